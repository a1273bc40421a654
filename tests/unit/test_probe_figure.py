"""Figure of probed results: levels over frequency, waves over time, one panel for each unit."""

import math

import numpy as np
import pytest
from support import ProbeKeys, SoundLevel, Waveforms, plot_probes

FREQUENCY = np.array([100.0, 1000.0, 10_000.0])
PRESSURE = np.array([0.02 + 0.0j, 0.0, -0.2j])
SPL = ProbeKeys(of="ear.pressure", take="spl")


def draw(probes, data, levels):
    units = {"ear.pressure": "Pa", "cone.x": "m"}
    (figure,) = plot_probes(probes, Waveforms(data, {}), units, levels)
    return figure


@pytest.mark.parametrize(("reference", "words"), [(20e-6, "20 µPa"), (1e-6, "1 µPa")])
def test_a_response_is_drawn_as_its_level(reference, words):
    """20 log10 of the rms value, which is the amplitude divided by the square root of 2."""
    data = {"frequency": FREQUENCY, "ear.pressure": PRESSURE}
    figure = draw({"level_db": SPL}, data, {"level_db": SoundLevel(reference, 76.99)})
    (panel,) = figure.panels
    ((curve,), _) = panel.curves, figure.main
    assert panel.y == f"level in dB re {words}"
    assert panel.log_x
    assert not panel.log_y
    expected = 20 * math.log10(0.2 / math.sqrt(2) / reference)
    assert curve.y[[0, 2]] == pytest.approx([expected - 20, expected])
    assert np.isnan(curve.y[1])  # silence has no level
    assert figure.title == "Probed results: level 76.99 dB"
    assert words in figure.caption


def test_a_wave_is_drawn_as_a_pressure_and_its_level_is_in_the_title():
    data = {"time": np.array([0.0, 1e-3]), "ear.pressure": np.array([0.0, 0.3])}
    figure = draw({"level_db": SPL}, data, {"level_db": SoundLevel(20e-6, 80.5)})
    (panel,) = figure.panels
    assert panel.y == "value in Pa"
    assert panel.curves[0].y == pytest.approx([0.0, 0.3])
    assert figure.title == "Probed results: level 80.5 dB"


def test_a_level_and_an_amplitude_of_one_pressure_have_two_panels():
    probes = {
        "level_db": SPL,
        "peak_pa": ProbeKeys(of="ear.pressure"),
        "x_m": ProbeKeys(of="cone.x"),
    }
    data = {"frequency": FREQUENCY, "ear.pressure": PRESSURE, "cone.x": 1e-6 * PRESSURE}
    figure = draw(probes, data, {"level_db": SoundLevel(20e-6, 70.0)})
    labels = ["level in dB re 20 µPa", "magnitude in Pa", "magnitude in m"]
    assert [panel.y for panel in figure.panels] == labels
    assert figure.panels[1].curves[0].y == pytest.approx(np.abs(PRESSURE))


def test_a_level_marks_the_frequency_that_a_probe_reads():
    probe = ProbeKeys(of="ear.pressure", take="spl", at=1000.0)
    data = {"frequency": FREQUENCY, "ear.pressure": PRESSURE + 0.1}
    figure = draw({"level_db": probe}, data, {"level_db": SoundLevel(20e-6)})
    ((place, name),) = figure.panels[0].marks
    assert (place, name) == (pytest.approx(1.0), "level_db")  # kHz
    assert figure.title == "Probed results: level"
