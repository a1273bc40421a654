"""Base class of the netlist dialects of simulators other than ngspice.

Sources: Xyce Reference Guide (devices B, S, X, commands .PRINT and .SUBCKT) and LTspice Help
(B sources, .model SW, .save).
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from operator import attrgetter
from types import MappingProxyType
from typing import ClassVar

from kc2spice.core.errors import UsageError
from kc2spice.netlist.circuit import (
    Circuit,
    Directive,
    Element,
    FunctionCard,
    Item,
    ModelCard,
    Parameters,
    key_by_lower_name,
    select_items,
)
from kc2spice.netlist.deck import ANALYSES, Deck
from kc2spice.netlist.expression import (
    COMMON_FUNCTIONS,
    BinaryOperation,
    ConditionalExpression,
    FunctionCall,
    Number,
    Trace,
    Tree,
    UnaryOperation,
    parse_expression,
    parse_vector,
)
from kc2spice.netlist.name_scopes import INCLUDES
from kc2spice.netlist.printers.ngspice import Printer
from kc2spice.netlist.subcircuit_library import Subcircuit

_COMMON_COMMANDS = frozenset({".end", *ANALYSES, *INCLUDES}) - {".noise"}
# letters of elements with the same syntax in all dialects, apart from braces and parameters
_COMMON_ELEMENTS = frozenset("rclvikfhxdqjmbegs")
# Parameters of semiconductor models from SPICE2, with the same meaning in ngspice, Xyce and
# LTspice.
_SEMICONDUCTOR_PARAMETERS = {
    "d": "is rs n tt cjo vj m eg xti fc bv ibv",
    "npn": "is bf nf vaf ikf ise ne br nr var ikr rb rc re cje vje mje tf cjc vjc mjc tr",
    "nmos": "level vto kp gamma phi lambda rd rs is cgso cgdo cgbo tox",
    "njf": "vto beta lambda rd rs cgs cgd pb is",
}
for _p_type, _n_type in (("pnp", "npn"), ("pmos", "nmos"), ("pjf", "njf")):
    _SEMICONDUCTOR_PARAMETERS[_p_type] = _SEMICONDUCTOR_PARAMETERS[_n_type]
COMMON = COMMON_FUNCTIONS.union(["acosh", "asinh", "atanh", "ceil", "int", "log10", "sgn", "uramp"])
_EULER_NUMBER = "2.718281828459045"


# Element parameters of ngspice that Xyce and LTspice also have.
_ELEMENT_PARAMETERS = {
    "r": {"tc", "tc1", "tc2", "temp"},
    "c": {"ic", "m"},
    "l": {"ic", "m"},
    "v": set[str](),
    "i": set[str](),
    "d": {"area", "m", "temp"},
    "q": {"area", "m", "temp"},
    "j": {"area", "m", "temp"},
    "m": {"l", "w", "ad", "as", "pd", "ps", "nrd", "nrs", "m", "temp"},
}
# element parameters that are omitted: they affect only noise analyses, which dialects reject
_NOISE_PARAMETERS = frozenset({"noisy"})
_EXPONENT = r"e[-+]?\d+"
_NUMBER = re.compile(
    rf"(?<![\w.])(?:\d+\.?\d*|\.\d+)(?:{_EXPONENT})?((?!{_EXPONENT})[a-z]\w*)(?![\w.])", re.I
)
# scale factors with the same meaning in all simulators
_COMMON_SCALE_FACTORS = frozenset({"t", "g", "meg", "k", "m", "u", "n", "p", "f"})


class Dialect(Printer, ABC):
    """Printer of one dialect, which overrides the syntax of ngspice where necessary.

    ``dialect`` is the name for the option ``--dialect``, ``title`` is the simulator name in
    messages, and ``command`` runs a deck. ``keyword`` is the word before parameters on the cards of
    subcircuits. ``functions`` contains the functions of the simulator, and ``rewritten`` contains
    the ngspice functions that :meth:`write_call` replaces. ``known_options`` contains the options
    of the simulator, which are written after ``option_prefix``; other options become comments. All
    cards of each command in ``joined`` are merged into one card. ``parameters`` contains the known
    parameters, keyed by element letter. ``temperature`` is the name of the temperature in
    expressions. With an empty ``temperature``, an expression that contains the temperature causes
    an error.

    ``deck`` is the deck to print, or None for a library alone. :attr:`analysis` is the analysis of
    the deck. :meth:`make_unsupported_error` returns the error for a construct that the simulator
    lacks.
    """

    dialect: ClassVar[str] = ""
    command = ""
    option_prefix = ".options"
    known_options: frozenset[str] = frozenset()
    joined = frozenset({".save"})  # Xyce writes one output file for each ``.print`` card
    functions = COMMON
    rewritten = frozenset({"pow", "pwl"})
    parameters: Mapping[str, set[str]] = MappingProxyType(_ELEMENT_PARAMETERS)
    temperature = ""
    measure_keyword = ".meas"

    def __init__(self, deck: Deck | None = None) -> None:
        super().__init__()
        self.deck = deck
        self.defined: set[str] = set()
        self.unmeasured: set[str] = set()  # names of measurements that this dialect cannot express

    @cached_property
    def analysis(self) -> Directive:
        """Analysis card of the deck; without one, a ``.tran`` card with ``uic``."""
        items = self.deck.trees[self.deck.main_file_name].items if self.deck else ()
        analyses = (card for card in select_items(items, Directive) if card.keyword in ANALYSES)
        transient = Directive(".tran", ("uic",))
        return min(analyses, key=attrgetter("keyword"), default=transient)

    def symbols(self, part: Subcircuit, library: str) -> dict[str, str]:
        """Return the files with the graphical symbols of a part; none by default.

        ``library`` is the name of the library file.
        """
        return {}

    # -- cards ------------------------------------------------------------------------------

    def format_file(self, circuit: Circuit) -> str:
        """Return the text of a netlist file with all items of a circuit."""
        self.defined = {item.name.lower() for item in select_items(circuit.items, FunctionCard)}
        return super().format_file(circuit)

    def format_cards(self, items: Sequence[Item]) -> Iterator[str]:
        """Yield the text of each card, after repeated cards of a command are merged.

        The attribute ``joined`` contains the keywords of the commands whose cards are merged into
        one card.
        """
        return super().format_cards(_join_commands(items, self.joined))

    def card(self, item: Item) -> str:
        """Return the text of one netlist item without its comments.

        The text may be empty.
        """
        if isinstance(item, Parameters) and item.keyword != ".param":
            raise self.make_unsupported_error(item.written, f"the command {item.keyword}")
        if not isinstance(item, Directive):
            return self._require_text(item, super().card(item))
        match item.keyword:
            case ".meas":
                return self.measure(item) or f"* {self.title} prints no {item.text}"
            case ".print":  # other simulators write all vectors of the ``.save`` cards
                return ""
            case ".options" | ".option" | ".opt":
                return self.format_options(item.words)
            case ".save":
                return self.save(list(map(self.format_vector, item.words)))
            case ".ic" | ".nodeset":
                return self.directive(
                    replace(item, words=tuple(map(self.format_initial_value, item.words)))
                )
            case keyword if keyword in _COMMON_COMMANDS & ANALYSES:
                return self.directive(
                    replace(item, words=tuple(map(self.format_numbers, item.words)))
                )
            case keyword if keyword in _COMMON_COMMANDS:
                return self.directive(item)
        raise self.make_unsupported_error(item.text, f"the command {item.keyword}")

    def _require_text(self, item: Item, text: str) -> str:
        """Return ``text``; raise an error if it is not the nonempty text of a card."""
        method = "format_element" if isinstance(item, Element) else "format_model"
        if isinstance(item, Element | ModelCard) and (
            not isinstance(text, str) or not text.strip()
        ):
            raise UsageError(
                f"the dialect {self.dialect} writes no text for this card",
                where=self.where,
                got=f"{method}() returned {text!r} for {item.written[:80]}",
                expected="the card as text",
                hint=f"end the method with a return, such as: return super().{method}(card)",
            )
        return text

    def measure(self, card: Directive) -> str:
        """Return the card of a measurement; empty if the dialect cannot express it."""
        if len(card.words) < 3:
            return ""
        kind, name, what, *rest = card.words
        if what.startswith("param="):
            expression = what.removeprefix("param=").strip("'")
            known = expression.rpartition("*")[2] not in self.unmeasured
            return (
                self.format_derived_measure(kind, name, self.format_numbers(expression))
                if known
                else ""
            )
        read: tuple[str, ...] = ()
        match what, rest:
            case (("MAX" | "MIN" | "PP" | "AVG" | "RMS"), [text]):
                read = (what, self.format_measured_quantity(text, kind))
            case (("MAX_AT" | "MIN_AT"), [text]):
                measured = self.format_measured_quantity(text, kind)
                read = self.locate_extreme(what.removesuffix("_AT"), measured, kind)
            case "FIND", [text, at] if at.startswith("AT="):
                read = (what, self.format_measured_quantity(text, kind), self.format_numbers(at))
            case "WHEN", [condition, "CROSS=1"]:
                text, _, level = condition.rpartition("=")
                read = (
                    what,
                    f"{self.format_measured_quantity(text, kind)}={self.format_numbers(level)}",
                    "CROSS=1",
                )
        if not read:
            self.unmeasured.add(name)
            return ""
        return " ".join((self.measure_keyword, kind.upper(), name, *read))

    def format_measured_quantity(self, text: str, kind: str) -> str:
        """Return the expression of a measured quantity in an analysis of type ``kind``.

        In an ``ac`` analysis, the quantity is the magnitude of a voltage or the real part of a
        current.
        """
        if text.startswith("vm("):
            return self.format_magnitude(self.format_vector(f"v({text[3:]}"))
        plain = self.format_vector(text)
        return self.format_real_part(plain) if kind == "ac" else plain

    def locate_extreme(self, extreme: str, vector: str, kind: str) -> tuple[str, ...]:
        """Return the words of a measurement card that locate an extremum."""
        return ()

    @abstractmethod
    def format_derived_measure(self, kind: str, name: str, expression: str) -> str:
        """Return a card that computes a measurement from other measurements."""

    @abstractmethod
    def format_magnitude(self, vector: str) -> str:
        """Return the text for the magnitude of a complex vector."""

    @abstractmethod
    def format_real_part(self, vector: str) -> str:
        """Return the text for the real part of a complex vector."""

    def make_unsupported_error(
        self, got: str | None, what: str, expected: str | None = None
    ) -> UsageError:
        """Return the error for a construct that this dialect cannot express."""
        message, got = f"{self.title} has no equivalent of {what}", got and got[:120]
        return UsageError(
            message,
            where=self.where,
            got=got,
            expected=expected,
            hint="rewrite this card, or export with --dialect ngspice",
        )

    def format_element(self, part: Element) -> str:
        """Return the card of an element."""
        laplace = part.kind in "eg" and len(part.nodes) == 2 and not part.quantity
        files = "file" in " ".join((*part.values, *part.parameters)).lower()
        if (
            part.kind not in _COMMON_ELEMENTS
            or laplace
            or files
            or (part.kind in "eg" and part.parameters)
        ):
            raise self.make_unsupported_error(part.written, f"this {part.kind.upper()} card")
        known = self.parameters.get(part.kind)
        if known is not None:
            part = replace(part, parameters=self._known_parameters(part, known))
        return super().format_element(part)

    def _known_parameters(self, part: Element, known: set[str]) -> dict[str, str]:
        """Return the parameters of an element except noise settings; reject unknown ones."""
        result = {}
        for key, value in part.parameters.items():
            if key.lower() in _NOISE_PARAMETERS:
                continue
            if key.lower() not in known:
                what = f"the parameter {key} of this {part.kind.upper()} card"
                expected = ", ".join(sorted(known)) or "no parameters"
                raise self.make_unsupported_error(part.written, what, expected)
            result[key] = value
        return result

    def format_model(self, model: ModelCard) -> str:
        """Return the card of a switch model or of a semiconductor model."""
        parameters = key_by_lower_name(model.parameters)
        values = dict(zip(parameters, map(self.format_word, parameters.values()), strict=True))
        if model.type.lower() == "sw":
            return self.switch(model.name, values)
        known = _SEMICONDUCTOR_PARAMETERS.get(model.type.lower(), "").split()
        if not set(values) <= set(known) or values.get("level", "1") != "1":
            raise self.make_unsupported_error(model.written, "this model")
        return super().format_model(model)

    def format_options(self, words: Sequence[str]) -> str:
        """Return the options card; options that the simulator lacks become comments."""
        supported, comments = [], []
        for word in words:
            if word.partition("=")[0].lower() in self.known_options:
                supported.append(self.format_numbers(word))
            else:
                comments.append(f"* {self.title} has no option {word}")
        lines = [f"{self.option_prefix} {' '.join(supported)}"] if supported else []
        return "\n".join([*lines, *comments])

    def save(self, vectors: list[str]) -> str:
        """Return the ``.save`` card, which selects the vectors that a run saves."""
        return "\n+ ".join([".save", *vectors])

    @abstractmethod
    def switch(self, name: str, values: Mapping[str, str]) -> str:
        """Return the model card of a voltage-controlled switch."""

    def format_initial_value(self, text: str) -> str:
        """Return the initial value ``v(NODE)=VALUE`` in this dialect."""
        node, equals, value = text.partition("=")
        return f"{self.format_vector(node)}={self.format_word(value)}" if equals else text

    def format_vector(self, text: str) -> str:
        """Return the name of a saved vector in this dialect."""
        result = parse_vector(text)
        bare = "(" not in text and "@" not in text
        if result is None or bare or result.parameter.lower() not in ("", "i", "id", "current"):
            raise self.make_unsupported_error(text, "this vector")
        if result.quantity == "i":
            return f"I({self.format_device(result)})"
        return f"V({','.join(self.format_node(name.split('.')) for name in result.names)})"

    def format_node(self, path: list[str]) -> str:
        """Return the name of a node inside nested subcircuit instances."""
        return ":".join(path)

    def format_device(self, trace: Trace) -> str:
        """Format the name of a device in this dialect, to save the current of the device."""
        return ":".join([*trace.path, *trace.names])

    def format_numbers(self, text: str) -> str:
        """Format the numbers of a word so that all simulators read equal values.

        Unit letters after a number are removed. Scale factors such as ``mil``, ``a`` or ``x`` are
        replaced.
        """
        return _NUMBER.sub(_remove_letters, text)

    # -- expressions ------------------------------------------------------------------------

    def format_name(self, text: str) -> str:
        """Return the spelling of a parameter or keyword."""
        known = {"e": _EULER_NUMBER, "temper": self.temperature}
        if known.get(text.lower(), text) == "" or text.lower() == "hertz":
            raise self.make_unsupported_error(text, f"the word {text}")
        return known.get(text.lower(), text)

    def write_call(self, function: str, arguments: tuple[Tree, ...]) -> str:
        """Return an equivalent function call, such as ``table`` for ``pwl``."""
        if function == "pwl":
            values = arguments[1:]
            flat = len(values) >= 4 and values[1] == values[3] and values[-1] == values[-3]
            # ``pwl`` extrapolates beyond its points, but ``table`` does not
            if len(values) % 2 or not flat:
                raise UsageError(
                    f"a pwl() that is not constant at both ends has no equivalent in {self.title}",
                    where=self.where,
                    got="different values in the first or in the last two points of the pwl()",
                    expected="equal values in the first two points, and in the last two points",
                    hint="add a point with an equal value before the first point and after the "
                    "last point",
                )
            head, *pairs = map(self.write_tree, arguments)
            rows = [f"\n+ {x},{y}" for x, y in zip(pairs[::2], pairs[1::2], strict=True)]
            return f"table({head},{','.join(rows)})"
        if function == "pow" and len(arguments) == 2:
            return self.write_tree(BinaryOperation("^", *arguments))
        spelled = "ln" if function == "log" else function
        if spelled not in self.functions and function not in self.defined:
            known = ", ".join(sorted(self.functions | self.rewritten))
            raise self.make_unsupported_error(None, f"the function {function}", known)
        return super().write_call(spelled, arguments)

    def format_condition(self, tree: Tree) -> str:
        """Return a condition in which any nonzero number is true, as in ngspice."""
        if isinstance(tree, BinaryOperation) and tree.op in _COMPARISON_OPERATORS:
            return super().write_tree(tree)
        return f"{self.write_tree(_convert_condition(tree), 3)}>0.5"

    def write_tree(self, tree: Tree, level: int = 0) -> str:
        """Write an expression tree as text in the syntax of the dialect.

        As in ngspice, a power is computed from the absolute value of its base. Logical operators
        become conditional expressions, which have the syntax ``if(test, yes, no)`` in Xyce and
        LTspice.
        """
        match tree:
            case ConditionalExpression(test, yes, no):
                condition = self.format_condition(test)
                return f"if({condition}, {self.write_tree(yes)}, {self.write_tree(no)})"
            case BinaryOperation("^", left, right):
                return f"pow(abs({self.write_tree(left)}), {self.write_tree(right)})"
            case BinaryOperation("&&" | "||" | "==" | "!=") | UnaryOperation("!"):
                return self.write_tree(_convert_condition(tree), level)
        return super().write_tree(tree, level)


def _remove_letters(match: re.Match[str]) -> str:
    """Remove letters after a number, except scale factors that all simulators know."""
    if match[1].lower() in _COMMON_SCALE_FACTORS:
        return match[0]
    tree = parse_expression(match[0])
    return tree.text if isinstance(tree, Number) else match[0]


_ONE = Number("1")
_ZERO = Number("0")
_COMPARISON_OPERATORS = ("<", "<=", ">", ">=")


def _convert_condition(tree: Tree) -> Tree:
    """Return an expression that is 1 if a condition is true, otherwise 0."""
    match tree:
        case BinaryOperation(op) if op in _COMPARISON_OPERATORS:
            return ConditionalExpression(tree, _ONE, _ZERO)
        case BinaryOperation("&&", left, right):
            return BinaryOperation("*", _convert_condition(left), _convert_condition(right))
        case BinaryOperation("||", left, right):
            return FunctionCall("max", (_convert_condition(left), _convert_condition(right)))
        case BinaryOperation("!=", left, right):
            return _convert_condition(BinaryOperation("-", left, right))
        case BinaryOperation("==", left, right):
            return _convert_condition(UnaryOperation("!", BinaryOperation("-", left, right)))
        case UnaryOperation("!", value):
            return BinaryOperation("-", _ONE, _convert_condition(value))
    return ConditionalExpression(
        BinaryOperation(">", FunctionCall("abs", (tree,)), _ZERO), _ONE, _ZERO
    )


def _join_commands(items: Sequence[Item], joined: frozenset[str]) -> list[Item]:
    """Merge all cards of a command into one card, for each command in ``joined``.

    The merged card replaces the first card of the command, and has the comments of all cards of the
    command.
    """
    merged: dict[str | int, Item] = {}
    for number, item in enumerate(items):
        if isinstance(item, Directive) and item.keyword in joined:
            card = merged.get(item.keyword, Directive(item.keyword, where=item.where))
            assert isinstance(card, Directive)
            words, notes = card.words + item.words, card.notes + item.notes
            merged[item.keyword] = replace(card, words=words, notes=notes)
        else:
            merged[number] = item
    return list(merged.values())
