"""Resolve a scene: ask each part once, in order of dependence, and keep the answers as records.

A scene with checked keys goes in. The scene that comes out has one :class:`Record` for each part,
its nets and its reference frames. Later stages read the records; they do not ask part types again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from kc2spice.scene.compose import composed
from kc2spice.scene.model import Build, BuildRecord, BuildRecords, Record, Scene
from kc2spice.scene.parttype import replaced


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
    """Return the build with the answers of its parts about it.

    The current of a body follows from the results of the parts that are joined to it, and what can
    be set on a part follows from what holds the others at rest. Parts without cards have neither
    results nor anything that can be set.
    """
    records = {part.name: BuildRecord(build.rest(part)) for part in build.scene.parts.values()}
    build = replace(build, records=BuildRecords(build.scene, build.models, records))
    without = replaced(build.scene)
    parts = [part for name, part in build.scene.parts.items() if name not in without]
    for part in sorted(parts, key=lambda item: item.reduced):
        vectors = part.type.vectors(part, build)
        records[part.name] = replace(records[part.name], vectors=vectors)
    for part in parts:
        settable = part.type.settable(part, build)
        records[part.name] = replace(records[part.name], settable=settable)
    return build


def with_governed(scene: Scene) -> Scene:
    """Return the scene with what its parts govern, and with the details of their own packages.

    The details may depend on each other: each is computed at its first use.
    """
    records: dict[str, Record[Any]] = {}
    for part in scene.parts.values():
        records[part.name] = Record(part, part.type.governs(part, scene))
    scene = replace(scene, records=records)
    for part in scene.parts.values():
        detail = part.type.detail(part, scene)
        records[part.name] = replace(records[part.name], detail=detail)
    return scene


def with_numerics(scene: Scene) -> Scene:
    """Return a scene with nets, with the numerical requirements and the reductions of its parts."""
    records = dict(scene.records)
    for name, record in records.items():
        rows = tuple(record.part.type.numerics(record.part, scene))
        records[name] = replace(record, numerics=rows)
    scene = replace(scene, records=records)
    reductions = {n: r.part.type.reduction(r.part, scene) for n, r in records.items()}
    return replace(
        scene, records={n: replace(r, reduction=reductions[n]) for n, r in records.items()}
    )


def resolve_again(scene: Scene) -> Scene:
    """Return the scene after a change of keys or of its frame, with the pins and nets it has."""
    former = scene.records
    scene = with_governed(scene)
    records = dict(scene.records)
    for name, record in records.items():
        rest = record.part.type.at_rest(record.part, scene)
        records[name] = replace(record, joins=former[name].joins, rest=rest)
    return with_numerics(replace(scene, records=records))
