"""Where the pins of a part sit on its symbol: inputs left, outputs right, references below."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from math import ceil

from kc2spice.netlist.circuit import Param, Pin, Subcircuit
from kc2spice.netlist.scope import Scope, circuit

REFERENCES = frozenset({"base", "ref"})
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

    name: str
    library: str
    title: str
    params: tuple[Param, ...]
    width: int
    height: int
    places: tuple[Place, ...]


def layout(part: Subcircuit) -> Box:
    """The symbol of ``part``; the number of a pin is its position on the ``.subckt`` card.

    Electrical terminals of an actuator are left of its mechanical ports; of electronics, what only
    senses is left of what drives; of mechanical parts, displacements left of the rest.
    """
    sides = _sides(list(enumerate(part.pins, 1)), inputs(part))
    width, height = _size(sides)
    return Box(
        part.name,
        part.filename,
        part.title,
        part.params,
        width,
        height,
        tuple(sorted(_around(sides, width, height), key=lambda place: place.number)),
    )


def inputs(part: Subcircuit) -> frozenset[str]:
    """Pins, in lower case, that elements of ``part`` sense but none draws current from."""
    top = circuit("part", {"part": part.circuit})
    return frozenset({p.name.lower() for p in part.pins} & _sensed(top.find(part.name)))


def _sensed(scope: Scope | None) -> set[str]:
    """Nodes that elements of ``scope`` sense but none draws current from."""
    sensed: set[str] = set()
    loaded: set[str] = set()
    for each in scope.elements if scope else ():
        two = each.kind in _CONTROLLED and len(each.nodes) == 4
        loaded |= set(each.ends[:2] if two else () if each.kind == "x" else each.ends)
        sensed |= {*each.ends[2:]} if two else each.sensed
        if each.kind == "x" and scope and (called := scope.find(each.model)):
            quiet = _sensed(called)
            for pin, node in zip(called.pins, each.ends, strict=False):
                (sensed if pin in quiet else loaded).add(node)
    return sensed - loaded


def _sides(
    numbered: list[tuple[int, Pin]], quiet: Collection[str]
) -> dict[str, list[tuple[int, Pin]]]:
    """Pins by the side that they are drawn on."""
    plain = [pin for _, pin in numbered if pin.name not in REFERENCES]
    electric = [pin for pin in plain if pin.flow == "A"]
    mechanical = [pin for pin in plain if pin.flow not in ("A", "-")]
    left: set[str] = {pin.name for pin in plain if pin.name.lower() in quiet}
    if electric and mechanical:
        left = {pin.name for pin in electric}
    elif electric:
        left |= {pin.name for pin in plain if pin.flow == "-"}  # a command, though it be loaded
        left = left or {electric[0].name}
    elif mechanical:
        moved = [pin.name for pin in mechanical if pin.unit == "um"]
        left = set(moved or [pin.name for pin in mechanical])
    sides: dict[str, list[tuple[int, Pin]]] = {"left": [], "right": [], "bottom": []}
    for number, pin in numbered:
        side = "left" if pin.name in left else "right"
        sides["bottom" if pin.name in REFERENCES else side].append((number, pin))
    return sides


def _size(sides: dict[str, list[tuple[int, Pin]]]) -> tuple[int, int]:
    """Half width and half height that keep the names of all pins apart."""
    left, right, below = (
        max([0, *(len(pin.name) for _, pin in sides[s])]) for s in ("left", "right", "bottom")
    )
    columns = len(sides["bottom"])
    rows = max(len(sides["left"]), len(sides["right"]))
    # names along the bottom stand upright between those of both sides
    width = ceil(max(_LETTER * left, _LETTER * right) + 0.6 + 0.5 * columns)
    return max(3, width), max(ceil((rows + 1) / 2), ceil((_LETTER * below + 0.8) / 2))


def _around(sides: dict[str, list[tuple[int, Pin]]], width: int, height: int) -> list[Place]:
    places = []
    for side, x in (("left", -width - 1), ("right", width + 1)):
        for row, (number, pin) in enumerate(sides[side]):
            places.append(Place(number, pin.name, side, x, height - 1 - row))
    first = -(len(sides["bottom"]) // 2)
    for column, (number, pin) in enumerate(sides["bottom"]):
        places.append(Place(number, pin.name, "bottom", first + column, -height - 1))
    return places
