"""Differences of an edited netlist to the scene's netlist: parameters, or other cards.

Parts are judged by the parameters that the netlist has. A part whose cards are others cannot be
judged by its keys.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from kc2spice.netlist.circuit import Element
from kc2spice.netlist.expression import literal
from kc2spice.netlist.printers.ngspice import Printer
from kc2spice.netlist.scope import Scope
from kc2spice.scene.model import Part


@dataclass(frozen=True)
class Instance:
    """A part's instance in a deck: its subcircuit, and its parameters by names in lower case."""

    library: Scope
    parameters: Mapping[str, str]

    @property
    def cards(self) -> Any:
        """Content of its cards, inner subcircuits included."""
        return _cards(self.library, frozenset())


def instance(top: Scope, name: str) -> Instance | None:
    """The instance ``name``; None where there is none, or its subcircuit is not there."""
    card = next((item for item in top.elements if item.key == name.lower()), None)
    library = top.find(card.model) if card is not None and card.kind == "x" else None
    if card is None or library is None:
        return None
    return Instance(library, library.defaults | card.settings)


def _cards(scope: Scope, above: frozenset[str]) -> Any:
    inside = []
    for item in scope.elements:
        called = scope.find(item.model) if item.kind == "x" else None
        if called is not None and called.name.lower() not in above:
            within = _cards(called, above | {called.name.lower()})
            inside.append((item.model.lower(), sorted(called.defaults.items()), within))
    printer = Printer()
    plain = list(map(printer.card, scope.commands))
    models = {name: printer.card(item) for name, item in scope.models.maps[0].items()}
    return scope.pins, list(map(element_text, scope.elements)), plain, models, inside


def element_text(card: Element) -> str:
    """Content of an element's card: blanks and brackets of expressions make no difference."""
    plain = replace(card, name=card.key, nodes=card.ends, parameters=card.settings)
    return Printer().element(plain)


def changed(original: Instance, edited: Instance) -> Iterator[tuple[str, float, float]]:
    """Name, old and new value of each parameter that differs; nan of an expression."""

    def number(text: str | None) -> float:
        value = None if text is None else literal(text)
        return math.nan if value is None else value

    before, now = original.parameters, edited.parameters
    for name in before.keys() | now.keys():
        if before.get(name) != now.get(name):
            old, new = number(before.get(name)), number(now.get(name))
            if old != new:
                yield name, old, new


def with_value(part: Part, name: str, old: float, new: float) -> Part | None:
    """The part with the value that a netlist has of the key ``name``, in any case of letters; None
    where no key of it has the ``old`` value."""
    fields = type(part.keys).model_fields
    key = next((field for field in fields if field.lower() == name.lower()), None)
    known = getattr(part.keys, key) if key is not None else None
    if key is None or not isinstance(known, float) or not math.isclose(known, old):
        return None
    return replace(part, keys=part.keys.model_copy(update={key: new}))
