"""The models of a scene's parts: FE, reduction and field tables, built once and cached."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kc2spice.core.progress import Clock
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.workflow.ahead import built_ahead
from kc2spice.workflow.decks import libraries


def build_models(
    scene: Scene,
    clock: Clock,
    *,
    trust: bool = False,
    functions: Mapping[str, Any] | None = None,
    ahead: bool = False,
) -> Build:
    """Build or fetch the models of the parts that the scene names, and only those.

    ``trust`` lets included netlists act on the machine; ``functions`` are those of controllers, by
    part. ``ahead`` computes two at a time; see :func:`kc2spice.workflow.ahead.built_ahead`.
    """
    keyed = model_keys(scene) if ahead else {}
    waiting = {name: scene.parts[name] for name in keyed}
    models = {}
    with built_ahead(scene, waiting, clock):
        for name, part in scene.parts.items():
            models[name] = part.type.build(part, scene, clock)
            waiting.pop(name, None)
    return Build(scene, models, libraries(scene), trust=trust, functions=functions or {})


def model_keys(scene: Scene) -> dict[str, Mapping[str, Any]]:
    """What the models depend on, by part; parts with equal entries share a model."""
    keys = {part.name: part.type.model_key(part, scene) for part in scene.parts.values()}
    return {name: key for name, key in keys.items() if key is not None}


def model_facts(build: Build) -> dict[str, dict[str, float]]:
    """``model`` of ``result.json``: the numbers by which an engineer knows the parts."""
    parts = build.scene.parts.values()
    facts = {part.name: dict(part.type.facts(part, build)) for part in parts}
    return {name: found for name, found in facts.items() if found}


def rom_facts(build: Build) -> dict[str, Any]:
    """``rom`` of ``result.json``, that of the first part with a reduced model; ``roms`` of all."""
    parts = build.scene.parts.values()
    found = {part.name: part.type.rom(part, build) for part in parts}
    reduced = {name: rom for name, rom in found.items() if rom is not None}
    if not reduced:
        return {}
    first = {"rom": next(iter(reduced.values()))}
    return first | {"roms": reduced} if len(reduced) > 1 else first
