"""Error against time over a scene's settings, the front of the best, and what to use.

The scene is run as it is, with one key changed at a time, with all of them finer, and from there
along the axes towards the cheapest setting within the wanted error, and within the scene's own.
Errors are against a run with every key at its finest; a second, less fine one tells how well that
has converged. Times are medians of the simulator's CPU time over rounds that visit all settings in
turn, so that a machine that slows down slows all alike.

Errors of two keys may cancel by luck, and do. A setting therefore counts as within the wanted error
only if the sum of what each of its values does alone is so too::

    bound = sum_k max_{v at least as fine as v_k} |m(own, k = v) - m(own, k = finest)| / |m|
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.files import staged
from kc2spice.core.progress import Progress, silent
from kc2spice.report.bench_page import write_bench
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Scene
from kc2spice.sim.ngspice import find_ngspice
from kc2spice.workflow.bench.axes import (
    Line,
    Place,
    label,
    lines,
    neighbours,
    overrides,
    own_place,
    reference_settings,
    settings,
    star,
)
from kc2spice.workflow.bench.evaluate import Run, chosen, errors, evaluate, time_again
from kc2spice.workflow.results import plain, write_record

ERROR = 1e-4
MOST_POINTS = 80
UNSTEADY = 1e-2  # a metric that still moves by so much at the finest settings measures nothing
SLOW = 5.0  # times the scene's own: such a setting is timed once
ALIKE = 1.05  # ratio of times that are the same for the choice between two errors


@dataclass
class _Point:
    """A setting that was run: its errors by metric and the CPU seconds of each run."""

    place: Place
    values: dict[str, Any]
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


@dataclass
class Plane:
    """All that was run of one scene, against its reference ``exact``; ``check`` is the change of
    each metric from a less fine one. ``limit`` is the wanted error.
    """

    scene: Scene
    limit: float
    trust: bool
    found: tuple[Line, ...] = ()
    wanted: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    check: dict[str, float] = field(default_factory=dict)
    points: dict[Place, _Point] = field(default_factory=dict)
    failed: dict[Place, dict[str, Any]] = field(default_factory=dict)
    alone: list[list[dict[str, float]]] = field(default_factory=list)
    runs: dict[str, Run] = field(default_factory=dict)

    def run(self, values: Mapping[str, Any]) -> Run:
        """The scene with ``values``, run once."""
        name = label(values)
        if name not in self.runs:
            scene = load_scene(self.scene, dict(values))
            self.runs[name] = evaluate(scene, trust=self.trust)
        return self.runs[name]

    @property
    def own(self) -> _Point:
        """The scene as it is."""
        return self.points[own_place(self.found)]

    @property
    def exact(self) -> Run:
        """The reference."""
        return self.run(reference_settings(self.found)[0])

    @property
    def floor(self) -> float:
        """Uncertainty of the reference."""
        return max(self.check[name] for name in self.names)

    def visit(self, place: Place) -> _Point | None:
        """Run a setting for the first time; None if it gives no result."""
        if place in self.points or place in self.failed:
            return self.points.get(place)
        values = settings(self.found, place)
        try:
            run = self.run(values)
            found = errors(run, self.exact, self.names)
        except (SimulationError, UsageError) as error:
            why = " ".join(f"{error.message} {error.got or ''}".split())
            self.failed[place] = {"label": label(values), "settings": values, "why": why}
            return None
        point = _Point(place, values, run, found, [run.cpu_s], self._bound(place))
        self.points[place] = point
        return point

    def _bound(self, place: Place) -> float:
        """Sum of the errors of the values of ``place``, each alone; 0 while they are not known."""
        if not self.alone:
            return 0.0
        return max(
            sum(errors[k][name] for errors, k in zip(self.alone, place, strict=True))
            for name in self.names
        )

    def measure_alone(self) -> None:
        """What each value of each axis does by itself, never less than a finer one does."""
        own = own_place(self.found)
        for k, axis in enumerate(self.found):
            finest = self.run(axis.finest)
            known = dict.fromkeys(self.names, 0.0)
            column: list[dict[str, float]] = []
            for value in reversed(range(len(axis.values))):
                point = self.points.get((*own[:k], value, *own[k + 1 :]))
                if point is None:
                    known = dict.fromkeys(self.names, float("inf"))
                else:
                    change = errors(point.run, finest, self.names)
                    known = {name: max(known[name], change[name]) for name in self.names}
                column.insert(0, known)
            self.alone.append(column)
        for point in self.points.values():
            point.bound = self._bound(point.place)

    def cheapest(self, limit: float) -> _Point | None:
        """Cheapest point within ``limit``; of those that take the same time the most exact."""
        kept = [point for point in self.points.values() if point.guarded <= limit]
        least = min((point.time for point in kept), default=0.0)
        return min(
            (p for p in kept if p.time <= ALIKE * least), key=lambda p: p.guarded, default=None
        )

    def again(self, place: Place) -> None:
        """One more time of a point."""
        point = self.points[place]
        point.times.append(time_again(point.run))


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
    the record. Parameters and errors: see :func:`search`.
    """
    with staged(out) as work:
        plane = search(scene, error=error, metric=metric, trust=trust, progress=progress)
        record = measure(plane, repeats, progress)
        write_bench(work, scene.title or scene.name, record)
        write_record(record, work, "bench.json")
    return record


def search(
    scene: Scene,
    *,
    error: float = ERROR,
    metric: Sequence[str] = (),
    trust: bool = False,
    progress: Progress = silent,
) -> Plane:
    """Run the settings of ``scene``, once each.

    The error of a setting is the largest relative one of the metrics ``metric``, else of those that
    the scene's ``bench.metric`` names, else of all scalars that converge.

    Raises
    ------
    UsageError : an unknown metric, or a scene with nothing to set.
    SimulationError : the scene as it is, or its reference, does not run.
    MissingToolError : no ngspice.
    """
    find_ngspice()
    plane = Plane(scene, error, trust)
    progress("models", None, "the scene as it is")
    own = plane.run({})
    found = lines(own.axes)
    if not found:
        raise UsageError("has no setting that trades time for error", where=f"bench {scene.name}")
    plane.found = found
    plane.wanted = chosen(own, metric or scene.bench.metric)
    progress("plan", None, _estimate(own, plane.found))
    finest, finer = reference_settings(plane.found)
    progress("reference", None, label(finest))
    present = _present(plane.wanted, plane.exact, plane.run(finer), own)
    plane.check = errors(plane.run(finer), plane.exact, present)
    steady = bool(metric or scene.bench.metric)
    plane.names = tuple(n for n, by in plane.check.items() if by <= UNSTEADY or steady)
    if not plane.names:
        raise SimulationError(
            "no metric converges",
            where=f"bench {scene.name}",
            got=", ".join(f"{n} changes by {v:.1e}" for n, v in plane.check.items()) or None,
            expected=f"at most {UNSTEADY:g} between the two finest settings",
            hint="name a steadier one with --metric",
        )
    _search(plane, progress)
    return plane


def measure(plane: Plane, repeats: int, progress: Progress = silent) -> dict[str, Any]:
    """The record of a searched plane, after ``repeats`` rounds over its settings for their time."""
    _time(plane, repeats, progress)
    simulator, scene = find_ngspice(), plane.scene
    record = {
        "scene": scene.name,
        "simulator": f"{simulator.name} {simulator.version}",
        "limit": plane.limit,
        "repeats": repeats,
        "metrics": plane.names,
        "left_out": {n: plane.check.get(n) for n in plane.wanted if n not in plane.names},
        **_choice(plane),
        "reference": {
            "label": label(finest := reference_settings(plane.found)[0]),
            "settings": finest,
            "time_s": plane.exact.cpu_s,
            "error": plane.floor,
        },
    }
    return dict(plain(record))


def _present(names: Sequence[str], exact: Run, *others: Run) -> list[str]:
    """Those of ``names`` that all have a value for, in ``exact`` not one that is zero all over."""

    def finite(name: str, run: Run) -> bool:
        return name in run.values and bool(np.isfinite(run.values[name].astype(float)).all())

    return [
        name
        for name in names
        if all(finite(name, run) for run in (exact, *others)) and exact.values[name].any()
    ]


def _estimate(own: Run, found: Sequence[Line]) -> str:
    """How long it will take, told from one run: finer settings cost more, coarser ones less."""
    points = sum(len(axis.values) for axis in found) + 6 * len(found)
    overhead, reductions = 0.3, 20.0  # s a run for netlist, files and checks; s for new models
    seconds = points * (1.5 * own.cpu_s + overhead) + 30 * own.cpu_s + reductions
    return (
        f"one run takes {own.cpu_s:.2g} s of CPU: about {points} settings, "
        f"about {max(1, round(seconds / 60))} min for a run of each"
    )


def _search(plane: Plane, progress: Progress) -> None:
    """Change one key at a time, then walk to the cheapest settings in the limit and in the own."""
    first = list(star(plane.found))
    own = own_place(plane.found)
    for done, place in enumerate(first):
        progress("settings", done / len(first), f"{done} of {len(first)}")
        if plane.visit(place) is None and place == own:
            raise SimulationError(
                "the scene as it is gives another result than its reference",
                where="bench",
                got=plane.failed[place]["why"],
            )
    plane.measure_alone()
    for wanted in sorted({plane.limit, plane.own.guarded}):
        _walk(plane, wanted, progress)


def _walk(plane: Plane, limit: float, progress: Progress) -> None:
    """Along the axes from the cheapest setting in ``limit``, as long as that gives a cheaper one.

    Where none is within ``limit``, from the most exact one towards finer ones.
    """
    while len(plane.points) + len(plane.failed) < MOST_POINTS:
        best = plane.cheapest(limit)
        if best is not None:
            start, step = best, -1
        else:
            start, step = min(plane.points.values(), key=lambda point: point.guarded), +1
        known = len(plane.points) + len(plane.failed)
        progress("search", None, f"{known} settings, now {label(start.values)}")
        for place in neighbours(plane.found, start.place, step):
            plane.visit(place)
        if len(plane.points) + len(plane.failed) == known:
            break


def _time(plane: Plane, repeats: int, progress: Progress) -> None:
    """Rounds over all settings but the slow ones."""
    least, turns = SLOW * plane.own.time, repeats - 1
    again = [place for place, point in plane.points.items() if point.time <= least]
    for turn in range(turns):
        for k, place in enumerate(again):
            share = (turn * len(again) + k) / (len(again) * turns)
            progress("times", share, f"round {turn + 1} of {turns}")
            plane.again(place)


def _beats(one: _Point, other: _Point) -> bool:
    """Whether ``one`` is better in error or time, and not worse in the other."""
    ours, theirs = (one.error, one.time), (other.error, other.time)
    return ours != theirs and ours[0] <= theirs[0] and ours[1] <= theirs[1]


def _choice(plane: Plane) -> dict[str, Any]:
    """Points, front and recommendation as they are recorded."""
    points = sorted(plane.points.values(), key=lambda point: point.time)
    best = plane.cheapest(plane.limit)
    rows = [
        {
            "label": label(p.values),
            "settings": p.values,
            "error": p.error,
            "bound": p.bound,
            "time_s": p.time,
            "front": not any(_beats(other, p) for other in points),
            "own": p is plane.own,
            "errors": p.errors,
            "time_low_s": min(p.times),
            "time_high_s": max(p.times),
            "repeats": len(p.times),
        }
        for p in points
    ]
    return {
        "points": rows,
        "failed": list(plane.failed.values()),
        "recommended": None
        if best is None
        else {
            "label": label(best.values),
            "settings": best.values,
            "error": best.error,
            "bound": best.bound,
            "time_s": best.time,
            "set": [word for each in overrides(best.values) for word in ("--set", each)],
        },
    }
