"""Random kicks keep their error budget, or say that they do not."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from hard_cases.budgets import drawn, judged

pytestmark = [pytest.mark.slow, pytest.mark.campaign]


@pytest.mark.parametrize("number", [0, 3, 5, 16])
def test_a_budget_holds_or_the_run_says_that_it_does_not(number):
    found = judged(number)
    assert found.outcome in ("holds", "said"), found
    assert (found.error <= found.budget) == (found.outcome == "holds")


def test_draws_cover_what_is_claimed():
    budgets, keys = zip(*(drawn(number) for number in range(100)), strict=True)
    assert min(budgets) < 2e-5
    assert max(budgets) > 5e-4
    assert sum(any("voltage=-" in key for key in each) for each in keys) > 10
    assert sum(any("enable_at" in key for key in each) for each in keys) > 20
