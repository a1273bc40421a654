"""The position sensor against closed forms: its pole, its offset, the statistics of its noise."""

import numpy as np
import pytest
from device import deck_of
from support import StageTimer, Waveforms, build_models, load_scene, run_deck, solve_laws

import kc2spice as kc

BANDWIDTH, OFFSET, STEP = 50e3, 0.3e-6, 2e-6  # Hz, m, m


def sensed(stop, **eye):
    """A sensor that looks at a prescribed displacement: a step of 2 um at 10 us."""
    return load_scene({
        "name": "sensed",
        "solver": {"stop": stop, "max_step": 1e-7, "reltol": 1e-6},
        "move": {
            "part": "source", "kind": "displacement",
            "pulse": {"high": STEP, "start": 10e-6, "width": 1.0, "edge": 1e-9},
        },
        "eye": {"part": "sensor", "bandwidth": BANDWIDTH, "pins": {"of": "move.out"}, **eye},
    })  # fmt: skip


def test_noise_has_its_rms_and_is_white_between_samples(tmp_path):
    rms = 20e-9
    waves = run_deck(deck_of(sensed(20e-3, noise=rms)), tmp_path)
    step = 0.5 / BANDWIDTH
    at = step * np.arange(100, round(20e-3 / step) - 2)
    noise = np.interp(at, waves["time"], waves["eye.y"]) - STEP
    count = noise.size
    # standard errors of mean, rms and correlation of independent normal samples, four of each
    assert abs(noise.mean()) < 4 * rms / np.sqrt(count)
    assert noise.std() == pytest.approx(rms, rel=4 / np.sqrt(2 * count))
    neighbours = np.mean(noise[1:] * noise[:-1]) / rms**2
    assert abs(neighbours) < 4 / np.sqrt(count)


def test_the_reading_follows_a_step_by_its_pole_and_offset_in_ngspice_and_by_its_law():
    scene = sensed(100e-6, offset=OFFSET)
    ngspice = kc.run(scene).waves
    law = solve_laws(
        build_models(scene, StageTimer()), Waveforms({"time": ngspice["time"]}, {})
    ).results
    # ngspice's steps; the edge of a nanosecond, of which half is a delay
    for waves, limit in ((ngspice, 1e-3), (law, 1e-7)):
        late = np.maximum(waves["time"] - 10e-6 - 0.5e-9, 0.0)
        exact = OFFSET + STEP * (1 - np.exp(-2 * np.pi * BANDWIDTH * late))
        after = abs(waves["time"] - 10e-6) > 1.1e-9
        np.testing.assert_allclose(waves["eye.y"][after], exact[after], atol=limit * STEP)


@pytest.mark.parametrize("eye", [None, {"offset": 2e-6}])
def test_control_through_a_sensor_equals_the_laws(eye):
    """Switched off for 0.3 ms: its integral begins anew."""
    data = {
        "name": "held",
        "sphere": {"height": 1.4e-3},
        "catch": {"positions": 11, "y_min": 1.5e-3, "y_max": 3.5e-3},
        "control": {
            "enable_at": [20e-6, 0.9e-3],
            "disable_at": [0.6e-3],
            "ki": 1e4,
            "form": "ideal",
        },
        "solver": {"stop": 1.5e-3, "max_step": 2e-6, "reltol": 1e-6},
    }
    if eye:
        data["eye"] = {"part": "sensor", "bandwidth": 1e6, "pins": {"of": "sphere.y"}, **eye}
        data["control"]["pins"] = {"y": "eye.out"}
    scene = load_scene(data)
    ngspice = kc.run(scene).waves
    build = build_models(scene, StageTimer())
    law = solve_laws(build, Waveforms({"time": ngspice["time"]}, {})).results
    for name, limit in (("sphere.y", 1e-9), ("control.error", 1e-9), ("sphere.v", 1e-5)):
        found = np.interp(law["time"], ngspice["time"], ngspice[name])
        np.testing.assert_allclose(found, law[name], atol=limit, err_msg=name)
    assert abs(law["control.error"][-1]) < 1e-5
