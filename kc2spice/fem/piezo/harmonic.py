"""Harmonic response of the full model by direct solution at every frequency (Figs 7 and A1)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from kc2spice.fem.piezo.operator import ShiftedSolver, electrical_port
from kc2spice.fem.piezo.system import PiezoSystem


def harmonic(
    system: PiezoSystem, frequency: np.ndarray, progress: Callable[[float], None] | None = None
) -> np.ndarray:
    """``H(j 2 pi f)`` (frequencies, outputs, inputs): displacement and charge per force and volt.

    ``H = B' (s^2 M + s E + K)^-1 B + D`` with ``E = alpha M + beta K``; of the modelled sector.
    One sparse complex factorisation per frequency: seconds each for the default mesh.
    """
    b, capacitance, _ = electrical_port(system)
    B = np.column_stack([system.B, b])
    response = np.empty((len(frequency), B.shape[1], B.shape[1]), dtype=complex)
    for k, f in enumerate(frequency):
        s = 2j * np.pi * f
        solver = ShiftedSolver(system, s * (s + system.alpha), 1 + s * system.beta)
        response[k] = B.T @ solver.solve(B)
        response[k, -1, -1] += capacitance
        if progress:
            progress((k + 1) / len(frequency))
    return response
