"""What reduction and time steps do to a launch or rebound: the same scene with more of both.

The certificate of a reduced model is that of its response over a band. Contact excites the body far
above it, so that a launch may be off by more: 30 states of the paper's chip miss it by 1e-4 for the
paper's pulse, by 5e-3 for the same pulse downwards.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.progress import Clock
from kc2spice.scene.gates import Gate
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import Build
from kc2spice.scene.settings import Action, Rom
from kc2spice.sim.retries import Outcome
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.models import build_models
from kc2spice.workflow.simulate import simulate
from kc2spice.workflow.verify.compare import Solution, measured, solution

NAME = "error of the "  # and the speed
WIDEST = 2e6  # Hz, band of the richer model at least
CLOSER, CLOSEST = 0.1, 1e-7  # times reltol and chgtol; no deck asks for less than that reltol
DEARER = 9.0  # times a run: 4.6 times the points, of twice the states
LIMIT = 1e-2  # error_budget where the scene has one
NEAR = 0.3  # of its limit: a check of too coarse steps that passes, but leaves a doubt
# Error of the closer run over its distance from the first: 0.2 to 0.45 seen; where a part has
# doubts both are off by as much, in any direction: 63 V at 0.05 % damping launch 3.2e-3 and 2.0e-3
# off in runs that are 1.1e-3 apart, -61 V at 0.04 % 6.5e-3 off in runs that are 3e-3 apart.
SHRINKS, DOUBTED = 0.5, 2.0
# What a budget allows for besides, for a doubt, and thrice for two: at 0.3 % damping 39 and 78
# states agree to 5e-5 and are 5e-4 off, a kick by -76 V at 0.13 % is 1.1e-3 off.
ALLOWED = 5e-4


@dataclass(frozen=True)
class Closer:
    """The closer run of a scene, what it says of the first one, and what it is off itself."""

    build: Build
    outcome: Outcome
    check: Check
    own: Check


def estimated(build: Build) -> tuple[str, ...]:
    """Metrics by which the certificate of a reduced body is judged, as it meets something.

    Those that a gate of the scene compares by their own size; none where nothing is reduced.
    """
    scene = build.scene
    if scene.analysis.type != "transient" or not any(p.type.reduced for p in scene.parts.values()):
        return ()
    gates = (gate for p in scene.parts.values() for gate in p.type.gates(p, build))
    return tuple(gate.of for gate in gates if gate.measure == "relative")


def doubts(build: Build, outcome: Outcome) -> Iterator[str]:
    """Why a launch may be worse than its settings say: what parts know to be sensitive, and checks
    of too coarse steps that are near their limits."""
    scene = build.scene
    for part in scene.parts.values():
        yield from part.type.doubts(part, scene)
    for check in outcome.verdict.checks:
        if check.coarse and check.value > NEAR * check.limit:
            yield f"{check.name} {check.value:.2g}, limit {check.limit:.2g}"


def closer_run(build: Build, outcome: Outcome, clock: Clock) -> Closer | Check | None:
    """A run with twice the states, at least 60, over 2 MHz at least, and a tenth of the tolerances;
    its check says how far off the speed is, or heights over the travel, whichever is farther: the
    distance from the closer run, and what that may be off itself.

    None where nothing asks for it (``checks.reduction``, an error budget, :func:`doubts`) or
    nothing leaves; where it fails, a check whose value is not a number.
    """
    scene, usual = build.scene, _reason(build, outcome)
    action: Action = scene.checks.reduction or ("warn" if usual else "off")
    ours = solution(outcome.waves, build)
    key = next((key for key in estimated(build) if ours.metrics.get(key)), None)
    if action == "off" or key is None:
        return None
    check = Check(
        f"{NAME}{key.rpartition('_m_s')[0].replace('_', ' ')}", math.nan,
        scene.error_budget or LIMIT, "of it or of the travel",
        "this contact needs more: raise rom.order and rom.band, lower solver.reltol and .chgtol",
        action,
    )  # fmt: skip
    other = richer(build)
    seconds = DEARER * outcome.attempts[-1].wall_s
    text = f"{other.rom.order} states and a tenth of the tolerances, up to {seconds:.0f} s and the "
    text += f"reduction, because of {usual or 'checks.reduction'}"
    clock.progress("closer run", None, text)
    try:
        closer = build_models(other, clock, trust=build.trust)
        with clock.stage("closer run", "ngspice"), tempfile.TemporaryDirectory() as directory:
            found = simulate(closer, make_deck(closer), Path(directory))
        apart = _apart(scene, key, ours, solution(found.waves, closer))
    except SimulationError:
        return check
    own = _own_error(scene, apart)
    return Closer(closer, found, replace(check, value=apart + own), replace(check, value=own))


def _own_error(scene: Scene, apart: float) -> float:
    """What the closer run may be off, ``apart`` from the first: a share of that distance, larger
    where parts have doubts, and under a budget what is allowed for these besides."""
    found = sum(1 for p in scene.parts.values() for _ in p.type.doubts(p, scene))
    allowed = 0.0 if scene.error_budget is None else ALLOWED * (2**found - 1)
    return (DOUBTED if found else SHRINKS) * apart + allowed


def _reason(build: Build, outcome: Outcome) -> str:
    """What asks for a closer run, in words; empty where nothing does."""
    if build.scene.error_budget is not None:
        return f"error_budget {build.scene.error_budget:g}"
    return "; ".join(doubts(build, outcome))


def _apart(scene: Scene, key: str, ours: Solution, closer: Solution) -> float:
    """Largest relative difference of speeds, and of heights over the travel."""
    gates = [Gate(key, key, {})]
    heights = [f"{part}.y" for part in scene.parts if f"{part}.y" in closer.waves]
    gates += [Gate(name, name, {}, "travel") for name in heights]
    found = [measured(gate, ours, closer) for gate in gates]
    return float(np.max([math.nan if value is None else value for value in found]))


def richer(build: Build) -> Scene:
    """The scene with twice the states of each reduced body, at least 60, over a wider band, closer
    steps and twice the points of lookups."""
    scene = build.scene
    orders = [_order(build.model(part)) for part in scene.parts.values() if part.type.reduced]
    high = max(WIDEST, 4 * scene.rom.band[1])
    rom = Rom(order=max(60, *(2 * order for order in orders)), band=(0.0, high))
    parts = {name: _finer(_without_rom(part)) for name, part in scene.parts.items()}
    steps = scene.solver
    update = {"rom": rom, "solver": steps.model_copy(update={"ringing": "followed"})}
    followed = replace(scene, frame=scene.frame.model_copy(update=update), parts=parts)
    # Of what the deck asks for: a part may ask for less where its ringing is followed.
    now = steps.reltol * _closeness(scene)
    reltol = min(now, max(CLOSEST, CLOSER * now)) / _closeness(followed)
    update["solver"] = update["solver"].model_copy(
        update={"reltol": reltol, "chgtol": CLOSER * steps.chgtol}
    )
    return replace(followed, frame=scene.frame.model_copy(update=update))


def _closeness(scene: Scene) -> float:
    return min(part.type.closeness(part, scene) for part in scene.parts.values())


def _order(model: Any) -> int:
    return int(getattr(model, "order", 0))


def _finer(part: Part) -> Part:
    """The part with twice the points of its lookup, if it has one."""
    key = part.type.lookup_key
    if key is None:
        return part
    points = 2 * getattr(part.keys, key) - 1
    return replace(part, keys=part.keys.model_copy(update={key: points}))


def _without_rom(part: Part) -> Part:
    """The part with the reduction of the scene instead of its own."""
    if getattr(part.keys, "rom", None) is None:
        return part
    return replace(part, keys=part.keys.model_copy(update={"rom": None}))
