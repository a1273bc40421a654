"""The library of a part whose cards are a template: pins and parameters are stated once."""

from __future__ import annotations

from collections.abc import Sequence

from kc2spice.netlist.circuit import Param, Pin, Subcircuit
from kc2spice.netlist.render import render
from kc2spice.scene.model import Terminal
from kc2spice.spice.header import ROOM, SIGN, Header, parameter_list, part_header


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
    sign: str = SIGN,
    no_module: str = "",
    **values: object,
) -> Subcircuit:
    """``templates/TEMPLATE.j2`` under its head, see :func:`kc2spice.spice.header.part_header`.

    Besides ``values`` the template has the names of its ``pins`` and the ``card`` behind
    ``.subckt``: name, pins and parameters with their defaults.
    """
    pins = tuple(Pin(each.name, each.unit, each.flow) for each in terminals)
    words = {"rating": rating, "validity": validity, "sign": sign}
    names = [pin.name for pin in pins]
    card = " ".join((name, *names, parameter_list(params)))
    head = part_header(header, f"{name}: {title}", pins, params, **words)
    cards = render(f"{template}.j2", card=card, pins=names, **values)
    text = f"{head}\n{cards}.ends {name}\n"
    return Subcircuit(name, pins, params, text, no_module=no_module)
