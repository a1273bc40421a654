"""The models of a scene's parts: FE, reduction and field tables, built once and cached."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from kc2spice.core.progress import Clock
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.modal import mode_table
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.workflow.decks import libraries, shared
from kc2spice.workflow.steps import largest_step


def build_models(
    scene: Scene,
    clock: Clock,
    *,
    trust: bool = False,
    functions: Mapping[str, Any] | None = None,
) -> Build:
    """Build or fetch the models of the parts that the scene names, and only those.

    ``trust`` lets included netlists act on the machine; ``functions`` are those of controllers, by
    part.
    """
    models = {name: part.type.build(part, scene, clock) for name, part in scene.parts.items()}
    build = shared(Build(scene, models, libraries(scene), trust=trust, functions=functions or {}))
    if scene.analysis.type != "transient":
        return build
    return replace(build, largest=largest_step(build))


def model_facts(build: Build) -> dict[str, dict[str, float]]:
    """``model`` of ``result.json``: the numbers by which an engineer knows the parts."""
    parts = build.scene.parts.values()
    facts = {part.name: dict(build.facts(part)) for part in parts}
    return {name: found for name, found in facts.items() if found}


def mode_tables(build: Build) -> dict[str, dict[str, Any]]:
    """``modes`` of ``result.json``: those of each body that has some within its band."""
    found = {n: mode_table(m) for n, m in build.models.items() if isinstance(m, LinearModel)}
    return {name: modes for name, modes in found.items() if modes}


def rom_facts(build: Build) -> dict[str, Any]:
    """``rom`` of ``result.json``, that of the first part with a reduced model; ``roms`` of all."""
    reduced = {n: _rom(m) for n, m in build.models.items() if isinstance(m, LinearModel)}
    if not reduced:
        return {}
    first = {"rom": next(iter(reduced.values()))}
    return first | {"roms": reduced} if len(reduced) > 1 else first


def _rom(model: LinearModel) -> dict[str, Any]:
    found: dict[str, Any] = {
        "order": model.order,
        "ports": [port.name for port in model.ports],
        "massless": 0 if model.M is None else int((model.M.diagonal() == 0).sum()),
    }
    return found if model.certificate is None else found | model.certificate.record()
