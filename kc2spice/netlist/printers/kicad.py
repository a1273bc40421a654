"""KiCad symbol libraries and what stands in them besides our parts: sources, ground, a probe.

Format: KiCad developer documentation, S-expression symbol library format, version 20231120, which
releases 8, 9 and 10 read.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from kc2spice.netlist.printers.box import Box, Place

GRID = 2.54  # mm, 100 mil
TEXT = 1.27  # mm
VERSION = 20231120
LIBRARY = "kc2spice"


class Word(str):
    """A keyword; every other string is written in quotes."""


Tree = Sequence["Tree | str | float | int"]
YES, NO = Word("yes"), Word("no")
HEAD: tuple[Tree, ...] = (
    ("version", VERSION),
    ("generator", "kc2spice"),
    ("generator_version", "8.0"),
)
_LEFT: Tree = ("justify", Word("left"))
_STROKE: Tree = ("stroke", ("width", 0.254), ("type", Word("default")))
_FILL: Tree = ("fill", ("type", Word("none")))
_PAPER: Tree = ("fill", ("type", Word("background")))
_ANGLE = {"left": 0, "right": 180, "bottom": 90, "top": 270}  # from the free end to the body


@dataclass(frozen=True)
class Symbol:
    """A drawing with pins: ``ends`` are their free ends in grid units, y upwards, with their side.

    ``text`` is where reference and value begin, left to right, one above the other.
    """

    name: str
    fields: dict[str, str]
    drawing: tuple[Tree, ...]
    pins: tuple[Tree, ...]
    ends: tuple[tuple[int, int, str], ...]
    text: tuple[float, float]
    power: bool = False
    simulated: bool = True
    named_pins: bool = True

    def definition(self, name: str) -> Tree:
        """The symbol as a library holds it; a sheet embeds it under ``library:name``."""
        hidden = () if self.named_pins else (Word("hide"),)
        return (
            "symbol",
            name,
            *([("power",)] if self.power else []),
            ("pin_numbers", Word("hide")),
            ("pin_names", ("offset", 0.508), *hidden),
            ("exclude_from_sim", NO if self.simulated else YES),
            ("in_bom", NO),
            ("on_board", NO),
            *self.properties(self.fields, 0.0, 0.0, up=1),
            ("symbol", f"{self.name}_0_1", *self.drawing),
            ("symbol", f"{self.name}_1_1", *self.pins),
        )

    def properties(self, fields: dict[str, str], x: float, y: float, *, up: int) -> list[Tree]:
        """Fields of a symbol at ``(x, y)``; ``up`` is -1 on a sheet, where y points down."""
        left, top = self.text
        place = {"Value": (x + left, y + up * top), "Reference": (x + left, y + up * (top + 2.0))}
        trees: list[Tree] = []
        for key, text in fields.items():
            shown = key in place and not fields["Reference"].startswith("#")
            at = ("at", *place.get(key, (x, y)), 0)
            hide = [] if shown else [("hide", YES)]
            trees.append(("property", key, text, at, ("effects", font(), _LEFT, *hide)))
        return trees


def library(symbols: Iterable[Symbol]) -> str:
    """A symbol library."""
    return write(("kicad_symbol_lib", *HEAD, *(s.definition(s.name) for s in symbols)))


def part_symbol(box: Box) -> Symbol:
    """The symbol of one of our parts. Its parameters keep the defaults of the library, digit for
    digit, until the user gives some in ``Sim.Params``."""
    fields = _fields("X", box.name, box.title) | {
        "Sim.Device": "SUBCKT",
        "Sim.Library": box.library,
        "Sim.Name": box.name,
        "Sim.Pins": " ".join(f"{place.number}={place.pin.name}" for place in box.places),
    }
    x, y = GRID * box.width, GRID * box.height
    outline: Tree = ("rectangle", ("start", -x, y), ("end", x, -y), _STROKE, _PAPER)
    return Symbol(
        box.name,
        fields,
        _opamp_drawing() if box.triangle else (outline,),
        tuple(_pin(place) for place in box.places),
        tuple((p.x, p.y, p.side) for p in box.places),
        (GRID, y + 0.5) if box.triangle else (-x, y + 1.3),
        named_pins=not box.triangle,
    )


def _opamp_drawing() -> tuple[Tree, ...]:
    w = 2 * GRID
    corners = ((-w, w), (-w, -w), (w, 0.0), (-w, w))
    marks = (("+", -1.5, 1.0, TEXT), ("-", -1.5, -1.0, TEXT), ("ref", -1.35, -2.3, 0.8),
             ("vcc", 0.5, 1.3, 0.8), ("vee", 0.5, -1.3, 0.8))  # fmt: skip
    return (
        ("polyline", ("pts", *(("xy", x, y) for x, y in corners)), _STROKE, _PAPER),
        *(
            ("text", text, ("at", GRID * x, GRID * y, 0), ("effects", font(size)))
            for text, x, y, size in marks
        ),
    )


def element_symbols() -> dict[str, Symbol]:
    """Symbols of plain elements by letter, and ``GND``, ``PWR_FLAG`` and ``PROBE``.

    Values are written as in a netlist (``Sim.Device`` ``SPICE``), so no digit is lost.
    """
    bar: Tree = ("rectangle", ("start", -1.016, GRID), ("end", 1.016, -GRID), _STROKE, _FILL)
    ring: Tree = ("circle", ("center", 0.0, 0.0), ("radius", GRID), _STROKE, _FILL)
    plates = tuple(_line((-1.8, y), (1.8, y)) for y in (0.5, -0.5))
    leads = (_line((0.0, GRID), (0.0, 0.5)), _line((0.0, -GRID), (0.0, -0.5)))
    plus = (_line((-0.6, 1.3), (0.6, 1.3)), _line((0.0, 1.9), (0.0, 0.7)),
            _line((-0.6, -1.3), (0.6, -1.3)))  # fmt: skip
    arrow = (_line((0.0, 1.6), (0.0, -1.6), (-0.6, -0.6)), _line((0.0, -1.6), (0.6, -0.6)))
    titles = {
        "V": ("SOURCE", "voltage source", (ring, *plus)),
        "I": ("CURRENT", "current source", (ring, *arrow)),
        "R": ("RESISTOR", "resistor", (bar,)),
        "C": ("CAPACITOR", "capacitor", (*plates, *leads)),
        "L": ("INDUCTOR", "inductor", (bar, _line((0.0, GRID), (0.0, -GRID)))),
        "F": ("CURRENT_BY_CURRENT", "current source controlled by a current", (ring, *arrow)),
        "H": ("VOLTAGE_BY_CURRENT", "voltage source controlled by a current", (ring, *plus)),
        "B": ("BEHAVIOUR", "behavioural source", (ring,)),
    }
    found = {
        letter: _two_pole(letter, name, title, drawing)
        for letter, (name, title, drawing) in titles.items()
    }
    found["E"] = _controlled("E", "VOLTAGE_BY_VOLTAGE", "voltage source controlled by a voltage")
    found["G"] = _controlled("G", "CURRENT_BY_VOLTAGE", "current source controlled by a voltage")
    return found | _marks()


def _two_pole(letter: str, name: str, title: str, drawing: tuple[Tree, ...]) -> Symbol:
    ends = ((0, 2, "top"), (0, -2, "bottom"))
    pins = tuple(
        _drawn("passive", k, text, *end, 1.0)
        for k, (text, end) in enumerate(zip("+-", ends, strict=True), 1)
    )
    text = (GRID + 0.8, -0.9)
    fields = _spice(letter, name, title, 2)
    return Symbol(name, fields, drawing, pins, ends, text, named_pins=False)


def _controlled(letter: str, name: str, title: str) -> Symbol:
    box: Tree = (
        "rectangle",
        ("start", -2 * GRID, 2 * GRID),
        ("end", 2 * GRID, -2 * GRID),
        _STROKE,
        _PAPER,
    )
    spots = (
        (3, 1, "right", "out+"),
        (3, -1, "right", "out-"),
        (-3, 1, "left", "in+"),
        (-3, -1, "left", "in-"),
    )
    pins = tuple(
        _drawn("passive", k, text, x, y, side, 1.0) for k, (x, y, side, text) in enumerate(spots, 1)
    )
    ends = tuple((x, y, side) for x, y, side, _ in spots)
    return Symbol(
        name, _spice(letter, name, title, 4), (box,), pins, ends, (-2 * GRID, 2 * GRID + 1.3)
    )


def _marks() -> dict[str, Symbol]:
    earth = _line((0.0, 0.0), (0.0, -1.27), (0.9, -1.27), (0.0, -2.2), (-0.9, -1.27), (0.0, -1.27))
    flag = _line((0.0, 0.0), (0.0, 1.27), (-1.0, 1.9), (0.0, 2.54), (1.0, 1.9), (0.0, 1.27))
    spot: Tree = ("circle", ("center", 0.0, 3.3), ("radius", 0.762), _STROKE, _FILL)
    ends = ((0, 0, "top"),)
    return {
        "GND": Symbol(
            "GND",
            _fields("#PWR", "GND", "ground, node 0"),
            (earth,),
            (_drawn("power_in", 1, "GND", 0, 0, "top", 0.0),),
            ends,
            (0.0, -4.0),
            power=True,
            named_pins=False,
        ),
        "PWR_FLAG": Symbol(
            "PWR_FLAG",
            _fields("#FLG", "PWR_FLAG", "tells that ground is driven"),
            (flag,),
            (_drawn("power_out", 1, "pwr", 0, 0, "bottom", 0.0),),
            ((0, 0, "bottom"),),
            (0.0, 3.0),
            power=True,
            named_pins=False,
        ),
        "PROBE": Symbol(
            "PROBE",
            _fields("TP", "PROBE", "a net to be plotted"),
            (spot,),
            (_drawn("passive", 1, "net", 0, 0, "bottom", 1.0),),
            ((0, 0, "bottom"),),
            (1.5, 2.4),
            simulated=False,
            named_pins=False,
        ),
    }


def _spice(letter: str, name: str, title: str, pins: int) -> dict[str, str]:
    numbers = " ".join(f"{k}={k}" for k in range(1, pins + 1))
    model = {"Sim.Device": "SPICE", "Sim.Params": spice(letter, "0"), "Sim.Pins": numbers}
    return _fields(letter, name, title) | model


def spice(letter: str, value: str) -> str:
    """``Sim.Params`` of an element whose ``value`` is written as on its netlist card."""
    return f'type="{letter}" model="{value}" lib=""'


def _fields(reference: str, value: str, description: str) -> dict[str, str]:
    return {
        "Reference": reference,
        "Value": value,
        "Footprint": "",
        "Datasheet": "",
        "Description": description,
    }


def _line(*points: tuple[float, float]) -> Tree:
    return ("polyline", ("pts", *(("xy", x, y) for x, y in points)), _STROKE, _FILL)


def font(size: float = TEXT) -> Tree:
    """Text of the usual size."""
    return ("font", ("size", size, size))


def _pin(place: Place) -> Tree:
    return _drawn(
        "passive", place.number, place.pin.name, place.x, place.y, place.side, place.length
    )


def _drawn(kind: str, number: int, name: str, x: int, y: int, side: str, length: float) -> Tree:
    """A pin whose free end is at ``(x, y)`` in grid units."""
    return (
        "pin",
        Word(kind),
        Word("line"),
        ("at", GRID * x, GRID * y, _ANGLE[side]),
        ("length", GRID * length),
        ("name", name, ("effects", font())),
        ("number", str(number), ("effects", font())),
    )


def write(tree: Tree, indent: str = "") -> str:
    """S-expression text, one line for a leaf, children on lines of their own."""
    head, *rest = tree
    if rest and isinstance(rest[-1], Word) and not isinstance(rest[0], str | float | int):
        inner = (_atom(i) if isinstance(i, str | float | int) else write(i).strip() for i in rest)
        return f"{indent}({head} {' '.join(inner)})"  # a keyword behind lists: (pin_names ... hide)
    flat = [item for item in rest if isinstance(item, str | float | int)]
    nested = [item for item in rest if not isinstance(item, str | float | int)]
    line = " ".join([f"{indent}({head}", *map(_atom, flat)])
    if not nested:
        return f"{line})" + ("\n" if not indent else "")
    body = "\n".join(write(child, indent + "\t") for child in nested)
    return f"{line}\n{body}\n{indent})" + ("\n" if not indent else "")


def _atom(item: str | float) -> str:
    if isinstance(item, Word):
        return item
    if isinstance(item, str):
        escaped = item.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        return f'"{escaped}"'
    return f"{item:.6g}" if isinstance(item, float) else str(item)
