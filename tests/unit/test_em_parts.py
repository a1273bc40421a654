"""Parts of the electromagnetic scenes on a force in closed form, cubic in the height: the splines
through a few heights are exact, and so must be what the parts make of them."""

import pytest

from kc2spice.core.errors import UsageError
from kc2spice.scene.load import load_scene

EM = {"name": "em", "em_force": {"currents": (-0.1, 0.3)}, "catch": {}, "sphere": {}}


# --- the actuator ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("fits", "refused", "word"),
    [
        ("catch.turns=4110", "catch.turns=4120", "do not fit"),
        ("catch.remanence=1.6", "catch.remanence=1.61", "permanent magnet"),
        ("catch.air_radius=1 m", "catch.air_radius=1.01 m", "fourth power"),
        ("catch.lower.inner=1.001 mm", "catch.lower.inner=1 mm", "does not fit through"),
        ("catch.ring.inner=4.999 mm", "catch.ring.inner=5 mm", "no material left"),
        ("catch.air_height=8.6 mm", "catch.ring.height=30 mm", "beyond the modelled air"),
        ("catch.ring.outer=9.99 mm", "catch.ring.outer=10 mm", "beyond the modelled air"),
        ("catch.upper.y=3 mm", "catch.upper.y=2.99 mm", "overlaps catch.lower"),
        ("catch.y_max=-2.4999 mm", "catch.y_max=-2.5 mm", "empty range"),
    ],
)
def test_where_an_actuator_begins_to_be_refused(fits, refused, word):
    """Coils of 2 mm at 1 and 3 mm touch; wire of 25 um fills a section of 2 mm2 4074 times."""
    load_scene({**EM, "catch": {}}, [fits])
    with pytest.raises(UsageError, match=word) as raised:
        load_scene({**EM, "catch": {}}, [refused])
    if word == "empty range":
        assert raised.value.got == "-0.0025 … -0.0025 m"
    if word == "do not fit":
        assert "4120 turns of 2.5e-05 m wire" in str(raised.value)


def test_side_by_side_bodies_may_share_heights():
    load_scene(EM, ["catch.ring.y=1 mm"])  # beyond the lower coil
    load_scene(EM, ["catch.ring.y=1 mm", "catch.ring.inner=2.3 mm"])  # they touch
    with pytest.raises(UsageError, match="overlaps"):
        load_scene(EM, ["catch.ring.y=1 mm", "catch.ring.inner=2.29 mm"])


def test_a_resting_sphere_lies_within_the_table():
    loop = {"name": "loop", "kick": {}, "contact": {}, "sphere": {}, "catch": {}}
    load_scene(loop, ["catch.y_min=0.99 mm"])
    with pytest.raises(UsageError, match="rest height"):
        load_scene(loop, ["catch.y_min=1 mm"])
    load_scene(loop, ["catch.y_max=1.01 mm"])
    with pytest.raises(UsageError, match="rest height"):
        load_scene(loop, ["catch.y_max=1 mm"])
