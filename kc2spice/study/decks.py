"""From a scene and its models to a deck, whichever experiment it is."""

from __future__ import annotations

from kc2spice.errors import UsageError
from kc2spice.netlist.circuit import Deck
from kc2spice.netlist.header import Header
from kc2spice.parts.experiments import scene_deck
from kc2spice.scene.hash import scene_hash
from kc2spice.scene.schema import Scene
from kc2spice.study.models import Models

DIALECTS = ("ngspice",)


def make_deck(scene: Scene, models: Models, dialect: str = "ngspice") -> Deck:
    """The testbench of ``scene`` with the libraries that it includes.

    Raises
    ------
    UsageError : a dialect that cannot be written.
    """
    if dialect not in DIALECTS:
        raise UsageError(
            "unknown dialect", where="--dialect", got=dialect, expected=", ".join(DIALECTS)
        )
    header = Header(scene.name, scene_hash(scene))
    kick = models.kick
    return scene_deck(
        scene,
        header,
        model=None if kick is None else kick.resonators,
        ring_radii=None if kick is None else kick.ring_radii,
        table=models.table,
    )
