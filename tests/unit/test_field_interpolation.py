"""The table of the catch says how well a spline goes through its heights."""

import dataclasses

import numpy as np
import pytest

from kc2spice.fem.magnetics.table import EMTable
from kc2spice.parts.ring_magnet_coils import (
    RingMagnetCoils,
    interpolation_error,
    resampling_error,
    smooth,
)
from kc2spice.scene.load import load_scene
from kc2spice.scene.plan import plan


def bump(y):
    return 1e-3 * y / 1e-3 * np.exp(-((y / 1e-3) ** 2))


def table(positions):
    y = np.linspace(-4e-3, 4e-3, positions)
    zero = np.zeros(positions)
    return EMTable(
        y=y, c0=bump(y), c1=zero, c2=zero, c11=zero, c12=zero, c22=zero,
        flux0=np.zeros((positions, 2)), inductance=np.tile(np.eye(2), (positions, 1, 1)),
        resistance=np.ones(2), unknowns=0,
    )  # fmt: skip


@pytest.mark.parametrize("positions", [13, 17, 25, 41])
def test_estimate_covers_the_error_between_the_heights(positions):
    found = table(positions)
    fine = np.linspace(-4e-3, 4e-3, 4001)
    truth = np.abs(found.splines(fine)[:, 0] - bump(fine)).max() / bump(fine).max()
    assert truth <= interpolation_error(found, 0.1) <= 40 * truth


def test_a_few_heights_are_too_few():
    assert interpolation_error(table(5), 0.0) > 1e-2
    assert interpolation_error(dataclasses.replace(table(41)), 0.0) < 1e-2


def polyline(lines, s):
    points = np.array(", ".join(lines).split(", "), dtype=float).reshape(-1, 2)
    return np.interp(s, points[:, 0], points[:, 1])


@pytest.mark.parametrize("points", [31, 101, 201])
def test_the_error_of_the_lookup_is_that_of_the_netlist_s_text(points):
    found = table(41)
    s = np.linspace(0.0, points - 1.0, 100 * (points - 1) + 1)
    splines = found.splines(np.linspace(-4e-3, 4e-3, points))[:, 0]
    values, bends = smooth(splines)
    t = s - np.floor(s)
    netlist = polyline(values, s) - t * (1 - t) * polyline(bends, s)
    exact = found.splines(-4e-3 + 8e-3 * s / (points - 1))[:, 0]
    truth = np.abs(netlist - exact).max() / np.abs(exact).max()
    assert resampling_error(found, points, 0.1) == pytest.approx(truth, rel=2e-2)


@pytest.mark.parametrize(("positions", "low", "high"), [(9, 1e-2, 1.0), (41, 1e-6, 1e-3)])
def test_explain_states_what_few_heights_cost(positions, low, high, monkeypatch):
    """A table of 9 heights is more than 1e-2 off, whatever its lookup's own error is."""
    fine = np.linspace(-4e-3, 4e-3, 4001)
    truth = np.abs(table(positions).splines(fine)[:, 0] - bump(fine)).max() / bump(fine).max()
    monkeypatch.setattr(RingMagnetCoils, "build", lambda *_: table(positions))
    scene = load_scene("kick_and_catch", {"catch.positions": positions})
    rows = {row.stage: row for row in plan(scene, estimate=True).errors}
    assert low < truth < high
    assert truth <= rows["heights of catch"].expected <= 40 * truth
    assert 0.0 < rows["lookup of catch"].expected < 1e-4
