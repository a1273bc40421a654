"""What a scene needs and what it leaves out: parts, joins, models, each omission with its size."""

from __future__ import annotations

from dataclasses import dataclass

from kc2spice.scene.compose import drawing
from kc2spice.scene.division import division
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
        errors=division(scene, estimate=estimate),
    )
