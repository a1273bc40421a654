"""Results of a benchmark: points of error and time, planes of points, ratios with targets."""

import math
import resource
import statistics
import time
from collections.abc import Mapping
from dataclasses import dataclass, field

ENOUGH = 1.0  # s of CPU after which a point is not run again: long runs scatter little


@dataclass(frozen=True)
class Timing:
    """CPU seconds of repeated runs: median, fastest, slowest, and how many there were."""

    median: float
    low: float
    high: float
    repeats: int


@dataclass(frozen=True)
class Point:
    """One setting of one method: what it costs and how far it is from the exact result.

    ``error`` is the plane's, ``errors`` are more of them by name; ``note`` says what a reader must
    know to compare. ``same_model`` is False where another model is solved; such a point takes no
    part in the ratios.
    """

    family: str
    label: str
    error: float
    time: Timing
    errors: Mapping[str, float | None] = field(default_factory=dict)
    facts: Mapping[str, float | str] = field(default_factory=dict)
    note: str = ""
    same_model: bool = True


@dataclass(frozen=True)
class Plane:
    """Points over one error and one time, both named with unit, and what was left out and why."""

    name: str
    title: str
    error_name: str
    time_name: str
    points: tuple[Point, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Ratio:
    """A speed-up or another figure with its target, if any. ``error`` is what it was taken at.

    ``at_least`` tells which side of the target is good; ``value`` None was not reached at all.
    """

    name: str
    value: float | None
    error: float | None
    target: float | None
    what: str
    at_least: bool = True
    unit: str = ""
    errors: Mapping[str, float | None] = field(default_factory=dict)

    @property
    def met(self):
        """Whether the value is on the good side of the target, if there is one."""
        if self.target is None:
            return True
        if self.value is None:
            return False
        return self.value >= self.target if self.at_least else self.value <= self.target


def speed_up(name, over, ours, target, what, **taken_at):
    """Time ``over`` in times of that of ``ours``, a point that may not be there; its error."""
    value = None if ours is None or over is None else over.median / ours.time.median
    error, errors = (None, {}) if ours is None else (ours.error, ours.errors)
    return Ratio(name, value, target=target, what=what,
                 **{"error": error, "errors": errors, **taken_at})  # fmt: skip


def timed(work, repeats, who="self"):
    """Run ``work`` so often, or until ``ENOUGH`` was spent; its last result and the CPU time of
    this process or its children.
    """
    seconds = []
    while len(seconds) < rounds(seconds, repeats):
        start = cpu_seconds(who)
        result = work()
        seconds.append(cpu_seconds(who) - start)
    return result, timing(seconds)


def rounds(seconds, repeats):
    """How often to run what took ``seconds`` so far: until ``ENOUGH`` is spent."""
    return min(repeats, math.ceil(ENOUGH / max(min(seconds), 1e-9))) if seconds else repeats


def quick_timed(work, repeats, least=0.02):
    """As :func:`timed` for work of microseconds: each repeat runs it for ``least`` seconds."""
    start = time.process_time()
    result = work()
    once = max(time.process_time() - start, 1e-7)
    count = max(1, min(100_000, round(least / once)))

    def many():
        for _ in range(count):
            work()

    _, whole = timed(many, repeats)
    return result, Timing(whole.median / count, whole.low / count, whole.high / count, repeats)


def timing(seconds):
    """Median and range of some runs."""
    return Timing(statistics.median(seconds), min(seconds), max(seconds), len(seconds))


def scaled(taken, factor):
    """Time of the whole work where only a share of it was run."""
    return Timing(taken.median * factor, taken.low * factor, taken.high * factor, taken.repeats)


def cpu_seconds(who):
    """CPU time so far of this process, or of all child processes that have ended."""
    if who == "self":
        return time.process_time()
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def pareto(points):
    """Those that no other beats: in error or in time, and is not worse in the other."""
    costs = [(point.error, point.time.median) for point in points]
    return [
        point for point, (e, t) in zip(points, costs, strict=True)
        if not any(a <= e and b <= t and (a < e or b < t) for a, b in costs)
    ]  # fmt: skip


def fastest(points, limits):
    """Fastest of the points whose ``errors`` keep all ``limits``, None if there is none."""

    def keeps(point):
        errors = ((point.errors.get(name), limit) for name, limit in limits.items())
        return all(error is not None and error <= limit for error, limit in errors)

    kept = [point for point in points if point.same_model and keeps(point)]
    return min(kept, key=lambda point: point.time.median, default=None)


@dataclass(frozen=True)
class Outcome:
    """Results of one part of the benchmark."""

    planes: tuple[Plane, ...] = ()
    ratios: tuple[Ratio, ...] = ()
