"""Runs the scenes named on the command line as the product does; prints what became of each.

A program of its own, so that all that it touches can be traced.
"""

import json
import sys
from pathlib import Path

from support import Kc2spiceError, StageTimer, build_models, load_scene, make_deck, run_deck


def main(root):
    said = {}
    for path in sorted(Path(root).glob("v*/hostile.toml")):
        try:
            scene = load_scene(path)
            deck = make_deck(build_models(scene, StageTimer()))
            run_deck(deck, path.parent / "deck", timeout=60)
            said[path.parent.name] = "ran"
        except Kc2spiceError as error:
            said[path.parent.name] = f"{error.exit_code}: {error}"
    print(json.dumps(said))


main(sys.argv[1])
