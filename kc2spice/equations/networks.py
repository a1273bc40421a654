"""Networks of laws that share no nets apart from ground.

Laws are the equations of parts. The functions of this module need laws and groups of joined pins,
but no scene. The notation for a pin of a law is ``LAW.PIN``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter

from kc2spice.core.constitutive_laws import (
    GROUND,
    Device,
    IdealSource,
    Law,
    PortBody,
    SecondOrderBody,
    WaveCombination,
    make_sensor_block,
)
from kc2spice.core.domains import TABLE

# SI value of the across quantity that 1 V on a node represents, keyed by the kind of the pin.
NODE_UNITS = {domain.pin_kind: domain.across.factor for domain in TABLE}


@dataclass(frozen=True)
class Network:
    """Network: laws (equations of parts) that are connected by nets other than ground.

    ``joins`` maps the name of each net to its pins. ``results`` maps the name of each result to a
    linear combination of waveforms. ``sweeps`` maps each pair ``(part, key)`` to a pair ``(source,
    factor)``. If the key has the value x in SI units, the source with the name ``source`` has the
    value ``factor`` times x.
    """

    laws: tuple[Law, ...]
    joins: Mapping[str, tuple[str, ...]]
    results: Mapping[str, WaveCombination]
    sweeps: Mapping[tuple[str, str], tuple[str, float]]

    @property
    def has_sources_only(self) -> bool:
        """Whether all laws are sources, so that the network has no unknowns."""
        return all(isinstance(law, IdealSource) for law in self.laws)

    @property
    def law_names(self) -> frozenset[str]:
        """Names of the laws in the network."""
        return frozenset(map(attrgetter("name"), self.laws))

    def is_fully_driven_by(self, driven: set[str]) -> bool:
        """Return whether sources drive all nets except ground in a network without bodies.

        ``driven`` contains the output pins of the sources that drive the nets. The result is also
        false if the network contains a body, or if ``driven`` is empty.
        """
        if not driven or any(isinstance(law, SecondOrderBody | PortBody) for law in self.laws):
            return False
        ungrounded = dict(self.joins)
        ungrounded.pop(GROUND, None)
        return not any(map(driven.isdisjoint, ungrounded.values()))

    def select(self, names: set[str]) -> Network:
        """Return the part of the network that contains only the laws with given names."""
        joins, results, sweeps = dict[str, tuple[str, ...]](), {}, {}
        for net, pins in self.joins.items():
            selected_pins = tuple(pin for pin in pins if get_law_name(pin) in names)
            if selected_pins:
                joins[net] = selected_pins
        for name, item in self.results.items():
            if get_law_name(item.waves[0]) in names:
                results[name] = item
        for key, source in self.sweeps.items():
            if source[0] in names:
                sweeps[key] = source
        laws = tuple(law for law in self.laws if law.name in names)
        return Network(laws, joins, results, sweeps)


def split_networks(
    laws: Sequence[Law],
    joins: Mapping[str, tuple[str, ...]],
    results: Mapping[str, WaveCombination],
    sweeps: Mapping[tuple[str, str], tuple[str, float]],
) -> tuple[Network, ...]:
    """Split laws into networks that have no net in common apart from ground."""
    laws, joins = connect_sensors(laws, joins)
    groups = [{law.name} for law in laws]
    for net, pins in joins.items():
        if net != GROUND:
            groups.append(set(map(get_law_name, pins)))
    scene = Network(tuple(laws), joins, results, sweeps)
    return tuple(map(scene.select, merge_groups(groups)))


def connect_sensors(
    laws: Sequence[Law], joins: Mapping[str, tuple[str, ...]]
) -> tuple[list[Law], dict[str, tuple[str, ...]]]:
    """Insert a sensor on each net that joins a signal pin to another kind of pin.

    The output of the sensor equals the node voltage in the netlist. 1 V on the node represents a
    voltage of 1 V or a displacement of 1 um.
    """
    kinds, sensors, result = list_pin_kinds(laws), [], dict(joins)
    for net, pins in joins.items():
        signals, others = list[str](), list[str]()
        for pin in pins:
            (signals if kinds[pin] == "signal" else others).append(pin)
        if net == GROUND or not signals or not others:
            continue
        kind = kinds[others[0]]
        name = f"{net} signals"
        sensors.append(make_sensor_block(name, 1 / NODE_UNITS[kind], kind))
        result[net] = (*others, f"{name}.a")
        result[name] = (*signals, f"{name}.out")
    return [*laws, *sensors], result


def get_law_name(pin: str) -> str:
    """Return the name of the law to which a pin or waveform ``LAW.NAME`` belongs."""
    return pin.partition(".")[0]


def list_pin_kinds(laws: Iterable[Law]) -> dict[str, str]:
    """Return the kind of each pin of the laws, keyed by ``LAW.PIN``."""
    result: dict[str, str] = {}
    for law in laws:
        for pin in law.pins:
            result[f"{law.name}.{pin.name}"] = pin.kind
    return result


def prescribes_value(laws: Mapping[str, Law], pin: str) -> bool:
    """Return whether the law of a pin ``LAW.PIN`` sets the pin's across quantity.

    For example, a voltage source sets the voltage of its pin.
    """
    name, _, end = pin.partition(".")
    law = laws[name]
    if isinstance(law, IdealSource):
        return end == "out" and not law.prescribes_flow
    return isinstance(law, Device) and end in law.prescribed_signals


def merge_groups(groups: Iterable[set[str]]) -> list[set[str]]:
    """Merge groups that have an element in common; return disjoint groups."""
    result: list[set[str]] = []
    for group in groups:
        separate = []
        for other in result:
            if other.isdisjoint(group):
                separate.append(other)
            else:
                group = group | other
        result = [*separate, group]
    return result
