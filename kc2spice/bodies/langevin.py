"""``part = "langevin"``: masses, ceramic rings of alternating poling, and the bolt through them.

    front = [{ material = "aluminium", diameter = "40 mm", length = "30 mm" }]   # outwards
    back = [{ material = "steel", diameter = "40 mm", length = "25 mm" }]
    rings = { material = "PZT-4", outer = "38 mm", inner = "15 mm", thickness = "5 mm", count = 2 }
    bolt = { material = "steel", diameter = "12 mm" }

Everything is bonded where it touches, the bolt to both masses along its thread and not to the
rings. Electrical pins ``anode`` and ``cathode`` (the masses), mechanical ports ``front`` and
``back``: mean axial displacement of the end faces, upwards, towards the front. Left out: the state
that the preload leaves in the ceramic, contact compliance, the electrodes' metal.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

from pydantic import Field, model_validator

from kc2spice.bodies.axisymmetric import Block, Face, Fixed, turned
from kc2spice.bodies.device import Device, part_named
from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Count, Length, Ratio, Section, validated
from kc2spice.fem.keys import Damping, Mesh
from kc2spice.fem.materials import material

_CELLS = 8  # along the largest radius before refinement


class Cylinder(Section):
    """One step of a mass; ``quality`` is for damping per material."""

    material: str | dict[str, Any] = Field(description="name or table")
    diameter: Length = Field(gt=0, description="outer")
    length: Length = Field(gt=0, description="along the axis")
    quality: Ratio | None = Field(None, gt=0, description="for damping.per_material")


class Rings(Section):
    """``count`` equal rings (even, so that both masses are cathodes)."""

    material: str | dict[str, Any] = Field(description="ceramic, name or table")
    outer: Length = Field(gt=0, description="diameter")
    inner: Length = Field(gt=0, description="diameter of the bore")
    thickness: Length = Field(gt=0, description="of one ring")
    count: Count = Field(2, ge=2, le=20, description="an even number")
    quality: Ratio | None = Field(None, gt=0, description="for damping.per_material")

    @model_validator(mode="after")
    def _possible(self) -> Rings:
        if self.count % 2:
            raise ValueError("an odd number of rings puts the anode on a mass that the bolt shorts")
        if self.inner >= self.outer:
            raise ValueError("inner must be smaller than outer")
        return self


class Bolt(Section):
    """The bolt along the axis; it reaches ``depth`` into the front mass and through all of the
    back mass, where its head (if any) sits on the end."""

    material: str | dict[str, Any] = Field(description="name or table")
    diameter: Length = Field(gt=0, description="of the shank")
    depth: Length | None = Field(None, gt=0, description="in the front mass; its first step")
    head_diameter: Length | None = Field(None, gt=0, description="with head_length")
    head_length: Length | None = Field(None, gt=0, description="with head_diameter")
    quality: Ratio | None = Field(None, gt=0, description="for damping.per_material")

    @model_validator(mode="after")
    def _head(self) -> Bolt:
        if (self.head_diameter is None) != (self.head_length is None):
            raise ValueError("a head needs head_diameter and head_length")
        return self


class Langevin(Section):
    """Keys of the part; masses are given outwards from the rings."""

    front: tuple[Cylinder, ...] = Field(min_length=1)
    back: tuple[Cylinder, ...] = Field(min_length=1)
    rings: Rings
    bolt: Bolt
    support: Literal["free", "back"] = Field("free", description="back: its end face is held")
    damping: Damping = Damping()
    mesh: Mesh = Mesh()


def device(
    keys: Langevin | Mapping[str, Any], *, refine: int = 1, where: str = "langevin"
) -> Device:
    """The sandwich with its mesh; facts as those of the disc.

    Raises
    ------
    UsageError : a key is wrong, or the parts do not fit into one another.
    """
    body = validated(Langevin, keys, where)
    _require_fit(body, where)
    pieces, rings = blocks(body, where), body.rings
    bottom, top = min(b.z[0] for b in pieces), max(b.z[1] for b in pieces)
    under = (body.bolt.head_diameter or body.back[-1].diameter) / 2
    faces = {
        "front": Face((0.0, body.front[-1].diameter / 2), top),
        "back": Face((0.0, under), bottom),
    }
    held = []
    if body.support == "back":
        end = faces.pop("back").r
        held = [Fixed("r", end, (bottom, bottom)), Fixed("z", end, (bottom, bottom))]
    r = (rings.inner / 2, rings.outer / 2)
    planes = [Face(r, i * rings.thickness) for i in range(rings.count + 1)]
    with part_named(where):
        return turned(
            pieces,
            {"anode": planes[1::2], "cathode": planes[::2]},
            held,
            faces,
            size=max(b.r[1] for b in pieces) / _CELLS,
            refine=refine * body.mesh.refine,
            damping=body.damping,
        )


def _require_fit(body: Langevin, where: str) -> None:
    depth = body.bolt.depth or body.front[0].length
    narrowest = min(step.diameter for step in (*body.front, *body.back))
    thick, inner, head = body.bolt.diameter, body.rings.inner, body.bolt.head_diameter or math.inf
    length = sum(step.length for step in body.front)
    beside = min(body.front[0].diameter, body.back[0].diameter)
    for wrong, key, got, message in (
        (thick >= inner, "bolt.diameter", thick, "the bolt does not pass through the rings"),
        (thick >= narrowest, "bolt.diameter", thick, "the bolt is thicker than a mass"),
        (
            depth > length * (1 + 1e-9),
            "bolt.depth",
            depth,
            "the bolt reaches through the front mass",
        ),
        (beside <= inner, "rings.inner", inner, "a mass falls through the rings"),
        (head <= thick, "bolt.head_diameter", head, "the head is no wider than the bolt"),
    ):
        if wrong:
            raise UsageError(message, where=f"{where}.{key}", got=f"{got:g} m")


def blocks(body: Langevin, where: str = "langevin") -> list[Block]:
    """Rings from z = 0 up, front above, back below, then the bolt in place of their cores."""
    found: list[Block] = []

    def add(
        part: Any, key: str, r: tuple[float, float], low: float, high: float, up: int = 1
    ) -> None:
        one = material(part.material, f"{where}.{key}.material")
        quality = part.quality or one.quality
        poled = replace(one.poled((0, 0, up)), name=f"{key} ({one.name})", quality=quality)
        found.append(Block(r, (low, high), poled))

    rings, bolt = body.rings, body.bolt
    core, ring = bolt.diameter / 2, (rings.inner / 2, rings.outer / 2)
    height = 0.0
    for i in range(rings.count):
        add(rings, f"rings[{i}]", ring, height, height + rings.thickness, (-1) ** i)
        height += rings.thickness
    if not found[0].material.piezoelectric:
        got = found[0].material.name
        raise UsageError(
            "the rings are not piezoelectric", where=f"{where}.rings.material", got=got
        )
    thread = height + (bolt.depth or body.front[0].length)
    for i, step in enumerate(body.front):
        for low, high, inner in _cut(height, height + step.length, thread, core):
            add(step, f"front[{i}]", (inner, step.diameter / 2), low, high)
        height += step.length
    height = 0.0
    for i, step in enumerate(body.back):
        add(step, f"back[{i}]", (core, step.diameter / 2), height - step.length, height)
        height -= step.length
    add(bolt, "bolt", (0.0, core), height, thread)
    if bolt.head_diameter is not None and bolt.head_length is not None:
        add(bolt, "bolt", (0.0, bolt.head_diameter / 2), height - bolt.head_length, height)
    return found


def _cut(low: float, high: float, thread: float, core: float) -> list[tuple[float, float, float]]:
    """Pieces (low, high, inner radius) of a step that the bolt reaches up to ``thread`` into."""
    if thread >= high:
        return [(low, high, core)]
    if thread <= low:
        return [(low, high, 0.0)]
    return [(low, thread, core), (thread, high, 0.0)]
