"""Varied kicks all complete, and launch as the independent integrator says."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from hard_cases.loops import BOUND, loops

pytestmark = [pytest.mark.slow, pytest.mark.campaign]


@pytest.fixture(scope="module")
def found():
    return list(loops())


def test_launch_of_150_varied_kicks(found):
    """All complete, none needs hundreds of contacts, and every launch is within the bound."""
    assert len(found) == 150
    assert np.median([loop.error for loop in found]) <= 5e-5
    assert max(loop.error for loop in found) <= BOUND
    assert max(loop.touches for loop in found) <= 20
