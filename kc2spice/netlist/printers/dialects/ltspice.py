"""Dialect of LTspice: netlists and symbols (``.asy``, file version 4)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from kc2spice.netlist.circuit import Element
from kc2spice.netlist.expression import Trace
from kc2spice.netlist.number_and_name_spelling import format_number
from kc2spice.netlist.printers.dialect import Dialect
from kc2spice.netlist.printers.dialect_registry import register_dialect
from kc2spice.netlist.printers.symbol_layout import arrange_pins
from kc2spice.netlist.subcircuit_library import Subcircuit

GRID = 32  # LTspice units per grid unit; pin positions must be multiples of 16
_SIDE_NAMES = {"left": "LEFT", "right": "RIGHT", "bottom": "BOTTOM", "top": "TOP"}


@register_dialect
class LTspice(Dialect):
    """Dialect of the simulator LTspice.

    LTspice inserts the values of parameters into behavioural sources as text.
    """

    dialect = "ltspice"
    title = "LTspice"
    command = "LTspice -b"
    keyword = "params:"
    temperature = "temp"
    known_options = frozenset(
        {"reltol", "abstol", "vntol", "chgtol", "trtol", "method", "gmin", "itl1", "itl2", "itl4"}
    )
    omits_braces = True  # whether names of parameters are written without braces

    def format_name(self, text: str) -> str:
        """Return a name; write a parameter as ``({NAME})`` if necessary.

        Without parentheses, the value of the parameter could not have a sign.
        """
        word = super().format_name(text)
        plain = self.omits_braces or word != text or text.lower() in ("time", "pi", "temp")
        return word if plain else f"({{{word}}})"

    def format_law(self, part: Element) -> str:
        """Format the law of a behavioural source as an expression."""
        self.omits_braces = part.kind != "b"
        text = self.write_tree(part.law)
        quantity, self.omits_braces = part.quantity, True
        return f"{quantity}={text}" if part.kind == "b" else f"value={{{text}}}"

    def switch(self, name: str, values: Mapping[str, str]) -> str:
        """Return the switch model with all parameters, because LTspice has other defaults."""
        parameters = {"vt": "0", "vh": "0", "ron": "1", "roff": "1e12"} | dict(values)
        return f".model {name} SW({' '.join(f'{k.upper()}={v}' for k, v in parameters.items())})"

    def format_element(self, part: Element) -> str:
        """Return the card of an element, with ``Rser=0`` for an inductor.

        Without ``Rser``, LTspice adds a series resistance to each inductor.
        """
        return super().format_element(part) + (" Rser=0" if part.kind == "l" else "")

    def format_derived_measure(self, kind: str, name: str, expression: str) -> str:
        """Return a measurement card whose value is an expression."""
        return f"{self.measure_keyword} {kind.upper()} {name} PARAM {expression}"

    def format_magnitude(self, vector: str) -> str:
        """Return the LTspice expression for the magnitude of a complex vector."""
        return f"mag({vector})"

    def format_real_part(self, vector: str) -> str:
        """Return the text for the real part of a complex vector."""
        return f"re({vector})"

    def format_node(self, path: list[str]) -> str:
        """Return a node name such as ``disc:n1``, without the prefix X of instance names."""
        return ":".join([*_strip_instance_letters(path[:-1]), path[-1]])

    def format_device(self, trace: Trace) -> str:
        """Return a device name with its element letter first, such as ``b:contact:ring0``."""
        (name,) = trace.names
        inner = (name[0], *_strip_instance_letters(trace.path), name[1:])
        return ":".join(inner) if trace.path else name

    def symbols(self, part: Subcircuit, library: str) -> dict[str, str]:
        """Return the symbol file of a part."""
        stem = part.filename.removesuffix(".lib")
        return {f"{stem}.asy": _draw_symbol(part, library)}


def _strip_instance_letters(path: Iterable[str]) -> list[str]:
    """Return the names of instances without the initial letter X."""
    return [instance[1:] for instance in path]


def _draw_symbol(part: Subcircuit, library: str) -> str:
    """Draw the symbol of a part; its attribute ``ModelFile`` names the part's library."""
    box = arrange_pins(part)
    x, y = GRID * box.width, GRID * box.height
    lines = [
        "Version 4",
        "SymbolType BLOCK",
        f"RECTANGLE Normal {x} {y} {-x} {-y}",
        f"WINDOW 0 0 {-y} Bottom 2",
        f"WINDOW 3 0 {y} Top 2",
        f"SYMATTR Value {part.name}",
        "SYMATTR Prefix X",
        f"SYMATTR ModelFile {library}",
        f"SYMATTR Description {part.title}",
    ]
    if part.params:
        parameters = " ".join(f"{p.name}={format_number(p.default)}" for p in part.params)
        lines.append(f"SYMATTR SpiceLine {parameters}")
    # pins are on the outline of the symbol; the y axis of LTspice points downwards
    for pin in box.places:
        x = max(-box.width, min(box.width, pin.x)) * GRID
        y = -max(-box.height, min(box.height, pin.y)) * GRID
        lines += [f"PIN {x} {y} {_SIDE_NAMES[pin.side]} 8", f"PINATTR PinName {pin.name}"]
        lines.append(f"PINATTR SpiceOrder {pin.number}")
    return "\n".join(lines) + "\n"
