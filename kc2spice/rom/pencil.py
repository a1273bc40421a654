"""Linear models of any origin as one polynomial pencil: ``P(s) x = B u``, ``y = C x + D u``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from scipy import sparse
from scipy.linalg import eigvals

from kc2spice.core.errors import SimulationError
from kc2spice.linalg.factor import Factor, Solver, inverses

Matrix: TypeAlias = Any  # np.ndarray or sparse.csc_array; scipy brings no types

# Two matrices whose entries differ by less than this of the largest one are the same matrix.
SAME = 1e-12
# A pole this far beyond the reference frequency belongs to a massless or algebraic equation.
INFINITE = 1e10


@dataclass(frozen=True)
class Pencil:
    """``P(s) = sum_k s^k coefficients[k]``, sparse (full model) or dense (reduced model).

    Second order: ``(K, E, M)``. First order ``E x' = A x + B u``: ``(-A, E)``.
    ``B`` (n, m), ``C`` (p, n) and ``D`` (p, m) are dense.
    """

    coefficients: tuple[Matrix, ...]
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray

    @property
    def size(self) -> int:
        """Number n of equations."""
        return int(self.B.shape[0])

    @property
    def degree(self) -> int:
        """1 for a first-order model, 2 for a second-order one."""
        return len(self.coefficients) - 1

    @property
    def symmetric(self) -> bool:
        """Every coefficient equals its transpose."""
        return all(largest(P - P.T) <= SAME * largest(P) for P in self.coefficients)

    @property
    def collocated(self) -> bool:
        """Outputs are taken where inputs act: ``C = B'``."""
        return self.B.shape == self.C.T.shape and np.array_equal(self.B, self.C.T)

    @property
    def undamped(self) -> bool:
        """Second order without first-order terms: real on the whole imaginary axis."""
        return self.degree == 2 and largest(self.coefficients[1]) == 0

    def at(self, s: complex) -> Matrix:
        """``P(s)``, real wherever it can be."""
        powers = [s**k for k in range(self.degree + 1)]
        if self.undamped and powers[2].imag == 0:
            return self.coefficients[0] + powers[2].real * self.coefficients[2]
        real = complex(s).imag == 0
        return sum(
            (p.real if real else p) * P
            for p, P in zip(powers, self.coefficients, strict=True)
        )  # fmt: skip

    def slope(self, s: complex) -> Matrix:
        """``P'(s)``, real where ``P(s)`` is: of an undamped model the derivative by ``s^2``."""
        if self.undamped:
            return self.coefficients[2]
        s = complex(s).real if complex(s).imag == 0 else s
        return sum(k * s ** (k - 1) * P for k, P in enumerate(self.coefficients) if k)

    def project(self, V: np.ndarray) -> Pencil:
        """Congruence ``V'PV``, ``V'B``, ``CV``; what is symmetric or skew stays so to the bit."""
        reduced = tuple(_congruence(P, V) for P in self.coefficients)
        B = V.T @ self.B
        return Pencil(reduced, B, B.T.copy() if self.collocated else self.C @ V, self.D)

    def scaled(self, omega: float) -> Pencil:
        """The same transfer function in unknowns whose energies at ``omega`` are alike."""
        rows = [omega**k * abs(P).max(axis=1) for k, P in enumerate(self.coefficients)]
        dense = [r.toarray() if sparse.issparse(r) else r for r in rows]
        size = np.sum([np.asarray(r, dtype=float).ravel() for r in dense], axis=0)
        t = 1 / np.sqrt(np.where(size > 0, size, 1.0))
        T = sparse.diags_array(t)
        coefficients = tuple(sparse.csc_array(T @ P @ T) for P in self.coefficients)
        B = t[:, None] * self.B
        return Pencil(coefficients, B, B.T.copy() if self.collocated else self.C * t, self.D)


def largest(matrix: Matrix) -> float:
    """Largest absolute entry."""
    return float(abs(matrix).max()) if matrix.shape[0] and matrix.shape[1] else 0.0


def _congruence(P: Matrix, V: np.ndarray) -> np.ndarray:
    """``V'PV``, its symmetric and skew parts each from that part of P alone."""
    total = np.zeros((V.shape[1],) * 2)
    for sign in (1, -1):
        part = 0.5 * (P + sign * P.T)
        if largest(part) > SAME * largest(P):
            R = V.T @ (part @ V)
            total += 0.5 * (R + sign * R.T)
    return total


def factorise_at(pencil: Pencil, s: complex, solver: Solver = "scipy") -> tuple[Factor, Factor]:
    """Solvers with ``P(s)`` and its transpose; the full model must be sparse.

    Without pivoting the fill of a symmetric model stays the least; a trial solution shows whether
    that is accurate, and partial pivoting follows where it is not (indefinite, saddle points).

    Raises
    ------
    SimulationError : ``s`` is a pole.
    MissingToolError : pypardiso is asked for and not installed.
    """
    matrix = sparse.csc_array(pencil.at(s))
    norm = float(abs(matrix).sum(axis=0).max())
    for symmetric in (True, False) if pencil.symmetric else (False,):
        try:
            apply, apply_transposed = inverses(matrix, symmetric=symmetric, solver=solver)
            forward = Factor(matrix, norm, apply)
            forward.solve(pencil.B[:, :1])
            return forward, Factor(sparse.csc_array(matrix.T), norm, apply_transposed)
        except (RuntimeError, MemoryError, SimulationError) as error:
            reason = error
    raise SimulationError(
        "matrix cannot be factorised", where="direct solver", got=f"{reason} at s = {s:.6g} 1/s"
    )


def states(pencil: Pencil, s: np.ndarray) -> np.ndarray:
    """``P(s)^-1 B`` of a dense pencil, (len(s), n, m) complex."""
    s = np.asarray(s, dtype=complex)[:, None, None]
    P = sum(s**k * P for k, P in enumerate(pencil.coefficients))
    return np.linalg.solve(P, np.broadcast_to(pencil.B, (len(s), *pencil.B.shape)))


def response(pencil: Pencil, s: np.ndarray) -> np.ndarray:
    """``C P(s)^-1 B + D`` of a dense pencil, (len(s), outputs, inputs) complex."""
    return np.asarray(pencil.C @ states(pencil, s) + pencil.D)


def poles(pencil: Pencil, omega: float) -> np.ndarray:
    """Finite poles [1/s] of a dense pencil; ``omega`` is a frequency that matters."""
    q, one = pencil.size, np.eye(pencil.size)
    P = [omega**k * P for k, P in enumerate(pencil.coefficients)]
    scale = 1 / max(largest(matrix) for matrix in P) if q else 1.0
    if pencil.degree == 1:
        values = eigvals(-scale * P[0], scale * P[1])
    else:
        left = np.block([[np.zeros((q, q)), one], [-scale * P[0], -scale * P[1]]])
        values = eigvals(left, np.block([[one, 0 * one], [0 * one, scale * P[2]]]))
    return np.asarray(omega * values[np.isfinite(values) & (np.abs(values) < INFINITE)])
