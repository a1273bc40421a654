"""Figures as data, independent of plotting libraries."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from kc2spice.core.equality import EqualByContent

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True, eq=False)
class Curve(EqualByContent):
    """Curve of a figure: points with coordinates ``x`` and ``y``.

    The coordinates are arrays of shape (n,) in the units of the panel's axes. A value that is not
    finite causes a gap in the curve.

    ``style``: a line (``-``, ``--``, ``:``), ``reference`` (dotted, in black), ``step`` (constant
    up to the next point), ``bar`` (bars without gaps), ``o`` (points), ``o-`` (points and a line).
    ``names`` are the n names of the points. The HTML page shows the name of the point under the
    mouse pointer.
    """

    label: str
    x: np.ndarray
    y: np.ndarray
    style: str = "-"
    names: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class ColourMap(EqualByContent):
    """Colour map of a figure: values ``z`` (rows, columns) over a grid of cells.

    The ascending coordinates ``x`` (columns,) and ``y`` (rows,) are the centres of the cells. A
    cell whose value is not finite is grey. ``label`` is the label of the colour bar.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    label: str


@dataclass(frozen=True)
class Panel:
    """Pair of axes of a figure, with curves, lines, shaded ranges and a colour map.

    The colour map is behind the curves. ``levels`` are horizontal lines ``(value, label)``,
    ``bands`` shaded ranges ``(low, high, label)``, and ``marks`` vertical lines ``(value, label)``.
    ``span`` is the range of the x axis. With ``equal``, both axes have the same scale.

    ``x`` and ``y`` are labels of the axes, of the form ``quantity in unit``.
    """

    x: str
    y: str
    curves: tuple[Curve, ...]
    levels: tuple[tuple[float, str], ...] = ()
    bands: tuple[tuple[float, float, str], ...] = ()
    marks: tuple[tuple[float, str], ...] = ()
    span: tuple[float, float] | None = None
    log_x: bool = False
    log_y: bool = False
    equal: bool = False
    map: ColourMap | None = None


@dataclass(frozen=True)
class Figure:
    """Figure as data: stacked panels with a common x axis, or panels in a grid.

    ``columns`` is the number of columns of the grid, in which each panel has a separate x axis.
    ``name`` is the name of the figure's file without suffix. ``main`` marks the most important
    figure of a scene.
    """

    name: str
    title: str
    caption: str
    panels: tuple[Panel, ...]
    columns: int = 1
    main: bool = False


@dataclass(frozen=True)
class Shape:
    """Shape in a side view of a scene: an upright rectangle or a circle.

    The shape is a circle if ``round`` is true. All lengths are in metres. The rectangle is drawn as
    ``layers`` equal slices. The text ``label`` is drawn beside the shape.
    """

    x: float
    y: float
    width: float
    height: float
    kind: Literal["ceramic", "metal", "magnet", "coil"] = "metal"
    label: str = ""
    layers: int = 1
    round: bool = False


def select_window(t: np.ndarray, first: float, last: float) -> np.ndarray:
    """Return a mask that selects the times from ``first`` to ``last``.

    The mask also selects the nearest time before ``first``, and the nearest time at or after
    ``last``. The boolean mask has the same shape (n,) as the times ``t``.
    """
    import numpy as np  # numpy is imported here, because few users of this module need numpy

    low, high = np.searchsorted(t, (first, last))
    inside = np.zeros(t.size, dtype=bool)
    inside[max(low - 1, 0) : high + 1] = True
    return inside


def choose_time_unit(t: np.ndarray) -> tuple[str, float]:
    """Choose the time unit of an axis; return its label and the factor from seconds.

    The unit is ms if the range of the times is at least 1 ms, otherwise µs.
    """
    return ("time in ms", 1e3) if t[-1] - t[0] >= 1e-3 else ("time in µs", 1e6)


def format_axis_label(name: str, unit: str) -> str:
    """Return the label ``quantity in unit``, or the quantity alone if it has no unit."""
    return f"{name} in {unit}" if unit else name


def get_axis_label_and_factor(name: str, x: np.ndarray) -> tuple[str, float]:
    """Return the label of an x axis, and the factor from SI units to its unit.

    ``name`` is ``time``, ``frequency`` or a swept key, and ``x`` are its values in SI units.
    """
    if name == "time":
        return choose_time_unit(x)
    if name == "frequency":
        return ("frequency in kHz", 1e-3) if x[-1] > 5e3 else ("frequency in Hz", 1.0)
    return name, 1.0


@dataclass(frozen=True)
class FileWriter:
    """Writer of one additional output file of a run: file name and write function.

    ``write(path)`` writes the file.
    """

    name: str
    write: Callable[[Path], None]
