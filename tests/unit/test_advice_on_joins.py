"""Joins of pins that do not fit: the advice of each error, followed until the scene runs."""

import copy
import re

import numpy as np
import pytest
from messages import fails
from support import parse_toml

import kc2spice as kc

SPEAKER = """[speaker]
part = "loudspeaker"
fs = "46.4 Hz"
re = "6.23 Ohm"
qms = 6.66
qes = 0.538
mms = "10.28 g"
pins = { plus = "drive.out", frame = "shake.out" }
[drive]
part = "source"
ac = "1 V"
[shake]
part = "source"
kind = "acceleration"
ac = "1 m/s2"
[analysis]
type = "ac"
start = "10 Hz"
stop = "1 kHz"
"""
TABLE = """[m]
part = "mass"
mass = "100 g"
pins = { a = "s.a" }
[s]
part = "spring"
stiffness = "10 kN/m"
pins = { b = "table.out" }
[d]
part = "damper"
damping = "2 N s/m"
pins = { a = "s.a", b = "table.out" }
[table]
part = "source"
kind = "acceleration"
ac = 1e-6
[analysis]
type = "ac"
start = "1 Hz"
stop = "1 kHz"
points = 200
[probes]
peak_m = { of = "m.x", take = "max" }
"""
BALL = """[plate]
part = "bimorph"
length = "50 mm"
width = "20 mm"
layers = [{ material = "steel", thickness = "2 mm" }]
points = { hit = "25 mm" }
damping = { ratio = 0.01 }
pins = { base = "shake.out" }
[contact]
part = "contact"
a = "plate.hit"
penalty = "1e6 N/m"
[ball]
part = "sphere"
radius = "2 mm"
pins = { base = "shake.out" }
[shake]
part = "source"
kind = "acceleration"
sine = { amplitude = "20 m/s2", frequency = "100 Hz" }
[analysis]
type = "transient"
stop = "1 ms"
"""
CIRCUIT = """[m]
part = "mass"
mass = "5 g"
pins = { a = "r.a" }
[r]
part = "resistor"
resistance = "1 kOhm"
[v]
part = "source"
dc = "5 V"
pins = { out = "r.a" }
[analysis]
type = "op"
"""
# pairs ``'key': 'value'`` that a hint writes into a Python dict
ENTRY = re.compile(r"write  '(\w+)': '([^']*)'  in the dict ([\w.]+)")
TARGET = re.compile(r'write  (\w+) = "([^"]*)"')


def follow_entry(scene, hint):
    """Write the entry that a hint proposes into a scene."""
    key, value, path = ENTRY.search(str(hint)).groups()
    table = scene
    for name in path.split("."):
        table = table[name]
    table[key] = value


def test_an_acceleration_at_a_frame_names_the_part_for_moving_frames():
    scene = parse_toml(SPEAKER)
    joined = fails(kc.load_scene, scene)
    displaced = copy.deepcopy(scene)
    displaced["shake"] |= {"kind": "displacement", "ac": 1e-6}
    assert "different kinds" in joined.message
    assert str(joined.hint) == str(fails(kc.load_scene, displaced).hint)
    assert "voice_coil" in str(joined.hint)
    follow_entry(scene, joined.hint)
    alone = fails(kc.load_scene, scene)
    assert alone.where.endswith("shake.pins.out")
    assert "gnd" not in alone.expected
    assert alone.hint.startswith("delete [shake]")
    del scene["shake"]
    peak = kc.run(kc.load_scene(scene)).metrics["largest_impedance_hz"]
    assert peak == pytest.approx(46.4, rel=0.01)


def test_a_source_joined_to_a_frame_names_the_part_for_moving_frames():
    scene = parse_toml(SPEAKER)
    del scene["speaker"]["pins"]["frame"]
    scene["shake"]["pins"] = {"out": "speaker.frame"}
    assert "voice_coil" in fails(kc.load_scene, scene).hint


def test_a_voice_coil_between_two_masses_has_a_moving_frame():
    """The springs carry a slow motion of the support to the frame and to the cone."""
    scene = parse_toml(SPEAKER)
    coil = {"part": "voice_coil", "resistance": 6.2, "inductance": 1e-4, "bl": 5.0, "cms": 1e-3}
    coil["pins"] = {"plus": "drive.out", "a": "cone.a", "b": "basket.a"}
    scene["speaker"] = coil
    scene["cone"] = {"part": "mass", "mass": "10 g"}
    scene["basket"] = {"part": "mass", "mass": "1 kg"}
    scene["mount"] = {"part": "spring", "stiffness": "1 MN/m", "pins": {"a": "basket.a"}}
    scene["mount"]["pins"]["b"] = "shake.out"
    scene["drive"], scene["shake"]["ac"] = {"part": "source", "dc": 0.0}, 1e-6
    scene["probes"] = {"x_m": {"of": "cone.x", "take": "max"}}
    scene["analysis"] = {"type": "ac", "start": "0.01 Hz", "stop": "0.02 Hz"}
    follow_entry(scene, fails(kc.load_scene, scene).hint)
    assert kc.run(kc.load_scene(scene)).metrics["x_m"] == pytest.approx(1e-6, rel=1e-3)


def test_an_acceleration_at_springs_becomes_a_displacement():
    """The mass follows its support by ``|k + j w c| / |k - w^2 m + j w c|``."""
    scene = parse_toml(TABLE)
    error = fails(kc.load_scene, scene)
    assert error.where.endswith("s.pins.b")
    assert "m.a" not in error.expected
    follow_entry(scene, error.hint)
    assert scene["table"]["kind"] == "displacement"
    w = 2 * np.pi * np.geomspace(1, 1e3, 100_001)
    support = 1e4 + 2j * w
    exact = 1e-6 * np.abs(support / (support - w**2 * 0.1)).max()
    result = kc.run(kc.load_scene(scene))
    assert result.metrics["peak_m"] == pytest.approx(exact, rel=0.02)


def test_a_source_that_accelerates_a_body_keeps_its_kind():
    plate = parse_toml(BALL)["plate"]
    scene = parse_toml(TABLE) | {"plate": plate | {"pins": {"base": "table.out"}}}
    hint = fails(kc.load_scene, scene).hint
    assert "another source of kind displacement" in hint
    scene["other"] = {"part": "source", "kind": "displacement", "ac": 1e-6}
    scene["s"]["pins"]["b"] = scene["d"]["pins"]["b"] = "other.out"
    assert kc.load_scene(scene).nets["s", "b"] == kc.load_scene(scene).nets["d", "b"]


def test_the_net_of_the_other_pin_is_never_proposed():
    """The source of volts cannot move the spring, whose other pin is on the net of the mass."""
    scene = parse_toml(TABLE)
    scene["table"]["kind"] = "voltage"
    for name in ("s", "d"):
        error = fails(kc.load_scene, scene)
        assert error.where.endswith(f"{name}.pins.b")
        assert "m.a" not in error.expected
        key, target = TARGET.search(str(error.hint)).groups()
        assert (key, target) == ("b", "gnd")
        scene[name]["pins"][key] = target


def test_a_sphere_in_an_accelerated_frame_becomes_a_mass():
    scene = parse_toml(BALL)
    error = fails(kc.load_scene, scene)
    assert "has no input for the acceleration" in error.message
    assert error.where.endswith("ball.pins.base")
    assert 'part = "mass" with the key `mass`' in error.hint
    scene["ball"] = {"part": "mass", "mass": "0.26 g", "pins": {"base": "shake.out"}}
    key, target = TARGET.search(str(fails(kc.load_scene, scene).hint)).groups()
    assert (key, target) == ("b", "ball")
    scene["contact"][key] = target
    follow_entry(scene, fails(kc.load_scene, scene).hint)
    assert scene["ball"]["pins"] == {"base": "gnd"}
    kc.run(kc.load_scene(scene))


@pytest.mark.parametrize("target", ["r.a", "gnd"])
def test_a_mass_without_a_partner_gets_a_spring(target):
    scene = parse_toml(CIRCUIT)
    scene["m"]["pins"]["a"] = target
    error = fails(kc.load_scene, scene)
    assert "gnd" not in error.expected
    text, _, table = error.hint.partition("  and add ")
    key, pin = TARGET.search(text).groups()
    scene["m"]["pins"][key] = pin
    name, keys = re.fullmatch(r"\[(\w+)\] with (.*)", table).groups()
    scene[name] = parse_toml(keys.replace(", ", "\n"))
    # the spring carries the weight: x = m g / k
    scene["m"]["weight"] = True
    scene["probes"] = {"x_m": {"of": "m.x", "take": "final"}}
    x = kc.run(kc.load_scene(scene)).metrics["x_m"]
    assert x == pytest.approx(-5e-3 * 9.80665 / 1e3, rel=1e-3)


@pytest.mark.parametrize(
    ("pins", "driven", "proposed"),
    [
        ({"a": "v.out", "b": "v.out"}, {}, ("b", "gnd")),
        ({"a": "gnd", "b": "gnd"}, {"out": "r.a"}, ("a", "v.out")),
    ],
)
def test_a_part_on_one_net_is_connected_to_an_existing_net(pins, driven, proposed):
    scene = parse_toml(CIRCUIT)
    del scene["m"]
    scene["r"]["pins"], scene["v"]["pins"] = pins, driven
    error = fails(kc.load_scene, scene)
    assert "the same net" in error.message
    assert error.where.endswith(f"r.pins.{proposed[0]}")
    assert TARGET.search(error.hint).groups() == proposed
    scene["r"]["pins"] = pins | dict([proposed])
    kc.run(kc.load_scene(scene))
