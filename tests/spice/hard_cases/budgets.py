"""Random kicks under error budgets: ``python tests/spice/hard_cases/budgets.py [FIRST LAST]``.

Every scene is run as ``kc2spice run`` runs it and judged by an own integrator on a model of 480
modes, all with their inertia: the budget holds, or the run says that it does not.
"""

from __future__ import annotations

import json
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.progress import Clock, silent
from kc2spice.parts.contact import kept_ports
from kc2spice.rom.massless import without_inertia
from kc2spice.rom.modal import resonators
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.scene.settings import Rom
from kc2spice.workflow import converge, run
from kc2spice.workflow.decks import libraries
from kc2spice.workflow.judge import metrics
from kc2spice.workflow.models import build_models

sys.path.insert(0, str(Path(__file__).parents[1]))
from hard_cases.modal_kick import Kick

COUNT = 100
START, FLIGHT, CATCH = 5e-6, 35e-6, 200e-6  # s: the kick, and what follows it
LATEST = 20e-6  # s after its start a kick upwards has thrown
EXACT_BAND = 0.0, 2e6  # Hz
RINGS = 6
ORACLES = (480, 0.5e-9), (320, 0.25e-9)  # modes, steps [s]; the first is the judge
# volts, damping ratio, width and edge [s], radius [m], density, penalty, budget: log-uniform
LOW = np.log([20.0, 1e-4, 5e-6, 1e-8, 0.5e-3, 3e3, 1e7, 1e-5])
HIGH = np.log([120.0, 3e-2, 5e-5, 2e-6, 1.5e-3, 15e3, 1e9, 1e-3])


@dataclass(frozen=True)
class Budgeted:
    """One draw: its ``error``, the oracle's own ``doubt`` of it, what the run ``said``, and whether
    the closer run was taken."""

    outcome: str
    budget: float
    error: float
    doubt: float
    said: float
    closer: bool
    keys: tuple[str, ...]


def drawn(number: int) -> tuple[float, tuple[str, ...]]:
    """Budget and keys of one scene; a fifth of the kicks are downwards, a third have a catch."""
    rng = np.random.default_rng((7, number))
    values = np.exp(LOW + (HIGH - LOW) * rng.random(LOW.size)).tolist()
    volts, damping, width, edge, radius, density, penalty, budget = values
    downwards, catch = rng.random(2) < (0.2, 1 / 3)
    keys = [
        f"kick.drive.voltage={-volts if downwards else volts!r}", f"kick.damping.ratio={damping!r}",
        f"kick.drive.width={width!r}", f"kick.drive.edge={min(edge, width)!r}",
        f"kick.drive.start={START}", f"contact.penalty={penalty!r}",
        f"sphere.density={density!r}", f"error_budget={budget!r}",
    ]  # fmt: skip
    stop = START + (width if downwards else min(width, LATEST))
    if catch:
        keys += [f"control.enable_at={START}", f"solver.stop={stop + CATCH!r}"]
    else:
        keys += [f"sphere.radius={radius!r}", f"solver.stop={stop + FLIGHT!r}"]
    return budget, tuple(keys)


def scene_of(keys: tuple[str, ...]) -> Scene:
    """The paper's loop with these keys, without its catch unless they enable it."""
    loop = load_scene("kick_and_catch")
    parts = ("kick", "contact", "sphere", "catch", "control")
    parts = parts if any(k.startswith("control.") for k in keys) else parts[:3]
    tables = {name: dict(loop.tables[name]) for name in parts}
    return load_scene({"name": "drawn", "gravity": 9.81, **tables}, keys)


@cache
def _chip(rings: int, rom: str) -> Any:
    """Resonators of the chip before their residual modes lose their inertia."""
    tables = {"kick": {}, "contact": {"rings": rings, "inertia": "lumped"}, "sphere": {}}
    found = load_scene(tables | {"rom": json.loads(rom)})
    return resonators(build_models(found, Clock(silent)).models["kick"])


def varied(scene: Scene, clock: Clock, **_: Any) -> Build:
    """Models of a scene, the chip's of one damping only: the basis depends on it in no way, as
    damping that is proportional to stiffness only scales with it."""
    chip = _chip(
        len(kept_ports(scene.parts["contact"], scene)), scene.rom.model_dump_json(exclude_none=True)
    )
    beta = scene.parts["kick"].keys.damping.beta
    damped = without_inertia(replace(chip, damp=beta * chip.omega**2), scene.rom.tolerance)
    others = (p for p in scene.parts.values() if p.name != "kick")
    models = {part.name: part.type.build(part, scene, clock) for part in others}
    return Build(scene, {"kick": damped.linear(), **models}, libraries(scene))


def judged(number: int) -> Budgeted:
    """Run one draw, and compare what it gives with the independent integrator."""
    budget, keys = drawn(number)
    run.build_models = converge.build_models = varied  # type: ignore[assignment]
    try:
        scene = scene_of(keys)
        with tempfile.TemporaryDirectory() as work, warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            done = run.complete(scene, Path(work))
    except (UsageError, SimulationError) as error:
        return Budgeted(f"refused: {error.message}", budget, np.nan, np.nan, np.nan, False, keys)
    finally:
        run.build_models = converge.build_models = build_models
    checks = [c for c in done.outcome.verdict.checks if c.name.startswith("error of ")]
    if not checks:
        left = metrics(done.outcome.waves, done.build).get("launch_time_s")
        what = "nothing leaves" if left is None else "NOT JUDGED"
        return Budgeted(what, budget, np.nan, np.nan, np.nan, False, keys)
    error, doubt = compared(done)
    outcome = "holds" if error <= budget else "said" if not checks[0].passed else "BROKEN, SILENT"
    if outcome.startswith("BROKEN") and error - doubt <= budget:
        outcome = "holds, as far as the oracle can tell"
    closer = any("the deck and models are those" in str(each.message) for each in said)
    return Budgeted(outcome, budget, error, doubt, checks[0].value, closer, keys)


def compared(done: run.Completed) -> tuple[float, float]:
    """Error of the speed after the last contact, or of the height over the travel, whichever is
    larger; and how far an oracle of fewer modes and finer steps is from it."""
    errors = [_error(done, order, step) for order, step in ORACLES]
    return errors[0], float(np.ptp(errors))


def _error(done: run.Completed, order: int, step: float) -> float:
    waves, scene = done.outcome.waves, done.build.scene
    time, parts = waves["time"], scene.parts
    ball, kick = parts["sphere"].keys, parts["kick"].keys
    chip = _chip(RINGS, Rom(order=order, band=EXACT_BAND).model_dump_json(exclude_none=True))
    weight = np.full(time.size, -ball.mass * scene.gravity)
    if "catch" in parts:
        pulled = parts["catch"].type.force_on(parts["catch"], "v", done.build, waves)
        weight += pulled
    pulse = kick.drive
    corners = np.array([0.0, pulse.edge, pulse.width, pulse.width + pulse.edge]) + pulse.start
    oracle = Kick(
        chip.omega, kick.damping.beta * chip.omega**2, chip.gain, kick.mesh.ring_spacing,
        ball.radius, ball.mass, 4 * parts["contact"].keys.penalty,
        np.stack([corners, pulse.voltage * np.array([0.0, 1.0, 1.0, 0.0])], axis=1),
        np.stack([time, weight], axis=1),
    )  # fmt: skip
    times, heights, speeds, touched = oracle.flight(step, float(time[-1]))
    at = max(touched, float(metrics(waves, done.build)["launch_time_s"]))
    exact = float(np.interp(at, times, speeds))
    speed = abs(np.interp(at, time, waves["sphere.v"]) / exact - 1)
    apart = np.abs(np.interp(time, times, heights) - (waves["sphere.y"] - ball.radius))
    return float(max(speed, apart.max() / np.ptp(heights)))


def budgets(first: int = 0, last: int = COUNT) -> Iterator[Budgeted]:
    """The draws ``first`` to ``last``."""
    return map(judged, range(first, last))


def main() -> None:
    """Print every draw, then how many budgets held."""
    count = Counter[str]()
    print("     budget   error    oracle   stated   closer run  outcome")
    first, last = map(int, sys.argv[1:3]) if len(sys.argv) > 2 else (0, COUNT)
    for number, found in enumerate(budgets(first, last), first):
        count[found.outcome] += 1
        closer = "is the result" if found.closer else ""
        print(f"{number:3d}  {found.budget:.1e}  {found.error:.1e}  {found.doubt:.0e}  "
              f"{found.said:.1e}  {closer:13s}  {found.outcome}", flush=True)  # fmt: skip
        if found.outcome in ("BROKEN, SILENT", "NOT JUDGED"):
            print("    ", *found.keys, flush=True)
    print(dict(count))


if __name__ == "__main__":
    main()
