"""Laws beside the penalty spring, each against a closed form or plain equations in scipy."""

import numpy as np
import pytest
from device import both, models
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from support import UsageError, load_scene, make_deck, run_deck

MASS = 4 / 3 * np.pi * 1e-9 * 7850.0


def bounce(**keys):
    return load_scene({
        "name": "bounce", "gravity": 0.0,
        "contact": {"part": "contact", "a": "gnd", **keys},
        "sphere": {"part": "sphere", "velocity": -1.0, "height": 1e-6},
        "solver": {"stop": 20e-6, "max_step": 1e-6, "reltol": 1e-4},
    })  # fmt: skip


@pytest.mark.parametrize(("law", "damping"), [("linear", 0.1), ("hertz", 1.0)])
def test_restitution_is_that_of_hunt_and_crossley(damping, law, tmp_path):
    """``ln((1 + c v) / (1 - c e v)) = c v (1 + e)`` at any exponent (Marhefka and Orin 1999)."""
    keys = {"modulus": 100e9} if law == "hertz" else {"penalty": 1e7}
    waves, exact, failed = both(bounce(law=law, damping=damping, **keys), tmp_path)
    e = brentq(lambda e: np.log((1 + damping) / (1 - damping * e)) - damping * (1 + e),
               1e-3, min(1.0, 1 / damping) * (1 - 1e-12))  # fmt: skip
    assert exact["sphere.v"][-1] == pytest.approx(e, rel=1e-8)
    assert waves["sphere.v"][-1] == pytest.approx(e, rel=2e-4)
    assert not failed


@pytest.mark.parametrize("angle", [60.0, 180.0])
def test_a_sphere_in_a_groove_leans_on_both_flanks(angle, tmp_path):
    """Flanks approach the sphere by s x, and push along the axis with s times their force."""
    scene = load_scene({
        "name": "groove", "gravity": 9.81, "sphere": {"part": "sphere"},
        "contact": {"part": "contact", "a": "gnd", "penalty": 1e6, "groove": angle},
        "solver": {"stop": 1e-3, "max_step": 1e-4},
    })  # fmt: skip
    waves, exact, _ = both(scene, tmp_path)
    s = np.sin(np.radians(angle) / 2)
    dent = -MASS * 9.81 / (2 * 1e6 * s**2)
    for found in (waves, exact):
        assert found["sphere.y"][-1] - 1e-3 == pytest.approx(dent, rel=1e-3)
        assert found["contact.flank"][-1] == pytest.approx(MASS * 9.81 / (2 * s), rel=1e-6)


def block(force, until, stop):
    """A block of 10 g that a horizontal force pushes over a floor."""
    return load_scene({
        "name": "block", "gravity": 9.81,
        "weight": {"part": "mass", "mass": 10e-3, "weight": True},
        "block": {"part": "mass", "mass": 10e-3, "pins": {"a": "push.out"}},
        "push": {"part": "source", "kind": "force",
                 "pulse": {"high": force, "width": until, "edge": 1e-6}},
        "floor": {"part": "contact", "a": "gnd", "b": "weight", "penalty": 1e5, "friction": 0.3,
                  "pins": {"slide": "block.a"}},
        "solver": {"stop": stop, "max_step": 20e-6},
    })  # fmt: skip


def test_a_pushed_block_slides_by_the_distance_of_coulomb_friction(tmp_path):
    """``x = a T^2 / 2 + (a T)^2 / (2 mu g)`` with ``a = F / m - mu g``."""
    waves, exact, failed = both(block(0.1, 5e-3, 30e-3), tmp_path)
    drag = 0.3 * 9.81
    a = 0.1 / 10e-3 - drag
    slid = a * 5e-3**2 / 2 + (a * 5e-3) ** 2 / (2 * drag)
    assert exact["block.x"][-1] == pytest.approx(slid, rel=2e-3)  # creep, and the edges
    assert waves["block.x"][-1] == pytest.approx(exact["block.x"][-1], rel=1e-3)
    assert waves["floor.friction"].max() == pytest.approx(0.3 * 10e-3 * 9.81, rel=1e-4)
    assert not failed


def test_newtons_cradle_against_plain_equations(tmp_path):
    """Momentum and energy are closed; each sphere as DOP853 has it."""
    scene = load_scene("newtons_cradle")
    waves = run_deck(make_deck(models(scene)), tmp_path)
    mass = 4 / 3 * np.pi * 1e-6 * 7860.0
    K = 4 / 3 * (211.9e9 / (1 - 0.291**2) / 2) * np.sqrt(5e-3)

    def rates(t, y):
        force = K * np.maximum(y[:4] - y[1:5], 0.0) ** 1.5
        return np.r_[y[5:], (np.r_[0.0, force] - np.r_[force, 0.0]) / mass]

    start = np.r_[-1e-6, np.zeros(4), 1.0, np.zeros(4)]
    plain = solve_ivp(rates, (0, scene.stop_time), start, method="DOP853", rtol=1e-11, atol=1e-14)
    speeds = np.array([waves[f"sphere{k}.v"] for k in range(1, 6)])
    assert np.abs(speeds.sum(axis=0) - 1.0).max() < 1e-9
    assert (speeds[:, -1] ** 2).sum() == pytest.approx(1.0, rel=1e-4)
    np.testing.assert_allclose(speeds[:, -1], plain.y[5:, -1], atol=1e-4)


def test_a_hertz_contact_requires_a_modulus_and_a_sphere_at_one_port():
    with pytest.raises(UsageError, match="modulus"):
        bounce(law="hertz")
    with pytest.raises(UsageError, match="requires a sphere that touches a part at a single port"):
        load_scene("impact", ["contact.law=hertz", "contact.rings=3"])


def test_a_ceiling_is_a_plane_above(tmp_path):
    """``x = (F + eps gap) / (k + eps)`` of what a spring holds and a force presses against it."""
    force, stiffness, penalty, gap = 1.0, 1e3, 1e5, 1e-4
    waves, _, failed = both(
        load_scene({
            "name": "ceiling", "gravity": 0.0, "analysis": {"type": "op"},
            "block": {"part": "mass", "mass": 1e-3, "pins": {"a": "spring.a"}},
            "spring": {"part": "spring", "stiffness": stiffness},
            "push": {"part": "source", "kind": "force", "dc": force, "pins": {"out": "block.a"}},
            "stop": {"part": "contact", "a": "block", "b": "gnd", "gap": gap, "penalty": penalty},
        }),
        tmp_path,
    )  # fmt: skip
    wanted = (force + penalty * gap) / (stiffness + penalty)
    assert waves["block.x"][-1] == pytest.approx(wanted, rel=1e-9)
    assert not failed
