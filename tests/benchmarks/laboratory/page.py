"""The benchmark as tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from kc2spice.report.html import Section
from kc2spice.report.words import quantity

Record = Mapping[str, Any]


def bench_tables(record: Record) -> str:
    """The whole record as Markdown."""
    parts = [f"# Speed against error\n\n{machine_line(record)}\n"]
    for section in bench_sections(record):
        parts.append(f"## {section.title}\n\n{_markdown(section)}")
    return "\n".join(parts)


def machine_line(record: Record) -> str:
    """Processor and versions in one line, with a warning where the numbers mean nothing."""
    m = record["machine"]
    took = sum(record["seconds"].values())
    line = (
        f"{m['cpu']}, {m['cores']} cores, {m['os']}, Python {m['python']}, numpy {m['numpy']}, "
        f"scipy {m['scipy']}, ngspice {m['ngspice']}, C compiler {m['compiler']}, "
        f"kc2spice {m['kc2spice']}; CPU times, medians of {record['repeats']}, "
        "of fewer where a run takes long"
    )
    if took:
        line += f"; all of it took {took / 60:.1f} min"
    quick = ". Quick run: coarse models, the numbers mean nothing."
    return line + quick if record["quick"] else line


def bench_sections(record: Record) -> list[Section]:
    """Ratios, then each plane."""
    sections = []
    head: tuple[str, ...]
    if record["ratios"]:
        head = ("figure", "value", "target", "", "taken at error", "what it is")
        sections.append(Section("Targets", ratio_rows(record), head))
    for name, points in record["planes"].items():
        words = record["titles"][name]
        head = ("method", "setting", "error", "time", "spread", "more")
        note = " ".join(f"{note}." for note in (f"Error: {words['error']}", *words["notes"]))
        sections.append(Section(words["title"], _point_rows(points), head, note))
    return sections


def ratio_rows(record: Record) -> list[tuple[str, ...]]:
    """One row for each figure with a target."""
    rows: list[tuple[str, ...]] = []
    for name, ratio in record["ratios"].items():
        sign, value, unit = "≥" if ratio["at_least"] else "≤", ratio["value"], ratio["unit"]
        rows.append(
            (
                name,
                "not reached" if value is None else quantity(value, unit, 4),
                "" if ratio["target"] is None else f"{sign} {quantity(ratio['target'], unit, 4)}",
                _verdict(ratio),
                _number(ratio["error"]),
                ratio["what"],
            )
        )
    return rows


def _verdict(ratio: Record) -> str:
    if ratio["target"] is None:
        return ""
    return "met" if ratio["met"] else "MISSED"


def _point_rows(points: Sequence[Record]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for point in points:
        extra = [f"{key} {_number(value)}" for key, value in point["errors"].items()]
        extra += [f"{key} {_number(value)}" for key, value in point["facts"].items()]
        extra += [point["note"]] if point["note"] else []
        rows.append(
            (
                point["family"],
                f"{point['label']}{' *' if point['pareto'] else ''}",
                _number(point["error"]),
                quantity(point["time_s"], "s", 3),
                f"{(point['time_high_s'] - point['time_low_s']) / point['time_s']:.0%}",
                "; ".join(extra),
            )
        )
    return rows


def _number(value: Any) -> str:
    if value is None:
        return "—"
    return value if isinstance(value, str) else f"{value:.3g}"


def _markdown(section: Section) -> str:
    lines = [_line(section.head), _line(["---"] * len(section.head))]
    lines += [_line(row) for row in section.rows]
    return "\n".join([*lines, "", section.note, ""])


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"
