"""From a scene and its models to a deck, whichever experiment it is."""

from __future__ import annotations

from kc2spice.parts.experiments import scene_deck
from kc2spice.scene.hash import scene_hash
from kc2spice.scene.schema import Scene
from kc2spice.spice.circuit import Deck
from kc2spice.spice.header import Header
from kc2spice.spice.included import included_netlists
from kc2spice.spice.naming import with_design_names
from kc2spice.workflow.models import Models


def make_deck(scene: Scene, models: Models, *, trust: bool = False) -> Deck:
    """The testbench of ``scene`` with the libraries that it includes.

    ``trust`` lets included files act on the machine (see :mod:`kc2spice.spice.scan`).

    Raises
    ------
    UsageError : an included file that is missing or could act on the machine.
    """
    kick = models.kick
    deck = scene_deck(
        scene,
        Header(scene.name, scene_hash(scene)),
        model=None if kick is None else kick.resonators,
        ring_radii=None if kick is None else kick.ring_radii,
        table=models.table,
        included=included_netlists(scene, trust=trust),
    )
    return with_design_names(deck)
