"""Printer of syntax trees in the syntax of ngspice; base class of all printers."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, count

from kc2spice.netlist.circuit import (
    NODE_COUNTS,
    Circuit,
    Directive,
    Element,
    FunctionCard,
    Item,
    ModelCard,
    Parameters,
    select_items,
)
from kc2spice.netlist.expression import ExpressionWriter, Name, Tree, parse_expression, walk_tree
from kc2spice.netlist.printers.line_breaks import wrap_card, wrap_comments
from kc2spice.netlist.scale_factors import write_numbers_with_prefixes

# Names in expressions that are not parameters and need no braces.
_BARE_NAMES = frozenset({"time", "temper", "hertz", "pi"})
# Cards of analyses; the numbers on these cards are printed with scale factors, such as ``10u``.
_NUMERIC_CARDS = frozenset({".tran", ".ac", ".dc", ".noise"})
_TABLE_WIDTH = 96


class Printer(ExpressionWriter):
    """Printer of circuits and decks in the netlist syntax of ngspice."""

    title = "ngspice"
    keyword = ""  # word before the parameters on cards of subcircuits and instances

    def __init__(self) -> None:
        self.where = "netlist"

    def format_file(self, circuit: Circuit) -> str:
        """Return the text of a file with all items of a circuit."""
        lines = [*self.format_cards(circuit.items), *_format_comments(circuit.closing)]
        return "\n".join(lines) + "\n"

    def format_cards(self, items: Sequence[Item]) -> Iterator[str]:
        """Yield the comment lines of each netlist item, and then the card of the item."""
        for item in items:
            yield from _format_comments(item.notes)
            self.where = item.where
            if card := self.card(item):
                yield card if isinstance(item, Circuit) else _continue_card(card)

    def card(self, item: Item) -> str:
        """Return the text of one netlist item without its comments.

        The text may be empty.
        """
        match item:
            case Element():
                return self.format_element(item)
            case ModelCard():
                return self.format_model(item)
            case Parameters():
                return f"{item.keyword} {self.join_assignments(item.values)}"
            case FunctionCard(name, arguments, _):
                law = self.format_word(f"{{{item.expression.strip('{}')}}}")
                return f".func {name}({','.join(arguments)}) {law}"
            case Circuit():
                body = (*self.format_cards(item.items), *_format_comments(item.closing))
                return "\n".join(
                    [_continue_card(self.write_subckt_card(item)), *body, f".ends {item.name}"]
                )
        return self.directive(item)

    def write_subckt_card(self, circuit: Circuit) -> str:
        """Return the ``.subckt`` card that begins a subcircuit."""
        keyword = self.keyword if circuit.defaults else ""
        return _join_words(
            ".subckt", circuit.name, *circuit.pins, keyword, self.join_assignments(circuit.defaults)
        )

    def format_element(self, part: Element) -> str:
        """Return the card of an element."""
        keyword = self.keyword if part.kind == "x" and part.parameters else ""
        law = self.format_law(part) if part.quantity else ""
        known = part.kind in NODE_COUNTS  # words of an unknown element may be names of nodes
        values = " ".join(map(self.format_word, part.values) if known else part.values)
        pairs = self.join_assignments(part.parameters)
        return _join_words(
            part.name, *part.nodes, *part.sources, part.model, values, law, keyword, pairs
        )

    def format_law(self, part: Element) -> str:
        """Format the law of a behavioural source as an expression.

        An expression with parameters is enclosed in braces completely, because ngspice inserts the
        content of inner braces as text. The expression of an E or G source always has braces,
        because ngspice rejects a number directly after ``value=``.
        """
        text = self.write_tree(part.law)
        if part.kind != "b":
            return f"value={{{text}}}"
        words = [leaf.text.lower() for leaf in select_items(walk_tree(part.law), Name)]
        inner = f"{{{text}}}" if not _BARE_NAMES.issuperset(words) else text
        return f"{part.quantity}={inner}"

    def format_model(self, model: ModelCard) -> str:
        """Return the card of a model."""
        inside = self.join_assignments(model.parameters)
        return _join_words(".model", model.name, model.type + (f"({inside})" if inside else ""))

    def directive(self, card: Directive) -> str:
        """Return the text of a dot card; a control block has one command on each line."""
        if card.keyword == ".control":
            return "\n".join([".control", *card.words, ".endc"])
        words = (
            map(self.format_numbers, card.words) if card.keyword in _NUMERIC_CARDS else card.words
        )
        return _join_words(card.keyword, *words)

    def join_assignments(self, assignments: Mapping[str, str]) -> str:
        """Return the words ``name=value``; an assignment without a value is a flag."""
        return " ".join(
            f"{key}={self.format_word(value)}" if value else key
            for key, value in assignments.items()
        )

    def format_numbers(self, text: str) -> str:
        """Return a word of a card with numbers in the spelling of this dialect."""
        return write_numbers_with_prefixes(text)

    def format_word(self, text: str) -> str:
        """Return the text of a word; a word in braces or quotes is an expression."""
        if text[:1] not in ("{", "'"):
            return self.format_numbers(text)
        written = self.write_tree(parse_expression(text, where=self.where))
        return f"{{{written.replace(', ', ',')}}}"  # a blank after a comma would end the word

    def write_call(self, function: str, arguments: tuple[Tree, ...]) -> str:
        """Return a function call; the points of a table are on several lines."""
        if function != "pwl":
            return super().write_call(function, arguments)
        head, *numbers = map(self.write_tree, arguments)
        rows = list(map(", ".join, zip(numbers[::2], numbers[1::2], strict=False)))
        lines = textwrap.wrap(", ".join(rows), _TABLE_WIDTH, break_long_words=False)
        return f"pwl({head},\n+ " + "\n+ ".join(lines) + ")"


def _format_comments(notes: Iterable[str]) -> tuple[str, ...]:
    """Return the lines of comments, wrapped to the maximum line length."""
    return tuple(chain.from_iterable(map(wrap_comments, notes)))


def _continue_card(card: str) -> str:
    """Return a card with line breaks; a control block is unchanged."""
    return card if card.startswith(".control") else "\n".join(wrap_card(card))


def _join_words(*words: str) -> str:
    """Join all nonempty words by blanks."""
    return " ".join(filter(None, words))


def locate_cards(circuit: Circuit, file: str) -> Circuit:
    """Return a tree in which each card has its printed text and its line number."""
    return replace(circuit, items=tuple(_locate_items(circuit.items, Printer(), file, count(1))))


def _locate_items(
    items: Iterable[Item], printer: Printer, file: str, lines: Iterator[int]
) -> Iterator[Item]:
    """Locate cards and subcircuits in a netlist file; yield them with line numbers.

    The iterator ``lines`` yields the line numbers of the file in ascending order.
    """
    for item in items:
        _skip_lines(lines, len(_format_comments(item.notes)))
        if isinstance(item, Circuit):
            head = _continue_card(printer.write_subckt_card(item))
            where = f"{file}:{next(lines)}"
            _skip_lines(lines, head.count("\n"))
            inner = tuple(_locate_items(item.items, printer, file, lines))
            _skip_lines(lines, len(_format_comments(item.closing)) + 1)
            yield replace(item, items=inner, where=where, written=head.replace("\n+", ""))
        elif card := printer.card(item):
            card = _continue_card(card)
            where = f"{file}:{next(lines)}"
            _skip_lines(lines, card.count("\n"))
            yield replace(item, where=where, written=card.replace("\n+", ""))


def _skip_lines(lines: Iterator[int], number: int) -> None:
    """Advance the line counter by a number of lines."""
    for _ in range(number):
        next(lines)
