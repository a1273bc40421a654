"""Distances between curves over frequency, against shifts and factors of a resonance."""

import numpy as np
import pytest
from support import compute_curve_distance


def resonance(f, f0=100.0, quality=60.0, gain=1.0):
    """Amplitude of a resonance of the largest value ``gain``."""
    return gain / quality / abs(1 - (f / f0) ** 2 + 1j * f / f0 / quality)


F = np.linspace(80.0, 120.0, 4001)
OTHER_F = np.geomspace(80.0, 120.0, 7001)


@pytest.mark.parametrize("shift", [1e-3, -2e-3, 5e-3])
def test_a_shifted_resonance_is_as_far_as_its_shift(shift):
    found = compute_curve_distance(
        F, resonance(F), OTHER_F, resonance(OTHER_F, 100 * (1 + shift)), 1.0
    )
    assert 0.7 * abs(shift) < found < 1.1 * abs(shift)
    assert abs(resonance(F) - resonance(F, 100 * (1 + shift))).max() > 40 * abs(shift)


@pytest.mark.parametrize("gain", [0.95, 1.1])
def test_a_higher_or_lower_peak_is_as_far_as_its_height(gain):
    """The flank of a peak is near a lower peak of the same frequency, but its maximum is not."""
    found = compute_curve_distance(F, resonance(F), OTHER_F, resonance(OTHER_F, gain=gain), 1.0)
    assert found == pytest.approx(abs(gain - 1), rel=0.02)


def test_a_missed_peak_counts():
    flat = np.full_like(F, 0.2)
    narrow = 0.2 + np.where(abs(OTHER_F - 101) < 0.1, 0.5, 0.0) * (1 - 10 * abs(OTHER_F - 101))
    assert compute_curve_distance(F, flat, OTHER_F, narrow, 1.0) == pytest.approx(0.5, rel=0.1)


def test_a_curve_has_no_distance_from_itself_on_a_part_of_its_range():
    inside = F[100:-100]
    assert compute_curve_distance(F, resonance(F), inside, resonance(inside), 1.0) < 1e-9
    assert compute_curve_distance(inside, resonance(inside), F, resonance(F), 1.0) < 1e-9
