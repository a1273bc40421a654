"""Descriptions of the nodes of a deck, for messages about a node.

The description of a node names the part that contains the node, and the nearest pin.
"""

from __future__ import annotations

from kc2spice.core.errors import UsageError
from kc2spice.netlist.circuit import make_electrical_pins
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.name_scopes import Scope, find_instance


def describe_node(deck: Deck, node: str) -> str | None:
    """Describe a node of a deck by the nearest part and pin; None for an unknown node.

    ``node`` has the spelling of ngspice. Examples of ``node`` are ``x1.x2.name`` for a node in a
    subcircuit, ``b.x1.b2`` for a device, and ``v1#branch`` for the current of a source. The result
    is None if the deck does not contain the node.
    """
    *path, name = node.lower().partition("#")[0].split(".")
    if path and len(path[0]) == 1:  # ngspice writes the device letter before the instance
        del path[0]
    try:
        scope = find_instance(deck.scope, tuple(path))
    except UsageError:
        return None
    if scope is None:
        return None
    if path:
        return _describe_inner_node(deck, scope, path[-1], name)
    if name in scope.elements_by_key:
        return f"{name} in {deck.main_file_name}"
    wired = []
    for element in scope.elements:
        called = scope.find_subcircuit(element.model) if element.kind == "x" else None
        for position, end in enumerate(element.lower_case_nodes):
            if end == name:
                pin = f" ({called.name}) pin {called.pins[position]}" if called else ""
                wired.append(f"{element.key}{pin}")
    return f"node of {', '.join(wired)}" if wired else None


def _describe_inner_node(deck: Deck, scope: Scope, instance: str, name: str) -> str:
    """Describe a node inside an instance by the instance and the nearest pin.

    An inner node belongs to the pin whose name is the end of the node's name: ``fring0`` belongs to
    ``ring0``.
    """
    part = next((part for part in deck.parts if part.name.lower() == scope.name.lower()), None)
    pins = part.pins if part else make_electrical_pins(scope.pins)
    matching = [pin for pin in pins if name.endswith(pin.key)]
    what = f"part {instance} ({part.title if part else scope.name})"
    if not matching:
        return f"{what}, inside at {name}"
    pin = max(matching, key=lambda pin: len(pin.name))
    flow = "" if pin.flow == "-" else f", 1 A = 1 {pin.flow}"
    return f"{what} at its pin {pin.name} (1 V = 1 {pin.unit}{flow})"
