"""The page of a fit: what was measured, what the scene's values give, and what the fitted ones."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel, scale_axis
from kc2spice.report.html import Section, write_page


def write_fit(
    path: Path,
    record: Mapping[str, Any],
    f: np.ndarray,
    Y: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
) -> None:
    """Write the page of ``record``; ``Y``, ``before`` and ``after`` (n,) are admittances [S] at
    ``f`` [Hz]."""
    sections = [
        *fit_sections(record),
        Section("Impedance", figures=fit_figures(f, Y, before, after)),
    ]
    lead = (
        f"The values for which {record['part']} is that of {Path(record['data']).name}. Export "
        "with --set fit.toml --set box.toml writes a netlist with these keys as parameters."
    )
    write_page(path, f"{record['part']}, fitted", lead, sections)


def fit_sections(record: Mapping[str, Any]) -> list[Section]:
    """What ``fit`` found, for the page and for the terminal."""
    values = [
        (key, f"{each['value']:.6g}", f"{each['sigma']:.2g}",
         f"{each['low']:g} to {each['high']:g}", "met" if each["at_bound"] else "")
        for key, each in record["parameters"].items()
    ]  # fmt: skip
    error = record["error"]
    facts = [
        ("deviation of |Z|", f"{error['rms']:.2g} rms, {error['largest']:.2g} at most"),
        ("noise of the data", f"{record['noise']:.2g}"),
        ("finite element models", str(record["models"])),
        ("starts that ended in another minimum", str(record["other_minima"])),
    ]
    for each in record["undetermined"]:
        told = ", ".join(f"{weight:+.2f} log {key}" for key, weight in each.items())
        facts.append(("not determined by the data", told))
    resonances = [
        tuple("" if value is None else f"{value:.6g}" for value in row.values())
        for row in record["resonances"]
    ]
    starts = [tuple(f"{value:.6g}" for value in each.values()) for each in record["starts"]]
    keys = tuple(record["parameters"])
    correlation = [
        (key, *(f"{value:+.3f}" for value in row))
        for key, row in zip(keys, record["correlation"], strict=True)
    ]
    return [
        Section("Values", values, ("key", "value", "standard error", "range", "bound")),
        Section("Fit", facts),
        Section("Resonances", resonances, ("measured in Hz", "at the scene's values", "fitted"),
                note="peaks of the conductance, in their order"),
        Section("Starts", starts, (*keys, "half the sum of squares")),
        Section("Correlation", correlation, ("", *keys)),
    ]  # fmt: skip


def fit_figures(
    f: np.ndarray, Y: np.ndarray, before: np.ndarray, after: np.ndarray
) -> tuple[Figure, ...]:
    """Impedance and phase of all three, and what is left over."""
    x, factor = scale_axis("frequency", f)
    f = factor * f
    three = {"measured": (Y, "o"), "scene": (before, "--"), "fitted": (after, "-")}
    size = [Curve(name, f, np.abs(1 / y), style) for name, (y, style) in three.items()]
    phase = [Curve(name, f, np.rad2deg(np.angle(1 / y)), style)
             for name, (y, style) in three.items()]  # fmt: skip
    left = Curve("fitted over measured", f, 100 * (np.abs(Y / after) - 1))
    panels = (
        Panel(x, "|Z| in Ω", tuple(size), log_y=True),
        Panel(x, "phase in °", tuple(phase)),
        Panel(x, "difference of |Z| in %", (left,)),
    )
    caption = "Measured impedance, that of the scene's values and that of the fitted ones."
    return (Figure("fit", "Impedance", caption, panels),)
