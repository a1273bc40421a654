"""Circuits as a simulator sees them: includes followed, names looked up from the inside out."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any

from kc2spice.netlist.circuit import (
    NODES,
    Card,
    Circuit,
    Directive,
    Element,
    Function,
    Model,
    Parameters,
)
from kc2spice.netlist.expression import vector

GROUND = frozenset({"0", "gnd", "!gnd"})
INCLUDES = (".include", ".inc")


@dataclass
class Scope:
    """Definitions in a subcircuit or, with an empty ``name``, at the top level.

    Names of definitions are in lower case. Each ``ChainMap`` is searched from the inside out: its
    first map contains the definitions of this scope, the next maps those of the enclosing scopes.
    ``defaults`` contains the parameters that an instance may set. ``params`` contains these and the
    parameters that the subcircuit defines. ``defined`` contains the text and the card of each
    definition.
    """

    name: str
    where: str = ""
    pins: tuple[str, ...] = ()
    defaults: dict[str, str] = field(default_factory=dict)
    params: ChainMap[str, str] = field(default_factory=ChainMap)
    models: ChainMap[str, Model] = field(default_factory=ChainMap)
    functions: ChainMap[str, Function] = field(default_factory=ChainMap)
    subcircuits: ChainMap[str, Scope] = field(default_factory=ChainMap)
    elements: list[Element] = field(default_factory=list)
    commands: list[Parameters | Function | Directive] = field(default_factory=list)
    defined: dict[str, tuple[str, Card]] = field(default_factory=dict)

    def find(self, name: str) -> Scope | None:
        """The subcircuit ``name`` as this scope sees it."""
        return self.subcircuits.get(name.lower())

    def inwards(self) -> Iterator[Scope]:
        """This scope and those within it."""
        yield self
        for child in self.subcircuits.maps[0].values():
            yield from child.inwards()


def circuit(tree: Circuit, files: Mapping[str, Circuit] | None = None, file: str = "") -> Scope:
    """The whole circuit of a ``file``'s tree, the includes of it and of other ``files`` followed.

    Raises
    ------
    UsageError : a missing or circular include, a broken card, a name defined twice; the message
        names file and line.
    """
    top = Scope("")
    _fill(top, tree, (file,), files or {})
    return top


def _fill(
    scope: Scope, tree: Circuit, chain: tuple[str, ...], files: Mapping[str, Circuit]
) -> None:
    """Sort what a circuit of the last file of ``chain``, and its includes, hold into ``scope``."""
    for item in tree.items:
        match item:
            case Element(kind, name):
                if kind not in NODES and kind != "x":
                    letters = "".join(sorted(NODES)).upper()
                    expected = f"a name that begins with one of {letters}X"
                    raise item.error("unknown kind of element", name, expected)
                scope.elements.append(item)
            case Circuit():
                _fill(_opened(item, scope), item, chain, files)
            case Model(name, kind, given):
                _require_same(scope, f"model {name}", f"{kind} {given}", item)
                scope.models[name.lower()] = item
            case Directive(keyword, words) if keyword in INCLUDES:
                written = " ".join(words).strip("\"'")
                target = str(PurePosixPath(chain[-1]).parent / written)  # from where the file is
                if target in chain:
                    raise item.error(
                        "a file includes itself, directly or through others", " -> ".join(chain)
                    )
                if target not in files:
                    expected = "one of " + ", ".join(sorted(set(files) - set(chain)))
                    got = written or "no file name"
                    raise item.error("included file is not there", got, expected)
                _fill(scope, files[target], (*chain, target), files)
            case Directive(".control" | ".end"):
                pass
            case Parameters(values):
                scope.commands.append(item)
                for key, value in values.items():
                    _require_same(scope, f"parameter {key}", value, item)
                    scope.params[key.lower()] = value
            case Function(name, _, law):
                scope.commands.append(item)
                _require_same(scope, f"function {name}", law, item)
                scope.functions[name.lower()] = item
            case _:
                scope.commands.append(item)


def _require_same(scope: Scope, what: str, value: str, card: Card) -> None:
    """Raise UsageError if two files define a name differently."""
    what, value = what.lower(), value.lower()
    first, place = scope.defined.setdefault(what, (value, card))
    files = {item.where.rpartition(":")[0] for item in (place, card)}
    if len(files) > 1 and first != value:
        expected = f"one definition; the first is in {place.where}"
        hint = "rename one, or put it into its .subckt"
        raise card.error(f"two files define the {what}", card.written, expected, hint)


def _opened(item: Circuit, parent: Scope) -> Scope:
    name = item.name.lower()
    if first := parent.subcircuits.maps[0].get(name):
        expected = f"one definition; the first is in {first.where}"
        raise item.error("two subcircuits have one name", item.name, expected)
    defaults = {key.lower(): value for key, value in item.defaults.items()}
    pins = tuple(map(str.lower, item.pins))
    outer: Any = (parent.models, parent.functions, parent.subcircuits)
    inner = (parent.params.new_child(dict(defaults)), *(m.new_child() for m in outer))
    parent.subcircuits[name] = Scope(item.name, item.where, pins, defaults, *inner)
    return parent.subcircuits[name]


def has_vector(top: Scope, text: str) -> bool:
    """Whether the circuit has the nodes or the device that a saved vector is read from."""
    result = vector(text.lower())
    if result is None:
        return False
    if result.quantity == "v":
        return all(_has_node(top, *name.split(".")) for name in result.names)
    scope = inside(top, result.path)
    return scope is not None and any(e.key == result.names[0] for e in scope.elements)


def _has_node(top: Scope, *path: str) -> bool:
    node, scope = path[-1], inside(top, path[:-1])
    nodes = {"0"}.union(scope.pins, *(e.ends for e in scope.elements)) if scope else ()
    return node in nodes


def inside(top: Scope, path: tuple[str, ...]) -> Scope | None:
    """The scope of the instance ``xa.xb`` …; None where there is none."""
    scope: Scope | None = top
    for name in path:
        called = next((e.model for e in scope.elements if e.key == name), None) if scope else None
        scope = scope.find(called) if scope and called else None
    return scope
