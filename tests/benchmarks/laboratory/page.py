"""The benchmark as tables: Markdown, and one page with its figures."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from kc2spice.report.html import Section, write_page
from kc2spice.report.words import quantity
from kc2spice.workflow.bench.plane import NEGLIGIBLE
from laboratory.figures import Picture

Record = Mapping[str, Any]
FRONTS = (
    "Each scene among the settings next to its own (kc2spice bench SCENE --near): its keys one "
    "value coarser and finer, all of them finer, and combinations that are as exact in less time. "
    "Error: the larger of that of the whole setting and of the sum of what its values do alone, of "
    "the scene's metrics, against a reference that is finer again; none is said to be smaller than "
    f"that one's own uncertainty or {NEGLIGIBLE:g}. A setting is beaten by one as exact in clearly "
    "less time (a fifth and 5 ms less, less than its quickest run, in the slowest run less than "
    "its median), or by one that takes no longer at half the error."
)


def bench_tables(record: Record) -> str:
    """The whole record as Markdown."""
    parts = [f"# Speed against error\n\n{machine_line(record)}\n"]
    for section in bench_sections(record, []):
        parts.append(f"## {section.title}\n\n{_markdown(section)}")
    return "\n".join(parts)


def write_bench(path: Path, record: Record, pictures: Sequence[Picture]) -> Path:
    """``bench.html`` with the same tables and the figures."""
    return write_page(
        path, "Speed against error", machine_line(record), bench_sections(record, pictures)
    )


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


def bench_sections(record: Record, pictures: Sequence[Picture]) -> list[Section]:
    """Ratios, then each plane, then the scaling table."""
    sections = []
    head: tuple[str, ...]
    if record["ratios"]:
        head = ("figure", "value", "target", "", "taken at error", "what it is")
        sections.append(Section("Targets", ratio_rows(record), head))
    by_name = {picture.path.stem: _embedded(picture) for picture in pictures}
    for name, points in record["planes"].items():
        words = record["titles"][name]
        head = ("method", "setting", "error", "time", "spread", "more")
        note = " ".join(f"{note}." for note in (f"Error: {words['error']}", *words["notes"]))
        drawn = by_name.get(f"bench_{name}", "")
        sections.append(Section(words["title"], _point_rows(points), head, note, drawing=drawn))
    if record["scaling"]:
        head = ("size", "of", "time", "memory", "power")
        drawn = by_name.get("bench_scaling", "")
        note = "The power of the size is fitted to the larger half of the sizes."
        sections.append(Section("Scaling", _scaling_rows(record), head, note, drawing=drawn))
    if record["fronts"]:
        head = ("scene", "error", "time", "settings", "beaten by", "error", "time")
        rows = [_front_row(name, front) for name, front in record["fronts"].items()]
        sections.append(Section("Shipped settings of the gallery", rows, head, FRONTS))
    if "bench_poles" in by_name:
        sections.append(Section("Poles", drawing=by_name["bench_poles"]))
    return sections


def _embedded(picture: Picture) -> str:
    data = base64.b64encode(picture.path.read_bytes()).decode("ascii")
    return (
        f'<figure><img src="data:image/png;base64,{data}" alt="{escape(picture.title)}" '
        f'style="max-width:100%"><figcaption>{escape(picture.caption)}</figcaption></figure>'
    )


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


def _front_row(name: str, front: Record) -> tuple[str, ...]:
    if "why" in front:
        return (name, "", "", "", front["why"], "", "")
    row = (name, f"{front['error']:.1e}", quantity(front["time_s"], "s", 3), str(front["tried"]))
    nearest = front["nearest"]
    if nearest is None:
        return (*row, "none", "", "")
    kept = f"; kept: {front['keep']}" if front["keep"] else ""
    best = (f"{nearest['error']:.1e}", quantity(nearest["time_s"], "s", 3))
    return (*row, f"{nearest['label']}{kept}", *best)


def _scaling_rows(record: Record) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for name, item in record["scaling"].items():
        memory = item["memory_bytes"] or [None] * len(item["sizes"])
        for k, (size, time) in enumerate(zip(item["sizes"], item["time_s"], strict=True)):
            last = k == len(item["sizes"]) - 1
            power = f"{item['exponent']:.2f}" if last else ""
            rows.append(
                (f"{size:g}", f"{name} ({item['what']})", quantity(time, "s", 3),
                 quantity(memory[k], "B", 3), power)
            )  # fmt: skip
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
