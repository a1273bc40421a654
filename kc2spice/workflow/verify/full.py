"""The scene with the full models of its parts in place of the reduced ones.

Statics and frequency responses are solved outright. In time both models go through one integrator
of equal steps (:mod:`kc2spice.reference.steps`), and what the full model does otherwise than the
reduced one is added to the reduced one's exact solution: both have the same error of stepping,
which cancels but for a share of their difference. That is measured by steps twice as long.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import Device, Law, PortBody
from kc2spice.core.waveforms import Waveforms
from kc2spice.reference.assemble import System
from kc2spice.reference.integrate import Result
from kc2spice.reference.steps import Body, seconds, steps
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.surrogate import surrogate
from kc2spice.scene.parttype import Build
from kc2spice.workflow.verify.circuit import Circuit, Reference, moving, read, steady

PER_PERIOD = 80  # steps of a period of the highest frequency that a reduced model holds to
FINEST = 800  # of a scene so short that there are steps to spare
WORK = 1e7  # unknowns times steps that a verification follows
MOST = 4000  # steps at most: of small models the other laws cost more
WHOLE = 100.0  # times as much where the whole scene is asked for
DIRECT = 3000  # unknowns up to which every frequency is solved directly
STILL = 1e-9  # of its swing by which a body's port may move while the body is at rest


@dataclass(frozen=True)
class FullSolution:
    """Waves of the full models over ``[0, end]``, at the points of the reduced models' own.

    ``coarse`` are those of steps twice as long; ``begin`` and ``end`` [s] is the interval that was
    compared, None where no time passes.
    """

    waves: Waveforms
    coarse: Waveforms | None = None
    begin: float | None = None
    end: float | None = None
    notes: tuple[str, ...] = ()


def full_build(build: Build, clock: Any) -> Build | None:
    """The scene with every model that has a full one behind it replaced by that; None if none has.

    In time only bodies have, whose full models are followed at their ports.
    """
    timed = build.scene.analysis.type == "transient"
    found = {}
    for part in build.scene.parts.values():
        if part.type.reduced or not timed:
            full = part.type.full_model(part, build, clock)
            if full is not None:
                found[part.name] = _sparse(full) if isinstance(full, LinearModel) else full
    return replace(build, models={**build.models, **found}) if found else None


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
    taken: Mapping[str, str],
    clock: Any,
    whole: bool,
) -> FullSolution | None:
    """The scene with its full models; None where no circuit has one.

    ``ours`` are ngspice's waves, which give ``taken`` nets, and ``exact`` the solution with the
    reduced models. ``whole`` follows the full model for :data:`WHOLE` times as many steps, at most
    to the end, and takes no surrogate for it.

    Raises
    ------
    SimulationError : no equilibrium, or a step that does not settle.
    """
    parts = moving(full, ours, taken)
    if build.scene.analysis.type != "transient":
        if build.scene.analysis.type == "ac":
            parts = _with_surrogates(parts, float(build.scene.analysis.stop or 0.0), clock, whole)
        with clock.stage("full model", "at its ports"):
            return FullSolution(steady(parts, full, ours).results)
    parts = [c for c in parts if any(isinstance(law, PortBody) for law in c.laws)]
    if not parts:
        return None
    found = [_followed(c, build, exact, clock, whole) for c in parts]
    end = min(each.end for each in found)
    waves, coarse = (_added(exact, found, end, twice) for twice in (False, True))
    return FullSolution(
        waves,
        coarse,
        min(each.begin for each in found),
        end,
        tuple(each.note for each in found),
    )


def _added(exact: Reference, found: list[_Followed], end: float, twice: bool) -> Waveforms:
    """The reduced models' solution up to ``end`` with what full models do otherwise; without the
    points around events that the steps do not resolve."""
    time = exact.results["time"]
    kept = time <= end * (1 + 1e-12)
    for each in found:
        kept &= each.resolved(time, each.coarse if twice else each.fine)
    waves = {name: values[kept] for name, values in exact.results.data.items()}
    for each in found:
        waves |= each.waves(time[kept], each.coarse if twice else each.fine)
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
                    model = surrogate(law.model, (0.0, stop)).model
                except SimulationError:
                    model = law.model
            small[id(law.model)] = replace(law, model=model, known={})
        return replace(small[id(law.model)], name=law.name)

    return [replace(c, laws=tuple(replaced(law) for law in c.laws)) for c in circuits]


@dataclass(frozen=True)
class Difference:
    """Waves and inputs of devices, full less reduced model, by the same steps; ``apart`` (nt,)
    where their devices are in different modes."""

    time: np.ndarray
    waves: dict[str, np.ndarray]
    inputs: dict[str, np.ndarray]
    apart: np.ndarray


@dataclass(frozen=True)
class _Followed:
    """A circuit's ``run`` with the reduced models, and full less reduced model from steps and from
    steps twice as long."""

    circuit: Circuit
    run: Result
    fine: Difference
    coarse: Difference
    begin: float
    end: float
    note: str

    @property
    def events(self) -> np.ndarray:
        """Times [s] at which the run with the reduced models changed its modes."""
        return np.unique([event.time for event in self.run.events])

    def resolved(self, time: np.ndarray, difference: Difference) -> np.ndarray:
        """Where both models are in one mode: not from an event to the end of its step, nor beside
        a step at whose end only one of them has changed its mode."""
        grid, found = difference.time, np.ones(time.size, dtype=bool)
        for k in np.flatnonzero(difference.apart).tolist():
            found &= (time < grid[max(k - 1, 0)]) | (time > grid[min(k + 1, grid.size - 1)])
        for event in self.events[(self.events > grid[0]) & (self.events < grid[-1])]:
            found &= (time <= event) | (time >= grid[np.searchsorted(grid, event)])
        return found

    def waves(self, time: np.ndarray, difference: Difference) -> dict[str, np.ndarray]:
        """Results at ``time``: the exact solution with the reduced models and the difference.

        Forces of contacts and the like, which have kinks, follow from what the devices see then.
        """
        exact = replace(self.run, time=time).waves

        def between(values: np.ndarray) -> np.ndarray:
            return _between(time, difference.time, values, self.events)

        found: dict[str, np.ndarray] = {}
        for device in self.run.system.devices:
            law = device.law
            moved = [between(column) for column in difference.inputs[law.name].T]
            e = exact.inputs(law.name)
            found |= _outputs(law, time, e + np.array(moved).T.reshape(e.shape))
        for name in {wave for r in self.circuit.readings.values() for _, wave in r.terms}:
            if name not in found and name in difference.waves and name in exact:
                found[name] = exact[name] + between(difference.waves[name])
        return read(self.circuit, found, time)


def _between(
    time: np.ndarray, grid: np.ndarray, values: np.ndarray, events: np.ndarray
) -> np.ndarray:
    """``values`` on ``grid`` at ``time``: straight lines, but up to one of the ``events`` within a
    step that of the step before; zero before the grid."""
    found = np.interp(time, grid, values, left=0.0)
    for event in events[(events > grid[1]) & (events < grid[-1])]:
        k = int(np.searchsorted(grid, event)) - 1
        here = (time > grid[k]) & (time <= event)
        slope = (values[k] - values[k - 1]) / (grid[k] - grid[k - 1])
        found[here] = values[k] + slope * (time[here] - grid[k])
    return found


def _outputs(law: Device, time: np.ndarray, inputs: np.ndarray) -> dict[str, np.ndarray]:
    """Waves of a device that sees ``inputs`` (nt, m)."""
    found: dict[str, list[float]] = {}
    for t, e in zip(time, inputs, strict=True):
        mode = law.mode(t, e)
        out = law.evaluate(t, e, mode)[0]
        for k, flow in enumerate(law.flows):
            if k in law.charged:
                continue  # its charge changes over time
            found.setdefault(f"{law.name}.{flow.pin}.through", []).append(out[k])
        for k, state in enumerate(law.states):
            found.setdefault(f"{law.name}.{state}", []).append(e[len(law.taps) + k])
        for key, value in law.waves(t, e, mode).items():
            found.setdefault(f"{law.name}.{key}", []).append(value)
    return {name: np.array(values) for name, values in found.items()}


def _followed(
    circuit: Circuit, build: Build, exact: Reference, clock: Any, whole: bool
) -> _Followed:
    bodies = [law for law in circuit.laws if isinstance(law, PortBody)]
    reduced = _with_models(circuit, {law.name: build.model(law.name) for law in bodies})
    stop = build.scene.stop
    begin, given = _still_until(circuit, bodies, exact)
    top = max(_top(build.model(law.name), build) for law in bodies)
    size = sum(law.model.order for law in bodies)
    most = max(2 * round(min(MOST, WORK / size) / 2), 100) * (WHOLE if whole else 1.0)
    step = max((stop - begin) / most, 1 / (FINEST * top))
    if step > 1 / (PER_PERIOD * top):
        step = 1 / (PER_PERIOD * top)
    count = 2 * math.ceil(min((stop - begin) / step, most) / 2)
    if begin + count * step > stop:
        step = (stop - begin) / count
    names = ", ".join(law.name for law in bodies)
    systems = circuit.system(), reduced.system()
    with clock.stage("full model", f"{names}: one factorisation of {size} unknowns"):
        each, factors = seconds(systems[0], step)
    said = (
        f"{names}: {count} steps of {step:.3g} s and half as many, about {1.5 * count * each:.0f} s"
    )
    with clock.stage("full model", said) as share:
        fine, coarse = (
            _difference(
                systems,
                begin,
                factor * step,
                count // factor,
                given,
                factors if factor == 1 else None,
                share,
            )
            for factor in (1, 2)
        )
    end = begin + count * step
    run = next(run for own, run in exact.runs if _names(own) == _names(circuit))
    note = (
        f"full model of {names}: {size} unknowns in {count} steps of {step:.3g} s, from "
        f"{begin:.6g} s to {end:.6g} s" + (f" of {stop:.6g} s" if end < 0.999 * stop else "")
    )
    return _Followed(circuit, run, fine, coarse, begin, end, note)


def _names(circuit: Circuit) -> set[str]:
    return {law.name for law in circuit.laws}


def _top(model: LinearModel, build: Build) -> float:
    """Highest frequency [Hz] that a reduced model is meant for."""
    known = model.certificate
    return float(known.band_hz[1] if known is not None else build.scene.rom.band[1])


def _with_models(circuit: Circuit, models: Mapping[str, LinearModel]) -> Circuit:
    laws = [
        PortBody(law.name, models[law.name], law.ports) if isinstance(law, PortBody) else law
        for law in circuit.laws
    ]
    return replace(circuit, laws=tuple(laws))


def _difference(
    systems: tuple[System, System],
    begin: float,
    step: float,
    count: int,
    given: Callable[[System, np.ndarray], np.ndarray] | None,
    factors: list[Body] | None,
    progress: Callable[[float], None],
) -> Difference:
    first, second = (
        steps(system, own or seconds(system, step)[1], begin, step, count, given, progress)
        for system, own in zip(systems, (factors, None), strict=True)
    )
    waves = {name: first.waves[name] - second.waves[name] for name in first.waves}
    inputs = {name: first.inputs[name] - second.inputs[name] for name in first.inputs}
    apart = np.zeros(first.time.size, dtype=bool)
    for device in systems[0].devices:
        law = device.law
        if not isinstance(law, PortBody):
            both = zip(first.time, first.inputs[law.name], second.inputs[law.name], strict=True)
            apart |= [law.mode(t, a) != law.mode(t, b) for t, a, b in both]
    return Difference(first.time, waves, inputs, apart)


def _still_until(
    circuit: Circuit, bodies: list[PortBody], exact: Reference
) -> tuple[float, Callable[[System, np.ndarray], np.ndarray] | None]:
    """When the first body is loaded otherwise than at t = 0, and the other laws' state then.

    Until then nothing differs between models. It is 0 where the state cannot be told.
    """
    run = next(run for own, run in exact.runs if _names(own) == _names(circuit))
    waves, time = run.waves, run.time
    first = time.size
    for law in bodies:
        for port in law.ports:
            wave = np.asarray(waves[f"{law.name}.{port.name}"])
            swing = np.abs(wave - wave[0])
            moved = np.flatnonzero(swing > STILL * swing.max()) if swing.any() else [time.size]
            first = min(first, int(moved[0]))
    if first < 2 or first >= time.size:
        return 0.0, None
    at = first - 1

    def given(system: System, z: np.ndarray) -> np.ndarray:
        return _state(
            system, z, {name: float(waves[name][at]) for name in _readable(system)}, float(time[at])
        )

    return float(time[at]), given


def _readable(system: System) -> list[str]:
    own = [
        f"{d.law.name}.{s}"
        for d in system.devices
        if not isinstance(d.law, PortBody)
        for s in d.law.states
    ]
    return [*system.across, *(f"{name}.rate" for name in system.rates), *own]


def _state(system: System, z: np.ndarray, values: Mapping[str, float], t: float) -> np.ndarray:
    """Unknowns that have these waves at ``t``, nearest to ``z`` where none tells."""
    s, d = system.inputs(t, t)
    rows = [(rows, values[name]) for name, rows in system.across.items()]
    rows += [(rows, values[f"{name}.rate"]) for name, rows in system.rates.items()]
    A = np.vstack([each.z for each, _ in rows])
    b = np.array([value - float((each.s @ s + each.d @ d)[0]) for each, value in rows])
    for device in system.devices:
        law = device.law
        if not isinstance(law, PortBody) and law.states:
            A = np.vstack((A, device.inputs.z[len(law.taps) :]))
            b = np.append(b, [values[f"{law.name}.{state}"] for state in law.states])
    level = np.abs(A).max(axis=1)
    A, b = A[level > 0] / level[level > 0, None], b[level > 0] / level[level > 0]
    return z + np.linalg.lstsq(A, b - A @ z, rcond=1e-12)[0]
