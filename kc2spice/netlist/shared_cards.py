"""Cards that many parts contain, and functions that attach comments to cards."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TypeAlias

from kc2spice.netlist.circuit import Element, Item
from kc2spice.netlist.number_and_name_spelling import format_comment

# Either a card, or a text with the comment lines and the blank lines above a card.
Line: TypeAlias = Item | str

_PIVOT_COMMENT = (
    "* A source of 0 V with breakpoints at 1 and 2 ps makes the first time step small. In this\n"
    "* step, the simulator chooses its pivot order."
)


def attach_comments(lines: Iterable[Line]) -> tuple[Item, ...]:
    """Return the cards, each with the comments that are above it."""
    result: list[Item] = []
    notes: list[str] = []
    for line in lines:
        if isinstance(line, str):
            notes += line.split("\n")
        else:
            result.append(replace(line, notes=(*notes, *line.notes)))
            notes = []
    assert not notes, "comments without a card below them"
    return tuple(result)


def add_title(title: str, items: Iterable[Item], owner: str = "") -> tuple[Item, ...]:
    """Add a blank line and a title comment above the cards of a part.

    ``owner`` is the name of the part. The comment also states the units of the element values,
    unless these are V, A, Ohm, F and H.
    """
    first, *others = (replace(item, owner=owner) for item in items)
    units = dict.fromkeys(item.unit for item in (first, *others) if isinstance(item, Element))
    unit_list = ", ".join(filter(None, units))
    notes = (
        "",
        f"* {format_comment(title)}{f'; values in {unit_list}' if unit_list else ''}",
        *first.notes,
    )
    return (replace(first, notes=notes), *others)


def write_pivot_cards(base: str) -> Iterator[Line]:
    """Yield cards for a short first time step, in which ngspice chooses its pivots.

    In its first time step, ngspice chooses the pivots of its matrix. If ngspice chose the pivots in
    a long step, rounding errors would prevent convergence in the picosecond steps of an impact.
    """
    yield _PIVOT_COMMENT
    yield Element.from_words("Vtick", "tick", base, "PWL(0 0 1e-12 0 2e-12 0)")
    yield Element.from_words("Rtick", "tick", base, "1")
