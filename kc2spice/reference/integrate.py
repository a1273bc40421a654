"""Transient of a `System`: smooth intervals between corners and located guards of devices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize import brentq

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import Device
from kc2spice.reference.assemble import System
from kc2spice.reference.equilibrium import equilibrium
from kc2spice.reference.interval import Interval
from kc2spice.reference.radau import NODES, WEIGHTS, Radau, Step

_MAX_SEGMENTS = 20_000  # a chattering contact beyond this is a modelling error, not a waveform


@dataclass(frozen=True)
class Event:
    """A located instant at which a device changed its mode."""

    time: float
    law: str
    what: str


@dataclass(frozen=True)
class Segment:
    """Accepted steps within one interval."""

    interval: Interval
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class Balance:
    """Energy [J] that a run cannot account for, what came in less what is stored more or became
    heat, and the ``turnover`` that it is judged by: all that came in, was lost or was there."""

    residual: float
    turnover: float


@dataclass(frozen=True)
class Result:
    """Segments and located events of a run, to be read at ``time`` (nt,)."""

    system: System
    time: np.ndarray
    segments: tuple[Segment, ...]
    events: tuple[Event, ...]

    @cached_property
    def waves(self) -> dict[str, np.ndarray]:
        """``time``; ``NAME.pin`` across, ``NAME.pin.through``, ``NAME.pin.rate``, ``NAME.state``,
        and what a device adds; read from the collocation polynomials."""
        # A corner that is rounded otherwise by ngspice is still the end of what was before it.
        ends = np.array([s.steps[-1].end for s in self.segments[:-1]])
        owner = np.searchsorted(ends + 4 * np.spacing(self.time[-1]), self.time, side="left")
        found = []
        for k in np.unique(owner):
            segment, t = self.segments[k], self.time[owner == k]
            at = np.searchsorted([s.start for s in segment.steps[1:]], t, side="left")
            steps = [(segment.steps[j], t[at == j]) for j in np.unique(at)]
            z = np.hstack([step.at(own) for step, own in steps])
            r = np.hstack([step.rate(own) for step, own in steps])
            found.append(segment.interval.waves(t, z, r))
        joined = {name: np.concatenate([waves[name] for waves in found]) for name in found[0]}
        return {"time": self.time, **joined}

    @cached_property
    def energy(self) -> Balance:
        """Energies at both ends, and powers by the quadrature of the method itself."""
        came, went = np.zeros(2), np.zeros(2)  # sums, and those of sizes
        for segment in self.segments:
            for sums, energies in zip((came, went), _exchanged(self.system, segment), strict=True):
                sums += np.sum(energies), np.abs(energies).sum()
        begin, end = self.segments[0], self.segments[-1]
        before = begin.interval.energy(begin.steps[0].start, begin.steps[0].first)
        after = end.interval.energy(end.steps[-1].end, end.steps[-1].last)
        residual = came[0] - went[0] + before - after
        return Balance(float(residual), float(came[1] + went[1] + abs(before)))


def transient(
    system: System,
    stop: float,
    rtol: float = 1e-9,
    times: np.ndarray | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Result:
    """Integrate from equilibrium to ``stop`` [s].

    Segments end at corners of sources, instants of devices and located zeros of their guards.
    ``times`` of the waves default to the accepted steps. ``progress`` is told the share done.
    Raises SimulationError.
    """
    z, modes = equilibrium(system)
    own = [d.law.corners(stop) for d in system.devices]
    driven = [p.wave.corners(stop) for p in system.sources]
    corners = np.unique(np.concatenate([[0.0, stop], *driven, *own]))
    segments: list[Segment] = []
    events: list[Event] = []
    for begin, end in pairwise(corners):
        t, within = begin, 0.5 * (begin + end)
        e = Interval(system, modes, within).inputs(begin, z)
        modes = [
            d.law.mode(begin, x, m) if begin > 0.0 and np.any(at == begin) else m
            for d, x, m, at in zip(system.devices, e, modes, own, strict=True)
        ]
        while t < end:
            if len(segments) > _MAX_SEGMENTS:
                raise SimulationError("contact chatters without end", where=f"t = {t:.9e} s")
            interval = Interval(system, modes, within)
            steps, fired = _run(interval, t, z, end, rtol, lambda t: progress(t / stop))
            if steps:
                segments.append(Segment(interval, tuple(steps)))
                t, z = steps[-1].end, steps[-1].last
            if fired is None:
                t = end
            else:
                modes, event = _switched(system, modes, fired, t)
                events += event
    grid = [s.start for p in segments for s in p.steps] + [stop]
    time = np.unique(grid) if times is None else np.union1d(times, [e.time for e in events])
    return Result(system, time, tuple(segments), tuple(events))


def _switched(
    system: System, modes: list[Any], fired: int, t: float
) -> tuple[list[Any], list[Event]]:
    """Modes after guard number ``fired`` fell to zero."""
    each = zip(system.devices, modes, strict=True)
    counts = [len(d.law.guards(t, np.zeros(len(d.inputs)), mode)) for d, mode in each]
    k = int(np.searchsorted(np.cumsum(counts), fired, side="right"))
    law, now = system.devices[k].law, list(modes)
    now[k], what = law.switch(modes[k], fired - sum(counts[:k]))
    return now, [Event(t, law.name, what)] if what else []


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
        step, fired = _located(interval, solver, step, fell) if fell.size else (step, None)
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


def _located(interval: Interval, solver: Radau, step: Step, fell: np.ndarray) -> tuple[Step, int]:
    """The step shortened to the first zero of a guard, solved anew there."""

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
    found = shortened(h)
    for _ in range(2):  # the polynomial is of lower order than the step
        miss = float(interval.guards(t0 + h, found.last)[guard])
        rate = (value(t0 + h, guard) - value(t0 + 0.999 * h, guard)) / (0.001 * h)
        if rate >= 0.0 or not 1e-17 <= abs(miss / rate) <= 0.01 * h:
            break
        h -= miss / rate
        found = shortened(h)
    return found, guard


def _exchanged(system: System, segment: Segment) -> tuple[list[float], list[float]]:
    """Energies [J] that sources and devices bring in, and those that become heat."""
    interval, steps = segment.interval, segment.steps
    t = np.concatenate([s.start + s.length * NODES for s in steps])
    w = np.concatenate([s.length * WEIGHTS for s in steps])
    z, r = (np.hstack(rows) for rows in zip(*(s.nodes() for s in steps), strict=True))
    X = interval.seen(t, z)
    came, went = [], []
    waves = interval.waves(t, z, r) if system.sources else {}
    for source in system.sources:
        if source.kind not in ("signal", "acceleration"):
            what = ".rate" if source.kind in ("force", "displacement") else ""
            high, low = (waves[f"{source.name}.{pin}{what}"] for pin in ("out", "ret"))
            came.append(float(-waves[f"{source.name}.out.through"] * (high - low) @ w))
    if system.lost.any():
        went.append(float(np.einsum("it,ij,jt,t", X, system.lost, X, w, optimize=True)))
    for device, mode in zip(system.devices, interval.modes, strict=True):
        law = device.law
        if type(law).loss is not Device.loss:
            seen = zip(t.tolist(), (device.inputs @ X).T, strict=True)
            gained = np.array([law.loss(at, e, mode) for at, e in seen])
            went.append(float(np.maximum(gained, 0.0) @ w))
            came.append(float(-np.minimum(gained, 0.0) @ w))
    return came, went
