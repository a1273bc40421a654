"""Scenes, models and effort of a benchmark."""

from dataclasses import dataclass, replace
from pathlib import Path

from kc2spice.core.errors import UsageError
from kc2spice.core.progress import StageTimer
from kc2spice.scene.load import load_scene
from kc2spice.workflow.part_models import build_models

# A chip of a tenth of the unknowns and a field table of a quarter of the heights.
COARSE = ("kick.mesh.sectors=2", "kick.mesh.outer_rings=2", "kick.layers=33")
COARSE_CATCH = ("catch.positions=11", "checks.range=warn")
SHORT = ("solver.stop=2 ms",)


@dataclass(frozen=True)
class Setup:
    """How much to measure, where to work, and whom to tell.

    ``quick`` takes coarse models and few points.
    """

    quick: bool
    repeats: int
    work: Path
    clock: StageTimer

    def scene(self, name, *, lumped=True):
        """A gallery scene, coarse in a quick run.

        Contact ports keep their inertia: the benchmark's integrators know the paper's form alone.
        With ``lumped`` False they are as the product makes them, without.
        """
        sets = {"em_force": COARSE_CATCH, "kick_and_catch": (*COARSE, *COARSE_CATCH, *SHORT)}
        chosen = sets.get(name, COARSE) if self.quick else ()
        with_mass = lumped and "contact" in load_scene(name).parts
        return load_scene(name, (*chosen, *(("contact.inertia=lumped",) if with_mass else ())))

    def build(self, scene):
        """``scene`` with its models."""
        return build_models(scene, self.clock)

    def some(self, values, quick=2):
        """All ``values``, or the first few in a quick run."""
        return values[:quick] if self.quick else values


def keys_of(scene, kind):
    """The keys of the only part of a type.

    Raises
    ------
    UsageError : there is none, or more than one.
    """
    part = scene.find_only_part(kind)
    if part is None:
        raise UsageError("the benchmark needs one such part", where=scene.name, expected=kind)
    return part.keys


def changed(build, keys):
    """The same models under a scene with other dotted keys, none of which they depend on."""
    return replace(build, scene=load_scene(build.scene, keys))
