"""``report.html`` of a run: sketches of its devices from the side, to scale, and of its circuit,
figures, metrics, checks with wall times, model facts, omissions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel, scale_axis
from kc2spice.core.waveforms import Waveforms
from kc2spice.report.drawings import devices, draw_circuit
from kc2spice.report.html import (
    NOISE,
    PageSection,
    fact,
    format_quantity,
    format_value,
    leaves,
    value_and_limit,
    write_page,
)
from kc2spice.scene.model import Scene, scene_hash
from kc2spice.scene.settings import Probe

FEW = 8  # entries of a list that a row shows
WIDE = 20.0  # a range of frequencies beyond this ratio has a logarithmic axis
LEAD = "Finite-element models, reduced, exported as a netlist and run in ngspice."
NETS = (
    "Pins by what they carry: blue electrical, orange mechanical, green signals. The names of the "
    "nets are those of the netlist."
)
HOW = (
    "Move the pointer to read values, drag to enlarge, double-click to see all; click a name of a "
    "legend to hide its curve. A shaded curve is the envelope of more cycles than the screen "
    "resolves."
)
LINEARISED = "About which the small signals are linear; results that are zero there are left out."
POINT = 6  # results at the operating point that a terminal shows
CHECKED = (
    "Laws of physics that the netlist does not contain. The last column states the effect of a "
    "violation."
)
MODES = (
    "Of the reduced model within its band, electrodes shorted, nothing pressing on it. k is the "
    "effective coupling factor; at other ports stands what the mode adds to the static answer."
)
ESTIMATED = "Relative errors; a run with error_budget estimates those of all metrics."
TRIED = "Every setting that was tried; the last one gave this result."

Rows = list[tuple[str, ...]]


def write_run(
    path: Path, result: Mapping[str, Any], scene: Scene, figures: Sequence[Figure]
) -> Path:
    """Write the page of ``kc2spice run`` from ``result.json``'s content: what it is, what it did,
    then the numbers."""
    energies = (
        PageSection(f"Energy: {name}", _facts(entries, dict.fromkeys(entries, "J")))
        for name, entries in result.get("energy_j", {}).items()
    )
    figures = sorted(figures, key=lambda figure: not figure.main)  # keeps the order of equals
    sections = [
        summary_section(result),
        PageSection("Device", drawing=devices(scene), note="Side view, to scale."),
        PageSection("Main result", figures=figures[:1], note=HOW),
        PageSection("Circuit", drawing=draw_circuit(scene), note=NETS),
        PageSection("Further figures", figures=figures[1:]),
        *result_sections(result),
        *energies,
        *(_modes(part, answer) for part, answer in result.get("modes", {}).items()),
        *plan_sections(result["plan"], result.get("convergence", {})),
        PageSection("Simulator", _simulator(result, scene)),
        PageSection("Files", links=result.get("files", ())),
    ]
    title = f"{scene.name}: {scene.title}" if scene.title else scene.name
    return write_page(path, title, LEAD, sections, origin=(f"scene {scene_hash(scene)}",))


def result_sections(result: Mapping[str, Any]) -> list[PageSection]:
    """The numbers of ``result.json``, for the page and for the terminal."""
    rom = result.get("rom", {})
    facts = {k: v for k, v in rom.items() if v is not None and not k.startswith("above_band")}
    attempts = result.get("simulator", {}).get("attempts", ())
    wall = result.get("wall_s", {})
    times = {**wall, "sum": sum(wall.values())} if wall else {}
    checks, tried = [], []
    for item in result.get("checks", ()):
        values = value_and_limit(item["value"], item["limit"], item["unit"])
        mark = "ok" if item["passed"] else "VIOLATED"
        checks.append((mark, _check_name(item), *values, item["action"]))
    for item in attempts if len(attempts) > 1 else ():
        outcome = (
            item["cause"] or "succeeded",
            item["part"] or "",
            format_quantity(item["wall_s"], "s", 3),
        )
        tried.append((item["setting"], item["settings"], *outcome))
    models, units = result.get("model", {}).items(), result.get("model_units", {})
    spent = [(stage, format_quantity(float(seconds), "s", 3)) for stage, seconds in times.items()]
    return [
        PageSection("Metrics", _facts(result.get("metrics", {}), result.get("metric_units", {}))),
        PageSection("Operating point", operating_rows(result), ("result", "value"), LINEARISED),
        PageSection("Physics checks", checks, ("", "check", "value", "limit", "action"), CHECKED),
        *(PageSection(f"Model: {n}", _facts(answer, units.get(n, {}))) for n, answer in models),
        PageSection("Reduced model", [*_facts(facts, {"band_hz": "Hz"}), *above_band_rows(rom)]),
        PageSection("Retries", tried, ("setting", "changes", "outcome", "blamed", "time"), TRIED),
        PageSection("Wall time", spent, ("stage", "time"), "0 s: taken from the cache."),
    ]


def operating_rows(result: Mapping[str, Any], most: int | None = None) -> Rows:
    """Rows of nonzero values at the small-signal operating point, at most ``most``."""
    point = result.get("operating_point", {})
    units = {name: item["unit"] for name, item in point.items()}
    numbers = {name: float(item["value"]) for name, item in point.items()}
    scales = _scales(numbers, units)
    rounded = {name: _chop_rounding(value, scales, units[name]) for name, value in numbers.items()}
    values = {name: value for name, value in rounded.items() if value}
    first = list(values.items())[:most]
    rows: Rows = [(name, format_quantity(value, units[name])) for name, value in first]
    if len(first) < len(values):
        rows.append(("further results", f"{len(values) - len(first)}, in the report"))
    return rows


def _check_name(check: Mapping[str, Any]) -> str:
    name: str = check["name"]
    return name if " " in name else name.replace("_", " ")


def summary_section(result: Mapping[str, Any], most: int | None = None) -> PageSection:
    """The answer of a run: its verdict, its metrics that are single numbers, its error estimates.

    ``most`` is the largest number of metrics.
    """
    units = result.get("metric_units", {})
    errors = result.get("convergence", {}).get("errors", {})
    metrics = {name: v for name, v in leaves(result.get("metrics", {})) if _single(v)}
    rows: Rows = [("checks", verdict_text(result.get("checks", ())))]
    for check in result.get("checks", ()):
        if not check["passed"]:
            value, limit = value_and_limit(check["value"], check["limit"], check["unit"])
            if " " in check["unit"]:  # a phrase stands once in the sentence
                limit = limit.removesuffix(f" {check['unit']}")
            rows.append(("VIOLATED", f"{_check_name(check)}: {value}, limit {limit}"))
    scales = _scales(metrics, units)
    for name, value in list(metrics.items())[:most]:
        error = errors.get(name)
        estimate = "" if error is None else f" (error estimate {100 * error:.2g} %)"
        label, text = _fact(name, value, units, scales)
        rows.append((label, text + estimate))
    if most is not None and len(metrics) > most:
        rows.append(("further metrics", f"{len(metrics) - most}, in the report"))
    rows += [(f"at the operating point: {n}", text) for n, text in operating_rows(result, POINT)]
    return PageSection("Result", [*rows, *_model_errors(result)])


def verdict_text(checks: Sequence[Mapping[str, Any]]) -> str:
    """``17 checks passed``, or how many of them."""
    passed = sum(bool(check["passed"]) for check in checks)
    if passed == len(checks):
        return f"{passed} check{'s' * (passed != 1)} passed"
    return f"{passed} of {len(checks)} checks passed"


def _single(value: Any) -> bool:
    return not isinstance(value, (list, tuple, Mapping))


def _model_errors(result: Mapping[str, Any]) -> Rows:
    """States, band and error estimate of each reduced model."""
    models = (result.get("roms") or {"": result["rom"]}) if result.get("rom") else {}
    rows: Rows = []
    for name, rom in models.items():
        label = f"reduced model {name}".strip()
        text = f"{rom['order']} states"
        if rom.get("error_estimate") is not None and rom.get("band_hz"):
            top = format_quantity(rom["band_hz"][1], "Hz", 3)
            text += f", error estimate {100 * rom['error_estimate']:.2g} % up to {top}"
        rows.append((label, text))
    return rows


def _scales(values: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, float]:
    """Largest magnitude among numbers of one unit."""
    result: dict[str, float] = {}
    for name, value in values.items():
        if isinstance(value, float) and math.isfinite(value):
            unit = units.get(name, "")
            result[unit] = max(result.get(unit, 0.0), abs(value))
    return result


def _chop_rounding(value: Any, scales: Mapping[str, float], unit: str) -> Any:
    """0 for a number that is rounding noise beside others of its unit."""
    noise = isinstance(value, float) and abs(value) < NOISE * scales.get(unit, 0.0)
    return 0.0 if noise else value


def above_band_rows(rom: Mapping[str, Any]) -> Rows:
    """Rows of what a certificate says of the compliance above its band."""
    errors = rom.get("above_band_compliance_error", ())
    return [
        (f"compliance at {f:g} Hz", f"{error:.2g} off, above the band")
        for f, error in zip(rom.get("above_band_hz", ()), errors, strict=True)
    ]


def plan_sections(
    planned: Mapping[str, Any], converged: Mapping[str, Any] | None = None
) -> list[PageSection]:
    """Sections of models, numerical settings and neglected effects.

    Each setting is listed with its effect on the metrics, if a refined run computed it.
    """
    result = converged or {}
    shares = result.get("shares", {})
    rows = [(k, f"{v:g}", shares.get(k, e)) for k, v, e in map(dict.values, planned["settings"])]
    rows += [(f"error of {name}", "", error) for name, error in result.get("errors", {}).items()]
    settings = [(*row, "not estimated" if e is None else f"{e:.2g}") for *row, e in rows]
    parts, omitted = ([[*row.values()] for row in planned[key]] for key in ("parts", "left_out"))
    return [
        PageSection("What is modelled", parts, ("part", "source", "model")),
        PageSection("Numerical settings", settings, ("key", "value", "error"), ESTIMATED),
        PageSection("What is left out", omitted, ("effect", "why", "size")),
    ]


def _facts(facts: Mapping[str, Any], units: Mapping[str, str]) -> Rows:
    """Rows of single numbers, whose ``units`` are by dotted name; curves are in the figures.

    Of lists, only a range and a few words are rows.
    """
    values = {name: value for name, value in leaves(facts) if _single(value) or _is_short(value)}
    scales = _scales(values, units)
    return [_fact(name, value, units, scales) for name, value in values.items()]


def _is_short(values: Sequence[Any]) -> bool:
    words = all(isinstance(value, str) for value in values)
    return len(values) <= (FEW if words else 2)


def _fact(
    name: str, value: Any, units: Mapping[str, str], scales: Mapping[str, float]
) -> tuple[str, str]:
    """Label and text of a number beside others whose largest magnitudes are ``scales``."""
    unit = units.get(name, "")
    return fact(name.replace(".", "_"), _chop_rounding(value, scales, unit), unit)


def _modes(part: str, table: Mapping[str, Any]) -> PageSection:
    """Table of the modes of one body; a port that no mode moves has no column."""
    units, modes = table["units"], table["modes"]
    coupled = [port for port in units if any(mode["couplings"][port] > 0 for mode in modes)]
    rows = []
    for mode in modes:
        moved = (format_quantity(mode["couplings"][port], units[port], 3) for port in coupled)
        rows.append(
            (
                format_quantity(mode["frequency_hz"], "Hz"),
                format_quantity(mode["quality"], "", 4),
                *moved,
            )
        )
    head = ("frequency", "Q", *(port if units[port] else f"k of {port}" for port in coupled))
    return PageSection(f"Modes: {part}", rows, head, MODES)


def _simulator(result: Mapping[str, Any], scene: Scene) -> Rows:
    rows: Rows = [(k, str(v)) for k, v in result.get("simulator", {}).items() if k != "attempts"]
    if scene.analysis.type != "transient":
        return [*rows, ("analysis", scene.analysis.type)]
    solver, step = scene.solver, result.get("largest_step")
    return [
        *rows,
        *((f"{k} time points", format_value(v, "")) for k, v in result.get("steps", {}).items()),
        ("reltol", f"{solver.reltol:g}"),
        ("method", solver.method),
        (
            "largest step",
            f"{format_quantity(step['s'], 's')}: {step['why']}" if step else "unknown",
        ),
        ("stop", format_quantity(scene.stop, "s")),
    ]


# --- figures ----------------------------------------------------------------------------------


def probe_figures(
    probes: Mapping[str, Probe], waves: Waveforms, units: Mapping[str, str]
) -> Iterator[Figure]:
    """One figure with a panel for each unit; responses by their magnitude.

    A mark stands where a probe takes its largest value, a level where it waits for a crossing.
    """
    scale = next(iter(waves.data))
    x = waves[scale].real
    if not probes or x.size < 2:
        return
    label, factor = scale_axis(scale, x)
    log = scale == "frequency" and bool(x[0] > 0 and x[-1] / x[0] > WIDE)
    panels = []
    for unit in dict.fromkeys(units.get(probe.of, "") for probe in probes.values()):
        panel_probes = {
            n: p for n, p in probes.items() if units.get(p.of, "") == unit and p.of in waves
        }
        complex_ = any(np.iscomplexobj(waves[p.of]) for p in panel_probes.values())
        curves_by_result = {
            p.of: np.abs(waves[p.of]) if complex_ else waves[p.of] for p in panel_probes.values()
        }
        size = "magnitude" if complex_ else "value"
        places = {
            n: float(x[curves_by_result[p.of].argmax()] if p.at is None else p.at)
            for n, p in panel_probes.items()
            if p.take in ("argmax", "value")
        }
        look: dict[str, Any] = {
            "levels": tuple((p.level, n) for n, p in panel_probes.items() if p.level is not None),
            "marks": tuple((factor * place, n) for n, place in places.items()),
            "log_x": log,
            "log_y": complex_ and all((v != 0).all() for v in curves_by_result.values()),
        }
        curves = tuple(Curve(of, factor * x, values) for of, values in curves_by_result.items())
        panels.append(Panel(label, f"{size} in {unit}" if unit else size, curves, **look))
    if panels:
        caption = "What the scene's probes look at, over the whole run."
        yield Figure("probes", "Probed results", caption, tuple(panels), main=True)
