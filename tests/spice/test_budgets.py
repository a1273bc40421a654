"""Error budgets of random devices against oracles of their own: none is missed in silence."""

import pytest
from hard_cases.budgets import COUNT, judged


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("number", range(COUNT))
def test_a_budget_is_held_or_the_run_says_that_it_is_not(number):
    found = judged(number)
    print(f"BUDGET {found}")
    assert found.outcome != "SILENT"
