"""Transient of a `System`: smooth intervals between corners and located guards of devices."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize import brentq

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import Device
from kc2spice.reference.assemble import Output, System
from kc2spice.reference.equilibrium import equilibrium
from kc2spice.reference.flight import Flight, FlightStep, Modes, modes_of
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
class Balance:
    """Energies by law [J]: supplied and lost over the run, stored before and after it."""

    supplied: defaultdict[str, float]
    lost: defaultdict[str, float]
    before: defaultdict[str, float]
    after: defaultdict[str, float]

    @property
    def residual(self) -> float:
        """Energy that the balance cannot account for [J]: what came in less what is stored more or
        became heat."""
        came, went = (self.supplied, self.before), (self.lost, self.after)
        return sum(sum(e.values()) for e in came) - sum(sum(e.values()) for e in went)

    @property
    def turnover(self) -> float:
        """What the residual is judged by [J]: all that came in, was lost or was there first."""
        return sum(
            abs(e) for each in (self.supplied, self.lost, self.before) for e in each.values()
        )


@dataclass(frozen=True)
class Segment:
    """Accepted steps within one interval, and what flies meanwhile."""

    interval: Interval
    steps: tuple[Step, ...]
    flight: Flight | None = None


class Samples:
    """Everything at times ``t`` (nt,) within one interval, from states and their rates (n, nt)."""

    def __init__(self, interval: Interval, t: np.ndarray, z: np.ndarray, r: np.ndarray) -> None:
        self.interval, self.t, self.X = interval, t, interval.seen(t, z)
        self.dX = np.concatenate((r, interval.system.given(t, interval.within, 1)))

    def inputs(self, k: int) -> np.ndarray:
        """What device ``k`` sees (nt, m)."""
        return np.asarray((self.interval.system.devices[k].inputs @ self.X).T)

    def each(self, k: int) -> Iterator[tuple[float, np.ndarray]]:
        """Time and inputs of device ``k``, point by point."""
        return zip(self.t.tolist(), self.inputs(k), strict=True)

    @cached_property
    def _devices(self) -> np.ndarray:
        """Outputs of all devices (K, nt)."""
        found = [np.zeros((0, self.t.size))]
        for k, device in enumerate(self.interval.system.devices):
            rates, mode = (device.inputs @ self.dX).T, self.interval.modes[k]
            points = zip(self.t.tolist(), self.inputs(k), rates, strict=True)
            found.append(np.array([device.out(t, e, rate, mode) for t, e, rate in points]).T)
        return np.concatenate(found)

    def wave(self, output: Output) -> np.ndarray:
        """Values (nt,)."""
        found = output.now @ self.X + output.rated @ self.dX + output.constant
        return found + output.devices @ self._devices if output.devices.any() else found

    @cached_property
    def more(self) -> dict[str, np.ndarray]:
        """What devices add, ``NAME.EXTRA``."""
        found = {}
        for k, (device, mode) in enumerate(
            zip(self.interval.system.devices, self.interval.modes, strict=True)
        ):
            law = device.law
            rows = [law.waves(t, e, mode) for t, e in (self.each(k) if law.extra else ())]
            for key in law.extra:
                found[f"{law.name}.{key}"] = np.array([row[key] for row in rows])
        return found


@dataclass(frozen=True)
class Result:
    """Waves over ``time``, located events, and the energy balance."""

    system: System
    time: np.ndarray
    segments: tuple[Segment, ...]
    events: tuple[Event, ...]

    @property
    def waves(self) -> Waves:
        """Every wave by name, worked out when asked for."""
        return Waves(self)

    @property
    def energy(self) -> Balance:
        """Energy by law."""
        return _balance(self)


class Waves(Mapping[str, np.ndarray]):
    """``time``; ``NAME.pin`` across, ``NAME.pin.through``, ``NAME.pin.rate``, ``NAME.state``, and
    what a device adds. Read from the collocation polynomials at ``Result.time``."""

    def __init__(self, result: Result) -> None:
        self.result = result
        self._samples: list[Samples] = []
        # A corner that is rounded otherwise by ngspice is still the end of what was before it.
        ends = np.array([s.steps[-1].end for s in result.segments[:-1]])
        owner = np.searchsorted(ends + 4 * np.spacing(result.time[-1]), result.time, side="left")
        for k in np.unique(owner):
            segment, t = result.segments[k], result.time[owner == k]
            at = np.searchsorted([s.start for s in segment.steps[1:]], t, side="left")
            steps = [(segment.steps[j], t[at == j]) for j in np.unique(at)]
            z = np.hstack([step.at(own) for step, own in steps])
            r = np.hstack([step.rate(own) for step, own in steps])
            self._samples.append(Samples(segment.interval, t, z, r))
        system = result.system
        self._more = [f"{d.law.name}.{key}" for d in system.devices for key in d.law.extra]

    def __iter__(self) -> Iterator[str]:
        yield from ("time", *self.result.system.outputs, *self._more)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __getitem__(self, name: str) -> np.ndarray:
        if name == "time":
            return self.result.time
        if name in self._more:
            return np.concatenate([s.more[name] for s in self._samples])
        output = self.result.system.outputs[name]
        return np.concatenate([s.wave(output) for s in self._samples])

    def inputs(self, law: str) -> np.ndarray:
        """(nt, m) what a device sees."""
        k = [device.law.name for device in self.result.system.devices].index(law)
        return np.concatenate([s.inputs(k) for s in self._samples])


def transient(
    system: System, stop: float, rtol: float = 1e-9, times: np.ndarray | None = None
) -> Result:
    """Integrate from equilibrium to ``stop`` [s].

    Segments end at corners of sources, instants of devices and located zeros of their guards.
    ``times`` of the waves default to the accepted steps. Raises SimulationError.
    """
    z, modes = equilibrium(system)
    own = [d.law.corners(stop) for d in system.devices]
    driven = [p.wave.corners(stop) for p in system.sources]
    corners = np.unique(np.concatenate([[0.0, stop], *driven, *own]))
    segments: list[Segment] = []
    events: list[Event] = []
    for begin, end in pairwise(corners):
        t, within, interval = begin, 0.5 * (begin + end), None
        e = Interval(system, modes, within).inputs(begin, z)
        modes = [
            d.law.mode(begin, x, m) if begin > 0.0 and np.any(at == begin) else m
            for d, x, m, at in zip(system.devices, e, modes, own, strict=True)
        ]
        while t < end:
            if len(segments) > _MAX_SEGMENTS:
                raise SimulationError("contact chatters without end", where=f"t = {t:.9e} s")
            if interval is None:
                interval = Interval(system, modes, within)
                flying = modes_of(interval)
            steps, flight, fired = _run(interval, t, z, end, rtol, flying)
            if steps:
                segments.append(Segment(interval, tuple(steps), flight))
                t, z = steps[-1].end, steps[-1].last
            if fired is not None:
                modes, event = _switched(system, modes, fired, t)
                events += event
                interval = None
            elif t >= end * (1 - 1e-15):
                t = end
    grid = [s.start for p in segments for s in p.steps] + [stop]
    time = np.unique(grid) if times is None else np.union1d(times, [e.time for e in events])
    return Result(system, time, tuple(segments), tuple(events))


def _switched(
    system: System, modes: list[Any], fired: int, t: float
) -> tuple[list[Any], list[Event]]:
    """Modes after guard number ``fired`` fell to zero."""
    now, zero = list(modes), 0
    for k, device in enumerate(system.devices):
        count = len(device.law.guards(t, np.zeros(len(device.inputs)), modes[k]))
        if fired < zero + count:
            now[k], what = device.law.switch(modes[k], fired - zero)
            return now, [Event(t, device.law.name, what)] if what else []
        zero += count
    raise AssertionError("guard out of range")


def _run(
    interval: Interval, t: float, z: np.ndarray, end: float, rtol: float, modes: Modes | None
) -> tuple[list[Step], Flight | None, int | None]:
    """Steps to ``end``, to the first guard that falls to zero (and its number), or to where modes
    take off or land."""
    z = interval.settled(t, z)
    before = interval.guards(t, z)
    flight = None if modes is None else modes.launched(t, z)
    if flight is not None and _landed(flight, t, before, 1.5):
        flight = None
    part, own = (interval, z) if flight is None else (flight.modes.part, z[flight.modes.others])
    solver = Radau(part, t, own, rtol)

    def full(step: Step) -> Step:
        return step if flight is None else FlightStep.of(step, flight)

    steps: list[Step] = []
    pace = min((getattr(p.wave, "pace", np.inf) for p in interval.system.sources), default=np.inf)
    h, fired = solver.guess(end), None
    while solver.t < end:
        inner, h_next = solver.advance(min(h, pace), end)
        step = full(inner)
        late = None if flight is None else _landing(interval, flight, step)
        if late is not None:
            if late - step.start <= 1e-15 * max(step.start, 1e-6):
                late = step.start + min(1e-3 * step.length, 1e-12)
            step = full(_short(solver, inner, late - step.start))
            end = late
        now = step.end if late is None else late
        after = interval.guards(now, step.last)
        wrong = (before < 0.0) & (after < before)
        if wrong.any():
            fired = int(np.flatnonzero(wrong)[0])
            break
        fell = np.flatnonzero((after < 0.0) & (before >= 0.0))
        if fell.size:
            step, fired = _located(interval, solver, step, fell, full)
        for device, e in zip(
            interval.system.devices, interval.inputs(step.end, step.last), strict=True
        ):
            device.law.check(step.end, e)
        steps.append(step)
        if fired is not None or now >= end * (1 - 1e-16):
            break
        solver.accept(inner)
        before, h = after, h_next
        waiting = modes if flight is None else None
        if waiting and not _landed(waiting.launched(now, step.last), now, after, 1.6):
            break
    return steps, flight, fired


def _landed(flight: Flight, t: float, guards: np.ndarray, margin: float) -> bool:
    """Whether a watched guard may fall to zero through the flight's own motion."""
    watched = flight.modes.watched
    return bool(np.any((guards - margin * flight.swing(t) <= 1e-9)[watched]))


def _landing(interval: Interval, flight: Flight, step: Step) -> float | None:
    """First time within ``step`` from which a watched guard may fall to zero by the flight."""
    times = step.start + step.length * np.linspace(0.0, 1.0, 9)[1:]

    def value(t: float) -> float:
        guards = interval.guards(t, step.at(t)[:, 0])
        return float((guards - flight.swing(t))[flight.modes.watched].min(initial=np.inf))

    low = step.start
    for t in times:
        if value(t) <= 0.0:
            return brentq(value, low, t, xtol=1e-12) if value(low) > 0.0 else low
        low = t
    return None


def _located(
    interval: Interval, solver: Radau, step: Step, fell: np.ndarray, full: Callable[[Step], Step]
) -> tuple[Step, int]:
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

    at, guard = min((root(int(k)), int(k)) for k in fell)
    inner = step.inner if isinstance(step, FlightStep) else step
    h = max(at - t0, 1e-12 * step.length)  # late in a run, t0 + 1e-12 length may be t0
    found = full(_short(solver, inner, h))
    for _ in range(2):  # the polynomial is of lower order than the step
        miss = float(interval.guards(t0 + h, found.last)[guard])
        rate = (value(t0 + h, guard) - value(t0 + 0.999 * h, guard)) / (0.001 * h)
        if rate >= 0.0 or not 1e-17 <= abs(miss / rate) <= 0.01 * h:
            break
        h -= miss / rate
        found = full(_short(solver, inner, h))
    return found, guard


def _short(solver: Radau, step: Step, h: float) -> Step:
    """The step of length ``h`` from the same start; on the polynomial where Newton fails."""
    found = solver.take(h)
    if found is not None:
        return found
    stages = step.at(step.start + h * NODES) - step.first[:, None]
    return Step(step.start, h, step.first, stages, step.differential)


def _balance(result: Result) -> Balance:
    """Energies at both ends, and powers by the quadrature of the method itself."""
    system, found = result.system, Balance(*(defaultdict(float) for _ in range(4)))
    losing = [k for k, d in enumerate(system.devices) if type(d.law).loss is not Device.loss]
    for segment in result.segments:
        interval, steps = segment.interval, segment.steps
        t = np.concatenate([s.start + s.length * NODES for s in steps])
        w = np.concatenate([s.length * WEIGHTS for s in steps])
        nodes = [s.nodes() for s in steps]
        z, r = (np.hstack(rows) for rows in zip(*nodes, strict=True))
        samples = Samples(interval, t, z, r)
        for source in system.sources:
            found.supplied[source.name] += float(_power(samples, source.name, source.kind) @ w)
        for term in system.terms:
            if term.kind in ("loss", "drag"):
                given = system.given(steps[0].start, interval.within)
                flight = segment.flight
                value = None if flight is None else flight.loss(steps[-1].end, term, given)
                if value is None:
                    y = term.rows @ (samples.X if term.kind == "loss" else samples.dX)
                    value = float(term.of(y) @ w)
                found.lost[term.law] += value
        for k in losing:
            law, mode = system.devices[k].law, interval.modes[k]
            gained = np.array([law.loss(at, e, mode) for at, e in samples.each(k)])
            first = interval.inputs(steps[0].start, steps[0].first)[k]
            last = interval.inputs(steps[-1].end, steps[-1].last)[k]
            kept = law.stores(first, last, mode)
            if kept is not None:
                found.lost[law.name] += float(gained @ w) - kept
            else:
                found.lost[law.name] += float(np.maximum(gained, 0.0) @ w)
                found.supplied[law.name] -= float(np.minimum(gained, 0.0) @ w)
    begin, end = result.segments[0], result.segments[-1]
    _energies(begin.interval, begin.steps[0].start, begin.steps[0].first, found.before)
    _energies(end.interval, end.steps[-1].end, end.steps[-1].last, found.after)
    return found


def _power(samples: Samples, name: str, kind: str) -> np.ndarray:
    """Power (nt,) out of a source: through times voltage, or times velocity; none of signals."""
    if kind in ("signal", "acceleration"):
        return np.zeros(samples.t.size)
    what = ".rate" if kind in ("force", "displacement") else ""
    outputs = samples.interval.system.outputs
    high, low = (samples.wave(outputs[f"{name}.{pin}{what}"]) for pin in ("out", "ret"))
    return -samples.wave(outputs[f"{name}.out.through"]) * (high - low)


def _energies(interval: Interval, t: float, z: np.ndarray, found: dict[str, float]) -> None:
    system, X = interval.system, interval.seen(t, z)
    for term in system.terms:
        if term.kind in ("energy", "weight"):
            found[term.law] += float(term.of((term.rows @ X)[:, None])[0])
    for device, e, mode in zip(system.devices, interval.inputs(t, z), interval.modes, strict=True):
        found[device.law.name] += device.law.energy(e, mode)
