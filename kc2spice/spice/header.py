"""Libraries of parts whose cards are templates, and the head of every one: where it comes from and
what each pin and parameter means."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from kc2spice.core import __version__
from kc2spice.core.mesh_error import NOT_ESTIMATED, mesh_words
from kc2spice.netlist.cards import comment, name, number, render, word
from kc2spice.netlist.circuit import Param, Pin
from kc2spice.netlist.library import Subcircuit
from kc2spice.netlist.printers.ngspice import printed
from kc2spice.rom.linear import Certificate
from kc2spice.scene.model import Terminal

SIGN = "um, m/s and N count upwards, out of the chip; 1 A into a pin pushes the part up with 1 N"
FLOW = "1 V counts from the reference, 1 A into the pin"
ROOM = "constant temperature; nothing here heats up, ages or breaks"
OUTWARDS = (
    "um and N count along each port's direction, out of the body; 1 A into a pin pushes the body "
    "that way with 1 N"
)


@dataclass(frozen=True)
class Header:
    """Origin of a netlist: the scene's name and the hash of all that its numbers depend on."""

    scene: str
    scene_hash: str

    def origin(self) -> str:
        """Tool version, scene and licence, as comment lines."""
        return (
            f"* tool: kc2spice {__version__}\n"
            f"* scene: {comment(self.scene)} hash={comment(self.scene_hash)}\n"
            "* licence: GPL-3.0-or-later"
        )


def plan_lines(found: Mapping[str, Any], without: Collection[str] = ()) -> str:
    """Models, neglected effects and numerical settings of a deck, as comment lines."""
    error = (
        "not estimated" if found["error_budget"] is None else f"budget {found['error_budget']:g}"
    )
    facts = {
        "modelled": ", ".join(part["part"] for part in found["parts"]),
        f"numerical settings (error {error})": ", ".join(
            f"{item['key']} {item['value']:g}"
            for item in found["settings"]
            if item["key"] not in without
        ),
        "left out (sizes: kc2spice explain)": "; ".join(
            item["effect"] for item in found["left_out"]
        ),
    }
    lines = [f"{head}: {text}" for head, text in facts.items() if text]
    wrapped = [textwrap.fill(comment(line), 96, subsequent_indent="  ") for line in lines]
    return textwrap.indent("\n".join(wrapped), "* ")


def _upwards(value: float) -> float:
    """Three digits of it, rounded so that a bound stays one."""
    mantissa, _, exponent = f"{value:.2e}".partition("e")
    short = float(f"{mantissa}e{exponent}")
    return short if short >= value else float(f"{float(mantissa) + 0.01:.2f}e{exponent}")


def paragraph(text: str) -> str:
    """``text`` as comment lines of at most 100 characters, all but the first indented."""
    words: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}
    lines = textwrap.wrap(comment(text), 96, subsequent_indent="  ", **words)
    return "".join(f"* {line}\n" for line in lines)


def rom_line(order: int, certificate: Certificate, circuit: str = "") -> str:
    """Comment lines: order, band and error estimate of a reduced model, how it was found, and what
    contact sees above the band. ``circuit`` states the share of the emitted circuit."""
    low, high = certificate.band_hz
    seen = [f"{error:.2g} at {f:g} Hz" for f, error in certificate.above]
    beyond = f", compliance off by {', '.join(seen)}" if seen else ""
    first = (
        f"* rom: order={order} band={number(low)}..{number(high)} Hz "
        f"norm={certificate.norm} error={number(_upwards(certificate.error_estimate))}\n"
    )
    method = "; ".join(filter(None, (certificate.method, circuit)))
    text = f"({method}); no error estimate above the band{beyond}"
    return first + paragraph(f"rom: {text}: a contact or a steep edge excites it").replace(
        "* rom:", "*  ", 1
    )


def use_line(name: str, pins: Sequence[Pin]) -> str:
    """An instance to copy; the nodes have the names of the pins."""
    return f"* use: X1 {' '.join(pin.name for pin in pins)} {name}\n"


def mesh_entry(facts: Mapping[str, float]) -> str:
    """Header entry of the mesh of a linear model: its error estimate, or the reason for none."""
    text = mesh_words(facts)
    return f"error estimate of the full model: {text}" if text else NOT_ESTIMATED


def part_header(
    header: Header,
    title: str,
    pins: tuple[Pin, ...],
    params: tuple[Param, ...] = (),
    *,
    rating: str,
    validity: str = ROOM,
    sign: str = SIGN,
    rom: str = "",
    mesh: str = "",
) -> str:
    """Everything above ``.subckt``: title, an instance to copy, origin, ROM facts, sign, validity
    and rating, one line per pin and parameter. ``title`` is ``NAME: what it is``.

    ``mesh`` is the error estimate of the mesh that its model is solved on, in words.
    ``unit`` is what 1 V on the pin means, ``flow`` what 1 A into it means (``-``: a signal).
    ``sign`` is for parts with mechanical pins.
    """
    sign = sign if any(p.flow == "N" for p in pins) else FLOW
    lines = [f"* {comment(title)}\n", use_line(title.partition(":")[0], pins)]
    lines += [f"{header.origin()}\n{rom}"]
    facts = {"mesh": mesh, "sign": sign, "validity": validity, "rating": rating}
    lines += [paragraph(f"{key}: {text}") for key, text in facts.items() if text]
    lines += [
        f"* @pin {i} {name(p.name)} unit={word(p.unit)} flow={word(p.flow)}\n"
        for i, p in enumerate(pins, 1)
    ]
    lines += [
        f"* @param {name(p.name)}={number(p.default)} unit={word(p.unit)}{_range(p)} "
        f"{comment(p.doc)}\n"
        for p in params
    ]
    return "".join(lines)


def _range(param: Param) -> str:
    """`` range=low..high`` where the parameter has one."""
    bounded = math.isfinite(param.low) or math.isfinite(param.high)
    return f" range={param.low:g}..{param.high:g}" if bounded else ""


def parameter_list(params: tuple[Param, ...]) -> str:
    """Parameters with their defaults as they stand behind the pins of a ``.subckt`` card."""
    return " ".join(f"{name(p.name)}={number(p.default)}" for p in params)


def library(
    template: str,
    header: Header,
    name: str,
    title: str,
    terminals: Sequence[Terminal],
    params: tuple[Param, ...] = (),
    *,
    rating: str,
    validity: str = ROOM,
    mesh: str = "",
    **values: object,
) -> Subcircuit:
    """``templates/TEMPLATE.j2`` under its head, see :func:`part_header`.

    Besides ``values`` the template has the ``card`` behind ``.subckt``: name, pins and parameters
    with their defaults.
    """
    pins = tuple(Pin(item.name, item.unit, item.flow) for item in terminals)
    card = " ".join((name, *(pin.name for pin in pins), parameter_list(params)))
    words = {"rating": rating, "validity": validity, "mesh": mesh}
    head = part_header(header, f"{name}: {title}", pins, params, **words)
    cards = render(f"{template}.j2", card=card, **values)
    part = Subcircuit(name, pins, params, f"{head}\n{cards}.ends {name}\n")
    return printed(part, part.circuit)
