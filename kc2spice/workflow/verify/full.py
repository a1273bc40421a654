"""The scene with the full models of its parts in place of the reduced ones.

Statics and frequency responses are solved outright. In time both models go through one integrator
of equal steps (:mod:`kc2spice.reference.steps`), and what the full model does otherwise than the
reduced one is added to the reduced one's exact solution: both have the same error of stepping,
which cancels but for a share of their difference. That is measured by steps twice as long.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import Law, PortBody
from kc2spice.core.waveforms import Waveforms
from kc2spice.reference.assemble import System
from kc2spice.reference.integrate import Result
from kc2spice.reference.steps import steps
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduce import surrogate
from kc2spice.scene.parttype import Build
from kc2spice.workflow.verify.bodies import held_band
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

    ``coarse`` are those of steps twice as long; ``end`` [s] of what was compared is None where no
    time passes.
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
    found = {}
    for part in build.scene.parts.values():
        if part.reduced or not timed:
            full = part.type.build(part, build.scene, clock, full=True)
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
        words = "at its ports"
        if build.scene.analysis.small:
            parts = _with_surrogates(parts, float(build.scene.analysis.stop or 0.0), clock, whole)
            points = next(iter(ours.data.values())).size
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
    end = min(float(each.time[-1]) for each in fine)
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
                    model = surrogate(law.model, (0.0, stop)).model
                except SimulationError:
                    model = law.model
            small[id(law.model)] = replace(law, model=model, known={})
        return replace(small[id(law.model)], name=law.name)

    return [replace(c, laws=tuple(replaced(law) for law in c.laws)) for c in circuits]


@dataclass(frozen=True)
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
        grid, found = self.time, np.ones(time.size, dtype=bool)
        last = grid.size - 1
        apart = np.flatnonzero(self.apart).tolist()
        spans = [(grid[max(k - 1, 0)], grid[min(k + 1, last)]) for k in apart]
        for first, end in spans:
            found &= (time < first) | (time > end)
        for event in self.events:
            if grid[0] < event < grid[-1]:
                k = int(np.searchsorted(grid, event))
                found &= (time <= grid[k - 1]) | (time >= grid[k])
        return found


def _followed(
    circuit: Circuit, build: Build, exact: Reference, clock: Any, whole: bool
) -> tuple[Difference, Difference, str]:
    """What a circuit's full models do otherwise, from steps and from steps twice as long, and which
    steps these were."""
    bodies = [law for law in circuit.laws if isinstance(law, PortBody)]
    models = {law.name: build.model(law.name) for law in bodies}
    laws = (
        PortBody(law.name, models[law.name], law.ports) if isinstance(law, PortBody) else law
        for law in circuit.laws
    )
    reduced, names = replace(circuit, laws=tuple(laws)), ", ".join(models)
    stop = build.scene.stop
    run = next(run for own, run in exact.runs if _names(own) == _names(circuit))
    events = tuple(event.time for event in run.events)
    begin, given = _still_until(bodies, run)
    top = max(held_band(model, build)[1] for model in models.values())
    size = sum(law.model.order for law in bodies)
    most = max(2 * round(min(MOST, WORK / size) / 2), 100) * (WHOLE if whole else 1.0)
    step = min(max((stop - begin) / most, 1 / (FINEST * top)), 1 / (PER_PERIOD * top))
    count = 2 * math.ceil(min((stop - begin) / step, most) / 2)
    if begin + count * step > stop:
        step = (stop - begin) / count

    def difference(times: int, told: str) -> Difference:
        with clock.stage("full model", f"{names}: {told}") as share:
            first, second = (
                steps(c.system(), begin, times * step, count // times, given, share)
                for c in (circuit, reduced)
            )
        ours = read(circuit, first.waves, first.time)
        other = read(reduced, second.waves, second.time)
        apart = [a != b for a, b in zip(first.modes, second.modes, strict=True)]
        results = {name: ours[name] - other[name] for name in ours}
        return Difference(first.time, results, np.array(apart), events)

    fine = difference(1, f"{count} steps of {step:.3g} s")
    coarse = difference(2, "half as many")
    end = begin + count * step
    note = (
        f"full model of {names}: {size} unknowns in {count} steps of {step:.3g} s, from "
        f"{begin:.6g} s to {end:.6g} s" + (f" of {stop:.6g} s" if end < 0.999 * stop else "")
    )
    return fine, coarse, note


def _names(circuit: Circuit) -> set[str]:
    return {law.name for law in circuit.laws}


def _still_until(
    bodies: list[PortBody], run: Result
) -> tuple[float, Callable[[System, np.ndarray], np.ndarray] | None]:
    """When the first body is loaded otherwise than at t = 0, and the other laws' state then.

    Until then nothing differs between models. It is 0 where the state cannot be told.
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
    """Unknowns that have these waves at ``t``, nearest to ``z`` where none tells."""
    read = ~(system.rated.any(axis=1) | system.direct.any(axis=1))
    told = np.array([not name.endswith(".through") for name in system.names]) & read
    now, names = system.now[told], np.array(system.names)[told].tolist()
    A, given = now[:, : z.size], system.given(t, t)
    b = np.array([wave(name) for name in names]) - now[:, z.size :] @ given
    level = np.abs(A).max(axis=1)
    A, b = A[level > 0] / level[level > 0, None], b[level > 0] / level[level > 0]
    return z + np.linalg.lstsq(A, b - A @ z, rcond=1e-12)[0]
