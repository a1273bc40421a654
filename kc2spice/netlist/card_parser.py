"""Parser that converts netlists to syntax trees."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import (
    accumulate,
    chain,
    combinations_with_replacement,
    count,
    filterfalse,
    takewhile,
)
from operator import attrgetter
from typing import Any

from kc2spice.core.errors import UsageError
from kc2spice.core.untrusted_files import split_lines
from kc2spice.netlist.circuit import (
    CONTROL_COUNTS,
    MODEL_KINDS,
    NODE_COUNTS,
    Card,
    Circuit,
    Directive,
    Element,
    FunctionCard,
    Item,
    ModelCard,
    Parameters,
)
from kc2spice.netlist.expression import parse_literal

_LAW_KEYWORDS = ("value", "vol", "cur", "table", "poly", "laplace")

LAPLACE_HINT = "replace this source by R, L, C, E and G elements with the same transfer function"
THERMAL_FLAG = "thermal"  # VDMOS flag that adds temperature pins (ngspice manual 11.3)
OPTION_CARDS = frozenset((".options", ".option", ".opt"))
_OPENING_BRACKETS = "({["
_CLOSING_BRACKETS = ")}]"
_OPERAND = re.compile(r"(?:\{[^{}]*\}|'[^']*'|[^\s(),])+")  # node, source or coefficient
_INLINE_COMMENT = re.compile(r";|(?<=\s)\$(?=\s)|//")  # start of a comment at the end of a card


# --- logical lines ---


@dataclass(frozen=True, kw_only=True)
class Statement(Card):
    """Logical line of a netlist: a card including its continuation lines.

    ``written`` is the text of the card without comments. ``line`` is the number of the first
    physical line, counted from 1.
    """

    line: int

    @property
    def keyword(self) -> str:
        """First word of the card in lower case; ``""`` if there are only comments."""
        return self.written.split(None, 1)[0].lower() if self.written else ""

    @cached_property
    def words(self) -> list[str]:
        """Words of the card; bracketed or quoted text is one word, and so is ``a = b``."""
        return split_words(self.written)

    @property
    def plain_words(self) -> list[str]:
        """Words of the card without the keyword ``params:``, which some dialects use."""
        return [word for word in self.words if word.lower() != "params:"]


def split_statements(text: str, file: str, *, title: bool = False) -> list[Statement]:
    """Return all statements of a file; the last one may contain only comments.

    If ``title`` is true, the first line is the title of a deck and becomes a comment.
    """
    # line number, comments above the card, lines of the card
    result: list[tuple[int, list[str], list[str]]] = []
    pending: list[str] = []  # comment lines below the latest statement
    lines = split_lines(text)
    for number, raw in enumerate(lines, 1):
        line = raw.strip()
        if not line or line.startswith("*") or (title and number == 1):
            pending.append(raw.rstrip())
        elif line.startswith("+") and result:
            result[-1][2].append(split_comment(line[1:])[0])
        elif line := split_comment(line)[0]:
            result.append((number, pending, [line]))
            pending = []
    if pending:
        result.append((len(lines) + 1, pending, []))
    return [
        Statement(line=k, where=f"{file}:{k}", written=" ".join(parts).rstrip(), notes=tuple(notes))
        for k, notes, parts in result
    ]


def split_words(text: str) -> list[str]:
    """Split a text at blanks outside of brackets and quotes.

    Blanks around ``=`` are removed.
    """
    # The expression matches only at the first of several blanks, so its time is proportional to the
    # length of the text.
    return list(_split_at_blanks(re.sub(r"(?<!\s)\s*(?<![=<>!])=(?!=)\s*", "=", text)))


def split_comment(line: str) -> tuple[str, str]:
    """Split a line into the text before a comment and the text of the comment."""
    match = _INLINE_COMMENT.search(line)
    if match is None:
        return line.strip(), ""
    return line[: match.start()].strip(), line[match.end() :].strip()


def _split_at_blanks(text: str) -> Iterator[str]:
    """Yield the words between blanks outside of brackets and quotes."""
    depth, quote, word = 0, "", ""
    for ch in text:
        if quote:
            quote = "" if ch == quote else quote
        elif ch in "\"'":
            quote = ch
        elif ch in _OPENING_BRACKETS:
            depth += 1
        elif ch in _CLOSING_BRACKETS:
            depth -= 1
        if ch.isspace() and depth <= 0 and not quote:
            if word:
                yield word
            word = ""
        else:
            word += ch
    if word:
        yield word


# --- circuits ---


def read_cards(text: str, file: str, *, title: bool = False) -> Circuit:
    """Parse the text of a netlist file to a syntax tree, up to the ``.end`` card.

    Raises
    ------
    UsageError : a card is invalid, or a subcircuit has no beginning or end.
    """
    return build_tree(split_statements(text, file, title=title))


def build_tree(cards: Iterable[Statement]) -> Circuit:
    """Build the syntax tree of the given cards up to ``.end``.

    Raises
    ------
    UsageError : a card is invalid, or a subcircuit has no beginning or end.
    """
    items, notes = _read_items(iter(cards), None)
    return Circuit(items=items, closing=notes)


def _read_items(
    cards: Iterator[Statement], head: Statement | None
) -> tuple[tuple[Item, ...], tuple[str, ...]]:
    """Return the items of a subcircuit or file, and the comments after the last item.

    ``head`` is the ``.subckt`` card that begins the subcircuit. Without ``head``, the function
    reads to the end of the file.
    """
    result: list[Item] = []
    for s in cards:
        if s.keyword == ".ends" and head is None:
            raise s.make_error(".ends without .subckt", hint="delete this line")
        if s.keyword == ".ends" or not s.keyword:
            if s.keyword or head is None:
                return tuple(result), s.notes
            break
        if s.keyword == ".control":
            block = takewhile(lambda card: card.keyword != ".endc", cards)
            commands = tuple(map(attrgetter("written"), block))
            result.append(Directive(".control", commands, **_describe_card_origin(s)))
        else:
            result.append(_read_subckt(s, cards) if s.keyword == ".subckt" else _read_card(s))
        if s.keyword == ".end":
            break
    if head is not None:
        name = head.words[1] if len(head.words) > 1 else ""
        end = f".ends {name}".strip()
        hint = f"add the line  {end}  below the last element of {name or 'the subcircuit'}"
        raise head.make_error("this subcircuit has no end", expected=end, hint=hint)
    return tuple(result), ()


def _read_subckt(s: Statement, cards: Iterator[Statement]) -> Circuit:
    """Read a subcircuit from its ``.subckt`` card to the matching ``.ends`` card."""
    _, *operands = s.plain_words
    if not operands:
        raise s.make_error("this subcircuit has no name", hint="write  .subckt NAME PIN1 PIN2")
    pins, assigned = _separate_assignments(operands[1:])
    low = list(map(str.lower, pins))
    if len(set(low)) < len(low):
        duplicate = next(pin for pin in low if low.count(pin) > 1)
        hint = f"rename the second pin {duplicate}"
        raise s.make_error(f"the pin {duplicate} stands twice", " ".join(pins), hint=hint)
    defaults = _read_assignments(assigned, s)
    items, closing = _read_items(cards, s)
    return Circuit(operands[0], tuple(pins), defaults, items, closing, **_describe_card_origin(s))


def _separate_assignments(card: Iterable[str]) -> tuple[list[str], list[str]]:
    """Split the words of a card into names and assignments ``name=value``."""
    names: list[str] = []
    assignments: list[str] = []
    for word in card:
        (assignments if "=" in word else names).append(word)
    return names, assignments


def _read_card(s: Statement) -> Item:
    """Read one card that does not begin a subcircuit or a control block."""
    origin = _describe_card_origin(s)
    if not s.keyword.startswith("."):
        return parse_element(s)
    if s.keyword in (".func", ".param", ".params") and (defined := _read_function(s)):
        return defined
    if s.keyword in (".param", ".csparam"):
        return Parameters(_read_assignments(s.words[1:], s), s.keyword, **origin)
    if s.keyword == ".model":
        if len(s.words) < 3:
            model = s.words[1] if len(s.words) > 1 else "NAME"
            hint = f"write for example  .model {model} D(IS=1e-14)"
            raise s.make_error("model card is not complete", hint=hint)
        kind, _, inside = " ".join(s.words[2:]).partition("(")
        kind, *more = kind.split() + split_words(inside.rstrip().removesuffix(")"))
        return ModelCard(s.words[1], kind, dict(map(_split_assignment, more)), **origin)
    return Directive(s.keyword, tuple(s.words[1:]), **origin)


def _describe_card_origin(s: Statement) -> dict[str, Any]:
    """Return file, line and text of a card, and the comments above the card."""
    return {"notes": s.notes, "where": s.where, "written": s.written}


def _read_function(s: Statement) -> FunctionCard | None:
    """Read the function on a card ``.func f(x) {law}`` or ``.param f(x) = {law}``.

    The result is None for cards that define no function.
    """
    name, opening, rest = s.written[len(s.keyword) :].strip().partition("(")
    inside, closing, law = rest.partition(")")
    if not (opening and closing and law.strip() and name.strip().isidentifier()):
        return None
    arguments = tuple(filter(None, map(str.strip, inside.split(","))))
    law = law.strip().removeprefix("=").strip()
    return FunctionCard(name.strip(), arguments, law, **_describe_card_origin(s))


def _read_assignments(items: Iterable[str], s: Statement) -> dict[str, str]:
    """Return the values of assignments ``name=value``, keyed by name."""
    pairs = {}
    for item in items:
        word = item.strip(",")
        if not _is_assignment(word):
            named = word if word.isidentifier() else "NAME"
            hint = f"write {named}={'VALUE' if named == word else word}"
            raise s.make_error("not a parameter", word, "name=value", hint)
        name, value = _split_assignment(word)
        pairs[name] = value
    return pairs


def _is_assignment(word: str) -> bool:
    """Return whether a word is an assignment ``name=value``."""
    name, equals, _ = word.partition("=")
    return bool(equals) and name.isidentifier()


def _split_assignment(word: str) -> tuple[str, str]:
    """Return name and value of an assignment; the value of a flag is empty."""
    name, _, value = word.partition("=")
    return name, value


def parse_element(s: Statement) -> Element:
    """Parse an element card; with an unknown element letter, all words are values."""
    kind, origin = s.written[0].lower(), _describe_card_origin(s)
    if kind == "b":
        return _read_behavioural_source(s)
    name, *rest = s.plain_words
    if kind == "x":
        plain, assigned = _separate_assignments(rest)
        if not plain:
            raise s.make_error(
                "the name of the subcircuit is missing",
                hint=f"write  {name} NODE1 NODE2 SUBCIRCUIT",
            )
        assignments = _read_assignments(assigned, s)
        return Element(kind, name, tuple(plain[:-1]), (), plain[-1], (), assignments, **origin)
    if kind not in NODE_COUNTS:
        return Element(kind, name, (), values=tuple(rest), **origin)
    if kind in "efgh":
        rest[:] = _split_node_pairs(rest, 4 if kind in "eg" else 2)
    count = _count_nodes(kind, rest)
    end = count + CONTROL_COUNTS.get(kind, 0)
    if kind in "fh" and len(rest) > 2 and rest[2].lower().partition("(")[0] == "poly":
        end = count
    needed = end + (kind in MODEL_KINDS or kind not in "vi")
    if len(rest) < needed or not {"=", "("}.isdisjoint("".join(rest[:count])):
        more = ", then a value or model" if kind not in "vi" else ""
        places = " ".join(f"NODE{k}" for k in range(1, count + 1))
        hint = f"write  {name} {places}{' VALUE' if more else ''}"
        raise s.make_error("element is not complete", expected=f"{count} nodes{more}", hint=hint)
    nodes, sources, rest = tuple(rest[:count]), tuple(rest[count:end]), rest[end:]
    if kind in "eg" and count == 2:
        return _read_controlled_source(Element(kind, name, nodes, values=tuple(rest), **origin))
    model = rest.pop(0) if kind in MODEL_KINDS else ""
    values = tuple(filterfalse(_is_assignment, rest))
    assignments = dict(map(_split_assignment, filter(_is_assignment, rest)))
    return Element(kind, name, nodes, sources, model, values, assignments, **origin)


def _split_node_pairs(words: Sequence[str], count: int) -> list[str]:
    """Split node pairs such as ``(a,b)`` among the first ``count`` nodes of a source."""
    nodes: list[str] = []
    for k, word in enumerate(words):
        is_law = word.lower().startswith(_LAW_KEYWORDS) or not set("={'\"").isdisjoint(word)
        if is_law or len(nodes) >= count:
            return [*nodes, *words[k:]]
        nodes += split_operands(word)
    return nodes


def _count_nodes(kind: str, rest: Sequence[str]) -> int:
    """Return the number of nodes of an element, given the words after its name."""
    if kind in "eg" and len(rest) > 2 and rest[2].lower().startswith(_LAW_KEYWORDS):
        word = rest[2].lower().partition("=")[0].partition("(")[0]
        return 2 if word in _LAW_KEYWORDS else 4
    if kind == "q" and len(rest) > 4 and "=" not in rest[4] and rest[4][0] not in "0123456789.+-":
        return 4
    if kind == "m":
        words = [*takewhile(lambda w: "=" not in w, rest)]
        if words[-1:] and words[-1].lower() == THERMAL_FLAG:
            # a VDMOS with pins for the junction temperature and the case temperature
            return len(words) - 2
        return 3 if len(words) == 4 else 4  # a VDMOS has no bulk
    return NODE_COUNTS[kind]


def _read_behavioural_source(s: Statement) -> Element:
    """Read the card of a B source, whose expression extends to the end of the card."""
    name, *rest = s.written.split(None, 3)
    quantity, _, law = rest[2].partition("=") if len(rest) > 2 else ("", "", "")
    if quantity.strip().upper() not in ("V", "I") or not law.strip():
        hint = f"write  {name} NODE1 NODE2 V=EXPRESSION"
        expected = "I=… or V=expression"
        raise s.make_error("behavioural source without a law", expected=expected, hint=hint)
    origin = _describe_card_origin(s) | {
        "quantity": quantity.strip().upper(),
        "expression": _remove_braces(law),
    }
    return Element("b", name, tuple(rest[:2]), **origin)


def _read_controlled_source(part: Element) -> Element:
    """Rewrite an E or G source as a behavioural source with one expression.

    A source with a Laplace transform is returned unchanged, because a Laplace transform is not an
    expression in the time domain.
    """
    text = " ".join(part.values)
    keyword = text.lower().partition("=")[0].split()[0].partition("(")[0]
    rest = text[len(keyword) :].lstrip(" =")
    law = {"poly": _read_polynomial, "table": _read_table}.get(keyword, lambda text, _: text)
    if keyword == "laplace" or not (result := law(rest, part.where)):
        return part
    quantity = "V" if part.kind == "e" else "I"
    return replace(part, values=(), quantity=quantity, expression=_remove_braces(result))


def _remove_braces(law: str) -> str:
    """Return an expression without enclosing braces."""
    law = law.strip()
    inner = law[1:-1]
    depths = accumulate((ch == "{") - (ch == "}") for ch in inner)
    enclosed = law[:1] == "{" and law[-1:] == "}" and min(depths, default=0) >= 0
    return inner.strip() if enclosed else law


def _read_polynomial(text: str, where: str) -> str:
    """Return the polynomial source ``(n) a+ a- b+ b- … p0 p1 …`` as an expression.

    The coefficients ``p0 p1 …`` are sorted by the degree of their terms; terms of the same degree
    are sorted by the order of their voltages.
    """
    dimension, *tokens = split_operands(text) or [""]
    if not dimension.isdigit() or len(tokens) <= 2 * int(dimension):
        raise UsageError(
            "the polynomial is not complete",
            where=where,
            got=text[:80],
            expected="the number of voltages, two nodes for each of them, and coefficients",
            hint="write for example  POLY(1) NODE1 NODE2 0 1",
        )
    ends, factors = tokens[: 2 * int(dimension)], tokens[2 * int(dimension) :]
    axes = [f"V({a},{b})" for a, b in zip(ends[::2], ends[1::2], strict=True)]
    if len(factors) == 1 and len(axes) == 1:
        # POLY(1) with a single coefficient: this coefficient belongs to the linear term.
        factors = ["0", *factors]
    factors = [factor.strip("'") for factor in factors]
    terms = chain.from_iterable(map(partial(combinations_with_replacement, axes), count()))
    return "+".join("*".join((f"({p})", *term)) for p, term in zip(factors, terms, strict=False))


def split_operands(text: str) -> list[str]:
    """Split a text at blanks, commas and parentheses outside of braces and quotes."""
    return _OPERAND.findall(text)


def _read_table(text: str, where: str) -> str:
    """Return the table ``{expression} = (x, y) …`` as a piecewise linear function."""
    control, _, rest = text.lstrip("{").partition("}")
    points = rest.translate(str.maketrans("(),=", "    ")).split()
    ends = [parse_literal(points[k], where=where) for k in (0, -2)] if len(points) > 1 else [None]
    if None in ends or len(points) % 2:
        return ""
    first, last = float(ends[0] or 0.0), float(ends[1] or 0.0)
    flat = [repr(first - 1), points[1], *points, repr(last + 1), points[-1]]
    return f"pwl({control}, {', '.join(flat)})"
