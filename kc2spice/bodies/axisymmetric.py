"""Bodies of revolution made of rectangular blocks that are bonded where they touch.

The blocks lie in the plane (r, z) on one tensor grid of nine-node quadrilaterals, whose lines run
through every edge of a block, an electrode, a support or a port. :mod:`kc2spice.fem.solid` does
the rest: the potential lives in piezoelectric blocks only, conductors and electrodes are
equipotentials, other insulators carry no field.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
from typing import Literal

import numpy as np
from skfem.mesh import MeshQuad

from kc2spice.bodies.device import Device, Setup, Shape, make_device, mean
from kc2spice.core.errors import UsageError
from kc2spice.fem.keys import Damping
from kc2spice.fem.materials import Material
from kc2spice.fem.solid import Solid
from kc2spice.rom.linear import Port

AXIAL = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Block:
    """A ring (or disc) of material, already poled: radii and heights [m]. Blocks whose materials
    have one name are one piece."""

    r: tuple[float, float]
    z: tuple[float, float]
    material: Material


@dataclass(frozen=True)
class Face:
    """A flat annulus at height ``z`` between two radii [m]."""

    r: tuple[float, float]
    z: float


@dataclass(frozen=True)
class Fixed:
    """Displacements along one direction that a support holds, in a box of radii and heights [m]."""

    direction: Literal["r", "z"]
    r: tuple[float, float]
    z: tuple[float, float]


def turned(
    blocks: Sequence[Block],
    electrodes: Mapping[str, Sequence[Face]],
    supports: Sequence[Fixed] = (),
    ports: Mapping[str, Face] | None = None,
    *,
    floating: Sequence[Sequence[Face]] = (),
    size: float,
    damping: Damping,
    refine: int = 1,
) -> Device:
    """The device of the bonded blocks; ``size`` [m] bounds the cells, ``refine`` divides them.

    Voltages of the electrodes are counted from the ``cathode``; each of the ``floating`` ones is
    one equipotential without charge. A port is the mean axial displacement of a face, whose force
    is spread evenly over it.

    Raises
    ------
    UsageError : a material that is not isotropic about z; an electrode, support or port that
        touches nothing; electrodes that touch each other.
    """
    faces = ports or {}
    every = [*faces.values(), *chain(*electrodes.values(), *floating)]
    solid = _solid(blocks, every, supports, size, refine)
    nodes = solid.places
    near = 1e-3 * float(np.abs(np.diff(solid.mesh.p[:, solid.mesh.facets], axis=1)).max(0).min())

    def touched(joined: Sequence[Face]) -> np.ndarray:
        return np.flatnonzero(np.any([_on(face, nodes, near) for face in joined], axis=0))

    def port(name: str, face: Face) -> Shape:
        weights = mean(solid, AXIAL, facets=_facets(solid, face, near))
        return Shape(Port(name, "mechanical"), weights)

    setup = Setup(
        fixed=_fixed(nodes, supports, near).ravel(),
        electrodes={name: touched(joined) for name, joined in electrodes.items()},
        reference="cathode",
        floating=[touched(joined) for joined in floating],
        shapes=[port(name, face) for name, face in faces.items()],
        damping=damping,
    )
    return make_device(solid, setup)


def _solid(
    blocks: Sequence[Block],
    faces: Iterable[Face],
    supports: Sequence[Fixed],
    size: float,
    refine: int,
) -> Solid:
    """Quads of the cells that some block owns; the later block wins."""
    radii = [x for spans in (blocks, faces, supports) for item in spans for x in item.r]
    heights = [x for spans in (blocks, supports) for item in spans for x in item.z]
    r, z = _divide(radii, size, refine), _divide(heights, size, refine)
    rows, columns = len(r) - 1, len(z) - 1
    across, along = (r[1:] + r[:-1]) / 2, (z[1:] + z[:-1]) / 2
    materials = {block.material.name: block.material for block in blocks}
    owner = np.full((rows, columns), -1)
    for block in blocks:
        wide = (across > block.r[0]) & (across < block.r[1])
        inside = np.outer(wide, (along > block.z[0]) & (along < block.z[1]))
        if not inside.any():
            raise UsageError("a block of no volume", got=f"r = {block.r}, z = {block.z}")
        owner[inside] = list(materials).index(block.material.name)
    i, j = np.nonzero(owner >= 0)
    corner = i * (columns + 1) + j
    t = np.array([corner, corner + columns + 1, corner + columns + 2, corner + 1])
    p = np.array([np.repeat(r, columns + 1), np.tile(z, rows + 1)])
    used, t = np.unique(t, return_inverse=True)
    mesh = MeshQuad(np.ascontiguousarray(p[:, used]), t.reshape(4, -1))
    return Solid(mesh, tuple(materials.values()), owner[i, j], axisymmetric=True)


def _divide(edges: Sequence[float], size: float, refine: int) -> np.ndarray:
    """All edges, and equal cells of at most ``size`` between them, each cut into ``refine``."""
    points = np.unique(np.array(edges))
    points = points[np.concatenate([[True], np.diff(points) > 1e-9 * np.ptp(points)])]
    pieces = []
    for a, b in pairwise(points):
        count = refine * max(1, int(np.ceil((b - a) / size - 1e-9)))
        pieces.append(np.linspace(a, b, count + 1)[:-1])
    return np.concatenate([*pieces, points[-1:]])


def _on(face: Face, places: np.ndarray, near: float) -> np.ndarray:
    r, z = places
    return (r > face.r[0] - near) & (r < face.r[1] + near) & (np.abs(z - face.z) < near)


def _facets(solid: Solid, face: Face, near: float) -> np.ndarray:
    mesh = solid.mesh
    ends = mesh.p[:, mesh.facets]
    level = np.abs(np.diff(ends[1], axis=0)[0]) < near
    found = np.flatnonzero(_on(face, ends.mean(axis=1), near) & level)
    if not found.size:
        raise UsageError("a port touches nothing", got=repr(face))
    return found


def _fixed(nodes: np.ndarray, supports: Sequence[Fixed], near: float) -> np.ndarray:
    """Mask (nodes, 2) of the displacements that the axis (u_r = 0) or a support holds."""
    r, z = nodes
    fixed = np.zeros((r.size, 2), bool)
    fixed[r < near, 0] = True
    for support in supports:
        inside = (r > support.r[0] - near) & (r < support.r[1] + near)
        inside &= (z > support.z[0] - near) & (z < support.z[1] + near)
        if not inside.any():
            raise UsageError("a support touches nothing", got=repr(support))
        fixed[inside, "rz".index(support.direction)] = True
    return fixed
