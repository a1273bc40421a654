"""``bench SCENE``: choice of settings on a made-up simulator whose errors and times are known."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from kc2spice.cli.main import app
from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.scene.load import load_scene
from kc2spice.workflow.bench import plane
from kc2spice.workflow.bench.axes import (
    axes,
    next_to_own,
    overrides,
    own_place,
    reference_settings,
    settings,
)
from kc2spice.workflow.bench.evaluate import Run, chosen, errors


def simulator(scene, *, trust=False):
    """Errors of tolerance and order have opposite signs; time grows as either gets finer."""
    reltol, order = scene.solver.reltol, scene.rom.order
    value = 1.0 + reltol - 3e-3 / order
    cost = 1e-2 * order / reltol**0.5
    rest = {"caught": np.asarray(True), "noise": np.asarray(np.sin(1e9 * reltol))}
    return Run({"speed": np.asarray(value), **rest}, cost, transient=True, deck=None)


@pytest.fixture(autouse=True, scope="module")
def timed_again():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plane, "time_again", lambda run: run.cpu_s)
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("bench") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plane, "evaluate", simulator)
        record = plane.bench(
            lambda more: load_scene("impact", ["bench.metric=[]", *more]), out, error=1e-4,
            repeats=2,
        )  # fmt: skip
    return record, out


@pytest.fixture
def record(made):
    return made[0]


def test_record_has_the_contracts_shape(made):
    record, out = made
    assert {"points", "recommended", "reference"} <= set(record)
    for point in record["points"]:
        assert {"label", "settings", "error", "time_s", "front"} <= set(point)
    stored = json.loads((out / "bench.json").read_text(encoding="utf-8"))
    assert stored["points"] == record["points"]
    page = (out / "bench.html").read_text(encoding="utf-8")
    assert all(json.dumps(point["label"])[1:-1] in page for point in record["points"])


def test_what_does_not_converge_is_left_out_and_said(record):
    assert record["metrics"] == ["speed"]
    assert "noise" in record["left_out"]


def test_errors_are_against_the_finest_setting(record):
    finest = record["reference"]["settings"]
    exact = 1.0 + finest["solver.reltol"] - 3e-3 / finest["rom.order"]
    for point in record["points"]:
        reltol = point["settings"].get("solver.reltol", 1e-4)
        order = point["settings"].get("rom.order", 30)
        assert point["error"] == pytest.approx(abs(1 + reltol - 3e-3 / order - exact) / exact)


def test_front_is_what_no_other_point_beats(record):
    for point in record["points"]:
        beaten = any(
            p["error"] <= point["error"] and p["time_s"] <= point["time_s"]
            and (p["error"], p["time_s"]) != (point["error"], point["time_s"])
            for p in record["points"]
        )  # fmt: skip
        assert point["front"] is not beaten


def test_recommendation_does_not_rely_on_errors_that_cancel(record):
    """reltol 1e-4 and order 30 are each off by 1e-4 and together by nothing."""
    own = next(point for point in record["points"] if point["own"])
    best = record["recommended"]
    assert own["error"] < 3e-5 < 1e-4 < own["bound"]
    reltol = best["settings"].get("solver.reltol", 1e-4)
    order = best["settings"].get("rom.order", 30)
    assert reltol + 3e-3 / order <= 1.1e-4 + 2.5e-5
    feasible = [p for p in record["points"] if max(p["error"], p["bound"]) <= 1e-4]
    assert best["time_s"] <= 1.05 * min(p["time_s"] for p in feasible)
    assert best["set"][::2] == ["--set"] * len(best["settings"])


def point(error, time, *, own=False, spread=0.1):
    low, high = time * (1 - spread), time * (1 + spread)
    return {"label": f"{error} {time}", "settings": {}, "error": error, "bound": error, "own": own,
            "time_s": time, "time_low_s": low, "time_high_s": high}  # fmt: skip


@pytest.mark.parametrize(
    ("other", "floor", "beaten"),
    [
        (point(1e-4, 0.7), 0.0, True),  # as exact and quicker
        (point(1e-4, 0.85), 0.0, False),  # not clearly quicker
        (point(1e-4, 0.7, spread=0.5), 0.0, False),  # not always
        (point(1.1e-4, 0.7), 0.0, False),  # less exact
        (point(1.1e-4, 0.7), 2e-4, True),  # equal within the reference's uncertainty
        (point(4e-5, 1.0), 0.0, True),  # clearly more exact in the same time
        (point(6e-5, 1.0), 0.0, False),  # a little more exact
        (point(4e-5, 1.0), 9e-5, False),  # which cannot be told
    ],
)
def test_a_scene_is_beaten_only_clearly(other, floor, beaten):
    found = plane.place_of_own([point(1e-4, 1.0, own=True), other], floor)
    assert found["on_front"] is not beaten
    assert found["nearest"] == (other["label"] if beaten else "0.0001 1.0")


def test_a_slower_scene_is_beaten(made, monkeypatch, tmp_path):
    """Negative control: a cost of the scene's own setting alone puts it behind its neighbours."""

    def slowed(scene, *, trust=False):
        run = simulator(scene, trust=trust)
        own = scene.solver.reltol == 1e-4 and scene.rom.order == 30
        return dataclasses.replace(run, cpu_s=run.cpu_s * (9.0 if own else 1.0))

    monkeypatch.setattr(plane, "evaluate", slowed)
    load = lambda more: load_scene("impact", ["bench.metric=[]", *more])  # noqa: E731
    record = plane.bench(load, tmp_path / "o", repeats=2)
    own = next(p for p in record["points"] if p["own"])
    assert not record["own"]["on_front"]
    assert record["own"]["time_s"] < 0.5 * own["time_s"]


@pytest.mark.parametrize(("error", "beaten"), [(9e-7, False), (3e-6, True)])
def test_errors_that_no_device_is_known_to_are_equal(error, beaten):
    points = [point(error, 1.0, own=True), point(1e-9, 1.0)]
    assert plane.place_of_own(points, 0.0)["on_front"] is not beaten


LOAD = lambda more: load_scene("impact", ["bench.metric=[]", *more])  # noqa: E731


def near(monkeypatch, evaluate, repeats=3):
    """The searched plane next to the scene's own setting, and its record."""
    monkeypatch.setattr(plane, "evaluate", evaluate)
    found = plane.search(LOAD, error=None)
    return found, plane.measure(found, repeats)


def test_only_values_next_to_the_own_are_tried(monkeypatch):
    found, record = near(monkeypatch, simulator)
    for wide, axis in zip(axes(LOAD([]), transient=True), found.found, strict=True):
        assert axis.name == wide.name
        assert axis.values[axis.own] == wide.values[wide.own] == {}
        assert set(map(str, axis.values)) <= set(map(str, wide.values))
        assert 1 < len(axis.values) <= 3
    tried = {(p["settings"].get("solver.reltol"), p["settings"].get("rom.order"))
             for p in record["points"]}  # fmt: skip
    assert {(None, None), (3e-4, None), (3e-5, None), (None, 45), (None, 22)} <= tried
    assert {order for _, order in tried} == {None, 22, 45}
    assert record["reference"]["settings"]["solver.reltol"] < 3e-5
    assert record["reference"]["settings"]["rom.order"] > 45
    assert "noise" in record["left_out"]


def test_only_what_may_beat_the_own_setting_is_timed_again(monkeypatch):
    """Times of the search, beside other searches, do not count where there are others."""
    again: list[float] = []

    def loaded(scene, *, trust=False):
        run = simulator(scene, trust=trust)
        return dataclasses.replace(run, cpu_s=5.0 * run.cpu_s)

    monkeypatch.setattr(plane, "time_again", lambda run: again.append(run.cpu_s) or run.cpu_s / 5)
    _, record = near(monkeypatch, loaded)
    own = next(p for p in record["points"] if p["own"])
    single = [p for p in record["points"] if p["repeats"] == 1]
    assert own["repeats"] == 3
    assert own["time_high_s"] == pytest.approx(simulator(LOAD([])).cpu_s)
    assert single
    for p in single:
        slower = p["time_s"] > plane.NEARBY * 5.0 * own["time_s"]
        assert slower or max(p["error"], p["bound"]) > max(own["error"], own["bound"])
    timed = [p for p in record["points"] if p["repeats"] == 3]
    assert len(again) == 3 * len(timed)


@pytest.mark.parametrize("missing", [1e-4, 3e-5])
def test_a_metric_that_a_run_does_not_have_is_left_out(monkeypatch, missing):
    """The scene as it is, or what checks the reference, never settles."""

    def unsettled(scene, *, trust=False):
        run = simulator(scene, trust=trust)
        time = np.nan if scene.solver.reltol == missing else 1.0
        return dataclasses.replace(run, values={**run.values, "settling": np.asarray(time)})

    _, record = near(monkeypatch, unsettled)
    assert record["metrics"] == ["speed"]
    assert record["left_out"]["settling"] is None


@pytest.mark.parametrize("cost", [1.0, 9.0])
def test_a_neighbour_beats_a_slower_scene(monkeypatch, cost):
    """A setting on its front by construction, and the same with a cost of its own."""

    def one_key(scene, *, trust=False):
        value = 1.0 + scene.solver.reltol + 1e-9 * scene.solver.chgtol
        own = scene.solver.reltol == 1e-4
        run_s = 1e-2 / scene.solver.reltol**0.5 * (cost if own else 1.0)
        return Run({"speed": np.asarray(value)}, run_s, transient=True, deck=None)

    _, record = near(monkeypatch, one_key)
    assert record["own"]["on_front"] is (cost == 1.0)
    if cost > 1.0:
        assert record["own"]["settings"]["solver.reltol"] == 3e-5
    assert record["recommended"] is not None


def test_an_error_that_vanishes_by_chance_is_not_relied_on(tmp_path, monkeypatch):
    """The scene's own tolerance happens to be right, the next finer one is off by 1e-5."""

    def lucky(scene, *, trust=False):
        reltol = scene.solver.reltol
        off = 0.0 if reltol == 1e-4 else reltol
        return Run({"speed": np.asarray(1.0 + off)}, 1e-2 / reltol**0.5, transient=True, deck=None)

    monkeypatch.setattr(plane, "evaluate", lucky)
    record = plane.bench(
        lambda more: load_scene("impact", ["bench.metric=[]", *more]), tmp_path / "out",
        error=1e-3, repeats=1,
    )  # fmt: skip
    (own,) = (point for point in record["points"] if point["own"])
    assert own["bound"] > 5e-6


def test_settings_load_again_as_they_are_printed():
    scene = load_scene("kick_and_catch")
    found = axes(scene, transient=True)
    assert {
        "solver.reltol", "solver.chgtol", "solver.trtol", "solver.max_step", "catch.points", "rom",
    } == {axis.name for axis in found}  # fmt: skip
    assert settings(found, own_place(found)) == {}
    for values in reference_settings(found):
        again = load_scene("kick_and_catch", overrides(values))
        assert again.solver.reltol == values["solver.reltol"] < scene.solver.reltol
        assert again.rom.order == values["rom.order"] > 30
        points = [s.parts["catch"].keys.points for s in (again, scene)]
        assert points[0] == values["catch.points"] > points[1]


def test_a_scene_has_the_axes_of_its_parts():
    assert [axis.name for axis in axes(load_scene("em_force"), transient=False)] == [
        "solver.reltol", "catch.points",
    ]  # fmt: skip
    assert "catch.points" not in {axis.name for axis in axes(load_scene("impact"), transient=True)}


@pytest.mark.parametrize(
    ("name", "transient", "coarser", "finer"),
    [
        ("buzzer_ft_20t_6_5a1", False, (1e-2, [520, 16.8e3]), (1e-4, [520, 16.8e3])),
        ("buzzer_square", True, (1e-3, [0.0, 5e6]), (1e-5, [0.0, 1e7])),
    ],
)
def test_a_reduction_is_varied_around_the_one_in_use(name, transient, coarser, finer):
    """Neither scene says how: its body chooses, for 650 Hz to 14 kHz, and for edges of 0.1 us."""
    rom = axes(load_scene(name), transient=transient)[-1]
    for step, (tolerance, band) in ((-1, coarser), (1, finer)):
        values = rom.values[rom.own + step]
        assert values["rom.tolerance"] == pytest.approx(tolerance)
        assert values["rom.band"] == pytest.approx(band)
        assert load_scene(name, overrides(values)).rom.tolerance == values["rom.tolerance"]


@pytest.mark.parametrize("name", ["em_force", "kick_and_catch", "harmonic"])
def test_the_reference_is_finer_than_all_that_is_tried_next_to_a_scene(name):
    for axis in next_to_own(axes(load_scene(name), transient=name == "kick_and_catch")):
        if axis.name != "solver.trtol":  # 1 is the finest that there is
            assert axis.finest not in axis.values
            assert axis.finer == axis.values[-1]


def test_another_outcome_is_no_result():
    yes, no = (Run({"caught": np.asarray(c)}, 1.0, True, None) for c in (True, False))
    with pytest.raises(SimulationError, match="caught"):
        errors(no, yes, [])
    missing = Run({"v": np.asarray(np.nan)}, 1.0, True, None)
    with pytest.raises(SimulationError, match="no v"):
        errors(missing, Run({"v": np.asarray(1.0)}, 1.0, True, None), ["v"])


def test_curves_count_by_their_largest_value():
    exact = Run({"f": np.array([1.0, 10.0])}, 1.0, False, None)
    off = Run({"f": np.array([1.5, 10.0])}, 1.0, False, None)
    assert errors(off, exact, ["f"]) == {"f": pytest.approx(0.05)}
    assert chosen(exact, ()) == ("f",)
    with pytest.raises(UsageError, match="no such metric"):
        chosen(exact, ["g"])


def test_nothing_within_the_error_is_exit_code_4(monkeypatch, tmp_path):
    monkeypatch.setattr(plane, "evaluate", simulator)
    called = ["bench", "impact", "--error", "1e-9", "--metric", "speed", "--repeats", "1"]
    result = CliRunner().invoke(app, [*called, "--json", "--quiet", "--out", str(tmp_path / "o")])
    assert result.exit_code == 4
    assert json.loads(result.stdout)["recommended"] is None
