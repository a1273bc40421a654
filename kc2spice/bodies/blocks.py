"""Bodies made of blocks that are bonded where they touch: layers, rings, beams.

Blocks are boxes along the axes, of a body of revolution in the plane (radius, height), on one grid
of quadratic quadrilaterals or hexahedra, whose lines run through every edge of a block, an
electrode, a support or a port. :mod:`kc2spice.fem.solid` does the rest: the potential lives in
piezoelectric blocks only, conductors and electrodes are equipotentials, other insulators carry no
field.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, pairwise
from typing import TypeAlias

import numpy as np
from skfem.mesh import MeshHex, MeshQuad

from kc2spice.bodies.device import (
    Device,
    Setup,
    Shape,
    make_device,
    node_shares,
    part_named,
    spread,
)
from kc2spice.core.errors import UsageError
from kc2spice.fem.keys import Damping
from kc2spice.fem.materials import Material
from kc2spice.fem.solid import Solid
from kc2spice.rom.linear import Port

# From and to [m] along each axis; of one value along an axis it is a face, an edge or a point.
Box: TypeAlias = tuple[tuple[float, float], ...]
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Block:
    """A box of material, already poled. Blocks whose materials have one name are one piece."""

    box: Box
    material: Material


@dataclass(frozen=True)
class Bonded:
    """Blocks, of which a later one wins where two overlap, and what is done to them.

    Attributes
    ----------
    electrodes : faces of each pin; voltages are counted from the ``cathode``.
    floating : faces of each equipotential without charge.
    ports : each the mean displacement upwards of a face, whose force is spread evenly over it, or
        that of a point.
    fixed : axes (``"xz"``, x the radius in a body of revolution) along which boxes are held.
    masses : [kg] spread over faces.
    moved : whether the acceleration of what holds it is the port ``base``, upwards.
    grid : lines along each axis, or none: cells of at most ``size`` [m], each cut in ``refine``.
    like : another body of the same blocks in other sizes, whose mesh this one has, moved.
    where : the part, for errors.
    """

    blocks: Sequence[Block]
    electrodes: Mapping[str, Sequence[Box]] = field(default_factory=dict)
    floating: Sequence[Sequence[Box]] = ()
    ports: Mapping[str, Box] = field(default_factory=dict)
    fixed: Sequence[tuple[str, Box]] = ()
    masses: Sequence[tuple[float, Box]] = ()
    moved: bool = False
    grid: Sequence[np.ndarray] = ()
    size: float = np.inf
    refine: int = 1
    like: Bonded | None = None
    damping: Damping = field(default_factory=Damping)
    where: str = "body"

    @property
    def every_port(self) -> tuple[Port, ...]:
        """What its model has, electrical ports first."""
        pins = [pin for pin in self.electrodes if pin != "cathode"]
        return (
            *(Port(pin, "electrical", pins=(pin, "cathode")) for pin in pins),
            *(Port(name, "mechanical") for name in self.ports),
            *([Port("base", "acceleration")] if self.moved else []),
        )

    @property
    def rated(self) -> float | None:
        """Voltage [V] at which one of the ceramics reaches its depoling field, the same field in
        all of them where electrodes between them float; None where no limit is known."""
        active = [block for block in self.blocks if block.material.piezoelectric]
        thick = np.array([block.box[-1][1] - block.box[-1][0] for block in active])
        limits = [block.material.depoling_field for block in active]
        if not active or None in limits:
            return None
        fields = np.array(limits, dtype=float)
        return float(fields.min() * thick.sum() if self.floating else (fields * thick).min())

    def device(self) -> Device:
        """Its mesh and full model.

        Raises
        ------
        UsageError : electrodes that touch each other; in a body of revolution a material that is
            not isotropic about its axis; edges in another order than those of :attr:`like`.
        """
        grid = self.grid or self._lines()
        near = 1e-3 * min(float(np.diff(lines).min()) for lines in grid)
        with part_named(self.where):
            solid = self._solid(grid, near)
            return make_device(solid, self._setup(solid, near))

    def _lines(self) -> list[np.ndarray]:
        """Along each axis all edges and equal cells between them."""
        model = self if self.like is None else self.like
        found = []
        for own, others in zip(self._edges(), model._edges(), strict=True):
            (points, place), (counted, alike) = _distinct(own), _distinct(others)
            if not np.array_equal(place, alike):
                raise UsageError(
                    "the body's edges change their order, which no mesh that moves can follow",
                    where=self.where,
                    expected="sizes that keep which edge lies beyond which: narrower ranges",
                )
            counts = np.ceil(np.diff(counted) / model.size - 1e-9).astype(int)
            cut = [
                np.linspace(*pair, self.refine * max(1, count) + 1)[:-1]
                for pair, count in zip(pairwise(points), counts, strict=True)
            ]
            found.append(np.concatenate([*cut, points[-1:]]))
        return found

    def _edges(self) -> list[np.ndarray]:
        """Along each axis where blocks, electrodes, supports and ports begin and end, always in
        the same order of them."""
        faces = [*self.ports.values(), *(box for _, box in self.fixed)]
        faces += chain(*self.electrodes.values(), *self.floating)
        boxes = [*(block.box for block in self.blocks), *faces]
        return [np.array([*chain(*spans)]) for spans in zip(*boxes, strict=True)]

    def _solid(self, grid: Sequence[np.ndarray], near: float) -> Solid:
        mesh = (MeshQuad if len(grid) == 2 else MeshHex).init_tensor(*grid)
        middle = mesh.p[:, mesh.t].mean(axis=1)
        materials = {block.material.name: block.material for block in self.blocks}
        owner = np.full(mesh.nelements, -1)
        for block in self.blocks:
            owner[_within(block.box, middle, near)] = list(materials).index(block.material.name)
        kept = np.flatnonzero(owner >= 0)
        found = tuple(materials.values())
        return Solid(mesh.restrict(kept), found, owner[kept], axisymmetric=len(grid) == 2)

    def _setup(self, solid: Solid, near: float) -> Setup:
        places, letters = solid.places, "xz" if solid.axisymmetric else "xyz"
        fixed = np.zeros((places.shape[1], len(letters)), bool)
        if solid.axisymmetric:
            fixed[places[0] < near, 0] = True
        for axes, box in self.fixed:
            for axis in axes:
                fixed[_within(box, places, near), letters.index(axis)] = True

        def touched(faces: Sequence[Box]) -> np.ndarray:
            return np.flatnonzero(np.any([_within(face, places, near) for face in faces], axis=0))

        def shares(box: Box) -> np.ndarray:
            if all(low == high for low, high in box):
                found = _within(box, places, near)
                return np.asarray(found / found.sum())
            face = solid.mesh.facets_satisfying(lambda x: _within(box, x, near))
            return node_shares(solid, facets=face)

        lumped = [mass * shares(box) for mass, box in self.masses]
        return Setup(
            fixed=fixed.ravel(),
            electrodes={pin: touched(faces) for pin, faces in self.electrodes.items()},
            reference="cathode",
            floating=[touched(faces) for faces in self.floating],
            shapes=[
                Shape(Port(name, "mechanical"), spread(shares(box), UP, solid))
                for name, box in self.ports.items()
            ],
            base=[(Port("base", "acceleration"), UP)] if self.moved else [],
            lumped=np.sum(lumped, axis=0) if lumped else None,
            damping=self.damping,
        )


def _distinct(edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Increasing edges, each once but for rounding, and which of them each one is."""
    points = np.unique(edges)
    points = points[np.r_[True, np.diff(points) > 1e-9 * np.ptp(points)]]
    return points, np.searchsorted(points, edges + 1e-9 * np.ptp(points), side="right") - 1


def _within(box: Box, places: np.ndarray, near: float) -> np.ndarray:
    """Mask of the places (d, …) in a box, its edges included."""
    inside = [
        (x > low - near) & (x < high + near) for x, (low, high) in zip(places, box, strict=True)
    ]
    return np.all(inside, axis=0)
