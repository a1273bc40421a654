"""Xyce runs the decks written for it; it is in no package and is tested where it is found."""

import numpy as np
import pytest
from support import read_raw, run_deck, translate_deck, write_files


@pytest.mark.parametrize("name", ["impact", "kick_and_catch"])
def test_xyce_gives_the_speed_of_ngspice(name, deck_of, program, run, tmp_path):
    xyce = program("Xyce")
    deck = deck_of(name) if name == "impact" else deck_of(name, stop=0.6e-3)
    ours = run_deck(deck, tmp_path / "ngspice")
    spoken = translate_deck(deck, "xyce")
    write_files(spoken.files, tmp_path / "xyce")
    main = tmp_path / "xyce" / spoken.main
    run([xyce, main.name], main.parent)
    theirs = {k.lower(): v for k, v in read_raw(main.parent / f"{main.name}.raw").items()}
    speed, _ = spoken.vectors["sphere.v"]
    assert np.real(theirs[speed.lower()][-1]) == pytest.approx(ours["sphere.v"][-1], rel=1e-3)
