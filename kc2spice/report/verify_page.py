"""``verify.html``: every scene's checks, errors, times and figures on one page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from kc2spice.report.html import Section, write_page
from kc2spice.report.verdict import Findings
from kc2spice.report.words import fact, quantity


def write_verify(path: Path, found: Mapping[str, Findings]) -> Path:
    """Write the page for the findings of each scene, by its name."""
    sections = [_summary(found)]
    for scene, findings in found.items():
        sections += _scene(scene, findings)
    lead = "Full model, reduced model and ngspice on the emitted netlist, against each other."
    kept = [s for s in sections if s.rows or s.figures or s.note]
    return write_page(path, "Verification", lead, kept)


def _summary(found: Mapping[str, Findings]) -> Section:
    rows = []
    for scene, findings in found.items():
        missed = [check for check in findings.checks if not check.passed]
        errors = [
            quantity(findings.errors.get(key), "", 2)
            for key in ("rom_vs_fom", "ngspice_vs_rom", "ngspice_vs_fom")
        ]
        verdict = "missed" if missed else "met"
        rows.append((scene, verdict, *errors))
    head = ("scene", "gates", "reduced − full", "ngspice − reduced", "ngspice − full")
    note = "Errors are the largest relative ones."
    return Section("Summary", rows, head, note)


def _scene(scene: str, findings: Findings) -> list[Section]:
    checks = [
        (
            check.name,
            _with_unit(check.value, check.unit),
            _with_unit(check.limit, check.unit),
            "met" if check.passed else "missed",
        )
        for check in findings.checks
    ]
    return [
        Section(f"{scene}: gates", checks, ("check", "value", "limit", "")),
        Section(
            f"{scene}: time",
            [(stage, quantity(time, "s", 3)) for stage, time in findings.wall_s.items()],
            ("stage", "wall time"),
        ),
        Section(
            f"{scene}: each output",
            [
                (
                    error.pair.replace("_vs_", " to "),
                    error.output,
                    f"{error.largest:.2g}",
                    f"{error.rms:.2g}",
                )
                for error in findings.outputs
            ],
            ("solutions", "output", "largest error", "rms error"),
        ),
        Section(
            f"{scene}: results",
            [
                fact(key, value)
                for key, value in findings.metrics.items()
                if not isinstance(value, Mapping)
            ],
            note=" ".join(findings.notes),
        ),
        Section(f"{scene}: figures", figures=findings.figures),
    ]


def _with_unit(value: float | None, unit: str) -> str:
    return quantity(value, "" if unit == "1" else unit, 3)
