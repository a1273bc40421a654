"""Sketches of a scene as SVG: its devices from the side, to scale, and its circuit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from html import escape

from kc2spice.core.figure import Shape
from kc2spice.report.figures import BLACK, BLUE, GREEN, GREY
from kc2spice.scene.model import Scene, Terminal

WIDE, HIGH = 520.0, 300.0  # of the devices, in units of the page
LETTER = 6.2  # width of a letter
TRACK, BOX = 24.0, 74.0  # between two nets; height of a part
ORANGE = "#B86E00"
_FILLS = {"ceramic": "#F3D9A4", "metal": "#D9D9D9", "magnet": "#B8C9E6", "coil": "#E3B7A0"}
_COLOURS = {"A": BLUE, "N": ORANGE, "Nm": ORANGE, "-": GREEN}
_SVG = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {w:.0f} {h:.0f}" role="img" '
    'style="max-width:{w:.0f}px;width:100%" font-family="system-ui, \'DejaVu Sans\', '
    'sans-serif" font-size="11">{body}</svg>'
)


# --- devices ------------------------------------------------------------------------------------


def devices(scene: Scene) -> str:
    """Side view of all parts that have one, to scale; empty where none has."""
    shapes = _side_by_side(scene)
    if not shapes:
        return ""
    left = min(s.x - s.width / 2 for s in shapes)
    right = max(s.x + s.width / 2 for s in shapes)
    top = max(s.y + s.height / 2 for s in shapes)
    bottom = min(s.y - s.height / 2 for s in shapes)
    scale = min(WIDE / (right - left), HIGH / (top - bottom))
    place = lambda x, y: (10 + scale * (x - left), 10 + scale * (top - y))  # noqa: E731
    width, height = scale * (right - left), scale * (top - bottom)
    items = [_shape(shape, *place(shape.x, shape.y), scale) for shape in shapes]
    named = sorted((s for s in shapes if s.label), key=lambda s: -s.y)
    line = 0.0
    for shape in named:
        x, y = place(shape.x + shape.width / 2 * (0.7 if shape.round else 0.9), shape.y)
        line = max(line + 16, y)
        items += [
            _line(x, y, width + 26, line, GREY, 'stroke-width="0.7"'),
            _text(width + 30, line + 4, shape.label),
        ]
    longest = max((len(s.label) for s in named), default=0)
    bar = _round(0.25 * (right - left))
    low = max(height, line) + 34
    items += [
        _line(10, low, 10 + scale * bar, low, BLACK, 'stroke-width="2"'),
        _text(10, low - 5, f"{1e3 * bar:g} mm"),
    ]
    return _SVG.format(w=width + 50 + LETTER * longest, h=low + 10, body="".join(items))


def _side_by_side(scene: Scene) -> list[Shape]:
    """Bodies beside each other; what has no pins of its own to fix it stands on the first."""
    found: list[Shape] = []
    end = None
    for part in scene.parts.values():
        shapes = list(part.type.outline(part, scene))
        if part.type.reduced and shapes:
            half = max(s.width for s in shapes) / 2
            move = 0.0 if end is None else end + 1.5 * half
            end = move + half
            shapes = [replace(s, x=s.x + move) for s in shapes]
        found += shapes
    return found


def _shape(shape: Shape, x: float, y: float, scale: float) -> str:
    w, h = scale * shape.width, max(scale * shape.height, 1.5)
    look = f'fill="{_FILLS[shape.kind]}" stroke="#555" stroke-width="0.8"'
    if shape.round:
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{w / 2:.1f}" {look}/>'
    rectangle = (
        f'<rect x="{x - w / 2:.1f}" y="{y - h / 2:.1f}" width="{w:.1f}" height="{h:.1f}" {look}/>'
    )
    count = shape.layers if h > 2 * shape.layers else 1
    lines = (y - h / 2 + k * h / count for k in range(1, count))
    thin = 'stroke-width="0.4"'
    return rectangle + "".join(_line(x - w / 2, v, x + w / 2, v, "#555", thin) for v in lines)


def _round(length: float) -> float:
    """One digit, for a scale bar."""
    return float(f"{length:.0e}")


# --- circuit ------------------------------------------------------------------------------------


def circuit(scene: Scene) -> str:
    """Parts as boxes in a row; each net is a line above them, under its name in the netlist."""
    spots: dict[str, list[tuple[float, Terminal]]] = {}
    boxes, x = [], 10.0
    for part in scene.parts.values():
        pins = part.type.pins(part, scene)
        steps = [max(30.0, LETTER * len(pin.name) + 10) for pin in pins]
        width = max(sum(steps), LETTER * max(len(part.name), len(part.type.name)) + 16)
        boxes.append((x, width, part.name, part.type.name))
        at = x + (width - sum(steps)) / 2
        for pin, step in zip(pins, steps, strict=True):
            spots.setdefault(scene.net(part.name, pin.name), []).append((at + step / 2, pin))
            at += step
        x += width + 22
    levels = _levels({n: [p for p, _ in s] for n, s in spots.items() if n != "0" and len(s) > 1})
    top = TRACK * (1 + max(levels.values(), default=0)) + 18
    items = [_box(*box, top) for box in boxes]
    for net, ends in spots.items():
        items += _net(net, ends, top, top - TRACK * (levels[net] + 1) if net in levels else None)
    return _SVG.format(w=x, h=top + BOX + 26, body="".join(items))


def _levels(nets: dict[str, Sequence[float]]) -> dict[str, int]:
    """Height of each net, short ones lowest; two of one height do not overlap."""
    taken: list[list[tuple[float, float]]] = []
    found = {}
    for net, places in sorted(nets.items(), key=lambda item: max(item[1]) - min(item[1])):
        low, high = min(places) - 6, max(max(places), min(places) + LETTER * len(net)) + 6
        level = next(
            (k for k, row in enumerate(taken) if all(high < a or b < low for a, b in row)),
            len(taken),
        )
        if level == len(taken):
            taken.append([])
        taken[level].append((low, high))
        found[net] = level
    return found


def _net(
    net: str, ends: Sequence[tuple[float, Terminal]], top: float, level: float | None
) -> list[str]:
    colour = _COLOURS.get(ends[0][1].flow, GREY)
    items = [
        _text(x, top + 13, pin.name, "middle", _COLOURS.get(pin.flow, GREY)) for x, pin in ends
    ]
    if net == "0":  # the sign of ground under the box
        for x, _ in ends:
            items.append(_line(x, top + BOX, x, top + BOX + 8, GREY))
            items += [
                _line(x - s, top + BOX + y, x + s, top + BOX + y, GREY)
                for s, y in ((8, 8), (5, 11), (2, 14))
            ]
    elif level is None:
        items += [_line(x, top, x, top - 8, colour) for x, _ in ends]
    else:
        places = [x for x, _ in ends]
        items.append(_line(min(places), level, max(places), level, colour))
        items += [_line(x, top, x, level, colour) for x in places]
        items += [
            f'<circle cx="{x:.1f}" cy="{level:.1f}" r="2.5" fill="{colour}"/>' for x in places
        ]
        items.append(_text(min(places) + 4, level - 3, net, colour=GREY, extra='font-size="9"'))
    return items


def _box(x: float, width: float, name: str, kind: str, top: float) -> str:
    middle = x + width / 2
    frame = (
        f'<rect x="{x:.1f}" y="{top:.1f}" width="{width:.1f}" height="{BOX:.0f}" rx="5" '
        f'fill="#F5F8FB" stroke="{BLUE}"/>'
    )
    words = _text(middle, top + 42, name, "middle", BLACK, 'font-weight="bold"')
    return frame + words + _text(middle, top + 58, kind.replace("_", " "), "middle", GREY)


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, extra: str = "") -> str:
    ends = f'x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"'
    return f'<line {ends} stroke="{colour}" {extra}/>'


def _text(
    x: float, y: float, text: str, anchor: str = "start", colour: str = BLACK, extra: str = ""
) -> str:
    place = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"'
    return f'<text {place} fill="{colour}" {extra}>{escape(text)}</text>'
