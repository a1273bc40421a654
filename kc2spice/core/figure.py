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
    """Curve of ``x`` and ``y`` (n,) in the panel's units.

    A value that is not finite is a gap.

    ``style``: a line (``-``, ``--``, ``:``), ``reference`` (dotted, in black), ``step`` (constant
    up to the next point), ``bar`` (bars without gaps), ``o`` (points), ``o-`` (points and a line).
    ``names`` (n,) of the points are shown where the pointer is.
    """

    label: str
    x: np.ndarray
    y: np.ndarray
    style: str = "-"
    names: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Map(EqualByContent):
    """Colours ``z`` (rows, columns) at centres ``x`` (columns,) and ``y`` (rows,).

    The centres ascend. A value that is not finite is grey. ``label`` is the label of the colour
    bar.
    """

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    label: str


@dataclass(frozen=True)
class Panel:
    """One pair of axes with curves, lines, ranges and a map below them.

    ``levels`` are horizontal lines ``(value, label)``, ``bands`` shaded ranges ``(low, high,
    label)``, and ``marks`` vertical lines. ``span`` is the range of x. ``equal`` gives both axes
    one scale.

    ``x`` and ``y`` are labels of the form ``quantity in unit``.
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
    map: Map | None = None


@dataclass(frozen=True)
class Figure:
    """Panels above each other with one x axis, or in a grid of ``columns``.

    Panels in a grid have their own axes. ``name`` is the name of the file without suffix. ``main``
    marks the most important curve of a scene.
    """

    name: str
    title: str
    caption: str
    panels: tuple[Panel, ...]
    columns: int = 1
    main: bool = False


@dataclass(frozen=True)
class Shape:
    """Upright rectangle or circle (``round``) of a side view, in metres.

    ``layers`` equal slices are drawn; ``label`` stands beside it.
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
    """Return a mask (n,) of the points from ``first`` to ``last`` and one more on each side."""
    import numpy as np  # imported here, because modules that draw load this module first

    low, high = np.searchsorted(t, (first, last))
    inside = np.zeros(t.size, dtype=bool)
    inside[max(low - 1, 0) : high + 1] = True
    return inside


def scale_time_axis(t: np.ndarray) -> tuple[str, float]:
    """Return the label of an axis with times [s], and the factor to its unit.

    The unit is µs, and ms from 1 ms on.
    """
    return ("time in ms", 1e3) if t[-1] - t[0] >= 1e-3 else ("time in µs", 1e6)


def format_axis_label(name: str, unit: str) -> str:
    """Return the label ``quantity in unit``, or the quantity alone if it has no unit."""
    return f"{name} in {unit}" if unit else name


def scale_axis(name: str, x: np.ndarray) -> tuple[str, float]:
    """Return the label of the axis of a run's scale, and the factor to its unit.

    The scale is ``time``, ``frequency`` or a swept key, with values in SI.
    """
    if name == "time":
        return scale_time_axis(x)
    if name == "frequency":
        return ("frequency in kHz", 1e-3) if x[-1] > 5e3 else ("frequency in Hz", 1.0)
    return name, 1.0


@dataclass(frozen=True)
class FileWriter:
    """Additional output file of a run; ``write(path)`` writes the file."""

    name: str
    write: Callable[[Path], None]
