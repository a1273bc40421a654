"""A run that is ended by a signal leaves neither ngspice nor unfinished files; broken programs."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from spicelib import RawRead

from kc2spice.scene.load import load_scene
from kc2spice.workflow.run import run

LONG = """name = "long"
[source]
part = "source"
sine = { amplitude = 1.0, frequency = 1e6 }
pins = { out = "load.a" }
[load]
part = "resistor"
resistance = "1 Ohm"
[analysis]
type = "transient"
stop = 0.09
[solver]
max_step = "10 ns"
"""


def children(pid):
    found = subprocess.run(["pgrep", "-P", str(pid), "ngspice"], capture_output=True, text=True)
    return [int(each) for each in found.stdout.split()]


def started(folder, **environment):
    (folder / "long.toml").write_text(LONG)
    # Tests that run under nohup would hand the signal down as one that is ignored.
    command = [shutil.which("env"), "--default-signal=HUP", sys.executable, "-m", "kc2spice"]
    command += ["run", "long.toml", "-o", "out"]
    process = subprocess.Popen(
        command, cwd=folder, env={**os.environ, **environment}, stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and process.poll() is None:
        if simulators := children(process.pid):
            return process, simulators
        time.sleep(0.05)
    process.kill()
    raise AssertionError(process.communicate()[1])


def gone(pid):
    for _ in range(100):
        try:
            os.kill(pid, 0)
            if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except (ProcessLookupError, FileNotFoundError):
            return True
        time.sleep(0.05)
    return False


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_signal_ends_the_simulator_too(number, tmp_path):
    process, simulators = started(tmp_path)
    process.send_signal(number)
    said = process.communicate(timeout=120)[1]
    assert all(gone(pid) for pid in simulators)
    assert "Traceback" not in said
    if number != signal.SIGKILL:  # which nothing can clear up after; the next run does
        assert process.returncode == 128 + number
        assert sorted(os.listdir(tmp_path)) == ["long.toml"]


def test_the_raw_file_is_kept_on_request(tmp_path):
    """Another reader finds in it what the results say."""
    (tmp_path / "short.toml").write_text(LONG.replace("stop = 0.09", "stop = 1e-6"))
    scene = load_scene(tmp_path / "short.toml", ["name=short"])
    for keep in (True, False):
        record = run(scene, tmp_path / "out", keep=keep)
        files = sorted(record["files"])
        assert files == sorted(os.listdir(tmp_path / "out"))
        assert ("short.raw" in files, "short.log" in files) == (keep, keep)
        if keep:
            raw = RawRead(str(tmp_path / "out" / "short.raw"), dialect="ngspice")
            with np.load(tmp_path / "out" / "waveforms.npz") as waves:
                found = raw.get_trace("v(source_out)").get_wave()
                np.testing.assert_allclose(found, waves["source.v"], atol=1e-12)
