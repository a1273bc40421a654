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

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.files import staged
from kc2spice.core.progress import Clock, Progress, silent
from kc2spice.core.words import did_you_mean
from kc2spice.report.bench_page import write_bench
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Scene
from kc2spice.scene.plan import Axis, axes, keys_at
from kc2spice.sim.ngspice import find_ngspice
from kc2spice.workflow.refine import Run, changes, evaluate, time_again
from kc2spice.workflow.results import plain, write_record

ERROR = 1e-4
NOTCHES = (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0)  # of every axis, from coarse to fine
CHECK, REFERENCE = 1.5, 2.0  # of the run that checks the reference, and of the reference
MOST_POINTS = 80
UNSTEADY = 1e-2  # a metric that still moves by so much at the finest settings measures nothing
SLOW = 5.0  # times the scene's own: such a setting is timed once
ALIKE = 1.05  # ratio of times that are the same for the choice between two errors

Place = tuple[int, ...]  # of a setting: on each axis, which of its values from coarse to fine


@dataclass
class _Point:
    """A setting that was run: its errors by metric and the CPU seconds of each run.

    ``bound`` is the sum of what its values do alone, 0 while that is not known.
    """

    settings: dict[str, Any]
    run: Run
    errors: dict[str, float]
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


class _Plane:
    """All that was run of ``scene``; ``names`` are the metrics whose error counts."""

    def __init__(self, scene: Scene, trust: bool) -> None:
        self.scene, self.trust = scene, trust
        self.runs: dict[str, Run] = {}
        self.points: dict[Place, _Point] = {}
        self.failed: dict[Place, dict[str, Any]] = {}
        self.names: tuple[str, ...] = ()
        self.alone: list[list[dict[str, float]]] = []
        found = axes(scene, self.run({}).build)
        self.axes = [axis for axis in found if not axis.model]  # a mesh costs the simulator nothing
        self.notches = [_distinct(axis) for axis in self.axes]
        self.own = tuple(notches.index(0.0) for notches in self.notches)
        if not self.axes:
            where = f"bench {scene.name}"
            raise UsageError("has no setting that trades time for error", where=where)

    def run(self, settings: Mapping[str, Any]) -> Run:
        """The scene with ``settings``, run once and without a second try."""
        name = _label(settings)
        if name not in self.runs:
            scene = load_scene(self.scene, settings)
            self.runs[name] = evaluate(scene, Clock(), name, trust=self.trust, retries=0)
        return self.runs[name]

    def all_at(self, notch: float) -> dict[str, Any]:
        """Keys with every axis moved alike."""
        return keys_at(self.axes, {axis.name: notch for axis in self.axes})

    @property
    def exact(self) -> Run:
        """The reference."""
        return self.run(self.all_at(REFERENCE))

    def visit(self, place: Place) -> _Point | None:
        """Run a setting for the first time; None if it gives no result."""
        if place in self.points or place in self.failed:
            return self.points.get(place)
        pairs = zip(self.axes, self.notches, place, strict=True)
        settings = keys_at(self.axes, {axis.name: notches[k] for axis, notches, k in pairs})
        try:
            run = self.run(settings)
            errors = _errors(run, self.exact, self.names)
        except (SimulationError, UsageError) as error:
            why = " ".join(f"{error.message} {error.got or ''}".split())
            self.failed[place] = {"label": _label(settings), "settings": settings, "why": why}
            return None
        self.points[place] = _Point(settings, run, errors, [run.cpu_s], self.bound(place))
        return self.points[place]

    def bound(self, place: Place) -> float:
        """Sum of the errors of the values of ``place``, each alone."""
        values = [column[k] for column, k in zip(self.alone, place, strict=False)]
        return max(sum(errors[name] for errors in values) for name in self.names)

    def measure_alone(self) -> None:
        """What each value of each axis does by itself, never less than a finer one does."""
        for k, axis in enumerate(self.axes):
            finest = self.run(axis.at(REFERENCE))
            known = dict.fromkeys(self.names, 0.0)
            column: list[dict[str, float]] = []
            for value in reversed(range(len(self.notches[k]))):
                point = self.points.get(_moved(self.own, k, value))
                change = dict.fromkeys(self.names, np.inf)
                if point is not None:
                    change = _errors(point.run, finest, self.names)
                known = {name: max(known[name], change[name]) for name in self.names}
                column.insert(0, known)
            self.alone.append(column)
        for place, point in self.points.items():
            point.bound = self.bound(place)

    def cheapest(self, limit: float) -> _Point | None:
        """Cheapest point within ``limit``; of those that take the same time the most exact."""
        kept = [point for point in self.points.values() if point.guarded <= limit]
        least = min((point.time for point in kept), default=0.0)
        alike = [point for point in kept if point.time <= ALIKE * least]
        return min(alike, key=lambda point: point.guarded, default=None)

    def star(self) -> Iterator[Place]:
        """The scene as it is, with one axis moved at a time, and with all of them finer."""
        yield self.own
        for k, notches in enumerate(self.notches):
            yield from (_moved(self.own, k, n) for n in range(len(notches)) if n != self.own[k])
        last = [len(notches) - 1 for notches in self.notches]
        for step in range(1, max(np.subtract(last, self.own)) + 1):
            pairs = zip(self.own, last, strict=True)
            yield tuple(min(own + step, finest) for own, finest in pairs)

    def walk(self, limit: float, progress: Progress) -> None:
        """Along the axes from the cheapest setting in ``limit``, as long as that gives a cheaper
        one. Where none is within ``limit``, from the most exact one towards finer ones."""
        known = 0
        while known < (count := len(self.points) + len(self.failed)) < MOST_POINTS:
            known = count
            start = self.cheapest(limit)
            step = 1 if start is None else -1
            start = start or min(self.points.values(), key=lambda point: point.guarded)
            progress("search", None, f"{known} settings, now {_label(start.settings)}")
            place = next(place for place, point in self.points.items() if point is start)
            for k, notches in enumerate(self.notches):
                if 0 <= place[k] + step < len(notches):
                    self.visit(_moved(place, k, place[k] + step))


def _distinct(axis: Axis) -> list[float]:
    """Notches from coarse to fine whose values differ: an axis ends at its bounds."""
    found: dict[str, float] = {}
    for notch in sorted(NOTCHES, key=abs):
        found.setdefault(str(axis.at(notch)), notch)
    return sorted(found.values())


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
        plane = _Plane(scene, trust)
        wanted = _wanted(plane.run({}), metric or scene.bench.metric)
        progress("plan", None, _estimate(plane))
        finest = plane.all_at(REFERENCE)
        progress("reference", None, _label(finest))
        check = _steady(plane, wanted, all_of_them=bool(metric or scene.bench.metric))
        _search(plane, error, progress)
        _time(plane, repeats, progress)
        reference = {
            "label": _label(finest),
            "settings": finest,
            "time_s": plane.exact.cpu_s,
            "error": max(check[name] for name in plane.names),
        }
        record = {
            "scene": scene.name,
            "simulator": f"{simulator.name} {simulator.version}",
            "limit": error,
            "repeats": repeats,
            "metrics": plane.names,
            "left_out": {name: check.get(name) for name in wanted if name not in plane.names},
            "points": _rows(plane),
            "failed": list(plane.failed.values()),
            "recommended": _recommended(plane.cheapest(error)),
            "reference": reference,
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
            raise UsageError(
                "this scene has no such metric",
                where="--metric",
                got=name,
                expected=", ".join(run.values),
                hint=did_you_mean(name, run.values),
            )
        found += hits
    numbers = {name: v for name, v in run.values.items() if v.dtype.kind != "b"}
    scalars = [name for name, v in numbers.items() if v.ndim == 0]
    return tuple(dict.fromkeys(found or scalars or numbers))


def _steady(plane: _Plane, wanted: Sequence[str], *, all_of_them: bool) -> dict[str, float]:
    """What each wanted metric still changes by at the finest settings; those that count become the
    ``names`` of the plane.

    Raises
    ------
    SimulationError : none converges.
    """
    exact = plane.exact
    finer = plane.run(plane.all_at(CHECK))
    moved, own = changes(finer, exact), changes(plane.run({}), exact)
    known = {n for n, change in moved.items() if max(change, own[n]) < np.inf}
    present = [n for n in wanted if n in known and exact.values[n].any()]
    check = _errors(finer, exact, present)
    plane.names = tuple(n for n, by in check.items() if by <= UNSTEADY or all_of_them)
    if not plane.names:
        raise SimulationError(
            "no metric converges",
            where=f"bench {plane.scene.name}",
            got=", ".join(f"{n} changes by {v:.1e}" for n, v in check.items()) or None,
            expected=f"at most {UNSTEADY:g} between the two finest settings",
            hint="name a steadier one with --metric",
        )
    return check


def _errors(run: Run, exact: Run, names: Sequence[str]) -> dict[str, float]:
    """Relative error of each metric; SimulationError if one is missing, or a yes became a no."""
    for name, value in exact.values.items():
        if value.dtype.kind == "b" and not np.array_equal(run.values.get(name, np.nan), value):
            ours = run.values.get(name)
            raise SimulationError(f"{name} is {ours}, with the finest settings {value}")
    found = changes(run, exact)
    for name in names:
        if found[name] == np.inf:
            raise SimulationError(f"has no {name}")
    return {name: found[name] for name in names}


def _estimate(plane: _Plane) -> str:
    """How long it will take, told from one run: finer settings cost more, coarser ones less."""
    own = plane.run({}).cpu_s
    points = sum(map(len, plane.notches)) + 6 * len(plane.axes)
    overhead, reductions = 0.3, 20.0  # s a run for netlist, files and checks; s for new models
    seconds = points * (1.5 * own + overhead) + 30 * own + reductions
    return (
        f"one run takes {own:.2g} s of CPU: about {points} settings, "
        f"about {max(1, round(seconds / 60))} min for a run of each"
    )


def _search(plane: _Plane, limit: float, progress: Progress) -> None:
    """Move one axis at a time, then walk to the cheapest settings in the limit and in the own."""
    first = list(plane.star())
    for done, place in enumerate(first):
        progress("settings", done / len(first), f"{done} of {len(first)}")
        plane.visit(place)
        if plane.own in plane.failed:
            raise SimulationError(
                "the scene as it is gives another result than its reference",
                where="bench",
                got=plane.failed[plane.own]["why"],
            )
    plane.measure_alone()
    for wanted in sorted({limit, plane.points[plane.own].guarded}):
        plane.walk(wanted, progress)


def _time(plane: _Plane, repeats: int, progress: Progress) -> None:
    """Rounds over all settings but the slow ones."""
    least, turns = SLOW * plane.points[plane.own].time, repeats - 1
    again = [point for point in plane.points.values() if point.time <= least]
    for turn in range(turns):
        for k, point in enumerate(again):
            share = (turn * len(again) + k) / (len(again) * turns)
            progress("times", share, f"round {turn + 1} of {turns}")
            point.times.append(time_again(point.run))


def _rows(plane: _Plane) -> list[dict[str, Any]]:
    """All points as they are recorded, the quickest first."""
    points = sorted(plane.points.values(), key=lambda point: point.time)
    return [
        {
            **_row(p),
            "front": not any(other.beats(p) for other in points),
            "own": p is plane.points[plane.own],
            "errors": p.errors,
            "time_low_s": min(p.times),
            "time_high_s": max(p.times),
            "repeats": len(p.times),
        }
        for p in points
    ]


def _row(point: _Point) -> dict[str, Any]:
    return {
        "label": _label(point.settings),
        "settings": point.settings,
        "error": point.error,
        "bound": point.bound,
        "time_s": point.time,
    }


def _recommended(best: _Point | None) -> dict[str, Any] | None:
    if best is None:
        return None
    pairs = best.settings.items()
    texts = [f"{key}={v if isinstance(v, str) else repr(v)}" for key, v in pairs]
    return {**_row(best), "set": [word for text in texts for word in ("--set", text)]}


def _label(settings: Mapping[str, Any]) -> str:
    """What is changed, in words."""
    return ", ".join(f"{key} {_short(value)}" for key, value in settings.items()) or "as it is"


def _short(value: Any) -> str:
    if isinstance(value, list):
        return "…".join(f"{each:g}" for each in value)
    return value if isinstance(value, str) else f"{value:g}"
