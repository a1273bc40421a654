"""The table of the catch says how well a spline goes through its heights."""

import numpy as np
import pytest

from kc2spice.fem.magnetics.table import EMTable
from kc2spice.parts.ring_magnet_coils import (
    interpolation_error,
    resampling_error,
    smooth,
)


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
