"""Netlists as trees of elements, models, parameters and subcircuits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

from kc2spice.core.errors import UsageError
from kc2spice.netlist.expression import Tree, find_probed_names, parse_expression
from kc2spice.netlist.number_and_name_spelling import format_number

SMALLEST_POSITIVE = 1e-30  # smallest accepted value of a parameter that must be positive
# Number of nodes of each element except X, keyed by element letter.
# The number of nodes of an X element depends on the subcircuit.
# Behavioural E and G elements have only two nodes.
NODE_COUNTS = {
    "r": 2, "c": 2, "l": 2, "v": 2, "i": 2, "b": 2, "e": 4, "g": 4, "f": 2, "h": 2,
    "d": 2, "q": 3, "j": 3, "m": 4, "z": 3, "s": 4, "w": 2, "t": 4, "k": 0,
}  # fmt: skip
# Letters of elements whose cards state a .model name after the nodes and the controlling elements.
MODEL_KINDS = frozenset("dqjmzsw")
# Number of controlling sources or inductors after the nodes, keyed by element letter.
CONTROL_COUNTS = {"f": 1, "h": 1, "w": 1, "k": 2}


@dataclass(frozen=True, kw_only=True)
class Card:
    """Statement of a netlist, with the comment lines and blank lines above it.

    ``notes`` contains the comment lines and blank lines. ``where`` is the position as
    ``file:line``, and ``written`` is the statement on one line. Error messages quote both.
    ``owner`` is the part of the scene to which the statement belongs.
    """

    notes: tuple[str, ...] = ()
    owner: str = field(default="", compare=False)
    where: str = field(default="", compare=False)
    written: str = field(default="", compare=False)

    @property
    def file(self) -> str:
        """Name of the file that contains the statement."""
        return self.where.rpartition(":")[0]

    def make_error(
        self, message: str, got: str = "", expected: str | None = None, hint: str | None = None
    ) -> UsageError:
        """Return an error about this card that quotes a text, by default the whole card."""
        got = got or self.written[:80]
        return UsageError(message, where=self.where, got=got, expected=expected, hint=hint)


@dataclass(frozen=True)
class Element(Card):
    """Element of a netlist, with nodes, controlling sources and model.

    ``kind`` is the element letter in lower case. ``sources`` are the controlling sources or
    inductors. ``values`` are the words after the nodes, and ``parameters`` the assignments after
    the values. A behavioural source (B, or E and G with an expression) sets the ``quantity`` V or I
    to the value of ``expression``. Names keep their original letter case. ``unit`` is the unit of
    the values, and empty for the simulator's own unit (V, A, Ohm, F or H).
    """

    kind: str
    name: str
    nodes: tuple[str, ...]
    sources: tuple[str, ...] = ()
    model: str = ""
    values: tuple[str, ...] = ()
    parameters: Mapping[str, str] = field(default_factory=dict)
    quantity: str = ""
    expression: str = ""
    unit: str = field(default="", compare=False)

    @classmethod
    def from_words(cls, name: str, *words: str | float, **parameters: str) -> Element:
        """Make an element from the name, the words and the assignments on its card.

        Parameters
        ----------
        name : str
            Name of the element. The first letter of the name determines the kind of the element.
        *words : str or float
            Words after the name, as text or as numbers. The function
            :func:`kc2spice.netlist.number_and_name_spelling.format_number` converts the numbers to
            text.
        **parameters : str
            Assignments after the words.

        Examples
        --------
        >>> Element.from_words("Cmass", "v", "base", 1e-5, IC="0").values
        ('1e-05',)
        """
        kind, texts = (
            name[0].lower(),
            tuple(w if isinstance(w, str) else format_number(w) for w in words),
        )
        if kind == "x":
            return cls(kind, name, texts[:-1], model=texts[-1], parameters=parameters)
        count = NODE_COUNTS[kind]
        end = count + CONTROL_COUNTS.get(kind, 0)
        nodes, sources, values = texts[:count], texts[count:end], texts[end:]
        model = values[0] if kind in MODEL_KINDS else ""
        values = values[1:] if kind in MODEL_KINDS else values
        return cls(kind, name, nodes, sources, model, values, parameters)

    @classmethod
    def behavioural_source(
        cls, name: str, plus: str, minus: str, quantity: str, law: str
    ) -> Element:
        """Return a behavioural source whose current I or voltage V is an expression."""
        return cls("b", name, (plus, minus), quantity=quantity, expression=law)

    def with_unit(self, unit: str) -> Element:
        """Return a copy of the element with another unit of its values."""
        return replace(self, unit=unit)

    @cached_property
    def key(self) -> str:
        """Key for look-ups: the name in lower case, as simulators ignore letter case."""
        return self.name.lower()

    @cached_property
    def lower_case_nodes(self) -> tuple[str, ...]:
        """Nodes in lower case, because simulators ignore letter case."""
        return tuple(map(str.lower, self.nodes))

    @cached_property
    def settings(self) -> dict[str, str]:
        """Parameters of the element, keyed by names in lower case."""
        return key_by_lower_name(self.parameters)

    @cached_property
    def law(self) -> Tree:
        """Expression of a behavioural source's voltage or current, as a tree.

        Raises
        ------
        UsageError : the text is not an expression.
        """
        return parse_expression(self.expression, where=self.where)

    @property
    def sensed_nodes(self) -> frozenset[str]:
        """Nodes whose voltages occur in the expression; empty for an invalid expression."""
        try:
            return find_probed_names(self.law, "v") if self.quantity else frozenset()
        except UsageError:  # a later check of the netlist reports the error
            return frozenset()


@dataclass(frozen=True)
class ModelCard(Card):
    """Statement ``.model`` with a name, a type and parameters."""

    name: str
    type: str
    parameters: Mapping[str, str]


@dataclass(frozen=True)
class Parameters(Card):
    """Statement ``.param``: names and values of parameters."""

    values: Mapping[str, str]
    keyword: str = ".param"


@dataclass(frozen=True)
class FunctionCard(Card):
    """Statement ``.func``: name, arguments and expression of a function."""

    name: str
    arguments: tuple[str, ...]
    expression: str


@dataclass(frozen=True)
class Directive(Card):
    """Dot statement without a class of its own: keyword in lower case, and words."""

    keyword: str
    words: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """Text of the statement on one line."""
        return " ".join((self.keyword, *self.words))

    @property
    def argument(self) -> str:
        """Text after the keyword without enclosing quotes, such as the path of an include."""
        return " ".join(self.words).strip("\"'")


@dataclass(frozen=True)
class Circuit(Card):
    """Subcircuit or netlist file with its items; a file has an empty ``name``.

    ``defaults`` are the parameters that an instance may set, with their default values. ``closing``
    contains the comments after the last item.
    """

    name: str = ""
    pins: tuple[str, ...] = ()
    defaults: Mapping[str, str] = field(default_factory=dict)
    items: tuple[Item, ...] = ()
    closing: tuple[str, ...] = ()

    @property
    def subcircuits(self) -> tuple[Circuit, ...]:
        """Subcircuits defined at the top level of this circuit, without nested ones."""
        return select_items(self.items, Circuit)

    def map_items(self, change: Callable[[Item], Item]) -> Circuit:
        """Return the circuit with a function applied to each item, innermost items first.

        ``change`` is the function that changes an item.
        """
        inner = (i.map_items(change) if isinstance(i, Circuit) else i for i in self.items)
        return replace(self, items=tuple(map(change, inner)))


Item = Element | ModelCard | Parameters | FunctionCard | Directive | Circuit
Kind = TypeVar("Kind")
Value = TypeVar("Value")


def key_by_lower_name(values: Mapping[str, Value]) -> dict[str, Value]:
    """Return the values with all keys in lower case.

    Simulators ignore the letter case of names.
    """
    return dict(zip(map(str.lower, values), values.values(), strict=True))


def select_items(items: Iterable[object], kind: type[Kind]) -> tuple[Kind, ...]:
    """Return all items of one class, such as all elements, in the original order."""
    return tuple(item for item in items if isinstance(item, kind))


@dataclass(frozen=True)
class Pin:
    """Pin of a subcircuit, with the quantities that 1 V and 1 A represent.

    1 V on the pin represents one ``unit``. 1 A into the pin represents one unit of ``flow``, which
    is ``"-"`` for a signal pin.
    """

    name: str
    unit: str
    flow: str

    @property
    def key(self) -> str:
        """Key for look-ups: the name in lower case, as simulators ignore letter case."""
        return self.name.lower()


@dataclass(frozen=True)
class Param:
    """Parameter of a subcircuit, with unit, default value and range."""

    name: str
    default: float
    unit: str
    doc: str
    low: float = -math.inf
    high: float = math.inf


def make_electrical_pins(names: Iterable[str]) -> tuple[Pin, ...]:
    """Return electrical pins, with the units V and A."""
    return tuple(Pin(name, "V", "A") for name in names)


def make_positive_parameter(name: str, default: float, unit: str, doc: str) -> Param:
    """Return a parameter whose value must be positive."""
    return Param(name, default, unit, doc, low=SMALLEST_POSITIVE)
