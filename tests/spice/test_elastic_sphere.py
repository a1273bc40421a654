"""The elastic sphere in scenes: what is refused, and an impact on what hardly gives, by Hertz."""

from __future__ import annotations

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.core.progress import Clock, silent
from kc2spice.fem.materials import material
from kc2spice.parts.contact import separation
from kc2spice.scene.load import load_scene
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.judge import verdict
from kc2spice.workflow.models import build_models
from kc2spice.workflow.verify.circuit import solve

PRESSED = ("contact.shape=pressure", "sphere.elastic=true")


@pytest.mark.parametrize(
    ("keys", "where"),
    [
        (["sphere.elastic=true"], "contact.shape"),
        ([*PRESSED, "contact.damping=0.1"], "contact.damping"),
        ([*PRESSED, "sphere.material=PZT-5A"], "sphere.material"),
        ([*PRESSED[:1], "sphere.elastic.damping.per_material=true"], "per_material"),
        ([*PRESSED[:1], "sphere.elastic.damping.ratoi=1"], "ratoi"),
        ([*PRESSED, "sphere.radius=0.2 mm"], "contact.shape"),
    ],
)
def test_what_no_model_is_for_is_refused(keys, where):
    with pytest.raises(UsageError) as raised:
        load_scene("impact", keys)
    assert where in str(raised.value.where)


def test_an_elastic_sphere_has_one_contact():
    with pytest.raises(UsageError, match="one contact") as raised:
        load_scene("newtons_cradle", ["sphere2.elastic=true"])
    assert "sphere2.elastic" in str(raised.value.where)
    with pytest.raises(UsageError, match="one contact") as raised:
        load_scene({"name": "b", "sphere": {"elastic": True}, "analysis": {"type": "op"}})
    assert raised.value.got == "none"


def hertz(mass, radius, speed):
    """Time [s] and depth [m] of the impact of an elastic sphere on a rigid plane (Johnson 1985,
    11.3): ``2.868 (m^2 / (R E*^2 v))^(1/5)``, ``(15 m v^2 / (16 sqrt(R) E*))^(2/5)``."""
    modulus = 211.9e9 / (1 - 0.291**2)
    time = 2.868265 * (mass**2 / (radius * modulus**2 * speed)) ** 0.2
    return time, (15 * mass * speed**2 / (16 * np.sqrt(radius) * modulus)) ** 0.4


@pytest.mark.slow  # models of chip and sphere
def test_an_impact_is_that_of_hertz(tmp_path):
    """A chip ten thousand times as stiff as ceramic is a rigid plane; a slow sphere is a
    half-space but for the contact's radius over its own, 1.7 %."""
    speed, stiff = 0.1, [1e4 * c for c in (120e9, 50e9, 50e9, 120e9, 35e9, 35e9)]
    scene = load_scene("impact", [
        *PRESSED, "sphere.material=steel", f"sphere.density={material('steel').density!r}",
        "kick.layers=3", "kick.mesh.ring_spacing=20 um", "contact.spacing=2 um",
        f"kick.material.stiffness={stiff}", "rom.tolerance=1e-4", "solver.reltol=1e-5",
        "solver.stop=15 us", "impact.gap=0", f"impact.velocity=-{speed}",
    ])  # fmt: skip
    build = build_models(scene, Clock(silent))
    waves = run_deck(make_deck(build), tmp_path)
    keys = scene.parts["sphere"].keys
    time, depth = hertz(keys.mass, keys.radius, speed)
    force, v, t = waves["contact.force"], waves["sphere.v"], waves["time"]
    left = separation(t, force, v)
    assert left is not None
    assert left[0] == pytest.approx(time, rel=6e-3)
    assert keys.radius - waves["sphere.y"].min() == pytest.approx(depth, rel=6e-3)
    assert left[1] == pytest.approx(speed, rel=3e-4)  # restitution
    # momentum, and what the sphere's modes keep is what it lost
    assert np.trapezoid(force, t) == pytest.approx(keys.mass * (v[-1] - v[0]), rel=1e-5)
    reference = solve(build, waves)
    assert reference.imbalance is not None
    assert reference.imbalance < 1e-7
    assert reference.results["sphere.v"][-1] == pytest.approx(v[-1], rel=1e-4)
    found = verdict(waves, build)
    assert all(check.passed for check in found.checks), found.checks
    assert "sphere_elastic" in dict(found.balances)
