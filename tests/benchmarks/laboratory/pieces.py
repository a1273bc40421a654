"""Smooth pieces of the motion: coupled ones near contact, and flights with exact modes."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from kc2spice.core.errors import SimulationError
from laboratory.freemodes import FreeModes
from laboratory.law import EXTRA, HEIGHT, INTEGRAL, RATE, SPEED, Law, Mode

# States below these sizes, times rtol, count as zero: metres, metres per second, amperes.
_ATOL = np.zeros(EXTRA)
_ATOL[[HEIGHT, SPEED, RATE, INTEGRAL]] = 1e-6, 1.0, 1.0, 1e-3


@dataclass(frozen=True)
class Piece:
    """One smooth stretch: ``state(t)`` gives the full states (N, nt); ``fired`` names its end."""

    start: float
    end: float
    mode: Mode
    state: Callable[[np.ndarray], np.ndarray]
    last: np.ndarray
    fired: tuple[str, ...]
    steps: int


@dataclass(frozen=True)
class _Event:
    """A crossing of zero that ends a piece; attributes as ``solve_ivp`` asks for them."""

    label: str
    value: Callable[[np.ndarray], float]
    direction: int
    terminal: bool = True

    def __call__(self, t: float, x: np.ndarray) -> float:
        return self.value(x)


def _clamp_events(law: Law, mode: Mode, rest: Callable[[np.ndarray], np.ndarray]) -> list[_Event]:
    """Crossings of the current limits; ``rest`` takes the last four rows out of a state."""
    if not mode.enabled or law.control is None:
        return []
    limit = law.control.current_limit
    upper, lower = (-1 if mode.saturated == 1 else 1), (1 if mode.saturated == -1 else -1)
    return [
        _Event("upper limit", lambda x: law.demand(rest(x)) - limit, upper),
        _Event("lower limit", lambda x: law.demand(rest(x)) + limit, lower),
    ]


def _penetration(law: Law, ring: int, x: np.ndarray) -> float:
    return float(law.penetration(x)[ring])


def _solve(
    rhs: Callable[[float, np.ndarray], np.ndarray],
    jac: Callable[[float, np.ndarray], np.ndarray],
    x0: np.ndarray,
    span: tuple[float, float],
    events: list[_Event],
    tolerance: tuple[float, np.ndarray],
) -> tuple[Any, tuple[str, ...]]:
    solution = solve_ivp(
        rhs, span, x0, method="Radau", jac=jac, events=events, rtol=tolerance[0], atol=tolerance[1],
        dense_output=True,
    )  # fmt: skip
    if solution.status < 0:
        raise SimulationError(
            "the reference integration failed", where=f"t = {solution.t[-1]:.9e} s",
            got=solution.message,
        )  # fmt: skip
    fired = tuple(e.label for e, times in zip(events, solution.t_events, strict=True) if times.size)
    return solution, fired


def coupled(
    law: Law, mode: Mode, x: np.ndarray, end: float, closed: np.ndarray, ceiling: float, rtol: float
) -> Piece:
    """Integrate everything until a ring toggles, the clamp toggles or the sphere is well clear.

    A ring that is closed can only open and the other way round: a crossing that just ended the
    last piece cannot end this one again.
    """
    row = 2 * law.q + HEIGHT
    events = [
        _Event(f"ring{i}", partial(_penetration, law, i), -1 if closed[i] else 1)
        for i in range(closed.size)
    ]
    events += _clamp_events(law, mode, lambda x: x[2 * law.q :])
    if np.isfinite(ceiling):
        events.append(_Event("clear", lambda x: x[row] - ceiling, 1))
    atol = np.full(2 * law.q + EXTRA, rtol * 1e-6)
    atol[2 * law.q :] = rtol * _ATOL
    solution, fired = _solve(
        partial(law.rhs, mode=mode), partial(law.jacobian, mode=mode),
        x, (mode.start, end), events, (rtol, atol),
    )  # fmt: skip
    law.check_height(solution.y[row])
    last = solution.y[:, -1]
    return Piece(mode.start, solution.t[-1], mode, solution.sol, last, fired, solution.t.size - 1)


def flight(
    law: Law, mode: Mode, x: np.ndarray, end: float, free: FreeModes, floor: float, rtol: float
) -> Piece:
    """Integrate the sphere alone until it comes down to ``floor`` or the clamp toggles."""
    base = 2 * law.q
    events = [_Event("near", lambda y: y[0] - floor, -1), *_clamp_events(law, mode, lambda y: y)]
    solution, fired = _solve(
        partial(law.sphere.rhs, mode=mode), partial(law.sphere.jacobian, mode=mode),
        x[base:], (mode.start, end), events, (rtol, rtol * _ATOL),
    )  # fmt: skip

    law.check_height(solution.y[0])

    def state(t: np.ndarray) -> np.ndarray:
        return np.vstack((free.at(t), solution.sol(np.atleast_1d(t))))

    stop = solution.t[-1]
    last = state(stop)[:, 0]
    last[base:] = solution.y[:, -1]
    return Piece(mode.start, stop, mode, state, last, fired, solution.t.size - 1)
