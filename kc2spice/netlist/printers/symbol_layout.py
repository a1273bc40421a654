"""Positions of the pins on the symbol of a part."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from operator import attrgetter

from kc2spice.core.domains import ELECTRICAL, REFERENCES, SIGNAL, TRANSLATION
from kc2spice.netlist.circuit import Pin
from kc2spice.netlist.name_scopes import Scope, build_scope
from kc2spice.netlist.subcircuit_library import Subcircuit

_LETTER_WIDTH = 0.45  # width of a letter in grid units
_CONTROLLED_KINDS = frozenset("egs")  # elements whose third and fourth node draw no current


@dataclass(frozen=True)
class SymbolPin:
    """Pin of a symbol, with its free end at the grid position ``(x, y)``.

    The y axis points upwards. The free end is at a distance ``length`` from the body of the symbol.
    """

    number: int
    name: str
    side: str
    x: int
    y: int
    length: float = 1.0


@dataclass(frozen=True)
class SymbolBox:
    """Rectangular outline of a schematic symbol, with its pins.

    ``width`` and ``height`` are half the width and half the height of the outline.
    """

    width: int
    height: int
    places: tuple[SymbolPin, ...]


def arrange_pins(part: Subcircuit) -> SymbolBox:
    """Arrange the pins of a part on a symbol, numbered as on its ``.subckt`` card.

    On the symbol of an actuator, electrical pins are on the left and mechanical pins on the right.
    On the symbol of an electronic part, inputs are on the left and outputs on the right. On the
    symbol of a mechanical part, displacements are on the left and all other pins on the right.
    """
    left, right, below = _assign_sides(part)
    longest = max(_find_longest_name_length(left), _find_longest_name_length(right))
    rows = max(len(left), len(right))
    # pin names at the bottom are vertical, between the names of the left and right pins
    width = max(3, ceil(_LETTER_WIDTH * longest + 0.6 + 0.5 * len(below)))
    height = max(
        ceil((rows + 1) / 2), ceil((_LETTER_WIDTH * _find_longest_name_length(below) + 0.8) / 2)
    )
    places = []
    for side, x, pins in (("left", -width - 1, left), ("right", width + 1, right)):
        for row, (number, pin) in enumerate(pins):
            places.append(SymbolPin(number, pin.name, side, x, height - 1 - row))
    first = -(len(below) // 2)
    for column, (number, pin) in enumerate(below):
        places.append(SymbolPin(number, pin.name, "bottom", first + column, -height - 1))
    places.sort(key=attrgetter("number"))
    return SymbolBox(width, height, tuple(places))


def _find_longest_name_length(pins: list[tuple[int, Pin]]) -> int:
    """Return the length of the longest pin name in characters."""
    return max((len(pin.name) for _, pin in pins), default=0)


def _find_sensed_nodes(scope: Scope | None) -> set[str]:
    """Return the nodes that carry no current, but whose voltage is sensed."""
    sensed: set[str] = set()
    loaded: set[str] = set()
    for item in scope.elements if scope else ():
        two = item.kind in _CONTROLLED_KINDS and len(item.nodes) == 4
        loaded |= set(
            item.lower_case_nodes[:2] if two else () if item.kind == "x" else item.lower_case_nodes
        )
        sensed |= {*item.lower_case_nodes[2:]} if two else item.sensed_nodes
        if item.kind == "x" and scope and (called := scope.find_subcircuit(item.model)):
            sensed_pins = _find_sensed_nodes(called)
            for pin, node in zip(called.pins, item.lower_case_nodes, strict=False):
                (sensed if pin in sensed_pins else loaded).add(node)
    return sensed - loaded


def _assign_sides(part: Subcircuit) -> tuple[list[tuple[int, Pin]], ...]:
    """Return the numbered pins on the left, on the right and at the bottom."""
    electrical, signals, displacements, others = list[str](), list[str](), list[str](), list[str]()
    for pin in part.pins:
        if pin.name in REFERENCES:
            continue
        if pin.flow == ELECTRICAL.flow_unit:
            electrical.append(pin.name)
        elif pin.flow == SIGNAL:
            signals.append(pin.name)
        else:
            moves = pin.unit == TRANSLATION.across.pin_unit
            (displacements if moves else others).append(pin.name)
    mechanical = displacements or others
    sensed = _find_sensed_nodes(build_scope(part.circuit).find_subcircuit(part.name))
    left = {pin.name for pin in part.pins if pin.key in sensed} - REFERENCES
    if electrical and mechanical:
        left = set(electrical)
    elif electrical:
        # in an electronic part, signal pins, which carry no power, are command inputs
        left.update(signals)
        left = left or {electrical[0]}
    elif mechanical:
        left = set(mechanical)
    sides: tuple[list[tuple[int, Pin]], ...] = ([], [], [])
    for number, pin in enumerate(part.pins, 1):
        side = 0 if pin.name in left else 1
        sides[2 if pin.name in REFERENCES else side].append((number, pin))
    return sides
