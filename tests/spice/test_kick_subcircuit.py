"""The emitted kick against the model that it was made from, solved in numpy."""

import numpy as np
import pytest
from device import bench, deck_of

from kc2spice.scene.load import load_scene
from kc2spice.sim.log import classify
from kc2spice.sim.ngspice import run_deck
from kc2spice.spice.realize import subcircuit

RINGS = ["ring0", "ring1", "ring2", "ring3", "ring4", "ring5"]


def response(model, frequency):
    """Textbook sum over modes, (frequency, output, input)."""
    s = 2j * np.pi * frequency[:, None]
    poles = 1 / (s**2 + model.damp * s + model.omega**2)
    return np.einsum("jk,fj,jl->fkl", model.gain, poles, model.gain) + model.D


def test_ac_of_all_port_pairs(model, header, tmp_path):
    scene = load_scene({"name": "h", "kick": {}, "harmonic": {"steps": 60}})
    waves = run_deck(deck_of(scene, model), tmp_path)
    exact = response(model, waves["frequency"])
    names = [p.name for p in model.ports]
    for i, source in enumerate(names):
        for k, sink in enumerate(names):
            error = np.abs(waves[f"{source}>{sink}"] - exact[:, k, i]) / np.abs(exact[:, k, i])
            # the leak of a picosiemens shows in the charge: 4e-9 at the lowest frequency
            assert error.max() < 1e-8, (source, sink)


def test_open_anode_is_the_partial_inverse(model, header, tmp_path):
    tables = {"kick": {"electrical": "open"}, "harmonic": {"steps": 20}}
    waves = run_deck(deck_of(load_scene({"name": "h", **tables}), model), tmp_path)
    full = response(model, waves["frequency"])
    for k, source in enumerate(RINGS):  # Q = 0 fixes the voltage of each load case
        voltage = -full[:, 6, k] / full[:, 6, 6]
        np.testing.assert_allclose(waves[f"{source}>anode"], voltage, rtol=1e-8)
        np.testing.assert_allclose(
            waves[f"{source}>ring0"], full[:, 0, k] + full[:, 0, 6] * voltage, rtol=1e-8
        )


def test_transient_of_a_force_step_is_the_exact_one(model, header, tmp_path):
    part = subcircuit(model.linear(), "kick", header)
    cards = """Vanode anode 0 0
Istep 0 ring0 PULSE(0 1 1e-09 1e-12 1e-12 1)
Xkick anode 0 ring0 ring1 ring2 ring3 ring4 ring5 0 kick
.options reltol=1e-6 trtol=1 chgtol=1e-13
.tran 1e-08 1e-05 0 1e-07"""
    vectors = {r: (f"v({r.lower()})", 1e-6) for r in ("ring0", "ring5")}
    waves = run_deck(bench([part], cards, vectors, 1e-5), tmp_path)
    t = np.maximum(waves["time"] - 1e-9, 0.0)[:, None]
    sigma, root = model.damp / 2, np.emath.sqrt(model.damp**2 / 4 - model.omega**2)
    one, two = root - sigma, -root - sigma  # poles of each mode
    step = 1 - (two * np.exp(one * t) - one * np.exp(two * t)) / (two - one)
    for ring, column in (("ring0", 0), ("ring5", 5)):
        exact = (step.real / model.omega**2) @ (model.gain[:, 0] * model.gain[:, column])
        # reltol 1e-6 a step, accumulated over the ringing of 30 modes
        assert np.abs(waves[ring] - exact).max() < 3e-4 * np.abs(exact).max()


def test_floating_anode_holds_no_charge_and_is_found_in_silence(model, header, tmp_path):
    part = subcircuit(model.linear(), "kick", header)
    cards = """Iload 0 ring0 1
Xkick anode 0 ring0 ring1 ring2 ring3 ring4 ring5 0 kick
.dc Iload 1 1 1"""
    waves = run_deck(bench([part], cards, {"V": ("v(anode)", 1.0)}), tmp_path)
    static = response(model, np.array([0.0]))[0].real
    assert waves["V"][0] == pytest.approx(-static[6, 0] / static[6, 6], rel=1e-9)
    assert not classify((tmp_path / "bench.log").read_text()).struggles
