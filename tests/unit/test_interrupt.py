"""Signals end the program, whatever it does."""

import signal
import subprocess
import sys
import time

import pytest

SCRIPT = """
import hashlib, sys, time
from pathlib import Path
from kc2spice.core.signal_handlers import end_on_signals
with end_on_signals(0.2):
    try:
        Path(sys.argv[2]).write_text("ready")
        if sys.argv[1] == "library":  # one call of a library in C, of an hour
            hashlib.pbkdf2_hmac("sha256", b"", b"", 2**31 - 1)
        time.sleep(3600)
    except KeyboardInterrupt:
        Path(sys.argv[2]).write_text("cleaned up")
        sys.exit(130)
    finally:
        time.sleep(0.5)  # longer than a call may take to begin with this
        with Path(sys.argv[2]).open("a") as file:
            file.write(", finished")
"""
LOADING = """
import importlib.abc, os, signal, sys
from kc2spice.__main__ import main

class Finder(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "kc2spice.cli.main":
            signal.raise_signal(getattr(signal, sys.argv[1]))

sys.meta_path.insert(0, Finder())
main()
"""
ENDED = """
import signal, sys
from kc2spice.core.signal_handlers import end_on_signals
try:
    with end_on_signals():
        sys.exit(4)
finally:
    signal.raise_signal(getattr(signal, sys.argv[1]))
"""


@pytest.mark.parametrize(
    ("work", "number", "code", "left"),
    [
        ("library", "SIGTERM", 143, "ready"),
        ("library", "SIGINT", 130, "ready"),
        ("python", "SIGTERM", 143, "ready, finished"),
        ("python", "SIGINT", 130, "cleaned up, finished"),
    ],
)
def test_signals_end_long_calls_and_wait_for_cleaning_up(tmp_path, work, number, code, left):
    mark = tmp_path / "mark"
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, work, str(mark)], stderr=subprocess.DEVNULL
    )
    try:
        while not (mark.is_file() and mark.read_text()):
            assert process.poll() is None
            time.sleep(0.02)
        time.sleep(0.1)
        process.send_signal(getattr(signal, number))
        assert process.wait(60) == code
    finally:
        process.kill()
    assert mark.read_text() == left


@pytest.mark.parametrize(("number", "code"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_signals_while_modules_are_loaded_have_the_same_exit_codes(number, code):
    done = subprocess.run([sys.executable, "-c", LOADING, number], capture_output=True)
    assert done.returncode == code
    assert b"Traceback" not in done.stderr


@pytest.mark.parametrize("number", ["SIGTERM", "SIGINT"])
def test_signals_after_the_end_leave_the_exit_code(number):
    done = subprocess.run([sys.executable, "-c", ENDED, number], capture_output=True)
    assert (done.returncode, done.stderr) == (4, b"")


MESHED = """
import os
from kc2spice.core.gmsh_session import gmsh_session
with gmsh_session():
    pass
inlet, outlet = os.pipe()
os.close(inlet)
try:
    os.write(outlet, b"x")
except BrokenPipeError:
    print("an exception")
"""


@pytest.mark.skipif(not hasattr(signal, "SIGPIPE"), reason="the system has no such signal")
def test_a_broken_pipe_after_meshing_is_an_exception():
    done = subprocess.run([sys.executable, "-c", MESHED], capture_output=True)
    assert (done.returncode, done.stdout) == (0, b"an exception\n")
