"""What drivers' waveforms are held against, on waves made by hand from each driver's equations."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from kc2spice.fem.magnetics.table import EMTable
from kc2spice.parts import _driver_checks as driver
from kc2spice.parts._driver_checks import Stage
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build, part_types

RAILS, CURRENT = "within its rails", "within its current"
SLEW, FOLLOWS = "within its slew rate", "follows its command"
RAIL, ROUT, LIMIT = 100.0, 4.0, 5.0


def limits(kind, keys, time, part=None, build=None, **wave):
    """Checks of a driver by what they are of; what no wave is given for stays zero."""
    type_ = part_types()[kind]
    part = part or SimpleNamespace(keys=type_.schema(**keys), name="d")
    time = np.asarray(time, float)
    wave = {name: np.zeros(time.size) + np.asarray(values) for name, values in wave.items()}
    found = type_.limits(part, build, time, wave)
    return {check.name.removeprefix(f"{part.name} "): check for check in found}


# --- the stage that they share --------------------------------------------------------------------

# Follows its command exactly: 1 V/s of output slope for 1 V of error at 1/(2 pi) Hz.
TIME = np.linspace(0.0, 4.0, 401)
STEADY = Stage(TIME, 0.1 + 0 * TIME, 0.1 * TIME, 0 * TIME, -1.0, 2.0, 3.0, 4.0, 0.5 / np.pi)


def of_stage(**changed):
    found = replace(
        STEADY, **{k: v if np.isscalar(v) else np.asarray(v) for k, v in changed.items()}
    )
    return {check.name.removeprefix("d "): check for check in found.checks("d")}


def test_a_stage_is_held_against_its_rails_current_and_slew_rate():
    """A thousandth of span and current is given, two thousandths to slew rate and gain."""
    found = of_stage()
    assert list(found) == [RAILS, CURRENT, SLEW, FOLLOWS]
    assert [found[name].limit for name in found] == pytest.approx([3e-3, 4.004, 6e-3, 2e-3])
    assert [found[name].unit for name in found] == ["V beyond", "A", "V ahead", "of its swing"]
    assert [found[name].value for name in found] == pytest.approx([0, 0, 0, 0], abs=1e-12)
    assert all(check.wiring for check in found.values())
    assert "beyond its rails" in found[RAILS].advice


def test_rails_hold_for_what_is_inside_of_the_output_resistance():
    current = np.where(TIME < 2, 3.0, -2.0)
    assert of_stage(volts=2.0 + 0 * TIME, current=current)[RAILS].value == pytest.approx(0.3)
    assert of_stage(volts=-1.0 + 0 * TIME, current=current)[RAILS].value == pytest.approx(0.2)
    outer = of_stage(volts=2.0 + 0 * TIME, current=current, rout=1.0)
    assert outer[RAILS].value == pytest.approx(3.0)
    assert outer[CURRENT].value == 3.0
    assert of_stage(current=-current)[CURRENT].value == 3.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stage_at_its_current_is_free_to_lag_and_to_jump(sign):
    """From 98 % of its limit on."""
    jump = sign * np.where(TIME < 2.0, 0.0, 0.5)
    for share, free in ((0.97, True), (0.99, False)):
        held = np.where(np.abs(TIME - 2.0) < 1.5, sign * share * 4.0, 0.0)
        found = of_stage(volts=jump, current=held, rout=0.0, error=0 * TIME)
        assert (found[SLEW].value > 0.4) is free
        assert (found[FOLLOWS].value > 0.1) is free


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_stage_may_lag_where_it_slews(sign):
    """From 98 % of its slew rate on: 3 V/s, 3 V of error."""
    for share, linear in ((0.97, True), (0.99, False)):
        error = np.full(TIME.size, sign * share * 3.0)
        found = of_stage(error=error, volts=0.1 * sign * TIME, rout=0.0)
        wanted = share * 3.0 - 0.1
        assert found[FOLLOWS].value == pytest.approx(wanted / 0.4 if linear else 0.0)


@pytest.mark.parametrize(("rail", "inwards"), [(2.0, -1.0), (-1.0, 1.0)])
def test_a_stage_may_lag_at_its_rails(rail, inwards):
    """Within a thousandth of the span of 3 V; the swing is no less than that either."""
    for off, linear in ((2.9e-3, False), (3.1e-3, True)):
        found = of_stage(volts=np.full(TIME.size, rail + inwards * off), error=0.1 + 0 * TIME)
        assert found[FOLLOWS].value == pytest.approx(0.1 / 3e-3 if linear else 0.0)


def test_a_lag_is_a_mean_over_a_time_constant_of_the_loop():
    """An error of 1 V for a tenth of the time constant ``1 / (2 pi gbw feedback)``, 0.5 s, at an
    output that rests but for its swing of 1 V at the end."""
    error = np.where(np.abs(TIME - 1.03) < 0.025, 1.0, 0.0)  # five samples
    volts = np.where(TIME < 3.9, 0.0, 1.0)
    current = np.where(TIME < 3.0, 0.0, 4.0)  # at its limit then
    found = of_stage(error=error, volts=volts, current=current, rout=0.0, feedback=2.0)
    assert found[FOLLOWS].value == pytest.approx(0.1 / 2, rel=1e-6)
    single = of_stage(error=error, volts=volts, current=current, rout=0.0, feedback=1.0)
    assert single[FOLLOWS].value == pytest.approx(0.05, rel=1e-6)


def test_samples_wider_than_the_time_constant_are_judged_one_by_one():
    time = np.arange(4.0)
    few = Stage(time, np.array([0.0, 0.0, 0.3, 0.0]), np.array([0.0, 0.0, 0.0, 1.0]), 0 * time,
                -1.0, 2.0, 30.0, 4.0, 5 / np.pi)  # fmt: skip
    found = {check.name: check.value for check in few.checks("d")}
    # between 2 and 3 s: a mean error of 0.15 V, a slope of 1 V/s for 0.1 V
    assert found["d follows its command"] == pytest.approx(0.15)


def test_slopes_are_judged_between_any_two_times():
    """2 V/s up to 1 s, level for 1 s, 2 V/s again: ahead of 1 V/s by 1 V at 1 s, and 1 V at 3 s."""
    time = np.array([0.0, 1.0, 2.0, 3.0])
    for sign in (1.0, -1.0):
        volts = sign * np.array([0.0, 2.0, 2.0, 4.0])
        found = driver.slewing("d", time, volts, 1.0, 0.25)
        assert (found.value, found.limit) == (1.0, 0.25)
        assert driver.slewing("d", time, volts, 2.0, 0.25).value == 0.0
    assert "please report" in found.advice


def test_what_relaxes_does_so_from_its_first_value():
    t = np.linspace(0.0, 3.0, 3001)
    towards = np.where(t == 0, 5.0, 2.0)
    exact = 2.0 + 3.0 * np.exp(-t / 0.5)
    np.testing.assert_allclose(driver.relaxed(t, towards, 0.5)[1:], exact[1:], atol=4e-3)
    found = driver.relaxed(np.array([0.0, 1.0]), np.array([1.0, 3.0]), 2.0)
    np.testing.assert_allclose(found, [1.0, (0.75 + 1.0) / 1.25])


# --- amplifiers -----------------------------------------------------------------------------------

STEP = 50e-9  # s, between two samples, less than a time constant of the loops below


def test_an_amplifier_follows_as_one_pole_at_its_bandwidth():
    """``V(out)' = 2 pi f (V(command) - V(out))`` behind 0.1 Ohm of its own, the current of 20 kOhm
    of feedback on top."""
    keys = {"rail": RAIL, "resistance": ROUT, "bandwidth": 1e6, "slew": 2e9, "current_limit": LIMIT}
    out, i, command = np.array([2.0, 3.0]), np.array([0.5, 0.75]), np.array([10.0, 12.0])
    found = limits("amplifier", keys, [0, STEP], out=out, i=i, command=command)
    volts = out + ROUT * i
    current = i + volts / 20e3
    inner = volts + 0.1 * current
    behind = np.mean(command - volts) - np.diff(inner)[0] / STEP / (2 * np.pi * 1e6)
    assert found[FOLLOWS].value == pytest.approx(abs(behind) / np.ptp(inner), rel=1e-9)
    assert found[CURRENT].value == pytest.approx(current[1], rel=1e-9)
    assert found[CURRENT].limit == pytest.approx(1.001 * LIMIT)
    assert found[SLEW].limit == pytest.approx(2e-3 * 110)
    steep = limits("amplifier", keys | {"slew": 1e7}, [0, STEP], out=out, i=i, command=command)
    assert steep[SLEW].value == pytest.approx(np.diff(inner)[0] - 1e7 * STEP)


def test_an_amplifier_stays_between_ten_volts_below_zero_and_its_rail():
    keys = {"rail": RAIL, "resistance": ROUT, "current_limit": LIMIT}
    for out, beyond in ((95.0, 0.0), (99.0, 3.0), (-5.0, 0.0), (-9.0, 3.0)):
        i = math.copysign(1.0, out)  # 4 V and 0.1 V inside of the output, feedback apart
        found = limits("amplifier", keys, [0, STEP], out=out, i=i, command=0.0)
        volts = out + ROUT * i
        beyond = beyond + 0.1 * (1 + abs(volts) / 20e3) if beyond else 0.0
        assert found[RAILS].value == pytest.approx(beyond)
        assert found[RAILS].limit == pytest.approx(0.11)


def test_a_charge_drive_follows_by_the_voltage_of_its_capacitor():
    """``V(command) C / C_sense`` on the capacitor in series; the loop has the bandwidth asked for
    with the share ``C / (C_sense + C)`` of the output returned."""
    keys = {"capacitance": 2e-7, "sense": 8e-7, "rail": RAIL, "resistance": ROUT,
            "bandwidth": 1e6, "slew": 2e9, "current_limit": LIMIT}  # fmt: skip
    anode, i = np.array([2.0, 3.0]), np.array([0.5, 0.75])
    command, cathode = np.array([10.0, 12.0]), np.array([1.0, 0.5])
    wave = {"anode": anode, "cathode": cathode, "i": i, "command": command}
    found = limits("charge_drive", keys, [0, STEP], **wave)
    inner = anode + (ROUT + 0.1) * i
    error = np.mean(command / 4 - cathode) / 0.2
    behind = error - np.diff(inner)[0] / STEP / (2 * np.pi * 1e6)
    assert found[FOLLOWS].value == pytest.approx(abs(behind) / np.ptp(inner), rel=1e-9)
    assert found[CURRENT].value == 0.75
    assert found[CURRENT].limit == pytest.approx(1.001 * LIMIT)
    steep = limits("charge_drive", keys | {"slew": 1e7}, [0, STEP], **wave)
    assert steep[SLEW].value == pytest.approx(np.diff(inner)[0] - 1e7 * STEP)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_charge_drive_has_two_equal_rails(sign):
    keys = {"rail": RAIL, "resistance": ROUT}
    found = limits("charge_drive", keys, [0, STEP], anode=97.0 * sign, i=1.0 * sign, command=0.0,
                   cathode=0.0)  # fmt: skip
    assert found[RAILS].value == pytest.approx(1.1)
    assert found[RAILS].limit == pytest.approx(0.2)


# --- current sources for coils --------------------------------------------------------------------

COILS = EMTable(
    np.linspace(-2.5e-3, 7.5e-3, 5), *np.zeros((6, 5)), np.zeros((5, 2)),
    np.tile([[0.03, 0.01], [0.01, 0.04]], (5, 1, 1)), np.array([5.0, 7.0]), 0,
)  # fmt: skip
L, R = 0.05, 12.0  # both in series, one reversed


def coil_driver(kind, **keys):
    """A driver of coils in the loop of its scene, and its build."""
    scene = load_scene("coil_rails" if kind == "linear_drive" else "pwm_coil",
                       {f"catch.driver.{kind.partition('_')[0]}.{k}": v for k, v in keys.items()}
                       | {"control.current_limit": 0.2})  # fmt: skip
    return {"part": scene.parts["catch_driver"], "build": Build(scene, {"catch": COILS})}


def test_a_linear_drive_follows_by_its_integral():
    """``drive = command + (command - ret) k (1 + t R / L)`` of an error that begins at 0, with
    ``k = 2 pi f L / 100 Ohm`` and 100 Ohm in R; a slope of the output needs an error of its own, by
    an amplifier of five times the bandwidth. The first sample lies at the limit of the current."""
    f, error, t = 20e3, 0.05, np.r_[-1e-12, np.linspace(0.0, 2e-5, 401)]
    k = 2 * np.pi * f * L / 100
    e = np.where(t < 0, 0.0, error)
    drive = 3.0 + e * k * (1 + t * (R + 100) / L)
    i = np.where(t < 0, 0.399, 0.1)
    found = limits(
        "linear_drive", {}, t, **coil_driver("linear_drive", bandwidth=f, rail=48.0),
        command=3.0, ret=3.0 - e, drive=drive, i=i,
    )  # fmt: skip
    slope = error * k * (R + 100) / L
    swing = np.ptp(drive + 1.1 * i)
    assert found[FOLLOWS].value == pytest.approx(slope / (2 * np.pi * 5 * f) / swing, rel=2e-3)
    assert found[CURRENT].value == 0.399
    assert found[CURRENT].limit == pytest.approx(1.001 * 0.4)
    assert found[RAILS].limit == pytest.approx(1e-3 * 96)


def test_a_linear_drive_has_two_equal_rails_and_a_slew_rate():
    for sign in (1.0, -1.0):
        wave = {"command": 0.0, "ret": 0.0, "i": sign, "drive": [sign * 47.5, sign * 43.5]}
        known = coil_driver("linear_drive", rail=48.0, slew=1e6)
        found = limits("linear_drive", {}, [0.0, 1e-6], **known, **wave)
        assert found[RAILS].value == pytest.approx(0.6)
        assert found[CURRENT].value == 1.0
        wave["i"] = sign * 0.1
        found = limits("linear_drive", {}, [0.0, 1e-6], **known, **wave)
        assert found[SLEW].value == pytest.approx(3.0)


def test_a_linear_drive_without_a_controller_gives_up_to_two_amperes():
    scene = load_scene({
        "name": "open_loop", "sphere": {}, "catch": {"pins": {"y": "gnd"}},
        "hand": {"part": "source", "dc": 1.0, "pins": {"out": "amp.command"}},
        "amp": {"part": "linear_drive", "pins": {"drive": "catch.up", "ret": "catch.lp"}},
    })  # fmt: skip
    build = Build(scene, {"catch": COILS})
    found = limits("linear_drive", {}, [0, 1e-6], part=scene.parts["amp"], build=build,
                   command=0.0, ret=0.0, drive=0.0, i=0.0)  # fmt: skip
    assert found[CURRENT].limit == pytest.approx(2.002)


def test_legs_of_a_bridge_are_taken_before_switches_and_shunt():
    """Of 0.5 Ohm each, and 1 Ohm: 2 A through legs of 95 and 6 V."""
    known = coil_driver("pwm_drive", rail=100.0, resistance=0.5)
    wave = {"i": 2.0, "drive": 95.0 - 1.0, "ret": 6.0 + 3.0, "command": 0.2}
    found = limits("pwm_drive", {}, [0.0, 1e-9, 2e-9], **known, **wave)
    assert found["legs against each other"].value == pytest.approx(0.01)
    assert found["legs against each other"].limit == 2e-3
    assert (found[RAILS].value, found[RAILS].limit) == (0.0, pytest.approx(0.1))
    for drive, ret, beyond in (
        (102.0, 3.0, 3.0),
        (0.0, 106.0, 3.0),
        (49.0, 1.0, 2.0),
        (-3.0, 53.0, 2.0),
    ):
        found = limits("pwm_drive", {}, [0.0, 1e-9], **known, i=2.0, drive=drive, ret=ret,
                       command=0.2)  # fmt: skip
        assert found[RAILS].value == pytest.approx(beyond)


def test_a_bridge_is_on_as_long_as_its_controller_asks_for(monkeypatch):
    """On average over time: a duty of 0.25 for 3 s and 0.75 for 1 s against 40 V of 100 V."""
    kind = type(part_types()["pwm_drive"])
    monkeypatch.setattr(kind, "_duty", lambda *_: np.array([0.25, 0.25, 0.75, 0.75]))
    known = coil_driver("pwm_drive", rail=100.0, resistance=0.5)
    time = [0.0, 3.0 - 1e-9, 3.0, 4.0]
    found = limits("pwm_drive", {}, time, **known, i=0.0, drive=40.0, ret=60.0, command=0.0)
    assert found[FOLLOWS].value == pytest.approx((3 * 0.15 + 0.35) / 4)
    assert (found[FOLLOWS].limit, found[FOLLOWS].unit) == (0.1, "of its rail on average")


# --- the half-bridge ------------------------------------------------------------------------------

BRIDGE = {"rail": RAIL, "resistance": 2.0, "gate_resistance": 10.0, "current_limit": 15.0,
          "reservoir": 1e-5, "supply_resistance": 100.0}  # fmt: skip
SETTLED = 10 * 10.0 * 5.2e-10  # s: ten time constants of a gate


def of_bridge(time, bridge, i, command, **keys):
    i = np.zeros(len(time)) + np.asarray(i)
    own = BRIDGE | keys
    out = np.asarray(bridge) - own["resistance"] * i
    return limits("half_bridge", own, time, out=out, i=i, command=command)


def drop(i):
    """Of a diode at this current: 30 mV times its logarithm over 10 fA."""
    return 0.03 * math.log(1 + i / 1e-14)


def across(i, limit=15.0):
    """Of a switch of 12 V at the gate and 3 V of threshold: ``i = limit (1 - (1 - v/9)^2)``."""
    return 9.0 * (1 - math.sqrt(1 - i / limit))


def test_a_half_bridge_gives_way_by_its_diodes_and_by_what_the_load_returns():
    """4 A for 1 us, then -6 A for 2 us: 12 uC come back to 10 uF."""
    time, i = [0.0, 1e-6, 1e-6, 3e-6], [4.0, 4.0, -6.0, -6.0]
    top, bottom = RAIL + drop(6.0) + 12e-6 / 1e-5, -drop(6.0)
    for bridge, beyond in ((top - 0.01, 0.0), (top + 0.5, 0.5), (bottom + 0.01, 0.0),
                           (bottom - 0.25, 0.25)):  # fmt: skip
        found = of_bridge(time, bridge, i, 50.0)
        assert found[RAILS].value == pytest.approx(beyond, abs=1e-9)
        assert found[RAILS].limit == pytest.approx(0.1)
    taken = of_bridge([0.0, 1e-6], RAIL + drop(6.0) + 0.2, 6.0, 50.0)  # nothing returned
    assert taken[RAILS].value == pytest.approx(0.2)


def test_a_half_bridge_limits_its_current_between_its_rails():
    """Gates give 12 V over their resistance on top; beyond the rails diodes carry."""
    bridge, i = [-1.0, 0.0, 0.5, 99.5, 100.0, 101.0], [40.0, 40.0, 3.0, -7.0, 50.0, 50.0]
    found = of_bridge(np.arange(6), bridge, i, 50.0)
    assert found[CURRENT].value == 7.0
    found = of_bridge(np.arange(6), bridge, [*i[:2], -8.0, *i[3:]], 50.0)
    assert found[CURRENT].value == 8.0
    found = of_bridge(np.arange(4), [-1.0, 50.0, 99.0, 101.0], [40.0, 3.0, -7.0, 50.0], 50.0)
    assert found[CURRENT].value == 7.0
    assert found[CURRENT].limit == pytest.approx(1.001 * (15 + 1.2))
    found = of_bridge([0, 1], [50.0, 50.0], [1.0, 2.0], 50.0, gate_resistance=4.0)
    assert found[CURRENT].limit == pytest.approx(1.001 * (15 + 3.0))


@pytest.mark.parametrize("current", [3.0, -3.0])
def test_an_upper_switch_hangs_below_its_tank(current):
    """Which the supply refills through 100 Ohm: ``rail - 100 Ohm i (1 - exp(-t / 1 ms))``."""
    time = np.linspace(0.0, 5e-5, 501)
    i = np.where(time > 0, current, 0.0)
    tank = RAIL - 100.0 * i * -np.expm1(-time / 1e-3)
    bridge = tank - np.sign(i) * across(3.0)
    found = of_bridge(time, bridge, i, RAIL)
    if current < 0:  # beyond the tank its diode carries too: not judged
        assert found[FOLLOWS].value == 0.0
        return
    assert found[FOLLOWS].value < 2e-4
    low = of_bridge(time, bridge - 0.7, i, RAIL)
    assert low[FOLLOWS].value == pytest.approx(7e-3, abs=2e-4)
    assert (low[FOLLOWS].limit, low[FOLLOWS].unit) == (2e-3, "of its rail")


@pytest.mark.parametrize(("before", "drawn"), [(51.0, True), (49.0, False)])
def test_the_tank_gives_its_charge_while_the_command_is_above_half_the_rail(before, drawn):
    """3 A for 50 us, then nothing: it comes back with 1 ms."""
    time = np.linspace(0.0, 1e-4, 1001)
    first = time < 5e-5
    lost = 300.0 * -np.expm1(-0.05) if drawn else 0.0
    tank = RAIL - lost * np.exp(-(time - 5e-5) / 1e-3)
    i, command = np.where(first & (time > 0), 3.0, 0.0), np.where(first, before, RAIL)
    found = of_bridge(time, np.where(first, 50.0, tank), i, command)
    assert found[FOLLOWS].value < 1e-3


def test_a_lower_switch_hangs_above_zero_while_the_load_discharges():
    time = np.linspace(0.0, 1e-6, 101)
    for current, off, value in ((-3.0, 0.0, 0.0), (-3.0, 0.4, 4e-3), (3.0, 0.0, 0.0)):
        bridge = off - math.copysign(across(3.0), current)
        found = of_bridge(time, bridge, current, 0.0)
        assert found[FOLLOWS].value == pytest.approx(value, abs=1e-9)
    # of a small current the switch drops little: judged on either side of zero
    found = of_bridge(time, -0.5, 0.3, 0.0)
    assert across(0.3) < 0.2
    assert found[FOLLOWS].value == pytest.approx((0.5 - across(0.3)) / RAIL)
    found = of_bridge(time, -0.5, 0.4, 0.0)
    assert across(0.4) < 0.2
    found = of_bridge(time, RAIL + 0.5, 0.3, RAIL, supply_resistance=1e-3)
    assert found[FOLLOWS].value == pytest.approx((0.5 + across(0.3)) / RAIL, rel=1e-3)
    assert of_bridge(time, -0.5, 1.0, 0.0)[FOLLOWS].value == 0.0


def test_a_half_bridge_is_judged_once_its_gates_have_settled():
    """Ten time constants of 520 pF on the gate's resistance after the command came to its end."""
    for on, bridge in ((RAIL, 90.0), (0.0, 10.0)):
        for late, seen in ((0.99, False), (1.01, True)):
            time = np.array([0.0, 1e-9, 1e-9 + late * SETTLED])
            found = of_bridge(time, bridge, 0.0, np.array([99.0 * on / RAIL, 50.0, on]))
            assert found[FOLLOWS].value == pytest.approx(0.1 if seen else 0.0), (on, late)
        # on from the first sample
        time = np.array([0.0, 0.99 * SETTLED])
        assert of_bridge(time, bridge, 0.0, on)[FOLLOWS].value == 0.0
        assert of_bridge(time, bridge, 0.0, on, gate_resistance=5.0)[FOLLOWS].value > 0.05
    none = of_bridge([0.0, 1e-3], 50.0, 0.0, 99.0)  # in between both are off
    assert none[FOLLOWS].value == 0.0


def test_a_switch_near_its_saturation_is_not_judged():
    """From 90 % of its current on."""
    time = np.array([0.0, 1e-6])
    for share, seen in ((0.89, True), (0.91, False)):
        found = of_bridge(time, 50.0, share * 15.0, RAIL, supply_resistance=1e-3)
        assert (found[FOLLOWS].value > 0.3) is seen
