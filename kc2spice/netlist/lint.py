"""Check of the connections and names in a deck before a simulation."""

from __future__ import annotations

import difflib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from itertools import chain
from operator import attrgetter
from typing import NamedTuple

from kc2spice.core.disjoint_groups import DisjointGroups
from kc2spice.core.errors import UsageError, join_first, list_candidates
from kc2spice.netlist.circuit import Card, Circuit, Directive, Element, Parameters
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.expression import (
    BUILT_IN_NAMES,
    FUNCTIONS,
    BinaryOperation,
    CircuitVariable,
    FunctionCall,
    Name,
    Number,
    parse_expression,
    walk_tree,
)
from kc2spice.netlist.importer import PSPICE_SWITCHES
from kc2spice.netlist.name_scopes import GROUND_NAMES, Scope, build_scope, find_instance
from kc2spice.netlist.number_and_name_spelling import split_infix_unit
from kc2spice.netlist.subcircuit_library import parse_declared_pins

_ODD_NUMBERS = tuple(map(Number, ("1", "3", "5", "7", "9")))
# Example models of switches, which do not depend on a manufacturer.
_SWITCH_MODELS = {
    "s": "SW(vt=1 vh=0 ron=1 roff=1meg)",
    "w": "CSW(it=1m ih=0 ron=1 roff=1meg)",
}
# LTspice settings for parasitics of an element, and the separate elements that replace them.
_PARASITIC_ELEMENTS = {"rser": "R in series", "lser": "L in series", "rpar": "R across it",
              "rlshunt": "R across it", "cpar": "C across it"}  # fmt: skip


def require_valid_wiring(deck: Deck) -> None:
    """Raise an error for the first wiring mistake; state how many mistakes follow.

    Raises
    ------
    UsageError : the deck has a wiring mistake; the message contains file, line, mistake and
        expected text.
    """
    if result := find_wiring_mistakes(deck):
        first = result[0]
        more = f"{len(result) - 1} more after this one" if len(result) > 1 else None
        first.hint = "; ".join(filter(None, (first.hint, more))) or None
        raise first


def find_wiring_mistakes(deck: Deck) -> list[UsageError]:
    """Return all wiring mistakes of a deck.

    Wiring mistakes are unknown subcircuits, models, parameters, nodes or controlling sources, wrong
    numbers of pins, repeated names, nodes with only one connection, and loops of ideal voltage
    sources.

    Raises
    ------
    UsageError : the deck cannot be parsed, for example because of a missing include or an invalid
        card.
    """
    try:
        if not _find_problems(deck, deck.trees, deck.scope):
            return []
    except UsageError:
        pass  # ``build_scope`` below raises this error again, with the position of the card
    top = build_scope(
        deck.located_trees[deck.main_file_name], deck.located_trees, deck.main_file_name
    )
    return _find_problems(deck, deck.located_trees, top)


def _find_problems(deck: Deck, trees: Mapping[str, Circuit], top: Scope) -> list[UsageError]:
    """Return the wiring mistakes in parsed circuits."""
    signals = frozenset(_list_signal_pins(trees.values()))
    read = _list_saved_nodes(deck, top)
    read.setdefault(id(top), set()).update(deck.free_nets)
    problems: list[UsageError] = []
    for item in top.list_scopes():
        problems += _check_cards(item)
        problems += _check_connections(item, signals, read.get(id(item), set()))
    return problems + list(_check_source_loops(top))


def _list_saved_nodes(deck: Deck, top: Scope) -> dict[int, set[str]]:
    """Return the nodes with saved voltages inside subcircuits, keyed by scope.

    The keys are the ``id`` of each scope that contains saved nodes. A node with a saved voltage
    needs no second connection.
    """
    result: dict[int, set[str]] = {}
    for text in deck.saved_vectors:
        for name in text.lower().partition("(")[2].removesuffix(")").split(","):
            *path, node = name.strip().split(".")
            scope = find_instance(top, tuple(path)) if path else None
            if scope is not None:
                result.setdefault(id(scope), set()).add(node)
    return result


def _list_signal_pins(circuits: Iterable[Circuit]) -> Iterator[tuple[str, str]]:
    """Yield each signal pin as a pair of subcircuit name and pin name."""
    for item in circuits:
        for pin in parse_declared_pins(item):
            if pin.flow == "-":
                yield item.name.lower(), pin.key
        yield from _list_signal_pins(item.subcircuits)


def _check_cards(scope: Scope) -> Iterator[UsageError]:
    """Yield the mistakes on the cards of one subcircuit or of the top level."""
    for part in scope.elements:
        first = scope.elements_by_key[part.key]
        if first is not part:
            other = f"another name; the first {part.key} is in {first.where}"
            hint = f"rename this element, such as {part.name}_2"
            yield part.make_error("two elements have the same name", part.name, other, hint)
    kinds = {"v": scope.nodes | GROUND_NAMES, "i": scope.select_elements("vlehb").keys()}
    for card in (*scope.commands, *scope.elements):
        if isinstance(card, Element):
            check = _check_instance if card.kind == "x" else _check_references
            yield from check(card, scope)
        for text in _list_expressions(card):
            yield from _check_expression(card, text, scope, kinds)


def _check_instance(part: Element, scope: Scope) -> Iterator[UsageError]:
    """Yield the mistakes on the card of a subcircuit instance."""
    called = scope.find_subcircuit(part.model)
    if called is None:
        message, hint = "no such subcircuit", f"add a .subckt {part.model} to this file"
        yield _make_unknown_name_error(part, message, part.model, scope.subcircuits, hint)
        return
    if len(part.nodes) != len(called.pins):
        lacks_nodes = len(part.nodes) < len(called.pins)
        which = (
            called.pins[len(part.nodes) :]
            if lacks_nodes
            else part.lower_case_nodes[len(called.pins) :]
        )
        yield part.make_error(
            f"{'missing' if lacks_nodes else 'too many'} pins of {called.name}: {' '.join(which)}",
            f"{len(part.nodes)} nodes: {' '.join(part.lower_case_nodes)}",
            f"{len(called.pins)} pins: {' '.join(called.pins)}",
            f"add the nodes of {' '.join(which)}" if lacks_nodes else f"delete {' '.join(which)}",
        )
    for param in part.settings:
        if param not in called.defaults:
            message, hint = f"{called.name} has no such parameter", f"delete {param} from this line"
            yield _make_unknown_name_error(part, message, param, called.defaults, hint)


def _check_references(part: Element, scope: Scope) -> Iterator[UsageError]:
    """Yield the mistakes in models, parameters and controlling sources of a card."""
    model = scope.models.get((part.model or "").lower())
    if part.model and model is None:
        hint = f"copy the  .model {part.model}  line of the manufacturer into this file"
        hint += ", or include the file that contains this line"
        if switch := _SWITCH_MODELS.get(part.kind):
            hint = f"add the line  .model {part.model} {switch}"
        yield _make_unknown_name_error(part, "no such model", part.model, scope.models, hint)
    if model is not None and (replacement := PSPICE_SWITCHES.get(model.type.lower())):
        yield model.make_error(
            f"model type {model.type} exists in PSpice but not in ngspice",
            f"{model.type} of the model {model.name}",
            f'{replacement}, or a netlist part with syntax = "pspice"',
            'add  syntax = "pspice"  to the table of the netlist part',
        )
    for param in part.settings if part.kind in "rlcvi" else ():
        if instead := _PARASITIC_ELEMENTS.get(param):
            yield part.make_error(
                f"the element parameter {param} exists in LTspice but not in ngspice",
                f"{param}={part.settings[param]} of {part.name}",
                f"{instead} as a separate element",
                f"write the {instead} as a separate element and delete {param}, or set "
                'syntax = "ltspice" in the netlist part',
            )
    for value in part.values:
        # ngspice ignores the digits behind the letter, such as 7 in 4k7
        if number := split_infix_unit(value):
            integer, unit, decimals = number
            message = f"ngspice reads {value} as {integer}{unit}"
            plain = f"{integer}.{decimals}{unit}"
            yield part.make_error(message, f"{value} of {part.name}", plain, f"write {plain}")
    kind = "l" if part.kind == "k" else "v"
    for source in map(str.lower, part.sources):
        item = scope.elements_by_key.get(source)
        if item is None or item.kind != kind:
            what = "inductor" if kind == "l" else "voltage source"
            message, hint = f"no such {what}", f"add the {what} {source} to this netlist"
            known = scope.select_elements(kind)
            yield _make_unknown_name_error(part, message, source, known, hint)


def _list_expressions(card: Card) -> Iterator[str]:
    """Yield all expressions on a card; the law of a behavioural source comes last."""
    if isinstance(card, Parameters):
        yield from card.values.values()
    elif isinstance(card, Element):
        for value in (*card.values, *card.parameters.values()):
            for piece in value.split("{")[1:]:
                yield f"{{{piece.partition('}')[0]}}}"
            if value.startswith("'"):
                yield value
        if card.quantity:
            yield card.expression


def _check_expression(
    card: Card, text: str, scope: Scope, kinds: Mapping[str, Collection[str]]
) -> Iterator[UsageError]:
    """Yield the mistakes in an expression: unknown names, nodes and sources.

    ``kinds`` contains the known nodes (``v``) and sources (``i``). In a behavioural source, a
    function that ngspice lacks is also a mistake. A power with an odd exponent is a mistake too,
    because ngspice replaces the base by its absolute value.
    """
    law = isinstance(card, Element) and text is card.expression
    try:
        tree = (
            card.law
            if isinstance(card, Element) and law
            else parse_expression(text, where=card.where)
        )
    except UsageError as error:
        yield error
        return
    functions = FUNCTIONS.union(scope.functions)
    for leaf in walk_tree(tree):
        match leaf:
            case Name(name) if name.lower() not in BUILT_IN_NAMES.union(scope.params):
                message, hint = "no such parameter", f"add the line  .param {name}=VALUE"
                yield _make_unknown_name_error(card, message, name, scope.params, hint)
            case CircuitVariable(kind, names):
                for name in map(str.lower, names):
                    if name not in kinds[kind]:
                        what = "node" if kind == "v" else "source"
                        hint = f"connect an element to {name}"
                        hint = hint if kind == "v" else f"add the voltage source {name}"
                        yield _make_unknown_name_error(
                            card, f"no such {what}", name, kinds[kind], hint
                        )
            case FunctionCall(name) if law and name not in functions:
                message, hint = "ngspice has no such function", f"add a .func {name}(x) {{…}}"
                yield _make_unknown_name_error(card, message, name, functions, hint)
            case BinaryOperation("^", _, power) if law and power in _ODD_NUMBERS:
                message = "ngspice computes odd powers from the absolute value of the base"
                yield card.make_error(message, card.written, "a product", "write x*x*x for x^3")


def _check_connections(
    scope: Scope, signals: frozenset[tuple[str, str]], read: Collection[str]
) -> Iterator[UsageError]:
    """Yield an error for each node with only one connection.

    One connection is sufficient for signal outputs, for nodes in a command or an expression, for
    the nodes in ``read``, and for nodes named ``nc…``.
    """
    uses = Counter(chain(scope.pins, *map(attrgetter("lower_case_nodes"), scope.elements)))
    watched = set(read)
    for card in scope.commands:
        for text in _card_text(card).split("(")[1:]:
            names = text.partition(")")[0].lower().split(",")
            watched.update(map(str.strip, names))
    watched.update(*map(attrgetter("sensed_nodes"), scope.elements))
    for part in scope.elements:
        called = scope.find_subcircuit(part.model) if part.kind == "x" else None
        pins = dict(enumerate(called.pins if called else ()))
        for position, node in enumerate(part.lower_case_nodes):
            if uses[node] > 1 or node in GROUND_NAMES or node in watched or node.startswith("nc"):
                continue
            pin = pins.get(position, str(position + 1))
            if (part.model.lower(), pin) not in signals:
                near = difflib.get_close_matches(node, uses.keys() - {node}, 1)
                yield part.make_error(
                    f"floating port: nothing else is wired to node {node}",
                    f"pin {pin} of {part.name}",
                    near[0] if near else None,
                    f"did you mean {near[0]!r}?"
                    if near
                    else f"connect another element to {node}, or rename {node} to nc_{node} if the "
                    "node is intentionally unconnected",
                )


class _SourceBranch(NamedTuple):
    """Series connection of ideal voltage sources between two nets, in order from the first net."""

    first: str
    last: str
    sources: tuple[Element, ...]


def _check_source_loops(top: Scope) -> Iterator[UsageError]:
    """Yield an error for each voltage source that closes a loop of voltage sources.

    The currents in such a loop have no unique value, so the simulator fails. The loop consists of V
    elements and of E elements that are controlled by a voltage. Each subcircuit definition is
    checked once, even if many instances refer to it.
    """
    problems: list[UsageError] = []
    _find_branches_between_pins(top, {}, problems)
    yield from problems


def _find_branches_between_pins(
    scope: Scope, known: dict[int, list[_SourceBranch]], problems: list[UsageError]
) -> list[_SourceBranch]:
    """Find the ideal voltage sources that connect pins of a circuit, or a pin and ground.

    ``known`` maps the ``id()`` of the scope of each circuit that was already examined to the result
    for this circuit. The function adds an error to ``problems`` for each loop inside the circuit.
    """
    if id(scope) in known:
        return known[id(scope)]
    known[id(scope)] = []  # a subcircuit that contains itself is reported elsewhere
    branches = list(_list_source_branches(scope, known, problems))
    ends = chain.from_iterable((branch.first, branch.last) for branch in branches)
    terminals = dict.fromkeys((*scope.pins, "0"))
    groups = DisjointGroups((*terminals, *ends))
    branches_at: dict[str, list[_SourceBranch]] = {}  # accepted branches, by net
    for branch in branches:
        first, last, sources = branch
        if groups.are_joined(first, last):
            *others, source = *_find_source_path(branches_at, first, last), *reversed(sources)
            problems.append(_make_loop_error(source, others))
            continue
        groups.join(first, last)
        branches_at.setdefault(first, []).append(branch)
        branches_at.setdefault(last, []).append(_SourceBranch(last, first, sources[::-1]))
    for group in groups.list_groups():
        joined = [*filter(terminals.__contains__, group)]
        for pin in joined[1:]:
            path = _find_source_path(branches_at, joined[0], pin)
            # each source is listed once, although it can belong to several instances
            distinct = tuple({id(item): item for item in path}.values())
            known[id(scope)].append(_SourceBranch(joined[0], pin, distinct))
    return known[id(scope)]


def _list_source_branches(
    scope: Scope, known: dict[int, list[_SourceBranch]], problems: list[UsageError]
) -> Iterator[_SourceBranch]:
    """Yield each ideal voltage source of a circuit, and the branches inside of its instances.

    The arguments are the same as for :func:`_find_branches_between_pins`.
    """
    for element in scope.elements:
        nodes = element.lower_case_nodes
        ends = ["0" if node in GROUND_NAMES else node for node in nodes]
        words = {*map(str.lower, element.values), *element.settings}
        # An E element with an expression is not ideal, because it may depend on currents.
        # A V element with the word ``portnum`` is not ideal, because it contains a resistance.
        if element.kind in "ve" and not element.quantity and "portnum" not in words:
            yield _SourceBranch(ends[0], ends[1], (element,))
        called = scope.find_subcircuit(element.model) if element.kind == "x" else None
        if called is not None:
            nets = {"0": "0"} | dict(zip(called.pins, ends, strict=False))
            for first, last, sources in _find_branches_between_pins(called, known, problems):
                if first in nets and last in nets:
                    yield _SourceBranch(nets[first], nets[last], sources)


def _find_source_path(
    branches_at: Mapping[str, Collection[_SourceBranch]], first: str, last: str
) -> list[Element]:
    """Return the sources that join two nets; empty if both nets are the same."""
    paths: dict[str, list[Element]] = {first: []}
    for net in (waiting := [first]):
        for _, other, sources in branches_at.get(net, ()):
            if other not in paths:
                paths[other] = [*paths[net], *sources]
                waiting.append(other)
    return paths[last]


def _make_loop_error(source: Element, others: Collection[Element]) -> UsageError:
    """Make the error for a source that closes a loop with other sources."""
    if not others:
        return source.make_error(
            "both nodes of this voltage source are the same node",
            expected="two different nodes",
            hint=f"delete {source.name}, or connect one of its nodes to another node",
        )
    names = [f"{item.name} ({item.where})" for item in (*others, source)]
    return source.make_error(
        "this voltage source closes a loop of ideal voltage sources",
        f"a loop of {join_first(names)}",
        "one ideal voltage source between two nodes",
        f"delete {source.name}, or connect a resistor in series with {source.name}",
    )


def _card_text(card: Card) -> str:
    """Return the text of a card."""
    return card.text if isinstance(card, Directive) else card.written


def _make_unknown_name_error(
    card: Card, message: str, name: str, known: Collection[str], otherwise: str
) -> UsageError:
    """Make the error about a name that the netlist does not define.

    ``otherwise`` is the advice if no known name is similar to ``name``.
    """
    expected = f"one of {list_candidates(name, sorted(known))}" if known else None
    similar = difflib.get_close_matches(name.lower(), list(known), 1)
    hint = f"did you mean {similar[0]!r}?" if similar else otherwise
    return card.make_error(message, name, expected, hint)
