"""What a run says of its reduced bodies: how far off they are, and that they do not grow."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from kc2spice.cli.main import app

SCENE = """name = "bar_on_file"
[bar]
part = "matrices"
file = "bar.npz"
[push]
part = "source"
kind = "force"
ac = 1.0
sine = { amplitude = 1e-3, frequency = "50 kHz" }
pins = { out = "bar.left" }
"""
AC = """[analysis]
type = "ac"
start = "1 kHz"
stop = "90 kHz"
points = 20
"""
TRANSIENT = """[analysis]
type = "transient"
stop = "20 us"
[solver]
max_step = "0.2 us"
"""
PORTS = """band = [0, 4e5]
[[ports]]
name = "left"
kind = "mechanical"
column = 1
[[ports]]
name = "right"
kind = "mechanical"
column = 2
"""


def bar(folder, *, held=0.0, damping=1e-3, masses=12):
    """A chain of masses with a dashpot that couples its modes; free to move unless ``held``."""
    links = np.eye(masses - 1, masses, 1) - np.eye(masses - 1, masses)
    K = 4e6 * links.T @ links
    K[0, 0] += held
    E = 10 * damping * np.outer(links[0], links[0]) + damping * links.T @ links
    M, B = 1e-6 * np.eye(masses), np.eye(masses)[:, [0, masses - 1]]
    np.savez(folder / "bar.npz", M=M, E=E, K=K, B=B)
    (folder / "bar.toml").write_text(PORTS)


def command(folder, text, *words):
    scene = folder / "scene.toml"
    scene.write_text(text)
    return CliRunner().invoke(app, [words[0], str(scene), "-o", str(folder / "out"), *words[1:]])


@pytest.mark.parametrize(("order", "code", "action"), [(2, 5, "fail"), (3, 0, "warn")])
@pytest.mark.parametrize("analysis", [AC, TRANSIENT])
def test_a_run_says_that_its_reduced_body_is_far_off(tmp_path, order, code, action, analysis):
    bar(tmp_path, held=1e6)
    rom = f'[rom]\norder = {order}\nband = ["0 Hz", "100 kHz"]\n'
    done = command(tmp_path, SCENE + rom + analysis, "run", "--json", "--quiet")
    assert done.exit_code == code, done.output
    if action == "fail":
        assert "reduction of bar" in done.stderr
    else:
        (check,) = (c for c in json.loads(done.stdout)["checks"] if "reduction" in c["name"])
        assert not check["passed"]
        assert 0.01 < check["value"] < 0.1


PULSE = "pulse = { high = 1e-3, width = '30 us', edge = '10 us', start = '1 us' }"
SINE = 'sine = { amplitude = 1e-3, frequency = "50 kHz" }'


@pytest.mark.parametrize(("order", "code"), [(1, 5), (2, 0)])
def test_a_sharp_resonance_that_is_off_fails_no_pulse(tmp_path, order, code):
    """Pointwise two states of twelve are far off at a resonance that is all but undamped; under the
    pulse's force they are right to 7 %, and one state is not."""
    bar(tmp_path, held=1e6, damping=1e-5)
    rom = f'[rom]\norder = {order}\nband = ["0 Hz", "100 kHz"]\n'
    text = SCENE.replace(SINE, PULSE) + rom
    done = command(tmp_path, text + AC, "run", "--json", "--quiet")
    assert done.exit_code == 5
    assert "reduction of bar" in done.stderr
    text += TRANSIENT.replace("20 us", "60 us")
    done = command(tmp_path, text, "run", "--json", "--quiet")
    assert done.exit_code == code, done.output
    if code:
        assert "reduction of bar" in done.stderr
        assert "rom.order = 2" in done.stderr
        return
    checks = {c["name"]: c for c in json.loads(done.stdout)["checks"]}
    assert checks["reduction of bar"]["value"] < 0.1
    assert "under the run's own loads" in checks["reduction of bar"]["unit"]
    assert checks["resonances of bar"]["value"] > 0.1
    assert not checks["resonances of bar"]["passed"]


def test_a_run_says_that_its_body_grows_by_itself(tmp_path):
    bar(tmp_path, held=1e6, damping=-1e-4)
    done = command(tmp_path, SCENE + TRANSIENT, "run", "--json", "--quiet")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    (check,) = (c for c in found["checks"] if c["name"] == "stability of bar")
    assert not check["passed"]
    assert "grow" in check["advice"]
    assert found["rom"]["stable"] is False
