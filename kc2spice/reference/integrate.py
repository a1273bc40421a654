"""Transient of a `System`: smooth pieces between corners and located guards of devices."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize import brentq

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import Device
from kc2spice.reference.assemble import Rows, System
from kc2spice.reference.modal import Flight, FlightStep, Modes, flown_loss, modes_of
from kc2spice.reference.piece import Piece
from kc2spice.reference.radau import NODES, WEIGHTS, Radau, Step

_MAX_PIECES = 20_000  # a chattering contact beyond this is a modelling error, not a waveform


@dataclass(frozen=True)
class Event:
    """A located instant at which a device changed its mode."""

    time: float
    law: str
    what: str


@dataclass(frozen=True)
class Share:
    """Energy of one law over the run [J]."""

    supplied: float = 0.0
    dissipated: float = 0.0
    before: float = 0.0
    after: float = 0.0


@dataclass(frozen=True)
class Balance:
    """Energy by law; ``residual`` is what came in less what is stored more or became heat [J]."""

    shares: Mapping[str, Share]

    @property
    def residual(self) -> float:
        """Energy that the balance cannot account for [J]."""
        return sum(s.supplied - s.dissipated - (s.after - s.before) for s in self.shares.values())

    @property
    def turnover(self) -> float:
        """What the residual is judged by [J]: all that came in, was lost or was there first."""
        parts = self.shares.values()
        return sum(abs(s.supplied) + abs(s.dissipated) + abs(s.before) for s in parts)


@dataclass(frozen=True)
class Stretch:
    """Accepted steps of one piece."""

    piece: Piece
    steps: tuple[Step, ...]
    flight: Flight | None = None

    @property
    def end(self) -> float:
        """Time at which it ends."""
        return self.steps[-1].start + self.steps[-1].length


@dataclass(frozen=True)
class Result:
    """Waves over ``time``, located events, and the energy balance."""

    system: System
    time: np.ndarray
    stretches: tuple[Stretch, ...]
    events: tuple[Event, ...]

    @property
    def steps(self) -> int:
        """Accepted steps."""
        return sum(len(s.steps) for s in self.stretches)

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
        self._states: list[tuple[Piece, np.ndarray, np.ndarray, np.ndarray]] = []
        # A corner that is rounded otherwise by ngspice is still the end of what was before it.
        ends = np.array([s.end for s in result.stretches[:-1]]) + 4 * np.spacing(result.time[-1])
        owner = np.searchsorted(ends, result.time, side="left")
        for k in np.unique(owner):
            part = result.stretches[k]
            t = result.time[owner == k]
            starts = np.array([s.start for s in part.steps[1:]])
            at = np.searchsorted(starts, t, side="left")
            chosen = np.unique(at)
            z = np.hstack([part.steps[j].at(t[at == j]) for j in chosen])
            r = np.hstack([part.steps[j].rate(t[at == j]) for j in chosen])
            self._states.append((part.piece, t, z, r))
        self._extra = _device_waves(result.system)

    def __iter__(self) -> Iterator[str]:
        yield "time"
        yield from self.result.system.across
        yield from (f"{n}.rate" for n in self.result.system.rates)
        yield from (f"{n}.through" for n in self.result.system.through)
        yield from (f"{s.law}.out.through" for s in self.result.system.supplies)
        yield from self._extra

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __getitem__(self, name: str) -> np.ndarray:
        if name == "time":
            return self.result.time
        system = self.result.system
        if name in system.across:
            return self._read(system.across[name])
        stem, _, last = name.rpartition(".")
        if last == "rate" and stem in system.rates:
            return self._read(system.rates[stem])
        if last == "through" and stem in system.through:
            return self._through(*system.through[stem])
        if name in self._extra:
            read = self._extra[name]
            return np.array([v for piece, t, z, r in self._states for v in read(piece, t, z, r)])
        for k, supply in enumerate(system.supplies):
            if name == f"{supply.law}.out.through":
                parts = [_supplied(p, t, z, r)[1][k] for p, t, z, r in self._states]
                return -np.concatenate(parts)
        raise KeyError(name)

    def inputs(self, law: str) -> np.ndarray:
        """(nt, m) what a device sees."""
        names = [device.law.name for device in self.result.system.devices]
        k = names.index(law)
        return np.concatenate([_columns(piece, k, t, z) for piece, t, z, _ in self._states])

    def _read(self, rows: Rows) -> np.ndarray:
        parts = []
        for piece, t, z, _ in self._states:
            s, d = self.result.system.inputs(t, piece.within)
            parts.append(rows.at(z, s, d)[0])
        return np.concatenate(parts)

    def _through(self, direct: Rows, rated: Rows) -> np.ndarray:
        parts = []
        for piece, t, z, r in self._states:
            s, d = self.result.system.inputs(t, piece.within)
            change = rated.z @ r + rated.s @ d
            parts.append((direct.at(z, s, d) + change)[0])
        return np.concatenate(parts)


_Read = Callable[[Piece, np.ndarray, np.ndarray, np.ndarray], list[float]]


def _device_waves(system: System) -> dict[str, _Read]:
    found: dict[str, _Read] = {}
    for k, device in enumerate(system.devices):
        law = device.law

        def outputs(i: int, k: int = k) -> _Read:
            def read(piece: Piece, t: np.ndarray, z: np.ndarray, r: np.ndarray) -> list[float]:
                device, mode = piece.system.devices[k], piece.modes[k]
                e = _columns(piece, k, t, z)
                out = [device.law.evaluate(a, x, mode)[0][i] for a, x in zip(t, e, strict=True)]
                if i not in device.law.charged:
                    return out
                _, d = piece.system.inputs(t, piece.within)
                de = (device.inputs.z @ r + device.inputs.s @ d).T
                rates = [device.flowing(x, dx, mode)[i] for x, dx in zip(e, de, strict=True)]
                return [a + b for a, b in zip(out, rates, strict=True)]

            return read

        def state(i: int, k: int = k) -> _Read:
            return lambda piece, t, z, r: list(_columns(piece, k, t, z)[:, i])

        for i, flow in enumerate(law.flows):
            found[f"{law.name}.{flow.pin}.through"] = outputs(i)
        for i, name in enumerate(law.states):
            found[f"{law.name}.{name}"] = state(len(law.taps) + i)
    return found | {
        f"{d.law.name}.{key}": _more(k, key)
        for k, d in enumerate(system.devices)
        for key in d.law.extra
    }


def _more(k: int, key: str) -> _Read:
    def read(piece: Piece, t: np.ndarray, z: np.ndarray, r: np.ndarray) -> list[float]:
        law, mode = piece.system.devices[k].law, piece.modes[k]
        e = _columns(piece, k, t, z)
        return [law.waves(a, x, mode)[key] for a, x in zip(t, e, strict=True)]

    return read


def _columns(piece: Piece, k: int, t: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Inputs (nt, m) of device ``k``."""
    s, d = piece.system.inputs(t, piece.within)
    return piece.system.devices[k].inputs.at(z, s, d).T


def transient(
    system: System,
    stop: float,
    rtol: float = 1e-9,
    times: np.ndarray | None = None,
    start: np.ndarray | None = None,
) -> Result:
    """Integrate from equilibrium, or from ``start``, to ``stop`` [s].

    Pieces end at corners of sources, instants of devices and located zeros of their guards.
    ``times`` of the waves default to the accepted steps. Raises SimulationError.
    """
    from kc2spice.reference.equilibrium import equilibrium

    z, modes = equilibrium(system) if start is None else (start, None)
    own = [d.law.corners(stop) for d in system.devices]
    corners = np.unique(
        np.concatenate(
            [
                [0.0, stop],
                *(p.wave.corners(stop) for p in system.sources),
                *own,
            ]
        )
    )
    stretches: list[Stretch] = []
    events: list[Event] = []
    if modes is None:
        modes = _first_modes(system, z)
    for begin, end in pairwise(corners):
        within = 0.5 * (begin + end)
        if begin > 0.0:
            e = Piece(system, modes, within).inputs_of(begin, z)
            modes = [
                d.law.mode(begin, x, m) if np.any(at == begin) else m
                for d, x, m, at in zip(system.devices, e, modes, own, strict=True)
            ]
        t, piece = begin, None
        while t < end:
            if len(stretches) > _MAX_PIECES:
                raise SimulationError("contact chatters without end", where=f"t = {t:.9e} s")
            if piece is None:
                piece = Piece(system, modes, within)
                flying = modes_of(piece)
            stretch, fired = _run(piece, t, z, end, rtol, flying)
            if stretch is not None:
                stretches.append(stretch)
                t, z = stretch.end, stretch.steps[-1].last
            if fired is not None:
                modes, event = _switched(system, modes, fired, t)
                events += event
                piece = None
            elif t >= end * (1 - 1e-15):
                t = end
    grid = [s.start for p in stretches for s in p.steps] + [stop]
    time = np.unique(grid) if times is None else np.union1d(times, [e.time for e in events])
    return Result(system, time, tuple(stretches), tuple(events))


def _first_modes(system: System, z: np.ndarray) -> list[Any]:
    s, d = system.inputs(0.0, 0.0)
    return [x.law.mode(0.0, x.inputs.at(z, s, d)) for x in system.devices]


def _switched(
    system: System, modes: list[Any], fired: int, t: float
) -> tuple[list[Any], list[Event]]:
    """Modes after guard number ``fired`` fell to zero."""
    now = list(modes)
    zero = 0
    for k, device in enumerate(system.devices):
        e = np.zeros(device.inputs.z.shape[0])
        count = len(device.law.guards(t, e, modes[k]))
        if fired < zero + count:
            now[k], what = device.law.switch(modes[k], fired - zero)
            return now, [Event(t, device.law.name, what)] if what else []
        zero += count
    raise AssertionError("guard out of range")


def _run(
    piece: Piece, t: float, z: np.ndarray, end: float, rtol: float, modes: Modes | None
) -> tuple[Stretch | None, int | None]:
    """Steps to ``end``, to the first guard that falls to zero (and its number), or to where modes
    take off or land."""
    z = piece.settle(t, z)
    before = piece.guards(t, z)
    flight = None if modes is None else modes.launched(t, z)
    if flight is not None and _landed(flight, t, before, 1.5):
        flight = None
    part = piece if flight is None else flight.modes.part
    solver = Radau(part, t, z if flight is None else z[flight.modes.others], rtol)

    def full(step: Step) -> Step:
        return step if flight is None else FlightStep.of(step, flight, z.size)

    steps: list[Step] = []
    pace = min((getattr(p.wave, "pace", np.inf) for p in piece.system.sources), default=np.inf)
    h, fired = solver.guess(end), None
    while solver.t < end:
        inner, h_next = solver.advance(min(h, pace), end)
        step = full(inner)
        now = step.start + step.length
        if flight is not None:
            late = _landing(piece, flight, step)
            if late is not None:
                if late - step.start <= 1e-15 * max(step.start, 1e-6):
                    late = step.start + min(1e-3 * step.length, 1e-12)
                step = full(_short(solver, inner, late - step.start))
                now, end = late, late
        after = piece.guards(now, step.last)
        wrong = (before < 0.0) & (after < before)
        if wrong.any():
            fired = int(np.flatnonzero(wrong)[0])
            break
        fell = np.flatnonzero((after < 0.0) & (before >= 0.0))
        if fell.size:
            step, fired = _locate(piece, solver, step, fell, full)
        _check(piece, step)
        steps.append(step)
        if fired is not None or now >= end * (1 - 1e-16):
            break
        solver.accept(inner)
        before, h = after, h_next
        if (
            modes is not None
            and flight is None
            and not _landed(modes.launched(now, step.last), now, after, 1.6)
        ):
            break
    return (Stretch(piece, tuple(steps), flight) if steps else None), fired


def _landed(flight: Flight, t: float, guards: np.ndarray, margin: float) -> bool:
    """Whether a watched guard may fall to zero through the flight's own motion."""
    watched = flight.modes.watched
    return bool(np.any((guards - margin * flight.swing(t) - 1e-9 * (margin > 1.0) <= 0.0)[watched]))


def _landing(piece: Piece, flight: Flight, step: Step) -> float | None:
    """First time within ``step`` from which a watched guard may fall to zero by the flight."""
    times = step.start + step.length * np.linspace(0.0, 1.0, 9)[1:]

    def value(t: float) -> float:
        guards = piece.guards(t, step.at(t)[:, 0])
        return float((guards - flight.swing(t))[flight.modes.watched].min(initial=np.inf))

    low = step.start
    for t in times:
        if value(t) <= 0.0:
            return brentq(value, low, t, xtol=1e-12) if value(low) > 0.0 else low
        low = t
    return None


def _check(piece: Piece, step: Step) -> None:
    t = step.start + step.length
    for device, e in zip(piece.system.devices, piece.inputs_of(t, step.last), strict=True):
        device.law.check(t, e)


def _locate(
    piece: Piece, solver: Radau, step: Step, fell: np.ndarray, full: Callable[[Step], Step]
) -> tuple[Step, int]:
    """The step shortened to the first zero of a guard, solved anew there."""

    def value(t: float, k: int) -> float:
        return float(piece.guards(t, step.at(t)[:, 0])[k])

    t0, t1 = step.start, step.start + step.length
    low = t0 + 1e-12 * step.length
    roots = []
    for k in fell:
        root = (
            brentq(value, low, t1, args=(k,), xtol=1e-18, rtol=1e-15)
            if (value(low, k) > 0.0 > value(t1, k))
            else t1
            if value(low, k) > 0.0
            else low
        )
        roots.append(root)
    first = int(np.argmin(roots))
    h, guard = roots[first] - t0, int(fell[first])
    inner = step.inner if isinstance(step, FlightStep) else step
    h = max(h, 1e-12 * step.length)  # late in a run, t0 + 1e-12 length may be t0
    found = full(_short(solver, inner, h))
    for _ in range(2):  # the polynomial is of lower order than the step
        miss = float(piece.guards(t0 + h, found.last)[guard])
        rate = (value(t0 + h, guard) - value(t0 + 0.999 * h, guard)) / (0.001 * h)
        if rate >= 0.0 or abs(miss / rate) > 0.01 * h or abs(miss / rate) < 1e-17:
            break
        h -= miss / rate
        found = full(_short(solver, inner, h))
    return found, guard


def _short(solver: Radau, step: Step, h: float) -> Step:
    """The step of length ``h`` from the same start; on the polynomial where Newton fails."""
    found = solver.take(h)
    if found is not None:
        return found
    return Step(
        step.start,
        h,
        step.first,
        step.at(step.start + h * NODES) - step.first[:, None],
        step.differential,
    )


def _supplied(
    piece: Piece, t: np.ndarray, z: np.ndarray, r: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Power (supplies, nt) and through quantity out of every source."""
    system = piece.system
    s, d = system.inputs(t, piece.within)
    M, A, S, const, G, T, Ts, Td = system.raw
    force = None
    power, flow = [], []
    for supply in system.supplies:
        if supply.rows is not None:
            read = supply.rows.at(z, s, d)[0]
            power.append(s[supply.source] * read)
            flow.append(s[supply.source])
            continue
        if force is None:
            y, dy = T @ z + Ts @ s + Td @ d, T @ r + Ts @ d
            left = M @ dy - A @ y - S @ s - const[:, None]
            for device, mode in zip(system.devices, piece.modes, strict=True):
                e = device.inputs.at(z, s, d)
                de = device.inputs.z @ r + device.inputs.s @ d
                out = [
                    device.law.evaluate(a, x, mode)[0] + device.flowing(x, dx, mode)
                    for a, x, dx in zip(t, e.T, de.T, strict=True)
                ]
                left -= device.raw @ np.array(out).T
            touched = G.any(axis=0)
            force = np.linalg.lstsq(G[:, touched].T, left[touched], rcond=1e-12)[0]
        lam = force[supply.multiplier]
        power.append((d if supply.by_rate else s)[supply.source] * lam)
        flow.append(lam)
    shape = (0, t.size)
    return np.array(power).reshape(-1, t.size) if power else np.zeros(shape), np.array(flow)


def _balance(result: Result) -> Balance:
    """Energies at both ends, and powers by the quadrature of the method itself."""
    system = result.system
    supplied: dict[str, float] = {}
    lost: dict[str, float] = {}
    losing = [k for k, d in enumerate(system.devices) if type(d.law).loss is not Device.loss]
    for part in result.stretches:
        piece, step = part.piece, part.steps[0]
        t = np.concatenate([s.start + s.length * NODES for s in part.steps])
        w = np.concatenate([s.length * WEIGHTS for s in part.steps])
        nodes = [s.nodes() for s in part.steps]
        z, r = (np.hstack(rows) for rows in zip(*nodes, strict=True))
        if system.supplies:
            power, _ = _supplied(piece, t, z, r)
            for supply, row in zip(system.supplies, power, strict=True):
                supplied[supply.law] = supplied.get(supply.law, 0.0) + float(row @ w)
        s, d = system.inputs(t, piece.within)
        for term in system.terms:
            if term.kind in ("loss", "drag"):
                value = None
                if part.flight is not None:
                    value = flown_loss(part.flight, part.end, term, s[:, 0], d[:, 0])
                if value is None:
                    rows = term.rows
                    y = rows.at(z, s, d) if term.kind == "loss" else rows.z @ r + rows.s @ d
                    value = float(term.weight @ y**2 @ w)
                lost[term.law] = lost.get(term.law, 0.0) + value
        for k in losing:
            device, mode = system.devices[k], piece.modes[k]
            name = device.law.name
            e = device.inputs.at(z, s, d).T
            gained = np.array([device.law.loss(a, x, mode) for a, x in zip(t, e, strict=True)])
            first = piece.inputs_of(step.start, step.first)[k]
            last = piece.inputs_of(part.end, part.steps[-1].last)[k]
            kept = device.law.stores(first, last, mode)
            if kept is not None:
                lost[name] = lost.get(name, 0.0) + float(gained @ w) - kept
            elif gained.size:
                lost[name] = lost.get(name, 0.0) + float(np.maximum(gained, 0.0) @ w)
                supplied[name] = supplied.get(name, 0.0) - float(np.minimum(gained, 0.0) @ w)
    begin, end = result.stretches[0], result.stretches[-1]
    before = _energies(begin.piece, begin.steps[0].start, begin.steps[0].first)
    after = _energies(end.piece, end.end, end.steps[-1].last)
    names = dict.fromkeys((*supplied, *lost, *before))
    return Balance(
        {
            n: Share(supplied.get(n, 0.0), lost.get(n, 0.0), before.get(n, 0.0), after.get(n, 0.0))
            for n in names
        }
    )


def _energies(piece: Piece, t: float, z: np.ndarray) -> dict[str, float]:
    system = piece.system
    s, d = system.inputs(t, piece.within)
    found: dict[str, float] = {}
    for term in system.terms:
        if term.kind == "energy":
            y = term.rows.at(z, s, d)
            value = float(term.weight @ (y if term.linear else y * y))
            found[term.law] = found.get(term.law, 0.0) + value
    for device, e, mode in zip(system.devices, piece.inputs_of(t, z), piece.modes, strict=True):
        value = device.law.energy(e, mode)
        found[device.law.name] = found.get(device.law.name, 0.0) + value
    return found
