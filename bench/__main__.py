"""``python -m bench`` in the root of the repository; ``make bench`` runs it.

Measures speed against error: ngspice, its peers and a lower bound. Writes bench.json, bench.md and
a plot of each plane. A target that is missed is a row of the table, not a failure.
"""

import argparse
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from datetime import date
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy
import scipy

import kc2spice
from bench.page import bench_figures, bench_tables
from bench.points import pareto
from bench.setup import Setup
from kc2spice.core.errors import Kc2spiceError, UsageError
from kc2spice.core.files import stage_directory
from kc2spice.core.progress import StageTimer
from kc2spice.core.waveforms import write_record
from kc2spice.report.matplotlib_figures import write_pngs
from kc2spice.sim.ngspice import find_ngspice
from kc2spice.workflow.sweep.workers import count_available_cores

# Each part is the function of its own name in the module of that name. What a user waits for comes
# first: many a machine slows down under the minutes of load that the others are.
PARTS = ("start", "loop", "impact", "imprint", "harmonic", "em", "dense", "writers")


def bench(out, parts, *, quick, repeats):
    """Measure ``parts`` (all of them if there are none) and write the files into ``out``.

    ``quick`` takes coarse models and few points: the record has the same shape, its numbers mean
    nothing.
    """
    for part in parts:
        if part not in PARTS:
            raise UsageError("no such part", where="--part", got=part, expected=", ".join(PARTS))
    record: dict[str, Any] = {
        "date": date.today().isoformat(), "commit": commit(), "machine": machine(),
        "quick": quick, "repeats": repeats,
        "planes": {}, "titles": {}, "ratios": {}, "seconds": {},
    }  # fmt: skip
    with (
        stage_directory(out) as directory,
        tempfile.TemporaryDirectory(prefix="kc2spice-bench-") as work,
    ):
        setup = Setup(quick, repeats, Path(work), StageTimer())
        for part in PARTS:
            if parts and part not in parts:
                continue
            print(part, file=sys.stderr, flush=True)
            begin = time.perf_counter()
            outcome = getattr(import_module(f"bench.{part}"), part)(setup)
            for plane in outcome.planes:
                record["planes"][plane.name] = _points(plane)
                record["titles"][plane.name] = {
                    "title": plane.title, "error": plane.error_name, "time": plane.time_name,
                    "notes": list(plane.notes),
                }  # fmt: skip
            for ratio in outcome.ratios:
                record["ratios"][ratio.name] = {**asdict(ratio), "met": ratio.met}
            record["seconds"][part] = time.perf_counter() - begin
        record = write_record(record, directory, "bench.json")
        (directory / "bench.md").write_text(bench_tables(record), encoding="utf-8")
        write_pngs(directory, [*bench_figures(record)])


def _points(plane):
    # The lower bound solves this loop and nothing else: it is no choice, only a bound.
    front = pareto([point for point in plane.points if point.family != "lower bound"])
    return [
        {
            "label": point.label, "family": point.family, "error": point.error,
            "time_s": point.time.median, "time_low_s": point.time.low,
            "time_high_s": point.time.high, "repeats": point.time.repeats,
            "errors": point.errors, "facts": point.facts, "note": point.note,
            "same_model": point.same_model, "pareto": point in front,
        }
        for point in plane.points
    ]  # fmt: skip


def commit():
    """Short name of the commit of this package, empty outside of a clone."""
    words = ["git", "-C", str(Path(kc2spice.__file__).parent), "rev-parse", "--short", "HEAD"]
    return subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()


def machine():
    """Processor, cores that may be used, system, and the versions of what was timed."""
    compiler, info = shutil.which("cc"), Path("/proc/cpuinfo")
    said = [compiler and subprocess.run([compiler, "--version"], capture_output=True, text=True)]
    names = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    models = [line.partition(":")[2].strip() for line in names if line.startswith("model name")]
    return {
        "cpu": next(iter(models), platform.processor() or platform.machine()),
        "cores": count_available_cores(),
        "os": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "numpy": numpy.__version__,
        "scipy": scipy.__version__,
        "ngspice": find_ngspice().version,
        "compiler": next((done.stdout.partition("\n")[0] for done in said if done), "none"),
        "kc2spice": kc2spice.__version__,
    }


def main():
    """The exit code is that of ``kc2spice``."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("--part", action="append", default=[], help=f"only {', '.join(PARTS)}")
    parser.add_argument("--out", type=Path, default=Path("out/bench"), help="where to write")
    parser.add_argument("--repeats", type=int, default=5, help="of each point; the median counts")
    parser.add_argument("--quick", action="store_true", help="for the shape, not for the numbers")
    asked = parser.parse_args()
    try:
        bench(asked.out, asked.part, quick=asked.quick, repeats=asked.repeats)
    except Kc2spiceError as error:
        print(error, file=sys.stderr)
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())
