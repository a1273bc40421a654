"""``verify.html``: every scene's checks, solutions, paper table and figures on one page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from kc2spice.report.html import Section, write_page
from kc2spice.report.paper import paper_section
from kc2spice.report.verdict import Findings
from kc2spice.report.words import fact, quantity
from kc2spice.scene.gates import Table


def write_verify(path: Path, found: Mapping[str, Findings], more: Sequence[Section] = ()) -> Path:
    """Write the page for the findings of each scene, by its name, and ``more`` sections.

    The table "paper / here" takes its values from each scene's ``metrics``.
    """
    sections = [_summary(found)]
    for scene, findings in found.items():
        sections += _scene(scene, findings)
    sections += more
    lead = "Full model, reduced model and ngspice on the emitted netlist, against each other."
    kept = [s for s in sections if s.rows or s.pictures or s.note]
    return write_page(path, "Verification", lead, kept)


def _summary(found: Mapping[str, Findings]) -> Section:
    rows = []
    for scene, findings in found.items():
        missed = [check for check in findings.checks if not check.passed]
        errors = [
            quantity(findings.errors.get(key), "", 2)
            for key in ("rom_vs_fom", "ngspice_vs_rom", "ngspice_vs_fom")
        ]
        speed = [quantity(findings.speedup.get(key), "", 3) for key in ("refactor", "low_rank")]
        verdict = "missed" if missed else "met"
        rows.append((scene, verdict, *errors, *speed))
    head = (
        "scene", "gates", "reduced − full", "ngspice − reduced", "ngspice − full",
        "speed-up, refactorised", "speed-up, low rank",
    )  # fmt: skip
    note = "Errors are the largest relative ones. Speed-ups: full model over ngspice."
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
        _costs(scene, findings),
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
        paper_section(scene if findings.shipped else "", findings.metrics),
        Section(
            f"{scene}: results",
            [
                fact(key, value)
                for key, value in findings.metrics.items()
                if not isinstance(value, Mapping)
            ],
            note=" ".join(findings.notes),
        ),
        Section(f"{scene}: figures", pictures=findings.pictures),
    ]


def table_section(table: Table) -> Section:
    """A study of a part."""
    return Section(table.title, table.rows, table.head, table.note)


def _with_unit(value: float | None, unit: str) -> str:
    return quantity(value, "" if unit == "1" else unit, 3)


def _costs(scene: str, findings: Findings) -> Section:
    keys = list(dict.fromkeys(key for cost in findings.costs for key in cost.errors))
    rows = [
        (
            cost.name,
            quantity(cost.wall_s, "s", 3),
            cost.against,
            *(fact(key, cost.errors[key])[1] if key in cost.errors else "" for key in keys),
        )
        for cost in findings.costs
    ]
    head = ("solution", "wall time", "compared with", *(fact(key, 0)[0] for key in keys))
    return Section(f"{scene}: time and error", rows, head)
