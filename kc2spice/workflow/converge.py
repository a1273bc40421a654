"""The error of every metric, from runs of the same scene with its numerical settings refined.

Every setting that trades time for error is an axis with one notch finer. A refined run moves all
axes by a notch; what a metric changes by is its estimated error, times :data:`REMAINDER`. A scene
with an ``error_budget`` goes along the axis with the largest share, which is what moving it alone
changes, until the estimate holds for every metric, or says what it tried.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.progress import Clock
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.scene.settings import Action, Rom
from kc2spice.sim.retries import Outcome
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.judge import metrics
from kc2spice.workflow.models import build_models
from kc2spice.workflow.simulate import simulate

MOST = 12  # runs besides the scene's own
LIMIT = 1e-2  # error_budget where checks.reduction asks without one
TENTH, HALF, MORE, WIDER = 0.1, 0.5, 1.5, 2.0  # one notch: of tolerances, steps, states, bands
FINEST = 1e-7  # reltol: below it ngspice's iterations end in rounding
# A notch leaves a third of an axis' error at most: the change is two thirds of the error at least.
REMAINDER = 1.5
NEAR_ZERO = 0.1  # of the largest metric in its unit: what a small one is judged by
SHRINKS = 0.8  # from one estimate to the next, or the axes do not converge


@dataclass(frozen=True)
class Axis:
    """A setting: its value today in words, and the scene one notch finer along it."""

    name: str
    today: str
    finer: Callable[[Scene], Scene]


def axes(build: Build) -> tuple[Axis, ...]:
    """The settings of a scene that trade time for error."""
    return tuple(_axes(build))


def _axes(build: Build) -> Iterator[Axis]:
    scene = build.scene
    if scene.analysis.type == "transient":
        step = None if build.largest is None else build.largest.step
        now = scene.solver
        words = f"reltol {now.reltol:g}, chgtol {now.chgtol:g}"
        yield Axis(
            "time steps", words if step is None else f"{words}, at most {step:.3g} s",
            lambda s: _finer_steps(s, step),
        )  # fmt: skip
    elif scene.analysis.type == "ac":
        yield Axis(
            "frequencies",
            f"{scene.analysis.points} points",
            lambda s: _framed(s, "analysis", {"points": min(2 * s.analysis.points, 200_000)}),
        )
    reduced = [part for part in scene.parts.values() if part.type.reduced]
    if reduced:
        roms = {part.name: part.type.reduction(part, scene) for part in reduced}
        words = ", ".join(f"{n}: {_target(rom)}" for n, rom in roms.items() if rom is not None)
        yield Axis("reduction", words, lambda s: _finer_models(s, build))
    for part in scene.parts.values():
        key = part.type.lookup_key
        if key is not None:
            name, points = part.name, getattr(part.keys, key)
            finer = partial(_finer_lookup, name=name, key=key)
            yield Axis(f"lookup of {name}", f"{points} points", finer)


def _target(rom: Rom) -> str:
    return f"order {rom.order}" if rom.tolerance is None else f"tolerance {rom.tolerance:g}"


def _framed(scene: Scene, section: str, values: Mapping[str, Any]) -> Scene:
    table = getattr(scene.frame, section).model_copy(update=dict(values))
    return replace(scene, frame=scene.frame.model_copy(update={section: table}))


def _finer_steps(scene: Scene, derived: float | None) -> Scene:
    now = scene.solver
    step = now.max_step or derived
    values: dict[str, Any] = {
        "reltol": max(TENTH * now.reltol, min(FINEST, now.reltol)), "chgtol": TENTH * now.chgtol,
        "ringing": "followed",
    }  # fmt: skip
    return _framed(scene, "solver", values | ({} if step is None else {"max_step": HALF * step}))


def _finer_models(scene: Scene, build: Build) -> Scene:
    timed = scene.analysis.type == "transient"
    parts, frame = dict(scene.parts), scene.frame
    for part in scene.parts.values():
        rom = part.type.reduction(part, scene) if part.type.reduced else None
        if rom is None:
            continue
        model = build.model(part)
        certificate = getattr(model, "certificate", None)
        own = "rom" in scene.frame.model_fields_set or getattr(part.keys, "rom", None) is not None
        band = rom.band if own or certificate is None else certificate.band_hz
        band = (band[0], WIDER * band[1]) if timed else band
        if rom.tolerance is None:
            finer = Rom(order=math.ceil(MORE * float(rom.order or 1)), band=band)
        else:
            finer = Rom(tolerance=max(TENTH * rom.tolerance, 1e-10), band=band)
        follows = getattr(part.keys, "rom", None) is None and rom == scene.rom
        if follows or not hasattr(part.keys, "rom"):
            frame = frame.model_copy(update={"rom": finer})
        else:
            parts[part.name] = replace(part, keys=part.keys.model_copy(update={"rom": finer}))
    return replace(scene, parts=parts, frame=frame)


def _finer_lookup(scene: Scene, name: str, key: str) -> Scene:
    part = scene.parts[name]
    keys = part.keys.model_copy(update={key: 2 * getattr(part.keys, key) - 1})
    return replace(scene, parts={**scene.parts, name: replace(part, keys=keys)})


# --- runs and their differences -------------------------------------------------------------------


@dataclass(frozen=True)
class Tried:
    """A scene's run: what moved since the first, its metrics, the estimated error of each where a
    refined run followed."""

    moved: tuple[str, ...]
    build: Build
    outcome: Outcome
    errors: Mapping[str, float]

    @property
    def error(self) -> float:
        """The largest of all metrics."""
        return max(self.errors.values(), default=math.inf)

    def record(self) -> dict[str, Any]:
        """Its row of ``result.json``."""
        return {
            "finer": list(self.moved),
            "settings": {axis.name: axis.today for axis in axes(self.build)},
            "errors": {name: _plain(error) for name, error in self.errors.items()},
        }


@dataclass(frozen=True)
class Converged:
    """The run that is taken, whether its estimate holds the budget, why not, and all estimates."""

    taken: Tried
    check: Check
    tried: tuple[Tried, ...]
    shares: Mapping[str, float]

    def record(self) -> dict[str, Any]:
        """``convergence`` of ``result.json``."""
        return {
            "budget": self.check.limit,
            "held": self.check.passed,
            "errors": {name: _plain(error) for name, error in self.taken.errors.items()},
            "shares": {name: _plain(error) for name, error in self.shares.items()},
            "tried": [each.record() for each in self.tried],
        }


def _plain(error: float) -> float | None:
    return error if math.isfinite(error) else None


def converge(build: Build, outcome: Outcome, clock: Clock) -> Converged | None:
    """Refine the scene until the estimated error of every metric is within ``error_budget``.

    Without a budget ``checks.reduction`` asks for one estimate; None where neither does.
    """
    scene, budget = build.scene, build.scene.error_budget
    action: Action = scene.checks.reduction or ("off" if budget is None else "warn")
    if action == "off":
        return None
    limit, left = budget or LIMIT, MOST
    now = Tried((), build, outcome, {})
    tried: list[Tried] = []
    shares: dict[str, float] = {}
    why, last = "", math.inf
    while True:
        found = axes(now.build)
        finer = _run(now, found, clock)
        left -= 1
        if finer is None:
            why = "a refined run failed"
            break
        now = replace(now, errors=_differences(now, finer))
        tried.append(now)
        if now.error <= limit or budget is None:
            break
        if now.error > SHRINKS * last:
            why = f"the estimate does not shrink: {last:.2g}, then {now.error:.2g}"
        last = now.error
        if left < len(found) + 1:
            why = why or f"{MOST} runs do not suffice"
            break
        alone = {axis.name: _run(now, (axis,), clock) for axis in found} if len(found) > 1 else {}
        left -= len(alone)
        shares = {
            name: max(_differences(now, each).values(), default=0.0)
            for name, each in alone.items() if each is not None
        }  # fmt: skip
        best = max(shares, key=lambda name: shares[name], default="")
        following = alone.get(best) or finer
        now = replace(following, errors={})
    told = f"raise error_budget, or refine what it was tried with ({why})" if why else "raise it"
    worst = max(now.errors, key=lambda name: now.errors[name], default="its metrics")
    check = Check(f"error of {worst}", now.error, limit, "relative, estimated", told, action)
    return Converged(now, check, tuple(tried), shares)


def _run(now: Tried, moved: tuple[Axis, ...], clock: Clock) -> Tried | None:
    """The scene with these axes a notch finer; None where that has no result."""
    scene = now.build.scene
    for axis in moved:
        scene = axis.finer(scene)
    names = tuple(axis.name for axis in moved)
    try:
        build = build_models(scene, clock, trust=now.build.trust, functions=now.build.functions)
        with clock.stage("refined run", ", ".join(names)), tempfile.TemporaryDirectory() as folder:
            outcome = simulate(build, make_deck(build), Path(folder))
    except (SimulationError, UsageError):
        return None
    return Tried((*now.moved, *names), build, outcome, {})


def _differences(one: Tried, other: Tried) -> dict[str, float]:
    """Estimated relative error of each metric of ``one``; a curve's is of its largest value, that
    of a small number of :data:`NEAR_ZERO` of the largest in its unit."""
    ours, theirs = (dict(_numbers(metrics(t.outcome.waves, t.build))) for t in (one, other))
    largest: dict[str, float] = {}
    for name, value in theirs.items():
        unit = name.rpartition("_")[2]
        largest[unit] = max(largest.get(unit, 0.0), float(np.abs(value).max(initial=0.0)))
    found = {}
    for name, value in theirs.items():
        mine = ours.get(name)
        if mine is None or mine.shape != value.shape or not np.isfinite(mine).all():
            found[name] = math.inf if value.shape == () else 0.0  # curves over other points
            continue
        scale = max(float(np.abs(value).max()), NEAR_ZERO * largest[name.rpartition("_")[2]])
        apart = float(np.abs(mine - value).max())
        found[name] = REMAINDER * apart / scale if scale else 0.0
    return found


def _numbers(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, np.ndarray]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _numbers(value, f"{prefix}{key}.")
        elif isinstance(value, (bool, int, float, list, np.ndarray, np.number)):
            array = np.asarray(value)
            if array.dtype.kind in "bif" and array.size and np.isfinite(array.astype(float)).all():
                yield f"{prefix}{key}", array.astype(float)
