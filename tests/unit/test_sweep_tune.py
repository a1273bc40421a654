"""The tuner against a metric whose best point is known, and what it records."""

import csv

import numpy as np
import pytest

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.scene.keys import keys_of
from kc2spice.scene.load import load_scene
from kc2spice.workflow.sweep import tune
from kc2spice.workflow.sweep.point import Outcome, SceneText
from kc2spice.workflow.sweep.pool import ThreadEngine
from kc2spice.workflow.sweep.study import Request, make_study

KEYS = keys_of(load_scene("kick_and_catch"))
BOUNDS = ["control.kp=1e4:1e6", "control.kd=2:200"]
BEST = {90.0: (1e5, 10.0), 110.0: (1e5, 40.0)}  # of each condition alone


def settling(kp, kd, voltage):
    """A bowl in the logarithms around each condition's own best."""
    a, b = BEST[voltage]
    return 1e-3 * (1 + np.log(kp / a) ** 2 + np.log(kd / b) ** 2)


@pytest.fixture
def calls(monkeypatch):
    """Every point that is run, by what it asks for; none reaches ngspice."""
    made = []

    def run_point(job, task):
        asked = dict(text.split("=") for text in task.overrides)
        values = {"control.kp": 5e4, "control.kd": 20.0} | {k: float(v) for k, v in asked.items()}
        made.append(asked)
        found = settling(values["control.kp"], values["control.kd"], values["kick.drive.voltage"])
        return Outcome(task.index, (float(found),))

    monkeypatch.setattr(tune, "run_point", run_point)
    return made


def tuned(tmp_path, metric="settling_time_s"):
    sets = ("kick.drive.voltage=90,110",)
    study = make_study(Request(SceneText("kick_and_catch", None), sets, metrics=(metric,)))
    bounds = [tune.bound(text, study.keys) for text in BOUNDS]
    return tune.tune(study, bounds, metric, 6, tmp_path, ThreadEngine(1))


def test_the_worst_condition_decides(calls, tmp_path):
    found = tuned(tmp_path)
    # By symmetry kp is at its best for both. kd must weigh them: the worst ratio has its least
    # where both are equal, as long as one rises and the other falls.
    kd = np.geomspace(10.0, 40.0, 100_001)
    before = {v: settling(5e4, 20.0, v) for v in BEST}
    ratio = np.array([settling(1e5, kd, v) / before[v] for v in BEST])
    best = kd[np.argmin(ratio.max(axis=0) + tune.MEAN * ratio.mean(axis=0))]
    assert found.best["control.kp"] == pytest.approx(1e5, rel=0.02)
    assert found.best["control.kd"] == pytest.approx(best, rel=0.02)
    assert (found.after / found.before).max() < 0.9
    np.testing.assert_allclose(found.before, list(before.values()))


def test_a_search_goes_on_where_it_was(calls, tmp_path):
    first = tuned(tmp_path)
    made = len(calls)
    again = tuned(tmp_path)
    assert len(calls) == made  # every run was recorded
    assert again.best == first.best


def test_a_scene_without_the_metric_is_refused(calls, tmp_path, monkeypatch):
    monkeypatch.setattr(tune, "run_point", lambda job, task: Outcome(task.index, failure="lost"))
    with pytest.raises(SimulationError, match="no such metric"):
        tuned(tmp_path)


@pytest.mark.parametrize("text", ["control.kp", "control.kp=5", "control.kp=0:1", "control.kp=2:1"])
def test_bad_bounds_are_refused(text):
    with pytest.raises(UsageError):
        tune.bound(text, KEYS)


def test_a_constraint_keeps_the_search_on_its_side(calls, tmp_path, monkeypatch):
    """The free optimum has kp at 1e5; a second metric that grows with kp holds it below 7e4."""
    free = tune.run_point

    def two_metrics(job, task):
        asked = dict(text.split("=") for text in task.overrides)
        effort = float(asked.get("control.kp", 5e4)) / 1e4
        return Outcome(task.index, (*free(job, task).values, effort))

    monkeypatch.setattr(tune, "run_point", two_metrics)
    metrics = ("settling_time_s", "peak_height_m")
    sets = ("kick.drive.voltage=90,110",)
    study = make_study(Request(SceneText("kick_and_catch", None), sets, metrics=metrics))
    found = tune.tune(
        study, [tune.bound(text, KEYS) for text in BOUNDS], metrics[0], 6, tmp_path,
        ThreadEngine(1),
        limits=[tune.limit("peak_height_m <= 7")],
    )  # fmt: skip
    assert 6e4 < found.best["control.kp"] <= 7e4


@pytest.mark.parametrize("text", ["peak_height_m", "a<1", "a<=b", "<=1", "a<=1<=2", ""])
def test_bad_constraints_are_refused(text):
    with pytest.raises(UsageError, match="--require"):
        tune.limit(text)


def test_a_tuning_leaves_its_table_and_figure(calls, tmp_path):
    sets = ("kick.drive.voltage=90,110",)
    metrics = ("settling_time_s",)
    study = make_study(Request(SceneText("kick_and_catch", None), sets, metrics=metrics))
    bounds = [tune.bound(text, study.keys) for text in BOUNDS]
    found = tune.run_tuning(study, bounds, metrics[0], 2, tmp_path / "o", ThreadEngine(1))
    rows = list(csv.DictReader((tmp_path / "o" / tune.TABLE).open(encoding="utf-8", newline="")))
    assert [float(row["kick.drive.voltage"]) for row in rows] == [90.0, 110.0]
    before = [float(row["settling_time_s"]) for row in rows]
    assert before == pytest.approx([settling(5e4, 20.0, v) for v in BEST])
    best = (found["best"]["control.kp"], found["best"]["control.kd"])
    after = [float(row["settling_time_s tuned"]) for row in rows]
    assert after == pytest.approx([settling(*best, v) for v in BEST])
    assert found["worst_ratio"] == pytest.approx(max(np.divide(after, before)))
    assert (tmp_path / "o" / "tuned.png").stat().st_size > 1000
    with pytest.raises(UsageError, match="no such metric"):
        tune.run_tuning(study, bounds, "peak_height_m", 2, tmp_path / "p", ThreadEngine(1))
    with pytest.raises(UsageError, match="cannot be tuned"):
        tune.run_tuning(study, [tune.Bound("kick.drive.voltage", 80, 90)], metrics[0], 2,
                        tmp_path / "p", ThreadEngine(1))  # fmt: skip
