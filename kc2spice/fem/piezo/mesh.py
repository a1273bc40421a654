"""Mapped mesh of the quarter chip: rings around the contact point, swept through the layers.

The paper asks for a mapped mesh (2.2.2): nodes on concentric circles make one force per ring
exact.

A *level* is one element over the height: one layer, or several of them as one medium where
``layers_per_element`` allows it. The field in each layer is given by its electrodes, so m layers in
parallel at one voltage are one layer m times as thick, of coupling ``m e`` and permittivity
``m^2 eps``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from skfem import MeshHex1, MeshHex2

from kc2spice.fem.piezo.keys import Cap, Chip
from kc2spice.linalg.memory import require_bytes

GROWTH = 0.25  # of a level's thickness with its depth
# Fill of sparse factors of a solid grows as n^(4/3); 152 000 unknowns took 5.8 GB.
SPARSE_BYTES = 700.0


@dataclass(frozen=True)
class KickMesh:
    """Quarter chip ``0 <= x, y``, ``0 <= z``, its bottom cap included.

    Attributes
    ----------
    mesh : hexahedra, trilinear, or triquadratic and isoparametric; those at the axis have one edge
        collapsed.
    numbers : of the nodes of each hexahedron, plane by plane, in each the centre first, then ring
        by ring from the x to the y axis.
    level : (cells,) of each hexahedron, from the bottom up.
    faces : (levels + 1,) heights [m] between them.
    spans : piezoelectric layers in each level, from the bottom up; 0 in the caps.
    """

    mesh: MeshHex1
    numbers: np.ndarray
    level: np.ndarray
    faces: np.ndarray
    spans: np.ndarray


def kick_mesh(kick: Chip) -> KickMesh:
    """Mesh the quarter chip as ``kick.mesh`` says (paper 2.2.2, Fig. 3b).

    Raises
    ------
    UsageError : the factor of its stiffness would not fit into the memory that is free now.
    """
    _require_memory(kick)
    steps = kick.mesh.refine * kick.mesh.order
    lattice = _in_plane(kick, steps)
    spans, heights = _levels(kick, steps)
    mesh, numbers = _hexahedra(lattice, heights, kick.mesh.order)
    cells = mesh.nelements // (len(heights) - 1) * kick.mesh.order
    level = np.arange(mesh.nelements) // (cells * kick.mesh.refine)
    return KickMesh(mesh, numbers, level, heights[::steps], spans)


def _levels(kick: Chip, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Active layers in each level, and the heights [m] of all planes of nodes."""
    spans, caps = level_spans(kick), (kick.bottom_cap, kick.top_cap)
    counts = [cap_layers(kick, cap) for cap in caps]
    below, above = (
        np.linspace(0, cap.thickness if cap else 0.0, steps * count + 1)
        for cap, count in zip(caps, counts, strict=True)
    )
    edges = kick.height / kick.layers * np.r_[0, np.cumsum(spans)]
    active = np.interp(np.arange(steps * len(spans) + 1) / steps, np.arange(len(edges)), edges)
    heights = np.r_[below[:-1], below[-1] + active[:-1], below[-1] + active[-1] + above]
    return np.pad(spans, counts), heights


def _hexahedra(lattice: np.ndarray, heights: np.ndarray, order: int) -> tuple[MeshHex1, np.ndarray]:
    """A box in (ring, spoke, plane) coordinates whose nodes are then moved in place, with the
    numbers of the nodes of its hexahedra.

    The box gives regular hexahedra and their numbering; the nodes of its face ring = 0 become one
    node per plane, which collapses those hexahedra into exact wedges.
    """
    counts = (lattice.shape[0] - 1, lattice.shape[1] - 1, len(heights) - 1)
    box = MeshHex1.init_tensor(*(np.arange(n // order + 1) * 1.0 for n in counts))
    if order == 2:
        box = MeshHex2.from_mesh(box)
    i, j, k = np.rint(box.doflocs * order).astype(int)
    spokes, per_plane = lattice.shape[1], 1 + counts[0] * lattice.shape[1]
    number = np.where(i == 0, 0, 1 + (i - 1) * spokes + j) + k * per_plane
    places = np.array([*lattice[i, j].T, heights[k]])
    return type(box)(places, box.t), number[box.dofs.element_dofs]


def level_spans(kick: Chip) -> np.ndarray:
    """Layers in each level from the bottom up: ``layers_per_element`` at most, and no level thicker
    than ``GROWTH`` of its depth below the top."""
    spans: list[int] = []
    while (left := kick.layers - sum(spans)) > 0:
        grown = max(1, int(GROWTH * sum(spans)))
        spans.append(min(kick.mesh.layers_per_element, grown, left))
    return np.array(spans[::-1])


def cap_layers(kick: Chip, cap: Cap | None) -> int:
    """Layers of cells in a cap: about as thick as an active layer, sixteen at most."""
    if cap is None:
        return 0
    return int(np.clip(np.ceil(cap.thickness * kick.layers / kick.height - 1e-9), 2, 16))


def _require_memory(kick: Chip) -> None:
    """The stiffness factor is sparse where potentials are free, or banded."""
    mesh = kick.mesh
    steps = mesh.refine * mesh.order
    plane = 1 + (mesh.rings + mesh.outer_rings) * steps * (mesh.sectors * steps + 1)
    caps = cap_layers(kick, kick.bottom_cap) + cap_layers(kick, kick.top_cap)
    spans = level_spans(kick)
    nodes = plane * ((len(spans) + caps) * steps + 1)
    inner = plane * int((spans == 1).sum()) * (steps - 1)
    sparse_bytes = SPARSE_BYTES * (3.0 * nodes + inner) ** (4 / 3)
    banded_bytes = 8.0 * 3 * nodes * 3 * plane
    require_bytes(
        sparse_bytes if inner else min(sparse_bytes, banded_bytes),
        "the factorised stiffness",
        where="kick.mesh",
        hint="lower kick.mesh.refine, kick.mesh.order or the number of rings and sectors",
    )


def _in_plane(kick: Chip, steps: int) -> np.ndarray:
    """Lattice (rings + 1, spokes + 1, 2) of node positions; row 0 repeats the centre.

    Nodes share arcs and straight edges evenly; out from the last ring they lie on straight lines.
    """
    mesh, half = kick.mesh, kick.half
    along = np.linspace(0.0, 1.0, mesh.sectors * steps + 1)
    circle = np.column_stack([np.cos(np.pi / 2 * along), np.sin(np.pi / 2 * along)])
    inner = mesh.ring_spacing * np.arange(mesh.rings * steps + 1)[:, None, None] / steps * circle
    if kick.diameter is None:
        sides = np.interp(along, [0.5, 1.0], [1.0, 0.0]), np.interp(along, [0.0, 0.5], [0.0, 1.0])
        edge = np.column_stack(sides) * half
    else:  # chords of linear elements enclose the circle's area
        angle = np.pi / (2 * mesh.sectors * steps)
        edge = half[0] * (np.sqrt(angle / np.sin(angle)) if mesh.order == 1 else 1.0) * circle
    left = min(half) - mesh.rings * mesh.ring_spacing
    growth = _growth(left, mesh.ring_spacing, mesh.outer_rings) ** (1 / steps)
    sizes = np.cumsum(growth ** np.arange(mesh.outer_rings * steps))
    share = (sizes / sizes[-1])[:, None, None]
    return np.concatenate([inner, (1 - share) * inner[-1] + share * edge])


def _growth(length: float, first: float, count: int) -> float:
    """Ratio g with ``first (1 + g + ... + g^(count-1)) = length``: no jump at the last ring."""
    if count == 1 or length <= first * count:
        return 1.0
    from scipy.optimize import brentq  # late: few meshes are made

    powers, ratio = np.arange(count), length / first
    return float(brentq(lambda g: (g**powers).sum() - ratio, 1.0, ratio, xtol=1e-15))
