"""Chip and sphere with a given set of closed rings: a linear system and its eigenvectors."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eig, lu_factor

from laboratory.law import Law


@dataclass(frozen=True)
class Modes:
    """Eigenvectors of one contact set: rates (k,), rows of interest, transformation to them."""

    rates: np.ndarray
    vectors: np.ndarray  # (n, k), those of conjugate pairs once, twice as large
    rows: np.ndarray  # (rings + 2, k): ring displacements, height, velocity
    inverse: np.ndarray  # (k, n)
    lu: tuple[np.ndarray, np.ndarray]


class ContactSets:
    """``x' = A x`` over ``x = [a, b, p, v, d]`` for each set of closed rings, made once and kept.

    Without contact the modes are alone: ``A`` is theirs only.
    """

    def __init__(self, law: Law) -> None:
        self.law, q, count = law, law.q, len(law.gaps)
        self.n = 2 * q + 3
        self.select = np.zeros((count + 2, self.n))
        self.select[:count, :q] = law.rings
        self.select[count, 2 * q] = self.select[count + 1, 2 * q + 1] = 1.0
        self.rolloff = law.control.rolloff if law.control is not None else 1.0
        self.slope = self._slope()
        self.known: dict[bytes, Modes] = {}

    def modes(self, closed: np.ndarray) -> Modes:
        """Eigenvectors for the rings that are closed."""
        key = closed.tobytes()
        if key not in self.known:
            A = self._matrix(closed)
            if not closed.any():
                A = A[: 2 * self.law.q, : 2 * self.law.q]
            rates, vectors = eig(A)
            inverse = np.linalg.inv(vectors)
            kept = rates.imag >= 0.0
            twice = np.where(rates[kept].imag > 0.0, 2.0, 1.0)
            vectors = vectors[:, kept] * twice
            rows = self.select[:, : len(A)] @ vectors
            self.known[key] = Modes(rates[kept], vectors, rows, inverse[kept], lu_factor(A))
        return self.known[key]

    def _matrix(self, closed: np.ndarray) -> np.ndarray:
        """``A`` over ``[a, b, p, v, d]`` with the springs of the closed rings."""
        law, q, A = self.law, self.law.q, np.zeros((self.n, self.n))
        diag, p, v, d = np.arange(q), 2 * q, 2 * q + 1, 2 * q + 2
        A[diag, q + diag], A[q + diag, diag] = law.omega, -law.omega
        A[q + diag, q + diag] = -law.damp
        rings = law.rings[closed]
        A[q:p, :q] -= law.stiffness * (law.inverse_mass[:, None] * rings.T) @ rings
        if law.electrical == "open":
            A[q:p, :q] -= np.outer(law.inverse_mass * law.charge, law.charge) / law.c0
        A[q:p, p] = law.stiffness * law.inverse_mass * rings.sum(axis=0)
        A[p, v] = 1.0
        A[v, :q] = law.stiffness * rings.sum(axis=0) / law.mass
        A[v, p] = (self.slope - law.stiffness * len(rings)) / law.mass
        A[d, v] = A[d, d] = -1.0 / self.rolloff
        return A

    def _slope(self) -> float:
        """dF/dp [N/m] of the magnets at the chip, with the current that the set point asks for."""
        law = self.law
        if law.force_map is None:
            return 0.0
        side = 0.0 if law.control is None else np.sign(law.control.setpoint - law.radius)
        limit = 0.0 if law.control is None else law.control.current_limit
        return law.force_map(law.radius, float(side * limit))[1]
