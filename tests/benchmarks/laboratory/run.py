"""``bench``: run the parts that were asked for, write one record, tables, plots and a page."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any

from kc2spice.core.errors import UsageError
from kc2spice.core.files import staged
from kc2spice.core.progress import Clock, Progress, silent
from kc2spice.workflow.results import plain, write_record
from laboratory.figures import bench_figures
from laboratory.machine import machine
from laboratory.page import bench_tables
from laboratory.points import Outcome, Plane, Ratio, pareto
from laboratory.setup import Setup

# Each part is the function of its own name in the module of that name. What a user waits for comes
# first: many a machine slows down under the minutes of load that the others are.
PARTS = ("start", "loop", "impact", "imprint", "harmonic", "em", "dense")


def bench(
    out: Path,
    parts: Sequence[str] = (),
    *,
    quick: bool = False,
    full_sweep: bool = False,
    repeats: int = 5,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Measure ``parts`` (all by default) and write ``bench.json``, ``bench.md`` and plots into
    ``out``; return the record.

    ``quick`` takes coarse models and few points: the record has the same shape, its numbers mean
    nothing. ``full_sweep`` runs what is otherwise timed on a sample or left out for its length.

    Raises
    ------
    UsageError : an unknown part.
    MissingToolError : no ngspice.
    """
    for part in parts:
        if part not in PARTS:
            raise UsageError("no such part", where="--part", got=part, expected=", ".join(PARTS))
    wanted = [part for part in PARTS if part in parts or not parts]
    record: dict[str, Any] = {
        "machine": machine(), "quick": quick, "full_sweep": full_sweep, "repeats": repeats,
        "planes": {}, "titles": {}, "ratios": {}, "seconds": {},
    }  # fmt: skip
    with staged(out) as directory, tempfile.TemporaryDirectory(prefix="kc2spice-bench-") as work:
        setup = Setup(quick, full_sweep, repeats, Path(work), Clock(progress))
        for part in wanted:
            progress(part, None, "begins")
            begin = time.perf_counter()
            _enter(record, _measure(part)(setup))
            record["seconds"][part] = time.perf_counter() - begin
        record = plain(record)
        write_record(record, directory, "bench.json")
        (directory / "bench.md").write_text(bench_tables(record), encoding="utf-8")
        bench_figures(directory, record)
    return record


def _measure(part: str) -> Callable[[Setup], Outcome]:
    """Imported when it is run: each part needs libraries that the others do not."""
    found: Callable[[Setup], Outcome] = getattr(import_module(f"laboratory.{part}"), part)
    return found


def _enter(record: dict[str, Any], outcome: Outcome) -> None:
    for plane in outcome.planes:
        record["planes"][plane.name] = _points(plane)
        record["titles"][plane.name] = {
            "title": plane.title, "error": plane.error_name, "time": plane.time_name,
            "notes": list(plane.notes),
        }  # fmt: skip
    record["ratios"] |= {ratio.name: _ratio(ratio) for ratio in outcome.ratios}


def _points(plane: Plane) -> list[dict[str, Any]]:
    # The lower bound solves this loop and nothing else: it is no choice, only a bound.
    open_to_choice = [point for point in plane.points if point.family != "lower bound"]
    best_labels = {
        p.label for p, best in zip(open_to_choice, pareto(open_to_choice), strict=True) if best
    }
    return [
        {
            "label": point.label, "family": point.family, "error": point.error,
            "time_s": point.time.median, "time_low_s": point.time.low,
            "time_high_s": point.time.high, "repeats": point.time.repeats,
            "errors": point.errors, "facts": point.facts, "note": point.note,
            "same_model": point.same_model, "pareto": point.label in best_labels,
        }
        for point in plane.points
    ]  # fmt: skip


def _ratio(ratio: Ratio) -> Mapping[str, Any]:
    return {**asdict(ratio), "met": ratio.met}
