"""A symmetric model as decoupled resonators: one second-order equation per state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from kc2spice.core.errors import UsageError
from kc2spice.rom.linear import Certificate, LinearModel, Port

# Proportional damping is exact by construction; anything above rounding is another damping.
COUPLING_LIMIT = 1e-8


@dataclass(frozen=True)
class Resonators:
    """``m_j z_j'' + damp_j z_j' + omega_j^2 z_j = sum_k gain_jk u_k``,
    ``y_k = sum_j gain_jk z_j + sum_l D_kl u_l``.

    ``omega`` (q,) in rad/s, ``damp`` (q,) in 1/s, ``gain`` (q, p), ``D`` (p, p). ``m_j`` is one,
    but zero of the last ``massless`` states, which relax within ``damp_j / omega_j^2``. Reciprocal
    by form, stable for ``damp >= 0`` and passive for ``D`` positive semi-definite.
    For an electrical port u is the voltage and y the charge.
    """

    omega: np.ndarray
    damp: np.ndarray
    gain: np.ndarray
    D: np.ndarray
    ports: tuple[Port, ...]
    certificate: Certificate | None
    massless: int = 0

    @property
    def order(self) -> int:
        """Number of states, each a displacement and its velocity or, without inertia, only that."""
        return self.omega.size

    @property
    def inertia(self) -> np.ndarray:
        """(q,) ``m_j``: 1 or 0."""
        return (np.arange(self.order) < self.order - self.massless).astype(float)

    def transfer(self, frequency: np.ndarray) -> np.ndarray:
        """``H(j 2 pi f)`` (frequencies, outputs, inputs), as a sum over modes."""
        s = 2j * np.pi * np.asarray(frequency, dtype=float)[:, None]
        inverse = 1 / (self.inertia * s**2 + self.damp * s + self.omega**2)
        return np.einsum("jo,fj,ji->foi", self.gain, inverse, self.gain) + self.D

    def linear(self) -> LinearModel:
        """The same model as matrices; :func:`resonators` takes it back to the bit."""
        return LinearModel(
            M=np.diag(self.inertia),
            E=np.diag(self.damp),
            K=np.diag(self.omega**2),
            B=self.gain,
            D=self.D,
            ports=self.ports,
            certificate=self.certificate,
        )


def resonators(rom: LinearModel) -> Resonators:
    """Mass-normalised modes of the symmetric pair (K, M) with damping that they diagonalise.

    Solved as ``M phi = mu K phi`` because K is the better conditioned of the two.

    Raises
    ------
    UsageError : M or K not positive definite, C not B', or damping that couples the modes.
    """
    if rom.first_order or not rom.symmetric:
        raise _unfit("not a symmetric second-order model", "M, K > 0, E >= 0 and C = B'")
    K, E, M = rom.pencil.dense().coefficients
    one, massless = np.eye(rom.order), int(np.count_nonzero(np.diag(M) == 0.0))
    form = one * (np.arange(rom.order) < rom.order - massless)
    diagonal = np.array_equal(M, form) and all(np.array_equal(P, P * one) for P in (E, K))
    if diagonal and (np.diag(K) > 0).all():
        return Resonators(
            np.sqrt(np.diag(K)),
            np.diag(E).copy(),
            rom.B,
            rom.D,
            rom.ports,
            rom.certificate,
            massless,
        )
    try:
        mu, phi = scipy.linalg.eigh(M, K)
    except np.linalg.LinAlgError:
        mu = np.zeros(1)
    if mu[0] <= 0:
        raise _unfit("M or K is not positive definite", "M, K > 0, E >= 0 and C = B'")
    mu, phi = mu[::-1], phi[:, ::-1] / np.sqrt(mu[::-1])
    damping = phi.T @ E @ phi
    damp = np.diag(damping).copy()
    scale = np.sqrt(np.abs(np.outer(damp, damp))) + np.finfo(float).tiny
    coupling = np.abs(damping - np.diag(damp)) / scale
    if coupling.max(initial=0.0) > COUPLING_LIMIT:
        raise _unfit(
            "damping couples the modes",
            "damping proportional to mass and stiffness",
            f"relative coupling {coupling.max():.1e}",
        )
    gain = phi.T @ rom.B
    # A mode has no sign of its own; this one makes the same model the same netlist everywhere.
    gain *= np.sign(gain[np.arange(len(gain)), np.abs(gain).argmax(axis=1)])[:, None]
    return Resonators(1 / np.sqrt(mu), damp, gain, rom.D, rom.ports, rom.certificate)


def _unfit(why: str, expected: str, got: str | None = None) -> UsageError:
    return UsageError(why, where="resonator form", got=got, expected=expected)
