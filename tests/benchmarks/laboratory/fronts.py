"""Part ``fronts``: does each scene of the gallery ship with a setting that no neighbour beats?"""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

from kc2spice.core.errors import SimulationError
from kc2spice.scene.load import gallery, load_scene
from kc2spice.scene.model import Scene
from kc2spice.workflow.bench.plane import NEGLIGIBLE, Plane, measure, search
from kc2spice.workflow.sweep.workers import cores
from laboratory.points import Outcome, Ratio, rounds
from laboratory.setup import Setup

LEAST = 3  # rounds where a run takes long: their medians decide
RIVAL = (
    "label", "settings", "error", "bound", "time_s", "time_low_s", "time_high_s", "repeats", "own",
)  # fmt: skip
QUICK = ("newtons_cradle", "buzzer_7bb_12_9")


def fronts(setup: Setup) -> Outcome:
    """Errors of all settings on all cores, then the times of the few that count, one by one."""
    names = QUICK if setup.quick else sorted(gallery())
    with setup.clock.stage("fronts", f"settings of {len(names)} scenes") as share:
        planes = dict(_searched(names, share))
    found = {}
    for k, name in enumerate(names):
        setup.clock.progress("fronts", k / len(names), f"times of {name}")
        found[name] = _place(planes[name], setup.repeats)
    return Outcome(ratios=(beaten(found),), fronts=found)


def beaten(found: Mapping[str, Mapping[str, Any]]) -> Ratio:
    """Number of scenes with a better setting and no reason to keep theirs, or without a result."""
    names = [
        name for name, front in found.items()
        if "why" in front or (front["nearest"] and not front["keep"])
    ]  # fmt: skip
    what = "scenes of the gallery that a setting next to their own beats, without a reason to keep"
    return Ratio(
        "fronts_beaten", float(len(names)), None, 0.0, f"{what}: {', '.join(names) or 'none'}",
        at_least=False,
    )  # fmt: skip


def _searched(names: Sequence[str], share: Any) -> Iterable[tuple[str, Plane | str]]:
    """The searched plane of each scene, those of many steps first."""
    order = sorted(names, key=lambda name: _steps(load_scene(name)), reverse=True)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(cores(), mp_context=context) as pool:
        for done, item in enumerate(pool.map(_search, order)):
            share(done / len(order))
            yield item


def _steps(scene: Scene) -> float:
    return scene.stop / scene.solver.max_step if scene.analysis.type == "transient" else 0.0


def _search(name: str) -> tuple[str, Plane | str]:
    """The plane, or why there is none: one scene must not cost the other parts their record."""
    try:
        return name, search(partial(_loaded, name), error=None)
    except SimulationError as error:
        return name, " ".join(f"{error.message} {error.got or ''}".split())


def _loaded(name: str, more: Sequence[str]) -> Scene:
    return load_scene(name, list(more))


def _place(plane: Plane | str, repeats: int) -> dict[str, Any]:
    """What is recorded of one scene."""
    if isinstance(plane, str):
        return {"why": plane, "nearest": None, "keep": ""}
    record = measure(plane, max(rounds([plane.own.time], repeats), min(repeats, LEAST)))
    place, own = record["own"], next(point for point in record["points"] if point["own"])
    floor = max(record["reference"]["error"], NEGLIGIBLE)
    return {
        "error": max(own["error"], own["bound"], floor), "time_s": own["time_s"],
        "tried": len(record["points"]) + len(record["failed"]), "keep": plane.load([]).bench.keep,
        "nearest": None if place["on_front"] else {"label": place.pop("nearest"), **place},
        "left_out": record["left_out"], "reference": record["reference"],
        "rivals": [
            {key: point[key] for key in RIVAL}
            for point in record["points"] if point["repeats"] == own["repeats"]
        ],
    }  # fmt: skip
