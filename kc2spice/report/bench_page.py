"""The plane of a scene's settings: ``bench.html``."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel
from kc2spice.report.html import Section, write_page
from kc2spice.report.words import quantity

_LEAST = 1e-16  # an error of zero is drawn here


def write_bench(directory: Path, title: str, record: Mapping[str, Any]) -> None:
    """Write the page of the ``record`` of ``bench``."""
    sections = [
        Section("Error against time", figures=[_figure(record)]),
        *bench_sections(record),
    ]
    lead = f"{record['simulator']}; CPU time of the simulator, median of {record['repeats']}"
    write_page(directory / "bench.html", f"Settings of {title}", lead, sections)


def bench_sections(record: Mapping[str, Any]) -> list[Section]:
    """What ``bench`` found, for the page and for the terminal: settings the quickest first."""
    points = [
        (
            point["label"],
            f"{point['error']:.1e}",
            f"{point['bound']:.1e}",
            quantity(point["time_s"], "s", 3),
            f"{quantity(point['time_low_s'], 's', 3)} … {quantity(point['time_high_s'], 's', 3)}",
            "front" if point["front"] else "",
        )
        for point in record["points"]
    ]
    failed = [(each["label"], each["why"]) for each in record["failed"]]
    head = ("setting", "error", "sum of errors", "CPU time", "spread", "")
    return [
        Section("Recommended", recommendation(record)),
        Section("Settings", points, head),
        Section("Settings without a result", failed, ("setting", "why")),
    ]


def recommendation(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What to use, what the scene uses, and what errors are against."""
    own = next(point for point in record["points"] if point["own"])
    best, reference = record["recommended"], record["reference"]
    rows = [("error of", _names(record["metrics"])), ("the scene as it is", _cost(own))]
    if best is None:
        nearest = min(record["points"], key=lambda p: max(p["error"], p["bound"]))
        rows.append((f"within {record['limit']:g}", "none of the settings"))
        rows.append(("nearest", f"{nearest['label']}: {_cost(nearest)}"))
    else:
        words = " ".join(map(shlex.quote, best["set"])) or "the scene as it is"
        rows.append((f"cheapest within {record['limit']:.2g}", words))
        rows.append(("", _cost(best)))
    rows.append(("reference", f"{reference['label']}: {quantity(reference['time_s'], 's', 3)}"))
    rows.append(("uncertainty of the reference", f"{reference['error']:.1e}"))
    for name, change in record["left_out"].items():
        why = "no value" if change is None else f"changes by {change:.1e} at the finest settings"
        rows.append(("left out", f"{name}: {why}"))
    return rows


def _names(metrics: Sequence[str]) -> str:
    """Names in one line, those of one group by the group."""
    groups: dict[str, int] = {}
    for name in metrics:
        first = name.partition(".")[0]
        groups[first] = groups.get(first, 0) + 1
    return ", ".join(n if count == 1 else f"{n} ({count} curves)" for n, count in groups.items())


def _cost(point: Mapping[str, Any]) -> str:
    bound = f"{point['bound']:.1e} if nothing cancelled"
    return f"error {point['error']:.1e} ({bound}) in {quantity(point['time_s'], 's', 3)} of CPU"


def _figure(record: Mapping[str, Any]) -> Figure:
    points, best = record["points"], record["recommended"]

    def curve(label: str, chosen: list[Mapping[str, Any]], style: str = "o") -> Curve:
        error = np.maximum([p["error"] for p in chosen], _LEAST)
        time = np.array([p["time_s"] for p in chosen])
        return Curve(label, error, time, style, tuple(p["label"] for p in chosen))

    front = sorted((p for p in points if p["front"]), key=lambda p: p["error"])
    curves = [curve("settings", points), curve("front", front, "step")]
    curves.append(curve("the scene as it is", [p for p in points if p["own"]]))
    if best is not None:
        curves.append(curve("recommended", [best]))
    limit, unsure = max(record["limit"], _LEAST), record["reference"]["error"]
    marks = [(limit, f"error {limit:.2g}")]
    if unsure > 0.0:
        marks.append((unsure, "uncertainty of the reference"))
    ends = [*curves[0].x, *(place for place, _ in marks)]
    panel = Panel(
        "largest relative error",
        "CPU time of the simulator in s",
        tuple(curves),
        marks=tuple(marks),
        span=(0.5 * min(ends), 2.0 * max(ends)),
        log_x=True,
        log_y=True,
    )
    return Figure("bench", "Error against time", "Lower left is better.", (panel,))
