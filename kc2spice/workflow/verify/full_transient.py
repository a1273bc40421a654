"""A transient with full models, as its difference to the one with the reduced models.

Both models go through one integrator of equal steps (:mod:`kc2spice.reference.steps`), and what the
full model does otherwise than the reduced one is added to the reduced one's exact solution: both
have the same error of stepping, which cancels but for a share of their difference. That is measured
by steps twice as long.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kc2spice.core.laws import PortBody
from kc2spice.core.waveforms import Waveforms
from kc2spice.equations.circuits import Circuit, read
from kc2spice.reference.assemble import System
from kc2spice.reference.integrate import Result
from kc2spice.reference.steps import steps
from kc2spice.scene.model import Build
from kc2spice.workflow.verify.bodies import held_band
from kc2spice.workflow.verify.law_solution import Reference

PER_PERIOD = 80  # steps of a period of the highest frequency that a reduced model holds to
FINEST = 800  # steps of such a period in a short scene
WORK = 1e7  # largest product of unknowns and steps of a full model
MOST = 4000  # largest number of steps; for small models the other laws need more time
WHOLE = 100.0  # factor of the number of steps with --full
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
