"""The plane of a scene's settings: ``bench.html`` with its figure ``bench.png``."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kc2spice.report.html import Section, write_page
from kc2spice.report.plots import BLACK, BLUE, GREEN, GREY, ORANGE, RED, Picture, name_axes, sheet
from kc2spice.report.words import quantity

HEAD = ("setting", "error", "sum of errors", "CPU time", "spread", "")
_LEAST = 1e-16  # an error of zero is drawn here


def write_bench(directory: Path, title: str, record: Mapping[str, Any]) -> None:
    """Write page and figure of the ``record`` of ``bench``."""
    picture = _figure(directory / "bench.png", record)
    sections = [
        Section("Recommended", recommendation(record)),
        Section("Error against time", pictures=[picture]),
        Section(
            "Settings",
            point_rows(record),
            HEAD,
        ),
    ]
    if record["failed"]:
        rows = [(each["label"], each["why"]) for each in record["failed"]]
        sections.append(Section("Settings without a result", rows, ("setting", "why")))
    lead = f"{record['simulator']}; CPU time of the simulator, median of {record['repeats']}"
    write_page(directory / "bench.html", f"Settings of {title}", lead, sections)


def recommendation(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What to use, what the scene uses, and what errors are against."""
    own = next(point for point in record["points"] if point["own"])
    best, reference = record["recommended"], record["reference"]
    rows = [("error of", _names(record["metrics"])), ("the scene as it is", _cost(own))]
    rows.append(("", _place(record["own"], own)))
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


def point_rows(record: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """One row for each setting, the quickest first."""
    return [
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


def _place(nearest: Mapping[str, Any], own: Mapping[str, Any]) -> str:
    """Whether the scene as it is lies on the front of its settings."""
    if nearest["on_front"]:
        return "on the front of its settings"
    return (
        f"beaten by {nearest['nearest']}: sum of errors {nearest['error']:.1e} in "
        f"{nearest['time_s'] / own['time_s']:.2f} of the time"
    )


def _figure(path: Path, record: Mapping[str, Any]) -> Picture:
    points, best = record["points"], record["recommended"]

    def place(chosen: list[Mapping[str, Any]]) -> tuple[list[float], list[float]]:
        return [max(p["error"], _LEAST) for p in chosen], [p["time_s"] for p in chosen]

    front = sorted((p for p in points if p["front"]), key=lambda p: p["error"])
    with sheet(path, size=(8.0, 4.6)) as axes:
        axes.plot(*place(points), "o", color=BLUE, ms=5, label="settings")
        axes.step(*place(front), where="post", color=GREY, lw=1.0, ls="--", label="front", zorder=1)
        own = [p for p in points if p["own"]]
        axes.plot(*place(own), "s", color=ORANGE, ms=9, label="the scene as it is")
        if best is not None:
            axes.plot(*place([best]), "o", color=BLACK, ms=12, mfc="none", label="recommended")
        limit = max(record["limit"], _LEAST)
        axes.axvline(limit, color=GREEN, lw=1.0, label=f"error {limit:.2g}")
        if record["reference"]["error"] > 0.0:
            axes.axvspan(
                _LEAST, record["reference"]["error"], color=RED, alpha=0.07, lw=0,
                label="uncertainty of the reference",
            )  # fmt: skip
        axes.set_xscale("log")
        axes.set_yscale("log")
        errors = place(points)[0]
        axes.set_xlim(0.5 * min(*errors, limit), 2.0 * max(*errors, limit))
        name_axes(axes, "largest relative error", "CPU time of the simulator [s]")
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
    return Picture(path, "Error against time", "Lower left is better.")
