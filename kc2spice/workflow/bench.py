"""``bench SCENE``: error against time over its settings, the front of the best, what to use.

The scene is run as it is, with one axis (:mod:`kc2spice.scene.axes`) moved at a time, with all of
them finer, and from there along the axes towards the cheapest setting within the wanted error, and
within the scene's own. Errors are against a run with every axis at its finest; a second, less fine
one tells how well that has converged. A key that the scene sets to its finest value, such as a
``reltol`` of 1e-7, has no finer run: what a coarser run changes is part of every error. The scene
as it is also gets the estimate that its ``error_budget`` would state. Times are medians of the
simulator's CPU time over rounds that visit all settings in turn, so that a machine that slows down
slows all alike.

Errors of two keys may cancel by luck, and do. A setting therefore counts as within the wanted error
only if the sum of what each of its values does alone is so too::

    bound = sum_k max_{v at least as fine as v_k} |m(own, k = v) - m(own, k = finest)| / |m|
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError, UsageError, unknown
from kc2spice.core.files import staged
from kc2spice.core.progress import Clock, Progress, silent
from kc2spice.core.waveforms import write_record
from kc2spice.report.bench_page import write_bench
from kc2spice.scene.axes import Axis, axes, finest_axes, keys_at
from kc2spice.scene.model import Scene
from kc2spice.sim.ngspice import find_ngspice
from kc2spice.workflow import refine
from kc2spice.workflow.refine import Runs, changes
from kc2spice.workflow.simulate import Run

ERROR = 1e-4
NOTCHES = (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0)  # refinement steps of each axis, coarse to fine
CHECK, REFERENCE = 1.5, 2.0  # notches of the run that checks the reference; of the reference
MOST_POINTS = 80
UNSTEADY = 1e-2  # a metric that still moves by so much at the finest settings measures nothing
SLOW = 5.0  # times the CPU time of the scene's settings; a slower setting is timed once
ALIKE = 1.05  # ratio of times that are the same for the choice between two errors

Place = tuple[float, ...]  # one setting, as the notches of each axis
Errors = dict[str, float]  # error of each metric


@dataclass
class _Point:
    """A setting that was run: its errors and the CPU seconds of each run."""

    place: Place
    settings: dict[str, Any]
    run: Run
    errors: Errors
    times: list[float]

    @property
    def error(self) -> float:
        return max(self.errors.values())

    @property
    def time(self) -> float:
        return statistics.median(self.times)

    def beats(self, other: _Point) -> bool:
        """Whether it is better in error or time, and not worse in the other."""
        ours, theirs = (self.error, self.time), (other.error, other.time)
        return ours != theirs and ours[0] <= theirs[0] and ours[1] <= theirs[1]


class _Plane:
    """All that was run of a scene, by the labels of the settings; ``names`` are the metrics whose
    error counts."""

    def __init__(self, run: Run) -> None:
        finer, finest = axes(run.build), finest_axes(run.build)
        # a mesh costs the simulator nothing
        self.axes = [axis for axis in (*finer, *finest) if not axis.model]
        self.finest = [axis.name for axis in finest if not axis.model]
        self.runs = Runs(run, finer, Clock(), finest=finest, retries=0, most=np.inf)
        self.points: dict[str, _Point] = {}
        self.failed: dict[str, dict[str, Any]] = {}
        self.names: tuple[str, ...] = ()
        self.known: dict[tuple[str, float], Errors] = {}
        if not self.axes:
            where = f"bench {run.build.scene.name}"
            raise UsageError("has no setting that trades time for error", where=where)

    def notches(self, place: Place) -> dict[str, float]:
        """Notches of each axis by its name."""
        return {axis.name: notch for axis, notch in zip(self.axes, place, strict=True)}

    def all_at(self, notch: float) -> Run:
        """The run with every axis moved alike."""
        return self.runs.at(self.notches((notch,) * len(self.axes)))

    @cached_property
    def unrefined(self) -> Errors:
        """Error of each metric by settings at their finest value, which the reference has too."""
        return refine.coarser_changes(self.runs, {}, self.finest, self.names)

    def estimate(self) -> dict[str, Any] | None:
        """Error estimate of the scene as it is, meshes and tables included."""
        result = refine.estimate(self.runs, {})
        if result is None:
            return None
        errors = {name: error for name, error in result.errors.items() if name in self.names}
        return {"error": max(errors.values(), default=0.0), "errors": errors}

    def visit(self, place: Place) -> None:
        """Run a setting, unless that was done."""
        settings = keys_at(self.axes, self.notches(place))
        label = _label(settings)
        if label in self.points or label in self.failed:
            return
        try:
            run = self.runs.at(self.notches(place))
            errors = _errors(run, self.all_at(REFERENCE), self.names)
            errors = {name: error + self.unrefined[name] for name, error in errors.items()}
        except (SimulationError, UsageError) as error:
            why = " ".join(f"{error.message} {error.got or ''}".split())
            self.failed[label] = {"label": label, "settings": settings, "why": why}
        else:
            self.points[label] = _Point(place, settings, run, errors, [run.cpu_s])

    def alone(self, axis: Axis, notch: float) -> Errors:
        """Return the errors that one value of an axis causes while the others stay.

        A value has at least the errors of every finer value.
        """
        if (axis.name, notch) not in self.known:
            finer = next((n for n in NOTCHES if n > notch), None)
            result = dict.fromkeys(self.names, 0.0) if finer is None else self.alone(axis, finer)
            change = dict.fromkeys(self.names, np.inf)
            if (point := self.points.get(_label(axis.at(notch)))) is not None:
                change = _errors(point.run, self.runs.at({axis.name: REFERENCE}), self.names)
            self.known[axis.name, notch] = {n: max(result[n], change[n]) for n in self.names}
        return self.known[axis.name, notch]

    def bound(self, point: _Point) -> float:
        """Sum of the errors of its values, each alone."""
        item = [self.alone(axis, n) for axis, n in zip(self.axes, point.place, strict=True)]
        item.append(self.unrefined)
        return max(sum(errors[name] for errors in item) for name in self.names)

    def guarded(self, point: _Point) -> float:
        """Error that does not hang on errors which cancel."""
        return max(point.error, self.bound(point))

    def cheapest(self, limit: float) -> _Point | None:
        """Cheapest point within ``limit``; of those that take the same time the most exact."""
        accurate = [point for point in self.points.values() if self.guarded(point) <= limit]
        least = min((point.time for point in accurate), default=0.0)
        alike = [point for point in accurate if point.time <= ALIKE * least]
        return min(alike, key=self.guarded, default=None)

    def search(self, limit: float, progress: Progress) -> None:
        """Move one axis at a time, then walk to the cheapest settings in the limit and the own."""
        origin = (0.0,) * len(self.axes)
        star = [origin, *(_move(origin, k, n) for k in range(len(origin)) for n in NOTCHES)]
        star += [(n,) * len(origin) for n in NOTCHES if n > 0]
        for done, place in enumerate(star):
            progress("settings", done / len(star), f"{done} of {len(star)}")
            self.visit(place)
            if failed := self.failed.get(_label({})):
                raise SimulationError(
                    "the scene as it is gives another result than its reference",
                    where="bench",
                    got=failed["why"],
                )
        for bound in sorted({limit, self.guarded(self.points[_label({})])}):
            self._walk(bound, progress)

    def _walk(self, limit: float, progress: Progress) -> None:
        """Along the axes from the cheapest setting in ``limit``, as long as that gives a cheaper
        one. Where none is within ``limit``, from the most exact one towards finer ones."""
        known = 0
        while known < (count := len(self.points) + len(self.failed)) < MOST_POINTS:
            known = count
            start = self.cheapest(limit)
            step = 1 if start is None else -1
            start = start or min(self.points.values(), key=self.guarded)
            progress("search", None, f"{known} settings, now {_label(start.settings)}")
            for k, notch in enumerate(start.place):
                neighbour = NOTCHES.index(notch) + step
                if 0 <= neighbour < len(NOTCHES):
                    self.visit(_move(start.place, k, NOTCHES[neighbour]))

    def time(self, repeats: int, progress: Progress) -> None:
        """Rounds over all settings but the slow ones."""
        least = SLOW * self.points[_label({})].time
        again = [point for point in self.points.values() if point.time <= least]
        for turn in range(1, repeats):
            progress("times", turn / repeats, f"round {turn} of {repeats - 1}")
            for point in again:
                point.times.append(refine.time_again(point.run))

    def record(self, point: _Point) -> dict[str, Any]:
        """One of its points."""
        return {
            "label": _label(point.settings),
            "settings": point.settings,
            "error": point.error,
            "bound": self.bound(point),
            "time_s": point.time,
            "front": not any(other.beats(point) for other in self.points.values()),
            "own": not point.settings,
            "errors": point.errors,
            "time_low_s": min(point.times),
            "time_high_s": max(point.times),
            "repeats": len(point.times),
        }


def _move(place: Place, axis: int, notch: float) -> Place:
    return (*place[:axis], notch, *place[axis + 1 :])


def bench(
    scene: Scene,
    out: Path,
    *,
    error: float = ERROR,
    metric: Sequence[str] = (),
    repeats: int = 5,
    trust: bool = False,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Measure the plane of ``scene`` and write ``bench.json``, ``bench.html`` into ``out``; return
    the record.

    The error of a setting is the largest relative one of the metrics ``metric``, else of those that
    the scene's ``bench.metric`` names, else of all scalars that converge.

    Raises
    ------
    UsageError : an unknown metric, or a scene with nothing to set.
    SimulationError : the scene as it is, or its reference, does not run.
    MissingToolError : no ngspice.
    """
    simulator = find_ngspice()
    with staged(out) as work:
        progress("models", None, "the scene as it is")
        run = refine.evaluate(scene, Clock(), trust=trust, retries=0)
        plane, requested = _Plane(run), metric or scene.bench.metric
        selected = _select_metrics(run, requested)
        progress("reference", None, "all settings at their finest")
        check = _steady(plane, selected, all_of_them=bool(requested))
        plane.search(error, progress)
        plane.time(repeats, progress)
        progress("estimate", None, "all settings and meshes a notch finer")
        finest = keys_at(plane.axes, plane.notches((REFERENCE,) * len(plane.axes)))
        best = plane.cheapest(error)
        points = sorted(plane.points.values(), key=lambda point: point.time)
        record = {
            "scene": scene.name,
            "simulator": f"{simulator.name} {simulator.version}",
            "limit": error,
            "repeats": repeats,
            "metrics": plane.names,
            "left_out": {name: check.get(name) for name in selected if name not in plane.names},
            "points": list(map(plane.record, points)),  # the quickest first
            "failed": list(plane.failed.values()),
            "recommended": best and {**plane.record(best), "set": _words(best.settings)},
            "reference": {
                "label": _label(finest),
                "settings": finest,
                "time_s": plane.all_at(REFERENCE).cpu_s,
                "error": max(check[name] + plane.unrefined[name] for name in plane.names),
            },
            "estimate": plane.estimate(),
        }
        write_bench(work, scene.title or scene.name, record)
        return write_record(record, work, "bench.json")


def _select_metrics(run: Run, names: Sequence[str]) -> tuple[str, ...]:
    """Metrics of ``run`` that ``names`` mean, each alone or all that begin with it and a dot.

    Without any: all scalars that are numbers; of a run that has none, all curves.

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


def _steady(plane: _Plane, selected: Sequence[str], *, all_of_them: bool) -> Errors:
    """Change of each wanted metric at the finest settings.

    The metrics that converge become the ``names`` of the plane.

    Raises
    ------
    SimulationError : none converges.
    """
    start, finer, exact = map(plane.all_at, (0.0, CHECK, REFERENCE))
    moved, changed = changes(finer, exact), changes(start, exact)
    known = {name for name, by in moved.items() if max(by, changed[name]) < np.inf}
    present = [name for name in selected if name in known and exact.values[name].any()]
    check = _errors(finer, exact, present)
    plane.names = tuple(name for name, by in check.items() if by <= UNSTEADY or all_of_them)
    if not plane.names:
        raise SimulationError(
            "no metric converges",
            where=f"bench {start.build.scene.name}",
            got=", ".join(f"{n} changes by {v:.1e}" for n, v in check.items()) or None,
            expected=f"at most {UNSTEADY:g} between the two finest settings",
            hint="name a steadier one with --metric",
        )
    return check


def _errors(run: Run, exact: Run, names: Sequence[str]) -> Errors:
    """Relative error of each metric; SimulationError if one is missing, or a yes became a no."""
    for name, value in exact.values.items():
        ours = run.values.get(name)
        if value.dtype.kind == "b" and not np.array_equal(np.nan if ours is None else ours, value):
            raise SimulationError(f"{name} is {ours}, with the finest settings {value}")
    result = changes(run, exact)
    for name in names:
        if result[name] == np.inf:
            raise SimulationError(f"has no {name}")
    return {name: result[name] for name in names}


def _words(settings: Mapping[str, Any]) -> list[str]:
    """For the command line."""
    texts = (f"{key}={v if isinstance(v, str) else repr(v)}" for key, v in settings.items())
    return [word for text in texts for word in ("--set", text)]


def _label(settings: Mapping[str, Any]) -> str:
    """Changed settings in words."""
    return ", ".join(f"{key} {_short(value)}" for key, value in settings.items()) or "as it is"


def _short(value: Any) -> str:
    if isinstance(value, list):
        return "…".join(f"{item:g}" for item in value)
    return value if isinstance(value, str) else f"{value:g}"
