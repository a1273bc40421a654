"""Estimates of the discretisation error of strain and electric field.

The mesh consists of hexahedra. Around every corner of the mesh, polynomials are fitted to the
strain and the electric field of the adjacent elements by least squares. The fit uses the points of
an element at which strain and field are most accurate. The recovered strain and field are the sum
of these polynomials, weighted by linear shape functions. Recovered strain and field are more
accurate than the original strain and field. The differences (dS, dE) between recovered and original
values give the energy product of the errors of two solutions 1 and 2:

    A(1, 2) = int dS1' C dS2 - dS1' e' dE2 - dE1' e dS2 - dE1' eps dE2

A fit includes only elements of one piece of the mesh. A piece consists of connected elements whose
materials have the same name, so the strain within a piece is continuous. In a stack with
alternating poling, the coupling of each layer is s times the coupling of the first layer, where s
is 1 or -1. Multiplied by the sign s of each layer's coupling, the electric field is continuous
across the layers. In a mesh of linear elements, each fit includes elements of several layers. A fit
to linear elements of only one layer would be constant across this layer, like the electric field of
the elements. In a mesh of quadratic elements, each fit includes elements of only one layer. Strain
and field are discontinuous at an electrode if the mean strain changes from layer to layer. Sources:
O. C. Zienkiewicz and J. Z. Zhu, Int. J. Numer. Meth. Eng. 33 (1992) 1331; N.-E. Wiberg and F.
Abdulwahab, Int. J. Numer. Meth. Eng. 36 (1993) 2703.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
import skfem
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from kc2spice.fem.solid import Solid, list_strain_operators, list_tensors

CHUNK_SIZE = 1000  # elements or corners processed together, which limits the memory
# Penalty on the squares of coefficients of degree 1, relative to the mean diagonal entry of the
# normal equations. The penalty on coefficients of degree p is p^2 * RIDGE_PENALTY.
# The penalty on coefficients makes the fit of a polynomial to too few points unique.
RIDGE_PENALTY = 1e-6
# Penalty on the choice of a neighbouring patch instead of the patch around a corner.
# The penalty is added to the squared distance between the corner and the patch's mean point.
# The squared distance is measured relative to the spread of the patch's points.
NEIGHBOUR_PENALTY = 0.5


@dataclass(frozen=True, eq=False)
class EnergyProducts:
    """Energy inner products between k solutions, and between the solutions' errors.

    The energy inner products are matrices [J] of shape (k, k). ``solution`` contains the energy
    inner products of the solutions, and ``error`` the energy inner products of the errors.
    ``spread`` is the sum of the absolute values of all element contributions to ``error``.
    """

    solution: np.ndarray
    error: np.ndarray
    spread: np.ndarray


def compute_energy_products(solid: Solid, u: np.ndarray, phi: np.ndarray) -> EnergyProducts:
    """Compute the energy inner products of k solutions, and of the solutions' errors.

    Each of the k solutions consists of displacements, a column of ``u``, and potentials, a column
    of ``phi``. The displacements [m] have the shape (d * nodes, k), with d components per node. The
    potentials [V] have the shape (nodes, k).
    """
    patches = _PatchPolynomials.fit_patches(solid, u, phi)
    k = u.shape[1]
    solution, error, spread = np.zeros((3, k, k))
    for cells in _split_range(solid.mesh.nelements):
        basis = solid.basis(elements=cells)
        places = np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1)
        energy = np.zeros((len(cells), k, k))
        hats = _evaluate_linear_shape_functions(basis.X)
        points = zip(
            _evaluate_fields(solid, basis, cells, u, phi),
            _list_energy_matrices(solid, basis, cells),
            strict=True,
        )
        for q, (field, H) in enumerate(points):
            w = basis.dx[:, q, None, None]
            delta = patches.evaluate(cells, places[:, q], hats[q]) - field
            energy += w * (delta.transpose(0, 2, 1) @ (H @ delta))
            solution += (w * (field.transpose(0, 2, 1) @ (H @ field))).sum(axis=0)
        error += energy.sum(axis=0)
        spread += np.abs(energy).sum(axis=0)
    return EnergyProducts(solution, error, spread)


def _split_range(count: int) -> Iterator[np.ndarray]:
    """Yield 0 to ``count - 1`` in arrays of at most :data:`CHUNK_SIZE` numbers."""
    return (
        np.arange(start, min(start + CHUNK_SIZE, count)) for start in range(0, count, CHUNK_SIZE)
    )


def _evaluate_fields(
    solid: Solid, basis: skfem.Basis, cells: np.ndarray, u: np.ndarray, phi: np.ndarray
) -> Iterator[np.ndarray]:
    """Yield strains and electric fields at each integration point of a basis.

    Each array has the shape (cells, 9, k). ``cells`` are the elements of the basis. Rows 0 to 5
    contain the strains. Rows 6 to 8 contain the electric field, multiplied by the coupling factor
    of the material.
    """
    d, nodes = solid.component_count, basis.element_dofs.T
    moves = (d * nodes[:, :, None] + np.arange(d)).reshape(len(nodes), -1)
    factor = -_compute_coupling_factors(solid)[solid.owner[cells], None, None]
    for _, B, G in list_strain_operators(solid, basis):
        yield np.concatenate([B @ u[moves], factor * (G @ phi[nodes])], axis=1)


def _compute_coupling_factors(solid: Solid) -> np.ndarray:
    """Return the coupling factor of each material, an array of shape (materials,).

    Several materials can have one name, for example layers of opposite poling. The coupling factor
    of a material is its piezoelectric coupling, divided by the piezoelectric coupling of the first
    equally named material in ``solid.materials``.
    """
    first = {material.name: material.e for material in reversed(solid.materials)}
    pairs = [(material.e, first[material.name]) for material in solid.materials]
    return np.array([np.sum(e * e0) / np.sum(e0 * e0) if e.any() else 1.0 for e, e0 in pairs])


def _list_energy_matrices(
    solid: Solid, basis: skfem.Basis, cells: np.ndarray
) -> Iterator[np.ndarray]:
    """Yield the matrices ``[[C, -e'], [-e, -eps]]`` at each integration point.

    Each array has the shape (cells, 9, 9). The matrices are scaled for an electric field that is
    multiplied by the coupling factor of the material. In materials that are neither piezoelectric
    nor dielectric, the rows and columns of the electric field are zero.
    """
    owner, factors = solid.owner[cells], _compute_coupling_factors(solid)
    constants = [list_tensors(solid, basis, material) for material in solid.materials]
    for _ in range(basis.X.shape[-1]):
        H = np.zeros((len(cells), 9, 9))
        for number, (material, each) in enumerate(zip(solid.materials, constants, strict=True)):
            members = owner == number
            C, e, eps = (item if len(item) == 1 else item[members] for item in next(each))
            H[members, :6, :6] = C
            if material.is_piezoelectric or material.dielectric:
                e, eps = e / factors[number], eps / factors[number] ** 2
                H[members, 6:, :6], H[members, :6, 6:], H[members, 6:, 6:] = (
                    -e,
                    -e.transpose(0, 2, 1),
                    -eps,
                )
        yield H


def _evaluate_linear_shape_functions(X: np.ndarray) -> np.ndarray:
    """Return the values of the linear shape functions at the points ``X``.

    ``X`` has the shape (d, points), and the returned array has the shape (points, corners).
    """
    element = skfem.ElementHex1()
    return np.array([element.lbasis(X, i)[0] for i in range(len(element.doflocs))]).T


def _evaluate_monomials(x: np.ndarray, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of all monomials of the coordinates up to a given degree.

    ``x`` has the shape (…, d), and the array of monomials has the shape (…, terms). The second
    returned array contains the degree (terms,) of each monomial.
    """
    dimensions = range(x.shape[-1])
    powers = list[tuple[int, ...]]()
    for total in range(degree + 1):
        powers += combinations_with_replacement(dimensions, total)
    columns = [np.prod(x[..., list(axes)], axis=-1) for axes in powers]
    return np.stack(columns, axis=-1), np.array(list(map(len, powers)))


@dataclass(frozen=True, eq=False)
class _PatchPolynomials:
    """Polynomials fitted to strain and electric field in patches of elements.

    A patch consists of the elements around a corner of the mesh. The position of this corner is the
    ``middle`` of the patch; ``middle`` [m] has the shape (patches, d). ``coefficients`` (patches,
    terms, 9 * k) are the coefficients of the polynomials in the coordinates ``(x - middle) /
    size``. ``number`` (elements, corners) contains the number of the patch around each corner of
    each element.
    """

    number: np.ndarray
    middle: np.ndarray
    size: np.ndarray
    coefficients: np.ndarray
    degree: int

    @staticmethod
    def fit_patches(solid: Solid, u: np.ndarray, phi: np.ndarray) -> _PatchPolynomials:
        """Fit polynomials to the strain and electric field in all patches of elements."""
        degree = solid.order
        places, samples = _sample_fields(solid, u, phi, solid.order)
        number, middle = _number_patches(solid)
        members = _widen_patches(
            _assign_patch_elements(number, len(middle)), number, middle, places
        )
        size, sums, right = _assemble_normal_equations(members, middle, places, samples, degree)
        degrees = _evaluate_monomials(middle[:1], degree)[1]
        mean = np.trace(sums, axis1=1, axis2=2) / len(degrees)
        sums += RIDGE_PENALTY * mean[:, None, None] * np.diag(degrees**2)
        coefficients = np.linalg.solve(sums, right)
        return _PatchPolynomials(number, middle, size, coefficients, degree)

    def evaluate(self, cells: np.ndarray, at: np.ndarray, hats: np.ndarray) -> np.ndarray:
        """Return the recovered strains and electric fields at one point of each element.

        The returned array has the shape (cells, 9, k). ``at`` (cells, d) [m] contains the points,
        and ``hats`` (corners,) the values of the linear shape functions at these points.
        """
        result = 0.0
        for corner, hat in enumerate(hats):
            patch = self.number[cells, corner]
            x = (at - self.middle[patch]) / self.size[patch]
            terms = hat * _evaluate_monomials(x, self.degree)[0]
            result = result + np.einsum("et,ets->es", terms, self.coefficients[patch])
        return np.reshape(result, (len(cells), 9, -1))


def _sample_fields(
    solid: Solid, u: np.ndarray, phi: np.ndarray, order: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the strains and electric fields to which the polynomials are fitted.

    The first returned array contains the positions [m] of the integration points and has the shape
    (elements, points, d). The second array contains the values of strain and field and has the
    shape (elements, points, 9 * k).
    """
    places, values = [], []
    for cells in _split_range(solid.mesh.nelements):
        basis = solid.basis(order, elements=cells)
        places.append(np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1))
        fields = np.stack([*_evaluate_fields(solid, basis, cells, u, phi)], axis=1)
        values.append(fields.reshape(*fields.shape[:2], -1))
    return np.concatenate(places), np.concatenate(values)


def _number_patches(solid: Solid) -> tuple[np.ndarray, np.ndarray]:
    """Return the patch number of each corner of each element, and the patch centres.

    The numbers have the shape (elements, corners). A corner on the boundary between pieces of the
    mesh has one patch in each piece. The second returned array (patches, d) contains the position
    [m] of the corner in the middle of each patch.
    """
    first, second = solid.mesh.f2t[:, solid.mesh.f2t[1] >= 0]
    names = np.array([material.name for material in solid.materials])
    label = solid.owner if solid.order == 2 else names[solid.owner]
    alike = label[first] == label[second]
    n, nodes = solid.mesh.nelements, solid.node_positions.shape[1]
    links = sparse.coo_array((np.ones(alike.sum()), (first[alike], second[alike])), shape=(n, n))
    piece = connected_components(links, directed=False)[1]
    corners = solid.basis(1).element_dofs[: solid.mesh.t.shape[0]].T
    known, number = np.unique(piece[:, None] * nodes + corners, return_inverse=True)
    return number.reshape(corners.shape), solid.node_positions[:, known % nodes].T


def _assign_patch_elements(number: np.ndarray, count: int) -> sparse.csr_array:
    """Return a matrix that assigns elements to patches.

    The entry of the matrix (patches, elements) is 1 if the element belongs to the patch.
    """
    elements = np.repeat(np.arange(len(number)), number.shape[1])
    ones = np.ones(number.size)
    result = sparse.csr_array((ones, (number.ravel(), elements)), shape=(count, len(number)))
    result.sort_indices()
    return result


def _assemble_normal_equations(
    members: sparse.csr_array,
    middle: np.ndarray,
    places: np.ndarray,
    samples: np.ndarray,
    degree: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the patch sizes and the normal equations of the least-squares fits.

    The sizes have the shape (patches, d). With the monomials p at each point, the normal equations
    have the matrices ``sum(p * p')``, of shape (patches, terms, terms). The right-hand sides are
    ``sum(p * values)``, of shape (patches, terms, 9 * k).
    """
    sizes, sums, rights = [], [], []
    for chosen in _split_range(len(middle)):
        start, end = members.indptr[chosen[0]], members.indptr[chosen[-1] + 1]
        elements = members.indices[start:end]
        counts = np.diff(members.indptr[chosen[0] : chosen[-1] + 2])
        first, patch = members.indptr[chosen] - start, np.repeat(chosen, counts)
        arm = places[elements] - middle[patch, None]
        size = np.maximum.reduceat(np.abs(arm).max(axis=1), first)
        P, _ = _evaluate_monomials(arm / np.repeat(size, counts, axis=0)[:, None], degree)
        turned = P.transpose(0, 2, 1)
        sizes.append(size)
        sums.append(np.add.reduceat(turned @ P, first))
        rights.append(np.add.reduceat(turned @ samples[elements], first))
    return np.concatenate(sizes), np.concatenate(sums), np.concatenate(rights)


def _widen_patches(
    members: sparse.csr_array, number: np.ndarray, middle: np.ndarray, places: np.ndarray
) -> sparse.csr_array:
    """Widen element patches whose sample points surround the patch centre unevenly.

    The added elements are the elements of the best neighbouring patch.
    """
    use = _choose_patches(number, members, middle, places)
    index = np.arange(len(use))
    other = use != index
    more = sparse.csr_array(
        (np.ones(other.sum()), (index[other], use[other])), shape=(len(use), len(use))
    )
    result = sparse.csr_array(members + more @ members)
    result.data[:] = 1.0
    result.sort_indices()
    return result


def _choose_patches(
    number: np.ndarray, members: sparse.csr_array, middle: np.ndarray, places: np.ndarray
) -> np.ndarray:
    """Choose for each mesh corner its own patch of elements or a neighbouring patch.

    The returned array has the shape (patches,). The best patch is the patch whose points surround
    its corner most evenly. If a mesh corner is on the surface of the body, all points of its patch
    are on one side of the corner.
    """
    count, d = places.shape[1], places.shape[2]
    total = np.diff(members.indptr) * count
    mean = (members @ places.sum(axis=1)) / total[:, None]
    squares = np.einsum("eqi,eqj->eij", places, places).reshape(len(places), -1)
    spread = (members @ squares / total[:, None]).reshape(-1, d, d)
    spread = spread - mean[:, :, None] * mean[:, None]
    spread += 1e-12 * np.trace(spread, axis1=1, axis2=2)[:, None, None] * np.eye(d)
    away = (middle - mean)[:, :, None]
    distance = (away.transpose(0, 2, 1) @ np.linalg.solve(spread, away))[:, 0, 0]
    corners = number.shape[1]
    patch = np.repeat(number, corners, axis=1).ravel()
    other = np.tile(number, corners).ravel()
    cost = distance[other] + NEIGHBOUR_PENALTY * (patch != other)
    order = np.lexsort((cost, patch))
    first = np.r_[True, np.diff(patch[order]) > 0]
    return np.asarray(other[order][first])
