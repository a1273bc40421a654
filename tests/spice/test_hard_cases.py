"""Every hard case is met, or refused with the true reason."""

from __future__ import annotations

import pytest
from hard_cases.every import CASES
from hard_cases.kit import judge

MARKED = [
    pytest.param(case, id=case.name, marks=[pytest.mark.slow] if case.slow else [])
    for case in CASES
]


@pytest.mark.parametrize("case", MARKED)
def test_hard_case(case):
    met, text = judge(case)
    print(f"| {case.entry} | {case.name} | {case.what} | {text} |")
    assert met, text


def test_their_names_differ():
    assert len({case.name for case in CASES}) == len(CASES)
