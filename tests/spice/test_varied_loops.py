"""Varied kicks all complete, and launch as exact modes between the touches say."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from hard_cases.loops import CHAOTIC, loops


@pytest.mark.slow
def test_launch_of_150_varied_kicks():
    found = list(loops())
    assert len(found) == 150  # all complete
    assert np.median([loop.error for loop in found]) <= 5e-5
    assert max(loop.error for loop in found if loop.damping >= CHAOTIC) <= 2e-4
    # Thousands of touches multiply every error; closer tolerances do not help either.
    wild = [loop.error for loop in found if loop.damping < CHAOTIC]
    assert sum(error > 2e-4 for error in wild) <= 10
    assert max(wild) <= 5e-3
