"""The scene's laws joined as its parts are, and its analysis by the independent integrator; the
same with the full models of its parts in place of the reduced ones.

Statics and frequency responses are solved outright. In time both models go through one integrator
of equal steps (:mod:`kc2spice.reference.steps`), and what the full model does otherwise than the
reduced one is added to the reduced one's exact solution: both have the same error of stepping,
which cancels but for a share of their difference. That is measured by steps twice as long.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import (
    GROUND,
    Device,
    Equations,
    Law,
    LinearBody,
    PortBody,
    Reading,
    Source,
    reading,
    sensor,
)
from kc2spice.core.waveforms import Recorded, Waveforms
from kc2spice.reference import equilibrium
from kc2spice.reference.assemble import System, assemble
from kc2spice.reference.integrate import Result, transient
from kc2spice.reference.linear import ac, noise
from kc2spice.reference.steps import steps
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduce import surrogate
from kc2spice.scene.model import Build
from kc2spice.scene.parttype import replaced
from kc2spice.workflow.meters import WAVE, sweep_values, swept
from kc2spice.workflow.verify.bodies import held_band

RTOL = 1.5e-9  # integrator; at 1e-8 a sphere ringing at megahertz loses 5e-7 of its energy
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
        nets = [set(pins) for net, pins in self.joins.items() if net != GROUND]
        return (
            bool(held)
            and all(pins & held for pins in nets)
            and not any(isinstance(law, LinearBody | PortBody) for law in self.laws)
        )


@dataclass(frozen=True)
class _Laws:
    """Equations of a scene's parts, the parts that have none, and all laws with their pins."""

    build: Build
    equations: Mapping[str, Equations]
    missing: tuple[str, ...] = ()

    @cached_property
    def laws(self) -> dict[str, Law]:
        """By name."""
        return {law.name: law for item in self.equations.values() for law in item.laws}

    @cached_property
    def kinds(self) -> dict[str, str]:
        """Kinds of all pins of laws."""
        return _kinds(self.laws.values())

    @cached_property
    def ends(self) -> list[tuple[str, str, str, str]]:
        """Net of the scene, part, its pin, and the pin of a law that stands for it."""
        nets = self.build.scene.nets
        return [
            (nets[n, pin], n, pin, end) for n, e in self.equations.items() for pin, end in e.pins
        ]

    def joins(self, replayed: Mapping[str, Source] | None = None) -> dict[str, tuple[str, ...]]:
        """Nets of the laws' pins. Nets of the scene that share a pin of a law are one."""
        groups = [set(net) for item in self.equations.values() for net in item.nets]
        by_net = {net: {f"{source.name}.out"} for net, source in (replayed or {}).items()}
        for net, _, _, end in self.ends:
            by_net.setdefault(net, {GROUND} if net == "0" else set()).add(end)
        merged = _merged([*groups, *by_net.values()])
        free = sorted(sorted(pins) for pins in merged if GROUND not in pins and len(pins) > 1)
        joins = {f"n{k}": tuple(pins) for k, pins in enumerate(free)}
        ground = next((sorted(pins - {GROUND}) for pins in merged if GROUND in pins), None)
        return joins | ({GROUND: tuple(ground)} if ground else {})


def _laws(build: Build) -> _Laws:
    """Parts that drive a load by a signal have no law, as a signal knows no current."""
    copied = replaced(build.scene)
    result: dict[str, Equations] = {}
    for part in build.scene.parts.values():
        equations = None if part.name in copied else part.type.law(part, build)
        if equations is not None:
            result[part.name] = equations
    every = _Laws(build, result)
    circuit = {net for net, _, _, end in every.ends if every.kinds[end] != "signal"}
    loaded = {
        name
        for net, name, _, end in every.ends
        if net in circuit and every.kinds[end] == "signal" and _holds(every.laws, end)
    }
    known = {name: equations for name, equations in result.items() if name not in loaded}
    missing = (name for name in build.scene.parts if name not in known and name not in copied)
    return _Laws(build, known, tuple(missing))


def _kinds(laws: Iterable[Law]) -> dict[str, str]:
    return {f"{law.name}.{pin.name}": pin.kind for law in laws for pin in law.pins}


def _merged(groups: Iterable[set[str]]) -> list[set[str]]:
    """Merge groups that have an element in common."""
    result: list[set[str]] = []
    for group in groups:
        touched = [other for other in result if other & group]
        result = [other for other in result if not other & group] + [group.union(*touched)]
    return result


def without_law(build: Build) -> tuple[str, ...]:
    """Names of the parts that have no law: the scene as a whole cannot be integrated."""
    return _laws(build).missing


def replayed_nets(build: Build) -> dict[str, str] | None:
    """Return the kind of each net that joins a part without a law to parts with laws.

    Sources on these nets replace the parts without a law: they reproduce the voltage, displacement
    or signal that ngspice computed. A net whose value a law prescribes needs no source and is not
    in the result.

    The result is None in three cases:

    * No part has a law.
    * There is no source of the kind of one of the nets.
    * Real coils follow an elastic body. Their flux is nonlinear, so every step of the body's
      ringing needs Newton's method, which takes hours.
    """
    result = _laws(build)
    laws, kinds, joins = result.laws, result.kinds, result.joins()
    met: dict[str, str] = {}
    for net, name, pin, target in result.ends:
        ends = build.scene.joined(name, pin)
        others = {part for part, end in ends if not _listens(build, part, end)}
        joined = next((pins for pins in joins.values() if target in pins), (target,))
        if others & {*result.missing} and not any(_holds(laws, item) for item in joined):
            met[net] = kinds[target] if met.get(net, "signal") == "signal" else met[net]
    curved = (law for law in laws.values() if isinstance(law, Device) and not law.linear)
    coils = any(law.storing for law in curved)
    elastic = any(isinstance(law, LinearBody) for law in laws.values())
    known = laws and set(met.values()) <= set(SOURCES)
    return met if known and not (coils and elastic) else None


def _listens(build: Build, name: str, pin: str) -> bool:
    """Whether a pin takes no current, of a part whose cards are our own."""
    end = build.scene.terminals[name, pin]
    return end.flow == "-" and not end.signal_out and not build.scene.parts[name].netlist


def _holds(laws: Mapping[str, Law], pin: str) -> bool:
    """Whether the law of a pin prescribes what its net has."""
    name, _, own = pin.partition(".")
    law = laws[name]
    if isinstance(law, Source):
        return own == "out" and law.kind not in ("current", "force")
    return isinstance(law, Device) and own in law.prescribes


def circuits(build: Build, replayed: Mapping[str, Source] | None = None) -> tuple[Circuit, ...]:
    """The scene's independent circuits, which share nothing but ground; ``replayed`` are sources on
    nets of parts without a law.

    Raises
    ------
    UsageError : the laws do not fit each other; a part without law is for the caller to find.
    """
    result, replayed = _laws(build), replayed or {}
    laws, joins = _listening([*result.laws.values(), *replayed.values()], result.joins(replayed))
    readings = {k: r for e in result.equations.values() for k, r in e.results.items()}
    sweeps = {(n, k): s for n, e in result.equations.items() for k, s in e.sweeps.items()}
    met = [{_owner(pin) for pin in pins} for net, pins in joins.items() if net != GROUND]
    whole = []
    for group in _merged([*({law.name} for law in laws), *met]):
        own = {n: tuple(pin for pin in pins if _owner(pin) in group) for n, pins in joins.items()}
        whole.append(
            Circuit(
                tuple(law for law in laws if law.name in group),
                {net: pins for net, pins in own.items() if pins},
                {k: r for k, r in readings.items() if _owner(r.terms[0][1]) in group},
                {k: s for k, s in sweeps.items() if s[0] in group},
            )
        )
    return tuple(whole)


def _owner(pin: str) -> str:
    return pin.partition(".")[0]


def _listening(
    laws: list[Law], joins: Mapping[str, tuple[str, ...]]
) -> tuple[list[Law], dict[str, tuple[str, ...]]]:
    """Signal inputs on a net of a circuit or of a motion are set by a sensor of its own: it has
    what ngspice has on the node, volts or micrometres."""
    kinds, sensors, result = _kinds(laws), [], dict(joins)
    for net, pins in joins.items():
        signals = tuple(pin for pin in pins if kinds[pin] == "signal")
        rest = tuple(pin for pin in pins if pin not in signals)
        if net == GROUND or not signals or not rest:
            continue
        kind = kinds[rest[0]]
        name = f"{net} signals"
        sensors.append(sensor(name, 1 / SOURCES.get(kind, ("", 1.0))[1], kind))
        result[net] = (*rest, f"{name}.a")
        result[name] = (*signals, f"{name}.out")
    return [*laws, *sensors], result


# --- analyses -------------------------------------------------------------------------------------


def solve(
    build: Build,
    waves: Waveforms,
    replayed: Mapping[str, str] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> Reference:
    """The analysis of the scene at the points of ``waves``, those of ngspice.

    On the nets ``replayed`` (see :func:`replayed_nets`) it is given what ngspice has there.

    Raises
    ------
    UsageError : the laws do not fit each other.
    SimulationError : no equilibrium, or a law left its range.
    """
    parts = moving(build, waves, replayed or {})
    if build.scene.analysis.type != "transient":
        return Reference(steady(parts, build, waves))
    stop = build.scene.stop
    times = np.minimum(np.unique(waves["time"]), stop)
    runs = [(c, transient(c.system(), stop, RTOL, times, progress)) for c in parts]
    grid = np.unique(np.concatenate([times, *(run.time for _, run in runs)]))
    data = {"time": grid}
    for circuit, run in runs:
        data |= read(circuit, replace(run, time=grid).waves, grid)
    balances = [run.energy for _, run in runs]
    turnover = sum(balance.turnover for balance in balances)
    imbalance = sum(abs(balance.residual) for balance in balances) / turnover if turnover else None
    return Reference(Waveforms(data, {}), imbalance, tuple(runs))


def steady(parts: Iterable[Circuit], build: Build, waves: Waveforms) -> Waveforms:
    """:func:`solve` for circuits in which no time passes."""
    scale, points = next(iter(waves.data.items()))
    points = points.real
    data = {scale: points}
    for circuit in parts:
        if build.noisy:
            data |= _noise(circuit, build, points)
        else:
            data |= read(circuit, _steady(circuit, build, points), points)
    return Waveforms(data, {})


def _noise(circuit: Circuit, build: Build, points: np.ndarray) -> dict[str, np.ndarray]:
    """Density of the output's noise, where this circuit has it."""
    name = str(build.scene.analysis.output)
    ends = {f"{part}.{pin}": end for _, part, pin, end in _laws(build).ends}
    of = circuit.readings.get(name) or (reading(ends[name]) if name in ends else None)
    if of is None or _owner(of.terms[0][1]) not in {law.name for law in circuit.laws}:
        return {}
    return {WAVE: noise(circuit.laws, circuit.joins, of, points)}


def _steady(circuit: Circuit, build: Build, points: np.ndarray) -> Mapping[str, np.ndarray]:
    system, kind = circuit.system(), build.scene.analysis.type
    if kind == "ac":
        return ac(system, points)
    source, values = None, np.zeros(1)
    if kind == "dc":
        part, key, result = swept(build)
        assert result.range is not None
        values, last = sweep_values(build), result.range[1]
        if build.scene.analysis.back:
            values = last - np.sign(last - result.range[0]) * np.abs(values - last)
        source = circuit.sweeps.get((part.name, key))
    if source is not None:
        return equilibrium.dc(system, source[0], source[1] * values)
    point = equilibrium.operating_point(system)
    return {name: np.full(values.size, value) for name, value in point.items()}


def moving(build: Build, waves: Waveforms, replayed: Mapping[str, str]) -> list[Circuit]:
    """The circuits not given by sources alone or, on all of their nets, by ``replayed`` ones."""
    sources = {net: _replayed(net, kind, waves) for net, kind in replayed.items()}
    whole = circuits(build, sources)
    parts = [c for c in whole if not all(isinstance(law, Source) for law in c.laws)]
    held = {f"{source.name}.out" for source in sources.values()}
    # where every net is given, such as a capacitor behind a rectifier, nothing is left to integrate
    return [c for c in parts if not c.given(held)]


def replayed_vectors(nets: Mapping[str, str]) -> dict[str, tuple[str, float]]:
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


def read(
    circuit: Circuit, waves: Mapping[str, np.ndarray], scale: np.ndarray
) -> dict[str, np.ndarray]:
    """Results of a circuit; a reading of a wave that this analysis has not is left out."""
    result = {}
    for name, item in circuit.readings.items():
        if not {wave for _, wave in item.terms} <= set(waves):
            continue
        value = np.asarray(sum(factor * waves[wave] for factor, wave in item.terms))
        if np.iscomplexobj(value):  # small signals have no constant part
            value = value / (2j * np.pi * scale) if item.charge else value
        else:
            value = value + item.constant
        result[name] = value
    return result


PER_PERIOD = 80  # steps of a period of the highest frequency that a reduced model holds to
FINEST = 800  # steps of such a period in a short scene
WORK = 1e7  # largest product of unknowns and steps of a full model
MOST = 4000  # largest number of steps; for small models the other laws need more time
WHOLE = 100.0  # factor of the number of steps with --full
DIRECT = 3000  # unknowns up to which every frequency is solved directly
STILL = 1e-9  # largest motion of a port of a body at rest, relative to its swing


@dataclass(frozen=True)
class FullSolution:
    """Waves of the full models over ``[0, end]``, at the points of the reduced models' waves.

    ``coarse`` are the waves of steps twice as long. ``end`` is the duration compared [s]; None
    without a transient.
    """

    waves: Waveforms
    coarse: Waveforms | None = None
    end: float | None = None
    notes: tuple[str, ...] = ()


def full_build(build: Build, clock: Any) -> Build | None:
    """The scene with every model that has a full one behind it replaced by that; None if none has.

    In time only bodies have, whose full models are followed at their ports.
    """
    timed = build.scene.analysis.type == "transient"
    result = {}
    for part in build.scene.parts.values():
        if part.reduced or not timed:
            full = part.type.build(part, build.scene, clock, full=True)
            if full is not None:
                result[part.name] = _sparse(full) if isinstance(full, LinearModel) else full
    return replace(build, models={**build.models, **result}) if result else None


def finer_build(build: Build, parts: Iterable[str], clock: Any) -> Build | None:
    """The scene with the finer discretisation of these ``parts``, such as a film with more branches
    or a conductor with more loops; None if none of them has one."""
    scene, result = build.scene, {}
    for name in parts:
        finer = scene.parts[name].type.build(scene.parts[name], scene, clock, full=True)
        if finer is not None:
            result[name] = finer
    return replace(build, models={**build.models, **result}) if result else None


def _sparse(model: LinearModel) -> LinearModel:
    """A full model given as arrays, in the form that is followed at its ports."""
    if not model.pencil.is_dense:
        return model
    from scipy import sparse

    matrices = {k: sparse.csc_array(P) for k in "MEKA" if (P := getattr(model, k)) is not None}
    return replace(model, **matrices)


def full_solution(
    build: Build,
    full: Build,
    ours: Waveforms,
    exact: Reference,
    replayed: Mapping[str, str],
    clock: Any,
    whole: bool,
) -> FullSolution | None:
    """The scene with its full models; None where no circuit has one.

    ``ours`` are ngspice's waves, which give ``replayed`` nets, and ``exact`` the solution with the
    reduced models. ``whole`` follows the full model for :data:`WHOLE` times as many steps, at most
    to the end, and takes no surrogate for it.

    Raises
    ------
    SimulationError : no equilibrium, or a step that does not settle.
    """
    parts = moving(full, ours, replayed)
    if build.scene.analysis.type != "transient":
        words = "at its ports"
        if build.scene.analysis.small:
            parts = _with_surrogates(parts, float(build.scene.analysis.stop or 0.0), clock, whole)
            points = ours.scale.size
            for law in (law for c in parts for law in c.laws if isinstance(law, PortBody)):
                if law.model.order > DIRECT:  # no basis is as good: a solution each
                    words = f"{law.model.order} unknowns at {points} frequencies, solved at each"
        with clock.stage("full model", words):
            return FullSolution(steady(parts, full, ours))
    parts = [c for c in parts if any(isinstance(law, PortBody) for law in c.laws)]
    if not parts:
        return None
    fine, coarse, notes = zip(
        *(_followed(c, build, exact, clock, whole) for c in parts), strict=True
    )
    end = min(float(item.time[-1]) for item in fine)
    return FullSolution(_added(exact, fine, end), _added(exact, coarse, end), end, notes)


def _added(exact: Reference, found: Sequence[Difference], end: float) -> Waveforms:
    """The reduced models' solution up to ``end`` with what full models do otherwise; without the
    points around events that the steps do not resolve."""
    time = exact.results["time"]
    kept = time <= end * (1 + 1e-12)
    for difference in found:
        kept &= difference.resolved(time)
    waves = {name: values[kept] for name, values in exact.results.data.items()}
    for difference in found:
        for name, change in difference.results.items():
            waves[name] = waves[name] + np.interp(time[kept], difference.time, change, left=0.0)
    return Waveforms(waves, {})


def _with_surrogates(
    circuits: list[Circuit], stop: float, clock: Any, whole: bool
) -> list[Circuit]:
    """Large models replaced by a basis that is certified against direct solutions, one for all
    copies of a body."""
    small: dict[int, PortBody] = {}

    def replaced(law: Law) -> Law:
        if not isinstance(law, PortBody) or law.model.order <= DIRECT or whole:
            return law
        if id(law.model) not in small:
            with clock.stage("full model", f"{law.name}: basis against direct solutions"):
                try:
                    model, _ = surrogate(law.model, (0.0, stop))
                except SimulationError:
                    model = law.model
            small[id(law.model)] = replace(law, model=model, known={})
        return replace(small[id(law.model)], name=law.name)

    return [replace(c, laws=tuple(replaced(law) for law in c.laws)) for c in circuits]


@dataclass(frozen=True, eq=False)
class Difference:
    """Results of a circuit with full models less those with reduced ones, by the same steps;
    ``apart`` (nt,) where their devices are in different modes, ``events`` [s] of the run with the
    reduced ones."""

    time: np.ndarray
    results: dict[str, np.ndarray]
    apart: np.ndarray
    events: tuple[float, ...]

    def resolved(self, time: np.ndarray) -> np.ndarray:
        """Where both models are in one mode: not within the step of an event, nor beside a step at
        whose end only one of them has changed its mode."""
        grid, result = self.time, np.ones(time.size, dtype=bool)
        last = grid.size - 1
        apart = np.flatnonzero(self.apart).tolist()
        spans = [(grid[max(k - 1, 0)], grid[min(k + 1, last)]) for k in apart]
        for first, end in spans:
            result &= (time < first) | (time > end)
        for event in self.events:
            if grid[0] < event < grid[-1]:
                k = int(np.searchsorted(grid, event))
                result &= (time <= grid[k - 1]) | (time >= grid[k])
        return result


def _followed(
    circuit: Circuit, build: Build, exact: Reference, clock: Any, whole: bool
) -> tuple[Difference, Difference, str]:
    """Differences of full and reduced models in a circuit, from steps ``h`` and ``2 h``.

    The text describes the steps.
    """
    bodies = [law for law in circuit.laws if isinstance(law, PortBody)]
    models = {law.name: build.models[law.name] for law in bodies}
    laws = (
        PortBody(law.name, models[law.name], law.ports) if isinstance(law, PortBody) else law
        for law in circuit.laws
    )
    reduced, names = replace(circuit, laws=tuple(laws)), ", ".join(models)
    stop = build.scene.stop
    own = {law.name for law in circuit.laws}
    run = next(run for other, run in exact.runs if {law.name for law in other.laws} == own)
    begin, given = _still_until(bodies, run)
    top = max(held_band(model, build)[1] for model in models.values())
    size = sum(law.model.order for law in bodies)
    most = max(2 * round(min(MOST, WORK / size) / 2), 100) * (WHOLE if whole else 1.0)
    step = min(max((stop - begin) / most, 1 / (FINEST * top)), 1 / (PER_PERIOD * top))
    count = 2 * math.ceil(min((stop - begin) / step, most) / 2)
    if begin + count * step > stop:
        step = (stop - begin) / count

    def difference(times: int, label: str) -> Difference:
        with clock.stage("full model", f"{names}: {label}") as share:
            first, second = (
                steps(c.system(), begin, times * step, count // times, given, share)
                for c in (circuit, reduced)
            )
        ours = read(circuit, first.waves, first.time)
        other = read(reduced, second.waves, second.time)
        apart = [a != b for a, b in zip(first.modes, second.modes, strict=True)]
        results = {name: ours[name] - other[name] for name in ours}
        return Difference(first.time, results, np.array(apart), run.events)

    fine = difference(1, f"{count} steps of {step:.3g} s")
    coarse = difference(2, "half as many")
    end = begin + count * step
    note = (
        f"full model of {names}: {size} unknowns in {count} steps of {step:.3g} s, from "
        f"{begin:.6g} s to {end:.6g} s" + (f" of {stop:.6g} s" if end < 0.999 * stop else "")
    )
    return fine, coarse, note


def _still_until(
    bodies: list[PortBody], run: Result
) -> tuple[float, Callable[[System, np.ndarray], np.ndarray] | None]:
    """Return the last time [s] before the load of a body changes, and the state.

    Until that time the full and the reduced models agree. The time is 0 and the state None if a
    load changes at once, or if no load changes.
    """
    waves, time = run.waves, run.time
    first = time.size
    for wave in (waves[f"{law.name}.{port.name}"] for law in bodies for port in law.ports):
        swing = np.abs(wave - wave[0])
        moved = np.flatnonzero(swing > STILL * swing.max()) if swing.any() else [time.size]
        first = min(first, int(moved[0]))
    if first < 2 or first >= time.size:
        return 0.0, None
    at = first - 1

    def given(system: System, z: np.ndarray) -> np.ndarray:
        return _state(system, z, float(time[at]), lambda name: float(waves[name][at]))

    return float(time[at]), given


def _state(system: System, z: np.ndarray, t: float, wave: Callable[[str], float]) -> np.ndarray:
    """Return the unknowns that reproduce the waves at ``t``.

    Unknowns that the waves do not determine stay as near as possible to ``z``.
    """
    read = ~(system.rated.any(axis=1) | system.direct.any(axis=1))
    recorded = np.array([not name.endswith(".through") for name in system.names]) & read
    now, names = system.now[recorded], np.array(system.names)[recorded].tolist()
    A, given = now[:, : z.size], system.given(t, t)
    b = np.array([wave(name) for name in names]) - now[:, z.size :] @ given
    level = np.abs(A).max(axis=1)
    A, b = A[level > 0] / level[level > 0, None], b[level > 0] / level[level > 0]
    return z + np.linalg.lstsq(A, b - A @ z, rcond=1e-12)[0]
