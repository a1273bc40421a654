"""Shipped scenes find their operating point straight away: no word of a struggle in the log."""

import dataclasses
import re
from pathlib import Path

import pytest
from support import Deck, find_failure, list_gallery, run_deck

NETLISTS = Path(__file__).parents[2] / "netlists"
SHORT = 1e-6  # s: long enough for the operating point and the first steps


def committed(name):
    """The scene's committed deck, its transient cut to a microsecond."""
    (path,) = NETLISTS.glob(f"*/{name}.cir")
    files = {library.name: library.read_text() for library in path.parent.glob("*.lib")}
    cut = f".tran 1e-7 {SHORT} 0 1e-7"
    main, found = re.subn(r"(?m)^\.tran \S+ \S+ 0 \S+", cut, path.read_text())
    return Deck(name=name, text=main, more=files, stop=SHORT if found else None)


@pytest.mark.parametrize("options", ["ours", "ngspice's own"])
@pytest.mark.parametrize("name", sorted(list_gallery()))
def test_operating_point_is_silent(name, options, tmp_path):
    deck = committed(name)
    if options != "ours":
        main = re.sub(r"(?m)^\.options (?!acct).*\n", "", deck.text)
        deck = dataclasses.replace(deck, text=main)
    run_deck(deck, tmp_path)
    report = find_failure((tmp_path / f"{name}.log").read_text())
    assert not report.struggles
    assert report.cause is None
