"""Remaining times of stages: steps, iterations, reductions and the lines of the terminal."""

import math

import mor_families as families
import numpy as np
import pytest
from scipy import sparse
from support import (
    ConvergenceTimer,
    OutputRecipient,
    StageTimer,
    StepTimer,
    follow_stage,
    progress,
)

import kc2spice as kc


@pytest.fixture
def clock(monkeypatch):
    """Clock that a test sets: a list whose only entry is the time [s]."""
    now = [0.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    return now


@pytest.fixture
def reports():
    """Stage, completed fraction and text of each report."""
    return []


def test_the_times_of_finished_steps_predict_those_of_the_others(clock, reports):
    steps = ("assembly", 1.0), ("modes", 3.0), ("mesh error", 4.0)
    with follow_stage(lambda *item: reports.append(item), "assemble", "plate"):
        timer = StepTimer()
        clock[0] = 2.0
        timer.begin_step(1, steps)
        clock[0] = 10.0  # instead of 2 + 6
        timer.begin_step(2, steps)
    assert [text for *_, text in reports] == ["plate", "plate, modes", "plate, mesh error"]
    assert [done for _, done, _ in reports] == [None, pytest.approx(1 / 8), pytest.approx(0.5)]


@pytest.mark.parametrize("confirmations", [1, 2, 3])
def test_a_geometric_decline_predicts_the_steps_of_an_iteration(clock, reports, confirmations):
    """Errors 1, 0.1, 0.01, ... and steps of 2 s: step 7 is the first within 1.5e-6."""
    with follow_stage(lambda *item: reports.append(item), "reduce", "900 equations"):
        timer = ConvergenceTimer(1.5e-6, confirmations, 20, "block")
        for k in range(6 + confirmations):
            clock[0] += 2.0
            timer.end_step(10.0**-k)
    last = 6 + confirmations
    assert reports[1][2] == "900 equations, block 1 of about 20"
    for k, (_, done, text) in enumerate(reports[2:], 2):
        assert text == f"900 equations, block {k} of about {last}"
        assert done == pytest.approx(k / last)


@pytest.mark.parametrize("errors", [[1.0, 1.0], [math.inf], [1e-3, 1e-2, 2e-2, math.inf]])
def test_errors_that_do_not_decline_predict_the_usual_number(errors):
    timer = ConvergenceTimer(1e-6, 2, 10, "block")
    for error in errors:
        timer.end_step(error)
    assert timer.remaining_steps() == 10 - len(errors)


@pytest.mark.parametrize("dashpot", [0.0, 0.3])
def test_a_reduction_reports_increasing_steps_up_to_the_last(reports, dashpot):
    matrices = families.damped_chain(1400, dashpot, 3.0)
    if not dashpot:
        matrices = matrices | {"E": None, "rayleigh": (0.0, 1e-2)}
    matrices = {key: sparse.csc_array(P) if key in "MEK" and P is not None else P
                for key, P in matrices.items()}  # fmt: skip
    clock = StageTimer(lambda *item: reports.append(item))
    with clock.time_stage("reduce", "chain"):
        kc.reduce(kc.LinearModel(**matrices), tolerance=1e-4, band=(0, 0.003))
    assert clock.wall_s["reduce"] > 0
    fractions = [done for _, done, _ in reports[1:]]
    words = [text.rsplit(" ", 4) for *_, text in reports[1:]]
    assert all(0 < done <= 1 for done in fractions)
    assert [int(count) for _, count, *_ in words] == [*range(1, len(words) + 1)]
    assert fractions[-1] == 1.0
    assert words[-1][1] == words[-1][-1]


def test_outside_of_a_stage_nothing_is_reported(reports):
    with follow_stage(lambda *item: reports.append(item), "reduce", "chain"):
        pass
    progress.report_remaining_time(3.0, "block")
    assert reports == [("reduce", None, "chain")]
    assert np.all([done is None for _, done, _ in reports])


@pytest.mark.parametrize(
    ("seconds", "printed"),
    [(1.0, ""), (8.0, "simulate: ngspice, about 1:12 left\n")],
    ids=["short", "long"],
)
def test_piped_output_contains_one_line_about_a_long_stage(clock, capsys, seconds, printed):
    """A tenth of the stage takes 1 or 8 s: 9 or 72 s remain."""
    with OutputRecipient(as_json=False, quiet=False).open_progress_display() as report:
        report("simulate", None, "ngspice")
        for k in range(1, 10):
            clock[0] += seconds
            report("simulate", k / 10, "ngspice")
    assert capsys.readouterr().err == printed
