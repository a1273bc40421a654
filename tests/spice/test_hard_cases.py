"""Every hard case is met or refused with the true reason; most decks run on default options too."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from hard_cases.every import CASES
from hard_cases.kit import judge

MARKED = [
    pytest.param(case, id=case.name, marks=[pytest.mark.slow] if case.slow else [])
    for case in CASES
]


@pytest.mark.parametrize("case", MARKED)
def test_hard_case(case):
    outcome, _ = judge(case)
    assert outcome.met, f"error {outcome.error}, limit {case.limit}: {outcome.text}"


def test_there_are_enough_of_them():
    assert len({case.name for case in CASES}) == len(CASES) >= 60


@pytest.mark.slow
@pytest.mark.campaign
def test_nine_of_ten_converge_on_default_options():
    """Decks without their ``.options``; users' circuits that are meant to fail do not count."""
    ran = failed = 0
    for case in CASES:
        if "user circuit" in case.entry:
            continue
        _, bench = judge(case, plain=True)
        ran, failed = ran + (bench.decks > 0), failed + bool(bench.failures)
    assert failed <= 0.1 * ran, f"{failed} of {ran}"
