"""Drawings on the report page of a run: the circuit, and a side view to scale."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np

from kc2spice.core.figure import Shape
from kc2spice.report.html import render_page
from kc2spice.scene.scene_classes import Scene

# Lengths in SVG units.
SKETCH_WIDTH = 520.0  # largest width of the side view
SKETCH_HEIGHT = 300.0  # largest height of the side view
LETTER_WIDTH = 6.2  # mean width of a letter in a label
NET_SPACING = 24.0  # vertical distance between the lines of two nets in the circuit
PART_HEIGHT = 74.0  # height of the box of a part in the circuit
# CSS variables for colours; the default values apply to drawings outside of a report page.
BLUE = "var(--blue, #0072B2)"
ORANGE = "var(--orange, #B86E00)"
GREEN = "var(--green, #009E73)"
GREY = "var(--grey, #75797D)"
MATERIAL_COLOURS = {
    "ceramic": "#F3D9A4",
    "metal": "#D9D9D9",
    "magnet": "#B8C9E6",
    "coil": "#E3B7A0",
}
FLOW_COLOURS = {"A": BLUE, "N": ORANGE, "Nm": ORANGE, "-": GREEN}


def draw_side_view(scene: Scene) -> str:
    """Draw a side view to scale, as SVG, of all parts that have an outline.

    Return an empty string if no part has an outline.
    """
    shapes = _place_shapes(scene)
    if not shapes:
        return ""
    x, y, width, height = np.array(list(map(attrgetter("x", "y", "width", "height"), shapes))).T
    left, right = min(x - width / 2), max(x + width / 2)
    top, bottom = max(y + height / 2), min(y - height / 2)
    scale = min(SKETCH_WIDTH / (right - left), SKETCH_HEIGHT / (top - bottom))
    spots = 10 + scale * (x - left), 10 + scale * (top - y), scale * width
    placed = list(zip(shapes, *spots, np.maximum(scale * height, 1.5), strict=True))
    labels, line = [], 0.0
    for shape, x, y, width, _ in sorted(placed, key=itemgetter(2)):
        if shape.label:
            line = max(line + 16, y)
            edge = x + width / 2 * (0.7 if shape.round else 0.9)
            labels.append((shape.label, edge, y, line))
    names = list(filter(None, map(attrgetter("label"), shapes)))
    side = scale * (right - left)
    return render_page(
        "devices.svg.j2",
        shapes=placed,
        fills=MATERIAL_COLOURS,
        labels=labels,
        side=side,
        scale=scale,
        bar=float(f"{0.25 * (right - left):.0e}"),  # one significant digit
        low=max(scale * (top - bottom), line) + 34,
        spoken="Side view: " + "; ".join(names),
        width=side + 50 + LETTER_WIDTH * max(map(len, names), default=0),
    )


def write_side_view_caption(scene: Scene) -> str:
    """Return the caption of the side view.

    The caption contains all labels in full. In the drawing, labels may be cut off.
    """
    names = filter(None, map(attrgetter("label"), _place_shapes(scene)))
    return f"Side view, to scale. {'; '.join(dict.fromkeys(names))}."


def _place_shapes(scene: Scene) -> list[Shape]:
    """Return the shapes of all parts in the side view, with bodies side by side.

    Only bodies are moved. All other parts already are above the first body.
    """
    result: list[Shape] = []
    end = None
    for part in scene.parts.values():
        shapes, move = list(part.type.outline(part, scene)), 0.0
        if part.is_body and shapes:
            half = max(map(attrgetter("width"), shapes)) / 2
            move = 0.0 if end is None else end + 1.5 * half
            end = move + half
        result += [replace(shape, x=shape.x + move) for shape in shapes]
    return result


def draw_circuit(scene: Scene) -> str:
    """Draw the circuit of a scene as SVG.

    Parts are boxes in a row, and nets are horizontal lines above the boxes.
    """
    # horizontal position, name and colour of each pin, keyed by net
    ends: dict[str, list[tuple[float, str, str]]] = {}
    boxes, x = [], 10.0
    for part in scene.parts.values():
        pins = scene.pins(part.name)
        steps = [max(30.0, LETTER_WIDTH * len(pin.name) + 10) for pin in pins]
        longest = max(len(part.name), len(part.type.name))
        width = max(sum(steps), LETTER_WIDTH * longest + 16)
        boxes.append((x, width, part.name, part.type.name.replace("_", " ")))
        at = x + (width - sum(steps)) / 2
        for pin, step in zip(pins, steps, strict=True):
            end = (at + step / 2, pin.name, FLOW_COLOURS.get(pin.flow, GREY))
            ends.setdefault(scene.get_net(part.name, pin.name), []).append(end)
            at += step
        x += width + 22
    spans = {net: (min(rows)[0], max(rows)[0]) for net, rows in ends.items()}
    lines = {net: span for net, span in spans.items() if net != "0" and len(ends[net]) > 1}
    levels = _assign_levels(lines)
    top = NET_SPACING * (1 + max(levels.values(), default=0)) + 18
    nets = []
    for net, rows in ends.items():
        first, last = spans[net]
        height = top - NET_SPACING * (levels[net] + 1) if net in levels else None
        nets.append(
            {
                "name": net,
                "ends": rows,
                "colour": rows[0][2],
                "first": first,
                "last": last,
                "level": height,
            }
        )
    look: dict[str, Any] = {"top": top, "box": PART_HEIGHT, "width": x, "blue": BLUE, "grey": GREY}
    spoken = "Circuit of " + ", ".join(scene.parts)
    return render_page("circuit.svg.j2", boxes=boxes, nets=nets, spoken=spoken, **look)


def _assign_levels(spans: Mapping[str, tuple[float, float]]) -> dict[str, int]:
    """Assign a vertical level in the circuit to each net; levels are keyed by net.

    The lines of nets on the same level do not overlap. ``spans`` contains the horizontal range of
    the line of each net.
    """
    levels: list[list[tuple[float, float]]] = []
    result = {}
    for net, (first, last) in sorted(spans.items(), key=lambda item: item[1][1] - item[1][0]):
        span = first - 6, max(last, first + LETTER_WIDTH * len(net)) + 6
        level = 0
        while level < len(levels) and _overlaps(span, levels[level]):
            level += 1
        if level == len(levels):
            levels.append([])
        levels[level].append(span)
        result[net] = level
    return result


def _overlaps(span: tuple[float, float], others: Iterable[tuple[float, float]]) -> bool:
    """Return whether a range overlaps any of several other ranges."""
    low, high = span
    return any(low <= end and start <= high for start, end in others)
