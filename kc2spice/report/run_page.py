"""``report.html`` of a run: metrics, checks with wall times, model facts, omissions, figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kc2spice.report.html import Section, quantity, write_page
from kc2spice.report.plots import Picture
from kc2spice.scene.model import Scene
from kc2spice.scene.plan import plan

# Longest suffix first: the key's name says its unit, as in result.json.
_SUFFIXES = (
    ("_m_per_100v", "m per 100 V"), ("_m_s", "m/s"), ("_v_m", "V/m"), ("_pa", "Pa"),
    ("_hz", "Hz"), ("_kg", "kg"), ("_ohm", "Ω"), ("_m", "m"), ("_s", "s"), ("_a", "A"), ("_n", "N"), ("_f", "F"), ("_h", "H"),
    ("_v", "V"), ("_c", "C"),
)  # fmt: skip


def write_run(
    path: Path,
    result: Mapping[str, Any],
    scene: Scene,
    pictures: Sequence[Picture],
    errors: Sequence[Mapping[str, Any]] = (),
) -> Path:
    """Write the page of ``kc2spice run`` from ``result.json``'s content.

    ``errors`` are rows of one road each: ``road`` (words), ``wall_s`` and, against the reference,
    the keys of :func:`kc2spice.report.metrics.compare`.
    """
    sections = [
        _facts("Metrics", result.get("metrics", {})),
        _roads(errors),
        _checks(result),
        *(_energy(book, entries) for book, entries in result.get("energy_j", {}).items()),
        _wall(result),
        _simulator(result, scene),
        _attempts(result),
        *(_facts(f"Model: {part}", facts) for part, facts in result.get("model", {}).items()),
        _facts("Reduced model", result.get("rom", {})),
        _modelled(scene),
        _errors(scene),
        _left_out(scene),
        Section("Figures", pictures=pictures),
        Section("Files", [(name,) for name in result.get("files", ())]),
    ]
    kept = [s for s in sections if s.rows or s.pictures]
    title = f"{scene.name}: {scene.title}" if scene.title else scene.name
    lead = "Finite-element models, reduced, exported as a netlist and run in ngspice."
    return write_page(path, title, lead, kept)


def unit_of(key: str) -> str:
    """Unit that a key of result.json names by its suffix, empty where it names none."""
    return _suffix(key)[1]


def _suffix(key: str) -> tuple[str, str]:
    return next(((s, u) for s, u in _SUFFIXES if key.endswith(s)), ("", ""))


def fact(key: str, value: Any) -> tuple[str, str]:
    """A key of result.json and its value as words: the suffix of the key is the unit."""
    suffix, unit = _suffix(key)
    name = key.removesuffix(suffix).replace("_", " ")
    if isinstance(value, (list, tuple)) and len(value) > 8:
        return name, f"{len(value)} values, in result.json"
    values = value if isinstance(value, (list, tuple)) else [value]
    return name, ", ".join(_words(v, unit) for v in values)


def _words(value: Any, unit: str) -> str:
    if value is None:
        return "not reached"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int) and not unit:
        return f"{value:,}".replace(",", " ")
    return quantity(value, unit) if isinstance(value, (int, float)) else str(value)


def _facts(title: str, facts: Mapping[str, Any]) -> Section:
    plain = {k: v for k, v in facts.items() if not isinstance(v, Mapping)}
    return Section(title, [fact(key, value) for key, value in plain.items()])


def _roads(errors: Sequence[Mapping[str, Any]]) -> Section:
    keys = {key: None for row in errors for key in row if key not in ("road", "wall_s")}
    head = ("road", "wall time", *(fact(key, 0)[0] for key in keys))
    rows = [
        (
            str(row["road"]),
            quantity(row.get("wall_s"), "s", 3),
            *("" if row.get(key) is None else fact(key, row[key])[1] for key in keys),
        )
        for row in errors
    ]
    note = "Errors against the independent integration in scipy, each next to the time it took."
    return Section("Time and error", rows, head, note)


def _checks(result: Mapping[str, Any]) -> Section:
    rows = [
        (
            "ok" if check["passed"] else "VIOLATED",
            check["name"],
            f"{check['value']:.3g} {check['unit']}",
            f"{check['limit']:.3g}",
            check["action"],
        )
        for check in result.get("checks", ())
    ]
    note = "Physics that the simulator was not told; the last column is what a violation does."
    return Section("Physics checks", rows, ("", "check", "value", "limit", "action"), note)


def _energy(book: str, entries: Mapping[str, float]) -> Section:
    rows = [(name, quantity(value, "J")) for name, value in entries.items()]
    return Section(f"Energy: {book}", rows)


def _attempts(result: Mapping[str, Any]) -> Section:
    rows = [
        (
            attempt["setting"],
            attempt["settings"],
            attempt["cause"] or "succeeded",
            attempt["part"] or "",
            quantity(attempt["wall_s"], "s", 3),
        )
        for attempt in result.get("simulator", {}).get("attempts", ())
    ]
    head = ("setting", "changes", "outcome", "blamed", "time")
    note = "Every setting that was tried; the last one gave this result."
    return Section("Retries", rows if len(rows) > 1 else [], head, note)


def _wall(result: Mapping[str, Any]) -> Section:
    stages = result.get("wall_s", {})
    rows = [(stage, quantity(float(seconds), "s", 3)) for stage, seconds in stages.items()]
    if rows:
        rows.append(("sum", quantity(float(sum(stages.values())), "s", 3)))
    return Section("Wall time", rows, ("stage", "time"), "0 s: taken from the cache.")


def _simulator(result: Mapping[str, Any], scene: Scene) -> Section:
    rows = [(k, str(v)) for k, v in result.get("simulator", {}).items() if k != "attempts"]
    rows += [(f"{k} time points", _words(v, "")) for k, v in result.get("steps", {}).items()]
    solver = scene.solver
    rows += [
        ("reltol", f"{solver.reltol:g}"),
        ("method", solver.method),
        ("largest step", quantity(solver.max_step, "s")),
        ("stop", quantity(scene.stop, "s")),
    ]
    return Section("Simulator", rows)


def _modelled(scene: Scene) -> Section:
    rows = [(part.part, part.source, part.detail) for part in plan(scene).parts]
    return Section("What is modelled", rows, ("part", "source", "model"))


def _left_out(scene: Scene) -> Section:
    rows = [(item.effect, item.why, item.error) for item in plan(scene).left_out]
    return Section("What is left out", rows, ("effect", "why", "size"))


def _errors(scene: Scene) -> Section:
    found = plan(scene)
    rows = [
        (each.stage, _share(each.share), _share(each.expected), each.settings, each.why)
        for each in found.errors
    ]
    note = "Relative; a stage without a share is no part of the budget."
    if found.error_budget is not None:
        note = f"error_budget {found.error_budget:g}. {note}"
    head = ("stage", "share", "expected", "settings", "")
    return Section("Expected errors", rows, head, note)


def _share(value: float | None) -> str:
    return "—" if value is None else f"{value:.2g}"
