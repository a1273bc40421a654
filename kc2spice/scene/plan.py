"""What a scene needs and what it leaves out: parts, joins, numerical settings, omissions."""

from __future__ import annotations

from dataclasses import dataclass

from kc2spice.scene.axes import axes
from kc2spice.scene.compose import drawing
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build, LeftOut, Modelled


@dataclass(frozen=True)
class Setting:
    """A numerical setting by its key, its value, and the relative ``error`` known of it before a
    run: None where only a refined run can tell."""

    key: str
    value: float
    error: float | None


@dataclass(frozen=True)
class Plan:
    """What runs for a scene. ``joins`` are the nets, ``settings`` what trades time for error."""

    parts: tuple[Modelled, ...]
    joins: tuple[str, ...]
    left_out: tuple[LeftOut, ...]
    error_budget: float | None
    settings: tuple[Setting, ...]


def plan(scene: Scene, build: Build | None = None) -> Plan:
    """Parts, joins and omissions of a checked scene; omissions of several parts stand once.

    With its ``build`` the time step is among the settings where nobody set it.
    """
    parts = scene.parts.values()
    left_out = [row for part in parts for row in part.type.left_out(part, scene)]
    certified = scene.analysis.type == "ac"  # steps and contacts excite what is above the band
    return Plan(
        parts=tuple(part.type.modelled(part, scene) for part in parts),
        joins=drawing(scene),
        left_out=tuple(dict.fromkeys(left_out)),
        error_budget=scene.error_budget,
        settings=tuple(
            Setting(
                axis.name,
                axis.value,
                axis.value if certified and axis.name.endswith("rom.tolerance") else None,
            )
            for axis in axes(scene, build)
        ),
    )
