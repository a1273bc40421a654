"""Contact ports without inertia: exact statics, passivity, a bounce by plain equations."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from device import bench, built, chip
from scipy.integrate import solve_ivp

from kc2spice.parts.contact import Normal, contact_subcircuit
from kc2spice.parts.sphere import sphere_subcircuit
from kc2spice.rom.massless import without_inertia
from kc2spice.rom.modal import Resonators
from kc2spice.scene.load import load_scene
from kc2spice.sim.ngspice import run_deck
from kc2spice.spice.header import Header
from kc2spice.spice.realize import subcircuit
from kc2spice.workflow.verify.circuit import solve

HEADER = Header("massless", "0")
MASS, EPS = 32.9e-6, 4e8  # kg, N/m


@pytest.fixture(scope="module")
def lumped() -> Resonators:
    return chip(30)


@pytest.fixture(scope="module")
def light(lumped: Resonators) -> Resonators:
    return without_inertia(lumped)


@pytest.mark.parametrize("damped", [1.0, 0.0])
def test_the_netlist_answers_as_the_model(light, tmp_path, damped):
    """``.ac`` of the emitted subcircuit against the sum over modes, undamped states at once."""
    model = dataclasses.replace(light, damp=damped * light.damp)
    part = subcircuit(model.linear(), "kick", HEADER)
    rings = " ".join(f"ring{k}" for k in range(6))
    cards = f"""Xkick 0 0 {rings} 0 kick
Iforce 0 ring0 dc 0 ac 1
.ac lin 40 1e6 40e6"""
    vectors = {f"ring{k}": (f"v(ring{k})", 1e-6) for k in range(6)}
    waves = run_deck(bench([part], cards, vectors), tmp_path)
    exact = model.transfer(waves["frequency"].real)[:, :6, 0]
    found = np.array([waves[f"ring{k}"] for k in range(6)]).T
    np.testing.assert_allclose(found, exact, rtol=1e-6, atol=1e-9 * np.abs(exact).max())


def _thrown(tau: float, speed: float, stop: float) -> tuple[np.ndarray, np.ndarray]:
    """A sphere on one mode and one massless state: plain equations by DOP853."""
    omega, damp, g, compliance = 2 * np.pi * 270e3, 2e4, 120.0, 2e-7

    def rhs(t, x):
        z, rate, q, y, v = x
        force = EPS * max(0.0, g * z + q - y)
        return [rate, -damp * rate - omega**2 * z - g * force, (-compliance * force - q) / tau,
                v, force / MASS]  # fmt: skip

    start = [0.0, 0.0, 0.0, 1e-7, -speed]
    done = solve_ivp(rhs, (0.0, stop), start, method="DOP853", rtol=1e-10, atol=1e-16)
    assert done.success
    return done.t, done.y


def test_a_bounce_is_that_of_the_plain_equations(tmp_path):
    """ngspice on the emitted parts and the independent integrator against DOP853."""
    tau, stop = 2e-8, 15e-6
    _, states = _thrown(tau, 1.0, stop)
    nominal = 2 * np.pi * 1e7
    full = chip(2)
    model = Resonators(
        np.array([2 * np.pi * 270e3, nominal]), np.array([2e4, tau * nominal**2]),
        np.array([[120.0, 0.0], [nominal * np.sqrt(2e-7), 0.0]]), np.diag([0.0, 34.87e-9]),
        (full.ports[0], full.ports[-1]), full.certificate, 1,
    )  # fmt: skip
    parts = [
        subcircuit(model.linear(), "kick", HEADER),
        contact_subcircuit(HEADER, ("ring0",), np.zeros(1), Normal(EPS)),
        sphere_subcircuit(HEADER, MASS, 1e-3, 0.0, velocity=-1.0, height=1e-7),
    ]
    cards = f"""Xkick 0 0 ring0 0 kick
Xcontact ring0 v bottom 0 contact
Xsphere v bottom y 0 sphere
.options reltol=1e-5 trtol=1 chgtol=1e-08
.tran 1e-08 {stop} 0 5e-08 uic"""
    waves = run_deck(bench(parts, cards, {"v": ("v(v)", 1.0)}, stop), tmp_path)
    assert waves["v"][-1] == pytest.approx(states[4, -1], rel=2e-5)
    density = MASS / (4 / 3 * np.pi * 1e-9)
    scene = load_scene({
        "name": "impact", "impact": {"velocity": -1.0, "gap": 1e-7}, "contact": {"rings": 1},
        "kick": {"electrical": "short"}, "sphere": {"radius": 1e-3, "density": density},
        "gravity": 0.0, "solver": {"stop": stop},
    })  # fmt: skip
    exact = solve(built(scene, model), waves).results
    assert exact["sphere.v"][-1] == pytest.approx(states[4, -1], rel=1e-7)
