"""A run that failed: what the log blames, which part that is, and how far the waveforms got."""

from __future__ import annotations

from dataclasses import dataclass

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Pin, Subcircuit
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.scope import Scope
from kc2spice.sim.log import Kind, LogReport


@dataclass(frozen=True)
class Failure:
    """Cause of a failed run; ``time`` [s], ``partial`` the waveforms up to there, if any."""

    cause: str
    kind: Kind | None
    node: str | None = None
    time: float | None = None
    part: str | None = None
    partial: Waveforms | None = None


class FailedRunError(SimulationError):
    """ngspice ended without a result; ``failure`` says why."""

    failure: Failure


def diagnose(deck: Deck, report: LogReport, otherwise: str, partial: Waveforms | None) -> Failure:
    """The failure that a log tells of; ``otherwise`` where it names no cause."""
    part = belongs_to(deck, report.node) if report.node else None
    return Failure(report.cause or otherwise, report.kind, report.node, report.time, part, partial)


def belongs_to(deck: Deck, node: str) -> str | None:
    """In words, the part of ``deck`` that ``node`` belongs to and the pins next to it.

    ``node`` as ngspice says it: ``x1.x2.name``, ``b.x1.b2`` for a device, ``v1#branch`` for the
    current of a source. None where nothing of that name is in the deck.
    """
    path = node.lower().partition("#")[0].split(".")
    if len(path) > 1 and len(path[0]) == 1:  # a device: its letter stands before the instance
        path = path[1:]
    try:
        scope = deck.scope
    except UsageError:
        return None
    inside = None
    for name in path[:-1]:
        instance = next((e for e in scope.elements if e.key == name), None)
        called = scope.find(instance.model) if instance else None
        if called is None:
            return None
        inside, scope = f"part {name} ({_title(deck, called.name)})", called
    if inside is not None:
        return inside + _pin_inside(deck, scope, path[-1])
    return _at_top(deck, scope, path[-1])


def _at_top(deck: Deck, scope: Scope, name: str) -> str | None:
    """The card of this name, or all that is wired to the node."""
    if any(element.key == name for element in scope.elements):
        return f"{name} in {deck.main}"
    wired = []
    for element in scope.elements:
        for position, node in enumerate(element.ends):
            called = scope.find(element.model) if element.kind == "x" else None
            if node == name and called is not None:
                wired.append(f"{element.key} ({called.name}) pin {called.pins[position]}")
            elif node == name:
                wired.append(element.key)
    return f"node of {', '.join(wired)}" if wired else None


def _title(deck: Deck, subcircuit: str) -> str:
    """What the library says that a subcircuit is; its name where it says nothing."""
    part = _part(deck, subcircuit)
    return part.text.splitlines()[0].lstrip("* ") if part else subcircuit


def _part(deck: Deck, subcircuit: str) -> Subcircuit | None:
    return next((part for part in deck.parts if part.name.lower() == subcircuit), None)


def _pin_inside(deck: Deck, scope: Scope, name: str) -> str:
    """The documented pin that an inner node or element is named after: ``fring0`` after ring0."""
    part = _part(deck, scope.name)
    pins = part.pins if part else tuple(Pin(pin, "V", "A") for pin in scope.pins)
    named = [pin for pin in pins if name.endswith(pin.name.lower())]
    if not named:
        return f", inside at {name}"
    pin = max(named, key=lambda pin: len(pin.name))
    flow = "" if pin.flow == "-" else f", 1 A = 1 {pin.flow}"
    return f" at its pin {pin.name} (1 V = 1 {pin.unit}{flow})"
