"""Reduced models as decoupled resonators: one second-order equation per state."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import eigh

from kc2spice.core.errors import UsageError
from kc2spice.rom.model import ReducedModel, ResonatorModel

# Proportional damping is exact by construction; anything above rounding is another damping.
COUPLING_LIMIT = 1e-8


def resonators(rom: ReducedModel) -> ResonatorModel:
    """Mass-normalised modes of the symmetric pair (K, M) with damping that they diagonalise.

    Solved as ``M phi = mu K phi`` because K is the better conditioned of the two.

    Raises
    ------
    UsageError : M or K not positive definite, C not B', or damping that couples the modes.
    """
    if not (rom.certificate.stable and np.array_equal(rom.C, rom.B.T)):
        raise UsageError(
            "not a symmetric positive definite model",
            where="resonator form",
            expected="M, K > 0, E >= 0 and C = B'",
        )
    mu, phi = eigh(rom.M, rom.K)
    mu, phi = mu[::-1], phi[:, ::-1] / np.sqrt(mu[::-1])
    damping = phi.T @ rom.E @ phi
    damp = np.diag(damping).copy()
    scale = np.sqrt(np.outer(damp, damp)) + np.finfo(float).tiny
    coupling = np.abs(damping - np.diag(damp)) / scale
    if coupling.max(initial=0.0) > COUPLING_LIMIT:
        raise UsageError(
            "damping couples the modes",
            where="resonator form",
            got=f"relative coupling {coupling.max():.1e}",
            expected="damping proportional to mass and stiffness",
        )
    gain = phi.T @ rom.B
    # A mode has no sign of its own; this one makes the same model the same netlist everywhere.
    gain *= np.sign(gain[np.arange(len(gain)), np.abs(gain).argmax(axis=1)])[:, None]
    return ResonatorModel(1 / np.sqrt(mu), damp, gain, rom.D, rom.ports, rom.certificate)


def whole_device(model: ResonatorModel, sectors: int) -> ResonatorModel:
    """All symmetry sectors moving alike, as one device.

    A force on a whole ring is shared by the sectors, which all answer with the displacement of
    one; the anode sees the charges of all at one voltage. With the modal amplitude scaled by
    sqrt(sectors) the form stays reciprocal: mechanical gains shrink by it, electrical ones grow.
    """
    root = np.sqrt(sectors)
    factor = np.array([root if port.kind == "electrical" else 1 / root for port in model.ports])
    return replace(model, gain=model.gain * factor, D=model.D * np.outer(factor, factor))
