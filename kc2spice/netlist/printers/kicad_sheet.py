"""A deck as a KiCad project: a sheet with every instance, libraries, a simulation set-up.

Nets are joined by global labels, which carry the node names of the deck, so that a curve has the
same name in KiCad, in the deck and in the results. Format: KiCad developer documentation,
S-expression schematic format, version 20231120, which releases 8, 9 and 10 read.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from math import ceil
from textwrap import shorten
from uuid import NAMESPACE_URL, uuid5

from kc2spice.core.errors import UsageError
from kc2spice.netlist.circuit import Directive, Element, Subcircuit
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.printers.box import layout
from kc2spice.netlist.printers.kicad import (
    GRID,
    HEAD,
    LIBRARY,
    NO,
    YES,
    Symbol,
    Tree,
    Word,
    element_symbols,
    font,
    library,
    part_symbol,
    spice,
    write,
)
from kc2spice.netlist.read import subcircuits
from kc2spice.netlist.scope import GROUND, Scope
from kc2spice.netlist.vectors import vector

# grid units at which rows break, and the papers on which the sheet then has a good shape
_ENOUGH = {105: ("A4",), 150: ("A4", "A3"), 220: ("A3", "A2"), 320: ("A2", "A1", "A0")}
MARGIN = 10
_LETTER = 0.5  # width of a letter in grid units
_PAPERS = {
    "A4": (297, 210), "A3": (420, 297), "A2": (594, 420), "A1": (841, 594), "A0": (1189, 841),
}  # fmt: skip
_STAMP = 40  # mm, height of the title block
_COMMENT = 80  # letters of a line in it
_VALUE = 56  # letters of a value
_NUMBER = re.compile(r"(?<![\w.])\d+\.?\d*(?:e[-+]?\d+)?(?![\w.])")
_OURS = frozenset({".save", ".print", ".end", ".include", ".inc"})
_COLOURS = ("rgb(228, 26, 28)", "rgb(55, 126, 184)", "rgb(77, 175, 74)", "rgb(152, 78, 163)")


@dataclass(frozen=True)
class _Item:
    """A symbol on the sheet, its fields and nets; ``reach`` is left, right, up, down in units."""

    symbol: Symbol
    fields: dict[str, str]
    nets: tuple[str, ...]
    reach: tuple[int, int, int, int]


@dataclass(frozen=True)
class _Put:
    """An item at a grid position."""

    item: _Item
    x: int
    y: int


def project(deck: Deck) -> dict[str, str]:
    """``{file name: text}`` of a KiCad project that shows and simulates ``deck``.

    ``NAME.kicad_pro`` opens it; the sheet runs with the deck's own analysis and options, and the
    exported netlist gives the deck's results.

    Raises
    ------
    UsageError : the deck instantiates a subcircuit that none of its files defines.
    """
    top = deck.scope
    parts = _parts(deck)
    plain = element_symbols()
    drawn = {name: part_symbol(layout(part)) for name, part in parts.items()}
    items = [_item(element, drawn, plain) for element in top.elements]
    once = Counter(net for item in items for net in item.nets)
    items += [_probe(net, plain["PROBE"]) for net in once if once[net] == 1 and net not in GROUND]
    title = deck.files[deck.main].partition("\n")[0].lstrip("* ").removeprefix(f"{deck.name}: ")
    sources = {e.key: _reference(e.name) for e in top.elements}
    commands = [
        " ".join(_renamed(word, sources) for word in card.text.split())
        for card in top.commands
        if not (isinstance(card, Directive) and card.keyword in _OURS)
    ]
    used = [*drawn.values(), *{s.name: s for s in plain.values()}.values()]
    return {
        f"{deck.name}.kicad_sch": _sheet(deck.name, title, items, commands, plain),
        f"{deck.name}.kicad_pro": _settings(deck.name),
        f"{deck.name}.wbk": _workbook(deck, top, commands),
        f"{LIBRARY}.kicad_sym": library(used),
        "sym-lib-table": (
            "(sym_lib_table\n\t(version 7)\n"
            f'\t(lib (name "{LIBRARY}")(type "KiCad")(uri "${{KIPRJMOD}}/{LIBRARY}.kicad_sym")'
            '(options "")(descr "parts of this project"))\n)\n'
        ),
    }


def _parts(deck: Deck) -> dict[str, Subcircuit]:
    """Subcircuits by lower-case name: ours, and those of the user's files."""
    own = {part.name.lower(): part for part in deck.parts}
    ours = {part.filename for part in deck.parts}
    for file, text in deck.files.items():
        if file not in ours and file != deck.main:
            for part in subcircuits(text, file):
                own.setdefault(part.name.lower(), part)
    return own


def _reference(name: str) -> str:
    """KiCad counts symbols: a name must end in a number."""
    return name if name[-1].isdigit() else f"{name}1"


def _renamed(word: str, references: Mapping[str, str]) -> str:
    """A word of a command: a source, or what begins with a vector inside of an instance."""
    if word.lower() in references:
        return references[word.lower()]
    head, dot, rest = word.partition(".")
    opening, bracket, instance = head.rpartition("(")
    name = references.get(instance.lower(), instance) if dot and bracket else instance
    return f"{opening}{bracket}{name}{dot}{rest}"


def _item(element: Element, parts: dict[str, Symbol], plain: dict[str, Symbol]) -> _Item:
    letter, name = element.name[0].upper(), _reference(element.name)
    nets = tuple("0" if n.lower() in GROUND else n for n in element.nodes)
    given = " ".join(f"{k}={v}" for k, v in element.parameters.items())
    if letter == "X":
        symbol = parts.get(element.model.lower())
        if symbol is None or len(symbol.ends) != len(nets):
            raise UsageError("no such subcircuit", where=element.where, got=element.model)
        fields = symbol.fields | ({"Sim.Params": given} if given else {})
        return _placed(symbol, fields | {"Reference": name}, nets)
    symbol = plain.get(letter)
    if symbol is None or len(symbol.ends) != len(nets):
        raise UsageError(
            "the sheet has no symbol for this card",
            where=element.where,
            got=element.text[:80],
            expected=f"one of {', '.join(sorted(k for k in plain if len(k) == 1))} or X",
        )
    law = f"{element.quantity}={element.expression}" if element.quantity else ""
    words = (*map(_reference, element.sources), *element.values, given, law)
    value = " ".join(filter(None, words))
    fields = symbol.fields | {
        "Reference": name,
        "Value": _shown(value),
        "Sim.Params": spice(letter, value),
    }
    return _placed(symbol, fields, nets)


def _shown(value: str) -> str:
    """A value to be read: six digits, one short line; ``Sim.Params`` has it all."""
    short = _NUMBER.sub(lambda number: f"{float(number[0]):.6g}", value)
    return short if len(short) <= _VALUE else short[: _VALUE - 2].rpartition(" ")[0] + " …"


def _probe(net: str, symbol: Symbol) -> _Item:
    return _placed(symbol, symbol.fields | {"Reference": "TP", "Value": net}, (net,))


def _placed(symbol: Symbol, fields: dict[str, str], nets: tuple[str, ...]) -> _Item:
    """An item with the room that its pins, labels and texts take."""
    left, right, up, down = 1, 1, 1, 1
    for (x, y, side), net in zip(symbol.ends, nets, strict=True):
        label = 2 if net == "0" else ceil(_LETTER * len(net)) + 2
        left = max(left, -x + (label if side == "left" else 0))
        right = max(right, x + (label if side == "right" else 0))
        up = max(up, y + (label if side == "top" else 0))
        down = max(down, -y + (label if side == "bottom" else 0))
    longest = max(len(fields["Value"]), len(fields["Reference"]))
    right = max(right, ceil(symbol.text[0] / GRID + _LETTER * longest))
    up = max(up, ceil(symbol.text[1] / GRID) + 2)
    return _Item(symbol, fields, nets, (left, right, up, down))


def _rows(items: Iterable[_Item], width: int) -> Iterator[_Put]:
    """Items from left to right, row below row, in the order of the deck."""
    x, y, row = MARGIN, MARGIN, list[_Item]()

    def flush() -> Iterator[_Put]:
        at, top = MARGIN, max(item.reach[2] for item in row)
        for item in row:
            yield _Put(item, at + item.reach[0], y + top)
            at += item.reach[0] + item.reach[1] + 2

    for item in items:
        needed = item.reach[0] + item.reach[1] + 2
        if row and x + needed > width:
            yield from flush()
            y += max(i.reach[2] for i in row) + max(i.reach[3] for i in row) + 2
            x, row = MARGIN, []
        row.append(item)
        x += needed
    if row:
        yield from flush()


def _sheet(
    name: str, title: str, items: list[_Item], commands: list[str], plain: dict[str, Symbol]
) -> str:
    sheet = _uuid(name, "sheet")
    counted = [
        replace(item, fields=item.fields | {"Reference": f"TP{k}"})
        if item.symbol.name == "PROBE"
        else item
        for k, item in enumerate(items, 1)
    ]
    for width in _ENOUGH:
        puts = list(_rows(counted, width))
        bottom = max(put.y + put.item.reach[3] for put in puts) + 3
        right = GRID * (max(put.x + put.item.reach[1] for put in puts) + MARGIN // 2)
        height = GRID * (bottom + len(commands)) + _STAMP
        paper = next((p for p, (w, h) in _PAPERS.items() if right <= w and height <= h), "A0")
        if paper in _ENOUGH[width]:
            break
    marks = list(_marks(puts, plain))
    texts = [_text(line, MARGIN, bottom + k, name) for k, line in enumerate(commands)]
    used = {put.item.symbol.name: put.item.symbol for put in [*puts, *marks]}
    return write(
        (
            "kicad_sch",
            *HEAD,
            ("uuid", sheet),
            ("paper", paper),
            ("title_block", ("title", name), ("comment", 1, shorten(title, _COMMENT))),
            ("lib_symbols", *(s.definition(f"{LIBRARY}:{s.name}") for s in used.values())),
            *(_label(*label, name) for put in puts for label in _labels(put)),
            *texts,
            *(_symbol(put, name, sheet) for put in [*puts, *marks]),
            ("sheet_instances", ("path", "/", ("page", "1"))),
        )
    )


def _ends(put: _Put) -> Iterator[tuple[int, int, str, str]]:
    """Free ends on the sheet, where y points down: x, y, side, net."""
    for (x, y, side), net in zip(put.item.symbol.ends, put.item.nets, strict=True):
        yield put.x + x, put.y - y, side, net


def _labels(put: _Put) -> Iterator[tuple[int, int, str, str]]:
    return (end for end in _ends(put) if end[3] != "0")


_TURN = {"bottom": 0, "right": 90, "top": 180, "left": 270}


def _marks(puts: list[_Put], plain: dict[str, Symbol]) -> Iterator[_Put]:
    """Ground at every pin on node 0, turned away from the symbol, and one flag."""
    grounds = [end for put in puts for end in _ends(put) if end[3] == "0"]
    for k, (x, y, side, _) in enumerate(grounds, 1):
        symbol = plain["GND"]
        fields = symbol.fields | {"Reference": f"#PWR{k:02d}", "turn": str(_TURN[side])}
        yield _Put(_Item(symbol, fields, ("0",), (0, 0, 0, 0)), x, y)
    if grounds:
        # a place of its own, on a ground of its own
        for symbol, reference in ((plain["GND"], "#PWR00"), (plain["PWR_FLAG"], "#FLG01")):
            fields = symbol.fields | {"Reference": reference, "turn": "0"}
            yield _Put(_Item(symbol, fields, ("0",), (0, 0, 0, 0)), MARGIN - 2, MARGIN - 2)


def _symbol(put: _Put, name: str, sheet: str) -> Tree:
    symbol, fields = put.item.symbol, dict(put.item.fields)
    turn = int(fields.pop("turn", "0"))
    reference = fields["Reference"]
    x, y = GRID * put.x, GRID * put.y
    return (
        "symbol",
        ("lib_id", f"{LIBRARY}:{symbol.name}"),
        ("at", x, y, turn),
        ("unit", 1),
        ("exclude_from_sim", NO if symbol.simulated else YES),
        ("in_bom", NO),
        ("on_board", NO),
        ("dnp", NO),
        ("uuid", _uuid(name, reference)),
        *symbol.properties(fields, x, y, up=-1),
        *(
            ("pin", str(k), ("uuid", _uuid(name, reference, "pin", k)))
            for k in range(1, len(symbol.pins) + 1)
        ),
        (
            "instances",
            ("project", name, ("path", f"/{sheet}", ("reference", reference), ("unit", 1))),
        ),
    )


def _label(x: int, y: int, side: str, net: str, name: str) -> Tree:
    angle = {"right": 0, "top": 90, "left": 180, "bottom": 270}[side]
    justify = Word("right") if side in ("left", "bottom") else Word("left")
    return (
        "global_label",
        net,
        ("shape", Word("passive")),
        ("at", GRID * x, GRID * y, angle),
        ("effects", font(), ("justify", justify)),
        ("uuid", _uuid(name, "label", x, y)),
    )


def _text(text: str, x: int, y: int, name: str) -> Tree:
    left: Tree = ("justify", Word("left"), Word("bottom"))
    return (
        "text",
        text,
        ("exclude_from_sim", NO),
        ("at", GRID * x, GRID * y, 0),
        ("effects", font(), left),
        ("uuid", _uuid(name, "text", y)),
    )


def _settings(name: str) -> str:
    ngspice = {"meta": {"version": 0}, "model_mode": 0, "workbook_filename": f"{name}.wbk"}
    content = {
        "meta": {"filename": f"{name}.kicad_pro", "version": 1},
        "schematic": {"meta": {"version": 1}, "ngspice": ngspice},
        "sheets": [[_uuid(name, "sheet"), "Root"]],
        "text_variables": {},
    }
    return json.dumps(content, indent=2) + "\n"


def _workbook(deck: Deck, top: Scope, commands: list[str]) -> str:
    """KiCad's saved simulation set-up: the analysis and four node voltages of the deck's results,
    the first of every part before any second one."""
    analysis = next((c for c in commands if c.split()[0].lower() in _KINDS), "")
    kind = _KINDS.get(analysis.split()[0].lower() if analysis else "", "TRAN")
    found = {name: vector(text) for name, (text, _) in deck.vectors.items()}
    results = {n: t.names[0] for n, t in found.items() if t and t.quantity == "v"}
    first: dict[str, str] = {}
    for name, node in results.items():
        first.setdefault(name.partition(".")[0], node)
    nodes = [*first.values(), *results.values()]
    present = {node.lower(): node for part in top.elements for node in part.nodes}
    names = [present[n] for n in dict.fromkeys(nodes) if n in present][: len(_COLOURS)]
    gain = kind == "AC"
    traces = [
        {
            "color": colour,
            "signal": f"V({name})" + (" (gain)" if gain else ""),
            "trace_type": 521 if gain else 257,
        }
        for name, colour in zip(names, _COLOURS, strict=False)
    ]
    tab = {
        "analysis": kind,
        "commands": [analysis, ".kicad adjustpaths", ".save all"],
        "dottedSecondary": True,
        "margins": {"bottom": 45, "left": 70, "right": 70, "top": 30},
        "measurements": [],
        "showGrid": True,
        "traces": traces,
    }
    content = {
        "last_sch_text_sim_command": analysis,
        "tabs": [tab],
        "user_defined_signals": [],
        "version": 6,
    }
    return json.dumps(content, indent=2) + "\n"


_KINDS = {".tran": "TRAN", ".ac": "AC", ".dc": "DC", ".op": "OP"}


def _uuid(*what: object) -> str:
    """The same every time, so that a new export does not change the file."""
    return str(uuid5(NAMESPACE_URL, "kc2spice/" + "/".join(map(str, what))))
