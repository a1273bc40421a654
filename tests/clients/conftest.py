"""Programs that read what we write, where they are installed, and decks for them.

``tools/clients.sh`` fetches them into a folder of their own; the tests look there and on the path.
"""

import os
import shutil
import subprocess
from pathlib import Path

import device
import pytest
from support import load_scene, make_deck

ROOT = Path(__file__).parents[2]
CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "kc2spice-clients"
OWN = Path(os.environ.get("KC2SPICE_CLIENTS", CACHE)) / "bin"


@pytest.fixture(scope="session")
def program():
    """``program(name, own=False)``: its path; the test is skipped where it is not installed."""

    def find(name, *, own=False):
        path = shutil.which(name, path=str(OWN)) or (None if own else shutil.which(name))
        if path is None:
            pytest.skip(f"{name} is not installed; tools/clients.sh fetches all but Xyce")
        return path

    return find


@pytest.fixture(scope="session")
def deck_of():
    """``deck_of(scene, **solver)``: a gallery scene around made-up chip and magnets, exported."""

    def make(name, **solver):
        whole = load_scene(name)
        given = {f"solver.{key}": value for key, value in solver.items()}
        if whole.analysis.stop is not None and "stop" in solver:
            stop = given.pop("solver.stop")
            late = [key for key, probe in whole.probes.items() if (probe.from_ or 0.0) >= stop]
            given |= {"analysis.stop": stop} | {f"probes.{key}.from": 0.0 for key in late}
        scene = load_scene(name, given)
        return make_deck(device.built(scene, device.chip(), device.magnets(), others=True))

    return make


@pytest.fixture(scope="session")
def run():
    """``run(command, folder)``: its output; it must succeed."""

    def execute(command, folder):
        path = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
        environment = {**os.environ, "PYTHONPATH": path}
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        return done.stdout + done.stderr

    return execute
