"""Varied kicks all complete, and launch as exact modes between the touches say."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from hard_cases.loops import CHAOTIC, loops

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def found():
    return list(loops())


def test_launch_of_150_varied_kicks(found):
    assert len(found) == 150  # all complete
    assert np.median([loop.error for loop in found]) <= 5e-5
    assert max(loop.error for loop in found if loop.damping >= CHAOTIC) <= 2e-4


@pytest.mark.xfail(strict=True, reason="eight kicks damped by less than 0.05 % are beyond it")
def test_no_launch_is_beyond_2e_4(found):
    assert max(loop.error for loop in found) <= 2e-4
