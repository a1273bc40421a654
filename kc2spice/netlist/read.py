"""The one reader: text of users, of templates and of libraries becomes a tree here."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, combinations_with_replacement, count, takewhile
from typing import Any

from kc2spice.core.errors import UsageError
from kc2spice.core.untrusted_files import lines_of
from kc2spice.netlist.circuit import (
    CONTROLS,
    MODELLED,
    NODES,
    Card,
    Circuit,
    Directive,
    Element,
    Function,
    Item,
    Model,
    Parameters,
)
from kc2spice.netlist.expression import literal

_LAWS = ("value", "vol", "cur", "table", "poly", "laplace")

OPTION_CARDS = frozenset((".options", ".option", ".opt"))
_OPEN, _CLOSE = "({[", ")}]"
_INLINE = re.compile(r";|(?<=\s)\$(?=\s)|//")  # start of a comment behind a card


# --- logical lines ---


@dataclass(frozen=True, kw_only=True)
class Statement(Card):
    """One logical line, ``written`` with its continuation lines joined and without comments;
    ``line`` counts from 1 and is that of its first physical line."""

    line: int

    @property
    def keyword(self) -> str:
        """First word in lower case, ``""`` for trailing comments."""
        return self.written.split(None, 1)[0].lower() if self.written else ""

    @cached_property
    def words(self) -> list[str]:
        """Words; brackets and quotes hold together, ``a = b`` is one word ``a=b``."""
        return words(self.written)


def statements(text: str, file: str, *, title: bool = False) -> list[Statement]:
    """All statements of a file, in order; the last one may have comments only.

    ``title``: the first line is the deck's title, whatever it says, and counts as a comment.
    """
    result: list[tuple[int, list[str], list[str]]] = []  # first line, comments above, pieces
    pending: list[str] = []  # comment lines behind the newest statement
    lines = lines_of(text)
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


def words(text: str) -> list[str]:
    """Split on blanks outside brackets and quotes; blanks around a bare ``=`` are dropped."""
    # Only the first of several blanks can begin a match: a run of them is read once.
    return list(_split(re.sub(r"(?<!\s)\s*(?<![=<>!])=(?!=)\s*", "=", text)))


def split_comment(line: str) -> tuple[str, str]:
    """A line without its comment, and the text of that."""
    match = _INLINE.search(line)
    if match is None:
        return line.strip(), ""
    return line[: match.start()].strip(), line[match.end() :].strip()


def _split(text: str) -> Iterator[str]:
    depth, quote, word = 0, "", ""
    for ch in text:
        if quote:
            quote = "" if ch == quote else quote
        elif ch in "\"'":
            quote = ch
        elif ch in _OPEN:
            depth += 1
        elif ch in _CLOSE:
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


def read(text: str, file: str, *, title: bool = False) -> Circuit:
    """Parse the cards of ``file`` up to ``.end``, in order.

    Raises
    ------
    UsageError : a broken card, a subcircuit that does not begin or end.
    """
    return tree_of(statements(text, file, title=title))


def tree_of(cards: Iterable[Statement]) -> Circuit:
    """Return the tree of cards up to ``.end``, in order.

    Raises
    ------
    UsageError : a broken card, a subcircuit that does not begin or end.
    """
    items, notes = _items(iter(cards), None)
    return Circuit(items=items, closing=notes)


def _items(
    cards: Iterator[Statement], head: Statement | None
) -> tuple[tuple[Item, ...], tuple[str, ...]]:
    """Items up to the ``.ends`` of ``head``, or up to the end of the file, and comments there."""
    result: list[Item] = []
    for s in cards:
        if s.keyword == ".ends" and head is None:
            raise s.error(".ends without .subckt")
        if s.keyword == ".ends" or not s.keyword:
            if s.keyword or head is None:
                return tuple(result), s.notes
            break
        if s.keyword == ".control":
            block = tuple(c.written for c in takewhile(lambda c: c.keyword != ".endc", cards))
            result.append(Directive(".control", block, **_origin(s)))
        else:
            result.append(_subckt(s, cards) if s.keyword == ".subckt" else _item(s))
        if s.keyword == ".end":
            break
    if head is not None:
        raise head.error("subcircuit is not closed", expected=f".ends {head.words[1]}")
    return tuple(result), ()


def _subckt(s: Statement, cards: Iterator[Statement]) -> Circuit:
    rest = [word for word in s.words[1:] if word.lower() != "params:"]
    if not rest:
        raise s.error("subcircuit has no name")
    pins, assigned = _split_assigned(rest[1:])
    low = list(map(str.lower, pins))
    if len(set(low)) < len(low):
        raise s.error("a pin name stands twice", " ".join(low))
    defaults = _assignments(assigned, s)
    items, closing = _items(cards, s)
    return Circuit(rest[0], tuple(pins), defaults, items, closing, **_origin(s))


def _split_assigned(card: Iterable[str]) -> tuple[list[str], list[str]]:
    """Split the words of a card into names and assignments ``name=value``."""
    names: list[str] = []
    assignments: list[str] = []
    for word in card:
        (assignments if "=" in word else names).append(word)
    return names, assignments


def _item(s: Statement) -> Item:
    origin = _origin(s)
    if not s.keyword.startswith("."):
        return parse_element(s)
    if s.keyword in (".func", ".param", ".params") and (defined := _function(s)):
        return defined
    if s.keyword in (".param", ".csparam"):
        return Parameters(_assignments(s.words[1:], s), s.keyword, **origin)
    if s.keyword == ".model":
        if len(s.words) < 3:
            raise s.error("model card is not complete")
        kind, _, inside = " ".join(s.words[2:]).partition("(")
        kind, *more = kind.split() + words(inside.rstrip().removesuffix(")"))
        pairs = dict((w + "=").split("=", 1) for w in more)
        parameters = {key: value.removesuffix("=") for key, value in pairs.items()}
        return Model(s.words[1], kind, parameters, **origin)
    return Directive(s.keyword, tuple(s.words[1:]), **origin)


def _origin(s: Statement) -> dict[str, Any]:
    """File and line of a card, its text, and the comments above it."""
    return {"notes": s.notes, "where": s.where, "written": s.written}


def _function(s: Statement) -> Function | None:
    """``.func f(x) {law}`` and ``.param f(x) = {law}``."""
    name, opening, rest = s.written[len(s.keyword) :].strip().partition("(")
    inside, closing, law = rest.partition(")")
    if not (opening and closing and law.strip() and name.strip().isidentifier()):
        return None
    arguments = tuple(word.strip() for word in inside.split(",") if word.strip())
    law = law.strip().removeprefix("=").strip()
    return Function(name.strip(), arguments, law, **_origin(s))


def _assignments(items: Sequence[str], s: Statement) -> dict[str, str]:
    pairs = {}
    for word in (item.strip(",") for item in items):
        if not _assigned(word):
            raise s.error("not a parameter", word, "name=value")
        name, _, value = word.partition("=")
        pairs[name] = value
    return pairs


def _assigned(word: str) -> bool:
    name, equals, _ = word.partition("=")
    return bool(equals) and name.isidentifier()


def parse_element(s: Statement) -> Element:
    """Split one element card; of a letter that we do not know, all words are values."""
    kind, origin = s.written[0].lower(), _origin(s)
    if kind == "b":
        return _behaviour(s)
    name, *rest = (word for word in s.words if word.lower() != "params:")
    if kind == "x":
        plain, assigned = _split_assigned(rest)
        if not plain:
            raise s.error("instance names no subcircuit")
        assignments = _assignments(assigned, s)
        return Element(kind, name, tuple(plain[:-1]), (), plain[-1], (), assignments, **origin)
    if kind not in NODES:
        return Element(kind, name, (), values=tuple(rest), **origin)
    count = _count(kind, rest)
    end = count + CONTROLS.get(kind, 0)
    if kind in "fh" and len(rest) > 2 and rest[2].lower().startswith("poly("):
        end = count
    needed = end + (kind in MODELLED or kind not in "vi")
    if len(rest) < needed or any("=" in w or "(" in w for w in rest[:count]):
        more = ", then a value or model" if kind not in "vi" else ""
        raise s.error("element is not complete", expected=f"{count} nodes{more}")
    nodes, sources, rest = tuple(rest[:count]), tuple(rest[count:end]), rest[end:]
    if kind in "eg" and count == 2:
        return _controlled(Element(kind, name, nodes, values=tuple(rest), **origin))
    model = rest.pop(0) if kind in MODELLED else ""
    values = tuple(w for w in rest if not _assigned(w))
    assignments = dict(w.split("=", 1) for w in rest if _assigned(w))
    return Element(kind, name, nodes, sources, model, values, assignments, **origin)


def _count(kind: str, rest: Sequence[str]) -> int:
    if kind in "eg" and len(rest) > 2 and rest[2].lower().startswith(_LAWS):
        word = rest[2].lower().partition("=")[0].partition("(")[0]
        return 2 if word in _LAWS else 4
    if kind == "q" and len(rest) > 4 and "=" not in rest[4] and rest[4][0] not in "0123456789.+-":
        return 4
    if kind == "m" and len([*takewhile(lambda w: "=" not in w, rest)]) == 4:
        return 3  # a VDMOS has no bulk
    return NODES[kind]


def _behaviour(s: Statement) -> Element:
    """A B source; its expression runs to the end of the card."""
    name, *rest = s.written.split(None, 3)
    quantity, _, law = rest[2].partition("=") if len(rest) > 2 else ("", "", "")
    if quantity.strip().upper() not in ("V", "I") or not law.strip():
        raise s.error("behavioural source without a law", expected="I=… or V=expression")
    origin = _origin(s) | {"quantity": quantity.strip().upper(), "expression": _bare(law)}
    return Element("b", name, tuple(rest[:2]), **origin)


def _controlled(part: Element) -> Element:
    """An E or G source with an expression as one, whichever of its spellings it has.

    A Laplace transform stays as it is: it is none of time.
    """
    text = " ".join(part.values)
    keyword = text.lower().partition("=")[0].split()[0].partition("(")[0]
    rest = text[len(keyword) :].lstrip(" =")
    law = {"poly": _polynomial, "table": _table}.get(keyword, lambda text, _: text)
    if keyword == "laplace" or not (result := law(rest, part.where)):
        return part
    quantity = "V" if part.kind == "e" else "I"
    return replace(part, values=(), quantity=quantity, expression=_bare(result))


def _bare(law: str) -> str:
    """An expression without the braces around all of it."""
    law = law.strip()
    inner = law[1:-1]
    depths = accumulate((ch == "{") - (ch == "}") for ch in inner)
    enclosed = law[:1] == "{" and law[-1:] == "}" and min(depths, default=0) >= 0
    return inner.strip() if enclosed else law


def _polynomial(text: str, where: str) -> str:
    """``(n) a+ a- b+ b- … p0 p1 …``: coefficients by degree, products in the order of their
    factors."""
    dimension, _, rest = text.removeprefix("(").partition(")")
    tokens = rest.replace("(", " ").replace(")", " ").replace(",", " ").split()
    if not dimension.strip().isdigit() or len(tokens) <= 2 * int(dimension):
        raise UsageError("polynomial is not complete", where=where, got=text[:80])
    ends, factors = tokens[: 2 * int(dimension)], tokens[2 * int(dimension) :]
    axes = [f"V({a},{b})" for a, b in zip(ends[::2], ends[1::2], strict=True)]
    if len(factors) == 1 and len(axes) == 1:
        factors = ["0", *factors]  # a lone coefficient is the linear one
    terms = (p for degree in count() for p in combinations_with_replacement(axes, degree))
    return "+".join("*".join((f"({p})", *term)) for p, term in zip(factors, terms, strict=False))


def _table(text: str, where: str) -> str:
    """``{expression} = (x, y) …``, flat beyond its ends."""
    control, _, rest = text.lstrip("{").partition("}")
    points = rest.translate(str.maketrans("(),=", "    ")).split()
    ends = [literal(points[k], where=where) for k in (0, -2)] if len(points) > 1 else [None]
    if None in ends or len(points) % 2:
        return ""
    first, last = float(ends[0] or 0.0), float(ends[1] or 0.0)
    flat = [repr(first - 1), points[1], *points, repr(last + 1), points[-1]]
    return f"pwl({control}, {', '.join(flat)})"
