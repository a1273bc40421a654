"""Stops that keep a part of each strike: bounce by bounce in closed form, until nothing bounces."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from support import BuiltScene, Waveforms, add_results_and_sources, load_scene, solve_laws

import kc2spice as kc

PLATE = Path(__file__).parents[2] / "docs/published/plate_pull_in.toml"
MASS, PUSH, TRAVEL, STOP = 1e-6, 1e-4, 1e-4, 1e4  # kg, N, m, N/m
PARTS = {
    "parallel_plate": {"area": 1e-8, "gap": 2e-4, "travel": TRAVEL},
    "comb_drive": {"fingers": 1, "thickness": 1e-6, "gap": 1e-6, "overlap": 1e-3, "travel": TRAVEL},
    "reluctance": {"area": 1e-6, "gap": 1e-3, "resistance": 1.0, "travel": TRAVEL},
    "above": {"area": 1e-8, "gap": 2e-4, "travel": TRAVEL, "a": "mass.a"},
    "below": {"area": 1e-8, "gap": 2e-4, "travel": TRAVEL, "a": "mass.a"},
}


def pushed(kind, restitution=None, **keys):
    """A mass that a constant force pushes against a stop, without voltage."""
    plate = {"part": kind, **PARTS[kind], "stop": STOP, "pins": {"plus": "drive.out"}, **keys}
    if restitution is not None:
        plate["restitution"] = restitution
    if kind in ("above", "below"):
        plate |= {"part": "gap", "side": kind}
    else:
        plate["pins"]["a"] = "mass.a"
    force = PUSH * (-1 if kind == "below" else 1)
    return {
        "name": "pushed",
        "gravity": 0.0,
        "plate": plate,
        "mass": {"part": "mass", "mass": MASS},
        "drive": {"part": "source", "dc": 0.0},
        "push": {"part": "source", "kind": "force", "pins": {"out": "mass.a"},
                 "pulse": {"high": force, "width": 1.0, "edge": 1e-9}},
        "solver": {"stop": 6e-3, "max_step": 2e-6},
    }  # fmt: skip


def bounces(restitution, count):
    """Time of each highest place between strikes, and how far it is from the stop: a spring of
    ``2 STOP / (1 + e^2)`` on the way in, of e^2 times that on the way out, under constant push."""
    a = PUSH / MASS
    stiff = 2 * STOP / (1 + restitution**2)
    time, speed, result = np.sqrt(2 * TRAVEL / a), np.sqrt(2 * a * TRAVEL), []
    for _ in range(count):
        w, rest = np.sqrt(stiff / MASS), PUSH / stiff
        swing = np.hypot(rest, speed / w)
        time += (np.pi - np.arctan2(speed / w, rest)) / w  # d = rest - rest cos wt + v/w sin wt
        soft = stiff * restitution**2
        w, below = np.sqrt(soft / MASS), PUSH / soft
        over = rest + swing - below
        angle = np.arccos(-below / over)
        time, speed = time + angle / w, over * w * np.sin(angle)
        result.append((time + speed / a, speed**2 / (2 * a)))
        time += 2 * speed / a
    return np.array(result)


@pytest.mark.parametrize("kind", PARTS)
def test_a_mass_bounces_with_its_restitution_and_comes_to_rest(kind):
    """0.5 by default: heights fall to a quarter. Ten bounces are at the speed of the law's rest."""
    waves = kc.run(pushed(kind)).waves
    away = TRAVEL - np.abs(waves["mass.x"])
    k = 1 + np.flatnonzero((np.diff(away)[:-1] > 0) & (np.diff(away)[1:] <= 0))
    exact = bounces(0.5, 3)
    np.testing.assert_allclose(away[k][:3], exact[:, 1], rtol=6e-3)
    np.testing.assert_allclose(waves["time"][k][:3], exact[:, 0], rtol=1e-3)
    late = waves["time"] > 5e-3
    assert np.abs(waves["mass.v"][late]).max() < 1e-6
    np.testing.assert_allclose(-away[late], PUSH / STOP, rtol=1e-3)


@pytest.mark.parametrize(("restitution", "damping"), [(0.8, 0.0), (1.0, 2.0)])
def test_both_kinds_of_loss_are_those_of_ngspice_and_of_the_integrator(restitution, damping):
    scene = pushed("parallel_plate", restitution, damping=damping)
    scene["solver"]["stop"] = 3e-3
    waves = kc.run(scene).waves
    law = solve_laws(
        add_results_and_sources(BuiltScene(load_scene(scene), {})),
        Waveforms({"time": waves["time"]}, {}),
    ).results
    exact = bounces(restitution, 1)[0, 1]
    if damping:
        speed = left(damping, np.sqrt(2 * PUSH / MASS * TRAVEL))
        exact = speed**2 * MASS / (2 * PUSH)
    for times, found in ((waves["time"], waves["mass.x"]), (law["time"], law["mass.x"])):
        assert TRAVEL - found[times > 1.5e-3].min() == pytest.approx(exact, rel=3e-3)


def left(damping, speed):
    """Speed after a strike: ``m d'' = PUSH - STOP d (1 + damping d')`` from d = 0 to d = 0."""

    def rates(t, y):
        return [y[1], (PUSH - STOP * y[0] * (1 + damping * y[1])) / MASS]

    def out(t, y):
        return y[0] + 1e-15 * (t == 0.0)

    out.terminal, out.direction = True, -1
    done = solve_ivp(rates, (0, 1e-3), [0.0, speed], events=out, rtol=1e-9, atol=1e-15)
    return abs(done.y[1, -1])


@pytest.mark.parametrize("stop", [1e4, 1e6, 1e8, 1e10])
def test_a_stop_of_any_stiffness_returns_its_restitution(stop):
    """A mass that is thrown at it with 0.1 m/s leaves with half of that, within 1 %."""
    scene = pushed("parallel_plate", 0.5) | {"checks": {"plausible": "off"}}
    scene["plate"] |= {"stop": stop, "travel": 1e-5}
    scene["push"]["pulse"] = {"high": 1e-2, "width": 1e-5, "edge": 1e-6}
    scene["solver"] = {"stop": 4e-4}
    waves = kc.run(scene).waves
    before = waves["mass.v"][np.searchsorted(waves["time"], 5e-5)]
    assert before == pytest.approx(0.1, rel=1e-3)
    assert -waves["mass.v"][-1] / before == pytest.approx(0.5, rel=0.01)


@pytest.mark.slow
def test_a_hard_stop_balances_the_force_on_it():
    """30 mg snap onto a stop of 10 GN/m and rest there, at the first attempt: ngspice has chosen
    pivots that keep the digits of steps of picoseconds."""
    keys = {"plate.restitution": 0.3, "solver.retries": 0, "solver.stop": "397 ms"}
    found = kc.run(load_scene(PLATE, keys))
    volts, gap, stiffness, travel = found.waves["drive.v"][-1], 1e-6, 3e6, 0.9e-6

    def force(depth):
        pull = 8.8541878188e-12 * 1e-6 * volts**2 / (2 * (gap - travel - depth) ** 2)
        return 1e10 * depth + stiffness * (travel + depth) - pull

    depth = brentq(force, 0.0, 5e-8)
    assert found.waves["plate.x"][-1] - travel == pytest.approx(depth, rel=1e-3)
    assert abs(found.waves["mass.v"][-1]) < 1e-6
