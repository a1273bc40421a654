"""Interpreters that the script for the oldest and newest Python selects, with stubs of them."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "tools/pythons.sh"
# "-c" answers for the interpreter's own minor version only, as the real ones do.
STUB = """#!/bin/sh
case "$1 $2" in
-c*) case "$2" in *"(3, {minor})"*) exit 0 ;; *) exit 1 ;; esac ;;
"-m venv") mkdir -p "$3/bin" && cp "$0" "$3/bin/python" ;;
"-m pip") echo "pip 3.{minor}"; exit {pip} ;;
"-m pytest") shift; echo "tests 3.{minor}: $*"; exit {tests} ;;
esac
"""

pytestmark = pytest.mark.skipif(shutil.which("sh") is None, reason="needs a POSIX shell")


def run_script(home, minors, pip=0, tests=0):
    """Result of the script on a machine with these minor versions, in PATH or, if odd, in pyenv."""
    home.mkdir()
    tools = home / "bin"
    tools.mkdir()
    for program in ("sh", "dirname", "mkdir", "cp"):
        (tools / program).symlink_to(shutil.which(program))
    for minor in minors:
        path = tools / f"python3.{minor}"
        if minor % 2:
            path = home / f".pyenv/versions/3.{minor}.1/bin/python"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(STUB.format(minor=minor, pip=pip, tests=tests), encoding="utf-8")
        path.chmod(0o755)
    environment = {"PATH": str(tools), "HOME": str(home)}
    done = subprocess.run([SCRIPT], env=environment, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("minors", "tested"), [((11, 12, 13, 14), (11, 14)), ((11, 13), (11, 13)), ((14, 15), (15,))]
)
def test_the_oldest_and_the_newest_python_run_the_tests(tmp_path, minors, tested):
    code, text = run_script(tmp_path / "home", minors)
    rows = [line for line in text.splitlines() if line.startswith("tests")]
    assert code == 0
    assert [row.partition(":")[0] for row in rows] == [f"tests 3.{minor}" for minor in tested]
    assert all("tests/unit tests/physics" in row for row in rows)


def test_missing_pythons_are_reported_and_skipped(tmp_path):
    code, text = run_script(tmp_path / "home", (12,))
    assert code == 0
    assert "no Python 3.11 on this machine" in text
    assert "no Python 3.13 or newer on this machine" in text


def test_libraries_that_cannot_be_downloaded_skip_the_tests(tmp_path):
    code, text = run_script(tmp_path / "home", (13,), pip=1)
    assert code == 0
    assert "its tests are skipped" in text
    assert "tests 3.13" not in text


def test_failed_tests_fail_the_script(tmp_path):
    code, _ = run_script(tmp_path / "home", (11, 13), tests=1)
    assert code != 0
    assert os.access(SCRIPT, os.X_OK)
