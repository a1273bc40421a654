"""Splines against scipy, which the product does not load for them."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from kc2spice.fem.magnetics.cubics import cubic_spline


@pytest.fixture(params=[2, 3, 4, 5, 41])
def case(request):
    """Uneven nodes, two functions of different size."""
    rng = np.random.default_rng(request.param)
    x = np.cumsum(rng.uniform(0.5, 2.0, request.param)) * 1e-4
    values = rng.standard_normal((x.size, 2)) * (1.0, 1e-6)
    return x, values, np.concatenate([x, np.linspace(x[0], x[-1], 1001)])


def close(ours, theirs):
    # Rounding of the two eliminations, of the order of the condition number times 1e-16.
    np.testing.assert_allclose(ours / abs(theirs).max(0), theirs / abs(theirs).max(0), atol=1e-12)


def test_spline_is_scipys(case):
    x, values, where = case
    close(cubic_spline(x, values)(where), CubicSpline(x, values)(where))


def test_integral_is_scipys_and_can_be_raised(case):
    x, values, where = case
    ours, theirs = cubic_spline(x, values).integral(), CubicSpline(x, values).antiderivative()
    close(ours(where), theirs(where))
    offset = np.array([1.0, -2.0])
    np.testing.assert_allclose(ours.raised(offset)(where) - ours(where), 0 * ours(where) + offset)


def test_a_cubic_is_reproduced_and_shapes_broadcast():
    x = np.array([0.0, 0.1, 0.7, 1.0, 3.0])
    spline = cubic_spline(x, (x**3 - x)[:, None])
    where = np.linspace(0, 3, 12).reshape(3, 4)
    assert spline(where).shape == (3, 4, 1)
    np.testing.assert_allclose(spline(where)[..., 0], where**3 - where, atol=1e-12)
    assert spline(0.5).shape == (1,)
