"""A symmetric model as decoupled resonators, and its modes as an engineer reads them: frequency, Q,
and how each port sees them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from kc2spice.core.errors import UsageError
from kc2spice.rom.linear import Certificate, LinearModel, Port

# Proportional damping is exact by construction; anything above rounding is another damping.
COUPLING_LIMIT = 1e-8
LISTED = 20  # modes in a table, the lowest
STILL = 1e-5  # of the band's end: a motion without stiffness, up to rounding
COUPLED_IN = {"mechanical": "m/N", "rotational": "rad/(N m)", "acceleration": "kg s2"}


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


def mode_table(model: LinearModel) -> dict[str, Any] | None:
    """Modes with all electrodes shorted and no load, up to the end of the certificate's band.

    ``modes``, each with ``frequency_hz``, ``quality`` (None without damping) and ``couplings`` by
    port, in ``units``. That of an electrical port is the effective factor ``k = sqrt(C_j / (C_j +
    C_above))``, where ``C_j = gain_j^2 / omega_j^2`` [F] is what the mode adds to the static
    capacitance and ``C_above`` what all higher ones and the clamped body have (``k^2 = 1 - (f_r /
    f_a)^2`` of a mode far from others); of any other port it is the same static share ``gain_j^2 /
    omega_j^2``.

    Modes that damping couples are those of the poles, ``omega_j`` their distance from zero. Motions
    without stiffness are none of them. None for a model in first order, or without conservative
    ports alone.
    """
    found = _resonant(model)
    if found is None:
        return None
    omega, damp, share, rest = found
    end = np.inf if model.certificate is None else model.certificate.band_hz[1]
    order = np.argsort(omega)
    electrical = np.array([port.kind == "electrical" for port in model.ports])
    above = rest + share[order].sum(axis=0) - np.cumsum(share[order], axis=0)
    modes = []
    for j, higher in zip(order[:LISTED], above, strict=False):
        if omega[j] > 2 * np.pi * end:
            break
        whole = share[j] + np.maximum(higher, 0.0)
        factor = np.sqrt(np.divide(share[j], whole, out=np.zeros_like(whole), where=whole > 0))
        size = np.where(electrical, factor, share[j])
        modes.append(
            {
                "frequency_hz": float(omega[j] / (2 * np.pi)),
                "quality": float(omega[j] / damp[j]) if damp[j] > 0 else None,
                "couplings": {p.name: float(v) for p, v in zip(model.ports, size, strict=True)},
            }
        )
    units = {port.name: COUPLED_IN.get(port.kind, "") for port in model.ports}
    return {"units": units, "modes": modes} if modes else None


def _resonant(model: LinearModel) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """``omega`` and ``damp`` (modes,), shares (modes, ports) and what the ports answer besides."""
    try:
        found = resonators(model)
    except UsageError:
        return _by_poles(model)
    count = found.order - found.massless
    share = found.gain**2 / found.omega[:, None] ** 2
    rest = np.diag(found.D) + share[count:].sum(axis=0)
    return found.omega[:count], found.damp[:count], share[:count], rest


def _by_poles(
    model: LinearModel,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """The same by the poles of ``M x'' + E x' + K x``; ``-2 Re(residue / pole)`` of a port's own
    transfer function is its share, ``gain^2 / omega^2`` where nothing couples."""
    if model.first_order or not all(port.conservative for port in model.ports):
        return None
    K, E, M = model.pencil.dense().coefficients
    n, one = len(K), np.eye(len(K))
    scale = np.sqrt(np.abs(np.diag(K)).max() / np.abs(np.diag(M)).max())  # rad/s
    left = np.block([[np.zeros((n, n)), one], [-K, -scale * E]])
    right = np.block([[one, np.zeros((n, n))], [np.zeros((n, n)), scale**2 * M]])
    values, dual, own = scipy.linalg.eig(left, right, left=True, right=True)
    end = np.abs(values[np.isfinite(values)]).max()
    if model.certificate is not None:
        end = min(end, 2 * np.pi * model.certificate.band_hz[1] / scale)
    rows = np.isfinite(values) & (values.imag > STILL * end)
    weight = np.einsum("ij,ij->j", dual.conj(), right @ own)[rows]
    into = dual[n:, rows].conj().T @ model.B
    out = model.C @ own[:n, rows]
    share = -2 * np.real(into * out.T / weight[:, None] / values[rows, None])
    size = np.abs(values[rows]) * scale
    return size, -2 * values[rows].real * scale, share, np.diag(model.D)
