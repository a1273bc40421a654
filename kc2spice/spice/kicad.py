"""KiCad symbol libraries in the file formats of releases 8 and 9.

Format: developer documentation, S-expression symbol library and schematic formats; release 8
writes version 20231120, release 9 version 20241209 (libraries) and 20250114 (schematics).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from kc2spice.spice.box import Box, Place
from kc2spice.spice.cards import number

GRID = 1.27  # mm
TEXT = 1.27  # mm
_ANGLE = {"left": 0, "right": 180, "bottom": 90}  # from the end of a pin towards the body


class Word(str):
    """A keyword; every other string is written in quotes."""


Tree = Sequence["Tree | str | float | int"]
YES, NO = Word("yes"), Word("no")


@dataclass(frozen=True)
class Release:
    """A KiCad release and the versions of its two file formats."""

    major: int
    library: int
    schematic: int

    @property
    def tail(self) -> list[Tree]:
        """What release 9 adds to the end of a symbol or sheet."""
        return [("embedded_fonts", NO)] if self.major >= 9 else []

    def head(self, version: int) -> list[Tree]:
        """Version and origin of a file."""
        return [
            ("version", version),
            ("generator", "kc2spice"),
            ("generator_version", f"{self.major}.0"),
        ]


RELEASES = (Release(8, 20231120, 20231120), Release(9, 20241209, 20250114))


def library(boxes: Iterable[Box], release: Release) -> str:
    """A symbol library with one symbol per part."""
    symbols = [symbol(box.name, box, release) for box in boxes]
    return write(("kicad_symbol_lib", *release.head(release.library), *symbols))


def symbol(name: str, box: Box, release: Release) -> Tree:
    """The definition of one symbol; a schematic embeds it under ``library:name``."""
    return definition(
        name,
        box.name,
        fields(box),
        [_outline(box)],
        [_pin(place) for place in box.places],
        release,
        GRID * (box.height + 1),
    )


def definition(
    name: str,
    short: str,
    properties: dict[str, str],
    drawing: Sequence[Tree],
    pins: Sequence[Tree],
    release: Release,
    top: float,
    *,
    power: bool = False,
) -> Tree:
    """A symbol from its drawing and pins; its reference stands at height ``top``."""
    return (
        "symbol",
        name,
        *([("power",)] if power else []),
        ("pin_names", ("offset", 1.016)),
        ("exclude_from_sim", NO),
        ("in_bom", YES),
        ("on_board", YES),
        *instance_fields(properties, 0.0, 0.0, top),
        ("symbol", f"{short}_0_1", *drawing),
        ("symbol", f"{short}_1_1", *pins),
        *release.tail,
    )


def fields(box: Box) -> dict[str, str]:
    """The fields that make a symbol a simulation model."""
    needs = f" (needs {', '.join(f'{n}.lib' for n in box.needs)})" if box.needs else ""
    found = {
        "Reference": "X",
        "Value": box.name,
        "Footprint": "",
        "Datasheet": "",
        "Description": box.title + needs,
        "Sim.Device": "SUBCKT",
        "Sim.Library": f"{box.name}.lib",
        "Sim.Name": box.name,
        "Sim.Pins": " ".join(f"{place.number}={place.pin.name}" for place in box.places),
    }
    if box.params:
        found["Sim.Params"] = " ".join(f"{p.name}={number(p.default)}" for p in box.params)
    return found


def instance_fields(properties: dict[str, str], x: float, y: float, top: float) -> list[Tree]:
    """Fields around ``(x, y)``; reference and value are shown, the others hidden."""
    shown = {"Reference": y + top, "Value": y - top}
    trees: list[Tree] = []
    for key, text in properties.items():
        hidden = [] if key in shown and not text.startswith("#") else [("hide", YES)]
        place = ("at", x, shown.get(key, y), 0)
        trees.append(("property", key, text, place, ("effects", font(), *hidden)))
    return trees


def font() -> Tree:
    """Text of the usual size."""
    return ("font", ("size", TEXT, TEXT))


def pin(kind: str, number: int, name: str, x: float, y: float, angle: int) -> Tree:
    """A pin whose free end is at ``(x, y)``."""
    return (
        "pin",
        Word(kind),
        Word("line"),
        ("at", x, y, angle),
        ("length", 2 * GRID),
        ("name", name, ("effects", font())),
        ("number", str(number), ("effects", font())),
    )


def _pin(place: Place) -> Tree:
    reach = {"left": (-1, 0), "right": (1, 0), "bottom": (0, -1)}[place.side]
    x, y = (GRID * (c + d) for c, d in zip((place.x, place.y), reach, strict=True))
    return pin("passive", place.number, place.pin.name, x, y, _ANGLE[place.side])


def _outline(box: Box) -> Tree:
    x, y = GRID * box.width, GRID * box.height
    return (
        "rectangle",
        ("start", -x, y),
        ("end", x, -y),
        ("stroke", ("width", 0.254), ("type", Word("default"))),
        ("fill", ("type", Word("background"))),
    )


def write(tree: Tree, indent: str = "") -> str:
    """S-expression text, one line for a leaf, children on lines of their own."""
    head, *rest = tree
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
