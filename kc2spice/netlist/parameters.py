"""Parameters of a deck's subcircuits, changed without a new netlist: ``param.PART.NAME``."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

from kc2spice.core.errors import UsageError
from kc2spice.core.words import did_you_mean
from kc2spice.netlist.cards import number
from kc2spice.netlist.circuit import LEAST, Circuit, Item, Param, Subcircuit
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.printers.ngspice import printed

Parameters = tuple[tuple[str, float], ...]  # ("PART.NAME", value)


def library_of(part: Subcircuit) -> str:
    return part.filename.rpartition(".")[0] or part.filename


def cards(part: Subcircuit) -> Iterator[tuple[str, Circuit]]:
    """Every subcircuit of a library and its name in ``param.NAME.…``.

    The part itself goes by its file, whatever helper it brings along by the helper's own name:
    ``opamp`` is the amplifier in all libraries that have one.
    """
    for each in part.circuit.subcircuits:
        own = each.name.lower() == part.name.lower()
        yield (library_of(part) if own else each.name.removeprefix(f"{part.name}_")), each


def declared(deck: Deck) -> dict[str, float]:
    """``PART.NAME`` and default of every numeric parameter of the deck's subcircuits."""
    found = {}
    for part in deck.parts:
        for library, each in cards(part):
            for name, text in each.defaults.items():
                with contextlib.suppress(ValueError):  # an expression: nothing to replace
                    found[f"{library}.{name}"] = float(text)
    return found


def with_parameters(deck: Deck, values: Iterable[tuple[str, float]]) -> Deck:
    """``deck`` with other defaults for ``("PART.NAME", value)``, in the card and in the header.

    Raises
    ------
    UsageError : no part of the deck has that parameter, or not with that value.
    """
    known, parts = declared(deck), list(deck.parts)
    for key, value in values:
        if key not in known:
            raise UsageError(
                "no part of this scene has such a parameter",
                where=f"param.{key}",
                expected=", ".join(known),
                hint=did_you_mean(key, known),
            )
        library, _, name = key.partition(".")
        parts = [_changed(part, library, name, value) for part in parts]
    return replace(deck, parts=tuple(parts))


def _changed(part: Subcircuit, library: str, name: str, value: float) -> Subcircuit:
    own = library == library_of(part)
    for param in part.params if own else ():
        if param.name.lower() == name.lower():
            _require_within(param, library, value)
    mine = [each for where, each in cards(part) if where == library and name in each.defaults]
    items = tuple(
        _with_default(each, name, value) if any(each is other for other in mine) else each
        for each in part.circuit.items
    )
    return printed(part, replace(part.circuit, items=items)) if mine else part


def _with_default(circuit: Item, name: str, value: float) -> Item:
    """A subcircuit with another default, in its card and in its head."""
    assert isinstance(circuit, Circuit)
    head = f"* @param {name}="
    notes = tuple(
        f"{head}{number(value)} {line.partition(' unit=')[1].strip()}{line.partition(' unit=')[2]}"
        if line.startswith(head)
        else line
        for line in circuit.notes
    )
    return replace(circuit, defaults={**circuit.defaults, name: number(value)}, notes=notes)


def _require_within(param: Param, library: str, value: float) -> None:
    """A mass of zero or a negative stiffness has no solution, or a wrong one."""
    least, most = param.low, param.high
    if least <= value <= most and math.isfinite(value):
        return
    expected = f"{least:g} … {most:g}" if math.isfinite(least) else "a finite number"
    if most == math.inf and least > -math.inf:
        expected = "above zero" if least == LEAST else f"at least {least:g}"
    raise UsageError(
        "outside the range of this parameter",
        where=f"param.{library}.{param.name}",
        got=f"{value:g} {param.unit}",
        expected=expected,
    )
