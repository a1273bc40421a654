"""Figures of the benchmark: time over error for each plane."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.report.figures import BESIDE, BLACK, GREY, PALETTE, sheet

_MARKS = ("o", "s", "^", "D", "v", "P", "X")
_LEAST = 1e-16  # an error of zero is drawn here


def bench_figures(directory: Path, record: Mapping[str, Any]) -> None:
    """One figure for each plane."""
    for name, points in record["planes"].items():
        if points:
            _plane(directory / f"bench_{name}.png", points, record["titles"][name])


def _plane(path: Path, points: list[Mapping[str, Any]], words: Mapping[str, Any]) -> None:
    """Lower left is better; circled points are beaten by none in both, the lower bound aside."""
    families = list(dict.fromkeys(point["family"] for point in points))
    with sheet(path, size=(9.5, 4.6)) as page:
        axes = page.subplots()
        front = sorted((p for p in points if p["pareto"]), key=lambda p: p["error"])
        axes.step(
            [max(p["error"], _LEAST) for p in front], [p["time_s"] for p in front], where="post",
            color=GREY, linewidth=1.0, linestyle="--", label="Pareto front", zorder=1,
        )  # fmt: skip
        for k, family in enumerate(families):
            own = [point for point in points if point["family"] == family]
            error = np.maximum([p["error"] for p in own], _LEAST)
            time = np.array([p["time_s"] for p in own])
            spread = [time - [p["time_low_s"] for p in own], [p["time_high_s"] for p in own] - time]
            style = {"color": PALETTE[k % len(PALETTE)], "marker": _MARKS[k // len(PALETTE) % 7]}
            axes.errorbar(
                error, time, yerr=np.abs(spread), linestyle="none", markersize=5.5,
                elinewidth=0.8, label=family, **style,
            )  # fmt: skip
        for point in front:
            axes.plot(
                max(point["error"], _LEAST), point["time_s"], "o", color=BLACK, fillstyle="none",
                markersize=10, markeredgewidth=0.9,
            )  # fmt: skip
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set(xlabel=words["error"], ylabel=words["time"], title=words["title"])
        axes.legend(**BESIDE)
