"""``.meas`` cards: ngspice prints the metrics of the run, from the deck that is exported."""

import re
import subprocess

import numpy as np
import pytest

import kc2spice as kc
from kc2spice.core.progress import Clock
from kc2spice.sim.ngspice import find_ngspice, write_files
from kc2spice.workflow.decks import prepared

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
    command = [find_ngspice().path, "-b", "-n", deck.main]
    text = subprocess.run(command, cwd=directory, capture_output=True, text=True, check=True).stdout
    rows = re.findall(r"(?m)^(\w+) +=\s+(\S+)", text)
    return {name: float(value) for name, value in rows}


def run(scene, directory):
    """Values that ngspice prints, and the result of the program."""
    _, deck = prepared(scene, Clock())
    assert deck.measures
    values = printed(deck, directory)
    assert {m.name.lower() for m in deck.measures} <= values.keys()
    return deck, values, kc.run(scene)


@pytest.mark.parametrize("name", ["kick_and_catch", "harvester_bridge", "buzzer_square"])
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
    _, deck = prepared(kc.load_scene("loudspeaker"), Clock())
    assert ".meas tran " in deck.files[deck.main]
    operating = deck.with_command(kc.deck("loudspeaker").command.__class__("op", ()))
    assert ".meas" not in operating.files[operating.main]
