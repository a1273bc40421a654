"""The few numbers by which an engineer recognises the actuator, from the full model."""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from kc2spice.core.errors import SimulationError
from kc2spice.rom.krylov import Operator
from kc2spice.rom.schur import CondensedSystem

VOLTAGE = 100.0  # of the free stroke, as in the actuator's data sheet
MODES = 8
# A mode that answers to no port is there by rounding only; coupled ones lie above 1e-2.
COUPLED = 1e-4


def condensed_facts(model: CondensedSystem) -> dict[str, float]:
    """Unknowns, mass, free stroke, capacitances and first resonances of the whole chip.

    ``free_stroke_m_per_100v`` is that of the centre, ``capacitance_free_f`` the static one,
    ``resonance_short_hz`` and ``resonance_open_hz`` the lowest undamped frequencies that any port
    can excite, anode shorted and open.
    """
    system = model.system
    b, clamped = model.B[:, -1], model.D[-1, -1]
    unit_voltage = model.solve(b)
    return {
        "unknowns": system.unknowns,
        "mass_kg": system.sectors * system.mass,
        "free_stroke_m_per_100v": VOLTAGE * float(model.B[:, 0] @ unit_voltage),
        "capacitance_free_f": system.sectors * float(clamped + b @ unit_voltage),
        "capacitance_clamped_f": system.sectors * float(clamped),
        "resonance_short_hz": _resonance(model, model.solve),
        "resonance_open_hz": _resonance(model, _open_circuit(model, unit_voltage)),
    }


def _open_circuit(model: CondensedSystem, unit_voltage: np.ndarray) -> Operator:
    """``(K + b b'/C0)^-1``: at zero charge the anode floats to ``V = -b'u / C0``."""
    b, clamped = model.B[:, -1], model.D[-1, -1]
    weight = 1 / (clamped + b @ unit_voltage)

    def solve(force: np.ndarray) -> np.ndarray:
        u = model.solve(force)
        return u - unit_voltage * (weight * (b @ u))

    return solve


def _resonance(model: CondensedSystem, solve: Operator) -> float:
    """Lowest port-coupled frequency [Hz], from shift-inverted Lanczos at zero.

    Starting from a static port answer keeps Lanczos in the subspace that ports can excite.
    """
    n = model.M.shape[0]
    inverse = LinearOperator((n, n), matvec=solve, dtype=float)
    start = solve(model.B[:, 0])
    # Given OPinv, eigsh takes only shape and type from its first argument.
    values, modes = eigsh(inverse, MODES, M=model.M, sigma=0.0, OPinv=inverse, v0=start)
    gain = np.abs(modes.T @ model.B)
    coupled = values[(gain / gain.max(axis=0)).max(axis=1) > COUPLED]
    if not coupled.size:
        raise SimulationError("no port-coupled resonance found", where="kick facts")
    return float(np.sqrt(coupled.min()) / (2 * np.pi))
