"""``part = "disc"``: circular layers on one another, with electrodes. Buzzers, diaphragms, discs.

    layers = [                                  # from the bottom up
      { material = "brass", diameter = "20 mm", thickness = "0.2 mm" },
      { material = "PZT-5A", diameter = "14 mm", thickness = "0.22 mm", electrodes = "12.8 mm" },
    ]
    support = "free"                            # clamped, simply_supported, { node = "13 mm" }

Electrical pins ``anode``, ``cathode`` (and ``feedback`` against the cathode), mechanical port
``centre``: mean axial displacement of a small patch on top, upwards. Left out: glue unless it is a
layer, silver, solder and wires, the air.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import chain
from typing import Any, Literal

from pydantic import Field

from kc2spice.bodies.axisymmetric import Block, Face, Fixed, turned
from kc2spice.bodies.device import Device, part_named
from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Length, Ratio, Section, validated
from kc2spice.fem.keys import Damping, Mesh
from kc2spice.fem.materials import material

_CELLS = 20  # along the largest radius (or half the height) before refinement


class Feedback(Section):
    """A ring (or disc) cut out of the top electrode, for self-oscillating buzzers.

    Sheets show a tongue; the ring stands for it: the area counts, not the angle.
    """

    inner: Length = Field(0.0, ge=0, description="radius; 0 cuts out a disc")
    outer: Length = Field(gt=0, description="radius")
    gap: Length = Field(0.5e-3, gt=0, description="bare ceramic to the main electrode")


class Layer(Section):
    """One disc. ``electrodes`` is the diameter of its electrodes where it lies on no metal."""

    material: str | dict[str, Any] = Field(description="name or table")
    diameter: Length = Field(gt=0, description="outer")
    thickness: Length = Field(gt=0, description="of the layer")
    electrodes: Length | None = Field(
        None, gt=0, description="diameter of its electrodes; the whole face unless told"
    )
    feedback: Feedback | None = None
    poling: Literal["up", "down"] = Field("up", description="of a ceramic")
    quality: Ratio | None = Field(None, gt=0, description="for damping.per_material")


class Node(Section):
    """A knife edge under the body."""

    node: Length = Field(gt=0, description="diameter")


class Disc(Section):
    """Keys of the part. ``wiring`` matters with more than one ceramic layer: ``parallel`` connects
    every second electrode to the cathode, beginning with the lowest; ``series`` uses the lowest and
    the highest and leaves those between floating."""

    layers: tuple[Layer, ...] = Field(min_length=1)
    support: Literal["free", "clamped", "simply_supported"] | Node = "free"
    wiring: Literal["parallel", "series"] = Field(
        "parallel", description="of several ceramic layers"
    )
    centre: Length | None = Field(
        None, gt=0, description="diameter of the port's patch; the thickness on the axis if absent"
    )
    damping: Damping = Damping()
    mesh: Mesh = Mesh()


def device(keys: Disc | Mapping[str, Any], *, refine: int = 1, where: str = "disc") -> Device:
    """The disc with its mesh. ``refine`` divides the cells of ``keys.mesh`` once more.

    Raises
    ------
    UsageError : a key is wrong, or names electrodes or supports that touch nothing.
    """
    disc = validated(Disc, keys, where)
    pieces = blocks(disc, where)
    heights = [0.0, *(piece.z[1] for piece in pieces)]
    electrodes, floating = _electrodes(disc, pieces, where)
    with part_named(where):
        return turned(
            pieces,
            electrodes,
            _supports(disc, heights, where),
            {"centre": _centre(disc, heights[-1], where)},
            floating=floating,
            size=max(heights[-1], *(layer.diameter for layer in disc.layers)) / (2 * _CELLS),
            refine=refine * disc.mesh.refine,
            damping=disc.damping,
        )


def blocks(disc: Disc, where: str = "disc") -> list[Block]:
    """The layers from the bottom up."""
    found: list[Block] = []
    height = 0.0
    for i, layer in enumerate(disc.layers):
        here = f"{where}.layers.{i}"
        one = material(layer.material, f"{here}.material")
        if layer.electrodes is not None and not one.piezoelectric:
            raise UsageError(
                "an electrode on a material that is not piezoelectric", where=here, got=one.name
            )
        if layer.electrodes is not None and layer.electrodes > layer.diameter * (1 + 1e-9):
            raise UsageError(
                "electrodes larger than the layer",
                where=f"{here}.electrodes",
                got=f"{layer.electrodes:g} m",
                expected=f"at most {layer.diameter:g} m",
            )
        quality = layer.quality or one.quality
        poled = one.poled((0, 0, 1 if layer.poling == "up" else -1))
        poled = replace(poled, name=f"layers[{i}] ({one.name})", quality=quality)
        found.append(Block((0.0, layer.diameter / 2), (height, height + layer.thickness), poled))
        height += layer.thickness
    if not any(block.material.piezoelectric for block in found):
        got = ", ".join(block.material.name for block in found)
        raise UsageError("no piezoelectric layer", where=f"{where}.layers", got=got)
    return found


def _electrodes(
    disc: Disc, pieces: list[Block], where: str
) -> tuple[dict[str, list[Face]], list[list[Face]]]:
    """Faces of each pin, equipotentials from the bottom up joined as the wiring says, and of those
    that float."""
    conductors = _conductors(disc, pieces, where)
    if disc.wiring == "series":
        found = {"anode": conductors[-1], "cathode": conductors[0]}
    else:
        found = {"anode": [*chain(*conductors[1::2])], "cathode": [*chain(*conductors[::2])]}
    for layer, block in zip(disc.layers, pieces, strict=True):
        if layer.feedback is not None:
            ring = layer.feedback
            found.setdefault("feedback", []).append(
                Face((ring.inner / 2, ring.outer / 2), block.z[1])
            )
    return found, conductors[1:-1] if disc.wiring == "series" else []


def _conductors(disc: Disc, pieces: list[Block], where: str) -> list[list[Face]]:
    """Faces of each electrode in order of height; a metal layer is one electrode."""
    found: list[list[Face]] = []
    last_metal: int | None = None
    for i in range(len(pieces) + 1):
        below = i - 1 if i > 0 else None
        beside = [k for k in (i - 1, i) if 0 <= k < len(pieces)]
        ceramic = [k for k in beside if pieces[k].material.piezoelectric]
        metal = [k for k in beside if pieces[k].material.conductor]
        height = pieces[i].z[0] if i < len(pieces) else pieces[-1].z[1]
        if not ceramic:
            continue
        if not metal:
            found.append(_plane(disc, ceramic, height, below, where))
            continue
        contact = Face((0.0, min(pieces[k].r[1] for k in (ceramic[0], metal[0]))), height)
        if metal[0] == last_metal:
            found[-1].append(contact)
        else:
            found.append([contact])
        last_metal = metal[0]
    return found


def _plane(
    disc: Disc, ceramic: list[int], height: float, below: int | None, where: str
) -> list[Face]:
    """Electrode on bare ceramic, without the feedback's ring and its gaps."""
    diameters = {disc.layers[k].electrodes or disc.layers[k].diameter for k in ceramic}
    if len(diameters) > 1 and all(disc.layers[k].electrodes for k in ceramic):
        raise UsageError(
            "two layers state different diameters of the electrode between them",
            where=f"{where}.layers.{ceramic[-1]}.electrodes",
            got=sorted(diameters),
        )
    radius = min(diameters) / 2
    ring = disc.layers[below].feedback if below in ceramic and below is not None else None
    if ring is None:
        return [Face((0.0, radius), height)]
    inner, outer = ring.inner / 2 - ring.gap, ring.outer / 2 + ring.gap
    if not ring.inner < ring.outer <= 2 * radius or (inner <= 0 and outer >= radius):
        raise UsageError(
            "no room for the feedback electrode",
            where=f"{where}.layers.{below}.feedback",
            got=f"{ring.inner:g} to {ring.outer:g} m, gap {ring.gap:g} m",
            expected=f"inner < outer, within the electrode of {2 * radius:g} m, some of it left",
        )
    faces = [Face((0.0, inner), height)] if inner > 0 else []
    return faces + ([Face((outer, radius), height)] if outer < radius else [])


def _supports(disc: Disc, heights: list[float], where: str) -> list[Fixed]:
    if disc.support == "free":
        return []
    if isinstance(disc.support, Node):
        r = disc.support.node / 2
        lowest = next((i for i, x in enumerate(disc.layers) if x.diameter / 2 >= r), None)
        if lowest is None:
            raise UsageError(
                "the node lies outside the body",
                where=f"{where}.support.node",
                got=f"{2 * r:g} m",
                expected=f"at most {max(x.diameter for x in disc.layers):g} m",
            )
        return [Fixed("z", (r, r), (heights[lowest],) * 2)]
    radius = max(layer.diameter for layer in disc.layers) / 2
    rim = [i for i, layer in enumerate(disc.layers) if layer.diameter / 2 >= radius * (1 - 1e-9)]
    z = (heights[rim[0]], heights[rim[-1] + 1])
    if disc.support == "clamped":
        return [Fixed("r", (radius, radius), z), Fixed("z", (radius, radius), z)]
    return [Fixed("z", (radius, radius), (sum(z) / 2,) * 2)]


def _centre(disc: Disc, height: float, where: str) -> Face:
    smallest = disc.layers[-1].diameter
    diameter = disc.centre or min(height, smallest)
    if diameter > smallest * (1 + 1e-9):
        raise UsageError(
            "the centre port is wider than the top layer",
            where=f"{where}.centre",
            got=f"{diameter:g} m",
            expected=f"at most {smallest:g} m",
        )
    return Face((0.0, diameter / 2), height)
