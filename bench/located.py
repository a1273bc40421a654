"""scipy on the equations of the loop: general integrators, and one that locates the contacts.

Contact and clamp are kinks that a step control must find; an integrator that is not restarted at
the pulse's edges steps over the kick.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.integrate import solve_ivp

from bench.law import EXTRA, HEIGHT, INTEGRAL, RATE, SPEED, Law
from bench.segments import initial, saturation, segments
from kc2spice.core.errors import SimulationError

IMPLICIT = ("Radau", "BDF", "LSODA")
_TOUCH = 1e-9  # m over the rings; nearer than this the sphere is not said to fly
_MAX_PIECES = 5_000  # a chattering contact beyond this is a modelling error, not a waveform
# States below these sizes, times rtol, count as zero: metres, metres per second, amperes.
_ATOL = np.zeros(EXTRA)
_ATOL[[HEIGHT, SPEED, RATE, INTEGRAL]] = 1e-6, 1.0, 1.0, 1e-3


def _solved(equations, mode, x, rtol, method="Radau", **options):
    """From the start of ``mode`` to its end; 1 um of any ring is small, too."""
    atol = rtol * np.concatenate((np.full(2 * equations.q, 1e-6), _ATOL))
    if method in IMPLICIT:
        options["jac"] = partial(equations.jacobian, mode=mode)
    with np.errstate(divide="ignore"):  # scipy divides by an error that is zero at rest
        solution = solve_ivp(
            partial(equations.rhs, mode=mode), (mode.start, mode.end), x, method, rtol=rtol,
            atol=atol, **options,
        )  # fmt: skip
    if solution.status < 0:
        raise SimulationError(
            f"{method} gave up", where=f"t = {solution.t[-1]:.9e} s", got=solution.message
        )
    return solution


def integrate(law, scene, method, rtol):
    """The scene's transient by ``solve_ivp`` with ``method``, restarted at the pulse's edges."""
    x = initial(law, scene)
    times, states = [np.zeros(1)], [x[:, None]]
    for mode in segments(law, scene.stop_time):
        solution = _solved(law, mode, x, rtol, method)
        times.append(solution.t[1:])
        states.append(solution.y[:, 1:])
        x = solution.y[:, -1]
    t = np.concatenate(times)
    return law.waveforms(t, np.concatenate(states, axis=1), t.size)


# --- located events ------------------------------------------------------------------------------


@dataclass(frozen=True)
class FreeModes:
    """``a(s) = c1 e^(r1 s) + c2 e^(r2 s) + a0 + a1 s`` with ``s = t - start``, per mode.

    Solves ``a'' + damp a' + omega^2 a = f + g s``; ``r1``, ``r2`` are the roots of the
    characteristic polynomial.
    """

    start: float
    roots: np.ndarray  # (2, q) complex
    amplitudes: np.ndarray  # (2, q) complex
    a0: np.ndarray
    a1: np.ndarray
    law: Law

    @classmethod
    def of(cls, law, mode, x):
        """From the full state ``x`` at the start of ``mode``."""
        q, w = law.q, law.omega
        a, velocity = x[:q], w * x[q : 2 * q]
        half = 0.5 * law.damp
        spread = np.sqrt((half**2 - w**2).astype(complex))
        # Equal roots divide by zero; 1e-4 apart the solution differs by 1e-8.
        spread = np.where(np.abs(spread) < 1e-4 * w, 1e-4 * w, spread)
        fast = -half - spread
        slow = np.where(half > w, w**2 / fast, -half + spread)
        push = law.scale**2 * law.charge / w**2
        a1 = push * mode.slope
        a0 = push * mode.volt - law.damp / w**2 * a1
        u, du = a - a0, velocity - a1
        c1 = (du - slow * u) / (fast - slow)
        return cls(mode.start, np.array((fast, slow)), np.array((c1, u - c1)), a0, a1, law)

    def at(self, t):
        """Modal rows ``[a, b]`` (2 q, nt) of the state."""
        s = np.atleast_1d(t) - self.start
        waves = self.amplitudes[:, :, None] * np.exp(self.roots[:, :, None] * s)
        a = waves.sum(axis=0).real + self.a0[:, None] + self.a1[:, None] * s
        velocity = (self.roots[:, :, None] * waves).sum(axis=0).real + self.a1[:, None]
        return np.vstack((a, velocity / self.law.omega[:, None]))

    def reach(self, end):
        """Bound on the rings' height over rest until ``end`` [m]."""
        steady = np.maximum(np.abs(self.a0), np.abs(self.a0 + self.a1 * (end - self.start)))
        bound = np.abs(self.amplitudes).sum(axis=0) + steady
        return float((np.abs(self.law.rings) @ bound).max())


@dataclass(frozen=True)
class Piece:
    """One smooth stretch: ``state(t)`` gives the full states (N, nt); ``fired`` names its end."""

    end: float
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

    def __call__(self, t, x):
        return self.value(x)


def _clamp_events(law, mode):
    """Crossings of the current limits."""
    if not mode.enabled or law.control is None:
        return []
    limit = law.control.current_limit
    upper, lower = (-1 if mode.saturated == 1 else 1), (1 if mode.saturated == -1 else -1)
    return [
        _Event("upper limit", lambda x: law.demand(x[-EXTRA:]) - limit, upper),
        _Event("lower limit", lambda x: law.demand(x[-EXTRA:]) + limit, lower),
    ]


def coupled(law, mode, x, closed, ceiling, rtol):
    """Integrate everything until a ring toggles, the clamp toggles or the sphere is well clear.

    A ring that is closed can only open and the other way round: a crossing that just ended the
    last piece cannot end this one again.
    """
    row = 2 * law.q + HEIGHT
    events = [
        _Event(f"ring{i}", lambda x, i=i: law.penetration(x)[i], -1 if closed[i] else 1)
        for i in range(closed.size)
    ]
    events += _clamp_events(law, mode)
    if np.isfinite(ceiling):
        events.append(_Event("clear", lambda x: x[row] - ceiling, 1))
    return _piece(law, mode, x, rtol, events, lambda solution: solution.sol)


def flight(law, mode, x, free, floor, rtol):
    """Integrate the sphere alone until it comes down to ``floor`` or the clamp toggles."""
    events = [_Event("near", lambda y: y[0] - floor, -1), *_clamp_events(law, mode)]

    def state(solution):
        return lambda t: np.vstack((free.at(t), solution.sol(np.atleast_1d(t))))

    return _piece(law.sphere, mode, x[2 * law.q :], rtol, events, state)


def _piece(equations, mode, x, rtol, events, state):
    done = _solved(equations, mode, x, rtol, events=events, dense_output=True)
    equations.check_height(done.y[2 * equations.q + HEIGHT])
    fired = tuple(e.label for e, times in zip(events, done.t_events, strict=True) if times.size)
    whole, end = state(done), float(done.t[-1])
    last = whole(np.array([end]))[:, 0]
    last[last.size - done.y.shape[0] :] = done.y[:, -1]
    return Piece(end, whole, last, fired, done.t.size - 1)


def located(law, scene, rtol=1e-9):
    """Integrate from the start of ``scene`` to its stop (paper 2.4, 3.2.3).

    Radau with an analytic Jacobian between located events (contact, clamp, pulse edges); far from
    contact the modes are propagated exactly. Sampled every microsecond and every 10 ns after the
    pulse's edges; an impact in 3000 steps.

    Raises
    ------
    SimulationError : contact chatters, the integrator gives up, or the sphere leaves the height
        range of the force table.
    """
    pieces, events = _integrate(law, initial(law, scene), scene.stop_time, rtol)
    return _waveforms(law, pieces, np.union1d(_grid(law, scene), events))


def _integrate(law, x, stop, rtol):
    """All pieces, and the times at which they end."""
    pieces = []
    closed = law.penetration(x) > 0.0
    for mode in segments(law, stop):
        mode = replace(mode, saturated=saturation(law, x, mode.enabled))
        while mode.start < mode.end:
            if len(pieces) >= _MAX_PIECES:
                raise SimulationError("contact chatters without end", where=f"t = {mode.start} s")
            piece = _step(law, mode, x, closed, rtol)
            pieces.append(piece)
            x = piece.last
            closed = _closed(law, x, closed, piece.fired)
            saturated = _toggled(mode.saturated, piece.fired)
            mode = replace(mode, start=piece.end, volt=mode.voltage(piece.end), saturated=saturated)
    return pieces, [piece.end for piece in pieces]


def _step(law, mode, x, closed, rtol):
    if law.electrical == "open":  # charge constraint couples the modes: no exact flight
        return coupled(law, mode, x, closed, np.inf, rtol)
    free = FreeModes.of(law, mode, x)
    reach, height = free.reach(mode.end), x[2 * law.q + HEIGHT]
    # A margin: while the modes die away under a falling sphere, flights would follow each other in
    # ever shorter pieces.
    if height > 1.1 * reach + _TOUCH and not closed.any():
        return flight(law, mode, x, free, reach, rtol)
    return coupled(law, mode, x, closed, max(1.2 * reach, height + 1e-6), rtol)


def _closed(law, x, closed, fired):
    """Which rings touch after a piece: those that fired toggled, the others by their sign."""
    toggled = np.array([f"ring{i}" in fired for i in range(closed.size)])
    return np.where(toggled, ~closed, law.penetration(x) > 0.0)


def _toggled(saturated, fired):
    if "upper limit" in fired:
        return 0 if saturated == 1 else 1
    if "lower limit" in fired:
        return 0 if saturated == -1 else -1
    return saturated


def _grid(law, scene):
    if scene.find_only_part("throw") is not None:
        return np.linspace(0.0, scene.stop_time, 3001)
    coarse = np.linspace(0.0, scene.stop_time, max(2, round(scene.stop_time / 1e-6) + 1))
    if law.drive is None:
        return coarse
    d = law.drive
    edges = d.start, d.start + d.width
    fine = [np.arange(edge - 1e-6, edge + 75e-6, 10e-9) for edge in edges]
    corners = [(edge, edge + d.edge) for edge in edges]
    both = np.unique(np.concatenate((coarse, *fine, *corners)))
    return both[(both >= 0.0) & (both <= scene.stop_time)]


def _waveforms(law, pieces, times):
    owner = np.searchsorted([p.end for p in pieces[:-1]], times, side="left")
    states = [pieces[k].state(times[owner == k]) for k in np.unique(owner)]
    return law.waveforms(times, np.concatenate(states, axis=1), sum(p.steps for p in pieces))
