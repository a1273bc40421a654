"""Laws (equations) of all parts of a scene, and the nets that join their pins.

:func:`get_scene_laws` returns the laws of a scene. Other modules use the laws to choose and check
the time step of a run, to find resonances, and to verify scenes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, filterfalse
from operator import attrgetter
from typing import NamedTuple

from kc2spice.core.constitutive_laws import (
    GROUND,
    Equations,
    IdealSource,
    Law,
    MissingEquations,
    SecondOrderBody,
    WaveCombination,
)
from kc2spice.core.domains import FLOW_SYMBOLS
from kc2spice.equations.networks import (
    Network,
    list_pin_kinds,
    merge_groups,
    prescribes_value,
    split_networks,
)
from kc2spice.scene.scene_classes import BuiltScene


class PinLink(NamedTuple):
    """Pin of a part on a net, and the corresponding pin ``LAW.PIN`` of a law."""

    net: str
    part: str
    pin: str
    law_pin: str


@dataclass(frozen=True)
class SceneLaws:
    """Laws of the parts of a built scene, created at first use.

    A part without cards (netlist statements) has no law. Parts have no cards if another part
    prescribes their motion, or writes copies of their subcircuits. A part whose signal drives a
    load has no law either, because signals of laws carry no current.
    """

    build: BuiltScene

    @cached_property
    def parts_with_cards(self) -> tuple[str, ...]:
        """Names of the parts that have netlist statements."""
        scene = self.build.scene
        return tuple(filterfalse(scene.without_cards.__contains__, scene.parts))

    @cached_property
    def available_equations(self) -> Mapping[str, Equations]:
        """Equations of each part that has both netlist statements and known equations."""
        stated = self._equations_by_part.items()
        return {name: item for name, item in stated if isinstance(item, Equations)}

    @cached_property
    def _equations_by_part(self) -> Mapping[str, Equations | MissingEquations | None]:
        """Equations keyed by part, or the reason why a part has no equations."""
        parts = map(self.build.scene.parts.__getitem__, self.parts_with_cards)
        return {part.name: part.type.law(part, self.build) for part in parts}

    @cached_property
    def reasons_without_law(self) -> Mapping[str, str]:
        """Reason why a part has no law, keyed by part.

        The reason is empty if the part type states no reason.
        """
        result = dict.fromkeys(self.parts_without_law, "")
        for name in self.parts_without_law:
            match self._equations_by_part[name]:
                case MissingEquations(reason):
                    result[name] = reason
                case Equations():
                    result[name] = (
                        "its signal drives a load, but the reference equations assume signals "
                        "without current"
                    )
        return result

    @cached_property
    def equations(self) -> Mapping[str, Equations]:
        """Equations of each part that has a law."""
        return {
            k: v
            for k, v in self.available_equations.items()
            if k not in self._parts_with_loaded_signals
        }

    @cached_property
    def parts_without_law(self) -> tuple[str, ...]:
        """Names of the parts with netlist statements, but without a law.

        A part without a law prevents the integration of the whole scene.
        """
        return tuple(filterfalse(self.equations.__contains__, self.parts_with_cards))

    @cached_property
    def is_linear(self) -> bool:
        """Whether the equations of all parts are known and linear.

        Parts that other parts copy or move have no netlist statements, and are ignored.
        """
        parts = self.build.scene.parts
        names = [name for name in self.parts_with_cards if not parts[name].is_body]
        if not self.available_equations.keys() >= set(names):
            return False
        stated = chain.from_iterable(self.available_equations[name].laws for name in names)
        return all(
            isinstance(law, SecondOrderBody | IdealSource) or law.is_linear for law in stated
        )

    @cached_property
    def laws(self) -> dict[str, Law]:
        """Laws of all parts, keyed by the name of the law."""
        return _index_laws(self.equations)

    @cached_property
    def pin_kinds(self) -> dict[str, str]:
        """Kind of each pin of all laws, keyed by ``LAW.PIN``."""
        return list_pin_kinds(self.laws.values())

    @cached_property
    def pin_links(self) -> tuple[PinLink, ...]:
        """Links from each pin of a part to the corresponding pin in the part's equations."""
        return tuple(_list_pin_links(self.build, self.equations))

    @cached_property
    def networks(self) -> tuple[Network, ...]:
        """Networks of part equations that share no nets with each other except ground.

        Raises
        ------
        UsageError : the laws of the parts are incompatible.
        """
        return self.build_networks({})

    def build_networks(self, sources: Mapping[str, IdealSource]) -> tuple[Network, ...]:
        """Build the separate networks that the joined laws and additional sources form.

        ``sources`` are keyed by net.
        """
        results: dict[str, WaveCombination] = {}
        sweeps: dict[tuple[str, str], tuple[str, float]] = {}
        for name, item in self.equations.items():
            results |= _add_quantity_names(name, item.results)
            for key, source in item.sweeps.items():
                sweeps[name, key] = source
        laws = [*self.laws.values(), *sources.values()]
        return split_networks(laws, self.list_law_pins_by_net(sources), results, sweeps)

    def list_law_pins_by_net(
        self, sources: Mapping[str, IdealSource]
    ) -> dict[str, tuple[str, ...]]:
        """Return the pins of the laws and of additional sources, keyed by net.

        If several nets of the scene contain the same pin of a law, these nets become one net.
        """
        inside = chain.from_iterable(map(attrgetter("nets"), self.equations.values()))
        by_net: dict[str, set[str]] = {}
        for net, source in sources.items():
            by_net[net] = {f"{source.name}.out"}
        for link in self.pin_links:
            by_net.setdefault(link.net, {GROUND} if link.net == "0" else set()).add(link.law_pin)
        groups = merge_groups([*map(set, inside), *by_net.values()])
        grounded, ungrounded = set[str](), []
        for pins in groups:
            if GROUND in pins:
                grounded |= pins - {GROUND}
            elif len(pins) > 1:
                ungrounded.append(tuple(sorted(pins)))
        result = {f"n{k}": pins for k, pins in enumerate(sorted(ungrounded))}
        return result | ({GROUND: tuple(sorted(grounded))} if grounded else {})

    @cached_property
    def _parts_with_loaded_signals(self) -> frozenset[str]:
        """Names of the parts whose signal output is on a net with other kinds of pins.

        The other pins load the net with a current or a force.
        """
        laws = _index_laws(self.available_equations)
        kinds = list_pin_kinds(laws.values())
        loaded, drivers = set[str](), list[PinLink]()
        for link in _list_pin_links(self.build, self.available_equations):
            if kinds[link.law_pin] != "signal":
                loaded.add(link.net)
            elif prescribes_value(laws, link.law_pin):
                drivers.append(link)
        return frozenset(link.part for link in drivers if link.net in loaded)


def _add_quantity_names(
    part: str, results: Mapping[str, WaveCombination]
) -> dict[str, WaveCombination]:
    """Add second names to results of a part, such as ``r.current`` for ``r.i``.

    For example, the current ``r.i`` is also named ``r.current``.
    """
    names = dict(results)
    for quantity_name, symbol in FLOW_SYMBOLS.items():
        if f"{part}.{symbol}" in results:
            names.setdefault(f"{part}.{quantity_name}", results[f"{part}.{symbol}"])
    return names


def _index_laws(equations: Mapping[str, Equations]) -> dict[str, Law]:
    """Return the laws in the equations of all parts, keyed by the name of the law."""
    laws = chain.from_iterable(map(attrgetter("laws"), equations.values()))
    return {law.name: law for law in laws}


def _list_pin_links(build: BuiltScene, equations: Mapping[str, Equations]) -> Iterator[PinLink]:
    """Yield the links from each pin of a part to the pin in the part's equations."""
    nets = build.scene.nets
    for name, item in equations.items():
        for pin, law_pin in item.pins:
            yield PinLink(nets[name, pin], name, pin, law_pin)


def get_scene_laws(build: BuiltScene) -> SceneLaws:
    """Return the laws of a built scene.

    Laws that :func:`store_laws` has stored in the build are returned if they are still valid. If
    the scene or a model has changed, new laws are created.
    """
    laws = build.laws
    if isinstance(laws, SceneLaws) and _have_same_models(laws.build, build):
        return laws
    return SceneLaws(build)


def store_laws(build: BuiltScene) -> BuiltScene:
    """Return a copy of a built scene that stores the laws for later calls."""
    return replace(build, laws=get_scene_laws(build))


def _have_same_models(a: BuiltScene, b: BuiltScene) -> bool:
    """Return whether two built scenes share their loaded scene and their models."""
    return a.scene is b.scene and a.models is b.models
