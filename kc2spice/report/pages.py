"""Pages beside that of a run: ``bench.html``, the plane of a scene's settings; that of a fit;
``sweep.html``; ``verify.html``, every scene's checks, errors, times and figures.

The figures of a sweep follow what was swept: curves over one key, maps over two that are crossed,
and of draws or more keys a histogram of each metric and its values over each key.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from kc2spice.core.figure import Curve, Figure, Map, Panel, scale_axis
from kc2spice.core.waveforms import Waveforms
from kc2spice.report.html import (
    PageSection,
    fact,
    format_quantity,
    format_value,
    value_and_limit,
    write_page,
)
from kc2spice.scene.checks import PAIRS, Check
from kc2spice.scene.model import Scene

_LEAST = 1e-16  # an error of zero is drawn here


def write_bench(directory: Path, title: str, record: Mapping[str, Any]) -> None:
    """Write the page of the ``record`` of ``bench``."""
    sections = [
        PageSection("Error against time", figures=[_figure(record)]),
        *bench_sections(record),
    ]
    lead = f"{record['simulator']}; CPU time of the simulator, median of {record['repeats']}"
    write_page(directory / "bench.html", f"Settings of {title}", lead, sections)


def bench_sections(record: Mapping[str, Any]) -> list[PageSection]:
    """Results of ``bench`` for the page and the terminal, the fastest settings first."""
    points = [
        (
            point["label"],
            f"{point['error']:.1e}",
            f"{point['bound']:.1e}",
            format_quantity(point["time_s"], "s", 3),
            " … ".join(format_quantity(point[f"time_{end}_s"], "s", 3) for end in ("low", "high")),
            "front" if point["front"] else "",
        )
        for point in record["points"]
    ]
    failed = [(item["label"], item["why"]) for item in record["failed"]]
    head = ("setting", "error", "sum of errors", "CPU time", "spread", "")
    return [
        PageSection("Recommended", recommendation(record)),
        PageSection("Settings", points, head),
        PageSection("Settings without a result", failed, ("setting", "why")),
    ]


def recommendation(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Recommended settings, settings of the scene, and the reference of the errors."""
    current = next(point for point in record["points"] if point["own"])
    best, reference = record["recommended"], record["reference"]
    rows = [("error of", _names(record["metrics"])), ("the scene as it is", _cost(current))]
    if best is None:
        nearest = min(record["points"], key=lambda p: max(p["error"], p["bound"]))
        rows.append((f"within {record['limit']:g}", "none of the settings"))
        rows.append(("nearest", f"{nearest['label']}: {_cost(nearest)}"))
    else:
        words = " ".join(map(shlex.quote, best["set"])) or "the scene as it is"
        rows.append((f"cheapest within {record['limit']:.2g}", words))
        rows.append(("", _cost(best)))
    rows.append(
        ("reference", f"{reference['label']}: {format_quantity(reference['time_s'], 's', 3)}")
    )
    rows.append(("uncertainty of the reference", f"{reference['error']:.1e}"))
    if (estimate := record["estimate"]) is not None:
        what = "error estimate of the scene as it is"
        rows.append((what, f"{estimate['error']:.1e}, meshes and tables included"))
    for name, change in record["left_out"].items():
        why = "no value" if change is None else f"changes by {change:.1e} at the finest settings"
        rows.append(("left out", f"{name}: {why}"))
    return rows


def _names(metrics: Sequence[str]) -> str:
    """Names in one line, those of one group by the group."""
    groups = Counter(name.partition(".")[0] for name in metrics)
    return ", ".join(n if count == 1 else f"{n} ({count} curves)" for n, count in groups.items())


def _cost(point: Mapping[str, Any]) -> str:
    bound = f"{point['bound']:.1e} if nothing cancelled"
    return (
        f"error {point['error']:.1e} ({bound}) in {format_quantity(point['time_s'], 's', 3)} of CPU"
    )


def _figure(record: Mapping[str, Any]) -> Figure:
    points, best = record["points"], record["recommended"]

    def curve(label: str, selected: list[Mapping[str, Any]], style: str = "o") -> Curve:
        error = np.maximum([p["error"] for p in selected], _LEAST)
        time = np.array([p["time_s"] for p in selected])
        return Curve(label, error, time, style, tuple(p["label"] for p in selected))

    front = sorted((p for p in points if p["front"]), key=lambda p: p["error"])
    curves = [curve("settings", points), curve("front", front, "step")]
    curves.append(curve("the scene as it is", [p for p in points if p["own"]]))
    curves += [curve("recommended", [best])] if best is not None else []
    limit, unsure = max(record["limit"], _LEAST), record["reference"]["error"]
    both = (limit, f"error {limit:.2g}"), (unsure, "uncertainty of the reference")
    marks = tuple(mark for mark in both if mark[0] > 0.0)
    ends = [*curves[0].x, *(place for place, _ in marks)]
    look: Any = {"span": (0.5 * min(ends), 2.0 * max(ends)), "log_x": True, "log_y": True}
    labels = "largest relative error", "CPU time of the simulator in s"
    panel = Panel(*labels, tuple(curves), marks=marks, **look)
    return Figure("bench", "Error against time", "Lower left is better.", (panel,))


def write_fit(
    path: Path,
    record: Mapping[str, Any],
    f: np.ndarray,
    Y: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
) -> None:
    """Write the page of ``record``; ``Y``, ``before`` and ``after`` (n,) are admittances [S] at
    ``f`` [Hz]."""
    figures = fit_figures(f, Y, before, after)
    sections = [*fit_sections(record), PageSection("Impedance", figures=figures)]
    lead = (
        f"The values for which {record['part']} is that of {Path(record['data']).name}. Export "
        "with --set fit.toml --set box.toml writes a netlist with these keys as parameters."
    )
    write_page(path, f"{record['part']}, fitted", lead, sections)


def fit_sections(record: Mapping[str, Any]) -> list[PageSection]:
    """Results of ``fit`` for the page and the terminal."""
    values = [
        (key, f"{item['value']:.6g}", f"{item['sigma']:.2g}",
         f"{item['low']:g} to {item['high']:g}", "met" if item["at_bound"] else "")
        for key, item in record["parameters"].items()
    ]  # fmt: skip
    error = record["error"]
    facts = [
        ("deviation of |Z|", f"{error['rms']:.2g} rms, {error['largest']:.2g} at most"),
        ("noise of the data", f"{record['noise']:.2g}"),
        ("misfit, in units of the noise", f"{record['misfit']:.2g}"),
        ("finite element models", str(record["models"])),
        ("starts that ended in another minimum", str(record["other_minima"])),
    ]
    if record["caution"]:
        facts.append(("warning", record["caution"]))
    for item in record["undetermined"]:
        text = ", ".join(f"{weight:+.2f} log {key}" for key, weight in item.items())
        facts.append(("not determined by the data", text))
    resonances = [
        tuple("" if value is None else f"{value:.6g}" for value in row.values())
        for row in record["resonances"]
    ]
    starts = [tuple(f"{value:.6g}" for value in item.values()) for item in record["starts"]]
    keys = tuple(record["parameters"])
    correlation = [
        (key, *(f"{value:+.3f}" for value in row))
        for key, row in zip(keys, record["correlation"], strict=True)
    ]
    return [
        PageSection("Values", values, ("key", "value", "standard error", "range", "bound")),
        PageSection("Fit", facts),
        PageSection("Resonances", resonances, ("measured in Hz", "at the scene's values", "fitted"),
                note="peaks of the conductance, in their order"),
        PageSection("Starts", starts, (*keys, "half the sum of squares")),
        PageSection("Correlation", correlation, ("", *keys)),
    ]  # fmt: skip


def fit_figures(
    f: np.ndarray, Y: np.ndarray, before: np.ndarray, after: np.ndarray
) -> tuple[Figure, ...]:
    """Impedance and phase of all three, and what is left over."""
    x, factor = scale_axis("frequency", f)
    f = factor * f
    three = {"measured": (Y, "o"), "scene": (before, "--"), "fitted": (after, "-")}

    def curves(of: Callable[[np.ndarray], np.ndarray]) -> tuple[Curve, ...]:
        return tuple(Curve(name, f, of(1 / y), style) for name, (y, style) in three.items())

    left = Curve("fitted over measured", f, 100 * (np.abs(Y / after) - 1))
    panels = (
        Panel(x, "|Z| in Ω", curves(np.abs), log_y=True),
        Panel(x, "phase in °", curves(lambda z: np.angle(z, deg=True))),
        Panel(x, "difference of |Z| in %", (left,)),
    )
    caption = "Measured impedance, that of the scene's values and that of the fitted ones."
    return (Figure("fit", "Impedance", caption, panels),)


CONFIDENCE = 0.95
NUMBERS = float, int, bool

Table = Mapping[str, Sequence[Any]]
Axis = tuple[str, np.ndarray]  # label that ends in the unit, numbers in it


def _has(column: Sequence[Any], *kinds: type) -> bool:
    """Whether the values that are there are of one of these types, all of the same."""
    return {type(value) for value in column} - {type(None)} in [{kind} for kind in kinds]


def _numbers(column: Sequence[Any]) -> np.ndarray:
    return np.array([np.nan if value is None else value for value in column], dtype=float)


def yields(table: Table, keys: Sequence[str]) -> dict[str, dict[str, float]]:
    """Share of all points at which each flag is true, with its exact confidence interval.

    A point that failed counts as false. The interval is that of Clopper and Pearson (1934), which
    covers at least ``confidence``; it speaks of the swept population only where keys were drawn.
    """
    result = {}
    for name, column in table.items():
        if name not in keys and _has(column, bool):
            count, total = sum(map(bool, column)), len(column)
            interval = binomtest(count, total).proportion_ci(CONFIDENCE, method="exact")
            ends = {"low": float(interval.low), "high": float(interval.high)}
            result[name] = {"share": count / total, **ends, "confidence": CONFIDENCE}
    return result


def write_sweep(
    path: Path,
    scene: Scene,
    table: Table,
    units: Mapping[str, str],
    metric_units: Mapping[str, str],
    random: Sequence[str],
    plan: str,
    shares: Mapping[str, Mapping[str, float]],
) -> None:
    """Write the page of a finished ``table`` to ``path``.

    ``units`` are those of the swept keys, in their order, ``metric_units`` those of metrics that
    have one. ``random`` are the keys that were drawn, ``plan`` says how much was run, ``shares``
    are the :func:`yields`.
    """
    metrics = [n for n in table if n not in units and _has(table[n], *NUMBERS)]
    numbers = [name for name in metrics if not _has(table[name], bool)]
    spread = [_quantile_row(name, table[name], metric_units.get(name, "")) for name in numbers]
    head = ("metric", "points", "least", "5 %", "median", "95 %", "largest")
    failed = Counter(text for text in table["status"] if text != "ok").most_common(20)
    note = "Of all points; a point that failed counts as a miss."
    sections = [
        PageSection("Plan", [("points", plan), *(_swept(key, table[key], units) for key in units)]),
        PageSection("Yield", [(fact(n, 0)[0], _share(s)) for n, s in shares.items()], note=note),
        PageSection("Metrics", spread, head),
        PageSection("Points that failed", [(str(n), why) for why, n in failed], ("points", "why")),
        PageSection(
            "Figures", figures=tuple(sweep_figures(table, units, metrics, metric_units, random))
        ),
    ]
    write_page(path, f"Sweep of {scene.name}", scene.title, sections)


def _share(share: Mapping[str, float]) -> str:
    low, high, level = (100 * share[name] for name in ("low", "high", "confidence"))
    return f"{100 * share['share']:.4g} % ({level:.3g} % confidence: {low:.4g} … {high:.4g} %)"


def _swept(key: str, column: Sequence[Any], units: Mapping[str, str]) -> tuple[str, str]:
    distinct = list({repr(value): value for value in column}.values())
    ends = ", ".join(map(str, distinct[:10]))
    if _has(column, *NUMBERS):
        ends = f"{min(distinct):g} … {max(distinct):g} {units[key]}".rstrip()
    return key, f"{len(distinct)} values, {ends}"


def _quantile_row(name: str, column: Sequence[Any], unit: str) -> tuple[str, ...]:
    values = _numbers(column)
    values = values[np.isfinite(values)]
    shares = np.quantile(values, (0.0, 0.05, 0.5, 0.95, 1.0))
    texts = (format_value(float(v), unit) for v in shares)
    return (fact(name, 0, unit)[0], str(values.size), *texts)


def sweep_figures(
    table: Table,
    units: Mapping[str, str],
    metrics: Sequence[str],
    metric_units: Mapping[str, str],
    random: Sequence[str],
) -> Iterator[Figure]:
    """The ``metrics`` of a table over its swept keys, with the units of both."""
    keys = [key for key in units if _has(table[key], *NUMBERS)]
    if not keys or not metrics:
        return
    x = {key: (_label(key, units[key]), _numbers(table[key])) for key in keys}
    y = {}
    for name in metrics:
        unit = metric_units.get(name, "")
        y[name] = _label(fact(name, 0, unit)[0], unit), _numbers(table[name])
    crossed = np.prod([np.unique(x[key][1]).size for key in keys]) == len(table["status"])
    if not random and len(keys) == 1:
        words = zip(*(table[key] for key in units if key not in x), strict=True)
        labels = [" ".join(map(str, item)) for item in words]
        panels = [_curves(x[keys[0]], labels, axis) for axis in y.values()]
        yield Figure("curves", "Curves", "A gap is a point without that metric.", tuple(panels))
    elif not random and len(keys) == len(units) == 2 and crossed:
        for name, axis in y.items():
            panel = _map(x[keys[0]], x[keys[1]], axis)
            title = axis[0].partition(" in ")[0]
            yield Figure(f"map_{name}", title, "Grey where there is none.", (panel,))
    else:
        caption = "Lines at the median and at 5 and 95 % of the points."
        panels = list(map(_histogram, y.values()))
        yield Figure("histograms", "Distributions", caption, tuple(panels), columns=3)
        for name, (label, values) in y.items():
            panels = [Panel(k, label, (Curve("", v, values, "o"),)) for k, v in x.values()]
            yield Figure(f"over_{name}", label, "Over each key.", tuple(panels), columns=3)


def _label(name: str, unit: str) -> str:
    return f"{name.replace('_', ' ')} in {unit}" if unit else name.replace("_", " ")


def _curves(x: Axis, words: Sequence[str], y: Axis) -> Panel:
    """One curve for each combination of the swept words."""
    labels = np.array(words) if words else np.full(x[1].size, "")
    curves = []
    for label in np.unique(labels):
        mine = np.flatnonzero(labels == label)
        mine = mine[np.argsort(x[1][mine])]
        curves.append(Curve(str(label), x[1][mine], y[1][mine], "o-"))
    ends = (float(x[1].min()), float(x[1].max()))
    return Panel(x[0], y[0], tuple(curves), span=ends, log_x=_logarithmic(np.unique(x[1])))


def _logarithmic(x: np.ndarray) -> bool:
    """Ascending and equally spaced in the logarithm rather than in the values."""
    even = x.size > 2 and x[0] > 0 and np.ptp(np.diff(np.log(x))) < 1e-6 * np.log(x[-1] / x[0])
    return bool(even)


def _map(x: Axis, y: Axis, z: Axis) -> Panel:
    columns, i = np.unique(x[1], return_inverse=True)
    rows, j = np.unique(y[1], return_inverse=True)
    field = np.full((rows.size, columns.size), np.nan)
    field[j, i] = z[1]
    log_x, log_y = _logarithmic(columns), _logarithmic(rows)
    return Panel(x[0], y[0], (), log_x=log_x, log_y=log_y, map=Map(columns, rows, field, z[0]))


def _histogram(axis: Axis) -> Panel:
    values = axis[1][np.isfinite(axis[1])]
    counts, edges = np.histogram(values, bins="auto" if values.size > 1 else 1)
    bars = Curve("", (edges[:-1] + edges[1:]) / 2, counts.astype(float), "bar")
    low, middle, high = np.quantile(values, (0.05, 0.5, 0.95)).tolist()
    marks = ((low, "5 %"), (middle, "median"), (high, "95 %"))
    return Panel(axis[0], "points", (bars,), marks=marks)


MET = {True: "ok", False: "MISSED"}
MOST = 4  # panels of one figure
FLOOR = 1e-17  # a difference of nothing, on a logarithmic axis

Solutions = Mapping[str, Waveforms]


@dataclass
class Findings:
    """Results of the verification of one scene.

    ``errors`` has those of :data:`kc2spice.scene.checks.PAIRS` (largest relative), ``wall_s`` the
    time of each stage; ``left_out`` names the parts without a law. ``answers`` has the metrics of
    each solution: ``ngspice``, ``rom`` (laws) and ``fom`` (with full models, as far as followed).
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
        """Whether every check is."""
        return all(check.passed for check in self.checks)

    def record(self) -> dict[str, Any]:
        """Record for ``verify.json``."""
        result = {
            key: value for key, value in vars(self).items() if key not in ("figures", "units")
        }
        checks = [check.record() for check in self.checks]
        outputs = list(map(asdict, self.outputs))
        return {"passed": self.passed, **result, "checks": checks, "outputs": outputs}


def write_verify(path: Path, findings_by_scene: Mapping[str, Findings]) -> Path:
    """Write the page for the findings of each scene, by its name."""
    rows = [
        (
            scene,
            MET[item.passed],
            *(format_quantity(item.errors.get(pair), "", 2) for pair in PAIRS),
        )
        for scene, item in findings_by_scene.items()
    ]
    head = ("scene", "gates", "reduced − full", "ngspice − reduced", "ngspice − full")
    sections = [PageSection("Summary", rows, head, "Errors are the largest relative ones.")]
    for scene, findings in findings_by_scene.items():
        sections += [*verdict_sections(scene, findings.record()), *_details(scene, findings)]
    lead = "Full model, reduced model and ngspice on the emitted netlist, against each other."
    return write_page(path, "Verification", lead, sections)


def verdict_sections(scene: str, record: Mapping[str, Any]) -> list[PageSection]:
    """Gates and times of one scene's record, for the page and for the terminal."""
    checks = []
    for check in record["checks"]:
        unit = "" if check["unit"] == "1" else check["unit"]
        value, limit = (
            None if v is None or np.isnan(v) else v for v in (check["value"], check["limit"])
        )
        if value is None or limit is None:
            texts = format_quantity(value, unit, 3), format_quantity(limit, unit, 3)
        else:
            texts = value_and_limit(value, limit, unit)
        checks.append((MET[check["passed"]], check["name"], *texts))
    times = [(stage, format_quantity(time, "s", 3)) for stage, time in record["wall_s"].items()]
    return [
        PageSection(f"{scene}: gates", checks, ("", "check", "value", "limit")),
        PageSection(f"{scene}: time", times, ("stage", "wall time")),
    ]


def _details(scene: str, findings: Findings) -> list[PageSection]:
    outputs = [
        (e.pair.replace("_vs_", " to "), e.output, f"{e.largest:.2g}", f"{e.rms:.2g}")
        for e in findings.outputs
    ]
    numbers = {k: v for k, v in findings.metrics.items() if not isinstance(v, Mapping)}
    head = ("solutions", "output", "largest error", "rms error")
    facts, notes = (
        [fact(k, v, findings.units.get(k, "")) for k, v in numbers.items()],
        " ".join(findings.notes),
    )
    return [
        PageSection(f"{scene}: each output", outputs, head),
        PageSection(f"{scene}: results", facts, note=notes),
        PageSection(f"{scene}: figures", figures=findings.figures),
    ]


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
    selected = _largest(common, exact, units)
    if not selected or np.ptp(exact[scale]) == 0:
        return
    panels = []
    for wave in selected:
        curves = tuple(
            Curve(n, factor * w[scale].real, _size(w[wave]), "-" if k else "reference")
            for k, (n, w) in enumerate(solutions.items())
        )
        unit = units.get(wave, "")
        panels.append(Panel(label, f"{wave} in {unit}" if unit else wave, curves))
    over, caption = f"{title}: solutions over each other", f"Reference (dotted): {first}."
    yield Figure(f"{name}_solutions", over, caption, tuple(panels))
    x = exact[scale].real
    errors = tuple(
        Curve(f"{n}, {wave}", factor * x, np.maximum(_difference(w, exact, scale, wave), FLOOR))
        for n, w in others
        for wave in selected
    )
    panel = Panel(label, f"difference to {first} / largest value", errors, log_y=True)
    caption = f"Differences to {first}, each over the wave's largest value."
    yield Figure(f"{name}_differences", f"{title}: differences", caption, (panel,))


def responses(name: str, curves: Solutions) -> Iterator[Figure]:
    """Responses of one body port by port to itself, every solution of it."""
    last = list(curves.values())[-1]
    pairs = [n for n in last if ">" in n and len({*n.split(">")}) == 1][:MOST]
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
        title = f"{name}: response of the emitted subcircuit"
        caption = "Each port's answer to a unit load on itself; points are direct solutions of the "
        yield Figure(f"{name}_response", title, f"{caption}full model.", tuple(panels))


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
