"""Losses of declared parts as heat flows, against scipy, closed forms and energy balances."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import scipy
from support import (
    Declaration,
    Number,
    SimulationError,
    UsageError,
    find_resistance_coefficient,
    format_summary,
    list_dialect_names,
    multiply_trees,
)

import kc2spice as kc

SINK = {
    "mass": {"part": "thermal_capacitor", "capacity": "1e-3 J/K", "pins": {"b": "gnd"}},
    "path": {
        "part": "thermal_resistor",
        "resistance": "50 K/W",
        "pins": {"a": "mass.a", "b": "gnd"},
    },
}
SUPPLY = {"part": "source", "sine": {"amplitude": "20 V", "frequency": "50 Hz"}}


def scene_of(parts, name="warm", **tables):
    """A scene of parts whose heat flows into ``mass.a``, beside a mass and a path of heat."""
    return {"name": name, "gravity": 0.0} | SINK | parts | tables


def test_an_ac_analysis_advises_how_to_compute_the_temperature():
    """The recipe of the warning gives ``R_th V^2 / (2 R)`` for the amplitude V."""
    parts = {
        "load": {
            "part": "resistor", "resistance": "40 Ohm",
            "pins": {"a": "drive.out", "heat": "mass.a"},
        },
        "drive": {"part": "source", "ac": "2 V"},
    }  # fmt: skip
    probes = {
        "rise_k": {"of": "load.temperature"}, "out_w": {"of": "load.heat_flow"},
        "loss_w": {"of": "load.power", "take": "mean"},
    }  # fmt: skip
    analysis = {"type": "ac", "start": "10 Hz", "stop": "1 kHz"}
    with pytest.warns(UserWarning, match=r"probes\.(rise_k|out_w): .* is not computed") as found:
        swept = kc.run(scene_of(parts, probes=probes, analysis=analysis))
    assert all("read the mean power from a probe of load.power" in str(one) for one in found.list)
    assert swept.metrics["rise_k"] is None
    assert swept.metrics["out_w"] is None
    summary = dict(format_summary(swept.record).rows)
    assert "rise" not in summary
    assert "is not computed" in summary["WARNING"]
    source = {"part": "source", "kind": "heat_flow", "dc": swept.metrics["loss_w"],
              "pins": {"out": "mass.a"}}  # fmt: skip
    probes = {"rise_k": {"of": "mass.temperature", "take": "final"}}
    steady = kc.run(scene_of({"heat": source}, probes=probes, analysis={"type": "op"}))
    assert steady.metrics["rise_k"] == pytest.approx(50 * 2**2 / (2 * 40), rel=1e-6)


def test_a_thermal_circuit_with_an_ac_source_keeps_its_temperatures():
    source = {"part": "source", "kind": "heat_flow", "ac": "2 W", "pins": {"out": "mass.a"}}
    probes = {"rise_k": {"of": "mass.temperature"}}
    analysis = {"type": "ac", "start": "1 mHz", "stop": "1 Hz"}
    result = kc.run(scene_of({"heat": source}, probes=probes, analysis=analysis))
    assert result.metrics["rise_k"] == pytest.approx(2 * 50, rel=1e-3)


def assert_balanced(result, name):
    """The run has checked the energy balance of a part."""
    (check,) = [check for check in result.checks if check.name == f"energy of {name}"]
    assert check.passed
    assert check.value < 1e-3


def resistor(**keys):
    """A resistor in series with a capacitor at a source."""
    pins = {"a": "drive.out", "b": "c.a", "heat": "mass.a"}
    return {
        "r": {"part": "resistor", "resistance": "50 Ohm", "pins": pins} | keys,
        "c": {"part": "capacitor", "capacitance": "100 uF", "pins": {"b": "gnd"}},
        "drive": SUPPLY,
    }


@pytest.mark.parametrize("coefficient", [0.0, 3.93e-3, -2e-3])
def test_a_resistor_with_a_heat_capacity_follows_its_equations(coefficient):
    keys = {"temperature_coefficient": coefficient, "reference_temperature": "5 K"}
    solver = {"stop": "0.2 s", "reltol": 1e-5, "max_step": "20 us"}
    result = kc.run(scene_of(resistor(**keys), solver=solver))
    R0, C, Rth, Cth = 50.0, 100e-6, 50.0, 1e-3

    def slopes(t, y):
        u, T = y
        v = 20 * np.sin(2 * np.pi * 50 * t) - u
        i = v / (R0 * (1 + coefficient * (T - 5.0)))
        return [i / C, (v * i - T / Rth) / Cth]

    exact = scipy.integrate.solve_ivp(
        slopes, (0, 0.2), [0.0, 0.0], "LSODA", result.time, rtol=1e-10, atol=1e-12
    ).y
    rise = exact[1]
    assert rise.max() > 50.0
    assert np.abs(result.waves["r.temperature"] - rise).max() < 2e-4 * rise.max()
    assert np.abs(result.waves["c.v"] - exact[0]).max() < 2e-4 * np.abs(exact[0]).max()
    assert_balanced(result, "r")


def coil(**drive):
    """A voice coil at rest whose wire is the only loss, at a constant source."""
    keys = {"resistance": "4 Ohm", "inductance": "1 mH", "bl": 0.0, "cms": "1 mm/N"}
    pins = {"plus": "drive.out", "heat": "mass.a", "a": "gnd"}
    return {
        "coil": {"part": "voice_coil", "pins": pins} | keys,
        "drive": {"part": "source"} | drive,
    }


def test_a_copper_coil_heats_to_its_fixed_point():
    a, R0, Rth, probe = find_resistance_coefficient("copper"), 4.0, 50.0, {"take": "final"}
    op = {"type": "op"}
    probes = {"rise": {"of": "mass.temperature"} | probe}
    # I^2 R0 (1 + a T) Rth = T
    parts = coil(kind="current", dc="0.5 A")
    rise = kc.run(scene_of(parts, analysis=op, probes=probes)).metrics["rise"]
    cold = 0.25 * R0 * Rth
    assert rise == pytest.approx(cold / (1 - a * cold), rel=1e-6)
    # U^2 Rth / (R0 (1 + a T)) = T
    rise = kc.run(scene_of(coil(dc="2 V"), analysis=op, probes=probes)).metrics["rise"]
    assert rise == pytest.approx((np.sqrt(1 + 4 * a * 50.0) - 1) / (2 * a), rel=1e-6)


STEP = {
    "part": "source",
    "pulse": {"high": "5 V", "width": "1 s", "edge": "20 us", "start": "1 ms"},
}
PUSH = {
    "part": "source",
    "kind": "force",
    "sine": {"amplitude": "10 mN", "frequency": "200 Hz"},
}
HEATED = {
    "resistor": resistor(temperature_coefficient="3.93e-3 1/K"),
    "damper": {
        "part": {"part": "damper", "damping": "0.02 N s/m", "pins": {"a": "push.out", "b": "gnd"}},
        "spring": {"part": "spring", "stiffness": "100 N/m", "pins": {"a": "push.out"}},
        "push": PUSH,
    },
    "voice_coil": {
        "part": {
            "part": "voice_coil",
            "resistance": "4 Ohm",
            "inductance": "1 mH",
            "bl": "3 N/A",
            "bl2": -1e5,
            "cms": "1 mm/N",
            "damping": "0.3 N s/m",
            "pins": {"plus": "drive.out", "a": "cone.a"},
        },
        "cone": {"part": "mass", "mass": "5 g"},
        "drive": STEP,
    },
    "reluctance": {
        "part": {
            "part": "reluctance",
            "area": "20 mm2",
            "gap": "1 mm",
            "core": 1e6,
            "turns": 1000,
            "resistance": "50 Ohm",
            "travel": "0.8 mm",
            "pins": {"plus": "drive.out", "a": "plunger.a"},
        },
        "plunger": {"part": "mass", "mass": "5 g"},
        "spring": {"part": "spring", "stiffness": "1 kN/m", "pins": {"a": "plunger.a"}},
        "drive": STEP,
    },
    "relay": {
        "part": {
            "part": "relay",
            "resistance": "70 Ohm",
            "voltage": "5 V",
            "pick_up": "3.75 V",
            "release": "0.5 V",
            "operate_time": "10 ms",
            "pins": {"plus": "drive.out", "no": "supply.out", "com": "load.a"},
        },
        "load": {"part": "resistor", "resistance": "100 Ohm", "pins": {"b": "gnd"}},
        "supply": {"part": "source", "dc": "12 V"},
        "drive": STEP,
    },
    "loudspeaker": {
        "part": {
            "part": "loudspeaker",
            "fs": "46.4 Hz",
            "re": "6.23 Ohm",
            "qms": 6.66,
            "qes": 0.538,
            "mms": "10.28 g",
            "pins": {"plus": "drive.out"},
        },
        "drive": STEP,
    },
    "moving_magnet": {
        "part": {
            "part": "moving_magnet",
            "radius": "3 mm",
            "thickness": "4 mm",
            "remanence": "1.2 T",
            "y_min": "-2 mm",
            "y_max": "2 mm",
            "coils": {
                "coil": {
                    "radius": "4 mm",
                    "width": "2 mm",
                    "height": "3 mm",
                    "y": "-6 mm",
                    "turns": 200,
                    "resistance": "10 Ohm",
                }
            },
            "pins": {"coil_p": "drive.out", "a": "body.a"},
        },
        "body": {"part": "mass", "mass": "1 g"},
        "spring": {"part": "spring", "stiffness": "1 kN/m", "pins": {"a": "body.a"}},
        "drive": STEP,
    },
}  # fmt: skip


def heated_scene(kind):
    """A transient of a part that gives off its heat."""
    parts = json.loads(json.dumps(HEATED[kind]))
    name = "part" if "part" in parts else "r"
    parts[name]["pins"]["heat"] = "mass.a"
    solver = {"stop": "30 ms", "reltol": 1e-5, "max_step": "10 us"}
    return scene_of(parts, solver=solver), name


@pytest.mark.parametrize("kind", HEATED)
def test_a_part_gives_off_the_energy_that_enters_by_its_other_pins(kind):
    scene, name = heated_scene(kind)
    result = kc.run(scene)
    assert_balanced(result, name)
    flow = -result.waves[f"{name}.heat"]
    assert scipy.integrate.trapezoid(flow, result.time) > 0
    verdict = kc.verify(scene)
    assert verdict["passed"], [c for c in verdict["checks"] if not c["passed"]]


def test_the_heat_of_a_voice_coil_is_its_electrical_work_less_the_stored_energy():
    scene, _ = heated_scene("voice_coil")
    scene["part"] |= {"bl2": 0.0}
    result = kc.run(scene)
    waves, t = result.waves, result.time
    work = scipy.integrate.cumulative_trapezoid(waves["drive.v"] * waves["part.i"], t, initial=0)
    heat = scipy.integrate.cumulative_trapezoid(-waves["part.heat"], t, initial=0)
    x, speed = waves["part.x"], np.gradient(waves["part.x"], t)
    stored = 0.5e-3 * waves["part.i"] ** 2 + 0.5 * 1e3 * x**2 + 0.5 * 5e-3 * speed**2
    assert heat[-1] > 0.1
    assert np.abs(work - heat - stored).max() < 1e-3 * work.max()


def test_a_netlist_that_gives_off_too_little_heat_fails_the_balance(monkeypatch):
    power = Declaration.heat_power.func
    less = property(lambda self: multiply_trees(Number("0.99"), power(self)))
    monkeypatch.setattr(Declaration, "heat_power", less)
    scene, _ = heated_scene("damper")
    with pytest.raises(SimulationError, match="energy balance of part"):
        kc.run(scene)


def test_every_dialect_and_the_symbol_have_the_pins_of_heat(tmp_path):
    scene, _ = heated_scene("voice_coil")
    for dialect in list_dialect_names():
        files = kc.export(scene, tmp_path / dialect, dialect=dialect)
        texts = [path.read_text("utf-8") for path in map(Path, files) if "part" in path.name]
        texts = texts or [path.read_text("utf-8") for path in map(Path, files)]
        assert any("heat" in text and "ambient" in text for text in texts), dialect
    symbols = "".join(p.read_text("utf-8") for p in tmp_path.rglob("*.kicad_sym"))
    assert '"heat"' in symbols


def test_without_the_pin_of_heat_the_netlist_has_none():
    for kind in HEATED:
        parts = json.loads(json.dumps(HEATED[kind]))
        parts.get("r", {}).pop("temperature_coefficient", None)
        parts.get("r", {"pins": {}})["pins"].pop("heat", None)
        texts = kc.deck(scene_of(parts, solver={"stop": "1 ms"})).files.values()
        libraries = [text for text in texts if "@pin" in text]
        assert all(re.search("@pin .* (heat|ambient) ", text) is None for text in libraries), kind
        assert bool(libraries) == (kind not in ("resistor", "damper"))


@pytest.mark.parametrize(
    ("kind", "pins", "keys", "words"),
    [
        ("resistor", {"heat": "drive.out"}, {}, "pins of different kinds"),
        ("resistor", {"heat": "c.a"}, {}, "pins of different kinds"),
        ("capacitor", {"heat": "mass.a"}, {}, "no such pin"),
        ("resistor", {}, {"temperature_coefficient": 4e-3}, "no effect without a heat pin"),
        ("resistor", {}, {"reference_temperature": "20 K"}, "no effect without a heat pin"),
    ],
)
def test_bad_joins_and_keys_of_heat_are_refused(kind, pins, keys, words):
    value = {"resistor": ("resistance", "50 Ohm"), "capacitor": ("capacitance", "1 nF")}[kind]
    part = {"part": kind, "pins": {"a": "drive.out", "b": "c.a"} | pins, value[0]: value[1]} | keys
    parts = resistor() | {"r": part}
    with pytest.raises(UsageError, match=words):
        kc.deck(scene_of(parts, solver={"stop": "1 ms"}))


@pytest.mark.parametrize("tables", [{"analysis": {"type": "op"}}, {"solver": {"stop": "1 ms"}}])
def test_heat_without_a_path_to_the_ambient_temperature_is_refused(tables):
    scene = scene_of(resistor(), **tables)
    del scene["path"]
    with pytest.raises(UsageError, match="heat cannot flow from") as caught:
        kc.load_scene(scene)
    assert "heat flow of r" in str(caught.value)
    assert "thermal_resistor" in caught.value.hint


def test_slow_heating_needs_no_small_steps():
    """A wire of copper warms for 100 s: the rise is that of scipy, in far less than 1e7 steps."""
    parts = {"wire": {"part": "resistor", "resistance": "10 Ohm",
                      "temperature_coefficient": "3.93e-3 1/K",
                      "pins": {"a": "supply.out", "heat": "mass.a"}},
             "supply": {"part": "source", "pulse": {"high": "2 V", "width": "1 ks",
                                                    "edge": "1 ms", "start": "1 s"}}}  # fmt: skip
    scene = scene_of(parts, solver={"stop": "100 s", "reltol": 1e-4})
    scene["mass"] = scene["mass"] | {"capacity": "0.2 J/K"}
    result = kc.run(scene)
    assert result.time.size < 1e4

    def slope(t, T):
        return (4.0 / (10 * (1 + 3.93e-3 * T)) - T / 50.0) / 0.2

    exact = scipy.integrate.solve_ivp(slope, (0, 99), [0.0], rtol=1e-9, dense_output=True).sol
    rise = np.where(result.time > 1.001, exact(np.maximum(result.time - 1.0005, 0))[0], 0.0)
    assert np.abs(result.waves["mass.temperature"] - rise).max() < 1e-3 * rise.max()
