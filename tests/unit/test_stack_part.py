"""The layered chip as a part: what its keys make of a scene, on numbers and waves made by hand."""

import pytest

from kc2spice.core.errors import UsageError
from kc2spice.scene.load import load_scene

LOOP = {"name": "loop", "kick": {}, "contact": {}, "sphere": {}}
IMPACT = {"name": "hit", "kick": {"electrical": "open"}, "contact": {}, "sphere": {"velocity": -1}}
ALONE = {"name": "alone", "kick": {}}


# --- parts that come along ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "said"),
    [({"tube": {}}, "half_bridge"), ({"amplifier": {}, "charge": {}}, "amplifier, charge")],
)
def test_a_chip_has_one_driver_of_those_known(given, said):
    with pytest.raises(UsageError, match="driver") as raised:
        load_scene({"name": "d", "kick": {"driver": given}})
    assert said in str(raised.value)


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scene", "fits", "refused", "word"),
    [
        (ALONE, ["kick.mesh.ring_spacing=1.49 mm", "kick.mesh.rings=1"],
         ["kick.mesh.ring_spacing=1.5 mm", "kick.mesh.rings=1"],
         "beyond the chip"),
        (LOOP, ["kick.drive.edge=25 us"], ["kick.drive.edge=25.1 us"], "longer than the pulse"),
        (LOOP, ["kick.drive.start=4.99 ms"], ["kick.drive.start=5 ms"], "after the simulation"),
        (IMPACT, ["kick.drive.start=6 ms"], ["kick.mounting=free"], "nothing holds the chip"),
        (ALONE, ["kick.mounting=free"], ["kick.electrical=open", "kick.driver.amplifier={}"],
         "not driven"),
        (ALONE, ["kick.side=0.1", "kick.height=0.1"], ["kick.side=0.101", "kick.height=0.1"],
         "sintered"),
        (ALONE, ["kick.height=0.16 m"], ["kick.height=0.2001 m", "kick.layers=100"], "sintered"),
        (ALONE, ["kick.height=9.9 mm", "kick.layers=2", "kick.drive.voltage=10"],
         ["kick.height=10.1 mm", "kick.layers=2", "kick.drive.voltage=10"], "ceramic tape"),
        (ALONE, ["kick.drive.voltage=-1.2 kV"], ["kick.drive.voltage=1.22 kV"], "breaks down"),
        (ALONE, ["kick.drive.voltage=5 kV", "kick.driver.amplifier={}"],
         ["kick.drive.voltage=5 kV"], "breaks down"),
        (LOOP, ["kick.material.stiffness=[2e11, 1.99e11, 1e9, 2e11, 2e10, 2e10]"],
         ["kick.material.stiffness=[2e11, 2e11, 1e9, 2e11, 2e10, 2e10]"], "no such material"),
        (LOOP, ["kick.material.stiffness=[2e11, 1e11, 1.72e11, 2e11, 2e10, 2e10]"],
         ["kick.material.stiffness=[2e11, 1e11, 1.74e11, 2e11, 2e10, 2e10]"], "no such material"),
        (LOOP, ["kick.material.stiffness=[2e11, -1.9e11, 1e9, 2e11, 2e10, 2e10]"],
         ["kick.material.stiffness=[2e11, -2.1e11, 1e9, 2e11, 2e10, 2e10]"], "no such material"),
    ],
)  # fmt: skip
def test_where_a_stack_begins_to_be_refused(scene, fits, refused, word):
    load_scene(scene, fits)
    with pytest.raises(UsageError, match=word):
        load_scene(scene, refused)


def test_how_small_and_how_strong_a_stack_may_be():
    """0.1 mm wide, 10 um high, layers of 1 um, 20 V/um."""
    narrow = ["kick.mesh.ring_spacing=10 um", "kick.mesh.rings=1", "kick.drive.voltage=1"]
    flat = ["kick.layers=2", "kick.drive.voltage=1"]
    exact = ["kick.layers=32", "kick.height=2 mm"]  # 62.5 um a layer
    for keys, fits, refused, word in (
        (narrow, "kick.side=0.1 mm", "kick.side=0.0999 mm", "kick.side"),
        (narrow, "kick.diameter=0.1 mm", "kick.diameter=0.0999 mm", "kick.diameter"),
        (flat, "kick.height=10 um", "kick.height=9.99 um", "kick.height"),
        (["kick.drive.voltage=1"], "kick.height=33.1 um", "kick.height=32.9 um", "kick.layers"),
        (exact, "kick.drive.voltage=1250", "kick.drive.voltage=1250.00003", "breaks down"),
    ):  # fmt: skip
        load_scene(ALONE, [*keys, fits])
        with pytest.raises(UsageError, match="hardly exists") as raised:
            load_scene(ALONE, [*keys, refused])
        assert word in str(raised.value)


def test_nothing_presses_on_a_stack_that_shears():
    with pytest.raises(UsageError, match="moves sideways"):
        load_scene(LOOP, ["kick.poling=x", "kick.mounting=glued"])
    load_scene(ALONE, ["kick.poling=x", "kick.mounting=glued"])
