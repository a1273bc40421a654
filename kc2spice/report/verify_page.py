"""``verify.html``: checks, errors, wall times and metrics of every verified scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel, scale_axis
from kc2spice.core.waveforms import Waveforms
from kc2spice.report.html import (
    PageSection,
    fact,
    format_quantity,
    value_and_limit,
    write_page,
)
from kc2spice.scene.checks import PAIRS, Check

MET = {True: "ok", False: "MISSED"}
MOST = 4  # panels of one figure
FLOOR = 1e-17  # a difference of nothing, on a logarithmic axis

Solutions = Mapping[str, Waveforms]


@dataclass
class Findings:
    """Results of the verification of one scene.

    ``errors`` has those of :data:`kc2spice.scene.checks.PAIRS` (largest relative), ``wall_s`` the
    time of each stage; ``left_out`` names the parts without a law. ``answers`` has the metrics of
    each solution: ``ngspice``, ``rom`` (laws) and ``fom`` (with full models, as far as followed).
    """

    checks: list[Check] = field(default_factory=list)
    errors: dict[str, float] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    answers: dict[str, Mapping[str, Any]] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    outputs: list[Any] = field(default_factory=list)
    wall_s: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        """Whether every check is."""
        return all(check.passed for check in self.checks)

    def record(self) -> dict[str, Any]:
        """Record for ``verify.json``."""
        result = {
            key: value for key, value in vars(self).items() if key not in ("figures", "units")
        }
        checks = [check.record() for check in self.checks]
        outputs = list(map(asdict, self.outputs))
        return {"passed": self.passed, **result, "checks": checks, "outputs": outputs}


def write_verify(path: Path, findings_by_scene: Mapping[str, Findings]) -> Path:
    """Write the page for the findings of each scene, by its name."""
    rows = [
        (
            scene,
            MET[item.passed],
            *(format_quantity(item.errors.get(pair), "", 2) for pair in PAIRS),
        )
        for scene, item in findings_by_scene.items()
    ]
    head = ("scene", "gates", "reduced − full", "ngspice − reduced", "ngspice − full")
    sections = [PageSection("Summary", rows, head, "Errors are the largest relative ones.")]
    for scene, findings in findings_by_scene.items():
        sections += [*verdict_sections(scene, findings.record()), *_details(scene, findings)]
    lead = "Full model, reduced model and ngspice on the emitted netlist, against each other."
    return write_page(path, "Verification", lead, sections)


def verdict_sections(scene: str, record: Mapping[str, Any]) -> list[PageSection]:
    """Gates and times of one scene's record, for the page and for the terminal."""
    checks = []
    for check in record["checks"]:
        unit = "" if check["unit"] == "1" else check["unit"]
        value, limit = (
            None if v is None or np.isnan(v) else v for v in (check["value"], check["limit"])
        )
        if value is None or limit is None:
            texts = format_quantity(value, unit, 3), format_quantity(limit, unit, 3)
        else:
            texts = value_and_limit(value, limit, unit)
        checks.append((MET[check["passed"]], check["name"], *texts))
    times = [(stage, format_quantity(time, "s", 3)) for stage, time in record["wall_s"].items()]
    return [
        PageSection(f"{scene}: gates", checks, ("", "check", "value", "limit")),
        PageSection(f"{scene}: time", times, ("stage", "wall time")),
    ]


def _details(scene: str, findings: Findings) -> list[PageSection]:
    outputs = [
        (e.pair.replace("_vs_", " to "), e.output, f"{e.largest:.2g}", f"{e.rms:.2g}")
        for e in findings.outputs
    ]
    numbers = {k: v for k, v in findings.metrics.items() if not isinstance(v, Mapping)}
    head = ("solutions", "output", "largest error", "rms error")
    facts, notes = (
        [fact(k, v, findings.units.get(k, "")) for k, v in numbers.items()],
        " ".join(findings.notes),
    )
    return [
        PageSection(f"{scene}: each output", outputs, head),
        PageSection(f"{scene}: results", facts, note=notes),
        PageSection(f"{scene}: figures", figures=findings.figures),
    ]


# --- figures: solutions over each other, and their differences ----------------------------------


def comparison(
    name: str, title: str, solutions: Solutions, units: Mapping[str, str]
) -> Iterator[Figure]:
    """The waves that all solutions have, the first one as the reference, with their differences.

    One panel for each of the largest waves of a unit, one for the differences of all of these.
    """
    (first, exact), *others = solutions.items()
    scale = next(iter(exact))
    label, factor = scale_axis(scale, exact[scale].real)
    common = [n for n in exact if n != scale and all(n in w for _, w in others)]
    selected = _largest(common, exact, units)
    if not selected or np.ptp(exact[scale]) == 0:
        return
    panels = []
    for wave in selected:
        curves = tuple(
            Curve(n, factor * w[scale].real, _size(w[wave]), "-" if k else "reference")
            for k, (n, w) in enumerate(solutions.items())
        )
        unit = units.get(wave, "")
        panels.append(Panel(label, f"{wave} in {unit}" if unit else wave, curves))
    over, caption = f"{title}: solutions over each other", f"Reference (dotted): {first}."
    yield Figure(f"{name}_solutions", over, caption, tuple(panels))
    x = exact[scale].real
    errors = tuple(
        Curve(f"{n}, {wave}", factor * x, np.maximum(_difference(w, exact, scale, wave), FLOOR))
        for n, w in others
        for wave in selected
    )
    panel = Panel(label, f"difference to {first} / largest value", errors, log_y=True)
    caption = f"Differences to {first}, each over the wave's largest value."
    yield Figure(f"{name}_differences", f"{title}: differences", caption, (panel,))


def responses(name: str, curves: Solutions) -> Iterator[Figure]:
    """Responses of one body port by port to itself, every solution of it."""
    last = list(curves.values())[-1]
    pairs = [n for n in last if ">" in n and len({*n.split(">")}) == 1][:MOST]
    end = float(last["frequency"].real[-1]) / 1e3
    panels = []
    for pair in pairs:
        lines = []
        for label, waves in curves.items():
            f = waves["frequency"].real / 1e3
            style = "o" if f.size < 60 and len(curves) > 1 else "-"
            lines.append(Curve(label, f, np.abs(waves[pair]), style))
        look: Any = {"span": (0.0, end), "log_y": True}
        panels.append(Panel("frequency in kHz", f"|{pair}|", tuple(lines), **look))
    if panels:
        title = f"{name}: response of the emitted subcircuit"
        caption = "Each port's answer to a unit load on itself; points are direct solutions of the "
        yield Figure(f"{name}_response", title, f"{caption}full model.", tuple(panels))


def _largest(names: list[str], waves: Waveforms, units: Mapping[str, str]) -> list[str]:
    """The largest wave of each unit, in order."""
    best: dict[str, str] = {}
    for name in names:
        unit = units.get(name, "")
        size = np.abs(waves[name]).max(initial=0.0)
        if size > 0 and (unit not in best or size > np.abs(waves[best[unit]]).max()):
            best[unit] = name
    return list(best.values())[:MOST]


def _size(values: np.ndarray) -> np.ndarray:
    return np.abs(values) if np.iscomplexobj(values) else values


def _difference(waves: Waveforms, exact: Waveforms, scale: str, name: str) -> np.ndarray:
    """At the points of ``exact``, over its largest value."""
    ours, y = waves[name], exact[name]
    if ours.shape != y.shape or scale == "time":
        t, unique = np.unique(waves[scale].real, return_index=True)
        ours = np.interp(exact[scale].real, t, ours[unique])
    return np.abs(ours - y) / np.abs(y).max()
