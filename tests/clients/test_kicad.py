"""KiCad checks, draws and exports every sheet; the exported netlist gives the deck's results."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from kc2spice.scene.load import gallery
from kc2spice.sim.ngspice import write_files
from kc2spice.sim.rawfile import read_raw
from kc2spice.spice.symbol import symbol_files

pytestmark = pytest.mark.slow  # minutes: other programs, every scene


@pytest.fixture(scope="module")
def kicad(program):
    return program("kicad-cli")


def project(deck, folder):
    write_files(deck.files | symbol_files(deck), folder)
    return f"{deck.name}.kicad_sch"


@pytest.mark.parametrize("name", sorted(gallery()))
def test_sheets_are_clean_and_are_the_deck(name, deck_of, kicad, run, tmp_path):
    deck = deck_of(name) if deck_of(name).stop is None else deck_of(name, stop=0.52e-3)
    sheet = project(deck, tmp_path)
    run([kicad, "sch", "erc", "--severity-all", "--exit-code-violations", sheet], tmp_path)
    run([kicad, "sch", "export", "netlist", "--format", "spice", "-o", "sheet.cir", sheet],
        tmp_path)  # fmt: skip
    nodes = sorted({v for e, _ in deck.vectors.values() for v in re.findall(r"v\(\w+\)", e)})
    saved = "\n".join(f".save {node}" for node in nodes)
    exported = (tmp_path / "sheet.cir").read_text()
    (tmp_path / "sheet.cir").write_text(exported.replace(".end\n", f"{saved}\n.end\n"))
    (tmp_path / "ordered.cir").write_text(reordered(deck.files[deck.main], exported))
    files = ("sheet.cir", "ordered.cir", deck.main)
    for file in files:
        run(["ngspice", "-b", "-n", "-r", f"{file}.raw", file], tmp_path)
    theirs, ordered, ours = (read_raw(tmp_path / f"{file}.raw") for file in files)
    # the stroke; KiCad has its own order of instances, in which sums are rounded otherwise
    for node in [n for n in nodes if "r0" in n] or nodes:
        scale = np.max(np.abs(ordered[node]))
        assert np.max(np.abs(theirs[node])) == pytest.approx(scale, rel=1e-6), node
        # contact multiplies that rounding up to the error of a step, reltol 1e-4
        assert np.max(np.abs(ours[node])) == pytest.approx(scale, rel=3e-4), node


def reordered(main, exported):
    """The deck with its cards in the order of another netlist with the same names."""
    order = re.findall(r"(?m)^([a-zA-Z]\w*) ", exported)
    title, *lines = main.splitlines()
    cards = {line.split()[0].lower(): line for line in lines if line[:1].isalpha()}
    kept = [line for line in lines if not line[:1].isalpha()]
    sources = [next(k for k in (name, name.removesuffix("1")) if k in cards)
               for name in map(str.lower, order)]  # fmt: skip
    assert sorted(sources) == sorted(cards)
    return "\n".join([title, *(cards[name] for name in sources), *kept]) + "\n"


def test_a_wrong_sheet_is_seen(deck_of, kicad, run, tmp_path):
    sheet = project(deck_of("impact"), tmp_path)
    text = (tmp_path / sheet).read_text()
    (tmp_path / sheet).write_text(
        text.replace('global_label "contact_bottom"', 'global_label "lost"', 1)
    )
    with pytest.raises(AssertionError):
        run([kicad, "sch", "erc", "--severity-all", "--exit-code-violations", sheet], tmp_path)


def test_symbols_and_sheets_are_drawn(deck_of, kicad, run, tmp_path):
    sheet = project(deck_of("charge_kick"), tmp_path)
    run([kicad, "sch", "export", "svg", "-o", "drawn", sheet], tmp_path)
    run([kicad, "sym", "export", "svg", "-o", "drawn", "kc2spice.kicad_sym"], tmp_path)
    pictures = {path.name: ElementTree.parse(path) for path in (tmp_path / "drawn").glob("*.svg")}
    assert "charge_kick.svg" in pictures
    assert len(pictures) >= 15
