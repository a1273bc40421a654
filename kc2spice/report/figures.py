"""Draws figures that are data: one sheet of panels each."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import MissingToolError
from kc2spice.core.figure import Figure, Panel
from kc2spice.report.plots import (
    BLACK,
    GREEN,
    GREY,
    PALETTE,
    legend_above,
    legend_beside,
    name_axes,
    open_sheet,
    plain_log,
    sheet,
    style,
)

MANY = 4  # labels above the axes; more stand beside them
_MARKS = ("o", "s", "^", "D", "v", "P")
_LINES = ("-", "--", ":", "reference", "step")


def require_matplotlib() -> None:
    """Before anything is computed.

    Raises
    ------
    MissingToolError : matplotlib is not installed.
    """
    if find_spec("matplotlib") is None:
        raise MissingToolError(
            "matplotlib is not installed",
            where="Python",
            expected="matplotlib, for PNG files",
            hint="pip install matplotlib, or leave out --png: report.html needs none",
        )


def draw_all(directory: Path, figures: Sequence[Figure]) -> list[str]:
    """Draw every figure into ``directory`` as ``NAME.png``; return the names of the files."""
    for figure in figures:
        _draw(directory / f"{figure.name}.png", figure)
    return [f"{figure.name}.png" for figure in figures]


def notebook_figure(figure: Figure) -> Any:
    """The matplotlib figure of ``figure``, which notebooks show by themselves."""
    rows, columns, size = _layout(figure)
    with style():
        sheet = open_sheet(size)
        _fill_all(sheet.subplots(rows, columns, sharex=columns == 1, squeeze=False), figure)
    return sheet


def _draw(path: Path, figure: Figure) -> None:
    rows, columns, size = _layout(figure)
    with sheet(path, rows, columns, size=size, sharex=columns == 1, squeeze=False) as axes:
        _fill_all(axes, figure)


def _layout(figure: Figure) -> tuple[int, int, tuple[float, float]]:
    """Rows, columns, and size in inches."""
    count, columns = len(figure.panels), figure.columns
    rows = -(-count // columns)
    if columns == 1:
        return rows, 1, (7.0, 4.0 if count == 1 else 2.6 * count)
    return rows, columns, (3.6 * columns, 2.7 * rows)


def _fill_all(axes: Any, figure: Figure) -> None:
    for each, panel in zip(axes.flat, figure.panels, strict=False):
        _fill(each, panel)
    for spare in axes.flat[len(figure.panels) :]:
        spare.set_axis_off()


def _fill(axes: Any, panel: Panel) -> None:
    for low, high, label in panel.bands:
        axes.axhspan(low, high, color=GREEN, alpha=0.15, lw=0, label=label or None)
    for value, label in panel.levels:
        axes.axhline(value, color=GREY, lw=0.9, ls=":", label=label or None)
    for place, label in panel.marks:
        axes.axvline(place, color=GREEN, lw=1.0, label=label or None)
    for k, curve in enumerate(panel.curves):
        colour = BLACK if curve.style == "reference" else PALETTE[k % len(PALETTE)]
        marks = {"marker": _MARKS[k % len(_MARKS)], "ms": 4}
        name = curve.label or None
        if curve.style == "bar":
            wide = 0.9 * float(np.diff(curve.x[:2])[0]) if len(curve.x) > 1 else 0.8
            axes.bar(curve.x, curve.y, wide, color=colour, label=name)
        elif curve.style == "step":
            axes.step(curve.x, curve.y, where="post", color=colour, label=name)
        elif curve.style in ("o", "o-"):
            line = "-" if curve.style == "o-" else "none"
            axes.plot(curve.x, curve.y, ls=line, color=colour, label=name, **marks)
        elif curve.style == "-" and k > 0:  # told apart in print
            axes.plot(
                curve.x,
                curve.y,
                color=colour,
                label=name,
                mfc="white",
                markevery=(0.03 * k, 0.15),
                **marks,
            )
        else:
            dashes: Any = (0, (1, 3)) if curve.style == "reference" else curve.style
            axes.plot(curve.x, curve.y, color=colour, ls=dashes, label=name)
    if panel.map is not None:
        shown = panel.map
        axes.set_facecolor("#D8D8D8")
        axes.grid(False)
        mesh = axes.pcolormesh(shown.x, shown.y, shown.z, shading="nearest", cmap="viridis")
        axes.figure.colorbar(mesh, ax=axes, label=shown.label)
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
    elif panel.map is None and panel.curves and panel.curves[0].style in _LINES:
        axes.set_xlim(panel.curves[0].x[0], panel.curves[0].x[-1])
    name_axes(axes, panel.x, panel.y)
    labels = len(axes.get_legend_handles_labels()[1])
    if labels > MANY:
        legend_beside(axes)
    elif labels > 1:
        legend_above(axes)
