"""``verify.html``: every scene's checks, errors, times and figures on one page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel, scale_axis
from kc2spice.core.waveforms import Waveforms
from kc2spice.report.html import Section, write_page
from kc2spice.report.words import fact, quantity
from kc2spice.scene.judge import PAIRS, Check

MET = {True: "ok", False: "MISSED"}
MOST = 4  # panels of one figure
FLOOR = 1e-17  # a difference of nothing, on a logarithmic axis

Solutions = Mapping[str, Waveforms]


@dataclass
class Findings:
    """What one scene's verification has found.

    ``errors`` has those of :data:`kc2spice.scene.judge.PAIRS` (largest relative), ``wall_s`` the
    time of each stage; ``left_out`` names the parts without a law. ``answers`` has the metrics of
    each solution: ``ngspice``, ``rom`` (laws) and ``fom`` (with full models, as far as followed).
    """

    checks: list[Check] = field(default_factory=list)
    errors: dict[str, float] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)
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
        """Of ``verify.json``."""
        found = {key: value for key, value in vars(self).items() if key != "figures"}
        checks = [check.record() for check in self.checks]
        outputs = [asdict(output) for output in self.outputs]
        return {"passed": self.passed, **found, "checks": checks, "outputs": outputs}


def write_verify(path: Path, found: Mapping[str, Findings]) -> Path:
    """Write the page for the findings of each scene, by its name."""
    rows = [
        (
            scene,
            MET[findings.passed],
            *(quantity(findings.errors.get(pair), "", 2) for pair in PAIRS),
        )
        for scene, findings in found.items()
    ]
    head = ("scene", "gates", "reduced − full", "ngspice − reduced", "ngspice − full")
    sections = [Section("Summary", rows, head, "Errors are the largest relative ones.")]
    for scene, findings in found.items():
        sections += [*verdict_sections(scene, findings.record()), *_details(scene, findings)]
    lead = "Full model, reduced model and ngspice on the emitted netlist, against each other."
    return write_page(path, "Verification", lead, sections)


def verdict_sections(scene: str, record: Mapping[str, Any]) -> list[Section]:
    """Gates and times of one scene's record, for the page and for the terminal."""
    checks = [
        (MET[c["passed"]], c["name"], *(_with_unit(c[k], c["unit"]) for k in ("value", "limit")))
        for c in record["checks"]
    ]
    times = [(stage, quantity(time, "s", 3)) for stage, time in record["wall_s"].items()]
    return [
        Section(f"{scene}: gates", checks, ("", "check", "value", "limit")),
        Section(f"{scene}: time", times, ("stage", "wall time")),
    ]


def _details(scene: str, findings: Findings) -> list[Section]:
    outputs = [
        (e.pair.replace("_vs_", " to "), e.output, f"{e.largest:.2g}", f"{e.rms:.2g}")
        for e in findings.outputs
    ]
    numbers = {k: v for k, v in findings.metrics.items() if not isinstance(v, Mapping)}
    head = ("solutions", "output", "largest error", "rms error")
    facts, notes = [fact(key, value) for key, value in numbers.items()], " ".join(findings.notes)
    return [
        Section(f"{scene}: each output", outputs, head),
        Section(f"{scene}: results", facts, note=notes),
        Section(f"{scene}: figures", figures=findings.figures),
    ]


def _with_unit(value: float | None, unit: str) -> str:
    reached = None if value is None or np.isnan(value) else value
    return quantity(reached, "" if unit == "1" else unit, 3)


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
    chosen = _largest(common, exact, units)
    if not chosen or np.ptp(exact[scale]) == 0:
        return
    panels = []
    for wave in chosen:
        curves = tuple(
            Curve(n, factor * w[scale].real, _size(w[wave]), "-" if k else "reference")
            for k, (n, w) in enumerate(solutions.items())
        )
        unit = units.get(wave, "")
        panels.append(Panel(label, f"{wave} in {unit}" if unit else wave, curves))
    yield Figure(
        f"{name}_solutions",
        f"{title}: solutions over each other",
        f"Reference (dotted): {first}.",
        tuple(panels),
    )
    x = exact[scale].real
    errors = tuple(
        Curve(f"{n}, {wave}", factor * x, np.maximum(_difference(w, exact, scale, wave), FLOOR))
        for n, w in others
        for wave in chosen
    )
    yield Figure(
        f"{name}_differences",
        f"{title}: differences",
        f"Differences to {first}, each over the wave's largest value.",
        (Panel(label, f"difference to {first} / largest value", errors, log_y=True),),
    )


def responses(name: str, curves: Solutions) -> Iterator[Figure]:
    """Responses of one body port by port to itself, every solution of it."""
    last = list(curves.values())[-1]
    pairs = [n for n in last if ">" in n and len({*n.split(">")}) == 1][:MOST]
    end = float(last["frequency"].real[-1]) / 1e3
    panels = []
    for pair in pairs:
        lines = tuple(
            Curve(
                label,
                waves["frequency"].real / 1e3,
                np.abs(waves[pair]),
                "o" if waves["frequency"].size < 60 and len(curves) > 1 else "-",
            )
            for label, waves in curves.items()
        )
        panels.append(Panel("frequency in kHz", f"|{pair}|", lines, span=(0.0, end), log_y=True))
    if panels:
        yield Figure(
            f"{name}_response",
            f"{name}: response of the emitted subcircuit",
            "Each port's answer to a unit load on itself; points are direct solutions of the full "
            "model.",
            tuple(panels),
        )


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
