"""What a library offers to change: parameters with their defaults, units and ranges; and numbers in
the circuits of drivers, by formulas of their own."""

import math
import re
from types import SimpleNamespace

import pytest

from kc2spice.parts._drivers import Load
from kc2spice.parts._opamp import opamp_subcircuit
from kc2spice.parts.amplifier import AmplifierKeys, amplifier_subcircuit
from kc2spice.parts.charge_drive import ChargeKeys, charge_drive_subcircuit
from kc2spice.parts.half_bridge import HalfBridgeKeys, half_bridge_subcircuit
from kc2spice.parts.linear_drive import LinearKeys, linear_subcircuit
from kc2spice.parts.pid import Control, pid_subcircuit
from kc2spice.parts.pwm_drive import PwmKeys, pwm_subcircuit
from kc2spice.parts.sphere import sphere_subcircuit
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build, part_types
from kc2spice.spice.header import Header

HEADER = Header("t", "0")
COILS = Load(0.05, 12.0)  # H, Ohm


SPRING, RESISTOR = {"part": "spring", "stiffness": 1.0}, {"part": "resistor", "resistance": 1.0}
BESIDE = {
    "sensor": ({"of": "far.a"}, SPRING), "mass": ({"a": "far.a"}, SPRING),
    "diode": ({"anode": "far.a", "cathode": "gnd"}, RESISTOR),
}  # fmt: skip


def of_scene(name, **keys):
    """The library of a part that takes its numbers from keys alone."""
    pins, far = BESIDE[name]
    it = {"part": name, "pins": pins, **keys}
    scene = load_scene({"name": "one", "gravity": 9.81, "it": it, "far": far})
    part = scene.parts["it"]
    (found,) = part.type.subcircuits(part, Build(scene, {}, {"it": "it"}), HEADER)
    return found


LIBRARIES = {
    "opamp_ideal": lambda: opamp_subcircuit(HEADER, "ideal"),
    "opamp": lambda: opamp_subcircuit(HEADER),
    "opamp_slew": lambda: opamp_subcircuit(HEADER, "slew"),
    "half_bridge": lambda: half_bridge_subcircuit(HEADER, HalfBridgeKeys(rail=90.0)),
    "amplifier": lambda: amplifier_subcircuit(HEADER, AmplifierKeys(resistance=3.0)),
    "charge_drive": lambda: charge_drive_subcircuit(HEADER, ChargeKeys(sense=2e-6)),
    "linear_drive": lambda: linear_subcircuit(HEADER, LinearKeys(slew=3e7), COILS, 0.25),
    "pwm_drive": lambda: pwm_subcircuit(HEADER, PwmKeys(edge=6e-8), COILS),
    "pid": lambda: pid_subcircuit(HEADER, Control(), load=12.0),
    "pid without output": lambda: pid_subcircuit(HEADER, Control(current_limit=0.2), output=False),
    "pid as a law": lambda: pid_subcircuit(HEADER, Control(form="ideal", kp=0.0, kd=0.0)),
    "sphere": lambda: sphere_subcircuit(HEADER, 1e-5, 1e-3, 9.81, velocity=-1.0, height=2e-3),
    "sensor": lambda: of_scene("sensor", offset=1e-7),
    "mass": lambda: of_scene("mass", mass=2.0, weight=True),
    "mass without weight": lambda: of_scene("mass", mass=2.0),
    "diode": lambda: of_scene("diode", series_resistance=0.5),
}  # fmt: skip
# > above zero, >= from zero on, without either any number
TABLE = """
opamp_ideal: a0 1e7 - >, rout 0.1 Ohm >
opamp: a0 1e7 - >, gbw 1e9 Hz >, rout 0.1 Ohm >, offset 0 V, clip 1e3 S >
opamp_slew: a0 1e7 - >, gbw 1e9 Hz >, rout 0.1 Ohm >, offset 0 V, slew 1e9 V/s >,
    current_limit 1 A >
half_bridge: rail 90 V >, resistance 2 Ohm >, gate_resistance 10 Ohm >, current_limit 15 A >,
    reservoir 1e-5 F >, supply_resistance 100 Ohm >
amplifier: rail 120 V >, resistance 3 Ohm >, bandwidth 2e6 Hz >, slew 1e9 V/s >,
    current_limit 15 A >
charge_drive: capacitance 1.5e-7 F >, sense 2e-6 F >, rail 300 V >, resistance 20 Ohm >,
    bandwidth 2e5 Hz >, slew 1e9 V/s >, current_limit 10 A >
linear_drive: rail 48 V >, slew 3e7 V/s >, current_limit 0.5 A >
pwm_drive: rail 100 V >, frequency 1e5 Hz >, resistance 0.5 Ohm >, edge 6e-8 s >
pid: setpoint 2.5e-3 m, kp 5e4 A/m >, ki 10 A/(m.s) >, kd 20 A.s/m >, rolloff 1e-7 s >,
    current_limit 0.1 A >, offset 0 V, rail 15 V >, compliance 400 V >
pid without output: setpoint 2.5e-3 m, kp 5e4 A/m >, ki 10 A/(m.s) >, kd 20 A.s/m >,
    rolloff 1e-7 s >, current_limit 0.2 A >, offset 0 V, rail 24 V >
pid as a law: setpoint 2.5e-3 m, ki 10 A/(m.s) >, current_limit 0.1 A >
sphere: mass 1e-5 kg >, radius 1e-3 m >, gravity 9.81 m/s2, velocity -1 m/s, height 2e-3 m
sensor: bandwidth 1e6 Hz >=, offset 1e-7 m
mass: mass 2 kg >, gravity 9.81 m/s2, position 0 m, velocity 0 m/s
mass without weight: mass 2 kg >, gravity 0 m/s2, position 0 m, velocity 0 m/s
diode: is 2.52e-9 A, n 1.752 -, rs 0.5 Ohm, cjo 4e-12 F, tt 20e-9 s, bv 100 V
"""
ROWS = dict(row.split(": ") for row in TABLE.replace("\n    ", " ").strip().splitlines())


@pytest.mark.parametrize("name", LIBRARIES)
def test_a_library_offers_its_parameters(name):
    low = {">": pytest.approx(0.0, abs=1e-29), ">=": 0.0, "": -math.inf}
    wanted = [(*row.split(), "")[:4] for row in ROWS[name].split(", ")]
    found = LIBRARIES[name]()
    assert [(p.name, p.unit) for p in found.params] == [(n, unit) for n, _, unit, _ in wanted]
    defaults = [float(v) for _, v, _, _ in wanted]
    assert [p.default for p in found.params] == pytest.approx(defaults, rel=1e-12)
    for param, (_, _, _, sign) in zip(found.params, wanted, strict=True):
        assert param.low == low[sign]
        assert (param.low > 0) == (sign == ">")
        assert param.high == math.inf
    first = next(line for line in found.text.splitlines() if line.startswith(".subckt"))
    assert [word.partition("=")[0] for word in first.split() if "=" in word] == [
        p.name for p in found.params
    ]


# --- circuits -------------------------------------------------------------------------------------


def value(text, card):
    """The last word of a card, without braces."""
    return re.search(rf"(?m)^{card} .*?(\S+)$", text)[1].strip("{}")


def test_the_loop_of_a_linear_drive_cancels_the_pole_of_its_coils():
    """``R2 / R1 = 2 pi f L / 100 Ohm``, ``R2 C1 = L / R``; five times the bandwidth behind it."""
    text = linear_subcircuit(HEADER, LinearKeys(bandwidth=20e3), COILS, 0.25).text
    r1, r2, c1 = (float(value(text, card)) for card in ("R1", "R2", "C1"))
    gain = 2 * math.pi * 20e3 * 0.05 / 100
    assert r2 / r1 == pytest.approx(gain)
    assert r2 * c1 == pytest.approx(0.05 / 112)
    assert float(value(text, "Rsense")) == 100.0
    gbw = float(re.search(r"gbw=(\S+) slew", text)[1])
    assert gbw == pytest.approx(5 * 20e3 * (1 + gain))
    assert "0.05 H and 112 Ohm" in text
    assert "20000 Hz" in text


def test_the_loop_of_a_modulator_cancels_the_pole_of_its_coils():
    """``R2 / R1 = 2 pi f L 10 V / (100 Ohm rail)``, two switches and 1 Ohm more in R."""
    keys = PwmKeys(bandwidth=5e3, resistance=0.25, rail=50.0)
    text = pwm_subcircuit(HEADER, keys, COILS).text
    r1 = float(value(text, "R1"))
    r2 = float(value(text, "R2").removesuffix("/rail")) / 50.0
    c1 = float(value(text, "C1").removesuffix("*rail")) * 50.0
    assert r2 / r1 == pytest.approx(2 * math.pi * 5e3 * 0.05 * 10 / (100 * 50.0), rel=1e-9)
    assert r2 * c1 == pytest.approx(0.05 / 13.5)
    assert (float(value(text, "Vcc")), float(value(text, "Vee"))) == (12.0, -12.0)
    assert float(value(text, "Gsense")) * 1000 == pytest.approx(100.0)
    assert "0.05 H and 13.5 Ohm" in text


@pytest.mark.parametrize(
    ("keys", "rail", "sense"), [({}, 15.0, 100.0), ({"current_limit": 0.5}, 15.0, 20.0)]
)
def test_a_controller_measures_within_its_rails(keys, rail, sense):
    """10 V at its limit, at most 100 Ohm; 1.2 times that on the rails, 15 V at least."""
    found = pid_subcircuit(HEADER, Control(**keys))
    assert float(value(found.text, "Rsense")) == sense
    assert next(p.default for p in found.params if p.name == "rail") == rail
    assert value(found.text, "Vset") == "setpoint*2000.0"
    assert f"{{current_limit*{sense}}}" in found.text
    assert ".param lag={(45+2*post)/6283185307.179586}" in found.text


@pytest.mark.parametrize(
    ("keys", "output", "rating"),
    [({}, True, "current_limit and compliance"), ({}, False, "current_limit"),
     ({"form": "ideal"}, True, "current_limit"), ({"form": "ideal"}, False, "current_limit")],
)  # fmt: skip
def test_a_controller_says_what_bounds_its_output(keys, output, rating):
    found = pid_subcircuit(HEADER, Control(**keys), output=output)
    assert f"* rating: its output stays within {rating}\n" in found.text
    ends = ["drive", "sense"] if output else ["command"]
    assert [pin.name for pin in found.pins] == ["y", "enable", *ends, "ref"]
    assert ("opamp" in found.text) is (keys == {})


def test_gains_of_a_controller_are_above_zero_or_none():
    """A roll-off is there with a differentiator alone."""
    for keys, names in (
        ({"kd": 0.0}, ["kp", "ki"]), ({"kp": 0.0}, ["ki", "kd", "rolloff"]),
        ({"ki": 0.0, "kp": 0.0}, ["kd", "rolloff"]), ({"kd": 0.5}, ["kp", "ki", "kd", "rolloff"]),
    ):  # fmt: skip
        found = pid_subcircuit(HEADER, Control(**keys))
        own = [p.name for p in found.params]
        assert [name for name in own if name in ("kp", "ki", "kd", "rolloff")] == names
        weights = re.search(r"sqrt\(\(([^)]*)\)/40", found.text)[1].split("+")
        assert weights == [f"gain_{name[1]}" for name in names if name != "rolloff"]


def test_an_ideal_amplifier_has_no_rails_and_the_others_say_theirs():
    for level, words in (("ideal", "none: ideal"), ("pole", "between vee and vcc"),
                         ("slew", "between vee and vcc")):  # fmt: skip
        assert words in opamp_subcircuit(HEADER, level).text


def test_a_sensor_draws_its_noise_twice_a_period_of_its_bandwidth():
    quiet = of_scene("sensor").text
    assert "TRNOISE" not in quiet
    noisy = of_scene("sensor", bandwidth=2e5, noise=3e-9).text
    size, step = re.search(r"TRNOISE\((\S+) (\S+) 0 0\)", noisy).groups()
    assert (float(size), float(step)) == pytest.approx((3e-3, 2.5e-6), rel=1e-9)
    scene = load_scene({
        "name": "s", "eye": {"part": "sensor", "pins": {"of": "far.a"}}, "far": SPRING,
    })  # fmt: skip
    eye = scene.parts["eye"]
    (vector,) = eye.type.vectors(eye, Build(scene, {})).values()
    assert (vector.factor, vector.unit) == (1e-6, "m")
    assert eye.type.modelled(eye, scene).detail == "1e+06 Hz, offset 0 m, noise 0 m rms"
    pins = {p.name: (p.required, p.signal_out) for p in eye.type.pins(eye, scene)}
    assert pins == {"of": (True, False), "out": (False, True), "ref": (False, False)}


def test_drivers_of_one_scene_have_short_names_and_several_their_own():
    one, two = SimpleNamespace(name="one"), SimpleNamespace(name="two")
    alone, both = (SimpleNamespace(of=lambda _, all_=all_: all_) for all_ in ([one], [one, two]))
    for kind, short in (("linear_drive", "linear"), ("pwm_drive", "pwm"),
                        ("charge_drive", "charge")):  # fmt: skip
        type_ = part_types()[kind]
        assert type_.library(one, alone) == short
        assert [type_.library(part, both) for part in (one, two)] == ["one", "two"]
