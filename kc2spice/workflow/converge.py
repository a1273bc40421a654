"""The error of every metric, from runs of the same scene with its numerical settings refined.

A refined run moves all axes of the scene (:mod:`kc2spice.scene.plan`) by a notch; what a metric
changes by is its estimated error, times :data:`REMAINDER`. A scene with an ``error_budget`` goes
along the axis with the largest share, which is what moving it alone changes, until the estimate
holds for every metric, or says what it tried.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.progress import Clock
from kc2spice.scene.judge import Check
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.scene.plan import Axis, axes, keys_at
from kc2spice.scene.settings import Action
from kc2spice.sim.retries import Outcome
from kc2spice.workflow.refine import Run, changes, evaluate, measured

MOST = 16  # runs besides the scene's own
LIMIT = 1e-2  # error_budget where checks.reduction asks without one
# A notch leaves half of an axis' error at most, as corners of a mesh do; what a metric changes by
# is the other half at least.
REMAINDER = 2.0
PER_NOTCH, FARTHEST = 4.0, 3  # by which an error falls at best, notches that are taken at once
NEAR_ZERO = 0.1  # of the largest metric in its unit: what a small one is judged by
SHRINKS, STALLS = 0.9, 2  # from one estimate to the next; so often not, the axes do not converge


@dataclass(frozen=True)
class Tried:
    """A scene's run, by how many notches its axes were moved, and the estimated error of each
    metric where a refined run followed; ``unmoved`` are axes that this one could not move."""

    notches: Mapping[str, int]
    settings: Mapping[str, Any]
    run: Run
    errors: Mapping[str, float] = field(default_factory=dict)
    unmoved: tuple[str, ...] = ()

    @property
    def moved(self) -> tuple[str, ...]:
        """Names of the axes that are finer than the scene's own."""
        return tuple(name for name, count in self.notches.items() if count)

    @property
    def error(self) -> float:
        """The largest of all metrics."""
        return max(self.errors.values(), default=math.inf)

    def record(self) -> dict[str, Any]:
        """Its row of ``result.json``."""
        return {
            "settings": dict(self.settings),
            "errors": dict(self.errors),
            "unmoved": self.unmoved,
        }


@dataclass(frozen=True)
class Converged:
    """The run that is taken, whether its estimate holds the budget, why not, and all estimates;
    ``shares`` are the errors of single axes."""

    taken: Tried
    check: Check
    tried: tuple[Tried, ...]
    shares: Mapping[str, float]

    def record(self) -> dict[str, Any]:
        """``convergence`` of ``result.json``."""
        return {
            "budget": self.check.limit,
            "held": self.check.passed,
            "errors": dict(self.taken.errors),
            "shares": dict(self.shares),
            "unmoved": self.taken.unmoved,
            "tried": [each.record() for each in self.tried],
        }


def converge(build: Build, outcome: Outcome, clock: Clock) -> Converged | None:
    """Refine the scene until the estimated error of every metric is within ``error_budget``.

    Without a budget ``checks.reduction`` asks for one estimate; None where neither does.
    """
    scene, budget = build.scene, build.scene.error_budget
    action: Action = scene.checks.reduction or ("off" if budget is None else "warn")
    if action == "off":
        return None
    limit = budget or LIMIT
    found = axes(scene, build)
    runs = _Runs(build, found, clock)
    now = Tried({}, {}, measured(build, outcome))
    tried: list[Tried] = []
    shares: dict[str, float] = {}
    why, last, stalls = "", math.inf, 0
    while True:
        finer, unmoved = runs.finer(now)
        if finer is None:
            why = "a refined run failed"
            now = tried[-1] if tried else now
            break
        now = replace(now, errors=_differences(now, finer), unmoved=unmoved)
        tried.append(now)
        if now.error <= limit or budget is None:
            break
        stalls = stalls + 1 if now.error > SHRINKS * last else 0
        if stalls == STALLS:
            why = f"the estimate does not shrink: {last:.2g}, then {now.error:.2g}"
            break
        last = now.error
        best = _largest_share(runs, now, shares, limit)
        if best is None or runs.left < 1:
            why = f"{MOST} runs do not suffice" if runs.left < 1 else "nothing more to refine"
            break
        now = best
    told = f"raise error_budget, or refine what it was tried with ({why})" if why else "raise it"
    worst = max(now.errors, key=lambda name: now.errors[name], default="its metrics")
    check = Check(f"error of {worst}", now.error, limit, "relative, estimated", told, action)
    return Converged(now, check, tuple(tried), shares)


def _largest_share(runs: _Runs, now: Tried, shares: dict[str, float], limit: float) -> Tried | None:
    """The run with the axis moved that changes the metrics most, by several notches where the
    ``limit`` is far. ``shares`` are kept up to date: of axes that were not moved since, they stand.
    """
    alone: dict[str, Tried] = {}
    for axis in runs.found:
        if axis.name in shares or axis.name in now.unmoved:
            continue
        one = runs.run(now, (axis,))
        if one is not None:
            alone[axis.name] = one
            shares[axis.name] = max(_differences(now, one).values(), default=0.0)
    for name in sorted(shares, key=lambda name: shares[name], reverse=True):
        axis = next(axis for axis in runs.found if axis.name == name)
        far = int(math.log(max(shares[name] / limit, 1.0)) / math.log(PER_NOTCH))
        most = 1 if axis.model else min(max(far, 1), FARTHEST)
        notches = _with_room(axis, now.notches.get(name, 0), most)
        if not notches:
            return None  # at its finest: what else is refined leaves its error
        near = alone.get(name) if notches == 1 else None
        following = near or runs.run(now, (axis,), notches)
        if following is not None:
            del shares[name]
            return following
    return None


def _with_room(axis: Axis, now: int, most: int) -> int:
    """By how many notches an axis can move so that one more would still change it."""
    return next((n for n in range(most, 0, -1) if axis.at(now + n) != axis.at(now + n + 1)), 0)


class _Runs:
    """Runs of a scene with axes moved, as many as are left."""

    def __init__(self, build: Build, found: Sequence[Axis], clock: Clock) -> None:
        self.build, self.found, self.clock, self.left = build, found, clock, MOST

    def finer(self, now: Tried) -> tuple[Tried | None, tuple[str, ...]]:
        """All axes a notch finer; without those of meshes where that is too much for the machine,
        and the names of these."""
        one = self.run(now, self.found)
        meshes = tuple(axis.name for axis in self.found if axis.model)
        if one is not None or not meshes:
            return one, ()
        rest = [axis for axis in self.found if not axis.model]
        return (self.run(now, rest) if rest else None), meshes

    def run(self, now: Tried, moved: Sequence[Axis], by: int = 1) -> Tried | None:
        """``now`` with these axes ``by`` notches finer; None where that has no result."""
        self.left -= 1
        if self.left < 0:
            return None
        notches = {**now.notches, **{a.name: now.notches.get(a.name, 0) + by for a in moved}}
        settings, names = keys_at(self.found, notches), ", ".join(axis.name for axis in moved)
        own = self.build
        try:
            scene = load_scene(own.scene, settings)
            found = evaluate(scene, self.clock, names, trust=own.trust, functions=own.functions)
        except (SimulationError, UsageError):
            return None
        return Tried(notches, settings, found)


def _differences(one: Tried, other: Tried) -> dict[str, float]:
    """Estimated relative error of each metric of ``one``."""
    found = changes(one.run, other.run, NEAR_ZERO)
    return {name: REMAINDER * change for name, change in found.items()}
