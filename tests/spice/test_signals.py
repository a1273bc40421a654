"""A run that is ended by a signal leaves neither ngspice nor unfinished files; broken programs."""

import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from kc2spice.core.errors import MissingToolError
from kc2spice.sim import ngspice

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
stop = 10.0
[solver]
max_step = "10 ns"
"""


def children(pid):
    found = subprocess.run(["pgrep", "-P", str(pid), "ngspice"], capture_output=True, text=True)
    return [int(each) for each in found.stdout.split()]


def started(folder, **environment):
    (folder / "long.toml").write_text(LONG)
    command = [sys.executable, "-m", "kc2spice", "run", "long.toml", "-o", "out"]
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
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_signal_ends_the_simulator_too(number, tmp_path):
    process, simulators = started(tmp_path)
    process.send_signal(number)
    said = process.communicate(timeout=30)[1]
    assert all(gone(pid) for pid in simulators)
    assert "Traceback" not in said
    if number != signal.SIGKILL:  # which nothing can clear up after; the next run does
        assert process.returncode == 128 + number
        assert sorted(os.listdir(tmp_path)) == ["long.toml"]


@pytest.mark.parametrize(
    "program", ["\x7fELF broken", "#!/bin/sh\nexec sleep 60\n", "#!/nowhere\n"]
)
def test_a_program_that_does_not_run_is_a_missing_one(program, tmp_path, monkeypatch):
    path = tmp_path / "ngspice"
    path.write_text(program)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(ngspice, "ANSWERS", 0.5)
    with pytest.raises(MissingToolError, match="does not run"):
        ngspice.find_ngspice.__wrapped__()
