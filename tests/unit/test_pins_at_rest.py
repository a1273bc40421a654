"""Reference pins that must be at rest: rejected joins, warnings, and joins that are right."""

import warnings

import numpy as np
import pytest
from support import UsageError, load_scene

import kc2spice as kc

AC = {"type": "ac", "start": "100 Hz", "stop": "1 kHz", "points": 3}
PULSE = {"high": "10 K", "start": "1 s", "edge": "1 ms", "width": "100 s"}
LAYERS = [
    {"material": "brass", "diameter": "20 mm", "thickness": "0.2 mm"},
    {"material": "PZT-5A", "diameter": "14 mm", "thickness": "0.2 mm"},
]
STACK = {"part": "piezo_stack", "pins": {"anode": "drive.out"}}
DISC = {"part": "disc", "layers": LAYERS, "support": "clamped", "pins": {"anode": "drive.out"}}
WOOFER = {"part": "loudspeaker", "fs": "37 Hz", "re": "6 Ohm", "qms": 5.6, "mms": "109.5 g",
          "bl": "25.6 N/A", "pins": {"plus": "drive.out"}}  # fmt: skip
CONE = {
    "part": "diaphragm",
    "area": "1 cm2",
    "mass": "1 g",
    "pins": {"a": "push.out", "front": "r.a"},
}
AIR = {"part": "acoustic_resistor", "resistance": "1e6 Pa s/m3"}
CAVITY = {"part": "cavity", "volume": "1 cm3", "pins": {"a": "pump.out"}}
PUMP = {"part": "source", "kind": "volume_velocity", "ac": "1e-9 m3/s"}
TUBE = {"part": "tube", "radius": "2 mm", "length": "20 mm", "pins": {"a": "pump.out", "b": "gnd"}}
DRIVE = {"part": "source", "ac": "1 V"}
PUSH = {"part": "source", "kind": "force", "ac": "1 N"}
SPRING = {"part": "spring", "stiffness": "10 kN/m"}
# for each part: its table, its reference pin, a part t that moves this pin, and further parts
MOVED = {
    "piezo_stack": (STACK, "base", SPRING, {"drive": DRIVE}, "port of kind base"),
    "mass": ({"part": "mass", "mass": "3 g", "pins": {"a": "push.out"}}, "base", SPRING,
             {"push": PUSH}, "connect p.a to a moving part"),
    "loudspeaker": (WOOFER, "frame", SPRING, {"drive": DRIVE}, "voice_coil"),
    "diaphragm": (CONE, "b", SPRING, {"push": PUSH, "r": AIR}, ""),
    "cavity": (CAVITY, "ambient", AIR, {"pump": PUMP}, "acoustic_resistor"),
    "tube": (TUBE, "ambient", AIR, {"pump": PUMP}, ""),
}  # fmt: skip


def scene_of(part, pins, others, **tables):
    """A scene with the part ``p``, whose table gets further pins."""
    table = {**part, "pins": part["pins"] | pins}
    return {"name": "still", "gravity": 0.0, "p": table, **others, "analysis": AC} | tables


@pytest.mark.parametrize("kind", MOVED)
def test_a_reference_pin_that_can_move_is_rejected(kind):
    part, pin, moving, others, cure = MOVED[kind]
    with pytest.raises(UsageError, match=r"applies to .* relative to its pin") as caught:
        load_scene(scene_of(part, {pin: "t.a"}, {**others, "t": moving}))
    error = caught.value
    assert error.where.endswith(f"p.pins.{pin}")
    assert error.got == "t.a"
    assert error.expected == "gnd"
    assert str(error.hint).startswith(f"write  '{pin}': 'gnd'  in the dict p.pins")
    assert cure in str(error.hint)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        load_scene(scene_of(part, {pin: "gnd"}, others))


def test_the_error_names_the_pin_that_is_joined_to_the_reference():
    others = {"drive": DRIVE, "k": {**SPRING, "pins": {"a": "p.base"}}}
    with pytest.raises(UsageError, match="inertia of p") as caught:
        load_scene(scene_of(STACK, {}, others))
    assert caught.value.where.endswith("k.pins.a")
    assert caught.value.got == "p.base"
    assert str(caught.value.hint).startswith("write  'a': 'gnd'  in the dict k.pins")


def test_a_static_analysis_accepts_a_moving_reference_pin():
    """A force bends the spring between the two pins of the mass: ``x = F/k``."""
    push = {"part": "source", "kind": "force", "dc": "1 N"}
    part = {"part": "mass", "mass": "3 g", "pins": {"a": "push.out"}}
    link = {**SPRING, "pins": {"a": "p.base"}}
    others = {"push": push, "link": link, "k": {**SPRING, "pins": {"a": "push.out", "b": "p.base"}}}
    probes = {"x": {"of": "p.x", "take": "final"}}
    scene = scene_of(part, {}, others, analysis={"type": "op"}, probes=probes)
    assert kc.run(load_scene(scene)).metrics["x"] == pytest.approx(1 / 10e3)


def test_a_constant_source_may_hold_a_reference_pin():
    wall = {"part": "source", "kind": "displacement", "dc": "10 um"}
    scene = scene_of(STACK, {"base": "wall.out"}, {"drive": DRIVE, "wall": wall})
    load_scene(scene)
    scene["wall"] = wall | {"ac": "1 um"}
    with pytest.raises(UsageError, match="applies to displacements relative to its pin base"):
        load_scene(scene)


def test_a_displacement_source_at_the_base_of_a_disc_becomes_an_acceleration():
    shaker = {"part": "source", "kind": "displacement", "ac": 1.0}
    scene = scene_of(DISC, {"base": "shaker.out"}, {"drive": DRIVE, "shaker": shaker})
    with pytest.raises(UsageError, match="different kinds") as caught:
        load_scene(scene)
    assert "'kind': 'acceleration'  in the dict shaker" in str(caught.value.hint)
    scene["shaker"] = shaker | {"kind": "acceleration"}
    assert load_scene(scene).terminals["p", "base"].unit == "m/s2"
    scene["p"]["pins"] |= {"ground": "k.a"}
    scene["k"] = SPRING
    with pytest.raises(UsageError, match="relative to its pin ground") as caught:
        load_scene(scene)
    assert "p.base" in str(caught.value.hint)


def test_an_acceleration_source_without_a_target_names_the_base_of_a_disc():
    shaker = {"part": "source", "kind": "acceleration", "ac": 1.0}
    scene = scene_of(DISC, {}, {"drive": DRIVE, "shaker": shaker})
    with pytest.raises(UsageError, match="is not connected") as caught:
        load_scene(scene)
    assert "p.base" in str(caught.value.hint)
    scene["shaker"] = shaker | {"pins": {"out": "p.base"}}
    load_scene(scene)


@pytest.mark.parametrize("kind", ["acceleration", "displacement"])
def test_a_free_disc_has_no_support_that_can_move(kind):
    shaker = {"part": "source", "kind": kind, "ac": 1.0}
    part = DISC | {"support": "free"}
    scene = scene_of(part, {"base": "shaker.out"}, {"drive": DRIVE, "shaker": shaker})
    with pytest.raises(UsageError, match="p is free, so it has no support") as caught:
        load_scene(scene)
    assert caught.value.where.endswith("p.support")


HEAT = {
    "part": "heat_body",
    "layers": [{"material": "copper", "thickness": "3 mm", "area": "25 mm2"}],
    "sources": {"j": "top"},
    "films": [{"group": "bottom", "coefficient": "1 kW/(m2 K)"}],
    "pins": {},
}
ROOM = {"part": "source", "kind": "temperature", "pulse": PULSE}


def test_a_varying_ambient_temperature_warns_and_the_advice_gives_the_right_temperature():
    """A block of copper follows the temperature of the air by ``1 - exp(-t / (R C))``."""
    # the run needs few time points
    tables = {"analysis": {"type": "transient", "stop": "4 s"}, "solver": {"max_step": "20 ms"}}
    tables["probes"] = {"t": {"of": "p.temperature.j", "take": "final"}}
    warning = "the heat capacity of p applies to temperatures relative to its pin ambient"
    with pytest.warns(UserWarning, match=warning):
        load_scene(scene_of(HEAT, {"ambient": "room.out"}, {"room": ROOM}, **tables))
    films = [HEAT["films"][0] | {"pin": "air"}]
    scene = scene_of(HEAT | {"films": films}, {"air": "room.out"}, {"room": ROOM}, **tables)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded = load_scene(scene)
    result = kc.run(loaded)
    capacity, resistance = 8960 * 385 * 25e-6 * 3e-3, 1 / (1e3 * 25e-6)
    exact = 10 * (1 - np.exp(-3.0 / (resistance * capacity)))
    assert result.metrics["t"] == pytest.approx(exact, rel=0.02)


def test_a_constant_ambient_temperature_does_not_warn():
    room = {"part": "source", "kind": "temperature", "dc": "300 K"}
    tables = {"analysis": {"type": "transient", "stop": "1 s"}}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_scene(scene_of(HEAT, {"ambient": "room.out"}, {"room": room}, **tables))


@pytest.mark.parametrize("kind", ["spring", "damper", "radiation"])
def test_parts_without_inertia_may_be_joined_to_moving_pins(kind):
    drive = {"part": "source", "kind": "displacement", "ac": "1 um"}
    parts = {
        "spring": (SPRING, "b"),
        "damper": ({"part": "damper", "damping": "0.1 N s/m"}, "b"),
        "radiation": ({"part": "radiation", "radius": "10 mm"}, "ambient"),
    }
    table, pin = parts[kind]
    first, other = ("a", SPRING) if kind != "radiation" else ("face", AIR)
    if kind == "radiation":
        drive = {"part": "source", "kind": "pressure", "ac": "1 Pa"}
    table = {**table, "pins": {first: "k.a"}}
    load_scene(scene_of(table, {pin: "drive.out"}, {"drive": drive, "k": other}))
