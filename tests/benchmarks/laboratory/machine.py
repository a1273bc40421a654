"""The machine line of a benchmark: without it no time means anything."""

from __future__ import annotations

import platform
import shutil
import subprocess
from pathlib import Path

import numpy
import scipy

import kc2spice
from kc2spice.sim.ngspice import find_ngspice
from kc2spice.workflow.sweep.workers import cores


def machine() -> dict[str, str | int]:
    """Processor, cores that may be used, system, and the versions of what was timed."""
    return {
        "cpu": _cpu(),
        "cores": cores(),
        "os": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "numpy": numpy.__version__,
        "scipy": scipy.__version__,
        "ngspice": find_ngspice().version,
        "compiler": compiler() or "none",
        "kc2spice": kc2spice.__version__,
    }


def compiler() -> str | None:
    """First line of the C compiler's version, None where there is none."""
    path = shutil.which("cc")
    if path is None:
        return None
    said = subprocess.run([path, "--version"], capture_output=True, text=True, check=False).stdout
    return said.splitlines()[0] if said else None


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
