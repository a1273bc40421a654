"""Contact, sphere, catch and controller in ngspice against their laws."""

import numpy as np
import pytest
from device import bench, deck_of
from scipy.interpolate import CubicSpline

from kc2spice.parts._opamp import opamp_subcircuit
from kc2spice.parts.contact import Normal, contact_subcircuit, ring_gaps
from kc2spice.parts.current_cases import cases
from kc2spice.parts.pid import Control, pid_subcircuit
from kc2spice.scene.load import load_scene
from kc2spice.sim.log import classify
from kc2spice.sim.ngspice import run_deck

# ---------------------------------------------------------------------------------- contact


def test_contact_law_and_reaction(header, radii, tmp_path):
    gaps = ring_gaps(radii[:3], 1e-3)
    part = contact_subcircuit(header, ("ring0", "ring1", "ring2"), gaps, Normal(4e8))
    cards = """V0 ring0 0 0.3
V1 ring1 0 0.2
V2 ring2 0 0
Vv v 0 0
Vbottom bottom 0 0
Xcontact ring0 ring1 ring2 v bottom 0 contact
.dc Vbottom -6 1 0.05"""
    vectors = {
        "bottom": ("v(bottom)", 1e-6),
        **{f"F{k}": (f"@b.xcontact.bring{k}[i]", 1.0) for k in range(3)},
        **{f"ring{k}": (f"i(v{k})", 1.0) for k in range(3)},
        "sphere": ("i(vv)", 1.0),
    }
    waves = run_deck(bench([part], cards, vectors), tmp_path)
    rings = np.array([0.3e-6, 0.2e-6, 0.0])
    law = 4e8 * np.maximum(0.0, rings - waves["bottom"][:, None] - gaps)
    assert law.max() > 400.0
    for k in range(3):
        np.testing.assert_allclose(waves[f"F{k}"], law[:, k], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(waves[f"ring{k}"], -law[:, k], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(waves["sphere"], law.sum(axis=1), rtol=1e-9, atol=1e-9)


# ------------------------------------------------------------------------------------ catch


def test_lookup_follows_the_spline(header, table, tmp_path):
    scene = load_scene({"name": "em", "em_force": {}, "catch": {}, "sphere": {}})
    waves = run_deck(deck_of(scene, table=table), tmp_path)
    splines = {n: CubicSpline(table.y, getattr(table, n)) for n in ("c0", "c1", "c2", "c11", "c22")}
    c = {name: spline(waves["sphere.y"]) for name, spline in splines.items()}
    for k, (i1, i2) in enumerate(cases(scene.parts["em_force"])):
        law = c["c0"] + c["c1"] * i1 + c["c2"] * i2 + c["c11"] * i1**2 + c["c22"] * i2**2
        # 201 cubic pieces through a smooth curve; measured 6e-6 on the paper's system
        assert np.abs(waves[f"catch.force.{k}"] - law).max() < 2e-5 * 0.065


# --------------------------------------------------------------------------------------- pid


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
        "error": ("v(xpid.e)", 1 / 2e3),
    }
    if control.ki:
        scale = 1 / control.ki if control.form == "ideal" else -10.0 / 2e3
        vectors["integral"] = ("v(xpid.i)", scale)
    parts = [opamp_subcircuit(header), pid_subcircuit(header, control, load=load)]
    return bench(parts, cards, vectors, stop)


FORMS = pytest.mark.parametrize("form", ["opamps", "ideal"])


@FORMS
def test_controller_follows_the_law(header, form, tmp_path):
    control = Control(form=form)
    # a ramp of 2 mm/s through the set point: P and D both inside the clamp
    deck = controller(header, control, "0 2499 1e-03 2501", 1e-3)
    waves = run_deck(deck, tmp_path)
    late = waves["time"] > 20e-6  # after the enable and the roll-off have died away
    error = control.setpoint - waves["y"]
    wanted = control.kp * error + control.kd * -2e-3
    law = np.clip(wanted, -control.current_limit, control.current_limit)
    # the sensor's milliohm makes an offset of a tenth of a nanometre, thus of 6 uA
    assert np.abs(waves["i"] - law)[late].max() < 2e-4 * control.current_limit
    assert np.abs(waves["error"] - error)[late].max() < 1e-5 * 1e-3


@FORMS
def test_controller_is_clamped_silent_before_enable_and_does_not_wind_up(header, form, tmp_path):
    control = Control(form=form)
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
    assert not classify((tmp_path / "bench.log").read_text()).struggles


@pytest.mark.parametrize(("how", "form"), [("export", "ideal"), ("instance", "opamps")])
def test_controller_has_the_gains_asked_for(header, how, form, tmp_path):
    """Small signals by ``KP + KI / s + KD s / (1 + s rolloff)``, exported or set in the deck."""
    control = Control(kp=3e4, ki=3e5, kd=12.0, rolloff=2e-7, form=form)
    given = f"kp={control.kp} ki={control.ki} kd={control.kd} rolloff={control.rolloff}"
    exported = control if how == "export" else Control(form=form)
    cards = f"""Vy y 0 DC 2500 AC 1
Venable enable 0 1
Xpid y enable command 0 pid {given if how == "instance" else ""}
.ac dec 5 100 3e5"""
    parts = [opamp_subcircuit(header), pid_subcircuit(header, exported, output=False)]
    waves = run_deck(bench(parts, cards, {"out": ("v(command)", 1e-2)}), tmp_path)
    s = 2j * np.pi * waves["frequency"]
    law = control.kp + control.ki / s + control.kd * s / (1 + s * control.rolloff)
    # KI is 1.6 % of the law at 100 Hz. Three stages of 15 to 25 MHz lag by 30 ns together.
    error = np.abs(-1e6 * waves["out"] / law - 1)
    if form == "ideal":  # milliohm and kiloohm at the differentiator
        assert error.max() < 5e-6
    assert error[0] < 1e-3
    assert (error / waves["frequency"]).max() < 2 * np.pi * 40e-9 + 1e-5
