"""More than a hundred circuits that try to act, run as the product does, judged by what it touched.

Every file that is opened and every program that is started is traced with strace; an exit code
could say anything.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from hostile.circuits import honest, write_all
from support import find_ngspice

import kc2spice

CHILD = Path(__file__).parent / "hostile" / "child.py"
CALL = re.compile(r"^(\d+) +(execve|openat|creat)\((?:AT_FDCWD, )?\"((?:[^\"\\]|\\.)*)\"(.*)$")
# What ngspice may look at besides the files that are written for it.
SYSTEM = ("/usr/", "/lib", "/etc/", "/proc/", "/sys/", "/dev/")
OWN = (".ngspice_history", ".editrc")
THEIRS = ("inner.lib", "nested.lib", "extra.lib", "link.lib", "payload.lib")
OUR_FILES = re.compile(r"(\./)?([a-z_]+|user\.lib_inner)\.(lib|cir|raw\.part)")


def traced(command, log, **options):
    """Calls of the program and of all that it starts: (process, call, path, rest)."""
    strace = shutil.which("strace")
    assert strace, "this test needs strace: apt-get install strace"
    words = [strace, "-f", "-qq", "-s", "4096", "-e", "trace=execve,openat,creat", "-o", str(log)]
    done = subprocess.run([*words, *command], capture_output=True, text=True, check=False,
                          stdin=subprocess.DEVNULL, **options)  # fmt: skip
    found = [CALL.match(line) for line in log.read_text(errors="replace").splitlines()]
    return done, [match.groups() for match in found if match]


def acts(calls, program):
    """Files touched outside the system and the deck's files, and programs other than ``program``.

    The product may read what a circuit includes: how else could it refuse it? Nobody writes there.
    """
    simulators = {pid for pid, call, path, _ in calls if call == "execve" and path == program}
    found = []
    for pid, call, path, rest in calls:
        if call == "execve":
            ours = path in (program, sys.executable) or ties(program, path, rest)
            if not ours and "ENOENT" not in rest:
                found.append(f"runs {path}")
        elif "pwned" in path.lower() or (
            "/payload" in path and (pid in simulators or "O_RDONLY" not in rest)
        ):
            found.append(f"opens {path}")
        elif pid in simulators and not path.startswith(SYSTEM) and "O_TMPFILE" not in rest:
            file = Path(path).name
            if file in THEIRS or (file not in OWN and not OUR_FILES.fullmatch(path)):
                found.append(f"ngspice opens {path}")
    return found


def ties(program, path, rest):
    """Whether this ties the life of ``program`` to its parent's, or is the trial of that."""
    if path == shutil.which("setpriv"):
        words = rest.startswith(', ["setpriv", "--pdeathsig", "KILL", "--", ')
        return words and (f', "--", "{program}", "-b", ' in rest or ', "--", "true"]' in rest)
    return path == shutil.which("true") and rest.startswith(', ["true"]')


@pytest.fixture(scope="module")
def circuits(tmp_path_factory):
    root = tmp_path_factory.mktemp("hostile")
    return root, write_all(root)


def environment(root):
    root_folder = Path(kc2spice.__file__).parents[1]
    source = os.pathsep.join([str(root_folder), str(root_folder / "tests")])
    return os.environ | {"HOME": str(root / "home"), "PYTHONPATH": source, "LC_ALL": "C.UTF-8"}


@pytest.mark.slow
def test_nothing_is_touched_that_was_not_written_for_the_simulator(circuits):
    root, scenes = circuits
    assert len(scenes) >= 100 + len(honest())
    done, calls = traced([sys.executable, str(CHILD), str(root)], root / "trace",
                         env=environment(root), cwd=root)  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    said = json.loads(done.stdout)
    assert len(said) == len(scenes)
    assert [said[scene.parent.name] for scene in scenes[: len(honest())]] == ["ran"] * len(honest())
    assert all(text == "ran" or text.startswith(("2:", "5:")) for text in said.values())
    assert acts(calls, find_ngspice().path) == []
    assert not [path for path in root.rglob("*") if path.name.lower() == "pwned"]


@pytest.mark.slow
def test_a_trace_of_ngspice_detects_harmful_circuits(circuits):
    """The same circuits given to ngspice as they are: most of them act, and the judge sees it."""
    root, scenes = circuits
    acted = 0
    for scene in scenes:
        command = [find_ngspice().path, "-b", "-n", "bare.cir"]
        _, calls = traced(command, root / "bare", env=environment(root), cwd=scene.parent)
        found = acts(calls, command[0])
        acted += any("outside" in text or "runs" in text or "inner" in text for text in found)
        (scene.parent / "pwned").unlink(missing_ok=True)
    assert acted >= 70
