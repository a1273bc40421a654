"""Piezoelectric solids on any mesh of scikit-fem.

The elements are tetrahedra, hexahedra, or axisymmetric triangles and quadrilaterals.

Weak form of ``rho u'' = div T``, ``div D = 0`` with ``T = C S - e' E``, ``D = e S + eps E`` and
``E = -grad phi``, for a displacement u and a potential phi on the nodes of one scalar element:

    M    = int rho v u          K_uu = int S(v)' C S(u)
    K_up = int S(v)' e' grad phi          K_pp = int grad psi' eps grad phi

Displacement unknowns are numbered ``d node + axis`` with d components (3; of an axisymmetric
mesh r and z), potentials by node. Strains are in Voigt order xx yy zz yz xz xy, engineering
shear; of an axisymmetric body x is radial, y the hoop direction, and volumes cover the full turn.
Source: IEEE Std 176-1987; R. Lerch, IEEE Trans. UFFC 37 (1990) 233.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import skfem
from scipy import sparse
from skfem.mapping import MappingIsoparametric
from skfem.mesh import Mesh, MeshHex, MeshLine, MeshQuad, MeshTet

from kc2spice.core.errors import wrong
from kc2spice.fem.materials import ElementAxes, Material

FACE_QUADRATURE = 5  # order of integration: exact for a quadratic function times the radius
CHUNK_SIZE = 4000  # elements processed together, which limits the memory of the element matrices
# Voigt row of the derivative of component i with respect to coordinate j.
VOIGT_ROWS = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
# Coordinates of a mesh among x, y and z, by its dimension: a height, a meridian plane, space.
_COORDINATE_AXES = {1: np.array([2]), 2: np.array([0, 2]), 3: np.arange(3)}


# Largest change of all local coordinates in the last Newton step in elements that are so thin that
# rounding of global coordinates exceeds the default; the convergence is quadratic.
THIN_ELEMENT_TOLERANCE = 1e-8


class FacetMapping(MappingIsoparametric):
    """Mapping of elements, whose inverse also converges in elements a micrometre thin."""

    def invF(self, x: np.ndarray, tind: Any = None, **options: Any) -> np.ndarray:
        """Return local coordinates of points."""
        try:
            return np.asarray(super().invF(x, tind, **options))
        except Exception:  # skfem raises no narrower class
            options["newton_tol"] = THIN_ELEMENT_TOLERANCE
            return np.asarray(super().invF(x, tind, **options))


@dataclass(frozen=True, eq=False)
class Solid:
    """Mesh whose element ``k`` consists of ``materials[owner[k]]``, already poled.

    The shape functions have the ``order`` (1 on hexahedra only). Materials with the same name are
    one material in reports. ``numbers`` (l, elements) are the node numbers of each element if they
    differ from scikit-fem: nodes of collapsed edges and faces share a number.

    Raises
    ------
    UsageError : an element is turned inside out, or an axisymmetric mesh crosses the axis.
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
            expected = "Jacobian determinants of one sign"
            problem = "some elements have a negative volume"
            hint = "repair or refine the mesh"
            raise wrong("mesh", problem, f"{flipped.sum()} of them", expected, hint)
        for material in self.materials if self.axisymmetric else ():
            if material.local_axes is not None and material.couples_planes:
                problem = "this material twists an axisymmetric body under a voltage"
                hint = 'use a mesh in three dimensions (part = "body" without axisymmetric)'
                raise wrong(None, problem, material.name, "a poling in the plane of the mesh", hint)
            if material.local_axes is None and not material.isotropic_about_z:
                problem = "an axisymmetric body needs materials that are isotropic about its axis"
                hint = 'use a mesh in three dimensions (part = "body"), or give the average in the '
                hint += 'plane; poling = { GROUP = "radial" } is that of a ring poled radially'
                raise wrong(None, problem, material.name, hint=hint)
        if self.axisymmetric and self.mesh.p[0].min() < -1e-9 * np.ptp(self.mesh.p):
            problem = "the axisymmetric mesh crosses the axis"
            got = f"x = {self.mesh.p[0].min():g} m"
            raise wrong("mesh", problem, got, "x (the radius) of at least 0")

    @property
    def components(self) -> int:
        """Components of the displacement."""
        return self.mesh.dim()

    @property
    def axes(self) -> np.ndarray:
        """Coordinates of the mesh among x, y and z."""
        return _COORDINATE_AXES[self.mesh.dim()]

    @property
    def element(self) -> Any:
        """The scalar element of the mesh."""
        mesh = self.mesh
        if isinstance(mesh, MeshHex):
            return skfem.ElementHex1() if self.order == 1 else skfem.ElementHex2()
        if isinstance(mesh, MeshTet):
            return skfem.ElementTetP2()
        if isinstance(mesh, MeshLine):
            return skfem.ElementLineP2()
        return skfem.ElementQuad2() if isinstance(mesh, MeshQuad) else skfem.ElementTriP2()

    @property
    def quadrature(self) -> int:
        """Order of integration: exact for the mass of a straight quadratic tetrahedron."""
        return 2 * self.order

    def basis(self, order: int | None = None, **options: Any) -> skfem.Basis:
        """Scalar finite-element basis; this package calls its degrees of freedom nodes."""
        if "quadrature" not in options:
            options["intorder"] = order or self.quadrature
        return skfem.Basis(self.mesh, self.element, dofs=self._nodes, **options)

    def facet_basis(
        self, facets: np.ndarray, order: int, side: Literal[0, 1] = 0
    ) -> skfem.BoundaryFacetBasis:
        """Return the scalar basis on facets, seen from the element on one ``side``."""
        options: dict[str, Any] = {"facets": facets, "intorder": order, "dofs": self._nodes}
        if not self.mesh.affine:
            options["mapping"] = FacetMapping(self.mesh, self.mesh.elem(), self.mesh.bndelem)
        if side:
            return skfem.InteriorFacetBasis(self.mesh, self.element, side=side, **options)
        return skfem.BoundaryFacetBasis(self.mesh, self.element, **options)

    @cached_property
    def places(self) -> np.ndarray:
        """(d, nodes) positions [m] of the nodes."""
        return np.asarray(self.basis(1).doflocs)

    @cached_property
    def _nodes(self) -> skfem.Dofs | None:
        if self.numbers is None:
            return None
        result = skfem.Dofs(self.mesh, self.element)
        result.element_dofs, result.N = self.numbers, int(self.numbers.max()) + 1
        return result

    def nodes(self, elements: np.ndarray) -> np.ndarray:
        """Numbers of the nodes of some elements."""
        return np.unique(self.basis(1).element_dofs[:, elements])


@dataclass(frozen=True, eq=False)
class Operators:
    """Matrices over all nodes of a solid, without constraints; see the module."""

    M: sparse.csc_array
    K_uu: sparse.csc_array
    K_up: sparse.csc_array
    K_pp: sparse.csc_array


def list_strain_operators(
    solid: Solid, basis: skfem.Basis
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield values and strain operators at each point of ``basis``.

    The yielded arrays are the values N (elements, l), the strain operator B (elements, 6, l d) and
    the gradient G (elements, 3, l) of the l local shape functions.
    """
    local = [function[0] for function in basis.basis]
    d, axes = solid.components, solid.axes
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
            axis = r < 1e-9 * np.ptp(solid.mesh.p)  # on the axis, u_r / r is the derivative
            B[:, 1, :, 0] = np.where(axis, slope[0], value / np.where(axis, 1.0, r))
        yield value, B.reshape(len(B), 6, -1), G


def list_tensors(
    solid: Solid, basis: skfem.Basis, material: Material
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield stiffness, coupling and permittivity at each point of ``basis``.

    The tensors of the ``material`` are in the axes of the solid, (elements or 1, …). The axes of an
    axisymmetric solid are cylindrical.
    """
    places = np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1)
    elements = np.arange(len(places)) if basis.tind is None else basis.tind
    by_element = isinstance(material.local_axes, ElementAxes)
    for q in range(places.shape[1]):
        if solid.axisymmetric and not by_element:
            yield material.C[None], material.e[None], material.eps_S[None]
        else:
            yield material.at(places[:, q], elements)


def _split_chunks(solid: Solid, only: int | None) -> Iterator[tuple[Material, np.ndarray]]:
    """Yield materials with at most ``CHUNK_SIZE`` of their elements.

    ``only`` selects one material.
    """
    for number, material in enumerate(solid.materials):
        cells = np.flatnonzero(solid.owner == number)
        if only in (None, number):
            for start in range(0, len(cells), CHUNK_SIZE):
                yield material, cells[start : start + CHUNK_SIZE]


def assemble_solid(solid: Solid, *, only: int | None = None) -> Operators:
    """Assemble the matrices of a solid.

    Coupling and permittivity are those of piezoelectric or dielectric materials.

    With ``only``, the matrices of only this material are assembled.
    """
    d = solid.components
    parts: list[list[tuple[np.ndarray, ...]]] = [[], [], [], []]
    for material, cells in _split_chunks(solid, only):
        field = material.piezoelectric or material.dielectric
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
                k = k + w * _stress_stiffness(solid, material, N, B, G)
            if field:
                c = c + w * (B.transpose(0, 2, 1) @ (e.transpose(0, 2, 1) @ G))
                p = p + w * (G.transpose(0, 2, 1) @ (eps @ G))
        parts[0].append((m, nodes, nodes))
        parts[1].append((k, moves, moves))
        if field:
            parts[2].append((c, moves, nodes))
            parts[3].append((p, nodes, nodes))
    n = solid.places.shape[1]
    shapes = ((n, n), (d * n, d * n), (d * n, n), (n, n))
    m, K_uu, K_up, K_pp = (sum_matrices(p, s) for p, s in zip(parts, shapes, strict=True))
    M = sparse.csc_array(sparse.kron(symmetrise(m), np.eye(d)))
    return Operators(M, symmetrise(K_uu), K_up, symmetrise(K_pp))


def _stress_stiffness(
    solid: Solid, material: Material, N: np.ndarray, B: np.ndarray, G: np.ndarray
) -> np.ndarray:
    """Return the stiffness (elements, l d, l d) due to prestress: ``grad v . sigma0 grad u``.

    The same matrix applies to each component. Rotation of the hoop direction adds ``sigma0_y v_r
    u_r / r^2``.
    """
    d, sigma = solid.components, np.array(material.residual_stress)
    item = G.transpose(0, 2, 1) @ (sigma[:, None] * G)
    result = np.einsum("eab,ij->eaibj", item, np.eye(d))
    if solid.axisymmetric:
        hoop = B.reshape(len(B), 6, -1, d)[:, 1, :, 0]
        result[:, :, 0, :, 0] += sigma[1] * hoop[:, :, None] * hoop[:, None]
    return np.asarray(result.reshape(len(result), item.shape[1] * d, -1))


def compute_node_shares(
    solid: Solid, *, facets: np.ndarray | None = None, elements: np.ndarray | None = None
) -> np.ndarray:
    """Shares of nodes ``int N / int 1`` (nodes,) over facets or elements.

    The integrals of a body of revolution are over the full turn. The cross-section of a line is
    constant over the facets or elements.
    """
    basis = (
        solid.facet_basis(facets, 4) if facets is not None else solid.basis(4, elements=elements)
    )
    form = skfem.LinearForm(lambda v, w: v * w.x[0] if solid.axisymmetric else v)
    shares = form.assemble(basis)
    return np.asarray(shares / shares.sum())


def compute_displaced_volume(solid: Solid, facets: np.ndarray) -> np.ndarray:
    """Volume that a boundary displaces per displacement: ``int N n dS`` (d nodes,) [m^2].

    n is the outward normal. The integrals of a body of revolution are over the full turn.
    """
    basis = solid.facet_basis(facets, FACE_QUADRATURE)
    radius = np.asarray(basis.global_coordinates())[0]
    around = 2 * np.pi * radius if solid.axisymmetric else np.ones_like(radius)
    form = skfem.LinearForm(lambda v, w: v * w.weight)
    columns = [form.assemble(basis, weight=around * normal) for normal in basis.normals]
    return np.stack(columns, axis=-1).ravel()


def compute_area(solid: Solid, facets: np.ndarray) -> float:
    """Area of a boundary [m^2]; that of a body of revolution is the area of the full turn."""
    basis = solid.facet_basis(facets, FACE_QUADRATURE)
    around = 2 * np.pi * basis.global_coordinates()[0] if solid.axisymmetric else 1.0
    return float((basis.dx * around).sum())


def sum_matrices(
    parts: Sequence[tuple[np.ndarray, ...]], shape: tuple[int, int]
) -> sparse.csc_array:
    """Sum element matrices (elements, l, k), each with the numbers of its rows and columns."""
    total = sparse.csc_array(shape)
    for values, rows, columns in parts:
        i = np.broadcast_to(rows[:, :, None], values.shape).ravel()
        j = np.broadcast_to(columns[:, None, :], values.shape).ravel()
        total = total + sparse.csc_array(sparse.coo_array((values.ravel(), (i, j)), shape=shape))
    return total


def symmetrise(matrix: sparse.csc_array) -> sparse.csc_array:
    """Remove the last-digit asymmetry of sums."""
    return sparse.csc_array((matrix + matrix.T) * 0.5)
