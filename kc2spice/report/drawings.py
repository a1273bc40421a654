"""Drawings of a run's page: its devices from the side, to scale, and its circuit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from kc2spice.core.figure import Shape
from kc2spice.report.html import render_page
from kc2spice.scene.model import Scene

SKETCH_WIDTH, HIGH = 520.0, 300.0  # size of the drawings of the devices, in units of the page
LETTER = 6.2  # width of a letter
TRACK, BOX = 24.0, 74.0  # between two nets; height of a part
# Colours of the page, light or dark, and those of a drawing without one.
BLUE, ORANGE = "var(--blue, #0072B2)", "var(--orange, #B86E00)"
GREEN, GREY = "var(--green, #009E73)", "var(--grey, #75797D)"
FILLS = {"ceramic": "#F3D9A4", "metal": "#D9D9D9", "magnet": "#B8C9E6", "coil": "#E3B7A0"}
COLOURS = {"A": BLUE, "N": ORANGE, "Nm": ORANGE, "-": GREEN}


def devices(scene: Scene) -> str:
    """Side view of all parts that have one, to scale; empty where none has."""
    shapes = _side_by_side(scene)
    if not shapes:
        return ""
    x, y, width, height = np.array([(s.x, s.y, s.width, s.height) for s in shapes]).T
    left, right = min(x - width / 2), max(x + width / 2)
    top, bottom = max(y + height / 2), min(y - height / 2)
    scale = min(SKETCH_WIDTH / (right - left), HIGH / (top - bottom))
    spots = 10 + scale * (x - left), 10 + scale * (top - y), scale * width
    placed = list(zip(shapes, *spots, np.maximum(scale * height, 1.5), strict=True))
    labels, line = [], 0.0
    for shape, x, y, width, _ in sorted(placed, key=lambda row: row[2]):
        if shape.label:
            line = max(line + 16, y)
            edge = x + width / 2 * (0.7 if shape.round else 0.9)
            labels.append((shape.label, edge, y, line))
    side = scale * (right - left)
    return render_page(
        "devices.svg.j2",
        shapes=placed,
        fills=FILLS,
        labels=labels,
        side=side,
        scale=scale,
        bar=float(f"{0.25 * (right - left):.0e}"),  # one digit
        low=max(scale * (top - bottom), line) + 34,
        spoken="Side view: " + "; ".join(shape.label for shape in shapes if shape.label),
        width=side + 50 + LETTER * max((len(label) for label, *_ in labels), default=0),
    )


def _side_by_side(scene: Scene) -> list[Shape]:
    """Bodies beside each other; what has no pins of its own to fix it stands on the first."""
    result: list[Shape] = []
    end = None
    for part in scene.parts.values():
        shapes, move = list(part.type.outline(part, scene)), 0.0
        if part.reduced and shapes:
            half = max(s.width for s in shapes) / 2
            move = 0.0 if end is None else end + 1.5 * half
            end = move + half
        result += [replace(s, x=s.x + move) for s in shapes]
    return result


def draw_circuit(scene: Scene) -> str:
    """Parts as boxes in a row; each net is a line above them, under its name in the netlist."""
    spots: dict[str, list[tuple[float, str, str]]] = {}
    boxes, x = [], 10.0
    for part in scene.parts.values():
        pins = scene.pins(part.name)
        steps = [max(30.0, LETTER * len(pin.name) + 10) for pin in pins]
        width = max(sum(steps), LETTER * max(len(part.name), len(part.type.name)) + 16)
        boxes.append((x, width, part.name, part.type.name.replace("_", " ")))
        at = x + (width - sum(steps)) / 2
        for pin, step in zip(pins, steps, strict=True):
            end = (at + step / 2, pin.name, COLOURS.get(pin.flow, GREY))
            spots.setdefault(scene.net(part.name, pin.name), []).append(end)
            at += step
        x += width + 22
    places = {net: [place for place, *_ in ends] for net, ends in spots.items()}
    levels = _levels({net: at for net, at in places.items() if net != "0" and len(at) > 1})
    top = TRACK * (1 + max(levels.values(), default=0)) + 18
    heights = {net: top - TRACK * (level + 1) for net, level in levels.items()}
    keys = ("name", "ends", "colour", "first", "last", "level")
    nets = []
    for net, ends in spots.items():
        place = ends[0][2], min(places[net]), max(places[net]), heights.get(net)
        nets.append(dict(zip(keys, (net, ends, *place), strict=True)))
    look: dict[str, Any] = {"top": top, "box": BOX, "width": x, "blue": BLUE, "grey": GREY}
    spoken = "Circuit of " + ", ".join(scene.parts)
    return render_page("circuit.svg.j2", boxes=boxes, nets=nets, spoken=spoken, **look)


def _levels(nets: Mapping[str, Sequence[float]]) -> dict[str, int]:
    """Height of each net, short ones lowest; two of one height do not overlap."""
    levels: list[list[tuple[float, float]]] = []
    result = {}
    for net, places in sorted(nets.items(), key=lambda item: max(item[1]) - min(item[1])):
        low, high = min(places) - 6, max(max(places), min(places) + LETTER * len(net)) + 6
        levels.append([])
        free = (k for k, row in enumerate(levels) if all(high < a or b < low for a, b in row))
        result[net] = next(free)
        levels[result[net]].append((low, high))
    return result
