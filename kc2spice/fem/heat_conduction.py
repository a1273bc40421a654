"""Finite-element matrices of heat conduction in solids.

The equation of heat conduction is ``rho c T' = div(k grad T) + p``, where p is the heat source
density [W/m^3]. The heat flux through a face with the film coefficient h is ``h (T - T_film)``
[W/m^2]. With the nodal temperatures T and the test functions v, the weak form has these matrices:

    E   = int rho c v T          K = int grad v . k grad T          H = int v T over faces

Integrals over axisymmetric meshes cover the full revolution. In one dimension, ``areas`` contains
the cross-sectional areas of the elements. A thermal interface with the resistance r [m^2 K/W] has
separate nodes on its two sides a and b. The heat flux through the interface from side a to side b
is ``(T_a - T_b) / r``.

Source: J. N. Reddy, D. K. Gartling, The Finite Element Method in Heat Transfer and Fluid Dynamics,
3rd ed., CRC Press 2010, chapter 3.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import skfem
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from kc2spice.fem.solid import CHUNK_SIZE, Solid, sum_matrices, symmetrise
from kc2spice.fem.thermal_materials import ThermalMaterial

MAX_CANDIDATES = 50  # number of elements near a point that may contain the point
# a point outside of an element counts as inside up to this distance in local coordinates
INSIDE_TOLERANCE = 1e-6
NEWTON_STEPS = 20  # largest number of Newton steps; points inside an element need fewer
# A shape function counts as zero on a face if its largest value on the face is at most this limit.
FACE_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class HeatSolid:
    """Mesh of a heat-conducting body, with the thermal material of each element.

    Element ``k`` has the material ``materials[geometry.owner[k]]``. ``areas`` (elements,) [m^2]
    contains the cross-sectional areas of line elements. ``areas`` is None if the elements are not
    lines.
    """

    geometry: Solid
    materials: tuple[ThermalMaterial, ...]
    areas: np.ndarray | None = None

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return int(self.geometry.node_positions.shape[1])

    def compute_weights(self, basis: skfem.Basis, cells: np.ndarray) -> np.ndarray:
        """Return the weights of integration points for volume integrals.

        The returned array has the shape (cells, points).
        """
        weights = np.asarray(basis.dx)
        if self.geometry.axisymmetric:
            weights = 2 * np.pi * weights * np.asarray(basis.global_coordinates())[0]
        return weights if self.areas is None else weights * self.areas[cells, None]

    def find_adjacent_cell_numbers(self, facets: np.ndarray) -> np.ndarray:
        """Return the number of one adjacent element for each facet."""
        return np.asarray(self.geometry.mesh.f2t[0, facets])


def list_local_functions(basis: skfem.Basis) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the shape functions of all elements at each integration point of a basis.

    Each item contains the values (cells, l) and the gradients (cells, d, l) of the l shape
    functions of each element in d dimensions.
    """
    local = [function[0] for function in basis.basis]
    for q in range(basis.X.shape[-1]):
        value = [np.broadcast_to(np.asarray(f), basis.dx.shape)[:, q] for f in local]
        yield np.stack(value, -1), np.stack([f.grad[:, :, q].T for f in local], -1)


def _split_by_material(solid: HeatSolid) -> Iterator[tuple[ThermalMaterial, np.ndarray]]:
    """Yield pairs of a material and at most ``CHUNK_SIZE`` of its elements."""
    for number, material in enumerate(solid.materials):
        cells = np.flatnonzero(solid.geometry.owner == number)
        for start in range(0, len(cells), CHUNK_SIZE):
            yield material, cells[start : start + CHUNK_SIZE]


def assemble_heat(solid: HeatSolid) -> tuple[sparse.csc_array, sparse.csc_array]:
    """Return the matrices of heat capacity [J/K] and thermal conductance [W/K].

    Both matrices have the shape (nodes, nodes).
    """
    capacities, conductances = [], []
    for material, cells in _split_by_material(solid):
        basis = solid.geometry.basis(elements=cells)
        k = material.conductivity[solid.geometry.axis_indices][:, None]
        e_cell, k_cell = np.zeros(()), np.zeros(())
        weights = solid.compute_weights(basis, cells).T[:, :, None, None]
        for (N, G), w in zip(list_local_functions(basis), weights, strict=True):
            e_cell = e_cell + w * material.capacity * N[:, :, None] * N[:, None]
            k_cell = k_cell + w * (G.transpose(0, 2, 1) @ (k * G))
        nodes = basis.element_dofs.T
        capacities.append((e_cell, nodes, nodes))
        conductances.append((k_cell, nodes, nodes))
    shape = (solid.node_count, solid.node_count)
    E, K = (symmetrise(sum_matrices(parts, shape)) for parts in (capacities, conductances))
    return E, K


def assemble_faces(solid: HeatSolid, facets: np.ndarray) -> sparse.csc_array:
    """Assemble the matrix [m^2] of integrals of shape-function products over faces.

    The integral covers the faces ``facets``, and the matrix is called H. H has the shape (nodes,
    nodes). The sum of the entries of H is the area of the faces.
    """
    basis = solid.geometry.make_facet_basis(facets, solid.geometry.quadrature_degree)
    weights, nodes = (
        solid.compute_weights(basis, solid.find_adjacent_cell_numbers(facets)),
        basis.element_dofs.T,
    )
    matrix = np.zeros(())
    for (N, _), w in zip(list_local_functions(basis), weights.T[:, :, None, None], strict=True):
        matrix = matrix + w * N[:, :, None] * N[:, None]
    return symmetrise(sum_matrices([(matrix, nodes, nodes)], (solid.node_count, solid.node_count)))


def _find_local_coordinates(mesh: skfem.Mesh, cell: int, point: np.ndarray) -> np.ndarray:
    """Compute the local coordinates (axes, 1) of a point in a cell by Newton's method.

    Newton's iteration starts in the middle of the cell. If the iteration does not converge for a
    point far outside of a distorted cell, the last iterate is returned.
    """
    mapping, which = mesh.mapping(), np.array([cell])
    places = np.asarray(point, float)[:, None, None]
    local = np.full((len(point), 1, 1), 1 / (len(point) + 1))
    for _ in range(NEWTON_STEPS):
        step = np.einsum(
            "ijkl,jkl->ikl", mapping.invDF(local, which), places - mapping.F(local, which)
        )
        local = local + step
        if np.abs(step).max() < INSIDE_TOLERANCE**2:
            break
    return np.asarray(local[:, 0])


def evaluate_functions_at_point(solid: HeatSolid, point: np.ndarray) -> np.ndarray:
    """Return the values (nodes,) of the shape functions of all nodes at a point.

    For a point outside of the mesh, the shape function of the nearest node is 1, and all other
    shape functions are 0.
    """
    geometry, result = solid.geometry, np.zeros(solid.node_count)
    mesh = geometry.mesh
    centres = mesh.p[:, mesh.t].mean(axis=1)
    near = np.argsort(np.linalg.norm(centres.T - point, axis=1))[:MAX_CANDIDATES]
    for cell in near:
        local = _find_local_coordinates(mesh, int(cell), point)
        simplex = mesh.refdom.nnodes == len(point) + 1
        total = local.sum() if simplex else local.max()
        if local.min() >= -INSIDE_TOLERANCE and total <= 1 + INSIDE_TOLERANCE:
            basis = geometry.basis(elements=np.array([cell]), quadrature=(local, np.ones(1)))
            values, _ = next(list_local_functions(basis))
            result[basis.element_dofs[:, 0]] = values[0]
            return result
    result[np.argmin(np.linalg.norm(geometry.node_positions.T - point, axis=1))] = 1.0
    return result


def duplicate_face_nodes(geometry: Solid, facets: np.ndarray) -> Solid:
    """Return the mesh with duplicated nodes on inner facets, one for each side.

    Two elements still share a node if faces outside of ``facets`` connect the elements, for example
    around the tip of a crack.
    """
    numbers = np.array(geometry.basis(1).element_dofs)
    count, sides = int(numbers.max()) + 1, geometry.mesh.f2t
    split = np.zeros(count, bool)
    split[find_face_nodes(geometry, facets)] = True
    near = np.flatnonzero(split[numbers].any(axis=0))
    bonded = np.setdiff1d(np.unique(geometry.mesh.t2f[:, near]), facets)
    bonded = bonded[sides[1, bonded] >= 0]
    first, second = numbers[:, sides[0, bonded]], numbers[:, sides[1, bonded]]
    i, j, f = np.nonzero((first[:, None] == second[None]) & split[first][:, None])
    elements = numbers.shape[1]
    a, b = i * elements + sides[0, bonded[f]], j * elements + sides[1, bonded[f]]
    links = sparse.coo_array((np.ones(a.size), (a, b)), shape=(numbers.size, numbers.size))
    _, piece = connected_components(links, directed=False)
    at = split[numbers].ravel()
    pairs = np.column_stack([numbers.ravel()[at], piece[at]])
    unique, which = np.unique(pairs, axis=0, return_inverse=True)
    again = np.flatnonzero(np.r_[False, unique[1:, 0] == unique[:-1, 0]])
    new = unique[:, 0].copy()
    new[again] = count + np.arange(again.size)
    result = numbers.ravel()
    result[at] = new[np.ravel(which)]
    return replace(geometry, numbers=result.reshape(numbers.shape))


def assemble_interface(solid: HeatSolid, facets: np.ndarray) -> sparse.csc_array:
    """Assemble the matrix [m^2] of integrals of temperature jumps over inner facets.

    The matrix represents the integral ``int (v_a - v_b) (T_a - T_b) dS`` over the facets. The
    facets are inside of the mesh. T_a and T_b are the temperatures on the two sides of the facets,
    and v_a and v_b are the test functions on these sides.
    """
    geometry = solid.geometry
    first, second = (
        geometry.make_facet_basis(facets, geometry.quadrature_degree, side=side) for side in (0, 1)
    )
    nodes = np.vstack([first.element_dofs, second.element_dofs]).T
    weights, matrix = (
        solid.compute_weights(first, solid.find_adjacent_cell_numbers(facets)),
        np.zeros(()),
    )
    functions = zip(list_local_functions(first), list_local_functions(second), strict=True)
    for ((N, _), (M, _)), w in zip(functions, weights.T[:, :, None, None], strict=True):
        jump = np.concatenate([N, -M], axis=1)
        matrix = matrix + w * jump[:, :, None] * jump[:, None]
    return symmetrise(sum_matrices([(matrix, nodes, nodes)], (solid.node_count, solid.node_count)))


def find_common_faces(geometry: Solid, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the numbers of the faces between two sets of elements."""
    sides = geometry.mesh.f2t
    inner = sides[1] >= 0
    a, b = np.isin(sides, first), np.isin(sides, second)
    return np.flatnonzero(inner & ((a[0] & b[1]) | (a[1] & b[0])))


def find_face_nodes(geometry: Solid, facets: np.ndarray) -> np.ndarray:
    """Return the numbers of the nodes on faces.

    If a face has duplicated nodes, only the nodes on its first side are returned.
    """
    basis = geometry.make_facet_basis(facets, 2)
    values = np.max([np.abs(N) for N, _ in list_local_functions(basis)], axis=0)
    return np.unique(basis.element_dofs.T[values > FACE_TOLERANCE])
