"""Writer of the page ``report.html`` of a fit.

The page contains fitted keys, errors, and figures of impedances.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel, get_axis_label_and_factor
from kc2spice.report.html import PageSection, write_page


@dataclass(frozen=True, eq=False)
class PlottedCurve:
    """Plotted curve of a fit: measured admittance, and model before and after the fit.

    ``before`` contains the admittances of the model before the fit, ``after`` the fitted
    admittances.

    All admittances [S] are arrays of shape (n,) at the frequencies ``f`` (n,) [Hz].
    """

    name: str
    f: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray


def write_fit(path: Path, record: Mapping[str, Any], curves: Sequence[PlottedCurve]) -> None:
    """Write the page of a fit to ``path``.

    ``record`` contains the results of the fit, and ``curves`` the measured and fitted admittances.
    """
    sections = format_fit(record)
    for curve in curves:
        figures = plot_fit(curve.f, curve.measured, curve.before, curve.after)
        sections.append(PageSection(curve.name, figures=figures))
    export = "--set fit.toml writes a netlist with the fitted values"
    if record["models"]:
        export = "--set fit.toml --set box.toml writes a netlist with the fitted keys as parameters"
    lead = (
        f"Values for which the model of {record['part']} best matches the measurement "
        f"{Path(record['data']).name}. The command kc2spice export SCENE {export}."
    )
    write_page(path, f"{record['part']}, fitted", lead, sections)


def format_fit(record: Mapping[str, Any]) -> list[PageSection]:
    """Return the results of ``kc2spice fit`` as sections for a page or the terminal."""
    keys = tuple(record["parameters"])
    sections = [
        PageSection("Values", list(map(_make_value_row, keys, record["parameters"].values())),
                    ("key", "value", "standard error", "range", "bound")),
        PageSection("Fit", _format_quality(record)),
        PageSection("Resonances", list(map(_make_number_row, record["resonances"])),
                    ("measured in Hz", "at the scene's values", "fitted"),
                    note="peaks of the conductance, in ascending order of frequency"),
        PageSection("Starts", list(map(_make_number_row, record["starts"])),
                    (*keys, "half the sum of squares")),
        PageSection("Correlation", list(map(_make_correlation_row, keys, record["correlation"])),
                    ("", *keys)),
    ]  # fmt: skip
    if curves := record.get("curves"):
        titles = ("curve", "keys of the measurement", "use", "rms", "largest")
        sections.insert(2, PageSection("Error of |Z|", list(map(_make_curve_row, curves)), titles))
    return sections


def _make_curve_row(curve: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the table row of a curve: file, keys, fitted or predicted, and errors.

    The use of a curve is ``fitted`` or ``predicted``.
    """
    keys = ", ".join(f"{key} = {value}" for key, value in curve["set"].items())
    use = "predicted" if curve["predict"] else "fitted"
    return curve["data"], keys, use, f"{curve['rms']:.2%}", f"{curve['largest']:.2%}"


def _make_value_row(key: str, item: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the table row of a fitted key, with its value, standard error and range.

    If the fitted value has reached an end of its range, the column "bound" contains "met".
    """
    limits = f"{item['low']:g} to {item['high']:g}"
    bound = "met" if item["at_bound"] else ""
    return key, f"{item['value']:.6g}", f"{item['sigma']:.2g}", limits, bound


def _make_number_row(numbers: Mapping[str, float | None]) -> tuple[str, ...]:
    """Return a table row of numbers, with empty cells for missing numbers."""
    return tuple("" if value is None else f"{value:.6g}" for value in numbers.values())


def _make_correlation_row(key: str, coefficients: Sequence[float]) -> tuple[str, ...]:
    """Return the table row with the correlations of a fitted key."""
    return key, *map("{:+.3f}".format, coefficients)


def _format_quality(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return table rows that describe the quality of a fit.

    The rows contain the deviation of the impedance, statistics, warnings, and combinations of keys
    that the data do not determine.
    """
    error = record["error"]
    facts = [
        *(("data", text) for text in record["read"]),
        ("deviation of |Z|", f"{error['rms']:.2g} rms, {error['largest']:.2g} at most"),
        ("noise of the data", f"{record['noise']:.2g}"),
        ("misfit, in units of the noise", f"{record['misfit']:.2g}"),
        *([("finite element models", str(record["models"]))] if record["models"] else []),
        ("starts that ended in another minimum", str(record["other_minima"])),
    ]
    if record["caution"]:
        facts.append(("warning", record["caution"]))
    for item in record["undetermined"]:
        text = ", ".join(f"{weight:+.2f} log {key}" for key, weight in item.items())
        facts.append(("not determined by the data", text))
    return facts


def plot_fit(
    f: np.ndarray, Y: np.ndarray, before: np.ndarray, after: np.ndarray
) -> tuple[Figure, ...]:
    """Plot the impedances of a fit: measured, initial and fitted.

    The panels show magnitude and phase of the three impedances, and the deviation of the fitted
    impedance. ``Y``, ``before`` and ``after`` are the measured, initial and fitted admittances [S].
    """
    x, factor = get_axis_label_and_factor("frequency", f)
    f = factor * f
    three = {"measured": (Y, "o"), "scene": (before, "--"), "fitted": (after, "-")}

    def plot_curves(function: Callable[[np.ndarray], np.ndarray]) -> tuple[Curve, ...]:
        """Plot ``function`` of the measured, initial and fitted impedances as curves."""
        return tuple(Curve(name, f, function(1 / y), style) for name, (y, style) in three.items())

    left = Curve("fitted over measured", f, 100 * (np.abs(Y / after) - 1))
    panels = (
        Panel(x, "|Z| in Ω", plot_curves(np.abs), log_y=True),
        Panel(x, "phase in °", plot_curves(lambda z: np.angle(z, deg=True))),
        Panel(x, "difference of |Z| in %", (left,)),
    )
    caption = (
        "Impedance: measured, computed with the values of the scene, and computed with the fitted "
        "values."
    )
    return (Figure("fit", "Impedance", caption, panels),)
