"""Elements of mesh files, and conversion of the elements to quadratic meshes.

A file contains blocks of linear or quadratic elements. All elements of a block are of one kind.
Meshes that consist only of hexahedra are converted to elements with 27 nodes, and meshes of
quadrilaterals to elements with 9 nodes. The positions of nodes that are not in the file are
interpolated by the shape functions of the file's elements.

All other meshes are converted to quadratic tetrahedra or triangles. In meshes of different
elements, prisms, pyramids and hexahedra are divided into tetrahedra. The diagonal that divides a
face starts at the node with the lowest number, so that the tetrahedra on both sides of the face
match. Source: J. Dompierre et al., How to subdivide pyramids, prisms and hexahedra into tetrahedra,
8th International Meshing Roundtable (1999).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import skfem
from skfem.mesh import (
    Mesh,
    MeshHex,
    MeshHex2,
    MeshQuad,
    MeshQuad2,
    MeshTet,
    MeshTet2,
    MeshTri,
    MeshTri2,
)

from kc2spice.core.errors import wrong

# Local numbers of the corners of each face of an element, in the node order of gmsh.
# The key is the number of corners of the element.
ELEMENT_FACES = {
    5: ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)),
    6: ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    8: ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}  # fmt: skip
# Neighbours of each corner along the edges of an element, in right-handed order.
# The key consists of the dimension of an element and the number of its corners.
CORNER_NEIGHBOURS = {
    (2, 4): ((1, 3), (2, 0), (3, 1), (0, 2)),
    (3, 5): ((1, 3, 4), (2, 0, 4), (3, 1, 4), (0, 2, 4)),
    (3, 6): ((1, 2, 3), (2, 0, 4), (0, 1, 5), (5, 4, 0), (3, 5, 1), (4, 3, 2)),
    (3, 8): (
        (1, 3, 4), (2, 0, 5), (3, 1, 6), (0, 2, 7), (7, 5, 0), (4, 6, 1), (5, 7, 2), (6, 4, 3),
    ),
}  # fmt: skip
SIMPLEX_MESHES = {2: (MeshTri, MeshTri2), 3: (MeshTet, MeshTet2)}
PRODUCT_MESHES = {2: (MeshQuad, MeshQuad2), 3: (MeshHex, MeshHex2)}
# scikit-fem elements with the same shape functions as the elements in mesh files.
# The key consists of the dimension of an element and the number of its nodes.
PRODUCT_ELEMENTS = {
    (2, 4): skfem.ElementQuad1, (2, 8): skfem.ElementQuadS2, (2, 9): skfem.ElementQuad2,
    (3, 8): skfem.ElementHex1, (3, 20): skfem.ElementHexS2, (3, 27): skfem.ElementHex2,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class CellBlock:
    """Block of elements of one kind, such as triangles with six nodes.

    ``nodes`` (elements, nodes per element) contains the node numbers of each element, with the
    corner nodes first. ``corners`` is the number of corner nodes. ``local`` (nodes per element, d)
    contains the positions of the nodes on the reference element of gmsh.
    """

    nodes: np.ndarray
    corners: int
    local: np.ndarray

    @property
    def dimension(self) -> int:
        """Dimension of the elements: 1 for lines, 2 for faces, 3 for solids."""
        return self.local.shape[1]

    @property
    def vertices(self) -> np.ndarray:
        """Node numbers of the elements' vertices, an array of shape (elements, corners)."""
        return self.nodes[:, : self.corners]

    @property
    def is_tensor_product(self) -> bool:
        """Whether the elements are quadrilaterals or hexahedra."""
        return self.corners == 2**self.dimension

    def renumber_nodes(self, number: np.ndarray) -> CellBlock:
        """Return the block with each node number k replaced by ``number[k]``."""
        return CellBlock(number[self.nodes], self.corners, self.local)

    def find_middle_nodes(self) -> dict[tuple[int, int], int]:
        """Return the local numbers of mid-edge nodes, keyed by pairs of corners."""
        result: dict[tuple[int, int], int] = {}
        for edge in combinations(range(self.corners), 2):
            middle = self.local[list(edge)].mean(axis=0)
            for node in range(self.corners, len(self.local)):
                if np.allclose(self.local[node], middle):
                    result[edge] = node
        centres = self._find_face_nodes(result)
        return {edge: node for edge, node in result.items() if node not in centres}

    def _find_face_nodes(self, middles: dict[tuple[int, int], int]) -> set[int]:
        """Return the local numbers of nodes in the middle of faces.

        A node is in the middle of a face if it is in the middle of several lines between corners.
        """
        nodes = list(middles.values())
        return {node for node in nodes if nodes.count(node) > 1}


def is_product_mesh(blocks: Sequence[CellBlock]) -> bool:
    """Return whether a mesh has only tensor-product elements: quads or hexahedra."""
    return bool(blocks) and all(block.is_tensor_product for block in blocks)


def reject_folded_elements(points: np.ndarray, blocks: Sequence[CellBlock], where: str) -> None:
    """Reject elements whose Jacobian determinant changes sign between corners.

    Raises
    ------
    UsageError : an element is folded or all of its corners are in one plane.
    """
    for block in blocks:
        corners = CORNER_NEIGHBOURS.get((block.dimension, block.corners))
        if corners is None:
            continue
        places = points[block.vertices]
        edges = (places[:, list(ends)] - places[:, [i]] for i, ends in enumerate(corners))
        determinant = np.array([*map(np.linalg.det, edges)])
        folded = np.flatnonzero((determinant.min(axis=0) <= 0) & (determinant.max(axis=0) >= 0))
        if folded.size:
            centre = ", ".join(f"{1e3 * x:.4g}" for x in places[folded[0]].mean(axis=0))
            raise wrong(
                where,
                "some elements of the mesh have a negative volume",
                got=f"{folded.size} elements, such as the one around ({centre}) mm",
                expected="Jacobian determinants of one sign at all corners of an element",
                hint="repair these elements in the mesher, or mesh the body with tetrahedra",
            )


def divide_faces(faces: np.ndarray) -> np.ndarray:
    """Divide each quadrilateral into two triangles by a diagonal.

    The quadrilaterals have the shape (n, 4), and the triangles the shape (k, 3). The diagonal of a
    quadrilateral starts at the node with the lowest number.

    If the last two nodes of a quadrilateral are the same, the result is one triangle.
    """
    turned = _rotate_to_lowest_node(faces)
    result = np.concatenate([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]])
    return result[(np.diff(np.sort(result, axis=1), axis=1) > 0).all(axis=1)]


def _rotate_to_lowest_node(faces: np.ndarray) -> np.ndarray:
    """Rotate the node order of each face so that the lowest number comes first."""
    order = (faces.argmin(axis=1)[:, None] + np.arange(faces.shape[1])) % faces.shape[1]
    return np.take_along_axis(faces, order, axis=1)


def divide_cells(blocks: Sequence[CellBlock]) -> tuple[np.ndarray, np.ndarray]:
    """Divide elements into triangles or tetrahedra.

    Return two arrays with k rows or entries, one for each of the k resulting triangles or
    tetrahedra. The first array has the shape (k, d + 1) and contains the node numbers of each
    triangle or tetrahedron. The second array has the shape (k,) and contains the number of the
    divided element for each triangle or tetrahedron. Each tetrahedron of a divided element consists
    of the node with the lowest number and a triangle on a face without this node.
    """
    pieces, parents, start = [], [], 0
    for block in blocks:
        number = start + np.arange(len(block.nodes))
        start += len(number)
        for cells, members in _divide_block(block):
            pieces.append(cells)
            parents.append(number[members])
    width = blocks[0].dimension + 1 if blocks else 0
    cells = np.concatenate([np.empty((0, width), int), *pieces])
    parent = np.concatenate([np.empty(0, int), *parents])
    order = np.argsort(parent, kind="stable")
    return cells[order], parent[order]


def _divide_block(block: CellBlock) -> list[tuple[np.ndarray, np.ndarray]]:
    """Divide the elements of a block into triangles or tetrahedra.

    Each item of the returned list contains two arrays: the node numbers of triangles or tetrahedra,
    and the indices of the divided elements.
    """
    cells = block.vertices
    if block.corners == block.dimension + 1:
        return [(cells, np.arange(len(cells)))]
    if block.dimension == 2:
        turned, every = _rotate_to_lowest_node(cells), np.arange(len(cells))
        return [(turned[:, [0, 1, 2]], every), (turned[:, [0, 2, 3]], every)]
    result, lowest = [], cells.argmin(axis=1)
    for corner in range(block.corners):
        members = np.flatnonzero(lowest == corner)
        for face in ELEMENT_FACES[block.corners]:
            if corner in face:
                continue
            turned = _rotate_to_lowest_node(cells[members][:, face])
            for triangle in ((0, 1, 2), (0, 2, 3))[: len(face) - 2]:
                apex = cells[members, corner]
                result.append((np.column_stack([apex, turned[:, triangle]]), members))
    return result


def _find_edge_middles(points: np.ndarray, block: CellBlock) -> tuple[np.ndarray, np.ndarray]:
    """Return the end nodes and midpoints [m] of edges and diagonals of elements.

    The end nodes have the shape (k, 2), and the midpoints the shape (k, d). The edges belong to
    quadratic elements and may be curved. The diagonals divide quadratic elements into triangles or
    tetrahedra. For linear elements, both arrays are empty.
    """
    if len(block.local) == block.corners:
        return np.empty((0, 2), int), np.empty((0, points.shape[1]))
    middles, nodes = block.find_middle_nodes(), block.nodes
    ends = [nodes[:, list(edge)] for edge in middles]
    places = [points[nodes[:, node]] for node in middles.values()]
    faces = ((0, 1, 2, 3),) if block.dimension == 2 else ELEMENT_FACES.get(block.corners, ())
    for face in faces if block.corners > block.dimension + 1 else ():
        if len(face) == 4:
            around = [middles[_sort_pair(face[i - 1], face[i])] for i in range(4)]
            centre = points[nodes[:, around]].sum(axis=1) / 2
            places.append(centre - points[nodes[:, list(face)]].sum(axis=1) / 4)
            ends.append(_rotate_to_lowest_node(nodes[:, list(face)])[:, [0, 2]])
    if block.corners == 8:
        around = list(middles.values())
        corner = block.vertices.argmin(axis=1)
        opposite = np.array([6, 7, 4, 5, 2, 3, 0, 1])[corner]
        every = np.arange(len(nodes))
        ends.append(np.column_stack([nodes[every, corner], nodes[every, opposite]]))
        sums = points[nodes[:, around]].sum(axis=1) - points[block.vertices].sum(axis=1)
        places.append(sums / 4)
    return np.concatenate(ends), np.concatenate(places)


def _sort_pair(first: int, second: int) -> tuple[int, int]:
    """Return two numbers in ascending order."""
    return min(first, second), max(first, second)


def make_quadratic_mesh(
    points: np.ndarray, blocks: Sequence[CellBlock]
) -> tuple[Mesh, np.ndarray, np.ndarray]:
    """Make a quadratic mesh from the nodes and elements of a file.

    Edges without a middle node in the file are straight.

    Returns
    -------
    mesh : mesh of quadrilaterals, hexahedra, triangles or tetrahedra.
    number : array of shape (n,); for each node of the file, its node number in the mesh, or -1 if
        the node is not a corner.
    parent : array of shape (elements,) with the number of the original element in the file for each
        element of the mesh.
    """
    make = _make_product_mesh if is_product_mesh(blocks) else _make_simplex_mesh
    return make(points, blocks)


def _make_simplex_mesh(
    points: np.ndarray, blocks: Sequence[CellBlock]
) -> tuple[Mesh, np.ndarray, np.ndarray]:
    """Make a mesh from blocks whose elements are divided into triangles or tetrahedra."""
    corners, parent = divide_cells(blocks)
    vertices, cells = np.unique(corners, return_inverse=True)
    number = _index_vertices(vertices, len(points))
    kind, curved = SIMPLEX_MESHES[points.shape[1]]
    mesh = curved.from_mesh(kind(points[vertices].T.copy(), cells.reshape(corners.shape).T.copy()))
    places = mesh.doflocs.copy()
    for block in blocks:
        ends, middle = _find_edge_middles(points, block)
        places[:, find_edge_nodes(mesh, number[ends])] = middle.T
    return curved(places, mesh.t), number, parent


def _make_product_mesh(
    points: np.ndarray, blocks: Sequence[CellBlock]
) -> tuple[Mesh, np.ndarray, np.ndarray]:
    """Make a mesh of tensor-product elements, which are quadrilaterals or hexahedra."""
    dimension = points.shape[1]
    kind, curved = PRODUCT_MESHES[dimension]
    corners = np.concatenate([block.vertices for block in blocks])
    vertices, cells = np.unique(corners, return_inverse=True)
    order = _match_positions(
        _compute_unit_positions(blocks[0])[: corners.shape[1]], kind.elem.doflocs
    )
    mesh = curved.from_mesh(
        kind(points[vertices].T.copy(), cells.reshape(corners.shape)[:, order].T.copy())
    )
    numbers = skfem.Dofs(mesh, curved.elem()).element_dofs
    places, start = mesh.doflocs.copy(), 0
    for block in blocks:
        columns = numbers[:, start : start + len(block.nodes)]
        start += len(block.nodes)
        places[:, columns] = np.einsum(
            "il,eld->die", _compute_interpolation_weights(block), points[block.nodes]
        )
    number = _index_vertices(vertices, len(points))
    return curved(places, mesh.t), number, np.arange(len(corners))


def _compute_unit_positions(block: CellBlock) -> np.ndarray:
    """Compute the positions of a block's nodes on the unit square or unit cube.

    The returned array has the shape (nodes per element, dimensions).
    """
    return (block.local + 1) / 2


def _match_positions(places: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Match each position to the nearest of several candidates; return the indices.

    Each position in ``others`` is matched to the nearest candidate position in ``places``.
    """
    distance = np.linalg.norm(places[None] - others[:, None], axis=-1)
    return np.asarray(distance.argmin(axis=1))


def _compute_interpolation_weights(block: CellBlock) -> np.ndarray:
    """Return interpolation weights for the node positions of a quadratic element.

    The array of weights has the shape (m, l). The product of the weights and the positions of l
    nodes in the file gives the positions of m nodes of the quadratic element.
    """
    element = PRODUCT_ELEMENTS[block.dimension, len(block.local)]()
    curved = PRODUCT_MESHES[block.dimension][1].elem.doflocs
    result = np.empty((len(curved), len(block.local)))
    order = _match_positions(_compute_unit_positions(block), element.doflocs)
    for i, node in enumerate(order):
        result[:, node] = element.lbasis(curved.T, i)[0]
    return result


def _index_vertices(vertices: np.ndarray, count: int) -> np.ndarray:
    """Return the index of each node number in ``vertices``; -1 for other nodes.

    The node numbers are 0 to ``count - 1``. The index is -1 for a node that is not in
    ``vertices``.
    """
    number = np.full(count, -1)
    number[vertices] = np.arange(len(vertices))
    return number


def find_edge_nodes(mesh: Mesh, pairs: np.ndarray) -> np.ndarray:
    """Return the mid-edge nodes between pairs of vertices.

    ``pairs`` has the shape (k, 2), and the returned array has the shape (k,).
    """
    edges = mesh.edges if mesh.dim() == 3 else mesh.facets
    return mesh.nvertices + find_entities_by_corners(edges, pairs)


def find_entities_by_corners(entities: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Find edges or faces by the numbers of their corners, in any order.

    Each column of ``entities`` (c, n) contains the c corners of an edge or face. Each row of
    ``corners`` (k, c) contains the corners of an edge or face to be found. Return the column
    numbers (k,), with -1 for corners that are not a column of ``entities``.
    """
    columns, rows = np.sort(entities, axis=0), np.sort(corners, axis=1)
    if columns.shape[0] != rows.shape[1]:
        return np.full(len(rows), -1)
    base = columns.max(initial=0) + 1
    powers = base ** np.arange(min(len(columns), 3))  # three corners identify a face
    keys, row_keys = powers @ columns[: len(powers)], rows[:, : len(powers)] @ powers
    order = np.argsort(keys)
    place = order[np.minimum(np.searchsorted(keys[order], row_keys), len(keys) - 1)]
    return np.where((rows == columns[:, place].T).all(axis=1), place, -1)
