"""The contact as a part: its law, and which side is which."""

import math

import pytest

import kc2spice as kc
from kc2spice.parts.contact import normal
from kc2spice.scene.load import load_scene

STEEL = 211.9e9 / (1 - 0.291**2)


def test_two_spheres_touch_with_both_curvatures_and_moduli():
    """``1/R = 1/R_a + 1/R_b``, ``1/E* = 1/M_a + 1/M_b`` (Hertz 1881)."""
    cradle = load_scene({
        "name": "pair", "gravity": 0.0,
        "one": {"part": "sphere", "radius": 2e-3, "material": "steel"},
        "two": {"part": "sphere", "radius": 1e-3, "material": "steel", "velocity": -1.0},
        "contact": {"part": "contact", "law": "hertz", "a": "one", "b": "two"},
    })  # fmt: skip
    law = normal(cradle.parts["contact"], cradle)
    assert law.stiffness == pytest.approx(4 / 3 * STEEL / 2 * math.sqrt(2e-3 / 3), rel=1e-9)
    assert law.power == 1.5


def test_the_gap_closes_when_a_rises():
    """As the keys say: swapped sides pass through each other."""
    scene = {
        "name": "two", "gravity": 0, "analysis": {"type": "transient", "stop": "2 ms"},
        "one": {"part": "mass", "mass": "1 g", "velocity": 0.1},
        "other": {"part": "mass", "mass": "1 g", "velocity": 0.0},
        "probes": {"left": {"of": "one.v", "take": "final"}},
    }  # fmt: skip
    for sides, left in (({"a": "one", "b": "other"}, 0.0), ({"a": "other", "b": "one"}, 0.1)):
        found = kc.run(scene | {"contact": {**sides, "gap": "10 um"}})
        # equal masses exchange their speeds; the penalty loses none of it
        assert found.metrics["left"] == pytest.approx(left, abs=1e-6)
