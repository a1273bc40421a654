"""Circuits of laws that share nothing but ground, with the results that they determine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from kc2spice.core.laws import GROUND, Law, LinearBody, PortBody, Reading, Source, sensor
from kc2spice.equations.scene_laws import _kinds, _laws, _merged
from kc2spice.reference.assemble import System, assemble
from kc2spice.scene.model import Build

# Kind of a pin: the source that can stand for a part there, and the factor to SI of ngspice's node.
SOURCES = {"electrical": ("voltage", 1.0), "displacement": ("displacement", 1e-6),
           "signal": ("signal", 1.0)}  # fmt: skip


@dataclass(frozen=True)
class Circuit:
    """Laws that are joined, directly or over others, with the readings of their waves."""

    laws: tuple[Law, ...]
    joins: Mapping[str, tuple[str, ...]]
    readings: Mapping[str, Reading]
    sweeps: Mapping[tuple[str, str], tuple[str, float]]

    def system(self) -> System:
        """The equations."""
        return assemble(self.laws, self.joins)

    def given(self, held: set[str]) -> bool:
        """Whether sources of the pins ``held`` prescribe every net, none of them moving a body."""
        nets = [set(pins) for net, pins in self.joins.items() if net != GROUND]
        return (
            bool(held)
            and all(pins & held for pins in nets)
            and not any(isinstance(law, LinearBody | PortBody) for law in self.laws)
        )


def circuits(build: Build, replayed: Mapping[str, Source] | None = None) -> tuple[Circuit, ...]:
    """The scene's independent circuits, which share nothing but ground; ``replayed`` are sources on
    nets of parts without a law.

    Raises
    ------
    UsageError : the laws do not fit each other; a part without law is for the caller to find.
    """
    result, replayed = _laws(build), replayed or {}
    laws, joins = _listening([*result.laws.values(), *replayed.values()], result.joins(replayed))
    readings = {k: r for e in result.equations.values() for k, r in e.results.items()}
    sweeps = {(n, k): s for n, e in result.equations.items() for k, s in e.sweeps.items()}
    met = [{_owner(pin) for pin in pins} for net, pins in joins.items() if net != GROUND]
    whole = []
    for group in _merged([*({law.name} for law in laws), *met]):
        own = {n: tuple(pin for pin in pins if _owner(pin) in group) for n, pins in joins.items()}
        whole.append(
            Circuit(
                tuple(law for law in laws if law.name in group),
                {net: pins for net, pins in own.items() if pins},
                {k: r for k, r in readings.items() if _owner(r.terms[0][1]) in group},
                {k: s for k, s in sweeps.items() if s[0] in group},
            )
        )
    return tuple(whole)


def _owner(pin: str) -> str:
    return pin.partition(".")[0]


def _listening(
    laws: list[Law], joins: Mapping[str, tuple[str, ...]]
) -> tuple[list[Law], dict[str, tuple[str, ...]]]:
    """Signal inputs on a net of a circuit or of a motion are set by a sensor of its own: it has
    what ngspice has on the node, volts or micrometres."""
    kinds, sensors, result = _kinds(laws), [], dict(joins)
    for net, pins in joins.items():
        signals = tuple(pin for pin in pins if kinds[pin] == "signal")
        rest = tuple(pin for pin in pins if pin not in signals)
        if net == GROUND or not signals or not rest:
            continue
        kind = kinds[rest[0]]
        name = f"{net} signals"
        sensors.append(sensor(name, 1 / SOURCES.get(kind, ("", 1.0))[1], kind))
        result[net] = (*rest, f"{name}.a")
        result[name] = (*signals, f"{name}.out")
    return [*laws, *sensors], result


def read(
    circuit: Circuit, waves: Mapping[str, np.ndarray], scale: np.ndarray
) -> dict[str, np.ndarray]:
    """Results of a circuit; a reading of a wave that this analysis has not is left out."""
    result = {}
    for name, item in circuit.readings.items():
        if not {wave for _, wave in item.terms} <= set(waves):
            continue
        value = np.asarray(sum(factor * waves[wave] for factor, wave in item.terms))
        if np.iscomplexobj(value):  # small signals have no constant part
            value = value / (2j * np.pi * scale) if item.charge else value
        else:
            value = value + item.constant
        result[name] = value
    return result
