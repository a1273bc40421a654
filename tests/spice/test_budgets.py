"""Error budgets of random devices against oracles of their own: none is missed in silence."""

import pytest
from hard_cases.budgets import COUNT, judged


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("number", range(COUNT))
def test_a_run_meets_its_error_budget_or_warns(number):
    found = judged(number)
    print(f"BUDGET {found}")
    assert found.outcome != "SILENT"
