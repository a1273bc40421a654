"""Writer of the page ``report.html`` of a run.

The page contains drawings, figures, metrics, checks and wall times. Functions whose names begin
with ``format_`` also produce the output in the terminal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import chain
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

from kc2spice.core.domains import ACCELERATION
from kc2spice.core.error_norms import NORM_WORDS
from kc2spice.core.figure import Figure
from kc2spice.core.mesh_error_descriptions import MESH_ERROR_PREFIX
from kc2spice.core.si_prefix_format import (
    ROUNDING_NOISE,
    format_percent,
    format_quantity,
    format_ratio,
    format_value_and_limit,
    remove_unit_words,
)
from kc2spice.report.drawings import draw_circuit, draw_side_view, write_side_view_caption
from kc2spice.report.html import (
    MAX_ROW_VALUES,
    PageSection,
    distinguish_labels,
    flatten_mapping,
    format_metric,
    format_value,
    label_key,
    write_page,
)
from kc2spice.scene.part_records import STEP_SET_BY_USER
from kc2spice.scene.scene_classes import Scene, compute_scene_hash

# Metrics that state the frequency at which another metric applies, keyed by the other metric.
_FREQUENCY_METRICS = {"capacitance_f": "capacitance_frequency_hz"}
# Each row of assumptions replaces one metric of a summary, but at least MIN_METRICS remain.
MIN_METRICS = 4
OPERATING_RESULTS = 6  # largest number of operating-point results in a summary
LEAD_TEXT = "Finite-element models, reduced, exported as a netlist and run in ngspice."
NETS_NOTE = (
    "Colours of pins: blue electrical, orange mechanical, green signals, grey others. The names of "
    "the nets are those of the netlist."
)
FIGURES_NOTE = (
    "Hover to read values, drag to zoom in, double-click to reset the zoom; click a legend entry "
    "to hide its curve. A shaded curve is the envelope of more cycles than the screen resolves."
)
OPERATING_NOTE = (
    "The small-signal analysis linearises the circuit about the operating point. Results that are "
    "zero at the operating point are omitted."
)
CHECKS_NOTE = (
    "Independent checks of the results against physical laws and limits that the netlist does not "
    "enforce. Percentages are relative: result.json gives the reference value of each percentage."
)
# Effect of a violated check on the run, keyed by the action of the check.
VIOLATION_EFFECTS = {"warn": "warning", "fail": "error"}
# Values that probes compute from a waveform, in words.
PROBE_WORDS = {
    "max": "maximum", "min": "minimum", "final": "final value", "mean": "mean", "rms": "rms",
    "peak_to_peak": "peak-to-peak", "spl": "sound pressure level", "frequency": "frequency",
}  # fmt: skip
MODEL_STAGES = ("mesh", "assemble", "reduce", "magnetics")  # stages with a cache
MIN_STAGE_TIME = 0.005  # s; shorter stages would be printed as 0.00 s
MODES_NOTE = (
    "Natural modes of the reduced model within its band, with shorted electrodes and without "
    "external forces. The compliance is the contribution of the mode to the static compliance of "
    "the port. The coupling factor is the effective coupling factor of an electrical port."
)
# Unit of the static response to an acceleration, which is the effective mass divided by omega².
ACCELERATION_RESPONSE_UNIT = ACCELERATION.compliance
NOT_ESTIMATED = "not estimated"
IDEAL_SOURCE = "ideal source"  # origin of the model of an independent source
RETRIES_NOTE = "All settings that were tried. The result is from the last setting."

Rows = list[tuple[str, str]]


def write_run(
    path: Path, result: Mapping[str, Any], scene: Scene, figures: Sequence[Figure]
) -> Path:
    """Write the page of ``kc2spice run`` to ``path``; return the path.

    ``result`` is the content of ``result.json``.
    """
    # the main figures are first; a stable sort keeps the order of all other figures
    figures = sorted(figures, key=attrgetter("main"), reverse=True)
    energies = result.get("energy_j", {})
    sections = [
        format_summary(result),
        PageSection("Device", drawing=draw_side_view(scene), note=write_side_view_caption(scene)),
        PageSection("Main result", figures=figures[:1], note=FIGURES_NOTE),
        PageSection("Circuit", drawing=draw_circuit(scene), note=NETS_NOTE),
        PageSection("Further figures", figures=figures[1:]),
        *format_results(result),
        *map(_format_energy, energies, energies.values()),
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
    checks = sorted(result.get("checks", ()), key=_compute_share_of_limit, reverse=True)
    attempts = result.get("simulator", {}).get("attempts", ())
    tried = list(map(_make_attempt_row, attempts)) if len(attempts) > 1 else []
    models, units, modes = [], result.get("model_units", {}), result.get("modes", {})
    for name, facts in result.get("model", {}).items():
        ordered = dict(sorted(facts.items(), key=_get_fact_order))
        rows = _make_summary_rows(ordered, units.get(name, {}))
        models.append(PageSection(f"Model: {name}", rows))
    reduced = []
    for name, certificate in _get_reduced_model_records(result).items():
        title = f"Reduced model: {name}" if name else "Reduced model"
        reduced.append(PageSection(title, _make_certificate_rows(certificate)))
    check_rows = list(map(_make_check_row, checks))
    check_head = ("", "check", "value", "limit", "if exceeded")
    attempt_head = ("setting", "changes", "outcome", "blamed", "time")
    return [
        PageSection(
            "Operating point", format_operating_point(result), ("result", "value"), OPERATING_NOTE
        ),
        PageSection("Checks, closest to the limit first", check_rows, check_head, CHECKS_NOTE),
        *models,
        *reduced,
        *map(_format_modes, modes, modes.values()),
        PageSection("Retries", tried, attempt_head, RETRIES_NOTE),
        PageSection("Run time", _make_time_rows(result), ("stage", "time")),
    ]


def _get_fact_order(fact: tuple[str, Any]) -> tuple[bool, bool]:
    """Return the sort key of a model's value: the size of the model first, mesh errors last."""
    name, _ = fact
    return name != "unknowns", name.startswith(MESH_ERROR_PREFIX)


def _format_check_value(check: Mapping[str, Any]) -> tuple[str, str]:
    """Format the value and the limit of a check; JSON files contain null for infinity."""
    value = math.inf if check["value"] is None else check["value"]
    return format_value_and_limit(value, check["limit"], remove_unit_words(check["unit"]))


def _compute_share_of_limit(check: Mapping[str, Any]) -> float:
    """Return the value of a check divided by its limit; infinite for a violated check."""
    if not check["passed"]:
        return math.inf
    return float(check["value"] / check["limit"]) if check["limit"] else 0.0


def _make_check_row(check: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the table row of a check: verdict, label, value, limit, effect of a violation."""
    value, limit = _format_check_value(check)
    mark = "ok" if check["passed"] else "VIOLATED"
    effect = VIOLATION_EFFECTS.get(check["action"], check["action"])
    return mark, _get_check_label(check), value, limit, effect


def _get_check_label(check: Mapping[str, Any]) -> str:
    """Return the label of a check; records of earlier versions contain only the name."""
    return str(check.get("label", check["name"]))


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
    """Make table rows of a reduced model's certificate and its errors above the band.

    The row of the key ``method`` contains only the text before the first semicolon.
    """
    facts = {}
    for name, value in certificate.items():
        if value is not None and not name.startswith("above_band"):
            facts[name] = value
    if not facts.get("massless"):
        facts.pop("massless", None)
    if "band_hz" in facts:
        facts["band_hz"] = format_band(facts["band_hz"])
    if "method" in facts:
        facts["method"] = facts["method"].partition(";")[0]
    if "norm" in facts:
        facts["norm"] = NORM_WORDS.get(facts["norm"], facts["norm"])
    return [*_make_summary_rows(facts, {}), *format_above_band(certificate)]


def _get_reduced_model_records(result: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the record of each reduced model in ``result.json``, keyed by part name.

    The key is empty if ``result.json`` does not contain the name of the part.
    """
    if not result.get("rom"):
        return {}
    if result.get("roms"):
        return dict(result["roms"])
    names = list(result.get("modes", {}))
    return {names[0] if len(names) == 1 else "": result["rom"]}


def format_band(band: Sequence[float]) -> str:
    """Format a frequency band, such as ``504 Hz to 16.8 kHz``."""
    low, high = (format_quantity(frequency, "Hz", 3) for frequency in band)
    return f"{low} to {high}"


def _make_time_rows(result: Mapping[str, Any]) -> Rows:
    """Return table rows with the wall times of all stages that took time, and their sum."""
    wall = result.get("wall_s", {})
    if not wall:
        return []
    rows = [(stage, time) for stage, time in wall.items() if time >= MIN_STAGE_TIME]
    cached = result.get("model") and not any(wall.get(stage) for stage in MODEL_STAGES)
    texts = [(stage, f"{time:.2f} s") for stage, time in [*rows, ("total", sum(wall.values()))]]
    return [("models", "from the cache"), *texts] if cached else texts


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
    return [*rows[:most], (f"further {kind}", f"{len(rows) - most}, printed with --verbose")]


def format_summary(result: Mapping[str, Any], most: int | None = None) -> PageSection:
    """Return the summary of a run: verdict, scalar metrics and error estimates.

    ``most`` is the largest number of metrics in the summary. By default, the summary contains all
    metrics, and also short lists of numbers.
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
        *_make_stop_rows(result),
        *map(_make_violation_row, violated),
        *(("WARNING", text) for text in result.get("metric_warnings", {}).values()),
        *_limit_rows(_make_metric_rows(result, with_lists=most is None), fewer, "metrics"),
        *map(itemgetter("effect", "error"), assumed),
        *((f"at the operating point: {name}", text) for name, text in point),
        *_make_model_rows(result),
    ]
    return PageSection("Result", rows)


def _make_stop_rows(result: Mapping[str, Any]) -> Rows:
    """Return a summary row of the default end time of a transient, or no row."""
    stop = result.get("plan", {}).get("default_stop_s")
    if stop is None:
        return []
    text = f"stop = {format_quantity(stop, 's')} (default of the key analysis.stop)"
    return [("analysis", text)]


def _make_violation_row(check: Mapping[str, Any]) -> tuple[str, str]:
    """Return the summary row of a violated check: label, value and limit."""
    value, limit = _format_check_value(check)
    return "VIOLATED", f"{_get_check_label(check)}: {value}, limit {limit}"


def _make_metric_rows(result: Mapping[str, Any], *, with_lists: bool) -> Rows:
    """Return table rows of the metrics, with error estimates and definitions of probes.

    A metric with a warning is omitted, because the summary prints the warning.
    """
    units, probes = result.get("metric_units", {}), result.get("probes", {})
    errors = result.get("convergence", {}).get("errors", {})
    warned, metrics = result.get("metric_warnings", {}), {}
    resolutions, scopes = result.get("metric_resolutions", {}), result.get("metric_scopes", {})
    for name, value in flatten_mapping({**result.get("metrics", {}), **result.get("curves", {})}):
        is_shown = _is_scalar(value) or (with_lists and _fits_one_row(value))
        if is_shown and name not in warned:
            metrics[name] = value
    scales = _find_largest_by_unit(metrics, units)
    rows = {}
    for name, value in metrics.items():
        table, dot, key = name.rpartition(".")
        if key in _FREQUENCY_METRICS.values():
            continue  # no row, because the row of another metric states the frequency
        label, text = _make_summary_row(name, value, units, scales)
        frequency = metrics.get(f"{table}{dot}{_FREQUENCY_METRICS.get(key)}")
        if frequency is not None:
            text += f" at {format_quantity(frequency, 'Hz')}"
        if value is not None and name in resolutions:
            text += f" ± {format_quantity(resolutions[name], units.get(name, ''), 3)}"
        if (kind := PROBE_WORDS.get(probes.get(name, {}).get("take"))) is not None:
            text += f", {kind} of {probes[name]['of']}"
        if name in scopes:
            text += f", of {scopes[name]} without its circuit"
        if name in errors:
            text += f" (error estimate {format_percent(errors[name], 2)})"
        rows[name] = label, text
    return _label_rows(rows, units)


def format_verdict(checks: Sequence[Mapping[str, Any]]) -> str:
    """Return a string with the number of passed checks.

    Examples are ``all 17 passed``, ``16 of 17 passed`` and ``no check applies to this run``.
    """
    if not checks:
        return "no check applies to this run"
    passed = sum(map(bool, map(itemgetter("passed"), checks)))
    if passed < len(checks):
        return f"{passed} of {len(checks)} passed"
    return f"all {passed} passed" if passed > 1 else f"{passed} passed"


def _is_scalar(value: Any) -> bool:
    """Return whether the value of a metric is a scalar, not a list or a mapping."""
    return not isinstance(value, (list, tuple, Mapping))


def _make_model_rows(result: Mapping[str, Any]) -> Rows:
    """Return table rows of reduced models: number of states, band, error estimate."""
    rows = []
    for name, rom in _get_reduced_model_records(result).items():
        label = f"reduced model of {name}" if name else "reduced model"
        text = f"{rom['order']} states"
        if rom.get("error_estimate") is not None and rom.get("band_hz"):
            band = format_band(rom["band_hz"]).replace("0 Hz to ", "up to ", rom["band_hz"][0] == 0)
            text += f", error estimate {format_percent(rom['error_estimate'], 2)}, {band}"
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


def format_above_band(certificate: Mapping[str, Any], *, as_ratio: bool = False) -> Rows:
    """Format the mechanical compliance's errors above the band as a table row.

    The errors are in percent, or ratios with ``as_ratio``.
    """
    format_error = format_ratio if as_ratio else _format_relative_error
    frequencies = certificate.get("above_band_hz", ())
    errors = certificate.get("above_band_compliance_error", ())
    texts = []
    for frequency, error in zip(frequencies, errors, strict=True):
        texts.append(f"{format_error(error)} at {format_quantity(frequency, 'Hz')}")
    return [("compliance error above the band", ", ".join(texts))] if texts else []


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
    for item in planned["settings"]:
        key, of = item["key"], item["error_of"] or ""
        error = item["error"]
        if key in shares:
            error, of = shares[key], "metrics"
        settings.append((key, _format_setting(item), _format_relative_error(error), of))
    for name, error in result.get("errors", {}).items():
        settings.append(("all settings", "", _format_relative_error(error), name))
    sources_first = sorted(planned["parts"], key=lambda part: part["source"] != IDEAL_SOURCE)
    parts = list(chain.from_iterable(map(_make_part_rows, sources_first)))
    omitted = []
    for row in sorted(planned["left_out"], key=_get_effect_order):
        omitted.append((row["effect"], row["why"], row["error"]))
    head = ("key", "value", "estimated error", "error of")
    note = _write_settings_note(planned["error_budget"])
    step = planned.get("largest_step")
    if step is not None and step["why"] != STEP_SET_BY_USER:
        note = f"solver.max_step follows from: {step['why']}. {note}"
    return [
        PageSection("Parts", parts, ("part", "model")),
        PageSection("Numerical settings", settings, head, note),
        PageSection("Neglected effects", omitted, ("effect", "assumption", "influence")),
    ]


def _make_part_rows(part: Mapping[str, str]) -> Rows:
    """Return the table rows of a part's model: origin of the model, and one row per fact."""
    first, *others = part["detail"].split("; ")
    return [(part["part"], f"{part['source']}: {first}"), *(("", text) for text in others)]


def _get_effect_order(row: Mapping[str, Any]) -> tuple[int, float]:
    """Return the key that sorts neglected effects by size.

    Effects in the summary of the run are first, then effects of known size, largest first. Effects
    that are not estimated are last.
    """
    if row["summarised"]:
        return 0, 0.0
    if row["size"] is not None:
        return 1, -row["size"]
    return (3 if row["error"].startswith(NOT_ESTIMATED) else 2), 0.0


def _format_setting(setting: Mapping[str, Any]) -> str:
    """Format the value of a numerical setting: a count, a ratio in percent, or a quantity."""
    value, unit = setting["value"], setting["unit"]
    if unit is None:
        return f"{value:g}"
    return format_quantity(value, unit) if unit else f"{100 * value:g} %"


def _write_settings_note(budget: float | None) -> str:
    """Return the note below the table of numerical settings.

    The note states how a run limits the errors. ``budget`` is the key ``error_budget``.
    """
    if budget is not None:
        return (
            f"error_budget = {budget:g}: a run refines the settings until the error of each metric "
            f"is at most {100 * budget:g} %."
        )
    return (
        "Errors are estimated before the run. To limit the error of each metric to 1 %, write "
        "error_budget = 0.01 at the top of the scene file."
    )


def _format_relative_error(error: float | None) -> str:
    """Format a relative error in percent, or return ``not estimated``."""
    return NOT_ESTIMATED if error is None else format_percent(error, 2)


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
    *tables, key = name.split(".")
    label, text = format_metric(key, _replace_rounding_error(value, scales, unit), unit)
    return " ".join((*map(label_key, tables), label)), text


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
            head.append(f"{_name_coupling(unit)} {port}")
    rows = []
    for mode in modes:
        row = [format_quantity(mode["frequency_hz"], "Hz"), format_quantity(mode["quality"], "")]
        for port in coupled:
            row.append(_format_coupling(mode, port, units[port]))
        rows.append(row)
    return PageSection(f"Modes: {part}", rows, head, MODES_NOTE)


def _name_coupling(unit: str) -> str:
    """Return the beginning of a column title: the quantity of a coupling with this unit."""
    if unit == ACCELERATION_RESPONSE_UNIT:
        return "effective mass at"
    return "compliance at" if unit else "coupling factor of"


def _format_coupling(mode: Mapping[str, Any], port: str, unit: str) -> str:
    """Format the coupling of a mode to a port; for an acceleration, the effective mass."""
    value = mode["couplings"][port]
    if unit == ACCELERATION_RESPONSE_UNIT:
        return format_quantity(value * (2 * math.pi * mode["frequency_hz"]) ** 2, "kg", 3)
    return format_quantity(value, unit, 3)


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
