"""Terminal output of ``kc2spice reduce``: a reduced model, or a comparison of methods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kc2spice.cli.terminal_output import print_notes, print_table
from kc2spice.core.error_norms import NORM_WORDS
from kc2spice.report.run_page import Rows, format_above_band, format_band

METHOD_COLUMNS = "method", "first-order states", "error estimate", "of the peak", "CPU time"
STABILITY_WORDS = {True: "yes", False: "NO", None: "not known"}


def print_reduction(result: Mapping[str, Any]) -> None:
    """Print size, band and error estimate of a reduced model, with notes and warnings.

    The errors are ratios, because the option ``--tolerance`` is a ratio.
    """
    form = result.get("full_form", result["form"])
    estimate = f"{result['error_estimate']:.3g} of {NORM_WORDS[result['norm']]}"
    rows = [("data", str(result["data"]))] if "data" in result else []
    rows += [
        ("equations", f"{result['unknowns']}, {form}"),
        _make_size_row(result),
        ("band", format_band(result["band_hz"])),
        ("error estimate", estimate),
        *format_above_band(result, as_ratio=True),
        *map(_make_parameter_row, result.get("parameters", {}).values()),
        ("stable", STABILITY_WORDS[result["stable"]]),
        ("passive", "yes" if result["passive"] else "not shown"),
        *_make_method_rows(result["method"]),
        ("reduced model", str(result["rom"])),
    ]
    print_table("Reduced model", rows)
    print_notes(result)


def print_comparison(result: Mapping[str, Any]) -> None:
    """Print state count, errors and CPU time of each reduction method."""
    title = f"{result['unknowns']} equations, errors relative to {NORM_WORDS[result['norm']]}"
    print_table(title, list(map(_make_comparison_row, result["methods"])), METHOD_COLUMNS)
    print(f"CPU time of the basis shared by all methods: {result['shared_cpu_s']:.2g} s")


def _make_size_row(result: Mapping[str, Any]) -> tuple[str, str]:
    """Return the table row with the number of states, or of unknowns, of a reduced model.

    The row of a second-order model contains both numbers. For a model of measured data, the row
    contains only the number of unknowns. In the model of measured data, an unknown without inertia
    has one first-order state, and any other unknown has two.
    """
    order = result["order"]
    if result["form"] == "first order":
        changed = result.get("full_form", result["form"]) != result["form"]
        return "states", f"{order}, first order" if changed else str(order)
    if "data" in result:
        return "unknowns", str(order)
    return "unknowns", f"{order} ({2 * order} first-order states)"


def _make_parameter_row(parameter: Mapping[str, Any]) -> tuple[str, str]:
    """Return the table row of a parameter of the reduced model."""
    low, high = parameter["low"], parameter["high"]
    unit = "" if parameter["unit"] == "-" else f" {parameter['unit']}"
    return f"parameter {parameter['name']}", f"{low:g} … {high:g}{unit}"


def _make_method_rows(method: str) -> Rows:
    """Return the table rows about the method that estimated the error."""
    first, *others = method.split("; ")
    return [("method", first), *(("", fact) for fact in others)]


def _make_comparison_row(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the table row of a reduction method, with the reason of a failure."""
    cpu = f"{row['cpu_s']:.2g} s"
    if row["states"] is None:
        return row["method"], "-", row["reason"], "", cpu
    errors = (f"{row[key]:.2g}" for key in ("error_estimate", "peak_error"))
    return row["method"], str(row["states"]), *errors, cpu
