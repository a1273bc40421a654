"""Cards that many parts contain, and functions that attach comments to cards."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

from kc2spice.netlist.circuit import SMALLEST_POSITIVE, Element, Item, Param
from kc2spice.netlist.number_and_name_spelling import format_comment, format_number

# Either a card, or a text with the comment lines and the blank lines above a card.
Line: TypeAlias = Item | str

_STOP_RESISTANCE = 1e12  # ohm, resistance of the cards that stop the simulation
STOP_COMMENT = """
* These cards stop the simulation if a parameter is outside of its range."""
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


def list_range_conditions(parameters: Sequence[Param]) -> dict[str, str]:
    """Return an expression for each bounded parameter that is finite only within its range.

    The keys state the ranges as words, such as ``keff_must_be_between_0_and_1``.
    """
    result = {}
    for p in parameters:
        if p.low == SMALLEST_POSITIVE and p.high == math.inf:
            result[f"{p.name}_must_be_above_0"] = f"ln({p.name})"
        elif p.low == SMALLEST_POSITIVE:
            above = f"{p.name}*({format_number(p.high)}-{p.name})"
            result[f"{p.name}_must_be_between_0_and_{p.high:.6g}"] = f"ln({above})"
        elif math.isfinite(p.low):
            above = f"{p.name}-{format_number(p.low)}"
            result[f"{p.name}_must_be_at_least_{p.low:.6g}"] = f"sqrt({above})"
    return result


def write_condition_stops(conditions: Mapping[str, str], node: str) -> Iterator[Element]:
    """Yield resistors whose values stop the simulator if an expression is not finite.

    Both ends of a resistor are at the same node, so no current flows. The simulator adds and
    subtracts the conductance of the resistor in its matrix. The resistance is therefore so large
    that the rounding errors of these operations are negligible. The name of the resistor is the key
    of its expression, because the simulator prints this name.
    """
    for words, expression in conditions.items():
        name = f"R{convert_to_element_name(words)}"
        value = f"{{{format_number(_STOP_RESISTANCE)}*(1+0*{expression})}}"
        yield Element.from_words(name, node, node, value)


def convert_to_element_name(words: str) -> str:
    """Replace all characters that element names cannot contain."""
    return re.sub(r"\W", lambda c: {".": "p", "-": "m", "+": ""}[c[0]], words)


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
