"""``bench.html``: errors and times of a scene under different numerical settings."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel
from kc2spice.report.html import PageSection, format_quantity, write_page

_LEAST = 1e-16  # an error of zero is drawn here


def write_bench(directory: Path, title: str, record: Mapping[str, Any]) -> None:
    """Write the page of the ``record`` of ``bench``."""
    sections = [
        PageSection("Error against time", figures=[_figure(record)]),
        *bench_sections(record),
    ]
    lead = f"{record['simulator']}; CPU time of the simulator, median of {record['repeats']}"
    write_page(directory / "bench.html", f"Settings of {title}", lead, sections)


def bench_sections(record: Mapping[str, Any]) -> list[PageSection]:
    """Results of ``bench`` for the page and the terminal, the fastest settings first."""
    points = [
        (
            point["label"],
            f"{point['error']:.1e}",
            f"{point['bound']:.1e}",
            format_quantity(point["time_s"], "s", 3),
            " … ".join(format_quantity(point[f"time_{end}_s"], "s", 3) for end in ("low", "high")),
            "front" if point["front"] else "",
        )
        for point in record["points"]
    ]
    failed = [(item["label"], item["why"]) for item in record["failed"]]
    head = ("setting", "error", "sum of errors", "CPU time", "spread", "")
    return [
        PageSection("Recommended", recommendation(record)),
        PageSection("Settings", points, head),
        PageSection("Settings without a result", failed, ("setting", "why")),
    ]


def recommendation(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Recommended settings, settings of the scene, and the reference of the errors."""
    current = next(point for point in record["points"] if point["own"])
    best, reference = record["recommended"], record["reference"]
    rows = [("error of", _names(record["metrics"])), ("the scene as it is", _cost(current))]
    if best is None:
        nearest = min(record["points"], key=lambda p: max(p["error"], p["bound"]))
        rows.append((f"within {record['limit']:g}", "none of the settings"))
        rows.append(("nearest", f"{nearest['label']}: {_cost(nearest)}"))
    else:
        words = " ".join(map(shlex.quote, best["set"])) or "the scene as it is"
        rows.append((f"cheapest within {record['limit']:.2g}", words))
        rows.append(("", _cost(best)))
    rows.append(
        ("reference", f"{reference['label']}: {format_quantity(reference['time_s'], 's', 3)}")
    )
    rows.append(("uncertainty of the reference", f"{reference['error']:.1e}"))
    if (estimate := record["estimate"]) is not None:
        what = "error estimate of the scene as it is"
        rows.append((what, f"{estimate['error']:.1e}, meshes and tables included"))
    for name, change in record["left_out"].items():
        why = "no value" if change is None else f"changes by {change:.1e} at the finest settings"
        rows.append(("left out", f"{name}: {why}"))
    return rows


def _names(metrics: Sequence[str]) -> str:
    """Names in one line, those of one group by the group."""
    groups = Counter(name.partition(".")[0] for name in metrics)
    return ", ".join(n if count == 1 else f"{n} ({count} curves)" for n, count in groups.items())


def _cost(point: Mapping[str, Any]) -> str:
    bound = f"{point['bound']:.1e} if nothing cancelled"
    return (
        f"error {point['error']:.1e} ({bound}) in {format_quantity(point['time_s'], 's', 3)} of CPU"
    )


def _figure(record: Mapping[str, Any]) -> Figure:
    points, best = record["points"], record["recommended"]

    def curve(label: str, selected: list[Mapping[str, Any]], style: str = "o") -> Curve:
        error = np.maximum([p["error"] for p in selected], _LEAST)
        time = np.array([p["time_s"] for p in selected])
        return Curve(label, error, time, style, tuple(p["label"] for p in selected))

    front = sorted((p for p in points if p["front"]), key=lambda p: p["error"])
    curves = [curve("settings", points), curve("front", front, "step")]
    curves.append(curve("the scene as it is", [p for p in points if p["own"]]))
    curves += [curve("recommended", [best])] if best is not None else []
    limit, unsure = max(record["limit"], _LEAST), record["reference"]["error"]
    both = (limit, f"error {limit:.2g}"), (unsure, "uncertainty of the reference")
    marks = tuple(mark for mark in both if mark[0] > 0.0)
    ends = [*curves[0].x, *(place for place, _ in marks)]
    look: Any = {"span": (0.5 * min(ends), 2.0 * max(ends)), "log_x": True, "log_y": True}
    labels = "largest relative error", "CPU time of the simulator in s"
    panel = Panel(*labels, tuple(curves), marks=marks, **look)
    return Figure("bench", "Error against time", "Lower left is better.", (panel,))
