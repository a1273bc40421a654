"""Figures that are data, drawn as SVG: the pictures of a run within milliseconds, where loading
matplotlib alone takes longer than a simulation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel
from kc2spice.report.plots import BLACK, GREEN, GREY, MANY, PALETTE, Picture

WIDE, ALONE, AMONG = 700.0, 400.0, 260.0  # of a picture; heights of one panel, of one of several
LETTER = 7.2  # width of a letter of the size below
_HEAD = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {w:.0f} {h:.0f}" width="{w:.0f}" '
    'height="{h:.0f}" font-family="\'DejaVu Sans\', system-ui, sans-serif" font-size="13">'
    '<title>{title}</title><rect width="100%" height="100%" fill="#FFF"/>'
)
_DASHES = {"--": "7 4", ":": "2 3", "-.": "7 3 2 3", "reference": "2 5"}


@dataclass(frozen=True)
class _Axis:
    """Data from ``low`` to ``high``, of which the logarithm counts where ``log``, lie between the
    places ``first`` and ``last``."""

    low: float
    high: float
    log: bool
    first: float
    last: float

    def place(self, values: np.ndarray | float) -> np.ndarray:
        shares = (_scaled(values, self.log) - self.low) / (self.high - self.low)
        return self.first + shares * (self.last - self.first)

    def ticks(self) -> list[tuple[float, str]]:
        """Places and labels: 1, 2, 5, … or decades of a logarithmic axis, else round steps."""
        if self.log:
            decades = range(math.floor(self.low), math.ceil(self.high) + 1)
            digits = (1, 2, 5) if self.high - self.low < 3 else (1,)
            values = [k * 10.0**d for d in decades for k in digits]
            values = [v for v in values if self.low - 1e-9 <= math.log10(v) <= self.high + 1e-9]
            if len(values) > 1:
                return [(float(self.place(v)), f"{v:g}") for v in values]
        ends = (10.0**self.low, 10.0**self.high) if self.log else (self.low, self.high)
        each = 85 if self.last > self.first else 38  # of x, of y
        raw = (ends[1] - ends[0]) / max(2.0, abs(self.last - self.first) / each)
        power = 10.0 ** math.floor(math.log10(raw))
        step = next(k for k in (1, 2, 2.5, 5, 10) if k * power >= raw * (1 - 1e-9)) * power
        numbers = range(math.ceil(ends[0] / step - 1e-9), math.floor(ends[1] / step + 1e-9) + 1)
        return [(float(self.place(k * step)), _number(k * step, step)) for k in numbers]


def draw_all(directory: Path, figures: Sequence[Figure]) -> list[Picture]:
    """Draw every figure into ``directory`` as ``NAME.svg``."""
    pictures = []
    for figure in figures:
        path = directory / f"{figure.name}.svg"
        path.write_text(_picture(figure), encoding="utf-8")
        pictures.append(Picture(path, figure.title, figure.caption, figure))
    return pictures


def _picture(figure: Figure) -> str:
    """All panels below each other, over one range of x."""
    panels = figure.panels
    each = ALONE if len(panels) == 1 else AMONG
    spans = [p.span for p in panels if p.span is not None]
    x = [curve.x for panel in panels for curve in panel.curves]
    reach = spans[0] if spans else _extent(x, panels[0].log_x)
    beside = max((_beside(p) for p in panels), default=0.0)
    items = [
        _panel(panel, reach, k * each, (k + 1) * each, beside, last=k + 1 == len(panels))
        for k, panel in enumerate(panels)
    ]
    head = _HEAD.format(w=WIDE, h=each * len(panels), title=escape(figure.title))
    return head + "".join(items) + "</svg>\n"


def _panel(
    panel: Panel, reach: tuple[float, float], top: float, bottom: float, beside: float, last: bool
) -> str:
    labels = _labels(panel)
    left, right = 76.0, WIDE - 16.0 - beside
    up = top + (30.0 if 1 < len(labels) <= MANY else 14.0)
    down = bottom - (48.0 if last or panel.x else 22.0)
    low, high = (float(v) for v in _scaled(np.array(reach), panel.log_x))
    x = _Axis(low, high, panel.log_x, left, right)
    y = _Axis(*_heights(panel, reach), panel.log_y, down, up)
    if panel.equal:
        x, y = _one_scale(x, y)
    clip = f"c{top:.0f}"
    items = [f'<clipPath id="{clip}">{_box(left, up, right, down)}</clipPath><g stroke="#E3E3E3">']
    items += [_line(v, up, v, down) for v, _ in x.ticks()]
    items += [_line(left, v, right, v) for v, _ in y.ticks()]
    look = 'fill="none" stroke-width="1.6" stroke-linejoin="round"'
    items.append(f'</g><g clip-path="url(#{clip})" {look}>')
    for band in panel.bands:
        high, low = sorted(float(y.place(v)) for v in band[:2])
        items.append(_box(left, high, right, low, f'fill="{GREEN}" fill-opacity="0.15"'))
    for value, _ in panel.levels:
        v = float(y.place(value))
        items.append(_line(left, v, right, v, f'stroke="{GREY}" stroke-dasharray="2 3"'))
    for value, _ in panel.marks:
        v = float(x.place(value))
        items.append(_line(v, up, v, down, f'stroke="{GREEN}"'))
    items += [_curve(curve, _look(k, curve), x, y) for k, curve in enumerate(panel.curves)]
    corner = f"M{left:.1f} {up:.1f}V{down:.1f}H{right:.1f}"
    items.append(f'</g><path d="{corner}" fill="none" stroke="#555"/>')
    if last or panel.x:
        items += [_text(v, down + 18, text, "middle") for v, text in x.ticks()]
        items.append(_text((left + right) / 2, bottom - 10, panel.x, "middle"))
    items += [_text(left - 7, v + 4.5, text, "end") for v, text in y.ticks()]
    middle = (up + down) / 2
    turned = f'transform="rotate(-90 16 {middle:.1f})"'
    items.append(_text(16, middle, panel.y, "middle", turned))
    items += _legend(labels, left, up, right if beside else None)
    return "".join(items)


# --- what is shown where ------------------------------------------------------------------------


def _labels(panel: Panel) -> list[tuple[str, str, str]]:
    """Label, colour and style of what the legend names."""
    found = [(label, GREEN, "band") for _, _, label in panel.bands]
    found += [(label, GREY, ":") for _, label in panel.levels]
    found += [(label, GREEN, "-") for _, label in panel.marks]
    found += [(c.label, _look(k, c), c.style) for k, c in enumerate(panel.curves)]
    return [item for item in found if item[0]]


def _look(k: int, curve: Curve) -> str:
    return BLACK if curve.style == "reference" else PALETTE[k % len(PALETTE)]


def _beside(panel: Panel) -> float:
    """Width of a legend to the right of a panel, or none."""
    labels = [label for label, _, _ in _labels(panel)]
    return 40.0 + LETTER * max(map(len, labels)) if len(labels) > MANY else 0.0


def _legend(
    labels: list[tuple[str, str, str]], left: float, up: float, right: float | None
) -> list[str]:
    """In a line above the axes, or one below the other at their right, where it covers no data."""
    if len(labels) < 2:
        return []
    many, items = len(labels) > MANY, []
    x, y = (left, up - 10) if not many or right is None else (right + 10, up + 8)
    for label, colour, style in labels:
        if style == "o":
            items.append(f'<circle cx="{x + 11:.1f}" cy="{y:.1f}" r="3" fill="{colour}"/>')
        else:
            look = '9" stroke-opacity="0.15"' if style == "band" else f'1.6" {_stroke(style)}'
            items.append(_line(x, y, x + 22, y, f'stroke="{colour}" stroke-width="{look}'))
        items.append(_text(x + 27, y + 4.5, label))
        x, y = (x, y + 18) if many else (x + 42 + LETTER * len(label), y)
    return items


def _heights(panel: Panel, reach: tuple[float, float]) -> tuple[float, float]:
    """Range of y: what the curves have within ``reach``, levels and bands, and a little more."""
    inside = [c.y[(c.x >= reach[0]) & (c.x <= reach[1])] for c in panel.curves]
    more = [v for v, _ in panel.levels] + [v for a, b, _ in panel.bands for v in (a, b)]
    low, high = _scaled(np.array(_extent([*inside, np.array(more)], panel.log_y)), panel.log_y)
    return float(low - 0.05 * (high - low)), float(high + 0.05 * (high - low))


def _extent(values: Sequence[np.ndarray], log: bool) -> tuple[float, float]:
    """Least and largest number of ``values``, apart from each other."""
    flat = np.concatenate([[], *values])
    flat = flat[np.isfinite(flat) & ((flat > 0) | (not log))]
    low, high = (float(flat.min()), float(flat.max())) if flat.size else (1.0, 1.0)
    if high - low > 1e-12 * max(abs(low), abs(high)):
        return low, high
    return (low / 2, high * 2) if log else (low - (abs(low) or 1), high + (abs(high) or 1))


def _scaled(values: np.ndarray | float, log: bool) -> np.ndarray:
    values = np.asarray(values, dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log10(values) if log else values


def _one_scale(x: _Axis, y: _Axis) -> tuple[_Axis, _Axis]:
    """Both axes with the smaller scale of the two, about their middles."""
    scale = min(abs(a.last - a.first) / (a.high - a.low) for a in (x, y))
    found = []
    for axis in (x, y):
        half, middle = abs(axis.last - axis.first) / scale / 2, (axis.low + axis.high) / 2
        found.append(_Axis(middle - half, middle + half, False, axis.first, axis.last))
    return found[0], found[1]


# --- marks --------------------------------------------------------------------------------------


def _curve(curve: Curve, colour: str, x: _Axis, y: _Axis) -> str:
    at = np.column_stack((x.place(curve.x), y.place(curve.y)))
    at = np.clip(at, -1e5, 1e5)  # far outside the clipped frame all places are alike
    if curve.style == "o":
        points = at[np.isfinite(at).all(axis=1)]
        path, look = _path(points, "M%.1f %.1fh0"), 'stroke-width="6" stroke-linecap="round"'
    else:
        breaks = np.flatnonzero(~np.isfinite(at).all(axis=1))
        pieces = [p[1 if k else 0 :] for k, p in enumerate(np.split(at, breaks))]
        path = "".join("M" + _path(_seen(p), "%.1f %.1f ") for p in pieces if len(p))
        look = _stroke(curve.style)
    return f'<path d="{path.strip()}" stroke="{colour}" {look}/>'


def _seen(at: np.ndarray) -> np.ndarray:
    """Points (n, 2) of a line without those that no eye can tell from it: of each half of a unit
    of width the first, the last and the extremes stay."""
    column = np.floor(2 * at[:, 0])
    starts = np.flatnonzero(np.r_[True, np.diff(column) != 0])
    if 4 * starts.size >= len(at):
        return at
    ends = np.r_[starts[1:], len(at)]
    run = np.repeat(np.arange(starts.size), ends - starts)
    order = np.lexsort((at[:, 1], run))
    return at[np.unique(np.concatenate((starts, ends - 1, order[starts], order[ends - 1])))]


def _path(points: np.ndarray, form: str) -> str:
    return (form * len(points)) % tuple(points.ravel().tolist())


def _stroke(style: str) -> str:
    return f'stroke-dasharray="{_DASHES[style]}"' if style in _DASHES else ""


def _number(value: float, step: float) -> str:
    """As many digits as tell one multiple of ``step`` from the next."""
    if value == 0:
        return "0"
    if not 1e-4 < step < 1e5:
        return f"{value:.3g}".replace("-", "−")
    places = max(0, -math.floor(math.log10(step) + 1e-9))
    places += round(step * 10**places, 6) != round(step * 10**places)
    return f"{value:.{places}f}".replace("-", "−")


def _line(x1: float, y1: float, x2: float, y2: float, extra: str = "") -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" {extra}/>'


def _box(x1: float, y1: float, x2: float, y2: float, extra: str = "") -> str:
    size = f'width="{x2 - x1:.1f}" height="{y2 - y1:.1f}"'
    return f'<rect x="{x1:.1f}" y="{y1:.1f}" {size} {extra}/>'


def _text(x: float, y: float, text: str, anchor: str = "start", extra: str = "") -> str:
    place = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"'
    return f'<text {place} fill="{BLACK}" {extra}>{escape(text)}</text>'
