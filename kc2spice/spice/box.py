"""Where the pins of a part sit on its symbol: a box, its sides filled from the pin table."""

from __future__ import annotations

from dataclasses import dataclass

from kc2spice.spice.circuit import Param, Pin, Subcircuit
from kc2spice.spice.elements import circuit

REFERENCES = frozenset({"base", "ref"})


@dataclass(frozen=True)
class Place:
    """A pin at grid position ``(x, y)``, y upwards, on one ``side`` of the box."""

    number: int
    pin: Pin
    side: str
    x: int
    y: int


@dataclass(frozen=True)
class Box:
    """A symbol: half width and half height in grid units, pins one unit outside the outline."""

    name: str
    title: str
    needs: tuple[str, ...]
    params: tuple[Param, ...]
    width: int
    height: int
    places: tuple[Place, ...]


def layout(part: Subcircuit) -> Box:
    """Electrical pins to the left, mechanical and signal pins to the right, references below.

    The number of a pin is its position on the ``.subckt`` card, wherever it is drawn.
    """
    sides: dict[str, list[tuple[int, Pin]]] = {"left": [], "right": [], "bottom": []}
    for number, pin in enumerate(part.pins, 1):
        side = "left" if pin.flow == "A" else "right"
        sides["bottom" if pin.name in REFERENCES else side].append((number, pin))
    rows = max(len(sides["left"]), len(sides["right"]), 1)
    longest = max(len(pin.name) for pin in part.pins)
    width = max(4, 1 + longest, 1 + len(sides["bottom"]))
    height = rows + 1  # pins on every second line, so that names do not touch
    places = []
    for side, x in (("left", -width - 1), ("right", width + 1)):
        for row, (number, pin) in enumerate(sides[side]):
            places.append(Place(number, pin, side, x, height - 2 - 2 * row))
    for column, (number, pin) in enumerate(sides["bottom"]):
        places.append(Place(number, pin, "bottom", 2 * column, -height - 1))
    return Box(
        part.name,
        part.text.partition("\n")[0].lstrip("* "),
        _needs(part),
        part.params,
        width,
        height,
        tuple(sorted(places, key=lambda place: place.number)),
    )


def _needs(part: Subcircuit) -> tuple[str, ...]:
    """Other parts whose libraries must be included too."""
    top = circuit(
        "needs", {"needs": f"* needs\n.include {part.filename}", part.filename: part.text}
    )
    inside = top.subcircuits[part.name.lower()].elements
    return tuple(sorted({str(e.model) for e in inside if e.kind == "x"}))
