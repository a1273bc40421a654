"""The benchmark as tables and figures."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel
from kc2spice.core.si_prefix_format import format_quantity

Record = Mapping[str, Any]
RATIOS = ("figure", "value", "target", "", "at error", "description")
POINTS = ("method", "setting", "error", "time", "spread", "more")
LEAST = 1e-16  # an error of zero is drawn here


def bench_tables(record):
    """The whole record as Markdown."""
    text = f"# Speed against error\n\n{_origin(record)}\n\n{_machine_line(record)}\n"
    if record["ratios"]:
        text += _section("Targets", RATIOS, map(_ratio, record["ratios"].items()), "")
    for name, points in record["planes"].items():
        words = record["titles"][name]
        note = " ".join(
            f"{note}." for note in (f"The column *error* is the {words['error']}", *words["notes"])
        )
        text += _section(words["title"], POINTS, map(_point, points), note)
    return text


def _origin(record):
    """Date and commit of the measurement, and the command that repeats it."""
    if "date" not in record:
        return "Written by `make bench`. This record has no date."
    return f"Measured on {record['date']} from commit {record['commit']} by `make bench`."


def _section(title, head, rows, note):
    lines = (head, ["---"] * len(head), *rows)
    cells = ("| " + " | ".join(c.replace("|", r"\|") for c in line) + " |" for line in lines)
    return "\n".join([f"\n## {title}\n", *cells, "", note, ""])


def _machine_line(record):
    """Processor, versions and duration, with a warning if the models were coarse."""
    m = record["machine"]
    took = sum(record["seconds"].values())
    line = (
        f"Machine: {m['cpu']}, {m['cores']} cores, {m['os']}.\n\n"
        f"Versions: Python {m['python']}, numpy {m['numpy']}, scipy {m['scipy']}, "
        f"ngspice {m['ngspice']}, C compiler {m['compiler']}, kc2spice {m['kc2spice']}.\n\n"
        f"Each time is a CPU time: the median of {record['repeats']} runs, or of fewer runs if a "
        "run takes long. An asterisk marks a setting that is more accurate than every faster "
        "setting in its table. A row `lower bound` contains the time of a compiled program that "
        "can solve only the equations of one benchmark. A row `lower bound` never has an asterisk. "
        "The asterisks of all other rows are assigned as if the table had no row `lower bound`."
    )
    if took:
        line += f" The whole benchmark took {took / 60:.1f} min."
    quick = " This was a quick run with coarse models, so its numbers mean nothing."
    return line + quick if record["quick"] else line


def _ratio(item):
    name, ratio = item
    sign, value, unit = "≥" if ratio["at_least"] else "≤", ratio["value"], ratio["unit"]
    target = ratio["target"]
    return (
        name,
        "not reached" if value is None else format_quantity(value, unit, 4),
        "" if target is None else f"{sign} {format_quantity(target, unit, 4)}",
        "" if target is None else "met" if ratio["met"] else "MISSED",
        _number(ratio["error"]),
        ratio["what"],
    )


def _point(point):
    more = [*point["errors"].items(), *point["facts"].items()]
    extra = [f"{key} {_number(value)}" for key, value in more]
    return (
        point["family"],
        f"{point['label']}{' *' if point['pareto'] else ''}",
        _number(point["error"]),
        format_quantity(point["time_s"], "s", 3),
        f"{(point['time_high_s'] - point['time_low_s']) / point['time_s']:.0%}",
        "; ".join([*extra, *([point["note"]] if point["note"] else [])]),
    )


def _number(value):
    if value is None:
        return "—"
    return value if isinstance(value, str) else f"{value:.3g}"


def bench_figures(record):
    """Time over error of each plane; lower left is better."""
    for name, points in record["planes"].items():
        words = record["titles"][name]
        families = dict.fromkeys(point["family"] for point in points)
        front = sorted((p for p in points if p["pareto"]), key=lambda p: p["error"])
        curves = [_spline("Pareto front", front, "step")]
        curves += [_spline(f, [p for p in points if p["family"] == f], "o") for f in families]
        ends = [max(p["error"], LEAST) for p in points]
        span = 0.5 * min(ends), 2.0 * max(ends)
        panel = Panel(
            words["error"], words["time"], tuple(curves), span=span, log_x=True, log_y=True
        )
        yield Figure(f"bench_{name}", words["title"], "", (panel,))


def _spline(label, points, style):
    error = np.maximum([p["error"] for p in points], LEAST)
    return Curve(label, error, np.array([p["time_s"] for p in points]), style)
