"""Terminal output of ``kc2spice reduce``: a reduced model, or a comparison of methods."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kc2spice.cli.terminal_output import print_notes, print_table
from kc2spice.core.error_norms import NORM_WORDS
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.report.run_page import Rows, format_above_band, format_band

METHOD_COLUMNS = "method", "states", "form", "error", "CPU time"
PEAK_COLUMN = "of the peak"  # title of the column with errors in the norm *peak*
PASSIVE_MARK = "*"  # mark of passive models in the column "form"
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
        *_make_pointwise_rows(result),
        *format_above_band(result, as_ratio=True),
        *map(_make_parameter_row, result.get("parameters", {}).values()),
        ("stable", STABILITY_WORDS[result["stable"]]),
        ("passive", "yes" if result["passive"] else "not shown"),
        *_make_method_rows(result["method"], result.get("reduction_method", "")),
        ("reduced model", str(result["rom"])),
    ]
    print_table("Reduced model", rows)
    print_notes(result)


def print_comparison(result: Mapping[str, Any]) -> None:
    """Print state count, errors and CPU time of each reduction method."""
    title = f"{result['unknowns']} equations, errors relative to {NORM_WORDS[result['norm']]}\n"
    title += f"states: first-order states; form: 1st or 2nd order, {PASSIVE_MARK} if passive"
    rows = [row for row in result["methods"] if row["states"] is not None]
    columns: tuple[str, ...] = METHOD_COLUMNS
    if with_peak := result["norm"] != "peak":
        columns = *METHOD_COLUMNS[:-1], PEAK_COLUMN, METHOD_COLUMNS[-1]
    print_table(title, [_make_comparison_row(row, with_peak) for row in rows], columns)
    for row in rows:
        if row["reduction_method"] not in ("", row["method"]):
            print(f"{row['method']}: {row['reduction_method']}")
    failed = [row for row in result["methods"] if row["states"] is None]
    if failed:
        print_table("Methods without a result", [(row["method"], row["reason"]) for row in failed])
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


def _make_pointwise_rows(result: Mapping[str, Any]) -> Rows:
    """Return a table row of the largest pointwise error, or no row.

    The pointwise error is relative to the response at the same frequency. The norm *peak* does not
    limit the pointwise error, which can be large at minima of the response.
    """
    if "pointwise_error" not in result:
        return []
    place = format_quantity(result["pointwise_error_hz"], "Hz", 4)
    text = f"up to {result['pointwise_error']:.3g} of the response at the same frequency, at "
    return [("", f"{text}{place}; --tolerance with --norm pointwise limits this error")]


def _make_method_rows(evidence: str, reduction_method: str) -> Rows:
    """Return the table rows about the reduction method and the check of the error.

    For a model that was fitted to measured data, ``evidence`` describes the fit, and
    ``reduction_method`` is "".
    """
    title = "error check" if reduction_method else "method"
    rows: Rows = [("method", reduction_method)] if reduction_method else []
    facts = evidence.removeprefix(f"{reduction_method}; ").split("; ")
    return [*rows, (title, facts[0]), *(("", fact) for fact in facts[1:])]


def _make_comparison_row(row: Mapping[str, Any], with_peak: bool) -> tuple[str, ...]:
    """Return the table row of a reduced model, with its form, errors and CPU time."""
    form = ("1st" if row["first_order"] else "2nd") + (PASSIVE_MARK if row["passive"] else "")
    keys = ("error_estimate", "peak_error") if with_peak else ("error_estimate",)
    errors = (f"{row[key]:.2g}" for key in keys)
    return row["method"], str(row["states"]), form, *errors, f"{row['cpu_s']:.3f} s"
