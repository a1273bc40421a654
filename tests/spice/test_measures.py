"""``.meas`` cards: ngspice prints the metrics of the run, from the deck that is exported."""

import re
import subprocess

import numpy as np
import pytest
from support import StageTimer, find_ngspice, prepare_deck, translate_deck, write_files

import kc2spice as kc

SWEPT = {
    "name": "divider",
    "g": {"part": "source", "dc": 1.0},
    "r": {"part": "resistor", "resistance": "2 kOhm", "pins": {"a": "g.out", "b": "low.a"}},
    "low": {"part": "resistor", "resistance": "1 kOhm"},
    "analysis": {"type": "dc", "sweep": "g.dc", "from": -3.0, "to": 6.0, "points": 31},
    "probes": {
        "largest_v": {"of": "low.v", "take": "max"},
        "least_a": {"of": "low.i", "take": "min"},
    },
}


def printed(deck, directory):
    """Measured values by name, as ngspice prints them without a raw file."""
    write_files(deck.files, directory)
    command = [find_ngspice().path, "-b", "-n", deck.main_file_name]
    text = subprocess.run(command, cwd=directory, capture_output=True, text=True, check=True).stdout
    rows = re.findall(r"(?m)^(\w+) +=\s+(\S+)", text)
    return {name: float(value) for name, value in rows}


def run(scene, directory):
    """Values that ngspice prints, and the result of the program."""
    _, deck = prepare_deck(scene, StageTimer())
    assert deck.measures
    values = printed(deck, directory)
    assert {m.name.lower() for m in deck.measures} <= values.keys()
    return deck, values, kc.run(scene)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("kick_and_catch", marks=pytest.mark.slow),
        pytest.param("harvester_bridge", marks=pytest.mark.slow),
        "buzzer_square",
    ],
)
def test_metrics_of_a_transient_are_those_that_ngspice_prints(name, tmp_path):
    deck, values, result = run(kc.load_scene(name), tmp_path)
    for measure in deck.measures:
        expected = result.metrics[measure.name]
        assert values[measure.name.lower()] == pytest.approx(expected, rel=2e-6), measure.name


def test_metrics_of_a_sweep_are_those_that_ngspice_prints(tmp_path):
    _, values, result = run(kc.load_scene(SWEPT), tmp_path)
    for name in SWEPT["probes"]:
        assert values[name] == pytest.approx(result.metrics[name], rel=2e-6)
    assert values["largest_v"] == pytest.approx(2.0, rel=1e-6)
    assert values["least_a"] == pytest.approx(-1e-3, rel=1e-6)


def test_a_resonance_is_measured_at_the_points_of_the_analysis(tmp_path):
    """The metric interpolates between the points: it is within a step of the largest of them."""
    _, values, result = run(kc.load_scene("harvester"), tmp_path)
    size = np.abs(result.waves["load.v"])
    assert values["peak_voltage_v"] == pytest.approx(size.max(), rel=2e-6)
    assert size.max() <= result.metrics["peak_voltage_v"] <= 1.05 * size.max()


def test_a_resonance_frequency_is_that_of_the_largest_point(tmp_path):
    _, values, result = run(kc.load_scene("gap_biased"), tmp_path)
    f = result.waves["frequency"].real
    for name, of in (("voltage_hz", "mass.x"), ("charge_hz", "charged_mass.x")):
        k = np.abs(result.waves[of]).argmax()
        assert values[name] == pytest.approx(f[k], rel=2e-5)  # prints six digits
        assert abs(values[name] - result.metrics[name]) <= f[k + 1] - f[k] + 2e-5 * f[k]


def test_only_the_analysis_that_a_measure_belongs_to_has_it():
    _, deck = prepare_deck(kc.load_scene("loudspeaker"), StageTimer())
    assert ".meas tran " in deck.files[deck.main_file_name]
    operating = deck.with_command(kc.deck("loudspeaker").command.__class__("op", ()))
    assert ".meas" not in operating.files[operating.main_file_name]


DISCHARGE = {
    "name": "discharge",
    "g": {"part": "source", "kind": "current", "pulse": {
        "high": "-1 mA", "width": "2 ms", "edge": "1 us", "start": "0.1 ms"}},
    "r": {"part": "resistor", "resistance": "1 kOhm", "pins": {"a": "g.out"}},
    "c": {"part": "capacitor", "capacitance": "1 uF", "pins": {"a": "g.out"}},
    "analysis": {"type": "transient", "stop": "5 ms"},
    "probes": {
        "half_s": {"of": "c.v", "take": "crossing", "level": -0.5},
        "never_s": {"of": "c.v", "take": "crossing", "level": 3.0},
        "later_v": {"of": "c.v", "at": "1 ms"},
        "first_s": {"of": "r.v", "take": "argmax"},
    },
}  # fmt: skip


def test_crossings_and_values_are_those_that_ngspice_prints(tmp_path):
    _, deck = prepare_deck(kc.load_scene(DISCHARGE), StageTimer())
    values, metrics = printed(deck, tmp_path), kc.run(DISCHARGE).metrics
    tau, begin = 1e-3, 0.1005e-3
    assert values["half_s"] == pytest.approx(metrics["half_s"], rel=2e-6)
    assert values["half_s"] == pytest.approx(begin + tau * np.log(2), rel=1e-3)
    assert values["later_v"] == pytest.approx(metrics["later_v"], rel=2e-6)
    assert "never_s" not in values  # ngspice prints that the measure failed
    assert metrics["never_s"] is None


STRETCHED = {
    "name": "stretched",
    "push": {"part": "source", "kind": "displacement", "dc": "1 um"},
    "spring": {"part": "spring", "stiffness": 100.0, "pins": {"a": "push.out"}},
    "analysis": {"type": "dc", "sweep": "push.dc", "from": "-3 um", "to": "6 um", "points": 37},
    "probes": {
        "rest_m": {"of": "push.force", "take": "crossing", "level": 1e-4},
        "largest_m": {"of": "push.force", "take": "argmax"},
        "there_n": {"of": "push.force", "at": "2.1 um"},
    },
}


def test_crossings_of_a_sweep_are_in_units_of_the_key(tmp_path):
    """The source counts in um, the key in m."""
    _, values, result = run(kc.load_scene(STRETCHED), tmp_path)
    for name, exact in {"rest_m": 1e-6, "largest_m": 6e-6, "there_n": 2.1e-4}.items():
        assert values[name] == pytest.approx(result.metrics[name], rel=2e-6), name
        assert values[name] == pytest.approx(exact, rel=1e-5), name


def test_a_resonance_of_an_impedance_is_within_a_step_of_the_fit(tmp_path):
    deck, values, result = run(kc.load_scene("buzzer_7bb_20_6"), tmp_path)
    scale, per_decade, *_ = deck.command.words
    assert scale == "dec"
    step = 10 ** (1 / float(per_decade)) - 1
    assert values["resonance_hz"] == pytest.approx(result.metrics["resonance_hz"], rel=step)


def test_an_operating_point_prints_the_values_of_its_probes(tmp_path):
    scene = {
        "name": "held",
        "push": {"part": "source", "kind": "force", "dc": "2 mN"},
        "spring": {"part": "spring", "stiffness": 100.0, "pins": {"a": "push.out"}},
        "analysis": {"type": "op"},
        "probes": {"moved_m": {"of": "push.x", "take": "final"}},
    }
    _, deck = prepare_deck(kc.load_scene(scene), StageTimer())
    text = deck.files[deck.main_file_name]
    (factor, node) = re.search(r"(?m)^\* moved_m in SI units is (\S+) times (\S+)$", text).groups()
    assert f".print op {node}" in text
    assert ".meas" not in text
    write_files(deck.files, tmp_path)
    command = [find_ngspice().path, "-b", "-n", deck.main_file_name]
    shown = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    value = float(re.search(rf"(?mi)^\s*{re.escape(node[2:-1])}\s+(\S+)$", shown)[1])
    assert value * float(factor) == pytest.approx(kc.run(scene).metrics["moved_m"], rel=2e-6)


MEASURED = {
    "ltspice": [
        ".meas TRAN half_s WHEN V(g_out)=-0.5 CROSS=1",
        ".meas TRAN later_v FIND V(g_out) AT=0.001",
        "* LTspice prints no .meas tran first_s MAX_AT v(g_out)",
    ],
    "xyce": [
        ".measure TRAN half_s WHEN V(g_out)=-0.5 CROSS=1",
        ".measure TRAN later_v FIND V(g_out) AT=0.001",
        ".measure TRAN first_s MAX V(g_out) OUTPUT=TIME",
    ],
}


@pytest.mark.parametrize("dialect", MEASURED)
def test_measurements_have_the_syntax_of_other_simulators(dialect):
    _, deck = prepare_deck(kc.load_scene(DISCHARGE), StageTimer())
    lines = translate_deck(deck, dialect).text.split("\n")
    assert set(MEASURED[dialect]) <= set(lines)
    assert "* Main metrics in SI units" in lines


def test_scales_and_magnitudes_have_the_syntax_of_other_simulators():
    _, deck = prepare_deck(kc.load_scene("gap_biased"), StageTimer())
    xyce, ltspice = (translate_deck(deck, dialect).text for dialect in ("xyce", "ltspice"))
    assert re.search(r"(?m)^\.measure AC voltage_hz MAX VM\(\w+\) OUTPUT=FREQ$", xyce)
    assert "LTspice prints no .meas ac voltage_hz MAX_AT" in ltspice
    _, deck = prepare_deck(kc.load_scene("loudspeaker"), StageTimer())
    xyce, ltspice = (translate_deck(deck, dialect).text for dialect in ("xyce", "ltspice"))
    scaled = r"(?m)^\.meas\w* TRAN (\w+) (?:PARAM |EQN \{)1e-06\*\1_raw\}?$"
    assert re.search(scaled, xyce)
    assert re.search(scaled, ltspice)


@pytest.mark.parametrize("dialect", ["ltspice", "xyce"])
def test_no_measure_scales_one_that_a_dialect_lacks(dialect):
    """Neither gives the place of a maximum of a sweep, so none is multiplied by the unit."""
    _, deck = prepare_deck(kc.load_scene(STRETCHED), StageTimer())
    text = translate_deck(deck, dialect).text
    assert re.search(r"(?m)^\.meas\w* DC rest_m (PARAM |EQN \{)1e-06\*rest_m_raw", text)
    assert not re.search(r"(?m)^\.meas.*largest_m", text)
