"""What single parts refuse, measure and say, on scenes and waves made by hand."""

import math
import re

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.pid import Control, compliance, sense_resistance, settling_time, tail_mean
from kc2spice.parts.source import smooth_pieces
from kc2spice.parts.sphere import SphereKeys, _air_drag, integral
from kc2spice.parts.throw import minimum
from kc2spice.scene.gates import stepping
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.workflow.verify.circuit import solve

LOOP = {"name": "loop", "kick": {}, "contact": {}, "sphere": {}}
MASS = 4 / 3 * np.pi * 1e-9 * 7850.0


def wave(**data):
    return Waveforms({k.replace("__", "."): np.asarray(v, float) for k, v in data.items()}, {})


def part_of(scene, name, *keys, models=None):
    """Its part of this name, its type, and a build."""
    loaded = load_scene(scene, list(keys))
    part = loaded.parts[name]
    return part, part.type, Build(loaded, models or {})


# --- throw and push -------------------------------------------------------------------------------


def test_a_throw_goes_down_and_arrives_with_what_it_fell():
    part, kind, build = part_of("impact", "impact", "impact.velocity=-0.3", "impact.gap=10 mm")
    assert kind.speed(part, build.scene) == pytest.approx(0.3)  # no gravity
    part, kind, build = part_of("impact", "impact", "gravity=9.81", "impact.velocity=-0.3",
                                "impact.gap=10 mm")  # fmt: skip
    assert kind.speed(part, build.scene) == pytest.approx(math.sqrt(0.09 + 2 * 9.81 * 0.01))
    part, kind, build = part_of("impact", "impact", "impact.velocity=-1e-6")
    assert kind.speed(part, build.scene) == 1e-3
    part, kind, build = part_of("impact", "impact", "gravity=-9.81")
    assert kind.speed(part, build.scene) == 1.0
    for up in ("0", "0.1"):
        with pytest.raises(UsageError, match="never arrives"):
            load_scene("impact", [f"impact.velocity={up}"])


def test_a_throw_is_judged_by_travel_rebound_and_separation():
    part, kind, build = part_of("impact", "impact", "gates.position=3e-4")
    travel, rebound, separation = kind.gates(part, build)
    every = {"rom_vs_fom", "ngspice_vs_rom", "ngspice_vs_fom"}
    assert travel.limits == dict.fromkeys(every, 3e-4)
    assert (travel.measure, travel.leads) == ("travel", True)
    assert (rebound.of, set(rebound.limits)) == ("rebound_velocity_m_s", every)
    assert (separation.measure, separation.unit) == ("absolute", "s")
    assert kind.metrics(part, build, Waveforms({}, {})) == {}
    assert kind.modelled(part, build.scene).detail == "-1 m/s from 1e-06 m"


def test_a_throw_under_a_pressure_is_judged_by_its_hats(monkeypatch):
    """Against the full model; where nothing is touched there are none."""
    from kc2spice.parts import throw

    monkeypatch.setattr(throw, "unresolved", lambda contact, scene: 0.02 * len(scene.parts))
    part, kind, build = part_of("impact", "impact", "gates.position=3e-4")
    hats = 0.02 * len(build.scene.parts)
    travel, *_ = kind.gates(part, build)
    assert travel.limits == {
        "rom_vs_fom": hats, "ngspice_vs_rom": 3e-4, "ngspice_vs_fom": hats
    }  # fmt: skip
    alone = {"name": "thrown", "gates": {"position": 3e-4}, "sphere": {}, "impact": {}}
    part, kind, build = part_of(alone, "impact")
    travel, *_ = kind.gates(part, build)
    assert set(travel.limits.values()) == {3e-4}
    assert kind.metrics(part, build, wave(time=[0.0], sphere__y=[0.0])) == {}


@pytest.mark.parametrize("start", [0.0, 0.3])
def test_the_lowest_point_of_a_parabola_is_between_its_samples(start):
    """Uneven samples of a parabola with its vertex at 1.3: exact; at an end that end."""
    t = np.array([start, 1.0, 1.25, 1.9, 2.0])
    time, value = minimum(t, 5.0 + 2.0 * (t - 1.3) ** 2)
    assert (time, value) == pytest.approx((1.3, 5.0), rel=1e-12)
    assert minimum(t, -t) == (2.0, -2.0)
    assert minimum(t, t) == (start, start)
    assert minimum(np.arange(3.0), np.array([1.0, 1.0, 1.0]))[1] == 1.0
    assert minimum(np.arange(4.0), np.array([2.0, 1.0, 1.0, 2.0])) == pytest.approx((1.5, 0.875))


def test_a_push_needs_a_contact_and_stays_above_the_middle():
    load_scene("imprint", ["imprint.depth=0.99 mm"])
    with pytest.raises(UsageError, match="deeper than the sphere's radius"):
        load_scene("imprint", ["imprint.depth=1 mm"])
    with pytest.raises(UsageError, match="needs this part"):
        load_scene({"name": "none", "kick": {}, "sphere": {}, "imprint": {}})


def test_a_push_is_swept_and_solved_to_rounding():
    part, kind, build = part_of("imprint", "imprint", "imprint.steps=10")
    scene = build.scene
    assert (scene.analysis.points, kind.sweep_range(part, scene)) == (11, (0.0, 50e-6))
    assert kind.dc(part, "depth", build) == ("Vimprint", -1e6)
    assert kind.dc(part, "steps", build) is None
    vector = kind.vectors(part, build)["imprint.depth"]
    assert vector.factor == -1e-6
    assert kind.options(part, scene)["reltol"][0] == "1e-09"
    (reach,) = kind.reach(part, scene)
    assert (reach.depth, reach.prescribed) == (50e-6, True)
    (gate,) = kind.gates(part, build)
    assert (gate.measure, gate.leads) == ("relative", True)
    assert gate.limits == {
        "rom_vs_fom": 1e-12, "ngspice_vs_rom": 1e-11, "ngspice_vs_fom": 1e-11
    }  # fmt: skip
    assert kind.modelled(part, scene).detail == "10 steps down to 5e-05 m"


def test_a_push_under_a_pressure_is_judged_by_its_hats(monkeypatch):
    from kc2spice.parts import push

    monkeypatch.setattr(push, "unresolved", lambda *_: 0.02)
    part, kind, build = part_of("imprint", "imprint", "contact.shape=pressure")
    assert kind.options(part, build.scene)["reltol"][0] == "1e-12"
    (gate,) = kind.gates(part, build)
    assert gate.measure == "largest"
    assert gate.limits == {
        "rom_vs_fom": 0.02, "ngspice_vs_rom": 1e-11, "ngspice_vs_fom": 0.02
    }  # fmt: skip


# --- sphere and mass ------------------------------------------------------------------------------


def test_a_sphere_keeps_its_energy_balance():
    """Lifted by 3 N against its weight at 1, 2 and 4 m/s in 0.5 s steps: by trapezoids."""
    part, kind, build = part_of(LOOP, "sphere")
    t, v, force = np.array([0.0, 0.5, 1.0]), np.array([1.0, 2.0, 4.0]), np.array([0.0, 3.0, 1.0])
    waves = wave(time=t, sphere__v=v, contact__force=force, sphere__y=t)
    found = kind.energy(part, build, waves)["sphere"]
    lifted = 0.5 * (0 + 6) / 2 + 0.5 * (6 + 4) / 2
    weight = -MASS * 9.81 * (0.5 * 1.5 + 0.5 * 3.0)
    kinetic = MASS * (16 - 1) / 2
    assert found.entries == pytest.approx({
        "work of the weight": weight, "work of the contact": lifted, "kinetic": kinetic,
    })  # fmt: skip
    assert found.missing == pytest.approx(abs(kinetic - weight - lifted))
    assert found.scale == pytest.approx(lifted - weight)
    assert found.limit == 1e-4
    np.testing.assert_allclose(integral(v, t), [0.0, 0.75, 2.25])
    assert kind.energy(part, build, wave(sphere__v=v)) == {}


def test_a_sphere_has_a_gate_of_its_height():
    part, kind, build = part_of(LOOP, "sphere")
    (gate,) = kind.gates(part, build)
    assert gate.limits == {"ngspice_vs_rom": stepping(build.scene.solver)}
    assert gate.measure == "travel"
    part, kind, build = part_of(LOOP, "sphere", "gates.trajectory=3 um")
    (gate,) = kind.gates(part, build)
    assert (gate.limits, gate.unit) == ({"ngspice_vs_rom": 3e-6}, "m")
    part, kind, build = part_of(LOOP, "sphere", "sphere.velocity=-1")
    assert not list(kind.gates(part, build))


def test_what_a_sphere_is_made_of():
    part, kind, build = part_of(LOOP, "sphere", "sphere.elastic=false")
    assert "sphere_elastic" not in build.scene.parts
    assert kind.indentation_modulus(part) is None
    assert part.keys.mass == pytest.approx(MASS)
    part, kind, _ = part_of(LOOP, "sphere", "sphere.material=steel")
    assert kind.indentation_modulus(part) == pytest.approx(211.9e9 / (1 - 0.291**2), rel=1e-6)
    assert part.keys.density == 7860.0
    part, _, _ = part_of(LOOP, "sphere", "sphere.material=steel", "sphere.density=5000")
    assert part.keys.density == 5000.0
    with pytest.raises(UsageError, match="steeel"):
        load_scene(LOOP, ["sphere.material=steeel"])


@pytest.mark.parametrize(
    ("fits", "refused", "word"),
    [("radius=0.1", "radius=0.101", "adhesion"), ("density=1", "density=0.99", "aerogel"),
     ("density=22600", "density=22600.5", "osmium"), ("radius=1 um", "radius=0.99 um", "adhesion")],
)  # fmt: skip
def test_where_a_sphere_begins_to_be_refused(fits, refused, word):
    alone = {"name": "ball", "sphere": {"velocity": -1.0}}
    load_scene(alone, [f"sphere.{fits}"])
    with pytest.raises(UsageError, match=word):
        load_scene(alone, [f"sphere.{refused}"])
    with pytest.raises(UsageError, match="nothing touches the sphere"):
        load_scene({"name": "loose", "kick": {}, "sphere": {}})


def test_a_sphere_begins_where_it_is_thrown_or_rests():
    """A height alone counts as a start; the law's coordinate is that of its lowest point."""
    for keys, speed, height in ((["sphere.height=2 mm"], 0.0, 2e-3), ([], 0.0, None),
                                (["sphere.velocity=-3"], -3.0, 0.0)):  # fmt: skip
        part, kind, build = part_of(LOOP, "sphere", *keys)
        (law,) = kind.law(part, build).laws
        assert law == type(law)("sphere", part.keys.mass, 9.81, height, speed)
        assert kind.without_operating_point(part, build.scene) == bool(keys)
    part, kind, build = part_of({"name": "ball", "sphere": {}}, "sphere")
    assert set(kind.initial(part, build).values()) == {0.0}
    assert len(kind.initial(part, build)) == 2
    assert kind.modelled(part, build.scene).detail.startswith("32.88 mg, vertical motion")
    part, kind, build = part_of({"name": "ball", "sphere": {}}, "sphere", "sphere.height=1 mm")
    assert kind.initial(part, build) == {}
    seen = {"part": "sensor", "pins": {"of": "sphere.bottom"}}
    for more in ({"catch": {}}, {"seen": seen}):  # at its pin v, and at its pin bottom
        part, kind, build = part_of({"name": "ball", "sphere": {}, **more}, "sphere")
        assert kind.initial(part, build) == {}


@pytest.mark.parametrize("radius", [0.1e-3, 0.2e-3, 0.35e-3, 0.5e-3, 1e-3, 2e-3, 5e-3])
def test_the_drag_of_the_air_is_told_of_the_weight(radius):
    """Schiller and Naumann: ``24 / Re (1 + 0.15 Re^0.687)``, air of 20 degC at 1 m/s."""
    reynolds = 1.204 * 2 * radius / 1.825e-5
    drag = 0.5 * 1.204 * np.pi * radius**2 * 24 / reynolds * (1 + 0.15 * reynolds**0.687)
    weight = 4 / 3 * np.pi * radius**3 * 7850 * 9.81
    found = _air_drag(SphereKeys(radius=radius))
    assert found.error == f"{drag / weight:.2g} of the weight at 1 m/s"


def test_how_much_softer_an_elastic_sphere_were_is_told_by_both_moduli():
    """Against the softest of what it may touch: E* of steel 231.5 GPa."""
    part, kind, build = part_of(LOOP, "sphere")
    chip = build.scene.parts["kick"]
    modulus = chip.type.indentation_modulus(chip)
    rows = {row.effect: row for row in kind.left_out(part, build.scene)}
    told = rows["elasticity of the sphere"].error
    assert told == f"the dent would be {100 * modulus * (1 - 0.291**2) / 211.9e9:.0f} % softer"
    lone, kind, build = part_of({"name": "ball", "sphere": {}, "contact": {"a": "gnd"}}, "sphere")
    rows = {row.effect: row for row in kind.left_out(lone, build.scene)}
    assert rows["elasticity of the sphere"].error == "not estimated"


def test_a_sphere_stands_on_its_lowest_point():
    part, kind, build = part_of(LOOP, "sphere", "sphere.radius=2 mm")
    (shape,) = kind.outline(part, build.scene)
    assert (shape.x, shape.y, shape.width, shape.height, shape.round) == (
        0.0, 2e-3, 4e-3, 4e-3, True,
    )  # fmt: skip
    assert shape.label == "sphere: radius 2 mm"


def test_a_mass_tells_its_inertia_against_what_pulls_it():
    box = {"part": "mass", "mass": 2e-3, "weight": True}
    pull = {"part": "source", "kind": "force", "dc": 1.0, "pins": {"out": "box.a"}}
    scene = {"name": "m", "gravity": 9.81, "box": box, "pull": pull}
    part, kind, build = part_of(scene, "box")
    waves = wave(box__force=[0.0, 3.0])
    np.testing.assert_allclose(kind.force_on(part, "a", build, waves), [-0.01962, -3.01962])
    assert kind.force_on(part, "base", build, waves) is None
    assert kind.force_on(part, "a", build, Waveforms({}, {})) is None
    assert kind.law(part, build).laws[0].gravity == 9.81
    part, kind, build = part_of(scene, "box", "box.weight=false")
    np.testing.assert_allclose(kind.force_on(part, "a", build, waves), [0.0, -3.0])
    assert kind.law(part, build).laws[0].gravity == 0.0
    two = scene | {"other": {"part": "mass", "mass": 1e-3, "pins": {"base": "box.a"}},
                   "push": {"part": "source", "kind": "force", "dc": 1.0,
                            "pins": {"out": "other.a"}}}  # fmt: skip
    part, kind, build = part_of(two, "other")
    assert kind.law(part, build) is None  # its base moves


def test_a_damper_is_a_law_of_the_speed():
    scene = {"name": "d", "box": {"part": "mass", "mass": 1.0},
             "brake": {"part": "damper", "damping": 0.25, "pins": {"a": "box.a"}}}  # fmt: skip
    part, kind, build = part_of(scene, "brake")
    (law,) = kind.law(part, build).laws
    assert law == type(law)("brake", 0.25)
    waves = wave(brake__force=[2.0])
    assert [kind.force_on(part, pin, build, waves)[0] for pin in ("a", "b")] == [-2.0, 2.0]
    assert kind.force_on(part, "a", build, Waveforms({}, {})) is None
    assert kind.modelled(part, build.scene).detail == "damping 0.25"


# --- electrical parts -----------------------------------------------------------------------------

CELL = {"name": "cell", "cell": {"part": "source", "dc": 1.0, "pins": {"out": "load.a"}},
        "load": {"part": "resistor", "resistance": 5.0}}  # fmt: skip


def test_a_diodes_current_leaves_what_feeds_its_anode():
    scene = {"name": "d", "cell": {"part": "source", "dc": 1.0, "pins": {"out": "one.anode"}},
             "one": {"part": "diode", "pins": {"cathode": "gnd"}}}  # fmt: skip
    part, kind, build = part_of(scene, "one")
    assert [kind.current(part, pin, build).factor for pin in ("anode", "cathode")] == [-1.0, 1.0]


@pytest.mark.parametrize(
    ("part", "keys", "told", "card"),
    [
        ("resistor", {"resistance": 5.0}, {"v": (1.0, "V"), "i": (0.2, "A")}, 5.0),
        ("capacitor", {"capacitance": 5e-6}, {"v": (1.0, "V"), "i": (1.0, "A")}, 5e-6),
        ("inductor", {"inductance": 5e-6}, {"v": (1.0, "V"), "i": (1.0, "A")}, 5e-6),
        ("spring", {"stiffness": 5.0}, {"force": (5e-6, "N")}, 2e5),  # um for each newton
        ("damper", {"damping": 5.0}, {"force": (1.0, "N")}, 5e-6),
        ("mass", {"mass": 5.0}, {"x": (1e-6, "m"), "v": (1.0, "m/s"), "force": (1.0, "N")}, None),
    ],
)  # fmt: skip
def test_a_part_of_two_pins_is_one_card_and_tells_in_si(part, keys, told, card):
    kind = {"resistor": "voltage", "capacitor": "voltage", "inductor": "current"}.get(part, "force")
    scene = {"name": "one", "it": {"part": part, **keys},
             "feed": {"part": "source", "kind": kind, "pins": {"out": "it.a"}}}  # fmt: skip
    it, type_, build = part_of(scene, "it")
    found = {n.removeprefix("it."): (pytest.approx(v.factor, rel=1e-9), v.unit)
             for n, v in type_.vectors(it, build).items()}  # fmt: skip
    assert told == found
    ends = {pin.name: pin.default for pin in type_.pins(it, build.scene)}
    assert ends == ({"a": None, "base": "gnd"} if part == "mass" else {"a": None, "b": "gnd"})
    if card is not None:
        assert float(type_.cards(it, build)[-1].split()[-1]) == pytest.approx(card, rel=1e-9)


def test_a_controller_sees_its_inputs_in_their_units():
    scene = {
        "name": "c",
        "brain": {"part": "controller", "inputs": ["x", "u", "s"], "units": {"u": "V", "s": "m/s"},
                  "output": "current", "pins": {"x": "box.a", "u": "load.a", "s": "ball.v",
                                                "out": "load.a"}},
        "box": {"part": "mass", "mass": 1.0}, "load": {"part": "resistor", "resistance": 1.0},
        "hold": {"part": "spring", "stiffness": 1.0, "pins": {"a": "box.a"}}, "ball": {
            "part": "sphere", "velocity": -1.0},
    }  # fmt: skip
    part, kind, build = part_of(scene, "brain")
    found = {n: (v.factor, v.unit) for n, v in kind.vectors(part, build).items()}
    assert found == {"brain.x": (1e-6, "m"), "brain.u": (1.0, "V"), "brain.s": (1.0, "m/s")}
    source, drive = kind.cards(part, build)
    assert source == "Vbrain brain_held 0 EXTERNAL"
    assert drive == f"Gbrain 0 {build.net(part, 'out')} brain_held 0 1"
    part, kind, build = part_of(scene, "brain", "brain.output=voltage")
    assert kind.cards(part, build) == (f"Vbrain {build.net(part, 'out')} 0 EXTERNAL",)


def test_currents_of_resistors_and_sources_count_out_of_the_pin():
    part, kind, build = part_of(CELL, "load")
    assert [math.copysign(1, kind.current(part, pin, build).factor) for pin in "ab"] == [-1, 1]
    part, kind, build = part_of(CELL, "cell")
    assert [kind.current(part, pin, build).factor for pin in ("out", "ret")] == [-1.0, 1.0]
    part, kind, build = part_of(CELL, "cell", "cell.kind=current")
    assert kind.current(part, "out", build) is None


@pytest.mark.parametrize(
    ("kind", "load", "key", "across", "through"),
    [("voltage", "resistor", "resistance", "v", "i"),
     ("current", "resistor", "resistance", "v", "i"),
     ("displacement", "spring", "stiffness", "x", "force"),
     ("force", "spring", "stiffness", "x", "force")],
)  # fmt: skip
def test_laws_of_sources_count_what_leaves_them(kind, load, key, across, through):
    """Of 3 units on 5 Ohm or 5 N/m."""
    scene = {"name": "c", "far": {"part": load, key: 5.0},
             "cell": {"part": "source", "kind": kind, "ac": 3.0, "pins": {"out": "far.a"}},
             "analysis": {"type": "ac", "start": 1.0, "stop": 2.0}}  # fmt: skip
    _, _, build = part_of(scene, "cell")
    found = solve(build, Waveforms({"frequency": np.array([1.0, 2.0])}, {})).results
    ratio = 5.0 if load == "resistor" else 1 / 5.0
    given = kind in ("voltage", "displacement")
    pair = (3.0, 3.0 / ratio) if given else (3.0 * ratio, 3.0)
    for name, value in zip((across, through), pair, strict=True):
        np.testing.assert_allclose(found[f"cell.{name}"], value, rtol=1e-9)


def test_the_voltage_of_a_source_is_read_where_the_deck_has_it():
    """Of a current source that floats there is none."""
    ends = {"out": "load.a", "ret": "load.b"}
    floating = CELL | {
        "cell": {"part": "source", "kind": "current", "pins": ends},
        "earth": {"part": "resistor", "resistance": 1.0, "pins": {"a": "load.b"}},
    }
    part, kind, build = part_of(floating, "cell")
    assert set(kind.vectors(part, build)) == {"cell.i"}
    part, kind, build = part_of(CELL, "cell", "cell.kind=current")
    assert set(kind.vectors(part, build)) == {"cell.i", "cell.v"}


@pytest.mark.parametrize(
    ("kind", "load", "card", "told"),
    [
        ("voltage", "resistor", "Vcell far 0 2.0 AC 3.0",
         {"i": ("i(vcell)", -1.0, "A"), "v": ("v(far)", 1.0, "V")}),
        ("current", "resistor", "Icell 0 far 2.0 AC 3.0",
         {"i": ("@icell[current]", 1.0, "A"), "v": ("v(far)", 1.0, "V")}),
        ("force", "spring", "Icell 0 far 2.0 AC 3.0",
         {"force": ("@icell[current]", 1.0, "N"), "x": ("v(far)", 1e-6, "m")}),
        ("displacement", "spring", "Vcell far 0 2000000.0 AC 3000000.0",
         {"force": ("i(vcell)", -1.0, "N"), "x": ("v(far)", 1e-6, "m")}),
    ],
)  # fmt: skip
def test_a_source_of_each_kind_drives_and_tells_in_its_unit(kind, load, card, told):
    key = {"resistor": "resistance", "spring": "stiffness"}[load]
    scene = {"name": "c", "far": {"part": load, key: 5.0},
             "cell": {"part": "source", "kind": kind, "dc": 2.0, "ac": 3.0,
                      "pins": {"out": "far.a"}}}  # fmt: skip
    part, type_, build = part_of(scene, "cell")
    net = build.net(part, "out")
    (found,) = type_.cards(part, build)
    assert found.replace(f" {net} ", " far ").replace(" DC ", " ") == card
    vectors = {n.removeprefix("cell."): v for n, v in type_.vectors(part, build).items()}
    assert {
        n: (v.expression.replace(net, "far"), v.factor, v.unit) for n, v in vectors.items()
    } == (told)
    assert type_.dc(part, "dc", build) == (card.split()[0], 1e6 if kind == "displacement" else 1.0)
    assert type_.dc(part, "ac", build) is None
    force = wave(cell__force=[2.0, -3.0])
    np.testing.assert_array_equal(type_.force_on(part, "out", build, force), [2.0, -3.0])
    np.testing.assert_array_equal(type_.force_on(part, "ret", build, force), [-2.0, 3.0])
    assert type_.force_on(part, "ret", build, Waveforms({}, {})) is None
    quantity = next(iter(told)) if card[0] == "I" else list(told)[1]
    waves = wave(time=[0.0, 1.0], **{f"cell__{quantity}": [2.0, 2.5]})
    (check,) = type_.checks(part, build, waves)
    assert check.value == pytest.approx(0.25)


def test_springs_and_dampers_pass_on_what_they_take():
    scene = {"name": "d", "far": {"part": "spring", "stiffness": 5.0},
             "push": {"part": "source", "kind": "force", "pins": {"out": "far.a"}}}  # fmt: skip
    part, kind, build = part_of(scene, "far")
    force = wave(far__force=[2.0])
    assert [kind.force_on(part, pin, build, force)[0] for pin in "ab"] == [-2.0, 2.0]
    vector = kind.vectors(part, build)["far.force"]
    assert vector.factor == pytest.approx(5e-6)  # N per um
    (card,) = kind.cards(part, build)
    assert float(card.split()[-1]) == pytest.approx(1e6 / 5.0)


def test_a_source_is_held_against_its_own_definition():
    """Of its swing, or of its size where it is constant, or as it is where that is zero."""
    pulse = {"high": 3.0, "low": 1.0, "width": 2.0, "edge": 1.0, "start": 1.0}
    scene = CELL | {"cell": {"part": "source", "pulse": pulse, "pins": {"out": "load.a"}}}
    part, kind, build = part_of(scene, "cell")
    exact = np.array([1.0, 1.0, 3.0, 3.0, 1.0])
    for off, dc in ((2e-3, None), (4e-3, 4.0), (1e-3, 0.0)):
        if dc is not None:
            part, kind, build = part_of(CELL, "cell", f"cell.dc={dc}")
            exact = np.full(5, dc)
        moved = exact + np.array([0.0, 0.0, off, 0.0, 0.0])
        waves = wave(time=[0.0, 1.0, 2.0, 3.0, 4.0], cell__v=moved)
        (check,) = kind.checks(part, build, waves)
        assert check.value == pytest.approx(1e-3)
        assert (check.limit, check.wiring) == (1e-3, True)
    assert not list(kind.checks(part, build, Waveforms({}, {})))
    assert not list(kind.checks(part, build, wave(cell__v=[0.0])))


def test_the_integrator_gets_the_same_waves():
    """Pulses of a train until the end, a sine from its start on, corners once each."""
    train = {"high": 2.0, "width": 1e-3, "edge": 1e-4, "start": 1e-3, "period": 3e-3}
    sine = {"amplitude": 2.0, "frequency": 500.0, "start": 1e-3}
    touching = {"high": 2.0, "width": 2**-10, "edge": 2**-13, "period": 2**-10 + 2**-13}
    for shape, given in (
        ("pulse", train), ("sine", sine), ("pulse", train | {"count": 2}), ("pulse", touching),
        ("pulse", train | {"low": 5.0}),
    ):  # fmt: skip
        cell = {"part": "source", shape: given, "pins": {"out": "load.a"}}
        part, _, build = part_of(CELL | {"cell": cell}, "cell")
        wanted = part.keys.waveform(build.scene.home)
        law = smooth_pieces(wanted, 11e-3)
        t = np.linspace(0.0, 11e-3, 1111)[:-1] + 1e-6
        np.testing.assert_allclose(law.value(t), wanted(t), atol=1e-9)


@pytest.mark.parametrize(
    ("shape", "word"),
    [({"pulse": {"high": 1, "width": 1e-6, "edge": 1.1e-6}}, "longer than the pulse"),
     ({"pulse": {"high": 1, "width": 1e-6, "edge": 0}}, "longer than the pulse"),
     ({"pulse": {"high": 1, "width": 1e-6, "edge": 1e-7, "period": 1.09e-6}}, "overlap"),
     ({"pwl": [[0, 1]]}, "must rise"), ({"pwl": [[0, 1], [0, 2]]}, "must rise"),
     ({"dc": 1, "sine": {"amplitude": 1, "frequency": 1}}, "two shapes")],
)  # fmt: skip
def test_what_is_no_waveform_is_refused(shape, word):
    with pytest.raises(UsageError, match=word):
        load_scene(CELL | {"cell": {"part": "source", "pins": {"out": "load.a"}, **shape}})


@pytest.mark.parametrize(
    "shape",
    [{"pulse": {"high": 1, "width": 1e-6, "edge": 1e-6}},
     {"pulse": {"high": 1, "width": 1e-6, "edge": 1e-7, "period": 1.1e-6}},
     {"pwl": [[0, 1], [1e-9, 2]]}],
)  # fmt: skip
def test_waveforms_at_their_limits_are_taken(shape):
    load_scene(CELL | {"cell": {"part": "source", "pins": {"out": "load.a"}, **shape}})


def test_a_table_of_a_file_is_read_with_or_without_a_head(tmp_path):
    text = CELL | {"cell": {"part": "source", "file": "w.csv", "pins": {"out": "load.a"}}}
    toml = "[cell]\npart='source'\nfile='w.csv'\npins={out='load.a'}\n"
    toml += "[load]\npart='resistor'\nresistance=5\n"
    (tmp_path / "s.toml").write_text(toml)
    for rows in ("0,1\n2,3\n", "t,v\n0,1\n2,3\n"):
        (tmp_path / "w.csv").write_text(rows)
        scene = load_scene(tmp_path / "s.toml")
        source = scene.parts["cell"].keys.waveform(scene.home)
        np.testing.assert_allclose(source(np.array([0.0, 1.0, 2.0])), [1.0, 2.0, 3.0])
    for rows in ("0,1,2\n1,2,3\n", "0\n1\n", "0,1\nx,2\n"):
        (tmp_path / "w.csv").write_text(rows)
        with pytest.raises(UsageError, match=r"is no table|must rise|cannot be read"):
            load_scene(tmp_path / "s.toml")
    assert text["cell"]["file"] == "w.csv"


def test_a_table_has_room_for_forty_bytes_a_row(monkeypatch, tmp_path):
    from kc2spice.parts import source

    monkeypatch.setattr(source, "MAX_ROWS", 2)
    (tmp_path / "s.toml").write_text(
        "[cell]\npart='source'\nfile='w.csv'\npins={out='load.a'}\n"
        "[load]\npart='resistor'\nresistance=5\n"
    )
    for more, said in ((0, None), (1, "too long")):
        rows = "0,1\n2,3\n"
        (tmp_path / "w.csv").write_text("#" * (80 + more - len(rows) - 1) + "\n" + rows)
        if said is None:
            load_scene(tmp_path / "s.toml")
        else:
            with pytest.raises(UsageError, match=said) as raised:
                load_scene(tmp_path / "s.toml")
            assert "at most 2 rows" in str(raised.value)


def test_a_voltage_from_ground_is_that_of_the_other_pin_reversed():
    scene = {"name": "r", "cell": {"part": "source", "dc": 1.0, "pins": {"out": "it.b"}},
             "it": {"part": "resistor", "resistance": 4.0, "pins": {"a": "gnd"}}}  # fmt: skip
    part, kind, build = part_of(scene, "it")
    found = kind.vectors(part, build)
    net = build.net(part, "b")
    assert (found["it.v"].expression, found["it.v"].factor) == (f"-v({net})", 1.0)
    assert (found["it.i"].expression, found["it.i"].factor) == (f"-v({net})", 0.25)


# --- pid ------------------------------------------------------------------------------------------


def test_the_output_stage_has_a_supply_for_its_coils():
    """1.2 times what the limit needs through coils and sense, in steps of 100 V from 400 V on."""
    assert compliance(Control(), 1000.0) == compliance(Control(), 3200.0) == 400.0  # 396
    assert compliance(Control(), 3300.0) == 500.0  # 408
    assert compliance(Control(current_limit=0.5), 3200.0) == 2000.0  # 20 Ohm: 1932
    assert sense_resistance(Control()) == 100.0
    assert sense_resistance(Control(current_limit=0.05)) == 100.0
    assert sense_resistance(Control(current_limit=0.5)) == 20.0
    assert sense_resistance(Control(current_limit=0.5), output=False) == 100.0


@pytest.mark.parametrize(
    ("keys", "word"),
    [
        (["control.setpoint=7.49 mm"], None), (["control.setpoint=7.5 mm"], "outside the force"),
        (["control.setpoint=-2.5 mm"], "outside the force"),
        (["control.enable_at=[1e-3, 3e-3]", "control.disable_at=[2e-3]"], None),
        (["control.enable_at=[1e-3]", "control.disable_at=[2e-3]"], None),
        (["control.enable_at=[1e-3, 2e-3]"], "do not alternate"),
        (["control.disable_at=[1e-4]"], "do not alternate"),
        (["control.enable_at=-1e-6"], "do not alternate"),
        (["control.enable_at=0"], None),
        (["control.enable_at=4.9 ms"], None), (["control.enable_at=5 ms"], "after the simulation"),
    ],
)  # fmt: skip
def test_when_a_controller_may_be_on(keys, word):
    if word is None:
        load_scene("kick_and_catch", keys)
        return
    with pytest.raises(UsageError, match=word):
        load_scene("kick_and_catch", keys)


def test_switching_is_a_signal_with_edges_of_ten_nanoseconds():
    scene = load_scene(
        "kick_and_catch", ["control.enable_at=[0, 3e-3]", "control.disable_at=[1e-3]"]
    )
    wave_ = scene.parts["control_enable"].keys.waveform(scene.home)
    t = np.array([0.0, 1e-9, 1.1e-8, 1e-3, 1e-3 + 1.1e-8, 3e-3, 3e-3 + 1.1e-8, 5e-3])
    np.testing.assert_allclose(wave_(t), [0, 0, 1, 1, 0, 0, 1, 1], atol=1e-6)
    (law,) = scene.parts["control"].type.law(scene.parts["control"], Build(scene, {})).laws
    assert tuple(
        value for value in (getattr(law, f) for f in law.__dataclass_fields__)
        if isinstance(value, tuple)
    ) == ((0.0, 3e-3), (1e-3,))  # fmt: skip


CAUGHT = {"name": "caught", "kick": {}, "contact": {}, "sphere": {}, "catch": {}, "control": {}}
HAND = {"part": "resistor", "resistance": 1.0}


@pytest.mark.parametrize(
    ("tables", "remote"),
    [
        ({}, False), ({"catch": {"driver": {"linear": {}}}}, True),
        ({"hand": HAND | {"pins": {"a": "control.command"}}}, True),
        ({"hand": HAND, "control": {"pins": {"command": "hand.a"}}}, True),
        ({"hand": HAND | {"pins": {"a": "control.enable"}}}, False),
    ],
)  # fmt: skip
def test_a_controller_ends_at_its_command_where_anything_else_takes_it(tables, remote):
    part, kind, build = part_of(CAUGHT | tables, "control")
    scene = build.scene
    ends = ["command"] if remote else ["drive", "sense"]
    assert [pin.name for pin in kind.pins(part, scene)] == ["y", "enable", *ends, "ref"]
    joins = {"y": "sphere.y"} | ({} if remote else {"drive": "catch.drive", "sense": "catch.ret"})
    assert kind.links(part, scene) == joins
    assert kind.wants(part, scene) == (() if remote else ("catch.drive", "catch.ret"))
    assert ("coil.wanted" in kind.vectors(part, build)) is remote
    only = "hand" not in scene.parts or scene.parts["hand"].pins.get("a") != "control.enable"
    assert (kind.law(part, build) is None) is (remote or not only)


def test_a_controllers_law_stands_on_ground():
    floating = CAUGHT | {"hand": HAND, "control": {"pins": {"ref": "hand.a"}}}
    part, kind, build = part_of(floating, "control")
    assert kind.law(part, build) is None
    part, kind, build = part_of(CAUGHT, "control", "control.kp=3", "control.ki=4", "control.kd=5",
                                "control.setpoint=2 mm", "control.current_limit=0.2")  # fmt: skip
    (law,) = kind.law(part, build).laws
    numbers = (law.kp, law.ki, law.kd, law.rolloff, law.limit, law.setpoint)
    assert numbers == (3.0, 4.0, 5.0, 1e-7, 0.2, 2e-3)


def test_a_controllers_signals_have_their_scale():
    part, kind, build = part_of("kick_and_catch", "control")
    assert kind.vectors(part, build)["control.error"].factor == pytest.approx(1 / 2000.0)
    assert "coil.wanted" not in kind.vectors(part, build)
    part, kind, build = part_of("coil_rails", "control")
    assert kind.vectors(part, build)["coil.wanted"].factor == pytest.approx(0.01)
    assert kind.law(part, build) is None  # its driver is a circuit of its own


def test_a_controller_at_its_limit_is_counted_from_its_start():
    """From 1 s on: 3 of 4 s at 99.95 % of the limit, by trapezoids; what was before does not
    count."""
    part, kind, build = part_of("kick_and_catch", "control", "control.enable_at=1 ms")
    t = 1e-3 * np.array([0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 5.0])
    current = 0.1 * np.array([1.0, 1.0, 0.9995, -0.9995, 1.0, 0.998, 0.5])
    waves = wave(time=t, coil__upper__current=current)
    (check,) = kind.checks(part, build, waves)
    assert check.value == pytest.approx((0.25 + 2 + 0.5) / 4)
    assert (check.limit, check.action) == (0.9, "warn")
    assert not list(kind.checks(part, build, wave(time=t)))
    assert kind.metrics(part, build, wave(time=t)) == {}


def test_a_sphere_is_caught_if_it_settles_in_nine_tenths_of_the_run():
    part, kind, build = part_of("kick_and_catch", "control")
    t = np.linspace(0.0, 1.0, 101)
    for settled, caught in ((0.89, True), (0.91, False)):
        y = np.where(t < settled, 1e-3, 2.5e-3)
        found = kind.metrics(part, build, wave(time=t, sphere__y=y))
        assert found["caught"] is caught
        assert found["final_error_m"] == 0.0
        assert found["hold_current_a"] is None
    (goal,) = kind.goals(part, build.scene, build.scene.parts["sphere"])
    assert goal[:2] == (2.5e-3, pytest.approx(0.05 * 1.5e-3))
    assert not list(kind.goals(part, build.scene, part))


def test_the_tail_is_the_last_twentieth():
    t = np.linspace(1.0, 3.0, 201)
    assert tail_mean(t, np.where(t < 2.895, 100.0, t)) == pytest.approx(2.95)
    assert settling_time(t, np.where(t < 2.0, 0.0, 1.0), 1.0, 0.5) == pytest.approx(1.995, abs=6e-3)


def test_errors_of_the_amplifiers_are_known_of_usual_gains():
    for keys, expected in (
        ([], 6.5e-5), (["control.current_limit=1"], 6.5e-5), (["control.current_limit=1.01"], None),
        (["control.current_limit=0.09"], None), (["control.rolloff=1 us"], None),
        (["control.form=ideal"], 0.0),
    ):  # fmt: skip
        part, kind, build = part_of("kick_and_catch", "control", *keys)
        (row,) = kind.errors(part, build.scene)
        assert (row.expected, row.share) == (expected, None)
        form = "ideal" if keys == ["control.form=ideal"] else "op-amp"
        assert kind.modelled(part, build.scene).detail.startswith(f"{form} PID, output clamped at")


# --- port loads -----------------------------------------------------------------------------------


def test_a_sweep_of_loads_begins_above_rest():
    load_scene("harmonic", ["harmonic.start=499 kHz"])
    with pytest.raises(UsageError, match="empty frequency range"):
        load_scene("harmonic", ["harmonic.start=500 kHz"])
    with pytest.raises(UsageError, match="which body it loads"):
        load_scene({"name": "two", "harmonic": {}, "kick": {}, "other": {"part": "piezo_stack"}})
    two = {"name": "two", "harmonic": {"of": "kick", "start": 1e5}, "kick": {},
           "other": {"part": "piezo_stack"}}  # fmt: skip
    part, kind, build = part_of(two, "harmonic")
    scene = build.scene
    assert (scene.analysis.start, scene.analysis.points) == (pytest.approx(1.02e5), 200)
    assert kind.wants(part, scene)[:2] == ("kick.ring0", "kick.ring1")
    assert kind.modelled(part, scene).detail == "200 frequencies, 100000 … 500000 Hz"


@pytest.mark.parametrize(
    ("keys", "rom"), [([], 1e-4), (["rom.tolerance=1e-6"], 1e-6), (["rom.tolerance=0.1"], 1e-4)]
)
def test_the_gate_of_a_response_is_what_was_asked_of_the_reduction(keys, rom):
    part, kind, build = part_of("harmonic", "harmonic", *keys)
    whole, low = kind.gates(part, build)
    asked = {"rom_vs_fom": rom, "ngspice_vs_rom": 5e-9, "ngspice_vs_fom": rom}
    if keys or build.scene.rom.tolerance is None:
        assert whole.limits == asked
    assert (low.limits, low.share, whole.share) == ({"rom_vs_fom": 5e-9}, 0.2, 1.0)
    assert whole.leads


@pytest.mark.parametrize(("electrical", "meter", "unit"), [("open", "anode", "V"),
                                                         ("short", "charge", "C")])  # fmt: skip
def test_responses_are_displacements_and_the_anodes_charge_or_voltage(electrical, meter, unit):
    part, kind, build = part_of("harmonic", "harmonic", f"kick.electrical={electrical}")
    found = kind.vectors(part, build)
    told = found["ring0>anode"], found["anode>ring1"]
    assert [(v.expression, v.factor, v.unit) for v in told] == [
        (f"v({meter}_ring0)", 1.0, unit), ("v(ring1_anode)", 1e-6, "m"),
    ]  # fmt: skip


# --- circuits of the user -------------------------------------------------------------------------


def test_files_and_functions_of_controllers_are_their_own():
    scene = {"name": "c", "brain": {"part": "controller", "inputs": ["x"], "file": "a.py",
                                    "pins": {"x": "box.a", "out": "load.a"}},
             "box": {"part": "mass", "mass": 1.0}, "load": {"part": "resistor", "resistance": 1.0},
             "hold": {"part": "spring", "stiffness": 1.0, "pins": {"a": "box.a"}}}  # fmt: skip
    part, kind, build = part_of(scene, "brain")
    assert kind.files(part, build.scene) == ("a.py",)
    scene["brain"].pop("file")
    part, kind, build = part_of(scene, "brain", "brain.delay=9.9 us")
    assert kind.files(part, build.scene) == ()
    called = Build(build.scene, {}, functions={"brain": lambda t, x: 2 * t + x["x"]})
    sampled = kind.sampled(part, called)
    assert (sampled.period, sampled.delay) == (1e-5, 9.9e-6)
    assert sampled.call(3.0, {build.net(part, "x"): 5e5}) == pytest.approx(6.5)
    with pytest.raises(UsageError, match="after the next sample"):
        load_scene(scene, ["brain.delay=10 us"])
    with pytest.raises(UsageError, match="no function"):
        kind.sampled(part, build)


MINE = ".subckt mine a out x base\nR1 a out 1\nR2 x base 1\nR3 out base 1\n.ends\n"


def test_pins_of_a_netlist_have_the_kinds_and_ratings_that_are_told(tmp_path):
    (tmp_path / "mine.lib").write_text(MINE)

    def load(**keys):
        text = "[mine]\npart='netlist'\nfile='mine.lib'\nsubckt='mine'\n"
        text += "pins={a='load.a', out='load.b', x='box.a'}\n"
        text += "".join(f"{k} = {v}\n" for k, v in keys.items())
        text += "[load]\npart='resistor'\nresistance=5\n[box]\npart='mass'\nmass=1.0\n"
        (tmp_path / "s.toml").write_text(text)
        scene = load_scene(tmp_path / "s.toml")
        return scene.parts["mine"], scene

    part, scene = load(units="{x='um/N'}", ratings="{out={low=-1, high=2, slew=4}}")
    pins = {p.name: (p.unit, p.flow, p.default, p.required) for p in part.type.pins(part, scene)}
    assert pins == {"a": ("V", "A", None, True), "out": ("V", "A", None, True),
                    "x": ("um", "N", None, True), "base": ("V", "A", "gnd", False)}  # fmt: skip
    waves = wave(time=[0.0, 1.0, 2.0], mine__out=[-1.5, 2.0, 7.0])
    rails, slew = part.type.checks(part, Build(scene, {}), waves)
    assert (rails.value, rails.limit) == (5.0, pytest.approx(7e-3))
    assert slew.value == pytest.approx(1.0)  # 5 V in a second
    assert not list(part.type.checks(part, Build(scene, {}), wave(mine__out=[1.0])))
    assert not list(part.type.checks(part, Build(scene, {}), wave(time=[1.0])))
    part, scene = load(units="{x='um/N'}", ratings="{out={slew=4}}")
    rails, _ = part.type.checks(part, Build(scene, {}), waves)
    assert rails.value == 0.0  # no rail is known
    for wrong in ("{x='um'}", "{y='um/N'}"):
        with pytest.raises(UsageError, match="not a kind of a pin"):
            load(units=wrong)


def test_a_netlists_subcircuit_is_found_with_its_pins_alone(tmp_path):
    """Without regard to case; what follows the pins are parameters. Pins are names of nodes."""
    scene = tmp_path / "s.toml"
    scene.write_text(
        "[mine]\npart='netlist'\nfile='mine.lib'\nsubckt='Mine'\nratings={out={high=1}}\n"
        "pins={a='load.a', out='load.b'}\n[load]\npart='resistor'\nresistance=5\n"
    )
    rest = "\nR1 a out 1\nR2 out ref 1\n.ends mine\n"
    other = ".subckt other p q\nR1 p q 1\n.ends other\n"
    for head in (".subckt mine a out ref", ".SUBCKT MINE a out ref k=1",
                 ".subckt mine a out ref PARAMS: k=1 l=2"):  # fmt: skip
        (tmp_path / "mine.lib").write_text(other + head + rest)
        loaded = load_scene(scene)
        part = loaded.parts["mine"]
        pins = part.type.pins(part, loaded)
        assert [(p.name, p.default) for p in pins] == [("a", None), ("out", None), ("ref", "gnd")]
        assert set(part.type.vectors(part, Build(loaded, {}))) == {"mine.out"}
        assert (part.type.library(part, loaded), part.type.files(part, loaded)) == (
            "Mine", ("mine.lib",),
        )  # fmt: skip
    ac = load_scene(scene, ["analysis.type=ac", "analysis.start=1", "analysis.stop=2"])
    assert ac.parts["mine"].type.vectors(ac.parts["mine"], Build(ac, {})) == {}
    wrong = {"no such subcircuit": other, "not a netlist name": f".subckt mine a out 2nd{rest}"}
    for said, text in wrong.items():
        (tmp_path / "mine.lib").write_text(text)
        with pytest.raises(UsageError, match=said) as raised:
            load_scene(scene)
        assert raised.value.where.endswith("mine.subckt")


# --- drivers --------------------------------------------------------------------------------------


def test_a_driver_says_what_it_is_and_measures_its_first_terminal():
    part, kind, build = part_of("amplifier_kick", "kick_driver")
    through = kind.current(part, "out", build)
    assert (through.expression, through.factor) == ("@r.xkick_driver.rout[i]", 1.0)
    assert kind.current(part, "command", build) is None
    assert "slew 1e+08" in kind.modelled(part, build.scene).detail
    assert kind.checks(part, build, wave(time=[0.0])) == ()
    assert set(kind.vectors(part, build)) == {
        "kick_driver.command", "kick_driver.out", "kick_driver.i"
    }  # fmt: skip
    ac = load_scene({"name": "ac", "amp": {"part": "amplifier", "pins": {"out": "load.a"}},
                     "load": {"part": "resistor", "resistance": 1.0},
                     "analysis": {"type": "ac", "start": 1.0, "stop": 10.0}})  # fmt: skip
    assert ac.parts["amp"].type.vectors(ac.parts["amp"], Build(ac, {})) == {}


@pytest.mark.parametrize("kind", ["user", "netlist"])
def test_a_driver_of_the_user_is_in_the_file_that_it_names_or_the_first_included(kind, tmp_path):
    body = "R1 {0} ref 1\nR2 {1} ref 1\nR3 command ref 1\n.ends mine\n"
    chip = ".subckt mine command out ref\n" + body.format("out", "out")
    coils = ".subckt mine command drive ret ref\n" + body.format("drive", "ret")
    for part, text, ends, asks in (
        ("kick", chip, {"out": "kick.anode"}, ""),
        ("catch", coils, {"drive": "catch.up", "ret": "catch.lp"},
         "pins = { command = 'catch_driver.command' }\n"),
    ):  # fmt: skip
        for name in ("one.lib", "two.lib", "own.lib"):
            (tmp_path / name).write_text(text)
        for include, own, file in (
            (["one.lib", "two.lib"], "", "one.lib"), (["two.lib"], "file='own.lib'\n", "own.lib"),
            ([], "file='own.lib'\n", "own.lib"),
        ):  # fmt: skip
            (tmp_path / "s.toml").write_text(
                f"include = {include}\n[kick]\n[contact]\n[sphere]\n[catch]\n[control]\n"
                f"{asks}[{part}.driver.{kind}]\nsubckt='mine'\n{own}"
            )
            driver = load_scene(tmp_path / "s.toml").parts[f"{part}_driver"]
            assert (driver.type.name, driver.keys.file) == ("netlist", file)
            assert driver.pins == ends | {"ref": "gnd"}


@pytest.mark.parametrize(
    ("part", "kind", "name", "ends"),
    [
        ("kick", "charge", "charge_drive", {"anode": "kick.anode", "cathode": "kick.cathode"}),
        ("kick", "amplifier", "amplifier", {"out": "kick.anode"}),
        ("kick", "half_bridge", "half_bridge", {"out": "kick.anode"}),
        ("catch", "linear", "linear_drive", {"drive": "catch.up", "ret": "catch.lp"}),
        ("catch", "pwm", "pwm_drive", {"drive": "catch.up", "ret": "catch.lp"}),
        ("catch", "linear_drive", "linear_drive", {"drive": "catch.up", "ret": "catch.lp"}),
    ],
)  # fmt: skip
def test_a_driver_is_joined_to_what_it_drives(part, kind, name, ends):
    loaded = load_scene({**CAUGHT, part: {"driver": {kind: {}}}})
    driver = loaded.parts[f"{part}_driver"]
    assert (driver.type.name, driver.pins) == (name, ends)
    if part == "catch":
        assert driver.type.links(driver, loaded) == {"command": "control.command"}
    for other in ({}, {kind: {}, "second": {}}, {"tube": {}}):
        with pytest.raises(UsageError, match="driver"):
            load_scene({**CAUGHT, part: {"driver": other}})


def test_voltages_of_a_driver_are_those_over_its_reference():
    """Which may float; a pin on it has none."""
    scene = {"name": "d", "cell": {"part": "source", "dc": 1.0, "pins": {"out": "amp.command"}},
             "amp": {"part": "amplifier", "pins": {"out": "load.a"}},
             "load": {"part": "resistor", "resistance": 1.0},
             "hold": {"part": "resistor", "resistance": 1.0}}  # fmt: skip
    for pins, told in (
        ({"out": "load.a"}, {"command": "v(command)", "out": "v(out)"}),
        ({"out": "load.a", "ref": "hold.a"},
         {"command": "v(command)-v(ref)", "out": "v(out)-v(ref)"}),
        ({"out": "gnd", "ref": "hold.a"}, {"command": "v(command)-v(ref)", "out": "-v(ref)"}),
        ({"out": "hold.a", "ref": "hold.a"}, {"command": "v(command)-v(ref)"}),
        ({"out": "gnd"}, {"command": "v(command)"}),
    ):  # fmt: skip
        free = {"load": {**scene["load"], "pins": {"a": "amp.command"}}}
        tables = scene | ({} if "load.a" in pins.values() else free)
        if "hold.a" not in pins.values():
            tables = {name: table for name, table in tables.items() if name != "hold"}
        part, kind, build = part_of(tables | {"amp": {"part": "amplifier", "pins": pins}}, "amp")
        found = {n.removeprefix("amp."): v for n, v in kind.vectors(part, build).items()}
        assert found.pop("i").unit == "A"
        nets = {build.net(part, pin): pin for pin in ("command", "out", "ref")}
        texts = {n: re.sub(r"v\((\w+)\)", lambda m, nets=nets: f"v({nets[m[1]]})", v.expression)
                 for n, v in found.items()}  # fmt: skip
        assert texts == told


def test_drivers_tell_the_current_of_their_first_terminal_alone():
    scene = {"name": "d", "kick": {"driver": {"charge": {}}}}
    part, kind, build = part_of(scene, "kick_driver")
    assert kind.current(part, "anode", build).expression == "@r.xkick_driver.rout[i]"
    for pin in ("cathode", "command", "ref"):
        assert kind.current(part, pin, build) is None
    part, kind, build = part_of("amplifier_kick", "kick_driver")
    for pin in ("command", "ref"):
        assert kind.current(part, pin, build) is None
    for scene, name in (("coil_rails", "catch_driver"), ("pwm_coil", "catch_driver")):
        part, kind, build = part_of(scene, name)
        assert [kind.current(part, pin, build) for pin in ("drive", "ret")] == [None, None]


def test_sweeps_move_what_their_key_names():
    """No other key of a part is a source's value."""
    for scene, name, key, card, factor in (
        ("imprint", "imprint", "depth", "Vimprint", -1e6),
        ("em_force", "em_force", "height", "Vheight", 1e6),
        (CELL, "cell", "dc", "Vcell", 1.0),
    ):  # fmt: skip
        part, kind, build = part_of(scene, name)
        assert kind.dc(part, key, build) == (card, factor)
        for other in ("ac", "currents", "of", "steps", "zero"):
            assert kind.dc(part, other, build) is None


def test_a_coil_driver_is_made_for_coils_at_the_set_point():
    from kc2spice.fem.magnetics.table import EMTable

    y = np.linspace(-2.5e-3, 7.5e-3, 5)
    own = 4.0 + 100 * (y - 2.5e-3)
    L = np.stack([np.stack([own, 0 * y + 1], -1), np.stack([0 * y + 1, 0 * y + 3], -1)], -1)
    table = EMTable(y, 0 * y, 0 * y, 0 * y, 50 + 0 * y, 0 * y, 0 * y, np.zeros((5, 2)), L,
                    np.array([5.0, 7.0]), 0)  # fmt: skip
    part, kind, build = part_of("coil_rails", "catch_driver", models={"catch": table})
    load = kind.load(part, build)
    assert (load.inductance, load.resistance) == (pytest.approx(4 + 3 - 2 * 1), 12.0)
    assert kind.current(part, "drive", build) is None
    hand = {"name": "hand", "sphere": {}, "catch": {"pins": {"y": "gnd"}},
            "amp": {"part": "linear_drive", "pins": {"drive": "catch.up", "ret": "catch.lp"}},
            "cell": {"part": "source", "dc": 1.0, "pins": {"out": "amp.command"}}}  # fmt: skip
    part, kind, build = part_of(hand, "amp", models={"catch": table})
    assert kind.load(part, build).inductance == pytest.approx(3.75 + 3 - 2 * 1)  # at height 0
    alone = load_scene({"name": "alone", "amp": {"part": "linear_drive",
                                                 "pins": {"drive": "load.a", "ret": "load.b"}},
                        "load": {"part": "resistor", "resistance": 1.0}})  # fmt: skip
    with pytest.raises(UsageError, match="drives no coils"):
        kind.load(alone.parts["amp"], Build(alone, {}))
