"""How the error of a scene's result is divided over the stages, and who set what."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from kc2spice.scene.budget import STEP, Stages, divide, known_error, lookup_error
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import ErrorRow
from kc2spice.scene.settings import Rom

KEYS = {
    "reduction": ("rom.order", "rom.tolerance", "rom.band"),
    "time stepping": ("solver.reltol", "solver.chgtol"),
}


def stages(scene: Scene) -> Stages:
    """What of a checked scene costs accuracy."""
    types = {part.name: part.type for part in scene.parts.values()}
    own = "band" in scene.rom.model_fields_set and "rom.band" not in scene.budgeted
    band = scene.rom.band if own else None
    return Stages.of(types, scene.analysis.type == "transient", band)


def division(scene: Scene, *, estimate: bool = False) -> tuple[ErrorRow, ...]:
    """Every stage of the scene; the shares add up to ``error_budget`` at most.

    ``estimate`` also asks for errors that take a computation.
    """
    parts = scene.parts.values()
    own = [row for part in parts for row in part.type.errors(part, scene)]
    if estimate:
        own += [row for part in parts for row in part.type.estimates(part, scene)]
    return (*own, *_stages(scene))


def _stages(scene: Scene) -> Iterator[ErrorRow]:
    budget, found = scene.error_budget, stages(scene)
    for stage, setting in divide(found, budget or 1.0).items():
        own = _reductions(scene) if stage == "reduction" else {}
        if any(rom != scene.rom for rom in own.values()):
            yield from (_reduction(name, rom, found) for name, rom in own.items())
            continue
        keys = KEYS.get(stage, tuple(setting.keys))
        if stage == "time stepping" and found.throws:
            keys = (*keys, STEP)
        values = {name: _value(scene, name) for name in keys}
        text = ", ".join(f"{k} {_short(v)}" for k, v in values.items() if v is not None)
        counted = {k for k, v in values.items() if v is not None}
        if not (found.transient and found.contact):
            counted -= {"rom.band"}
        ours = budget is not None and scene.budgeted >= counted
        yield ErrorRow(
            stage,
            setting.error if ours else None,
            _expected(scene, found, stage, values),
            text,
            "error_budget" if ours else "set by the scene",
        )


def _reductions(scene: Scene) -> dict[str, Rom]:
    """The settings of each part's reduction."""
    found = {part.name: part.type.reduction(part, scene) for part in scene.parts.values()}
    return {name: rom for name, rom in found.items() if rom is not None}


def _reduction(name: str, rom: Rom, found: Stages) -> ErrorRow:
    """Where bodies do not follow the scene's ``rom``: one row for each."""
    target = "order" if rom.tolerance is None else "tolerance"
    text = f"{target} {_short(getattr(rom, target))}, band {_short(rom.band)}"
    expected = None if found.transient else rom.tolerance
    return ErrorRow(f"reduction of {name}", None, expected, text, "of the frequency response")


def _expected(scene: Scene, found: Stages, stage: str, values: dict[str, Any]) -> float | None:
    if stage == "lookup":
        return lookup_error(found, next(iter(values.values())))
    certified = not found.contact and "rom.tolerance" in scene.budgeted
    if not found.transient or (stage == "reduction" and certified):
        return scene.rom.tolerance
    if not all(part.type.measured(part, scene) for part in scene.parts.values()):
        return None
    return known_error(found.reductions if stage == "reduction" else found.steppings, values)


def _value(scene: Scene, name: str) -> Any:
    section, key = name.split(".")
    holder = scene.parts[section].keys if section in scene.parts else getattr(scene, section)
    return getattr(holder, key)


def _short(value: Any) -> str:
    return " … ".join(f"{each:g}" for each in value) if isinstance(value, tuple) else f"{value:g}"
