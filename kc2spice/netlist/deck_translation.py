"""Output for other tools: netlists in dialects, Verilog-A modules and symbols."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from kc2spice.core.errors import UsageError
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.expression import join_terms, split_terms
from kc2spice.netlist.printers.dialect_registry import (
    NGSPICE,
    VERILOG_A,
    find_dialect,
    list_deck_dialects,
)
from kc2spice.netlist.printers.kicad import make_project
from kc2spice.netlist.printers.ngspice import locate_cards
from kc2spice.netlist.printers.verilog_a import format_module, make_testbench
from kc2spice.netlist.subcircuit_library import Subcircuit


def translate_deck(deck: Deck, dialect: str) -> Deck:
    """Translate all netlist files of a deck to the dialect of a simulator.

    Raises
    ------
    UsageError : the dialect is unknown, or the dialect has no equivalent of a construct in the
        deck.
    """
    if dialect == NGSPICE:
        return deck
    printer = find_dialect(dialect)(deck)
    main = deck.add_usage_comment(f"* Run it with:  {printer.command} {deck.main_file_name}")
    trees = {**deck.located_trees, deck.main_file_name: main}
    if deck.text is None:
        trees[deck.main_file_name] = locate_cards(main, deck.main_file_name)
    files = {name: printer.format_file(tree) for name, tree in trees.items()}
    vectors = {}
    for key, (expression, factor) in deck.vectors.items():
        signed = [(sign, printer.format_vector(item)) for sign, item in split_terms(expression)]
        vectors[key] = join_terms(signed), factor
    text = files.pop(deck.main_file_name)
    changes: dict[str, Any] = {"options": (), "refinements": (), "vectors": vectors}
    return replace(deck, text=text, tree=None, more=files, parts=(), **changes)


def write_dialect_files(deck: Deck, dialect: str) -> dict[str, str]:
    """Write a deck in a dialect or in Verilog-A; return all file texts, keyed by name.

    A part that cannot be a Verilog-A module, such as a pulse generator, is written only as a SPICE
    library. The file ``verilog-a.txt`` states why such parts cannot be Verilog-A modules. The
    testbench ``NAME_osdi.cir`` runs the compiled modules in ngspice.

    Raises
    ------
    UsageError : the dialect is unknown, the dialect has no equivalent of a construct in the deck,
        or none of the parts can be written as a Verilog-A module.
    """
    if dialect != VERILOG_A:
        return translate_deck(deck, dialect).files
    files: dict[str, str] = {}
    left_out: list[UsageError] = []
    modules: list[Subcircuit] = []
    for part in deck.parts:
        try:
            files |= format_module(part)
            modules.append(part)
        except UsageError as error:
            left_out.append(error)
    if left_out and not files:
        raise left_out[0]
    if left_out:
        paragraphs = ("Not written as modules:", *map(str, left_out))
        files["verilog-a.txt"] = "\n\n".join(paragraphs) + "\n"
    return files | make_testbench(deck, modules)


def write_symbol_files(deck: Deck, dialect: str = "ngspice") -> dict[str, str]:
    """Return the texts of symbol files and of their libraries, keyed by file name.

    The caller saves the texts to the disk. A symbol file contains the graphical symbol of a part
    for a schematic editor. An export for ngspice contains a KiCad project of the deck. An export
    for ngspice also contains the part symbols for every other simulator, and the libraries
    ``NAME.DIALECT.lib`` that these symbols use. For another dialect, the files are the symbols for
    its simulator, which use the libraries ``NAME.lib``. For Verilog-A, the result is empty. A
    user-defined part that only ngspice can simulate has no symbols for other simulators.

    Raises
    ------
    UsageError : the simulator cannot represent a part, or a card has no KiCad symbol.
    """
    if dialect == VERILOG_A:
        return {}
    files = make_project(deck) if dialect == NGSPICE else {}
    dialects = list_deck_dialects() if dialect == NGSPICE else (dialect,)
    for name in filter(NGSPICE.__ne__, dialects):
        printer = find_dialect(name)()
        for part in deck.parts:
            stem = part.filename.removesuffix(".lib")
            library = f"{stem}.{name}.lib" if dialect == NGSPICE else f"{stem}.lib"
            symbols = printer.symbols(part, library)
            if symbols and dialect == NGSPICE:
                try:
                    symbols = {**symbols, library: printer.format_file(part.located_tree)}
                except UsageError:  # the dialect has no equivalent of a card in the library
                    symbols = {}
            files |= symbols
    return files
