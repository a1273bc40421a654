"""Values and results with a probable mistake: a run accepts them, and prints a warning."""

import math
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from messages import fails
from small_scenes import RESISTOR, SPEAKER

import kc2spice as kc

OSCILLATOR = {
    "spring": {"part": "spring", "stiffness": "1 kN/m", "pins": {"a": "mass.a"}},
    "mass": {"part": "mass", "mass": "25 mg"},
    "push": {
        "part": "source",
        "kind": "force",
        "pulse": {"high": "10 mN", "width": "1 ms", "edge": "10 us", "start": "1 us"},
        "pins": {"out": "mass.a"},
    },
    "analysis": {"type": "transient", "stop": "3 ms"},
}
HEATER = {
    "die": {
        "part": "heat_body",
        "layers": [{"material": "silicon", "thickness": "0.3 mm", "area": "25 mm2"}],
        "sources": {"top": "top"},
        "films": [{"group": "bottom", "coefficient": "1 kW/(m2 K)"}],
        "pins": {"top": "load.out"},
    },
    "load": {"part": "source", "kind": "heat_flow", "dc": "20 W"},
    "analysis": {"type": "op"},
}
BUZZER = {
    "disc": {
        "part": "disc",
        "layers": [
            {"material": "brass", "diameter": "20 mm", "thickness": "0.2 mm"},
            {"material": "PZT-5A", "diameter": "14 mm", "thickness": "0.22 mm"},
        ],
        "support": "free",
        "damping": {"quality": 50},
    },
    "analysis": {"type": "ac", "start": "1 kHz", "stop": "14 kHz", "points": 300},
}


def list_warnings(call, *arguments, **options):
    """The texts of the warnings of a call, and its result."""
    with warnings.catch_warnings(record=True) as records:
        warnings.simplefilter("always")
        result = call(*arguments, **options)
    return [str(record.message) for record in records], result


def load(tables, **overrides):
    """The warnings of a scene whose keys are overridden."""
    changed = {key.replace("__", "."): value for key, value in overrides.items()}
    return list_warnings(kc.load_scene, tables, changed)[0]


@pytest.mark.parametrize(
    ("tables", "key", "value", "meant"),
    [
        (SPEAKER, "woofer.mms", 109.5, "109.5 g"),
        (SPEAKER, "woofer.sd", 530, "530 cm2"),
        (SPEAKER, "woofer.xmax", 8, "8 mm"),
        (SPEAKER, "woofer.le", 700, "700 mH"),
        (OSCILLATOR, "mass.mass", 25, "25 g"),
    ],
)
def test_a_key_whose_number_lacks_its_unit_causes_a_warning(tables, key, value, meant):
    found = [text for text in load(tables, **{key: value}) if text.startswith(key)]
    assert len(found) == 1
    assert f'did you mean "{meant}"?' in found[0]
    assert not [text for text in load(tables, **{key: meant}) if text.startswith(key)]


@pytest.mark.parametrize(
    ("part", "key", "value", "meant"),
    [
        ("capacitor", "capacitance", 10, "10 nF"),
        ("capacitor", "capacitance", 1, "1 nF"),
        ("inductor", "inductance", 220, "220 mH"),
    ],
)
def test_an_element_whose_value_lacks_its_unit_causes_a_warning(part, key, value, meant):
    tables = {
        "battery": {"part": "source", "dc": "1 V"},
        "load": {"part": part, key: value, "pins": {"a": "battery.out"}},
        "analysis": {"type": "transient", "stop": "1 ms"},
    }
    (found,) = load(tables)
    assert f'did you mean "{meant}"?' in found
    assert not load(tables, **{f"load.{key}": meant})
    assert not load(tables, checks__plausible="off")


def test_the_density_of_a_solid_without_its_unit_causes_a_warning():
    die = {"density": 2.33, "conductivity": 148.0, "specific_heat": 712.0}
    rubber = {"density": 1, "youngs_modulus": "5 MPa", "poisson_ratio": 0.4, "conductor": True}
    for tables, key, typed in (
        ("impact", "sphere.density", 7.85),
        (HEATER, "die.layers[0].material", die),
        (BUZZER, "disc.layers[0].material", rubber),
    ):
        number = typed["density"] if isinstance(typed, dict) else typed
        (found,) = list_warnings(kc.load_scene, tables, {key: typed})[0]
        assert f'did you mean "{number} g/cm3"?' in found
        meant = f"{number} g/cm3"
        meant = typed | {"density": meant} if isinstance(typed, dict) else meant
        assert not list_warnings(kc.load_scene, tables, {key: meant})[0]


@pytest.mark.parametrize(
    ("density", "speed", "warns"),
    [(1.0, 1480, True), (1.84, 653, False), (0.998, 1482, True), (0.166, 1007, False),
     ("1 g/cm3", 1480, False), (998.0, 1482, False), (1.2, 343, False)],
)  # fmt: skip
def test_the_density_of_a_liquid_without_its_unit_causes_a_warning(density, speed, warns):
    """Helium has 0.166 kg/m3 and 1007 m/s, water 998 kg/m3 and 1482 m/s at 20 degrees Celsius."""
    tables = {
        "pump": {"part": "source", "kind": "volume_velocity", "ac": "1 cm3/s"},
        "bottle": {
            "part": "cavity",
            "volume": "1 l",
            "fluid": {"density": density, "sound_speed": speed},
            "pins": {"a": "pump.out"},
        },
        "analysis": {"type": "ac", "start": "1 Hz", "stop": "10 Hz"},
    }
    found = list_warnings(kc.load_scene, tables)[0]
    assert [f'did you mean "{density:g} g/cm3"?' in text for text in found] == [True] * warns


def test_the_density_of_a_light_solid_without_its_unit_is_rejected_with_the_unit():
    error = fails(kc.load_scene, "impact", {"sphere.density": 0.5})
    advised = re.match(r'did you mean "(.*)"\?', error.hint)[1]
    assert advised == "500 kg/m³"
    kc.load_scene("impact", {"sphere.density": advised})
    error = fails(kc.load_scene, "impact", {"sphere.density": 78500})
    assert error.hint.startswith("lower the value to 22600 kg/m³")
    kc.load_scene("impact", {"sphere.density": "22600 kg/m³"})


def test_a_large_stiffness_causes_a_warning():
    assert "spring.stiffness: 1e+12 N/m" in load(OSCILLATOR, spring__stiffness=1e12)[0]
    assert not load(OSCILLATOR, spring__stiffness="1 GN/m")


def test_an_unusual_total_q_factor_causes_a_warning():
    """qts = qms qes / (qms + qes) with qes = 2 pi fs mms re / bl^2, computed by hand."""
    qes = 2 * math.pi * 37 * 109.5 * 6 / 25.6**2
    (found,) = (text for text in load(SPEAKER, woofer__mms=109.5) if "woofer.qts" in text)
    assert f"{5.6 * qes / (5.6 + qes):.4g} is larger than usual" in found
    assert not load(SPEAKER)


def test_a_temperature_at_which_solids_melt_causes_a_warning():
    """20 kW through 0.3 mm of silicon and a film of 1 kW/(m2 K) on 25 mm2: above 800 kK."""
    film = 20e3 / (1e3 * 25e-6)
    found, result = list_warnings(kc.run, HEATER, overrides={"load.dc": "20 kW"})
    (check,) = (check for check in result.checks if "usual range of" in check.name)
    assert film < check.value < 1.01 * film
    assert check.action == "warn"
    assert any("solids melt" in text for text in found)
    assert not any("usual" in text for text in list_warnings(kc.run, HEATER)[0])


def test_a_mass_that_moves_faster_than_sound_causes_warnings():
    """A step F on a mass without damping: x = 2 F / k and v = F / sqrt(k m)."""
    found, result = list_warnings(kc.run, OSCILLATOR, overrides={"push.pulse.high": "10 kN"})
    sizes = {check.unit: check.value for check in result.checks if "usual" in check.name}
    assert sizes["m"] == pytest.approx(2 * 1e4 / 1e3, rel=0.02)
    assert sizes["m/s"] == pytest.approx(1e4 / math.sqrt(1e3 * 25e-6), rel=0.02)
    assert sum("usual range" in text for text in found) == 2
    assert not list_warnings(kc.run, OSCILLATOR)[0]
    off = {"push.pulse.high": "10 kN", "checks.plausible": "off"}
    assert not list_warnings(kc.run, OSCILLATOR, overrides=off)[0]


def test_amplitudes_of_an_ac_analysis_are_not_checked():
    tables = {name: table for name, table in OSCILLATOR.items() if name != "analysis"}
    tables["push"] = {"part": "source", "kind": "force", "ac": "1 MN", "pins": {"out": "mass.a"}}
    tables["analysis"] = {"type": "ac", "start": "1 Hz", "stop": "10 Hz"}
    found, result = list_warnings(kc.run, tables)
    assert np.abs(result.waves["mass.x"]).max() > 100
    assert not found


def test_gravity_that_acts_on_no_part_causes_a_warning():
    (found,) = load(OSCILLATOR, gravity=9.81)
    assert "`gravity` has no effect" in found
    assert found.endswith("write  weight = true  in [mass]")
    assert not load(OSCILLATOR, gravity=9.81, mass__weight=True)
    assert not load(OSCILLATOR, gravity=0)
    assert not load("impact", gravity=9.81)  # gravity acts on its sphere
    (found,) = load(SPEAKER, gravity=9.81)
    assert found.endswith("delete the key")


def test_gravity_in_another_unit_causes_a_warning():
    (found,) = load(OSCILLATOR, gravity=9810, mass__weight=True)
    assert 'did you mean "9810 mm/s2"?' in found
    assert not load(OSCILLATOR, gravity="9810 mm/s2", mass__weight=True)


@pytest.mark.parametrize(
    ("key", "value"),
    [("push.pulse.start", "1 s"), ("push.pulse.start", "3 ms"), ("analysis.stop", "0.5 us")],
)
def test_a_pulse_after_the_end_of_the_run_causes_a_warning(key, value):
    (found,) = load(OSCILLATOR, **{key: value})
    assert found.startswith("push: the waveform begins at")
    assert "this source stays constant" in found


@pytest.mark.parametrize(
    ("wave", "count"),
    [
        ({"sine": {"frequency": "1 kHz", "start": "4 ms"}}, 1),
        ({"sine": {"frequency": "1 kHz", "start": "2 ms"}}, 0),
        ({"pwl": [[0, 1], ["5 ms", 1], ["6 ms", 0]]}, 1),
        ({"pwl": [[0, 1], ["2 ms", 1], ["6 ms", 0]]}, 0),
        ({"dc": "1 N"}, 0),
        ({"pulse": {"high": 0, "width": "1 ms", "start": "1 s"}}, 0),
    ],
)
def test_only_waveforms_that_are_constant_during_the_run_cause_a_warning(wave, count):
    push = {"part": "source", "kind": "force", "pins": {"out": "mass.a"}, **wave}
    assert len(load(OSCILLATOR | {"push": push})) == count


def test_a_logarithmic_range_from_zero_is_an_error():
    error = fails(kc.load_scene, BUZZER, {"analysis.start": 0})
    assert error.message == "a logarithmic range cannot begin at zero"
    assert 'scale = "linear"' in error.hint
    kc.load_scene(BUZZER, {"analysis.start": 0, "analysis.scale": "linear"})


def test_a_linear_range_from_zero_has_the_resonances():
    """The resonances do not depend on the first frequency of the range."""
    usual = kc.run(BUZZER).metrics
    linear = {"analysis.start": 0, "analysis.scale": "linear"}
    found = kc.run(BUZZER, overrides=linear).metrics
    for name in ("resonance_hz", "antiresonance_hz", "coupling"):
        assert found[name] == pytest.approx(usual[name], rel=1e-4)


def test_a_relative_tolerance_below_the_rounding_errors_is_an_error(cli):
    text = RESISTOR.replace('dc = "10 V"', 'sine = { frequency = "1 kHz" }')
    transient = 'type = "transient"\nstop = "1 ms"'
    Path("my.toml").write_text(text.replace('type = "op"', transient))
    found = cli("run", "my.toml", "--set", "solver.reltol=1e-20")
    assert found.exit_code == 2
    assert "raise solver.reltol to 1e-12" in found.stderr
    assert cli("run", "my.toml", "--set", "solver.reltol=1e-12").exit_code == 0


@pytest.mark.parametrize("kind", ["transient", "op"])
def test_a_division_by_zero_in_a_netlist_causes_a_warning_with_the_node(kind, tmp_path):
    """A quotient by a difference that is always zero is far above 1e15 V; a small one is not."""
    circuit = (
        "* quotient\n.subckt div in out ref\n"
        "B1 out ref V=V(in,ref)/(V(in,ref)-V(in,ref)+OFFSET)\n.ends\n"
    )
    library = tmp_path / "div.lib"
    library.write_text(circuit.replace("OFFSET", "0"))
    scene = tmp_path / "div.toml"
    scene.write_text(
        f"""
[drive]
part = "source"
dc = 1.0
[div]
part = "netlist"
file = "div.lib"
subckt = "div"
pins = {{ in = "drive.out", out = "load.a", ref = "gnd" }}
[load]
part = "resistor"
resistance = "1 kOhm"
[analysis]
type = "{kind}"
{'stop = "1 ms"' if kind == "transient" else ""}
"""
    )
    found, result = list_warnings(kc.run, scene)
    checks = {check.name: check for check in result.checks}
    assert checks["usual range of load.v"].value > 1e15
    assert any("usual range of load.v" in text and "division by zero" in text for text in found)
    library.write_text(circuit.replace("OFFSET", "1e-12"))
    assert not list_warnings(kc.run, scene)[0]


def test_a_q_factor_of_a_weakly_driven_mode_causes_a_warning():
    """A voltage hardly bends a thick ceramic on a foil, but drives its radial mode.

    With viscous damping, the Q factor falls as 1 / f. The proposed key gives the stated Q factor to
    the radial mode, as the impedance shows.
    """
    layers = [
        {"material": "brass", "diameter": "20 mm", "thickness": "0.02 mm"},
        {"material": "PZT-5A", "diameter": "20 mm", "thickness": "1 mm"},
    ]
    tables = {
        "drive": {"part": "source", "ac": 1.0},
        "disc": {"part": "disc", "layers": layers, "damping": {"quality": 50},
                 "pins": {"anode": "drive.out"}},
        "analysis": {"type": "ac", "start": "1 kHz", "stop": "200 kHz"},
    }  # fmt: skip
    for band in ({}, {"analysis.start": "50 kHz"}):
        found, result = list_warnings(kc.run, tables, overrides=band)
        (text,) = (text for text in found if "damping of disc" in text)
        (check,) = (check for check in result.checks if check.name == "damping of disc")
        bending = result.metrics["resonance_hz"] / check.value
        assert f"disc.damping.quality applies to the mode at {bending / 1e3:.1f}" in text
        assert result.metrics["quality"] == pytest.approx(50 / check.value, rel=0.03)
        key, value = re.search(r'set (\S+) = "(.+?)"', text).groups()
        found, result = list_warnings(kc.run, tables, overrides={**band, key: value})
        assert not any("damping of disc" in text for text in found)
        assert result.metrics["quality"] == pytest.approx(50, rel=0.03)
    for keys in (
        {"analysis.stop": "30 kHz"},
        {"disc.damping": {"model": "ieee176", "quality": 50}},
    ):
        found, _ = list_warnings(kc.run, tables, overrides=keys)
        assert not any("damping of disc" in text for text in found)


@pytest.mark.parametrize(
    ("damping", "words"),
    [
        ({"quality": 5e7}, "disc.damping.quality: 5e+07 is larger than usual"),
        ({"loss_factor": 1e-8}, "disc.damping.loss_factor: 1e-08 is smaller than usual"),
        ({"ratio": 1e-8}, "disc.damping.ratio: 1e-08 is smaller than usual"),
        ({"quality": 9e5}, None),
    ],
)
def test_an_unusual_q_factor_causes_a_warning(damping, words):
    tables = {**BUZZER, "disc": {**BUZZER["disc"], "damping": damping}}
    found = [text for text in list_warnings(kc.load_scene, tables)[0] if "usual" in text]
    assert len(found) == (words is not None)
    assert words is None or words in found[0]
