"""Varied kicks all complete, and launch as exact modes between the touches say."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from hard_cases.loops import BOUND, loops

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found():
    return list(loops())


def test_launch_of_150_varied_kicks(found):
    """The bound for every launch that is determined to half of it by its data."""
    assert len(found) == 150  # all complete
    assert np.median([loop.error for loop in found]) <= 5e-5
    known = [loop for loop in found if loop.doubt <= BOUND / 2]
    assert max(loop.error for loop in known) <= BOUND
    assert len(known) >= 140
    for loop in found:
        if loop not in known:  # each was refined, for its hundreds of touches
            assert loop.rungs == 3
            assert loop.touches > 400


@pytest.mark.xfail(strict=True, reason="six launches that their data do not determine")
def test_no_launch_is_beyond_the_bound(found):
    assert max(loop.error for loop in found) <= BOUND
