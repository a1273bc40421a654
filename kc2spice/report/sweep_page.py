"""``sweep.html``: metrics of all points of a sweep.

The figures follow what was swept: curves over one key, maps over two crossed keys. For random or
more keys they are a histogram of each metric, and its values over each key.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from kc2spice.core.figure import Curve, Figure, Map, Panel
from kc2spice.report.html import PageSection, fact, format_value, write_page
from kc2spice.scene.model import Scene

CONFIDENCE = 0.95
NUMBERS = float, int, bool

Table = Mapping[str, Sequence[Any]]
Axis = tuple[str, np.ndarray]  # label that ends in the unit, numbers in it


def _has(column: Sequence[Any], *kinds: type) -> bool:
    """Whether the values that are there are of one of these types, all of the same."""
    return {type(value) for value in column} - {type(None)} in [{kind} for kind in kinds]


def _numbers(column: Sequence[Any]) -> np.ndarray:
    return np.array([np.nan if value is None else value for value in column], dtype=float)


def yields(table: Table, keys: Sequence[str]) -> dict[str, dict[str, float]]:
    """Share of all points at which each flag is true, with its exact confidence interval.

    A point that failed counts as false. The interval is that of Clopper and Pearson (1934), which
    covers at least ``confidence``; it speaks of the swept population only where keys were drawn.
    """
    result = {}
    for name, column in table.items():
        if name not in keys and _has(column, bool):
            count, total = sum(map(bool, column)), len(column)
            interval = binomtest(count, total).proportion_ci(CONFIDENCE, method="exact")
            ends = {"low": float(interval.low), "high": float(interval.high)}
            result[name] = {"share": count / total, **ends, "confidence": CONFIDENCE}
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
    """Write the page of a finished ``table`` to ``path``.

    ``units`` are those of the swept keys, in their order, ``metric_units`` those of metrics that
    have one. ``random`` are the keys that were drawn, ``plan`` says how much was run, ``shares``
    are the :func:`yields`.
    """
    metrics = [n for n in table if n not in units and _has(table[n], *NUMBERS)]
    numbers = [name for name in metrics if not _has(table[name], bool)]
    spread = [_quantile_row(name, table[name], metric_units.get(name, "")) for name in numbers]
    head = ("metric", "points", "least", "5 %", "median", "95 %", "largest")
    failed = Counter(text for text in table["status"] if text != "ok").most_common(20)
    note = "Of all points; a point that failed counts as a miss."
    sections = [
        PageSection("Plan", [("points", plan), *(_swept(key, table[key], units) for key in units)]),
        PageSection("Yield", [(fact(n, 0)[0], _share(s)) for n, s in shares.items()], note=note),
        PageSection("Metrics", spread, head),
        PageSection("Points that failed", [(str(n), why) for why, n in failed], ("points", "why")),
        PageSection(
            "Figures", figures=tuple(sweep_figures(table, units, metrics, metric_units, random))
        ),
    ]
    write_page(path, f"Sweep of {scene.name}", scene.title, sections)


def _share(share: Mapping[str, float]) -> str:
    low, high, level = (100 * share[name] for name in ("low", "high", "confidence"))
    return f"{100 * share['share']:.4g} % ({level:.3g} % confidence: {low:.4g} … {high:.4g} %)"


def _swept(key: str, column: Sequence[Any], units: Mapping[str, str]) -> tuple[str, str]:
    distinct = list({repr(value): value for value in column}.values())
    ends = ", ".join(map(str, distinct[:10]))
    if _has(column, *NUMBERS):
        ends = f"{min(distinct):g} … {max(distinct):g} {units[key]}".rstrip()
    return key, f"{len(distinct)} values, {ends}"


def _quantile_row(name: str, column: Sequence[Any], unit: str) -> tuple[str, ...]:
    values = _numbers(column)
    values = values[np.isfinite(values)]
    shares = np.quantile(values, (0.0, 0.05, 0.5, 0.95, 1.0))
    texts = (format_value(float(v), unit) for v in shares)
    return (fact(name, 0, unit)[0], str(values.size), *texts)


def sweep_figures(
    table: Table,
    units: Mapping[str, str],
    metrics: Sequence[str],
    metric_units: Mapping[str, str],
    random: Sequence[str],
) -> Iterator[Figure]:
    """The ``metrics`` of a table over its swept keys, with the units of both."""
    keys = [key for key in units if _has(table[key], *NUMBERS)]
    if not keys or not metrics:
        return
    x = {key: (_label(key, units[key]), _numbers(table[key])) for key in keys}
    y = {}
    for name in metrics:
        unit = metric_units.get(name, "")
        y[name] = _label(fact(name, 0, unit)[0], unit), _numbers(table[name])
    crossed = np.prod([np.unique(x[key][1]).size for key in keys]) == len(table["status"])
    if not random and len(keys) == 1:
        words = zip(*(table[key] for key in units if key not in x), strict=True)
        labels = [" ".join(map(str, item)) for item in words]
        panels = [_curves(x[keys[0]], labels, axis) for axis in y.values()]
        yield Figure("curves", "Curves", "A gap is a point without that metric.", tuple(panels))
    elif not random and len(keys) == len(units) == 2 and crossed:
        for name, axis in y.items():
            panel = _map(x[keys[0]], x[keys[1]], axis)
            title = axis[0].partition(" in ")[0]
            yield Figure(f"map_{name}", title, "Grey where there is none.", (panel,))
    else:
        caption = "Lines at the median and at 5 and 95 % of the points."
        panels = list(map(_histogram, y.values()))
        yield Figure("histograms", "Distributions", caption, tuple(panels), columns=3)
        for name, (label, values) in y.items():
            panels = [Panel(k, label, (Curve("", v, values, "o"),)) for k, v in x.values()]
            yield Figure(f"over_{name}", label, "Over each key.", tuple(panels), columns=3)


def _label(name: str, unit: str) -> str:
    return f"{name.replace('_', ' ')} in {unit}" if unit else name.replace("_", " ")


def _curves(x: Axis, words: Sequence[str], y: Axis) -> Panel:
    """One curve for each combination of the swept words."""
    labels = np.array(words) if words else np.full(x[1].size, "")
    curves = []
    for label in np.unique(labels):
        mine = np.flatnonzero(labels == label)
        mine = mine[np.argsort(x[1][mine])]
        curves.append(Curve(str(label), x[1][mine], y[1][mine], "o-"))
    ends = (float(x[1].min()), float(x[1].max()))
    return Panel(x[0], y[0], tuple(curves), span=ends, log_x=_logarithmic(np.unique(x[1])))


def _logarithmic(x: np.ndarray) -> bool:
    """Ascending and equally spaced in the logarithm rather than in the values."""
    even = x.size > 2 and x[0] > 0 and np.ptp(np.diff(np.log(x))) < 1e-6 * np.log(x[-1] / x[0])
    return bool(even)


def _map(x: Axis, y: Axis, z: Axis) -> Panel:
    columns, i = np.unique(x[1], return_inverse=True)
    rows, j = np.unique(y[1], return_inverse=True)
    field = np.full((rows.size, columns.size), np.nan)
    field[j, i] = z[1]
    log_x, log_y = _logarithmic(columns), _logarithmic(rows)
    return Panel(x[0], y[0], (), log_x=log_x, log_y=log_y, map=Map(columns, rows, field, z[0]))


def _histogram(axis: Axis) -> Panel:
    values = axis[1][np.isfinite(axis[1])]
    counts, edges = np.histogram(values, bins="auto" if values.size > 1 else 1)
    bars = Curve("", (edges[:-1] + edges[1:]) / 2, counts.astype(float), "bar")
    low, middle, high = np.quantile(values, (0.05, 0.5, 0.95)).tolist()
    marks = ((low, "5 %"), (middle, "median"), (high, "95 %"))
    return Panel(axis[0], "points", (bars,), marks=marks)
