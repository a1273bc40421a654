"""What the commands print for a person: results, verdicts, plans, keys and findings as tables."""

from __future__ import annotations

import shlex
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kc2spice.cli.console import COLUMNS, print_facts, print_table

if TYPE_CHECKING:
    from kc2spice.cli.doctor import Finding
    from kc2spice.scene.keys import Key
    from kc2spice.scene.model import Scene
    from kc2spice.scene.partdocs import PartDoc
    from kc2spice.scene.parttype import StepLimit
    from kc2spice.scene.plan import Plan


def show_result(result: Mapping[str, Any], directory: Path) -> None:
    """What ``run`` found."""
    for part, facts in result.get("model", {}).items():
        print_facts(f"model: {part}", facts)
    if "rom" in result:
        rom = result["rom"]
        low, high = rom["band_hz"]
        rows = [
            ("order", str(rom["order"])),
            ("band", f"{low:g} … {high:g} Hz"),
            ("error estimate", f"{rom['error_estimate']:.3g}"),
        ]
        rows += _above_band(rom)
        print_table("reduced model", rows)
    print_facts("metrics", result.get("metrics", {}), result.get("metric_units", {}))
    _show_checks(result.get("checks", ()))
    _show_attempts(result.get("simulator", {}).get("attempts", ()))
    print_facts("wall time", {f"{stage}_s": time for stage, time in result["wall_s"].items()})
    print_table(f"files in {directory}", [(", ".join(map(str, result["files"])),)])
    for raw in (name for name in result["files"] if name.endswith(".raw")):
        rows = [
            ("ngspice", f"load {raw}, then plot VECTOR"),
            ("Python", f"spicelib.RawRead({raw!r}, dialect='ngspice')"),
        ]
        print_table("viewers of the raw file", rows)


def _above_band(rom: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Rows of what a certificate says of the compliance above its band."""
    errors = rom.get("above_band_compliance_error", ())
    return [
        (f"compliance at {f:g} Hz", f"{error:.2g} off, above the band")
        for f, error in zip(rom.get("above_band_hz", ()), errors, strict=True)
    ]


def _show_checks(checks: Iterable[Mapping[str, Any]]) -> None:
    from kc2spice.report.words import check_name

    rows = [
        (
            "ok" if check["passed"] else "VIOLATED",
            check_name(check["name"]),
            f"{check['value']:.3g} {check['unit']}",
            f"limit {check['limit']:.3g}",
        )
        for check in checks
    ]
    if rows:
        print_table("physics checks", rows)


def _show_attempts(attempts: Sequence[Mapping[str, Any]]) -> None:
    """All retry settings, where more than the first was needed."""
    rows = [
        (each["setting"], each["settings"], each["cause"] or "succeeded", f"{each['wall_s']:.3g} s")
        for each in attempts
    ]
    if len(rows) > 1:
        print_table("retries", rows, header=("setting", "changes", "outcome", "time"))


def show_verdicts(found: Mapping[str, Mapping[str, Any]], directory: Path) -> None:
    """What ``verify`` found."""
    for name, record in found.items():
        rows = [
            (
                "ok" if check["passed"] else "MISSED",
                check["name"],
                "-" if check["value"] is None else f"{check['value']:.3g}",
                f"{check['limit']:.3g}" + ("" if check["unit"] == "1" else f" {check['unit']}"),
            )
            for check in record["checks"]
        ]
        print_table(f"{name}: gates", rows, header=("", "check", "value", "limit"))
        times = [(stage, f"{time:.3g} s") for stage, time in record["wall_s"].items()]
        print_table(f"{name}: time", times, header=("stage", "wall time"))
        for note in record["notes"]:
            print(f"  {note}")
    print(f"all of it, with errors and plots: {directory / 'verify.html'}")


def show_plan(scene: Scene, digest: str, plan: Plan, limit: StepLimit | None) -> None:
    """What ``explain`` says."""
    print(textwrap.fill(f"{scene.name}: {scene.title}", COLUMNS))
    print(f"scene hash {digest}\n")
    rows = [(part.part, part.source, part.detail) for part in plan.parts]
    print_table("modelled", rows, header=("part", "model", "detail"))
    print_table("joined", [(line,) for line in plan.joins])
    settings = [
        (s.key, f"{s.value:g}", "not estimated" if s.error is None else f"{s.error:.2g}")
        for s in plan.settings
    ]
    print_table("numerical settings", settings, header=("key", "value", "error"))
    budget = "X" if plan.error_budget is None else f"{plan.error_budget:g}"
    print(f"error_budget = {budget} refines these until every metric's error is below {budget}\n")
    left = [(item.effect, item.why, item.error) for item in plan.left_out]
    print_table("left out", left, header=("effect", "why", "size"))
    if limit is not None:
        print(textwrap.fill(f"largest step {limit.step:.3g} s: {limit.why}", COLUMNS))


def show_reduced(found: Mapping[str, Any]) -> None:
    """What ``reduce`` made."""
    low, high = found["band_hz"]
    rows = [
        ("equations", f"{found['unknowns']}, {found['form']}"),
        ("states", str(found["order"])),
        ("band", f"{low:g} … {high:g} Hz"),
        ("error estimate", f"{found['error_estimate']:.3g}, {found['norm']}"),
        *_above_band(found),
        ("stable", {True: "yes", False: "NO", None: "not known"}[found["stable"]]),
        ("passive", "yes" if found["passive"] else "not shown"),
        ("method", found["method"]),
        ("reduced model", found["rom"]),
    ]
    print_table("reduced model", rows)


def show_bench(record: Mapping[str, Any], given: str, out: Path) -> None:
    """What ``bench`` measured of a scene with overrides, ``given`` as words of the command line."""
    from kc2spice.report.bench_page import HEAD, point_rows, recommendation

    front = {**record, "points": [p for p in record["points"] if p["front"] or p["own"]]}
    print_table("front", point_rows(front), HEAD)
    print_table("bench", recommendation(record))
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
    rows = [
        (
            key,
            f"{each['value']:.6g} +- {each['sigma']:.2g}" + " at its bound" * each["at_bound"],
        )
        for key, each in found["parameters"].items()
    ]
    print_table("fitted", rows)
    rows = [
        ("deviation of |Z|", f"{found['error']['rms']:.2g} rms, {found['error']['largest']:.2g}"),
        ("noise of the data", f"{found['noise']:.2g}"),
        ("ends of all starts", ", ".join(f"{each['cost']:.4g}" for each in found["starts"])),
        ("values", str(found["overrides"])),
    ]
    for each in found["undetermined"]:
        told = ", ".join(f"{weight:+.2f} log {key}" for key, weight in each.items())
        rows.append(("not determined", told))
    print_table("fit", rows)
