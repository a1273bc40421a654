"""From the operators of a piezoelectric body to its LinearModel, with the facts that name it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, eigsh

from kc2spice.bodies.keys import Damping
from kc2spice.core.errors import SimulationError
from kc2spice.fem.potentials import Condensed, PiezoOperators, condense_potentials, solver
from kc2spice.rom.linear import LinearModel, Port

_MODES = (12, 24, 48, 96)  # searched, one after the other, for one that an electrode moves
_COUPLED = 1e-8  # square of the effective coupling above which it is not rounding
_STRONG = 1e-2  # of the strongest one among these modes, from which a mode counts as coupled


@dataclass(frozen=True)
class FirstMode:
    """Lowest mode that the first electrode couples to, with all electrodes shorted and with it
    open [Hz], and the number of rigid-body modes."""

    short_hz: float
    open_hz: float
    rigid: int


def piezo_model(
    operators: PiezoOperators,
    ports: Sequence[Port],
    damping: Damping,
    qualities: Sequence[float] = (),
) -> LinearModel:
    """Eliminate the potentials, damp, and state the facts.

    ``ports`` are the electrical ones in the order of ``operators.electrodes``, then the
    mechanical ones in the order of the columns of ``operators.B``. ``qualities`` belong to
    ``operators.parts`` and are needed for damping per material only.

    Raises
    ------
    SimulationError : the body has no coupled resonance among its first modes, or more than one
        rigid-body mode.
    """
    condensed = condense_potentials(operators)
    mode = first_mode(operators, condensed.b[:, 0], float(condensed.C0[0, 0]))
    K, M = condensed.K, operators.M
    E = damping.matrix(M, K, operators.parts, qualities, mode.short_hz)
    B = np.column_stack([condensed.b, operators.B])
    D = np.zeros((B.shape[1],) * 2)
    k = len(operators.electrodes)
    D[:k, :k] = condensed.C0
    free = _free_capacitances(operators, condensed, mode.rigid)
    facts = {
        "mass_kg": operators.mass,
        "unknowns": float(operators.unknowns),
        "capacitance_free_f": free[0],
        "capacitance_clamped_f": float(condensed.C0[0, 0]),
        "resonance_short_hz": mode.short_hz,
        "resonance_open_hz": mode.open_hz,
        "rigid_modes": float(mode.rigid),
    }
    for name, value in zip(operators.electrodes[1:], free[1:], strict=True):
        facts[f"{name}_capacitance_f"] = value
    return LinearModel(B=B, C=B.T.copy(), D=D, ports=tuple(ports), M=M, E=E, K=K, facts=facts)


def _free_capacitances(operators: PiezoOperators, condensed: Condensed, rigid: int) -> list[float]:
    """Static charge per voltage [F] of each electrode, the others shorted.

    The loads of an electrode are in equilibrium, so that a body free to move along z may be held
    at any one unknown: that support takes no force.
    """
    solve = solver(operators, first=rigid)
    return [
        float(condensed.C0[i, i] + b @ solve(b)) for i, b in enumerate(np.transpose(condensed.b))
    ]


def first_mode(operators: PiezoOperators, b: np.ndarray, C0: float) -> FirstMode:
    """Resonance ``(K - w^2 M) x = 0`` and antiresonance ``(K + b b'/C0 - w^2 M) x = 0``.

    The update by ``b b'/C0`` has rank one, so that eigenvalues interlace: the open mode of the same
    number belongs to the short one.
    """
    M, shift = operators.M, -_scale(operators)
    shorted = solver(operators, shift)
    moved = shorted(b)
    gain = C0 + b @ moved

    def open_solve(x: np.ndarray) -> np.ndarray:
        y = shorted(x)
        return y - moved * (b @ y) / gain

    for count in _MODES:
        count = min(count, M.shape[0] - 1)
        short, modes = _eigenpairs(M, shorted, count, shift)
        rigid = int(np.sum(short < 1e-6 * abs(shift)))
        if rigid > 1:
            raise SimulationError("more than one rigid-body mode", got=rigid)
        coupling = (b @ modes[:, rigid:]) ** 2 / (short[rigid:] * C0)
        coupled = np.flatnonzero(coupling > max(_COUPLED, _STRONG * coupling.max())) + rigid
        if len(coupled):
            break
    else:
        raise SimulationError(
            f"no coupled resonance among the first {count} modes",
            got=f"largest squared coupling {coupling.max():.1e}",
            hint="are the electrodes and the poling directions as intended?",
        )
    first = int(coupled[0])
    opened, _ = _eigenpairs(M, open_solve, count, shift)
    hertz = np.sqrt([short[first], opened[first]]) / (2 * np.pi)
    return FirstMode(float(hertz[0]), float(hertz[1]), rigid)


def _scale(operators: PiezoOperators) -> float:
    """Square of an angular frequency well below any elastic mode, yet far from rounding.

    The eigenvalue of the softest trial: a parabola in r on the axial unknowns.
    """
    r, direction = operators.points[:, 0], operators.points[:, 2]
    z = operators.points[:, 1]
    trial = np.where(direction == 1, (r / r.max()) ** 2, -2 * z * r / r.max() ** 2)
    trial -= np.where(direction == 1, trial[direction == 1].mean(), 0.0)
    return 1e-3 * float(trial @ (operators.K_uu @ trial) / (trial @ (operators.M @ trial)))


def _eigenpairs(M, solve, count: int, shift: float):  # type: ignore[no-untyped-def]
    n = M.shape[0]
    shape = LinearOperator((n, n), matvec=lambda x: x, dtype=float)
    inverse = LinearOperator((n, n), matvec=solve, dtype=float)
    start = np.random.default_rng(0).standard_normal(n)
    values, vectors = eigsh(shape, count, M=M, sigma=shift, OPinv=inverse, v0=start, tol=1e-12)
    order = np.argsort(values)
    return values[order], vectors[:, order]
