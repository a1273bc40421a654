"""The operational amplifier of all analogue parts, at three levels of detail."""

from __future__ import annotations

from typing import Literal

from kc2spice.netlist.circuit import Param, Subcircuit, positive
from kc2spice.scene.model import Terminal
from kc2spice.spice.header import Header
from kc2spice.spice.library import library

GAIN = 1e7  # V/V at rest
BANDWIDTH = 1e9  # Hz, gain-bandwidth product of a fast decompensated amplifier

Level = Literal["ideal", "pole", "slew"]
_NAMES: dict[Level, str] = {"ideal": "opamp_ideal", "pole": "opamp", "slew": "opamp_slew"}
_TITLES: dict[Level, str] = {
    "ideal": "ideal operational amplifier",
    "pole": "operational amplifier",
    "slew": "operational amplifier with slew rate and current limit",
}


def opamp_subcircuit(header: Header, level: Level = "pole") -> Subcircuit:
    """``V(out) = A(s) (V(inp) - V(inn))`` behind an output resistance, pins alike at all levels.

    ``ideal``: A = a0. ``pole``: A = a0 / (1 + s a0 / (2 pi gbw)) between the rails ``vee`` and
    ``vcc``, with an input offset. ``slew``: the same with limited slew rate and output current.
    The parts are named ``opamp_ideal``, ``opamp`` and ``opamp_slew``.
    """
    pins = [Terminal(pin, "V", "A") for pin in ("inp", "inn", "out", "vcc", "vee", "ref")]
    rating = "none: ideal" if level == "ideal" else "its output stays between vee and vcc"
    params, title = _params(level), _TITLES[level]
    return library("opamp", header, _NAMES[level], title, pins, params, rating=rating, level=level)


def _params(level: Level) -> tuple[Param, ...]:
    gain = positive("a0", GAIN, "-", "gain at rest")
    output = positive("rout", 0.1, "Ohm", "output resistance")
    if level == "ideal":
        return (gain, output)
    pole = positive("gbw", BANDWIDTH, "Hz", "gain-bandwidth product")
    offset = Param("offset", 0.0, "V", "input offset")
    if level == "pole":
        return (gain, pole, output, offset, positive("clip", 1e3, "S", "stiffness of the rails"))
    return (
        gain,
        pole,
        output,
        offset,
        positive("slew", 1e9, "V/s", "fastest change of the output"),
        positive("current_limit", 1.0, "A", "largest output current"),
    )
