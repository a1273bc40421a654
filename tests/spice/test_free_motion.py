"""Masses and bodies that nothing holds, or something soft: closed forms, and what has none."""

import numpy as np
import pytest
from device import both
from support import LinearModel, Port, UsageError, list_inertial_pins, load_scene

MASS, G = 1e-6, 9.81
BOX = {"part": "mass", "mass": MASS}
SEEN = {"part": "sensor", "pins": {"of": "box.a"}}
STEPS = {"solver": {"stop": 0.1, "max_step": 1e-3}}


def ran(tables, directory):
    waves, exact, failed = both({"name": "free", **tables}, directory)
    assert not failed
    return waves, exact


def push(**keys):
    return {"part": "source", "kind": "force", "pins": {"out": "box.a"}, **keys}


def test_a_free_mass_keeps_its_velocity(tmp_path):
    """A hidden spring of 1e-3 N/m would have turned it back within 50 ms."""
    for found in ran({"box": BOX | {"velocity": 1.0}, "seen": SEEN, **STEPS}, tmp_path):
        np.testing.assert_allclose(found["box.x"], found["time"], rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(found["box.v"], 1.0, rtol=1e-9)


@pytest.mark.parametrize(
    ("keys", "start"),
    [({}, (-MASS * G, 0.0)), ({"position": 2e-6}, (2e-6, 0.0)), ({"velocity": 3e-3}, (0.0, 3e-3))],
)
def test_one_stated_start_makes_the_other_zero(keys, start, tmp_path):
    """Without both keys, the mass begins in the equilibrium ``-m g / k`` of its spring."""
    spring = {"part": "spring", "stiffness": 1.0, "pins": {"a": "box.a"}}
    steps = {"solver": {"stop": 10e-6, "max_step": 1e-6}}
    tables = {"box": BOX | {"weight": True} | keys, "spring": spring, "seen": SEEN, **steps}
    for found in ran(tables, tmp_path):
        first = found["box.x"][0], found["box.v"][0]
        np.testing.assert_allclose(first, start, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("shape", [{"sine": {"frequency": 1e3}}, {"pwl": [[0, 0], [1, 1e-6]]}])
def test_a_jump_of_velocity_is_refused_where_nothing_yields(shape):
    table = {"part": "source", "kind": "displacement", "pins": {"out": "box.a"}}
    with pytest.raises(UsageError, match=r"makes the velocity of .* jump") as caught:
        load_scene({"name": "free", "box": BOX, "table": table | shape, **STEPS})
    assert caught.value.where == f"scene, key table.{next(iter(shape))}"
    joint = {"part": "spring", "stiffness": 1.0, "pins": {"a": "table.out", "b": "box.a"}}
    table["pins"] = {}
    load_scene({"name": "free", "box": BOX, "table": table | shape, "joint": joint, **STEPS})


@pytest.mark.parametrize(("light", "D", "found"), [(1, 0, ("tip",)), (0, 0, ()), (1, 1e-9, ())])
def test_a_jump_of_the_load_moves_only_massless_states(light, D, found):
    M, ports = np.diag([1.0, light]), [Port("tip", "mechanical")]
    model = LinearModel(M=M, E=0 * M, K=np.eye(2), B=[[1.0], [1.0]], D=[[D]], ports=ports)
    assert list_inertial_pins(model) == found


def test_two_masses_on_a_spring_keep_their_momentum(tmp_path):
    """The centre of mass keeps its velocity; masses swing with ``sqrt(k (1 / m1 + 1 / m2))``."""
    other = {"part": "mass", "mass": 2 * MASS}
    join = {"part": "spring", "stiffness": 1.0, "pins": {"a": "box.a", "b": "other.a"}}
    tables = {"box": BOX | {"velocity": 1.0}, "other": other, "join": join,
              "solver": {"stop": 20e-3, "max_step": 5e-6, "reltol": 1e-6}}  # fmt: skip
    w = np.sqrt(1.0 / MASS * 1.5)
    for found, error in zip(ran(tables, tmp_path), (1e-3, 1e-8), strict=True):
        t = found["time"]
        momentum = MASS * found["box.v"] + 2 * MASS * found["other.v"]
        np.testing.assert_allclose(momentum, MASS, rtol=1e-9)
        # the trapezoid is late by (w h)^2 / 12 of the phase: 4e-4 after four periods
        apart = found["box.x"] - found["other.x"]
        np.testing.assert_allclose(apart, np.sin(w * t) / w, atol=error / w)


def test_the_response_of_a_free_mass_is_that_of_its_inertia(tmp_path):
    """From 1 mHz, where a hidden spring of 1e-3 N/m would have held 1 mg, to 1 MHz."""
    sweep = {"type": "ac", "start": 1e-3, "stop": 1e6, "points": 30}
    coil = {"part": "inductor", "inductance": 1.0, "pins": {"a": "drop.out"}}
    tables = {"box": BOX, "push": push(ac=1.0), "analysis": sweep,
              "box_a_held": coil, "drop": {"part": "source"}}  # fmt: skip
    for found in ran(tables, tmp_path):
        w = 2 * np.pi * found["frequency"].real
        np.testing.assert_allclose(found["box.x"], -1 / (MASS * w**2), rtol=1e-9)


SPRING = {"part": "spring", "stiffness": 1.0, "pins": {"a": "box.a", "b": "other.a"}}
NO_REST = {
    "op": ({"box": BOX, "push": push(dc=1e-2), "analysis": {"type": "op"}}, "box"),
    "dc": ({"box": BOX, "push": push(), "analysis": {
        "type": "dc", "sweep": "push.dc", "to": 1.0}}, "box"),
    "ac": ({"box": BOX, "push": push(dc=1e-2, ac=1.0), "analysis": {
        "type": "ac", "start": 1.0, "stop": 1e3}}, "box"),
    "weight": ({"box": BOX | {"weight": True}, "push": push(ac=1.0), "analysis": {
        "type": "ac", "start": 1.0, "stop": 1e3}}, "box"),
    "held by another that is free": (
        {"box": BOX, "other": BOX, "join": SPRING, "push": push(dc=1.0),
         "analysis": {"type": "op"}}, "box"),
    "a damper": ({"box": BOX | {"weight": True}, "analysis": {"type": "op"}, "oil": {
        "part": "damper", "damping": 1.0, "pins": {"a": "box.a"}}}, "box"),
    "an open contact": ({"box": BOX | {"weight": True}, "analysis": {"type": "op"}, "floor": {
        "part": "contact", "a": "gnd", "b": "box", "gap": 1e-6}}, "box"),
    "a sphere": ({"ball": {"part": "sphere"}, "analysis": {"type": "op"}}, "ball"),
}  # fmt: skip


@pytest.mark.parametrize("case", NO_REST)
def test_nets_without_equilibrium_are_errors_before_the_run(case):
    tables, name = NO_REST[case]
    with pytest.raises(UsageError, match=f"{name} has no support") as caught:
        load_scene({"name": "free", **tables})
    assert "spring" in caught.value.expected


def test_parts_that_touch_the_ground_rest_on_it(tmp_path):
    floor = {"part": "contact", "a": "gnd", "b": "box", "penalty": 1e5}
    tables = {"box": BOX | {"weight": True}, "floor": floor, "analysis": {"type": "op"}}
    for found in ran(tables, tmp_path):
        assert found["floor.force"][-1] == pytest.approx(MASS * G, rel=1e-9)
