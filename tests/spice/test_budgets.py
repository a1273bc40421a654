"""Random kicks keep their error budget, or say that they do not; what they state is true."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import pytest

from kc2spice.scene.load import load_scene
from kc2spice.workflow import run
from kc2spice.workflow.judge import metrics

sys.path.insert(0, str(Path(__file__).parent))
from hard_cases.budgets import drawn, judged

pytestmark = pytest.mark.slow
QUICK = 0, 1, 3  # the others take half an hour: more of them on request


@pytest.mark.parametrize(
    "number",
    [*QUICK, *(pytest.param(n, marks=pytest.mark.campaign) for n in range(100) if n not in QUICK)],
)
def test_a_budget_holds_or_the_run_says_that_it_does_not(number):
    found = judged(number)
    if found.outcome == "nothing leaves":
        return
    assert found.outcome.startswith(("holds", "said")), found
    assert found.error - found.doubt <= max(found.said, found.budget), found


def test_draws_cover_what_is_claimed():
    budgets, keys = zip(*(drawn(number) for number in range(100)), strict=True)
    assert min(budgets) < 2e-5
    assert max(budgets) > 5e-4
    assert sum(any("voltage=-" in key for key in each) for each in keys) > 10
    assert sum(any("enable_at" in key for key in each) for each in keys) > 20


def test_a_kick_behind_an_amplifier_keeps_its_budget(tmp_path):
    """5 A make it a slow kick, 1.5e-3 off at the settings of a quick one."""
    launches = []
    closer = ["rom.order=78", "rom.band=[0, 4e6]", "solver.reltol=3e-6", "solver.chgtol=1e-9"]
    for keys in (["error_budget=1e-4"], closer):
        scene = load_scene("amplifier_kick", [*keys, "solver.stop=0.6 ms"])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            done = run.complete(scene, tmp_path)
        launches.append(metrics(done.outcome.waves, done.build)["launch_velocity_m_s"])
        checks = done.outcome.verdict.checks
        assert all(c.passed for c in checks if c.name.startswith("error of the launch"))
    assert launches[0] == pytest.approx(launches[1], rel=1e-4)
