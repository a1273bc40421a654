"""Scenes, models and effort of a benchmark."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from kc2spice.core.progress import Clock
from kc2spice.scene.load import load_scene
from kc2spice.scene.schema import Rom, Scene
from kc2spice.workflow.models import Models, build_models

T = TypeVar("T")

# A chip of a tenth of the unknowns and a field table of a quarter of the heights.
COARSE = ("kick.mesh.sectors=2", "kick.mesh.outer_rings=2", "kick.layers=33")
COARSE_CATCH = ("catch.positions=11",)
SHORT = ("solver.stop=2 ms",)


@dataclass(frozen=True)
class Setup:
    """How much to measure, where to work, and whom to tell.

    ``quick`` takes coarse models and few points; ``full_sweep`` runs what is otherwise sampled.
    """

    quick: bool
    full_sweep: bool
    repeats: int
    work: Path
    clock: Clock

    def scene(self, name: str) -> Scene:
        """A gallery scene, coarse in a quick run."""
        if not self.quick:
            return load_scene(name)
        sets = {"em_force": COARSE_CATCH, "kick_and_catch": (*COARSE, *COARSE_CATCH, *SHORT)}
        return load_scene(name, sets.get(name, COARSE))

    def models(self, scene: Scene, rom: Rom | None = None) -> Models:
        """Models of ``scene``, or of another reduction of it."""
        if rom is not None:
            scene = scene.model_copy(update={"rom": rom})
        return build_models(scene, self.clock)

    def some(self, values: tuple[T, ...], quick: int = 2) -> tuple[T, ...]:
        """All ``values``, or the first few in a quick run."""
        return values[:quick] if self.quick else values
