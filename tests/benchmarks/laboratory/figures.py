"""Figures of the benchmark: time over error for each plane, and how time grows with size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.report.plots import (
    BLACK,
    BLUE,
    GREY,
    PALETTE,
    RED,
    legend_beside,
    name_axes,
    sheet,
)

_MARKS = ("o", "s", "^", "D", "v", "P", "X")
_LEAST = 1e-16  # an error of zero is drawn here


@dataclass(frozen=True)
class Picture:
    """A figure on disk with the words that go with it."""

    path: Path
    title: str
    caption: str


def bench_figures(directory: Path, record: Mapping[str, Any]) -> list[Picture]:
    """One figure for each plane, and one for all scalings, one for the poles."""
    pictures = [
        _plane(directory, name, points, record["titles"][name])
        for name, points in record["planes"].items()
        if points
    ]
    if record["scaling"]:
        pictures.append(_scaling(directory, record["scaling"]))
    if record.get("poles"):
        poles = {
            name: np.array(part["real"]) + 1j * np.array(part["imag"])
            for name, part in record["poles"].items()
        }
        pictures.append(_poles(directory / "bench_poles.png", poles))
    return pictures


def _plane(
    directory: Path, name: str, points: list[Mapping[str, Any]], words: Mapping[str, Any]
) -> Picture:
    path = directory / f"bench_{name}.png"
    families = list(dict.fromkeys(point["family"] for point in points))
    with sheet(path, size=(9.5, 4.6)) as axes:
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
        name_axes(axes, words["error"], words["time"], words["title"])
        legend_beside(axes)
    caption = "Lower left is better; circled points are beaten by none in both, the bound aside."
    return Picture(path, words["title"], caption)


def _scaling(directory: Path, scaling: Mapping[str, Mapping[str, Any]]) -> Picture:
    path = directory / "bench_scaling.png"
    with sheet(path, size=(8.0, 4.4)) as axes:
        for k, (name, item) in enumerate(scaling.items()):
            color, mark = PALETTE[k % len(PALETTE)], _MARKS[k % len(_MARKS)]
            label = f"{name}: power {item['exponent']:.2f}"
            axes.plot(item["sizes"], item["time_s"], color=color, marker=mark, label=label)
        axes.set_xscale("log")
        axes.set_yscale("log")
        name_axes(axes, "size", "CPU time [s]", "Time over size")
        legend_beside(axes)
    return Picture(path, "Time over size", "Powers are fitted to the larger half of the sizes.")


def _poles(path: Path, poles: Mapping[str, np.ndarray]) -> Picture:
    """Poles [1/s] of several projections side by side; the right half plane is shaded."""
    with sheet(path, 1, len(poles), size=(9.5, 3.6), sharey=True, squeeze=False) as axes:
        for (name, values), panel in zip(poles.items(), axes.flat, strict=True):
            unstable = values.real > 0.0
            panel.set_xscale("symlog", linthresh=1e3)
            panel.set_yscale("symlog", linthresh=1e5)
            panel.plot(values.real[~unstable], values.imag[~unstable], "o", ms=4, color=BLUE)
            panel.plot(values.real[unstable], values.imag[unstable], "X", ms=8, color=RED)
            bound = 3.0 * max(float(np.abs(values.real).max()), 1e4)
            panel.set_xlim(-bound, bound)
            panel.axvspan(0.0, bound, color=RED, alpha=0.08, lw=0)
            name_axes(panel, "real part in 1/s", "", f"{name}: {int(unstable.sum())} unstable")
            ticks = 10.0 ** np.arange(3, int(np.log10(bound)) + 1, 2)
            panel.set_xticks([*(-ticks[::-1]), 0.0, *ticks])
        axes.flat[0].set_ylabel("imaginary part in 1/s")
    return Picture(path, "Poles", "Poles of the reduced models; crosses grow without end.")
