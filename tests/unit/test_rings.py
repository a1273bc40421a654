"""Which rings a scene keeps, against the paper's chip and closed forms."""

import math

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.fem.piezo.keys import Chip, Material
from kc2spice.parts.contact import reach
from kc2spice.parts.piezo_stack import free_stroke, kept_rings, top_material
from kc2spice.scene.load import load_scene
from kc2spice.scene.plan import plan


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
    assert kept_rings(loaded.parts["kick"], loaded) == rings
    pins = [pin for part, pin in loaded.nets if part == "kick"]
    ports = [f"ring{k}" for k in range(rings)]
    assert pins == ["anode", "cathode", *ports, "base"]


@pytest.mark.parametrize(("voltage", "rings"), [(20, 1), (26, 1), (27, 2), (106, 2), (107, 3)])
def test_without_a_catch_the_kick_alone_decides(voltage, rings):
    """ring1 closes at 1.2508 um and ring2 at 5.0126 um, twice the strokes at 26.6 and 106.6 V."""
    loaded = load_scene({"kick": {"drive": {"voltage": voltage}}, "contact": {}, "sphere": {}})
    assert kept_rings(loaded.parts["kick"], loaded) == rings
    fed = {
        "part": "source",
        "pulse": {"high": voltage, "width": 25e-6, "edge": 1e-7},
        "pins": {"out": "stack.anode"},
    }
    stack = {"part": "piezo_stack"}
    free = load_scene({"stack": stack, "supply": fed, "contact": {}, "sphere": {}})
    assert kept_rings(free.parts["stack"], free) == rings


def test_a_probe_and_a_pin_ask_for_a_ring():
    tables = {"kick": {}, "probes": {"edge": {"of": "kick.u.ring3"}}}
    probed = load_scene(tables)
    assert kept_rings(probed.parts["kick"], probed) == 4
    weight = {"part": "mass", "mass": 1e-6, "pins": {"a": "kick.ring1"}}
    loaded = load_scene({"kick": {}, "weight": weight})
    assert kept_rings(loaded.parts["kick"], loaded) == 2
    with pytest.raises(UsageError, match="ring0 to ring5"):
        load_scene({"kick": {}, "weight": weight | {"pins": {"a": "kick.ring6"}}})
    alone = load_scene({"kick": {}})
    assert kept_rings(alone.parts["kick"], alone) == 0


def test_what_is_left_out_is_named_with_its_reason():
    (rings,) = (e for e in plan(load_scene("kick_and_catch")).left_out if "contact at" in e.effect)
    assert rings.effect == "contact at ring2 to ring5"
    assert "5.01e-06 m" in rings.why  # R - sqrt(R^2 - r^2) at 100 um
    assert "4.7e-06 m" in rings.why
    everything = plan(load_scene("kick_and_catch", ["contact.rings=all"]))
    assert not [
        each
        for each in everything.left_out
        if "ring2" in each.effect or "contact at" in each.effect
    ]


def test_the_free_stroke_is_that_of_the_matrices():
    """d = e C^-1 with the full 6 x 6 matrices; 2.3508 um is what the FE chip does."""
    kick = Chip()
    c11, c12, c13, c33, c44, c66 = kick.material.stiffness
    C = np.diag([c11, c11, c33, c44, c44, c66])
    C[0, 1] = C[1, 0] = c12
    C[:2, 2] = C[2, :2] = c13
    e31, e33, _ = kick.material.coupling
    d33 = np.linalg.solve(C, [e31, e31, e33, 0, 0, 0])[2]
    assert free_stroke(kick, -100.0) == pytest.approx(33 * 100 * d33, rel=1e-12)
    assert free_stroke(kick, 100.0) == pytest.approx(2.3508e-6, rel=1e-4)


def test_the_modulus_of_an_isotropic_solid_is_the_textbooks():
    young, poisson = 200e9, 0.3
    shear = young / (2 * (1 + poisson))
    lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    steel = Material(stiffness=(lame + 2 * shear, lame, lame, lame + 2 * shear, shear, shear))
    assert top_material(Chip(material=steel)).indentation_modulus == pytest.approx(
        young / (1 - poisson**2), rel=1e-12
    )


def depth_of(override=()):
    scene = load_scene("impact", override)
    return reach(scene.parts["contact"], scene).depth


def test_an_impact_reaches_deeper_than_it_goes():
    """The FE chip stops the paper's sphere after 3.138 um; depth grows with speed^(4/5)."""
    depth = depth_of()
    assert 3.138e-6 < depth < 1.5 * 3.138e-6
    faster = depth_of(["impact.velocity=-2", "impact.gap=0"])
    assert faster / depth == pytest.approx(2**0.8, rel=1e-12)


def test_a_fall_counts_the_height():
    speed = math.sqrt(2 * 9.81 * 1e-3)
    falling = depth_of(["gravity=9.81", "impact.gap=1 mm", "impact.velocity=-1e-9"])
    thrown = depth_of(["impact.gap=0", f"impact.velocity={-speed}"])
    assert falling == pytest.approx(thrown, rel=1e-9)


@pytest.mark.parametrize("rings", ["0", "-1", "2.5", "some", "[]", "true"])
def test_a_wrong_choice_is_refused_with_the_right_ones(rings):
    with pytest.raises(UsageError, match="needed, all, or a whole number"):
        load_scene("impact", [f"contact.rings={rings}"])


def test_an_unstable_material_is_refused_before_anything_is_estimated():
    soft = "kick.material.stiffness=[1e9, 2e9, 1e9, 1e9, 1e9, 1e9]"
    with pytest.raises(UsageError, match="no such material"):
        load_scene("impact", [soft])
