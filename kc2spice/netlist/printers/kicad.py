"""KiCad: symbols of parts and elements, a deck as a project with its sheet and simulation.

Nets are joined by global labels, which carry the node names of the deck, so that a curve has the
same name in KiCad, in the deck and in the results. Formats: KiCad developer documentation,
S-expression symbol library and schematic, version 20231120, which releases 8, 9 and 10 read; their
text is ``templates/kicad.j2``.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from math import ceil
from textwrap import shorten
from types import SimpleNamespace
from uuid import NAMESPACE_URL, uuid5

from kc2spice.netlist.circuit import Directive, Element
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.expression import vector
from kc2spice.netlist.library import Subcircuit
from kc2spice.netlist.printers.ngspice import Printer
from kc2spice.netlist.printers.symbol_layout import Place, layout
from kc2spice.netlist.scope import GROUND, Scope, circuit
from kc2spice.netlist.spelling import render

GRID = 2.54  # mm, 100 mil
_SPICE = 'type="{}" model="{}" lib=""'  # an element whose value is as on its netlist card
LIBRARY = "kc2spice"
_POLES = (Place(1, "+", "top", 0, 2), Place(2, "-", "bottom", 0, -2))
_SPOTS = (
    Place(1, "out+", "right", 3, 1),
    Place(2, "out-", "right", 3, -1),
    Place(3, "in+", "left", -3, 1),
    Place(4, "in-", "left", -3, -1),
)
_ELEMENTS = {  # by letter: name, title, drawing
    "V": ("SOURCE", "voltage source", "voltage"),
    "I": ("CURRENT", "current source", "current"),
    "R": ("RESISTOR", "resistor", "bar"),
    "C": ("CAPACITOR", "capacitor", "plates"),
    "L": ("INDUCTOR", "inductor", "coil"),
    "F": ("CURRENT_BY_CURRENT", "current source controlled by a current", "current"),
    "H": ("VOLTAGE_BY_CURRENT", "voltage source controlled by a current", "voltage"),
    "B": ("BEHAVIOUR", "behavioural source", "ring"),
    "E": ("VOLTAGE_BY_VOLTAGE", "voltage source controlled by a voltage", "box"),
    "G": ("CURRENT_BY_VOLTAGE", "current source controlled by a voltage", "box"),
}
_MARKS = {  # reference, title, drawing, pin, where the text begins, kind of pin
    "GND": ("#PWR", "ground, node 0", "ground", Place(1, "GND", "top", 0, 0, 0.0), (0.0, -4.0),
            "power_in"),
    "PWR_FLAG": ("#FLG", "tells that ground is driven", "flag",
                 Place(1, "pwr", "bottom", 0, 0, 0.0), (0.0, 3.0), "power_out"),
    "PROBE": ("TP", "a net to be plotted", "probe", Place(1, "net", "bottom", 0, 0), (1.5, 2.4),
              "passive"),
}  # fmt: skip


@dataclass(frozen=True)
class Symbol:
    """A drawing with pins at ``places``; ``text`` is where reference and value begin, left to
    right, one above the other, ``half`` the half width and height [mm] of one drawn as a box."""

    name: str
    fields: dict[str, str]
    drawing: str
    places: tuple[Place, ...]
    text: tuple[float, float]
    half: tuple[float, float] = (0.0, 0.0)
    pins: str = "passive"
    simulated: bool = True
    named_pins: bool = False


def symbol_library(symbols: Iterable[Symbol]) -> str:
    """A symbol library."""
    return render("kicad.j2", symbols=list(symbols), grid=GRID, sheet=None)


def part_symbol(part: Subcircuit) -> Symbol:
    """The symbol of one of our parts. Its parameters keep the defaults of the library, digit for
    digit, until the user gives some in ``Sim.Params``."""
    box = layout(part)
    fields = _fields("X", part.name, part.title) | {
        "Sim.Device": "SUBCKT",
        "Sim.Library": part.filename,
        "Sim.Name": part.name,
        "Sim.Pins": " ".join(f"{place.number}={place.name}" for place in box.places),
    }
    x, y = GRID * box.width, GRID * box.height
    return Symbol(part.name, fields, "box", box.places, (-x, y + 1.3), (x, y), named_pins=True)


def element_symbols() -> dict[str, Symbol]:
    """Symbols of plain elements by letter, and ``GND``, ``PWR_FLAG`` and ``PROBE``.

    Values are written as in a netlist (``Sim.Device`` ``SPICE``), so no digit is lost.
    """
    result = {}
    for letter, (name, title, drawing) in _ELEMENTS.items():
        box = drawing == "box"
        places = _SPOTS if box else _POLES
        fields = _fields(letter, name, title) | {
            "Sim.Device": "SPICE",
            "Sim.Params": _SPICE.format(letter, "0"),
            "Sim.Pins": " ".join(f"{p.number}={p.number}" for p in places),
        }
        side = 2 * GRID
        text = (-side, side + 1.3) if box else (GRID + 0.8, -0.9)
        result[letter] = Symbol(name, fields, drawing, places, text, (side, side), named_pins=box)
    for name, (reference, title, drawing, place, text, pins) in _MARKS.items():
        fields, simulated = _fields(reference, name, title), name != "PROBE"
        mark = Symbol(name, fields, drawing, (place,), text, pins=pins, simulated=simulated)
        result[name] = mark
    return result


def _fields(reference: str, value: str, description: str) -> dict[str, str]:
    fields = {"Reference": reference, "Value": value, "Footprint": "", "Datasheet": ""}
    return fields | {"Description": description}


# --- a deck as a project ---

_TURN = {
    "bottom": 0,
    "right": 90,
    "top": 180,
    "left": 270,
}  # angle of a ground, away from the symbol
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
_OURS = frozenset({".save", ".print", ".meas", ".end", ".include", ".inc"})
_KINDS = {".tran": "TRAN", ".ac": "AC", ".dc": "DC", ".op": "OP"}
_COLOURS = ("rgb(228, 26, 28)", "rgb(55, 126, 184)", "rgb(77, 175, 74)", "rgb(152, 78, 163)")


@dataclass(frozen=True)
class _Item:
    """A symbol on the sheet at a grid position, its fields and nets; ``reach`` is left, right, up,
    down in units."""

    symbol: Symbol
    fields: dict[str, str]
    nets: tuple[str, ...]
    reach: tuple[int, int, int, int] = (0, 0, 0, 0)
    x: int = 0
    y: int = 0
    turn: int = 0

    @property
    def ends(self) -> Iterator[tuple[int, int, str, str]]:
        """Free ends on the sheet, where y points down: x, y, side, net."""
        for place, net in zip(self.symbol.places, self.nets, strict=True):
            yield self.x + place.x, self.y - place.y, place.side, net


def project(deck: Deck) -> dict[str, str]:
    """``{file name: text}`` of a KiCad project that shows and simulates ``deck``.

    ``NAME.kicad_pro`` opens it; the sheet runs with the deck's own analysis and options, and the
    exported netlist gives the deck's results.

    Raises
    ------
    UsageError : the deck instantiates a subcircuit that none of its files defines.
    """
    top = circuit(deck.located[deck.main], deck.located, deck.main)
    plain = element_symbols()
    drawn = {part.name.lower(): part_symbol(part) for part in deck.parts}
    items = [_item(element, drawn, plain) for element in top.elements]
    counts = Counter(chain.from_iterable(item.nets for item in items))
    for net in [net for net, count in counts.items() if count == 1]:
        if net in GROUND:
            continue
        fields = {"Reference": f"TP{len(items) + 1}", "Value": net}
        items.append(_placed(plain["PROBE"], plain["PROBE"].fields | fields, (net,)))
    title = deck.title.removeprefix(f"{deck.name}: ")
    sources = {e.key: _reference(e.name) for e in top.elements}
    commands = [
        " ".join(_renamed(word, sources) for word in Printer().card(card).split())
        for card in top.commands
        if not (isinstance(card, Directive) and card.keyword in _OURS)
    ]
    used = [*drawn.values(), *{s.name: s for s in plain.values()}.values()]
    return {
        f"{deck.name}.kicad_sch": _sheet(deck.name, title, items, commands, plain),
        f"{deck.name}.kicad_pro": render(
            "kicad_project.j2", name=deck.name, sheet=_uuid(deck.name, "sheet")
        ),
        f"{deck.name}.wbk": _workbook(deck, top, commands),
        f"{LIBRARY}.kicad_sym": symbol_library(used),
        "sym-lib-table": (
            "(sym_lib_table\n\t(version 7)\n"
            f'\t(lib (name "{LIBRARY}")(type "KiCad")(uri "${{KIPRJMOD}}/{LIBRARY}.kicad_sym")'
            '(options "")(descr "parts of this project"))\n)\n'
        ),
    }


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
    parameters = " ".join(f"{k}={v}" for k, v in element.parameters.items())
    if letter == "X":
        symbol = parts.get(element.model.lower())
        if symbol is None or len(symbol.places) != len(nets):
            raise element.error("no such subcircuit", element.model)
        fields = symbol.fields | ({"Sim.Params": parameters} if parameters else {})
        return _placed(symbol, fields | {"Reference": name}, nets)
    symbol = plain.get(letter)
    if symbol is None or len(symbol.places) != len(nets):
        known = ", ".join(sorted(k for k in plain if len(k) == 1))
        raise element.error(
            "the sheet has no symbol for this card", expected=f"one of {known} or X"
        )
    law = Printer().law(element) if element.quantity else ""
    words = (*map(_reference, element.sources), *element.values, parameters, law)
    value = " ".join(filter(None, words))
    fields = symbol.fields | {
        "Reference": name,
        "Value": f"{_short_text(value)} {element.unit}".rstrip(),
        "Sim.Params": _SPICE.format(letter, value),
    }
    return _placed(symbol, fields, nets)


def _short_text(value: str) -> str:
    """A value to be read: six digits, one short line; ``Sim.Params`` has it all."""
    short = _NUMBER.sub(lambda number: f"{float(number[0]):.6g}", value)
    return short if len(short) <= _VALUE else short[: _VALUE - 2].rpartition(" ")[0] + " …"


def _placed(symbol: Symbol, fields: dict[str, str], nets: tuple[str, ...]) -> _Item:
    """An item with the room that its pins, labels and texts take."""
    room = {"left": 1, "right": 1, "top": 1, "bottom": 1}
    for place, net in zip(symbol.places, nets, strict=True):
        label = 2 if net == "0" else ceil(_LETTER * len(net)) + 2
        out = {"left": -place.x, "right": place.x, "top": place.y, "bottom": -place.y}
        for side, far in out.items():
            room[side] = max(room[side], far + (label if side == place.side else 0))
    longest = max(len(fields["Value"]), len(fields["Reference"]))
    right = max(room["right"], ceil(symbol.text[0] / GRID + _LETTER * longest))
    up = max(room["top"], ceil(symbol.text[1] / GRID) + 2)
    return _Item(symbol, fields, nets, (room["left"], right, up, room["bottom"]))


def _rows(items: Iterable[_Item], width: int) -> Iterator[_Item]:
    rows: list[list[tuple[int, _Item]]] = []
    x = width
    for item in items:
        needed = item.reach[0] + item.reach[1] + 2
        if not rows or x + needed > width:
            rows.append([])
            x = MARGIN
        rows[-1].append((x + item.reach[0], item))
        x += needed
    y = MARGIN
    for row in rows:
        top, below = (max(item.reach[k] for _, item in row) for k in (2, 3))
        yield from (replace(item, x=x, y=y + top) for x, item in row)
        y += top + below + 2


def _ends(items: Iterable[_Item]) -> Iterator[tuple[int, int, str, str]]:
    """Yield the free ends of all symbols on the sheet: x, y, side and net of each."""
    for item in items:
        yield from item.ends


def _sheet(
    name: str, title: str, items: list[_Item], commands: list[str], plain: dict[str, Symbol]
) -> str:
    for width in _ENOUGH:
        placed = list(_rows(items, width))
        bottom = max(item.y + item.reach[3] for item in placed) + 3
        right = GRID * (max(item.x + item.reach[1] for item in placed) + MARGIN // 2)
        height = GRID * (bottom + len(commands)) + _STAMP
        paper = next((p for p, (w, h) in _PAPERS.items() if right <= w and height <= h), "A0")
        if paper in _ENOUGH[width]:
            break
    every = [*placed, *_grounds(placed, plain)]
    sheet = SimpleNamespace(
        paper=paper,
        labels=[end for end in _ends(placed) if end[3] != "0"],
        texts=[(line, MARGIN, bottom + k) for k, line in enumerate(commands)],
        items=every,
    )
    return render(
        "kicad.j2",
        sheet=sheet,
        symbols=list({item.symbol.name: item.symbol for item in every}.values()),
        grid=GRID,
        name=name,
        title=shorten(title, _COMMENT),
        uuid=partial(_uuid, name),
    )


def _grounds(items: list[_Item], plain: dict[str, Symbol]) -> Iterator[_Item]:
    """Ground at every pin on node 0, turned away from the symbol, and one flag."""
    grounds = [end for end in _ends(items) if end[3] == "0"]
    rows = [("GND", f"#PWR{k:02d}", *end[:2], _TURN[end[2]]) for k, end in enumerate(grounds, 1)]
    if grounds:  # a place of its own, on a ground of its own
        corner = (MARGIN - 2, MARGIN - 2, 0)
        rows += [("GND", "#PWR00", *corner), ("PWR_FLAG", "#FLG01", *corner)]
    for mark, reference, *place in rows:
        fields = plain[mark].fields | {"Reference": reference}
        yield _Item(plain[mark], fields, ("0",), (0, 0, 0, 0), *place)


def _workbook(deck: Deck, top: Scope, commands: list[str]) -> str:
    """KiCad's saved simulation set-up: the analysis and four node voltages of the deck's results,
    the first of every part before any second one."""
    analysis = next((c for c in commands if c.split()[0].lower() in _KINDS), "")
    kind = _KINDS.get(analysis.split()[0].lower() if analysis else "", "TRAN")
    result = {name: vector(text) for name, (text, _) in deck.vectors.items()}
    results = {n: t.names[0] for n, t in result.items() if t and t.quantity == "v"}
    first: dict[str, str] = {}
    for name, node in results.items():
        first.setdefault(name.partition(".")[0], node)
    nodes = [*first.values(), *results.values()]
    present = {node.lower(): node for part in top.elements for node in part.nodes}
    names = [present[n] for n in dict.fromkeys(nodes) if n in present][: len(_COLOURS)]
    traces = list(zip(names, _COLOURS, strict=False))
    return render("kicad_workbook.j2", analysis=analysis, kind=kind, traces=traces)


def _uuid(*what: object) -> str:
    """The same every time, so that a new export does not change the file."""
    return str(uuid5(NAMESPACE_URL, "kc2spice/" + "/".join(map(str, what))))
