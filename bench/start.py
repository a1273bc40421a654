"""Part ``start``: what a user waits for: help, a changed gain, the very first run."""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bench.points import Outcome, Ratio, timing
from bench.setup import COARSE, COARSE_CATCH
from kc2spice.core.errors import SimulationError

SCENE = ("run", "kick_and_catch", "--quiet", "--json", "--out")
GAIN = "control.kd=21 A s/m"
RUNS = 7  # of each; their median counts


def start(setup):
    """Wall time of whole commands, in new processes, the first run with an empty cache."""
    runs = min(RUNS, setup.repeats) if setup.quick else RUNS
    with tempfile.TemporaryDirectory(prefix="kc2spice-start-") as folder:
        work = Path(folder)
        coarse = (*COARSE, *COARSE_CATCH) if setup.quick else ()
        small = [word for key in coarse for word in ("--set", key)]
        help_, first, again = [], [], []
        _send_command([*SCENE, str(work / "a"), *small], work / "cache")  # writes the bytecode
        for k in range(runs):  # in turn, so that a slow minute meets them alike
            cache = work / f"cache{k}"
            help_.append(_send_command(["--help"], cache))
            first.append(_send_command([*SCENE, str(work / "a"), *small], cache))
            again.append(_send_command([*SCENE, str(work / "b"), "--set", GAIN, *small], cache))
    return Outcome(
        ratios=(
            _limit("start_help_s", help_, 0.1, "kc2spice --help"),
            _limit("start_rerun_s", again, 0.8, "second run of kick_and_catch, with a new gain"),
            _limit("start_first_s", first, 3.0, "first run of kick_and_catch, with an empty cache"),
        )
    )


def _limit(name, taken, limit, what):
    spread = f"{what}, wall time, median of {len(taken)}, {min(taken):.3g} to {max(taken):.3g} s"
    return Ratio(name, timing(taken).median, None, limit, spread, at_least=False, unit="s")


def _send_command(arguments, cache):
    """Seconds of one command of kc2spice with a cache of its own."""
    command = [sys.executable, "-m", "kc2spice", *arguments]
    environment = {**os.environ, "KC2SPICE_CACHE": str(cache)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # what is installed has its bytecode
    begin = time.perf_counter()
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if ran.returncode:
        raise SimulationError("the command failed", where=" ".join(command), got=ran.stderr[-500:])
    return time.perf_counter() - begin
