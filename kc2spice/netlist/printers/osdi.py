"""Testbenches for Verilog-A modules compiled to OSDI, for an ngspice that can load them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

from kc2spice.netlist.circuit import Directive, Element, Item, Model, Subcircuit
from kc2spice.netlist.deck import Deck, retold
from kc2spice.netlist.printers.ngspice import Printer
from kc2spice.netlist.scope import INCLUDES
from kc2spice.netlist.vectors import vector


def testbench(deck: Deck, modules: Collection[Subcircuit]) -> dict[str, str]:
    """``{file name: text}``: the deck with ``modules`` in place of their subcircuits.

    ``openvaf-r NAME.va`` makes ``NAME.osdi`` of each module. Parts that are no modules come along
    as libraries. Vectors inside of modules cannot be saved and are left out; initial conditions
    are the modules' own, so the transient needs no ``uic``.
    """
    stems = {p.name.lower(): p.filename.removesuffix(".lib") for p in modules}
    replaced = {p.filename for p in modules}
    main = f"{deck.name}_osdi.cir"
    compiled = " && ".join(f"openvaf-r {stem}.va" for stem in stems.values())
    tree = retold(
        deck.trees[deck.main],
        f"* Run it with:  {compiled} && ngspice -b -r {deck.name}.raw {main}",
        "* Each part is a Verilog-A module, compiled by OpenVAF and loaded by ngspice 39 or later.",
    )
    models: list[Item] = []
    items: list[Item] = []
    notes: tuple[str, ...] = ()
    for item in tree.items:
        notes += item.notes
        if kept := _changed(item, stems, replaced, models):
            items.append(replace(kept, notes=notes))
            notes = ()
    first, *rest = items
    loads = tuple(f"pre_osdi {stem}.osdi" for stem in stems.values())
    control = Directive(".control", loads, notes=first.notes)
    tree = replace(tree, items=(control, *models, replace(first, notes=()), *rest))
    files = {main: Printer().file(tree)}
    return files | {n: text for n, text in deck.files.items() if n not in {deck.main, *replaced}}


def _changed(
    item: Item, stems: Mapping[str, str], replaced: Collection[str], models: list[Item]
) -> Item | None:
    """An item of the deck as it is among modules; ``models`` are added to."""
    if isinstance(item, Element) and item.model.lower() in stems:
        return _instance(item, models)
    if not isinstance(item, Directive):
        return item
    if item.keyword == ".print" or (item.keyword in INCLUDES and item.words[0] in replaced):
        return None
    if item.keyword == ".save":
        kept = tuple(word for word in item.words if _outer(word))
        return replace(item, words=kept) if kept else None
    if item.keyword == ".tran":
        return replace(item, words=tuple(w for w in item.words if w.lower() != "uic"))
    return item


def _outer(text: str) -> bool:
    """Whether a vector exists without subcircuits."""
    found = vector(text)
    return (
        found is not None
        and not (found.path or found.parameter)
        and "." not in found.names[0]
        and (found.quantity == "v" or found.names[0].lower().startswith("v"))
    )


def _instance(part: Element, models: list[Item]) -> Element:
    """An N card with a model of its own for an X card; parameters go to the model."""
    name = f"m{part.key}"
    models.append(Model(name, part.model, part.parameters))
    return replace(part, kind="n", name=f"N{part.name[1:]}", model=name, parameters={})
