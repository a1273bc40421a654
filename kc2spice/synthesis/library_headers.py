"""Headers of all libraries, and subcircuits that are made from templates.

A header states the origin of a library and the meaning of each pin and parameter.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from operator import attrgetter
from typing import Any

from kc2spice.core.domains import TRANSLATION
from kc2spice.core.mesh_error_descriptions import NOT_ESTIMATED, describe_mesh_errors
from kc2spice.netlist.card_parser import read_cards
from kc2spice.netlist.circuit import Circuit, Param, Pin
from kc2spice.netlist.number_and_name_spelling import (
    format_comment,
    format_number,
    render_template,
    require_name,
    require_word,
)
from kc2spice.netlist.subcircuit_library import (
    Header,
    ReductionSummary,
    Subcircuit,
    write_instance_comment,
    write_parameter_line,
)
from kc2spice.rom.linear_model import Certificate, Port
from kc2spice.scene.scene_classes import Terminal

SIGN_TEXT = (
    "um, m/s and N are positive upwards; 1 A into a pin is an upward force of 1 N on the part"
)
FLOW_TEXT = "pin voltages are relative to the reference node; currents are positive into the pins"
MODAL_EXCITATION = ", where a contact or a steep edge can excite modes"
ROOM_TEXT = "constant temperature; no heating, ageing or failure"
OUTWARDS_TEXT = (
    "um and N are positive along each port's direction, out of the body; 1 A into a pin is a force "
    "of 1 N on the body in this direction"
)


def wrap_comment(text: str) -> list[str]:
    """Return a text as netlist comment lines, indented after the first line."""
    words: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False}
    lines = textwrap.wrap(format_comment(text), 96, subsequent_indent="  ", **words)
    return list(map("* {}".format, lines))


def write_rom_comments(
    reduction: ReductionSummary, certificate: Certificate, excitation: str = MODAL_EXCITATION
) -> tuple[str, ...]:
    """Return comment lines that state the error estimate of a reduced model.

    The lines also state the circuit error and the errors of the compliance above the band. The
    lines also state whether stability or passivity is not proven. ``excitation`` describes what can
    excite the model above the band.
    """
    errors = [f"{error:.2g} at {f:g} Hz" for f, error in certificate.above]
    compliance = f"; error of the compliance above the band: {', '.join(errors)}" if errors else ""
    share = f"{reduction.circuit_error:.1g} at {reduction.worst_hz:.4g} Hz"
    proofs = "" if certificate.stable and certificate.passive else certificate.proofs
    facts = certificate.method, proofs, f"emitted circuit to model: {share}"
    method = "; ".join(filter(None, facts))
    above = f"no error estimate above the band{excitation}"
    first, *more = wrap_comment(f"rom: ({method}); {above}{compliance}")
    return f"* rom: {reduction.summary}", first.replace("* rom:", "*  ", 1), *more


def write_mesh_error_text(facts: Mapping[str, float]) -> str:
    """Return the text of the mesh error estimate, or a note that there is none."""
    text = describe_mesh_errors(facts)
    return f"error estimate of the full model: {text}" if text else NOT_ESTIMATED


def write_part_header(
    header: Header,
    title: str,
    pins: tuple[Pin, ...],
    params: tuple[Param, ...] = (),
    *,
    rating: str,
    validity: str = ROOM_TEXT,
    sign: str = SIGN_TEXT,
    rom: tuple[str, ...] = (),
    mesh: str = "",
    heat: str = "",
) -> tuple[str, ...]:
    """Return the header of a part: all comment lines above its ``.subckt`` card.

    The header consists of the title, an instance card to copy, the origin, and comments about a
    reduced model (``rom``) and the mesh. Further comment lines state the sign convention, validity
    and rating, and describe each pin and each parameter. ``title`` is ``NAME: DESCRIPTION``.
    ``mesh`` is the text of the mesh error estimate. ``sign`` is the sign convention of mechanical
    pins. ``heat`` describes the heat pins.
    """
    sign = sign if TRANSLATION.flow_unit in map(attrgetter("flow"), pins) else FLOW_TEXT
    ends = map(attrgetter("name"), pins)
    lines = [
        f"* {format_comment(title)}",
        write_instance_comment(title.partition(":")[0], ends, format_parameter_defaults(params)),
    ]
    lines += [*header.origin(), *rom]
    facts = {"mesh": mesh, "sign": sign, "heat": heat, "validity": validity, "rating": rating}
    for key, text in facts.items():
        if text:
            lines += wrap_comment(f"{key}: {text}")
    for i, p in enumerate(pins, 1):
        name, unit, flow = require_name(p.name), require_word(p.unit), require_word(p.flow)
        lines.append(f"* @pin {i} {name} unit={unit} flow={flow}")
    lines += map(write_parameter_line, params)
    return tuple(lines)


def list_netlist_pins(port: Port) -> tuple[Pin, ...]:
    """Return the netlist pins of a port, with the across and flow units of each pin."""
    flow = port.flow if port.conservative else "-"
    return tuple(Pin(pin, port.across, flow) for pin in port.terminals)


def format_parameter_defaults(params: Iterable[Param]) -> dict[str, str]:
    """Return the default values of parameters in netlist syntax, keyed by name."""
    return {require_name(p.name): format_number(p.default) for p in params}


def render_library(
    template: str,
    header: Header,
    name: str,
    title: str,
    terminals: Sequence[Terminal],
    params: tuple[Param, ...] = (),
    *,
    rating: str,
    validity: str = ROOM_TEXT,
    mesh: str = "",
    **values: object,
) -> Subcircuit:
    """Render the library of a part from a template: its header and its subcircuit.

    The cards of the subcircuit are in ``templates/TEMPLATE.j2``. :func:`write_part_header` makes
    the header of the subcircuit. The template can use the ``values`` and the text ``card``.
    ``card`` contains the words of the ``.subckt`` card: the name, the pins, and the parameters with
    default values.
    """
    pins = tuple(Pin(item.name, item.unit, item.flow) for item in terminals)
    settings = map("=".join, format_parameter_defaults(params).items())
    card = " ".join((name, *map(attrgetter("name"), pins), *settings))
    words: dict[str, Any] = {"rating": rating, "validity": validity, "mesh": mesh}
    head = write_part_header(header, f"{name}: {title}", pins, params, **words)
    cards = render_template(f"{template}.j2", card=card, **values)
    (circuit,) = read_cards(f"{cards}.ends {name}\n", f"{template}.j2").items
    circuit = replace(circuit, notes=(*head, "", *circuit.notes))
    title = format_comment(f"{name}: {title}")
    tree = Circuit(items=(circuit,))
    return Subcircuit(name, pins, params, tree, title=title, header_lines=len(head))
