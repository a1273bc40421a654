"""Netlists as trees of elements, models, parameters and subcircuits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

from kc2spice.core.errors import UsageError
from kc2spice.netlist.expression import Tree, parse, probed_names
from kc2spice.netlist.spelling import number

LEAST = 1e-30  # least value of a parameter that must be above zero
# Nodes of each element letter; X counts by its subcircuit, E and G have two if behavioural.
NODES = {
    "r": 2, "c": 2, "l": 2, "v": 2, "i": 2, "b": 2, "e": 4, "g": 4, "f": 2, "h": 2,
    "d": 2, "q": 3, "j": 3, "m": 4, "z": 3, "s": 4, "w": 2, "t": 4, "k": 0,
}  # fmt: skip
MODELLED = frozenset("dqjmzsw")  # the word behind nodes and controls names a .model
CONTROLS = {"f": 1, "h": 1, "w": 1, "k": 2}  # sources or inductors behind the nodes


@dataclass(frozen=True, kw_only=True)
class Card:
    """One statement with ``notes``, the comment and blank lines above it.

    Messages quote ``where``, its place as ``file:line``, and ``written``, its text on one line.
    ``owner`` is the part of a scene that it belongs to.
    """

    notes: tuple[str, ...] = ()
    owner: str = field(default="", compare=False)
    where: str = field(default="", compare=False)
    written: str = field(default="", compare=False)

    @property
    def file(self) -> str:
        """Name of the file that contains the statement."""
        return self.where.rpartition(":")[0]

    def error(
        self, message: str, got: str = "", expected: str | None = None, hint: str | None = None
    ) -> UsageError:
        """Return the error for this card; ``got`` is by default the card as written."""
        got = got or self.written[:80]
        return UsageError(message, where=self.where, got=got, expected=expected, hint=hint)


@dataclass(frozen=True)
class Element(Card):
    """One device with its ``nodes``, controlling ``sources`` and ``model``.

    ``kind`` is its letter in lower case, ``values`` are the words behind the nodes, ``parameters``
    the assignments behind the values. A behavioural source (B, or E and G with an expression) has
    the ``quantity`` V or I that its ``expression`` gives. Names are spelled as they were written.
    ``unit`` is the unit of its values if it differs from that of the simulator (V, A, Ohm, F, H).
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
    def of(cls, name: str, *words: str | float, **parameters: str) -> Element:
        """Return the element of a name with its nodes, controls, and model or values.

        Parameters
        ----------
        name : str
            Name of the element. The first letter of the name is the kind of the element.
        *words : str or float
            Words behind the name. Numbers are spelled by :func:`kc2spice.netlist.spelling.number`.
        **parameters : str
            Assignments behind the words.

        Examples
        --------
        >>> Element.of("Cmass", "v", "base", 1e-5, IC="0").values
        ('1e-05',)
        """
        kind, texts = name[0].lower(), tuple(w if isinstance(w, str) else number(w) for w in words)
        if kind == "x":
            return cls(kind, name, texts[:-1], model=texts[-1], parameters=parameters)
        count = NODES[kind]
        end = count + CONTROLS.get(kind, 0)
        nodes, sources, values = texts[:count], texts[count:end], texts[end:]
        model = values[0] if kind in MODELLED else ""
        values = values[1:] if kind in MODELLED else values
        return cls(kind, name, nodes, sources, model, values, parameters)

    @classmethod
    def behaviour(cls, name: str, plus: str, minus: str, quantity: str, law: str) -> Element:
        """Return the behavioural source of a current I or a voltage V by an expression."""
        return cls("b", name, (plus, minus), quantity=quantity, expression=law)

    def with_unit(self, unit: str) -> Element:
        """Return the same element with values in this unit."""
        return replace(self, unit=unit)

    @cached_property
    def key(self) -> str:
        """The name in lower case, as simulators compare names."""
        return self.name.lower()

    @cached_property
    def ends(self) -> tuple[str, ...]:
        """The nodes in lower case, as simulators compare nodes."""
        return tuple(map(str.lower, self.nodes))

    @cached_property
    def settings(self) -> dict[str, str]:
        """Parameters of the element by names in lower case."""
        return lower_keys(self.parameters)

    @cached_property
    def law(self) -> Tree:
        """The expression of a behavioural source as a tree.

        Raises
        ------
        UsageError : the text is no expression.
        """
        return parse(self.expression, where=self.where)

    @property
    def sensed_nodes(self) -> frozenset[str]:
        """Nodes whose voltages the expression reads; none if the expression is broken."""
        try:
            return probed_names(self.law, "v") if self.quantity else frozenset()
        except UsageError:  # the linter reports it
            return frozenset()


@dataclass(frozen=True)
class Model(Card):
    """``.model``: its type and parameters."""

    name: str
    type: str
    parameters: Mapping[str, str]


@dataclass(frozen=True)
class Parameters(Card):
    """``.param``: names and values."""

    values: Mapping[str, str]
    keyword: str = ".param"


@dataclass(frozen=True)
class Function(Card):
    """``.func``: a name for an expression of its arguments."""

    name: str
    arguments: tuple[str, ...]
    expression: str


@dataclass(frozen=True)
class Directive(Card):
    """Any other card with a dot: its keyword in lower case and the words behind it."""

    keyword: str
    words: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The card on one line."""
        return " ".join((self.keyword, *self.words))


@dataclass(frozen=True)
class Circuit(Card):
    """A subcircuit, or the content of one file, with an empty ``name``.

    ``defaults`` are the parameters that an instance may set, ``closing`` the comments behind the
    last item.
    """

    name: str = ""
    pins: tuple[str, ...] = ()
    defaults: Mapping[str, str] = field(default_factory=dict)
    items: tuple[Item, ...] = ()
    closing: tuple[str, ...] = ()

    @property
    def subcircuits(self) -> tuple[Circuit, ...]:
        """The subcircuits that the circuit defines."""
        return items_of(self.items, Circuit)

    def changed(self, change: Callable[[Item], Item]) -> Circuit:
        """Return the same circuit with every item changed, those of subcircuits first."""
        inner = (i.changed(change) if isinstance(i, Circuit) else i for i in self.items)
        return replace(self, items=tuple(map(change, inner)))


Item = Element | Model | Parameters | Function | Directive | Circuit
Kind = TypeVar("Kind")
Value = TypeVar("Value")


def lower_keys(values: Mapping[str, Value]) -> dict[str, Value]:
    """Return values by their names in lower case, as simulators compare names."""
    return dict(zip(map(str.lower, values), values.values(), strict=True))


def items_of(items: Iterable[object], kind: type[Kind]) -> tuple[Kind, ...]:
    """Return the items of one class, such as all elements, in their order."""
    return tuple(item for item in items if isinstance(item, kind))


@dataclass(frozen=True)
class Pin:
    """One pin of a subcircuit, with the meaning of 1 V and 1 A on it.

    A signal pin has the flow ``"-"``.
    """

    name: str
    unit: str
    flow: str

    @property
    def key(self) -> str:
        """The name in lower case, as simulators compare names."""
        return self.name.lower()


@dataclass(frozen=True)
class Param:
    """A parameter of a subcircuit with its default in ``unit`` and its range."""

    name: str
    default: float
    unit: str
    doc: str
    low: float = -math.inf
    high: float = math.inf


def electrical_pins(names: Iterable[str]) -> tuple[Pin, ...]:
    """Return pins on which a volt is a volt and an ampere is an ampere."""
    return tuple(Pin(name, "V", "A") for name in names)


def positive_parameter(name: str, default: float, unit: str, doc: str) -> Param:
    """Return a parameter that must stay above zero."""
    return Param(name, default, unit, doc, low=LEAST)
