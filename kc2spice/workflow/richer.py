"""What reduction and time steps do to a launch or rebound: the same scene with more of both.

The certificate of a reduced model is that of its response over a band. Contact excites the body far
above it, so that a launch may be off by more: 30 states of the paper's chip miss it by 1e-4 for the
paper's pulse, by 5e-3 for the same pulse downwards.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.progress import Clock
from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import Build
from kc2spice.scene.settings import Action, Rom
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.judge import metrics
from kc2spice.workflow.models import build_models
from kc2spice.workflow.simulate import simulate

NAME = "error of the "  # and the speed
WIDEST = 2e6  # Hz, band of the richer model at least
CLOSER, CLOSEST = 0.1, 1e-6  # times reltol and chgtol, which is not below that
LIMIT = 1e-2  # error_budget where the scene has one


def estimated(build: Build) -> tuple[str, ...]:
    """Metrics by which the certificate of a reduced body is judged, as it meets something.

    Those that a gate of the scene compares by their own size; none where nothing is reduced.
    """
    scene = build.scene
    if scene.analysis.type != "transient" or not any(p.type.reduced for p in scene.parts.values()):
        return ()
    gates = (gate for p in scene.parts.values() for gate in p.type.gates(p, build))
    return tuple(gate.of for gate in gates if gate.measure == "relative")


def reduction_check(build: Build, waves: Waveforms, clock: Clock) -> Check | None:
    """How far a run is from one with twice the states, at least 60, over 2 MHz at least, and with
    a tenth of its tolerances: its speed, or its heights over the travel, whichever is farther.

    None where the scene does not ask for it, or nothing leaves. Where the second run fails, the
    error is not a number.
    """
    scene = build.scene
    usual: Action = "off" if scene.error_budget is None else "warn"
    action = scene.checks.reduction or usual
    if action == "off":
        return None
    ours = metrics(waves, build)
    key = next((key for key in estimated(build) if ours.get(key)), None)
    if key is None:
        return None
    try:
        other = build_models(richer(build), clock, trust=build.trust)
        with tempfile.TemporaryDirectory(prefix="kc2spice-") as directory:
            closer = simulate(other, make_deck(other), Path(directory)).waves
        value = _apart(scene, ours[key], metrics(closer, other).get(key), waves, closer)
    except SimulationError:
        value = float("nan")
    return Check(
        f"{NAME}{key.rpartition('_m_s')[0].replace('_', ' ')}", value,
        scene.error_budget or LIMIT, "of it or of the travel",
        "this contact needs more: raise rom.order and rom.band, lower solver.reltol and .chgtol",
        action,
    )  # fmt: skip


def _apart(
    scene: Scene, ours: float, theirs: float | None, waves: Waveforms, closer: Waveforms
) -> float:
    """Largest relative difference of speeds, and of heights over the travel."""
    found = [float("nan") if theirs is None else abs(ours / theirs - 1.0)]
    for name in (f"{part}.y" for part in scene.parts if f"{part}.y" in waves):
        exact = np.interp(waves["time"], closer["time"], closer[name])
        found.append(float(np.abs(waves[name] - exact).max() / np.ptp(exact)))
    return float(np.max(found))


def richer(build: Build) -> Scene:
    """The scene with twice the states of each reduced body, at least 60, over a wider band, and
    closer steps."""
    scene = build.scene
    orders = [_order(build.model(part)) for part in scene.parts.values() if part.type.reduced]
    high = max(WIDEST, 4 * scene.rom.band[1])
    rom = Rom(order=max(60, *(2 * order for order in orders)), band=(0.0, high))
    parts = {name: _without_rom(part) for name, part in scene.parts.items()}
    steps = scene.solver
    reltol = min(steps.reltol, max(CLOSEST, CLOSER * steps.reltol))
    update = {"reltol": reltol, "chgtol": CLOSER * steps.chgtol, "ringing": "followed"}
    closer = steps.model_copy(update=update)
    frame = scene.frame.model_copy(update={"rom": rom, "solver": closer})
    return replace(scene, frame=frame, parts=parts)


def _order(model: Any) -> int:
    return int(getattr(model, "order", 0))


def _without_rom(part: Part) -> Part:
    """The part with the reduction of the scene instead of its own."""
    if getattr(part.keys, "rom", None) is None:
        return part
    return replace(part, keys=part.keys.model_copy(update={"rom": None}))
