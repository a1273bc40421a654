"""A run that is ended by a signal leaves neither ngspice nor unfinished files; broken programs."""

import os
import shutil
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from spicelib import RawRead

from kc2spice.core.errors import MissingToolError, SimulationError
from kc2spice.netlist.deck import Deck
from kc2spice.scene.load import load_scene
from kc2spice.sim import ngspice
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


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_kill_ends_the_simulator_where_setpriv_is_missing(tmp_path):
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "ngspice").symlink_to(shutil.which("ngspice"))
    process, simulators = started(tmp_path, PATH=str(tmp_path / "bin"))
    process.kill()
    process.communicate(timeout=120)
    assert all(gone(pid) for pid in simulators)


def test_a_program_that_stands_still_is_ended(tmp_path, monkeypatch):
    path = tmp_path / "ngspice"
    path.write_text("#!/bin/sh\n[ $1 = --version ] && echo ngspice-45 && exit\nexec sleep 60\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setattr(ngspice, "find_ngspice", lambda: ngspice.Simulator("x", "45", str(path)))
    monkeypatch.setattr(ngspice, "STALLED", 0.3)
    begin = time.monotonic()
    with pytest.raises(SimulationError, match="ngspice hangs"):
        ngspice.run_deck(Deck(name="any", stop=1.0), tmp_path)
    assert time.monotonic() - begin < 10
    assert "any.raw" not in os.listdir(tmp_path)


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


UNKNOWN = ["unshare", "-U", "--map-user=54321", "--map-group=54321"]
may_unshare = shutil.which("unshare") and not subprocess.run([*UNKNOWN, "true"]).returncode


@pytest.mark.skipif(not may_unshare, reason="a user namespace makes the unknown user")
@pytest.mark.parametrize("engine", ["batch", "shared"])
def test_an_unknown_user_without_home_simulates(engine, tmp_path):
    """ngspice asks for the home of its user and crashes where there is none."""
    (tmp_path / "short.toml").write_text(LONG.replace("stop = 0.09", "stop = 1e-6"))
    words = {"batch": ["-m", "kc2spice", "run", "short.toml", "-q", "-o", "out"],
             "shared": ["-c", "from kc2spice.sim.shared import Library; "
                              "assert Library().load('t\\nR1 a 0 1\\n.op\\n.end')"]}  # fmt: skip
    homeless = {k: v for k, v in os.environ.items() if k != "HOME"}
    done = subprocess.run([*UNKNOWN, sys.executable, *words[engine]], cwd=tmp_path, env=homeless,
                          capture_output=True, text=True)  # fmt: skip
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("program", ["\x7fELF broken", "#!/bin/sh\nexec sleep 60\n"])
def test_a_program_that_does_not_run_is_a_missing_one(program, tmp_path, monkeypatch):
    path = tmp_path / "ngspice"
    path.write_text(program)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(ngspice, "ANSWERS", 0.5)
    with pytest.raises(MissingToolError, match="does not run"):
        ngspice.find_ngspice.__wrapped__()
