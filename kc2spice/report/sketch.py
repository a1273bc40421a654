"""Sketches of a scene as SVG: its devices from the side, to scale, and its circuit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from kc2spice.core.figure import Shape
from kc2spice.report.figures import BLUE, GREEN, GREY
from kc2spice.report.html import rendered
from kc2spice.scene.model import Scene

WIDE, HIGH = 520.0, 300.0  # of the devices, in units of the page
LETTER = 6.2  # width of a letter
TRACK, BOX = 24.0, 74.0  # between two nets; height of a part
ORANGE = "#B86E00"
FILLS = {"ceramic": "#F3D9A4", "metal": "#D9D9D9", "magnet": "#B8C9E6", "coil": "#E3B7A0"}
COLOURS = {"A": BLUE, "N": ORANGE, "Nm": ORANGE, "-": GREEN}


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
    placed = [
        (
            shape,
            10 + scale * (shape.x - left),
            10 + scale * (top - shape.y),
            scale * shape.width,
            max(scale * shape.height, 1.5),
        )
        for shape in shapes
    ]
    labels, line = [], 0.0
    for shape, x, y, width, _ in sorted(placed, key=lambda row: row[2]):
        if shape.label:
            line = max(line + 16, y)
            edge = x + width / 2 * (0.7 if shape.round else 0.9)
            labels.append((shape.label, edge, y, line))
    side = scale * (right - left)
    return rendered(
        "devices.svg.j2",
        shapes=placed,
        fills=FILLS,
        labels=labels,
        side=side,
        scale=scale,
        bar=float(f"{0.25 * (right - left):.0e}"),  # one digit
        low=max(scale * (top - bottom), line) + 34,
        width=side + 50 + LETTER * max((len(label) for label, *_ in labels), default=0),
    )


def _side_by_side(scene: Scene) -> list[Shape]:
    """Bodies beside each other; what has no pins of its own to fix it stands on the first."""
    found: list[Shape] = []
    end = None
    for part in scene.parts.values():
        shapes = list(part.type.outline(part, scene))
        if part.reduced and shapes:
            half = max(s.width for s in shapes) / 2
            move = 0.0 if end is None else end + 1.5 * half
            end = move + half
            shapes = [replace(s, x=s.x + move) for s in shapes]
        found += shapes
    return found


def circuit(scene: Scene) -> str:
    """Parts as boxes in a row; each net is a line above them, under its name in the netlist."""
    spots: dict[str, list[tuple[float, str, str]]] = {}
    boxes, x = [], 10.0
    for part in scene.parts.values():
        pins = part.type.pins(part, scene)
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
    nets = [
        {
            "name": net,
            "ends": ends,
            "colour": ends[0][2],
            "first": min(places[net]),
            "last": max(places[net]),
            "level": top - TRACK * (levels[net] + 1) if net in levels else None,
        }
        for net, ends in spots.items()
    ]
    return rendered(
        "circuit.svg.j2", boxes=boxes, nets=nets, top=top, box=BOX, width=x, blue=BLUE, grey=GREY
    )


def _levels(nets: Mapping[str, Sequence[float]]) -> dict[str, int]:
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
