"""Run a sweep: resume what is recorded, keep the workers busy, stream the rows, draw the table."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.progress import Progress, silent
from kc2spice.workflow.sweep.point import Cost, Outcome, cpu_since_last, run_point, task
from kc2spice.workflow.sweep.pool import Call, Engine, WorkerDied, WorkerPool
from kc2spice.workflow.sweep.study import (
    PLAN,
    SHARDS,
    Study,
    check_parameters,
    make_study,
    read_plan,
    write_plan,
)
from kc2spice.workflow.sweep.table import (
    BAD,
    INTERRUPTED,
    MISSING,
    RowStore,
    columns,
    need_parquet,
    publish,
)

ROWS = "rows.sqlite"
DIED = "its worker process died, twice"
NO_TIME: dict[str, float | None] = {"wall_s": 0.0}
SCRIPT = "sweep.sbatch"
_SLURM = """\
#!/bin/bash
# {points} points of {scene} in {shards} parts. Edit what your site needs, then
#     sbatch {script}
# and when all tasks are done
#     kc2spice sweep --collect .
# A task that was killed may be submitted again: it runs only what it did not record.
#SBATCH --job-name=kc2spice
#SBATCH --array=0-{last}
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=1
#SBATCH --output=slurm-%A_%a.log
set -euo pipefail
cd "${{SLURM_SUBMIT_DIR:-$(dirname "$0")}}"
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
exec kc2spice sweep --out . --shard "${{SLURM_ARRAY_TASK_ID}}/{shards}" \\
    --workers "${{SLURM_CPUS_PER_TASK:-1}}"
"""


@dataclass(frozen=True)
class Shard:
    """Part ``number`` of ``count`` equal parts of a sweep, for one task of an array."""

    number: int
    count: int


def sweep(
    study: Study, out: Path, engine: Engine, progress: Progress = silent, *,
    retry_failed: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Run all points that ``out`` does not hold yet; return the contract's summary.

    Rows go to ``out/rows.sqlite`` as they come; the table, its figures and ``sweep.html`` appear
    when all are there. A sweep that was killed goes on where it was when it is asked for again.
    Points that failed for what happened to the machine are run again then, with ``retry_failed``
    all that failed; their rows are kept for that.

    Raises
    ------
    UsageError : ``out`` holds another sweep, or another process writes there.
    MissingToolError : no workers, or no ngspice where they are.
    """
    acquire(study, out)
    table, path = _table(study, out), out / ROWS
    if table.exists() and not path.exists():
        return {**_conclude(study, out, progress), "resumed": study.plan.size, **NO_TIME}
    check_parameters(study)
    found = _filled(study, path, None, engine, progress, retry_failed)
    publish([path], table, study.header, study.kinds)
    if not found["failed"]:
        path.unlink()
    return {**found, **_conclude(study, out, progress)}


def tabulate(
    study: Study, directory: Path, engine: Engine, progress: Progress = silent
) -> dict[str, np.ndarray]:
    """Run all points; the table's columns. ``directory`` is scratch."""
    path, table = directory / ROWS, directory / "sweep.csv"
    _filled(study, path, None, engine, progress, False)
    publish([path], table, study.header, study.kinds)
    return columns(table, study.kinds)


def sweep_shard(
    directory: Path, shard: Shard, engine: Engine, progress: Progress = silent, *,
    retry_failed: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Run one part of the sweep that is planned in ``directory``; its rows wait to be collected."""
    study = planned(directory)
    if not 0 <= shard.number < shard.count:
        raise UsageError("no such shard", got=shard.number, expected=f"0 … {shard.count - 1}")
    path = directory / SHARDS / f"{shard.number:06d}.sqlite"
    return _filled(study, path, shard, engine, progress, retry_failed)


def collect(directory: Path, progress: Progress = silent) -> dict[str, Any]:
    """Put the rows of all shards into the sweep's table.

    Raises
    ------
    SimulationError : points are missing; the rows that are there stay where they are.
    """
    study = planned(directory)
    table = _table(study, directory)
    stores = sorted((directory / SHARDS).glob("*.sqlite"))
    if not table.exists():
        found = [RowStore(path, study.plan.size) for path in stores]
        for rows in found:
            rows.close()
        recorded = [rows.state != MISSING for rows in found]
        there = np.any(recorded, axis=0).sum() if found else 0
        missing = study.plan.size - int(there)
        if missing:
            raise SimulationError(
                "the sweep is not complete", where=str(directory), got=f"{missing} points missing",
                expected=f"{study.plan.size} points",
                hint="submit the array again: only what is missing is run",
            )  # fmt: skip
        publish(stores, table, study.header, study.kinds)
    return {**_conclude(study, directory, progress), "resumed": 0, "wall_s": 0.0}


def dry_run_summary(study: Study, out: Path) -> dict[str, Any]:
    """What :func:`sweep` would do in ``out``; nothing is run or written."""
    return {
        "scene": study.base.name,
        "points": study.plan.size,
        "failed": 0,
        "resumed": 0,
        "table": str(_table(study, out).absolute()),
        "runs": study.stages.runs,
    }


def write_array(study: Study, directory: Path, shards: int) -> dict[str, Any]:
    """Plan the sweep in ``directory`` and write the Slurm script that runs it in parts."""
    acquire(study, directory)
    shards, script = min(shards, study.plan.size), directory / SCRIPT
    text = _SLURM.format(points=study.plan.size, scene=study.base.name, shards=shards,
                         last=shards - 1, script=SCRIPT)  # fmt: skip
    script.write_text(text, encoding="utf-8")
    script.chmod(0o755)
    return {**dry_run_summary(study, directory), "script": str(script.absolute()),
            "files": [PLAN, SCRIPT]}  # fmt: skip


def planned(directory: Path) -> Study:
    """The study that ``directory`` holds the plan of.

    Raises
    ------
    UsageError : there is none, or this version would plan it differently.
    """
    request, digest = read_plan(directory)
    study = make_study(request)
    if study.digest != digest:
        raise UsageError("planned by another version of kc2spice", where=str(directory / PLAN),
                         hint="plan the sweep anew")  # fmt: skip
    return study


def acquire(study: Study, out: Path, purpose: object = None) -> None:
    """Make ``out`` the directory of this sweep, done for ``purpose``.

    Raises
    ------
    UsageError : it is already that of another one, or cannot be written.
    """
    own = study.digest if purpose is None else study.plan.digest([study.digest, purpose])
    if study.request.format == "parquet":
        need_parquet()
    if out.exists() and not out.is_dir():
        raise UsageError("is a file, not a directory", where=str(out), hint="choose another --out")
    if (out / PLAN).exists():
        _, digest = read_plan(out)
        if digest == own:
            return
        raise UsageError(
            "holds another sweep", where=str(out), got=f"plan {digest}",
            expected=f"plan {own}", hint="choose another --out, or remove the old one",
        )  # fmt: skip
    for name in (ROWS, _table(study, out).name):
        if (out / name).exists():
            raise UsageError("would be overwritten", where=str(out / name),
                             hint="choose another --out, or remove it")  # fmt: skip
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_plan(study, out, own)
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}", where=str(out)) from None


def _table(study: Study, out: Path) -> Path:
    return out / f"sweep.{study.request.format}"


def _filled(
    study: Study, path: Path, shard: Shard | None, engine: Engine, progress: Progress, retry: bool
) -> dict[str, Any]:
    """Run the points that the rows in ``path`` lack; what a summary says of them."""
    rows = RowStore(path, study.plan.size)
    try:
        rows.forget(INTERRUPTED, *([BAD] if retry else []))
        resumed = int((rows.state != MISSING).sum())
        spent = _fill(study, rows, engine, progress, shard)
        points = int((rows.state != MISSING).sum())
        return {"points": points, "failed": rows.failed, "resumed": resumed,
                "table": str(path.absolute()), **spent}  # fmt: skip
    finally:
        rows.close()


def _fill(
    study: Study, rows: RowStore, engine: Engine, progress: Progress, shard: Shard | None
) -> dict[str, float | None]:
    """Run the points that are missing; return ``wall_s`` and what it cost.

    A point that is interrupted by what happens to the machine is tried once more at the end.
    """
    start, spent = time.monotonic(), Cost()
    cpu_since_last()
    missing = int(sum(rows.state[index] == MISSING for index in _share(study, shard)))
    if not missing:
        return NO_TIME
    meter = _Meter(progress, missing, start)
    for attempt in (1, 2):
        with WorkerPool(engine) as pool:
            for call, result in pool.run(_calls(study, rows, _share(study, shard))):
                outcome = result
                if isinstance(result, WorkerDied):
                    outcome = Outcome(call.name, failure=DIED, interrupted=True)
                cells = outcome.values or (None,) * len(study.job.metrics)
                rows.record(
                    call.name, (*study.plan.values(call.name), *cells), outcome.failure,
                    interrupted=outcome.interrupted,
                )  # fmt: skip
                spent += outcome.cost
                meter.count(rows.failed)
        again = int((rows.state == INTERRUPTED).sum())
        if not again or attempt == 2:
            break
        progress("again", None, f"{again} points that were interrupted")
        rows.forget(INTERRUPTED)
    wall = time.monotonic() - start
    return {"wall_s": wall, **_cost(spent + Cost(own=cpu_since_last().own), engine.workers, wall)}


def _cost(spent: Cost, workers: int, wall: float) -> dict[str, float | None]:
    """``busy_share`` of the workers' time that any CPU was used, ``overhead`` over ngspice.

    ``overhead`` is the CPU of Python per CPU of ngspice; None where nothing was run, or where the
    system does not tell what child processes used.
    """
    available = workers * wall
    return {
        "ngspice_cpu_s": spent.simulator,
        "python_cpu_s": spent.own,
        "busy_share": (spent.own + spent.simulator) / available if available else None,
        "overhead": spent.own / spent.simulator if spent.simulator else None,
    }


def _share(study: Study, shard: Shard | None) -> Iterator[int]:
    """Points in the order in which they are run.

    First those that need models of their own, so that these are built side by side, then all that
    share finite elements one after the other.
    """
    slow = dict.fromkeys(study.plan.block(key) for key in study.stages.keys)
    order = study.plan.order(list(slow))
    if shard is None:
        first = dict.fromkeys(study.stages.first)
        return chain(first, (index for index in order if index not in first))
    start, end = (k * study.plan.size // shard.count for k in (shard.number, shard.number + 1))
    return islice(order, start, end)


def _calls(study: Study, rows: RowStore, points: Iterator[int]) -> Iterator[Call]:
    for index in points:
        if rows.state[index] == MISSING:
            yield Call(index, run_point, (study.job, task(study.plan, index)))


class _Meter:
    """Progress in points since ``start``, with rate and time left."""

    def __init__(self, progress: Progress, total: int, start: float) -> None:
        self._progress, self._total, self._done, self._start = progress, total, 0, start

    def count(self, failed: int) -> None:
        """One more point is recorded."""
        self._done += 1
        rate = self._done / max(time.monotonic() - self._start, 1e-9)
        minutes, seconds = divmod(round((self._total - self._done) / rate), 60)
        hours, minutes = divmod(minutes, 60)
        left = f"{hours} h {minutes} min" if hours else f"{minutes} min {seconds} s"
        text = f"{self._done} of {self._total} points, {failed} failed, {rate:.3g}/s, {left} left"
        self._progress("sweep", self._done / self._total, text)


def _conclude(study: Study, out: Path, progress: Progress) -> dict[str, Any]:
    """Summary of a finished table, with figures and page beside it."""
    from kc2spice.report.sweep_page import write_sweep, yields

    table = _table(study, out)
    progress("report", None, "figures and page")
    data = columns(table, study.kinds)
    failed = [text for text in data["status"] if text != "ok"]
    flags = [name for name in study.job.metrics if study.kinds[name] is bool]
    found = yields(data, flags) if study.plan.random else {}
    files = write_sweep(
        out, study.base, data, study.units, study.job.metrics, study.plan.random,
        study.describe(), found,
    )  # fmt: skip
    return {
        "scene": study.base.name,
        "points": study.plan.size,
        "failed": len(failed),
        "table": str(table.absolute()),
        "directory": str(out.absolute()),
        "runs": study.stages.runs,
        "yield": found,
        "files": [table.name, *files],
    }
