"""What the commands print for a person: results, verdicts, plans, keys and findings as tables."""

from __future__ import annotations

import shlex
import textwrap
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kc2spice.cli.console import COLUMNS, print_table

if TYPE_CHECKING:
    from kc2spice.cli.doctor import Finding
    from kc2spice.report.html import Section
    from kc2spice.scene.keys import Key, PartDoc


def show_sections(sections: Iterable[Section]) -> None:
    """The tables of a page."""
    for section in sections:
        if section.rows:
            rows = [[cell.replace("\u2212", "-") for cell in row] for row in section.rows]
            print_table(section.title, rows, section.head)


def show_result(result: Mapping[str, Any], directory: Path) -> None:
    """What ``run`` found."""
    from kc2spice.report.run_page import result_sections

    show_sections(result_sections(result))
    print_table(f"files in {directory}", [(", ".join(map(str, result["files"])),)])
    for raw in (name for name in result["files"] if name.endswith(".raw")):
        rows = [
            ("ngspice", f"load {raw}, then plot VECTOR"),
            ("Python", f"spicelib.RawRead({raw!r}, dialect='ngspice')"),
        ]
        print_table("viewers of the raw file", rows)


def show_verdicts(found: Mapping[str, Mapping[str, Any]], directory: Path) -> None:
    """What ``verify`` found."""
    from kc2spice.report.verify_page import verdict_sections

    for name, record in found.items():
        show_sections(verdict_sections(name, record))
        for note in record["notes"]:
            print(f"  {note}")
    print(f"all of it, with errors and plots: {directory / 'verify.html'}")


def show_plan(record: Mapping[str, Any], title: str) -> None:
    """What ``explain`` says."""
    from kc2spice.report.run_page import plan_sections

    print(textwrap.fill(f"{record['scene']}: {title}", COLUMNS))
    print(f"scene hash {record['hash']}\n")
    print_table("joined", [(line,) for line in record["joins"]])
    show_sections(plan_sections(record))
    budget = "X" if record["error_budget"] is None else f"{record['error_budget']:g}"
    told = "refines the settings until every metric's error is below"
    print(f"error_budget = {budget} {told} {budget}\n")
    if step := record["largest_step"]:
        print(textwrap.fill(f"largest step {step['s']:.3g} s: {step['why']}", COLUMNS))


def show_reduced(found: Mapping[str, Any]) -> None:
    """What ``reduce`` made."""
    from kc2spice.report.run_page import above_band

    low, high = found["band_hz"]
    rows = [
        ("equations", f"{found['unknowns']}, {found['form']}"),
        ("states", str(found["order"])),
        ("band", f"{low:g} … {high:g} Hz"),
        ("error estimate", f"{found['error_estimate']:.3g}, {found['norm']}"),
        *above_band(found),
        ("stable", {True: "yes", False: "NO", None: "not known"}[found["stable"]]),
        ("passive", "yes" if found["passive"] else "not shown"),
        ("method", found["method"]),
        ("reduced model", found["rom"]),
    ]
    print_table("reduced model", rows)


def show_bench(record: Mapping[str, Any], given: str, out: Path) -> None:
    """What ``bench`` measured of a scene with overrides, ``given`` as words of the command line."""
    from kc2spice.report.bench_page import bench_sections

    front = [point for point in record["points"] if point["front"] or point["own"]]
    show_sections(bench_sections({**record, "points": front}))
    if record["recommended"] is not None:
        print(f"kc2spice run {given} {shlex.join(record['recommended']['set'])}".rstrip())
    print(f"all of it: {out / 'bench.html'}")


def show_sweep(result: Mapping[str, Any]) -> None:
    """What ``sweep`` has run."""
    rows = [(name, str(result[name])) for name in ("points", "failed", "resumed", "table")]
    for name, share in result.get("yield", {}).items():
        low, high = share["low"], share["high"]
        rows.append((f"{name}: yield", f"{share['share']:.4g} (95 %: {low:.4g} … {high:.4g})"))
    if result.get("files"):
        rows.append(("files", ", ".join(result["files"])))
    print_table("sweep", rows)


def show_keys(keys: Iterable[Key]) -> None:
    """What ``scenes --keys`` lists."""
    rows = [
        (
            key.name,
            key.unit or "",
            "" if key.default is None else str(key.default),
            " | ".join(key.choices) or key.doc,
        )
        for key in keys
    ]
    print_table("keys of a scene", rows, header=("key", "unit", "default", ""), names=0)


def show_parts(docs: Iterable[PartDoc]) -> None:
    """What ``scenes --parts`` lists."""
    for doc in docs:
        rows = [
            ("pin", pin.name, pin.kind, f"default {pin.default}" if pin.default else "")
            for pin in doc.pins
        ]
        rows += [
            (
                "key",
                key.name,
                key.unit or " | ".join(key.choices),
                "" if key.default is None else f"default {key.default}",
            )
            for key in doc.keys
        ]
        print_table(f"{doc.name}: {doc.title}", rows, names=1)


def show_findings(findings: Iterable[Finding]) -> None:
    """What ``doctor`` found."""
    marks = {(True, True): "ok", (True, False): "ok", (False, True): "MISSING"}
    rows = [
        (marks.get((f.ok, f.needed), "absent"), f.name, f.found, "" if f.ok else f.fix)
        for f in findings
    ]
    print_table("doctor", rows, header=("", "what", "found", "fix"))


def show_fit(found: Mapping[str, Any]) -> None:
    """What ``fit`` found."""
    from kc2spice.report.fit_page import fit_sections

    show_sections(fit_sections(found))
    print(f"values, for --set: {found['overrides']}\nwith plots: {found['page']}")
