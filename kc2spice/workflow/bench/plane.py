"""Error against time over a scene's settings, the front of the best, and what to use.

The scene is run as it is, with one key changed at a time, with all of them finer, and from there
along the axes towards the cheapest setting within the wanted error, and within the scene's own:
the scene lies on its front if none is as exact in clearly less time, or clearly more exact.
Errors are against a run with every key at its finest; a second, less fine one tells how well that
has converged. Times are medians of the simulator's CPU time over rounds that visit all settings in
turn, so that a machine that slows down slows all alike.

Errors of two keys may cancel by luck, and do. A setting therefore counts as within the wanted error
only if the sum of what each of its values does alone is so too::

    bound = sum_k max_{v at least as fine as v_k} |m(own, k = v) - m(own, k = finest)| / |m|
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.files import staged
from kc2spice.core.progress import Progress, silent
from kc2spice.report.bench_page import write_bench
from kc2spice.scene.model import Scene
from kc2spice.sim.ngspice import find_ngspice
from kc2spice.workflow.bench.axes import (
    Axis,
    Place,
    axes,
    label,
    neighbours,
    overrides,
    own_place,
    reference_settings,
    settings,
    star,
)
from kc2spice.workflow.bench.evaluate import Run, chosen, errors, evaluate
from kc2spice.workflow.results import plain, write_record

ERROR = 1e-4
MOST_POINTS = 80
UNSTEADY = 1e-2  # a metric that still moves by so much at the finest settings measures nothing
SLOW = 5.0  # times the scene's own: such a setting is timed once
ALIKE = 1.05  # ratio of times that are the same for the choice between two errors
CLEAR = 1.25  # ratio of times from which on a setting is quicker than the scene's own
START = 5e-3  # s by which it is quicker at least: start-ups of the simulator vary by as much
EXACT = 2.0  # ratio of errors from which on it is more exact

Load = Callable[[Sequence[str]], Scene]  # the scene with some KEY=VALUE on top of it


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
class _Plane:
    """All that was run of one scene, against its reference."""

    load: Load
    found: tuple[Axis, ...]
    names: tuple[str, ...]
    exact: Run
    trust: bool
    points: dict[Place, _Point] = field(default_factory=dict)
    failed: dict[Place, dict[str, Any]] = field(default_factory=dict)
    alone: list[list[dict[str, float]]] = field(default_factory=list)

    def visit(self, place: Place) -> _Point | None:
        """Run a setting for the first time; None if it gives no result."""
        if place in self.points or place in self.failed:
            return self.points.get(place)
        values = settings(self.found, place)
        try:
            run = evaluate(self.load(overrides(values)), trust=self.trust)
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
            finest = evaluate(self.load(overrides(axis.finest)), trust=self.trust)
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
        scene = self.load(overrides(point.values))
        point.times.append(evaluate(scene, trust=self.trust).cpu_s)


def bench(
    load: Load,
    out: Path,
    *,
    error: float = ERROR,
    metric: Sequence[str] = (),
    repeats: int = 5,
    trust: bool = False,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Measure the plane of the scene that ``load`` gives and write ``bench.json``, ``bench.html``
    and ``bench.png`` into ``out``; return the record.

    ``load([])`` is the scene, ``load(["KEY=VALUE", ...])`` the scene with other settings. The error
    of a setting is the largest relative one of the metrics ``metric``, else of those that the
    scene's ``bench.metric`` names, else of all scalars that converge.

    Raises
    ------
    UsageError : an unknown metric, or a scene with nothing to set.
    SimulationError : the scene as it is, or its reference, does not run.
    MissingToolError : no ngspice.
    """
    simulator, scene = find_ngspice(), load([])
    progress("models", None, "the scene as it is")
    own = evaluate(scene, trust=trust)
    found = axes(scene, transient=own.transient)
    if not found:
        raise UsageError("has no setting that trades time for error", where=f"bench {scene.name}")
    wanted = chosen(own, metric or scene.bench.metric)
    with staged(out) as work:
        progress("plan", None, _estimate(own, found, repeats))
        finest, finer = reference_settings(found)
        progress("reference", None, label(finest))
        exact = evaluate(load(overrides(finest)), trust=trust)
        check = errors(
            evaluate(load(overrides(finer)), trust=trust), exact, _present(exact, wanted)
        )
        names = tuple(n for n in check if check[n] <= UNSTEADY or metric or scene.bench.metric)
        if not names:
            raise SimulationError(
                "no metric converges", where=f"bench {scene.name}",
                got=", ".join(f"{n} changes by {v:.1e}" for n, v in check.items()) or None,
                expected=f"at most {UNSTEADY:g} between the two finest settings",
                hint="name a steadier one with --metric",
            )  # fmt: skip
        plane = _Plane(load, found, names, exact, trust)
        _search(plane, error, progress)
        _time(plane, repeats, progress)
        record: dict[str, Any] = {
            "scene": scene.name, "simulator": f"{simulator.name} {simulator.version}",
            "limit": error, "repeats": repeats, "metrics": names,
            "left_out": {name: check.get(name) for name in wanted if name not in names},
            **_choice(plane, error, max(check[name] for name in names)),
            "reference": {
                "label": label(finest), "settings": finest, "time_s": exact.cpu_s,
                "error": max(check[name] for name in names),
            },
        }  # fmt: skip
        record = plain(record)
        write_bench(work, scene.title or scene.name, record)
        write_record(record, work, "bench.json")
    return record


def _present(exact: Run, names: Sequence[str]) -> list[str]:
    """Those of ``names`` that the reference has a value for, and not one that is zero all over."""
    return [n for n in names if n in exact.values and exact.values[n].astype(float).any()]


def _estimate(own: Run, found: Sequence[Axis], repeats: int) -> str:
    """How long it will take, told from one run: finer settings cost more, coarser ones less."""
    points = sum(len(axis.values) for axis in found) + 6 * len(found)
    overhead, reductions = 0.3, 20.0  # s a run for netlist, files and checks; s for new models
    seconds = points * repeats * (1.5 * own.cpu_s + overhead) + 30 * own.cpu_s + reductions
    return (
        f"one run takes {own.cpu_s:.2g} s of CPU: about {points} settings, {repeats} times each, "
        f"about {max(1, round(seconds / 60))} min"
    )


def _search(plane: _Plane, limit: float, progress: Progress) -> None:
    """Change one key at a time, then walk to the cheapest settings in ``limit`` and in the own."""
    first = list(star(plane.found))
    own = own_place(plane.found)
    for done, place in enumerate(first):
        progress("settings", done / len(first), f"{done} of {len(first)}")
        if plane.visit(place) is None and place == own:
            raise SimulationError("the scene as it is gives another result than its reference",
                                  where="bench", got=plane.failed[place]["why"])  # fmt: skip
    plane.measure_alone()
    for wanted in (limit, plane.points[own].guarded):
        _walk(plane, wanted, progress)


def _walk(plane: _Plane, limit: float, progress: Progress) -> None:
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


def _time(plane: _Plane, repeats: int, progress: Progress) -> None:
    """Rounds over all settings; the slow ones are timed once."""
    own = plane.points[own_place(plane.found)].time
    quick = [place for place, point in plane.points.items() if point.time <= SLOW * own]
    for turn in range(1, repeats):
        for k, place in enumerate(quick):
            share = ((turn - 1) * len(quick) + k) / (len(quick) * (repeats - 1))
            progress("times", share, f"round {turn + 1} of {repeats}")
            plane.again(place)


def _choice(plane: _Plane, limit: float, floor: float) -> dict[str, Any]:
    """Points, front, recommendation and the scene's place as they are recorded."""
    points = sorted(plane.points.values(), key=lambda point: point.time)
    front, least = set(), float("inf")
    for point in points:
        if point.error < least:
            front.add(point.place)
            least = point.error
    own, best = own_place(plane.found), plane.cheapest(limit)
    rows = [
        {
            "label": label(p.values),
            "settings": p.values,
            "error": p.error,
            "bound": p.bound,
            "time_s": p.time,
            "front": p.place in front,
            "own": p.place == own,
            "errors": p.errors,
            "time_low_s": min(p.times),
            "time_high_s": max(p.times),
            "repeats": len(p.times),
        }
        for p in points
    ]
    return {
        "points": rows, "failed": list(plane.failed.values()), "own": place_of_own(rows, floor),
        "recommended": None if best is None else {
            "label": label(best.values), "settings": best.values, "error": best.error,
            "bound": best.bound,
            "time_s": best.time,
            "set": [word for each in overrides(best.values) for word in ("--set", each)],
        },
    }  # fmt: skip


def place_of_own(points: Sequence[Mapping[str, Any]], floor: float) -> dict[str, Any]:
    """Whether the scene's own setting lies on the front of the ``points`` of a record.

    It is beaten by one as exact whose median is quicker than its quickest run, by ``CLEAR`` and
    ``START``, or by one that takes no longer and is ``EXACT`` times more exact. Errors below
    ``floor``, the uncertainty of the reference, are equal. ``nearest`` is the quickest that beats
    it, or itself.
    """

    def guarded(point: Mapping[str, Any]) -> float:
        return max(point["error"], point["bound"], floor)

    own = next(point for point in points if point["own"])
    error, time = guarded(own), own["time_s"]
    beating = [
        p for p in points
        if (guarded(p) <= error and max(CLEAR * p["time_s"], p["time_s"] + START) <= time
            and p["time_s"] < own["time_low_s"])
        or (EXACT * guarded(p) <= error and p["time_s"] <= time)
    ]  # fmt: skip
    nearest = min(beating, key=lambda p: p["time_s"], default=own)
    return {
        "on_front": nearest is own, "nearest": nearest["label"], "settings": nearest["settings"],
        "error": guarded(nearest), "time_s": nearest["time_s"],
    }  # fmt: skip
