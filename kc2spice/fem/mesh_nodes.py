"""Merging of nodes of touching solids, and detection of meshes that do not match."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from kc2spice.core.errors import wrong
from kc2spice.fem.mesh_cells import CellBlock, divide_cells

# largest distance between nodes that count as coincident, relative to the shortest edge
COINCIDENCE_TOLERANCE = 1e-3


def merge_nodes(points: np.ndarray, blocks: Sequence[CellBlock], distance: float) -> np.ndarray:
    """Merge nodes that are close together: give these nodes the same number.

    Nodes are merged if their distance is at most ``distance`` [m]. Nodes that belong to no element
    keep their numbers.

    Raises
    ------
    UsageError : both ends of an edge would get the same number.
    """
    from scipy.spatial import cKDTree  # imported here, because few meshes need cKDTree

    used = _find_used_nodes(blocks)
    pairs = used[cKDTree(points[used]).query_pairs(distance, output_type="ndarray")]
    links = sparse.coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2)
    _, label = connected_components(links, directed=False)
    lowest = np.full(len(points), len(points))
    np.minimum.at(lowest, label, np.arange(len(points)))
    same = lowest[label]
    cells = divide_cells(blocks)[0]
    if (np.diff(np.sort(same[cells], axis=1), axis=1) == 0).any():
        raise wrong(
            "merge",
            "the merge distance exceeds the shortest edge of an element",
            got=f"{distance:g} m",
            expected=f"less than the shortest edge, {_find_shortest_edge(points, cells):.4g} m",
            hint=f"lower the key `merge` to {0.1 * _find_shortest_edge(points, cells):.2g} m",
        )
    return np.asarray(same)


def _find_used_nodes(blocks: Sequence[CellBlock]) -> np.ndarray:
    """Return the numbers of the nodes that belong to elements, in ascending order."""
    return np.unique(np.concatenate([block.nodes.ravel() for block in blocks]))


def _find_shortest_edge(points: np.ndarray, cells: np.ndarray) -> float:
    """Return the length [m] of the shortest edge of triangles or tetrahedra."""
    i, j = np.triu_indices(cells.shape[1], 1)
    return float(np.linalg.norm(points[cells[:, i]] - points[cells[:, j]], axis=-1).min())


def reject_unconnected_solids(
    points: np.ndarray,
    blocks: Sequence[CellBlock],
    owners: Mapping[str, np.ndarray],
    where: str,
) -> None:
    """Reject solids that touch but share no nodes.

    A mesh without common nodes does not connect touching solids. ``points`` (n, d) [m] are the
    positions of the nodes. ``owners`` maps the name of each group to the numbers of the elements in
    the group.

    Raises
    ------
    UsageError : two nodes are at the same place, or a node of one piece of the mesh is on the
        surface of another piece.
    """
    # imported here, so that a scene without a mesh file does not load scipy.spatial
    from scipy.spatial import cKDTree

    cells = divide_cells(blocks)[0]
    near = COINCIDENCE_TOLERANCE * _find_shortest_edge(points, cells)
    used = _find_used_nodes(blocks)
    pairs = used[cKDTree(points[used]).query_pairs(near, output_type="ndarray")]
    expected = "one common node for all elements that touch at a point"
    apart = "merge = 0 keeps the solids separate"
    if len(pairs):
        got = f"{len(pairs)} pairs of coincident nodes, "
        got += _describe_nodes(points, pairs.ravel(), blocks, owners)
        raise wrong(
            where,
            "solids touch but share no nodes",
            got=got,
            expected=expected,
            hint=f'merge = "{_format_length(10 * near)}" joins nodes up to that distance; {apart}',
        )
    strays = _find_nodes_on_other_pieces(points, cells, near)
    if strays.size:
        got = f"{strays.size} nodes on the surface of another piece, "
        got += _describe_nodes(points, strays, blocks, owners)
        hint = "fragment the solids before meshing, for example with gmsh's occ.fragment; " + apart
        raise wrong(
            where,
            "solids touch but their meshes do not match",
            got=got,
            expected=expected,
            hint=hint,
        )


def _find_nodes_on_other_pieces(points: np.ndarray, cells: np.ndarray, near: float) -> np.ndarray:
    """Find the nodes on the surface of one mesh piece that lie on another piece.

    A piece is a set of connected elements, and only nodes on the surfaces of pieces are considered.
    The ``cells`` (k, d + 1) are triangles or tetrahedra.
    """
    from scipy.spatial import cKDTree

    ends = np.array([cells[:, :-1].ravel(), cells[:, 1:].ravel()])
    links = sparse.coo_array((np.ones(ends.shape[1]), ends), shape=(len(points),) * 2)
    _, label = connected_components(links, directed=False)
    piece = label[cells[:, 0]]
    if (piece == piece[0]).all():
        return np.empty(0, int)
    omitted = [np.delete(cells, k, axis=1) for k in range(cells.shape[1])]
    faces, count = np.unique(np.sort(np.concatenate(omitted), axis=1), axis=0, return_counts=True)
    faces = faces[count == 1]
    middle = points[faces].mean(axis=1)
    reach = np.linalg.norm(points[faces] - middle[:, None], axis=-1).max(axis=1) + near
    nodes = np.unique(faces)
    around = cKDTree(points[nodes]).query_ball_point(middle, reach)
    face = np.repeat(np.arange(len(faces)), list(map(len, around)))
    node = nodes[np.fromiter(chain.from_iterable(around), int)]
    other = label[faces[face, 0]] != label[node]
    face, node = face[other], node[other]
    return np.unique(node[_mask_points_on_simplices(points[node], points[faces[face]], near)])


def _mask_points_on_simplices(places: np.ndarray, simplices: np.ndarray, near: float) -> np.ndarray:
    """Return a mask of the points that are close to at least one simplex.

    A point is close if its distance is at most ``near``. The mask has the shape (n,). Each of the n
    points ``places[i]`` (d,) is compared with one simplex ``simplices[i]`` (corners, d). The foot
    of the perpendicular from the point x is ``s_0 + J t`` with ``J'J t = J'(x - s_0)``, where
    ``s_0`` is a corner, and the columns of J are the edges from this corner.
    """
    J = (simplices[:, 1:] - simplices[:, :1]).transpose(0, 2, 1)
    arm = (places - simplices[:, 0])[:, :, None]
    t = np.linalg.solve(J.transpose(0, 2, 1) @ J, J.transpose(0, 2, 1) @ arm)
    away = np.linalg.norm((arm - J @ t)[:, :, 0], axis=1)
    slack = near / np.linalg.norm(J, axis=1).min(axis=1)
    inside = (t[:, :, 0] >= -slack[:, None]).all(axis=1) & (t.sum(axis=1)[:, 0] <= 1 + slack)
    return np.asarray(inside & (away <= near))


def _describe_nodes(
    points: np.ndarray,
    nodes: np.ndarray,
    blocks: Sequence[CellBlock],
    owners: Mapping[str, np.ndarray],
) -> str:
    """Describe nodes by their bounding box [mm] and the groups of their elements."""
    axes = "xyz" if points.shape[1] == 3 else ("radius", "height")
    spans = []
    for axis, values in zip(axes, 1e3 * points[nodes].T, strict=True):
        low, high = float(values.min()), float(values.max())
        flat = high - low <= 1e-6 * np.abs(values).max(initial=0.0)
        spans.append(f"{axis} = {low:.4g} mm" if flat else f"{axis} {low:.4g} … {high:.4g} mm")
    touched = np.concatenate([np.isin(block.nodes, nodes).any(axis=1) for block in blocks])
    names = [name for name, members in owners.items() if touched[members].any()]
    return ", ".join(spans) + (f", groups {', '.join(sorted(names))}" if names else "")


def _format_length(length: float) -> str:
    """Format a length with one significant digit and an SI prefix."""
    for unit, factor in (("mm", 1e-3), ("um", 1e-6)):
        if length >= factor:
            return f"{length / factor:.1g} {unit}"
    return f"{length / 1e-9:.1g} nm"
