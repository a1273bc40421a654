"""The page on own parts works as it stands: its files, its package, its commands."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "own_part.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """What a reader installs: the file, and the entry point of its ``pyproject.toml``."""
    folder = tmp_path_factory.mktemp("package")
    part, _trial = blocks("python")
    entry, scene = blocks("toml")
    (folder / "solenoid.py").write_text(part, encoding="utf-8")
    (folder / "pull.toml").write_text(scene, encoding="utf-8")
    points = re.fullmatch(r'\[project\.entry-points\."([\w.]+)"\]\n(\w+) = "(\S+)"\n', entry)
    installed = folder / "solenoid-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: solenoid\nVersion: 1.0\n")
    (installed / "entry_points.txt").write_text(f"[{points[1]}]\n{points[2]} = {points[3]}\n")
    return folder


def run(package, *words):
    path = os.pathsep.join([str(ROOT), str(package)])
    done = subprocess.run(
        [sys.executable, *words], cwd=package, capture_output=True, text=True, check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 0, f"{words}\n{done.stderr}"
    return done.stdout


def test_the_file_and_its_closed_form_run(package):
    (package / "trial.py").write_text("\n".join(blocks("python")), encoding="utf-8")
    run(package, "trial.py")


def test_the_commands_know_the_installed_part(package):
    for line in "".join(blocks("sh")).splitlines():
        run(package, "-m", *shlex.split(line))
    assert (package / "xyce" / "solenoid.lib").is_file()
    assert "I(" in (package / "modules" / "solenoid.va").read_text(encoding="utf-8")
    head = (package / "xyce" / "solenoid.lib").read_text(encoding="utf-8")
    assert "* @param travel=0.0015 unit=m x at which the stop is met" in head
