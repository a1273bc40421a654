"""Error and CPU time of a scene for various numerical settings, and a recommendation.

The axes are the settings of :mod:`kc2spice.scene.numerical_settings`. The scene runs unchanged,
with each single axis changed, and with all axes finer. The search then follows the axes to the
cheapest settings within the error limit, and within the error of the unchanged scene.

Errors are relative to a reference run with every axis at its finest value. A second, coarser run
shows how well the reference has converged. A key that the scene sets to its finest value, such as
a ``reltol`` of 1e-7, has no finer run. The change by a coarser value is then part of every error.
The unchanged scene also has the error estimate of an ``error_budget``.

Times are medians of the simulator's CPU time. Each round runs all settings, so that a slower
machine affects all settings equally.

Errors of two keys may cancel by chance. A setting is therefore within the limit only if the sum of
the errors of its single values is also within the limit::

    bound = sum_k max_{v at least as fine as v_k} |m(own, k = v) - m(own, k = finest)| / |m|
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
from kc2spice.core.progress import Clock, Progress, ignore_progress
from kc2spice.core.waveforms import write_record
from kc2spice.report.bench_page import write_bench
from kc2spice.scene.model import Scene
from kc2spice.scene.numerical_settings import (
    NumericalSetting,
    find_finest_settings,
    find_numerical_settings,
    refine_settings,
)
from kc2spice.sim.ngspice import find_ngspice
from kc2spice.workflow import refine
from kc2spice.workflow.refine import Runs, metric_changes
from kc2spice.workflow.simulate import Run

DEFAULT_ERROR_LIMIT = 1e-4
# refinement steps of each axis, coarse to fine
REFINEMENT_NOTCHES = (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0)
# notches of the run that checks the reference, and of the reference
CHECK_NOTCHES = 1.5
REFERENCE_NOTCHES = 2.0
MAX_POINTS = 80
MAX_METRIC_CHANGE = 1e-2  # largest relative change of a converged metric at the finest settings
# CPU time relative to the scene's settings; slower settings are timed only once
SLOW_TIME_RATIO = 5.0
EQUAL_TIME_RATIO = 1.05  # ratio of CPU times that count as equal in the choice between two errors

Place = tuple[float, ...]  # setting, as the notches of each axis
Errors = dict[str, float]  # error of each metric


@dataclass
class _TimedSetting:
    """Setting with its run, the errors of the metrics, and the CPU time [s] of each run."""

    place: Place
    settings: dict[str, Any]
    run: Run
    errors: Errors
    times: list[float]

    @property
    def error(self) -> float:
        """Largest error of the metrics."""
        return max(self.errors.values())

    @property
    def time(self) -> float:
        """Median of the CPU times [s]."""
        return statistics.median(self.times)

    def dominates(self, other: _TimedSetting) -> bool:
        """Return whether this point is better in error or time, and worse in neither."""
        ours, theirs = (self.error, self.time), (other.error, other.time)
        return ours != theirs and ours[0] <= theirs[0] and ours[1] <= theirs[1]


class _Plane:
    """All runs of a scene, keyed by the labels of their settings.

    ``names`` are the metrics whose error counts.
    """

    def __init__(self, run: Run) -> None:
        finer, finest = find_numerical_settings(run.build), find_finest_settings(run.build)
        # a finer mesh takes no time in the simulator
        self.axes = list(filterfalse(attrgetter("model"), (*finer, *finest)))
        self.finest = [axis.name for axis in finest if not axis.model]
        self.runs = Runs(run, finer, Clock(), finest=finest, retries=0, most=np.inf)
        self.points: dict[str, _TimedSetting] = {}
        self.failed: dict[str, dict[str, Any]] = {}
        self.names: tuple[str, ...] = ()
        self.known: dict[tuple[str, float], Errors] = {}
        if not self.axes:
            where = f"bench {run.build.scene.name}"
            raise UsageError("this scene has no numerical setting to vary", where=where)

    def notches(self, place: Place) -> dict[str, float]:
        """Notches of each axis, keyed by its name."""
        return dict(zip(map(attrgetter("name"), self.axes), place, strict=True))

    def run_all_at(self, notch: float) -> Run:
        """Return the run with every axis at the same notch."""
        return self.runs.run_at(self.notches((notch,) * len(self.axes)))

    @cached_property
    def unrefined_errors(self) -> Errors:
        """Error of each metric due to settings that have their finest value in all runs."""
        return refine.estimate_by_coarser_runs(self.runs, {}, self.finest, self.names)

    def estimate(self) -> dict[str, Any] | None:
        """Return the error estimate of the unchanged scene, with its meshes and tables."""
        result = refine.estimate_errors(self.runs, {})
        if result is None:
            return None
        errors = {name: error for name, error in result.errors.items() if name in self.names}
        return {"error": max(errors.values(), default=0.0), "errors": errors}

    def run_setting(self, place: Place) -> None:
        """Run a setting, unless it has run before."""
        settings = refine_settings(self.axes, self.notches(place))
        label = _describe_settings(settings)
        if label in self.points or label in self.failed:
            return
        try:
            run = self.runs.run_at(self.notches(place))
            errors = run_errors(run, self.run_all_at(REFERENCE_NOTCHES), self.names)
            errors = {name: error + self.unrefined_errors[name] for name, error in errors.items()}
        except (SimulationError, UsageError) as error:
            why = " ".join(f"{error.message} {error.got or ''}".split())
            self.failed[label] = {"label": label, "settings": settings, "why": why}
        else:
            self.points[label] = _TimedSetting(place, settings, run, errors, [run.cpu_s])

    def axis_errors(self, axis: NumericalSetting, notch: float) -> Errors:
        """Return the errors that one value of an axis causes while all others are unchanged.

        A value has at least the errors of every finer value.
        """
        if (axis.name, notch) not in self.known:
            finer = REFINEMENT_NOTCHES[bisect_right(REFINEMENT_NOTCHES, notch) :]
            result = self.axis_errors(axis, finer[0]) if finer else dict.fromkeys(self.names, 0.0)
            change = dict.fromkeys(self.names, np.inf)
            if (point := self.points.get(_describe_settings(axis.refined_keys(notch)))) is not None:
                reference = self.runs.run_at({axis.name: REFERENCE_NOTCHES})
                change = run_errors(point.run, reference, self.names)
            self.known[axis.name, notch] = {n: max(result[n], change[n]) for n in self.names}
        return self.known[axis.name, notch]

    def error_bound(self, point: _TimedSetting) -> float:
        """Return the largest sum of the errors that each value of a setting causes alone."""
        errors = [*map(self.axis_errors, self.axes, point.place), self.unrefined_errors]
        return max(sum(map(itemgetter(name), errors)) for name in self.names)

    def safe_error(self, point: _TimedSetting) -> float:
        """Return the error of a setting, or its bound if errors of its values cancel."""
        return max(point.error, self.error_bound(point))

    def find_cheapest(self, limit: float) -> _TimedSetting | None:
        """Return the fastest setting within ``limit``; among equally fast settings, the most
        accurate."""
        accurate = [point for point in self.points.values() if self.safe_error(point) <= limit]
        least = min(map(attrgetter("time"), accurate), default=0.0)
        fastest = [point for point in accurate if point.time <= EQUAL_TIME_RATIO * least]
        return min(fastest, key=self.safe_error, default=None)

    def search(self, limit: float, progress: Progress) -> None:
        """Run settings with one changed axis, then search the cheapest settings within two limits.

        The limits are ``limit`` and the error of the unchanged scene.
        """
        origin = (0.0,) * len(self.axes)
        star = [origin]
        for axis in range(len(origin)):
            star += map(partial(_with_notch, origin, axis), REFINEMENT_NOTCHES)
        star += [(n,) * len(origin) for n in REFINEMENT_NOTCHES if n > 0]
        for done, place in enumerate(star):
            progress("settings", done / len(star), f"{done} of {len(star)}")
            self.run_setting(place)
            if failed := self.failed.get(_describe_settings({})):
                raise SimulationError(
                    "the run with the settings of the scene differs from the reference run",
                    where="bench",
                    got=failed["why"],
                )
        for bound in sorted({limit, self.safe_error(self.points[_describe_settings({})])}):
            self._search_neighbours(bound, progress)

    def _search_neighbours(self, limit: float, progress: Progress) -> None:
        """Run the coarser neighbours of the cheapest setting until no cheaper one is found.

        If no setting is within ``limit``, run the finer neighbours of the most accurate one.
        """
        known = 0
        while known < (count := len(self.points) + len(self.failed)) < MAX_POINTS:
            known = count
            start = self.find_cheapest(limit)
            step = 1 if start is None else -1
            start = start or min(self.points.values(), key=self.safe_error)
            progress("search", None, f"{known} settings, now {_describe_settings(start.settings)}")
            for k, notch in enumerate(start.place):
                neighbour = REFINEMENT_NOTCHES.index(notch) + step
                if 0 <= neighbour < len(REFINEMENT_NOTCHES):
                    self.run_setting(_with_notch(start.place, k, REFINEMENT_NOTCHES[neighbour]))

    def measure_times(self, repeats: int, progress: Progress) -> None:
        """Repeat the runs of all settings except slow ones, in rounds."""
        longest = SLOW_TIME_RATIO * self.points[_describe_settings({})].time
        repeated = [point for point in self.points.values() if point.time <= longest]
        for turn in range(1, repeats):
            progress("times", turn / repeats, f"round {turn} of {repeats - 1}")
            for point in repeated:
                point.times.append(refine.repeat_timing(point.run))

    def record(self, point: _TimedSetting) -> dict[str, Any]:
        """Return the row of a setting in ``bench.json``."""
        return {
            "label": _describe_settings(point.settings),
            "settings": point.settings,
            "error": point.error,
            "bound": self.error_bound(point),
            "time_s": point.time,
            "front": not any(other.dominates(point) for other in self.points.values()),
            "own": not point.settings,
            "errors": point.errors,
            "time_low_s": min(point.times),
            "time_high_s": max(point.times),
            "repeats": len(point.times),
        }


def _with_notch(place: Place, axis: int, notch: float) -> Place:
    """Return a setting with one axis at ``notch``."""
    return (*place[:axis], notch, *place[axis + 1 :])


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
    """Measure error and time of ``scene`` and write ``bench.json`` and ``bench.html`` into ``out``.

    Returns the record. The error of a setting is the largest relative error of the metrics
    ``metric``. By default, the metrics are those of the key ``bench.metric``; without this key, all
    scalars that converge.

    Raises
    ------
    UsageError : an unknown metric, or a scene without numerical settings.
    SimulationError : the unchanged scene, or its reference, does not run.
    MissingToolError : no ngspice.
    """
    simulator = find_ngspice()
    with stage_directory(out) as work:
        progress("models", None, "the scene as it is")
        run = refine.evaluate_scene(scene, Clock(), trust=trust, retries=0)
        plane, requested = _Plane(run), metric or scene.bench.metric
        selected = _select_metrics(run, requested)
        progress("reference", None, "all settings at their finest")
        check = _measure_convergence(plane, selected, keep_all=bool(requested))
        plane.search(error, progress)
        plane.measure_times(repeats, progress)
        progress("estimate", None, "all settings and meshes a notch finer")
        finest = refine_settings(plane.axes, plane.notches((REFERENCE_NOTCHES,) * len(plane.axes)))
        best = plane.find_cheapest(error)
        points = sorted(plane.points.values(), key=attrgetter("time"))
        record = {
            "scene": scene.name,
            "simulator": f"{simulator.name} {simulator.version}",
            "limit": error,
            "repeats": repeats,
            "metrics": plane.names,
            "left_out": {name: check.get(name) for name in selected if name not in plane.names},
            "points": list(map(plane.record, points)),  # the quickest first
            "failed": list(plane.failed.values()),
            "recommended": best and {**plane.record(best), "set": _set_options(best.settings)},
            "reference": {
                "label": _describe_settings(finest),
                "settings": finest,
                "time_s": plane.run_all_at(REFERENCE_NOTCHES).cpu_s,
                "error": max(check[name] + plane.unrefined_errors[name] for name in plane.names),
            },
            "estimate": plane.estimate(),
        }
        write_bench(work, scene.title or scene.name, record)
        return write_record(record, work, "bench.json")


def _select_metrics(run: Run, names: Sequence[str]) -> tuple[str, ...]:
    """Return the metrics of ``run`` with these names, or whose names begin with them and a dot.

    Without names these are all scalars that are numbers; if there are none, all curves.

    Raises
    ------
    UsageError : a metric that the scene does not have.
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


def _measure_convergence(plane: _Plane, selected: Sequence[str], *, keep_all: bool) -> Errors:
    """Return the change of each selected metric at the finest settings.

    The metrics that converge become the ``names`` of the plane; with ``keep_all``, all do.

    Raises
    ------
    SimulationError : none converges.
    """
    start, finer, exact = map(plane.run_all_at, (0.0, CHECK_NOTCHES, REFERENCE_NOTCHES))
    moved, changed = metric_changes(finer, exact), metric_changes(start, exact)
    present = []
    for name in selected:
        comparable = name in moved and max(moved[name], changed[name]) < np.inf
        if comparable and exact.values[name].any():
            present.append(name)
    check = run_errors(finer, exact, present)
    plane.names = tuple(name for name in check if keep_all or check[name] <= MAX_METRIC_CHANGE)
    if not plane.names:
        raise SimulationError(
            "no metric converges",
            where=f"bench {start.build.scene.name}",
            got=", ".join(f"{n} changes by {v:.1e}" for n, v in check.items()) or None,
            expected=f"at most {MAX_METRIC_CHANGE:g} between the two finest settings",
            hint="select another metric with --metric",
        )
    return check


def run_errors(run: Run, exact: Run, names: Sequence[str]) -> Errors:
    """Return the relative error of each of the metrics ``names``.

    Raises
    ------
    SimulationError : a metric is missing, or a metric that is true or false has changed.
    """
    for name, value in exact.values.items():
        ours = run.values.get(name)
        if value.dtype.kind == "b" and not np.array_equal(np.nan if ours is None else ours, value):
            raise SimulationError(
                f"the metric {name} is {ours}, but {value} with the finest settings"
            )
    result = metric_changes(run, exact)
    for name in names:
        if result[name] == np.inf:
            raise SimulationError(f"the result has no metric {name}")
    return {name: result[name] for name in names}


def _set_options(settings: Mapping[str, Any]) -> list[str]:
    """Return the options of the command line that change these settings."""
    options = []
    for key, value in settings.items():
        text = value if isinstance(value, str) else repr(value)
        options += ["--set", f"{key}={text}"]
    return options


def _describe_settings(settings: Mapping[str, Any]) -> str:
    """Return changed settings in words."""
    words = (f"{key} {_format_setting(value)}" for key, value in settings.items())
    return ", ".join(words) or "as it is"


def _format_setting(value: Any) -> str:
    """Return a number, a range or a word as text."""
    if isinstance(value, list):
        return "…".join(map("{:g}".format, value))
    return value if isinstance(value, str) else f"{value:g}"
