"""Transient solution of full models: that of the reduced models plus a correction.

An integrator with equal steps (:mod:`kc2spice.reference.fixed_step_integrator`) solves the scene
with full and with reduced models. The difference between the integrator's solutions with full and
with reduced models is the effect of the model reduction. The solution with full models is the sum
of two terms: an accurate solution with reduced models, and the effect of the model reduction. The
time steps cause nearly the same error with full and with reduced models, so that most of this error
cancels in the difference. The integrator computes the difference between full and reduced models
again with steps twice as long. The change due to the longer steps is an estimate of the error that
remains in the difference.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from kc2spice.core.constitutive_laws import PortBody, evaluate_combinations
from kc2spice.core.progress import StageTimer
from kc2spice.core.waveforms import Waveforms
from kc2spice.equations.networks import Network
from kc2spice.reference.fixed_step_integrator import integrate_steps
from kc2spice.reference.radau_integrator import Trajectory
from kc2spice.reference.system import System, assemble_system
from kc2spice.rom.linear_model import LinearModel
from kc2spice.scene.scene_classes import BuiltScene
from kc2spice.workflow.verify.body_verification import choose_verified_band
from kc2spice.workflow.verify.law_solution import LawSolution

# Number of time steps per period of the highest frequency in the band of a reduced model.
STEPS_PER_PERIOD = 80
# Largest number of time steps per period of the highest frequency; short runs use this number.
MAX_STEPS_PER_PERIOD = 800
MAX_WORK = 1e7  # largest product of the numbers of unknowns and time steps of a full model
# Largest number of time steps. If the bodies have few unknowns, this limit applies instead of
# MAX_WORK, because other parts of the scene take most of the computing time.
MAX_STEPS = 4000
FULL_STEP_FACTOR = 100.0  # factor by which --full multiplies the largest number of steps
# Largest motion of a body's port that counts as rest, relative to the range of motion.
# The second value of REST_MOTIONS applies if a small motion precedes the load.
# An example of a small motion is the ripple of a pulse-width modulated force.
# The solutions of the full and of the reduced model both neglect the small motion.
# The difference between the two solutions therefore has only a small error, the product of the
# neglected motion and the relative difference between the models.
REST_MOTIONS = (1e-9, 1e-3)


@dataclass(frozen=True)
class FullSolution:
    """Waveforms of the full models at the times of the reduced models' waveforms.

    The waveforms ``waves`` cover the time range ``[0, end]``. ``coarse`` are the waveforms with
    steps twice as long. ``end`` is the end of the compared time range [s]; None without a
    transient.
    """

    waves: Waveforms
    coarse: Waveforms | None = None
    end: float | None = None
    notes: tuple[str, ...] = ()


def add_differences(
    exact: LawSolution, differences: Sequence[FullModelDifference], end: float
) -> Waveforms:
    """Return the solution with full models: reduced-model results plus differences.

    Points around events that the steps do not resolve are left out.
    """
    time = exact.results["time"]
    resolved = time <= end * (1 + 1e-12)
    for difference in differences:
        resolved &= difference.mask_equal_switching_states(time)
    waves = {name: values[resolved] for name, values in exact.results.data.items()}
    at = time[resolved]
    for difference in differences:
        for name, change in difference.results.items():
            waves[name] = waves[name] + np.interp(at, difference.time, change, left=0.0)
    return Waveforms(waves, {})


@dataclass(frozen=True, eq=False)
class FullModelDifference:
    """Results of a network with full models minus the results with reduced models.

    Full and reduced models are solved with equal time steps. ``apart`` is a mask of the times at
    which a device is in different modes in the two solutions. ``events`` [s] are the times of the
    events in the solution with the reduced models.
    """

    time: np.ndarray
    results: dict[str, np.ndarray]
    apart: np.ndarray
    events: tuple[float, ...]

    def mask_equal_switching_states(self, time: np.ndarray) -> np.ndarray:
        """Return a mask of the times at which both solutions have equal switching states.

        The mask has one entry for each ``time``. The mask is false within the step that contains an
        event. The mask is also false within one step of each time at which a device has different
        modes in the two solutions.
        """
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


def list_port_bodies(network: Network) -> list[PortBody]:
    """List port bodies: bodies represented by a relation between port quantities."""
    return [law for law in network.laws if isinstance(law, PortBody)]


def compute_full_model_differences(
    network: Network, build: BuiltScene, exact: LawSolution, clock: StageTimer, thorough: bool
) -> tuple[FullModelDifference, FullModelDifference, str]:
    """Compute differences between full and reduced models, with step sizes h and 2 h.

    The first two results are the differences between the solutions of full and reduced models, with
    the step sizes h and 2 h. The third result is a text that states the number of unknowns, the
    time steps and the compared time range.
    """
    bodies = list_port_bodies(network)
    parts = build.scene.parts
    models = {law.name: build.model(parts[law.name], LinearModel) for law in bodies}
    laws = (
        PortBody(law.name, models[law.name], law.ports) if isinstance(law, PortBody) else law
        for law in network.laws
    )
    reduced, names = replace(network, laws=tuple(laws)), ", ".join(models)
    stop = build.scene.stop_time
    run = next(run for other, run in exact.runs if other.law_names == network.law_names)
    top = max(choose_verified_band(model, build)[1] for model in models.values())
    size = sum(law.model.order for law in bodies)
    most = max(2 * round(min(MAX_STEPS, MAX_WORK / size) / 2), 100) * (
        FULL_STEP_FACTOR if thorough else 1.0
    )

    def choose_step(begin: float) -> float:
        """Return the time step [s] for a comparison that starts at a given time."""
        resolved = max((stop - begin) / most, 1 / (MAX_STEPS_PER_PERIOD * top))
        return min(resolved, 1 / (STEPS_PER_PERIOD * top))

    begin, reconstruct_state = find_last_rest(bodies, run, most * choose_step(0.0))
    step = choose_step(begin)
    count = 2 * math.ceil(min((stop - begin) / step, most) / 2)
    if begin + count * step > stop:
        step = (stop - begin) / count

    systems = [assemble_system(item.laws, item.joins) for item in (network, reduced)]

    def compute_difference(times: int, label: str) -> FullModelDifference:
        """Integrate both models, and return the difference of full and reduced models."""
        with clock.time_stage("full model", f"{names}: {label}") as share:
            first, second = (
                integrate_steps(
                    system, begin, times * step, count // times, reconstruct_state, share
                )
                for system in systems
            )
        ours = evaluate_combinations(network.results, first.waves, first.time)
        other = evaluate_combinations(reduced.results, second.waves, second.time)
        apart = [a != b for a, b in zip(first.modes, second.modes, strict=True)]
        results = {name: ours[name] - other[name] for name in ours}
        return FullModelDifference(first.time, results, np.array(apart), run.events)

    fine = compute_difference(1, f"{count} steps of {step:.3g} s")
    coarse = compute_difference(2, "half as many")
    end = begin + count * step
    note = (
        f"full model of {names}: {size} unknowns in {count} steps of {step:.3g} s, from "
        f"{begin:.6g} s to {end:.6g} s" + (f" of {stop:.6g} s" if end < 0.999 * stop else "")
    )
    return fine, coarse, note


def find_last_rest(
    bodies: list[PortBody], run: Trajectory, span: float
) -> tuple[float, Callable[[System, np.ndarray], np.ndarray] | None]:
    """Find the last time at which a scene is at rest before a load changes.

    The second result is a function that computes the state of a system at the returned time.

    The returned time [s] precedes the first change of a load. Until the returned time, the full and
    the reduced models agree. If no load changes, or if a load changes in the first time step, the
    result is the time 0 and None. If possible, the returned time is at most ``span`` [s] before a
    load first reaches half of its largest change.
    """
    waves, time = run.waves, run.time
    names = list(chain.from_iterable(map(_list_port_wave_names, bodies)))

    def find_first_load_change(share: float) -> int:
        """Return the first index at which a load reaches ``share`` of its largest change.

        If no load changes, the index is the number of time points.
        """
        first = time.size
        for name in names:
            swing = np.abs(waves[name] - waves[name][0])
            if swing.any():
                first = min(first, int(np.argmax(swing > share * swing.max())))
        return first

    loaded = find_first_load_change(0.5)
    for motion in REST_MOTIONS:
        first = find_first_load_change(motion)
        if loaded >= time.size or time[loaded] <= time[max(first - 1, 0)] + span:
            break
    if first < 2 or first >= time.size:
        return 0.0, None
    at = first - 1

    def reconstruct_state(system: System, z: np.ndarray) -> np.ndarray:
        """Reconstruct a system's unknowns from waveforms just before the loads change."""
        return _reconstruct_state(system, z, float(time[at]), lambda name: float(waves[name][at]))

    return float(time[at]), reconstruct_state


def _list_port_wave_names(body: PortBody) -> list[str]:
    """Return the names of the waveforms at the ports of a body."""
    return [f"{body.name}.{port.name}" for port in body.ports]


def _reconstruct_state(
    system: System, z: np.ndarray, t: float, wave: Callable[[str], float]
) -> np.ndarray:
    """Return the unknowns of a system that reproduce the waveforms at the time ``t``.

    Unknowns that the waves do not determine are as near as possible to ``z``.
    """
    algebraic = ~(system.rated.any(axis=1) | system.direct.any(axis=1))
    recorded = np.array([not name.endswith(".through") for name in system.names]) & algebraic
    now, names = system.now[recorded], np.array(system.names)[recorded].tolist()
    A, drives = now[:, : z.size], system.evaluate_source_derivatives(t, t)
    b = np.array(list(map(wave, names))) - now[:, z.size :] @ drives
    level = np.abs(A).max(axis=1)
    A, b = A[level > 0] / level[level > 0, None], b[level > 0] / level[level > 0]
    return z + np.linalg.lstsq(A, b - A @ z, rcond=1e-12)[0]
