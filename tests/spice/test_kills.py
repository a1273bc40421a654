"""Kills at random moments, two runs at once, a full disk: no torn or stale result stays."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

SHORT = ("--set", "solver.stop=6e-6", "--set", "rom.order=12", "--set", "kick.mesh.sectors=2",
         "--set", "kick.mesh.outer_rings=2", "--quiet")  # fmt: skip
COMMAND = (sys.executable, "-m", "kc2spice")
LONGEST = {"run": 4.0, "export": 1.5, "sweep": 3.0}  # s in which most kills fall


def kc(*words, **options):
    return subprocess.Popen(
        [*COMMAND, *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        start_new_session=True, **options,
    )  # fmt: skip


def finish(*words, **options):
    with kc(*words, **options) as process:
        _, said = process.communicate(timeout=240)
    return process.returncode, said


def velocity(number):
    """Every run has a velocity of its own, so that no file of another can pass for its."""
    return -0.5 - 0.001 * number


def words(command, number, out):
    if command == "sweep":
        points = f"impact.velocity={velocity(number)},{velocity(number) - 0.5}"
        return ("sweep", "impact", "--set", points, *SHORT, "--workers", "1", "-o", str(out))
    return (command, "impact", "--set", f"impact.velocity={velocity(number)}", *SHORT,
            "-o", str(out))  # fmt: skip


def hashes(out):
    texts = [path.read_text() for path in out.glob("*") if path.suffix in (".lib", ".cir")]
    return {found for text in texts for found in re.findall(r"hash=(\w+)", text)}


def assert_whole(command, out):
    """Files that look like a result are complete and all of one run."""
    entry = {"run": "result.json", "export": "impact.cir", "sweep": "sweep.csv"}[command]
    if not (out / entry).exists():
        return False
    if command != "sweep":
        assert len(hashes(out)) == 1
    if command == "run":
        record = json.loads((out / "result.json").read_text())
        assert all((out / name).is_file() for name in record["files"])
        with np.load(out / "waveforms.npz") as waves:
            assert waves["time"][-1] == pytest.approx(6e-6)
            lowest = (waves["sphere.y"] - 1e-3).min()
            speed = waves["sphere.v"][0]
        assert record["metrics"]["min_position_m"] == pytest.approx(lowest, rel=1e-3)
        deck = (out / "sphere.lib").read_text() + (out / "impact.cir").read_text()
        assert str(round(float(speed), 6)) in deck
    return True


def campaign(kills, seed, tmp_path):
    rng, finished = random.Random(seed), 0
    for number in range(kills):
        command = ("run", "export", "sweep")[number % 3]
        out = tmp_path / command
        process = kc(*words(command, number, out))
        time.sleep(rng.uniform(0.3, LONGEST[command]))
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        finished += assert_whole(command, out)
    for command in ("run", "export", "sweep"):
        code, said = finish(*words(command, kills, tmp_path / command))
        if command == "sweep" and code == 2:  # another sweep was begun there, and says so
            assert "sweep" in said
            continue
        assert code == 0, said
        assert assert_whole(command, tmp_path / command)
    assert not list(tmp_path.rglob("*.tmp"))
    return finished


@pytest.fixture(scope="module", autouse=True)
def models(tmp_path_factory):
    """The models are in the cache, so that kills fall into all stages alike."""
    code, said = finish(*words("export", 0, tmp_path_factory.mktemp("models")))
    assert code == 0, said


@pytest.mark.slow
def test_a_kill_of_each_command_leaves_no_torn_result(tmp_path):
    campaign(3, 1, tmp_path)


@pytest.mark.slow
@pytest.mark.campaign
def test_a_hundred_kills_leave_no_torn_result(tmp_path):
    assert campaign(100, 2, tmp_path) > 5


def test_two_runs_into_one_directory_leave_one_whole_result(tmp_path):
    out = tmp_path / "run"
    both = [kc(*words("run", number, out)) for number in (1, 2)]
    for process in both:
        _, said = process.communicate(timeout=240)
        assert process.returncode == 0, said
    assert assert_whole("run", out)
    assert not list(tmp_path.glob(".run.*"))
