"""Writer of the page ``bench.html`` of a benchmark.

The page contains errors and CPU times of a scene with different numerical settings.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.report.html import PageSection, write_page

SMALLEST_ERROR = 1e-16  # replaces an error of zero on the logarithmic axis


def write_bench(directory: Path, title: str, record: Mapping[str, Any]) -> None:
    """Write the page of a benchmark to the ``directory``.

    ``record`` contains the results of the benchmark.
    """
    sections = [
        PageSection("Error against time", figures=[plot_bench(record)]),
        *format_bench(record),
    ]
    lead = f"{record['simulator']}; CPU time of the simulator, median of {record['repeats']}"
    write_page(directory / "bench.html", f"Settings of {title}", lead, sections)


def format_bench(record: Mapping[str, Any]) -> list[PageSection]:
    """Return the results of ``kc2spice bench`` as sections for a page or the terminal.

    ``record`` contains the settings in ascending order of CPU time.
    """
    head = ("setting", "error", "sum of errors", "CPU time", "spread", "")
    failed = list(map(itemgetter("label", "why"), record["failed"]))
    return [
        PageSection("Recommended", format_recommendation(record)),
        PageSection("Settings", list(map(_make_setting_row, record["points"])), head),
        PageSection("Settings without a result", failed, ("setting", "why")),
    ]


def _make_setting_row(point: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the table row of one tried setting: errors and CPU times of its runs."""
    low, high = point["time_low_s"], point["time_high_s"]
    return (
        point["label"],
        f"{point['error']:.1e}",
        f"{point['bound']:.1e}",
        format_quantity(point["time_s"], "s", 3),
        f"{format_quantity(low, 's', 3)} … {format_quantity(high, 's', 3)}",
        "front" if point["front"] else "",
    )


def format_recommendation(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return table rows of the recommended, current and reference settings.

    The current settings are the settings of the scene.
    """
    current = next(filter(itemgetter("own"), record["points"]))
    best, reference = record["recommended"], record["reference"]
    rows = [
        ("error of", _list_metrics(record["metrics"])),
        ("unmodified scene", _format_error_and_cpu_time(current)),
    ]
    if best is None:
        nearest = min(record["points"], key=lambda p: max(p["error"], p["bound"]))
        rows.append((f"within {record['limit']:g}", "none of the settings"))
        rows.append(("nearest", f"{nearest['label']}: {_format_error_and_cpu_time(nearest)}"))
    else:
        words = " ".join(map(shlex.quote, best["set"])) or "no change: the unmodified scene"
        rows.append((f"cheapest within {record['limit']:.2g}", words))
        rows.append(("", _format_error_and_cpu_time(best)))
    rows.append(
        ("reference", f"{reference['label']}: {format_quantity(reference['time_s'], 's', 3)}")
    )
    rows.append(("uncertainty of the reference", f"{reference['error']:.1e}"))
    if (estimate := record["estimate"]) is not None:
        what = "error estimate of the unmodified scene"
        rows.append((what, f"{estimate['error']:.1e}, meshes and tables included"))
    for name, change in record["left_out"].items():
        why = "no value" if change is None else f"changes by {change:.1e} at the finest settings"
        rows.append(("left out", f"{name}: {why}"))
    return rows


def _list_metrics(metrics: Sequence[str]) -> str:
    """Return the names of metrics as one string.

    Several curves of one group are replaced by the name of the group and the number of curves.
    """
    groups = Counter(name.partition(".")[0] for name in metrics)
    return ", ".join(n if count == 1 else f"{n} ({count} curves)" for n, count in groups.items())


def _format_error_and_cpu_time(point: Mapping[str, Any]) -> str:
    """Format the error, error bound and CPU time of a setting as one string."""
    bound = f"{point['bound']:.1e} if nothing cancelled"
    return (
        f"error {point['error']:.1e} ({bound}) in {format_quantity(point['time_s'], 's', 3)} of CPU"
    )


def plot_bench(record: Mapping[str, Any]) -> Figure:
    """Plot the CPU time versus the error for all settings of a benchmark."""
    points, best = record["points"], record["recommended"]
    front = sorted(filter(itemgetter("front"), points), key=itemgetter("error"))
    curves = [
        _plot_time_versus_error("settings", points),
        _plot_time_versus_error("front", front, "step"),
        _plot_time_versus_error("unmodified scene", list(filter(itemgetter("own"), points))),
    ]
    if best is not None:
        curves.append(_plot_time_versus_error("recommended", [best]))
    limit, uncertainty = max(record["limit"], SMALLEST_ERROR), record["reference"]["error"]
    marks = [(limit, f"error {limit:.2g}")]
    if uncertainty > 0.0:
        marks.append((uncertainty, "uncertainty of the reference"))
    ends = [*curves[0].x, *map(itemgetter(0), marks)]
    look: Any = {"span": (0.5 * min(ends), 2.0 * max(ends)), "log_x": True, "log_y": True}
    labels = "largest relative error", "CPU time of the simulator in s"
    panel = Panel(*labels, tuple(curves), marks=tuple(marks), **look)
    return Figure("bench", "Error against time", "Lower left is better.", (panel,))


def _plot_time_versus_error(
    label: str, points: Sequence[Mapping[str, Any]], style: str = "o"
) -> Curve:
    """Return a curve of the CPU time versus the error for the settings in ``points``."""
    columns = map(itemgetter("error", "time_s", "label"), points)
    error, time, names = zip(*columns, strict=True) if points else ((), (), ())
    return Curve(label, np.maximum(error, SMALLEST_ERROR), np.array(time), style, names)
