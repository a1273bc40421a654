"""Outcomes that the errors of reduced bodies may change."""

import pytest
from support import Check, add_undecided_warnings

GRAVITY = 9.81


def flown(velocity, error, ceiling):
    """Checks of a flight to ``v^2 / 2 g`` under a ceiling, the velocity being off by ``error``."""
    height = velocity**2 / (2 * GRAVITY)
    beyond, distance = max(0.0, height - ceiling), abs(ceiling - height)
    left = Check("table_left", beyond, 0.0, "m", "widen it", distance=distance, travel=height,
                 label="height outside", undecided_label="height error near an end")  # fmt: skip
    return [Check("reduction of chip", error, 0.1, loaded=True), left]


@pytest.mark.parametrize("error", [1e-3, 1e-2])
@pytest.mark.parametrize("share", [-0.025, -0.015, -0.0015, 0.0015, 0.015, 0.025])
def test_an_outcome_is_undecided_if_the_error_reaches_the_limit(error, share):
    """The exact heights at both ends of the velocity's error lie on either side of the ceiling."""
    speed = 1.0
    ceiling = (1 - share) * speed**2 / (2 * GRAVITY)
    ends = [(speed * (1 + sign * error)) ** 2 / (2 * GRAVITY) > ceiling for sign in (-1, 1)]
    checks = {c.name: c for c in add_undecided_warnings(flown(speed, error, ceiling))}
    left = checks["table_left"]
    assert left.passed == (share < 0)
    told = "table_left undecided" in checks or "inconclusive" in left.advice
    assert told == (ends[0] != ends[1])
    if told and left.passed:
        assert checks["table_left undecided"].action == "warn"
        assert not checks["table_left undecided"].passed
        assert checks["table_left undecided"].label == "height error near an end"
    if not left.passed:
        assert left.is_fatal


def test_an_outcome_far_from_its_limit_is_decided():
    checks = flown(1.0, 0.05, 1.0)
    assert list(add_undecided_warnings(checks)) == checks
