"""Signals end the program, whatever it does."""

import signal
import subprocess
import sys
import time

import pytest

SCRIPT = """
import hashlib, sys, time
from pathlib import Path
from kc2spice.core.interrupt import end_on_signals
end_on_signals(0.2)
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
