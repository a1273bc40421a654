"""Conversion of figures to data for the script that draws figures in the browser.

The script ``templates/plots.js`` draws the figures with the library uPlot. uPlot requires that the
values of x increase. Therefore, a curve is divided into several curves at points where x changes
direction. The points of each curve are sorted by x. Repeated values of x are replaced by adjacent
floating-point numbers.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from html import escape
from itertools import chain
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np
from jinja2.utils import htmlsafe_json_dumps

from kc2spice.core.figure import ColourMap, Curve, Figure, Panel
from kc2spice.core.si_prefix_format import PREFIXES, get_prefix_exponent

# approximate number of points in a panel: two points for each horizontal pixel of a wide screen
PANEL_POINTS = 4000
LEGEND_CURVES = 4  # largest number of curves in one legend
# units to which an axis adds an SI prefix
_PREFIXABLE_UNITS = {
    "m", "m/s", "s", "V", "A", "W", "N", "J", "C", "F", "H", "Hz", "Pa", "T", "g", "Ω",
}  # fmt: skip


def render_figure(figure: Figure) -> str:
    """Return a figure as the HTML element ``<figure>``.

    The element contains the caption, and the panels as JSON. Panels that contain neither curves nor
    a map are omitted. Return an empty string if no panel remains.
    """
    stacked = figure.columns == 1
    panels = list(chain.from_iterable(map(_split_panel, figure.panels)))
    if not panels:
        return ""
    if stacked:
        labels = list(filter(None, map(attrgetter("x"), panels)))
        panels = _scale_x(panels, labels[-1] if labels else "")
    else:
        panels = list(chain.from_iterable(_scale_x([panel], panel.x) for panel in panels))
    span = _join_ranges(map(_find_x_range, panels)) if stacked else None
    numbered = [*[not stacked] * (len(panels) - 1), True]
    data = {
        "title": figure.title,
        "columns": figure.columns,
        "panels": [
            _encode_panel(figure.title, panel, span, last)
            for panel, last in zip(panels, numbered, strict=True)
        ],
    }
    text = htmlsafe_json_dumps(data, separators=(",", ":"), default=np.generic.item)
    return (
        f'<figure data-plot><script type="application/json">{text}</script>'
        f"<figcaption>{escape(figure.caption)}</figcaption></figure>"
    )


# --- curves and units of a panel ------------------------------------------------------------------


def _split_panel(panel: Panel) -> Iterator[Panel]:
    """Split a panel into panels with few curves, each with increasing x.

    A panel without curves and without a map yields no panels.
    """
    if panel.curves or panel.map is not None:
        yield from _split_curves(_scale_y(_sort_curves(panel)))


def _sort_curves(panel: Panel) -> Panel:
    """Return a panel with curves whose x increases.

    A panel with equal scales of both axes is returned unchanged, because the points of outlines
    must keep their order.
    """
    if panel.equal:
        return panel
    curves = chain.from_iterable(map(_split_at_turns, panel.curves))
    # the last curve, here the reference curve, is drawn above all other curves
    return replace(panel, curves=tuple(sorted(curves, key=_is_reference)))


def _is_reference(curve: Curve) -> bool:
    """Return whether a curve shows reference values."""
    return curve.style == "reference"


def _split_at_turns(curve: Curve) -> Iterator[Curve]:
    """Yield a curve with increasing x for each section between two turning points."""
    x = np.asarray(curve.x, dtype=float)
    if curve.style == "o":
        yield _select_points(curve, np.argsort(x, kind="stable"))
        return
    steps = np.flatnonzero(np.diff(x))
    turns = steps[1:][np.diff(np.sign(np.diff(x)[steps])) != 0]
    starts, ends = [0, *turns], [*turns, x.size - 1]
    for k, (first, last) in enumerate(zip(starts, ends, strict=True)):
        order = np.arange(first, last + 1)
        if x[first] > x[last]:
            order = order[::-1]
        label = curve.label if k == 0 else f"{curve.label}, back".lstrip(", ")
        yield replace(_select_points(curve, order), label=label)


def _select_points(curve: Curve, indices: np.ndarray) -> Curve:
    """Return a curve with only the points at ``indices``, in the order of ``indices``."""
    names = tuple(map(curve.names.__getitem__, indices)) if curve.names else ()
    x, y = np.asarray(curve.x, dtype=float), np.asarray(curve.y, dtype=float)
    return replace(curve, x=x[indices], y=y[indices], names=names)


def _scale_y(panel: Panel) -> Panel:
    """Return a panel with a y axis whose SI prefix suits the largest value.

    A y axis that shows powers of ten has no SI prefix. In a panel with a colour map, the SI prefix
    applies to the values of the colour map.
    """
    if panel.equal:
        return panel
    if panel.map is not None:
        label, scale = _choose_prefix(panel.map.label, panel.map.z)
        return replace(panel, map=replace(panel.map, label=label, z=scale * panel.map.z))
    levels = list(map(itemgetter(0), panel.levels))
    label, scale = _choose_prefix(panel.y, np.append(_collect_y_values(panel), levels))
    if scale == 1.0 or (panel.log_y and _spans_decade(panel)):
        return panel  # the axis shows powers of ten
    return replace(
        panel,
        y=label,
        curves=tuple(replace(curve, y=scale * np.asarray(curve.y)) for curve in panel.curves),
        levels=tuple(_scale_labelled_numbers(panel.levels, scale)),
        bands=tuple(_scale_labelled_numbers(panel.bands, scale)),
    )


def _scale_labelled_numbers(rows: Iterable[Sequence[Any]], scale: float) -> Iterator[Any]:
    """Multiply the numbers in rows ``(number, …, label)`` by ``scale``."""
    for *numbers, label in rows:
        yield (*(scale * np.array(numbers)).tolist(), label)


def _spans_decade(panel: Panel) -> bool:
    """Return whether the positive values of y span at least a decade.

    A decade is a ratio of ten between the largest and the smallest value.
    """
    y = _collect_y_values(panel)
    y = y[np.isfinite(y) & (y > 0.0)]
    return bool(y.size) and bool(y.max() >= 10.0 * y.min())


def _scale_x(panels: Sequence[Panel], label: str) -> list[Panel]:
    """Return panels with a suitable SI prefix for the common x axis.

    ``label`` is the label of the x axis.
    """
    values = np.concatenate(list(map(_collect_x_values, panels)))
    name, scale = _choose_prefix(label, values)
    if scale == 1.0 or any(panel.log_x or panel.equal for panel in panels):
        return [replace(panel, x=panel.x or label) for panel in panels]
    return [_multiply_x(panel, name, scale) for panel in panels]


def _multiply_x(panel: Panel, label: str, scale: float) -> Panel:
    """Return a panel with a new x label and values of x multiplied by ``scale``."""
    return replace(
        panel,
        x=label,
        curves=tuple(replace(curve, x=scale * np.asarray(curve.x)) for curve in panel.curves),
        marks=tuple(_scale_labelled_numbers(panel.marks, scale)),
        span=panel.span and (scale * panel.span[0], scale * panel.span[1]),
        map=panel.map and replace(panel.map, x=scale * np.asarray(panel.map.x)),
    )


def _choose_prefix(label: str, values: np.ndarray) -> tuple[str, float]:
    """Choose an SI prefix for the ``values`` on an axis.

    Return the axis label with the prefix, and the factor by which the values must be multiplied.
    """
    quantity, _, text = label.rpartition(" in ")
    factor, unit = _split_prefix(text)
    finite = np.asarray(values, dtype=float)
    largest = float(np.abs(finite[np.isfinite(finite)]).max(initial=0.0))
    if not quantity or unit not in _PREFIXABLE_UNITS or largest == 0.0:
        return label, 1.0
    power = get_prefix_exponent(largest * factor)
    scale = factor / 10.0**power
    if abs(scale - 1.0) < 1e-9:
        return label, 1.0
    return f"{quantity} in {PREFIXES[power]}{unit}", scale


def _split_prefix(unit: str) -> tuple[float, str]:
    """Split a unit into the factor of the SI prefix and the unit without prefix.

    For example, mA is split into 1e-3 and A.
    """
    if unit in _PREFIXABLE_UNITS:
        return 1.0, unit
    for power, prefix in PREFIXES.items():
        plain = unit.removeprefix(prefix)
        if prefix and unit.startswith(prefix) and plain in _PREFIXABLE_UNITS:
            return 10.0**power, plain
    return 1.0, unit


def _split_curves(panel: Panel) -> Iterator[Panel]:
    """Yield panels with at most ``LEGEND_CURVES`` curves each.

    The first reference curve is in every panel.
    """
    if panel.equal or len(panel.curves) <= LEGEND_CURVES:
        yield panel
        return
    shared = list(filter(_is_reference, panel.curves))[:1]
    others = [curve for curve in panel.curves if curve not in shared]
    count = -(-len(others) // (LEGEND_CURVES - len(shared)))
    for indices in np.array_split(np.arange(len(others)), count):
        yield replace(panel, curves=(*others[indices[0] : indices[-1] + 1], *shared))


# --- data for the script --------------------------------------------------------------------------

Range = tuple[float, float]


def _encode_panel(title: str, panel: Panel, span: Range | None, last: bool) -> dict[str, Any]:
    """Encode a panel as data for the script in the browser.

    ``span`` is the common range of x of all panels, or None if each panel has a separate range.
    Only the ``last`` panel shows numbers at the x axis.
    """
    span = _round_outwards(span or _find_x_range(panel))
    result: dict[str, Any] = {
        "x": panel.x, "y": panel.y, "log_x": panel.log_x, "log_y": panel.log_y,
        "equal": panel.equal, "last": last, "spoken": _describe_panel(title, panel, span),
        "levels": panel.levels, "bands": panel.bands, "marks": panel.marks,
        "range_x": span, "curves": [], "outlines": [], "map": None,
    }  # fmt: skip
    outlines = panel.equal or panel.map is not None
    points = zip(panel.curves, _select_point_indices(panel), strict=True)
    curves = [_encode_curve(curve, indices, not outlines) for curve, indices in points]
    if outlines:
        range_y = _find_y_range(panel)
        result |= {"outlines": curves, "whole_x": span, "whole_y": range_y, "range_y": range_y}
    else:
        result["curves"] = curves
    if panel.map is not None:
        low, high = _find_finite_range(panel.map.z)
        result |= {"map": _encode_map(panel.map, low, high), "low": low, "high": high}
    return result


def _round_outwards(span: Range) -> Range:
    """Widen ``span`` so that it also contains its ends rounded to single precision."""
    low, high = np.array(span, dtype=np.float32).tolist()
    return min(span[0], low), max(span[1], high)


def _describe_panel(title: str, panel: Panel, span: Range) -> str:
    """Return the alternative text of a panel: quantities, ranges, names of curves."""
    low, high = _find_finite_range(
        panel.map.z if panel.map is not None else _collect_y_values(panel)
    )
    quantity = panel.map.label if panel.map is not None else panel.y
    names = ", ".join(filter(None, map(attrgetter("label"), panel.curves)))
    text = f"{title}: {quantity} from {low:.4g} to {high:.4g}"
    text += f" over {panel.x or 'x'} from {span[0]:.4g} to {span[1]:.4g}"
    return f"{text}; {names}" if names else text


def _collect_x_values(panel: Panel) -> np.ndarray:
    """Return the x values of all curves and of the map of a panel as one array."""
    maps = [panel.map.x] if panel.map is not None else []
    return np.concatenate([np.zeros(0), *map(attrgetter("x"), panel.curves), *maps])


def _collect_y_values(panel: Panel) -> np.ndarray:
    """Return the y values of all curves of a panel as one array."""
    return np.concatenate([np.zeros(0), *map(attrgetter("y"), panel.curves)])


def _find_finite_range(values: np.ndarray) -> Range:
    """Return the smallest and the largest finite value.

    The result is (0, 1) if no value is finite.
    """
    known = np.asarray(values, dtype=float)
    known = known[np.isfinite(known)]
    return (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)


def _find_x_range(panel: Panel) -> Range:
    """Return the range of the x axis of a panel."""
    if panel.span is not None:
        return panel.span
    if panel.map is not None:
        return _widen_range(_find_cell_edges(panel.map.x, panel.log_x))
    return _widen_range(_join_ranges(map(_find_curve_range, panel.curves)))


def _find_y_range(panel: Panel) -> Range:
    """Return the range of the y axis of a panel."""
    if panel.map is not None:
        return _widen_range(_find_cell_edges(panel.map.y, panel.log_y))
    return _widen_range(_find_finite_range(_collect_y_values(panel)))


def _find_cell_edges(centres: np.ndarray, log: bool) -> Range:
    """Compute the outer edges of a row of map cells from the cells' ``centres``."""
    at = np.log10(centres) if log else np.asarray(centres, dtype=float)
    half = np.diff(at)[[0, -1]] / 2 if at.size > 1 else np.full(2, 0.5)
    low, high = at[0] - half[0], at[-1] + half[1]
    return (float(10**low), float(10**high)) if log else (float(low), float(high))


def _find_curve_range(curve: Curve) -> Range:
    """Return the range of x of a curve, including the widths of bars."""
    low, high = _find_finite_range(curve.x)
    bars = curve.style == "bar" and len(curve.x) > 1
    half = float(curve.x[1] - curve.x[0]) / 2 if bars else 0.0
    return low - half, high + half


def _join_ranges(ranges: Iterable[Range]) -> Range:
    """Return the smallest range that contains all ``ranges``."""
    lows, highs = zip(*ranges, strict=True)
    return min(lows), max(highs)


def _widen_range(ends: Range) -> Range:
    """Return a range with the given ends, or a wider range if both ends are equal."""
    low, high = ends
    half = abs(low) / 2 or 1.0
    return (low, high) if low < high else (low - half, high + half)


def _encode_curve(curve: Curve, indices: np.ndarray, ascending: bool) -> dict[str, Any]:
    """Encode points of a curve as data for the script in the browser.

    ``indices`` are the indices of the points.

    If ``ascending`` is true, repeated values of x are replaced by adjacent floating-point numbers.
    """
    points = _select_points(curve, indices)
    x = points.x.astype("<f4")
    return {
        "label": curve.label,
        "style": curve.style,
        "x": _encode_numbers(_separate_equal_numbers(x) if ascending else x),
        "y": _encode_numbers(points.y),
        "names": points.names,
    }


def _encode_map(field: ColourMap, low: float, high: float) -> dict[str, str]:
    """Encode a map as the centres and the colour numbers of all cells.

    The colour number is 0 for the value ``low``, 65534 for ``high``, and 65535 for a missing value.
    """
    share = (np.asarray(field.z, dtype=float) - low) / ((high - low) or 1.0)
    z = np.where(np.isfinite(share), np.round(65534 * share), 65535).astype("<u2")
    return {
        "label": field.label,
        "x": _encode_numbers(field.x),
        "y": _encode_numbers(field.y),
        "z": base64.b64encode(z.tobytes()).decode("ascii"),
    }


def _encode_numbers(values: np.ndarray) -> str:
    """Encode values as little-endian float32 numbers in base64, row by row."""
    return base64.b64encode(np.asarray(values).astype("<f4").tobytes()).decode("ascii")


def _separate_equal_numbers(x: np.ndarray) -> np.ndarray:
    """Replace repeated float32 numbers by the next larger ones, so that all differ.

    The numbers in ``x`` must not decrease.

    The bit patterns of positive floats, interpreted as integers, increase with the floats. The bit
    patterns of negative floats decrease with increasing floats.
    """
    bits = x.view("<i4").astype(np.int64)
    rank = np.where(bits < 0, -(bits & 0x7FFFFFFF), bits)
    place = np.arange(x.size)
    rank = np.maximum.accumulate(rank - place) + place
    bits = np.where(rank < 0, -rank - 2**31, rank)
    return bits.astype("<i4").view("<f4")


def _select_point_indices(panel: Panel) -> list[np.ndarray]:
    """Return, for each curve, the indices of the points that are written to the page.

    If all curves have the same values of x, all curves have the same indices.
    """
    curves = panel.curves
    if panel.equal or panel.map is not None:
        return [np.arange(len(curve.x)) for curve in curves]
    count = max(len(curves), 1)
    alone = [
        _thin_points(np.asarray(curve.y, dtype=float), PANEL_POINTS // count) for curve in curves
    ]
    if all(np.array_equal(curve.x, curves[0].x) for curve in curves[1:]):
        both = np.unique(np.concatenate([np.zeros(0, dtype=int), *alone]))
        return [both] * len(curves)
    return alone


def _thin_points(y: np.ndarray, count: int) -> np.ndarray:
    """Select about ``count`` points that preserve the peaks and corners of a curve.

    Return the indices of the selected points: extremes of each group of consecutive points, and
    points on both sides of gaps and large jumps. ``y`` contains the values of the curve.
    """
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
