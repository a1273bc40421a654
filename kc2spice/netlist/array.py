"""Many copies of a scene in one deck: an array of actuators, each with its own drive."""

from __future__ import annotations

import re
from dataclasses import replace

from kc2spice.core.errors import UsageError
from kc2spice.netlist.deck import Block, Deck

MOST = 10_000
_PROBE = re.compile(r"(?i)([vi])\(([^()]+)\)|@(\w)\.([\w.]+\[\w+\])")


def array_deck(deck: Deck, count: int) -> Deck:
    """``count`` copies of all instances of ``deck``: subcircuits ``X1``, ``X2``, … around node 0.

    Results of copy k are called ``k.NAME``.

    Raises
    ------
    UsageError : a number of copies out of range, or a sweep, which moves one source only.
    """
    if not 1 <= count <= MOST:
        raise UsageError(
            "number of copies", where="--count", got=str(count), expected=f"1 to {MOST}"
        )
    if deck.command.kind == "dc":
        raise UsageError(
            "a dc sweep moves one source, not one of each copy", where="--count",
            got=deck.command.card, expected="a scene with a transient or an ac analysis",
        )  # fmt: skip
    unit = f"{deck.name}_unit"
    title, last = Block("one copy", (f".subckt {unit} common",)), Block("", (f".ends {unit}",))
    copies = Block(f"{count} copies", tuple(f"X{k} 0 {unit}" for k in range(1, count + 1)))
    numbers = range(1, count + 1)
    vectors = {
        f"{k}.{name}": (_within(text, k), factor)
        for k in numbers
        for name, (text, factor) in deck.vectors.items()
    }
    return replace(
        deck,
        title=f"{deck.title}, {count} copies",
        blocks=(title, *deck.blocks, last, copies),
        vectors=vectors,
        units={f"{k}.{name}": unit for k in numbers for name, unit in deck.units.items()},
        initial={f"x{k}.{node}": value for k in numbers for node, value in deck.initial.items()},
    )


def _within(expression: str, k: int) -> str:
    """An expression of copy ``k``; ngspice puts the letter of a device before its path."""

    def inside(match: re.Match[str]) -> str:
        if match[3]:
            return f"@{match[3]}.x{k}.{match[4]}"
        if match[1].lower() == "v":
            return f"v(x{k}.{match[2]})"
        device = match[2] if "." in match[2] else f"{match[2][0]}.{match[2]}"
        letter, _, path = device.partition(".")
        return f"i({letter}.x{k}.{path})"

    return _PROBE.sub(inside, expression)
