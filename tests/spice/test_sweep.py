"""Real sweeps: engines that agree to the last byte, kills that lose nothing, failures as rows."""

import contextlib
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import kc2spice
from kc2spice.core.errors import MissingToolError, SimulationError, UsageError
from kc2spice.scene.load import load_scene
from kc2spice.workflow.run import run as run_scene
from kc2spice.workflow.sweep import run
from kc2spice.workflow.sweep.point import SceneText, scene_text
from kc2spice.workflow.sweep.pool import DaskEngine, LocalEngine, ThreadEngine
from kc2spice.workflow.sweep.study import Request, make_study

# A kick and its first 0.1 ms of flight: 0.2 s of ngspice.
SHORT = ("kick.drive.start=20 us", "control.enable_at=20 us", "solver.stop=150 us",
         "solver.reltol=1e-3")  # fmt: skip
GAINS = ("control.kd=10,20,30", "kick.drive.voltage=80,100")


def study(*sets, **options):
    return make_study(Request(SceneText("kick_and_catch", None), (*sets, *SHORT), **options))


def sweep(out, *sets, engine=None, **options):
    return run.sweep(study(*sets, **options), out, engine or ThreadEngine(1))


def rows(path):
    with Path(path).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def local(tmp_path_factory):
    """Six points on two processes, and their summary."""
    out = tmp_path_factory.mktemp("local") / "o"
    return out, sweep(out, *GAINS, engine=LocalEngine(2))


def test_table_has_a_row_for_each_point_in_order(local):
    out, summary = local
    assert (summary["points"], summary["failed"], summary["resumed"]) == (6, 0, 0)
    found = rows(summary["table"])
    points = [(float(r["control.kd"]), float(r["kick.drive.voltage"])) for r in found]
    assert points == [(kd, v) for kd in (10.0, 20.0, 30.0) for v in (80.0, 100.0)]
    assert {r["status"] for r in found} == {"ok"}
    for name in summary["files"]:
        assert (out / name).stat().st_size > 0


def test_the_summary_tells_what_the_points_cost(local):
    """CPU of workers and ngspice cannot exceed what two workers have; ngspice's own word is less.

    Timing decides nothing here: only what must hold on any machine is asked.
    """
    _, summary = local
    ngspice, python = summary["ngspice_cpu_s"], summary["python_cpu_s"]
    assert ngspice > 0.0
    assert python > 0.0
    assert summary["overhead"] == pytest.approx(python / ngspice)
    parent = 1  # is no worker
    share = summary["busy_share"]
    assert share == pytest.approx((ngspice + python) / (2 * summary["wall_s"]))
    assert 0.0 < share < (2 + parent) / 2


def test_a_point_is_the_run_of_that_scene(local, tmp_path):
    _, summary = local
    scene = load_scene("kick_and_catch", [*SHORT, "control.kd=30", "kick.drive.voltage=80"])
    alone = run_scene(scene, tmp_path / "alone")["metrics"]
    row = rows(summary["table"])[4]
    for name in ("launch_velocity_m_s", "peak_height_m", "final_position_m"):
        assert float(row[name]) == alone[name]  # same deck, same digits


@pytest.mark.slow
def test_dask_gives_the_same_bytes(local, tmp_path):
    pytest.importorskip("distributed")
    summary = sweep(tmp_path / "o", *GAINS, engine=DaskEngine("local", 2))
    assert Path(summary["table"]).read_bytes() == Path(local[1]["table"]).read_bytes()


def test_an_array_of_parts_gives_the_same_bytes(local, tmp_path):
    plan = run.write_array(study(*GAINS), tmp_path, 2)
    script = Path(plan["script"]).read_text(encoding="utf-8")
    assert "#SBATCH --array=0-1" in script
    assert subprocess.run(["bash", "-n", plan["script"]]).returncode == 0
    run.sweep_shard(tmp_path, run.Shard(1, 2), ThreadEngine(1))
    with pytest.raises(SimulationError, match="3 points missing"):
        run.collect(tmp_path)
    run.sweep_shard(tmp_path, run.Shard(0, 2), ThreadEngine(1))
    table = Path(run.collect(tmp_path)["table"])
    assert table.read_bytes() == Path(local[1]["table"]).read_bytes()


def test_a_finished_sweep_is_not_run_again(local):
    out, _ = local
    before = (out / "sweep.csv").stat().st_mtime_ns
    assert sweep(out, *GAINS)["resumed"] == 6
    assert (out / "sweep.csv").stat().st_mtime_ns == before


def test_another_sweep_does_not_overwrite_it(local):
    out, _ = local
    with pytest.raises(UsageError, match="holds another sweep"):
        sweep(out, "control.kd=10,20")
    assert len(rows(out / "sweep.csv")) == 6


def test_failures_are_rows_with_their_diagnosis(tmp_path):
    # Edges longer than the pulse: either value alone would do.
    sets = ("kick.drive.width=25 us,0.5 us", "kick.drive.edge=0.1 us,1 us")
    summary = sweep(tmp_path / "o", *sets)
    status = [row["status"] for row in rows(summary["table"])]
    assert summary["failed"] == 1
    assert status[:3] == ["ok"] * 3
    assert status[3].startswith("failed: ")
    assert "longer than the pulse" in status[3]


def test_a_run_that_takes_too_long_is_a_failure(tmp_path):
    long = ("control.kd=10,20", "solver.stop=1", "kick.drive.voltage=0")
    found = make_study(Request(SceneText("kick_and_catch", None), long, timeout=0.3))
    summary = run.sweep(found, tmp_path / "o", ThreadEngine(1))
    assert summary["failed"] == 2
    assert all("0.3 s" in row["status"] for row in rows(summary["table"]))


def test_subcircuit_parameters_are_swept_without_a_new_netlist(tmp_path):
    metric = "final_position_m"
    sets = ("param.pid.current_limit=0.02,0.1",)
    summary = sweep(tmp_path / "o", *sets, metrics=(metric,))
    assert summary["runs"]["netlists"] == 1
    weak, strong = (float(row[metric]) for row in rows(summary["table"]))
    other = sweep(tmp_path / "p", "control.current_limit=0.02,0.1", metrics=(metric,))
    same_weak, same_strong = (float(row[metric]) for row in rows(other["table"]))
    assert abs(strong - weak) > 1e-6
    # The scene's limit also decides which small force terms are left out: 1e-6 of the force.
    assert weak == pytest.approx(same_weak, abs=1e-9)
    assert strong == same_strong
    with pytest.raises(UsageError, match="no part of this scene"):
        sweep(tmp_path / "q", "param.pid.nothing=1,2")


def session(leader):
    """Living processes of the session that ``leader`` began."""
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it ended meanwhile
            state, _, _, number, *_ = path.read_text().rpartition(")")[2].split()
            if int(number) == leader and state != "Z":
                return True
    return False


def test_a_sweep_that_was_killed_goes_on_and_loses_nothing(local, tmp_path):
    out, temporary = tmp_path / "o", tmp_path / "temporary"
    temporary.mkdir()
    own = {**os.environ, "TMPDIR": str(temporary)}  # other tests' sweeps have files of their own
    pairs = [word for text in (*GAINS, *SHORT) for word in ("--set", text)]
    command = [sys.executable, "-m", "kc2spice", "sweep", "kick_and_catch", *pairs, "-o", str(out)]
    process = subprocess.Popen(
        [*command, "--workers", "1", "--quiet"], start_new_session=True, env=own
    )
    rows = out / "rows.sqlite"
    deadline = time.monotonic() + 120
    while not (rows.exists() and rows.read_bytes().count(b",ok\n") >= 2):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    recorded = rows.read_bytes().count(b",ok\n")
    assert recorded < 6
    assert list(temporary.glob("kc2spice-sweep-*"))
    # The workers notice, end and leave nothing behind.
    while session(process.pid) or list(temporary.glob("kc2spice-sweep-*")):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    done = subprocess.run([*command, "--json"], capture_output=True, text=True)
    summary = json.loads(done.stdout)
    assert (summary["points"], summary["failed"], summary["resumed"]) == (6, 0, recorded)
    assert Path(summary["table"]).read_bytes() == Path(local[1]["table"]).read_bytes()


def test_an_unreachable_scheduler_is_a_missing_tool_and_spoils_nothing(tmp_path):
    pytest.importorskip("distributed")
    with pytest.raises(MissingToolError) as caught:
        sweep(tmp_path / "o", "control.kd=10,20", engine=DaskEngine("tcp://127.0.0.1:9", 1, 1.0))
    assert caught.value.exit_code == 3
    assert sweep(tmp_path / "o", "control.kd=10,20")["failed"] == 0


@pytest.fixture
def own_scene(tmp_path):
    """The gallery's scene with a user's driver, as two files in one directory; then they vanish."""
    name, folder = "bring_your_own", tmp_path / "mine"
    folder.mkdir()
    for suffix in ("toml", "lib"):
        text = (Path(kc2spice.__file__).parent / "scenes" / f"{name}.{suffix}").read_text()
        (folder / f"{name}.{suffix}").write_text(text)
    early = ("kick.drive.start=20 us", "control.enable_at=20 us", "solver.stop=120 us")
    found = make_study(Request(scene_text(str(folder / f"{name}.toml")),
                               ("kick.drive.voltage=80,100", *early)))  # fmt: skip
    shutil.rmtree(folder)  # as on another machine
    return found


@pytest.mark.parametrize(
    "kind", ["processes", "array", pytest.param("dask", marks=pytest.mark.slow)]
)
def test_a_scene_file_takes_its_netlists_along(own_scene, tmp_path, kind):
    if kind == "array":
        run.write_array(own_scene, tmp_path, 1)
        run.sweep_shard(tmp_path, run.Shard(0, 1), ThreadEngine(1))  # knows the directory alone
        summary = run.collect(tmp_path)
    else:
        if kind == "dask":
            pytest.importorskip("distributed")
        engine = LocalEngine(2) if kind == "processes" else DaskEngine("local", 2)
        summary = run.sweep(own_scene, tmp_path / "o", engine)
    assert (summary["points"], summary["failed"]) == (2, 0)
    slow, fast = (float(row["launch_velocity_m_s"]) for row in rows(summary["table"]))
    assert 0.1 < slow < fast
