"""Work in a process of its own: what it hands back, and everything that may go wrong in it."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from support import MissingToolError, UsageError, call_in_child

WORK = """
import ctypes, os, subprocess, time
from pathlib import Path
import numpy as np
from kc2spice.core.errors import UsageError

def double(values): return {"twice": 2.0 * np.array(values), "files": np.array(os.listdir())}
def crash(): ctypes.string_at(0)
def fill(): return {"a": np.ones(10**9)}
def refuse(): raise UsageError("no", where="file", got=[1], expected="two", hint="add")
def unread(): raise NotImplementedError("HDF")
def fail(): raise RuntimeError("line\\nbreak")
def leave(): os._exit(0)
def odd(): return {"a": np.array([object()])}
def wait(file):
    Path(file).write_text(str(os.getpid()))
    time.sleep(60)
"""


def ask(name, memory=2_000_000_000, **request):
    return call_in_child(
        f"work:{name}", request, lambda folder: (folder / "work.py").write_text(WORK), memory
    )


def test_arrays_come_back():
    found = ask("double", values=[1.0, 2.5])
    np.testing.assert_array_equal(found["twice"], [2.0, 5.0])
    assert set(found["files"]) <= {"work.py", "__pycache__"}  # a folder of its own


@pytest.mark.parametrize(
    ("name", "message"),
    [("crash", "crash"), ("fill", "2 GB of memory"), ("fail", "line break"), ("leave", "answer"),
     ("odd", "is a Python object")],
)  # fmt: skip
def test_every_fault_in_a_child_process_is_an_error(name, message):
    with pytest.raises(ValueError, match=message):
        ask(name)


def test_errors_of_child_processes_keep_their_content():
    with pytest.raises(UsageError) as caught:
        ask("refuse")
    error = caught.value
    found = (error.message, error.where, error.got, error.expected, error.hint)
    assert found == ("no", "file", [1], "two", "add")
    assert not isinstance(error, MissingToolError)
    with pytest.raises(NotImplementedError, match="HDF"):
        ask("unread")


def test_no_child_process_outlives_its_parent(tmp_path):
    """Even one that is killed on the spot."""
    script = (
        "import sys; from pathlib import Path\n"
        "from kc2spice.core.untrusted_files import call_in_child\n"
        f"call_in_child('work:wait', {{'file': {str(tmp_path / 'pid')!r}}}, "
        f"lambda home: (home / 'work.py').write_text({WORK!r}))"
    )
    parent = subprocess.Popen([sys.executable, "-c", script])
    pid = tmp_path / "pid"
    while not (pid.is_file() and pid.read_text()):
        assert parent.poll() is None
        time.sleep(0.02)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    for _ in range(500):
        try:
            os.kill(int(pid.read_text()), 0)
        except ProcessLookupError:
            return
        with open(f"/proc/{pid.read_text()}/stat") as stat:
            if stat.read().split()[2] == "Z":
                return
        time.sleep(0.02)
    pytest.fail("the child lives on")
