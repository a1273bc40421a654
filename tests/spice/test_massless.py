"""Contact ports without inertia: exact statics, passivity, a bounce by plain equations."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from device import bench, built, chip
from scipy.integrate import solve_ivp

from kc2spice.core.errors import UsageError
from kc2spice.parts.contact import Normal, contact_subcircuit
from kc2spice.parts.sphere import sphere_subcircuit
from kc2spice.rom.march import chip_response
from kc2spice.rom.massless import SHARE, without_inertia
from kc2spice.rom.modal import Resonators, resonators
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


def test_statics_are_exact_and_the_form_is_passive(lumped, light):
    assert 0 < light.massless < light.order
    static = lumped.gain.T @ (lumped.gain / lumped.omega[:, None] ** 2) + lumped.D
    np.testing.assert_allclose(light.transfer(np.zeros(1))[0].real, static, rtol=1e-12, atol=1e-24)
    frequency = np.geomspace(1e3, 1e10, 200)
    H = light.transfer(frequency)
    power = 2j * np.pi * frequency[:, None, None] * H
    power = (power + power.conj().transpose(0, 2, 1)) / 2
    balance = np.sqrt(np.abs(np.diagonal(H, axis1=1, axis2=2)))
    power /= balance[:, :, None] * balance[:, None, :] * frequency[:, None, None]
    assert np.linalg.eigvalsh(power)[:, 0].min() > -1e-12


def test_the_cut_is_that_of_its_criterion(lumped, light):
    """Counted from the highest mode down, and the certificate covers what was measured."""
    top = lumped.certificate.band_hz[1]
    hertz, gain = lumped.omega / (2 * np.pi), lumped.gain[:, :6]
    share = gain**2 / lumped.omega[:, None] ** 2
    share = share * (top / hertz[:, None]) ** 2 / share.sum(axis=0)
    kept = lumped.order - np.count_nonzero(share[::-1].cumsum(axis=0).max(axis=1) <= SHARE)
    assert kept == light.order - light.massless
    frequency = np.linspace(0, top, 400)
    exact, found = lumped.transfer(frequency), light.transfer(frequency)
    error = np.abs(found - exact).max(axis=0) / np.abs(exact).max(axis=0)
    assert 0 < error.max() <= light.certificate.error_estimate


def test_what_contact_sees_above_the_band_is_added(lumped):
    before = dataclasses.replace(lumped.certificate, above=((1e6, 0.1), (2e6, 0.4)))
    light = without_inertia(dataclasses.replace(lumped, certificate=before))
    frequency = np.array([1e6, 2e6])
    exact, found = (
        np.diagonal(each.transfer(frequency), axis1=1, axis2=2)[:, :6] for each in (lumped, light)
    )
    more = np.abs(found / exact - 1).max(axis=1)
    assert more.min() > 1e-5
    said = [error for _, error in light.certificate.above]
    np.testing.assert_allclose(said, np.array([0.1, 0.4]) + more, rtol=1e-9)


def test_a_tolerance_is_kept(lumped):
    for tolerance in (1.5e-3, 1e-2):
        found = without_inertia(lumped, tolerance)
        assert found.certificate.error_estimate <= tolerance
    assert without_inertia(lumped, 1.0001e-3).massless == 0


def test_states_of_unequal_pace_are_kept_apart(lumped, light):
    """Damping by mass as well: each state has its own time, and the statics stay."""
    mixed = dataclasses.replace(lumped, damp=lumped.damp + 1e4)
    found = without_inertia(mixed)
    assert found.order == lumped.order > light.order
    static = light.transfer(np.zeros(1))
    np.testing.assert_allclose(found.transfer(np.zeros(1)), static, rtol=1e-11, atol=1e-24)


def test_an_electrode_without_capacitance_is_refused(lumped):
    with pytest.raises(UsageError, match="capacitance of its own"):
        without_inertia(dataclasses.replace(lumped, D=0 * lumped.D))


def test_matrices_and_back(light):
    again = resonators(light.linear())
    assert again.massless == light.massless
    np.testing.assert_array_equal(again.gain, light.gain)


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


def test_the_exact_answer_to_recorded_loads(light):
    """The energy balance's oracle against Radau, loads linear between uneven points."""
    rng = np.random.default_rng(3)
    t = np.concatenate([[0.0], np.cumsum(10.0 ** rng.uniform(-9, -7, 20))])
    load = np.cumsum(rng.normal(size=(21, 7)), axis=0)
    heavy = light.order - light.massless
    found = chip_response(light, t, load)

    def slope(now, x):
        z, rate = x[: light.order], x[light.order :]
        push = light.gain @ [np.interp(now, t, column) for column in load.T] - light.omega**2 * z
        moved = np.concatenate([rate, push[heavy:] / light.damp[heavy:]])
        return np.concatenate([moved, push[:heavy] - light.damp[:heavy] * rate])

    state = np.concatenate([light.gain @ load[0] / light.omega**2, np.zeros(heavy)])
    for k in range(1, t.size):
        span = (t[k - 1], t[k])
        state = solve_ivp(slope, span, state, method="Radau", rtol=1e-9, atol=1e-14).y[:, -1]
        output = state[: light.order] @ light.gain + load[k] @ light.D
        np.testing.assert_allclose(found.output[k], output, rtol=1e-5, atol=1e-11)
