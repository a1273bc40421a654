"""Figures as data for the browser, which ``templates/plots.js`` draws with the library uPlot.

uPlot wants curves over ascending x. So a curve that turns back becomes one curve for each
direction, points are sorted, and equal numbers of x become neighbouring ones.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np
from jinja2.utils import htmlsafe_json_dumps

from kc2spice.core.figure import Curve, Figure, Map, Panel
from kc2spice.core.prefix import PREFIXES, prefix_power

SHOWN = 4000  # points of a panel, about; two for each pixel of a wide screen
MOST = 4  # curves in one legend
# Units that take a prefix on an axis.
_PLAIN = {"m", "m/s", "s", "V", "A", "W", "N", "J", "C", "F", "H", "Hz", "Pa", "T", "g", "Ω"}


def figure_html(figure: Figure) -> str:
    """The element ``<figure>`` from which the page's script draws: panels as JSON, a caption.

    Panels without a curve are left out, and so is a figure that has no others.
    """
    drawn = [panel for panel in figure.panels if panel.curves or panel.map is not None]
    panels = [part for panel in drawn for part in _split_curves(_with_units(_ascending(panel)))]
    if not panels:
        return ""
    stacked = figure.columns == 1
    if stacked:
        panels = _with_x_unit(panels, next((p.x for p in reversed(panels) if p.x), ""))
    else:
        panels = [one for panel in panels for one in _with_x_unit([panel], panel.x)]
    span = _union(list(map(_range_x, panels))) if stacked else None
    data = {
        "title": figure.title,
        "columns": figure.columns,
        "panels": [
            _panel(figure.title, p, span, not stacked or k == len(panels))
            for k, p in enumerate(panels, 1)
        ],
    }
    text = htmlsafe_json_dumps(data, separators=(",", ":"), default=np.generic.item)
    return (
        f'<figure data-plot><script type="application/json">{text}</script>'
        f"<figcaption>{escape(figure.caption)}</figcaption></figure>"
    )


# --- what a panel shows -------------------------------------------------------------------------


def _ascending(panel: Panel) -> Panel:
    """``panel`` with curves over ascending x, unless its axes are equal: these are outlines."""
    if panel.equal:
        return panel
    curves = [part for curve in panel.curves for part in _directions(curve)]
    curves.sort(key=lambda curve: curve.style == "reference")  # the last one is on top
    return replace(panel, curves=tuple(curves))


def _directions(curve: Curve) -> Iterator[Curve]:
    x, y = np.asarray(curve.x, dtype=float), np.asarray(curve.y, dtype=float)
    if curve.style == "o":
        order = np.argsort(x, kind="stable")
        names = tuple(curve.names[k] for k in order) if curve.names else ()
        yield replace(curve, x=x[order], y=y[order], names=names)
        return
    steps = np.flatnonzero(np.diff(x))
    turns = steps[1:][np.diff(np.sign(np.diff(x)[steps])) != 0]
    starts, ends = [0, *turns], [*turns, x.size - 1]
    for k, (first, last) in enumerate(zip(starts, ends, strict=True)):
        order = np.arange(first, last + 1)
        if x[first] > x[last]:
            order = order[::-1]
        label = curve.label if k == 0 else f"{curve.label}, back".lstrip(", ")
        names = tuple(curve.names[j] for j in order) if curve.names else ()
        yield replace(curve, label=label, x=x[order], y=y[order], names=names)


def _with_units(panel: Panel) -> Panel:
    """``panel`` with the SI prefix that suits the largest value, unless its y axis has powers of
    ten."""
    if panel.equal:
        return panel
    if panel.map is not None:
        label, scale = _with_prefix(panel.map.label, [panel.map.z])
        return replace(panel, map=replace(panel.map, label=label, z=scale * panel.map.z))
    levels = np.array([level for level, _ in panel.levels])
    label, scale = _with_prefix(panel.y, [*(curve.y for curve in panel.curves), levels])
    if scale == 1.0 or (panel.log_y and _has_decade(panel)):
        return panel  # its numbers are powers of ten
    return replace(
        panel,
        y=label,
        curves=tuple(replace(c, y=scale * np.asarray(c.y)) for c in panel.curves),
        levels=tuple((scale * level, text) for level, text in panel.levels),
        bands=tuple((scale * low, scale * high, text) for low, high, text in panel.bands),
    )


def _has_decade(panel: Panel) -> bool:
    y = _all_y(panel)
    y = y[np.isfinite(y) & (y > 0.0)]
    return bool(y.size) and bool(y.max() >= 10.0 * y.min())


def _with_x_unit(panels: Sequence[Panel], label: str) -> list[Panel]:
    """``panels`` over one x axis of this label, which gets the SI prefix that suits it."""
    values = [curve.x for panel in panels for curve in panel.curves]
    values += [panel.map.x for panel in panels if panel.map is not None]
    name, scale = _with_prefix(label, values)
    if any(panel.log_x or panel.equal for panel in panels) or scale == 1.0:
        return [replace(panel, x=panel.x or label) for panel in panels]
    return [_rescale_x(panel, name, scale) for panel in panels]


def _rescale_x(panel: Panel, label: str, scale: float) -> Panel:
    return replace(
        panel,
        x=label,
        curves=tuple(replace(c, x=scale * np.asarray(c.x)) for c in panel.curves),
        marks=tuple((scale * place, text) for place, text in panel.marks),
        span=panel.span and (scale * panel.span[0], scale * panel.span[1]),
        map=panel.map and replace(panel.map, x=scale * np.asarray(panel.map.x)),
    )


def _with_prefix(label: str, values: Sequence[np.ndarray]) -> tuple[str, float]:
    """``quantity in unit`` with the prefix that suits the largest of ``values``, which are to be
    multiplied by the second number."""
    quantity, _, text = label.rpartition(" in ")
    factor, unit = _without_prefix(text)
    largest = max((_largest(np.asarray(v, dtype=float)) for v in values), default=0.0)
    if not quantity or unit not in _PLAIN or largest == 0.0:
        return label, 1.0
    power = prefix_power(largest * factor)
    scale = factor / 10.0**power
    if abs(scale - 1.0) < 1e-9:
        return label, 1.0
    return f"{quantity} in {PREFIXES[power]}{unit}", scale


def _without_prefix(unit: str) -> tuple[float, str]:
    """Factor and unit without the prefix of ``unit``: ``mA`` is 1e-3 times ``A``."""
    if unit in _PLAIN:
        return 1.0, unit
    for power, prefix in PREFIXES.items():
        if prefix and unit.startswith(prefix) and unit.removeprefix(prefix) in _PLAIN:
            return 10.0**power, unit.removeprefix(prefix)
    return 1.0, unit


def _largest(values: np.ndarray) -> float:
    return float(np.abs(values[np.isfinite(values)]).max(initial=0.0))


def _split_curves(panel: Panel) -> Iterator[Panel]:
    """Panels of at most ``MOST`` curves; a reference is in each of them."""
    if panel.equal or len(panel.curves) <= MOST:
        yield panel
        return
    shared = [c for c in panel.curves if c.style == "reference"][:1]
    others = [c for c in panel.curves if c not in shared]
    count = -(-len(others) // (MOST - len(shared)))
    for part in np.array_split(np.arange(len(others)), count):
        yield replace(panel, curves=(*(others[k] for k in part), *shared))


# --- its data -----------------------------------------------------------------------------------

Range = tuple[float, float]


def _panel(title: str, panel: Panel, span: Range | None, last: bool) -> dict[str, Any]:
    """A panel as the script reads it; ``span`` is the range of x of all panels above each other,
    ``last`` whether its x axis has numbers."""
    span = _as_encoded(span or _range_x(panel))
    result: dict[str, Any] = {
        "x": panel.x, "y": panel.y, "log_x": panel.log_x, "log_y": panel.log_y,
        "equal": panel.equal, "last": last, "spoken": _spoken(title, panel, span),
        "levels": panel.levels, "bands": panel.bands, "marks": panel.marks,
        "range_x": span, "curves": [], "outlines": [], "map": None,
    }  # fmt: skip
    outlines = panel.equal or panel.map is not None
    selected = zip(panel.curves, _selected_points(panel), strict=True)
    curves = [_curve(curve, points, not outlines) for curve, points in selected]
    if outlines:
        range_y = _range_y(panel)
        result |= {"outlines": curves, "whole_x": span, "whole_y": range_y, "range_y": range_y}
    else:
        result["curves"] = curves
    if panel.map is not None:
        low, high = _ends(panel.map.z)
        result |= {"map": _map(panel.map, low, high), "low": low, "high": high}
    return result


def _as_encoded(span: Range) -> Range:
    """Ends that include the first and the last point also in the single precision of a page."""
    low, high = np.array(span, dtype=np.float32).tolist()
    return min(span[0], low), max(span[1], high)


def _spoken(title: str, panel: Panel, span: Range) -> str:
    """Alternative text: what is drawn over what, and the ranges of both."""
    low, high = _ends(panel.map.z if panel.map is not None else _all_y(panel))
    what = panel.map.label if panel.map is not None else panel.y
    names = ", ".join(c.label for c in panel.curves if c.label)
    text = f"{title}: {what} from {low:.4g} to {high:.4g}"
    text += f" over {panel.x or 'x'} from {span[0]:.4g} to {span[1]:.4g}"
    return f"{text}; {names}" if names else text


def _all_y(panel: Panel) -> np.ndarray:
    return np.concatenate([np.zeros(0), *(np.asarray(c.y, dtype=float) for c in panel.curves)])


def _ends(values: np.ndarray) -> Range:
    known = np.asarray(values, dtype=float)
    known = known[np.isfinite(known)]
    return (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)


def _range_x(panel: Panel) -> Range:
    if panel.span is not None:
        return panel.span
    if panel.map is not None:
        ends = _outer(panel.map.x, panel.log_x)
    else:
        halves = list(map(_half_bar, panel.curves))
        both = [_ends(curve.x) for curve in panel.curves]
        ends = _union([(a - h, b + h) for (a, b), h in zip(both, halves, strict=True)])
    return _widen_range(ends)


def _range_y(panel: Panel) -> Range:
    if panel.map is not None:
        return _widen_range(_outer(panel.map.y, panel.log_y))
    return _widen_range(_ends(_all_y(panel)))


def _outer(centres: np.ndarray, log: bool) -> Range:
    """Outer edges of the cells about ``centres``."""
    at = np.log10(centres) if log else np.asarray(centres, dtype=float)
    half = np.diff(at)[[0, -1]] / 2 if at.size > 1 else np.full(2, 0.5)
    low, high = at[0] - half[0], at[-1] + half[1]
    return (float(10**low), float(10**high)) if log else (float(low), float(high))


def _half_bar(curve: Curve) -> float:
    return float(curve.x[1] - curve.x[0]) / 2 if curve.style == "bar" and len(curve.x) > 1 else 0.0


def _union(ranges: Sequence[Range]) -> Range:
    return min(low for low, _ in ranges), max(high for _, high in ranges)


def _widen_range(ends: Range) -> Range:
    """A range that is one number becomes one about it."""
    low, high = ends
    half = abs(low) / 2 or 1.0
    return (low, high) if low < high else (low - half, high + half)


def _curve(curve: Curve, indices: np.ndarray, ascending: bool) -> dict[str, Any]:
    x = np.asarray(curve.x, dtype="<f4")[indices]
    y = _encode(np.asarray(curve.y, dtype=float)[indices])
    names = [curve.names[k] for k in indices] if curve.names else []
    at = _encode(_separate_equal(x) if ascending else x)
    return {"label": curve.label, "style": curve.style, "x": at, "y": y, "names": names}


def _map(field: Map, low: float, high: float) -> dict[str, str]:
    """Centres, and colours as whole numbers: 0 is ``low``, 65534 ``high``, 65535 no colour."""
    share = (np.asarray(field.z, dtype=float) - low) / ((high - low) or 1.0)
    z = np.where(np.isfinite(share), np.round(65534 * share), 65535).astype("<u2")
    axes = {name: _encode(getattr(field, name)) for name in "xy"}
    return {"label": field.label, **axes, "z": base64.b64encode(z.tobytes()).decode("ascii")}


def _encode(values: np.ndarray) -> str:
    """Little-endian float32, row by row."""
    return base64.b64encode(np.asarray(values).astype("<f4").tobytes()).decode("ascii")


def _separate_equal(x: np.ndarray) -> np.ndarray:
    """Ascending float32, equal numbers replaced by the next larger ones.

    The bits of positive floats are ordered as integers are; those of negative ones descend.
    """
    bits = x.view("<i4").astype(np.int64)
    rank = np.where(bits < 0, -(bits & 0x7FFFFFFF), bits)
    place = np.arange(x.size)
    rank = np.maximum.accumulate(rank - place) + place
    bits = np.where(rank < 0, -rank - 2**31, rank)
    return bits.astype("<i4").view("<f4")


def _selected_points(panel: Panel) -> list[np.ndarray]:
    """Indices of the points of each curve that a page contains; curves over one x share them."""
    curves = panel.curves
    if panel.equal or panel.map is not None:
        return [np.arange(len(curve.x)) for curve in curves]
    count = max(len(curves), 1)
    alone = [_thin_points(np.asarray(curve.y, dtype=float), SHOWN // count) for curve in curves]
    if all(np.array_equal(curve.x, curves[0].x) for curve in curves[1:]):
        both = np.unique(np.concatenate([np.zeros(0, dtype=int), *alone]))
        return [both] * len(curves)
    return alone


def _thin_points(y: np.ndarray, count: int) -> np.ndarray:
    """Indices of about ``count`` points: of each stretch of points its extremes, and both sides of
    the largest jumps and of gaps, so that neither peaks nor corners are lost."""
    if y.size <= count:
        return np.arange(y.size)
    stretch = -(-y.size // (count // 4))
    padded = np.full(stretch * -(-y.size // stretch), np.nan)
    padded[: y.size] = y
    rows = padded.reshape(-1, stretch)
    known, first = np.isfinite(rows), stretch * np.arange(rows.shape[0])
    low = first + np.where(known, rows, np.inf).argmin(axis=1)
    high = first + np.where(known, rows, -np.inf).argmax(axis=1)
    steps = np.abs(np.diff(y))
    steps[~np.isfinite(steps)] = np.inf
    jumps = np.argpartition(steps, -count // 4)[-count // 4 :]
    mask = np.zeros(y.size, dtype=bool)
    for selected in ([0, -1], low, high, jumps, jumps + 1):
        mask[selected] = True
    return np.flatnonzero(mask)
