"""Checks of what drivers and netlists of users give."""

import numpy as np
import pytest
from device import both, models
from support import (
    CoilLoad,
    LinearDrive,
    PwmDrive,
    SimulationError,
    load_scene,
    make_deck,
    simulate_deck,
)

COILS = CoilLoad(inductance=73e-3, resistance=3192.0, current=0.1)
CHIP = {"part": "capacitor", "capacitance": 10e-9}
WINDINGS = {
    "coils": {"part": "inductor", "inductance": COILS.inductance,
              "pins": {"a": "driver.drive", "b": "copper.a"}},
    "copper": {"part": "resistor", "resistance": COILS.resistance, "pins": {"b": "driver.ret"}},
}  # fmt: skip


def run_driver(tmp_path, kind, keys, source, analysis, load, **tables):
    """Checks by name, and waveforms, of a driver whose command is a source."""
    build = models({
        "name": "driven", "analysis": analysis, "solver": {"reltol": 1e-5},
        "driver": {"part": kind, **keys},
        "command": {"part": "source", "pins": {"out": "driver.command"}, **source},
        **load, **tables,
    })  # fmt: skip
    run = simulate_deck(build, make_deck(build), tmp_path)
    return {check.name: check for check in run.verdict.checks}, run.waves


def at_output(load):
    """A load between the output of a driver and ground."""
    return {"load": {**load, "pins": {"a": "driver.out", "b": "gnd"}}}


@pytest.mark.parametrize(("keys", "low"), [({}, -10.0), ({"negative_rail": "-15 V"}, -15.0)])
def test_a_sine_clips_at_the_negative_rail(keys, low, tmp_path):
    """A sine of 20 V is below the rail for ``1/2 - asin(rail/20 V)/pi`` of each period."""
    sine = {"sine": {"amplitude": 20.0, "frequency": 1e4}}
    analysis = {"type": "transient", "stop": 3e-4}
    checks, waves = run_driver(tmp_path, "amplifier", keys, sine, analysis, at_output(CHIP))
    assert waves["driver.out"].min() == pytest.approx(low, abs=0.01)
    assert waves["driver.out"].max() == pytest.approx(20.0, rel=1e-3)  # gain 1
    check = checks["clipping of driver"]
    below = np.arcsin(-low / 20)
    assert check.value == pytest.approx(0.5 - below / np.pi, rel=0.01)
    assert not check.passed
    assert not check.is_fatal
    assert f"−{-low:g} V" in check.advice
    start = (np.pi + below) / (2 * np.pi * 1e4)
    assert float(check.advice.partition("from ")[2].split()[0]) == pytest.approx(
        1e6 * start, abs=0.4
    )
    assert "driver.negative_rail" in check.advice


def test_a_rail_below_the_command_does_not_clip(tmp_path):
    sine = {"sine": {"amplitude": 20.0, "frequency": 1e4}}
    analysis = {"type": "transient", "stop": 3e-4}
    keys = {"negative_rail": -25.0}
    checks, waves = run_driver(tmp_path, "amplifier", keys, sine, analysis, at_output(CHIP))
    assert waves["driver.out"].min() == pytest.approx(-20.0, rel=1e-3)
    assert checks["clipping of driver"].value == 0.0


def test_the_law_of_an_amplifier_has_its_negative_rail(tmp_path):
    waves, exact, failed = both(load_scene({
        "name": "driven", "analysis": {"type": "transient", "stop": 1e-4},
        "driver": {"part": "amplifier", "negative_rail": -15.0},
        "command": {"part": "source", "sine": {"amplitude": 20.0, "frequency": 1e4},
                    "pins": {"out": "driver.command"}},
        **at_output(CHIP),
    }), tmp_path)  # fmt: skip
    assert [check.name for check in failed] == ["clipping of driver"]
    assert exact["driver.out"].min() == pytest.approx(-15.0, abs=0.01)
    assert waves["driver.out"].min() == pytest.approx(-15.0, abs=0.01)


def test_checks_of_clipping_can_fail_a_run(tmp_path):
    sine = {"sine": {"amplitude": 20.0, "frequency": 1e4}}
    with pytest.raises(SimulationError, match="share of time clipped, driver"):
        run_driver(tmp_path, "amplifier", {}, sine, {"type": "transient", "stop": 1e-4},
                   at_output(CHIP), checks={"saturation": "fail"})  # fmt: skip


@pytest.mark.parametrize(("rail", "share"), [(15.0, 0.5), (20.0, 0.0)])
def test_a_charge_drive_without_enough_voltage_clips(rail, share, tmp_path):
    """10 V command 1.5 uC: 15 V across 100 nF and 1.5 V across 1 uF, from half of the run on."""
    step = {"pulse": {"high": 10.0, "width": 1.0, "edge": 1e-6, "start": 5e-4}}
    load = {"part": "capacitor", "capacitance": 100e-9,
            "pins": {"a": "driver.anode", "b": "driver.cathode"}}  # fmt: skip
    checks, _ = run_driver(tmp_path, "charge_drive", {"rail": rail}, step,
                           {"type": "transient", "stop": 1e-3}, {"load": load})  # fmt: skip
    assert checks["clipping of driver"].value == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize(
    ("kind", "keys"), [("linear_drive", {}), ("pwm_drive", {"frequency": 1e5})]
)
@pytest.mark.parametrize(("rail", "clips"), [(100.0, True), (400.0, False)])
def test_a_current_source_without_enough_voltage_clips(
    kind, keys, rail, clips, tmp_path, monkeypatch
):
    """50 mA through 3292 Ohm are 165 V, requested from a tenth of the run on."""
    for driver in (LinearDrive, PwmDrive):
        monkeypatch.setattr(driver, "compute_coil_load", lambda self, part, build: COILS)
    step = {"pulse": {"high": 5.0, "width": 1.0, "edge": 1e-6, "start": 5e-5}}
    checks, _ = run_driver(tmp_path, kind, keys | {"rail": rail}, step,
                           {"type": "transient", "stop": 5e-4}, WINDINGS)  # fmt: skip
    share = 0.9 if clips else 0.0
    assert checks["clipping of driver"].value == pytest.approx(share, abs=0.03)


def test_dc_sweeps_and_operating_points_report_clipping(tmp_path):
    """Of -20, -15, … 20 V, the points -20 and -15 V are below the rail of -10 V."""
    sweep = {"type": "dc", "sweep": "command.dc", "from": -20.0, "to": 20.0, "points": 9}
    checks, waves = run_driver(tmp_path, "amplifier", {}, {}, sweep, at_output(CHIP))
    np.testing.assert_allclose(waves["driver.out"], np.maximum(waves.scale, -10.0), atol=0.01)
    assert checks["clipping of driver"].value == pytest.approx(2 / 9)
    source, op = {"dc": 200.0}, {"type": "op"}
    checks, _ = run_driver(tmp_path, "amplifier", {}, source, op, at_output(CHIP))
    assert checks["clipping of driver"].value == 1.0
    assert "120 V" in checks["clipping of driver"].advice


AC = {"type": "ac", "start": 1e3, "stop": 1e5, "points": 20}


@pytest.mark.parametrize(
    ("bias", "distance", "key"), [(0.0, 10.0, "negative_rail"), (80.0, 40.0, "rail")]
)
@pytest.mark.parametrize("ratio", [0.9, 1.1])
def test_amplitudes_are_compared_with_the_nearer_rail(bias, distance, key, ratio, tmp_path):
    source = {"dc": bias, "ac": ratio * distance}
    checks, _ = run_driver(tmp_path, "amplifier", {}, source, AC, at_output(CHIP))
    check = checks["output voltage of driver"]
    assert check.limit == pytest.approx(distance, rel=1e-3)
    assert check.value == pytest.approx(ratio * distance, rel=3e-3)  # a pole at 2 MHz
    assert check.passed == (ratio < 1)
    assert f"driver.{key}" in check.advice
    assert checks["clipping of driver"].passed


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_amplitudes_are_compared_with_current_limit_and_slew_rate(factor, tmp_path):
    """``i = v j w C / (1 + j w R C)`` into 2 Ohm and 1 uF, and ``w |v + 0.1 Ohm i|``, at 100 kHz.

    The slew rate limits the voltage before the output resistance of 0.1 Ohm.
    """
    w, volts = 2e5 * np.pi, 5.0
    current = volts * 1j * w * 1e-6 / (1 + 1j * w * 2.0 * 1e-6)
    ampere, slope = abs(current), w * abs(volts + 0.1 * current)
    keys = {"current_limit": ampere / factor, "slew": slope / factor, "bandwidth": 2e8}
    load = at_output(CHIP | {"capacitance": 1e-6})
    checks, _ = run_driver(tmp_path, "amplifier", keys, {"ac": volts}, AC, load)
    for name, exact in (("current", ampere), ("slope", slope)):
        check = checks[f"output {name} of driver"]
        assert check.value == pytest.approx(exact, rel=1e-3)
        assert check.limit == pytest.approx(exact / factor, rel=1e-6)
        assert check.passed == (factor < 1)
        assert "100 kHz" in check.advice
    assert checks["output voltage of driver"].passed


def test_a_direct_current_uses_up_a_part_of_the_current_limit(tmp_path):
    """20 V into 2 Ohm and 18 Ohm are 1 A of 1.5 A."""
    load = at_output({"part": "resistor", "resistance": 18.0})
    keys, source = {"current_limit": 1.5}, {"dc": 20.0, "ac": 5.0}
    checks, _ = run_driver(tmp_path, "amplifier", keys, source, AC, load)
    assert checks["output current of driver"].limit == pytest.approx(0.5, rel=1e-3)
    assert checks["output current of driver"].value == pytest.approx(0.25, rel=3e-3)


@pytest.mark.parametrize("kind", ["ac", "noise"])
def test_a_small_signal_analysis_at_a_rail_is_reported(kind, tmp_path):
    """An amplifier at its rail has no gain."""
    output = {"output": "load.v"} if kind == "noise" else {}
    source, load = {"dc": 200.0, "ac": 1.0}, {"part": "resistor", "resistance": 1e3}
    analysis = {**AC, "type": kind, **output}
    checks, _ = run_driver(tmp_path, "amplifier", {}, source, analysis, at_output(load))
    assert not checks["clipping of driver"].passed
    if kind == "ac":
        assert checks["output voltage of driver"].limit == 0.0


def test_amplitudes_of_current_sources_are_compared(tmp_path, monkeypatch):
    """At 1 kHz, 1 V is 10 mA of 0.2 A: ``|R + 200 Ohm + j w L|`` times 10 mA of 48 V, fewer."""
    monkeypatch.setattr(LinearDrive, "compute_coil_load", lambda self, part, build: COILS)
    analysis = {**AC, "stop": 1.01e3, "points": 2}
    checks, _ = run_driver(tmp_path, "linear_drive", {}, {"ac": 2.0}, analysis, WINDINGS)
    w = 2e3 * np.pi * 1.01
    volts = 0.02 * abs(COILS.resistance + 101.1 + 1j * w * COILS.inductance)
    assert checks["output voltage of driver"].value == pytest.approx(volts, rel=0.01)
    assert checks["output voltage of driver"].limit == pytest.approx(48.0, rel=1e-3)
    assert checks["output current of driver"].value == pytest.approx(0.02, rel=0.01)
    assert checks["output current of driver"].limit == pytest.approx(0.2, rel=1e-6)
    assert not checks["output voltage of driver"].passed


def test_an_ac_analysis_of_a_switching_driver_is_reported(tmp_path):
    load = at_output({"part": "resistor", "resistance": 1e3})
    checks, _ = run_driver(tmp_path, "half_bridge", {}, {"ac": 1.0}, AC, load)
    assert not checks["switching of driver"].passed


def test_an_amplifier_is_not_driven_beyond_its_rails(tmp_path):
    """3 A for 1 us into an output that takes 1 A: the rest charges 10 nF to 200 V."""
    build = models({
        "name": "driven", "analysis": {"type": "transient", "stop": 2e-6},
        "amplifier": {"part": "amplifier", "current_limit": 1.0, "pins": {"out": "push.out"}},
        "command": {"part": "source", "pins": {"out": "amplifier.command"}},
        "push": {"part": "source", "kind": "current",
                 "pulse": {"high": 3.0, "width": 1e-6, "edge": 1e-7}},
        "load": {"part": "capacitor", "capacitance": 10e-9, "pins": {"a": "push.out", "b": "gnd"}},
    })  # fmt: skip
    with pytest.raises(SimulationError, match="amplifier, voltage beyond its rails"):
        simulate_deck(build, make_deck(build), tmp_path)


RATED = """.subckt mine command out ref
Rsource command middle 10
Cslow middle ref 1e-8
Eout buffered ref middle ref 1
Rout buffered out 1
.ends mine
"""


@pytest.mark.parametrize(
    ("rating", "violated"),
    [
        ({"low": "-1 V", "high": "101 V", "slew": 6e8}, None),
        ({"high": "90 V"}, "mine.out, voltage beyond its rails"),
        ({"slew": 3e8}, "mine.out, voltage change beyond its slew rate"),
    ],
)
def test_the_header_of_a_netlist_is_checked(rating, violated, tmp_path):
    """RC of 100 ns behind an edge of 200 ns rises by at most (1 - e^-2) 5e8 V/s."""
    (tmp_path / "mine.lib").write_text(RATED)
    text = ", ".join(f"{k} = {v!r}" for k, v in rating.items())
    (tmp_path / "a.toml").write_text(
        "[pulse]\npart = 'source'\npins = { out = 'mine.command' }\n"
        "pulse = { high = 100, width = 1e-5, edge = 2e-7, start = 1e-6 }\n"
        "[mine]\npart = 'netlist'\nfile = 'mine.lib'\nsubckt = 'mine'\n"
        f"ratings = {{ out = {{ {text} }} }}\npins = {{ out = 'load.a' }}\n"
        "[load]\npart = 'resistor'\nresistance = 1000.0\n"
        "[analysis]\nstop = 2e-5\n[solver]\nmax_step = 5e-8\n"
    )
    build = models(tmp_path / "a.toml")
    if violated is None:
        names = [c.name for c in simulate_deck(build, make_deck(build), tmp_path).verdict.checks]
        assert {"mine.out within its rails", "mine.out within its slew rate"} <= set(names)
        return
    with pytest.raises(SimulationError, match=violated):
        simulate_deck(build, make_deck(build), tmp_path)
