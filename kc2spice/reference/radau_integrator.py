"""Transient solution of a `System` by an implicit Runge-Kutta method.

The method restarts at every corner and event. A corner is a jump in the slope of a source. An event
is a change of the mode of a device, which happens when a guard function of the device falls to
zero.

Each step solves ``d/dt g(t, z) = f(t, z)`` by the method Radau IIA of order five (Hairer and Wanner
1996, IV.8). This module eliminates no unknowns. In contrast, ``scipy.integrate.Radau`` accepts no
mass matrix, so that algebraic unknowns would have to be eliminated. Algebraic unknowns can be
eliminated only from equations of index 1. The equations of two inductors in series, or of an
inductor in series with a current source, have index 2. The method integrates the stored quantities
``g``, so that charge, flux and momentum are conserved.
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

from kc2spice.core.constitutive_laws import Device
from kc2spice.core.errors import SimulationError
from kc2spice.reference.equilibrium import Interval, find_equilibrium, join_waves
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
# Largest acceptable rounding error of a Newton correction, relative to the tolerance.
# A controller with a derivative term amplifies rounding errors to 100 nV.
_MAX_ROUNDING = 0.1
_MACHINE_EPSILON = float(np.finfo(float).eps)
# safety factor, because one set of random signs gives only a rough estimate of rounding errors
_ROUNDING_FACTOR = 3.0
# The matrices below convert values at the stages of a step to the coefficients of a polynomial.
# The cubic polynomial passes through the values at the start and at the stages.
# The quadratic polynomial passes through the values at the stages, but not through the start value.
_CUBIC_MATRIX = np.linalg.inv(RADAU_NODES[:, None] ** _POWERS)
_SQUARE_MATRIX = np.linalg.inv(RADAU_NODES[:, None] ** (_POWERS - 1))


@dataclass(frozen=True, eq=False)
class Step:
    """Time step, with the changes of the unknowns from the start to each stage.

    ``increments`` (n, 3) contains the change of each unknown from the start of the step to each
    stage. ``start`` and ``length`` are in seconds. ``first`` contains the unknowns at the start,
    and ``differential`` is true for each unknown that has a time derivative in the equations.
    """

    start: float
    length: float
    first: np.ndarray
    increments: np.ndarray
    differential: np.ndarray

    @property
    def end_time(self) -> float:
        """Time at the end of the step."""
        return self.start + self.length

    @property
    def end_unknowns(self) -> np.ndarray:
        """Unknowns at the end of the step."""
        return self.first + self.increments[:, 2]

    @property
    def stage_times(self) -> np.ndarray:
        """Times of the three stages of the step."""
        return self.start + self.length * RADAU_NODES

    def interpolate_states(self, t: np.ndarray | float) -> np.ndarray:
        """Interpolate the states at times ``t`` by the collocation polynomial.

        Return an array of shape (n, nt) for ``nt`` times.
        """
        x = (np.atleast_1d(t) - self.start) / self.length
        powers = x ** np.arange(4)[:, None]
        return self.first[:, None] + self._evaluate_polynomials(powers[1:], powers[:3])

    def compute_derivatives(self, t: np.ndarray | float) -> np.ndarray:
        """Compute the time derivatives of the states at each time in ``t``.

        Return an array of shape (n, nt).

        The derivatives of algebraic unknowns are less accurate than the derivatives of other
        unknowns.
        """
        x = (np.atleast_1d(t) - self.start) / self.length
        square = np.array([0.0 * x, x**0, 2 * x])
        return self._evaluate_polynomials(np.array([x**0, 2 * x, 3 * x**2]), square) / self.length

    def _evaluate_polynomials(self, cubic: np.ndarray, square: np.ndarray) -> np.ndarray:
        """Evaluate the collocation polynomials of all unknowns.

        ``cubic`` and ``square`` are powers of the time, relative to the step.
        """
        through_start = self.increments @ _CUBIC_MATRIX.T @ cubic
        alone = self.increments @ _SQUARE_MATRIX.T @ square
        return np.where(self.differential[:, None], through_start, alone)

    def evaluate_stages(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the unknowns and their rates at the stages, as two arrays (n, 3).

        The stages are also the nodes of a numerical integration over the step.
        """
        return self.first[:, None] + self.increments, self.compute_derivatives(self.stage_times)


class Radau:
    """Radau IIA integrator of the equations of one interval.

    ``find_step`` chooses the step length from the error of the step. ``take_step`` computes a step
    of prescribed length.
    """

    def __init__(self, interval: Interval, t: float, z: np.ndarray, rtol: float) -> None:
        self.rtol = rtol
        self.newton_tol = max(10 * np.finfo(float).eps / rtol, min(0.03, rtol**0.5))
        self.interval, self.rows = interval, interval.rows
        self.active = interval.system.differential  # mask of unknowns whose error is controlled
        self.before: Step | None = None
        self._start_step(t, z)
        self._linearise()

    def _start_step(self, t: float, z: np.ndarray) -> None:
        """Set the time and the unknowns at the start of the next step."""
        self.t, self.z = t, z
        self.g, f = self.interval.evaluate_equations(t, z)
        self.f = np.where(self.rows, f, 0.0)

    def _linearise(self) -> None:
        """Linearise the equations: compute Jacobians at the current time and unknowns."""
        self.M, self.J = self.interval.compute_jacobians(self.t, self.z)
        self.h_lu, self.lu = 0.0, tuple[Any, ...]()
        # rounding error of a Newton correction, relative to the tolerance
        self.rounding = 0.0

    def choose_first_step(self, end: float) -> float:
        """Choose the length of the first step from the relative rates of the unknowns."""
        rates = np.linalg.lstsq(self.M, self.f, rcond=None)[0]
        speed = _compute_rms((rates / (self.rtol * (1.0 + np.abs(self.z))))[self.active])
        if speed <= 1e-300:
            return end - self.t
        first = min(0.5 * (0.01 / speed) ** 0.25, max(1e-12, 0.01 * self.rtol**-0.75 / speed))
        return min(end - self.t, first)

    def _solve_system(self, right: np.ndarray, which: int) -> np.ndarray:
        """Solve the real or the complex linear system of a Newton iteration.

        ``which`` is 0 for the real and 1 for the complex system.
        """
        if np.iscomplexobj(self.lu[which][0]):
            return np.asarray(lapack.zgetrs(*self.lu[which][:2], right)[0])
        return np.asarray(lapack.dgetrs(*self.lu[which][:2], right)[0])

    def _compute_newton_change(self, r: np.ndarray) -> np.ndarray:
        """Compute the Newton correction (n, 3) of the stages for a residual ``r``."""
        real = np.outer(
            self._solve_system(r @ _EIGENVECTORS_INVERSE[_REAL_INDEX].real, 0),
            _vectors[:, _REAL_INDEX].real,
        )
        pair = np.outer(
            self._solve_system(r @ _EIGENVECTORS_INVERSE[_PAIR_INDEX], 1), _vectors[:, _PAIR_INDEX]
        )
        return np.asarray(real + 2.0 * pair.real)

    def _estimate_rounding(self, X: np.ndarray, h: float) -> np.ndarray:
        """Estimate the change of the stages due to the rounding error of the residual.

        The rounding error of each equation is proportional to the sum of the magnitudes of the
        equation's terms. The change is an array of shape (n, 3).
        """
        flow, stored = self.interval.sum_term_sizes(X)
        sizes = flow + (stored + np.abs(self.g)[:, None]) @ np.abs(_RADAU_INVERSE.T) / h
        signs = np.random.default_rng(0).choice((-1.0, 1.0), sizes.shape)
        return self._compute_newton_change(_MACHINE_EPSILON * sizes * signs)

    def _factorise(self, h: float) -> None:
        """Factorise both matrices of Newton's method for the step length ``h``."""
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

    def take_step(self, h: float) -> Step | None:
        """Compute a step of length ``h``; return None if Newton's method fails."""
        self._factorise(h)
        zero_increments = np.zeros((self.z.size, 3))
        if self.before is None:
            return self._solve_stages(h, zero_increments)
        # Extrapolation from a much shorter step amplifies rounding errors of the first guess.
        # With amplified rounding errors, an exponential law can overflow.
        # If the first guess fails, the unknowns at the start of the step are the second guess.
        predicted = self.before.interpolate_states(self.t + h * RADAU_NODES) - self.z[:, None]
        return self._solve_stages(h, predicted) or self._solve_stages(h, zero_increments)

    @np.errstate(over="ignore", invalid="ignore")
    def _solve_stages(self, h: float, Z: np.ndarray) -> Step | None:
        """Solve the stages of a step by Newton's method.

        ``Z`` (n, 3) is the initial guess for the changes of the unknowns. The result is None if
        Newton's method diverges or overflows.
        """
        p, t = self.interval, self.t + h * RADAU_NODES
        sources = p.system.evaluate_source_derivatives(t, p.within)
        scale = self.rtol * (1.0 + np.abs(self.z))
        # errors of algebraic unknowns do not propagate to the next step
        scale = np.where(self.active, scale, 1e3 * scale)
        last = 0.0
        for k in range(_MAX_NEWTON_STEPS):
            X = np.concatenate((self.z[:, None] + Z, sources))
            r = (
                p.compute_right_sides(X)
                - (p.compute_stored_quantities(X) - self.g[:, None]) @ _RADAU_INVERSE.T / h
            )
            change = self._compute_newton_change(r)
            size = _compute_rms(change / scale[:, None])
            rate = size / last if last > 0.0 else 0.0
            if not np.isfinite(size):
                return None
            if rate >= 1.0 and size > max(_MAX_ROUNDING, self.rounding):
                estimate = _compute_rms(self._estimate_rounding(X, h) / scale[:, None])
                # the estimated rounding error, relative to the tolerance, is limited to 1
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

    def accept_step(self, step: Step) -> None:
        """Accept a step: the next step will start at the end of this step."""
        self.before = step
        self._start_step(step.end_time, step.end_unknowns)
        if not self.interval.linear and self.iterations > 2:
            self._linearise()

    def find_step(self, h: float, end: float) -> tuple[Step, float]:
        """Compute a step with an error below the tolerance.

        Return the step and the length of the next step. The caller must pass the returned step to
        :meth:`accept_step`.
        """
        rejected = False
        while True:
            if not h > 1e-15 * max(abs(self.t), 1e-6):
                raise SimulationError("the time step became too small", where=f"t = {self.t:.9e} s")
            h = min(h, end - self.t)
            if not rejected and end - self.t - h < 1e-3 * h:
                h = end - self.t
            step = self.take_step(h)
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
        """Estimate the error of a step in units of the tolerance."""
        p, t, h = self.interval, step.stage_times, step.length
        sources = p.system.evaluate_source_derivatives(t, p.within)
        # The error is computed from the stored quantities ``g``.
        # The derivative ``M`` of ``g`` may be outdated, because ``M`` is not updated in every step.
        stage_stores = p.compute_stored_quantities(
            np.concatenate((step.first[:, None] + step.increments, sources))
        )
        stored_error = np.where(
            self.rows, (stage_stores - self.g[:, None]) @ _ERROR_COEFFICIENTS / h, 0.0
        )
        scale = self.rtol * (1.0 + np.maximum(np.abs(self.z), np.abs(step.end_unknowns)))
        error = self._solve_system(self.f + stored_error, 0)
        return _compute_rms((error / scale)[self.active])


def _compute_rms(x: np.ndarray) -> float:
    """Return the root mean square of the entries of ``x``, or 0 for an empty array."""
    return float(np.sqrt(np.mean(x * x))) if x.size else 0.0


# Largest permitted number of segments of a run.
# More segments indicate a modelling error, such as a contact that opens and closes without end.
_MAX_SEGMENTS = 20_000


@dataclass(frozen=True)
class Segment:
    """Time segment between two corners or events: equations and accepted steps."""

    interval: Interval
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class EnergyBalance:
    """Energy balance of a run.

    The ``residual`` [J] is the supplied energy that is neither stored nor lost.

    The residual is compared with the ``turnover`` [J]: the sum of the supplied energy, the lost
    energy and the energy stored at the start.
    """

    residual: float
    turnover: float


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Segments, output times [s] and event times [s] of a transient run.

    The output times are an array of shape (nt,). An event is a change of the mode of a device.
    """

    system: System
    time: np.ndarray
    segments: tuple[Segment, ...]
    events: tuple[float, ...]

    @cached_property
    def waves(self) -> dict[str, np.ndarray]:
        """Waveforms computed from the collocation polynomials, keyed by name.

        The names are ``time``, ``NAME.pin``, ``NAME.pin.through``, ``NAME.pin.rate``,
        ``NAME.state``, and the names of additional waves of devices. Each wave has the shape (nt,).
        """
        # The output times may come from ngspice, which may round the times of corners.
        # If rounding moves the output time of a corner slightly beyond the corner, the output time
        # still belongs to the segment before the corner.
        ends = np.array([s.steps[-1].end_time for s in self.segments[:-1]])
        owner = np.searchsorted(ends + 4 * np.spacing(self.time[-1]), self.time, side="left")
        result = []
        for k in np.unique(owner):
            segment, t = self.segments[k], self.time[owner == k]
            starts = list(map(attrgetter("start"), segment.steps[1:]))
            at = np.searchsorted(starts, t, side="left")
            states, rates = [], []
            for j in np.unique(at):
                step, times = segment.steps[j], t[at == j]
                states.append(step.interpolate_states(times))
                rates.append(step.compute_derivatives(times))
            result.append(
                segment.interval.compute_waveforms(t, np.hstack(states), np.hstack(rates))
            )
        return {"time": self.time, **join_waves(result)}

    @cached_property
    def energy(self) -> EnergyBalance:
        """Energy balance of the run: stored energies and integrated powers."""
        # each array contains the sum of the energies, and the sum of their magnitudes
        supplied, lost = np.zeros(2), np.zeros(2)
        for segment in self.segments:
            for sums, energies in zip(
                (supplied, lost), _sum_energies(self.system, segment), strict=True
            ):
                sums += np.sum(energies), np.abs(energies).sum()
        begin, end = self.segments[0], self.segments[-1]
        before = begin.interval.compute_energy(begin.steps[0].start, begin.steps[0].first)
        after = end.interval.compute_energy(end.steps[-1].end_time, end.steps[-1].end_unknowns)
        residual = supplied[0] - lost[0] + before - after
        return EnergyBalance(float(residual), float(supplied[1] + lost[1] + abs(before)))


def solve_transient(
    system: System,
    stop: float,
    rtol: float = 1e-9,
    times: np.ndarray | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Trajectory:
    """Integrate a system from equilibrium at t = 0 to the time ``stop`` [s].

    A segment ends at a corner of a source, or when a guard function of a device falls to zero.
    ``times`` are the output times [s], by default the ends of the accepted steps. ``progress`` is
    called with the completed share of the run, from 0 to 1.

    Raises
    ------
    SimulationError : there is no equilibrium, the equations are singular, or there are too many
    events.
    """
    z, modes = find_equilibrium(system)
    driven = [p.wave.find_corner_times(stop) for p in system.sources]
    corners = np.unique(np.concatenate([[0.0, stop], *driven]))
    segments: list[Segment] = []
    events: list[float] = []
    # Values of all guard functions at the end of the previous interval.
    # The initial values are infinite, so that no device changes mode in equilibrium.
    left = np.full_like(Interval(system, modes, 0.0).compute_guards(0.0, z), np.inf)
    for begin, end in pairwise(corners):
        t, within = begin, 0.5 * (begin + end)
        while t < end:
            if len(segments) > _MAX_SEGMENTS:
                raise SimulationError(
                    "a contact opens and closes too often",
                    where=f"t = {t:.9e} s",
                    expected=f"at most {_MAX_SEGMENTS} intervals between contact events",
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
                t, z = steps[-1].end_time, steps[-1].end_unknowns
            left = interval.compute_guards(t, z)
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
    """Find a guard function that a jump of algebraic unknowns makes negative.

    ``left`` contains the values of the guard functions before the jump. In ``left``, the value of a
    guard function that has just changed the mode of a device is nan. Return the index of the first
    guard function that becomes negative, or None if none does.
    """
    guards = interval.compute_guards(t, interval.solve_algebraic(t, z))
    if guards.shape != left.shape:
        return None
    jumped = np.flatnonzero((left > 0.0) & (guards < 0.0))
    return int(jumped[0]) if jumped.size else None


def _switch_mode(system: System, modes: list[Any], fired: int) -> list[Any]:
    """Return all devices' switching states after a guard function has fallen to zero.

    ``fired`` is the index of the guard function that fell to zero, among the guard functions of all
    devices.
    """
    devices_with_modes = zip(system.devices, modes, strict=True)
    counts = [
        len(d.law.evaluate_guards(np.zeros(len(d.inputs)), mode)) for d, mode in devices_with_modes
    ]
    k = int(np.searchsorted(np.cumsum(counts), fired, side="right"))
    next_mode = system.devices[k].law.find_next_mode(modes[k], fired - sum(counts[:k]))
    return [*modes[:k], next_mode, *modes[k + 1 :]]


def _integrate_interval(
    interval: Interval,
    t: float,
    z: np.ndarray,
    end: float,
    rtol: float,
    report_progress: Callable[[float], None],
) -> tuple[list[Step], int | None]:
    """Integrate one interval to the time ``end``, or until a guard falls to zero.

    Return the steps and the index of the guard function that falls to zero, or None without an
    event.
    """
    z = interval.solve_algebraic(t, z)
    before = interval.compute_guards(t, z)
    solver = Radau(interval, t, z, rtol)
    limits = (source.wave.step_limit for source in interval.system.sources)
    limit = min(limits, default=np.inf)
    steps: list[Step] = []
    h = 0.0
    while solver.t < end * (1 - 1e-16):
        step, h_next = solver.find_step(min(h or solver.choose_first_step(end), limit), end)
        after = interval.compute_guards(step.end_time, step.end_unknowns)
        still_falling = np.flatnonzero((before < 0.0) & (after < before))
        if still_falling.size:
            return steps, int(still_falling[0])
        fell = np.flatnonzero((after < 0.0) & (before >= 0.0))
        step, fired = _locate_zero(interval, solver, step, fell) if fell.size else (step, None)
        inputs = interval.compute_device_inputs(step.end_time, step.end_unknowns)
        for device, e in zip(interval.system.devices, inputs, strict=True):
            device.law.require_in_range(step.end_time, e)
        steps.append(step)
        if fired is not None:
            return steps, fired
        solver.accept_step(step)
        report_progress(step.end_time)
        before, h = after, h_next
    return steps, None


def _locate_zero(
    interval: Interval, solver: Radau, step: Step, fell: np.ndarray
) -> tuple[Step, int]:
    """Shorten a step so that it ends at the first zero of a guard function.

    ``fell`` contains the indices of the guard functions that become negative during the step.
    Return the shorter step, and the index of the guard function that is zero at the end of the
    shorter step.
    """

    def compute_guard(t: float, k: int) -> float:
        """Return the value of guard function ``k`` at the time ``t``."""
        return float(interval.compute_guards(t, step.interpolate_states(t)[:, 0])[k])

    t0, t1 = step.start, step.end_time
    low = t0 + 1e-12 * step.length

    def find_root(k: int) -> float:
        """Return the time of the first zero of guard function ``k``."""
        if compute_guard(low, k) <= 0.0:
            return low
        crosses = compute_guard(t1, k) < 0.0
        return brentq(compute_guard, low, t1, args=(k,), xtol=1e-18, rtol=1e-15) if crosses else t1

    def shorten_step(h: float) -> Step:
        """Solve a step of length ``h``; on failure, interpolate the longer ``step``."""
        stages = step.interpolate_states(t0 + h * RADAU_NODES) - step.first[:, None]
        rough = Step(t0, h, step.first, stages, step.differential)
        return solver.take_step(h) or rough

    zero_time, guard = min((find_root(int(k)), int(k)) for k in fell)
    h = max(zero_time - t0, 1e-12 * step.length)  # h > 0, even if zero_time rounds to t0
    result = shorten_step(h)
    for _ in range(2):  # the interpolated zero is inaccurate
        guard_at_end = float(interval.compute_guards(t0 + h, result.end_unknowns)[guard])
        rate = (compute_guard(t0 + h, guard) - compute_guard(t0 + 0.999 * h, guard)) / (0.001 * h)
        if rate >= 0.0 or not 1e-17 <= abs(guard_at_end / rate) <= 0.01 * h:
            break
        h -= guard_at_end / rate
        result = shorten_step(h)
    return result, guard


def _sum_energies(system: System, segment: Segment) -> tuple[list[float], list[float]]:
    """Return the supplied and the lost energies [J] of a segment, as two lists.

    The supplied energies come from sources and from devices with a negative loss. One lost energy
    covers all linear laws together; each nonlinear device has a separate lost energy.
    """
    interval, steps = segment.interval, segment.steps
    t = np.concatenate([*map(attrgetter("stage_times"), steps)])
    weights = np.outer([*map(attrgetter("length"), steps)], RADAU_WEIGHTS).ravel()
    z, r = map(np.hstack, zip(*map(Step.evaluate_stages, steps), strict=True))
    X = interval.append_sources(t, z)
    supplied, lost = [], []
    waves = interval.compute_waveforms(t, z, r) if system.sources else {}
    for source in system.sources:
        if not source.sets_signal:
            name, suffix = source.name, ".rate" if source.domain.has_position else ""
            across = waves[f"{name}.out{suffix}"] - waves[f"{name}.ret{suffix}"]
            supplied.append(float(-waves[f"{name}.out.through"] * across @ weights))
    if system.dissipated.any():
        lost.append(float(np.einsum("it,ij,jt,t", X, system.dissipated, X, weights, optimize=True)))
    for device, mode in zip(system.devices, interval.modes, strict=True):
        law = device.law
        if type(law).loss is not Device.loss:
            loss_powers = np.array([law.loss(e, mode) for e in (device.inputs @ X).T])
            lost.append(float(np.maximum(loss_powers, 0.0) @ weights))
            supplied.append(float(-np.minimum(loss_powers, 0.0) @ weights))
    return supplied, lost
