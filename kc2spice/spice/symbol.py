"""Schematic symbols of our parts, laid out once from the pin table and drawn by every tool."""

from __future__ import annotations

from collections.abc import Iterable

from kc2spice.spice import kicad, ltspice
from kc2spice.spice.box import layout
from kc2spice.spice.circuit import Subcircuit
from kc2spice.spice.dialect import translate_text
from kc2spice.spice.kicad_sheet import kick_sheet

LIBRARY = "kc2spice"


def symbol_files(parts: Iterable[Subcircuit], dialect: str = "ngspice") -> dict[str, str]:
    """``{file name: text}`` of the symbols of ``parts`` for the libraries written in ``dialect``.

    KiCad simulates with ngspice: one library per file format, and a schematic of the kick behind
    a driver. LTspice needs its own words: its symbols name ``NAME.lib`` where the libraries are
    written in its dialect, else ``NAME.ltspice.lib``, which come along.

    Raises
    ------
    UsageError : a part that LTspice cannot be told.
    """
    parts = tuple(parts)
    boxes = [layout(part) for part in parts]
    files: dict[str, str] = {}
    if dialect == "ngspice":
        for release in kicad.RELEASES:
            files[f"{LIBRARY}_kicad{release.major}.kicad_sym"] = kicad.library(boxes, release)
            for box in boxes:
                if "anode" in (place.pin.name for place in box.places):
                    sheet = f"{box.name}_driver_kicad{release.major}.kicad_sch"
                    files[sheet] = kick_sheet(box, release)
    if dialect in ("ngspice", "ltspice"):
        ending = ".lib" if dialect == "ltspice" else ".ltspice.lib"
        for part, box in zip(parts, boxes, strict=True):
            files[f"{part.name}.asy"] = ltspice.symbol(box, part.name + ending)
            if dialect == "ngspice":
                files[part.name + ending] = translate_text(part.text, part.filename, "ltspice")
    return files
