"""Circuits as a simulator sees them: includes followed, names looked up from the inside out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from kc2spice.core.errors import UsageError
from kc2spice.netlist.circuit import (
    Circuit,
    Directive,
    Element,
    Function,
    Item,
    Model,
    Parameters,
)
from kc2spice.netlist.read import NODES, read
from kc2spice.netlist.statements import beside
from kc2spice.netlist.vectors import vector

GROUND = frozenset({"0", "gnd", "!gnd"})
INCLUDES = (".include", ".inc")


@dataclass
class Scope:
    """A subcircuit or the top level (``name == ""``): what it defines, in lower case.

    ``defaults`` are the parameters that an instance may set, ``params`` those and its own.
    """

    name: str
    where: str = ""
    parent: Scope | None = None
    pins: tuple[str, ...] = ()
    defaults: dict[str, str] = field(default_factory=dict)
    params: dict[str, str] = field(default_factory=dict)
    elements: list[Element] = field(default_factory=list)
    models: dict[str, Model] = field(default_factory=dict)
    functions: dict[str, Function] = field(default_factory=dict)
    subcircuits: dict[str, Scope] = field(default_factory=dict)
    commands: list[Parameters | Function | Directive] = field(default_factory=list)

    def find(self, name: str) -> Scope | None:
        """The subcircuit ``name`` as this scope sees it."""
        return next(
            (s.subcircuits[name.lower()] for s in self.outwards() if name.lower() in s.subcircuits),
            None,
        )

    def model(self, name: str) -> Model | None:
        """The model ``name`` as this scope sees it."""
        return next(
            (s.models[name.lower()] for s in self.outwards() if name.lower() in s.models), None
        )

    def function(self, name: str) -> Function | None:
        """The function ``name`` as this scope sees it."""
        return next(
            (s.functions[name.lower()] for s in self.outwards() if name.lower() in s.functions),
            None,
        )

    def knows_param(self, name: str) -> bool:
        """Is the parameter ``name`` visible here?"""
        return any(name.lower() in scope.params for scope in self.outwards())

    def outwards(self) -> Iterator[Scope]:
        """This scope and those around it."""
        yield self
        if self.parent is not None:
            yield from self.parent.outwards()

    def inwards(self) -> Iterator[Scope]:
        """This scope and those within it."""
        yield self
        for child in self.subcircuits.values():
            yield from child.inwards()


def circuit(main: str, files: Mapping[str, str | Circuit]) -> Scope:
    """The whole circuit of a deck, its includes followed; a file is its text or its tree.

    Raises
    ------
    UsageError : a missing or circular include, a broken card, a name defined twice; the message
        names file and line.
    """
    top = Scope("")
    _link(main, files, top, ())
    return top


def _link(
    file: str, files: Mapping[str, str | Circuit], scope: Scope, chain: tuple[str, ...]
) -> None:
    held = files[file]
    tree = read(held, file, title=not chain) if isinstance(held, str) else held
    _fill(scope, tree.items, file, files, (*chain, file))


def _fill(
    scope: Scope,
    items: tuple[Item, ...],
    file: str,
    files: Mapping[str, str | Circuit],
    chain: tuple[str, ...],
) -> None:
    """Sort ``items`` of ``file`` into ``scope``."""
    for item in items:
        match item:
            case Element():
                scope.elements.append(_known(item))
            case Circuit():
                _fill(_opened(item, scope), item.items, file, files, chain)
            case Model():
                _add_model(item, scope)
            case Directive(keyword) if keyword in INCLUDES:
                _link(_included(item, file, files, chain), files, scope, chain)
            case Directive(".control" | ".end"):
                pass
            case _:
                scope.commands.append(item)
                if isinstance(item, Parameters):
                    scope.params |= {k.lower(): v for k, v in item.values.items()}
                elif isinstance(item, Function):
                    scope.functions[item.name.lower()] = item


def _known(part: Element) -> Element:
    if part.kind in NODES or part.kind == "x":
        return part
    letters = "".join(sorted(NODES)).upper()
    raise UsageError(
        "unknown kind of element",
        where=part.where,
        got=part.name,
        expected=f"a name that begins with one of {letters}X",
    )


def _add_model(model: Model, scope: Scope) -> None:
    first = scope.models.get(model.name.lower(), model)
    if first.where.partition(":")[0] != model.where.partition(":")[0] and not first.same(model):
        raise UsageError(
            "two models have one name",
            where=model.where,
            got=model.name,
            expected=f"one definition; the first is in {first.where}",
            hint="rename one, or put it into its .subckt",
        )
    scope.models[model.name.lower()] = model


def _included(
    s: Directive, file: str, files: Mapping[str, str | Circuit], chain: tuple[str, ...]
) -> str:
    written = " ".join(s.words).strip("\"'")
    target = beside(file, written)
    if target not in files:
        raise UsageError(
            "included file is not there",
            where=s.where,
            got=written or "no file name",
            expected="one of " + ", ".join(sorted(set(files) - set(chain))),
        )
    if target in chain:
        raise UsageError("include goes in a circle", where=s.where, got=" -> ".join(chain))
    return target


def _opened(each: Circuit, parent: Scope) -> Scope:
    if each.name.lower() in parent.subcircuits:
        raise UsageError(
            "two subcircuits have one name",
            where=each.where,
            got=each.name,
            expected="one definition; the first is in "
            f"{parent.subcircuits[each.name.lower()].where}",
        )
    defaults = {key.lower(): value for key, value in each.defaults.items()}
    pins = tuple(pin.lower() for pin in each.pins)
    scope = Scope(each.name, each.where, parent, pins, defaults, dict(defaults))
    parent.subcircuits[each.name.lower()] = scope
    return scope


def has_vector(top: Scope, text: str) -> bool:
    """Whether the circuit has the nodes or the device that a saved vector is read from."""
    found = vector(text.lower())
    if found is None:
        return False
    scope = _inside(top, found.path)
    if found.quantity == "v":
        return all(_has_node(top, name) for name in found.names)
    return scope is not None and any(e.key == found.names[0] for e in scope.elements)


def _has_node(top: Scope, name: str) -> bool:
    *path, node = name.split(".")
    scope = _inside(top, tuple(path))
    if scope is None:
        return False
    return node == "0" or node in scope.pins or any(node in e.ends for e in scope.elements)


def _inside(top: Scope, path: tuple[str, ...]) -> Scope | None:
    """The scope of the instance ``xa.xb`` …; None where there is none."""
    scope = top
    for name in path:
        called = next((e.model for e in scope.elements if e.key == name), None)
        found = scope.find(called) if called else None
        if found is None:
            return None
        scope = found
    return scope
