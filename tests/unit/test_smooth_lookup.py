"""Lookups of the netlists between their heights, against the function and the full blend."""

import numpy as np
import pytest

from kc2spice.parts.ring_magnet_coils import smooth


def polyline(lines, s):
    points = np.array(", ".join(lines).split(", "), dtype=float).reshape(-1, 2)
    return np.interp(s, points[:, 0], points[:, 1])


def blended_parabolas(f, s):
    """Of the parabolas through three neighbours each, by the place between the inner two."""
    k = np.floor(s).astype(int)
    t = s - k
    before, a, b, after = (f[k + j] for j in (-1, 0, 1, 2))
    left = a + t * (b - before) / 2 + t**2 * (before - 2 * a + b) / 2
    right = b - (1 - t) * (after - a) / 2 + (1 - t) ** 2 * (a - 2 * b + after) / 2
    return (1 - t) * left + t * right


@pytest.mark.parametrize("points", [31, 101, 201, 401])
def test_bends_left_out_cost_a_small_part_of_the_blend_s_own_error(points):
    force = lambda x: x * np.exp(-(x**2))  # noqa: E731 - as a ring magnet's on its axis
    heights = np.linspace(-3.0, 3.0, points)
    s = np.linspace(1.0, points - 2.001, 20_011)
    exact, t = force(-3.0 + 6.0 * s / (points - 1)), s - np.floor(s)
    values, bends = smooth(force(heights))
    found = polyline(values, s) - (t - t**2) * polyline(bends, s)
    own = np.abs(blended_parabolas(force(heights), s) - exact).max()
    assert np.abs(found - exact).max() < 1.3 * own
    assert ", ".join(bends).count(",") < 0.5 * ", ".join(values).count(",")


def test_a_lookup_of_nothing_is_nothing():
    values, bends = smooth(np.zeros(9))
    s = np.linspace(-3.0, 11.0, 50)
    assert not polyline(values, s).any()
    assert not polyline(bends, s).any()
