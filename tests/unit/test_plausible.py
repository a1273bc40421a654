"""Keys that can be computed but hardly exist are refused with the physical reason."""

import warnings

import pytest

from kc2spice.core.errors import UsageError
from kc2spice.scene.load import gallery, load_scene

WILD = [
    ("kick.side=0.15", "kick.side", "sintered"),
    ("kick.drive.voltage=10 kV", "kick.drive.voltage", "breaks down"),
    ("catch.wire_diameter=0.2 mm", "catch.turns", "do not fit"),
    ("catch.remanence=200", "catch.remanence", "permanent magnet"),
    ("sphere.density=7.85e6", "sphere.density", "osmium"),
]


@pytest.mark.parametrize(("override", "key", "why"), WILD)
def test_wild_keys_are_refused_with_the_reason(override, key, why):
    with pytest.raises(UsageError, match=why) as refused:
        load_scene("kick_and_catch", [override])
    assert key in str(refused.value) or override in str(refused.value)
    assert "checks.plausible" in refused.value.hint


def test_they_may_be_run_all_the_same():
    override = "catch.wire_diameter=0.2 mm"
    with pytest.warns(UserWarning, match="do not fit"):
        load_scene("kick_and_catch", [override, "checks.plausible=warn"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_scene("kick_and_catch", [override, "checks.plausible=off"])


def test_the_gallery_exists():
    for name in gallery():
        load_scene(name)
