"""Writer of the page ``verify.html`` with the results of verified scenes.

The results are checks, errors, wall times and metrics.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel, format_axis_label, get_axis_label_and_factor
from kc2spice.core.si_prefix_format import (
    format_ratio,
    format_value_and_limit,
    remove_unit_words,
)
from kc2spice.core.waveforms import Waveforms
from kc2spice.report.html import PageSection, format_metric, format_times, write_page
from kc2spice.report.run_page import format_verdict
from kc2spice.scene.checks import SOLUTION_PAIRS, Check

VERDICT_WORDS = {True: "ok", False: "MISSED"}
MAX_PANELS = 4  # largest number of panels in one figure
SMALLEST_DIFFERENCE = 1e-17  # replaces a difference of zero on the logarithmic axis

Solutions = Mapping[str, Waveforms]


@dataclass
class VerificationResult:
    """Checks, errors, metrics and figures of the verification of a scene.

    ``errors`` contains the largest relative difference of each pair of solutions in
    :data:`kc2spice.scene.checks.SOLUTION_PAIRS`. ``wall_s`` contains the wall time of each stage.
    ``left_out`` contains the names of parts without equations. ``answers`` contains the metrics of
    the solutions ``ngspice``, ``rom`` and ``fom``. The solutions ``rom`` and ``fom`` solve the
    equations of the parts with reduced and with full models. The solution ``fom`` covers only the
    compared part of the run.
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
        """Whether all checks of the scene passed."""
        return all(map(attrgetter("passed"), self.checks))

    def make_record(self) -> dict[str, Any]:
        """Return the results as a mapping for ``verify.json``."""
        result = {"passed": self.passed, **vars(self)}
        del result["figures"], result["units"]
        result["checks"] = list(map(Check.make_record, self.checks))
        result["outputs"] = list(map(asdict, self.outputs))
        return result


def write_verify(path: Path, findings_by_scene: Mapping[str, VerificationResult]) -> Path:
    """Write the page of the verification results to ``path``; return the path.

    ``findings_by_scene`` contains the results of each scene, keyed by the name of the scene.
    """
    rows = list(map(_make_summary_row, findings_by_scene, findings_by_scene.values()))
    head = ("scene", "checks", "reduced − full", "ngspice − reduced", "ngspice − full")
    sections = [PageSection("Summary", rows, head, "Errors are maximum relative errors.")]
    for scene, findings in findings_by_scene.items():
        sections += format_verification(scene, findings.make_record())
        sections += _format_details(scene, findings)
    lead = (
        "Comparison of the full model, the reduced model and the ngspice solution of its netlist."
    )
    return write_page(path, "Verification", lead, sections)


def _make_summary_row(scene: str, findings: VerificationResult) -> tuple[str, ...]:
    """Return the table row of a scene: verdict and differences between solutions."""
    errors = map(format_ratio, map(findings.errors.get, SOLUTION_PAIRS))
    return scene, VERDICT_WORDS[findings.passed], *errors


def format_verification(scene: str, record: Mapping[str, Any]) -> list[PageSection]:
    """Return checks and wall times of a scene as sections for a page or the terminal.

    ``record`` is the content of ``verify.json`` for the scene.
    """
    checks = list(map(_make_check_row, record["checks"]))
    times, verdict = format_times(record["wall_s"]), format_verdict(record["checks"])
    return [
        PageSection(f"{scene}: checks, {verdict}", checks, ("", "check", "value", "limit")),
        PageSection(f"{scene}: time", times, ("stage", "wall time")),
    ]


def _make_check_row(check: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the table row of a check: verdict, label, value and limit.

    A dash replaces a value that is not a number.
    """
    unit, value = remove_unit_words(check["unit"]), check["value"]
    is_missing = value is None or np.isnan(value)
    text, limit = format_value_and_limit(0.0 if is_missing else value, check["limit"], unit)
    return VERDICT_WORDS[check["passed"]], check["label"], "—" if is_missing else text, limit


def _format_details(scene: str, findings: VerificationResult) -> list[PageSection]:
    """Return page sections of a scene: errors of outputs, metrics, notes, figures."""
    head = ("solutions", "output", "largest error", "rms error")
    errors, facts = [], []
    for error in findings.outputs:
        pair = error.pair.replace("_vs_", " versus ")
        sizes = map(format_ratio, (error.largest, error.rms))
        errors.append((pair, error.output, *sizes))
    for name, value in findings.metrics.items():
        if not isinstance(value, Mapping):
            facts.append(format_metric(name, value, findings.units.get(name, "")))
    return [
        PageSection(f"{scene}: each output", errors, head),
        PageSection(f"{scene}: results", facts, note=" ".join(findings.notes)),
        PageSection(f"{scene}: figures", figures=findings.figures),
    ]


# --- figures of the solutions and of their differences --------------------------------------------


def plot_comparison(
    name: str, title: str, solutions: Solutions, units: Mapping[str, str]
) -> Iterator[Figure]:
    """Plot the waveforms of all solutions, and differences from the first solution.

    Each panel of the first figure belongs to one unit, and shows the waveform with the largest
    magnitude in this unit. The second figure shows the differences of the same waveforms between
    the first solution and each other solution.
    """
    (first, exact), *others = solutions.items()
    scale = next(iter(exact))
    label, factor = get_axis_label_and_factor(scale, exact[scale].real)
    common = set.intersection(*map(set, solutions.values())) - {scale}
    selected = _find_largest_wave_names(filter(common.__contains__, exact), exact, units)
    if not selected or np.ptp(exact[scale]) == 0:
        return
    panels = []
    for wave in selected:
        curves = tuple(
            Curve(n, factor * w[scale].real, _convert_to_real(w[wave]), "-" if k else "reference")
            for k, (n, w) in enumerate(solutions.items())
        )
        panels.append(Panel(label, format_axis_label(wave, units.get(wave, "")), curves))
    over, caption = f"{title}: comparison of solutions", f"Reference (dotted): {first}."
    yield Figure(f"{name}_solutions", over, caption, tuple(panels))
    x = factor * exact[scale].real
    errors = []
    for n, waves in others:
        for wave in selected:
            difference = _compute_relative_difference(waves, exact, scale, wave)
            errors.append(Curve(f"{n}, {wave}", x, np.maximum(difference, SMALLEST_DIFFERENCE)))
    panel = Panel(label, f"difference from {first} / peak value", tuple(errors), log_y=True)
    caption = f"Differences from {first}, each divided by the peak value of the waveform."
    yield Figure(f"{name}_differences", f"{title}: differences", caption, (panel,))


def plot_port_responses(name: str, curves: Solutions) -> Iterator[Figure]:
    """Plot the response of each port of a body to a load on the same port.

    ``curves`` contains the responses of each model, keyed by the label of the model.
    """
    last = list(curves.values())[-1]
    pairs = list(filter(_is_driving_point, last))[:MAX_PANELS]
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
        title = f"{name}: response of the generated subcircuit"
        caption = (
            "Response of each port to a unit load at the same port; points: direct solutions of "
            "the full model."
        )
        yield Figure(f"{name}_response", title, caption, tuple(panels))


def _is_driving_point(response: str) -> bool:
    """Return whether the load and the output of a response are at the same port.

    The name of the response is ``LOAD>PORT``.
    """
    load, _, port = response.partition(">")
    return load == port


def _find_largest_wave_names(
    names: Iterable[str], waves: Waveforms, units: Mapping[str, str]
) -> list[str]:
    """Find the name of the waveform with the largest magnitude, for each unit.

    At most ``MAX_PANELS`` units are selected. The order is the order in which the units first occur
    in ``names``.
    """
    best: dict[str, str] = {}
    for name in names:
        unit = units.get(name, "")
        size = np.abs(waves[name]).max(initial=0.0)
        if size > 0 and (unit not in best or size > np.abs(waves[best[unit]]).max()):
            best[unit] = name
    return list(best.values())[:MAX_PANELS]


def _convert_to_real(values: np.ndarray) -> np.ndarray:
    """Return an array of real values unchanged, or the magnitudes of complex values."""
    return np.abs(values) if np.iscomplexobj(values) else values


def _compute_relative_difference(
    waves: Waveforms, exact: Waveforms, scale: str, name: str
) -> np.ndarray:
    """Return the relative difference of a waveform between two solutions.

    The difference is relative to the largest value of the wave ``name`` in the solution ``exact``.
    The returned array has a value for each point of ``exact``.
    """
    values, y = waves[name], exact[name]
    if values.shape != y.shape or scale == "time":
        t, unique = np.unique(waves[scale].real, return_index=True)
        values = np.interp(exact[scale].real, t, values[unique])
    return np.abs(values - y) / np.abs(y).max()
