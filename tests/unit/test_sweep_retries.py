"""Which points are run again: those that the machine interrupted, and the failed ones if asked."""

from __future__ import annotations

import csv
import errno
import shutil
from types import SimpleNamespace

import pytest

from kc2spice.core.errors import SimulationError
from kc2spice.workflow.sweep import point, run
from kc2spice.workflow.sweep.point import Job, Outcome, SceneText, Task, run_point
from kc2spice.workflow.sweep.pool import ThreadEngine
from kc2spice.workflow.sweep.study import Request, make_study

SETS = ("impact.velocity=-1:-2:4",)


@pytest.fixture
def swept(monkeypatch, tmp_path):
    """``swept(outcome, ...)``: the summary, the statuses and the points that were run."""
    study = make_study(Request(SceneText("impact", None), SETS))

    def sweep(outcome, **options):
        ran = []

        def made_up(job, task):
            ran.append(task.index)
            return outcome(task.index, ran.count(task.index), len(job.metrics))

        monkeypatch.setattr(run, "run_point", made_up)
        summary = run.sweep(study, tmp_path / "out", ThreadEngine(1), **options)
        rows = csv.DictReader((tmp_path / "out" / "sweep.csv").open(encoding="utf-8", newline=""))
        return summary, [row["status"] for row in rows], ran

    return sweep


def good(index, time, count):
    return Outcome(index, (float(index),) * count)


def test_an_interrupted_point_is_tried_once_more_in_the_same_sweep(swept, tmp_path):
    def once(index, time, count):
        if index == 2 and time == 1:
            return Outcome(index, failure="exit code -9", interrupted=True)
        return good(index, time, count)

    summary, status, ran = swept(once)
    assert (summary["failed"], status) == (0, ["ok"] * 4)
    assert (sorted(ran[:4]), ran[4:]) == ([0, 1, 2, 3], [2])
    assert not (tmp_path / "out" / run.ROWS).exists()


def test_one_that_stays_interrupted_is_run_by_the_next_sweep_alone(swept):
    def killed(index, time, count):
        if index == 1:
            return Outcome(index, failure="exit code -9", interrupted=True)
        return good(index, time, count)

    summary, status, ran = swept(killed)
    assert summary["failed"] == 1
    assert status[1] == "failed: exit code -9"
    assert (sorted(ran[:4]), ran[4:]) == ([0, 1, 2, 3], [1])
    summary, status, ran = swept(good)
    assert (summary["failed"], summary["resumed"], ran) == (0, 3, [1])
    assert status == ["ok"] * 4


def test_what_failed_by_itself_is_run_again_only_if_asked(swept):
    def failing(index, time, count):
        return Outcome(index, failure="no") if index == 3 else good(index, time, count)

    assert sorted(swept(failing)[2]) == [0, 1, 2, 3]
    summary, status, ran = swept(good)
    assert (summary["failed"], status[3], ran) == (1, "failed: no", [])
    summary, status, ran = swept(good, retry_failed=True)
    assert (summary["failed"], status, ran) == (0, ["ok"] * 4, [3])


JOB = Job(SceneText("impact", None), (), (), ("min_position_m",), None)


def failed_by(error, monkeypatch):
    def fail(*_):
        raise error

    monkeypatch.setattr(point, "testbench", fail)
    return run_point(JOB, Task(0, (), ()))


def test_a_full_disk_is_no_property_of_a_point(monkeypatch):
    outcome = failed_by(OSError(errno.ENOSPC, "No space left on device"), monkeypatch)
    assert outcome.interrupted
    assert not failed_by(OSError(errno.EACCES, "no"), monkeypatch).interrupted
    broken = SimulationError("the raw file is not complete")
    assert not failed_by(broken, monkeypatch).interrupted
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=0))
    assert failed_by(broken, monkeypatch).interrupted


def test_a_simulator_that_was_ended_is_told_from_one_that_failed(monkeypatch):
    assert failed_by(SimulationError("ngspice failed: exit code -9"), monkeypatch).interrupted
    assert not failed_by(SimulationError("ngspice failed: exit code 1"), monkeypatch).interrupted
