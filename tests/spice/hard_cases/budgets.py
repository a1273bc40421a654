"""Random kicks under error budgets: ``python tests/spice/hard_cases/budgets.py [FIRST LAST]``.

Every scene is run as ``kc2spice run`` runs it and judged by the independent integrator on a
model of 96 states: the budget holds, or the run says that it does not.
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
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.contact import kept_ports
from kc2spice.rom.massless import without_inertia
from kc2spice.rom.modal import resonators
from kc2spice.scene.gates import Gate
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.scene.settings import Rom
from kc2spice.workflow import richer, run
from kc2spice.workflow.decks import libraries
from kc2spice.workflow.models import build_models
from kc2spice.workflow.verify.circuit import solve
from kc2spice.workflow.verify.compare import measured, solution

COUNT = 100
START, FLIGHT, CATCH = 5e-6, 35e-6, 200e-6  # s: the kick, and what follows it
LATEST = 20e-6  # s after its start a kick upwards has thrown
EXACT = Rom(order=96, band=(0.0, 2e6))
LAUNCH = "launch_velocity_m_s"
# volts, damping ratio, width and edge [s], radius [m], density, penalty, budget: log-uniform
LOW = np.log([20.0, 1e-4, 5e-6, 1e-8, 0.5e-3, 3e3, 1e7, 1e-5])
HIGH = np.log([120.0, 3e-2, 5e-5, 2e-6, 1.5e-3, 15e3, 1e9, 1e-3])


@dataclass(frozen=True)
class Budgeted:
    """One draw: its ``error``, what the run ``said`` of it, whether the closer run was taken."""

    outcome: str
    budget: float
    error: float
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
    run.build_models = richer.build_models = varied  # type: ignore[assignment]
    try:
        scene = scene_of(keys)
        with tempfile.TemporaryDirectory() as work, warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            done = run.complete(scene, Path(work))
    except (UsageError, SimulationError) as error:
        return Budgeted(f"refused: {error.message}", budget, np.nan, np.nan, False, keys)
    finally:
        run.build_models = richer.build_models = build_models
    checks = [c for c in done.outcome.verdict.checks if c.name.startswith(richer.NAME)]
    ours = solution(done.outcome.waves, done.build)
    if not checks:
        what = "nothing leaves" if ours.metrics.get(LAUNCH) is None else "NOT JUDGED"
        return Budgeted(what, budget, np.nan, np.nan, False, keys)
    frame = scene.frame.model_copy(update={"rom": EXACT})
    build = varied(replace(scene, frame=frame), Clock(silent))
    exact = solution(solve(build, Waveforms(_apart(done.outcome.waves["time"]), {})).results, build)
    gates = Gate(LAUNCH, LAUNCH, {}), Gate("y", "sphere.y", {}, "travel")
    error = max(np.inf if e is None else e for e in (measured(g, ours, exact) for g in gates))
    outcome = "holds" if error <= budget else "said" if not checks[0].passed else "BROKEN, SILENT"
    closer = any("closer run is the result" in str(each.message) for each in said)
    return Budgeted(outcome, budget, error, checks[0].value, closer, keys)


def _apart(time: np.ndarray) -> dict[str, np.ndarray]:
    return {"time": time[np.unique(np.linspace(0, time.size - 1, 2000).astype(int))]}


def budgets(first: int = 0, last: int = COUNT) -> Iterator[Budgeted]:
    """The draws ``first`` to ``last``."""
    return map(judged, range(first, last))


def main() -> None:
    """Print every draw, then how many budgets held."""
    count = Counter[str]()
    print("     budget   error    stated   closer run  outcome")
    first, last = map(int, sys.argv[1:3]) if len(sys.argv) > 2 else (0, COUNT)
    for number, found in enumerate(budgets(first, last), first):
        count[found.outcome] += 1
        closer = "is the result" if found.closer else ""
        print(f"{number:3d}  {found.budget:.1e}  {found.error:.1e}  {found.said:.1e}  {closer:13s}"
              f"  {found.outcome}", flush=True)  # fmt: skip
        if found.outcome in ("said", "BROKEN, SILENT", "NOT JUDGED"):
            print("    ", *found.keys, flush=True)
    print(dict(count))


if __name__ == "__main__":
    main()
