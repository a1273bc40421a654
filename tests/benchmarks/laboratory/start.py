"""Part ``start``: what a user waits for: help, a changed gain, the very first run."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from kc2spice.core.errors import SimulationError
from laboratory.points import Outcome, Ratio, Timing, timing
from laboratory.setup import Setup

SCENE = ("run", "kick_and_catch", "--quiet", "--json", "--out")
GAIN = "control.kd=21 A s/m"


def start(setup: Setup) -> Outcome:
    """Wall time of whole commands, in new processes, the first run with an empty cache."""
    with tempfile.TemporaryDirectory(prefix="kc2spice-start-") as folder:
        work = Path(folder)
        progress = setup.clock.progress
        progress("start", None, "--help")
        help_ = timing([_command(["--help"], work) for _ in range(setup.repeats)])
        progress("start", None, "first run, empty cache")
        small = [item for key in _coarse(setup) for item in ("--set", key)]
        first = timing([_command([*SCENE, str(work / "a"), *small], work)])
        progress("start", None, "run with another gain")
        again = timing(
            [
                _command([*SCENE, str(work / "b"), "--set", GAIN, *small], work)
                for _ in range(setup.repeats)
            ]
        )
    return Outcome(
        ratios=(
            _limit("start_help_s", help_, 0.3, "kc2spice --help"),
            _limit("start_rerun_s", again, 2.0, "kick_and_catch again with a new gain"),
            _limit("start_first_s", first, 60.0, "kick_and_catch with an empty cache"),
        )
    )


def _coarse(setup: Setup) -> tuple[str, ...]:
    from laboratory.setup import COARSE, COARSE_CATCH

    return (*COARSE, *COARSE_CATCH) if setup.quick else ()


def _limit(name: str, taken: Timing, limit: float, what: str) -> Ratio:
    return Ratio(name, taken.median, None, limit, f"{what}, wall time", at_least=False, unit="s")


def _command(arguments: list[str], work: Path) -> float:
    """Seconds of one command with a cache of its own."""
    command = [sys.executable, "-m", "kc2spice", *arguments]
    environment = {**os.environ, "KC2SPICE_CACHE": str(work / "cache")}
    begin = time.perf_counter()
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if ran.returncode:
        raise SimulationError(
            "the command failed", where=" ".join(arguments), got=ran.stderr[-500:]
        )
    return time.perf_counter() - begin
