"""The contact as a part, on waveforms and numbers made by hand."""

import math
import re

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts import contact as contacts
from kc2spice.parts.contact import Normal, _loaded, contact_subcircuit, dent, gaps, normal, sides
from kc2spice.scene.gates import stepping
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.spice.header import Header

LOOP = {"name": "loop", "kick": {}, "contact": {}, "sphere": {}}
MASS = 4 / 3 * np.pi * 1e-9 * 7850.0
STEEL = 211.9e9 / (1 - 0.291**2)


def loaded(*keys, scene=None):
    """A scene, its contact and a build without models."""
    found = load_scene(scene or LOOP, list(keys))
    return found, found.parts["contact"], Build(found, {})


# --- the law --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "law",
    [Normal(3.0), Normal(3.0, 1.5), Normal(2.0, 1.5, curve=(1.0, -0.25, 0.5), depth=4.0)],
    ids=["linear", "hertz", "series"],
)
def test_the_energy_of_a_law_is_the_integral_of_its_force(law):
    x = np.linspace(0.0, 4.0, 20001)
    exact = np.trapezoid(law.force(x), x)
    assert law.energy(np.array([4.0]))[0] == pytest.approx(exact, rel=1e-6)
    np.testing.assert_array_equal(law.force(np.array([-1.0, -1e-12])), 0.0)
    np.testing.assert_array_equal(law.energy(np.array([-1.0, 0.0])), 0.0)


def test_a_series_counts_the_root_of_the_depth():
    """``2 x^(3/2) (1 - s / 4 + s^2 / 2)`` with ``s = sqrt(x / 4)``."""
    law = Normal(2.0, 1.5, curve=(1.0, -0.25, 0.5), depth=4.0)
    assert law.force(np.array([1.0]))[0] == pytest.approx(2 * (1 - 0.125 + 0.125))
    assert law.force(np.array([4.0]))[0] == pytest.approx(16 * (1 - 0.25 + 0.5))


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


def test_keys_of_friction_and_damping_reach_the_law():
    scene, contact, _ = loaded()
    assert normal(contact, scene) == Normal(4e8)  # nothing said
    scene, contact, _ = loaded("contact.damping=0.3", "contact.gap=2 um")
    law = normal(contact, scene)
    assert (law.damping, law.friction, law.stiffness) == (0.3, 0.0, 4e8)
    radii = 50e-6 * np.arange(6)
    exact = 1e-3 - np.sqrt(1e-6 - radii**2) + 2e-6
    np.testing.assert_allclose(gaps(contact, scene, every=True), exact, rtol=1e-9)
    assert gaps(contact, scene).size == len(contact.type.pins(contact, scene)) - 3


def test_how_deep_a_sphere_goes_is_what_hertz_says_and_a_quarter_more():
    energy = 0.5 * 2e-5 * 3.0**2
    depth = dent(1e11, 2e-5, 3.0, 1e-3) / 1.25
    assert 8 / 15 * 1e11 * math.sqrt(1e-3) * depth**2.5 == pytest.approx(energy, rel=1e-12)


@pytest.mark.parametrize(
    ("keys", "share"),
    [([], 1.0), (["contact.law=hertz", "sphere.material=steel", "contact.rings=1",
                  "contact.a=kick.ring0"], 0.1),
     (["contact.shape=pressure"], 0.1), (["contact.damping=1"], 0.01)],
)  # fmt: skip
def test_curved_and_damped_laws_ask_for_smaller_steps(keys, share):
    scene, contact, _ = loaded(*keys)
    assert contact.type.closeness(contact, scene) == share


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


def test_a_pressure_says_what_it_found_instead_of_a_sphere():
    with pytest.raises(UsageError, match="under a sphere") as raised:
        load_scene(LOOP, [*PRESSED, "sphere.radius=0.25 mm"])
    assert raised.value.got == "a radius of 0.00025 m"
    assert "more than 0.00025 m" in raised.value.expected
    box = {"part": "mass", "mass": 1e-3, "pins": {"a": "hold.a"}}
    flat = {"name": "flat", "kick": {}, "box": box, "hold": {"part": "spring", "stiffness": 1.0},
            "contact": {"a": "kick", "b": "box.a", "shape": "pressure"}}  # fmt: skip
    with pytest.raises(UsageError, match="under a sphere") as raised:
        load_scene(flat)
    assert raised.value.got == "no sphere"


def test_rings_lie_below_the_sphere():
    load_scene(LOOP, ["sphere.radius=251 um"])
    with pytest.raises(UsageError, match="beyond the sphere"):
        load_scene(LOOP, ["sphere.radius=250 um"])


def test_both_sides_are_one_part_each_that_can_be_touched():
    both = {**LOOP, "load": {"part": "resistor", "resistance": 1.0, "pins": {"a": "kick.anode"}}}
    for keys, word in (
        (["contact.a=['kick.ring0', 'sphere']"], "one body on each side"),
        (["contact.a=load"], "offers nothing to touch"),
        (["contact.a=nobody"], "nobody"),
    ):
        with pytest.raises(UsageError, match=word):
            load_scene(both, keys)
    with pytest.raises(UsageError, match="what touches") as raised:
        load_scene({**LOOP, "other": {"part": "sphere"}})
    assert raised.value.got == "sphere, other"
    assert raised.value.hint is None
    with pytest.raises(UsageError, match="what touches") as raised:
        load_scene({"name": "none", "contact": {}, "sphere": {}})
    assert (raised.value.got, raised.value.expected) == (
        "no part that is a body with a surface", 'a = "PART" or "PART.PORT"',
    )  # fmt: skip
    assert "[kick]" in raised.value.hint


# --- what a run says ------------------------------------------------------------------------------


def run_of(scene, force, **more):
    """Samples of 1 us; all of the force in ring0, nothing else moves."""
    t = 1e-6 * np.arange(len(force))
    ports = [pin for part, pin in scene.nets if part == "contact" and pin.startswith("ring")]
    data = {"time": t, "sphere.y": np.full(t.size, 1e-3), "sphere.v": 0 * t}
    data |= {"contact.force": np.array(force)}
    data |= {f"contact.force.{port}": 0 * t for port in ports} | {
        "contact.force.ring0": np.array(force)
    }
    data |= {f"kick.u.{port}": 0 * t for port in ports}
    return Waveforms(data | {k.replace("__", "."): np.asarray(v) for k, v in more.items()}, {})


def check_of(scene, build, waves, name):
    contact = scene.parts["contact"]
    return next((c for c in contact.type.checks(contact, build, waves) if c.name == name), None)


def test_penetration_is_the_largest_force_over_the_penalty_of_a_ring():
    """Against the gap of the next ring: there the surfaces curve as much."""
    scene, _, build = loaded("contact.rings=all")
    check = check_of(scene, build, run_of(scene, [0.0, 400.0, 100.0]), "penetration")
    assert check.value == pytest.approx(400.0 / 4e8)
    assert check.limit == pytest.approx(1e-3 - math.sqrt(1e-6 - 25e-10), rel=1e-9)
    assert check.action == "warn"


def test_a_gap_of_its_own_lifts_the_sphere_at_rest():
    scene, _, build = loaded("contact.gap=2 um", "contact.rings=all")
    waves = run_of(scene, [0.0, 0.0], sphere__y=[1e-3 - 2e-6, 1e-3])
    assert check_of(scene, build, waves, "sphere starts at rest on kick").value == pytest.approx(
        0.0, abs=1e-15
    )
    waves = run_of(scene, [1e-9, 0.0], sphere__y=[2e-3, 1e-3])
    assert check_of(scene, build, waves, "sphere starts at rest on kick").value == 0.0


def test_contacts_are_counted_from_the_start_of_the_pulse_to_its_end():
    """Pulse from 2 to 7 us and its edges of 1 us: closings at 3, 5 and 8 us, the second of three
    lies at its very end; those at 1 and 10 us are others."""
    us = 2.0**-20  # s, so that sums are exact
    scene, _, build = loaded(
        f"kick.drive.start={2 * us}", f"kick.drive.width={5 * us}", f"kick.drive.edge={us}",
        "contact.rings=all",
    )  # fmt: skip
    force = [0, 1, 0, 1, 0, 1, 1, 0, 1, 0, 1, 0]
    waves = run_of(scene, np.array(force, float), time=us * np.arange(12))
    check = check_of(scene, build, waves, "touches")
    assert check.value == 3
    assert check.limit == max(20, 4e-3 / scene.solver.reltol)
    assert check.coarse
    assert check_of(scene, build, Waveforms(waves.data, {"reltol": 1e-2}), "touches").limit == 20


def test_the_outermost_ring_must_stay_open():
    scene, _, build = loaded("contact.rings=all")
    waves = run_of(scene, [0.0, 1.0])
    check = check_of(scene, build, waves, "outer_ring")
    assert (check.value, check.limit, check.unit) == (0.0, 0.0, "N")
    wide = Waveforms(waves.data | {"contact.force.ring5": np.array([0.0, 0.25])}, {})
    assert check_of(scene, build, wide, "outer_ring").value == 0.25


def test_the_bound_of_a_ring_that_was_left_out_is_what_the_kept_ones_press_and_lift(monkeypatch):
    """``u_K + sum_j S_Kj F_j`` over the sphere, up to 95 % of the first open ring's gap."""
    scene, _, build = loaded("contact.rings=2")
    compliance = np.array([[9.0, 3e-9], [3e-9, 5e-9]])
    kind = type(scene.parts["kick"].type)
    monkeypatch.setattr(kind, "static_compliance", lambda *_: compliance)
    waves = run_of(scene, [0.0, 100.0], sphere__y=[1e-3, 1e-3 + 1e-7], kick__u__ring1=[0.0, 2e-7])
    waves.data["contact.force.ring1"] = np.array([0.0, 20.0])
    check = check_of(scene, build, waves, "ring_left_out")
    assert check.value == pytest.approx(2e-7 + 3e-9 * 100 + 5e-9 * 20 - 1e-7)
    assert check.limit == pytest.approx(0.95 * (1e-3 - math.sqrt(1e-6 - 1e-8)), rel=1e-9)


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


def test_what_a_run_begins_and_ends_with_is_stored():
    scene, waves, y, elastic = bounced("linear", "contact.damping=20")
    contact, most = scene.parts["contact"], 1e6 * 4e-12 / 2
    first, last = slice(None, 1001), slice(1000, None)
    for piece, stored in ((first, most), (last, -most)):
        part = Waveforms({k: v[piece] for k, v in waves.data.items()}, {})
        found = contact.type.energy(contact, Build(scene, {}), part)["contact"]
        assert found.entries["stored in the contact"] == pytest.approx(stored, rel=1e-9)
        lost = -np.trapezoid((waves["contact.force"] - elastic)[piece], y[piece])
        assert found.entries["damped in the contact"] == pytest.approx(lost, rel=1e-6)
        assert found.missing < 1e-5 * most
    assert contact.type.energy(contact, Build(scene, {}), Waveforms({}, {})) == {}


def test_the_balance_is_measured_by_what_rests_or_moves_where_nothing_is_taken():
    """A spring that holds 2 N, or a sphere of 33 mg at 3 m/s, and no work."""
    scene, *_ = bounced("linear")
    contact, none = scene.parts["contact"], np.zeros(3)
    for force, v, scale in ((2.0, 0.0, 2.0**2 / 2e6), (0.0, -3.0, MASS * 4.5)):
        data = {"time": np.arange(3.0), "sphere.y": 1e-3 + none, "sphere.v": v + none,
                "contact.force": force + none, "contact.force.floor": force + none}  # fmt: skip
        found = contact.type.energy(contact, Build(scene, {}), Waveforms(data, {}))["contact"]
        assert found.scale == pytest.approx(scale)


def test_forces_push_both_sides_apart():
    _, contact, build = loaded()
    force = np.array([0.0, 3.0])
    waves = Waveforms({"contact.force": force, "contact.force.ring0": force / 3}, {})

    def on(pin):
        return contact.type.force_on(contact, pin, build, waves)

    np.testing.assert_array_equal(on("v"), force)
    np.testing.assert_array_equal(on("b"), force)
    np.testing.assert_array_equal(on("dent"), force)
    np.testing.assert_array_equal(on("va"), -force)
    np.testing.assert_array_equal(on("ring0"), -force / 3)
    assert on("ring1") is None
    assert on("slide") is None
    waves.data["contact.friction"] = np.array([0.0, 2.0])
    np.testing.assert_array_equal(on("slide"), [0.0, -2.0])
    np.testing.assert_array_equal(on("rail"), [0.0, 2.0])


def test_a_launch_has_a_gate_and_a_throw_has_none():
    scene, contact, build = loaded("gates.launch_velocity=2e-5", "gates.launch_full_model=3e-3")
    (gate,) = contact.type.gates(contact, build)
    assert gate.limits == {"ngspice_vs_rom": 2e-5, "rom_vs_fom": 3e-3, "ngspice_vs_fom": 3e-3}
    assert gate.leads
    scene, contact, build = loaded()
    (gate,) = contact.type.gates(contact, build)
    assert gate.limits["ngspice_vs_rom"] == stepping(scene.solver)
    thrown, contact, build = loaded("sphere.velocity=-1")
    assert not list(contact.type.gates(contact, build))
    waves = run_of(thrown, [1.0, 0.0])
    assert contact.type.metrics(contact, build, waves) == {}


def test_a_launch_is_told_with_its_time():
    """The load falls to zero in 1 us; the flight is uniform."""
    scene, contact, build = loaded("kick.drive.start=1 us", "kick.drive.width=5 us")
    force = np.r_[np.full(10, 4.0), 2.0, np.zeros(100)]
    v = np.where(np.arange(force.size) > 10, 0.7, 0.0)
    waves = run_of(scene, force, sphere__v=v)
    found = contact.type.metrics(contact, build, waves)
    assert found["launch_velocity_m_s"] == pytest.approx(0.7)
    assert found["launch_time_s"] == pytest.approx(11e-6)
    never = contact.type.metrics(contact, build, run_of(scene, np.ones(5)))
    assert never == {"launch_velocity_m_s": None, "launch_time_s": None}


def test_what_is_loaded_ends_with_the_first_contact():
    force = np.zeros(1000)
    force[100:120] = 1.0
    force[150] = 0.5  # a gap of 30 samples is within one contact
    force[500:510] = 1.0
    force[98], force[800] = 0.009, 0.009
    assert _loaded(force) == slice(98, 153)
    assert _loaded(np.zeros(3)) == slice(None)
    force[:] = 0.0
    force[0:4] = 1.0
    assert _loaded(force) == slice(0, 6)


def test_pins_and_joins_follow_what_touches():
    scene, contact, _ = loaded("contact.rings=2")
    kind = contact.type
    assert [p.name for p in kind.pins(contact, scene)] == ["ring0", "ring1", "v", "bottom", "base"]
    assert kind.wants(contact, scene) == ("kick.ring0", "kick.ring1", "sphere.v")
    assert kind.massless(contact, scene) == kind.wants(contact, scene)
    lumped, contact, _ = loaded("contact.inertia=lumped")
    assert kind.massless(contact, lumped) == ()
    block = {
        "name": "dry", "box": {"part": "mass", "mass": 1e-3, "pins": {"a": "pull.out"}},
        "pull": {"part": "source", "kind": "force", "dc": 1.0},
        "contact": {"part": "contact", "a": "gnd", "b": "box.a", "friction": 0.3,
                    "pins": {"slide": "side.a"}},
        "side": {"part": "mass", "mass": 1e-3},
    }  # fmt: skip
    dry = load_scene(block)
    contact = dry.parts["contact"]
    pins = {p.name: p for p in kind.pins(contact, dry)}
    assert list(pins) == ["floor", "b", "slide", "rail", "base"]
    assert pins["slide"].required
    assert (pins["rail"].default, pins["base"].default) == ("gnd", "gnd")
    assert kind.modelled(contact, dry).detail.endswith("friction 0.3, viscous below 0.0001 m/s")
    friction = kind.vectors(contact, Build(dry, {}))["contact.friction"]
    assert (friction.expression, friction.factor) == ("@b.xcontact.bslide[i]", 1.0)
    cradle = load_scene("newtons_cradle")
    one = next(c for c in cradle.of("contact"))
    assert [p.name for p in kind.pins(one, cradle)] == ["va", "a", "v", "bottom", "base"]
    assert sides(one, cradle)[0].rigid


def test_the_netlist_tells_what_its_parameters_are():
    header, radii = Header("t", "0"), np.array([0.0, 50e-6])
    under = contact_subcircuit(header, ("r0", "r1"), radii, Normal(4e8), under=(1e-3, radii))
    params = {p.name: p for p in under.params}
    assert (params["radius"].default, params["radius"].low) == (1e-3, 50e-6)
    assert (params["eps"].unit, params["gap_r1"].doc) == ("N/m", "added to the gap at r1")
    assert "elastic and normal to the surface" in under.text
    assert "no friction, adhesion" in " ".join(under.text.replace("*", "").split())
    dry = contact_subcircuit(
        header, ("r0",), np.zeros(1), Normal(1e9, 1.5, damping=0.5, friction=0.3, creep=1e-3)
    )
    params = {p.name: p.default for p in dry.params}
    assert params == {"eps": 1e9, "gap_r0": 0.0, "damping": 0.5, "friction": 0.3, "creep": 1e-3}
    assert dry.params[0].unit == "N/m^1.5"
    assert dry.params[1].doc == "gap at r0 when both sides are at rest"
    assert "elastic but for its damping and normal to and along" in dry.text
    assert dry.no_module
    assert not under.no_module
    assert [p.name for p in dry.pins] == ["r0", "v", "bottom", "slide", "rail", "base"]


def test_what_a_contact_is_modelled_as_is_told():
    scene, contact, _ = loaded("contact.rings=3", "contact.damping=0.5")
    told = contact.type.modelled(contact, scene).detail
    assert told == "3 unilateral springs, 4e+08 N/m each, damping of Hunt and Crossley 0.5 s/m"
    assert not list(contact.type.estimates(contact, scene))


def test_a_series_is_one_of_micrometres_in_the_netlist():
    """``curve_k (x / depth)^(k/2)`` with x in um."""
    law = Normal(1e8, 1.5, curve=(1.0, -0.25, 0.5), depth=4e-6, radius=1e-3)
    text = contact_subcircuit(Header("d", "0"), ("p",), np.zeros(1), law).text
    found = dict(re.findall(r"(?m)^\.param (c\d)=(\S+)$", text))
    assert {k: float(v) for k, v in found.items()} == pytest.approx(
        {"c1": -0.125, "c2": 0.125}, rel=1e-9
    )


def test_a_pressure_is_judged_by_how_deep_its_law_goes_and_how_many_hats_carry(monkeypatch):
    """Hats of 10 um under a contact of at least 30 um: sqrt(R depth)."""
    monkeypatch.setattr(contacts, "normal", lambda *_: Normal(1e9, 1.5, depth=4e-6, radius=1e-3))
    scene, contact, build = loaded("contact.shape=pressure", "contact.gap=0.5 um")
    still = np.zeros(3)

    def judged(deepest):
        place = 1e-3 - np.array([0.0, deepest + 0.75e-6, 0.0])
        moved = np.array([0.0, -0.25e-6, 0.0])
        waves = {"time": np.arange(3.0), "sphere.y": place, "kick.u.patch": moved}
        return list(contacts._within_law(contact, build, Waveforms(waves, {})))

    depth, hats = judged(3e-6)
    assert (depth.value, depth.limit) == (pytest.approx(3e-6, rel=1e-6), 4e-6)
    assert depth.action == scene.checks.range
    assert (hats.value, hats.limit) == (10e-6, pytest.approx(math.sqrt(3e-9) / 3, rel=1e-6))
    assert hats.action == scene.checks.penetration
    assert [c.passed for c in judged(0.89e-6)] == [True, False]
    assert [c.passed for c in judged(0.91e-6)] == [True, True]
    assert [c.passed for c in judged(4.01e-6)] == [False, True]
    assert len(judged(-1e-6)) == 1  # nothing touches
    waves = Waveforms({"time": still, "sphere.y": still}, {})
    assert not list(contacts._within_law(contact, build, waves))
    plain, contact, build = loaded()
    assert not list(contacts._within_law(contact, build, waves))
    assert plain.parts["contact"].keys.shape == "rings"


def test_what_falls_gains_speed_downwards_only():
    assert contacts.fall(0.2, 9.81) == pytest.approx(math.sqrt(2 * 9.81 * 0.2))
    assert contacts.fall(-0.2, 9.81) == contacts.fall(0.2, -9.81) == 0.0


def test_a_prescribed_reach_beats_what_could_happen():
    scene, contact, _ = loaded()
    rest = load_scene({"name": "rest", "sphere": {}, "contact": {"a": "gnd"}})
    weight = contacts.reach(rest.parts["contact"], rest)
    assert (weight.depth, weight.why) == (0.0, "its weight")
    kicked = contacts.reach(contact, scene)
    assert "free stroke" in kicked.why
    pushed = load_scene("imprint", ["imprint.depth=0.01 um", "kick.electrical=driven"])
    assert contacts.reach(pushed.parts["contact"], pushed).depth == pytest.approx(0.01e-6)
    higher = load_scene("kick_and_catch", ["kick.drive.voltage=1"])
    fallen = contacts.reach(higher.parts["contact"], higher)
    assert fallen.why == "fall from catch.y_max"


def test_a_sphere_that_sinks_with_the_surface_flies_by_its_own_speed():
    """Flights of -3 and -1 m/s, 50 us apart: the launch is the first of at least the fastest."""
    t = 1e-6 * np.arange(200.0)
    force = np.where((t < 10.5e-6) | ((t > 99.5e-6) & (t < 105.5e-6)), 1.0, 0.0)
    for speeds, launch in (((-3.0, -1.0), -1.0), ((-1.0, -3.0), -1.0), ((0.4, 1.0), 1.0),
                           ((0.6, 1.0), 0.6)):  # fmt: skip
        v = np.where(t < 50e-6, *speeds)
        assert contacts.separation(t, force, v)[1] == pytest.approx(launch)
    # of those that begin until 20 us after the drive
    v = np.where(t < 50e-6, 0.4, 1.0)
    assert contacts.separation(t, force, v, 84e-6)[1] == pytest.approx(0.4)
    assert contacts.separation(t, force, v, 86e-6)[1] == pytest.approx(1.0)
    assert contacts.separation(t, force, v, -1.0)[1] == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("scene", "keys", "until"),
    [
        ("kick_and_catch", ["control.enable_at=2 ms"], 525.1e-6), ("amplifier_kick", [], 525.1e-6),
        ({"name": "still", "sphere": {}}, [], math.inf),
    ],
)  # fmt: skip
def test_a_drive_is_busy_until_its_pulse_has_fallen(scene, keys, until):
    """Behind an amplifier too; a controller's enable is no drive."""
    kicked = ["kick.drive.start=500 us", "kick.drive.width=25 us", "kick.drive.edge=0.1 us"]
    found = load_scene(scene, [*keys, *(kicked if isinstance(scene, str) else [])])
    assert contacts.busy_until(found) == pytest.approx(until)


def test_an_enable_that_comes_first_hides_no_drive():
    kick = {"drive": {"start": 1e-4, "width": 2e-5, "edge": 1e-7}}
    order = {"name": "n", "control": {}, "catch": {}, "sphere": {}, "contact": {}, "kick": kick}
    scene = load_scene(order)
    assert [source.name for source in scene.of("source")] == ["control_enable", "kick_drive"]
    assert contacts.busy_until(scene) == pytest.approx(120.1e-6)


def test_a_stack_of_two_rings_tells_whether_the_outer_one_opens():
    scene, _, build = loaded("kick.mesh.rings=1", "contact.rings=all")
    check = check_of(scene, build, run_of(scene, [0.0, 1.0]), "outer_ring")
    assert (check.value, check.limit) == (0.0, 0.0)
    assert check_of(scene, build, run_of(scene, [0.0, 1.0]), "penetration").value > 0
    scene, _, build = loaded("contact.rings=all", "contact.a=kick.ring0")
    for name in ("outer_ring", "penetration"):
        assert check_of(scene, build, run_of(scene, [0.0, 1.0]), name) is None


def test_a_bed_of_springs_holds_what_rests_on_a_stack():
    found = load_scene(LOOP, ["kick.mounting=1e14 N/m3"])
    assert found.parts["kick"].keys.mounting == 1e14


def test_the_netlist_of_a_pressure_has_radius_and_pace():
    """Of a sphere no smaller than the law is deep; elastic ones carry their dent on a pin."""
    law = Normal(1e8, 1.5, curve=(1.0, 0.5), depth=4e-6, pace=2e-9, radius=1e-3)
    header = Header("t", "0")
    for elastic in (False, True):
        found = contact_subcircuit(header, ("patch",), np.array([3e-6]), law,
                                   under=(1e-3, np.zeros(1)), elastic=elastic)  # fmt: skip
        params = {p.name: (p.default, p.unit, p.low) for p in found.params}
        least = params.pop("eps")[2]
        assert 0 < least < 1e-20
        assert params == {
            "radius": (1e-3, "m", 4e-6), "pace": (2e-9, "s", -math.inf),
            "gap_patch": (3e-6, "m", -math.inf),
        }  # fmt: skip
        dent_ = ["dent"] if elastic else []
        assert [p.name for p in found.pins] == ["patch", "v", "bottom", *dent_, "base"]
    both = contact_subcircuit(header, ("a",), np.zeros(1), Normal(1e8), rigid=(True, True))
    assert [(p.name, p.unit) for p in both.pins] == [
        ("va", "m/s"), ("a", "um"), ("v", "m/s"), ("bottom", "um"), ("base", "um"),
    ]  # fmt: skip
    none = contact_subcircuit(header, ("a",), np.zeros(1), Normal(1e8), rigid=(False, False))
    assert [p.name for p in none.pins] == ["a", "b", "base"]
    assert "radius" not in {p.name for p in none.params}


def test_rings_lie_under_a_sphere_that_may_change_its_radius():
    """``r^2 / (R + sqrt(R^2 - r^2))`` of the rings that have a spring, R no less than theirs."""
    radii = np.array([0.0, 50e-6, 100e-6, 150e-6])
    found = contact_subcircuit(Header("t", "0"), ("r0", "r1", "r2"), np.zeros(3), Normal(1e8),
                               under=(1e-3, radii))  # fmt: skip
    assert {p.name: p.low for p in found.params}["radius"] == 100e-6
    for r in radii[1:3]:
        assert f"{float(r) ** 2!r}" in found.text
    assert f"{float(radii[3]) ** 2!r}" not in found.text


@pytest.mark.parametrize("name", ["anvil", "zinc"])
def test_a_body_of_any_name_is_no_ground(name):
    """What lies before and after ``gnd`` in the alphabet."""
    scene = load_scene({"name": "named", name: {"part": "piezo_stack", "drive": {}}, "sphere": {},
                        "contact": {"a": name, "rings": 2}})  # fmt: skip
    contact = scene.parts["contact"]
    joins = contact.type.links(contact, scene)
    assert joins == {"ring0": f"{name}.ring0", "ring1": f"{name}.ring1", "v": "sphere.v",
                     "bottom": "sphere.bottom"}  # fmt: skip
    own = sides(contact, scene)[0]
    waves = Waveforms({"time": np.arange(2.0), f"{name}.u.ring1": np.array([1e-6, 2e-6])}, {})
    found = contacts._height(name, own, "ring1", Build(scene, {}), waves)
    np.testing.assert_array_equal(found, [1e-6, 2e-6])
    floor = load_scene({"name": "floor", "sphere": {}, "contact": {"a": "gnd"}})
    contact = floor.parts["contact"]
    assert contact.type.links(contact, floor)["floor"] == "gnd"
    own = sides(contact, floor)[0]
    none = contacts._height("gnd", own, "floor", Build(floor, {}), waves)
    np.testing.assert_array_equal(none, [0.0, 0.0])
