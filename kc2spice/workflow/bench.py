"""``bench SCENE``: error against time over its settings, the front of the best, what to use.

The scene is run as it is, with one axis (:mod:`kc2spice.scene.plan`) moved at a time, with all of
them finer, and from there along the axes towards the cheapest setting within the wanted error, and
within the scene's own. Errors are against a run with every axis at its finest; a second, less fine
one tells how well that has converged. Times are medians of the simulator's CPU time over rounds
that visit all settings in turn, so that a machine that slows down slows all alike.

Errors of two keys may cancel by luck, and do. A setting therefore counts as within the wanted error
only if the sum of what each of its values does alone is so too::

    bound = sum_k max_{v at least as fine as v_k} |m(own, k = v) - m(own, k = finest)| / |m|
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError, UsageError, unknown
from kc2spice.core.files import staged
from kc2spice.core.progress import Clock, Progress, silent
from kc2spice.report.bench_page import write_bench
from kc2spice.scene.model import Scene
from kc2spice.scene.plan import axes, keys_at
from kc2spice.sim.ngspice import find_ngspice
from kc2spice.workflow import refine
from kc2spice.workflow.refine import Run, Runs, changes
from kc2spice.workflow.results import plain, write_record

ERROR = 1e-4
NOTCHES = (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0)  # of every axis, from coarse to fine
CHECK, REFERENCE = 1.5, 2.0  # of the run that checks the reference, and of the reference
MOST_POINTS = 80
UNSTEADY = 1e-2  # a metric that still moves by so much at the finest settings measures nothing
SLOW = 5.0  # times the scene's own: such a setting is timed once
ALIKE = 1.05  # ratio of times that are the same for the choice between two errors

Place = tuple[int, ...]  # of a setting: on each axis, which of the NOTCHES
Errors = dict[str, float]  # of each metric


@dataclass
class _Point:
    """A setting that was run: its errors and the CPU seconds of each run.

    ``bound`` is the sum of what its values do alone, 0 while that is not known.
    """

    place: Place
    settings: dict[str, Any]
    run: Run
    errors: Errors
    times: list[float]
    bound: float = 0.0

    @property
    def error(self) -> float:
        return max(self.errors.values())

    @property
    def guarded(self) -> float:
        """Error that does not hang on errors which cancel."""
        return max(self.error, self.bound)

    @property
    def time(self) -> float:
        return statistics.median(self.times)

    def beats(self, other: _Point) -> bool:
        """Whether it is better in error or time, and not worse in the other."""
        ours, theirs = (self.error, self.time), (other.error, other.time)
        return ours != theirs and ours[0] <= theirs[0] and ours[1] <= theirs[1]

    def record(self) -> dict[str, Any]:
        return {
            "label": _label(self.settings),
            "settings": self.settings,
            "error": self.error,
            "bound": self.bound,
            "time_s": self.time,
        }


class _Plane:
    """All that was run of a scene, by the labels of the settings; ``names`` are the metrics whose
    error counts."""

    def __init__(self, own: Run) -> None:
        # a mesh costs the simulator nothing
        self.axes = [axis for axis in axes(own.build) if not axis.model]
        self.runs = Runs(own, self.axes, Clock(), retries=0)
        self.points: dict[str, _Point] = {}
        self.failed: dict[str, dict[str, Any]] = {}
        self.names: tuple[str, ...] = ()
        self.alone: list[list[Errors]] = []
        self.own = (NOTCHES.index(0.0),) * len(self.axes)
        if not self.axes:
            where = f"bench {own.build.scene.name}"
            raise UsageError("has no setting that trades time for error", where=where)

    def all_at(self, notch: float) -> dict[str, float]:
        """Every axis moved alike."""
        return {axis.name: notch for axis in self.axes}

    def visit(self, place: Place) -> None:
        """Run a setting, unless that was done."""
        pairs = zip(self.axes, place, strict=True)
        notches = {axis.name: NOTCHES[k] for axis, k in pairs}
        settings = keys_at(self.axes, notches)
        label = _label(settings)
        if label in self.points or label in self.failed:
            return
        try:
            run = self.runs.at(notches)
            errors = _errors(run, self.runs.at(self.all_at(REFERENCE)), self.names)
        except (SimulationError, UsageError) as error:
            why = " ".join(f"{error.message} {error.got or ''}".split())
            self.failed[label] = {"label": label, "settings": settings, "why": why}
        else:
            bound = self.bound(place)
            self.points[label] = _Point(place, settings, run, errors, [run.cpu_s], bound)

    def bound(self, place: Place) -> float:
        """Sum of the errors of the values of ``place``, each alone."""
        values = [column[k] for column, k in zip(self.alone, place, strict=False)]
        return max(sum(errors[name] for errors in values) for name in self.names)

    def measure_alone(self) -> None:
        """What each value of each axis does by itself, never less than a finer one does."""
        for axis in self.axes:
            finest = self.runs.at({axis.name: REFERENCE})
            known = dict.fromkeys(self.names, 0.0)
            column: list[Errors] = []
            for notch in reversed(NOTCHES):
                point = self.points.get(_label(axis.at(notch)))
                change = dict.fromkeys(self.names, np.inf)
                if point is not None:
                    change = _errors(point.run, finest, self.names)
                known = {name: max(known[name], change[name]) for name in self.names}
                column.insert(0, known)
            self.alone.append(column)
        for point in self.points.values():
            point.bound = self.bound(point.place)

    def cheapest(self, limit: float) -> _Point | None:
        """Cheapest point within ``limit``; of those that take the same time the most exact."""
        kept = [point for point in self.points.values() if point.guarded <= limit]
        least = min((point.time for point in kept), default=0.0)
        alike = [point for point in kept if point.time <= ALIKE * least]
        return min(alike, key=lambda point: point.guarded, default=None)

    def search(self, limit: float, progress: Progress) -> None:
        """Move one axis at a time, then walk to the cheapest settings in the limit and the own."""
        first = list(self._star())
        for done, place in enumerate(first):
            progress("settings", done / len(first), f"{done} of {len(first)}")
            self.visit(place)
            for failed in self.failed.values():
                if not failed["settings"]:
                    raise SimulationError(
                        "the scene as it is gives another result than its reference",
                        where="bench",
                        got=failed["why"],
                    )
        self.measure_alone()
        for wanted in sorted({limit, self.points[_label({})].guarded}):
            self._walk(wanted, progress)

    def _star(self) -> Iterator[Place]:
        """The scene as it is, with one axis moved at a time, and with all of them finer."""
        yield self.own
        for k in range(len(self.axes)):
            yield from (_moved(self.own, k, value) for value in range(len(NOTCHES)))
        yield from ((value,) * len(self.axes) for value in range(self.own[0] + 1, len(NOTCHES)))

    def _walk(self, limit: float, progress: Progress) -> None:
        """Along the axes from the cheapest setting in ``limit``, as long as that gives a cheaper
        one. Where none is within ``limit``, from the most exact one towards finer ones."""
        known = 0
        while known < (count := len(self.points) + len(self.failed)) < MOST_POINTS:
            known = count
            start = self.cheapest(limit)
            step = 1 if start is None else -1
            start = start or min(self.points.values(), key=lambda point: point.guarded)
            progress("search", None, f"{known} settings, now {_label(start.settings)}")
            for k, value in enumerate(start.place):
                if 0 <= value + step < len(NOTCHES):
                    self.visit(_moved(start.place, k, value + step))

    def time(self, repeats: int, progress: Progress) -> None:
        """Rounds over all settings but the slow ones."""
        least, turns = SLOW * self.points[_label({})].time, repeats - 1
        again = [point for point in self.points.values() if point.time <= least]
        for turn in range(turns):
            for k, point in enumerate(again):
                share = (turn * len(again) + k) / (len(again) * turns)
                progress("times", share, f"round {turn + 1} of {turns}")
                point.times.append(refine.time_again(point.run))

    def record(self) -> list[dict[str, Any]]:
        """All points, the quickest first."""
        points = sorted(self.points.values(), key=lambda point: point.time)
        return [
            {
                **point.record(),
                "front": not any(other.beats(point) for other in points),
                "own": not point.settings,
                "errors": point.errors,
                "time_low_s": min(point.times),
                "time_high_s": max(point.times),
                "repeats": len(point.times),
            }
            for point in points
        ]


def _moved(place: Place, axis: int, value: int) -> Place:
    return (*place[:axis], value, *place[axis + 1 :])


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
        own = refine.evaluate(scene, Clock(), trust=trust, retries=0)
        plane, asked = _Plane(own), metric or scene.bench.metric
        wanted = _wanted(own, asked)
        progress("reference", None, "all settings at their finest")
        check = _steady(plane, wanted, all_of_them=bool(asked))
        plane.search(error, progress)
        plane.time(repeats, progress)
        finest = keys_at(plane.axes, plane.all_at(REFERENCE))
        best = plane.cheapest(error)
        record = {
            "scene": scene.name,
            "simulator": f"{simulator.name} {simulator.version}",
            "limit": error,
            "repeats": repeats,
            "metrics": plane.names,
            "left_out": {name: check.get(name) for name in wanted if name not in plane.names},
            "points": plane.record(),
            "failed": list(plane.failed.values()),
            "recommended": best and {**best.record(), "set": _words(best.settings)},
            "reference": {
                "label": _label(finest),
                "settings": finest,
                "time_s": plane.runs.at(plane.all_at(REFERENCE)).cpu_s,
                "error": max(check[name] for name in plane.names),
            },
        }
        write_bench(work, scene.title or scene.name, record)
        write_record(record, work, "bench.json")
    return dict(plain(record))


def _wanted(run: Run, names: Sequence[str]) -> tuple[str, ...]:
    """Metrics of ``run`` that ``names`` mean, each alone or all that begin with it and a dot.

    Without any: all scalars that are numbers; of a run that has none, all curves.

    Raises
    ------
    UsageError : a metric that the scene does not have.
    """
    found: list[str] = []
    for name in names:
        hits = [known for known in run.values if known == name or known.startswith(f"{name}.")]
        if not hits:
            raise unknown("this scene has no such metric", name, run.values, "--metric")
        found += hits
    numbers = {name: v for name, v in run.values.items() if v.dtype.kind != "b"}
    scalars = [name for name, v in numbers.items() if v.ndim == 0]
    return tuple(dict.fromkeys(found or scalars or numbers))


def _steady(plane: _Plane, wanted: Sequence[str], *, all_of_them: bool) -> Errors:
    """What each wanted metric still changes by at the finest settings; those that count become the
    ``names`` of the plane.

    Raises
    ------
    SimulationError : none converges.
    """
    own, finer, exact = (plane.runs.at(plane.all_at(n)) for n in (0.0, CHECK, REFERENCE))
    moved, changed = changes(finer, exact), changes(own, exact)
    known = {name for name, by in moved.items() if max(by, changed[name]) < np.inf}
    present = [name for name in wanted if name in known and exact.values[name].any()]
    check = _errors(finer, exact, present)
    plane.names = tuple(name for name, by in check.items() if by <= UNSTEADY or all_of_them)
    if not plane.names:
        raise SimulationError(
            "no metric converges",
            where=f"bench {own.build.scene.name}",
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
    found = changes(run, exact)
    for name in names:
        if found[name] == np.inf:
            raise SimulationError(f"has no {name}")
    return {name: found[name] for name in names}


def _words(settings: Mapping[str, Any]) -> list[str]:
    """For the command line."""
    texts = (f"{key}={v if isinstance(v, str) else repr(v)}" for key, v in settings.items())
    return [word for text in texts for word in ("--set", text)]


def _label(settings: Mapping[str, Any]) -> str:
    """What is changed, in words."""
    return ", ".join(f"{key} {_short(value)}" for key, value in settings.items()) or "as it is"


def _short(value: Any) -> str:
    if isinstance(value, list):
        return "…".join(f"{each:g}" for each in value)
    return value if isinstance(value, str) else f"{value:g}"
