"""What a run of the loop hands out; its motion is held against exact ones in benchmarks."""

import numpy as np
import pytest
from device import deck_of

from kc2spice.sim.ngspice import run_deck


@pytest.fixture(scope="module")
def run(scene, model, table, tmp_path_factory):
    deck = deck_of(scene, model, table)
    return deck, run_deck(deck, tmp_path_factory.mktemp("loop"))


def test_the_sphere_is_caught_and_held(run, scene):
    waves = run[1]
    setpoint = scene.parts["control"].keys.setpoint
    assert abs(waves["sphere.y"][-1] - setpoint) < 1e-6  # it is caught
    late = waves["time"] > 4.5e-3
    weight = scene.parts["sphere"].keys.mass * 9.81 / 0.65  # N over N/A
    assert waves["coil.upper.current"][late].mean() == pytest.approx(weight, rel=0.2)
    lower, upper = waves["coil.lower.current"], waves["coil.upper.current"]
    np.testing.assert_allclose(lower, -upper, rtol=1e-12)


def test_results_have_the_names_and_signs_of_the_contract(run):
    deck, waves = run
    assert set(waves.data) == {"time", *deck.vectors}
    forces = sum(waves[f"contact.force.ring{k}"] for k in range(6))
    np.testing.assert_allclose(waves["contact.force"], forces, rtol=1e-12)
    edge = (waves["time"] > 500.02e-6) & (waves["time"] < 500.08e-6)
    # the clamped capacitance at least is charged through the anode: C dV/dt = 28 A
    assert waves["kick.current"][edge].mean() > 20.0
    assert waves["kick.voltage"].max() == pytest.approx(80.0)
    np.testing.assert_allclose(waves["control.error"], 2.5e-3 - waves["sphere.y"], atol=1e-8)
