"""Peers and lower bound of the benchmark share their equations: each against one path that shares
nothing with them, written from the paper's equations and the device's own numbers."""

from __future__ import annotations

import device
import numpy as np
import pytest
from hard_cases.modal_kick import Kick
from scipy.interpolate import make_interp_spline

from kc2spice.scene.load import load_scene
from laboratory.law import Mode, law
from laboratory.lower_bound import LowerBound
from laboratory.peers import Peer, _linear
from laboratory.segments import Segment

RADIUS, DENSITY, GRAVITY = 1e-3, 7850.0, 9.81  # the scene's own: SI
MASS = DENSITY * 4 / 3 * np.pi * RADIUS**3
RING = 4 * 1e8  # N/m of a whole ring
SETPOINT, KP, KI, KD, ROLLOFF, LIMIT = 2.5e-3, 5e4, 10.0, 20.0, 100e-9, 0.1
GAP = RADIUS - np.sqrt(RADIUS**2 - device.RADII**2)


def rates(chip, field, volts, state, enabled):
    """``z'' + damp z' + omega^2 z = g_anode V - g_rings F``, Newton's law of the sphere, the PID
    with clamp and roll-off; forces by a spline of each coefficient of the table."""
    z, speed, height, v, rate, integral = state
    force = np.maximum(0.0, chip.gain[:, :6].T @ z - height - GAP) * RING
    bend = chip.gain[:, 6] * volts - chip.gain[:, :6] @ force - chip.damp * speed
    error = SETPOINT - RADIUS - height
    wanted = KP * error + integral + KD * rate if enabled else 0.0
    current = float(np.clip(wanted, -LIMIT, LIMIT))
    names = ("c0", "c1", "c2", "c11", "c12", "c22")
    at = {n: float(make_interp_spline(field.y, getattr(field, n))(RADIUS + height)) for n in names}
    lower, upper = -current, current
    pull = at["c0"] + at["c1"] * lower + at["c2"] * upper + at["c11"] * lower**2
    pull += at["c12"] * lower * upper + at["c22"] * upper**2
    lift = (force.sum() + pull) / MASS - GRAVITY
    wound = KI * error if enabled and current == wanted else 0.0
    return speed, bend - chip.omega**2 * z, v, lift, (-v - rate) / ROLLOFF, wound


@pytest.mark.parametrize("seed", [0, 1, 3])
def test_rates_of_peers_are_those_of_the_equations(loop, model, seed):
    """At random states: in contact and in flight, at the limit and below, before and after it is
    enabled."""
    rng = np.random.default_rng(seed)
    equations, q = law(loop), model.omega.size
    z = rng.normal(size=q) * 1e-6 / np.abs(model.gain[:, :6]).max(axis=1)
    speed = rng.normal(size=q) * model.omega * np.abs(z)
    height = (-1e-7, 2e-8, 0.4e-3, 1.4999e-3, 1.5e-3, 2e-3)[seed]
    v, rate, integral = rng.normal(size=3) * (0.5, 1e-4, 1e-3)
    volts, enabled = 37.0 * rng.normal(), seed % 3 != 1
    scale = equations.scale
    x = np.r_[scale * z, scale * speed / model.omega, height, v, rate, integral]
    wanted = rates(model, device.magnets(), volts, (z, speed, height, v, rate, integral), enabled)
    exact = np.r_[scale * wanted[0], scale * wanted[1] / model.omega, wanted[2:]]
    peer = Peer(equations, Segment(0.0, 1.0, volts, 0.0, enabled), _linear(equations))
    sphere = x[2 * q :]
    saturated = int(
        np.sign(equations.demand(sphere) - np.clip(equations.demand(sphere), -LIMIT, LIMIT))
    )
    mode = Mode(0.0, volts, 0.0, enabled, saturated)
    for found in (peer.rhs(0.0, x), equations.rhs(0.0, x, mode)):
        for part in (slice(0, q), slice(q, 2 * q)):
            size = np.abs(exact[part]).max()
            np.testing.assert_allclose(found[part], exact[part], rtol=0, atol=1e-12 * size)
        np.testing.assert_allclose(found[2 * q :], exact[2 * q :], rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_lower_bound_throws_as_modes_in_closed_form_do(model):
    """Chip, contact and sphere alone: steps of 0.5 and 0.25 ns, their limit of second order."""
    tables = {"name": "kick", "gravity": GRAVITY, "kick": {}, "contact": {"rings": "all"}}
    scene = load_scene(tables | {"sphere": {}, "solver": {"stop": "0.53 ms"}})
    waves = LowerBound(law(device.built(scene, model))).run(scene)
    edge, width, start = 0.1e-6, 25e-6, 5e-6
    times = start + np.array([0.0, edge, width, width + edge])
    corners = np.stack([times, [0.0, 100.0, 100.0, 0.0]], axis=1)
    weight = np.array([[0.0, -MASS * GRAVITY], [1.0, -MASS * GRAVITY]])
    kick = Kick(model.omega, model.damp, model.gain, 50e-6, RADIUS, MASS, RING, corners, weight)
    speeds = [kick.flight(step, start + 30e-6)[2][-1] for step in (0.5e-9, 0.25e-9)]
    limit = speeds[1] + (speeds[1] - speeds[0]) / 3
    ours = np.interp(0.5e-3 + 30e-6, waves["time"], waves["sphere.v"])
    assert ours == pytest.approx(limit, rel=1e-5)
