"""``verify`` holds what a run truncates against more of it, not against the same."""

import importlib
import json

import pytest
from films import FILM
from typer.testing import CliRunner

from kc2spice.cli.main import app
from kc2spice.equations.scene_laws import SceneLaws
from kc2spice.scene.load import load_scene

verify = importlib.import_module("kc2spice.workflow.verify.verify")


@pytest.mark.parametrize(
    ("branches", "code"), [(3, 4), pytest.param(None, 0, marks=pytest.mark.slow)]
)
def test_verify_doubles_the_branches_of_a_film(tmp_path, branches, code):
    scene = tmp_path / "film.toml"
    scene.write_text(FILM)
    words = ["verify", str(scene), "-o", str(tmp_path / "out"), "--json", "--quiet"]
    if branches:
        words += ["--set", f"g.film.branches={branches}"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == code, done.output
    checks = {c["name"]: c for c in json.loads(done.stdout)["checks"]}
    (film,) = (c for name, c in checks.items() if "the film's branches" in name)
    assert film["passed"] is (code == 0)
    assert (film["value"] > 0.05) is (code == 4)


SMALL_SIGNALS = FILM[FILM.index("[analysis]") :]
IN_TIME = """[analysis]
type = "transient"
stop = "2 us"
[solver]
max_step = "5 ns"
"""


@pytest.mark.slow
@pytest.mark.parametrize(("branches", "passed"), [(3, False), (100, True)])
def test_verify_counts_in_time_the_films_error_at_the_frequencies_of_the_run(
    tmp_path, monkeypatch, branches, passed
):
    """The integrator takes minutes for this film; as for parts without a law it is left out."""
    monkeypatch.setattr(SceneLaws, "missing", ("g",))
    monkeypatch.setattr(verify, "replayed_nets", lambda laws: None)
    text = FILM.replace(SMALL_SIGNALS, IN_TIME)
    sine = 'sine = { amplitude = "1 mN", frequency = "2 MHz" }'
    (tmp_path / "film.toml").write_text(text.replace('ac = "1 uN"', sine))
    scene = load_scene(tmp_path / "film.toml", [f"g.film.branches={branches}"])
    record = verify.verify([scene], tmp_path / "out")["scenes"]["film"]
    (film,) = (c for c in record["checks"] if "branches of the film" in c["name"])
    assert film["passed"] is passed
    assert (film["value"] > 0.05) is not passed
    assert any("not solved in time with a finer discretisation" in n for n in record["notes"])
