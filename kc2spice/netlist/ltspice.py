"""LTspice symbols (``.asy``, file version 4)."""

from __future__ import annotations

from kc2spice.netlist.box import Box, Place
from kc2spice.netlist.cards import number

GRID = 32  # LTspice's units, two of its grid: pins must lie on multiples of 16
_SIDES = {"left": "LEFT", "right": "RIGHT", "bottom": "BOTTOM", "top": "TOP"}


def symbol(box: Box, library: str) -> str:
    """The symbol of one part; ``library`` is the file that LTspice includes for it."""
    x, y = GRID * box.width, GRID * box.height
    lines = [
        "Version 4",
        "SymbolType BLOCK",
        f"RECTANGLE Normal {x} {y} {-x} {-y}",
        f"WINDOW 0 0 {-y} Bottom 2",
        f"WINDOW 3 0 {y} Top 2",
        f"SYMATTR Value {box.name}",
        "SYMATTR Prefix X",
        f"SYMATTR ModelFile {library}",
        f"SYMATTR Description {box.title}",
    ]
    if box.params:
        given = " ".join(f"{p.name}={number(p.default)}" for p in box.params)
        lines.append(f"SYMATTR SpiceLine {given}")
    for place in box.places:
        lines += _pin(place, box)
    return "\n".join(lines) + "\n"


def _pin(place: Place, box: Box) -> list[str]:
    """A pin on the outline; y points down here."""
    x = max(-box.width, min(box.width, place.x)) * GRID
    y = -max(-box.height, min(box.height, place.y)) * GRID
    return [
        f"PIN {x} {y} {_SIDES[place.side]} 8",
        f"PINATTR PinName {place.pin.name}",
        f"PINATTR SpiceOrder {place.number}",
    ]
