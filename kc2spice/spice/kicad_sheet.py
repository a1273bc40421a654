"""A KiCad schematic that shows the kick at work: pulse source, series resistance, actuator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from uuid import NAMESPACE_URL, uuid5

from kc2spice.spice.box import Box, Place
from kc2spice.spice.kicad import (
    GRID,
    NO,
    YES,
    Release,
    Tree,
    Word,
    definition,
    fields,
    font,
    instance_fields,
    pin,
    symbol,
    write,
)

LIBRARY = "kc2spice"
ORIGIN = (152.4, 101.6)  # mm, of the actuator on an A4 sheet
REACH = 4 * GRID  # from the middle of a two-terminal symbol to its pins
_STROKE: Tree = ("stroke", ("width", 0.254), ("type", Word("default")))
_FILL: Tree = ("fill", ("type", Word("none")))


@dataclass(frozen=True)
class _Driver:
    """A small symbol of the sheet: its fields, drawing, pins, and whether it names a net."""

    properties: dict[str, str]
    drawing: tuple[Tree, ...]
    pins: tuple[Tree, ...]
    power: bool = False


@dataclass(frozen=True)
class Pulse:
    """The kick's drive (V, s) behind ``resistance`` (Ohm)."""

    voltage: float = 100.0
    start: float = 5e-4
    edge: float = 1e-7
    flat: float = 2.49e-5
    resistance: float = 10.0


def kick_sheet(box: Box, release: Release, pulse: Pulse | None = None) -> str:
    """Text of a ``.kicad_sch`` with the symbol ``box`` driven by ``pulse``.

    Pins that are neither terminals nor references are free surfaces: they get no-connect marks.
    """
    drivers = _drivers(pulse or Pulse())
    sheet = _uuid("sheet", release.major)
    anode = _end(next(p for p in box.places if p.pin.name == "anode"))
    source = (anode[0] - 12 * REACH, anode[1] + REACH)
    resistor = (anode[0] - 6 * REACH, anode[1])
    grounds = [(source[0], source[1] + REACH)]
    grounds += [_end(p) for p in box.places if p.pin.name == "cathode" or p.side == "bottom"]
    free = [_end(p) for p in box.places if p.side != "left" and p.side != "bottom"]
    symbols = [
        symbol(f"{LIBRARY}:{box.name}", box, release),
        *(_symbol(name, driver, release) for name, driver in drivers.items()),
    ]
    placed = [
        _placed(box.name, "X1", fields(box), ORIGIN, len(box.places), sheet, GRID * box.height),
        _placed("SOURCE", "V1", drivers["SOURCE"].properties, source, 2, sheet, REACH),
        _placed("RESISTOR", "R1", drivers["RESISTOR"].properties, resistor, 2, sheet, REACH),
        *(
            _placed("GND", f"#PWR{i}", drivers["GND"].properties, place, 1, sheet, REACH)
            for i, place in enumerate(grounds, 1)
        ),
    ]
    wires = [
        _wire((source[0], source[1] - REACH), (resistor[0] - REACH, resistor[1])),
        _wire((resistor[0] + REACH, resistor[1]), anode),
    ]
    tree: Tree = (
        "kicad_sch",
        *release.head(release.schematic),
        ("uuid", sheet),
        ("paper", "A4"),
        ("title_block", ("title", f"{box.name} with a pulse driver")),
        ("lib_symbols", *symbols),
        *(("no_connect", ("at", *place), ("uuid", _uuid("free", *place))) for place in free),
        *wires,
        _label("drive", (source[0] + REACH, anode[1])),
        _label("anode", (anode[0] - REACH, anode[1])),
        _text(".tran 1u 1m 0 1u", (source[0], source[1] + 3 * REACH)),
        *placed,
        ("sheet_instances", ("path", "/", ("page", "1"))),
        *release.tail,
    )
    return write(tree)


def _drivers(pulse: Pulse) -> dict[str, _Driver]:
    shape = (
        f"y1=0 y2={pulse.voltage:g} td={pulse.start:g} tr={pulse.edge:g} tf={pulse.edge:g} "
        f"tw={pulse.flat:g} per=1"
    )
    two = {"Footprint": "", "Datasheet": "", "Description": "", "Sim.Pins": "1=+ 2=-"}
    ring: Tree = ("circle", ("center", 0.0, 0.0), ("radius", 2 * GRID), _STROKE, _FILL)
    bar: Tree = ("rectangle", ("start", -2 * GRID, GRID), ("end", 2 * GRID, -GRID), _STROKE, _FILL)
    corners = (("xy", -GRID, -GRID), ("xy", GRID, -GRID), ("xy", 0.0, -2 * GRID))
    earth: Tree = (
        "polyline",
        ("pts", *corners, ("xy", -GRID, -GRID), ("xy", 0.0, -GRID), ("xy", 0.0, 0.0)),
        _STROKE,
        _FILL,
    )
    return {
        "SOURCE": _Driver(
            {"Reference": "V", "Value": "kick pulse", **two,
             "Sim.Device": "V", "Sim.Type": "PULSE", "Sim.Params": shape},
            (ring,),
            (pin("passive", 1, "+", 0.0, REACH, 270), pin("passive", 2, "-", 0.0, -REACH, 90)),
        ),
        "RESISTOR": _Driver(
            {"Reference": "R", "Value": f"{pulse.resistance:g}", **two,
             "Sim.Device": "R", "Sim.Params": f"r={pulse.resistance:g}"},
            (bar,),
            (pin("passive", 1, "+", -REACH, 0.0, 0), pin("passive", 2, "-", REACH, 0.0, 180)),
        ),
        "GND": _Driver(
            {"Reference": "#PWR", "Value": "GND", "Footprint": "", "Datasheet": "",
             "Description": ""},
            (earth,),
            (pin("power_in", 1, "GND", 0.0, 0.0, 270),),
            power=True,
        ),
    }  # fmt: skip


def _symbol(name: str, driver: _Driver, release: Release) -> Tree:
    return definition(
        f"{LIBRARY}:{name}",
        name,
        driver.properties,
        driver.drawing,
        driver.pins,
        release,
        REACH,
        power=driver.power,
    )


def _placed(
    name: str,
    reference: str,
    properties: dict[str, str],
    place: tuple[float, float],
    pins: int,
    sheet: str,
    top: float,
) -> Tree:
    numbers = [("pin", str(i), ("uuid", _uuid(reference, "pin", i))) for i in range(1, pins + 1)]
    return (
        "symbol",
        ("lib_id", f"{LIBRARY}:{name}"),
        ("at", *place, 0),
        ("unit", 1),
        ("exclude_from_sim", NO),
        ("in_bom", YES),
        ("on_board", YES),
        ("dnp", NO),
        ("uuid", _uuid(reference)),
        *instance_fields(properties | {"Reference": reference}, *place, -top - 2 * GRID),
        *numbers,
        (
            "instances",
            ("project", "", ("path", f"/{sheet}", ("reference", reference), ("unit", 1))),
        ),
    )


def _wire(start: tuple[float, float], end: tuple[float, float]) -> Tree:
    points = ("pts", ("xy", *start), ("xy", *end))
    line: Tree = ("stroke", ("width", 0), ("type", Word("default")))
    return ("wire", points, line, ("uuid", _uuid("wire", *start, *end)))


def _label(text: str, place: tuple[float, float]) -> Tree:
    left: Tree = ("justify", Word("left"), Word("bottom"))
    return ("label", text, ("at", *place, 0), ("effects", font(), left), ("uuid", _uuid(text)))


def _text(text: str, place: tuple[float, float]) -> Tree:
    left: Tree = ("justify", Word("left"), Word("bottom"))
    body: Sequence[Tree] = (("at", *place, 0), ("effects", font(), left))
    return ("text", text, ("exclude_from_sim", NO), *body, ("uuid", _uuid(text)))


def _end(place: Place) -> tuple[float, float]:
    """Where a wire meets a pin; y points down on a sheet."""
    dx, dy = {"left": (-1, 0), "right": (1, 0), "bottom": (0, -1)}[place.side]
    return ORIGIN[0] + GRID * (place.x + dx), ORIGIN[1] - GRID * (place.y + dy)


def _uuid(*what: object) -> str:
    """The same every time, so that a new export does not change the file."""
    return str(uuid5(NAMESPACE_URL, "kc2spice/" + "/".join(map(str, what))))
