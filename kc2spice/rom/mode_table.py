"""Modes of a reduced model as an engineer reads them: frequency, Q, and how each port sees them."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from kc2spice.core.errors import UsageError
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.modal import resonators

MOST = 20  # modes in a table, the lowest
STILL = 1e-5  # of the band's end: a motion without stiffness, up to rounding
UNITS = {"mechanical": "m/N", "rotational": "rad/(N m)", "acceleration": "kg s2"}


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
    for j, higher in zip(order[:MOST], above, strict=False):
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
    units = {port.name: UNITS.get(port.kind, "") for port in model.ports}
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
