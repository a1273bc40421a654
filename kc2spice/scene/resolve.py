"""Resolve a scene: ask each part once, in order of dependence, and keep the answers as records.

A scene with checked keys goes in. The scene that comes out has one :class:`Record` for each part,
its nets and its reference frames. Later stages read the records; they do not ask part types again.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from itertools import chain
from typing import Any

from kc2spice.scene.compose import composed
from kc2spice.scene.model import Build, BuildRecord, Part, Record, Scene
from kc2spice.scene.rows import Numerics, State


def resolve(scene: Scene) -> Scene:
    """Return the scene with its nets, its reference frames and all answers of its parts.

    Raises
    ------
    UsageError : as :func:`kc2spice.scene.compose.composed`.
    """
    if any(scene.record(part) is None for part in scene.parts.values()):
        scene = with_governed(scene)
    return with_numerics(composed(scene))


def resolve_build(build: Build) -> Build:
    """Return the build with the answers of its parts about it: their results, and what can be set.

    What can be set on a part follows from what holds the others at rest.
    """
    build = with_vectors(build)
    records = dict(build.records)
    for part in _with_cards(build):
        settable = part.type.settable(part, build)
        records[part.name] = replace(records[part.name], settable=settable)
    return replace(build, records=records)


def with_vectors(build: Build, without: Collection[str] = ()) -> Build:
    """Return the build with its parts at rest and with their results, ``without`` those of some.

    The current of a body follows from the results of the parts that are joined to it. Parts without
    cards have neither results nor anything that can be set.
    """
    records = {
        name: BuildRecord(part.type.rest_with_model(part, build))
        for name, part in build.scene.parts.items()
    }
    for reduced in (False, True):
        build = replace(build, records=dict(records))
        for part in _with_cards(build):
            if part.reduced == reduced and part.name not in without:
                vectors = part.type.vectors(part, build)
                records[part.name] = replace(records[part.name], vectors=vectors)
    return replace(build, records=records)


def _with_cards(build: Build) -> list[Part]:
    """The parts that no other one copies or moves."""
    scene = build.scene
    return [part for name, part in scene.parts.items() if name not in scene.without_cards]


def with_governed(scene: Scene) -> Scene:
    """Return the scene with what its parts govern, and with the details of their own packages.

    The details may depend on each other: each is computed at its first use.
    """
    governs = {part.name: part.type.governs(part, scene) for part in scene.parts.values()}
    records: dict[str, Record[Any]] = {
        name: Record(part, governs[name], part.type.highest_frequency(part, scene))
        for name, part in scene.parts.items()
    }
    scene = replace(
        scene,
        records=records,
        movers=_movers(governs),
        initial_states=_initial_states(governs),
        without_cards=_without_cards(governs),
    )
    for part in scene.parts.values():
        detail = part.type.detail(part, scene)
        records[part.name] = replace(records[part.name], detail=detail)
    return scene


def _movers(governs: Mapping[str, Mapping[str, State | str]]) -> dict[str, str]:
    """The first part that prescribes all motion of another one, by the name of that one."""
    result: dict[str, str] = {}
    for owner, answer in governs.items():
        for name, what in answer.items():
            if what == "moved":
                result.setdefault(name, owner)
    return result


def _initial_states(governs: Mapping[str, Mapping[str, State | str]]) -> dict[str, State]:
    """The parts whose state at t = 0 is stated; a transient then has no operating point.

    What another part states of one replaces what its own keys state.
    """
    result: dict[str, State] = {}
    for owner, answer in governs.items():
        for name, state in answer.items():
            if isinstance(state, State) and (name != owner or name not in result):
                result[name] = state
    return result


def _without_cards(governs: Mapping[str, Mapping[str, State | str]]) -> frozenset[str]:
    """Parts without cards of their own: those of others have copies of them, or move them."""
    rows = chain.from_iterable(answer.items() for answer in governs.values())
    return frozenset(name for name, what in rows if isinstance(what, str))


EVEN = 1e-6  # relative, of a period that divides another


def drive_period(rows: Iterable[Numerics]) -> float | None:
    """The period [s] of all that drives a scene: the longest, where the others divide it."""
    periods = {row.period for row in rows} - {0.0}
    longest = max(periods, default=None)
    if longest is None or any(abs(longest / p - round(longest / p)) > EVEN for p in periods):
        return None
    return longest


def with_numerics(scene: Scene) -> Scene:
    """Return a scene with nets, with the numerical requirements and the reductions of its parts."""
    rows = {n: tuple(r.part.type.numerics(r.part, scene)) for n, r in scene.records.items()}
    records = {name: replace(r, numerics=rows[name]) for name, r in scene.records.items()}
    scales = tuple(chain.from_iterable(rows.values()))
    scene = replace(scene, records=records, numerics=scales, period=drive_period(scales))
    reductions = {n: r.part.type.reduction(r.part, scene) for n, r in records.items()}
    return replace(
        scene, records={n: replace(r, reduction=reductions[n]) for n, r in records.items()}
    )


def resolve_again(scene: Scene) -> Scene:
    """Return the scene after a change of keys or of its frame, with the pins and nets it has."""
    scene = with_governed(scene)
    rests = {name: r.part.type.at_rest(r.part, scene) for name, r in scene.records.items()}
    records = {name: replace(r, rest=rests[name]) for name, r in scene.records.items()}
    return with_numerics(replace(scene, records=records))
