"""The figures of one run, by its experiment."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.magnetics.table import EMTable
from kc2spice.report.loop_figures import force_map, loop_figures
from kc2spice.report.plots import Picture
from kc2spice.report.verify_figures import harmonic_figures, impact_figures, imprint_figures
from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene


def model_figures(directory: Path, scene: Scene, table: EMTable | None) -> list[Picture]:
    """Draw what is known before anything is simulated: the force map of a catch."""
    return [] if table is None else [force_map(directory / "em_force.png", table, scene)]


def run_figures(
    directory: Path, scene: Scene, waves: Waveforms, reference: Waveforms | None = None
) -> list[Picture]:
    """Draw what ngspice gave, over the independent ``reference`` where there is one."""
    if scene.experiment == "em_force":
        return []
    if scene.experiment == "loop":
        return loop_figures(directory, waves, scene, None, reference)
    roads = {"ngspice": waves} if reference is None else {"scipy": reference, "ngspice": waves}
    return verify_figures(directory, scene, roads)


def verify_figures(
    directory: Path,
    scene: Scene,
    roads: Mapping[str, Waveforms],
    table: EMTable | None = None,
) -> list[Picture]:
    """Draw the roads of a verification over each other, the most exact one first."""
    if scene.experiment == "em_force":
        return [force_map(directory / "em_force.png", need(table, "catch"), scene)]
    if scene.experiment == "loop":
        (_, reference), (_, waves) = roads.items()
        return loop_figures(directory, waves, scene, table, reference)
    if scene.experiment == "impact":
        return impact_figures(directory, roads, need(scene.sphere, "sphere").radius)
    draw = imprint_figures if scene.experiment == "imprint" else harmonic_figures
    return draw(directory, roads)
