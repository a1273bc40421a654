"""A scheduler and workers of their own: killed and restarted in the middle of a sweep."""

import socket
import subprocess
import sys
import time

import pytest
from support import SceneInput, make_dask_connector, make_local_pool_opener, sweep_execution

pytest.importorskip("distributed")

SETS = ("control.kd=10:30:16", "kick.drive.start=20 us", "control.enable_at=20 us",
        "solver.stop=600 us", "solver.reltol=1e-3")  # fmt: skip


def start(*arguments):
    command = [sys.executable, "-m", *arguments, "--no-dashboard"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.mark.slow
def test_a_killed_worker_and_a_restarted_scheduler_lose_no_point(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    scheduler = ("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port))
    worker = ("distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny")
    daemons = {"scheduler": start(*scheduler), "a": start(*worker), "b": start(*worker)}
    rows = tmp_path / "dask" / sweep_execution.ROWS_FILE
    study = sweep_execution.make_sweep(SceneInput("kick_and_catch", None), SETS)
    done = []

    def interfere(stage, share, text):
        if stage != "sweep":
            return
        done.append(rows.read_bytes().count(b'"interrupted": '))
        if len(done) == 3:
            daemons["a"].kill()
        if len(done) == 6:
            daemons["scheduler"].kill()
            daemons["scheduler"].wait()
            time.sleep(1.0)
            daemons["scheduler"] = start(*scheduler)
            daemons["c"] = start(*worker)

    try:
        workers = make_dask_connector(address, 1, patience=60.0)
        distributed = sweep_execution.run_sweep(study, tmp_path / "dask", workers, interfere)
    finally:
        for process in daemons.values():
            process.kill()
            process.wait()
    assert (distributed["points"], distributed["failed"]) == (16, 0)
    assert done == sorted(set(done))  # each row is recorded once
    local = sweep_execution.run_sweep(study, tmp_path / "local", make_local_pool_opener(2))
    tables = [(tmp_path / name / "sweep.csv").read_bytes() for name in ("dask", "local")]
    assert tables[0] == tables[1]
    assert local["failed"] == 0
