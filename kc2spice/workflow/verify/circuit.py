"""The scene's laws joined as its parts are, and its analysis by the independent integrator."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from kc2spice.core.laws import (
    Device,
    Equations,
    Law,
    LinearBody,
    PortBody,
    Reading,
    Recorded,
    Sensor,
    SignalBlock,
    Source,
)
from kc2spice.core.waveforms import Waveforms
from kc2spice.reference import equilibrium
from kc2spice.reference.assemble import System, assemble, has_store
from kc2spice.reference.integrate import Result, transient
from kc2spice.reference.linear import ac
from kc2spice.scene.parttype import Build
from kc2spice.workflow.decks import replacements, swept

RTOL = 1.5e-9  # of the integrator; at 1e-8 a sphere ringing at megahertz loses 5e-7 of its energy
# Kind of a pin: the source that can stand for a part there, and the factor to SI of ngspice's node.
SOURCES = {"electrical": ("voltage", 1.0), "displacement": ("displacement", 1e-6),
           "signal": ("signal", 1.0)}  # fmt: skip


@dataclass(frozen=True)
class Reference:
    """The scene's analysis by the reduced models' laws.

    ``results`` are the waves of ngspice that the laws know as well; ``imbalance`` is the share of
    the turned-over energy that the integration cannot account for, None where no time passes.
    """

    results: Waveforms
    imbalance: float | None = None
    events: tuple[tuple[float, str], ...] = ()
    runs: tuple[tuple[Circuit, Result], ...] = ()


@dataclass(frozen=True)
class Circuit:
    """Laws that are joined, directly or over others, with the readings of their waves."""

    laws: tuple[Law, ...]
    joins: Mapping[str, tuple[str, ...]]
    readings: Mapping[str, Reading]
    sweeps: Mapping[tuple[str, str], tuple[str, float]]

    def system(self) -> System:
        """The equations."""
        return assemble(self.laws, self.joins)

    def given(self, held: set[str]) -> bool:
        """Whether sources of the pins ``held`` prescribe every net, none of them moving a body."""
        nets = [set(pins) for net, pins in self.joins.items() if net != "gnd"]
        return (
            bool(held)
            and all(pins & held for pins in nets)
            and not any(isinstance(law, LinearBody | PortBody) for law in self.laws)
        )


def without_law(build: Build) -> tuple[str, ...]:
    """Names of the parts that have no law: the scene as a whole cannot be integrated."""
    return _missing(build, _equations(build))


def _missing(build: Build, found: Mapping[str, Equations]) -> tuple[str, ...]:
    known = {*found, *replacements(build)}
    return tuple(name for name in build.scene.parts if name not in known)


def _equations(build: Build) -> dict[str, Equations]:
    replaced = replacements(build)
    found: dict[str, Equations] = {}
    for part in build.scene.parts.values():
        equations = None if part.name in replaced else part.type.law(part, build)
        if equations is not None:
            found[part.name] = equations
    loaded = _loaded(build, found)
    return {name: equations for name, equations in found.items() if name not in loaded}


def _loaded(build: Build, found: Mapping[str, Equations]) -> set[str]:
    """Parts that drive a load by a signal: that has no law, as a signal knows no current."""
    laws = {law.name: law for equations in found.values() for law in equations.laws}
    kinds = _kinds(laws.values())
    nets: dict[str, list[tuple[str, str]]] = {}
    for name, equations in found.items():
        for pin, target in equations.pins:
            nets.setdefault(build.scene.nets[name, pin], []).append((name, target))
    return {
        name
        for net in nets.values()
        if any(kinds[target] != "signal" for _, target in net)
        for name, target in net
        if kinds[target] == "signal" and _holds(laws, target)
    }


def _kinds(laws: Iterable[Law]) -> dict[str, str]:
    return {f"{law.name}.{pin.name}": pin.kind for law in laws for pin in law.pins}


def taken_nets(build: Build) -> dict[str, str] | None:
    """Nets on which parts without a law meet others, and their kind.

    None if nothing has a law, if one of them has no source that could stand for the part, or if
    real coils follow an elastic body: their flux makes every step of its ringing one of Newton's
    method, for hours.

    What a part without law does to the rest of a transient is then known from ngspice: its voltage,
    displacement or signal on these nets. Nets that a law holds by itself are not among them.
    """
    found = _equations(build)
    missing = set(_missing(build, found))
    joins = _joins(build, found)
    laws = {law.name: law for equations in found.values() for law in equations.laws}
    kinds = _kinds(laws.values())
    met: dict[str, str] = {}
    for name, equations in found.items():
        for pin, target in equations.pins:
            net = build.scene.nets[name, pin]
            others = {
                part
                for part, end in build.scene.joined(name, pin)
                if not _listens(build, part, end)
            }
            joined = next((pins for pins in joins.values() if target in pins), (target,))
            if others & missing and not any(_holds(laws, each) for each in joined):
                met[net] = kinds[target] if met.get(net, "signal") == "signal" else met[net]
    coils = any(isinstance(law, Device) and has_store(law) for law in laws.values())
    elastic = any(isinstance(law, LinearBody) for law in laws.values())
    known = laws and set(met.values()) <= set(SOURCES)
    return met if known and not (coils and elastic) else None


def _listens(build: Build, name: str, pin: str) -> bool:
    """Whether a pin takes no current, of a part whose cards are our own."""
    part = build.scene.parts[name]
    end = next(t for t in part.type.pins(part, build.scene) if t.name == pin)
    return end.flow == "-" and not end.signal_out and not part.type.uses_netlists(part)


def _holds(laws: Mapping[str, Law], pin: str) -> bool:
    """Whether the law of a pin prescribes what its net has."""
    name, _, own = pin.partition(".")
    law = laws[name]
    if isinstance(law, Source):
        return own == "out" and law.kind not in ("current", "force")
    if isinstance(law, SignalBlock):
        return own in law.outputs
    return own in (law.drives if isinstance(law, Device) else ("out",) * isinstance(law, Sensor))


def circuits(build: Build, taken: Mapping[str, Source] | None = None) -> tuple[Circuit, ...]:
    """The scene's independent circuits; ``taken`` are sources on nets of parts without a law.

    Raises
    ------
    UsageError : the laws do not fit each other; a part without law is for the caller to find.
    """
    found, taken = _equations(build), taken or {}
    joins = _joins(build, found, taken)
    found |= {source.name: Equations((source,)) for source in taken.values()}
    laws = [law for equations in found.values() for law in equations.laws]
    readings = {k: r for equations in found.values() for k, r in equations.results.items()}
    sweeps = {(n, k): s for n, equations in found.items() for k, s in equations.sweeps.items()}
    return tuple(_apart(*_listening(laws, joins), readings, sweeps))


def _listening(
    laws: list[Law], joins: Mapping[str, tuple[str, ...]]
) -> tuple[list[Law], dict[str, tuple[str, ...]]]:
    """Signal inputs on a net of a circuit or of a motion are set by a sensor of its own: it has
    what ngspice has on the node, volts or micrometres."""
    kinds, sensors, found = _kinds(laws), [], dict(joins)
    for net, pins in joins.items():
        heard = tuple(pin for pin in pins if kinds[pin] == "signal")
        rest = tuple(pin for pin in pins if pin not in heard)
        if net == "gnd" or not heard or not rest:
            continue
        kind = kinds[rest[0]]
        sensor = Sensor(f"{net} heard", 1 / SOURCES.get(kind, ("", 1.0))[1], kind=kind)
        sensors.append(sensor)
        found[net] = (*rest, f"{sensor.name}.a")
        found[sensor.name] = (*heard, f"{sensor.name}.out")
    return [*laws, *sensors], found


def _joins(
    build: Build, found: Mapping[str, Equations], taken: Mapping[str, Source] | None = None
) -> dict[str, tuple[str, ...]]:
    """Nets of the laws' pins. Nets of the scene that share a pin of a law are one."""
    nets: list[tuple[bool, set[str]]] = []
    by_net = {net: {f"{source.name}.out"} for net, source in (taken or {}).items()}
    for name, equations in found.items():
        for pin, target in equations.pins:
            by_net.setdefault(build.scene.nets[name, pin], set()).add(target)
        nets += [(False, set(net)) for net in equations.nets]
    nets += [(net == "0", pins) for net, pins in by_net.items()]
    merged: list[tuple[bool, set[str]]] = []
    for ground, pins in nets:
        for other in [m for m in merged if m[1] & pins]:
            merged.remove(other)
            ground, pins = ground or other[0], pins | other[1]
        merged.append((ground, pins))
    grounded = [sorted(pins) for ground, pins in merged if ground]
    free = sorted(sorted(pins) for ground, pins in merged if not ground and len(pins) > 1)
    joins = {f"n{k}": tuple(pins) for k, pins in enumerate(free)}
    if grounded:
        joins["gnd"] = tuple(pin for pins in grounded for pin in pins)
    return joins


def _apart(
    laws: Iterable[Law],
    joins: Mapping[str, tuple[str, ...]],
    readings: Mapping[str, Reading],
    sweeps: Mapping[tuple[str, str], tuple[str, float]],
) -> Iterator[Circuit]:
    """Circuits that share nothing but ground."""
    groups: list[set[str]] = [{law.name} for law in laws]
    for net, pins in joins.items():
        if net != "gnd":
            names = {pin.partition(".")[0] for pin in pins}
            touched = [group for group in groups if group & names]
            groups = [group for group in groups if not group & names]
            groups.append(set().union(*touched))
    for group in groups:
        own = {
            net: kept
            for net, pins in joins.items()
            if (kept := tuple(p for p in pins if p.partition(".")[0] in group))
        }
        yield Circuit(
            tuple(law for law in laws if law.name in group),
            own,
            {k: r for k, r in readings.items() if _owner(r) in group},
            {k: s for k, s in sweeps.items() if s[0] in group},
        )


def _owner(reading: Reading) -> str:
    return reading.terms[0][1].partition(".")[0]


# --- analyses -------------------------------------------------------------------------------------


def solve(build: Build, waves: Waveforms, taken: Mapping[str, str] | None = None) -> Reference:
    """The analysis of the scene at the points of ``waves``, those of ngspice.

    On the nets ``taken`` (see :func:`taken_nets`) it is given what ngspice has there.

    Raises
    ------
    UsageError : the laws do not fit each other.
    SimulationError : no equilibrium, or a law left its range.
    """
    parts = moving(build, waves, taken or {})
    kind = build.scene.analysis.type
    if kind == "transient":
        return _transients(parts, build, waves)
    return steady(parts, build, waves)


def steady(parts: Iterable[Circuit], build: Build, waves: Waveforms) -> Reference:
    """:func:`solve` for circuits in which no time passes."""
    kind = build.scene.analysis.type
    if kind == "ac":
        frequency = waves["frequency"].real
        return _gathered("frequency", frequency, (_ac(c, frequency) for c in parts))
    scale = next(iter(waves.data))
    if kind == "op":
        return _gathered(scale, waves[scale], (_points(c, None) for c in parts))
    part, key, first, last = swept(build.scene)
    values = np.linspace(first, last, build.scene.analysis.points)
    solved = (_points(c, (c.sweeps.get((part.name, key)), values)) for c in parts)
    return _gathered(scale, waves[scale], solved)


def moving(build: Build, waves: Waveforms, taken: Mapping[str, str]) -> list[Circuit]:
    """The circuits that are not given: by sources alone, or on all of their nets by ``taken``."""
    sources = {net: _replayed(net, kind, waves) for net, kind in taken.items()}
    whole = circuits(build, sources)
    parts = [c for c in whole if not all(isinstance(law, Source) for law in c.laws)]
    held = {f"{source.name}.out" for source in sources.values()}
    # where every net is given, such as a capacitor behind a rectifier, nothing is left to integrate
    return [c for c in parts if not c.given(held)]


def taken_vectors(nets: Mapping[str, str]) -> dict[str, tuple[str, float]]:
    """Results of a deck that hold what it has on these nets."""
    return {f"net {net}": (f"v({net})", SOURCES[kind][1]) for net, kind in nets.items()}


def _replayed(net: str, kind: str, waves: Waveforms) -> Source:
    times, values = waves["time"], waves[f"net {net}"]
    # Where a contact closes, points lie picoseconds apart: their differences are rounding.
    apart = 1e-6 * float(np.ptp(times))
    kept = [0]
    for k in range(1, times.size):
        if times[k] - times[kept[-1]] >= apart:
            kept.append(k)
    return Source(f"net {net}", SOURCES[kind][0], Recorded(times[kept], values[kept]))


def _transients(parts: list[Circuit], build: Build, waves: Waveforms) -> Reference:
    times = np.unique(waves["time"])
    stop = build.scene.stop
    times = np.minimum(times, stop)
    runs = [(c, transient(c.system(), stop, RTOL, times)) for c in parts]
    grid = np.unique(np.concatenate([times, *(run.time for _, run in runs)]))
    data = {"time": grid}
    for circuit, run in runs:
        run = replace(run, time=grid)
        data |= read(circuit, run.waves, grid)
    events = sorted((e.time, f"{e.law} {e.what}") for _, run in runs for e in run.events)
    imbalance = _imbalance([run for _, run in runs])
    return Reference(Waveforms(data, {}), imbalance, tuple(events), tuple(runs))


def _imbalance(runs: list[Result]) -> float | None:
    books = [run.energy for run in runs]
    turnover = sum(book.turnover for book in books)
    return sum(abs(book.residual) for book in books) / turnover if turnover else None


def _ac(circuit: Circuit, frequency: np.ndarray) -> dict[str, np.ndarray]:
    return read(circuit, ac(circuit.system(), frequency), frequency)


def _points(
    circuit: Circuit, sweep: tuple[tuple[str, float] | None, np.ndarray] | None
) -> dict[str, np.ndarray]:
    system = circuit.system()
    source, values = (None, np.zeros(1)) if sweep is None else sweep
    if source is None:
        count = values.size
        point = equilibrium.operating_point(system).values
        solved = {name: np.full(count, value) for name, value in point.items()}
    else:
        name, scale = source
        solved = equilibrium.dc(system, name, scale * values)
    return read(circuit, solved, np.zeros(1))


def read(
    circuit: Circuit, waves: Mapping[str, np.ndarray], scale: np.ndarray
) -> dict[str, np.ndarray]:
    """Results of a circuit; a reading of a wave that this analysis has not is left out."""
    known = set(waves)
    found = {}
    for name, reading in circuit.readings.items():
        if not {wave for _, wave in reading.terms} <= known:
            continue
        value = np.asarray(sum(factor * waves[wave] for factor, wave in reading.terms))
        if np.iscomplexobj(value):  # small signals have no constant part
            value = value / (2j * np.pi * scale) if reading.charge else value
        else:
            value = value + reading.constant
        found[name] = value
    return found


def _gathered(name: str, scale: np.ndarray, parts: Iterable[Mapping[str, np.ndarray]]) -> Reference:
    data = {name: scale}
    for found in parts:
        data |= found
    return Reference(Waveforms(data, {}))
