"""Reads a deck before the simulator does and names what is wired wrongly."""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass

from kc2spice.core.errors import UsageError
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.elements import Element, Scope, behaviour, circuit
from kc2spice.netlist.expression import Binary, Call, Name, Number, Probe, parse, walk
from kc2spice.netlist.statements import Statement

GROUND = frozenset({"0", "gnd", "!gnd"})
BUILT_IN = frozenset({"time", "temper", "temp", "hertz", "pi", "e", "boltz", "gmin", "vt"})
# Functions of ngspice's behavioural sources; ``limit`` is among its statistics and returns 0.
FUNCTIONS = frozenset(
    ("abs", "acos", "acosh", "asin", "asinh", "atan", "atanh", "ceil", "cos", "cosh", "exp",
     "floor", "ln", "log", "log10", "max", "min", "nint", "pow", "pwl", "pwr", "sgn", "sin",
     "sinh", "sqrt", "tan", "tanh", "u", "u2", "uramp", "buf", "inv")
)  # fmt: skip
_ODD = tuple(Number(text) for text in ("1", "3", "5", "7", "9"))
_DEFINED = re.compile(r"(?i)\.(?:func|param|params|csparam)\s+(\w+)\s*(?=\()")
_VECTOR = re.compile(r"(?i)\b[vi]\w*\(([^()]*)\)")
# What LTspice adds to elements, and the element that says the same everywhere.
_PARASITIC = {"rser": "R in series", "lser": "L in series", "rpar": "R across it",
              "rlshunt": "R across it", "cpar": "C across it"}  # fmt: skip
_PIN = re.compile(r"\* @pin (\d+) (\w+) unit=(\S+) flow=(\S+)")


@dataclass(frozen=True)
class Problem:
    """One mistake: where it stands, what is wrong, what stands there, what would be right."""

    where: str
    message: str
    got: str
    expected: str | None = None
    hint: str | None = None


def lint(deck: Deck) -> None:
    """Raise the first mistake of ``deck`` as an error that counts the others.

    Raises
    ------
    UsageError : wrong wiring; the message names file, line, what is wrong and what was expected.
    """
    found = problems(deck)
    if not found:
        return
    first = found[0]
    more = f"{len(found) - 1} more after this one" if len(found) > 1 else None
    raise UsageError(
        first.message,
        where=first.where,
        got=first.got,
        expected=first.expected,
        hint="; ".join(filter(None, (first.hint, more))) or None,
    )


def problems(deck: Deck) -> list[Problem]:
    """All mistakes of ``deck``.

    Unknown subcircuits, models, parameters, nodes and controlling sources; instances with too many
    or too few pins; two parts with one name in one scope; nodes that one part alone touches.

    Raises
    ------
    UsageError : the text cannot be read at all (missing include, broken card, unclosed subcircuit).
    """
    if deck.main not in deck.files:
        raise UsageError("the deck has no main file", where=deck.name, got=deck.main)
    top = circuit(deck.main, deck.files)
    signals = _signal_pins(deck)
    return [p for scope in _scopes(top) for p in _scope_problems(scope, signals)]


def _scopes(scope: Scope) -> Iterator[Scope]:
    yield scope
    for child in scope.subcircuits.values():
        yield from _scopes(child)


def _outwards(scope: Scope) -> Iterator[Scope]:
    yield scope
    if scope.parent is not None:
        yield from _outwards(scope.parent)


def _signal_pins(deck: Deck) -> frozenset[tuple[str, str]]:
    """``(subcircuit, pin)`` of all pins that a library header declares as signals."""
    found = set()
    for text in deck.files.values():
        table: list[str] = []
        for line in text.splitlines():
            if match := _PIN.match(line):
                table += [match[2].lower()] if match[4] == "-" else []
            elif line.lower().startswith(".subckt"):
                found |= {(line.split()[1].lower(), pin) for pin in table}
                table = []
    return frozenset(found)


def _scope_problems(scope: Scope, signals: frozenset[tuple[str, str]]) -> Iterator[Problem]:
    yield from _duplicates(scope)
    yield from _defined_twice(scope)
    for card in scope.commands:
        if card.keyword in (".param", ".csparam"):
            for word in card.words[1:]:
                yield from _unknown_names(card, word.partition("=")[2], scope)
    for part in scope.elements:
        yield from _instance(part, scope) if part.kind == "x" else _references(part, scope)
        for text in _expressions(part):
            yield from _unknown_names(part.statement, text, scope)
            if part.kind == "b":
                yield from _unknown_functions(part.statement, text, scope)
    yield from _dangling(scope, signals)


def _duplicates(scope: Scope) -> Iterator[Problem]:
    seen: dict[str, Element] = {}
    for part in scope.elements:
        if part.name in seen:
            yield Problem(
                part.statement.where,
                "two parts have one name",
                part.statement.words[0],
                f"another name; the first {part.name} is in {seen[part.name].statement.where}",
            )
        seen.setdefault(part.name, part)


def _defined_twice(scope: Scope) -> Iterator[Problem]:
    """Parameters and functions of a whole deck that two of its files define differently."""
    seen: dict[str, tuple[str, Statement]] = {}
    for card in scope.commands if scope.parent is None else ():
        if match := _DEFINED.match(card.text):
            defined = {f"function {match[1].lower()}": card.text[match.end() :]}
        elif card.keyword in (".param", ".params"):
            pairs = (word.partition("=") for word in card.words[1:])
            defined = {f"parameter {name.lower()}": value for name, _, value in pairs}
        else:
            continue
        for what, value in defined.items():
            first, place = seen.setdefault(what, (value, card))
            if place.file != card.file and first != value:
                yield Problem(
                    card.where, f"two files define the {what}", card.text,
                    f"one definition; the first is in {place.where}",
                    "rename one, or put it into its .subckt",
                )  # fmt: skip


def _instance(part: Element, scope: Scope) -> Iterator[Problem]:
    name = part.model or ""
    called = scope.find(name)
    if called is None:
        known = [name for outer in _outwards(scope) for name in outer.subcircuits]
        yield Problem(part.statement.where, "no such subcircuit", name, _nearest(name, known))
        return
    if len(part.nodes) != len(called.pins):
        short = len(part.nodes) < len(called.pins)
        which = called.pins[len(part.nodes) :] if short else part.nodes[len(called.pins) :]
        yield Problem(
            part.statement.where,
            f"{'missing' if short else 'too many'} pins of {called.name}: {' '.join(which)}",
            f"{len(part.nodes)} nodes: {' '.join(part.nodes)}",
            f"{len(called.pins)} pins: {' '.join(called.pins)}",
        )
    for param in part.params:
        if param not in called.defaults:
            yield Problem(
                part.statement.where,
                f"{called.name} has no such parameter",
                param,
                _nearest(param, called.defaults),
            )


def _references(part: Element, scope: Scope) -> Iterator[Problem]:
    """Models and controlling sources of a primitive part."""
    if part.model is not None and not scope.knows_model(part.model):
        yield Problem(
            part.statement.where, "no such model", part.model, _nearest(part.model, scope.models)
        )
    for param in part.params if part.kind in "rlcvi" else ():
        if param in _PARASITIC:
            yield Problem(
                part.statement.where, "ngspice has no such parameter of an element, LTspice has",
                f"{param}={part.params[param]} of {part.statement.words[0]}",
                f"{_PARASITIC[param]}, as an element of its own",
                f"write the {_PARASITIC[param]} as a card of its own and leave {param} out",
            )  # fmt: skip
    kind = "l" if part.kind == "k" else "v"
    present = [e.name for e in scope.elements if e.kind == kind]
    for source in part.sources:
        if source not in present:
            yield Problem(
                part.statement.where, "no such controlling part", source, _nearest(source, present)
            )


def _unknown_names(card: Statement, text: str, scope: Scope) -> Iterator[Problem]:
    """Parameters and nodes that an expression of ``card`` uses but nothing defines."""
    try:
        tree = parse(text, where=card.where)
    except UsageError as error:
        yield Problem(card.where, error.message, str(error.got))
        return
    nodes = {n for part in scope.elements for n in part.nodes} | set(scope.pins) | GROUND
    sources = {e.name for e in scope.elements if e.kind in "vlehb"}
    for leaf in walk(tree):
        if isinstance(leaf, Name) and leaf.text.lower() not in BUILT_IN:
            if not scope.knows_param(leaf.text):
                known = [name for outer in _outwards(scope) for name in outer.params]
                yield Problem(
                    card.where, "no such parameter", leaf.text, _nearest(leaf.text, known)
                )
        elif isinstance(leaf, Probe):
            what, present = ("node", nodes) if leaf.kind == "v" else ("source", sources)
            for name in map(str.lower, leaf.names):
                if name not in present:
                    yield Problem(card.where, f"no such {what}", name, _nearest(name, present))


def _unknown_functions(card: Statement, text: str, scope: Scope) -> Iterator[Problem]:
    """Functions of a behavioural source that ngspice does not have, or has differently."""
    own = {
        match[1].lower()
        for outer in _outwards(scope)
        for command in outer.commands
        if (match := re.match(r"(?i)\.func\s+(\w+)", command.text))
    }
    try:
        leaves = walk(parse(text, where=card.where))
    except UsageError:
        return  # reported among the names
    for leaf in leaves:
        if isinstance(leaf, Call) and leaf.function not in FUNCTIONS | own:
            near = _nearest(leaf.function, FUNCTIONS | own)
            yield Problem(card.where, "ngspice has no such function", leaf.function, near)
        odd = isinstance(leaf, Binary) and leaf.op == "^" and leaf.right in _ODD
        if odd:
            message = "ngspice takes odd powers of the absolute value"
            yield Problem(card.where, message, card.text, "a product")


def _expressions(part: Element) -> Iterator[str]:
    """Every expression of a card: braces and quotes, or all behind ``V=`` of a B source."""
    if part.kind == "b":
        yield behaviour(part)[1]
        return
    for value in (*part.values, *part.params.values()):
        yield from re.findall(r"\{[^{}]*\}", value)
        if value.startswith("'"):
            yield value


def _dangling(scope: Scope, signals: frozenset[tuple[str, str]]) -> Iterator[Problem]:
    """Nodes with one connection, unless it is a signal output, saved, probed, or named ``nc…``."""
    uses = Counter(n for part in scope.elements for n in part.nodes)
    uses.update(scope.pins)
    watched = {
        name.strip().lower()
        for command in scope.commands
        for inside in _VECTOR.findall(command.text)
        for name in inside.split(",")
    }
    for part in scope.elements:
        watched |= _probed(part)
    for part in scope.elements:
        for position, node in enumerate(part.nodes):
            if uses[node] > 1 or node in GROUND or node in watched or node.startswith("nc"):
                continue
            pin = _pin(part, position, scope)
            if (str(part.model).lower(), pin) in signals:
                continue
            yield Problem(
                part.statement.where,
                f"floating port: nothing else is wired to node {node}",
                f"pin {pin} of {part.statement.words[0]}",
                _nearest(node, [n for n in uses if n != node]),
                f"wire it; if it is meant to be free, save v({node}) or call the node nc_{node}",
            )


def _probed(part: Element) -> set[str]:
    if part.kind != "b":
        return set()
    try:
        leaves = walk(parse(behaviour(part)[1]))
    except UsageError:
        return set()  # reported where the expression is checked
    return {
        n for leaf in leaves if isinstance(leaf, Probe) and leaf.kind == "v" for n in leaf.names
    }


def _pin(part: Element, position: int, scope: Scope) -> str:
    called = scope.find(part.model or "") if part.kind == "x" else None
    if called is not None and position < len(called.pins):
        return called.pins[position]
    return str(position + 1)


def _nearest(name: str, known: Collection[str]) -> str | None:
    """A suggestion: the most similar name, or all of a short list."""
    near = difflib.get_close_matches(name.lower(), list(known), 1)
    if near:
        return f"{near[0]}, perhaps"
    return ", ".join(sorted(known)) if 0 < len(known) <= 12 else None
