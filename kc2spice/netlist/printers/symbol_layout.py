"""Places of pins on the symbol of a part: inputs left, outputs right, references below."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

from kc2spice.core.domains import ELECTRICAL, REFERENCES, SIGNAL, TRANSLATION
from kc2spice.netlist.circuit import Pin
from kc2spice.netlist.library import Subcircuit
from kc2spice.netlist.scope import Scope, circuit

_LETTER = 0.45  # width of a letter in grid units
_CONTROLLED = frozenset("egs")  # the last two nodes of these draw nothing


@dataclass(frozen=True)
class Place:
    """The free end of a pin at grid position ``(x, y)``, y upwards, ``length`` from the body."""

    number: int
    name: str
    side: str
    x: int
    y: int
    length: float = 1.0


@dataclass(frozen=True)
class Box:
    """A symbol of half width and half height in grid units."""

    width: int
    height: int
    places: tuple[Place, ...]


def layout(part: Subcircuit) -> Box:
    """The symbol of ``part``; the number of a pin is its position on the ``.subckt`` card.

    The left side of an actuator has its electrical terminals, the right side its mechanical ports.
    Electronics have their inputs on the left and their outputs on the right. Mechanical parts have
    their displacements on the left and all other pins on the right.
    """
    sides = _sides(part)
    left, right, below = (max([0, *(len(pin.name) for _, pin in side)]) for side in sides)
    rows = max(len(sides[0]), len(sides[1]))
    # names along the bottom stand upright between those of both sides
    width = max(3, ceil(_LETTER * max(left, right) + 0.6 + 0.5 * len(sides[2])))
    height = max(ceil((rows + 1) / 2), ceil((_LETTER * below + 0.8) / 2))
    places = []
    for side, x, pins in (("left", -width - 1, sides[0]), ("right", width + 1, sides[1])):
        for row, (number, pin) in enumerate(pins):
            places.append(Place(number, pin.name, side, x, height - 1 - row))
    first = -(len(sides[2]) // 2)
    for column, (number, pin) in enumerate(sides[2]):
        places.append(Place(number, pin.name, "bottom", first + column, -height - 1))
    places.sort(key=lambda place: place.number)
    return Box(width, height, tuple(places))


def _sensed(scope: Scope | None) -> set[str]:
    """Nodes that elements of ``scope`` sense but none draws current from."""
    sensed: set[str] = set()
    loaded: set[str] = set()
    for item in scope.elements if scope else ():
        two = item.kind in _CONTROLLED and len(item.nodes) == 4
        loaded |= set(item.ends[:2] if two else () if item.kind == "x" else item.ends)
        sensed |= {*item.ends[2:]} if two else item.sensed
        if item.kind == "x" and scope and (called := scope.find(item.model)):
            quiet = _sensed(called)
            for pin, node in zip(called.pins, item.ends, strict=False):
                (sensed if pin in quiet else loaded).add(node)
    return sensed - loaded


def _sides(part: Subcircuit) -> tuple[list[tuple[int, Pin]], ...]:
    """Pins with their numbers, left, right and below."""
    plain = [pin for pin in part.pins if pin.name not in REFERENCES]
    electric = [pin.name for pin in plain if pin.flow == ELECTRICAL.flow]
    mechanical = [pin for pin in plain if pin.flow not in (ELECTRICAL.flow, SIGNAL)]
    quiet = _sensed(circuit(part.circuit).find(part.name))
    left = {pin.name for pin in plain if pin.name.lower() in quiet}
    if electric and mechanical:
        left = set(electric)
    elif electric:
        left |= {pin.name for pin in plain if pin.flow == SIGNAL}  # a command, though it be loaded
        left = left or {electric[0]}
    elif mechanical:
        placed = {pin.name for pin in mechanical if pin.unit == TRANSLATION.across.pin_unit}
        left = placed or {pin.name for pin in mechanical}
    sides: tuple[list[tuple[int, Pin]], ...] = ([], [], [])
    for number, pin in enumerate(part.pins, 1):
        side = 0 if pin.name in left else 1
        sides[2 if pin.name in REFERENCES else side].append((number, pin))
    return sides
