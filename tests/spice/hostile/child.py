"""Runs the scenes named on the command line as the product does; prints what became of each.

A program of its own, so that all that it touches can be traced.
"""

import json
import sys
from pathlib import Path

from kc2spice.core.errors import Kc2spiceError
from kc2spice.core.progress import Clock
from kc2spice.scene.load import load_scene
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.models import build_models


def main(root):
    said = {}
    for path in sorted(Path(root).glob("v*/hostile.toml")):
        try:
            scene = load_scene(path)
            deck = make_deck(build_models(scene, Clock()))
            run_deck(deck, path.parent / "deck", timeout=60)
            said[path.parent.name] = "ran"
        except Kc2spiceError as error:
            said[path.parent.name] = f"{error.exit_code}: {error}"
    print(json.dumps(said))


main(sys.argv[1])
