"""The bound on the launch velocity against a field that is the same everywhere."""

import numpy as np
import pytest

from kc2spice.fem.magnetics.table import EMTable
from kc2spice.scene.load import load_scene
from laboratory.rails import largest_speed


@pytest.fixture(scope="module")
def uniform():
    y = np.linspace(-2.5e-3, 7.5e-3, 11)
    none, one = np.zeros(11), np.ones(11)
    return EMTable(
        y=y, c0=none, c1=-0.3 * one, c2=0.3 * one, c11=none, c12=none, c22=none,
        flux0=np.zeros((11, 2)), inductance=np.zeros((11, 2, 2)),
        resistance=np.array([1500.0, 1500.0]), unknowns=0,
    )  # fmt: skip


@pytest.fixture(scope="module")
def scene():
    return load_scene(
        {"name": "rails", "kick": {}, "contact": {}, "sphere": {}, "catch": {}, "control": {}}
    )


@pytest.mark.parametrize(("rail", "current"), [(30.0, 0.01), (150.0, 0.05), (900.0, 0.1)])
def test_braking_work_is_force_times_way(uniform, scene, rail, current):
    mass = scene.part("sphere").keys.mass
    work = (0.6 * current + mass * scene.gravity) * 6.5e-3  # to the end of the table
    assert largest_speed(rail, scene, uniform, 3000.0) == pytest.approx(
        np.sqrt(2 * work / mass), rel=1e-9
    )
