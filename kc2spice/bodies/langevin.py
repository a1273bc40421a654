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

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

from pydantic import Field, model_validator

from kc2spice.bodies.axisymmetric import Block, Electrode, Face, Fixed, turned
from kc2spice.bodies.device import Device, part_named
from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Count, Length, Ratio, Section
from kc2spice.core.schema import validated
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
    blocks = _blocks(body, where)
    bottom, top = min(b.z[0] for b in blocks), _front_end(body)
    faces = {
        "front": Face((0.0, body.front[-1].diameter / 2), top),
        "back": Face((0.0, _back_radius(body)), bottom),
    }
    held = []
    if body.support == "back":
        end = (0.0, faces.pop("back").r[1])
        held = [Fixed("r", end, (bottom, bottom)), Fixed("z", end, (bottom, bottom))]
    with part_named(where):
        return turned(
            blocks,
            _electrodes(body.rings),
            held,
            faces,
            size=max(b.r[1] for b in blocks) / _CELLS,
            refine=refine * body.mesh.refine,
            damping=body.damping,
        )


def _stack_height(rings: Rings) -> float:
    return rings.count * rings.thickness


def _front_end(body: Langevin) -> float:
    return _stack_height(body.rings) + sum(step.length for step in body.front)


def _back_radius(body: Langevin) -> float:
    return (body.bolt.head_diameter or body.back[-1].diameter) / 2


def _require_fit(body: Langevin, where: str) -> None:
    depth = body.bolt.depth or body.front[0].length
    narrowest = min(step.diameter for step in (*body.front, *body.back))
    wrong = None
    if body.bolt.diameter >= body.rings.inner:
        wrong = "the bolt does not pass through the rings", "bolt.diameter", body.bolt.diameter
    elif body.bolt.diameter >= narrowest:
        wrong = "the bolt is thicker than a mass", "bolt.diameter", body.bolt.diameter
    elif depth > sum(step.length for step in body.front) * (1 + 1e-9):
        wrong = "the bolt reaches through the front mass", "bolt.depth", depth
    elif min(body.front[0].diameter, body.back[0].diameter) <= body.rings.inner:
        wrong = "a mass falls through the rings", "rings.inner", body.rings.inner
    elif body.bolt.head_diameter is not None and body.bolt.head_diameter <= body.bolt.diameter:
        wrong = "the head is no wider than the bolt", "bolt.head_diameter", body.bolt.head_diameter
    if wrong is not None:
        raise UsageError(wrong[0], where=f"{where}.{wrong[1]}", got=f"{wrong[2]:g} m")


def _blocks(body: Langevin, where: str) -> list[Block]:
    """Rings from z = 0 up, front above, back below, then the bolt in place of their cores."""
    blocks: list[Block] = []

    def add(
        r: tuple[float, float], z: tuple[float, float], part: Any, key: str, up: int = 1
    ) -> None:
        one = material(part.material, f"{where}.{key}.material")
        quality = part.quality or one.quality
        poled = replace(one.poled((0, 0, up)), name=f"{key} ({one.name})", quality=quality)
        blocks.append(Block(r, z, poled))

    rings, bolt = body.rings, body.bolt
    core = bolt.diameter / 2
    for i in range(rings.count):
        z = (i * rings.thickness, (i + 1) * rings.thickness)
        add((rings.inner / 2, rings.outer / 2), z, rings, f"rings[{i}]", (-1) ** i)
    thread = _stack_height(rings) + (bolt.depth or body.front[0].length)
    height = _stack_height(rings)
    for i, step in enumerate(body.front):
        for low, high, inner in _cut(height, height + step.length, thread, core):
            add((inner, step.diameter / 2), (low, high), step, f"front[{i}]")
        height += step.length
    height = 0.0
    for i, step in enumerate(body.back):
        add((core, step.diameter / 2), (height - step.length, height), step, f"back[{i}]")
        height -= step.length
    add((0.0, core), (height, thread), bolt, "bolt")
    if bolt.head_diameter is not None and bolt.head_length is not None:
        add((0.0, bolt.head_diameter / 2), (height - bolt.head_length, height), bolt, "bolt")
    if not blocks[0].material.piezoelectric:
        raise UsageError(
            "the rings are not piezoelectric",
            where=f"{where}.rings.material",
            got=blocks[0].material.name,
        )
    return blocks


def _cut(low: float, high: float, thread: float, core: float) -> list[tuple[float, float, float]]:
    """Pieces (low, high, inner radius) of a step that the bolt reaches up to ``thread`` into."""
    if thread >= high:
        return [(low, high, core)]
    if thread <= low:
        return [(low, high, 0.0)]
    return [(low, thread, core), (thread, high, 0.0)]


def _electrodes(rings: Rings) -> list[Electrode]:
    r = (rings.inner / 2, rings.outer / 2)
    planes = [Face(r, i * rings.thickness) for i in range(rings.count + 1)]
    return [
        Electrode("anode", tuple(planes[1::2])),
        Electrode("cathode", tuple(planes[::2]), "ground"),
    ]
