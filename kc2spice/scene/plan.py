"""What a scene needs and what it leaves out: parts, joins, models, each omission with its size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from kc2spice.scene.compose import drawing
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import ErrorRow, LeftOut, Modelled


@dataclass(frozen=True)
class Plan:
    """What runs for a scene. ``joins`` are the nets, ``errors`` the stages' expected errors."""

    parts: tuple[Modelled, ...]
    joins: tuple[str, ...]
    left_out: tuple[LeftOut, ...]
    error_budget: float | None
    errors: tuple[ErrorRow, ...]


def plan(scene: Scene, *, estimate: bool = False) -> Plan:
    """Parts, joins and omissions of a checked scene; omissions of several parts stand once.

    ``estimate`` adds the errors that take a computation, as those of meshes.
    """
    parts = scene.parts.values()
    left_out = [row for part in parts for row in part.type.left_out(part, scene)]
    return Plan(
        parts=tuple(part.type.modelled(part, scene) for part in parts),
        joins=drawing(scene),
        left_out=tuple(dict.fromkeys(left_out)),
        error_budget=scene.error_budget,
        errors=tuple(_errors(scene, estimate)),
    )


def _errors(scene: Scene, estimate: bool) -> Iterator[ErrorRow]:
    """What is known of each stage before a run; an error_budget estimates the rest of it."""
    parts = scene.parts.values()
    own = [row for part in parts for row in part.type.errors(part, scene)]
    if estimate:
        own += [row for part in parts for row in part.type.estimates(part, scene)]
    yield from own
    timed, budget = scene.analysis.type == "transient", scene.error_budget
    why = "by a run with error_budget" if budget is None else f"until it is {budget:g} in a run"
    for part in parts:
        rom = part.type.reduction(part, scene)
        if rom is not None:
            target = (
                f"order {rom.order}" if rom.tolerance is None else f"tolerance {rom.tolerance:g}"
            )
            known = None if timed else rom.tolerance
            told = f"{target}, band {rom.band[0]:g} … {rom.band[1]:g} Hz"
            yield ErrorRow(f"reduction of {part.name}", None, known, told, why)
    for part in parts:
        stage = f"lookup of {part.name}"
        if part.type.lookup_key is not None and stage not in {row.stage for row in own}:
            points = f"{getattr(part.keys, part.type.lookup_key)} points"
            yield ErrorRow(stage, None, None, points, why)
    if timed:
        told = f"reltol {scene.solver.reltol:g}, chgtol {scene.solver.chgtol:g}"
        yield ErrorRow("time steps", None, None, told, why)
