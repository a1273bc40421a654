"""Heat conduction in solids: matrices over the nodes of a mesh.

The equation of heat conduction is ``rho c T' = div(k grad T) + p``. The heat flow through a face
with a film is ``h (T - T_film)`` [W/m^2]. The weak form has these matrices for the temperatures T
of the nodes:

    E   = int rho c v T          K = int grad v . k grad T          H = int v T over faces

Axisymmetric integrals extend over the full turn. In one dimension, ``areas`` are the cross-sections
of the elements. An interface with the resistance r [m^2 K/W] consists of two sets of nodes, between
which the heat flow ``(T_a - T_b) / r`` passes.

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

MAX_CANDIDATES = 50  # number of nearest elements in which a point is searched
INSIDE_TOLERANCE = 1e-6  # rounding error of a point's local coordinates in an element
NEWTON_STEPS = 20  # more iterations than any point inside an element needs
FACE_TOLERANCE = 1e-9  # largest value of a shape function on a face that does not contain its node


@dataclass(frozen=True, eq=False)
class HeatSolid:
    """Mesh whose element ``k`` consists of ``materials[geometry.owner[k]]``.

    ``areas`` (elements,) [m^2] are the cross-sections of the elements of a line; None for solids.
    """

    geometry: Solid
    materials: tuple[ThermalMaterial, ...]
    areas: np.ndarray | None = None

    @property
    def count(self) -> int:
        """Number of nodes."""
        return int(self.geometry.places.shape[1])

    def compute_weights(self, basis: skfem.Basis, cells: np.ndarray) -> np.ndarray:
        """Return the weights (cells, points) of volume integrals."""
        weights = np.asarray(basis.dx)
        if self.geometry.axisymmetric:
            weights = 2 * np.pi * weights * np.asarray(basis.global_coordinates())[0]
        return weights if self.areas is None else weights * self.areas[cells, None]

    def find_adjacent_cells(self, facets: np.ndarray) -> np.ndarray:
        """Return one element adjacent to each of the ``facets``."""
        return np.asarray(self.geometry.mesh.f2t[0, facets])


def list_local_functions(basis: skfem.Basis) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the shape functions at each integration point of a basis.

    Each item consists of values (cells, l) and gradients (cells, d, l).
    """
    local = [function[0] for function in basis.basis]
    for q in range(basis.X.shape[-1]):
        value = [np.broadcast_to(np.asarray(f), basis.dx.shape)[:, q] for f in local]
        yield np.stack(value, -1), np.stack([f.grad[:, :, q].T for f in local], -1)


def _split_chunks(solid: HeatSolid) -> Iterator[tuple[ThermalMaterial, np.ndarray]]:
    """Yield each material with groups of at most ``CHUNK_SIZE`` of its elements."""
    for number, material in enumerate(solid.materials):
        cells = np.flatnonzero(solid.geometry.owner == number)
        for start in range(0, len(cells), CHUNK_SIZE):
            yield material, cells[start : start + CHUNK_SIZE]


def assemble_heat(solid: HeatSolid) -> tuple[sparse.csc_array, sparse.csc_array]:
    """Return heat capacities E [J/K] and conductances K [W/K], both (nodes, nodes)."""
    capacities, conductances = [], []
    for material, cells in _split_chunks(solid):
        basis = solid.geometry.basis(elements=cells)
        k = material.conductivity[solid.geometry.axes][:, None]
        e_cell, k_cell = np.zeros(()), np.zeros(())
        weights = solid.compute_weights(basis, cells).T[:, :, None, None]
        for (N, G), w in zip(list_local_functions(basis), weights, strict=True):
            e_cell = e_cell + w * material.capacity * N[:, :, None] * N[:, None]
            k_cell = k_cell + w * (G.transpose(0, 2, 1) @ (k * G))
        nodes = basis.element_dofs.T
        capacities.append((e_cell, nodes, nodes))
        conductances.append((k_cell, nodes, nodes))
    shape = (solid.count, solid.count)
    E, K = (symmetrise(sum_matrices(parts, shape)) for parts in (capacities, conductances))
    return E, K


def assemble_faces(solid: HeatSolid, facets: np.ndarray) -> sparse.csc_array:
    """Return the matrix H (nodes, nodes) [m^2] of faces; the sum of its entries is the area."""
    basis = solid.geometry.facet_basis(facets, solid.geometry.quadrature)
    weights, nodes = (
        solid.compute_weights(basis, solid.find_adjacent_cells(facets)),
        basis.element_dofs.T,
    )
    matrix = np.zeros(())
    for (N, _), w in zip(list_local_functions(basis), weights.T[:, :, None, None], strict=True):
        matrix = matrix + w * N[:, :, None] * N[:, None]
    return symmetrise(sum_matrices([(matrix, nodes, nodes)], (solid.count, solid.count)))


def _find_local_coordinates(mesh: skfem.Mesh, cell: int, point: np.ndarray) -> np.ndarray:
    """Compute the local coordinates (axes, 1) of a point in a cell by Newton's method.

    The iteration starts in the middle of the cell. For a point far outside of a distorted cell, the
    iteration ends without convergence.
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


def find_point_shares(solid: HeatSolid, point: np.ndarray) -> np.ndarray:
    """Return the values (nodes,) of the shape functions at a point.

    For a point outside of the mesh, only the value of the nearest node is not zero.
    """
    geometry, result = solid.geometry, np.zeros(solid.count)
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
    result[np.argmin(np.linalg.norm(geometry.places.T - point, axis=1))] = 1.0
    return result


def split_nodes(geometry: Solid, facets: np.ndarray) -> Solid:
    """Return the mesh with two nodes in place of each node on inner ``facets``.

    Two elements keep a common node if they are connected by faces that are not in ``facets``, as
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
    """Return the matrix of ``int (v_a - v_b) (T_a - T_b)`` [m^2] across inner ``facets``."""
    geometry = solid.geometry
    first, second = (
        geometry.facet_basis(facets, geometry.quadrature, side=side) for side in (0, 1)
    )
    nodes = np.vstack([first.element_dofs, second.element_dofs]).T
    weights, matrix = solid.compute_weights(first, solid.find_adjacent_cells(facets)), np.zeros(())
    functions = zip(list_local_functions(first), list_local_functions(second), strict=True)
    for ((N, _), (M, _)), w in zip(functions, weights.T[:, :, None, None], strict=True):
        jump = np.concatenate([N, -M], axis=1)
        matrix = matrix + w * jump[:, :, None] * jump[:, None]
    return symmetrise(sum_matrices([(matrix, nodes, nodes)], (solid.count, solid.count)))


def find_common_faces(geometry: Solid, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the faces between elements of a first set and elements of a second set."""
    sides = geometry.mesh.f2t
    inner = sides[1] >= 0
    a, b = np.isin(sides, first), np.isin(sides, second)
    return np.flatnonzero(inner & ((a[0] & b[1]) | (a[1] & b[0])))


def find_face_nodes(geometry: Solid, facets: np.ndarray) -> np.ndarray:
    """Return the numbers of the nodes on faces; at a double face, those on its first side."""
    basis = geometry.facet_basis(facets, 2)
    values = np.max([np.abs(N) for N, _ in list_local_functions(basis)], axis=0)
    return np.unique(basis.element_dofs.T[values > FACE_TOLERANCE])
