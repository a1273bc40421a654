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
    states = [np.linalg.solve(x * x * model.M + x * model.E + model.K, model.B) for x in s]
    return model.C @ np.array(states) + model.D


def relative_error(response: np.ndarray, reference: np.ndarray) -> float:
    """Largest ``|H - H_ref| / |H_ref|`` of all pairs and frequencies above the ``FLOOR``."""
    size = np.abs(reference)
    counted = size > FLOOR * size.max(axis=0)
    return float((np.abs(response - reference)[counted] / size[counted]).max(initial=0.0))
