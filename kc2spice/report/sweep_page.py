"""``sweep.html``: plan, yields, spread of the metrics, what failed and why, figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from kc2spice.report.html import Section, write_page
from kc2spice.report.sweep_figures import share_text, sweep_figures
from kc2spice.report.words import fact
from kc2spice.scene.model import Scene

CONFIDENCE = 0.95


def yields(data: Mapping[str, np.ndarray], flags: Sequence[str]) -> dict[str, dict[str, float]]:
    """Share of all points at which each flag is true, with its exact confidence interval.

    A point that failed counts as false. The interval is that of Clopper and Pearson (1934), which
    covers at least ``confidence``; it speaks of the swept population only where keys were drawn.
    """
    found = {}
    for name in flags:
        count, total = int(np.nansum(data[name])), data[name].size
        interval = binomtest(count, total).proportion_ci(CONFIDENCE, method="exact")
        found[name] = {
            "share": count / total,
            "low": float(interval.low),
            "high": float(interval.high),
            "confidence": CONFIDENCE,
        }
    return found


def write_sweep(
    directory: Path,
    scene: Scene,
    data: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    metrics: Sequence[str],
    random: Sequence[str],
    plan: str,
    found: Mapping[str, Mapping[str, float]],
) -> list[str]:
    """Write figures and page of a finished table into ``directory``; return their names.

    ``units`` are those of the swept keys, in their order.
    """
    keys = tuple(units)
    pictures = sweep_figures(directory, data, keys, metrics, random, units)
    sections = [
        Section("Plan", [("points", plan), *(_swept(key, data[key], units) for key in keys)]),
        Section(
            "Yield",
            [(fact(name, 0)[0], share_text(share)) for name, share in found.items()],
            note="Of all points; a point that failed counts as a miss.",
        ),
        _spread(data, [name for name in metrics if name not in found]),
        _failed(data["status"]),
        Section("Figures", pictures=pictures),
    ]
    write_page(
        directory / "sweep.html", f"Sweep of {scene.name}", scene.title,
        [section for section in sections if section.rows or section.pictures],
    )  # fmt: skip
    return [*(picture.path.name for picture in pictures), "sweep.html"]


def _swept(key: str, values: np.ndarray, units: Mapping[str, str]) -> tuple[str, str]:
    distinct = np.unique(values)
    unit = units.get(key, "")
    low, high = (f"{v:g}" if distinct.dtype.kind == "f" else str(v) for v in distinct[[0, -1]])
    return key, f"{distinct.size} values, {low} … {high} {unit}".rstrip()


def _spread(data: Mapping[str, np.ndarray], metrics: Sequence[str]) -> Section:
    rows = []
    for name in metrics:
        values = data[name][np.isfinite(data[name])]
        if values.size:
            shares = np.quantile(values, (0.0, 0.05, 0.5, 0.95, 1.0))
            label = fact(name, 0)[0]
            rows.append((label, str(values.size), *(fact(name, float(v))[1] for v in shares)))
    head = ("metric", "points", "least", "5 %", "median", "95 %", "largest")
    return Section("Metrics", rows, head)


def _failed(status: np.ndarray) -> Section:
    counts = Counter(text for text in status.tolist() if text != "ok")
    rows = [(str(count), text) for text, count in counts.most_common(20)]
    return Section("Points that failed", rows, ("points", "why"))
