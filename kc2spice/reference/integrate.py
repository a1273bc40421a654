"""Transient of a `System`: smooth intervals between corners and located guards of devices.

Steps are those of Radau IIA of order five for ``d/dt g(t, z) = f(t, z)`` (Hairer and Wanner 1996,
IV.8). ``scipy.integrate.Radau`` takes no mass matrix, and algebraic unknowns can be eliminated only
where the index is 1: for two inductors in series, or one behind a current source, which are of
index 2, what elimination has to solve is singular. This method follows both as they are. Carrying
``g`` from step to step keeps charge, flux and momentum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import brentq

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import Device
from kc2spice.reference.equilibrium import Interval, equilibrium
from kc2spice.reference.system import System

_S6 = np.sqrt(6.0)
NODES = np.array([(4 - _S6) / 10, (4 + _S6) / 10, 1.0])
_POWERS = np.arange(1, 4)
_A = (NODES[:, None] ** _POWERS / _POWERS) @ np.linalg.inv(NODES[:, None] ** (_POWERS - 1))
WEIGHTS = _A[2]
_INVERSE = np.linalg.inv(_A)
_values, _vectors = np.linalg.eig(_INVERSE)
_BACK = np.linalg.inv(_vectors)
_REAL, _PAIR = int(np.argmin(np.abs(_values.imag))), int(np.argmax(_values.imag))
_ERROR = np.array([-13 - 7 * _S6, -13 + 7 * _S6, -1.0]) / 3.0
_MAX_NEWTON = 8
_ROUNDING = 0.1  # over the tolerance; a controller's derivative amplifies rounding to 100 nV
# Polynomials through the start and the stages, and through the stages alone.
_CUBIC = np.linalg.inv(NODES[:, None] ** _POWERS)
_SQUARE = np.linalg.inv(NODES[:, None] ** (_POWERS - 1))


@dataclass(frozen=True, eq=False)
class Step:
    """An accepted step: start, length, state at the start, increments (n, 3) at the stages."""

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

    def at(self, t: np.ndarray | float) -> np.ndarray:
        """States (n, nt) on the collocation polynomial."""
        x = (np.atleast_1d(t) - self.start) / self.length
        powers = x ** np.arange(4)[:, None]
        return self.first[:, None] + self._polynomials(powers[1:], powers[:3])

    def rate(self, t: np.ndarray | float) -> np.ndarray:
        """Time derivatives (n, nt); those of algebraic unknowns are of low order."""
        x = (np.atleast_1d(t) - self.start) / self.length
        square = np.array([0.0 * x, x**0, 2 * x])
        return self._polynomials(np.array([x**0, 2 * x, 3 * x**2]), square) / self.length

    def _polynomials(self, cubic: np.ndarray, square: np.ndarray) -> np.ndarray:
        through_start = self.increments @ _CUBIC.T @ cubic
        alone = self.increments @ _SQUARE.T @ square
        return np.where(self.differential[:, None], through_start, alone)

    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """States and rates (n, 3) at the stages, for quadrature over the step."""
        return self.first[:, None] + self.increments, self.rate(self.start + self.length * NODES)


class Radau:
    """Steps within one interval; ``advance`` makes one of an error, ``take`` one of a length."""

    def __init__(self, interval: Interval, t: float, z: np.ndarray, rtol: float) -> None:
        self.rtol = rtol
        self.newton_tol = max(10 * np.finfo(float).eps / rtol, min(0.03, rtol**0.5))
        self.interval, self.rows = interval, interval.rows
        self.active = interval.system.differential  # unknowns whose error is judged
        self.before: Step | None = None
        self._start(t, z)
        self._linearise()

    def _start(self, t: float, z: np.ndarray) -> None:
        self.t, self.z = t, z
        self.g, f = self.interval.at(t, z)
        self.f = np.where(self.rows, f, 0.0)

    def _linearise(self) -> None:
        self.M, self.J = self.interval.slopes(self.t, self.z)
        self.h_lu, self.lu = 0.0, tuple[Any, ...]()

    def guess(self, end: float) -> float:
        """First step: a hundredth of the time in which the state doubles."""
        rates = np.linalg.lstsq(self.M, self.f, rcond=None)[0]
        speed = _norm((rates / (self.rtol * (1.0 + np.abs(self.z))))[self.active])
        if speed <= 1e-300:
            return end - self.t
        first = min(0.5 * (0.01 / speed) ** 0.25, max(1e-12, 0.01 * self.rtol**-0.75 / speed))
        return min(end - self.t, first)

    def _solve(self, right: np.ndarray, which: int) -> np.ndarray:
        if np.iscomplexobj(self.lu[which][0]):
            return np.asarray(lapack.zgetrs(*self.lu[which][:2], right)[0])
        return np.asarray(lapack.dgetrs(*self.lu[which][:2], right)[0])

    def _factor(self, h: float) -> None:
        if h == self.h_lu:
            return
        self.lu = (
            lapack.dgetrf(_values[_REAL].real / h * self.M - self.J),
            lapack.zgetrf(_values[_PAIR] / h * self.M - self.J),
        )
        self.h_lu = h
        if any(info for _, _, info in self.lu):
            raise SimulationError(
                "the equations are singular",
                where=f"t = {self.t:.6e} s",
                hint="look for a net without a path to ground, or an inductor in series with a "
                "current source",
            )

    def take(self, h: float) -> Step | None:
        """Solve one step of length ``h``; None if Newton's method does not converge."""
        self._factor(h)
        p, t = self.interval, self.t + h * NODES
        sources = p.system.source_values(t, p.within)
        Z = np.zeros((self.z.size, 3))
        if self.before is not None:
            Z = self.before.at(t) - self.z[:, None]
        scale = self.rtol * (1.0 + np.abs(self.z))
        scale = np.where(self.active, scale, 1e3 * scale)  # inactive states do not propagate errors
        last = 0.0
        for k in range(_MAX_NEWTON):
            X = np.concatenate((self.z[:, None] + Z, sources))
            r = p.flow(X) - (p.stored(X) - self.g[:, None]) @ _INVERSE.T / h
            real = np.outer(self._solve(r @ _BACK[_REAL].real, 0), _vectors[:, _REAL].real)
            pair = np.outer(self._solve(r @ _BACK[_PAIR], 1), _vectors[:, _PAIR])
            change = real + 2.0 * pair.real
            size = _norm(change / scale[:, None])
            rate = size / last if last > 0.0 else 0.0
            if not np.isfinite(size) or (rate >= 1.0 and size > _ROUNDING):
                return None
            Z += change
            done = size == 0.0 or (p.linear and k == 0)
            if last > 0.0:
                done |= rate >= 1.0 or rate / (1 - min(rate, 0.9)) * size < self.newton_tol
            if done:
                self.iterations = k + 1
                return Step(self.t, h, self.z, Z, self.active)
            last = size
        return None

    def accept(self, step: Step) -> None:
        """Go on from the end of ``step``."""
        self.before = step
        self._start(step.end, step.last)
        if not self.interval.linear and self.iterations > 2:
            self._linearise()

    def advance(self, h: float, end: float) -> tuple[Step, float]:
        """One step whose error is within tolerance, not yet accepted, and the next length."""
        rejected = False
        while True:
            if not h > 1e-15 * max(abs(self.t), 1e-6):
                raise SimulationError("the step became too small", where=f"t = {self.t:.9e} s")
            h = min(h, end - self.t)
            if not rejected and end - self.t - h < 1e-3 * h:
                h = end - self.t
            step = self.take(h)
            if step is None:
                h, rejected = 0.5 * h, True
                continue
            size = self._error(step)
            safety = 0.9 * (2 * _MAX_NEWTON + 1) / (2 * _MAX_NEWTON + self.iterations)
            factor = min(10.0, safety * max(size, 1e-4) ** -0.25)
            if size <= 1.0:
                return step, h if 1.0 <= factor < 1.2 else h * factor
            h, rejected = h * max(0.2, factor), True

    def _error(self, step: Step) -> float:
        """Estimated error in units of the tolerance."""
        p, t, h = self.interval, self.t + step.length * NODES, step.length
        sources = p.system.source_values(t, p.within)
        # of the stored value; ``M`` times the unknowns belongs to an earlier state
        late = p.stored(np.concatenate((step.first[:, None] + step.increments, sources)))
        moved = np.where(self.rows, (late - self.g[:, None]) @ _ERROR / h, 0.0)
        scale = self.rtol * (1.0 + np.maximum(np.abs(self.z), np.abs(step.last)))
        error = self._solve(self.f + moved, 0)
        return _norm((error / scale)[self.active])


def _norm(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x * x))) if x.size else 0.0


_MAX_SEGMENTS = 20_000  # a chattering contact beyond this is a modelling error, not a waveform


@dataclass(frozen=True)
class Segment:
    """Accepted steps within one interval."""

    interval: Interval
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class EnergyBalance:
    """Energy [J] that a run cannot account for, what came in less what is stored more or became
    heat, and the ``turnover`` that it is judged by: all that came in, was lost or was there."""

    residual: float
    turnover: float


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Segments of a run, to be read at ``time`` (nt,), and the ``events`` [s] at which a device
    changed its mode."""

    system: System
    time: np.ndarray
    segments: tuple[Segment, ...]
    events: tuple[float, ...]

    @cached_property
    def waves(self) -> dict[str, np.ndarray]:
        """``time``; ``NAME.pin`` across, ``NAME.pin.through``, ``NAME.pin.rate``, ``NAME.state``,
        and what a device adds; read from the collocation polynomials."""
        # A corner that is rounded otherwise by ngspice is still the end of what was before it.
        ends = np.array([s.steps[-1].end for s in self.segments[:-1]])
        owner = np.searchsorted(ends + 4 * np.spacing(self.time[-1]), self.time, side="left")
        result = []
        for k in np.unique(owner):
            segment, t = self.segments[k], self.time[owner == k]
            at = np.searchsorted([s.start for s in segment.steps[1:]], t, side="left")
            steps = [(segment.steps[j], t[at == j]) for j in np.unique(at)]
            z = np.hstack([step.at(times) for step, times in steps])
            r = np.hstack([step.rate(times) for step, times in steps])
            result.append(segment.interval.waves(t, z, r))
        joined = {name: np.concatenate([waves[name] for waves in result]) for name in result[0]}
        return {"time": self.time, **joined}

    @cached_property
    def energy(self) -> EnergyBalance:
        """Energies at both ends, and powers by the quadrature of the method itself."""
        came, went = np.zeros(2), np.zeros(2)  # sums, and those of sizes
        for segment in self.segments:
            for sums, energies in zip((came, went), _exchanges(self.system, segment), strict=True):
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
    Raises SimulationError.
    """
    z, modes = equilibrium(system)
    driven = [p.wave.corners(stop) for p in system.sources]
    corners = np.unique(np.concatenate([[0.0, stop], *driven]))
    segments: list[Segment] = []
    events: list[float] = []
    for begin, end in pairwise(corners):
        t, within = begin, 0.5 * (begin + end)
        while t < end:
            if len(segments) > _MAX_SEGMENTS:
                raise SimulationError(
                    "contact opens and closes without end", where=f"t = {t:.9e} s"
                )
            interval = Interval(system, modes, within)
            steps, fired = _run(interval, t, z, end, rtol, lambda t: progress(t / stop))
            if steps:
                segments.append(Segment(interval, tuple(steps)))
                t, z = steps[-1].end, steps[-1].last
            if fired is None:
                t = end
            else:
                modes = _switch_mode(system, modes, fired)
                events.append(t)
    grid = [s.start for p in segments for s in p.steps] + [stop]
    time = np.unique(grid) if times is None else np.union1d(times, events)
    return Trajectory(system, time, tuple(segments), tuple(events))


def _switch_mode(system: System, modes: list[Any], fired: int) -> list[Any]:
    """Modes after guard number ``fired`` fell to zero."""
    item = zip(system.devices, modes, strict=True)
    counts = [len(d.law.guards(np.zeros(len(d.inputs)), mode)) for d, mode in item]
    k = int(np.searchsorted(np.cumsum(counts), fired, side="right"))
    now = system.devices[k].law.switch(modes[k], fired - sum(counts[:k]))
    return [*modes[:k], now, *modes[k + 1 :]]


def _run(
    interval: Interval,
    t: float,
    z: np.ndarray,
    end: float,
    rtol: float,
    reached: Callable[[float], None],
) -> tuple[list[Step], int | None]:
    """Steps to ``end``, or to the first guard that falls to zero, and its number."""
    z = interval.settled(t, z)
    before = interval.guards(t, z)
    solver = Radau(interval, t, z, rtol)
    pace = min((p.wave.pace for p in interval.system.sources), default=np.inf)
    steps: list[Step] = []
    h = 0.0
    while solver.t < end * (1 - 1e-16):
        step, h_next = solver.advance(min(h or solver.guess(end), pace), end)
        after = interval.guards(step.end, step.last)
        wrong = np.flatnonzero((before < 0.0) & (after < before))
        if wrong.size:
            return steps, int(wrong[0])
        fell = np.flatnonzero((after < 0.0) & (before >= 0.0))
        step, fired = _locate_zero(interval, solver, step, fell) if fell.size else (step, None)
        inputs = interval.inputs(step.end, step.last)
        for device, e in zip(interval.system.devices, inputs, strict=True):
            device.law.check(step.end, e)
        steps.append(step)
        if fired is not None:
            return steps, fired
        solver.accept(step)
        reached(step.end)
        before, h = after, h_next
    return steps, None


def _locate_zero(
    interval: Interval, solver: Radau, step: Step, fell: np.ndarray
) -> tuple[Step, int]:
    """The step shortened to the first zero of a guard, solved again there."""

    def value(t: float, k: int) -> float:
        return float(interval.guards(t, step.at(t)[:, 0])[k])

    t0, t1 = step.start, step.end
    low = t0 + 1e-12 * step.length

    def root(k: int) -> float:
        if value(low, k) <= 0.0:
            return low
        crosses = value(t1, k) < 0.0
        return brentq(value, low, t1, args=(k,), xtol=1e-18, rtol=1e-15) if crosses else t1

    def shortened(h: float) -> Step:
        """On the polynomial where Newton's method fails."""
        stages = step.at(t0 + h * NODES) - step.first[:, None]
        rough = Step(t0, h, step.first, stages, step.differential)
        return solver.take(h) or rough

    at, guard = min((root(int(k)), int(k)) for k in fell)
    h = max(at - t0, 1e-12 * step.length)  # late in a run, t0 + 1e-12 length may be t0
    result = shortened(h)
    for _ in range(2):  # the polynomial is of lower order than the step
        miss = float(interval.guards(t0 + h, result.last)[guard])
        rate = (value(t0 + h, guard) - value(t0 + 0.999 * h, guard)) / (0.001 * h)
        if rate >= 0.0 or not 1e-17 <= abs(miss / rate) <= 0.01 * h:
            break
        h -= miss / rate
        result = shortened(h)
    return result, guard


def _exchanges(system: System, segment: Segment) -> tuple[list[float], list[float]]:
    """Energies [J] that sources and devices bring in, and those that become heat."""
    interval, steps = segment.interval, segment.steps
    t = np.concatenate([s.start + s.length * NODES for s in steps])
    w = np.concatenate([s.length * WEIGHTS for s in steps])
    z, r = map(np.hstack, zip(*(s.nodes() for s in steps), strict=True))
    X = interval.with_sources(t, z)
    came, went = [], []
    waves = interval.waves(t, z, r) if system.sources else {}
    for source in system.sources:
        if not source.signal:
            what = ".rate" if source.domain.position else ""
            high, low = (waves[f"{source.name}.{pin}{what}"] for pin in ("out", "ret"))
            came.append(float(-waves[f"{source.name}.out.through"] * (high - low) @ w))
    if system.dissipated.any():
        went.append(float(np.einsum("it,ij,jt,t", X, system.dissipated, X, w, optimize=True)))
    for device, mode in zip(system.devices, interval.modes, strict=True):
        law = device.law
        if type(law).loss is not Device.loss:
            gained = np.array([law.loss(e, mode) for e in (device.inputs @ X).T])
            went.append(float(np.maximum(gained, 0.0) @ w))
            came.append(float(-np.minimum(gained, 0.0) @ w))
    return came, went
