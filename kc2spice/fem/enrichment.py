"""Cubic shape functions that extend the quadratic shape functions of a solid.

The cubic functions are hierarchical: the quadratic and cubic functions together span all cubic
polynomials on triangles and tetrahedra. On quadrilaterals, the quadratic and cubic functions span
all products of cubic polynomials in x and in y. On hexahedra, the cubic functions are cubic in only
one direction. Each cubic function belongs to an edge, a face or the interior of an element. All
cubic functions are zero at the nodes of the solid:

    l_i l_j (l_j - l_i)   on edges of simplices, with barycentric coordinates l
    l_i l_j l_k           on faces of tetrahedra and in triangles
    b_3(x) l(y)           on edges of quadrilaterals, with l(y) = y or 1 - y
    b_3(x) b_2(y), b_2(x) b_3(y), b_3(x) b_3(y)    in quadrilaterals
    b_3(x) l(y) l(z)      on edges of hexahedra
    b_3(x) b_2(y) l(z), b_2(x) b_3(y) l(z)         on faces of hexahedra,

with ``b_2 = x (1 - x)`` and ``b_3 = x (1 - x) (2 x - 1)``. The function of an edge changes sign if
the direction of the edge is reversed. The function of a hexahedron's face changes sign if the
direction of its factor b_3 is reversed. Hexahedra have no functions of their interior, because the
functions of edges and faces already correct the errors of long elements.

:func:`assemble_enrichment` integrates all matrix entries that belong to cubic functions. The matrix
entries between quadratic functions are integrated by :mod:`kc2spice.fem.solid`. Source: B. Szabo
and I. Babuska, Finite Element Analysis (1991).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import combinations, product
from typing import NamedTuple

import numpy as np
import skfem
from scipy import sparse
from scipy.special import roots_jacobi
from skfem.mesh import MeshHex, MeshQuad, MeshTet

from kc2spice.fem.materials import Material
from kc2spice.fem.solid import VOIGT_ROWS, Solid, list_tensors

# Highest polynomial degree that is integrated exactly.
# For axisymmetric cubic elements with straight edges, the mass matrix needs this degree.
INTEGRATION_ORDER = 7
CHUNK_BYTES = 64e6  # largest size [B] of the element matrices that are computed at once
# If a mapping's derivatives vary by a smaller fraction within an element, the mapping is treated as
# affine.
AFFINE_TOLERANCE = 1e-9


class ShapeFunction(NamedTuple):
    """Values and gradients of a shape function on the reference element.

    The values have the shape (points,), and the gradients the shape (d, points). ``corners`` lists
    the corners of the edge, triangle or quadrilateral to which the function belongs. For an edge,
    the order of the two corners states the direction of the edge. For a face of a hexahedron, the
    first two and the last two corners are the ends of the edges along which the function is cubic.
    """

    corners: tuple[int, ...]
    values: np.ndarray
    gradients: np.ndarray


@dataclass(frozen=True, eq=False)
class Enrichment:
    """Enrichment of a solid's quadratic elements with cubic shape functions.

    Attributes
    ----------
    functions : cubic shape functions of the reference element, evaluated at the integration points.
    nodes : for each function, the local numbers of the nodes in its edge, face or element.
    numbers, signs : number and sign of each function of each element in the whole mesh, two arrays
        of shape (functions, elements).
    """

    solid: Solid
    functions: Sequence[ShapeFunction]
    nodes: Sequence[np.ndarray]
    numbers: np.ndarray
    signs: np.ndarray

    @property
    def function_count(self) -> int:
        """Number of cubic functions in the whole solid."""
        return int(self.numbers.max()) + 1

    def mask_dielectric_functions(self) -> np.ndarray:
        """Return a mask of the cubic functions in piezoelectric or dielectric materials."""
        field = np.array([m.is_piezoelectric or m.dielectric for m in self.solid.materials])
        result = np.zeros(self.function_count, bool)
        result[self.numbers[:, field[self.solid.owner]]] = True
        return result


@dataclass(frozen=True, eq=False)
class EnrichedOperators:
    """Matrices of selected cubic functions, and of their coupling to all nodes.

    The unknowns of the cubic functions are displacements and potentials. ``K`` is the stiffness
    matrix of the displacements, ``C`` the coupling matrix of displacements and potentials, ``P``
    the permittivity matrix of the potentials, and ``M`` the mass matrix. Matrices named ``…_nodes``
    have a row for each unknown of a cubic function and a column for each unknown of a node:

    - rows of ``K_nodes``, ``C_nodes`` and ``M_nodes``: displacements of the cubic functions
    - rows of ``D_nodes`` and ``P_nodes``: potentials of the cubic functions
    - columns of ``K_nodes``, ``D_nodes`` and ``M_nodes``: displacements of the nodes
    - columns of ``C_nodes`` and ``P_nodes``: potentials of the nodes
    """

    K: sparse.csr_array
    C: sparse.csr_array
    P: sparse.csr_array
    M: sparse.csr_array
    K_nodes: sparse.csr_array
    C_nodes: sparse.csr_array
    D_nodes: sparse.csr_array
    P_nodes: sparse.csr_array
    M_nodes: sparse.csr_array

    def scale(self, factor: float) -> EnrichedOperators:
        """Return a copy whose matrices are multiplied by a factor."""
        return EnrichedOperators(*(factor * getattr(self, field.name) for field in fields(self)))


def make_enrichment(solid: Solid) -> Enrichment:
    """Make the enrichment of a solid: cubic shape functions on its mesh."""
    functions = evaluate_shape_functions(solid, _make_basis(solid, np.array([0])).X)
    numbers, signs = _index_functions(solid, functions)
    return Enrichment(solid, functions, _find_entity_nodes(solid, functions), numbers, signs)


def assemble_enrichment(
    enrichment: Enrichment, free: np.ndarray, live: np.ndarray
) -> EnrichedOperators:
    """Assemble the finite-element matrices of selected cubic shape functions.

    The masks ``free`` (count, d) and ``live`` (count,) select the displacements and the potentials
    of the cubic functions.
    """
    solid, d = enrichment.solid, enrichment.solid.component_count
    nodes, size = solid.basis(1).element_dofs, solid.node_positions.shape[1]
    unknowns = {
        ("nodes", 0): np.arange(size * d).reshape(size, d),
        ("nodes", 1): np.arange(size)[:, None],
        ("functions", 0): _number_selected_entries(free),
        ("functions", 1): _number_selected_entries(live[:, None]),
    }
    local = {"nodes": slice(len(nodes)), "functions": slice(len(nodes), None)}
    parts = slice(d), slice(d, None)
    sums = {
        (i, group, j): _SparseSum(
            (unknowns["functions", i].max() + 1, unknowns[group, j].max() + 1)
        )
        for i, group, j in product((0, 1), local, (0, 1))
    }
    masses = {
        "nodes": _SparseSum((enrichment.function_count, size)),
        "functions": _SparseSum((enrichment.function_count,) * 2),
    }
    table = _tabulate_functions(solid, _make_basis(solid, np.array([0])).X, enrichment.functions)
    for material, cells in _split_by_material(solid, len(table), len(enrichment.functions)):
        S, M = _compute_element_matrices(solid, material, cells, table, len(nodes))
        numbers, sign = enrichment.numbers[:, cells].T, enrichment.signs[:, cells].T
        here = {"nodes": nodes[:, cells].T, "functions": numbers}
        for matrix in (S, M[:, :, None, :, None]):
            matrix *= sign[:, :, None, None, None]
            matrix[:, :, :, local["functions"]] *= sign[:, None, None, :, None]
        for group, mass in masses.items():
            mass.add(M[:, :, local[group]], numbers, here[group])
        for (i, group, j), total in sums.items():
            part = S[:, :, parts[i], local[group], parts[j]]
            if part.size:
                rows = _look_up_unknowns(unknowns["functions", i], numbers)
                columns = _look_up_unknowns(unknowns[group, j], here[group])
                total.add(part.reshape(*rows.shape, -1), rows, columns)
    K, C, P = (sums[i, "functions", j].matrix for i, j in ((0, 0), (0, 1), (1, 1)))
    K_nodes, C_nodes, D_nodes, P_nodes = (
        sums[i, "nodes", j].matrix for i, j in product((0, 1), (0, 1))
    )
    mass, mass_nodes = (
        sparse.kron(masses[group].matrix, np.eye(d), "csr")[free.ravel()]
        for group in ("functions", "nodes")
    )
    return EnrichedOperators(
        K, C, -P, mass[:, free.ravel()], K_nodes, C_nodes, D_nodes, -P_nodes, mass_nodes
    )


def _make_basis(solid: Solid, cells: np.ndarray) -> skfem.Basis:
    """Make a finite-element basis with exact quadrature on the elements ``cells``."""
    if isinstance(solid.mesh, MeshTet):
        return solid.basis(quadrature=_make_tetrahedron_rule(INTEGRATION_ORDER), elements=cells)
    return solid.basis(INTEGRATION_ORDER, elements=cells)


def _make_tetrahedron_rule(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return integration points and weights on the reference tetrahedron.

    The points have the shape (3, points), and the weights the shape (points,). The integration rule
    is a product of three Gauss-Jacobi rules. For comparison, scikit-fem's rules for tetrahedra are
    exact only up to polynomial degree 4. Source: A. H. Stroud, Approximate Calculation of Multiple
    Integrals (1971), section 2.5.
    """
    count = order // 2 + 1
    rules = [roots_jacobi(count, alpha, 0.0) for alpha in (2, 1, 0)]
    x, y, z = np.meshgrid(*((1 + t) / 2 for t, _ in rules), indexing="ij")
    weights = np.einsum("i,j,k->ijk", *(w for _, w in rules)) / 2**6
    points = np.array([x, y * (1 - x), z * (1 - x) * (1 - y)])
    return points.reshape(3, -1), weights.ravel()


def evaluate_shape_functions(solid: Solid, X: np.ndarray) -> list[ShapeFunction]:
    """Evaluate the cubic functions at points on the reference element.

    ``X`` (d, points) contains the points.
    """
    corners = np.asarray(solid.element.refdom.p, float)
    if isinstance(solid.mesh, MeshHex):
        return _evaluate_hexahedron_functions(corners, X)
    if isinstance(solid.mesh, MeshQuad):
        return _evaluate_quadrilateral_functions(corners, X)
    return _evaluate_simplex_functions(corners, X)


def _evaluate_simplex_functions(corners: np.ndarray, X: np.ndarray) -> list[ShapeFunction]:
    """Evaluate the cubic shape functions of a triangle or tetrahedron."""
    inverse = np.linalg.inv(np.vstack([np.ones(corners.shape[1]), corners]))
    value, slope = inverse @ np.vstack([np.ones(X.shape[1]), X]), inverse[:, 1:, None]
    result = []
    for i, j in combinations(range(len(value)), 2):
        (a, b), (da, db) = value[[i, j]], slope[[i, j]]
        gradient = da * b * (b - 2 * a) + db * a * (2 * b - a)
        result.append(ShapeFunction((i, j), a * b * (b - a), gradient))
    for i, j, k in combinations(range(len(value)), 3):
        (a, b, c), (da, db, dc) = value[[i, j, k]], slope[[i, j, k]]
        gradient = da * b * c + db * a * c + dc * a * b
        result.append(ShapeFunction((i, j, k), a * b * c, gradient))
    return result


def _evaluate_quadrilateral_functions(corners: np.ndarray, X: np.ndarray) -> list[ShapeFunction]:
    """Evaluate the cubic shape functions of a quadrilateral on the unit square."""
    ends = [1 - X, X], [-np.ones(X.shape), np.ones(X.shape)]
    square, square_slope = X * (1 - X), 1 - 2 * X
    cube, cube_slope = square * (2 * X - 1), -1 + 6 * X - 6 * X**2
    number = {tuple(corner): i for i, corner in enumerate(np.rint(corners).astype(int).T)}
    result = []
    for axis, side in product((0, 1), (0, 1)):
        other = 1 - axis
        edge = tuple(number[(end, side) if axis == 0 else (side, end)] for end in (0, 1))
        gradient = np.zeros(X.shape)
        gradient[axis] = cube_slope[axis] * ends[0][side][other]
        gradient[other] = cube[axis] * ends[1][side][other]
        result.append(ShapeFunction(edge, cube[axis] * ends[0][side][other], gradient))
    bubbles = (cube, cube_slope), (square, square_slope)
    for (f, df), (g, dg) in (bubbles, bubbles[::-1], (bubbles[0], bubbles[0])):
        gradient = np.array([df[0] * g[1], f[0] * dg[1]])
        result.append(ShapeFunction((0, 1, 2, 3), f[0] * g[1], gradient))
    return result


def _evaluate_hexahedron_functions(corners: np.ndarray, X: np.ndarray) -> list[ShapeFunction]:
    """Evaluate the cubic shape functions of the edges and faces of the unit cube."""
    square, cube = X * (1 - X), X * (1 - X) * (2 * X - 1)
    ends = [(1 - X, -np.ones(X.shape)), (X, np.ones(X.shape))]
    bubble, cubic = (square, 1 - 2 * X), (cube, -1 + 6 * X - 6 * X**2)
    number = {tuple(corner): i for i, corner in enumerate(np.rint(corners).astype(int).T)}
    result = []
    for axis, *others in ((0, 1, 2), (1, 0, 2), (2, 0, 1)):
        for kinds in product((0, 1, None), repeat=2):
            if kinds == (None, None):
                continue
            factors = {axis: cubic}
            # coordinates of the corners of the edge or face
            spans: dict[int, tuple[int, ...]] = {axis: (0, 1)}
            for other, side in zip(others, kinds, strict=True):
                factors[other] = bubble if side is None else ends[side]
                spans[other] = (0, 1) if side is None else (side,)
            entity = []
            for sides in product(*(spans[other] for other in others), (0, 1)):
                place = dict(zip((*others, axis), sides, strict=True))
                entity.append(number[place[0], place[1], place[2]])
            values = np.prod([factors[k][0][k] for k in range(3)], axis=0)
            gradients = np.ones(X.shape)
            for row, k in product(range(3), repeat=2):
                gradients[row] *= factors[k][1 if k == row else 0][k]
            result.append(ShapeFunction(tuple(entity), values, gradients))
    return result


def _index_functions(
    solid: Solid, functions: Sequence[ShapeFunction]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the global index and the sign of each cubic function in each element.

    Both arrays have the shape (local functions, elements). The function on an edge or face between
    two elements has the same index in both elements.
    """
    corners = solid.basis(1).element_dofs[: solid.mesh.t.shape[0]]
    element = np.arange(corners.shape[1])
    keys, signs = [], []
    for index, function in enumerate(functions):
        if isinstance(solid.mesh, MeshHex) and len(function.corners) == 4:
            key, sign = _identify_face_functions(corners[list(function.corners)])
            keys.append(key)
            signs.append(sign)
            continue
        at = np.sort(corners[list(function.corners)], axis=0)
        turned = (len(at) == 2) & (at[0] != corners[function.corners[0]])
        signs.append(np.where(turned, -1.0, 1.0))
        inside = np.array([-1 - index + 0 * element, element, element])
        keys.append(inside if len(at) == 4 else np.array([at[0], at[1], at[-1]]))
    _, numbers = np.unique(np.concatenate(keys, axis=1), axis=1, return_inverse=True)
    return numbers.reshape(len(functions), -1), np.array(signs)


def _identify_face_functions(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return keys that identify a face function of each hexahedron, and its signs.

    The array of keys has the shape (3, elements), and the array of signs the shape (elements,).
    ``corners`` (4, elements) are the corners of the face. The function is cubic from the first to
    the second corner, and from the third to the fourth corner. Two hexahedra with a common face
    have equal keys for the same function.
    """
    element, first = np.arange(corners.shape[1]), corners.argmin(axis=0)
    # corner on the same cubic edge as the first corner, and corner diagonal to the first corner
    neighbour, opposite = corners[first ^ 1, element], corners[3 - first, element]
    key = np.array([corners[first, element], opposite, neighbour])
    return key, np.where(first % 2, -1.0, 1.0)


def _find_entity_nodes(solid: Solid, functions: Sequence[ShapeFunction]) -> list[np.ndarray]:
    """Find the nodes on the edge or face to which each shape function belongs.

    The returned list contains an array of local node numbers for each shape function. For an
    interior function, the array contains all nodes of the element.
    """
    places, corners = np.asarray(solid.element.doflocs).T, solid.element.refdom.p
    result = []
    for function in functions:
        first, *others = corners[:, list(function.corners), None].transpose(1, 0, 2)
        if len(corners) == 3 and len(others) == 3:
            others = others[:2]  # three corners define the plane of a hexahedron's face
        span = np.hstack(others) - first
        share = np.linalg.lstsq(span, places - first, rcond=None)[0]
        away = np.abs(span @ share - (places - first)).max(axis=0)
        result.append(
            np.flatnonzero((away < AFFINE_TOLERANCE) & (share > -AFFINE_TOLERANCE).all(axis=0))
        )
    return result


def _tabulate_functions(
    solid: Solid, X: np.ndarray, functions: Sequence[ShapeFunction]
) -> np.ndarray:
    """Return gradients and values of all shape functions on the reference element.

    The array has the shape (functions, d + 1, points). Along the first axis, the shape functions of
    the nodes precede the cubic functions. Along the second axis, the d components of the gradient
    precede the value.
    """
    element, rows = solid.element, []
    for i in range(len(element.doflocs)):
        value, gradient = element.lbasis(X, i)
        rows.append([*(np.broadcast_to(g, X.shape[1:]) for g in gradient), value])
    rows += [[*function.gradients, function.values] for function in functions]
    return np.array([np.broadcast_arrays(*row) for row in rows], dtype=float)


def _split_by_material(
    solid: Solid, local: int, more: int
) -> Iterator[tuple[Material, np.ndarray]]:
    """Split the elements of each material into batches; yield (material, batch) pairs.

    A batch is an array of element numbers. The element matrices of one batch need at most
    ``CHUNK_BYTES`` bytes.
    """
    count = max(1, int(CHUNK_BYTES / (8 * local * more * (solid.component_count + 1) ** 2)))
    for number, material in enumerate(solid.materials):
        cells = np.flatnonzero(solid.owner == number)
        for start in range(0, len(cells), count):
            yield material, cells[start : start + count]


def _compute_element_matrices(
    solid: Solid, material: Material, cells: np.ndarray, table: np.ndarray, n: int
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the stiffness matrices S and mass matrices M of elements.

    All elements have the same material. S has five axes: element, cubic function, field, nodal or
    cubic function, field. M has three axes: element, cubic function, nodal or cubic function. The
    nodal functions are the shape functions of the ``n`` nodes, and precede the cubic functions. The
    fields are the displacement components, and also the potential in piezoelectric and dielectric
    materials. S is computed from products of gradients on the reference element.
    """
    rule = _make_basis(solid, cells)
    weights, radius = rule.dx, np.asarray(rule.global_coordinates())[0]
    if solid.axisymmetric:
        weights = 2 * np.pi * weights * radius
    inverse = rule.mapping.invDF(rule.X, tind=cells).transpose(2, 3, 0, 1)
    constants = [*list_tensors(solid, rule, material)]
    even = np.ptp(inverse, axis=1).max() < AFFINE_TOLERANCE * np.abs(inverse).max()
    even = even and all(len(constant[0]) == 1 for constant in constants)
    values = table[:, -1]
    pairs = (values[n:, None] * values).reshape(-1, values.shape[1])
    M = material.density * (weights @ pairs.T).reshape(len(cells), -1, len(table))
    gradients = table if solid.axisymmetric else table[:, :-1]
    pairs = np.einsum("amq,bpq->qmpab", gradients[n:], gradients)
    if even and not solid.axisymmetric:  # the products are first summed over all points
        pairs = np.tensordot(weights[0] / weights[0].sum(), pairs, 1)[None]
        weights, inverse, constants = weights.sum(axis=1)[:, None], inverse[:, :1], constants[:1]
    D = _compute_reference_tensor(solid, material, weights, inverse, constants, radius)
    fields = D.shape[2]
    D = D.transpose(0, 2, 4, 1, 3, 5).reshape(len(cells) * fields**2, -1)
    S = (D @ pairs.reshape(D.shape[1], -1)).reshape(-1, fields, fields, *pairs.shape[-2:])
    return np.ascontiguousarray(S.transpose(0, 3, 1, 4, 2)), M


def _compute_reference_tensor(
    solid: Solid,
    material: Material,
    weights: np.ndarray,
    inverse: np.ndarray,
    constants: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
    radius: np.ndarray,
) -> np.ndarray:
    """Compute second derivatives of the energy with respect to field gradients.

    The gradients are derivatives on the reference element. The array has the shape (elements,
    points, fields, m, fields, m), where m is the number of gradient components of each field. In
    axisymmetric solids, the value of the field counts as an additional gradient component.
    """
    d = solid.component_count
    field = material.is_piezoelectric or material.dielectric
    kinds = d + 1 if solid.axisymmetric else d
    strain = np.zeros((*weights.shape, 9, d + field, kinds))
    axes = solid.axis_indices
    for i, y in enumerate(axes):
        for k, x in enumerate(axes):
            strain[:, :, VOIGT_ROWS[x, y], k, :d] += inverse[:, :, :, i]
        if field:
            strain[:, :, 6 + y, d, :d] = inverse[:, :, :, i]
    if solid.axisymmetric:
        strain[:, :, 1, 0, d] = 1 / radius
    strain = strain.reshape(*strain.shape[:3], -1)
    H = np.zeros((max(len(C) for C, _, _ in constants), len(constants), 9, 9))
    for q, (C, e, eps) in enumerate(constants):
        H[:, q, :6, :6] = C
        if field:
            H[:, q, 6:, :6], H[:, q, :6, 6:] = e, e.transpose(0, 2, 1)
            H[:, q, 6:, 6:] = -eps
    result = strain.transpose(0, 1, 3, 2) @ (H @ strain) * weights[:, :, None, None]
    result = result.reshape(*weights.shape, d + field, kinds, d + field, kinds)
    sigma = np.array(material.residual_stress)
    # The prestress sigma contributes grad v . sigma grad u for each displacement component u.
    # In axisymmetric solids, the prestress also contributes a hoop term.
    if sigma.any():
        stress = np.einsum("eqmi,eqpi,i->eqmp", inverse, inverse, sigma[axes])
        for k in range(d):
            result[:, :, k, :d, k, :d] += weights[:, :, None, None] * stress
        if solid.axisymmetric:
            result[:, :, 0, d, 0, d] += weights * sigma[1] / radius**2
    return result


def _number_selected_entries(mask: np.ndarray) -> np.ndarray:
    """Number the true entries of a mask consecutively; other entries become -1."""
    return np.where(mask, np.cumsum(mask).reshape(mask.shape) - 1, -1)


def _look_up_unknowns(unknowns: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Look up the numbers of the unknowns that belong to each shape function.

    ``numbers`` (elements, functions) contains the numbers of the shape functions. The returned
    array has the shape (elements, functions * components). An unknown that is not selected has the
    number -1.
    """
    return unknowns[numbers].reshape(len(numbers), -1).astype(np.int32)


class _SparseSum:
    """Sum of element matrices, stored as one sparse matrix."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.matrix = sparse.csr_array(shape)

    def add(self, values: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> None:
        """Add the matrices of several elements to the sum.

        ``values`` contains the element matrices (elements, rows, columns). Entries with the row or
        column number -1 are omitted.
        """
        i = np.broadcast_to(rows[:, :, None], values.shape)
        j = np.broadcast_to(columns[:, None, :], values.shape)
        present = (i >= 0) & (j >= 0)
        entries = (values[present], (i[present], j[present]))
        self.matrix = self.matrix + sparse.csr_array(
            sparse.coo_array(entries, shape=self.matrix.shape)
        )
