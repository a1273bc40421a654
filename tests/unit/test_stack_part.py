"""The layered chip as a part: what its keys make of a scene, on numbers and waves made by hand."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from kc2spice.bodies import pressure
from kc2spice.core.errors import UsageError
from kc2spice.core.progress import Clock
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.materials import material
from kc2spice.fem.piezo.keys import Chip
from kc2spice.parts import _mesh_study, piezo_stack
from kc2spice.parts._meshed import Recovered
from kc2spice.parts.piezo_stack import (
    Drive,
    chip_of,
    free_stroke,
    highest_voltage,
    mounted,
    pressure_hats,
    top_material,
)
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.spice.realize import COARSE, FOLLOWED, STRIKING

LOOP = {"name": "loop", "kick": {}, "contact": {}, "sphere": {}}
IMPACT = {"name": "hit", "kick": {"electrical": "open"}, "contact": {}, "sphere": {"velocity": -1}}
ALONE = {"name": "alone", "kick": {}}
SOUND = math.sqrt(144.2e9 / 7700)
STROKE = 2.3508e-6  # m at 100 V, of the FE chip


def kick_of(*keys, scene=None):
    found = load_scene(scene or LOOP, list(keys))
    part = found.parts["kick"]
    return part, found, part.type


# --- speed, steps and doubts ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "speed"),
    [
        ([], STROKE / (8e-3 / SOUND)),
        (["kick.drive.edge=10 us"], STROKE / 10e-6),
        (["kick.drive.voltage=-50"], 0.1 * 0.5 * STROKE / (8e-3 / SOUND)),
        (["kick.drive.voltage=1 mV"], 1e-3),
    ],
)
def test_a_kick_is_as_fast_as_its_stroke_in_a_quarter_wave_or_an_edge(keys, speed):
    part, scene, kind = kick_of(*keys)
    assert kind.speed(part, scene) == pytest.approx(speed, rel=2e-4)


def test_nothing_is_thrown_without_a_drive_or_a_contact():
    for scene in (IMPACT, ALONE):
        part, found, kind = kick_of(scene=scene)
        assert kind.speed(part, found) is None


@pytest.mark.parametrize(
    ("scene", "keys", "share"),
    [
        (ALONE, ["kick.damping.ratio=1e-4"], 1.0),  # nothing touches it
        (IMPACT, [], 1.0),
        (IMPACT, ["kick.damping.ratio=1e-3"], 0.5),  # sqrt(1e-3 / 4e-3)
        (IMPACT, ["kick.damping.ratio=1e-5"], math.sqrt(0.05)),  # no less than of 2e-4
        (LOOP, ["kick.damping.ratio=1e-3"], 0.5),
        (LOOP, ["solver.ringing=coarse"], 1.0),  # 1.27 m/s
        (LOOP, ["kick.drive.voltage=60"], 1.0),
        (IMPACT, ["solver.ringing=coarse"], 1.0),
        (LOOP, ["solver.ringing=coarse", "kick.drive.voltage=60"], 0.0),
        (LOOP, ["solver.ringing=coarse", "kick.drive.voltage=40"], 0.03),
        ("amplifier_kick", ["solver.ringing=coarse"], 0.03),  # any kick may be a slow one
        (LOOP, ["kick.drive.voltage=-100"], 2e-3),
        (LOOP, ["kick.drive.voltage=0"], 1.0),
        (LOOP, ["kick.drive.voltage=-100", "solver.ringing=coarse"], 2e-3),
    ],
)
def test_what_rings_or_kicks_low_asks_for_smaller_steps(scene, keys, share):
    part, found, kind = kick_of(*keys, scene=scene)
    if not share:
        share = (0.6 * STROKE / (8e-3 / SOUND)) ** 8
        assert 0.05 < share < 0.5
    assert kind.closeness(part, found) == pytest.approx(share, rel=2e-3)


def test_steps_follow_what_strikes():
    for keys, watch, coarse in (
        ([], FOLLOWED, False), (["solver.ringing=coarse"], COARSE, True),
        (["kick.drive.voltage=-80", "solver.ringing=coarse"], STRIKING, False),
    ):  # fmt: skip
        part, scene, kind = kick_of(*keys)
        assert (kind.watch(part, scene), kind.coarse(part, scene)) == (watch, coarse)


@pytest.mark.parametrize("electrical", ["open", "short"])
def test_what_is_not_driven_does_not_strike(electrical):
    """Whatever its drive is."""
    drive = {"drive": {"voltage": -100.0}, "electrical": electrical}
    part, scene, kind = kick_of(scene={**IMPACT, "kick": drive})
    assert kind.watch(part, scene) == FOLLOWED
    assert kind.closeness(part, scene) == 1.0
    assert not list(kind.doubts(part, scene))
    assert not list(kind.reach(part, scene))
    assert highest_voltage(part, scene) == 0.0
    late = {"drive": {"start": 1.0}, "electrical": electrical}
    load_scene({**IMPACT, "kick": late})  # a pulse that nobody gives may begin at any time


def test_the_outline_is_that_of_the_stack_below_its_top():
    part, scene, kind = kick_of("kick.side=4 mm", "kick.height=3 mm", "kick.layers=50")
    (shape,) = kind.outline(part, scene)
    assert (shape.x, shape.y, shape.width, shape.height, shape.layers) == (
        0.0, -1.5e-3, 4e-3, 3e-3, 50,
    )  # fmt: skip
    assert shape.label == "kick: 4 mm wide, 3 mm high, 50 layers"
    assert shape.kind == "ceramic"


def test_a_kick_that_rings_is_doubtful_and_an_impact_is_not():
    for keys, scene, said in (
        ([], LOOP, []), (["kick.damping.ratio=4e-3"], LOOP, []),
        (["kick.damping.ratio=3.9e-3"], LOOP, ["less than 0.4%"]),
        (["kick.drive.voltage=-100"], LOOP, ["draws back first"]),
        (["kick.damping.ratio=1e-3"], IMPACT, []), (["kick.damping.ratio=1e-3"], ALONE, []),
    ):  # fmt: skip
        part, found, kind = kick_of(*keys, scene=scene)
        doubts = list(kind.doubts(part, found))
        assert len(doubts) == len(said)
        assert all(word in doubt for word, doubt in zip(said, doubts, strict=True))


# --- voltages and strokes -------------------------------------------------------------------------


def test_the_highest_voltage_is_that_of_drives_sources_or_rails():
    for scene, volts in ((ALONE, 100.0), (IMPACT, 0.0), ("amplifier_kick", 100.0)):
        part, found, _ = kick_of(scene=scene)
        assert highest_voltage(part, found) == volts
    part, found, _ = kick_of(scene={
        "name": "fed", "kick": {"drive": {"voltage": 7.0}, "electrical": "open"},
        "supply": {"part": "source", "pulse": {"high": -30.0, "low": 5.0, "width": 1e-5,
                                               "edge": 1e-6}, "pins": {"out": "kick.anode"}},
        "load": {"part": "source", "kind": "force", "dc": 500.0, "pins": {"out": "kick.ring0"}},
    })  # fmt: skip
    assert highest_voltage(part, found) == 30.0


def test_the_reach_of_a_kick_is_twice_its_free_stroke():
    part, scene, kind = kick_of("kick.drive.voltage=50")
    (reach,) = kind.reach(part, scene)
    assert reach.depth == pytest.approx(STROKE, rel=2e-4)
    assert reach.why == "2 times the free stroke of kick at 50 V"
    part, scene, kind = kick_of(scene=IMPACT)
    assert not list(kind.reach(part, scene))


def test_a_stack_that_shears_moves_by_d15():
    """``d15 = e15 / C44`` in every layer."""
    shear = Chip(poling="x", mounting="glued")
    assert free_stroke(shear, -10.0) == pytest.approx(33 * 10 * 13.38 / 14.08e9, rel=1e-12)


def test_rated_voltage_and_headline_follow_the_layers():
    part, _, kind = kick_of("kick.layers=10", "kick.height=1 mm", "kick.mounting=glued")
    assert kind.rated(part) == pytest.approx(2e6 * 1e-4)
    assert kind.headline(part).endswith("; bottom face glued down, u = 0")


def test_what_holds_and_covers_the_stack_is_told():
    keys = {"mounting": 1e12, "poling": "x", "preload_spring": 5e6,
            "bottom_cap": {"thickness": 1e-3, "material": "steel"},
            "top_cap": {"thickness": 0.5e-3}}  # fmt: skip
    assert mounted(Chip(**keys)) == (
        "bottom face on springs of 1e+12 N/m per m2 along each axis, poled along x: it shears, "
        "1 mm of steel below, 0.5 mm of unpoled ceramic on top, "
        "a spring of 5e+06 N/m on the top face"
    )
    assert mounted(Chip()) == "frictionless roller under its bottom face"
    assert mounted(Chip(mounting="free")) == "nothing holds its bottom face"


def test_what_presses_on_the_top_meets_the_cap():
    bare = top_material(Chip())
    assert bare.density == 7700.0
    np.testing.assert_array_equal(bare.C, Chip().material.tensors()[0])
    capped = Chip(top_cap={"thickness": 1e-3, "material": "steel"})
    assert top_material(capped).indentation_modulus == material("steel").indentation_modulus
    unpoled = Chip(top_cap={"thickness": 1e-3})
    assert top_material(unpoled).name == bare.name
    part, _, kind = kick_of()
    assert kind.indentation_modulus(part) == bare.indentation_modulus


# --- parts that come along ------------------------------------------------------------------------


def test_a_drive_stands_where_the_anode_is_driven():
    for scene, keys, driven in (
        (ALONE, [], True), ({"name": "h", "kick": {}, "harmonic": {}}, [], False),
        (IMPACT, [], False), ({"name": "s", "kick": {"electrical": "short"}}, [], None),
    ):  # fmt: skip
        _, found, _ = kick_of(*keys, scene=scene)
        source = found.parts.get("kick_drive")
        assert (source is not None) == (driven is not False)
        if driven is None:
            assert (source.keys.dc, source.keys.pulse) == (0.0, None)
        elif driven:
            pulse = source.keys.pulse
            assert (pulse.high, pulse.width, pulse.edge, pulse.start) == (100.0, 25e-6, 1e-7, 5e-4)
    undriven = {"name": "u", "kick": {"electrical": "open", "drive": {"voltage": 5.0}}}
    assert "kick_drive" not in load_scene(undriven).parts


@pytest.mark.parametrize(
    ("kind", "type_", "pins"),
    [("half_bridge", "half_bridge", {"out"}), ("amplifier", "amplifier", {"out"}),
     ("charge", "charge_drive", {"anode", "cathode"})],
)  # fmt: skip
def test_a_driver_stands_between_pulse_and_chip(kind, type_, pins):
    found = load_scene({"name": "d", "kick": {"driver": {kind: {}}}})
    driver = found.parts["kick_driver"]
    assert driver.type.name == type_
    assert set(driver.pins) == pins
    assert found.parts["kick_drive"].pins == {"out": "kick_driver.command"}


@pytest.mark.parametrize(
    ("given", "said"),
    [({"tube": {}}, "half_bridge"), ({"amplifier": {}, "charge": {}}, "amplifier, charge")],
)
def test_a_chip_has_one_driver_of_those_known(given, said):
    with pytest.raises(UsageError, match="driver") as raised:
        load_scene({"name": "d", "kick": {"driver": given}})
    assert said in str(raised.value)


def test_the_pulse_of_a_drive_is_as_wide_at_half_its_height():
    wave = Drive(voltage=80.0, width=20e-6, edge=2e-6, start=1e-6).waveform
    t = np.array([0.5e-6, 1e-6, 2e-6, 3e-6, 10e-6, 21e-6, 22e-6, 23e-6, 30e-6])
    np.testing.assert_allclose(wave(t), [0, 0, 40, 80, 80, 80, 40, 0, 0], atol=1e-9)


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scene", "fits", "refused", "word"),
    [
        (ALONE, ["kick.mesh.ring_spacing=1.49 mm", "kick.mesh.rings=1"],
         ["kick.mesh.ring_spacing=1.5 mm", "kick.mesh.rings=1"],
         "beyond the chip"),
        (LOOP, ["kick.drive.edge=25 us"], ["kick.drive.edge=25.1 us"], "longer than the pulse"),
        (LOOP, ["kick.drive.start=4.99 ms"], ["kick.drive.start=5 ms"], "after the simulation"),
        (IMPACT, ["kick.drive.start=6 ms"], ["kick.mounting=free"], "nothing holds the chip"),
        (ALONE, ["kick.mounting=free"], ["kick.electrical=open", "kick.driver.amplifier={}"],
         "not driven"),
        (ALONE, ["kick.side=0.1", "kick.height=0.1"], ["kick.side=0.101", "kick.height=0.1"],
         "sintered"),
        (ALONE, ["kick.height=0.16 m"], ["kick.height=0.2001 m", "kick.layers=100"], "sintered"),
        (ALONE, ["kick.height=9.9 mm", "kick.layers=2", "kick.drive.voltage=10"],
         ["kick.height=10.1 mm", "kick.layers=2", "kick.drive.voltage=10"], "ceramic tape"),
        (ALONE, ["kick.drive.voltage=-1.2 kV"], ["kick.drive.voltage=1.22 kV"], "breaks down"),
        (ALONE, ["kick.drive.voltage=5 kV", "kick.driver.amplifier={}"],
         ["kick.drive.voltage=5 kV"], "breaks down"),
        (LOOP, ["kick.material.stiffness=[2e11, 1.99e11, 1e9, 2e11, 2e10, 2e10]"],
         ["kick.material.stiffness=[2e11, 2e11, 1e9, 2e11, 2e10, 2e10]"], "no such material"),
        (LOOP, ["kick.material.stiffness=[2e11, 1e11, 1.72e11, 2e11, 2e10, 2e10]"],
         ["kick.material.stiffness=[2e11, 1e11, 1.74e11, 2e11, 2e10, 2e10]"], "no such material"),
        (LOOP, ["kick.material.stiffness=[2e11, -1.9e11, 1e9, 2e11, 2e10, 2e10]"],
         ["kick.material.stiffness=[2e11, -2.1e11, 1e9, 2e11, 2e10, 2e10]"], "no such material"),
    ],
)  # fmt: skip
def test_where_a_stack_begins_to_be_refused(scene, fits, refused, word):
    load_scene(scene, fits)
    with pytest.raises(UsageError, match=word):
        load_scene(scene, refused)


def test_how_small_and_how_strong_a_stack_may_be():
    """0.1 mm wide, 10 um high, layers of 1 um, 20 V/um."""
    narrow = ["kick.mesh.ring_spacing=10 um", "kick.mesh.rings=1", "kick.drive.voltage=1"]
    flat = ["kick.layers=2", "kick.drive.voltage=1"]
    exact = ["kick.layers=32", "kick.height=2 mm"]  # 62.5 um a layer
    for keys, fits, refused, word in (
        (narrow, "kick.side=0.1 mm", "kick.side=0.0999 mm", "kick.side"),
        (narrow, "kick.diameter=0.1 mm", "kick.diameter=0.0999 mm", "kick.diameter"),
        (flat, "kick.height=10 um", "kick.height=9.99 um", "kick.height"),
        (["kick.drive.voltage=1"], "kick.height=33.1 um", "kick.height=32.9 um", "kick.layers"),
        (exact, "kick.drive.voltage=1250", "kick.drive.voltage=1250.00003", "breaks down"),
    ):  # fmt: skip
        load_scene(ALONE, [*keys, fits])
        with pytest.raises(UsageError, match="hardly exists") as raised:
            load_scene(ALONE, [*keys, refused])
        assert word in str(raised.value)


def test_nothing_presses_on_a_stack_that_shears():
    with pytest.raises(UsageError, match="moves sideways"):
        load_scene(LOOP, ["kick.poling=x", "kick.mounting=glued"])
    load_scene(ALONE, ["kick.poling=x", "kick.mounting=glued"])


# --- ports and meshes -----------------------------------------------------------------------------


def test_ports_under_a_pressure_are_one_patch():
    part, scene, kind = kick_of("contact.shape=pressure", "contact.spacing=20 um")
    assert [p.name for p in kind.ports(part, scene)] == ["patch", "anode"]
    surface = kind.surface(part, scene)
    assert (surface.ports, surface.patch, surface.sectors) == (("patch",), 250e-6, 4)
    nodes = pressure_hats(part, scene).nodes
    assert (nodes[1], nodes[-1]) == (20e-6, 250e-6)
    finer = pressure_hats(part, scene, 4.0).nodes
    assert (finer[1], finer[-1]) == (5e-6, 250e-6)
    assert kind.full_key(part, scene)["hats"] == nodes.tolist()
    part, scene, kind = kick_of()
    assert pressure_hats(part, scene) is None
    assert "hats" not in kind.full_key(part, scene)
    surface = kind.surface(part, scene, ("ring3", "ring1"))
    assert surface.distance == pytest.approx((150e-6, 50e-6))


def test_only_keys_of_the_body_are_part_of_its_model():
    a, b = (kick_of(*keys)[0] for keys in ([], ["kick.drive.voltage=40", "kick.rated_field=1e6"]))
    assert chip_of(a.keys) == chip_of(b.keys)
    other, _, _ = kick_of("kick.layers=32")
    assert chip_of(a.keys) != chip_of(other.keys)


def test_the_full_model_is_that_of_the_refined_mesh(monkeypatch):
    asked = []
    monkeypatch.setattr(piezo_stack, "_mesh", lambda chip: asked.append(chip.mesh.refine))
    monkeypatch.setattr(piezo_stack, "_assembled", lambda chip: asked.append(chip.mesh.refine))
    monkeypatch.setattr(piezo_stack, "_device", lambda chip: chip.mesh.refine)
    part, scene, kind = kick_of("kick.mesh.refine=3")
    assert kind.full(part, scene, Clock()) == 3
    assert kind.full(part, scene, Clock(), 2) == 6
    assert asked == [3, 3, 6, 6]


def test_fields_are_those_of_the_sector_on_a_patch_where_a_pressure_acts(monkeypatch):
    from kc2spice.bodies import piezo_stack as body

    monkeypatch.setattr(body, "sector_device", lambda *told: told)
    monkeypatch.setattr(piezo_stack, "_assembled", lambda chip: "rings")
    monkeypatch.setattr(piezo_stack, "_on_patch", lambda chip, shape: shape.nodes[1])
    for keys, system in (
        ([], "rings"),
        (["contact.shape=pressure", "contact.spacing=20 um"], 20e-6),
    ):
        part, scene, kind = kick_of("kick.rated_field=1e6", *keys)
        assert kind.device(part, scene) == (chip_of(part.keys), system, 1e6)


def test_a_stack_is_modelled_as_told():
    part, scene, kind = kick_of("rom.order=12", "contact.rings=3")
    told = kind.modelled(part, scene).detail
    assert told.startswith("quarter chip, 33 layers, frictionless roller")
    assert told.endswith("reduced to order 12, band 0 … 500000 Hz, anode driven, 3 rings as ports")
    part, scene, kind = kick_of("contact.shape=pressure", "rom.tolerance=1e-4")
    told = kind.modelled(part, scene).detail
    assert "keep the error below 0.0001" in told
    assert told.endswith("a patch of pressure as port")


# --- errors ---------------------------------------------------------------------------------------


def mesh_row(*keys, scene="kick_and_catch"):
    part, found, kind = kick_of(*keys, scene=scene)
    return {row.stage: row for row in kind.errors(part, found)}


@pytest.mark.parametrize(
    ("keys", "known"),
    [
        ([], True), (["kick.drive.voltage=40"], True), (["kick.drive.voltage=105"], True),
        (["kick.drive.voltage=39.9"], False), (["kick.drive.voltage=105.1"], False),
        (["kick.drive.width=10 us"], True), (["kick.drive.width=9.9 us"], False),
        (["kick.drive.edge=0.11 us"], False), (["kick.drive.period=1 ms"], False),
        (["kick.damping.ratio=0.9 %"], False), (["kick.damping.ratio=2 %"], True),
        (["sphere.density=7900"], False), (["contact.rings=4"], True),
        (["contact.gap=1 um"], False),
        (["kick.mesh.refine=2"], False), (["kick.mesh.rings=4"], False),
        (["kick.mesh.ring_spacing=40 um"], False), (["kick.mesh.sectors=8"], False),
        (["kick.mesh.layers_per_element=1"], True),
    ],
)  # fmt: skip
def test_the_error_of_the_mesh_is_known_of_the_papers_kick(keys, known):
    assert mesh_row(*keys)["mesh"].expected == (0.024 if known else None)


@pytest.mark.parametrize(("speed", "known"), [("-1", True), ("-1.0005", True), ("-1.01", False)])
def test_the_error_of_the_mesh_is_known_of_an_impact_at_one_metre_per_second(speed, known):
    keys = ["impact.gap=0", f"impact.velocity={speed}"]
    assert mesh_row(*keys, scene="impact")["mesh"].expected == (0.024 if known else None)
    assert mesh_row(scene="imprint")["mesh"].expected is None


def test_merged_layers_have_an_error_of_their_own():
    """The square of their share: of the number of layers in an element over all of them."""
    rows = mesh_row("kick.mesh.layers_per_element=3")
    assert rows["layers in an element"].expected == pytest.approx((3 / 33) ** 2)
    rows = mesh_row("kick.layers=32", "kick.mesh.layers_per_element=2")
    assert rows["layers in an element"].expected == pytest.approx((2 / 32) ** 2)
    assert "layers in an element" not in mesh_row("kick.mesh.layers_per_element=1")


# --- what a run says ------------------------------------------------------------------------------


def told(scene, keys=(), **waves):
    part, found, kind = kick_of(*keys, scene=scene)
    data = {name.replace("__", "."): np.asarray(v, float) for name, v in waves.items()}
    build = Build(found, {"kick": SimpleNamespace(certificate=None, facts={})})
    return kind.metrics(part, build, Waveforms(data, {}))


def test_a_kick_tells_stroke_voltage_current_and_charge():
    """Currents 0, 2, -4, 0 A at 0, 1, 2, 4 s: charges 1, 0 and -4 C."""
    waves = {"time": [0, 1, 2, 4], "kick__u__ring0": [0, 3e-6, -5e-6, 1e-6],
             "kick__voltage": [0, 50, -70, 10], "kick__current": [0, 2, -4, 0]}  # fmt: skip
    assert told(LOOP, **waves) == {"kick_stroke_m": 3e-6}
    driven = told(LOOP | {"kick": {"driver": {"amplifier": {}}}}, **waves)
    assert driven == {"kick_stroke_m": 3e-6, "kick_voltage_peak_v": 70.0,
                      "kick_current_peak_a": 4.0, "kick_charge_peak_c": 4.0}  # fmt: skip
    alone = told(ALONE, **waves)
    assert set(alone) == {"kick_voltage_peak_v", "kick_current_peak_a", "kick_charge_peak_c"}
    waves.pop("kick__current")
    assert told(ALONE, **waves) == {"kick_voltage_peak_v": 70.0}
    waves.pop("time")
    assert told(LOOP, **waves) == {}


def test_stresses_under_the_hats_are_those_of_the_largest_force():
    """Of Hertz, as well as four hats tell; none where nothing touches."""
    small = ["kick.layers=2", "kick.mesh.sectors=4", "kick.mesh.rings=2", "kick.mesh.outer_rings=2",
             "kick.mesh.ring_spacing=100 um", "contact.shape=pressure", "contact.spacing=20 um",
             "kick.fields=true"]  # fmt: skip
    part, scene, kind = kick_of(*small, scene=IMPACT)
    build = Build(scene, {})
    waves = Waveforms({"contact.force": np.array([0.0, 80.0, 1.0])}, {})
    found = kind._under_pressure(part, build, waves)
    modulus = kind.indentation_modulus(part)
    wide = (3 * 80.0 * 1e-3 / (4 * modulus)) ** (1 / 3)  # Hertz: four hats
    highest = 3 * 80.0 / (2 * np.pi * wide**2)
    assert found["contact_pressure_pa"] == pytest.approx(highest, rel=0.25)
    assert found["contact_shear_pa"] == pytest.approx(0.31 * highest, rel=0.25)
    assert found["contact_shear_depth_m"] == pytest.approx(0.48 * wide, rel=0.5)
    none = Waveforms({"contact.force": np.zeros(3)}, {})
    assert kind._under_pressure(part, build, none) == {}
    part, scene, kind = kick_of(*small[:-1], scene=IMPACT)
    assert kind._under_pressure(part, Build(scene, {}), waves) == {}


def test_the_mesh_study_is_that_of_the_scenes_sphere_and_contact(monkeypatch):
    asked = []
    monkeypatch.setattr(
        _mesh_study, "mesh_table", lambda chip, load, whole, say: asked.append((chip, load, whole))
    )
    hit = {**IMPACT, "sphere": {"velocity": -1, "radius": 2e-3}}
    part, scene, kind = kick_of("contact.penalty=3e8", scene=hit)
    kind.mesh_study(part, Build(scene, {}), Clock(), True)
    part, scene, kind = kick_of("contact.shape=pressure", "contact.spacing=20 um", scene=hit)
    kind.mesh_study(part, Build(scene, {}), Clock(), False)
    mass = 4 / 3 * np.pi * 8e-9 * 7850
    (chip, rings, whole), (_, hats_, little) = asked
    assert chip == chip_of(part.keys)
    assert (rings.radius, rings.mass, rings.stiffness) == (2e-3, pytest.approx(mass), 3e8)
    assert (rings.spacing, rings.depth, whole) == (None, 20e-6, True)
    assert (hats_.spacing, hats_.depth, little) == (20e-6, 10e-6, False)
    part, scene, kind = kick_of("contact.gap=1 um", scene=hit)
    assert kind.mesh_study(part, Build(scene, {}), Clock(), True) is None


def test_the_error_of_the_graded_mesh_is_that_of_halved_cells(monkeypatch):
    """Compliances of 1 + 0.04 / k^2 on cells divided by k: about 0.04 on the coarser."""
    asked = []

    def dents(chip, shape, cells):
        asked.append(cells)
        k = cells / pressure.CELLS
        return (1 + 0.04 / k**2) * 1e-9 * np.eye(shape.nodes.size - 1)

    monkeypatch.setattr(pressure, "dents", dents)
    monkeypatch.setattr(piezo_stack, "cached", lambda _name, _key, make, **_: (make(), 0))
    part, scene, kind = kick_of("contact.shape=pressure", "contact.spacing=20 um")
    found = kind.mesh_error(part, scene)
    assert asked == [pressure.CELLS, 2 * pressure.CELLS]
    assert 0.02 < found.error < 0.06
    part, scene, kind = kick_of()
    assert kind.mesh_error(part, scene) is None  # of rings a mesh study knows it


def test_fields_ask_for_instants_of_the_run():
    load_scene(ALONE, ["kick.fields=[0, 5e-3]"])
    for instants in ("[-1e-6]", "[5.01e-3]"):
        with pytest.raises(UsageError, match="outside the run"):
            load_scene(ALONE, [f"kick.fields={instants}"])
    with pytest.raises(UsageError, match="waveforms over time"):
        load_scene({"name": "h", "kick": {"fields": True}, "harmonic": {}})


def test_the_worst_stress_is_the_nearest_to_its_limit():
    def stress(value, limit, quantity="principal_stress"):
        return SimpleNamespace(quantity=quantity, value=value, limit=limit)

    low, high, none = stress(4.0, 5.0), stress(6.0, 10.0), stress(99.0, None)
    field = stress(1e9, 1.0, "electric_field")
    assert Recovered(None, (high, low, none, field)).worst is low
    assert Recovered(None, (stress(1.0, None), none, field)).worst is none
