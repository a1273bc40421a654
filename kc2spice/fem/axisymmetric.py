"""Axisymmetric piezoelectric finite elements in (r, z): rectangles of material, biquadratic quads.

Displacements u_r, u_z and potential phi on nine-node quadrilaterals of one tensor grid, so that
blocks that touch are bonded. With strains ``S = (du_r/dr, u_r/r, du_z/dz, du_r/dz + du_z/dr)``
of the Voigt components rr, tt, zz, rz and the measure 2 pi r dr dz,

    K_uu = int S' C S,   K_up = int S' e' grad phi,   K_pp = int grad phi' eps grad phi.

The potential lives in piezoelectric blocks only; conductors and electrodes are equipotentials,
other insulators carry no field. Source: T. Ikeda, Fundamentals of Piezoelectricity, Oxford 1990;
Allik and Hughes, Int. J. Numer. Methods Eng. 2 (1970) 151.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy import sparse
from skfem import Basis, BilinearForm, ElementQuad2, ElementVector, LinearForm, MeshQuad

from kc2spice.core.errors import UsageError
from kc2spice.fem.materials import Material
from kc2spice.fem.potentials import PiezoOperators

_ACTIVE = [0, 1, 2, 4]  # rr tt zz rz of Voigt order; tz and rt vanish without torsion
_IN_PLANE = [0, 2]  # r and z of a vector
_QUADRATURE = 5  # exact for the biquadratic mass times r


@dataclass(frozen=True)
class Block:
    """A ring (or disc) of material, already poled: radii and heights [m]."""

    r: tuple[float, float]
    z: tuple[float, float]
    material: Material


@dataclass(frozen=True)
class Face:
    """A flat annulus at height ``z`` between two radii [m]."""

    r: tuple[float, float]
    z: float


@dataclass(frozen=True)
class Electrode:
    """One equipotential: a ``terminal`` is an input, the ``ground`` zero, ``floating`` is free."""

    name: str
    faces: tuple[Face, ...]
    kind: Literal["terminal", "ground", "floating"] = "terminal"


@dataclass(frozen=True)
class Fixed:
    """Unknowns of one direction that a support holds, in a box of radii and heights [m]."""

    direction: Literal["r", "z"]
    r: tuple[float, float]
    z: tuple[float, float]


@dataclass(frozen=True)
class Grid:
    """Cells along each axis between all edges that must be resolved."""

    r: np.ndarray
    z: np.ndarray

    @property
    def tolerance(self) -> float:
        """Length [m] below which two coordinates are the same."""
        return 1e-3 * float(min(np.diff(self.r).min(), np.diff(self.z).min()))


def assemble(
    blocks: Sequence[Block],
    electrodes: Sequence[Electrode] = (),
    supports: Sequence[Fixed] = (),
    ports: Sequence[Face] = (),
    *,
    size: float,
    refine: int = 1,
) -> PiezoOperators:
    """Operators of the bonded blocks; ``size`` [m] bounds the cells, ``refine`` divides them.

    A port is the mean axial displacement of a face, whose force is spread evenly over it.

    Raises
    ------
    UsageError : a material that is not isotropic about z, an electrode, support or port that
        touches nothing.
    """
    grid = _grid(blocks, electrodes, supports, ports, size, refine)
    mesh, owner = _mesh(blocks, grid)
    fields = _Fields(mesh, owner, blocks)
    free = _unsupported(fields.displacement, supports, grid.tolerance)
    parts = [part[free][:, free].tocsc() for part in fields.stiffness()]
    mass_matrix = fields.mass()
    tie_free, tie_terminal, names = _ties(fields, electrodes, grid.tolerance)
    coupling, permittivity = fields.coupling()[free], fields.permittivity()
    dense = tie_terminal.toarray()
    return PiezoOperators(
        M=mass_matrix[free][:, free].tocsc(),
        K_uu=sum(parts[1:], parts[0]),
        K_up=(coupling @ tie_free).tocsc(),
        K_pp=(tie_free.T @ permittivity @ tie_free).tocsc(),
        k_uV=coupling @ dense,
        k_pV=tie_free.T @ (permittivity @ dense),
        c_VV=dense.T @ (permittivity @ dense),
        electrodes=names,
        B=_port_shapes(fields, ports, grid.tolerance)[free],
        parts=parts,
        mass=fields.volume_integral([block.material.density for block in blocks]),
        points=fields.points()[free],
        potential_points=_places(fields, tie_free),
    )


def _grid(
    blocks: Sequence[Block],
    electrodes: Sequence[Electrode],
    supports: Sequence[Fixed],
    ports: Sequence[Face],
    size: float,
    refine: int,
) -> Grid:
    faces = [*ports, *(face for electrode in electrodes for face in electrode.faces)]
    r = [x for spans in (blocks, faces, supports) for item in spans for x in item.r]
    z = [x for spans in (blocks, supports) for item in spans for x in item.z]
    return Grid(_divide(r, size, refine), _divide(z, size, refine))


def _divide(edges: Sequence[float], size: float, refine: int) -> np.ndarray:
    """All edges, and equal cells of at most ``size`` between them, each cut into ``refine``."""
    points = np.unique(np.array(edges))
    kept = np.concatenate([[True], np.diff(points) > 1e-9 * np.ptp(points)])
    points = points[kept]
    pieces = []
    for a, b in pairwise(points):
        count = refine * max(1, int(np.ceil((b - a) / size - 1e-9)))
        pieces.append(np.linspace(a, b, count + 1)[:-1])
    return np.concatenate([*pieces, points[-1:]])


def _mesh(blocks: Sequence[Block], grid: Grid) -> tuple[MeshQuad, np.ndarray]:
    """Quads of the cells that some block owns, and the owner of each; the later block wins."""
    nr, nz = len(grid.r) - 1, len(grid.z) - 1
    r = (grid.r[1:] + grid.r[:-1]) / 2
    z = (grid.z[1:] + grid.z[:-1]) / 2
    owner = np.full((nr, nz), -1)
    for number, block in enumerate(blocks):
        inside = np.outer((r > block.r[0]) & (r < block.r[1]), (z > block.z[0]) & (z < block.z[1]))
        owner[inside] = number
    i, j = np.nonzero(owner >= 0)
    corner = i * (nz + 1) + j
    t = np.array([corner, corner + nz + 1, corner + nz + 2, corner + 1])
    p = np.array([np.repeat(grid.r, nz + 1), np.tile(grid.z, nr + 1)])
    used, t = np.unique(t, return_inverse=True)
    return MeshQuad(np.ascontiguousarray(p[:, used]), t.reshape(4, -1)), owner[i, j]


def _strain(u, r: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    """(4, …) strains rr, tt, zz, rz of a discrete field."""
    du = u.grad
    return np.array([du[0, 0], u[0] / r, du[1, 1], du[0, 1] + du[1, 0]])


class _Fields:
    """Bases of displacement and potential on a mesh, and the integrals over them."""

    def __init__(self, mesh: MeshQuad, owner: np.ndarray, blocks: Sequence[Block]) -> None:
        self.mesh, self.owner, self.blocks = mesh, owner, blocks
        vector, scalar = ElementVector(ElementQuad2()), ElementQuad2()
        self.displacement = Basis(mesh, vector, intorder=_QUADRATURE)
        self.potential = Basis(mesh, scalar, intorder=_QUADRATURE)
        self._pieces = []
        for number, block in enumerate(blocks):
            _require_axisymmetric(block.material)
            cells = np.flatnonzero(owner == number)
            if len(cells) == 0:
                raise UsageError("a block of no volume", got=f"r = {block.r}, z = {block.z}")
            u = Basis(mesh, vector, elements=cells, intorder=_QUADRATURE)
            p = Basis(mesh, scalar, elements=cells, intorder=_QUADRATURE)
            self._pieces.append((block.material, cells, u, p))

    def stiffness(self) -> list[sparse.csc_array]:
        """Stiffness at zero field, by block."""
        return [sparse.csc_array(_stiffness_form(m).assemble(u)) for m, _, u, _ in self._pieces]

    def mass(self) -> sparse.csc_array:
        """Consistent mass matrix."""
        total = sparse.csc_array((self.displacement.N,) * 2)
        for material, _, u, _ in self._pieces:
            total = total + _mass_form(material.density).assemble(u)
        return total.tocsc()

    def coupling(self) -> sparse.csc_array:
        """``int S' e' grad phi`` over the piezoelectric blocks."""
        total = sparse.csc_array((self.displacement.N, self.potential.N))
        for material, _, u, p in self._pieces:
            if material.piezoelectric:
                total = total + _coupling_form(material).assemble(p, u)
        return total.tocsc()

    def permittivity(self) -> sparse.csc_array:
        """``int grad phi' eps grad phi`` over the piezoelectric blocks."""
        total = sparse.csc_array((self.potential.N, self.potential.N))
        for material, _, _, p in self._pieces:
            if material.piezoelectric:
                total = total + _permittivity_form(material).assemble(p)
        return total.tocsc()

    def potential_unknowns(self) -> np.ndarray:
        """Numbers of the nodes that carry a potential."""
        dofs = [
            self.potential.element_dofs[:, cells].ravel()
            for material, cells, _, _ in self._pieces
            if material.piezoelectric
        ]
        return np.unique(np.concatenate(dofs)) if dofs else np.empty(0, int)

    def volume_integral(self, values: Sequence[float]) -> float:
        """Sum of a constant of each block over its volume."""
        return float(
            sum(
                value * _axial_load.assemble(u).sum()
                for value, (_, _, u, _) in zip(values, self._pieces, strict=True)
            )
        )

    def points(self) -> np.ndarray:
        """(n, 3) place and direction of every displacement unknown."""
        place = np.empty((self.displacement.N, 3))
        place[:, :2] = self.displacement.doflocs.T
        for direction in (0, 1):
            place[_dofs(self.displacement, direction), 2] = direction
        return place


def _stiffness_form(material: Material) -> BilinearForm:
    C = material.C[np.ix_(_ACTIVE, _ACTIVE)]

    def form(u, v, w):  # type: ignore[no-untyped-def]
        r = w.x[0]
        return 2 * np.pi * r * np.einsum("i...,ij,j...", _strain(v, r), C, _strain(u, r))

    return BilinearForm(form)


def _mass_form(density: float) -> BilinearForm:
    def form(u, v, w):  # type: ignore[no-untyped-def]
        product = u[0] * v[0] + u[1] * v[1]
        return 2 * np.pi * w.x[0] * density * product

    return BilinearForm(form)


def _coupling_form(material: Material) -> BilinearForm:
    e = material.e[np.ix_(_IN_PLANE, _ACTIVE)]

    def form(p, v, w):  # type: ignore[no-untyped-def]
        r = w.x[0]
        return 2 * np.pi * r * np.einsum("i...,ij,j...", p.grad, e, _strain(v, r))

    return BilinearForm(form)


def _permittivity_form(material: Material) -> BilinearForm:
    eps = material.eps_S[np.ix_(_IN_PLANE, _IN_PLANE)]

    def form(p, q, w):  # type: ignore[no-untyped-def]
        return 2 * np.pi * w.x[0] * np.einsum("i...,ij,j...", q.grad, eps, p.grad)

    return BilinearForm(form)


@LinearForm
def _axial_load(v, w):  # type: ignore[no-untyped-def]
    """A unit load along z per volume or area; its sum over all unknowns is that volume or area."""
    return 2 * np.pi * w.x[0] * v[1]


def _require_axisymmetric(material: Material) -> None:
    """Isotropic about z: nothing changes when it is turned by 30 or 45 degrees."""
    for angle in (np.pi / 6, np.pi / 4):
        c, s = np.cos(angle), np.sin(angle)
        turned = material.rotated(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]))
        pairs = [(material.C, turned.C), (material.e, turned.e), (material.eps_S, turned.eps_S)]
        if any(not np.allclose(a, b, rtol=0, atol=0.02 * np.abs(a).max()) for a, b in pairs):
            raise UsageError(
                "an axisymmetric body needs materials that are isotropic about its axis",
                got=material.name,
                hint='use a mesh (part = "body"), or give the material\'s average in the plane',
            )


def _dofs(basis: Basis, direction: int) -> np.ndarray:
    return np.concatenate(
        [
            basis.nodal_dofs[direction],
            basis.facet_dofs[direction],
            basis.interior_dofs[direction],
        ]
    )


def _unsupported(basis: Basis, supports: Sequence[Fixed], tolerance: float) -> np.ndarray:
    """Unknowns that neither the axis (u_r = 0) nor a support holds."""
    held = [_dofs(basis, 0)[basis.doflocs[0, _dofs(basis, 0)] < tolerance]]
    for support in supports:
        dofs = _dofs(basis, "rz".index(support.direction))
        r, z = basis.doflocs[:, dofs]
        inside = (r > support.r[0] - tolerance) & (r < support.r[1] + tolerance)
        inside &= (z > support.z[0] - tolerance) & (z < support.z[1] + tolerance)
        if not inside.any():
            raise UsageError("a support touches nothing", got=repr(support))
        held.append(dofs[inside])
    return np.setdiff1d(np.arange(basis.N), np.concatenate(held))


def _on(face: Face, places: np.ndarray, tolerance: float) -> np.ndarray:
    r, z = places
    inside = (r > face.r[0] - tolerance) & (r < face.r[1] + tolerance)
    return inside & (np.abs(z - face.z) < tolerance)


def _ties(
    fields: _Fields, electrodes: Sequence[Electrode], tolerance: float
) -> tuple[sparse.csc_array, sparse.csc_array, tuple[str, ...]]:
    """Nodal potentials from free ones and from terminal voltages: ``phi = F p + T V``.

    Every node of an electrode has the electrode's potential; nodes of no piezoelectric block have
    none, their rows are zero.
    """
    alive = fields.potential_unknowns()
    owner = np.full(fields.potential.N, -1)
    places = fields.potential.doflocs[:, alive]
    for number, electrode in enumerate(electrodes):
        nodes = alive[np.any([_on(face, places, tolerance) for face in electrode.faces], axis=0)]
        if len(nodes) == 0:
            raise UsageError("an electrode touches no piezoelectric layer", got=electrode.name)
        taken = owner[nodes]
        if np.any((taken >= 0) & (taken != number)):
            other = electrodes[int(taken[taken >= 0][0])].name
            raise UsageError("two electrodes touch", got=f"{electrode.name} and {other}")
        owner[nodes] = number
    columns = [alive[owner[alive] < 0][:, None]]
    free_nodes = columns[0].ravel()
    rows, cols = [free_nodes], [np.arange(len(free_nodes))]
    count = len(free_nodes)
    terminal_rows: list[np.ndarray] = []
    names: list[str] = []
    for number, electrode in enumerate(electrodes):
        nodes = np.flatnonzero(owner == number)
        if electrode.kind == "floating":
            rows.append(nodes)
            cols.append(np.full(len(nodes), count))
            count += 1
        elif electrode.kind == "terminal":
            terminal_rows.append(nodes)
            names.append(electrode.name)
    free = _selection(np.concatenate(rows), np.concatenate(cols), (len(owner), count))
    which = [np.full(len(nodes), k) for k, nodes in enumerate(terminal_rows)]
    terminal = _selection(
        np.concatenate([np.empty(0, int), *terminal_rows]),
        np.concatenate([np.empty(0, int), *which]),
        (len(owner), len(names)),
    )
    return free, terminal, tuple(names)


def _places(fields: _Fields, tie_free: sparse.csc_array) -> np.ndarray:
    """Where each free potential sits; a floating electrode is in many places, so in none."""
    places = np.full((tie_free.shape[1], 2), np.nan)
    nodes = np.diff(tie_free.indptr)
    single = nodes == 1
    places[single] = fields.potential.doflocs.T[tie_free.indices[tie_free.indptr[:-1][single]]]
    return places


def _selection(rows: np.ndarray, cols: np.ndarray, shape: tuple[int, int]) -> sparse.csc_array:
    return sparse.csc_array((np.ones(len(rows)), (rows, cols)), shape=shape)


def _port_shapes(fields: _Fields, ports: Sequence[Face], tolerance: float) -> np.ndarray:
    """(n, ports) consistent loads of unit axial forces spread evenly over the faces."""
    shapes = np.zeros((fields.displacement.N, len(ports)))
    mesh = fields.mesh
    middle = mesh.p[:, mesh.facets].mean(axis=1)
    ends = np.abs(np.diff(mesh.p[1][mesh.facets], axis=0)[0])
    for column, face in enumerate(ports):
        facets = np.flatnonzero(_on(face, middle, tolerance) & (ends < tolerance))
        if len(facets) == 0:
            raise UsageError("a port touches nothing", got=repr(face))
        basis = fields.displacement.boundary(facets)
        load = _axial_load.assemble(basis)
        shapes[:, column] = load / load.sum()
    return shapes
