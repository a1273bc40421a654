"""KiCad symbols of parts and elements, and KiCad projects of decks.

The symbols are arranged in rows. Wires join the pins of a net within one row, and global labels
join the nets of different rows. The nets have the node names of the deck, so a curve has the same
name in KiCad, the deck and the results. Symbol libraries and schematics have the file format
20231120, which KiCad 8, 9 and 10 read (KiCad developer documentation). The template
``templates/kicad.j2`` writes the files.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, pairwise
from math import ceil
from operator import attrgetter, itemgetter
from textwrap import shorten
from types import SimpleNamespace
from uuid import NAMESPACE_URL, uuid5

from kc2spice.netlist.circuit import Directive, Element
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.expression import parse_vector
from kc2spice.netlist.name_scopes import GROUND_NAMES, Scope, build_scope
from kc2spice.netlist.number_and_name_spelling import render_template
from kc2spice.netlist.printers.ngspice import Printer
from kc2spice.netlist.printers.symbol_layout import SymbolPin, arrange_pins
from kc2spice.netlist.subcircuit_library import Subcircuit

GRID = 2.54  # mm, 100 mil
# text of the field Sim.Params of an element, which contains the values of the netlist card
_SPICE_FIELD = 'type="{}" model="{}" lib=""'
LIBRARY = "kc2spice"
_POLE_PINS = (SymbolPin(1, "+", "top", 0, 2), SymbolPin(2, "-", "bottom", 0, -2))
_CONTROLLED_SOURCE_PINS = (
    SymbolPin(1, "out+", "right", 3, 1),
    SymbolPin(2, "out-", "right", 3, -1),
    SymbolPin(3, "in+", "left", -3, 1),
    SymbolPin(4, "in-", "left", -3, -1),
)
_ELEMENT_SYMBOLS = {  # name, title and drawing of each symbol, keyed by element letter
    "V": ("SOURCE", "voltage source", "voltage"),
    "I": ("CURRENT", "current source", "current"),
    "R": ("RESISTOR", "resistor", "bar"),
    "C": ("CAPACITOR", "capacitor", "plates"),
    "L": ("INDUCTOR", "inductor", "coil"),
    "F": ("CURRENT_BY_CURRENT", "current-controlled current source", "current"),
    "H": ("VOLTAGE_BY_CURRENT", "current-controlled voltage source", "voltage"),
    "B": ("BEHAVIOUR", "behavioural source", "ring"),
    "E": ("VOLTAGE_BY_VOLTAGE", "voltage-controlled voltage source", "box"),
    "G": ("CURRENT_BY_VOLTAGE", "voltage-controlled current source", "box"),
}
# KiCad symbols that are no netlist elements, keyed by symbol name.
# Each tuple contains reference, title, drawing, pin, text position and electrical type of the pin.
_MARK_SYMBOLS = {
    "GND": ("#PWR", "ground, node 0", "ground", SymbolPin(1, "GND", "top", 0, 0, 0.0), (0.0, -4.0),
            "power_in"),
    "PWR_FLAG": ("#FLG", "power flag: marks ground as driven", "flag",
                 SymbolPin(1, "pwr", "bottom", 0, 0, 0.0), (0.0, 3.0), "power_out"),
    "PROBE": ("TP", "a net to be plotted", "probe", SymbolPin(1, "net", "bottom", 0, 0), (1.5, 2.4),
              "passive"),
}  # fmt: skip


@dataclass(frozen=True)
class Symbol:
    """KiCad symbol with a drawing, text fields and pins.

    ``places`` contains the pins. The texts of reference and value start at the position ``text``,
    one below the other. For a symbol that is a box, ``half`` contains half the width and half the
    height [mm].
    """

    name: str
    fields: dict[str, str]
    drawing: str
    places: tuple[SymbolPin, ...]
    text: tuple[float, float]
    half: tuple[float, float] = (0.0, 0.0)
    pins: str = "passive"
    simulated: bool = True
    named_pins: bool = False


def format_symbol_library(symbols: Iterable[Symbol]) -> str:
    """Return the text of a KiCad symbol library with several symbols."""
    return render_template("kicad.j2", symbols=list(symbols), grid=GRID, sheet=None)


def draw_part_symbol(part: Subcircuit) -> Symbol:
    """Return the KiCad symbol of a part.

    The user can change the parameters in the field ``Sim.Params``, where their defaults have the
    same digits as in the library.
    """
    box = arrange_pins(part)
    fields = _make_standard_fields("X", part.name, part.title) | {
        "Sim.Device": "SUBCKT",
        "Sim.Library": part.filename,
        "Sim.Name": part.name,
        "Sim.Pins": " ".join(f"{place.number}={place.name}" for place in box.places),
    }
    x, y = GRID * box.width, GRID * box.height
    return Symbol(part.name, fields, "box", box.places, (-x, y + 1.3), (x, y), named_pins=True)


def make_element_symbols() -> dict[str, Symbol]:
    """Return the symbols of elements, and of marks such as ``GND``, keyed by letter.

    The text fields contain the values in netlist syntax with all digits (``Sim.Device`` is
    ``SPICE``).
    """
    result = {}
    for letter, (name, title, drawing) in _ELEMENT_SYMBOLS.items():
        box = drawing == "box"
        places = _CONTROLLED_SOURCE_PINS if box else _POLE_PINS
        fields = _make_standard_fields(letter, name, title) | {
            "Sim.Device": "SPICE",
            "Sim.Params": _SPICE_FIELD.format(letter, "0"),
            "Sim.Pins": " ".join(f"{p.number}={p.number}" for p in places),
        }
        side = 2 * GRID
        text = (-side, side + 1.3) if box else (GRID + 0.8, -0.9)
        result[letter] = Symbol(name, fields, drawing, places, text, (side, side), named_pins=box)
    for name, (reference, title, drawing, place, text, pins) in _MARK_SYMBOLS.items():
        fields, simulated = _make_standard_fields(reference, name, title), name != "PROBE"
        mark = Symbol(name, fields, drawing, (place,), text, pins=pins, simulated=simulated)
        result[name] = mark
    return result


def _make_standard_fields(reference: str, value: str, description: str) -> dict[str, str]:
    """Return the standard fields of a symbol."""
    fields = {"Reference": reference, "Value": value, "Footprint": "", "Datasheet": ""}
    return fields | {"Description": description}


# --- KiCad project of a deck ---

# Rotation [degrees] that points a ground symbol away from a part, keyed by the side of the part.
_GROUND_ANGLES = {
    "bottom": 0,
    "right": 90,
    "top": 180,
    "left": 270,
}
# Row widths [grid units] in the order in which they are tried, each with suitable paper sizes.
_ROW_WIDTHS = {105: ("A4",), 150: ("A4", "A3"), 220: ("A3", "A2"), 320: ("A2", "A1", "A0")}
SHEET_MARGIN = 10
_LETTER_WIDTH = 0.5  # grid units, average width of a letter
_PAPER_SIZES = {
    "A4": (297, 210), "A3": (420, 297), "A2": (594, 420), "A1": (841, 594), "A0": (1189, 841),
}  # fmt: skip
_TITLE_BLOCK_HEIGHT = 40  # mm, height of the title block at the bottom of a sheet
_MAX_COMMENT = 80  # characters of a line in the title block
_MAX_VALUE = 56  # characters of a value
_NUMBER = re.compile(r"(?<![\w.])\d+\.?\d*(?:e[-+]?\d+)?(?![\w.])")
_KICAD_COMMANDS = frozenset({".save", ".print", ".meas", ".end", ".include", ".inc"})
_ANALYSIS_KINDS = {".tran": "TRAN", ".ac": "AC", ".dc": "DC", ".op": "OP"}
_COLOURS = ("rgb(228, 26, 28)", "rgb(55, 126, 184)", "rgb(77, 175, 74)", "rgb(152, 78, 163)")


@dataclass(frozen=True)
class _PlacedSymbol:
    """Symbol at a grid position of the sheet, with its text fields and nets.

    ``reach`` contains the space that the symbol needs on the left, right, top and bottom, in grid
    units. The space on the left and right includes the vertical wires of the symbol. ``turn`` is
    the rotation angle of the symbol [degrees].
    """

    symbol: Symbol
    fields: dict[str, str]
    nets: tuple[str, ...]
    reach: tuple[int, int, int, int] = (0, 0, 0, 0)
    x: int = 0
    y: int = 0
    turn: int = 0

    @property
    def right_end(self) -> int:
        """Position of the right end of the symbol on the sheet."""
        return self.x + self.reach[1]

    @property
    def bottom(self) -> int:
        """Position of the lower end of the symbol on the sheet."""
        return self.y + self.reach[3]

    @property
    def pin_ends(self) -> Iterator[tuple[int, int, str, str]]:
        """Yield x, y (downwards), side and net of each pin end of the symbol."""
        for place, net in zip(self.symbol.places, self.nets, strict=True):
            yield self.x + place.x, self.y - place.y, place.side, net


def make_project(deck: Deck) -> dict[str, str]:
    """Return the files of a KiCad project for a deck as ``{file name: text}``.

    The user opens the file ``NAME.kicad_pro``. KiCad simulates the sheet with the analysis and the
    options of the deck. The netlist that KiCad exports has the same results as the deck.

    Raises
    ------
    UsageError : the deck instantiates a subcircuit that none of its files defines.
    """
    top = build_scope(
        deck.located_trees[deck.main_file_name], deck.located_trees, deck.main_file_name
    )
    symbols = make_element_symbols()
    drawn = {part.name.lower(): draw_part_symbol(part) for part in deck.parts}
    items = [_draw_element(element, drawn, symbols) for element in top.elements]
    counts = Counter(chain.from_iterable(map(attrgetter("nets"), items)))
    for net, count in counts.items():
        if count == 1 and net not in GROUND_NAMES:
            fields = {"Reference": f"TP{len(items) + 1}", "Value": net}
            items.append(_reserve_room(symbols["PROBE"], symbols["PROBE"].fields | fields, (net,)))
    title = deck.title.removeprefix(f"{deck.name}: ")
    commands = list(_list_simulation_commands(top))
    used = [*drawn.values(), *_remove_repeated_symbols(symbols.values())]
    return {
        f"{deck.name}.kicad_sch": _draw_sheet(deck.name, title, items, commands, symbols),
        f"{deck.name}.kicad_pro": render_template(
            "kicad_project.j2", name=deck.name, sheet=_make_uuid(deck.name, "sheet")
        ),
        f"{deck.name}.wbk": _write_workbook(deck, top, commands),
        f"{LIBRARY}.kicad_sym": format_symbol_library(used),
        "sym-lib-table": (
            "(sym_lib_table\n\t(version 7)\n"
            f'\t(lib (name "{LIBRARY}")(type "KiCad")(uri "${{KIPRJMOD}}/{LIBRARY}.kicad_sym")'
            '(options "")(descr "parts of this project"))\n)\n'
        ),
    }


def _list_simulation_commands(top: Scope) -> Iterator[str]:
    """List the deck's simulation commands; name elements as in the KiCad schematic."""
    sources = {key: _add_reference_number(item.name) for key, item in top.elements_by_key.items()}
    for card in top.commands:
        if not (isinstance(card, Directive) and card.keyword in _KICAD_COMMANDS):
            words = Printer().card(card).split()
            yield " ".join(_replace_element_names(word, sources) for word in words)


def _remove_repeated_symbols(symbols: Iterable[Symbol]) -> list[Symbol]:
    """Return symbols with unique names; the last symbol with each name is kept."""
    return list({symbol.name: symbol for symbol in symbols}.values())


def _add_reference_number(name: str) -> str:
    """Return a name that ends with a number, as KiCad requires of references."""
    return name if name[-1].isdigit() else f"{name}1"


def _replace_element_names(word: str, references: Mapping[str, str]) -> str:
    """Replace the element name in a word of a command by its reference in KiCad."""
    if word.lower() in references:
        return references[word.lower()]
    head, dot, rest = word.partition(".")
    opening, bracket, instance = head.rpartition("(")
    name = references.get(instance.lower(), instance) if dot and bracket else instance
    return f"{opening}{bracket}{name}{dot}{rest}"


def _draw_element(
    element: Element, parts: dict[str, Symbol], symbols: dict[str, Symbol]
) -> _PlacedSymbol:
    """Return the symbol on the sheet that represents an element.

    Raises
    ------
    UsageError : a subcircuit is unknown, or an element has no symbol.
    """
    letter, name = element.name[0].upper(), _add_reference_number(element.name)
    nets = tuple("0" if node.lower() in GROUND_NAMES else node for node in element.nodes)
    parameters = " ".join(map("=".join, element.parameters.items()))
    if letter == "X":
        symbol = parts.get(element.model.lower())
        if symbol is None or len(symbol.places) != len(nets):
            raise element.make_error("no such subcircuit", element.model)
        fields = symbol.fields | ({"Sim.Params": parameters} if parameters else {})
        return _reserve_room(symbol, fields | {"Reference": name}, nets)
    symbol = symbols.get(letter)
    if symbol is None or len(symbol.places) != len(nets):
        known = ", ".join(sorted(_ELEMENT_SYMBOLS))
        raise element.make_error(
            "the sheet has no symbol for this card", expected=f"one of {known} or X"
        )
    law = Printer().format_law(element) if element.quantity else ""
    words = (*map(_add_reference_number, element.sources), *element.values, parameters, law)
    value = " ".join(filter(None, words))
    fields = symbol.fields | {
        "Reference": name,
        "Value": f"{_shorten_value(value)} {element.unit}".rstrip(),
        "Sim.Params": _SPICE_FIELD.format(letter, value),
    }
    return _reserve_room(symbol, fields, nets)


def _shorten_value(value: str) -> str:
    """Return a value with six digits for the sheet; ``Sim.Params`` has all digits."""
    short = _NUMBER.sub(lambda number: f"{float(number[0]):.6g}", value)
    return short if len(short) <= _MAX_VALUE else short[: _MAX_VALUE - 2].rpartition(" ")[0] + " …"


def _reserve_room(symbol: Symbol, fields: dict[str, str], nets: tuple[str, ...]) -> _PlacedSymbol:
    """Return a placed symbol that reserves the space for its pins and texts."""
    room = {"left": 1, "right": 1, "top": 1, "bottom": 1}
    for place, net in zip(symbol.places, nets, strict=True):
        label = _compute_label_length(net) + (len(nets) if place.side in ("left", "right") else 0)
        out = {"left": -place.x, "right": place.x, "top": place.y, "bottom": -place.y}
        for side, far in out.items():
            room[side] = max(room[side], far + (label if side == place.side else 0))
    longest = max(len(fields["Value"]), len(fields["Reference"]))
    right = max(room["right"], ceil(symbol.text[0] / GRID + _LETTER_WIDTH * longest))
    up = max(room["top"], ceil(symbol.text[1] / GRID) + 2)
    return _PlacedSymbol(symbol, fields, nets, (room["left"], right, up, room["bottom"]))


def _compute_label_length(net: str) -> int:
    """Return the label length [grid units] of a net, or the length of a ground symbol."""
    return 2 if net == "0" else ceil(_LETTER_WIDTH * len(net)) + 2


def _split_rows(items: Iterable[_PlacedSymbol], width: int) -> list[list[_PlacedSymbol]]:
    """Split symbols into rows of limited width, and set their x positions."""
    items = list(items)
    longest = max(map(_compute_label_length, chain.from_iterable(map(attrgetter("nets"), items))))
    start = max(SHEET_MARGIN, longest + SHEET_MARGIN // 2)
    rows: list[list[_PlacedSymbol]] = []
    x = width
    for item in items:
        needed = item.reach[0] + item.reach[1] + 2
        if not rows or x + needed > width:
            rows.append([])
            x = start
        rows[-1].append(replace(item, x=x + item.reach[0]))
        x += needed
    return rows


def _stack_rows(
    items: Iterable[_PlacedSymbol], width: int
) -> tuple[list[_PlacedSymbol], list[_Track]]:
    """Stack rows of symbols; return the placed symbols and the horizontal wires."""
    placed: list[_PlacedSymbol] = []
    tracks: list[_Track] = []
    y = SHEET_MARGIN
    for row in _split_rows(items, width):
        _, _, ups, downs = zip(*map(attrgetter("reach"), row), strict=True)
        above = len(_find_shared_nets(row, upwards=True))
        y += above + max(ups)
        row = [replace(item, y=y) for item in row]
        tracks += _assign_tracks(row, y - max(ups) - 1, upwards=True)
        below = _assign_tracks(row, y + max(downs) + 1, upwards=False)
        tracks += below
        placed += row
        y += max(downs) + len(below) + 2
    return placed, tracks


@dataclass(frozen=True)
class _Track:
    """Horizontal wire of a net in the schematic, which joins pin ends.

    Each pin end at ``(x, y)`` has a column: the x position of the vertical wire between pin end and
    track.
    """

    net: str
    y: int
    pins: tuple[tuple[int, int], ...]
    columns: tuple[int, ...]

    @property
    def label(self) -> tuple[int, int, str, str]:
        """Position, side and net name of the label at the left end of the track."""
        return min(self.columns) - 1, self.y, "left", self.net

    @property
    def wire_junctions(self) -> Iterator[tuple[int, int]]:
        """Yield the points at which three wires meet."""
        for column in sorted(self.columns)[:-1]:
            yield column, self.y

    @property
    def wire_segments(self) -> Iterator[tuple[int, int, int, int]]:
        """Wire segments of a net: from each pin to the horizontal track, and the track."""
        for (x, y), column in zip(self.pins, self.columns, strict=True):
            if column != x:
                yield x, y, column, y
            yield column, y, column, self.y
        for left, right in pairwise((min(self.columns) - 1, *sorted(self.columns))):
            yield left, self.y, right, self.y


def _list_channel_ends(
    row: Iterable[_PlacedSymbol], upwards: bool
) -> list[tuple[int, int, str, str]]:
    """List pin ends that lead from a symbol row to the wiring channel above or below."""
    return [end for end in _list_pin_ends(row) if (end[2] == "top") == upwards]


def _find_shared_nets(row: Iterable[_PlacedSymbol], upwards: bool) -> frozenset[str]:
    """Return the nets, except ground, with several pin ends in one wiring channel."""
    counts = Counter(net for _, _, _, net in _list_channel_ends(row, upwards))
    return frozenset(net for net, count in counts.items() if count > 1) - {"0"}


def _assign_tracks(row: Iterable[_PlacedSymbol], y: int, upwards: bool) -> list[_Track]:
    """Return the tracks (horizontal wires) of a wiring channel that begins at ``y``.

    The track of the net with the leftmost first pin is next to the row. With this order, no wire
    crosses the label of another track.
    """
    shared = _find_shared_nets(row, upwards)
    ends: dict[str, dict[tuple[int, int], int]] = {net: {} for net in shared}
    for item in row:
        columns = _choose_columns(item, shared)
        for x, height, _, net in _list_channel_ends([item], upwards):
            if net in shared:
                ends[net][x, height] = columns[x, height]
    step = -1 if upwards else 1
    ordered = sorted(ends.items(), key=lambda entry: min(entry[1].values()))
    return [
        _Track(net, y + step * k, tuple(pins), tuple(pins.values()))
        for k, (net, pins) in enumerate(ordered)
    ]


def _choose_columns(item: _PlacedSymbol, shared: Container[str]) -> dict[tuple[int, int], int]:
    """Choose the grid column of the vertical wire at each pin end of a symbol.

    The keys of the returned dictionary are the positions (x, y) of the pin ends. On each side of a
    symbol, the wire of the lowest pin is in the column next to the symbol. On each side, the
    vertical wire of a pin is farther from the symbol than the wires and labels of all lower pins.
    """
    result = {}
    for side, outwards in (("left", -1), ("right", 1), ("top", 0), ("bottom", 0)):
        occupied = 0
        ends = (end for end in item.pin_ends if end[2] == side)
        for x, y, _, net in sorted(ends, key=itemgetter(1), reverse=True):
            if net in shared:
                occupied += 1
                result[x, y] = x + outwards * occupied
            else:
                occupied = max(occupied, _compute_label_length(net))
    return result


def _list_pin_ends(items: Iterable[_PlacedSymbol]) -> Iterator[tuple[int, int, str, str]]:
    """Yield x, y, side and net of all pin ends on the sheet."""
    for item in items:
        yield from item.pin_ends


def _draw_sheet(
    name: str,
    title: str,
    items: list[_PlacedSymbol],
    commands: list[str],
    symbols: dict[str, Symbol],
) -> str:
    """Return the text of the schematic, on the smallest suitable paper size."""
    for width in _ROW_WIDTHS:
        placed, tracks = _stack_rows(items, width)
        heights = chain(map(attrgetter("bottom"), placed), map(attrgetter("y"), tracks))
        bottom = max(heights) + 3
        right = GRID * (max(map(attrgetter("right_end"), placed)) + SHEET_MARGIN // 2)
        paper = _choose_paper(right, GRID * (bottom + len(commands)) + _TITLE_BLOCK_HEIGHT)
        if paper in _ROW_WIDTHS[width]:
            break
    all_items = [*placed, *_draw_grounds(placed, symbols)]
    wired = frozenset(chain.from_iterable(map(attrgetter("pins"), tracks)))
    single = [end for end in _list_pin_ends(placed) if end[3] != "0" and end[:2] not in wired]
    sheet = SimpleNamespace(
        paper=paper,
        labels=[*single, *map(attrgetter("label"), tracks)],
        wires=list(chain.from_iterable(map(attrgetter("wire_segments"), tracks))),
        junctions=list(chain.from_iterable(map(attrgetter("wire_junctions"), tracks))),
        texts=[(line, SHEET_MARGIN, bottom + k) for k, line in enumerate(commands)],
        items=all_items,
    )
    return render_template(
        "kicad.j2",
        sheet=sheet,
        symbols=_remove_repeated_symbols(map(attrgetter("symbol"), all_items)),
        grid=GRID,
        name=name,
        title=shorten(title, _MAX_COMMENT),
        uuid=partial(_make_uuid, name),
    )


def _choose_paper(width: float, height: float) -> str:
    """Return the smallest suitable paper for a size [mm]; A0 for larger drawings."""
    for paper, (available_width, available_height) in _PAPER_SIZES.items():
        if width <= available_width and height <= available_height:
            return paper
    return "A0"


def _draw_grounds(
    items: list[_PlacedSymbol], symbols: dict[str, Symbol]
) -> Iterator[_PlacedSymbol]:
    """Yield a ground symbol at every pin on node 0, and one power flag."""
    count = 0
    for x, y, side, net in _list_pin_ends(items):
        if net == "0":
            count += 1
            yield _make_ground_mark(symbols["GND"], f"#PWR{count:02d}", x, y, _GROUND_ANGLES[side])
    if count:  # the power flag is in a corner, on a separate ground symbol
        corner = SHEET_MARGIN - 2, SHEET_MARGIN - 2
        yield _make_ground_mark(symbols["GND"], "#PWR00", *corner)
        yield _make_ground_mark(symbols["PWR_FLAG"], "#FLG01", *corner)


def _make_ground_mark(
    symbol: Symbol, reference: str, x: int, y: int, turn: int = 0
) -> _PlacedSymbol:
    """Return a ground symbol or flag at a position, rotated by an angle [degrees]."""
    fields = symbol.fields | {"Reference": reference}
    return _PlacedSymbol(symbol, fields, ("0",), x=x, y=y, turn=turn)


def _write_workbook(deck: Deck, top: Scope, commands: list[str]) -> str:
    """Return KiCad's simulation workbook, which plots at most four node voltages.

    If possible, the selected voltages belong to different parts.
    """
    analyses = (line for line in commands if line.split()[0].lower() in _ANALYSIS_KINDS)
    analysis = next(analyses, "")
    kind = _ANALYSIS_KINDS[analysis.split()[0].lower()] if analysis else "TRAN"
    first: dict[str, str] = {}
    nodes = []
    for name, (text, _) in deck.vectors.items():
        trace = parse_vector(text)
        if trace and trace.quantity == "v":
            nodes.append(trace.names[0])
            first.setdefault(name.partition(".")[0], trace.names[0])
    spelled: dict[str, str] = {}
    for part in top.elements:
        spelled.update(zip(part.lower_case_nodes, part.nodes, strict=True))
    names = filter(None, map(spelled.get, dict.fromkeys([*first.values(), *nodes])))
    traces = list(zip(names, _COLOURS, strict=False))
    return render_template("kicad_workbook.j2", analysis=analysis, kind=kind, traces=traces)


def _make_uuid(*what: object) -> str:
    """Return an identifier that is the same in every export of an item."""
    return str(uuid5(NAMESPACE_URL, "kc2spice/" + "/".join(map(str, what))))
