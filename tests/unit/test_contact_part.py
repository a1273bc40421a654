"""The contact as a part, on waveforms and numbers made by hand."""

import math

import numpy as np
import pytest

import kc2spice as kc
from kc2spice.core.errors import UsageError
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.contact import Normal, dent, normal
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build

LOOP = {"name": "loop", "kick": {}, "contact": {}, "sphere": {}}
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


def test_how_deep_a_sphere_goes_is_what_hertz_says_and_a_quarter_more():
    energy = 0.5 * 2e-5 * 3.0**2
    depth = dent(1e11, 2e-5, 3.0, 1e-3) / 1.25
    assert 8 / 15 * 1e11 * math.sqrt(1e-3) * depth**2.5 == pytest.approx(energy, rel=1e-12)


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
