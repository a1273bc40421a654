"""Time points that a run is expected to take for the ringing of a body."""

import warnings
from dataclasses import replace

import device
import numpy as np
import pytest
from support import StageTimer, load_scene, make_deck, prepare_deck, ringing_time, run_deck

KICK = {
    "name": "rings", "kick": {"drive": {"voltage": "100 V", "start": "1 us"}}, "contact": {},
    "sphere": {}, "solver": {"stop": "60 us"},
}  # fmt: skip


def chip(damping):
    """The made-up chip with four modes of 270 to 900 kHz, and of the same compliances."""
    made, omega = device.chip(modes=4), 2 * np.pi * np.geomspace(270e3, 900e3, 4)
    gain = made.gain * (omega / made.omega)[:, None]
    return replace(made, omega=omega, damp=damping / np.pi / 250e3 * omega**2, gain=gain)


@pytest.mark.parametrize("damping", [0.0, 1e-3, 1e-2])
def test_ngspice_needs_the_expected_number_of_time_points(damping, tmp_path):
    """Modes ring for 59 us and longer, or die away within it."""
    model = chip(damping)
    scene = load_scene({**KICK, "solver": {"stop": "60 us"}})
    build = device.built(scene, model)
    deck = make_deck(build)
    taken = run_deck(deck, tmp_path)["time"].size
    expected = ringing_time.estimate_ringing("kick", build.models["kick"], 59e-6, deck.reltol)
    assert 0.75 < expected.points / taken < 1.35


DISC = {
    "name": "warm",
    "disc": {
        "part": "disc", "pins": {"anode": "drive.out", "heat": "air.a"},
        "damping": {"quality": 500},
        "layers": [{"material": "PZT-8", "diameter": "25 mm", "thickness": "3 mm"}],
    },
    "air": {"part": "thermal_resistor", "resistance": "80 K/W"},
    "drive": {"part": "source", "sine": {"amplitude": "2 V", "frequency": "90 kHz"}},
    "analysis": {"type": "transient", "stop": "20 ms"},
}  # fmt: skip


def test_a_long_transient_of_self_heating_is_advised_to_compute_the_mean_power():
    build, deck = prepare_deck(load_scene(DISC), StageTimer())
    with pytest.warns(UserWarning, match="this run needs at least") as found:
        ringing_time.warn_of_long_run(build, deck)
    text = str(found.list[-1].message)
    assert "read the mean power from a probe of disc.power in an `ac` analysis" in text
    cold = {name: table for name, table in DISC.items() if name != "air"}
    cold["disc"] = DISC["disc"] | {"pins": {"anode": "drive.out"}}
    # the pin ``heat`` of this part receives heat
    silicon = {"material": "silicon", "thickness": "0.3 mm", "area": "25 mm2"}
    cold["board"] = {"part": "heat_body", "layers": [silicon], "sources": {"heat": "top"},
                     "isothermal": {"case": "bottom"},
                     "pins": {"heat": "w.out", "case": "gnd"}}  # fmt: skip
    cold["w"] = {"part": "source", "kind": "heat_flow", "dc": "0.1 W"}
    build, deck = prepare_deck(load_scene(cold), StageTimer())
    with pytest.warns(UserWarning, match="this run needs at least") as found:
        ringing_time.warn_of_long_run(build, deck)
    assert "mean power" not in str(found.list[-1].message)


def test_a_long_ringing_is_announced_before_the_run(monkeypatch):
    build = device.built(load_scene(KICK), chip(0.0))
    monkeypatch.setattr(ringing_time, "MANY_POINTS", 2e3)
    with pytest.warns(UserWarning, match=r"kick rings at frequencies up to .*Hz .* s of CPU time"):
        ringing_time.warn_of_long_run(build, make_deck(build))
    damped = device.built(load_scene(KICK), chip(0.05))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ringing_time.warn_of_long_run(damped, make_deck(damped))


def test_a_run_of_many_short_steps_is_announced_with_their_cause():
    """A diode is not linear, so that 10 s take a million steps of at most 10 us."""
    scene = {
        "name": "slow",
        "source": {"part": "source", "sine": {"amplitude": 1.0, "frequency": 0.2}},
        "d": {"part": "diode", "pins": {"anode": "source.out", "cathode": "load.a"}},
        "load": {"part": "resistor", "resistance": 1e3, "pins": {"b": "gnd"}},
        "analysis": {"type": "transient", "stop": 10.0},
    }
    build, deck = prepare_deck(load_scene(scene), StageTimer())
    with pytest.warns(UserWarning, match=r"1e\+06 time points.* is 10 .s \(parts that are no"):
        ringing_time.warn_of_long_run(build, deck)
    shorter = {**scene, "analysis": {"type": "transient", "stop": 2.0}}
    build, deck = prepare_deck(load_scene(shorter), StageTimer())
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ringing_time.warn_of_long_run(build, deck)
