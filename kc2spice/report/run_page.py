"""Writer of the page ``report.html`` of a run.

The page contains drawings, figures, metrics, checks and wall times. Functions whose names begin
with ``format_`` also produce the output in the terminal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

from kc2spice.core.figure import Figure
from kc2spice.core.si_prefix_format import ROUNDING_NOISE, format_quantity, format_value_and_limit
from kc2spice.report.drawings import draw_circuit, draw_side_view, write_side_view_caption
from kc2spice.report.html import (
    MAX_ROW_VALUES,
    PageSection,
    distinguish_labels,
    flatten_mapping,
    format_metric,
    format_times,
    format_value,
    write_page,
)
from kc2spice.scene.scene_classes import Scene, compute_scene_hash

# Each row of assumptions replaces one metric of a summary, but at least MIN_METRICS remain.
MIN_METRICS = 4
OPERATING_RESULTS = 6  # largest number of operating-point results in a summary
LEAD_TEXT = "Finite-element models, reduced, exported as a netlist and run in ngspice."
NETS_NOTE = (
    "Colours of pins: blue electrical, orange mechanical, green signals, grey others. The names of "
    "the nets are those of the netlist."
)
FIGURES_NOTE = (
    "Move the pointer to read values, drag to enlarge, double-click to see all; click a name of a "
    "legend to hide its curve. A shaded curve is the envelope of more cycles than the screen "
    "resolves."
)
OPERATING_NOTE = (
    "About which the small signals are linear; results that are zero there are left out."
)
CHECKS_NOTE = (
    "Laws of physics that the netlist does not contain. The last column states the effect of a "
    "violation."
)
MODES_NOTE = (
    "Of the reduced model within its band, electrodes shorted, nothing pressing on it. k is the "
    "effective coupling factor; at other ports stands what the mode adds to the static answer."
)
SETTINGS_NOTE = "Relative errors; a run with error_budget estimates those of all metrics."
RETRIES_NOTE = "Every setting that was tried; the last one gave this result."

Rows = list[tuple[str, str]]


def write_run(
    path: Path, result: Mapping[str, Any], scene: Scene, figures: Sequence[Figure]
) -> Path:
    """Write the page of ``kc2spice run`` to ``path``; return the path.

    ``result`` is the content of ``result.json``.
    """
    # the main figures are first; a stable sort keeps the order of all other figures
    figures = sorted(figures, key=attrgetter("main"), reverse=True)
    energies, modes = result.get("energy_j", {}), result.get("modes", {})
    sections = [
        format_summary(result),
        PageSection("Device", drawing=draw_side_view(scene), note=write_side_view_caption(scene)),
        PageSection("Main result", figures=figures[:1], note=FIGURES_NOTE),
        PageSection("Circuit", drawing=draw_circuit(scene), note=NETS_NOTE),
        PageSection("Further figures", figures=figures[1:]),
        *format_results(result),
        *map(_format_energy, energies, energies.values()),
        *map(_format_modes, modes, modes.values()),
        *format_model_summary(result["plan"], result.get("convergence", {})),
        PageSection("Simulator", _make_simulator_rows(result, scene)),
        PageSection("Files", links=result.get("files", ())),
    ]
    title = f"{scene.name}: {scene.title}" if scene.title else scene.name
    return write_page(
        path, title, LEAD_TEXT, sections, origin=(f"scene {compute_scene_hash(scene)}",)
    )


def format_results(result: Mapping[str, Any]) -> list[PageSection]:
    """Return the results in ``result.json`` as sections for a page or the terminal."""
    wall = result.get("wall_s", {})
    times = {**wall, "sum": sum(wall.values())} if wall else {}
    checks = list(map(_make_check_row, result.get("checks", ())))
    attempts = result.get("simulator", {}).get("attempts", ())
    tried = list(map(_make_attempt_row, attempts)) if len(attempts) > 1 else []
    models, units = [], result.get("model_units", {})
    for name, facts in result.get("model", {}).items():
        models.append(PageSection(f"Model: {name}", _make_summary_rows(facts, units.get(name, {}))))
    metrics = _make_summary_rows(result.get("metrics", {}), result.get("metric_units", {}))
    check_head = ("", "check", "value", "limit", "action")
    attempt_head = ("setting", "changes", "outcome", "blamed", "time")
    return [
        PageSection("Metrics", metrics),
        PageSection(
            "Operating point", format_operating_point(result), ("result", "value"), OPERATING_NOTE
        ),
        PageSection("Physics checks", checks, check_head, CHECKS_NOTE),
        *models,
        PageSection("Reduced model", _make_certificate_rows(result.get("rom", {}))),
        PageSection("Retries", tried, attempt_head, RETRIES_NOTE),
        PageSection(
            "Wall time", format_times(times), ("stage", "time"), "0 s: taken from the cache."
        ),
    ]


def _format_check_value(check: Mapping[str, Any]) -> tuple[str, str]:
    """Format the value and the limit of a check; JSON files contain null for infinity."""
    value = math.inf if check["value"] is None else check["value"]
    return format_value_and_limit(value, check["limit"], check["unit"])


def _make_check_row(check: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the table row of a physics check: verdict, name, value, limit and action."""
    value, limit = _format_check_value(check)
    mark = "ok" if check["passed"] else "VIOLATED"
    return mark, _label_check(check), value, limit, check["action"]


def _make_attempt_row(attempt: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the table row of a simulation attempt: settings, outcome, wall time."""
    return (
        attempt["setting"],
        attempt["settings"],
        attempt["cause"] or "succeeded",
        attempt["part"] or "",
        format_quantity(attempt["wall_s"], "s", 3),
    )


def _make_certificate_rows(certificate: Mapping[str, Any]) -> Rows:
    """Return table rows of a certificate, followed by the errors above the band."""
    facts = {}
    for name, value in certificate.items():
        if value is not None and not name.startswith("above_band"):
            facts[name] = value
    return [*_make_summary_rows(facts, {"band_hz": "Hz"}), *format_above_band(certificate)]


def format_operating_point(result: Mapping[str, Any], most: int | None = None) -> Rows:
    """Return table rows of up to ``most`` nonzero results at the operating point.

    An additional row contains the number of omitted results.
    """
    units, numbers = {}, {}
    for name, item in result.get("operating_point", {}).items():
        units[name], numbers[name] = item["unit"], float(item["value"])
    scales = _find_largest_by_unit(numbers, units)
    rows = []
    for name, number in numbers.items():
        value = _replace_rounding_error(number, scales, units[name])
        if value:
            rows.append((name, format_quantity(value, units[name])))
    return _limit_rows(rows, most, "results")


def _limit_rows(rows: Rows, most: int | None, kind: str) -> Rows:
    """Return the first ``most`` rows, and a row with the number of omitted rows.

    ``kind`` is a plural noun for the rows, such as ``metrics``.
    """
    if most is None or len(rows) <= most:
        return rows
    return [*rows[:most], (f"further {kind}", f"{len(rows) - most}, in the report")]


def _label_check(check: Mapping[str, Any]) -> str:
    """Return the name of a check with blanks instead of underscores."""
    name: str = check["name"]
    return name if " " in name else name.replace("_", " ")


def format_summary(result: Mapping[str, Any], most: int | None = None) -> PageSection:
    """Return the summary of a run: verdict, scalar metrics and error estimates.

    ``most`` is the largest number of metrics in the summary.
    """
    checks = result.get("checks", ())
    left_out = result.get("plan", {}).get("left_out", ())
    assumed = [row for row in left_out if row["summarised"]]
    # In a short table, each assumption takes the place of a metric, down to MIN_METRICS metrics.
    fewer = None if most is None else max(most - len(assumed), min(most, MIN_METRICS))
    violated = [check for check in checks if not check["passed"]]
    point = format_operating_point(result, OPERATING_RESULTS)
    rows = [
        ("checks", format_verdict(checks)),
        *map(_make_violation_row, violated),
        *_limit_rows(_make_metric_rows(result), fewer, "metrics"),
        *map(itemgetter("effect", "error"), assumed),
        *((f"at the operating point: {name}", text) for name, text in point),
        *_make_model_rows(result),
    ]
    return PageSection("Result", rows)


def _make_violation_row(check: Mapping[str, Any]) -> tuple[str, str]:
    """Return the summary row of a violated check: name, value and limit."""
    value, limit = _format_check_value(check)
    # A unit of several words is written after the value, and not repeated after the limit.
    if " " in check["unit"]:
        limit = limit.removesuffix(f" {check['unit']}")
    return "VIOLATED", f"{_label_check(check)}: {value}, limit {limit}"


def _make_metric_rows(result: Mapping[str, Any]) -> Rows:
    """Return table rows of the scalar metrics with error estimates."""
    units = result.get("metric_units", {})
    errors = result.get("convergence", {}).get("errors", {})
    leaves = flatten_mapping(result.get("metrics", {}))
    metrics = {name: value for name, value in leaves if _is_scalar(value)}
    scales = _find_largest_by_unit(metrics, units)
    rows = {}
    for name, value in metrics.items():
        error = errors.get(name)
        estimate = "" if error is None else f" (error estimate {100 * error:.2g} %)"
        label, text = _make_summary_row(name, value, units, scales)
        rows[name] = label, text + estimate
    return _label_rows(rows, units)


def format_verdict(checks: Sequence[Mapping[str, Any]]) -> str:
    """Return a string with the number of passed checks.

    Examples are ``17 checks passed`` and ``16 of 17 checks passed``.
    """
    passed = sum(map(bool, map(itemgetter("passed"), checks)))
    if passed == len(checks):
        return f"{passed} check{'s' * (passed != 1)} passed"
    return f"{passed} of {len(checks)} checks passed"


def _is_scalar(value: Any) -> bool:
    """Return whether the value of a metric is a scalar, not a list or a mapping."""
    return not isinstance(value, (list, tuple, Mapping))


def _make_model_rows(result: Mapping[str, Any]) -> Rows:
    """Return table rows of reduced models: number of states, band, error estimate."""
    models = (result.get("roms") or {"": result["rom"]}) if result.get("rom") else {}
    rows = []
    for name, rom in models.items():
        label = f"reduced model {name}".strip()
        text = f"{rom['order']} states"
        if rom.get("error_estimate") is not None and rom.get("band_hz"):
            top = format_quantity(rom["band_hz"][1], "Hz", 3)
            text += f", error estimate {100 * rom['error_estimate']:.2g} % up to {top}"
        rows.append((label, text))
    return rows


def _find_largest_by_unit(values: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, float]:
    """Return the largest magnitude of the values with each unit, keyed by unit."""
    result: dict[str, float] = {}
    for name, value in values.items():
        if isinstance(value, float) and math.isfinite(value):
            unit = units.get(name, "")
            result[unit] = max(result.get(unit, 0.0), abs(value))
    return result


def _replace_rounding_error(value: Any, scales: Mapping[str, float], unit: str) -> Any:
    """Return a value, or 0 if the value is only a rounding error.

    ``scales`` contains the largest magnitude of the values of each unit, keyed by unit. A value
    counts as a rounding error if it is much smaller than the largest magnitude of the same unit.
    """
    noise = isinstance(value, float) and abs(value) < ROUNDING_NOISE * scales.get(unit, 0.0)
    return 0.0 if noise else value


def format_above_band(certificate: Mapping[str, Any]) -> Rows:
    """Return table rows of the mechanical compliance's errors above the band."""
    frequencies = certificate.get("above_band_hz", ())
    errors = certificate.get("above_band_compliance_error", ())
    rows = []
    for frequency, error in zip(frequencies, errors, strict=True):
        name = f"compliance at {format_quantity(frequency, 'Hz')}"
        rows.append((name, f"error {100 * error:.2g} %, above the band"))
    return rows


def format_model_summary(
    planned: Mapping[str, Any], converged: Mapping[str, Any] | None = None
) -> list[PageSection]:
    """Return page sections of models, numerical settings and neglected effects.

    ``converged`` contains the results of refined runs. If a refined run has computed the effect of
    a setting on the metrics, the table states this effect as the error of the setting.
    """
    result = converged or {}
    shares = result.get("shares", {})
    settings = []
    for key, value, error in map(dict.values, planned["settings"]):
        settings.append((key, f"{value:g}", _format_relative_error(shares.get(key, error))))
    for name, error in result.get("errors", {}).items():
        settings.append((f"error of {name}", "", _format_relative_error(error)))
    parts = list(map(tuple, map(dict.values, planned["parts"])))
    omitted = list(map(itemgetter("effect", "why", "error"), planned["left_out"]))
    return [
        PageSection("What is modelled", parts, ("part", "source", "model")),
        PageSection("Numerical settings", settings, ("key", "value", "error"), SETTINGS_NOTE),
        PageSection("What is left out", omitted, ("effect", "why", "size")),
    ]


def _format_relative_error(error: float | None) -> str:
    """Format a relative error; for an unknown error, return ``not estimated``."""
    return "not estimated" if error is None else f"{error:.2g}"


def _make_summary_rows(facts: Mapping[str, Any], units: Mapping[str, str]) -> Rows:
    """Return table rows of numbers, ranges and short lists of strings.

    ``units`` is keyed by the dotted names of the results. Curves are omitted, because figures show
    curves.
    """
    values = {}
    for name, value in flatten_mapping(facts):
        if _is_scalar(value) or _fits_one_row(value):
            values[name] = value
    scales = _find_largest_by_unit(values, units)
    rows = {name: _make_summary_row(name, value, units, scales) for name, value in values.items()}
    return _label_rows(rows, units)


def _label_rows(rows: Mapping[str, tuple[str, str]], units: Mapping[str, str]) -> Rows:
    """Return table rows with unique labels.

    ``rows`` contains a label and a text for each key. Labels that would be equal also contain the
    physical quantity.
    """
    labels = distinguish_labels({name: label for name, (label, _) in rows.items()}, units)
    return [(labels[name], text) for name, (_, text) in rows.items()]


def _fits_one_row(values: Sequence[Any]) -> bool:
    """Return whether a list of values is short enough for one table row."""
    words = all(isinstance(value, str) for value in values)
    return len(values) <= (MAX_ROW_VALUES if words else 2)


def _make_summary_row(
    name: str, value: Any, units: Mapping[str, str], scales: Mapping[str, float]
) -> tuple[str, str]:
    """Return the label and the formatted value of a result.

    ``scales`` contains the largest magnitude of the results of each unit, keyed by unit.
    """
    unit = units.get(name, "")
    return format_metric(name.replace(".", "_"), _replace_rounding_error(value, scales, unit), unit)


def _format_energy(name: str, entries: Mapping[str, float]) -> PageSection:
    """Return a page section with the table of an energy balance."""
    return PageSection(f"Energy: {name}", _make_summary_rows(entries, dict.fromkeys(entries, "J")))


def _format_modes(part: str, table: Mapping[str, Any]) -> PageSection:
    """Return a page section with a table of a body's modes.

    The table contains natural frequencies, Q factors and couplings.

    Ports without coupling to any mode are omitted.
    """
    units, modes = table["units"], table["modes"]
    coupled = []
    head = ["frequency", "Q"]
    for port, unit in units.items():
        if any(mode["couplings"][port] > 0 for mode in modes):
            coupled.append(port)
            head.append(port if unit else f"k of {port}")
    rows = []
    for mode in modes:
        row = [format_quantity(mode["frequency_hz"], "Hz"), format_quantity(mode["quality"], "")]
        for port in coupled:
            row.append(format_quantity(mode["couplings"][port], units[port], 3))
        rows.append(row)
    return PageSection(f"Modes: {part}", rows, head, MODES_NOTE)


def _make_simulator_rows(result: Mapping[str, Any], scene: Scene) -> Rows:
    """Return table rows that describe the simulator, time points and settings."""
    facts = dict(result.get("simulator", {}))
    facts.pop("attempts", None)
    rows: Rows = list(zip(facts, map(str, facts.values()), strict=True))
    if scene.analysis.type != "transient":
        return [*rows, ("analysis", scene.analysis.type)]
    for kind, count in result.get("steps", {}).items():
        rows.append((f"{kind} time points", format_value(count)))
    solver, step = scene.solver, result.get("largest_step")
    largest = f"{format_quantity(step['s'], 's')}: {step['why']}" if step else "unknown"
    return [
        *rows,
        ("reltol", f"{solver.reltol:g}"),
        ("method", solver.method),
        ("largest step", largest),
        ("stop", format_quantity(scene.stop_time, "s")),
    ]
