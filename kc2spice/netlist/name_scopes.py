"""Scopes of names in a circuit, with the names that included files define."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from pathlib import PurePosixPath

from kc2spice.core.disjoint_groups import DisjointGroups
from kc2spice.core.errors import did_you_mean
from kc2spice.netlist.circuit import (
    NODE_COUNTS,
    Card,
    Circuit,
    Directive,
    Element,
    FunctionCard,
    ModelCard,
    Parameters,
    key_by_lower_name,
)
from kc2spice.netlist.expression import parse_vector

GROUND_NAMES = frozenset({"0", "gnd", "!gnd"})
INCLUDES = (".include", ".inc")
# Number of nodes through which current flows, for elements whose other nodes are only sensed.
_CONDUCTING_NODES = {"e": 2, "g": 2, "s": 2}


@dataclass
class Scope:
    """Names that are defined in one subcircuit or at the top level of a circuit.

    All names are in lower case. In each ``ChainMap``, the first map contains the definitions of
    this scope, and the other maps contain the definitions of the enclosing scopes. ``defaults``
    contains the parameters that an instance may set. ``params`` contains all parameters of the
    subcircuit, including the ones in ``defaults``. ``defined`` contains the text and the card of
    each definition, keyed by its kind and name.
    """

    name: str
    where: str = ""
    pins: tuple[str, ...] = ()
    defaults: dict[str, str] = field(default_factory=dict)
    params: ChainMap[str, str] = field(default_factory=ChainMap)
    models: ChainMap[str, ModelCard] = field(default_factory=ChainMap)
    functions: ChainMap[str, FunctionCard] = field(default_factory=ChainMap)
    subcircuits: ChainMap[str, Scope] = field(default_factory=ChainMap)
    elements: list[Element] = field(default_factory=list)
    commands: list[Parameters | FunctionCard | Directive] = field(default_factory=list)
    defined: dict[str, tuple[str, Card]] = field(default_factory=dict)

    @property
    def nodes(self) -> frozenset[str]:
        """Names of the subcircuit's pins and of the nodes of its elements."""
        return frozenset(self.pins).union(*map(attrgetter("lower_case_nodes"), self.elements))

    @cached_property
    def elements_by_key(self) -> dict[str, Element]:
        """Elements keyed by lower-case name; of several elements with one name, the first."""
        result: dict[str, Element] = {}
        for element in self.elements:
            result.setdefault(element.key, element)
        return result

    def select_elements(self, kinds: str) -> dict[str, Element]:
        """Return the elements with the type letters ``kinds``, keyed by lower-case name."""
        return {key: item for key, item in self.elements_by_key.items() if item.kind in kinds}

    def find_subcircuit(self, name: str) -> Scope | None:
        """Find the subcircuit definition that a name refers to in this scope."""
        return self.subcircuits.get(name.lower())

    def list_scopes(self) -> Iterator[Scope]:
        """Yield this scope and the scopes of all subcircuits defined inside."""
        yield self
        for child in self.subcircuits.maps[0].values():
            yield from child.list_scopes()


def build_scope(tree: Circuit, files: Mapping[str, Circuit] | None = None, file: str = "") -> Scope:
    """Build the scope of a syntax tree and of the trees of included files.

    Raises
    ------
    UsageError : an include is missing or circular, a card is invalid, or a name is defined twice.
        The message contains file and line.
    """
    top, files = Scope(""), files or {}
    for include, chain in _fill_scope(top, tree, (file,), files):
        # a file must include neither itself nor a file by which it is included
        others = sorted(set(files) - set(chain))
        got = include.argument or "no file name"
        hint = (
            did_you_mean(include.argument, others) or f"copy {got} into the folder of the netlist"
        )
        expected = f"one of {', '.join(others)}" if others else None
        raise include.make_error("included file not found", got, expected, hint)
    return top


def _fill_scope(
    scope: Scope, tree: Circuit, chain: tuple[str, ...], files: Mapping[str, Circuit]
) -> list[tuple[Directive, tuple[str, ...]]]:
    """Add the cards of a circuit, and of its included files, to a scope.

    ``chain`` contains the file names from the main file to the file of the circuit, in the order in
    which they include each other. Return the include lines whose files are not in ``files``. Each
    include line is returned with the chain of files from the main file to the file that contains
    the line.
    """
    missing: list[tuple[Directive, tuple[str, ...]]] = []
    for item in tree.items:
        match item:
            case Element(kind, name):
                if kind not in NODE_COUNTS and kind != "x":
                    letters = "".join(sorted(NODE_COUNTS)).upper()
                    expected = f"a name that begins with one of {letters}X"
                    hint = "delete this line, or begin it with * if it is a comment"
                    raise item.make_error("unknown kind of element", name, expected, hint)
                scope.elements.append(item)
            case Circuit():
                missing += _fill_scope(_open_subcircuit(item, scope), item, chain, files)
            case ModelCard(name, kind, given):
                _require_same_definition(scope, f"model {name}", f"{kind} {given}", item)
                scope.models[name.lower()] = item
            case Directive(keyword) if keyword in INCLUDES:
                # the path of an included file is relative to the file with the include line
                target = str(PurePosixPath(chain[-1]).parent / item.argument)
                if target in chain:
                    raise item.make_error(
                        "a file includes itself, directly or through others", " -> ".join(chain)
                    )
                if target in files:
                    missing += _fill_scope(scope, files[target], (*chain, target), files)
                else:
                    missing.append((item, chain))
            case Directive(".control" | ".end"):
                pass
            case Parameters(values):
                scope.commands.append(item)
                for key, value in values.items():
                    _require_same_definition(scope, f"parameter {key}", value, item)
                    scope.params[key.lower()] = value
            case FunctionCard(name, _, law):
                scope.commands.append(item)
                _require_same_definition(scope, f"function {name}", law, item)
                scope.functions[name.lower()] = item
            case _:
                scope.commands.append(item)
    return missing


def _require_same_definition(scope: Scope, what: str, value: str, card: Card) -> None:
    """Raise an error if the same name has a different definition in another file."""
    what, value = what.lower(), value.lower()
    first, first_card = scope.defined.setdefault(what, (value, card))
    if first_card.file != card.file and first != value:
        expected = f"one definition; the first is in {first_card.where}"
        hint = "rename one of the two definitions, or move each definition into its .subckt"
        raise card.make_error(f"two files define the {what}", card.written, expected, hint)


def _open_subcircuit(item: Circuit, parent: Scope) -> Scope:
    """Make the scope of a subcircuit that is defined in another scope."""
    name = item.name.lower()
    if first := parent.subcircuits.maps[0].get(name):
        expected = f"one definition; the first is in {first.where}"
        hint = f"rename or delete the second .subckt {item.name}"
        raise item.make_error("two subcircuits have the same name", item.name, expected, hint)
    defaults = key_by_lower_name(item.defaults)
    parent.subcircuits[name] = Scope(
        item.name,
        item.where,
        tuple(map(str.lower, item.pins)),
        defaults,
        parent.params.new_child(dict(defaults)),
        parent.models.new_child(),
        parent.functions.new_child(),
        parent.subcircuits.new_child(),
    )
    return parent.subcircuits[name]


def has_vector(top: Scope, text: str) -> bool:
    """Return whether the circuit contains the nodes or device of a saved vector."""
    result = parse_vector(text.lower())
    if result is None:
        return False
    if result.quantity == "v":
        return all(_has_node(top, *name.split(".")) for name in result.names)
    scope = find_instance(top, result.path)
    return scope is not None and result.names[0] in scope.elements_by_key


def _has_node(top: Scope, *path: str) -> bool:
    """Return whether the circuit contains a node."""
    node, scope = path[-1], find_instance(top, path[:-1])
    return scope is not None and (node == "0" or node in scope.nodes)


def conducts_to_ground(scope: Scope, enclosing: frozenset[str] = frozenset()) -> bool:
    """Return whether an element of a subcircuit carries current into global ground.

    Elements of nested instances are included. A control voltage relative to ground carries no
    current. ``enclosing`` contains the file and line of the definition of each enclosing
    subcircuit.
    """
    for element in scope.elements:
        nodes = element.lower_case_nodes[: _CONDUCTING_NODES.get(element.kind)]
        if not GROUND_NAMES.isdisjoint(nodes):
            return True
    inside = enclosing | {scope.where}
    for element in scope.select_elements("x").values():
        called = scope.find_subcircuit(element.model)
        if called and called.where not in inside and conducts_to_ground(called, inside):
            return True
    return False


def find_currentless_pins(scope: Scope) -> dict[str, list[str]]:
    """Find the pins of a subcircuit through which no current can flow.

    The elements at such a pin connect it neither to another pin nor to ground. The result contains
    the inner nodes that are connected to each of these pins. Pins that only control sources are not
    in the result. The result is empty if the subcircuit contains global nodes.
    """
    if any(isinstance(card, Directive) and card.keyword == ".global" for card in scope.commands):
        return {}
    groups = DisjointGroups((*scope.pins, *scope.nodes, "0"))
    for element in scope.elements:
        nodes = [*element.lower_case_nodes[: _CONDUCTING_NODES.get(element.kind)]]
        called = scope.find_subcircuit(element.model) if element.kind == "x" else None
        if element.kind == "x" and (called is None or conducts_to_ground(called)):
            nodes.append("0")
        ends = ["0" if node in GROUND_NAMES else node for node in nodes]
        for node in ends[1:]:
            groups.join(ends[0], node)
    result = dict[str, list[str]]()
    for group in groups.list_groups():
        pins = [node for node in group if node in scope.pins]
        if len(pins) == 1 and "0" not in group and len(group) > 1:
            result[pins[0]] = [node for node in group if node not in pins]
    return result


def find_instance(top: Scope, path: tuple[str, ...]) -> Scope | None:
    """Return the scope of a nested instance; None if the instance does not exist."""
    scope: Scope | None = top
    for name in path:
        element = scope.elements_by_key.get(name) if scope else None
        scope = scope.find_subcircuit(element.model) if scope and element else None
    return scope
