"""The table of the catch says how well a spline goes through its heights."""

import dataclasses

import numpy as np
import pytest

from kc2spice.fem.magnetics.table import EMTable
from kc2spice.parts.ring_magnet_coils import interpolation_error


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
