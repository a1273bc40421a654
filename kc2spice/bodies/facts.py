"""The few numbers by which an engineer recognises an electromechanical body."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from kc2spice.core.errors import SimulationError
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.pencil import Pencil

VOLTAGE = 100.0  # of the free stroke, as in the actuator's data sheet
MODES = 8
# A mode that answers to no port is there by rounding only; coupled ones lie above 1e-2.
COUPLED = 1e-4
Operator = Callable[[np.ndarray], np.ndarray]


def electromechanical(model: LinearModel) -> dict[str, float]:
    """Free stroke, capacitances and first resonances of a supported body with one electrode pair.

    ``free_stroke_m_per_100v`` is that of the first port, ``capacitance_free_f`` the static one,
    ``resonance_short_hz`` and ``resonance_open_hz`` the lowest undamped frequencies that any port
    can excite, electrodes shorted and open.

    Raises
    ------
    SimulationError : the body is free to move.
    """
    pencil = model.pencil
    anode = next(i for i, p in enumerate(model.ports) if p.kind == "electrical")
    b, clamped = model.B[:, anode], float(model.D[anode, anode])
    solve = pencil.pencil_solver(0.0).solve
    unit_voltage = solve(b)
    return {
        "free_stroke_m_per_100v": VOLTAGE * float(model.B[:, 0] @ unit_voltage),
        "capacitance_free_f": clamped + float(b @ unit_voltage),
        "capacitance_clamped_f": clamped,
        "resonance_short_hz": _resonance(pencil, solve),
        "resonance_open_hz": _resonance(pencil, _open_circuit(solve, b, clamped, unit_voltage)),
    }


def _open_circuit(
    shorted: Operator, b: np.ndarray, clamped: float, unit_voltage: np.ndarray
) -> Operator:
    """``(K + b b'/C0)^-1``: at zero charge the anode floats to ``V = -b'u / C0``."""
    weight = 1 / (clamped + b @ unit_voltage)

    def solve(force: np.ndarray) -> np.ndarray:
        u = shorted(force)
        return u - unit_voltage * (weight * (b @ u))

    return solve


def _resonance(pencil: Pencil, solve: Operator) -> float:
    """Lowest port-coupled frequency [Hz], from shift-inverted Lanczos at zero.

    Starting from a static port answer keeps Lanczos in the subspace that ports can excite.
    """
    n, M = pencil.size, pencil.coefficients[-1]
    inverse = LinearOperator((n, n), matvec=solve, dtype=float)
    start = solve(pencil.B[:, 0])
    # Given OPinv, eigsh takes only shape and type from its first argument.
    values, modes = eigsh(inverse, MODES, M=M, sigma=0.0, OPinv=inverse, v0=start)
    gain = np.abs(modes.T @ pencil.B)
    coupled = values[(gain / gain.max(axis=0)).max(axis=1) > COUPLED]
    if not coupled.size:
        raise SimulationError("no port-coupled resonance found", where="facts")
    return float(np.sqrt(coupled.min()) / (2 * np.pi))
