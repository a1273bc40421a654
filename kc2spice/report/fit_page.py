"""``report.html`` of a fit: fitted keys, their errors, and the impedance before and after."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel, scale_axis
from kc2spice.report.html import PageSection, write_page


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
    figures = fit_figures(f, Y, before, after)
    sections = [*fit_sections(record), PageSection("Impedance", figures=figures)]
    lead = (
        f"The values for which {record['part']} is that of {Path(record['data']).name}. Export "
        "with --set fit.toml --set box.toml writes a netlist with these keys as parameters."
    )
    write_page(path, f"{record['part']}, fitted", lead, sections)


def fit_sections(record: Mapping[str, Any]) -> list[PageSection]:
    """Results of ``fit`` for the page and the terminal."""
    values = [
        (key, f"{item['value']:.6g}", f"{item['sigma']:.2g}",
         f"{item['low']:g} to {item['high']:g}", "met" if item["at_bound"] else "")
        for key, item in record["parameters"].items()
    ]  # fmt: skip
    error = record["error"]
    facts = [
        ("deviation of |Z|", f"{error['rms']:.2g} rms, {error['largest']:.2g} at most"),
        ("noise of the data", f"{record['noise']:.2g}"),
        ("misfit, in units of the noise", f"{record['misfit']:.2g}"),
        ("finite element models", str(record["models"])),
        ("starts that ended in another minimum", str(record["other_minima"])),
    ]
    if record["caution"]:
        facts.append(("warning", record["caution"]))
    for item in record["undetermined"]:
        text = ", ".join(f"{weight:+.2f} log {key}" for key, weight in item.items())
        facts.append(("not determined by the data", text))
    resonances = [
        tuple("" if value is None else f"{value:.6g}" for value in row.values())
        for row in record["resonances"]
    ]
    starts = [tuple(f"{value:.6g}" for value in item.values()) for item in record["starts"]]
    keys = tuple(record["parameters"])
    correlation = [
        (key, *(f"{value:+.3f}" for value in row))
        for key, row in zip(keys, record["correlation"], strict=True)
    ]
    return [
        PageSection("Values", values, ("key", "value", "standard error", "range", "bound")),
        PageSection("Fit", facts),
        PageSection("Resonances", resonances, ("measured in Hz", "at the scene's values", "fitted"),
                note="peaks of the conductance, in their order"),
        PageSection("Starts", starts, (*keys, "half the sum of squares")),
        PageSection("Correlation", correlation, ("", *keys)),
    ]  # fmt: skip


def fit_figures(
    f: np.ndarray, Y: np.ndarray, before: np.ndarray, after: np.ndarray
) -> tuple[Figure, ...]:
    """Impedance and phase of all three, and what is left over."""
    x, factor = scale_axis("frequency", f)
    f = factor * f
    three = {"measured": (Y, "o"), "scene": (before, "--"), "fitted": (after, "-")}

    def curves(of: Callable[[np.ndarray], np.ndarray]) -> tuple[Curve, ...]:
        return tuple(Curve(name, f, of(1 / y), style) for name, (y, style) in three.items())

    left = Curve("fitted over measured", f, 100 * (np.abs(Y / after) - 1))
    panels = (
        Panel(x, "|Z| in Ω", curves(np.abs), log_y=True),
        Panel(x, "phase in °", curves(lambda z: np.angle(z, deg=True))),
        Panel(x, "difference of |Z| in %", (left,)),
    )
    caption = "Measured impedance, that of the scene's values and that of the fitted ones."
    return (Figure("fit", "Impedance", caption, panels),)
