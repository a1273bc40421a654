"""Drivers against closed forms, and all parts for passivity, in decks that include libraries."""

import numpy as np
import pytest
from device import bench
from support import (
    Amplifier,
    AmplifierKeys,
    ChargeDrive,
    ChargeDriveKeys,
    CoilLoad,
    HalfBridge,
    HalfBridgeKeys,
    LinearDrive,
    LinearDriverKeys,
    PwmDrive,
    PwmKeys,
    make_key_parameters,
    make_opamp_subcircuit,
    run_deck,
)

LOAD = CoilLoad(73e-3, 3192.0, 0.1)


# ------------------------------------------------------------------------------------ op-amps


@pytest.mark.parametrize(("level", "part"), [("pole", "opamp"), ("slew", "opamp_slew")])
def test_every_level_of_amplifier_has_its_gain(header, tmp_path, level, part):
    """Non-inverting, gain 11; a pole at gbw / 11."""
    cards = f"""Vin in 0 AC 1
Vcc vcc 0 15
Vee vee 0 -15
Xop in n out vcc vee 0 {part} gbw=1.1e6
R1 n 0 1000
R2 out n 10000
.ac dec 4 100 1e6"""
    deck = bench([make_opamp_subcircuit(header, level)], cards, {"out": ("v(out)", 1.0)})
    waves = run_deck(deck, tmp_path)
    pole = 1 + 1j * waves["frequency"] / 1e5
    np.testing.assert_allclose(waves["out"], 11 / pole, rtol=2e-5)  # 0.1 Ohm and the finite gain


def test_slewing_amplifier_keeps_rate_current_offset_and_rails(header, tmp_path):
    cards = """Vin in 0 PULSE(0 20 1e-05 1e-09 1e-09 1)
Vcc vcc 0 10
Vee vee 0 -10
Xop in out out vcc vee 0 opamp_slew slew=1e6 offset=0.01 current_limit=0.005
Rload out 0 1e6
Vcc2 vcc2 0 30
Xtwo in low low vcc2 vee 0 opamp_slew current_limit=0.005
Rlow low 0 1000
.options reltol=1e-5
.tran 1e-07 1e-04 0 1e-07"""
    vectors = {"out": ("v(out)", 1.0), "low": ("v(low)", 1.0)}
    waves = run_deck(bench([make_opamp_subcircuit(header, "slew")], cards, vectors, 1e-4), tmp_path)
    t, out = waves["time"], waves["out"]
    assert out[0] == pytest.approx(0.01, rel=1e-3)
    rising = (t > 12e-6) & (t < 18e-6)
    # gbw / a0 = 100 Hz: 5 V on average leak away with 3 parts in 1000 of the slewing current
    assert np.polyfit(t[rising], out[rising], 1)[0] == pytest.approx(
        1e6 - 5 * 2 * np.pi * 100, rel=1e-3
    )
    assert out[-1] == pytest.approx(10.0, rel=1e-3)  # the rail
    assert waves["low"][-1] == pytest.approx(5.0, rel=1e-6)  # 5 mA through 1 kOhm


# ------------------------------------------------------------------------- drivers of the chip


def test_amplifier_follows_by_one_pole(header, tmp_path):
    """``e (1 + 0.1 Y) = A(s) (command - e) / 20`` at its output, with the chip's and the feedback's
    admittance Y."""
    names = ("rail", "resistance", "bandwidth", "slew", "current_limit")
    parameters = make_key_parameters(AmplifierKeys(), *names)
    rail = {"negative_rail": -10.0}
    part = Amplifier().render_subcircuit(header, "amplifier", parameters, rail)
    cards = """Vcommand command 0 AC 1
Xdriver command out 0 amplifier bandwidth=1e6 resistance=5
Cchip out 0 1e-08
.ac dec 3 1e4 1e7"""
    parts = [make_opamp_subcircuit(header, "slew"), part]
    waves = run_deck(bench(parts, cards, {"out": ("v(out)", 1.0)}), tmp_path)
    s = 2j * np.pi * waves["frequency"].real
    chip = 5 + 1 / (s * 1e-8)
    gain = 1 / (1e-7 + s / (2 * np.pi * 20e6)) / 20
    drive = gain / (gain + 1 + 0.1 * (1 / chip + 1 / 20e3))
    np.testing.assert_allclose(waves["out"], drive / (1 + 5 * s * 1e-8), rtol=1e-5)


def charging(header, parts, name, cards, tmp_path, stop=20e-6, load="Cchip out 0 1e-07"):
    """A pulse into 100 nF in place of the chip, in a driver with ``out``."""
    text = f"""Vcommand command 0 PULSE(0 100 1e-06 1e-07 1e-07 9.9e-06)
Xdriver command out 0 {name} {cards}
{load}
.options reltol=1e-5 trtol=1
.tran 1e-08 {stop} 0 2e-08"""
    vectors = {"out": ("v(out)", 1.0), "i": ("@r.xdriver.rout[i]", 1.0)}
    return run_deck(bench(parts, text, vectors, stop), tmp_path)


def test_half_bridge_limits_current_and_charge(header, tmp_path):
    part = HalfBridge().render_subcircuit(
        header, "half_bridge", make_key_parameters(HalfBridgeKeys())
    )
    waves = charging(header, [part], "half_bridge",
                     "resistance=0.1 current_limit=3 reservoir=1e-07 supply_resistance=1e6",
                     tmp_path)  # fmt: skip
    assert np.abs(waves["i"]).max() == pytest.approx(3.0, rel=0.02)
    # 100 nF of reservoir at 100 V shared with 100 nF of load
    end = np.interp(10e-6, waves["time"], waves["out"])
    assert end == pytest.approx(50.0, rel=0.01)


def test_the_voltage_drop_of_the_half_bridge_is_that_of_its_transistor(header, tmp_path):
    """``i = limit (1 - (1 - v / 9 V)^2)`` at a gate of 12 V and a threshold of 3 V."""
    part = HalfBridge().render_subcircuit(
        header, "half_bridge", make_key_parameters(HalfBridgeKeys())
    )
    cards = "current_limit=6 resistance=2 reservoir=1"
    waves = charging(header, [part], "half_bridge", cards, tmp_path, load="Rload out 0 23")
    i = np.interp(8e-6, waves["time"], waves["i"])
    v = 100 - 25 * i
    assert i == pytest.approx(6 * (1 - (1 - v / 9) ** 2), rel=1e-4)


def test_charge_drive_gives_its_charge_to_any_capacitance(header, tmp_path):
    """A volt of command is 150 nC, whatever the chip has: 15 V across 100 nF from 10 V."""
    part = ChargeDrive().render_subcircuit(header, "charge", make_key_parameters(ChargeDriveKeys()))
    cards = """Vcommand command 0 PULSE(0 10 1e-06 1e-07 1e-07 1)
Xdriver command anode cathode 0 charge
Cchip anode cathode 1e-07
.options reltol=1e-5 trtol=1
.tran 1e-08 3e-05 0 1e-07"""
    vectors = {"a": ("v(anode)", 1.0), "c": ("v(cathode)", 1.0)}
    parts = [make_opamp_subcircuit(header, "slew"), part]
    waves = run_deck(bench(parts, cards, vectors, 3e-5), tmp_path)
    assert waves["a"][-1] - waves["c"][-1] == pytest.approx(15.0, rel=2e-3)  # finite gain


# ------------------------------------------------------------------------ drivers of the coils


def stepped(parts, name, cards, tmp_path, stop, ask=2.0):
    """A step of the command [V, 100 per ampere] with a plain R and L as coils."""
    text = f"""Vwanted wanted 0 PULSE(0 {ask} 1e-05 1e-07 1e-07 1)
Xdriver wanted drive ret 0 {name} {cards}
Rcoils drive middle {LOAD.resistance}
Lcoils middle ret {LOAD.inductance}
.options reltol=1e-5 trtol=1
.tran 1e-06 {stop} 0 1e-06"""
    vectors = {"i": ("i(lcoils)", 1.0), "u": ("v(drive)", 1.0)}
    return run_deck(bench(parts, text, vectors, stop), tmp_path)


def test_linear_drive_closes_like_one_pole(header, tmp_path):
    """The amplifier of five times the bandwidth adds 2 % to the pole. The command that bypasses
    the controller adds 3 % well below the pole."""
    part = LinearDrive().render_subcircuit(
        header, "linear", *LinearDrive().adapt_to_load(LinearDriverKeys(), LOAD)
    )
    cards = f"""Vwanted wanted 0 AC 100
Xdriver wanted drive ret 0 linear
Rcoils drive middle {LOAD.resistance}
Lcoils middle ret {LOAD.inductance}
.ac dec 1 5e2 5e4"""
    parts = [make_opamp_subcircuit(header, "slew"), part]
    waves = run_deck(bench(parts, cards, {"i": ("i(lcoils)", 1.0)}), tmp_path)
    f = waves["frequency"].real / LinearDriverKeys().bandwidth
    np.testing.assert_allclose(np.abs(waves["i"]), np.abs(1 / (1 + 1j * f)), rtol=0.03)


def test_linear_drive_is_bound_by_its_rails(header, tmp_path):
    """The rail over all resistance at the end, and the rail over L at the start."""
    drive = LinearDriverKeys(rail=48.0)
    part = LinearDrive().render_subcircuit(
        header, "linear", *LinearDrive().adapt_to_load(drive, LOAD)
    )
    parts = [make_opamp_subcircuit(header, "slew"), part]
    waves = stepped(parts, "linear", "", tmp_path, 5e-4, ask=10.0)
    total = LOAD.resistance + 100.0 + 1.0 + 0.1
    assert waves["i"][-1] == pytest.approx(48 / total, rel=5e-3)
    t = waves["time"]
    rise = np.interp(48 / total * (1 - np.exp(-1)), waves["i"], t) - 10e-6
    assert rise == pytest.approx(LOAD.inductance / total, rel=0.12)  # L/R and 2.4 us of slew


def test_pwm_follows_with_the_ripple_of_the_inductance(header, tmp_path):
    drive = PwmKeys()
    parts = [
        make_opamp_subcircuit(header),
        PwmDrive().render_subcircuit(header, "pwm", *PwmDrive().adapt_to_load(drive, LOAD)),
    ]
    waves = stepped(parts, "pwm", "", tmp_path, 1e-3, ask=1.0)
    t, i = waves["time"], waves["i"]
    late = t > 0.8e-3
    mean = np.trapezoid(i[late], t[late]) / np.ptp(t[late])
    assert mean == pytest.approx(10e-3, rel=5e-3)
    share = 10e-3 * (LOAD.resistance + 2.0) / drive.rail  # of the rail, on average
    ripple = drive.rail * (1 - share**2) / (2 * drive.frequency * LOAD.inductance)
    assert np.ptp(i[late]) == pytest.approx(ripple, rel=0.05)  # of two-level modulation
    # Of one pole w and what passes the loop, g: the step misses (1 - g) / w of its height times
    # time; the modulator's delay and an eighth of a period's ripple are a fifth of that.
    w, g = 2 * np.pi * drive.bandwidth, 100.0 * drive.rail / (10.0 * (LOAD.resistance + 2.0))
    early = (t > 10e-6) & (t < 210e-6)
    missed = np.trapezoid(mean - i[early], t[early])
    assert missed == pytest.approx(mean * (1 - g) / w, rel=0.2)
