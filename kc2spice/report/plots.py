"""The one place that draws: style, sheets of axes, files. Figures elsewhere only fill axes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

# Okabe and Ito, "Color Universal Design" (2008): told apart with every colour vision.
BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
SKY, PURPLE, BLACK, GREY = "#56B4E9", "#CC79A7", "#222222", "#8A8A8A"
PALETTE = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK)

_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.6,
    "lines.solid_capstyle": "round",
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "xtick.labelcolor": BLACK,
    "ytick.labelcolor": BLACK,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "axes.formatter.useoffset": False,
    "figure.dpi": 150,
    "savefig.dpi": "figure",
}


def style() -> Any:
    """Context in which figures have the look of this project."""
    import matplotlib

    return matplotlib.rc_context(_STYLE)


@contextmanager
def sheet(
    path: Path | BytesIO,
    rows: int = 1,
    columns: int = 1,
    size: tuple[float, float] = (7.0, 4.0),
    **options: Any,
) -> Iterator[Any]:
    """Axes to fill, one or an array as in ``Figure.subplots``; written as PNG to ``path`` after.

    ``size`` is in inches at 150 dots per inch. ``options`` go to ``Figure.subplots``.
    """
    from matplotlib.figure import Figure as Sheet
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with style():
        layout = ConstrainedLayoutEngine()
        figure = Sheet(figsize=size, layout=layout)
        axes = figure.subplots(rows, columns, **options)
        yield axes
        # The layout once, here: left to savefig, it would cost another drawing of everything.
        layout.execute(figure)
        figure.set_layout_engine("none")
        figure.savefig(
            path,
            format="png",
            metadata={"Software": "kc2spice"},
            pil_kwargs={"compress_level": 2},  # the default takes longer than all the drawing
        )


def open_sheet(size: tuple[float, float]) -> Any:
    """An empty figure of ``size`` in inches that shows itself in a notebook."""
    from matplotlib.figure import Figure as Sheet

    class Shown(Sheet):
        """A figure that is its own picture."""

        def _repr_png_(self) -> bytes:
            stream = BytesIO()
            self.savefig(stream, format="png")
            return stream.getvalue()

    return Shown(figsize=size, layout="constrained")


def name_axes(axes: Any, x: str, y: str, title: str = "") -> None:
    """Label both axes, units included."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if title:
        axes.set_title(title)


def plain_log(axis: Any) -> None:
    """Plain numbers at 1, 2, 5, … of a logarithmic axis, or at decades where there are many: small
    ticks and powers of ten take longer than all the rest of a sheet."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    low, high = axis.get_data_interval()
    few = low > 0 and high < 1e3 * low
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def legend_beside(axes: Any, title: str = "") -> None:
    """Legend to the right of the axes, where it covers no data."""
    axes.legend(
        loc="upper left",
        bbox_to_anchor=(1.01, 1.0),
        borderaxespad=0.0,
        title=title or None,
        alignment="left",
    )


def legend_above(axes: Any, columns: int = 4) -> None:
    """Legend in one line above the axes."""
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns,
        borderaxespad=0.2,
        handlelength=1.6,
        columnspacing=1.4,
    )
