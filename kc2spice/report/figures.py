"""Draws figures that are data: one sheet of panels each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from kc2spice.core.figure import Figure, Panel
from kc2spice.report.plots import (
    BLACK,
    GREEN,
    GREY,
    PALETTE,
    Picture,
    legend_above,
    legend_beside,
    name_axes,
    open_sheet,
    plain_log,
    sheet,
    style,
)

MANY = 4  # labels above the axes; more stand beside them


def draw_all(directory: Path, figures: Sequence[Figure]) -> list[Picture]:
    """Draw every figure into ``directory``."""
    return [draw(directory, figure) for figure in figures]


def notebook_figure(figure: Figure) -> Any:
    """The matplotlib figure of ``figure``, which notebooks show by themselves."""
    count = len(figure.panels)
    with style():
        sheet = open_sheet((7.0, 4.0 if count == 1 else 2.6 * count))
        rows = sheet.subplots(count, 1, sharex=True, squeeze=False)
        for (axes,), panel in zip(rows, figure.panels, strict=True):
            _fill(axes, panel)
    return sheet


def draw(directory: Path, figure: Figure) -> Picture:
    """Draw one figure as ``NAME.png``."""
    path, count = directory / f"{figure.name}.png", len(figure.panels)
    height = 4.0 if count == 1 else 2.6 * count
    with sheet(path, count, 1, size=(7.0, height), sharex=True, squeeze=False) as rows:
        for (axes,), panel in zip(rows, figure.panels, strict=True):
            _fill(axes, panel)
    return Picture(path, figure.title, figure.caption)


def _fill(axes: Any, panel: Panel) -> None:
    for low, high, label in panel.bands:
        axes.axhspan(low, high, color=GREEN, alpha=0.15, lw=0, label=label or None)
    for value, label in panel.levels:
        axes.axhline(value, color=GREY, lw=0.9, ls=":", label=label or None)
    for place, label in panel.marks:
        axes.axvline(place, color=GREEN, lw=1.0, label=label or None)
    for k, curve in enumerate(panel.curves):
        colour = BLACK if curve.style == "reference" else PALETTE[k % len(PALETTE)]
        style: Any = (0, (1, 3)) if curve.style == "reference" else curve.style
        if curve.style == "o":
            axes.plot(curve.x, curve.y, "o", ms=4, color=colour, label=curve.label or None)
        else:
            axes.plot(curve.x, curve.y, color=colour, ls=style, label=curve.label or None)
    if panel.log_x:
        axes.set_xscale("log")
        plain_log(axes.xaxis)
    if panel.log_y:
        axes.set_yscale("log")
        plain_log(axes.yaxis)
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")
    elif panel.span is not None:
        axes.set_xlim(*panel.span)
    elif panel.curves:
        axes.set_xlim(panel.curves[0].x[0], panel.curves[0].x[-1])
    name_axes(axes, panel.x, panel.y)
    labels = len(axes.get_legend_handles_labels()[1])
    if labels > MANY:
        legend_beside(axes)
    elif labels > 1:
        legend_above(axes)
