"""Worker processes of a sweep: what a killed worker leaves running ends, and its files go."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest
from support import make_local_pool_opener

pytestmark = pytest.mark.skipif(not hasattr(os, "setpgrp"), reason="needs process groups")

WRITER = "import itertools, pathlib\nfor n in itertools.count(): pathlib.Path(str(n % 50)).touch()"


def dies_beside_a_writer(marker):
    """Start a program that never stops writing to the scratch folder, then die."""
    folder = tempfile.mkdtemp()
    child = subprocess.Popen([sys.executable, "-c", WRITER], cwd=folder)
    while not any(Path(folder).iterdir()):
        time.sleep(0.01)
    Path(marker).write_text(f"{child.pid} {tempfile.tempdir}")
    os.kill(os.getpid(), signal.SIGKILL)


def is_running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat")
    return not state.exists() or state.read_text().rpartition(")")[2].split()[0] != "Z"


def test_a_killed_worker_leaves_no_program_and_no_files(tmp_path):
    marker = tmp_path / "marker"
    with make_local_pool_opener(1)() as (pool, _), pytest.raises(BrokenProcessPool):
        pool.submit(dies_beside_a_writer, str(marker)).result(60)
    pid, scratch = marker.read_text().split(maxsplit=1)
    deadline = time.monotonic() + 10
    while is_running(int(pid)):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    assert not Path(scratch).exists()
