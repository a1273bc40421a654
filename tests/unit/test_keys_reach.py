"""Keys of a scene reach the text that the simulator reads, each with the value that was asked."""

import re

import pytest

from kc2spice.core.progress import Clock, silent
from kc2spice.core.units import quantity
from kc2spice.parts.piezo_stack import Drive
from kc2spice.scene.load import load_scene
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.models import build_models

SMALL = ("kick.layers=2", "kick.mesh.sectors=4", "kick.mesh.rings=1", "kick.mesh.outer_rings=1",
         "rom.order=6", "contact.rings=all", "catch.positions=4")  # fmt: skip


def deck(*overrides):
    """The main text of a small loop, and those of all its files."""
    build = build_models(load_scene("kick_and_catch", [*SMALL, *overrides]), Clock(silent))
    made = make_deck(build)
    return made.files[made.main], made.files


def chgtol(text):
    return float(re.search(r"\.options chgtol=(\S+)", text)[1])


def test_chgtol_reaches_the_deck():
    """In proportion: a weaker kick moves everything less, and so does what a step may miss."""
    assert chgtol(deck("solver.chgtol=2e-9")[0]) == pytest.approx(0.2 * chgtol(deck()[0]))


@pytest.mark.parametrize(
    ("override", "card"),
    [
        ("solver.method=gear", r"\.options method=gear"),
        ("solver.reltol=3e-5", r"\.options reltol=3e-05"),
        ("solver.trtol=2", r"\.options trtol=2"),
        ("solver.max_step=7e-6", r"\.tran \S+ 0.005 0 7e-06"),
        ("solver.stop=4 ms", r"\.tran \S+ 0.004 0 "),
        ("control.enable_at=0.7 ms", r"Vcontrol_enable \S+ 0 PULSE\(0\S* 1\S* 0.0007 "),
        ("kick.drive.voltage=83", r"Vkick_drive \S+ 0 PULSE\(0\S* 83"),
    ],
)
def test_a_key_reaches_the_deck(override, card):
    assert re.search(card, deck(override)[0])
    assert not re.search(card, deck()[0])


@pytest.mark.parametrize("points", [31, 201])
def test_the_lookup_has_as_many_points_as_asked(points):
    """Pairs of height and value; besides the heights, two flat points on each side."""
    _, files = deck(f"catch.points={points}")
    text = files["catch.lib"]
    table = re.search(r"pwl\(V\(s\),([^)]*)\)", text)[1].replace("\n+", "")
    assert len(table.split(",")) == 2 * (points + 4)


def test_every_prefix_of_a_quantity():
    """Powers of ten that no table here shares, tera among them."""
    powers = dict(zip("fpnumkMGT", (-15, -12, -9, -6, -3, 3, 6, 9, 12), strict=True))
    for prefix, power in powers.items():
        assert quantity(f"2 {prefix}Hz", "Hz") == pytest.approx(2.0 * 10.0**power, rel=1e-15)


def test_a_pulse_keeps_its_edges():
    drive = Drive(voltage=50.0, width=20e-6, edge=1e-6, start=1e-6)
    corners = [(0.9, 0.0), (1.5, 25.0), (2.0, 50.0), (20.9, 50.0), (21.5, 25.0), (23.0, 0.0)]
    for time, value in corners:
        assert drive.waveform(1e-6 * time) == pytest.approx(value, abs=1e-9)
