"""Calls of the methods of part types, in the order of their dependences.

The input is a scene with checked keys. The resolved scene contains a :class:`PartRecord` of each
part, the nets and the reference frames. Each method of a part is called only once, because later
stages of the run read its result from the :class:`PartRecord`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from itertools import chain
from operator import attrgetter
from typing import Any

import numpy as np

from kc2spice.scene.net_formation import join_parts, with_equilibrium_conditions
from kc2spice.scene.part_records import Governed, InitialState, NumericalRequirements
from kc2spice.scene.results import collect_results, find_noise_output, resolve_dc_sweep
from kc2spice.scene.scene_classes import (
    BuiltPartRecord,
    BuiltScene,
    NameAllocator,
    Part,
    PartRecord,
    Scene,
)


def resolve(scene: Scene) -> Scene:
    """Resolve a scene: join pins, find reference frames, and add a record per part.

    Raises
    ------
    UsageError : the connections of the scene are invalid, for example because a pin is unknown. The
        documentation of :func:`kc2spice.scene.net_formation.join_parts` lists all invalid
        connections.
    """
    if any(scene.get_record(part) is None for part in scene.parts.values()):
        scene = add_part_records(scene)
    return with_numerics(join_parts(scene))


def add_results_and_sources(build: BuiltScene) -> BuiltScene:
    """Add result definitions and settable sources to a built scene.

    A settable source is a source whose value an analysis sets, such as the source that a dc
    analysis sweeps. Which sources of a part are settable depends on the equilibrium conditions of
    other parts.

    Raises
    ------
    UsageError : the key ``sweep`` of a dc analysis or the key ``output`` of a noise analysis is
        invalid (:func:`kc2spice.scene.results.resolve_dc_sweep`,
        :func:`kc2spice.scene.results.find_noise_output`).
    """
    build = add_equilibrium_and_results(build)
    records = dict(build.records)
    for part in _list_parts_with_cards(build):
        settable = part.type.settable_quantities(part, build)
        records[part.name] = replace(records[part.name], settable=settable)
    build = replace(build, records=records)
    output = find_noise_output(build)
    build = replace(build, dc_sweep=resolve_dc_sweep(build), noise_output=output)
    return replace(build, results=collect_results(build))


def add_equilibrium_and_results(build: BuiltScene, without: Collection[str] = ()) -> BuiltScene:
    """Add equilibrium conditions and result definitions of parts to a built scene.

    The parts in ``without``, and parts without cards in the deck, get no results. The current of a
    body is computed from the results of the parts that are joined to the body. The results of
    bodies are therefore computed last.
    """
    records = {}
    for name, part in build.scene.parts.items():
        records[name] = BuiltPartRecord(part.type.equilibrium_after_build(part, build))
    for reduced in (False, True):
        build = replace(build, records=dict(records))
        for part in _list_parts_with_cards(build):
            if part.is_body == reduced and part.name not in without:
                vectors = part.type.vectors(part, build)
                records[part.name] = replace(records[part.name], vectors=vectors)
    return replace(build, records=records)


def _list_parts_with_cards(build: BuiltScene) -> list[Part]:
    """List the parts whose own cards are in the deck.

    Parts that another part copies or moves have no cards of their own.
    """
    scene = build.scene
    return [part for name, part in scene.parts.items() if name not in scene.without_cards]


def add_part_records(scene: Scene) -> Scene:
    """Add a record for each part, with the parts that it moves, copies or initialises.

    The records also contain the shared data of each part. The shared data of one part may depend on
    the shared data of other parts.
    """
    governed_parts: dict[str, Mapping[str, InitialState | Governed]] = {}
    records: dict[str, PartRecord[Any]] = {}
    for name, part in scene.parts.items():
        governed_parts[name] = part.type.governed_parts(part, scene)
        frequency = part.type.make_frequency_estimator(part, scene)
        records[name] = PartRecord(part, governed_parts[name], frequency)
    scene = replace(
        scene,
        records=records,
        movers=_find_movers(governed_parts),
        initial_states=_find_initial_states(governed_parts),
        without_cards=_find_parts_without_cards(governed_parts),
    )
    for part in scene.parts.values():
        shared_data = part.type.shared_data(part, scene)
        records[part.name] = replace(records[part.name], shared_data=shared_data)
    return scene


def _find_movers(
    governed_parts: Mapping[str, Mapping[str, InitialState | Governed]],
) -> dict[str, str]:
    """Return a mapping from each moved part to the first part that moves it."""
    result: dict[str, str] = {}
    for owner, answer in governed_parts.items():
        for name, governed in answer.items():
            if governed == "moved":
                result.setdefault(name, owner)
    return result


def _find_initial_states(
    governed_parts: Mapping[str, Mapping[str, InitialState | Governed]],
) -> dict[str, InitialState]:
    """Map the name of each part with a prescribed state at t = 0 to this state.

    A transient with prescribed states does not start at an operating point. If a part prescribes
    its own initial state and a second part also prescribes it, the value of the second part is
    used.
    """
    result: dict[str, InitialState] = {}
    for owner, answer in governed_parts.items():
        for name, state in answer.items():
            if isinstance(state, InitialState) and (name != owner or name not in result):
                result[name] = state
    return result


def _find_parts_without_cards(
    governed_parts: Mapping[str, Mapping[str, InitialState | Governed]],
) -> frozenset[str]:
    """Find the parts without cards of their own: parts that other parts copy or move."""
    rows = chain.from_iterable(answer.items() for answer in governed_parts.values())
    return frozenset(name for name, governed in rows if isinstance(governed, str))


# largest permitted deviation of the ratio (longest period / period) from a whole number
PERIOD_TOLERANCE = 1e-6


def find_period(rows: Iterable[NumericalRequirements]) -> float | None:
    """Return the longest period [s] if it is a multiple of all others, else None."""
    periods = set(map(attrgetter("period"), rows)) - {0.0}
    longest: float | None = max(periods, default=None)
    if longest is None:
        return None
    ratios = longest / np.array(list(periods))
    return None if np.any(abs(ratios - ratios.round()) > PERIOD_TOLERANCE) else longest


def with_numerics(scene: Scene) -> Scene:
    """Return the scene with each part's numerical requirements and reduction settings."""
    records = {}
    rows: list[NumericalRequirements] = []
    for name, record in scene.records.items():
        numerics = tuple(record.part.type.numerics(record.part, scene))
        records[name] = replace(record, numerics=numerics)
        rows += numerics
    scene = replace(scene, records=records, numerics=tuple(rows), period=find_period(rows))
    reduced = {}
    for name, record in records.items():
        reduction = record.part.type.choose_reduction(record.part, scene)
        reduced[name] = replace(record, reduction=reduction)
    return replace(scene, records=reduced)


def update_part_records(scene: Scene) -> Scene:
    """Update the records of all parts after a change of keys; keep the nets."""
    return with_numerics(with_equilibrium_conditions(add_part_records(scene)))


def name_subcircuits(scene: Scene) -> dict[str, str]:
    """Return the subcircuit name of each part, keyed by part name.

    If parts of different types choose the same name, each subcircuit gets the name of its part.
    """
    parts = scene.parts.values()
    names = {part.name: part.type.subcircuit_name(part, scene) for part in parts}
    types: dict[str, set[str]] = {}
    for part in parts:
        types.setdefault(names[part.name].lower(), set()).add(part.type.name)
    unique = NameAllocator(names[part.name] for part in parts if part.is_user_netlist)
    for part in parts:
        if not part.is_user_netlist:
            name = names[part.name]
            preferred = name if len(types[name.lower()]) == 1 else part.name
            names[part.name] = unique.allocate_name((part.type.name, preferred), preferred)
    return names
