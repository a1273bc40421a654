"""Writer of the page ``sweep.html``: metrics of all points of a sweep.

The figures depend on the swept keys. For one key, the figures are curves versus the key. For two
keys, if the sweep contains all combinations of values, the figures are maps. If keys have random
values, or if more than two keys are swept, each metric has a histogram and a plot versus each key.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from kc2spice.core.figure import ColourMap, Curve, Figure, Panel, format_axis_label
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.report.html import PageSection, format_value, label_key, write_page
from kc2spice.scene.scene_classes import Scene

CONFIDENCE_LEVEL = 0.95  # probability of the confidence intervals of yields
NUMBER_TYPES = (float, int, bool)  # types of the values in a column of numbers
# Metrics with a smaller relative difference, a rounding error of the simulator, count as equal.
EQUALITY_TOLERANCE = 1e-9
MAX_LISTED_VALUES = 10  # largest number of text values that the page lists for a swept key

Table = Mapping[str, Sequence[Any]]
Axis = tuple[str, np.ndarray]  # axis label with unit, and values along the axis


def _has_common_type(column: Sequence[Any], *kinds: type) -> bool:
    """Return whether all values except None have the same type, one of ``kinds``."""
    present = set(map(type, column)) - {type(None)}
    return len(present) == 1 and present <= set(kinds)


def _convert_to_numbers(column: Sequence[Any]) -> np.ndarray:
    """Convert a table column to an array of numbers; None becomes NaN."""
    return np.array(column, dtype=float)


def compute_yields(table: Table, keys: Sequence[str]) -> dict[str, dict[str, float]]:
    """Compute the yield of each metric whose values are only true or false.

    The yield is the share of the points at which the metric is true, with a confidence interval. At
    a point that failed, the metric counts as false. The interval is exact (Clopper and Pearson,
    1934): the probability that the interval contains the true share is at least
    :data:`CONFIDENCE_LEVEL`. The yield applies to the population of devices only if the values of
    the swept keys are random samples.
    """
    result = {}
    for name, column in table.items():
        if name not in keys and _has_common_type(column, bool):
            count, total = sum(map(bool, column)), len(column)
            interval = binomtest(count, total).proportion_ci(CONFIDENCE_LEVEL, method="exact")
            ends = {"low": float(interval.low), "high": float(interval.high)}
            result[name] = {"share": count / total, **ends, "confidence": CONFIDENCE_LEVEL}
    return result


def write_sweep(
    path: Path,
    scene: Scene,
    table: Table,
    units: Mapping[str, str],
    metric_units: Mapping[str, str],
    random: Sequence[str],
    plan: str,
    shares: Mapping[str, Mapping[str, float]],
) -> None:
    """Write the page of a sweep, with its table of results, to ``path``.

    ``units`` contains the units of the swept keys, and ``metric_units`` the units of the metrics.
    ``random`` contains the names of the keys with random values. ``plan`` is a text that states the
    number of points. ``shares`` is the result of :func:`compute_yields`.
    """
    metrics = []
    spread = []
    for name, column in table.items():
        if name not in units and _has_common_type(column, *NUMBER_TYPES):
            metrics.append(name)
            if not _has_common_type(column, bool):
                spread.append(_make_quantile_row(name, column, metric_units.get(name, "")))
    head = ("metric", "points", "least", "5 %", "median", "95 %", "largest")
    note = "Percentage of all points at which the metric is true. A failed point counts as false."
    plan_rows = [("points", plan), *(_make_key_row(key, table[key], units) for key in units)]
    figures = tuple(plot_sweep(table, units, metrics, metric_units, random))
    sections = [
        PageSection("Plan", plan_rows),
        PageSection("Yield", list(map(_make_yield_row, shares, shares.values())), note=note),
        PageSection("Metrics", spread, head),
        PageSection("Points that failed", _make_failure_rows(table["status"]), ("points", "why")),
        PageSection("Figures", figures=figures),
    ]
    write_page(path, f"Sweep of {scene.name}", scene.title, sections)


def _make_failure_rows(status: Sequence[str]) -> list[tuple[str, str]]:
    """Return table rows of the 20 most frequent reasons why sweep points failed."""
    counts = Counter(status)
    del counts["ok"]
    return [(str(count), reason) for reason, count in counts.most_common(20)]


def _make_yield_row(name: str, share: Mapping[str, float]) -> tuple[str, str]:
    """Return the table row of a yield: percentage of true values, confidence interval."""
    low, high, level = 100 * share["low"], 100 * share["high"], 100 * share["confidence"]
    interval = f"{level:.3g} % confidence: {low:.4g} … {high:.4g} %"
    return label_key(name), f"{100 * share['share']:.4g} % ({interval})"


def _make_key_row(key: str, column: Sequence[Any], units: Mapping[str, str]) -> tuple[str, str]:
    """Return the table row of a swept key: how many values, and their range or list."""
    distinct = list(dict(zip(map(repr, column), column, strict=True)).values())
    text = ", ".join(map(str, distinct[:MAX_LISTED_VALUES]))
    if _has_common_type(column, *NUMBER_TYPES):
        text = " … ".join(format_quantity(end(distinct), units[key]) for end in (min, max))
    return key, f"{len(distinct)} values, {text}"


def _make_quantile_row(name: str, column: Sequence[Any], unit: str) -> tuple[str, ...]:
    """Return the table row of a metric: extremes, median, and 5 % and 95 % quantiles.

    The row also contains the number of points at which the metric is finite.
    """
    values = _convert_to_numbers(column)
    values = values[np.isfinite(values)]
    quantiles = np.quantile(values, (0.0, 0.05, 0.5, 0.95, 1.0)).tolist()
    texts = (format_value(quantile, unit) for quantile in quantiles)
    return (label_key(name, unit), str(values.size), *texts)


def plot_sweep(
    table: Table,
    units: Mapping[str, str],
    metrics: Sequence[str],
    metric_units: Mapping[str, str],
    random: Sequence[str],
) -> Iterator[Figure]:
    """Plot the ``metrics`` in the table of a sweep versus the swept keys."""
    x: dict[str, Axis] = {}
    words: dict[str, Sequence[Any]] = {}
    crossed = 1
    for key, unit in units.items():
        if _has_common_type(table[key], *NUMBER_TYPES):
            values = _convert_to_numbers(table[key])
            x[key] = format_axis_label(key.replace("_", " "), unit), values
            crossed *= np.unique(values).size
        else:
            words[key] = table[key]
    if not x or not metrics:
        return
    y: dict[str, Axis] = {}
    for name in metrics:
        unit = metric_units.get(name, "")
        label = format_axis_label(label_key(name, unit).replace("_", " "), unit)
        y[name] = label, _convert_to_numbers(table[name])
    if not random and len(x) == 1:
        labels = [" ".join(map(str, row)) for row in zip(*words.values(), strict=True)]
        (axis_x,) = x.values()
        panels = [_plot_curves(axis_x, labels, axis) for axis in y.values()]
        yield Figure(
            "curves", "Curves", "A gap is a point at which the metric has no value.", tuple(panels)
        )
    elif not random and len(x) == len(units) == 2 and crossed == len(table["status"]):
        axis_x, axis_y = x.values()
        for name, axis in y.items():
            panel = _plot_map(axis_x, axis_y, axis)
            title = axis[0].partition(" in ")[0]
            yield Figure(f"map_{name}", title, "Grey: the metric has no value.", (panel,))
    else:
        caption = "Lines: median, and 5th and 95th percentiles of the points."
        histograms = tuple(map(_plot_histogram, y.values()))
        yield Figure("histograms", "Distributions", caption, histograms, columns=3)
        for name, (label, values) in y.items():
            panels = [Panel(k, label, (Curve("", v, values, "o"),)) for k, v in x.values()]
            yield Figure(
                f"over_{name}", label, "Metric versus each swept key.", tuple(panels), columns=3
            )


def _plot_curves(x: Axis, words: Sequence[str], y: Axis) -> Panel:
    """Return a panel with one curve for each distinct label in ``words``."""
    labels = np.array(words) if words else np.full(x[1].size, "")
    curves = []
    for label in np.unique(labels):
        indices = np.flatnonzero(labels == label)
        indices = indices[np.argsort(x[1][indices])]
        curves.append(Curve(str(label), x[1][indices], y[1][indices], "o-"))
    ends = (float(x[1].min()), float(x[1].max()))
    return Panel(x[0], y[0], tuple(curves), span=ends, log_x=_is_logarithmic(np.unique(x[1])))


def _is_logarithmic(x: np.ndarray) -> bool:
    """Return whether increasing values ``x`` have logarithmically equal spacing."""
    even = x.size > 2 and x[0] > 0 and np.ptp(np.diff(np.log(x))) < 1e-6 * np.log(x[-1] / x[0])
    return bool(even)


def _plot_map(x: Axis, y: Axis, z: Axis) -> Panel:
    """Return a panel with a colour map of a metric ``z`` versus keys ``x`` and ``y``."""
    columns, i = np.unique(x[1], return_inverse=True)
    rows, j = np.unique(y[1], return_inverse=True)
    field = np.full((rows.size, columns.size), np.nan)
    field[j, i] = z[1]
    log_x, log_y = _is_logarithmic(columns), _is_logarithmic(rows)
    return Panel(
        x[0], y[0], (), log_x=log_x, log_y=log_y, map=ColourMap(columns, rows, field, z[0])
    )


def _plot_histogram(axis: Axis) -> Panel:
    """Return a panel with the histogram, the median and two quantiles of a metric."""
    values = axis[1][np.isfinite(axis[1])]
    spread = np.ptp(values) > EQUALITY_TOLERANCE * np.abs(values).max()
    counts, edges = np.histogram(values, bins="auto" if spread else 1)
    bars = Curve("", (edges[:-1] + edges[1:]) / 2, counts.astype(float), "bar")
    low, middle, high = np.quantile(values, (0.05, 0.5, 0.95)).tolist()
    marks = ((low, "5 %"), (middle, "median"), (high, "95 %"))
    return Panel(axis[0], "points", (bars,), marks=marks)
