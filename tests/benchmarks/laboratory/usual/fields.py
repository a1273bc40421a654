"""A field per case: the usual code of the force table, which superposition does without."""

import numpy as np

from kc2spice.fem.magnetics.field import positions, ring_sign, systems
from kc2spice.fem.magnetics.keys import Catch


def brute_force(catch: Catch, radius: float, currents: np.ndarray) -> np.ndarray:
    """Force (m, n) [N] of the m pairs ``currents`` (m, 2) at n heights, case by case.

    The paper's road and the baseline of :func:`catch_table`: on the same meshes, each case
    assembles, factorises and solves for the sum of its sources and takes that one field's force.
    """
    y = positions(catch)
    amplitudes = [np.array([ring_sign(catch), 1.0, i1, i2]) for i1, i2 in currents]
    result = np.empty((len(amplitudes), y.size))
    for index, system in systems(catch, radius):
        for case, amplitude in enumerate(amplitudes):
            field = system.solve(system.loads @ amplitude[:, None])
            result[case, index] = system.force(field)[0, 0]
    return result
