"""Circuits as a simulator sees them: includes followed, names looked up from the inside out."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath

from kc2spice.netlist.circuit import (
    Card,
    Circuit,
    Directive,
    Element,
    Function,
    Item,
    Model,
    Parameters,
)
from kc2spice.netlist.expression import vector
from kc2spice.netlist.read import NODES

GROUND = frozenset({"0", "gnd", "!gnd"})
INCLUDES = (".include", ".inc")


@dataclass
class Scope:
    """A subcircuit or the top level (``name == ""``): what names in lower case mean in it.

    Mappings look from the inside out; their first map is what it defines itself. ``defaults`` are
    the parameters that an instance may set, ``params`` those and its own; ``defined`` says where.
    """

    name: str
    where: str = ""
    parent: Scope | None = None
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
    _link(tree, file, files or {}, top, ())
    return top


def _link(
    tree: Circuit, file: str, files: Mapping[str, Circuit], scope: Scope, chain: tuple[str, ...]
) -> None:
    """Sort what ``file`` and its includes hold into ``scope``."""
    chain = (*chain, file)

    def fill(scope: Scope, items: tuple[Item, ...]) -> None:
        for item in items:
            match item:
                case Element():
                    _require_known(item)
                    scope.elements.append(item)
                case Circuit():
                    fill(_opened(item, scope), item.items)
                case Model(name, kind, given):
                    _require_same(scope, f"model {name}", f"{kind} {given}", item)
                    scope.models[name.lower()] = item
                case Directive(keyword) if keyword in INCLUDES:
                    target = _included(item, file, files, chain)
                    _link(files[target], target, files, scope, chain)
                case Directive(".control" | ".end"):
                    pass
                case _:
                    scope.commands.append(item)
                    if isinstance(item, Parameters):
                        for key, value in item.values.items():
                            _require_same(scope, f"parameter {key}", value, item)
                            scope.params[key.lower()] = value
                    elif isinstance(item, Function):
                        _require_same(scope, f"function {item.name}", item.expression, item)
                        scope.functions[item.name.lower()] = item

    fill(scope, tree.items)


def _require_known(part: Element) -> None:
    if part.kind not in NODES and part.kind != "x":
        letters = "".join(sorted(NODES)).upper()
        expected = f"a name that begins with one of {letters}X"
        raise part.error("unknown kind of element", part.name, expected)


def _require_same(scope: Scope, what: str, value: str, card: Card) -> None:
    """That no two files define something differently."""
    what, value = what.lower(), value.lower()
    first, place = scope.defined.setdefault(what, (value, card))
    files = {each.where.rpartition(":")[0] for each in (place, card)}
    if len(files) > 1 and first != value:
        expected = f"one definition; the first is in {place.where}"
        hint = "rename one, or put it into its .subckt"
        raise card.error(f"two files define the {what}", card.written, expected, hint)


def _included(s: Directive, file: str, files: Mapping[str, Circuit], chain: tuple[str, ...]) -> str:
    written = " ".join(s.words).strip("\"'")
    target = str(PurePosixPath(file).parent / written)  # from where the file stands
    if target in chain:
        raise s.error("include goes in a circle", " -> ".join(chain))
    if target not in files:
        expected = "one of " + ", ".join(sorted(set(files) - set(chain)))
        raise s.error("included file is not there", written or "no file name", expected)
    return target


def _opened(each: Circuit, parent: Scope) -> Scope:
    if first := parent.subcircuits.maps[0].get(each.name.lower()):
        expected = f"one definition; the first is in {first.where}"
        raise each.error("two subcircuits have one name", each.name, expected)
    defaults = {key.lower(): value for key, value in each.defaults.items()}
    scope = Scope(
        each.name,
        each.where,
        parent,
        tuple(pin.lower() for pin in each.pins),
        defaults,
        parent.params.new_child(dict(defaults)),
        parent.models.new_child(),
        parent.functions.new_child(),
        parent.subcircuits.new_child(),
    )
    parent.subcircuits[each.name.lower()] = scope
    return scope


def has_vector(top: Scope, text: str) -> bool:
    """Whether the circuit has the nodes or the device that a saved vector is read from."""
    found = vector(text.lower())
    if found is None:
        return False
    if found.quantity == "v":
        return all(_has_node(top, *name.split(".")) for name in found.names)
    scope = inside(top, found.path)
    return scope is not None and any(e.key == found.names[0] for e in scope.elements)


def _has_node(top: Scope, *path: str) -> bool:
    node, scope = path[-1], inside(top, path[:-1])
    return scope is not None and (
        node == "0" or node in scope.pins or any(node in e.ends for e in scope.elements)
    )


def inside(top: Scope, path: tuple[str, ...]) -> Scope | None:
    """The scope of the instance ``xa.xb`` …; None where there is none."""
    scope: Scope | None = top
    for name in path:
        called = next((e.model for e in scope.elements if e.key == name), None) if scope else None
        scope = scope.find(called) if scope and called else None
    return scope
