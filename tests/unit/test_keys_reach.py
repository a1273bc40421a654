"""Keys of a scene reach the text that the simulator reads, each with the value that was asked."""

import re

import pytest
from support import StageTimer, build_models, ignore_progress, load_scene, make_deck

SMALL = ("kick.layers=2", "kick.mesh.sectors=4", "kick.mesh.rings=1", "kick.mesh.outer_rings=1",
         "rom.order=6", "contact.rings=all", "catch.positions=4")  # fmt: skip


def deck(*overrides):
    """The main text of a small loop."""
    build = build_models(
        load_scene("kick_and_catch", [*SMALL, *overrides]), StageTimer(ignore_progress)
    )
    made = make_deck(build)
    return made.files[made.main_file_name]


@pytest.mark.parametrize(
    ("override", "card"),
    [
        ("solver.method=gear", r"\.options method=gear"),
        ("solver.reltol=3e-5", r"\.options reltol=3e-05"),
        ("solver.trtol=2", r"\.options trtol=2"),
        ("solver.max_step=7e-6", r"\.tran \S+ 5m 0 7u$"),
        ("solver.stop=4 ms", r"\.tran \S+ 4m 0 "),
        ("control.enable_at=0.7 ms", r"Vcontrol_enable \S+ 0 PULSE\(0\S* 1\S* 700u "),
        ("kick.drive.voltage=83", r"Vkick_drive \S+ 0 PULSE\(0\S* 83"),
    ],
)
def test_a_key_reaches_the_deck(override, card):
    assert re.search(card, deck(override), re.M)
    assert not re.search(card, deck(), re.M)
