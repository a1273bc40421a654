"""Many copies of a scene in one deck: an array of actuators, each with its own drive."""

from __future__ import annotations

from dataclasses import replace

from kc2spice.core.errors import UsageError
from kc2spice.netlist.deck import Block, Deck
from kc2spice.netlist.vectors import added, terms, vector

MOST = 10_000


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
            "a dc sweep moves one source, not one of each copy",
            where="--count",
            got=deck.command.card,
            expected="a scene with a transient or an ac analysis",
        )
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
    """An expression of copy ``k``."""
    found = ((sign, text, vector(text)) for sign, text in terms(expression))
    return added([(s, str(each.within(f"x{k}")) if each else text) for s, text, each in found])
