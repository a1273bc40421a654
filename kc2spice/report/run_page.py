"""``report.html`` of a run: figures, metrics, checks with wall times, model facts, omissions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel, scale_axis
from kc2spice.core.waveforms import Waveforms
from kc2spice.report.html import Section, write_page
from kc2spice.report.sketch import circuit, devices
from kc2spice.report.words import check_name, fact, flat, quantity, worded
from kc2spice.scene.model import Probe, Scene
from kc2spice.scene.plan import plan

WIDE = 20.0  # a range of frequencies beyond this ratio has a logarithmic axis
NETS = (
    "Pins by what they carry: blue electrical, orange mechanical, green signals. The names of the "
    "nets are those of the netlist."
)
HOW = (
    "Move the pointer to read values, drag to look closer, double-click to see all; click a name "
    "of a legend to hide its curve."
)


def write_run(
    path: Path, result: Mapping[str, Any], scene: Scene, figures: Sequence[Figure]
) -> Path:
    """Write the page of ``kc2spice run`` from ``result.json``'s content: what it is, what it did,
    then the numbers."""
    planned = plan(scene)
    sections = [
        Section("Device", drawing=devices(scene), note="Side view, to scale."),
        Section("Circuit", drawing=circuit(scene), note=NETS),
        Section("Figures", figures=figures, note=HOW),
        _facts("Metrics", result.get("metrics", {}), result.get("metric_units", {})),
        _checks(result),
        *(
            Section(f"Energy: {name}", [(entry, quantity(v, "J")) for entry, v in entries.items()])
            for name, entries in result.get("energy_j", {}).items()
        ),
        *(_facts(f"Model: {part}", facts) for part, facts in result.get("model", {}).items()),
        _facts("Reduced model", {k: v for k, v in result.get("rom", {}).items() if v is not None}),
        *(_modes(part, found) for part, found in result.get("modes", {}).items()),
        Section(
            "What is modelled",
            [(part.part, part.source, part.detail) for part in planned.parts],
            ("part", "source", "model"),
        ),
        _settings(scene, result),
        Section(
            "What is left out",
            [(item.effect, item.why, item.error) for item in planned.left_out],
            ("effect", "why", "size"),
        ),
        _simulator(result, scene),
        _attempts(result),
        _wall(result),
        Section("Files", links=result.get("files", ())),
    ]
    kept = [s for s in sections if s.rows or s.figures or s.drawing or s.links]
    title = f"{scene.name}: {scene.title}" if scene.title else scene.name
    lead = "Finite-element models, reduced, exported as a netlist and run in ngspice."
    return write_page(path, title, lead, kept)


def _facts(title: str, facts: Mapping[str, Any], units: Mapping[str, str] | None = None) -> Section:
    rows = [fact(k, v, unit=(units or {}).get(k, "")) for k, v in flat(facts).items()]
    return Section(title, rows)


def _modes(part: str, found: Mapping[str, Any]) -> Section:
    """Of one body; a port that no mode moves has no column."""
    units, modes = found["units"], found["modes"]
    seen = [port for port in units if any(mode["couplings"][port] > 0 for mode in modes)]
    rows = [
        (
            quantity(mode["frequency_hz"], "Hz"),
            quantity(mode["quality"], "", 4),
            *(quantity(mode["couplings"][port], units[port], 3) for port in seen),
        )
        for mode in modes
    ]
    head = ("frequency", "Q", *(port if units[port] else f"k of {port}" for port in seen))
    note = (
        "Of the reduced model within its band, electrodes shorted, nothing pressing on it. k is "
        "the effective coupling factor; at other ports stands what the mode adds to the static "
        "answer."
    )
    return Section(f"Modes: {part}", rows, head, note)


def _checks(result: Mapping[str, Any]) -> Section:
    rows = [
        (
            "ok" if check["passed"] else "VIOLATED",
            check_name(check["name"]),
            f"{check['value']:.3g} {check['unit']}",
            f"{check['limit']:.3g}",
            check["action"],
        )
        for check in result.get("checks", ())
    ]
    note = "Physics that the simulator was not told; the last column is what a violation does."
    return Section("Physics checks", rows, ("", "check", "value", "limit", "action"), note)


def _attempts(result: Mapping[str, Any]) -> Section:
    rows = [
        (
            attempt["setting"],
            attempt["settings"],
            attempt["cause"] or "succeeded",
            attempt["part"] or "",
            quantity(attempt["wall_s"], "s", 3),
        )
        for attempt in result.get("simulator", {}).get("attempts", ())
    ]
    head = ("setting", "changes", "outcome", "blamed", "time")
    note = "Every setting that was tried; the last one gave this result."
    return Section("Retries", rows if len(rows) > 1 else [], head, note)


def _wall(result: Mapping[str, Any]) -> Section:
    stages = result.get("wall_s", {})
    rows = [(stage, quantity(float(seconds), "s", 3)) for stage, seconds in stages.items()]
    if rows:
        rows.append(("sum", quantity(float(sum(stages.values())), "s", 3)))
    return Section("Wall time", rows, ("stage", "time"), "0 s: taken from the cache.")


def _simulator(result: Mapping[str, Any], scene: Scene) -> Section:
    rows = [(k, str(v)) for k, v in result.get("simulator", {}).items() if k != "attempts"]
    if scene.analysis.type != "transient":
        return Section("Simulator", [*rows, ("analysis", scene.analysis.type)])
    solver = scene.solver
    rows += [(f"{k} time points", worded(v, "")) for k, v in result.get("steps", {}).items()]
    step = result.get("largest_step")
    rows += [
        ("reltol", f"{solver.reltol:g}"),
        ("method", solver.method),
        ("largest step", f"{quantity(step['s'], 's')}: {step['why']}" if step else "unknown"),
        ("stop", quantity(scene.stop, "s")),
    ]
    return Section("Simulator", rows)


def _settings(scene: Scene, result: Mapping[str, Any]) -> Section:
    """Numerical settings, and what a refined run says that each does to the metrics."""
    found = result.get("convergence", {})
    rows = [
        (each.key, f"{each.value:g}", _error(found.get("shares", {}).get(each.key, each.error)))
        for each in plan(scene).settings
    ]
    rows += [(f"error of {name}", "", _error(e)) for name, e in found.get("errors", {}).items()]
    note = "Relative errors; a run with error_budget estimates those of all metrics."
    return Section("Numerical settings", rows, ("key", "value", "error"), note)


def _error(value: float | None) -> str:
    return "not estimated" if value is None else f"{value:.2g}"


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
        own = {n: p for n, p in probes.items() if units.get(p.of, "") == unit and p.of in waves}
        shown = {p.of: waves[p.of] for p in own.values()}
        complex_ = any(np.iscomplexobj(v) for v in shown.values())
        if complex_:
            shown = {of: np.abs(values) for of, values in shown.items()}
        size = "magnitude" if complex_ else "value"
        panels.append(
            Panel(
                label,
                f"{size} in {unit}" if unit else size,
                tuple(Curve(of, factor * x, values) for of, values in shown.items()),
                levels=tuple((p.level, n) for n, p in own.items() if p.level is not None),
                marks=tuple(
                    (factor * _place(p, x, shown[p.of]), n)
                    for n, p in own.items()
                    if p.take in ("argmax", "value")
                ),
                log_x=log,
                log_y=complex_ and all((v != 0).all() for v in shown.values()),
            )
        )
    if panels:
        caption = "What the scene's probes look at, over the whole run."
        yield Figure("probes", "Probed results", caption, tuple(panels))


def _place(probe: Probe, x: np.ndarray, values: np.ndarray) -> float:
    return float(x[values.argmax()] if probe.at is None else probe.at)
