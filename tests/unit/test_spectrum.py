"""The frequency up to which a signal has its energy, against closed forms of its spectrum."""

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from support import (
    find_energy_frequency,
    find_highest_frequency,
    find_waveform_frequency,
    load_scene,
    make_constant_waveform,
    make_linear_waveform,
    make_pulse_waveform,
    make_sine_waveform,
)

# Each edge of height V leaves V^2 / (2 pi^2 F) above the frequency F.
BOTH_EDGES = 1e3 / np.pi**2


@pytest.mark.parametrize("train", [{}, {"period": 4e-5}, {"period": 4e-5, "count": 3}])
def test_a_rectangle_has_its_energy_below_101_over_its_width(train):
    wave = make_pulse_waveform(0.0, 5.0, 1e-3, 1e-5, 1e-10, **train)
    assert find_waveform_frequency(wave, 5e-3) == pytest.approx(BOTH_EDGES / 1e-5, rel=0.05)


def test_a_step_that_stays_has_one_edge():
    wave = make_pulse_waveform(0.0, 5.0, 0.0, 1.0, 1e-9)
    assert find_waveform_frequency(wave, 2e-3) == pytest.approx(BOTH_EDGES / 2 / 2e-3, rel=0.03)


def test_a_low_pass_absorbs_the_blocked_power():
    """A rectangle of the width w behind a time constant T has the spectrum ``sinc(f w)^2 / (1 +
    (2 pi f T)^2)``; ``exp(-t / T)`` the energy ``1 - (2 / pi) atan(2 pi F T)`` above F."""
    width, constant = 1e-6, 1e-5
    found = find_waveform_frequency(
        make_pulse_waveform(0.0, 1.0, 0.0, width, 1e-10), 5e-3, constant
    )

    def density(f):
        return np.sinc(f * width) ** 2 / (1 + (2 * np.pi * f * constant) ** 2)

    f = np.linspace(0.0, 2e8, 2_000_001)
    risen = cumulative_trapezoid(density(f), f)
    assert found == pytest.approx(f[np.searchsorted(risen, 0.999 * risen[-1])], rel=0.05)
    t = np.linspace(0.0, 20 * constant, 200_001)
    direct = find_energy_frequency(t, np.exp(-t / constant) * (t > 0))
    assert direct == pytest.approx(np.tan(0.999 * np.pi / 2) / (2 * np.pi * constant), rel=0.05)


def test_a_sine_has_its_frequency_and_a_constant_has_none():
    assert find_waveform_frequency(make_sine_waveform(1.0, 7e3), 1.0) == 7e3
    assert find_waveform_frequency(make_constant_waveform(3.0), 1.0) == 0.0
    assert find_waveform_frequency(make_linear_waveform([(2.0, 0.0), (3.0, 1.0)]), 1.0) == 0.0


@pytest.mark.parametrize(
    ("analysis", "exact"),
    [
        ({"type": "ac", "start": 1e3, "stop": 5e4}, 5e4),
        ({"type": "op"}, 0.0),
        ({"type": "transient", "stop": 1e-3}, 8e4),
        ({"type": "transient", "stop": 3e-4}, BOTH_EDGES / 2e-4),
    ],
)
def test_the_highest_frequency_of_a_scene_is_that_of_its_drives(analysis, exact):
    width = 2e-4 if analysis.get("stop") == 3e-4 else 1.0
    scene = load_scene({
        "name": "driven",
        "sine": {"part": "source", "sine": {"frequency": 8e4}, "ac": 1.0,
                 "pins": {"out": "ohm.a"}},
        "push": {"part": "source", "kind": "current", "pins": {"out": "load.a"},
                 "pulse": {"width": width, "edge": 1e-9}},
        "ohm": {"part": "resistor", "resistance": 1.0},
        "load": {"part": "resistor", "resistance": 1.0},
        "analysis": analysis,
    })  # fmt: skip
    assert find_highest_frequency(scene) == pytest.approx(exact, rel=0.05)
