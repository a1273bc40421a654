"""Relays from data sheets: times and hysteresis in ngspice against closed forms."""

import numpy as np
import pytest
from support import list_dialect_names

import kc2spice as kc

# Ningbo Songle SRD-05VDC-SL-C: 70 Ohm, 75 % and 10 % of 5 V, 10 ms.
SHEET = {"resistance": 70.0, "voltage": 5.0, "pick_up": 3.75, "release": 0.5}


def scene(drive, stop, **keys):
    relay = {"part": "relay", **SHEET, **keys}
    relay["pins"] = {"plus": "drive.out", "no": "supply.out", "com": "load.a"}
    return {
        "name": "relay",
        "relay": relay,
        "drive": {"part": "source", **drive},
        "supply": {"part": "source", "dc": 12.0},
        "load": {"part": "resistor", "resistance": 100.0},
        "solver": {"stop": stop, "max_step": stop / 4000},
    }


def switched(waves):
    """Times at which the contact switches, by the middle of the load's voltage."""
    time, closed = waves["time"], waves["load.v"] > 6.0
    return time[1:][closed[1:] != closed[:-1]]


PULSE = {"pulse": {"high": 5.0, "width": 0.04, "edge": 1e-6, "start": 1e-3}}


def test_a_relay_operates_and_releases_at_the_times_of_closed_forms():
    """``L/R ln(V/(V - Vp))`` of the current and ``ln 2`` time constants of the armature make the
    operate time; the current falls to release by ``L/R ln(V/Vr)``."""
    L, operate = 0.2, 6e-3
    waves = kc.run(scene(PULSE, 0.06, inductance=L, operate_time=operate)).waves
    closes, opens = switched(waves)
    armature = operate - L / 70.0 * np.log(5.0 / 1.25)
    assert closes - 1e-3 == pytest.approx(operate, rel=3e-3)
    released = L / 70.0 * np.log(5.0 / 0.5) + armature
    assert opens - 0.041 == pytest.approx(released, rel=3e-3)


def test_a_relay_operates_with_reversed_polarity():
    """An unpolarised armature is attracted by either sign of the current."""
    pulse = {"pulse": PULSE["pulse"] | {"high": -5.0}}
    keys = {"inductance": 0.2, "operate_time": 6e-3}
    mine, usual = (kc.run(scene(drive, 0.06, **keys)) for drive in (pulse, PULSE))
    np.testing.assert_allclose(switched(mine.waves), switched(usual.waves), rtol=1e-3)
    assert mine.metrics["operate_time_s"] == pytest.approx(6e-3, rel=2e-3)


def test_the_current_of_the_coil_is_that_of_an_inductor():
    waves = kc.run(scene(PULSE, 0.02, inductance=0.2)).waves
    time, current = waves["time"], waves["relay.i"]
    on = time > 2e-3
    expected = 5.0 / 70.0 * (1 - np.exp(-(time[on] - 1e-3) * 70.0 / 0.2))
    np.testing.assert_allclose(current[on], expected, rtol=2e-3)


def test_a_sheet_without_inductance_keeps_its_operate_time():
    closes, _ = switched(kc.run(scene(PULSE, 0.08, operate_time="10 ms")).waves)
    assert closes - 1e-3 == pytest.approx(10e-3, rel=3e-3)


def test_a_slow_voltage_switches_at_pick_up_and_release():
    ramp = {"pwl": [[0.0, 0.0], [1.0, 5.0], [2.0, 0.0]]}
    waves = kc.run(scene(ramp, 2.0, inductance=1e-3, operate_time=1e-4)).waves
    closes, opens = switched(waves)
    assert 5.0 * closes == pytest.approx(3.75, abs=0.01)
    assert 5.0 * (2.0 - opens) == pytest.approx(0.5, abs=0.01)


def test_a_changeover_contact_is_closed_at_rest():
    tables = scene({"dc": 0.0}, 1e-3, inductance=0.2, changeover=True)
    tables["relay"]["pins"] = {"plus": "drive.out", "nc": "supply.out", "com": "load.a"}
    tables |= {"analysis": {"type": "op"}}
    assert kc.run(tables).waves["load.v"][0] == pytest.approx(12.0 * 100 / 100.1, rel=1e-6)


def test_verify_integrates_the_relay_independently():
    assert kc.verify(scene(PULSE, 0.06, inductance=0.2, operate_time=6e-3))["passed"]


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "neither inductance nor operate_time"),
        ({"inductance": 2.0, "operate_time": 1e-3}, "operate_time contradicts inductance"),
        ({"operate_time": 0.01, "pick_up": 6.0}, "not in the order release < pick_up < voltage"),
        ({"operate_time": 0.01, "release": 4.0}, "not in the order release < pick_up < voltage"),
        ({"operate_time": 0.01, "insulation_resistance": 0.01}, "conducts better"),
    ],
)
def test_sheets_that_no_relay_has_are_errors(keys, message):
    with pytest.raises(kc.errors.UsageError, match=message):
        kc.load_scene(scene(PULSE, 0.01, **keys))


@pytest.mark.parametrize("dialect", list_dialect_names())
def test_every_dialect_has_it(dialect, tmp_path):
    assert kc.export(scene(PULSE, 0.01, operate_time=0.01), tmp_path, dialect=dialect)


def test_the_metrics_of_a_relay_are_its_times_and_its_coil_current():
    """Operate time of the data sheet, release time ``L/R ln(V/Vr) + ln 2 ta``, current V/R."""
    L, operate = 0.2, 6e-3
    metrics = kc.run(scene(PULSE, 0.06, inductance=L, operate_time=operate)).metrics
    tau = L / SHEET["resistance"]
    armature = operate - tau * np.log(5.0 / (5.0 - 3.75))  # ln 2 time constants
    assert metrics["operate_time_s"] == pytest.approx(operate, rel=2e-3)
    assert metrics["release_time_s"] == pytest.approx(tau * np.log(10) + armature, rel=2e-3)
    assert metrics["coil_current_a"] == pytest.approx(5.0 / 70.0, rel=1e-4)


def test_a_relay_without_a_single_operation_has_no_operate_time():
    low = kc.run(scene({"dc": 3.0}, 0.02, operate_time=10e-3)).metrics
    assert set(low) == {"coil_current_a"}
    assert low["coil_current_a"] == pytest.approx(3.0 / 70.0, rel=1e-3)
    pulse = {"pulse": PULSE["pulse"] | {"period": 0.08}}  # two operations
    assert set(kc.run(scene(pulse, 0.16, operate_time=10e-3)).metrics) == {"coil_current_a"}


def test_a_release_time_needs_the_inductance_of_the_coil():
    """The inductance from the operate time is too large, so the release would be too late."""
    metrics = kc.run(scene(PULSE, 0.08, operate_time=10e-3)).metrics
    assert set(metrics) == {"coil_current_a", "operate_time_s"}
