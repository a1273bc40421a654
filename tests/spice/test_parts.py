"""Contact, sphere, catch and controller in ngspice against their laws."""

import numpy as np
import pytest
from device import bench
from support import (
    PidKeys,
    compute_current_products,
    find_failure,
    make_coils_subcircuit,
    make_opamp_subcircuit,
    make_pid_subcircuit,
    run_deck,
)


def controller(header, control, position, stop, enable=1e-6, load=0.0):
    """The controller on two resistors as coils, looking at a prescribed height [um]."""
    cards = f"""Vy y 0 PWL({position})
Venable enable 0 PULSE(0 1 {enable} 1e-08 1e-08 1)
Xpid y enable drive ret 0 pid
Rcoils drive ret 3192
.options reltol=1e-5 trtol=1
.tran 1e-07 {stop} 0 1e-06"""
    vectors = {
        "y": ("v(y)", 1e-6),
        "i": ("@rcoils[i]", 1.0),
    }
    if control.ki:
        ideal = "v(xpid.state_integral)", 1 / control.ki
        vectors["integral"] = ideal if control.form == "ideal" else ("v(xpid.i)", -10.0 / 2e3)
    parts = [make_opamp_subcircuit(header), make_pid_subcircuit(header, control, load=load)]
    return bench(parts, cards, vectors, stop)


FORMS = pytest.mark.parametrize("form", ["opamps", "ideal"])


@FORMS
def test_controller_is_clamped_silent_before_enable_and_does_not_wind_up(header, form, tmp_path):
    control = PidKeys(form=form)
    # 3 ms far below the set point, then just above it
    position = "0 1000 3e-03 1000 3.01e-03 2501 4e-03 2501"
    waves = run_deck(controller(header, control, position, 4e-3, 1e-3), tmp_path)
    t, current = waves["time"], waves["i"]
    assert np.abs(current[t < 0.999e-3]).max() < 1e-5 * control.current_limit
    saturated = (t > 1.01e-3) & (t < 2.99e-3)
    np.testing.assert_allclose(current[saturated], control.current_limit, rtol=2e-5)
    held = waves["integral"][(t > 2.9e-3) & (t < 2.99e-3)]
    assert np.abs(held).max() < 0.01 * 1.5e-3 * 2e-3  # against 1.5 mm for 2 ms, had it run on
    assert current[-1] == pytest.approx(-control.kp * 1e-6, rel=1e-3)
    assert not find_failure((tmp_path / "bench.log").read_text()).struggles


@pytest.mark.parametrize(("how", "form"), [("export", "ideal"), ("instance", "opamps")])
def test_controller_has_the_specified_gains(header, how, form, tmp_path):
    """Small signals by ``KP + KI / s + KD s / (1 + s rolloff)``, exported or set in the deck."""
    control = PidKeys(kp=3e4, ki=3e5, kd=12.0, rolloff=2e-7, form=form)
    given = f"kp={control.kp} ki={control.ki} kd={control.kd} rolloff={control.rolloff}"
    exported = control if how == "export" else PidKeys(form=form)
    cards = f"""Vy y 0 DC 2500 AC 1
Venable enable 0 1
Xpid y enable command 0 pid {given if how == "instance" else ""}
.ac dec 5 100 3e5"""
    parts = [make_opamp_subcircuit(header), make_pid_subcircuit(header, exported, output=False)]
    waves = run_deck(bench(parts, cards, {"out": ("v(command)", 1e-2)}), tmp_path)
    s = 2j * np.pi * waves["frequency"]
    law = control.kp + control.ki / s + control.kd * s / (1 + s * control.rolloff)
    # KI is 1.6 % of the law at 100 Hz. Three stages of 15 to 25 MHz lag by 30 ns together.
    error = np.abs(-1e6 * waves["out"] / law - 1)
    if form == "ideal":  # milliohm and kiloohm at the differentiator
        assert error.max() < 5e-6
    assert error[0] < 1e-3
    assert (error / waves["frequency"]).max() < 2 * np.pi * 40e-9 + 1e-5


@FORMS
def test_a_disabled_controller_starts_again_from_zero(header, form, tmp_path):
    """1 um above the set point all the time, with an integral that reaches ten times kp e."""
    control = PidKeys(form=form, kp=1e3, ki=1e7, kd=0.0)
    cards = """Vy y 0 2501
Venable enable 0 PULSE(0 1 1e-06 1e-08 1e-08 1e-03 1.5e-03)
Xpid y enable drive ret 0 pid
Rcoils drive ret 3192
.options reltol=1e-5 trtol=1
.tran 1e-06 2.0e-03 0 1e-06"""
    parts = [make_opamp_subcircuit(header), make_pid_subcircuit(header, control)]
    waves = run_deck(bench(parts, cards, {"i": ("@rcoils[i]", 1.0)}, 2e-3), tmp_path)
    for start in (1e-6, 1.501e-3):  # an emptied integral is that of a microsecond
        t = start + np.array([50e-6, 450e-6])
        exact = -1e-6 * (control.kp + control.ki * (t - start))
        np.testing.assert_allclose(np.interp(t, waves["time"], waves["i"]), exact, rtol=1e-2)


def test_coils_push_and_induce_by_their_coenergy(header, table, tmp_path):
    """Fixed currents, a height and a speed: force, and voltages by central differences."""
    y, v, i1, i2 = 1.234e-3, 0.3, 0.04, -0.07
    cards = f"""Vy y 0 {1e6 * y}
Vv v 0 {v}
Ilower 0 lp {i1}
Iupper 0 up {i2}
Xcoil lp 0 up 0 y v 0 coil
.op"""
    vectors = {"force": ("i(vv)", 1.0), "lower": ("v(lp)", 1.0), "upper": ("v(up)", 1.0)}
    waves = run_deck(bench([make_coils_subcircuit(header, table)], cards, vectors), tmp_path)

    def coenergy(y, i1, i2):
        return float(table.coenergy.terms(y) @ compute_current_products(i1, i2))

    h, d = 1e-7, 1e-4
    force = (coenergy(y + h, i1, i2) - coenergy(y - h, i1, i2)) / (2 * h)
    assert waves["force"][0] == pytest.approx(force, rel=1e-5)
    # at rest the flux of the currents stands still: what is left is that of the magnets
    for name, (a, b), ohms, i in (
        ("lower", (d, 0.0), table.resistance[0], i1),
        ("upper", (0.0, d), table.resistance[1], i2),
    ):
        flux = [(coenergy(x, a, b) - coenergy(x, -a, -b)) / (2 * d) for x in (y + h, y - h)]
        induced = (flux[0] - flux[1]) / (2 * h) * v
        assert waves[name][0] == pytest.approx(ohms * i + induced, rel=1e-5)
