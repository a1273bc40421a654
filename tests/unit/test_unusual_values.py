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
        ({"pulse": {"high": 0, "width": "1 ms", "start": "1 s"}}, 1),
    ],
)
def test_only_waveforms_that_are_constant_during_the_run_cause_a_warning(wave, count):
    push = {"part": "source", "kind": "force", "pins": {"out": "mass.a"}, **wave}
    assert len(load(OSCILLATOR | {"push": push})) == count


def test_a_logarithmic_range_from_zero_is_an_error():
    error = fails(kc.load_scene, BUZZER, {"analysis.start": 0})
    assert error.message == "a logarithmic range cannot begin at zero"
    assert """'analysis.scale': "linear"  in the overrides""" in error.hint
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
    assert "write  --set solver.reltol=0.0001" in found.stderr
    assert cli("run", "my.toml", "--set", "solver.reltol=0.0001").exit_code == 0
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


@pytest.mark.parametrize(
    ("ceramic", "damping", "words"),
    [
        # TP-226 states a Q factor of 75 for PZT-5A and of 1000 for PZT-8
        ("PZT-5A", {"quality": 50_000}, "more than 100 times the Q factor of layers[1] (PZT-5A)"),
        ("PZT-5A", {"ratio": 1e-5}, "disc.damping.ratio: a Q factor of 50000"),
        ("PZT-5A", {"quality": 7_000}, None),
        ("PZT-8", {"quality": 50_000}, None),
        ("AlN", {"quality": 500_000}, None),
    ],
)
def test_a_q_factor_far_above_that_of_the_ceramic_causes_a_warning(ceramic, damping, words):
    """Crystals such as AlN, quartz and silicon have no tabulated limit of the Q factor."""
    brass, layer = BUZZER["disc"]["layers"]
    layers = [brass, layer | {"material": ceramic}]
    tables = {**BUZZER, "disc": {**BUZZER["disc"], "layers": layers, "damping": damping}}
    found = [text for text in list_warnings(kc.load_scene, tables)[0] if "Q factor" in text]
    assert len(found) == (words is not None)
    assert words is None or words in found[0]


SOUNDING = {
    **BUZZER,
    "disc": {**BUZZER["disc"], "pins": {"anode": "drive.out", "front_face": "front.face"}},
    "drive": {"part": "source", "ac": "1 V"},
    "front": {"part": "radiation", "motion": "piston", "radius": "10 mm"},
    "probes": {"current_a": {"of": "disc.current", "take": "max"}},
}


@pytest.mark.parametrize("common", ["drive.out", "gnd"])
def test_a_short_circuited_body_causes_a_warning(common):
    tables = {name: table for name, table in SOUNDING.items() if name != "probes"}
    tables["load"] = {"part": "resistor", "resistance": "1 kOhm", "pins": {"a": "drive.out"}}
    tables["disc"] = SOUNDING["disc"] | {
        "pins": {"anode": common, "cathode": common, "front_face": "front.face"}
    }
    (text,) = load(tables)
    assert f"both anode and cathode are connected to {common}" in text
    tables["disc"] = SOUNDING["disc"]
    assert load(tables) == []


def test_a_grounded_feedback_electrode_causes_no_warning():
    assert load("buzzer_ft_39t_2_5b1") == []


def test_the_terminals_of_a_shorted_coil_are_named():
    """A short circuit brakes a voice coil, so a scene may state it."""
    coil = {
        "coil": {"part": "voice_coil", "resistance": "6 Ohm", "inductance": "0.5 mH",
                 "bl": "5 N/A", "cms": "1 mm/N", "damping": "1 N s/m",
                 "pins": {"plus": "gnd", "minus": "gnd", "a": "cone.a"}},
        "cone": {"part": "mass", "mass": "10 g"},
        "push": {"part": "source", "kind": "force", "ac": "1 N", "pins": {"out": "cone.a"}},
        "analysis": {"type": "ac", "start": "1 Hz", "stop": "1 kHz"},
    }  # fmt: skip
    (text,) = load(coil)
    assert "both plus and minus are connected to gnd" in text


@pytest.mark.parametrize(
    ("band", "words"),
    [
        ({"analysis.stop": "3 kHz"}, "is above the frequency range; raise analysis.stop"),
        ({"analysis.start": "9 kHz"}, "is below the frequency range; lower analysis.start"),
        ({}, None),
    ],
)
def test_missing_metrics_of_a_resonance_have_a_reason(band, words):
    found, result = list_warnings(kc.run, SOUNDING, overrides=band)
    missing = [text for text in found if "metrics of its resonance are missing" in text]
    assert ("resonance_hz" in result.metrics) == (words is None)
    assert len(missing) == (words is not None)
    if words is not None:
        assert words in missing[0]
        place = float(re.search(r"near ([\d.]+) kHz", missing[0])[1])
        assert place == pytest.approx(1e-3 * kc.run(SOUNDING).metrics["resonance_hz"], rel=0.01)


def test_a_zero_response_has_a_reason():
    """The source drives only a resistor, and another resistor loads the disc."""
    tables = {
        **SOUNDING,
        "load": {"part": "resistor", "resistance": "1 kOhm", "pins": {"a": "drive.out"}},
        "bleed": {"part": "resistor", "resistance": "1 kOhm"},
        "disc": SOUNDING["disc"] | {"pins": {"anode": "bleed.a", "front_face": "front.face"}},
    }
    found, _ = list_warnings(kc.run, tables)
    assert any("voltage and current are zero at all frequencies" in text for text in found)
    assert any(text.startswith("probes.current_a: disc.current is zero") for text in found)
    found, _ = list_warnings(kc.run, SOUNDING)
    assert not any("zero" in text for text in found)


def test_a_gravity_that_acts_upwards_causes_a_warning():
    ball = {
        "ball": {"part": "mass", "mass": "1 g", "weight": True, "pins": {"a": "hold.a"}},
        "hold": {"part": "spring", "stiffness": "1 kN/m"},
        "analysis": {"type": "op"},
    }
    (text,) = load(ball, gravity="-9.81 m/s2")
    assert "-9.81 m/s2 acts upwards" in text
    assert load(ball, gravity="9.81 m/s2") == []
    # the position of a mass on a spring is -m g / k
    _, result = list_warnings(kc.run, ball, overrides={"gravity": -9.81})
    assert result.waves["ball.x"] == pytest.approx(1e-3 * 9.81 / 1e3, rel=1e-6)


@pytest.mark.parametrize(
    ("tables", "key", "text", "usual"),
    [
        (BUZZER, "analysis.start", "1 mHz", "1 kHz"),
        (BUZZER, "disc.damping", {"quality": 50, "at": "6 mHz"}, {"quality": 50, "at": "6 kHz"}),
        (OSCILLATOR, "push", {"part": "source", "kind": "force", "pins": {"out": "mass.a"},
                              "sine": {"amplitude": "1 mN", "frequency": "2 mHz"}}, None),
    ],
)  # fmt: skip
def test_a_frequency_in_millihertz_that_may_mean_megahertz_causes_a_warning(
    tables, key, text, usual
):
    found = [item for item in load(tables, **{key: text}) if "millihertz" in item]
    assert len(found) == 1
    assert f"{key}" in found[0]
    assert "MHz" in found[0]
    if usual is not None:
        assert not any("millihertz" in item for item in load(tables, **{key: usual}))


def test_a_slow_analysis_in_millihertz_causes_no_warning():
    slow = {"analysis.start": "1 mHz", "analysis.stop": "10 Hz"}
    assert not any("millihertz" in text for text in list_warnings(kc.load_scene, SPEAKER, slow)[0])


def test_a_modulus_in_millipascal_is_not_plausible():
    error = fails(kc.load_scene, "sphere_on_beam", {"contact.modulus": "110 mPa",
                                                    "checks.plausible": "fail"})  # fmt: skip
    assert error.message.startswith("this value is smaller than plausible: moduli")


def test_a_modulus_without_the_law_of_hertz_has_no_effect():
    found = load("impact", contact__modulus="40 GPa")
    assert any("the key `modulus` has no effect" in text for text in found)


@pytest.mark.parametrize(("radius", "count"), [("10 mm", 0), ("10.5 mm", 0), ("30 mm", 1)])
def test_a_piston_larger_than_the_face_causes_a_warning(radius, count):
    found, _ = list_warnings(kc.run, SOUNDING, overrides={"front.radius": radius})
    larger = [text for text in found if "is larger than disc.front_face" in text]
    assert len(larger) == count
    assert count == 0 or "a radius of 10 mm" in larger[0]


SILENT_DISC = """[disc]
part = "disc"
layers = [
  { material = "brass", diameter = "20 mm", thickness = "0.2 mm" },
  { material = "PZT-5A", diameter = "15 mm", thickness = "0.22 mm" },
]
support = { node = "13 mm" }
damping = { quality = 50 }
pins = { cathode = "gnd" }
[analysis]
type = "transient"
stop = "0.5 ms"
"""
SERIES = """[series]
part = "resistor"
resistance = "1 kOhm"
pins = { a = "gate.out" }
[gate]
part = "source"
pulse = { high = "5 V", width = "76.9 us", period = "153.8 us", edge = "0.1 us" }
[probes]
swing_m = { of = "disc.u.centre", take = "peak_to_peak" }
"""


def test_a_scene_without_a_drive_proposes_a_source_that_drives_it(tmp_path):
    path = tmp_path / "disc.toml"
    path.write_text(SILENT_DISC)
    (said,), _ = list_warnings(kc.run, path)
    assert said.startswith("all results are zero, because nothing drives this scene")
    table, *keys = said.partition("add  ")[2].replace("and below it", "and").split("  and  ")
    path.write_text(SILENT_DISC + "\n".join([table, *keys]))
    said, result = list_warnings(kc.run, path)
    assert not any("zero" in text for text in said)
    assert np.ptp(result.waves["disc.voltage"]) > 0.5


def test_a_disc_without_a_source_proposes_the_pin_that_nothing_joins(tmp_path):
    path = tmp_path / "disc.toml"
    path.write_text(SILENT_DISC + SERIES)
    (said,), result = list_warnings(kc.run, path)
    assert result.metrics["swing_m"] == 0
    assert "all results of disc are zero" in said
    assert "`series.b` is on gnd, because no pin is connected to it" in said
    join = said.partition("add  ")[2].partition("  to the pins of disc")[0]
    path.write_text(SILENT_DISC.replace("{ cathode", f"{{ {join}, cathode") + SERIES)
    said, result = list_warnings(kc.run, path)
    assert not said
    assert result.metrics["swing_m"] > 1e-9


@pytest.mark.parametrize(
    "part",
    [
        {"part": "mass", "mass": "25 mg", "velocity": "0.1 m/s"},
        {"part": "mass", "mass": "25 mg", "weight": True},
    ],
)
def test_initial_motion_and_weight_drive_a_scene(part):
    scene = {key: OSCILLATOR[key] for key in ("spring", "analysis")} | {"mass": part}
    assert not any("zero" in text for text in list_warnings(kc.run, scene)[0])


@pytest.mark.parametrize(
    ("wave", "words"),
    [
        ({"pulse": {"high": "5 mN", "low": "5 mN", "width": "1 ms", "edge": "10 us"}},
         "`pulse.low` and `pulse.high` are both 5 mN, so this source is constant"),
        ({"sine": {"amplitude": 0, "frequency": "1 kHz"}}, "`sine.amplitude` is 0"),
        ({"pwl": [[0, 2e-3], ["1 ms", 2e-3]]}, "all points of `pwl` have the value 2 mN"),
    ],
    ids=["pulse", "sine", "pwl"],
)  # fmt: skip
def test_a_constant_waveform_prints_a_warning(wave, words):
    push = {"part": "source", "kind": "force", "pins": {"out": "mass.a"}}
    with pytest.warns(UserWarning, match=re.escape(words)):
        kc.load_scene({**OSCILLATOR, "push": push | wave})


def test_a_constant_voltage_has_no_frequency_content(tmp_path):
    path = tmp_path / "disc.toml"
    path.write_text(SILENT_DISC.replace("{ cathode", '{ anode = "series.b", cathode') + SERIES)
    (said,), _ = list_warnings(kc.run, path, overrides={"gate.pulse.low": "5 V"})
    assert "`pulse.low` and `pulse.high` are both 5 V" in said


@pytest.mark.parametrize(
    ("scene", "key", "value", "proposed"),
    [
        ("buzzer_7bb_20_6", "listener.distance", 100, '"100 mm"'),
        ("buzzer_7bb_20_6", "listener.distance", "0.1 mm", "is the unit right?"),
        ("air_transducer", "listener.distance", 300, '"300 mm"'),
        ("comb_resonator", "comb.gap", 2, '"2 mm"'),
    ],
)
def test_a_length_in_a_wrong_unit_prints_a_warning(scene, key, value, proposed):
    with pytest.warns(UserWarning, match=re.escape(key)) as found:
        kc.load_scene(scene, {key: value})
    assert any(proposed in str(item.message) for item in found)
