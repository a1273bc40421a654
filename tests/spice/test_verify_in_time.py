"""``verify`` integrates a transient with a finer discretisation than that of the run."""

import importlib

import pytest
from support import load_scene

module = importlib.import_module("kc2spice.workflow.verify.scene_verification")

SCENE = {
    "name": "film",
    "plate": {"part": "gap", "a": ["shake.out"], "area": 2e-6, "gap": 5e-6, "travel": 2.5e-6,
              "side": "above", "pins": {"plus": "drive.out"},
              "film": {"length": 2e-3, "width": 1e-3, "pressure": 1e5}},
    "drive": {"part": "source"},
    "shake": {"part": "source", "kind": "displacement",
              "sine": {"amplitude": 1e-9, "frequency": 2e5}},
    "analysis": {"stop": 1e-5},
}  # fmt: skip


@pytest.mark.parametrize(("branches", "passed"), [(3, False), (16, True)])
def test_too_few_branches_of_a_film_fail_in_time(tmp_path, branches, passed):
    scene = load_scene(SCENE, {"plate.film.branches": branches})
    record = module.verify_scenes([scene], tmp_path / "out")["scenes"]["film"]
    (film,) = (c for c in record["checks"] if "times as many gas-film branches" in c["name"])
    assert film["passed"] is passed
    assert (film["value"] > 0.05) is not passed
    assert not any("not solved in time" in note for note in record["notes"])


def test_a_finer_integration_that_takes_too_long_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "TIME_FACTOR", 0.0)
    monkeypatch.setattr(module, "EXTRA_SECONDS", 0.0)
    scene = load_scene(SCENE, {"plate.film.branches": 3})
    record = module.verify_scenes([scene], tmp_path / "out")["scenes"]["film"]
    assert any("given up after 0 s" in note for note in record["notes"])
    (film,) = (c for c in record["checks"] if "3 branches of the film" in c["name"])
    assert film["passed"] is False
