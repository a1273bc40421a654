"""Figures of a sweep, chosen from what was swept: curves, maps, histograms, a scatter matrix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.report.plots import (
    BLUE,
    GREY,
    ORANGE,
    PALETTE,
    Picture,
    legend_above,
    name_axes,
    sheet,
)
from kc2spice.report.words import fact, quantity, unit_of

_MOST_POINTS = 4000  # in one scatter plot; more only blacken it
_MOST_PANELS = 6  # rows or columns of a scatter matrix
_PREFIXED = ("m", "s", "A", "V", "N", "m/s", "Hz")
_PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M"}


@dataclass(frozen=True)
class Axis:
    """A column ready to draw: numbers in the unit that its label ends in."""

    label: str
    values: np.ndarray


def sweep_figures(
    directory: Path,
    data: Mapping[str, np.ndarray],
    keys: Sequence[str],
    metrics: Sequence[str],
    random: Sequence[str],
    units: Mapping[str, str],
) -> list[Picture]:
    """Draw the columns ``data`` (points,) of ``metrics`` over the swept ``keys``.

    One grid of numbers gives curves, two that are crossed give maps; anything drawn gives
    histograms and, like three keys or more, a scatter matrix. ``units`` are those of the keys.
    """
    numbers = [key for key in keys if data[key].dtype.kind == "f"]
    words = [key for key in keys if key not in numbers]
    shown = [name for name in metrics if np.isfinite(data[name]).any()]
    if not shown or not numbers:
        return []
    grid = [key for key in numbers if key not in random]
    pictures = []
    if random:
        pictures.append(_histograms(directory / "sweep_histograms.png", data, shown))
    elif len(numbers) == 1:
        pictures.append(_curves(directory / "sweep_curves.png", data, grid[0], words, shown, units))
    elif len(numbers) == 2 and not words and _crossed(data, grid):
        pictures += [_map(directory / f"sweep_map_{name}.png", data, grid, name, units)
                     for name in shown]  # fmt: skip
    if random or len(numbers) > 2 or (len(numbers) == 2 and not pictures):
        pictures.append(_scatter(directory / "sweep_scatter.png", data, numbers, shown, units))
    return pictures


def _crossed(data: Mapping[str, np.ndarray], keys: Sequence[str]) -> bool:
    first, second = (np.unique(data[key]) for key in keys)
    return first.size * second.size == data[keys[0]].size


def _axis(name: str, values: np.ndarray, unit: str) -> Axis:
    """Scale to the prefix of the largest value: 2.5e-3 m is drawn as 2.5 mm."""
    label = name.replace("_", " ")
    finite = np.abs(values[np.isfinite(values)])
    top = float(finite.max(initial=0.0))
    if unit not in _PREFIXED or top == 0.0:
        return Axis(f"{label} in {unit}" if unit else label, values)
    power = int(np.clip(3 * np.floor(np.log10(top) / 3), min(_PREFIXES), max(_PREFIXES)))
    return Axis(f"{label} in {_PREFIXES[power]}{unit}", values / 10.0**power)


def _metric(name: str, data: Mapping[str, np.ndarray]) -> Axis:
    label, unit = fact(name, 0)[0], unit_of(name)
    return _axis(label, data[name], unit)


def _panels(count: int) -> tuple[int, int, tuple[float, float]]:
    columns = min(3, count)
    rows = -(-count // columns)
    return rows, columns, (3.6 * columns, 2.7 * rows)


def _grid_of(path: Path, names: Sequence[str]) -> Any:
    rows, columns, size = _panels(len(names))
    return sheet(path, rows, columns, size=size, squeeze=False)


def _hide(axes: Any, used: int) -> None:
    for spare in axes.flat[used:]:
        spare.set_axis_off()


def _curves(
    path: Path, data: Mapping[str, np.ndarray], key: str, words: Sequence[str],
    metrics: Sequence[str], units: Mapping[str, str],
) -> Picture:  # fmt: skip
    x = _axis(key, data[key], units.get(key, ""))
    labels = np.array(["  ".join(row) for row in zip(*(data[w] for w in words), strict=True)]
                      if words else [""] * x.values.size)  # fmt: skip
    with _grid_of(path, metrics) as axes:
        for name, panel in zip(metrics, axes.flat, strict=False):
            y = _metric(name, data)
            for label, colour in zip(np.unique(labels), PALETTE * 10, strict=False):
                mine = np.flatnonzero(labels == label)
                mine = mine[np.argsort(x.values[mine])]
                style = "o-" if mine.size <= 40 else "-"
                panel.plot(x.values[mine], y.values[mine], style, color=colour, ms=3, label=label)
            name_axes(panel, x.label, y.label)
            if _logarithmic(x.values):
                panel.set_xscale("log")
        if words:
            legend_above(axes.flat[0])
        _hide(axes, len(metrics))
    return Picture(path, "Curves", f"Metrics over {key}; a gap is a point without that metric.")


def _logarithmic(values: np.ndarray) -> bool:
    """Equally spaced in the logarithm rather than in the values."""
    x = np.unique(values)
    if x.size < 3 or x[0] <= 0:
        return False
    return bool(np.ptp(np.diff(np.log(x))) < 1e-6 * np.log(x[-1] / x[0]))


def _map(
    path: Path, data: Mapping[str, np.ndarray], keys: Sequence[str], name: str,
    units: Mapping[str, str],
) -> Picture:  # fmt: skip
    x, y = (_axis(key, data[key], units.get(key, "")) for key in keys)
    z = _metric(name, data)
    columns, i = np.unique(x.values, return_inverse=True)
    rows, j = np.unique(y.values, return_inverse=True)
    field = np.full((rows.size, columns.size), np.nan)
    field[j, i] = z.values
    with sheet(path, size=(5.6, 4.0)) as axes:
        axes.set_facecolor("#D8D8D8")
        axes.grid(False)
        mesh = axes.pcolormesh(columns, rows, field, shading="nearest", cmap="viridis")
        for values, scale in ((columns, axes.set_xscale), (rows, axes.set_yscale)):
            if _logarithmic(values):
                scale("log")
        axes.figure.colorbar(mesh, ax=axes, label=z.label)
        name_axes(axes, x.label, y.label)
    return Picture(path, f"Map of {z.label}", f"{z.label}; grey where there is none.")


def _is_flag(values: np.ndarray) -> bool:
    return set(np.unique(values[np.isfinite(values)])) <= {0.0, 1.0}


def _histograms(path: Path, data: Mapping[str, np.ndarray], metrics: Sequence[str]) -> Picture:
    with _grid_of(path, metrics) as axes:
        for name, panel in zip(metrics, axes.flat, strict=False):
            values = _metric(name, data)
            found = values.values[np.isfinite(values.values)]
            name_axes(panel, values.label, "points")
            if _is_flag(found):
                panel.bar(("no", "yes"), [np.sum(found == flag) for flag in (0.0, 1.0)], 0.6,
                          color=BLUE, alpha=0.85)  # fmt: skip
                continue
            panel.hist(found, bins="auto" if found.size > 1 else 1, color=BLUE, alpha=0.85)
            for share in (0.05, 0.5, 0.95):
                panel.axvline(np.quantile(found, share), color=ORANGE, lw=1.2,
                              ls="-" if share == 0.5 else "--")  # fmt: skip
        _hide(axes, len(metrics))
    words = "Distribution of every metric; lines at the median and at 5 and 95 % of the points."
    return Picture(path, "Histograms", words)


def _scatter(
    path: Path, data: Mapping[str, np.ndarray], keys: Sequence[str], metrics: Sequence[str],
    units: Mapping[str, str],
) -> Picture:  # fmt: skip
    drawn = [name for name in metrics if not _is_flag(data[name])] or list(metrics)
    wide, high = keys[:_MOST_PANELS], drawn[:_MOST_PANELS]
    step = -(-data[keys[0]].size // _MOST_POINTS)
    size = (2.3 * len(wide) + 0.8, 1.7 * len(high) + 0.4)
    with sheet(path, len(high), len(wide), size=size, squeeze=False, sharex="col",
               sharey="row") as axes:  # fmt: skip
        for row, name in zip(axes, high, strict=True):
            y = _metric(name, data)
            for panel, key in zip(row, wide, strict=True):
                x = _axis(key, data[key], units.get(key, ""))
                panel.plot(x.values[::step], y.values[::step], ".", color=BLUE, ms=2.5, alpha=0.5)
                panel.axhline(np.nanmedian(y.values), color=GREY, lw=0.6)
                if name == high[-1]:
                    panel.set_xlabel(x.label, fontsize=8)
                    panel.ticklabel_format(axis="x", style="sci", scilimits=(-3, 5))
            row[0].set_ylabel(y.label, fontsize=8)
    left = len(keys) - len(wide) + len(drawn) - len(high)
    rest = f" {left} more are in the table." if left else ""
    return Picture(path, "Scatter matrix", f"Every metric over every swept key.{rest}")


def tuning_figure(
    path: Path, key: str, key_unit: str, values: np.ndarray, metric: str, rows: np.ndarray,
    best: Mapping[str, float],
) -> Picture:  # fmt: skip
    """``metric`` over one swept key, before and after; ``rows`` (2, n)."""
    label, unit = fact(metric, 0)[0], unit_of(metric)
    scaled = _axis(label, rows, unit)
    before, after = scaled.values
    order = np.argsort(values)
    words = ", ".join(f"{name.rpartition('.')[2]} = {value:g}" for name, value in best.items())
    with sheet(path, size=(6.0, 3.8)) as axes:
        axes.plot(values[order], before[order], "o-", color=GREY, ms=3, label="as the scene is")
        axes.plot(values[order], after[order], "o-", color=BLUE, ms=3, label="tuned")
        axes.set_ylim(bottom=0)
        name_axes(axes, f"{key} in {key_unit}" if key_unit else key, scaled.label)
        axes.set_title(f"tuned: {words}")
        axes.legend()
    return Picture(path, "Tuning", f"{label} before and after tuning.")


def share_text(found: Mapping[str, float]) -> str:
    """A yield with its confidence interval, in words."""
    low, high = (100 * found[end] for end in ("low", "high"))
    level = quantity(100 * found["confidence"], "", 3)
    return f"{100 * found['share']:.4g} % ({level} % confidence: {low:.4g} … {high:.4g} %)"
