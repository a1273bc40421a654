"""Drawing of figures with matplotlib, for PNG files and notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel

# Colours that people with any type of colour vision can distinguish.
# Source: Okabe and Ito, "Color Universal Design" (2008).
BLUE = "#0072B2"
ORANGE = "#E69F00"
GREEN = "#009E73"
RED = "#D55E00"
SKY = "#56B4E9"
PURPLE = "#CC79A7"
BLACK = "#222222"
GREY = "#8A8A8A"
PALETTE = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK)

LABELS_ABOVE = 4  # largest number of labels of a legend above the axes
_LEGEND_ABOVE_AXES: Any = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": LABELS_ABOVE}
_LEGEND_BESIDE_AXES: Any = {
    "loc": "upper left",
    "bbox_to_anchor": (1.01, 1.0),
    "borderaxespad": 0.0,
}
_MARKERS = ("o", "s", "^", "D", "v", "P")
_LINE_STYLES: dict[str, Any] = {
    "-": "-",
    "--": "--",
    ":": ":",
    "reference": (0, (1, 3)),
    "step": "-",
}
_PLOT_STYLE: Any = {
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E3E3E3",
    "legend.frameon": False,
    "axes.formatter.useoffset": False,
    "figure.dpi": 150,
}


def write_pngs(directory: Path, figures: Sequence[Figure]) -> list[str]:
    """Write each figure to a PNG file in the ``directory``; return the file names."""
    names = []
    for figure in figures:
        page = make_notebook_figure(figure)
        names.append(f"{figure.name}.png")
        # With a layout engine, savefig would draw the figure twice.
        page.get_layout_engine().execute(page)
        page.set_layout_engine("none")
        page.savefig(
            directory / names[-1],
            metadata={"Software": "kc2spice"},
            pil_kwargs={"compress_level": 2},  # fast compression of the PNG file
        )
    return names


def make_notebook_figure(figure: Figure) -> Any:
    """Convert ``figure`` to a matplotlib figure that notebooks display as PNG image."""
    import matplotlib
    from matplotlib.figure import Figure as MatplotlibFigure

    class NotebookFigure(MatplotlibFigure):
        """Matplotlib figure that notebooks display as a PNG image."""

        def _repr_png_(self) -> bytes:
            """Return the figure as PNG image, for display in a notebook."""
            stream = BytesIO()
            self.savefig(stream, format="png")
            return stream.getvalue()

    with matplotlib.rc_context(_PLOT_STYLE):
        count, columns = len(figure.panels), figure.columns
        rows = -(-count // columns)
        size = (3.6 * columns, 2.7 * rows) if columns > 1 else (7.0, max(2.6 * rows, 4.0))
        page = NotebookFigure(figsize=size, layout="constrained")
        axes = page.subplots(rows, columns, sharex=columns == 1, squeeze=False)
        for item, panel in zip(axes.flat, figure.panels, strict=False):
            _draw_panel(item, panel)
        for spare in axes.flat[count:]:
            spare.set_axis_off()
    return page


def _draw_panel(axes: Any, panel: Panel) -> None:
    """Draw a panel of a figure on matplotlib axes."""
    for low, high, label in panel.bands:
        axes.axhspan(low, high, color=GREEN, alpha=0.15, lw=0, label=label or None)
    for value, label in panel.levels:
        axes.axhline(value, color=GREY, lw=0.9, ls=":", label=label or None)
    for place, label in panel.marks:
        axes.axvline(place, color=GREEN, lw=1.0, label=label or None)
    for k, curve in enumerate(panel.curves):
        _draw_curve(axes, k, curve)
    if panel.map is not None:
        field = panel.map
        axes.set_facecolor("#D8D8D8")
        axes.grid(False)
        mesh = axes.pcolormesh(field.x, field.y, field.z, shading="nearest", cmap="viridis")
        axes.figure.colorbar(mesh, ax=axes, label=field.label)
    for axis, log in ((axes.xaxis, panel.log_x), (axes.yaxis, panel.log_y)):
        if log:
            _set_log_scale(axes, axis)
    if panel.equal:
        axes.set_aspect("equal", adjustable="datalim")
    elif panel.span is not None:
        axes.set_xlim(*panel.span)
    elif panel.map is None and panel.curves and panel.curves[0].style in _LINE_STYLES:
        axes.set_xlim(panel.curves[0].x.min(), panel.curves[0].x.max())
    axes.set(xlabel=panel.x, ylabel=panel.y)
    labels = axes.get_legend_handles_labels()[1]
    if len(labels) > 1:
        inches = axes.get_window_extent().width / axes.figure.dpi
        # true if the legend, including line samples, is wider than the axes
        long = sum(map(len, labels)) + 6 * len(labels) > 16 * inches
        axes.legend(
            **(_LEGEND_BESIDE_AXES if len(labels) > LABELS_ABOVE or long else _LEGEND_ABOVE_AXES)
        )


def _draw_curve(axes: Any, k: int, curve: Curve) -> None:
    """Draw the curve with index ``k`` of a panel.

    Solid lines have markers, except if the first curve of the panel is solid.
    """
    colour = BLACK if curve.style == "reference" else PALETTE[k % len(PALETTE)]
    look: dict[str, Any] = {"color": colour, "label": curve.label or None}
    marks = {"marker": _MARKERS[k % len(_MARKERS)], "ms": 4}
    if curve.style == "bar":
        wide = 0.9 * float(np.diff(curve.x[:2])[0]) if len(curve.x) > 1 else 0.8
        axes.bar(curve.x, curve.y, wide, **look)
        return
    if curve.style in ("o", "o-"):
        look |= marks | {"ls": "-" if curve.style == "o-" else "none"}
    elif curve.style == "-" and k > 0:
        look |= marks | {"mfc": "white", "markevery": (0.03 * k, 0.15)}
    else:
        look |= {"ls": _LINE_STYLES[curve.style]}
        look |= {"drawstyle": "steps-post"} if curve.style == "step" else {}
    axes.plot(curve.x, curve.y, **look)


def _set_log_scale(axes: Any, axis: Any) -> None:
    """Make an axis logarithmic, with ticks at 1, 2, 5, … or at powers of ten.

    The labels of the ticks are plain numbers, and there are no minor ticks. Drawing minor ticks and
    labels such as 10^3 would take longer than drawing all other elements of a figure.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.set(**{f"{axis.axis_name}scale": "log"})
    low, high = axis.get_data_interval()
    # with more decades, labels at 1, 2, 5 would overlap
    decades = 2 if axis.axis_name == "x" else 3
    narrow = low > 0 and high < 10**decades * low
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if narrow else (1.0,)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}" if x > 5e-3 else f"{x:.0e}"))
