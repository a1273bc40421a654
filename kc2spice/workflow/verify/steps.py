"""What a time step buys: error of the impact against ngspice's accepted points."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from kc2spice.core.progress import Clock
from kc2spice.core.waveforms import Waveforms
from kc2spice.report.distance import compare
from kc2spice.report.html import Section, quantity
from kc2spice.report.verdict import StepPoint
from kc2spice.scene.schema import Scene
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.models import Models

TOLERANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
CEILINGS = (50e-9, 1e-6)  # s: the paper's step, and one that leaves all to the error control


def step_study(
    scene: Scene, models: Models, exact: Waveforms, clock: Clock, work: Path
) -> tuple[StepPoint, ...]:
    """The scene at every tolerance and step ceiling, against ``exact``, the same reduced model."""
    points = []
    with clock.stage("step study", "tolerances and step ceilings"):
        for max_step in CEILINGS:
            for reltol in TOLERANCES:
                solver = scene.solver.model_copy(update={"reltol": reltol, "max_step": max_step})
                deck = make_deck(scene.model_copy(update={"solver": solver}), models)
                waves = run_deck(deck, work)
                error = compare(waves, exact)
                points.append(
                    StepPoint(
                        reltol, max_step, int(waves.stats["accepted"]), waves.stats["cpu_s"],
                        error["trajectory_relative"], error["velocity_relative"],
                    )
                )  # fmt: skip
    return tuple(points)


def step_records(points: tuple[StepPoint, ...]) -> list[dict[str, Any]]:
    """The points as plain dictionaries."""
    return [asdict(point) for point in points]


def step_section(name: str, points: tuple[StepPoint, ...]) -> Section:
    """The study as a table of the page."""
    rows = [
        (
            f"{point.reltol:g}",
            quantity(point.max_step_s, "s"),
            f"{point.accepted}",
            quantity(point.cpu_s, "s", 3),
            "—" if point.position is None else f"{point.position:.2g}",
            "—" if point.velocity is None else f"{point.velocity:.2g}",
        )
        for point in points
    ]
    head = (
        "reltol", "largest step", "accepted points", "CPU time", "position over travel", "rebound",
    )  # fmt: skip
    note = "Errors are ngspice's alone, against the same reduced model integrated exactly."
    return Section(f"{name}: error against steps", rows, head, note)
