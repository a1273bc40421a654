"""The lowest versions that pyproject.toml allows, together in an environment of their own."""

import json
import os
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest

import kc2spice as kc

ROOT = Path(__file__).parents[2]
INSTALL = ("pip", "install", "--quiet", "--resolution", "lowest-direct", str(ROOT))


@pytest.fixture(scope="module")
def lowest(tmp_path_factory):
    """Runs the ``kc2spice`` that was installed with the lowest versions."""
    home = tmp_path_factory.mktemp("lowest")
    subprocess.run([sys.executable, "-m", "venv", home / "tools"], check=True)
    got = subprocess.run([home / "tools/bin/pip", "install", "--quiet", "uv"], check=False)
    if got.returncode:
        pytest.skip("needs the network: pip install uv")
    uv = str(home / "tools/bin/uv")
    subprocess.run([uv, "venv", "--quiet", "--python", sys.executable, home / "low"], check=True)
    python = home / "low/bin/python"
    subprocess.run([uv, *INSTALL, "--python", python], check=True)
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    environment["KC2SPICE_CACHE"] = str(home / "cache")

    def run(*words):
        command = [home / "low/bin/kc2spice", *words]
        done = subprocess.run(command, capture_output=True, text=True, cwd=home, env=environment,
                              check=False)  # fmt: skip
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


@pytest.mark.slow
@pytest.mark.campaign
def test_the_versions_are_the_lowest(lowest):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = dict(text.split(">=") for text in project["dependencies"])
    found = {each["name"]: each["state"] for each in lowest("doctor", "--json")["findings"]}
    for name in ("numpy", "scipy", "scikit-fem", "gmsh", "pydantic", "typer"):
        assert found[name].split(".")[:2] == (wanted[name] + ".0").split(".")[:2]
    assert version("numpy") != found["numpy"]  # else this would test nothing


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize(
    ("scene", "name"),
    [
        ("impact", "min_position_m"),  # a 3-D chip in contact
        ("buzzer_7bb_20_6", "resonance_hz"),  # an axisymmetric disc
        ("buzzer_square", "swing_m"),
        ("em_force", "force_max_n"),  # a magnetic field on a mesh of gmsh
    ],
)
def test_scenes_give_the_same_numbers(scene, name, lowest, tmp_path):
    old = lowest("run", scene, "--json", "-o", str(tmp_path / scene))["metrics"][name]
    assert old == pytest.approx(kc.run(scene).metrics[name], rel=1e-4)
    assert (tmp_path / scene / "report.html").stat().st_size > 10_000
