"""Testbenches for Verilog-A modules compiled to OSDI, for an ngspice that can load them."""

from __future__ import annotations

import re
from collections.abc import Collection

from kc2spice.netlist.circuit import Subcircuit
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.statements import Statement, statements

_OWN = re.compile(r"(?i)v\(\w+\)|i\(v\w+\)")  # vectors that exist without subcircuits
_RUN = re.compile(r"\* Run it with:|\*.*\bngspice (-\w|\w+_plot)")


def testbench(deck: Deck, modules: Collection[Subcircuit]) -> dict[str, str]:
    """``{file name: text}``: the deck with ``modules`` in place of their subcircuits.

    ``openvaf-r NAME.va`` makes ``NAME.osdi`` of each module. Parts that are no modules come along
    as libraries. Vectors inside of modules cannot be saved and are left out; initial conditions
    are the modules' own, so the transient needs no ``uic``.
    """
    stems = {p.name.lower(): p.filename.removesuffix(".lib") for p in modules}
    replaced = {p.filename for p in modules}
    main = f"{deck.name}_osdi.cir"
    lines: list[str] = []
    models: list[str] = []
    for s in statements(deck.files[deck.main], deck.main, title=True):
        lines += [line for line in s.comments if not _RUN.match(line)]
        if not s.text or (s.keyword in (".include", ".inc") and s.words[1] in replaced):
            continue
        if s.keyword == ".save":
            lines += [f".save {w}" for w in s.words[1:] if _OWN.fullmatch(w)]
        elif s.keyword == ".tran":
            lines.append(re.sub(r"(?i)\s+uic\b", "", s.text))
        elif s.keyword.startswith("x"):
            lines.append(_instance(s, stems, models))
        elif s.keyword != ".print":
            lines.append(s.text)
    compiled = " && ".join(f"openvaf-r {stem}.va" for stem in stems.values())
    loads = [f"pre_osdi {stem}.osdi" for stem in stems.values()]
    head = [
        lines[0],
        f"* Run it with:  {compiled} && ngspice -b -r {deck.name}.raw {main}",
        "* Each part is a Verilog-A module, compiled by OpenVAF and loaded by ngspice 39 or later.",
        ".control", *loads, ".endc",
        *models,
    ]  # fmt: skip
    files = {main: "\n".join([*head, *lines[1:]]) + "\n"}
    kept = {name: text for name, text in deck.files.items() if name != deck.main}
    return files | {name: text for name, text in kept.items() if name not in replaced}


def _instance(s: Statement, stems: Collection[str], models: list[str]) -> str:
    """An N card with a model of its own for an X card; parameters go to the model."""
    plain = [w for w in s.words if "=" not in w and w.lower() != "params:"]
    if plain[-1].lower() not in stems:
        return s.text
    given = " ".join(w for w in s.words if "=" in w)
    model = f"m{plain[0].lower()}"
    models.append(f".model {model} {plain[-1]}" + (f" {given}" if given else ""))
    return " ".join([f"N{plain[0][1:]}", *plain[1:-1], model])
