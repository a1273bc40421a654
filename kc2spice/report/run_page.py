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
from kc2spice.report.words import fact, leaves, quantity, worded
from kc2spice.scene.model import Probe, Scene

WIDE = 20.0  # a range of frequencies beyond this ratio has a logarithmic axis
LEAD = "Finite-element models, reduced, exported as a netlist and run in ngspice."
NETS = (
    "Pins by what they carry: blue electrical, orange mechanical, green signals. The names of the "
    "nets are those of the netlist."
)
HOW = (
    "Move the pointer to read values, drag to look closer, double-click to see all; click a name "
    "of a legend to hide its curve."
)
CHECKED = "Physics that the simulator was not told; the last column is what a violation does."
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
    sections = [
        Section("Device", drawing=devices(scene), note="Side view, to scale."),
        Section("Circuit", drawing=circuit(scene), note=NETS),
        Section("Figures", figures=figures, note=HOW),
        *result_sections(result),
        *(
            Section(f"Energy: {name}", [(entry, quantity(v, "J")) for entry, v in entries.items()])
            for name, entries in result.get("energy_j", {}).items()
        ),
        *(_modes(part, found) for part, found in result.get("modes", {}).items()),
        *plan_sections(result["plan"], result.get("convergence", {})),
        Section("Simulator", _simulator(result, scene)),
        Section("Files", links=result.get("files", ())),
    ]
    title = f"{scene.name}: {scene.title}" if scene.title else scene.name
    return write_page(path, title, LEAD, sections)


def result_sections(result: Mapping[str, Any]) -> list[Section]:
    """The numbers of ``result.json``, for the page and for the terminal."""
    rom = result.get("rom", {})
    facts = {k: v for k, v in rom.items() if v is not None and not k.startswith("above_band")}
    attempts = result.get("simulator", {}).get("attempts", ())
    wall = result.get("wall_s", {})
    times = {**wall, "sum": sum(wall.values())} if wall else {}
    return [
        Section("Metrics", _facts(result.get("metrics", {}), result.get("metric_units", {}))),
        Section(
            "Physics checks",
            [
                (
                    "ok" if check["passed"] else "VIOLATED",
                    check["name"] if " " in check["name"] else check["name"].replace("_", " "),
                    f"{check['value']:.3g} {check['unit']}",
                    f"{check['limit']:.3g}",
                    check["action"],
                )
                for check in result.get("checks", ())
            ],
            ("", "check", "value", "limit", "action"),
            CHECKED,
        ),
        *(
            Section(f"Model: {part}", _facts(found))
            for part, found in result.get("model", {}).items()
        ),
        Section("Reduced model", [*_facts(facts), *above_band(rom)]),
        Section(
            "Retries",
            [
                (
                    attempt["setting"],
                    attempt["settings"],
                    attempt["cause"] or "succeeded",
                    attempt["part"] or "",
                    quantity(attempt["wall_s"], "s", 3),
                )
                for attempt in (attempts if len(attempts) > 1 else ())
            ],
            ("setting", "changes", "outcome", "blamed", "time"),
            TRIED,
        ),
        Section(
            "Wall time",
            [(stage, quantity(float(seconds), "s", 3)) for stage, seconds in times.items()],
            ("stage", "time"),
            "0 s: taken from the cache.",
        ),
    ]


def above_band(rom: Mapping[str, Any]) -> Rows:
    """Rows of what a certificate says of the compliance above its band."""
    errors = rom.get("above_band_compliance_error", ())
    return [
        (f"compliance at {f:g} Hz", f"{error:.2g} off, above the band")
        for f, error in zip(rom.get("above_band_hz", ()), errors, strict=True)
    ]


def plan_sections(
    planned: Mapping[str, Any], converged: Mapping[str, Any] | None = None
) -> list[Section]:
    """What is modelled, its numerical settings with what a refined run says that each does to the
    metrics, what is left out."""
    found = converged or {}
    shares = found.get("shares", {})
    settings = [
        (k, f"{v:g}", shares.get(k, e)) for k, v, e in map(dict.values, planned["settings"])
    ]
    settings += [(f"error of {name}", "", error) for name, error in found.get("errors", {}).items()]
    return [
        Section(
            "What is modelled",
            [tuple(part.values()) for part in planned["parts"]],
            ("part", "source", "model"),
        ),
        Section(
            "Numerical settings",
            [
                (key, value, "not estimated" if error is None else f"{error:.2g}")
                for key, value, error in settings
            ],
            ("key", "value", "error"),
            ESTIMATED,
        ),
        Section(
            "What is left out",
            [tuple(each.values()) for each in planned["left_out"]],
            ("effect", "why", "size"),
        ),
    ]


def _facts(facts: Mapping[str, Any], units: Mapping[str, str] | None = None) -> Rows:
    return [fact(k, v, unit=(units or {}).get(k, "")) for k, v in leaves(facts, "_")]


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
    return Section(f"Modes: {part}", rows, head, MODES)


def _simulator(result: Mapping[str, Any], scene: Scene) -> Rows:
    rows: Rows = [(k, str(v)) for k, v in result.get("simulator", {}).items() if k != "attempts"]
    if scene.analysis.type != "transient":
        return [*rows, ("analysis", scene.analysis.type)]
    solver, step = scene.solver, result.get("largest_step")
    return [
        *rows,
        *((f"{k} time points", worded(v, "")) for k, v in result.get("steps", {}).items()),
        ("reltol", f"{solver.reltol:g}"),
        ("method", solver.method),
        ("largest step", f"{quantity(step['s'], 's')}: {step['why']}" if step else "unknown"),
        ("stop", quantity(scene.stop, "s")),
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
        own = {n: p for n, p in probes.items() if units.get(p.of, "") == unit and p.of in waves}
        complex_ = any(np.iscomplexobj(waves[p.of]) for p in own.values())
        shown = {p.of: np.abs(waves[p.of]) if complex_ else waves[p.of] for p in own.values()}
        size = "magnitude" if complex_ else "value"
        marked = [(n, p) for n, p in own.items() if p.take in ("argmax", "value")]
        panels.append(
            Panel(
                label,
                f"{size} in {unit}" if unit else size,
                tuple(Curve(of, factor * x, values) for of, values in shown.items()),
                levels=tuple((p.level, n) for n, p in own.items() if p.level is not None),
                marks=tuple((factor * _place(p, x, shown[p.of]), n) for n, p in marked),
                log_x=log,
                log_y=complex_ and all((v != 0).all() for v in shown.values()),
            )
        )
    if panels:
        caption = "What the scene's probes look at, over the whole run."
        yield Figure("probes", "Probed results", caption, tuple(panels))


def _place(probe: Probe, x: np.ndarray, values: np.ndarray) -> float:
    return float(x[values.argmax()] if probe.at is None else probe.at)
