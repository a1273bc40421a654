"""A run that is ended by a signal leaves neither ngspice nor unfinished files; broken programs."""

import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from commands import session
from spicelib import RawRead
from support import load_scene, run_scene

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


def within(seconds, condition):
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return found


def started(folder):
    """A run in a session of its own whose ngspice is under way."""
    (folder / "long.toml").write_text(LONG)
    # Tests that run under nohup would hand the signal down as one that is ignored.
    command = [shutil.which("env"), "--default-signal=HUP", sys.executable, "-m", "kc2spice"]
    command += ["run", "long.toml", "-o", "out"]
    process = subprocess.Popen(
        command, cwd=folder, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    within(60, lambda: any(w.startswith(b"ngspice") or b"/ngspice" in w.split(b"\0")[0]
                           for w in session(process.pid).values()))  # fmt: skip
    return process


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_signal_ends_the_simulator_too(number, tmp_path):
    process = started(tmp_path)
    process.send_signal(number)
    said = process.communicate(timeout=120)[1]
    assert within(5, lambda: not session(process.pid))
    assert "Traceback" not in said
    if number != signal.SIGKILL:  # which nothing can clear up after; the next run does
        assert process.returncode == 128 + number
        assert sorted(os.listdir(tmp_path)) == ["long.toml"]


def test_the_raw_file_is_kept_on_request(tmp_path):
    """Another reader finds in it what the results say."""
    (tmp_path / "short.toml").write_text(LONG.replace("stop = 0.09", "stop = 1e-6"))
    scene = load_scene(tmp_path / "short.toml", ["name=short"])
    for keep in (True, False):
        record = run_scene(scene, tmp_path / "out", keep=keep)
        files = sorted(record["files"])
        assert files == sorted(os.listdir(tmp_path / "out"))
        assert ("short.raw" in files, "short.log" in files) == (keep, keep)
        if keep:
            raw = RawRead(str(tmp_path / "out" / "short.raw"), dialect="ngspice")
            with np.load(tmp_path / "out" / "waveforms.npz") as waves:
                found = raw.get_trace("v(source_out)").get_wave()
                np.testing.assert_allclose(found, waves["source.v"], atol=1e-12)
