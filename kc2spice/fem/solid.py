"""Finite-element matrices of piezoelectric solids on scikit-fem meshes.

The elements are tetrahedra, hexahedra, or triangles and quadrilaterals of an axisymmetric mesh.

The equations are ``rho u'' = div T``, ``div D = 0`` with ``T = C S - e' E``, ``D = e S + eps E``
and ``E = -grad phi``. With nodal displacements u, nodal potentials phi and the test functions v and
psi, the weak form has these matrices:

    M    = int rho v u          K_uu = int S(v)' C S(u)
    K_up = int S(v)' e' grad phi          K_pp = int grad psi' eps grad phi

A displacement has d components: x, y and z, or r and z in an axisymmetric mesh. With d components
per node, entry ``d * node + axis`` of the displacement vector is the displacement of the node
number ``node`` along ``axis``. In the vector of potentials, entry k is the potential of node k.
Strains are in Voigt order xx yy zz yz xz xy with engineering shear strains. In an axisymmetric
body, x is the radial and y the hoop direction, and integrals cover the full revolution. Source:
IEEE Std 176-1987; R. Lerch, IEEE Trans. UFFC 37 (1990) 233.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any, Literal

import numpy as np
import skfem
from scipy import sparse
from skfem.mapping import MappingIsoparametric
from skfem.mesh import Mesh, MeshHex, MeshLine, MeshQuad, MeshTet

from kc2spice.core.errors import wrong
from kc2spice.fem.materials import ElementAxes, Material

# highest polynomial degree that the quadrature over a face integrates exactly
FACE_QUADRATURE = 5
CHUNK_SIZE = 4000  # elements processed together, which limits the memory of the element matrices
# Entry (i, j) is the Voigt index of the strain that contains the derivative of displacement
# component i with respect to coordinate j.
VOIGT_ROWS = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
# Indices of the mesh coordinates in the order x, y, z, keyed by the dimension of the mesh.
# A mesh of dimension 1 is a line along z, and a mesh of dimension 2 is a meridian plane.
_COORDINATE_AXES = {1: np.array([2]), 2: np.array([0, 2]), 3: np.arange(3)}


# Tolerance for thin elements: largest permitted change of local coordinates in the last Newton
# step. In thin elements, rounding errors of global coordinates exceed scikit-fem's tolerance.
# Newton's method converges quadratically, so the error after the last step is far smaller than the
# step.
THIN_ELEMENT_TOLERANCE = 1e-8


class FacetMapping(MappingIsoparametric):
    """Isoparametric mapping of facets; its inverse also converges in thin elements."""

    def invF(self, x: np.ndarray, tind: Any = None, **options: Any) -> np.ndarray:
        """Invert the mapping F: return the local coordinates of points in elements.

        ``x`` (d, elements, points) contains the coordinates of the points, and ``tind`` the indices
        of the elements.
        """
        try:
            return np.asarray(super().invF(x, tind, **options))
        except Exception:  # scikit-fem raises the base class Exception
            options["newton_tol"] = THIN_ELEMENT_TOLERANCE
            return np.asarray(super().invF(x, tind, **options))


@dataclass(frozen=True, eq=False)
class Solid:
    """Mesh of a solid body, with the material of each element.

    Element ``k`` has the material ``materials[owner[k]]``. The tensors of the materials are already
    rotated to the poling direction. The shape functions have the degree ``order``, which is 2, or
    optionally 1 on hexahedra. Reports list all materials of one name as a single material.
    ``numbers`` (nodes per element, elements) contains the node numbers of each element. If
    ``numbers`` is None, scikit-fem numbers the nodes. Collapsed edges or faces require ``numbers``,
    because all nodes of a collapsed edge or face have the same number.

    Raises
    ------
    UsageError : an element has a negative volume, an axisymmetric mesh crosses the axis, or the
        materials of an axisymmetric mesh are not isotropic about the axis.
    """

    mesh: Mesh
    materials: tuple[Material, ...]
    owner: np.ndarray
    axisymmetric: bool = False
    order: Literal[1, 2] = 2
    numbers: np.ndarray | None = None

    def __post_init__(self) -> None:
        determinant = self.mesh.mapping().detDF(self.basis(2).X)
        flipped = (determinant.min(axis=1) <= 0) & (determinant.max(axis=1) >= 0)
        if flipped.any():
            raise wrong(
                "mesh",
                "some elements have a negative volume",
                got=f"{flipped.sum()} elements",
                expected="a Jacobian determinant of one sign in each element",
                hint="repair or refine the mesh",
            )
        for material in self.materials if self.axisymmetric else ():
            if material.local_axes is not None and material.has_out_of_plane_coupling:
                raise wrong(
                    None,
                    "this material twists an axisymmetric body under a voltage",
                    got=material.name,
                    expected="a poling in the plane of the mesh",
                    hint='use a 3D mesh (part = "body" without axisymmetric)',
                )
            if material.local_axes is None and not material.is_isotropic_about_z:
                hint = 'use a 3D mesh (part = "body"), or enter constants '
                hint += "averaged in the plane; for a ring with radial poling, write  "
                hint += 'poling = { GROUP = "radial" }'
                raise wrong(
                    None,
                    "an axisymmetric body needs materials that are isotropic about its axis",
                    got=material.name,
                    hint=hint,
                )
        if self.axisymmetric and self.mesh.p[0].min() < -1e-9 * np.ptp(self.mesh.p):
            raise wrong(
                "mesh",
                "the axisymmetric mesh crosses the axis",
                got=f"x = {self.mesh.p[0].min():g} m",
                expected="x (the radius) of at least 0",
                hint="delete the half of the mesh with negative x, or move the mesh",
            )

    @property
    def component_count(self) -> int:
        """Number d of displacement components."""
        return self.mesh.dim()

    @property
    def axis_indices(self) -> np.ndarray:
        """Indices of the mesh coordinates in the order x, y, z."""
        return _COORDINATE_AXES[self.mesh.dim()]

    @property
    def element(self) -> Any:
        """scikit-fem element with the shape functions of one field component."""
        mesh = self.mesh
        if isinstance(mesh, MeshHex):
            return skfem.ElementHex1() if self.order == 1 else skfem.ElementHex2()
        if isinstance(mesh, MeshTet):
            return skfem.ElementTetP2()
        if isinstance(mesh, MeshLine):
            return skfem.ElementLineP2()
        return skfem.ElementQuad2() if isinstance(mesh, MeshQuad) else skfem.ElementTriP2()

    @property
    def quadrature_degree(self) -> int:
        """Highest polynomial degree that the quadrature integrates exactly.

        This degree is sufficient for the mass matrix of quadratic tetrahedra with straight edges.
        """
        return 2 * self.order

    def basis(self, order: int | None = None, **options: Any) -> skfem.Basis:
        """Return the scalar finite-element basis with one degree of freedom per node."""
        if "quadrature" not in options:
            options["intorder"] = order or self.quadrature_degree
        return skfem.Basis(self.mesh, self.element, dofs=self._dof_numbering, **options)

    def make_facet_basis(
        self, facets: np.ndarray, order: int, side: Literal[0, 1] = 0
    ) -> skfem.BoundaryFacetBasis:
        """Make the scalar basis on facets, evaluated in the elements on one side."""
        options: dict[str, Any] = {
            "facets": facets,
            "intorder": order,
            "dofs": self._dof_numbering,
        }
        if not self.mesh.affine:
            options["mapping"] = FacetMapping(self.mesh, self.mesh.elem(), self.mesh.bndelem)
        if side:
            return skfem.InteriorFacetBasis(self.mesh, self.element, side=side, **options)
        return skfem.BoundaryFacetBasis(self.mesh, self.element, **options)

    @cached_property
    def node_positions(self) -> np.ndarray:
        """Positions [m] of the nodes, an array of shape (d, nodes)."""
        return np.asarray(self.basis(1).doflocs)

    @cached_property
    def _dof_numbering(self) -> skfem.Dofs | None:
        """Numbering of the degrees of freedom from the node numbers of the elements.

        The result is None if scikit-fem numbers the nodes.
        """
        if self.numbers is None:
            return None
        result = skfem.Dofs(self.mesh, self.element)
        result.element_dofs, result.N = self.numbers, int(self.numbers.max()) + 1
        return result

    def nodes(self, elements: np.ndarray) -> np.ndarray:
        """Return the node numbers of some elements, sorted and without repetitions."""
        return np.unique(self.basis(1).element_dofs[:, elements])


def find_mesh_frequency_limit(solid: Solid) -> float:
    """Return the highest frequency [Hz] of waves that the mesh resolves.

    At this frequency, the wavelength of the slowest waves in a material equals the longest distance
    between two vertices of an element of this material. The quadratic shape functions of an element
    cannot represent waves of higher frequencies. In a body of several materials, the result is the
    largest of these frequencies.
    """
    corners = solid.mesh.p[:, solid.mesh.t]
    sizes = np.zeros(solid.mesh.nelements)
    for first, second in combinations(range(corners.shape[1]), 2):
        distances = np.linalg.norm(corners[:, first] - corners[:, second], axis=0)
        sizes = np.maximum(sizes, distances)
    result = 0.0
    for number, material in enumerate(solid.materials):
        lengths = sizes[solid.owner == number]
        if lengths.size:
            result = max(result, material.slowest_wave_speed / float(lengths.max()))
    return result


@dataclass(frozen=True, eq=False)
class SolidMatrices:
    """Finite-element matrices of a solid without constraints, for all nodes.

    The docstring of the module :mod:`kc2spice.fem.solid` defines the matrices.
    """

    M: sparse.csc_array
    K_uu: sparse.csc_array
    K_up: sparse.csc_array
    K_pp: sparse.csc_array


def list_strain_operators(
    solid: Solid, basis: skfem.Basis
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield shape functions N, strain operators B and gradients G at each point.

    At each integration point of ``basis``, N (elements, l) contains the values of the l local shape
    functions. G (elements, 3, l) contains the gradients of the shape functions. In elements with l
    nodes, the array B of shape (elements, 6, l * d) maps nodal displacements with d components to
    strains.
    """
    local = [function[0] for function in basis.basis]
    d, axes = solid.component_count, solid.axis_indices
    radius = np.asarray(basis.global_coordinates())[0]
    for q in range(basis.X.shape[-1]):
        value = np.stack([np.broadcast_to(np.asarray(f), basis.dx.shape)[:, q] for f in local], -1)
        slope = np.stack([f.grad[:, :, q] for f in local], -1)
        B = np.zeros((*value.shape[:1], 6, value.shape[1], d))
        G = np.zeros((*value.shape[:1], 3, value.shape[1]))
        for j, y in enumerate(axes):
            G[:, y] = slope[j]
            for i, x in enumerate(axes):
                B[:, VOIGT_ROWS[x, y], :, i] += slope[j]
        if solid.axisymmetric:
            r = radius[:, q, None]
            axis = r < 1e-9 * np.ptp(solid.mesh.p)  # on the axis, u_r / r equals du_r / dr
            B[:, 1, :, 0] = np.where(axis, slope[0], value / np.where(axis, 1.0, r))
        yield value, B.reshape(len(B), 6, -1), G


def list_tensors(
    solid: Solid, basis: skfem.Basis, material: Material
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield stiffness, coupling and permittivity of a material at each point.

    The points are the integration points of ``basis``. The tensors are in the axes of the solid,
    which are cylindrical in an axisymmetric solid. The first dimension of each tensor has the
    length 1 if all elements have the same tensors, and otherwise the number of elements.
    """
    places = np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1)
    elements = np.arange(len(places)) if basis.tind is None else basis.tind
    by_element = isinstance(material.local_axes, ElementAxes)
    for q in range(places.shape[1]):
        if solid.axisymmetric and not by_element:
            yield material.C[None], material.e[None], material.eps_S[None]
        else:
            yield material.compute_tensors(places[:, q], elements)


def _split_by_material(solid: Solid, only: int | None) -> Iterator[tuple[Material, np.ndarray]]:
    """Yield pairs of a material and at most ``CHUNK_SIZE`` of its elements.

    If ``only`` is the number of a material, the other materials are omitted.
    """
    for number, material in enumerate(solid.materials):
        cells = np.flatnonzero(solid.owner == number)
        if only in (None, number):
            for start in range(0, len(cells), CHUNK_SIZE):
                yield material, cells[start : start + CHUNK_SIZE]


def assemble_solid(solid: Solid, *, only: int | None = None) -> SolidMatrices:
    """Assemble the mass, stiffness, coupling and permittivity matrices of a solid.

    Only piezoelectric and dielectric materials contribute to the coupling and permittivity
    matrices. If ``only`` is the number of a material, the matrices include only the elements of
    this material.
    """
    d = solid.component_count
    parts: list[list[tuple[np.ndarray, ...]]] = [[], [], [], []]
    for material, cells in _split_by_material(solid, only):
        field = material.is_piezoelectric or material.dielectric
        basis = solid.basis(elements=cells)
        weights = basis.dx
        if solid.axisymmetric:
            weights = 2 * np.pi * weights * np.asarray(basis.global_coordinates())[0]
        nodes = basis.element_dofs.T
        moves = (d * nodes[:, :, None] + np.arange(d)).reshape(len(cells), -1)
        m, k, c, p = (np.zeros(()) for _ in range(4))
        points = zip(
            list_strain_operators(solid, basis), list_tensors(solid, basis, material), strict=True
        )
        for ((N, B, G), (C, e, eps)), w in zip(points, weights.T[:, :, None, None], strict=True):
            m = m + w * material.density * N[:, :, None] * N[:, None]
            k = k + w * (B.transpose(0, 2, 1) @ (C @ B))
            if any(material.residual_stress):
                k = k + w * _compute_stress_stiffness(solid, material, N, B, G)
            if field:
                c = c + w * (B.transpose(0, 2, 1) @ (e.transpose(0, 2, 1) @ G))
                p = p + w * (G.transpose(0, 2, 1) @ (eps @ G))
        parts[0].append((m, nodes, nodes))
        parts[1].append((k, moves, moves))
        if field:
            parts[2].append((c, moves, nodes))
            parts[3].append((p, nodes, nodes))
    n = solid.node_positions.shape[1]
    shapes = ((n, n), (d * n, d * n), (d * n, n), (n, n))
    m, K_uu, K_up, K_pp = (sum_matrices(p, s) for p, s in zip(parts, shapes, strict=True))
    M = sparse.csc_array(sparse.kron(symmetrise(m), np.eye(d)))
    return SolidMatrices(M, symmetrise(K_uu), K_up, symmetrise(K_pp))


def _compute_stress_stiffness(
    solid: Solid, material: Material, N: np.ndarray, B: np.ndarray, G: np.ndarray
) -> np.ndarray:
    """Return the element stiffness due to prestress at one integration point.

    The returned array has the shape (elements, l * d, l * d), with l nodes per element and d
    components per node. Each displacement component u, with its test function v, contributes ``grad
    v . sigma0 grad u``, where sigma0 is the prestress. In axisymmetric solids, the hoop prestress
    sigma0_y adds ``sigma0_y v_r u_r / r^2`` to the stiffness.
    """
    d, sigma = solid.component_count, np.array(material.residual_stress)
    item = G.transpose(0, 2, 1) @ (sigma[:, None] * G)
    result = np.einsum("eab,ij->eaibj", item, np.eye(d))
    if solid.axisymmetric:
        hoop = B.reshape(len(B), 6, -1, d)[:, 1, :, 0]
        result[:, :, 0, :, 0] += sigma[1] * hoop[:, :, None] * hoop[:, None]
    return np.asarray(result.reshape(len(result), item.shape[1] * d, -1))


def compute_node_shares(
    solid: Solid, *, facets: np.ndarray | None = None, elements: np.ndarray | None = None
) -> np.ndarray:
    """Return the fraction of the area or volume that belongs to each node.

    The fraction is ``int N / int 1``. The returned array has the shape (nodes,). N is the shape
    function of a node, and the integrals cover the given ``facets`` or ``elements``. In
    axisymmetric solids, the integrals cover the full revolution. In meshes of lines, the
    cross-section is assumed to be constant.
    """
    basis = (
        solid.make_facet_basis(facets, 4)
        if facets is not None
        else solid.basis(4, elements=elements)
    )
    form = skfem.LinearForm(lambda v, w: v * w.x[0] if solid.axisymmetric else v)
    shares = form.assemble(basis)
    return np.asarray(shares / shares.sum())


def compute_volume_gradient(solid: Solid, facets: np.ndarray) -> np.ndarray:
    """Return the volume displaced by boundary facets per displacement of each node.

    The returned array ``int N n dS`` [m^2] has the shape (d * nodes,), with d components per node.
    N are the shape functions, and n is the outward normal. In axisymmetric solids, the integrals
    cover the full revolution.
    """
    basis = solid.make_facet_basis(facets, FACE_QUADRATURE)
    radius = np.asarray(basis.global_coordinates())[0]
    around = 2 * np.pi * radius if solid.axisymmetric else np.ones_like(radius)
    form = skfem.LinearForm(lambda v, w: v * w.weight)
    columns = [form.assemble(basis, weight=around * normal) for normal in basis.normals]
    return np.stack(columns, axis=-1).ravel()


def compute_area(solid: Solid, facets: np.ndarray) -> float:
    """Return the area [m^2] of boundary facets.

    In axisymmetric solids, the area covers the full revolution.
    """
    basis = solid.make_facet_basis(facets, FACE_QUADRATURE)
    around = 2 * np.pi * basis.global_coordinates()[0] if solid.axisymmetric else 1.0
    return float((basis.dx * around).sum())


def sum_matrices(
    parts: Sequence[tuple[np.ndarray, ...]], shape: tuple[int, int]
) -> sparse.csc_array:
    """Assemble element matrices to one sparse matrix.

    Each item of ``parts`` consists of three arrays: element matrices of shape (elements, l, k),
    their row numbers of shape (elements, l), and their column numbers of shape (elements, k).
    """
    total = sparse.csc_array(shape)
    for values, rows, columns in parts:
        i = np.broadcast_to(rows[:, :, None], values.shape).ravel()
        j = np.broadcast_to(columns[:, None, :], values.shape).ravel()
        total = total + sparse.csc_array(sparse.coo_array((values.ravel(), (i, j)), shape=shape))
    return total


def symmetrise(matrix: sparse.csc_array) -> sparse.csc_array:
    """Return the symmetric part of a matrix, without asymmetric rounding errors."""
    return sparse.csc_array((matrix + matrix.T) * 0.5)
