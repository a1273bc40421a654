"""The contact as a part, on waveforms and numbers made by hand."""

import math

import numpy as np
import pytest

import kc2spice as kc
from kc2spice.core.errors import UsageError
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.contact import normal
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build

LOOP = {"name": "loop", "kick": {}, "contact": {}, "sphere": {}}
STEEL = 211.9e9 / (1 - 0.291**2)


# --- the law --------------------------------------------------------------------------------------


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


def test_a_groove_turns_the_law_by_its_flanks():
    ground = {"name": "groove", "sphere": {}, "contact": {"part": "contact", "a": "gnd"}}
    for law, power in (("linear", 1.0), ("hertz", 1.5)):
        keys = [f"contact.law={law}", "contact.modulus=1 GPa", "contact.penalty=1e6"]
        plain, grooved = (
            normal(*(lambda s: (s.parts["contact"], s))(load_scene(ground, [*keys, *more])))
            for more in ([], ["contact.groove=60"])
        )
        assert grooved.stiffness / plain.stiffness == pytest.approx(2 * 0.5 ** (1 + power))
        assert (plain.power, grooved.power) == (power, power)


# --- what is refused ------------------------------------------------------------------------------

PRESSED = ["contact.shape=pressure"]


@pytest.mark.parametrize(
    ("fits", "refused", "word"),
    [
        (["contact.spacing=62 um"], ["contact.spacing=62.5 um"], "wider than the patch"),
        (["sphere.radius=251 um"], ["sphere.radius=250 um"], "pressure is that under a sphere"),
        ([], ["contact.law=hertz"], "without law"),
        ([], ["contact.groove=90"], "without groove"),
        (["contact.a=kick"], ["contact.a=kick.ring0"], "no port of pressure"),
    ],
)
def test_where_a_pressure_begins_to_be_refused(fits, refused, word):
    """Under rings to 250 um."""
    load_scene(LOOP, [*PRESSED, *fits])
    with pytest.raises(UsageError, match=word):
        load_scene(LOOP, [*PRESSED, *refused])


# --- what a run says ------------------------------------------------------------------------------


def bounced(law, *keys):
    """A sphere on the ground that goes 2 um in and out again, forces by the law."""
    ground = {"name": "bounce", "gravity": 0.0, "sphere": {"velocity": -1.0, "height": 1e-6},
              "contact": {"part": "contact", "a": "gnd", "penalty": 1e6, "law": law}}  # fmt: skip
    scene = load_scene(ground, ["contact.modulus=1 GPa", *keys])
    t = np.linspace(0.0, 1e-3, 2001)
    y = 1e-6 - 3e-6 * np.sin(np.pi * t / 1e-3)
    v = np.gradient(y, t)
    law = normal(scene.parts["contact"], scene)
    elastic = law.force(-y)
    force = elastic * (1 - law.damping * v)
    data = {"time": t, "sphere.y": 1e-3 + y, "sphere.v": v, "contact.force": force}
    return scene, Waveforms(data | {"contact.force.floor": force}, {}), y, elastic


@pytest.mark.parametrize("law", ["linear", "hertz"])
@pytest.mark.parametrize("damping", [0.0, 20.0])
def test_the_balance_of_a_bounce_is_what_its_spring_took_and_gave(law, damping):
    """The work that went in, twice; the damper's is the area between both branches."""
    scene, waves, y, elastic = bounced(law, f"contact.damping={damping}")
    contact = scene.parts["contact"]
    found = contact.type.energy(contact, Build(scene, {}), waves)["contact"]
    k, power = (1e6, 1.0) if law == "linear" else (4 / 3 * 1e9 * math.sqrt(1e-3), 1.5)
    most = k * 2e-6 ** (power + 1) / (power + 1)
    assert found.scale == pytest.approx(2 * most, rel=1e-5)
    assert found.missing < 1e-5 * most
    assert found.entries["stored in the contact"] == pytest.approx(0.0, abs=1e-9 * most)
    if damping:
        lost = -np.trapezoid(waves["contact.force"] - elastic, y)
        assert found.entries["damped in the contact"] == pytest.approx(lost, rel=1e-6)
        assert lost > 0
    else:
        assert "damped in the contact" not in found.entries


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
