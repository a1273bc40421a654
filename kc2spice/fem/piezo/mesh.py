"""Mapped mesh of the quarter chip: rings around the contact point, swept through the layers.

The paper asks for a mapped mesh (2.2.2): nodes on concentric circles make one force per ring
exact, and equal layers let one assembled layer stand for all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np
from scipy import sparse
from scipy.optimize import brentq
from scipy.sparse.csgraph import shortest_path
from skfem import ElementHex1, ElementHex2, MeshHex1, MeshHex2

from kc2spice.core.errors import UsageError
from kc2spice.fem.gmsh_session import gmsh_session
from kc2spice.fem.piezo.keys import Chip


@dataclass(frozen=True)
class KickMesh:
    """Quarter chip ``0 <= x, y <= side/2``, ``0 <= z <= height``.

    Attributes
    ----------
    layer : scikit-fem mesh of the bottom layer; the hexahedra at the axis have one edge collapsed.
    element, order : scalar element on ``layer``: trilinear, or triquadratic and isoparametric.
    node : (scalar dofs of ``layer``,) their node numbers; the axis has one node per plane.
    plane : (nodes per plane, 2) positions [m], the centre first, then ring by ring.
    heights : (planes,) [m]. Node ``k * len(plane) + i`` is node ``i`` of plane ``k``.
    steps : planes per layer.
    rings : node numbers within the plane for R0 (centre), R1, ... from the x to the y axis.
    """

    layer: MeshHex1
    element: ElementHex1 | ElementHex2
    order: int
    node: np.ndarray
    plane: np.ndarray
    heights: np.ndarray
    steps: int
    rings: tuple[np.ndarray, ...]

    @property
    def layers(self) -> int:
        """Number of piezoelectric layers."""
        return (len(self.heights) - 1) // self.steps


def kick_mesh(kick: Chip) -> KickMesh:
    """Mesh the quarter chip as ``kick.mesh`` says (paper 2.2.2, Fig. 3b).

    Raises
    ------
    UsageError : the rings do not fit on the chip, or no mesh line would meet its corner.
    """
    _check(kick)
    steps = kick.mesh.refine * kick.mesh.order
    plane = _in_plane(kick, steps)
    layer, element, node = _layer(kick, plane, steps)
    stations = steps * np.arange(kick.mesh.rings + 1)
    spokes = plane.shape[1]
    ring_nodes = [np.array([0])] + [1 + (i - 1) * spokes + np.arange(spokes) for i in stations[1:]]
    return KickMesh(
        layer=layer,
        element=element,
        order=kick.mesh.order,
        node=node,
        plane=np.vstack([plane[0, 0], plane[1:].reshape(-1, 2)]),
        heights=np.linspace(0, kick.height, steps * kick.layers + 1),
        steps=steps,
        rings=tuple(ring_nodes),
    )


def _check(kick: Chip) -> None:
    mesh, half = kick.mesh, kick.side / 2
    if mesh.rings * mesh.ring_spacing > half * (1 - 1e-6):
        raise UsageError(
            "contact ring beyond the chip",
            where="kick.mesh",
            got=f"outermost ring radius {mesh.rings * mesh.ring_spacing:g} m",
            expected=f"less than half the side, {half:g} m",
            hint="lower kick.mesh.rings or kick.mesh.ring_spacing",
        )
    if mesh.sectors % 2:
        raise UsageError(
            "no mesh line meets the chip's corner",
            where="kick.mesh.sectors",
            got=mesh.sectors,
            expected="an even number",
        )


def _in_plane(kick: Chip, steps: int) -> np.ndarray:
    """Lattice (rings + 1, spokes + 1, 2) of node positions; row 0 repeats the centre."""
    with gmsh_session("chip") as gmsh:
        _transfinite_patches(gmsh, kick, steps)
        gmsh.model.mesh.generate(2)
        tags, xyz, _ = gmsh.model.mesh.getNodes()
        _, _, blocks = gmsh.model.mesh.getElements(2)
        corners = [gmsh.model.mesh.getElementProperties(t)[3] for t in (2, 3)]
    number = np.full(int(tags.max()) + 1, -1)
    number[tags] = np.arange(len(tags))
    cells = [number[b].reshape(-1, n) for b, n in zip(blocks, corners, strict=True)]
    return _lattice(np.asarray(xyz).reshape(-1, 3)[:, :2], cells)


def _transfinite_patches(gmsh: ModuleType, kick: Chip, steps: int) -> None:
    """Two patches (below and above the diagonal) per ring, and two from the last ring to the edge.

    Curves carry ``steps`` nodes per ring and sector, so every node is the product of two lines.
    """
    geo, mesh, half = gmsh.model.geo, kick.mesh, kick.side / 2
    radii = mesh.ring_spacing * np.arange(1, mesh.rings + 1)
    directions = [(1.0, 0.0), (0.5**0.5, 0.5**0.5), (0.0, 1.0)]
    circles = [[geo.addPoint(r * x, r * y, 0) for x, y in directions] for r in radii]
    square = [geo.addPoint(x, y, 0) for x, y in ((half, 0), (half, half), (0, half))]
    centre = geo.addPoint(0, 0, 0)
    growth = _growth(half - radii[-1], mesh.ring_spacing, mesh.outer_rings) ** (1 / steps)
    along = mesh.sectors // 2 * steps + 1

    inner, inner_arcs = [centre] * 3, None
    for outer in [*circles, square]:
        last = outer is square
        spokes = [geo.addLine(p, q) for p, q in zip(inner, outer, strict=True)]
        across = steps * (mesh.outer_rings if last else 1) + 1
        for curve in spokes:
            geo.mesh.setTransfiniteCurve(curve, across, "Progression", growth if last else 1.0)
        pairs = [(outer[0], outer[1]), (outer[1], outer[2])]
        arcs = [geo.addLine(p, q) if last else geo.addCircleArc(p, centre, q) for p, q in pairs]
        for i, curve in enumerate(arcs):
            geo.mesh.setTransfiniteCurve(curve, along)
            loop = [spokes[i], curve, -spokes[i + 1]] + ([-inner_arcs[i]] if inner_arcs else [])
            patch = geo.addPlaneSurface([geo.addCurveLoop(loop)])
            corners = [inner[i], *pairs[i]] + ([inner[i + 1]] if inner_arcs else [])
            geo.mesh.setTransfiniteSurface(patch, cornerTags=corners)
            geo.mesh.setRecombine(2, patch)
        inner, inner_arcs = outer, arcs
    geo.synchronize()


def _growth(length: float, first: float, count: int) -> float:
    """Ratio g with ``first (1 + g + ... + g^(count-1)) = length``: no jump at the last ring."""
    if count == 1 or length <= first * count:
        return 1.0
    powers = np.arange(count)
    return float(brentq(lambda g: first * np.sum(g**powers) - length, 1.0, length / first))


def _lattice(points: np.ndarray, cells: list[np.ndarray]) -> np.ndarray:
    """Order the nodes of a fan of rings: by steps from the centre, then by angle."""
    pairs = np.vstack([c[:, [i, j]] for c in cells for i in range(c.shape[1]) for j in range(i)])
    links = sparse.coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2)
    centre = int(np.argmin(np.hypot(*points.T)))
    ring = shortest_path(links.tocsr(), directed=False, unweighted=True, indices=centre).astype(int)
    order = np.lexsort((np.arctan2(points[:, 1], points[:, 0]), ring))
    rings = ring.max()
    outside = points[order[1:]].reshape(rings, -1, 2)
    inside = np.broadcast_to(points[centre], outside[:1].shape)
    return np.concatenate([inside, outside])


def _layer(
    kick: Chip, plane: np.ndarray, steps: int
) -> tuple[MeshHex1, ElementHex1 | ElementHex2, np.ndarray]:
    """Bottom layer: a box in (ring, spoke, plane) coordinates whose nodes are then moved in place.

    The box gives regular hexahedra and their numbering; the nodes of its face ring = 0 become one
    node per plane, which collapses those hexahedra into exact wedges.
    """
    order = kick.mesh.order
    counts = (plane.shape[0] - 1, plane.shape[1] - 1, steps)
    mesh = MeshHex1.init_tensor(*(np.arange(n // order + 1) * 1.0 for n in counts))
    element: ElementHex1 | ElementHex2 = ElementHex1()
    if order == 2:
        mesh, element = MeshHex2.from_mesh(mesh), ElementHex2()
    i, j, k = np.rint(mesh.doflocs * order).astype(int)
    spokes, per_plane = plane.shape[1], 1 + counts[0] * plane.shape[1]
    in_plane = np.where(i == 0, 0, 1 + (i - 1) * spokes + j)
    thickness = kick.height / kick.layers
    located = np.array([*plane[i, j].T, k * (thickness / steps)])
    return type(mesh)(located, mesh.t), element, in_plane + k * per_plane
