"""Error and CPU time of a scene for various and for recommended settings.

``bench`` runs the scene unchanged, with one numerical setting changed at a time
(:mod:`kc2spice.scene.numerical_settings`), and with all settings finer. A search changes one
setting of the fastest combination at a time. The search finds the fastest settings whose error is
within the error limit. The search also finds the fastest settings that are at least as accurate as
the unchanged scene.

Errors are relative to a reference run, in which every setting has its finest value. A second,
coarser run shows how well the reference run has converged. If the scene sets a key to its finest
value, such as a ``reltol`` of 1e-7, there is no finer run. If a key has no finer value, the error
of the reference run is estimated from a run with a coarser value of the key. The estimated errors
of the reference run are added to the errors of all combinations of settings. For the unchanged
scene, ``bench`` also computes the same error estimate as a run with an ``error_budget``.

Times are medians of the simulator's CPU time. Each round of the time measurement runs all settings,
so that a temporary slowdown of the machine affects all settings equally.

The errors caused by two settings may cancel by chance. The error limit therefore applies to two
errors of each combination of settings: its measured error, and the sum of the errors that each
setting causes alone. The sum of the errors is::

    bound = sum_k max_{v at least as fine as v_k} |m(own, k = v) - m(own, k = finest)| / |m(own)|

where m(own) is the metric with the scene's own settings, m(own, k = v) the metric if only the key k
has another value v, and v_k the value of k in the combination.
"""

from __future__ import annotations

import statistics
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import filterfalse
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError, UsageError, unknown
from kc2spice.core.files import stage_directory
from kc2spice.core.progress import Progress, StageTimer, ignore_progress
from kc2spice.core.waveforms import write_record
from kc2spice.report.bench_page import write_bench
from kc2spice.scene.numerical_settings import (
    NumericalSetting,
    find_finest_settings,
    find_numerical_settings,
    refine_settings,
)
from kc2spice.scene.scene_classes import Scene
from kc2spice.sim.ngspice import find_ngspice
from kc2spice.workflow import settings_refinement
from kc2spice.workflow.settings_refinement import RefinedRuns, compute_metric_changes
from kc2spice.workflow.simulation import Run

DEFAULT_ERROR_LIMIT = 1e-4
# Numbers of refinement steps that the search tries for each numerical setting, from coarse to fine.
REFINEMENT_STEPS = (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0)
# number of steps by which the run that checks the reference run refines each numerical setting
CHECK_STEPS = 1.5
REFERENCE_STEPS = 2.0  # number of steps by which the reference run refines each numerical setting
MAX_POINTS = 80  # largest number of combinations of settings that the search runs
MAX_METRIC_CHANGE = 1e-2  # largest relative change of a converged metric at the finest settings
# CPU time, relative to the unchanged scene, above which settings are timed only once.
SLOW_TIME_RATIO = 5.0
# Largest permitted ratio of two CPU times that count as equal. Of equally fast settings, the more
# accurate settings are chosen.
EQUAL_TIME_RATIO = 1.05

# number of refinement steps of each numerical setting; negative numbers make a setting coarser
Combination = tuple[float, ...]
Errors = dict[str, float]  # error of each metric


@dataclass
class _TimedRun:
    """Combination of settings with its run, metric errors, and measured CPU times [s]."""

    combination: Combination
    settings: dict[str, Any]
    run: Run
    errors: Errors
    times: list[float]

    @property
    def largest_error(self) -> float:
        """Largest error among all metrics of this run."""
        return max(self.errors.values())

    @property
    def median_time(self) -> float:
        """Median of the CPU times [s]."""
        return statistics.median(self.times)

    def dominates(self, other: _TimedRun) -> bool:
        """Return whether these settings Pareto-dominate others in error and CPU time.

        The combination is better in error or time, and worse in neither.
        """
        ours, theirs = (
            (self.largest_error, self.median_time),
            (other.largest_error, other.median_time),
        )
        return ours != theirs and ours[0] <= theirs[0] and ours[1] <= theirs[1]


class _SettingSearch:
    """Search for fast and accurate combinations of the numerical settings of a scene.

    Each combination of settings is one run of the scene. ``points`` contains the successful runs,
    and ``failed`` contains the failed runs. The keys of ``points`` and ``failed`` are labels that
    list the settings of a run. ``names`` are the metrics whose errors are compared.
    """

    def __init__(self, run: Run) -> None:
        finer, finest = find_numerical_settings(run.build), find_finest_settings(run.build)
        # A finer mesh does not change the CPU time of the simulator.
        self.varied_settings = list(filterfalse(attrgetter("model"), (*finer, *finest)))
        self.finest = [setting.name for setting in finest if not setting.model]
        self.runs = RefinedRuns(run, finer, StageTimer(), finest=finest, retries=0, most=np.inf)
        self.points: dict[str, _TimedRun] = {}
        self.failed: dict[str, dict[str, Any]] = {}
        self.names: tuple[str, ...] = ()
        self.errors_by_setting: dict[tuple[str, float], Errors] = {}
        if not self.varied_settings:
            raise UsageError(
                "this scene has no setting that bench can vary, such as a time step or a tolerance",
                where=f"bench {run.build.scene.name}",
            )

    def get_steps_by_setting(self, combination: Combination) -> dict[str, float]:
        """Return the refinement steps of a combination of settings, keyed by setting name."""
        return dict(zip(map(attrgetter("name"), self.varied_settings), combination, strict=True))

    def run_uniform_refinement(self, steps: float) -> Run:
        """Run the scene with every setting refined by the same number of steps."""
        return self.runs.get_refined_run(
            self.get_steps_by_setting((steps,) * len(self.varied_settings))
        )

    @cached_property
    def errors_of_finest_settings(self) -> Errors:
        """Errors of the metrics due to the finest settings, estimated by coarser runs.

        The finest settings are the settings that cannot be refined further.
        """
        return settings_refinement.estimate_by_coarser_runs(self.runs, {}, self.finest, self.names)

    def estimate_error(self) -> dict[str, Any] | None:
        """Estimate the metric errors of the scene with its present settings."""
        result = settings_refinement.estimate_errors(self.runs, {})
        if result is None:
            return None
        errors = {name: error for name, error in result.errors.items() if name in self.names}
        return {"error": max(errors.values(), default=0.0), "errors": errors}

    def run_setting(self, combination: Combination) -> None:
        """Run the scene with a combination of settings, unless it has already run."""
        settings = refine_settings(self.varied_settings, self.get_steps_by_setting(combination))
        label = _describe_settings(settings)
        if label in self.points or label in self.failed:
            return
        try:
            run = self.runs.get_refined_run(self.get_steps_by_setting(combination))
            errors = compute_metric_errors(
                run, self.run_uniform_refinement(REFERENCE_STEPS), self.names
            )
            errors = {
                name: error + self.errors_of_finest_settings[name] for name, error in errors.items()
            }
        except (SimulationError, UsageError) as error:
            why = " ".join(f"{error.message} {error.got or ''}".split())
            self.failed[label] = {"label": label, "settings": settings, "why": why}
        else:
            self.points[label] = _TimedRun(combination, settings, run, errors, [run.cpu_s])

    def compute_setting_errors(self, setting: NumericalSetting, steps: float) -> Errors:
        """Return the error of each metric due to one value of a setting.

        All other settings have the values of the unchanged scene. If a finer value of the setting
        has a larger error in a metric, the coarser value also gets the larger error.
        """
        if (setting.name, steps) not in self.errors_by_setting:
            finer = REFINEMENT_STEPS[bisect_right(REFINEMENT_STEPS, steps) :]
            result = (
                self.compute_setting_errors(setting, finer[0])
                if finer
                else dict.fromkeys(self.names, 0.0)
            )
            change = dict.fromkeys(self.names, np.inf)
            if (
                point := self.points.get(_describe_settings(setting.refine_keys(steps)))
            ) is not None:
                reference = self.runs.get_refined_run({setting.name: REFERENCE_STEPS})
                change = compute_metric_errors(point.run, reference, self.names)
            self.errors_by_setting[setting.name, steps] = {
                n: max(result[n], change[n]) for n in self.names
            }
        return self.errors_by_setting[setting.name, steps]

    def compute_error_bound(self, point: _TimedRun) -> float:
        """Return the error bound of a combination of settings: the sum of their errors.

        Each term of the sum is the error due to one setting of the combination, while all other
        settings are unchanged. The sum is computed for each metric, and the result is the largest
        sum.
        """
        errors = [
            *map(self.compute_setting_errors, self.varied_settings, point.combination),
            self.errors_of_finest_settings,
        ]
        return max(sum(map(itemgetter(name), errors)) for name in self.names)

    def compute_larger_error(self, point: _TimedRun) -> float:
        """Return the larger of two values: a run's measured error and its error bound."""
        return max(point.largest_error, self.compute_error_bound(point))

    def find_fastest(self, limit: float) -> _TimedRun | None:
        """Return the fastest combination of settings within an error limit, or None.

        Of several equally fast combinations, return the most accurate one.
        """
        accurate = [
            point for point in self.points.values() if self.compute_larger_error(point) <= limit
        ]
        least = min(map(attrgetter("median_time"), accurate), default=0.0)
        fastest = [point for point in accurate if point.median_time <= EQUAL_TIME_RATIO * least]
        return min(fastest, key=self.compute_larger_error, default=None)

    def run_combinations(self, limit: float, progress: Progress) -> None:
        """Run simple combinations of settings, then search for the fastest combinations.

        In a simple combination, only one setting is changed, or all settings are refined equally.
        Two searches follow: one accepts errors up to ``limit``, and the other accepts errors up to
        the error of the unchanged scene.
        """
        origin = (0.0,) * len(self.varied_settings)
        combinations = [origin]
        for number in range(len(origin)):
            combinations += map(partial(_with_steps, origin, number), REFINEMENT_STEPS)
        combinations += [(n,) * len(origin) for n in REFINEMENT_STEPS if n > 0]
        for done, combination in enumerate(combinations):
            progress("settings", done / len(combinations), f"{done} of {len(combinations)}")
            self.run_setting(combination)
            if failed := self.failed.get(_describe_settings({})):
                raise SimulationError(
                    "the run with the scene's settings is not comparable with the reference run",
                    where="bench",
                    got=failed["why"],
                )
        for bound in sorted(
            {limit, self.compute_larger_error(self.points[_describe_settings({})])}
        ):
            self._search_neighbours(bound, progress)

    def _search_neighbours(self, limit: float, progress: Progress) -> None:
        """Make settings of the fastest combination coarser, until no run is faster.

        If the error of no combination of settings is within ``limit``, make settings of the most
        accurate combination finer instead.
        """
        known = 0
        while known < (count := len(self.points) + len(self.failed)) < MAX_POINTS:
            known = count
            start = self.find_fastest(limit)
            direction = 1 if start is None else -1
            start = start or min(self.points.values(), key=self.compute_larger_error)
            progress("search", None, f"{known} settings, now {_describe_settings(start.settings)}")
            for number, steps in enumerate(start.combination):
                neighbour = REFINEMENT_STEPS.index(steps) + direction
                if 0 <= neighbour < len(REFINEMENT_STEPS):
                    self.run_setting(
                        _with_steps(start.combination, number, REFINEMENT_STEPS[neighbour])
                    )

    def measure_times(self, repeats: int, progress: Progress) -> None:
        """Measure CPU times by repeated runs; skip slow combinations of settings."""
        longest = SLOW_TIME_RATIO * self.points[_describe_settings({})].median_time
        repeated = [point for point in self.points.values() if point.median_time <= longest]
        for turn in range(1, repeats):
            progress("times", turn / repeats, f"round {turn} of {repeats - 1}")
            for point in repeated:
                point.times.append(settings_refinement.repeat_timing(point.run))

    def make_record(self, point: _TimedRun) -> dict[str, Any]:
        """Return the row of a combination of settings in ``bench.json``."""
        return {
            "label": _describe_settings(point.settings),
            "settings": point.settings,
            "error": point.largest_error,
            "bound": self.compute_error_bound(point),
            "time_s": point.median_time,
            "front": not any(other.dominates(point) for other in self.points.values()),
            "own": not point.settings,
            "errors": point.errors,
            "time_low_s": min(point.times),
            "time_high_s": max(point.times),
            "repeats": len(point.times),
        }


def _with_steps(combination: Combination, number: int, steps: float) -> Combination:
    """Replace the number of refinement steps of one setting in a combination."""
    return (*combination[:number], steps, *combination[number + 1 :])


def bench(
    scene: Scene,
    out: Path,
    *,
    error: float = DEFAULT_ERROR_LIMIT,
    metric: Sequence[str] = (),
    repeats: int = 5,
    trust: bool = False,
    progress: Progress = ignore_progress,
) -> dict[str, Any]:
    """Measure error and CPU time of a scene for various numerical settings.

    The files ``bench.json`` and ``bench.html`` are written into ``out``. The result is the content
    of ``bench.json``. The error of a combination of settings is the largest relative error of the
    metrics named in ``metric``. By default, ``metric`` is the value of the key ``bench.metric``. If
    ``bench.metric`` is not set, ``bench`` uses each metric that is a single number and changes by
    at most :data:`MAX_METRIC_CHANGE` between the two finest runs.

    Raises
    ------
    UsageError : a metric is unknown, or the scene has no numerical settings.
    SimulationError : the run of the unchanged scene, or the reference run, fails.
    MissingToolError : ngspice is missing.
    """
    simulator = find_ngspice()
    with stage_directory(out) as work:
        progress("models", None, "unmodified scene")
        run = settings_refinement.evaluate_scene(scene, StageTimer(), trust=trust, retries=0)
        search, requested = _SettingSearch(run), metric or scene.bench.metric
        selected = _select_metrics(run, requested)
        progress("reference", None, "all settings at their finest")
        check = _measure_convergence(search, selected, keep_all=bool(requested))
        search.run_combinations(error, progress)
        search.measure_times(repeats, progress)
        progress("estimate", None, "all settings and meshes one step finer")
        finest = refine_settings(
            search.varied_settings,
            search.get_steps_by_setting((REFERENCE_STEPS,) * len(search.varied_settings)),
        )
        best = search.find_fastest(error)
        points = sorted(search.points.values(), key=attrgetter("median_time"))
        record = {
            "scene": scene.name,
            "simulator": f"{simulator.name} {simulator.version}",
            "limit": error,
            "repeats": repeats,
            "metrics": search.names,
            "left_out": {name: check.get(name) for name in selected if name not in search.names},
            "points": list(map(search.make_record, points)),  # the fastest first
            "failed": list(search.failed.values()),
            "recommended": best
            and {**search.make_record(best), "set": _format_set_options(best.settings)},
            "reference": {
                "label": _describe_settings(finest),
                "settings": finest,
                "time_s": search.run_uniform_refinement(REFERENCE_STEPS).cpu_s,
                "error": max(
                    check[name] + search.errors_of_finest_settings[name] for name in search.names
                ),
            },
            "estimate": search.estimate_error(),
        }
        write_bench(work, scene.title or scene.name, record)
        return write_record(record, work, "bench.json")


def _select_metrics(run: Run, names: Sequence[str]) -> tuple[str, ...]:
    """Return the metrics with the given names or prefixes; by default, all scalars.

    Without ``names``, the result is all metrics that are single numbers, or all curves if no metric
    is a single number.

    Raises
    ------
    UsageError : at least one of the ``names`` is not a metric of the scene.
    """
    result: list[str] = []
    for name in names:
        hits = [known for known in run.values if known == name or known.startswith(f"{name}.")]
        if not hits:
            raise unknown("this scene has no such metric", name, run.values, "--metric")
        result += hits
    numbers = {name: v for name, v in run.values.items() if v.dtype.kind != "b"}
    scalars = [name for name, v in numbers.items() if v.ndim == 0]
    return tuple(dict.fromkeys(result or scalars or numbers))


def _measure_convergence(
    search: _SettingSearch, selected: Sequence[str], *, keep_all: bool
) -> Errors:
    """Return the change of each selected metric between the two finest settings.

    The names of the metrics that converge are stored in ``search.names``. With ``keep_all``,
    metrics that do not converge are also included.

    Raises
    ------
    SimulationError : no metric converges.
    """
    start, finer, exact = map(search.run_uniform_refinement, (0.0, CHECK_STEPS, REFERENCE_STEPS))
    moved, changed = compute_metric_changes(finer, exact), compute_metric_changes(start, exact)
    present = []
    for name in selected:
        comparable = name in moved and max(moved[name], changed[name]) < np.inf
        if comparable and exact.values[name].any():
            present.append(name)
    check = compute_metric_errors(finer, exact, present)
    search.names = tuple(name for name in check if keep_all or check[name] <= MAX_METRIC_CHANGE)
    if not search.names:
        raise SimulationError(
            "no metric converges",
            where=f"bench {start.build.scene.name}",
            got=", ".join(f"{n} changes by {v:.1e}" for n, v in check.items()) or None,
            expected=f"at most {MAX_METRIC_CHANGE:g} between the two finest settings",
            hint="select another metric with --metric",
        )
    return check


def compute_metric_errors(run: Run, exact: Run, names: Sequence[str]) -> Errors:
    """Return the relative error of each metric of a run against a reference run.

    ``names`` are the compared metrics.

    Raises
    ------
    SimulationError : a metric is missing, or a metric with the value true or false has changed.
    """
    for name, value in exact.values.items():
        run_value = run.values.get(name)
        compared = np.nan if run_value is None else run_value
        if value.dtype.kind == "b" and not np.array_equal(compared, value):
            raise SimulationError(
                f"the metric {name} is {run_value} in this run, but {value} in the reference run "
                "with the finest settings, so this run is not comparable"
            )
    result = compute_metric_changes(run, exact)
    for name in names:
        if result[name] == np.inf:
            raise SimulationError(f"the result has no metric {name}")
    return {name: result[name] for name in names}


def _format_set_options(settings: Mapping[str, Any]) -> list[str]:
    """Return the command-line options that set the changed settings."""
    options = []
    for key, value in settings.items():
        text = value if isinstance(value, str) else repr(value)
        options += ["--set", f"{key}={text}"]
    return options


def _describe_settings(settings: Mapping[str, Any]) -> str:
    """Return a text that describes changed settings."""
    words = (f"{key} {_format_setting(value)}" for key, value in settings.items())
    return ", ".join(words) or "unmodified scene"


def _format_setting(value: Any) -> str:
    """Return the value of a setting as text; the value is a number, range or string."""
    if isinstance(value, list):
        return "…".join(map("{:g}".format, value))
    return value if isinstance(value, str) else f"{value:g}"
