"""Sweeps by the command line: right numbers, equal tables everywhere, nothing lost to any kill."""

import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import session
from support import sweep_execution
from sweeps import circuit, command, rows, sweep

GRID = ("wire.resistance=500 Ohm:2 kOhm:4", "supply.pulse.high=5 V,10 V")
TIME = 1e-3  # s of charging


@pytest.fixture(scope="module")
def charge(tmp_path_factory):
    """Path of the scene, and the directory of eight points of it on two workers."""
    home = tmp_path_factory.mktemp("charge")
    scene = circuit(home)
    summary = sweep(scene, *GRID, out=home / "o", more=("--workers", "2"))
    return scene, home / "o", summary


def test_a_table_has_the_points_in_order_and_their_numbers(charge):
    _, out, summary = charge
    assert (summary["points"], summary["failed"], summary["resumed"]) == (8, 0, 0)
    table = rows(summary)
    ohms, volts = (500.0, 1000.0, 1500.0, 2000.0), (5.0, 10.0)
    found = [(float(r["wire.resistance"]), float(r["supply.pulse.high"])) for r in table]
    assert found == [(r, v) for r in ohms for v in volts]
    for (r, v), row in zip(found, table, strict=True):
        assert row["status"] == "ok"
        assert float(row["charged"]) == pytest.approx(
            v * (1 - math.exp(-TIME / (r * 1e-6))), rel=1e-3
        )
        assert float(row["largest"]) == pytest.approx(v / r, rel=1e-3)
    assert all((out / name).stat().st_size for name in summary["files"])


@pytest.mark.slow
def test_an_unreachable_scheduler_is_a_missing_tool_and_spoils_nothing(charge, tmp_path):
    pytest.importorskip("distributed")
    scene, _, _ = charge
    few = ("wire.resistance=500,900",)
    said = sweep(scene, *few, out=tmp_path / "o", more=("--dask", "tcp://127.0.0.1:9"), code=3)
    assert "no Dask scheduler" in said
    assert sweep(scene, *few, out=tmp_path / "o")["failed"] == 0


# --- what is asked ------------------------------------------------------------------------------


def test_a_finished_sweep_is_not_run_again_and_its_other_numbers_are_there(charge):
    scene, out, _ = charge
    before = (out / "sweep.csv").read_bytes()
    more = ("--metric", "charged", "--metric", "steps.accepted")
    again = sweep(scene, *GRID, out=out, more=more)
    assert again["resumed"] == 8
    table = rows(again)
    assert list(table[0]) == ["wire.resistance", "supply.pulse.high", "charged", "steps.accepted",
                              "status"]  # fmt: skip
    assert all(float(row["steps.accepted"]) > 500 for row in table)
    assert sweep(scene, *GRID, out=out)["resumed"] == 8
    assert (out / "sweep.csv").read_bytes() == before


def test_another_sweep_does_not_overwrite_it(charge):
    scene, out, _ = charge
    said = sweep(scene, "wire.resistance=1,2", out=out, code=2)
    assert "contains the results of another sweep" in said
    assert len(rows(out / "sweep.csv")) == 8


def test_an_unknown_column_is_refused_with_the_nearest(charge, tmp_path):
    scene, _, _ = charge
    said = sweep(scene, GRID[1], out=tmp_path / "o", more=("--metric", "chargd"), code=2)
    assert "charged" in said
    assert not (tmp_path / "o" / "sweep.csv").exists()


# --- failures -----------------------------------------------------------------------------------


def test_failures_are_rows_with_their_diagnosis(tmp_path):
    # Edges longer than the pulse: either value alone would do.
    scene = circuit(tmp_path)
    sets = ("supply.pulse.width=1 s,0.1 ms", "supply.pulse.edge=1 ns,0.2 ms")
    summary = sweep(scene, *sets, out=tmp_path / "o")
    status = [row["status"] for row in rows(summary)]
    assert [text == "ok" for text in status] == [True, True, True, False]
    assert status[3].startswith("failed: ")
    assert summary["failed"] == 1
    # What failed by itself is run again only if asked.
    assert sweep(scene, *sets, out=tmp_path / "o")["resumed"] == 4
    assert sweep(scene, *sets, out=tmp_path / "o", more=("--retry-failed",))["resumed"] == 3


# --- kills --------------------------------------------------------------------------------------

MANY = ("wire.resistance=500:2000:8", "solver.max_step=0.2 us")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    home = tmp_path_factory.mktemp("many")
    return Path(sweep(circuit(home), *MANY, out=home / "o")["table"]).read_bytes()


def begun(scene, out, count=2, **options):
    """A sweep of which at least ``count`` rows are there."""
    # Tests that run in the background would hand the signal down as one that is ignored.
    words = [shutil.which("env"), "--default-signal=INT"]
    words += command(scene, *MANY, out=out, more=("--workers", "2", "--quiet"))
    process = subprocess.Popen(words, start_new_session=True, stderr=subprocess.PIPE, text=True,
                               **options)  # fmt: skip
    deadline = time.monotonic() + 120
    while recorded(out) < count:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return process


def recorded(out):
    path = out / sweep_execution.ROWS_FILE
    return path.read_bytes().count(b'"interrupted": ') if path.exists() else 0


def goes_on(scene, out, undisturbed, code=0):
    before = recorded(out)
    summary = sweep(scene, *MANY, out=out, code=code)
    assert (summary["points"], summary["failed"], summary["resumed"]) == (8, 0, before)
    assert Path(summary["table"]).read_bytes() == undisturbed
    return before


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_sweep_that_was_killed_goes_on_and_loses_nothing(undisturbed, tmp_path):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    own = {**os.environ, "TMPDIR": str(temporary)}  # other tests' sweeps have files of their own
    scene, out = circuit(tmp_path), tmp_path / "o"
    process = begun(scene, out, env=own)
    process.kill()
    process.communicate()
    deadline = time.monotonic() + 60
    # The workers notice, end and leave nothing behind.
    while session(process.pid) or list(temporary.glob("kc2spice-sweep-*")):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert not (out / "sweep.csv").exists()
    assert 2 <= goes_on(scene, out, undisturbed) < 8


@pytest.mark.slow  # the kill of a whole sweep takes the same way back
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_killed_worker_loses_no_point(undisturbed, tmp_path):
    scene, out = circuit(tmp_path), tmp_path / "o"
    process = begun(scene, out)
    workers = [pid for pid, words in session(process.pid).items() if b"spawn_main" in words]
    assert len(workers) == 2
    os.kill(workers[0], signal.SIGKILL)
    said = process.communicate(timeout=240)[1]
    assert process.returncode == 0, said
    assert (out / "sweep.csv").read_bytes() == undisturbed
