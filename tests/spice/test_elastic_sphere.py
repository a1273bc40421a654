"""The elastic sphere in scenes: what is refused, and an impact on what hardly gives, by Hertz."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from kc2spice.bodies import sphere as elastic
from kc2spice.bodies.pressure import Pressed, hats
from kc2spice.core.errors import UsageError
from kc2spice.core.progress import Clock, silent
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.materials import material
from kc2spice.parts import contact as contacts
from kc2spice.parts import elastic_sphere
from kc2spice.parts.contact import separation
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build, Dents
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


@pytest.mark.parametrize("keys", [[], PRESSED[:1]])
def test_a_rigid_sphere_has_no_mesh(keys):
    assert "sphere_elastic" not in load_scene("impact", keys).parts


def test_its_reduction_is_its_own_and_keeps_its_modes():
    """The scene's order and band are the chip's; a sphere of steel breathes at 2.4 MHz."""
    scene = load_scene("impact", PRESSED)
    part = scene.parts["sphere_elastic"]
    chosen = part.type.reduction(part, scene)
    assert chosen.order is None
    assert chosen.band[1] > 2.65e6


SPACING = ("contact.spacing=25 um", "sphere.radius=2 mm", "sphere.elastic.mesh.refine=3")


@pytest.fixture
def bodies(monkeypatch):
    """What the part asks of its body, which answers with numbers made up: ``calls``."""
    calls = []

    def compliance(body, shape, refine):
        calls.append(("compliance", refine))
        return (1 + 0.04 / refine**2) * 1e-9 * np.eye(shape.nodes.size - 1)

    def pressed(body, shape, refine):
        calls.append(("pressed", refine))
        n = shape.nodes.size - 1
        return Pressed(np.full(n, 1 / n), 2e-9 * np.eye(n), 3e-9)

    def model(body, shares, shape, refine):
        calls.append(("sphere", refine))
        return body, shares, shape

    for name, made in (("compliance", compliance), ("pressed", pressed), ("sphere", model)):
        monkeypatch.setattr(elastic, name, made)
    monkeypatch.setattr(
        elastic_sphere, "cached", lambda name, key, make, **_: (calls.append(key), make())[::-1]
    )
    scene = load_scene("impact", [PRESSED[0], "sphere.elastic.damping.ratio=0.02", *SPACING])
    return scene.parts["sphere_elastic"], scene, calls


def test_the_model_is_that_of_the_sphere_under_its_contacts_hats(bodies):
    part, scene, calls = bodies
    body, shares, shape = part.type.full(part, scene, Clock(silent), 2)
    assert [call for call in calls if isinstance(call, tuple)] == [("pressed", 3), ("sphere", 6)]
    assert (body.radius, body.material.density) == (2e-3, 7850.0)
    assert (shape.nodes[1], shape.nodes[-1]) == (25e-6, 250e-6)  # the outermost ring of the chip
    assert shares.sum() == pytest.approx(1.0)
    assert [(p.name, p.kind) for p in part.type.ports(part, scene)] == [("patch", "mechanical")]


def test_its_dents_follow_the_pressure_within_its_damping(bodies):
    """``beta = 2 zeta / omega`` at the lowest mode, ``2.65 c / R`` (Lamb 1882)."""
    part, scene, _ = bodies
    assert part.type.surface(part, scene) is None
    assert part.type.surface(part, scene, ("dent",)) is None
    surface = part.type.surface(part, scene, ("patch",))
    found = surface.dents(hats(50e-6, 250e-6))
    sound = np.sqrt(211.9e9 / (2 * 1.291) / 7850)
    assert found.pace == pytest.approx(2 * 0.02 / (2.65 * sound / 2e-3), rel=1e-6)
    assert (found.patch, found.compliance[1, 1]) == (3e-9, 2e-9)
    assert len(found.compliance) < 10
    chosen = part.type.reduction(part, scene)
    low, high = chosen.band
    assert chosen.tolerance == 1e-3
    assert (low, high) == (0.0, pytest.approx(2 * 2.65 * sound / 2e-3 / (2 * np.pi), rel=1e-2))
    own = load_scene(scene, {"sphere.elastic.rom.order": 7})
    assert part.type.reduction(own.parts["sphere_elastic"], own).order == 7


def test_its_mesh_is_judged_by_cells_half_the_size(bodies):
    """1 + 0.04 / k^2 at k = 3 and 6: their difference is three quarters of the coarser's error."""
    part, scene, calls = bodies
    found = part.type.mesh_error(part, scene)
    assert [call[1] for call in calls if isinstance(call, tuple)] == [3, 6]
    exact = (1 + 0.04 / 9) - 1
    assert 0.7 * exact < found.error < 1.5 * exact
    (key,) = (call for call in calls if isinstance(call, dict))
    assert key["full"]["radius"] == 2e-3
    assert key["full"]["own"] == {"mesh": {"refine": 3}}
    assert len(key["full"]["hats"]) == hats(25e-6, 250e-6).nodes.size
    assert part.type.coarse(part, scene)


def test_what_it_leaves_out_is_told(bodies, monkeypatch):
    part, scene, _ = bodies
    law = SimpleNamespace(depth=4e-6)
    monkeypatch.setattr(elastic_sphere, "normal", lambda *_: law)
    ringing, slope = part.type.left_out(part, scene)
    assert ringing.effect == "free ringing of sphere"
    assert slope.error.startswith("at most 0.002 of the dent")


def test_dents_of_both_sides_add_and_share_their_pace(monkeypatch):
    """A side that gives three times as much sets three quarters of the time."""
    one = Dents(1e-9 * np.eye(3), 5e-9, 2e-8)
    two = Dents(3e-9 * np.eye(3), 7e-9, 6e-8)
    sides = [SimpleNamespace(dents=lambda _: one), SimpleNamespace(elastic="")]
    monkeypatch.setattr(contacts, "sides", lambda *_: sides)
    carried = SimpleNamespace(type=SimpleNamespace(
        surface=lambda part, scene, ports: SimpleNamespace(dents=lambda _: two)))  # fmt: skip
    scene = SimpleNamespace(parts={"ball": carried})
    assert contacts._dents(None, scene, None) is one
    sides[1].elastic = "ball"
    found = contacts._dents(None, scene, None)
    np.testing.assert_allclose(found.compliance, 4e-9 * np.eye(3))
    assert (found.patch, found.pace) == pytest.approx((12e-9, 5e-8))


def test_an_elastic_sphere_is_where_its_dent_carries_it(bodies):
    """The contact's place is the sphere's and what its patch gives; without that it is unknown."""
    _, scene, _ = bodies
    contact, still = scene.parts["contact"], np.zeros(2)
    data = {"time": np.arange(2.0), "sphere.y": 2e-3 - np.array([0.0, 3e-6]),
            "sphere_elastic.u.patch": np.array([0.0, 1e-6])}  # fmt: skip
    build = Build(scene, {})
    found = contacts._place(contact, build, Waveforms(data, {}))
    np.testing.assert_allclose(found, [0.0, -2e-6], atol=1e-15)
    data.pop("sphere_elastic.u.patch")
    waves = Waveforms(data | {"contact.force": still, "contact.force.patch": still}, {})
    assert contacts._place(contact, build, waves) is None
    assert contact.type.energy(contact, build, waves) == {}
    pins = [p.name for p in contact.type.pins(contact, scene)]
    assert pins == ["patch", "v", "bottom", "dent", "base"]
    assert contact.type.links(contact, scene)["dent"] == "sphere_elastic.patch"
    assert contact.type.wants(contact, scene)[-1] == "sphere_elastic.patch"


def test_an_elastic_sphere_goes_deeper_by_both_moduli():
    """Depth grows with ``E*^(-2/5)``, ``1/E* = 1/M_a + 1/M_b``."""
    rigid, soft = (load_scene("impact", [*PRESSED[:1], *more]) for more in ([], PRESSED[1:]))
    depth = [next(iter(s.parts["impact"].type.reach(s.parts["impact"], s))).depth
             for s in (rigid, soft)]  # fmt: skip
    kick = rigid.parts["kick"]
    chip, steel = kick.type.indentation_modulus(kick), 211.9e9 / (1 - 0.291**2)
    assert depth[1] / depth[0] == pytest.approx((1 + chip / steel) ** 0.4, rel=1e-6)


def test_the_hats_are_a_row_of_the_error_budget(monkeypatch):
    scene = load_scene("impact", PRESSED[:1])
    contact = scene.parts["contact"]
    monkeypatch.setattr(contacts, "spacing_error", lambda *_: 0.05)
    (row,) = contact.type.estimates(contact, scene)
    assert (row.stage, row.share, row.expected) == ("hats of contact", None, 0.05)
    assert row.settings == "contact.spacing 1e-05 m"
    assert contacts.unresolved(contact, scene) == pytest.approx(0.15)
    plain = load_scene("impact")
    assert contacts.unresolved(plain.parts["contact"], plain) == 0.0


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
