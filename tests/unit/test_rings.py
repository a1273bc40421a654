"""Rings that a scene needs, against the paper's chip and closed forms."""

import pytest
from support import UsageError, load_scene


def rings_of(scene, chip="kick"):
    """Number of rings that are pins of a chip."""
    pins = [pin for part, pin in scene.nets if part == chip]
    count = len(pins) - 3
    assert pins == ["anode", "cathode", *(f"ring{k}" for k in range(count)), "base"]
    return count


@pytest.mark.parametrize(
    ("scene", "override", "rings"),
    [
        ("kick_and_catch", "kick.drive.voltage=20", 2),  # it may fall 6.5 mm, the table's height
        ("kick_and_catch", "kick.drive.voltage=100", 2),  # 4.70 um, ring2 closes at 5.01 um
        ("kick_and_catch", "kick.drive.voltage=-120", 3),
        ("kick_and_catch", "contact.rings=all", 6),
        ("kick_and_catch", "contact.rings=4", 4),
        ("kick_and_catch", "contact.rings=40", 6),
        ("impact", "impact.velocity=-1", 2),
        ("impact", "impact.velocity=-10", 5),
        ("imprint", "imprint.depth=50 um", 6),
        ("imprint", "imprint.depth=5 um", 2),
        ("imprint", "imprint.depth=5.1 um", 3),
        ("harmonic", "rom.tolerance=1e-4", 6),
    ],
)
def test_rings_follow_the_scene(scene, override, rings):
    loaded = load_scene(scene, [override])
    assert rings_of(loaded) == rings


@pytest.mark.parametrize("rings", ["0", "-1", "2.5", "some", "[]", "true"])
def test_a_wrong_choice_is_refused_with_the_right_ones(rings):
    with pytest.raises(UsageError, match='"needed", "all", or a whole number'):
        load_scene("impact", [f"contact.rings={rings}"])
