"""Schematic symbols of our parts, laid out once from the pin table and drawn by every tool."""

from __future__ import annotations

from kc2spice.netlist.deck import Deck
from kc2spice.netlist.dialect import translate_text
from kc2spice.netlist.printers import ltspice
from kc2spice.netlist.printers.box import layout
from kc2spice.netlist.printers.kicad_sheet import project


def symbol_files(deck: Deck, dialect: str = "ngspice") -> dict[str, str]:
    """``{file name: text}`` of the symbols of ``deck``, whose libraries are written in ``dialect``.

    KiCad simulates with ngspice: a project of the whole deck with its symbol library. LTspice
    needs its own words: its symbols name ``NAME.lib`` where the libraries are written in its
    dialect, else ``NAME.ltspice.lib``, which come along.

    Raises
    ------
    UsageError : a part that LTspice cannot be told, a card that KiCad has no symbol for.
    """
    files = project(deck) if dialect == "ngspice" else {}
    if dialect in ("ngspice", "ltspice"):
        for part in deck.parts:
            stem = part.filename.removesuffix(".lib")
            library = f"{stem}.lib" if dialect == "ltspice" else f"{stem}.ltspice.lib"
            files[f"{stem}.asy"] = ltspice.symbol(layout(part), library)
            if dialect == "ngspice":
                files[library] = translate_text(part.text, part.filename, "ltspice")
    return files
