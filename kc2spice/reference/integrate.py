"""Transient of a `System` by an implicit method, between corners and events.

The steps use Radau IIA of order five for ``d/dt g(t, z) = f(t, z)`` (Hairer and Wanner 1996,
IV.8). ``scipy.integrate.Radau`` accepts no mass matrix, so algebraic unknowns would have to be
eliminated. This elimination is possible for index 1 only. Two inductors in series, or one behind a
current source, are of index 2, and their elimination is singular. The implicit method needs no
elimination. The steps of the method integrate ``g``, which conserves charge, flux and momentum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, pairwise
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import brentq

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import Device
from kc2spice.reference.equilibrium import Interval, equilibrium, join_waves
from kc2spice.reference.system import System

_S6 = np.sqrt(6.0)
RADAU_NODES = np.array([(4 - _S6) / 10, (4 + _S6) / 10, 1.0])
_POWERS = np.arange(1, 4)
_RADAU_MATRIX = (RADAU_NODES[:, None] ** _POWERS / _POWERS) @ np.linalg.inv(
    RADAU_NODES[:, None] ** (_POWERS - 1)
)
RADAU_WEIGHTS = _RADAU_MATRIX[2]
_RADAU_INVERSE = np.linalg.inv(_RADAU_MATRIX)
_values, _vectors = np.linalg.eig(_RADAU_INVERSE)
_EIGENVECTORS_INVERSE = np.linalg.inv(_vectors)
_REAL_INDEX = int(np.argmin(np.abs(_values.imag)))
_PAIR_INDEX = int(np.argmax(_values.imag))
_ERROR_COEFFICIENTS = np.array([-13 - 7 * _S6, -13 + 7 * _S6, -1.0]) / 3.0
_MAX_NEWTON_STEPS = 8
# largest rounding error relative to the tolerance; the derivative of a controller amplifies
# rounding to 100 nV
_MAX_ROUNDING = 0.1
_MACHINE_EPSILON = float(np.finfo(float).eps)
# factor on the estimate of rounding errors, which uses one set of random signs
_ROUNDING_FACTOR = 3.0
# Polynomials through the start and the stages, and through only the stages.
_CUBIC_MATRIX = np.linalg.inv(RADAU_NODES[:, None] ** _POWERS)
_SQUARE_MATRIX = np.linalg.inv(RADAU_NODES[:, None] ** (_POWERS - 1))


@dataclass(frozen=True, eq=False)
class Step:
    """Accepted step: start, length, first state, and increments (n, 3) at stages."""

    start: float
    length: float
    first: np.ndarray
    increments: np.ndarray
    differential: np.ndarray

    @property
    def end(self) -> float:
        """Time at the end."""
        return self.start + self.length

    @property
    def last(self) -> np.ndarray:
        """State at the end."""
        return self.first + self.increments[:, 2]

    @property
    def stage_times(self) -> np.ndarray:
        """Times (3,) of the stages."""
        return self.start + self.length * RADAU_NODES

    def at(self, t: np.ndarray | float) -> np.ndarray:
        """States (n, nt) on the collocation polynomial."""
        x = (np.atleast_1d(t) - self.start) / self.length
        powers = x ** np.arange(4)[:, None]
        return self.first[:, None] + self._polynomials(powers[1:], powers[:3])

    def rate(self, t: np.ndarray | float) -> np.ndarray:
        """Time derivatives (n, nt); derivatives of algebraic unknowns are of low order."""
        x = (np.atleast_1d(t) - self.start) / self.length
        square = np.array([0.0 * x, x**0, 2 * x])
        return self._polynomials(np.array([x**0, 2 * x, 3 * x**2]), square) / self.length

    def _polynomials(self, cubic: np.ndarray, square: np.ndarray) -> np.ndarray:
        through_start = self.increments @ _CUBIC_MATRIX.T @ cubic
        alone = self.increments @ _SQUARE_MATRIX.T @ square
        return np.where(self.differential[:, None], through_start, alone)

    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """States and rates (n, 3) at the stages, for quadrature over the step."""
        return self.first[:, None] + self.increments, self.rate(self.stage_times)


class Radau:
    """Integrator of one interval.

    The steps have a given error (``advance``) or a given length (``take``).
    """

    def __init__(self, interval: Interval, t: float, z: np.ndarray, rtol: float) -> None:
        self.rtol = rtol
        self.newton_tol = max(10 * np.finfo(float).eps / rtol, min(0.03, rtol**0.5))
        self.interval, self.rows = interval, interval.rows
        self.active = interval.system.differential  # mask of the unknowns whose error is controlled
        self.before: Step | None = None
        self._start(t, z)
        self._linearise()

    def _start(self, t: float, z: np.ndarray) -> None:
        """Set the state from which the next step begins."""
        self.t, self.z = t, z
        self.g, f = self.interval.at(t, z)
        self.f = np.where(self.rows, f, 0.0)

    def _linearise(self) -> None:
        """Compute the derivatives at the present state."""
        self.M, self.J = self.interval.slopes(self.t, self.z)
        self.h_lu, self.lu = 0.0, tuple[Any, ...]()
        # rounding error of a change by Newton's method, relative to the tolerance
        self.rounding = 0.0

    def choose_first_step(self, end: float) -> float:
        """Choose the first step: a hundredth of the time in which the state doubles."""
        rates = np.linalg.lstsq(self.M, self.f, rcond=None)[0]
        speed = _norm((rates / (self.rtol * (1.0 + np.abs(self.z))))[self.active])
        if speed <= 1e-300:
            return end - self.t
        first = min(0.5 * (0.01 / speed) ** 0.25, max(1e-12, 0.01 * self.rtol**-0.75 / speed))
        return min(end - self.t, first)

    def _solve(self, right: np.ndarray, which: int) -> np.ndarray:
        """Solve one of the two linear systems of a stage."""
        if np.iscomplexobj(self.lu[which][0]):
            return np.asarray(lapack.zgetrs(*self.lu[which][:2], right)[0])
        return np.asarray(lapack.dgetrs(*self.lu[which][:2], right)[0])

    def _newton_change(self, r: np.ndarray) -> np.ndarray:
        """Compute the change (n, 3) of the stages for a residual ``r``."""
        real = np.outer(
            self._solve(r @ _EIGENVECTORS_INVERSE[_REAL_INDEX].real, 0),
            _vectors[:, _REAL_INDEX].real,
        )
        pair = np.outer(
            self._solve(r @ _EIGENVECTORS_INVERSE[_PAIR_INDEX], 1), _vectors[:, _PAIR_INDEX]
        )
        return np.asarray(real + 2.0 * pair.real)

    def _estimate_rounding(self, X: np.ndarray, h: float) -> np.ndarray:
        """Estimate the change (n, 3) of the stages that rounding of the residual causes.

        Each equation has its own rounding error, in proportion to its largest terms.
        """
        flow, stored = self.interval.term_sizes(X)
        sizes = flow + (stored + np.abs(self.g)[:, None]) @ np.abs(_RADAU_INVERSE.T) / h
        signs = np.random.default_rng(0).choice((-1.0, 1.0), sizes.shape)
        return self._newton_change(_MACHINE_EPSILON * sizes * signs)

    def _factor(self, h: float) -> None:
        """Factorise the matrices for a step length."""
        if h == self.h_lu:
            return
        self.lu = (
            lapack.dgetrf(_values[_REAL_INDEX].real / h * self.M - self.J),
            lapack.zgetrf(_values[_PAIR_INDEX] / h * self.M - self.J),
        )
        self.h_lu = h
        if any(map(itemgetter(2), self.lu)):
            raise SimulationError(
                "the circuit equations are singular",
                where=f"t = {self.t:.6e} s",
                hint="look for a net without a path to ground, or an inductor in series with a "
                "current source",
            )

    def take(self, h: float) -> Step | None:
        """Solve one step of length ``h``; None if Newton's method diverges or overflows."""
        self._factor(h)
        still = np.zeros((self.z.size, 3))
        if self.before is None:
            return self._solve_stages(h, still)
        # The polynomial of a much shorter step extrapolates rounding errors. An exponential law
        # then overflows, so that the state at the start is the better guess.
        predicted = self.before.at(self.t + h * RADAU_NODES) - self.z[:, None]
        return self._solve_stages(h, predicted) or self._solve_stages(h, still)

    @np.errstate(over="ignore", invalid="ignore")
    def _solve_stages(self, h: float, Z: np.ndarray) -> Step | None:
        """Solve the stages of a step by Newton's method from the increments ``Z`` (n, 3)."""
        p, t = self.interval, self.t + h * RADAU_NODES
        sources = p.system.source_values(t, p.within)
        scale = self.rtol * (1.0 + np.abs(self.z))
        scale = np.where(self.active, scale, 1e3 * scale)  # inactive states do not propagate errors
        last = 0.0
        for k in range(_MAX_NEWTON_STEPS):
            X = np.concatenate((self.z[:, None] + Z, sources))
            r = p.flow(X) - (p.stored_quantities(X) - self.g[:, None]) @ _RADAU_INVERSE.T / h
            change = self._newton_change(r)
            size = _norm(change / scale[:, None])
            rate = size / last if last > 0.0 else 0.0
            if not np.isfinite(size):
                return None
            if rate >= 1.0 and size > max(_MAX_ROUNDING, self.rounding):
                estimate = _norm(self._estimate_rounding(X, h) / scale[:, None])
                # not larger than the tolerance
                self.rounding = min(1.0, _ROUNDING_FACTOR * estimate)
                if size > self.rounding:
                    return None
            Z = Z + change
            done = size == 0.0 or (p.linear and k == 0)
            if last > 0.0:
                done |= size <= self.rounding
                done |= rate >= 1.0 or rate / (1 - min(rate, 0.9)) * size < self.newton_tol
            if done:
                self.iterations = k + 1
                return Step(self.t, h, self.z, Z, self.active)
            last = size
        return None

    def accept(self, step: Step) -> None:
        """Accept a step: the next step starts at its end."""
        self.before = step
        self._start(step.end, step.last)
        if not self.interval.linear and self.iterations > 2:
            self._linearise()

    def advance(self, h: float, end: float) -> tuple[Step, float]:
        """Compute a step whose error is within the tolerance, and the next length.

        The step is not accepted yet.
        """
        rejected = False
        while True:
            if not h > 1e-15 * max(abs(self.t), 1e-6):
                raise SimulationError("the time step became too small", where=f"t = {self.t:.9e} s")
            h = min(h, end - self.t)
            if not rejected and end - self.t - h < 1e-3 * h:
                h = end - self.t
            step = self.take(h)
            if step is None:
                h, rejected = 0.5 * h, True
                continue
            size = self._estimate_error(step)
            safety = 0.9 * (2 * _MAX_NEWTON_STEPS + 1) / (2 * _MAX_NEWTON_STEPS + self.iterations)
            factor = min(10.0, safety * max(size, 1e-4) ** -0.25)
            if size <= 1.0:
                return step, h if 1.0 <= factor < 1.2 else h * factor
            h, rejected = h * max(0.2, factor), True

    def _estimate_error(self, step: Step) -> float:
        """Estimate the error in units of the tolerance."""
        p, t, h = self.interval, step.stage_times, step.length
        sources = p.system.source_values(t, p.within)
        # of the stored value; ``M`` times the unknowns belongs to an earlier state
        late = p.stored_quantities(np.concatenate((step.first[:, None] + step.increments, sources)))
        moved = np.where(self.rows, (late - self.g[:, None]) @ _ERROR_COEFFICIENTS / h, 0.0)
        scale = self.rtol * (1.0 + np.maximum(np.abs(self.z), np.abs(step.last)))
        error = self._solve(self.f + moved, 0)
        return _norm((error / scale)[self.active])


def _norm(x: np.ndarray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(x * x))) if x.size else 0.0


# a larger number of segments is a modelling error, such as a chattering contact
_MAX_SEGMENTS = 20_000


@dataclass(frozen=True)
class Segment:
    """Accepted steps within one interval."""

    interval: Interval
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class EnergyBalance:
    """Energy error of a run: the supplied energy [J] that is neither stored nor lost.

    The scale of the error is the ``turnover``: the sum of the supplied energy, the lost energy and
    the energy at the start.
    """

    residual: float
    turnover: float


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Segments of a run, its output times ``time`` (nt,), and its ``events`` [s].

    An event is a change of the mode of a device.
    """

    system: System
    time: np.ndarray
    segments: tuple[Segment, ...]
    events: tuple[float, ...]

    @cached_property
    def waves(self) -> dict[str, np.ndarray]:
        """Waves (nt,) by their names, from the collocation polynomials.

        The names are ``time``, ``NAME.pin``, ``NAME.pin.through``, ``NAME.pin.rate``,
        ``NAME.state`` and those that a device adds.
        """
        # ngspice may round the time of a corner differently: the corner still belongs to the
        # segment before.
        ends = np.array([s.steps[-1].end for s in self.segments[:-1]])
        owner = np.searchsorted(ends + 4 * np.spacing(self.time[-1]), self.time, side="left")
        result = []
        for k in np.unique(owner):
            segment, t = self.segments[k], self.time[owner == k]
            starts = list(map(attrgetter("start"), segment.steps[1:]))
            at = np.searchsorted(starts, t, side="left")
            states, rates = [], []
            for j in np.unique(at):
                step, times = segment.steps[j], t[at == j]
                states.append(step.at(times))
                rates.append(step.rate(times))
            result.append(segment.interval.waves(t, np.hstack(states), np.hstack(rates)))
        return {"time": self.time, **join_waves(result)}

    @cached_property
    def energy(self) -> EnergyBalance:
        """Energy balance by the energies at both ends and the quadrature of powers."""
        # sums of supplied and lost energies, and of their magnitudes
        came, went = np.zeros(2), np.zeros(2)
        for segment in self.segments:
            for sums, energies in zip(
                (came, went), _sum_energies(self.system, segment), strict=True
            ):
                sums += np.sum(energies), np.abs(energies).sum()
        begin, end = self.segments[0], self.segments[-1]
        before = begin.interval.energy(begin.steps[0].start, begin.steps[0].first)
        after = end.interval.energy(end.steps[-1].end, end.steps[-1].last)
        residual = came[0] - went[0] + before - after
        return EnergyBalance(float(residual), float(came[1] + went[1] + abs(before)))


def solve_transient(
    system: System,
    stop: float,
    rtol: float = 1e-9,
    times: np.ndarray | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Trajectory:
    """Integrate from equilibrium to ``stop`` [s].

    Segments end at corners of sources and located zeros of the devices' guards.
    ``times`` of the waves default to the accepted steps. ``progress`` receives the share done.

    Raises
    ------
    SimulationError : there is no equilibrium, the equations are singular, or events never end.
    """
    z, modes = equilibrium(system)
    driven = [p.wave.corners(stop) for p in system.sources]
    corners = np.unique(np.concatenate([[0.0, stop], *driven]))
    segments: list[Segment] = []
    events: list[float] = []
    # guards at the end of the previous interval; the modes at rest contradict no guard
    left = np.full_like(Interval(system, modes, 0.0).guards(0.0, z), np.inf)
    for begin, end in pairwise(corners):
        t, within = begin, 0.5 * (begin + end)
        while t < end:
            if len(segments) > _MAX_SEGMENTS:
                raise SimulationError(
                    "a contact opens and closes infinitely often", where=f"t = {t:.9e} s"
                )
            interval = Interval(system, modes, within)
            if (jumped := _find_triggered_guard(interval, t, z, left)) is not None:
                modes, left[jumped] = _switch_mode(system, modes, jumped), np.nan
                continue
            steps, fired = _integrate_interval(
                interval, t, z, end, rtol, lambda t: progress(t / stop)
            )
            if steps:
                segments.append(Segment(interval, tuple(steps)))
                t, z = steps[-1].end, steps[-1].last
            left = interval.guards(t, z)
            if fired is None:
                t = end
            else:
                left[fired] = np.nan
                modes = _switch_mode(system, modes, fired)
                events.append(t)
    accepted = chain.from_iterable(map(attrgetter("steps"), segments))
    grid = [*map(attrgetter("start"), accepted), stop]
    time = np.unique(grid) if times is None else np.union1d(times, events)
    return Trajectory(system, time, tuple(segments), tuple(events))


def _find_triggered_guard(
    interval: Interval, t: float, z: np.ndarray, left: np.ndarray
) -> int | None:
    """Return the index of an event function that becomes negative at a jump of algebraic unknowns.

    ``left`` are the guards before the jump, nan for guards that have switched.
    """
    guards = interval.guards(t, interval.solve_algebraic(t, z))
    if guards.shape != left.shape:
        return None
    jumped = np.flatnonzero((left > 0.0) & (guards < 0.0))
    return int(jumped[0]) if jumped.size else None


def _switch_mode(system: System, modes: list[Any], fired: int) -> list[Any]:
    """Return the modes after guard number ``fired`` fell to zero."""
    item = zip(system.devices, modes, strict=True)
    counts = [len(d.law.guards(np.zeros(len(d.inputs)), mode)) for d, mode in item]
    k = int(np.searchsorted(np.cumsum(counts), fired, side="right"))
    now = system.devices[k].law.next_mode(modes[k], fired - sum(counts[:k]))
    return [*modes[:k], now, *modes[k + 1 :]]


def _integrate_interval(
    interval: Interval,
    t: float,
    z: np.ndarray,
    end: float,
    rtol: float,
    report_progress: Callable[[float], None],
) -> tuple[list[Step], int | None]:
    """Integrate to ``end``, or to the first guard that falls to zero.

    Return the steps and the number of this guard, None without a guard.
    """
    z = interval.solve_algebraic(t, z)
    before = interval.guards(t, z)
    solver = Radau(interval, t, z, rtol)
    limits = (source.wave.step_limit for source in interval.system.sources)
    limit = min(limits, default=np.inf)
    steps: list[Step] = []
    h = 0.0
    while solver.t < end * (1 - 1e-16):
        step, h_next = solver.advance(min(h or solver.choose_first_step(end), limit), end)
        after = interval.guards(step.end, step.last)
        wrong = np.flatnonzero((before < 0.0) & (after < before))
        if wrong.size:
            return steps, int(wrong[0])
        fell = np.flatnonzero((after < 0.0) & (before >= 0.0))
        step, fired = _locate_zero(interval, solver, step, fell) if fell.size else (step, None)
        inputs = interval.inputs(step.end, step.last)
        for device, e in zip(interval.system.devices, inputs, strict=True):
            device.law.require_in_range(step.end, e)
        steps.append(step)
        if fired is not None:
            return steps, fired
        solver.accept(step)
        report_progress(step.end)
        before, h = after, h_next
    return steps, None


def _locate_zero(
    interval: Interval, solver: Radau, step: Step, fell: np.ndarray
) -> tuple[Step, int]:
    """Shorten a step to the first zero of a guard, and solve it again."""

    def guard_value(t: float, k: int) -> float:
        """Return the value of a guard at ``t``."""
        return float(interval.guards(t, step.at(t)[:, 0])[k])

    t0, t1 = step.start, step.end
    low = t0 + 1e-12 * step.length

    def find_root(k: int) -> float:
        """Return the first zero of a guard."""
        if guard_value(low, k) <= 0.0:
            return low
        crosses = guard_value(t1, k) < 0.0
        return brentq(guard_value, low, t1, args=(k,), xtol=1e-18, rtol=1e-15) if crosses else t1

    def shorten_step(h: float) -> Step:
        """Solve a shorter step; interpolate if Newton's method fails."""
        stages = step.at(t0 + h * RADAU_NODES) - step.first[:, None]
        rough = Step(t0, h, step.first, stages, step.differential)
        return solver.take(h) or rough

    at, guard = min((find_root(int(k)), int(k)) for k in fell)
    h = max(at - t0, 1e-12 * step.length)  # late in a run, t0 + 1e-12 length may equal t0
    result = shorten_step(h)
    for _ in range(2):  # the polynomial has a lower order than the step
        miss = float(interval.guards(t0 + h, result.last)[guard])
        rate = (guard_value(t0 + h, guard) - guard_value(t0 + 0.999 * h, guard)) / (0.001 * h)
        if rate >= 0.0 or not 1e-17 <= abs(miss / rate) <= 0.01 * h:
            break
        h -= miss / rate
        result = shorten_step(h)
    return result, guard


def _sum_energies(system: System, segment: Segment) -> tuple[list[float], list[float]]:
    """Compute energies [J] that sources and devices bring in, and the losses."""
    interval, steps = segment.interval, segment.steps
    t = np.concatenate([*map(attrgetter("stage_times"), steps)])
    w = np.outer([*map(attrgetter("length"), steps)], RADAU_WEIGHTS).ravel()
    z, r = map(np.hstack, zip(*map(Step.nodes, steps), strict=True))
    X = interval.with_sources(t, z)
    came, went = [], []
    waves = interval.waves(t, z, r) if system.sources else {}
    for source in system.sources:
        if not source.sets_signal:
            name, what = source.name, ".rate" if source.domain.has_position else ""
            across = waves[f"{name}.out{what}"] - waves[f"{name}.ret{what}"]
            came.append(float(-waves[f"{name}.out.through"] * across @ w))
    if system.dissipated.any():
        went.append(float(np.einsum("it,ij,jt,t", X, system.dissipated, X, w, optimize=True)))
    for device, mode in zip(system.devices, interval.modes, strict=True):
        law = device.law
        if type(law).loss is not Device.loss:
            gained = np.array([law.loss(e, mode) for e in (device.inputs @ X).T])
            went.append(float(np.maximum(gained, 0.0) @ w))
            came.append(float(-np.minimum(gained, 0.0) @ w))
    return came, went
