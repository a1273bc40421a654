"""The contact as a part: its law, and which side is which."""

import math

import numpy as np
import pytest
from scipy.integrate import simpson

import kc2spice as kc
from kc2spice.parts.contact import normal
from kc2spice.physics.contact import Normal
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


@pytest.mark.parametrize(
    "law",
    [Normal(1e8), Normal(2e9, 1.5), Normal(2e9, 1.5, curve=(1.0, -0.3, 0.5, 0.2), depth=3e-6)],
    ids=["penalty", "hertz", "pressure"],
)
def test_force_slope_energy_and_text_are_one_law(law):
    """By its definition, by Simpson's rule over the root of the depth, and by differences."""
    s = np.linspace(0.0, 1.0, 2001)
    x = 2e-6 * s**2
    series = sum(c * np.sqrt(x / law.depth) ** k for k, c in enumerate(law.curve))
    force = law.stiffness * x**law.power * series
    np.testing.assert_allclose(law.force(x), force, rtol=1e-12, atol=1e-30)
    np.testing.assert_allclose(law.energy(x)[-1], simpson(force * 4e-6 * s, x=s), rtol=1e-9)
    assert not law.force(-x).any()
    assert not law.energy(-x).any()
    at, closed = x[1:], np.ones(2000)
    ahead, behind = (law.pressed(at * (1 + way * 1e-5), closed)[0] for way in (1, -1))
    np.testing.assert_allclose(
        law.pressed(at, closed)[1], (ahead - behind) / (2e-5 * at), rtol=1e-8
    )
    micro = {f"c{k}": c / (1e6 * law.depth) ** (k / 2) for k, c in enumerate(law.curve)}
    known = {"sqrt": math.sqrt, "max": max, "k": law.stiffness * 1e-6**law.power} | micro
    for depth, exact in zip(x[1000::100], force[1000::100], strict=True):
        assert eval(law.text("um", "k"), known | {"um": 1e6 * depth}) == pytest.approx(exact)
