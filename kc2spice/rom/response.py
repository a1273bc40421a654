"""Frequency response of reduced models in displacement form, and how far two of them differ."""

from __future__ import annotations

import numpy as np

from kc2spice.rom.model import ReducedModel, ResonatorModel

# Entries this far below their own peak are left out of relative errors: they are zeros.
FLOOR = 1e-6


def frequency_response(model: ReducedModel | ResonatorModel, frequency: np.ndarray) -> np.ndarray:
    """``H(j 2 pi f)`` from inputs to outputs, (frequencies, outputs, inputs), complex.

    Displacement per force and charge per voltage; times ``s`` they are velocities and currents.
    """
    s = 2j * np.pi * np.asarray(frequency, dtype=float)
    if isinstance(model, ResonatorModel):
        s = s[:, None]
        inverse = 1 / (s**2 + model.damp * s + model.omega**2)
        return np.einsum("jo,fj,ji->foi", model.gain, inverse, model.gain) + model.D
    return model.C @ states(model, frequency) + model.D


def states(model: ReducedModel, frequency: np.ndarray) -> np.ndarray:
    """``x(j 2 pi f) = (s^2 M + s E + K)^-1 B``, (frequencies, states, inputs)."""
    s = 2j * np.pi * np.asarray(frequency, dtype=float)[:, None, None]
    return np.linalg.solve(s * s * model.M + s * model.E + model.K, model.B)


def relative_error(response: np.ndarray, reference: np.ndarray) -> float:
    """Largest ``|H - H_ref| / |H_ref|`` of all pairs and frequencies above the ``FLOOR``."""
    return float(relative_size(response - reference, reference).max(initial=0.0))


def relative_size(difference: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """``|difference| / |reference|``, zero where the reference is below ``FLOOR`` of its peak."""
    size = np.abs(reference)
    counted = size > FLOOR * size.max(axis=0)
    return np.divide(np.abs(difference), size, out=np.zeros_like(size), where=counted)
