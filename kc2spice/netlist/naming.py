"""Libraries that need no other file: helpers go along under their part's name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from kc2spice.netlist.circuit import Circuit, Element, Item, Subcircuit
from kc2spice.netlist.printers.ngspice import printed

_ORIGIN = ("* tool:", "* scene:", "* licence:", "* sign:", "* validity:", "* rating:", "* @")


def self_contained(part: Subcircuit, helpers: Iterable[Subcircuit]) -> Subcircuit:
    """``part`` with the ``helpers`` that it instantiates behind it, as ``PART_HELPER``.

    One library file then is all that a user includes, and two of them never define one name twice.
    """
    tree = part.circuit
    for helper in helpers:
        names = {helper.name: f"{part.name}_{helper.name}"}
        inner = tuple(_without_origin(item) for item in renamed(helper.circuit, names).items)
        tree = renamed(tree, names)
        tree = replace(tree, items=tree.items + inner)
    return printed(part, tree)


def _without_origin(item: Item) -> Item:
    kept = (line for line in item.notes if not line.startswith(_ORIGIN))
    return replace(item, notes=("", *kept)) if item.notes else item


def renamed(circuit: Circuit, names: Mapping[str, str]) -> Circuit:
    """``circuit`` with other names of subcircuits, where they are defined and where they are
    instantiated."""
    new = {old.lower(): name for old, name in names.items()}

    def item(each: Item) -> Item:
        if isinstance(each, Circuit):
            name = new.get(each.name.lower(), each.name)
            return replace(each, name=name, items=tuple(map(item, each.items)))
        if isinstance(each, Element) and each.kind == "x":
            return replace(each, model=new.get(each.model.lower(), each.model))
        return each

    return replace(circuit, items=tuple(map(item, circuit.items)))
