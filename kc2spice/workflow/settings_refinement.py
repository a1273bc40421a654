"""Runs with refined numerical settings, and error estimates of metrics.

Numerical settings (:mod:`kc2spice.scene.numerical_settings`) change in refinement steps. A refined
run refines all settings by one step. The error estimate of a metric is :data:`REMAINDER_FACTOR`
times the change of the metric in the refined run. With an ``error_budget``, the setting that
changes the metrics most is refined first. The refinement ends when the error estimate of every
metric is within the budget, or when no setting can be refined further.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.curve_distance import compute_curve_distance
from kc2spice.core.errors import SimulationError, UsageError, wrong
from kc2spice.core.memory import find_available_bytes
from kc2spice.core.mesh_error_descriptions import list_mesh_errors
from kc2spice.core.progress import ERROR_BUDGET, StageTimer
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import interpolate
from kc2spice.parts.bodies._meshed_bodies import MeshedBody
from kc2spice.scene.checks import Check, require_passed
from kc2spice.scene.load import load_scene
from kc2spice.scene.metrics import find_probe_window
from kc2spice.scene.numerical_settings import (
    MAX_STEP_KEY,
    NumericalSetting,
    find_finest_settings,
    find_numerical_settings,
    refine_settings,
)
from kc2spice.scene.scene_classes import Part, Scene
from kc2spice.scene.settings import Action
from kc2spice.workflow.decks import prepare_deck
from kc2spice.workflow.simulation import (
    Run,
    measure_simulator_cpu,
    run_simulation,
    simulate_deck,
)
from kc2spice.workflow.time_step import (
    EDGE_LIMIT,
    find_least_resolved_edges,
    find_linearised_scene,
)

# Largest number of unknowns of a refined mesh. Larger meshes would take many minutes of CPU time.
MAX_MESH_UNKNOWNS = 200_000
# Fraction of the free memory for one factorised matrix; other matrices and modes need the rest.
MEMORY_SHARE = 0.5
# Bytes of the factorised matrix of a plane mesh, divided by n log2(n) for n unknowns.
# The factorised matrix for 145 000 unknowns took 0.2 GB.
PLANE_FACTOR_BYTES = 100.0
MAX_RUNS = 16  # largest number of runs in addition to the run of the scene
# If all refined runs together will probably take longer than LONG_REFINEMENT [s], the expected time
# is printed before the first refined run.
LONG_REFINEMENT = 30.0
DEFAULT_ERROR_LIMIT = 1e-2  # error budget if checks.reduction is set without error_budget
# Assumption: each refinement step removes at least half of the error of a setting.
# Even on bodies with sharp corners, each refinement step of the mesh halves the error.
# The error is therefore at most REMAINDER_FACTOR times the change of a metric.
REMAINDER_FACTOR = 2.0
# assumption: largest factor by which one refinement step reduces the error of a setting
MAX_STEP_GAIN = 4.0
# In a scene with a user's netlist, or another part without equations, a refined run refines the
# largest time step by this number of steps. Such a part can produce pulses that lie between two
# time points. A run with only half the time step can miss the same pulses.
EDGE_REFINEMENT = 3
MAX_ADDED_STEPS = 3  # largest number of steps by which a setting is refined between two runs
# The divisor of a metric's relative change is at least this share of the largest metric that has
# the same unit.
NEAR_ZERO_SHARE = 0.1
# SMALL_SIGNAL_SHARE replaces NEAR_ZERO_SHARE in small-signal analyses.
SMALL_SIGNAL_SHARE = 1e-6
# Largest width of a spike, relative to the duration of the run.
SPIKE_WIDTH = 1e-8
# Smallest height of a spike, relative to the range of the waveform.
SPIKE_SHARE = 0.1
# largest ratio of successive error estimates that counts as convergence
CONVERGENCE_RATIO = 0.9
# The refinement ends after this number of successive steps that hardly reduce the error estimate.
# A step hardly reduces the estimate if (new estimate / previous estimate) > CONVERGENCE_RATIO.
MAX_STALLS = 2

RefinementSteps = Mapping[str, float]  # refinement steps, keyed by setting


# --- runs -----------------------------------------------------------------------------------------


class RefinedRuns:
    """Cache of runs of a scene with refined settings; each run is computed only once.

    ``refinable`` are the settings that can be refined; settings in ``finest`` can only become
    coarser. ``most`` is the largest number of further runs for an error estimate, in addition to
    the run of the unchanged scene.
    """

    def __init__(
        self,
        start: Run,
        refinable: Sequence[NumericalSetting],
        clock: StageTimer,
        *,
        finest: Sequence[NumericalSetting] = (),
        retries: int | None = None,
        most: float = MAX_RUNS,
    ) -> None:
        self.start, self.refinable, self.clock, self.retries = start, refinable, clock, retries
        self.finest, self.most = finest, most
        self.run_cache: dict[str, Run] = {repr({}): start}
        self.refused: UsageError | None = None  # latest error about a mesh above the size limits

    def get_refined_run(self, steps: RefinementSteps) -> Run:
        """Return the run with refined settings, from the cache if possible.

        ``steps`` contains the refinement steps of the settings. Raises the errors of
        :func:`kc2spice.workflow.simulation.simulate_deck`.
        """
        build, settings = self.start.build, refine_settings(self.all_settings, steps)
        if repr(settings) not in self.run_cache:
            self.require_mesh_within_limits(steps)
            self.run_cache[repr(settings)] = evaluate_scene(
                load_scene(build.scene, settings),
                self.clock,
                ", ".join(settings),
                trust=build.trust,
                functions=build.functions,
                retries=self.retries,
            )
        return self.run_cache[repr(settings)]

    @property
    def all_settings(self) -> tuple[NumericalSetting, ...]:
        """Settings that can be refined, then settings at their finest value."""
        return (*self.refinable, *self.finest)

    @cached_property
    def mesh_limits(self) -> tuple[float, float]:
        """Largest number of unknowns, and largest memory [B], of a refined mesh."""
        return MAX_MESH_UNKNOWNS, MEMORY_SHARE * find_available_bytes()

    def require_mesh_within_limits(self, steps: RefinementSteps) -> None:
        """Raise an error if a refined mesh would exceed the size limits.

        The limits of unknowns and memory are :attr:`mesh_limits`. The size of each mesh is
        estimated from ``steps``, the refinement steps of the settings.

        Raises
        ------
        UsageError : a refined mesh has too many unknowns or needs too much memory.
        """
        for setting in self.refinable:
            part = self._find_body_of_setting(setting)
            if part is None or not steps.get(setting.name):
                continue
            assert isinstance(part.type, MeshedBody)
            refined = setting.refine_keys(steps[setting.name])[setting.name]
            grown = part.type.estimate_mesh_growth(part, setting.value, refined)
            unknowns = grown * self.start.build.get_model_values(part)["unknowns"]
            need = estimate_factor_bytes(unknowns, part.type.dimensions(part))
            most, memory = self.mesh_limits
            if unknowns > most or need > memory:
                got = f"about {_format_size(unknowns, need)}"
                expected = f"at most {_format_size(most, memory)}"
                self.refused = wrong(
                    setting.name,
                    "the finer mesh for the error estimate is too large",
                    got=got,
                    expected=expected,
                )
                raise self.refused

    def _find_body_of_setting(self, setting: NumericalSetting) -> Part | None:
        """Return the body whose mesh a setting refines, or None."""
        for part in self.start.build.scene.parts.values() if setting.model else ():
            refined = setting.name.startswith(f"{part.key_prefix}.")
            if refined and isinstance(part.type, MeshedBody):
                return part
        return None

    @cached_property
    def has_unmodelled_parts(self) -> bool:
        """Whether kc2spice lacks the equations of a part, such as a user's netlist."""
        return bool(find_linearised_scene(self.start.build).parts_without_network)

    @property
    def has_runs_left(self) -> bool:
        """Whether the largest number of runs permits another run."""
        return len(self.run_cache) <= self.most

    def find_largest_mesh_error(self, names: Sequence[str], run: Run) -> float:
        """Find the largest mesh error estimate of bodies with a mesh setting in ``names``.

        The models in ``run`` contain the error estimates.
        """
        largest = 0.0
        for setting in self.all_settings:
            part = self._find_body_of_setting(setting) if setting.name in names else None
            if part is not None:
                errors = list_mesh_errors(run.build.get_model_values(part))
                largest = max([largest, *errors.values()])
        return largest


def _format_size(unknowns: float, memory: float) -> str:
    """Format a number of unknowns and a memory size [B] as text."""
    return f"{unknowns:,.0f}".replace(",", " ") + f" unknowns and {memory / 1e9:.2g} GB"


def estimate_factor_bytes(unknowns: float, dimensions: int) -> float:
    """Estimate the memory [B] of a factorised stiffness matrix.

    For n unknowns, the number of nonzeros of the factor grows as n^(4/3) in three dimensions, and
    as n log n in a plane (A. George, SIAM J. Numer. Anal. 10 (1973) 345).
    """
    if dimensions == 3:
        # imported here, because the module loads the finite elements
        from kc2spice.bodies.stack import SPARSE_BYTES

        return SPARSE_BYTES * unknowns ** (4 / 3)
    return PLANE_FACTOR_BYTES * unknowns * math.log2(max(unknowns, 2.0))


def evaluate_scene(
    scene: Scene,
    clock: StageTimer,
    text: str = "",
    *,
    trust: bool = False,
    functions: Mapping[str, Any] | None = None,
    retries: int | None = None,
) -> Run:
    """Build and simulate ``scene``, and compute its metrics.

    Raises the errors of :func:`kc2spice.workflow.simulation.simulate_deck`.
    """
    build, deck = prepare_deck(scene, clock, trust=trust, functions=functions)
    with (
        clock.time_stage("refined run", text) as share,
        tempfile.TemporaryDirectory() as folder,
    ):
        return simulate_deck(build, deck, Path(folder), retries=retries, progress=share)


def repeat_timing(run: Run) -> float:
    """Simulate the deck of ``run`` again and return the CPU time [s] of the simulator."""
    with tempfile.TemporaryDirectory() as folder:
        shared = bool(run.build.sampled_sources)
        begin = measure_simulator_cpu(shared=shared)
        run_simulation(run.build, run.deck, Path(folder))
        return measure_simulator_cpu(shared=shared) - begin


def compute_metric_changes(run: Run, finer: Run) -> dict[str, float]:
    """Return the relative change of every metric from a run to a finer run.

    The change of a curve is relative to its largest value. The change of a number is relative to
    the number itself. The divisor of the change is at least :data:`NEAR_ZERO_SHARE` times the
    largest metric with the same unit. For small-signal responses, :data:`SMALL_SIGNAL_SHARE`
    replaces :data:`NEAR_ZERO_SHARE`. The change of a number without a unit is relative to the
    number itself. A curve over time is interpolated to the time points of ``run``. The change of a
    curve over frequency is the distance that
    :func:`kc2spice.core.curve_distance.compute_curve_distance` returns. The change is infinite if
    ``run`` has no comparable metric.
    """
    share = SMALL_SIGNAL_SHARE if run.is_small_signal else NEAR_ZERO_SHARE
    exact: dict[str, np.ndarray] = {}
    least: dict[str, float] = {}
    for name, item in finer.values.items():
        value = item.astype(float)
        if not value.size or not np.isfinite(value).all():
            continue
        exact[name] = value
        unit = finer.units.get(name, "")
        if unit:
            least[unit] = max(least.get(unit, 0.0), share * float(np.abs(value).max()))
    result = {}
    for name, value in exact.items():
        mine = run.values.get(name)
        scale = max(float(np.abs(value).max()), least.get(finer.units.get(name, ""), 0.0))
        ours, theirs = run.waves.scale.real, finer.waves.scale.real
        if (
            run.is_small_signal
            and mine is not None
            and np.isfinite(mine).all()
            and _is_curve(mine, ours)
            and _is_curve(value, theirs)
        ):
            f, finer_f = ours[-len(mine) :], theirs[-len(value) :]
            result[name] = compute_curve_distance(f, mine, finer_f, value, scale or 1.0)
            continue
        if mine is not None and value.shape == theirs.shape and mine.shape == ours.shape:
            value = interpolate(ours, theirs, value)
        if mine is None or mine.shape != value.shape or not np.isfinite(mine).all():
            result[name] = np.inf
        else:
            apart = float(np.abs(mine.astype(float) - value).max())
            result[name] = apart / scale if scale else 0.0
    return result


def _is_curve(values: np.ndarray, frequency: np.ndarray) -> bool:
    """Return whether an array contains a value for each frequency, or for all except 0 Hz."""
    least = max(frequency.size - 1, 1)
    return values.ndim == 1 and least <= values.size <= frequency.size


# --- an error budget ------------------------------------------------------------------------------


@dataclass(frozen=True)
class RunEstimate:
    """Error estimate of each metric of a run, with the run and its settings.

    ``steps`` are the refinement steps of the settings. The error estimates come from a further,
    finer run. The settings ``unmoved`` could not be refined. ``fixed`` is the part of the largest
    error that the settings ``unmoved`` cause.
    """

    steps: RefinementSteps
    settings: Mapping[str, Any]
    run: Run
    errors: Mapping[str, float] = field(default_factory=dict)
    unmoved: tuple[str, ...] = ()
    fixed: float = 0.0

    @property
    def largest_error(self) -> float:
        """Largest error of all metrics."""
        return max(self.errors.values(), default=math.inf)

    def make_record(self) -> dict[str, Any]:
        """Make the record of a run in ``result.json``: settings and error estimates."""
        return {
            "settings": dict(self.settings),
            "errors": dict(self.errors),
            "unmoved": self.unmoved,
        }


@dataclass(frozen=True)
class ConvergedRun:
    """Final run of the refinement for an error budget, with all error estimates.

    ``shares`` contains, for each setting, the largest estimated error that the setting causes in a
    metric. ``limits`` are the largest number of unknowns and the largest memory [B] of a refined
    mesh.
    """

    final: RunEstimate
    check: Check
    tried: Sequence[RunEstimate]
    shares: Mapping[str, float]
    limits: tuple[float, float]

    @property
    def run(self) -> Run:
        """Final run, with the check of its error estimate."""
        run = self.final.run
        verdict = replace(run.verdict, checks=(*run.verdict.checks, self.check))
        return replace(run, verdict=verdict)

    def make_record(self) -> dict[str, Any]:
        """Make the record of the refinement: the table ``convergence`` of ``result.json``."""
        return {
            "budget": self.check.limit,
            "held": self.check.passed,
            "errors": dict(self.final.errors),
            "shares": dict(self.shares),
            "unmoved": self.final.unmoved,
            "limits": dict(zip(("unknowns", "memory_bytes"), self.limits, strict=True)),
            "tried": list(map(RunEstimate.make_record, self.tried)),
        }


def converge_to_budget(start: Run, clock: StageTimer) -> ConvergedRun | None:
    """Refine the scene until all error estimates are within the error budget.

    The key ``error_budget`` of the scene limits the relative error of every metric. If the scene
    has no ``error_budget``, the key ``checks.reduction`` requests a single error estimate. The
    result is None if the scene has neither ``error_budget`` nor ``checks.reduction``. A warning
    lists refined settings.

    Raises
    ------
    SimulationError : an error estimate exceeds its limit, and ``checks.reduction`` is ``fail``.
    """
    scene, budget = start.build.scene, start.build.scene.error_budget
    action: Action = scene.checks.reduction or ("off" if budget is None else "warn")
    if action == "off":
        return None
    limit = budget or DEFAULT_ERROR_LIMIT
    runs = RefinedRuns(
        start, find_numerical_settings(start.build), clock, finest=find_finest_settings(start.build)
    )
    if limits := list(_describe_limits(runs)):
        clock.progress(ERROR_BUDGET, None, "; ".join(limits))
    tried: list[RunEstimate] = []
    shares: dict[str, float] = {}
    steps: RefinementSteps = {}
    why, last, stalls = "", math.inf, 0
    other = "change the keys that the run refined"
    while True:
        if budget is not None:
            steps = _resolve_edges(runs, steps)
        now = estimate_errors(runs, steps)
        if now is None:
            why = "a refined run failed"
            break
        tried.append(now)
        if now.largest_error <= limit or budget is None:
            break
        if now.fixed > limit:
            if any(setting.mesh for setting in runs.all_settings if setting.name in now.unmoved):
                other = "give a mesh that is finer where its error arises"
            why = _explain_finest_settings(runs, now)
            break
        stalls = stalls + 1 if now.largest_error > CONVERGENCE_RATIO * last else 0
        if stalls == MAX_STALLS:
            why = f"the estimate does not shrink: {last:.2g}, then {now.largest_error:.2g}"
            break
        last = now.largest_error
        moved = _refine_dominant_setting(runs, now, shares, limit)
        if moved is None or not runs.has_runs_left:
            why = (
                "nothing more to refine"
                if runs.has_runs_left
                else f"the error budget is not met after {MAX_RUNS} runs"
            )
            break
        steps = moved
    final = min(tried, key=attrgetter("largest_error"), default=RunEstimate({}, {}, start))
    advice = f"raise error_budget, or {other} ({why})" if why else "raise error_budget"
    worst = max(final.errors, key=final.errors.__getitem__, default="its metrics")
    if why and (spike := _describe_spike(worst, runs.run_cache.values())):
        advice = f"{spike}; {advice}"
    check = Check(
        f"error of {worst}", final.largest_error, limit, "relative, estimated", advice, action
    )
    if final.settings:
        settings = ", ".join(final.settings)
        warn_user(
            f"to reduce its errors to error_budget = {limit:g}, the run refined these settings: "
            f"{settings}; the written deck and models contain the refined settings"
        )
    require_passed((check,), scene.name)
    return ConvergedRun(final, check, tried, shares, runs.mesh_limits)


def _describe_spike(metric: str, runs: Iterable[Run]) -> str:
    """Describe a spike that determines a metric of a transient; empty without a spike.

    The result is empty unless the metric is the maximum, minimum or peak-to-peak value of a
    waveform. A maximum or minimum is a spike if the waveform differs much from it shortly before
    and shortly after, at the distance :data:`SPIKE_WIDTH` times the duration of the run. The time
    of a spike, and its height, differ between runs at random.
    """
    for run in runs:
        probe, waves = run.build.scene.probes.get(metric), run.waves
        if probe is None or probe.take not in ("max", "min", "peak_to_peak"):
            return ""
        if "time" not in waves or probe.of not in waves:
            return ""
        time, wave = waves["time"], waves[probe.of]
        first, last = find_probe_window(probe, run.build.scene) or (-math.inf, math.inf)
        inside = np.flatnonzero((time >= first) & (time <= last))
        if not inside.size:
            return ""
        margin = SPIKE_WIDTH * float(np.ptp(time))
        for k in (inside[wave[inside].argmax()], inside[wave[inside].argmin()]):
            around = np.interp([time[k] - margin, time[k] + margin], time, wave)
            if np.abs(wave[k] - around).min() > SPIKE_SHARE * np.ptp(wave[inside]):
                at, width = format_quantity(time[k], "s", 5), format_quantity(2 * margin, "s", 2)
                return (
                    f"{probe.of} has a spike at {at} that is shorter than {width}, for example "
                    f'caused by an ideal switch: set probes.{metric}.take = "rms", or give the '
                    "switch a gradual transition"
                )
    return ""


def _describe_limits(runs: RefinedRuns) -> Iterator[str]:
    """Yield texts about the largest refined meshes and about long computing times."""
    if any(map(attrgetter("mesh"), runs.refinable)):
        most, memory = runs.mesh_limits
        yield f"meshes are refined up to {_format_size(most, memory)} of memory"
    # all settings are refined together, then each setting alone; a finer run takes twice as long
    elapsed = sum(runs.clock.wall_s.values())
    expected = 2 * elapsed * (1 + len(runs.refinable))
    if expected > LONG_REFINEMENT:
        yield (
            f"at most {MAX_RUNS} refined runs follow, which probably take more than "
            f"{expected:.0f} s"
        )


def _explain_finest_settings(runs: RefinedRuns, now: RunEstimate) -> str:
    """Explain why numerical settings, such as mesh sizes, cannot be refined further.

    The reason explains why an error estimate remains above the error budget.
    """
    if (large := runs.refused) is None:
        return f"{', '.join(now.unmoved)} cannot be refined"
    return f"{large.where}: {large.message}: {large.got}, {large.expected}"


def estimate_errors(runs: RefinedRuns, steps: RefinementSteps) -> RunEstimate | None:
    """Estimate the error of each metric of a run by a finer run.

    ``steps`` are the refinement steps of the run. The result is None if no refined run succeeds. In
    the refined run, all settings are one step finer. If the refined meshes are too large for the
    machine, the meshes remain unchanged. The error of settings at their finest value is estimated
    from coarser runs (:func:`estimate_by_coarser_runs`). The command ``bench``, and runs of scenes
    with an ``error_budget``, report the returned error estimate.
    """
    now = runs.get_refined_run(steps)
    finest = tuple(map(attrgetter("name"), runs.finest))
    meshes = [setting for setting in runs.refinable if setting.model]
    for fixed_settings in ([], meshes) if meshes else ([],):
        finer = _try_finer_run(
            runs, steps, [item for item in runs.refinable if item not in fixed_settings]
        )
        unmoved = (*map(attrgetter("name"), fixed_settings), *finest)
        if finer is not None:
            settings = refine_settings(runs.refinable, steps)
            errors = _estimate_metric_errors(now, finer)
            # errors due to settings that have equal values in the run and in the refined run
            left = estimate_by_coarser_runs(runs, steps, unmoved, errors)
            fixed = max(left.values(), default=0.0)
            errors = {name: error + left[name] for name, error in errors.items()}
            errors = _limit_to_resolution(errors, now)
            return RunEstimate(steps, settings, now, errors, unmoved, fixed)
    return None


def estimate_by_coarser_runs(
    runs: RefinedRuns, steps: RefinementSteps, unmoved: Sequence[str], metrics: Iterable[str]
) -> dict[str, float]:
    """Estimate the metric errors due to settings that cannot be refined further.

    ``unmoved`` contains the names of the settings that cannot be refined further. The estimate is
    the larger of two values: the error estimate of a body's mesh, and the change of the metric in a
    run with a coarser setting. Each refinement step at least halves the error due to a setting. The
    change of a metric between the coarser run and the present run is therefore at least the
    remaining error.
    """
    now = runs.get_refined_run(steps)
    result = dict.fromkeys(metrics, runs.find_largest_mesh_error(unmoved, now))
    for setting in runs.all_settings:
        if setting.name not in unmoved:
            continue
        at = steps.get(setting.name, 0)
        coarser = None
        if setting.refine_keys(at - 1) != setting.refine_keys(at):
            coarser = _try_run(runs, _add_steps(steps, [setting], -1))
        for name, change in (
            compute_metric_changes(coarser, now).items() if coarser is not None else ()
        ):
            if math.isfinite(change):
                result[name] = max(result.get(name, 0.0), change)
    return result


def _resolve_edges(runs: RefinedRuns, steps: RefinementSteps) -> RefinementSteps:
    """Refine the largest time step until the edges of all voltages are resolved.

    The times of unresolved edges differ between runs at random, so the change of a metric in a
    refined run would not be an error estimate. The refinement also ends if the time step cannot be
    refined further, or if a run fails.
    """
    setting = next((item for item in runs.refinable if item.name == MAX_STEP_KEY), None)
    while setting is not None:
        run = runs.get_refined_run(steps)
        edges, _ = find_least_resolved_edges(run.build, run.waves)
        if edges.share <= EDGE_LIMIT:
            break
        at = steps.get(setting.name, 0)
        ratio = edges.sufficient_step / setting.rule.refine(setting.value, at)
        by = _limit_added_steps(setting, at, math.ceil(math.log(ratio, setting.rule.factor)))
        moved = _add_steps(steps, [setting], by)
        if not by or _try_run(runs, moved) is None:
            break
        steps = moved
    return steps


def _limit_added_steps(setting: NumericalSetting, at: float, most: int) -> int:
    """Limit the added refinement steps, so that one further step remains possible.

    The result is the largest such number up to ``most``, or 0. ``at`` is the present number of
    refinement steps.
    """
    for by in range(most, 0, -1):
        if setting.refine_keys(at + by) != setting.refine_keys(at + by + 1):
            return by
    return 0


def _refine_dominant_setting(
    runs: RefinedRuns, now: RunEstimate, shares: dict[str, float], limit: float
) -> RefinementSteps | None:
    """Refine the setting that changes the metrics most, by several steps if necessary.

    ``shares`` contains, for each setting, the largest estimated error that it causes in a metric.
    The function adds missing entries to ``shares``, and deletes the entry of the refined setting.
    The result is None if no setting can be refined.
    """
    for setting in runs.refinable:
        if setting.name not in shares and setting.name not in now.unmoved:
            alone = _try_run(runs, _add_steps(now.steps, [setting]))
            if alone is not None:
                shares[setting.name] = max(
                    _estimate_metric_errors(now.run, alone).values(), default=0.0
                )
    if MAX_STEP_KEY in shares and runs.has_unmodelled_parts and max(shares.values()) <= limit:
        # pulses between two time points are missed even if the step is one refinement step finer
        shares[MAX_STEP_KEY] = now.largest_error
    for setting in sorted(
        runs.refinable, key=lambda setting: shares.get(setting.name, -1.0), reverse=True
    ):
        if setting.name not in shares:
            continue
        far = int(math.log(max(shares[setting.name] / limit, 1.0)) / math.log(MAX_STEP_GAIN))
        most = 1 if setting.model else min(max(far, 1), MAX_ADDED_STEPS)
        at = now.steps.get(setting.name, 0)
        by = _limit_added_steps(setting, at, most)
        if not by:
            # The setting has its finest value; refining other settings does not reduce its error.
            return None
        moved = _add_steps(now.steps, [setting], by)
        if _try_run(runs, moved) is not None:
            del shares[setting.name]
            return moved
    return None


def _add_steps(
    steps: RefinementSteps, moved: Sequence[NumericalSetting], by: int = 1
) -> RefinementSteps:
    """Add refinement steps to some settings, and return the steps of all settings.

    Each setting in ``moved`` gets ``by`` additional refinement steps.
    """
    return {**steps, **{setting.name: steps.get(setting.name, 0) + by for setting in moved}}


def _try_run(runs: RefinedRuns, steps: RefinementSteps) -> Run | None:
    """Run refined settings; return None if the run fails or no further run is allowed."""
    try:
        return runs.get_refined_run(steps) if runs.has_runs_left else None
    except (SimulationError, UsageError):
        return None


def _try_finer_run(
    runs: RefinedRuns, steps: RefinementSteps, moved: Sequence[NumericalSetting]
) -> Run | None:
    """Run a scene with some settings one step finer; return None if the run fails.

    If the scene contains a part without equations, such as a user's netlist, the largest time step
    is :data:`EDGE_REFINEMENT` steps finer.
    """
    finer = dict(_add_steps(steps, moved))
    if runs.has_unmodelled_parts and any(setting.name == MAX_STEP_KEY for setting in moved):
        finer[MAX_STEP_KEY] += EDGE_REFINEMENT - 1
    return _try_run(runs, finer)


def _limit_to_resolution(errors: Mapping[str, float], run: Run) -> dict[str, float]:
    """Return error estimates that are at least the relative resolution of each metric.

    The resolution of a metric between two points of a sweep is half of the sweep step.
    """
    result = dict(errors)
    for name, resolution in run.metric_resolutions.items():
        if name in result and run.values[name].any():
            least = resolution / float(np.abs(run.values[name]).max())
            result[name] = max(result[name], least)
    return result


def _estimate_metric_errors(run: Run, finer: Run) -> dict[str, float]:
    """Estimate the error of each metric from its change in a finer run."""
    return {
        name: REMAINDER_FACTOR * change
        for name, change in compute_metric_changes(run, finer).items()
    }
