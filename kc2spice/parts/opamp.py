"""The operational amplifier of all analogue parts: one pole, rails, output resistance."""

from __future__ import annotations

from kc2spice.netlist.circuit import Param, Pin, Subcircuit
from kc2spice.netlist.header import Header, parameter_list, part_header
from kc2spice.netlist.render import render

GAIN = 1e7  # V/V at rest
BANDWIDTH = 1e9  # Hz, gain-bandwidth product of a fast decompensated amplifier


def opamp_subcircuit(header: Header, *, name: str = "opamp") -> Subcircuit:
    """``V(out) = a0 / (1 + s a0 / (2 pi gbw)) (V(inp) - V(inn))`` between ``vee`` and ``vcc``."""
    pins = tuple(Pin(pin, "V", "A") for pin in ("inp", "inn", "out", "vcc", "vee", "ref"))
    params = (
        Param("a0", GAIN, "-", "gain at rest"),
        Param("gbw", BANDWIDTH, "Hz", "gain-bandwidth product"),
        Param("rout", 0.1, "Ohm", "output resistance"),
        Param("clip", 1e3, "S", "stiffness of the rails"),
    )
    text = render(
        "opamp.j2",
        header=part_header(header, f"{name}: operational amplifier", pins, params),
        name=name,
        pins=[pin.name for pin in pins],
        parameters=parameter_list(params),
    )
    return Subcircuit(name, pins, params, text)
