"""``bench SCENE``: choice of settings on a made-up simulator whose errors and times are known."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from support import Waveforms, bench, load_scene, settings_refinement


def simulator(scene, *_, **__):
    """Errors of tolerance and order have opposite signs; time grows as either gets finer."""
    reltol, order = scene.solver.reltol, scene.rom.order
    value = 1.0 + reltol - 3e-3 / order
    build = SimpleNamespace(scene=scene, largest_step=None, trust=False, functions={}, models={})
    cost = 1e-2 * order / reltol**0.5
    rest = {"caught": np.asarray(True), "noise": np.asarray(np.sin(1e9 * reltol))}
    values, waves = {"speed": np.asarray(value), **rest}, Waveforms({"time": np.arange(2)}, {})
    return SimpleNamespace(values=values, units={}, waves=waves, cpu_s=cost, build=build,
                           is_small_signal=False, metric_resolutions={})  # fmt: skip


@pytest.fixture(autouse=True, scope="module")
def timed_again():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(settings_refinement, "repeat_timing", lambda run: run.cpu_s)
        # the simulated scene has no circuits, so no netlist without equations
        empty = SimpleNamespace(parts_without_network=())
        patch.setattr(settings_refinement, "find_linearised_scene", lambda _: empty)
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("bench") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(settings_refinement, "evaluate_scene", simulator)
        record = bench.bench(load_scene("impact", ["bench.metric=[]"]), out, error=1e-4, repeats=2)
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


def test_nothing_within_the_error_is_exit_code_4(monkeypatch, cli):
    monkeypatch.setattr(settings_refinement, "evaluate_scene", simulator)
    called = ["bench", "impact", "--error", "1e-9", "--metric", "speed", "--repeats", "1"]
    result = cli(*called, "--json", "--quiet", "--out", "o")
    assert result.exit_code == 4
    assert json.loads(result.stdout)["recommended"] is None
