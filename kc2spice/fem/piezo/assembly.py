"""Piezoelectric FE model of the kick actuator: paper 2.2.2 and appendix A.2, equations 1 and 2."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from skfem import Basis, BilinearForm, ElementVector, FacetBasis, LinearForm

from kc2spice.core.errors import UsageError
from kc2spice.fem.materials import bond
from kc2spice.fem.materials import material as elastic_material
from kc2spice.fem.piezo.keys import Chip, Material
from kc2spice.fem.piezo.memory import require_memory
from kc2spice.fem.piezo.mesh import KickMesh, Slab, kick_mesh
from kc2spice.fem.piezo.system import PiezoSystem
from kc2spice.rom.linear import Port

QUARTERS = 4
FREE_SHIFT = 1e-3
_AXES = 3
_FINE = 8  # of a quadrature that meets the corners of a pressure anywhere in a cell


@dataclass(frozen=True)
class PiezoMaterial:
    """Constants of the stress-charge form ``T = C S - e' E``, ``D = e S + eps E``, poled along +z.

    ``C`` (6, 6) [Pa] at constant field, ``e`` (3, 6) [C/m^2], ``eps`` (3, 3) [F/m] at constant
    *strain*; Voigt order xx yy zz yz xz xy with engineering shear. ``density`` [kg/m^3].
    """

    C: np.ndarray
    e: np.ndarray
    eps: np.ndarray
    density: float


def piezo_material(material: Material) -> PiezoMaterial:
    """Voigt matrices of a ceramic (6mm) and its permittivity at constant strain.

    Data sheets give eps^T, at constant stress; the stress-charge form needs
    ``eps^S = eps^T - e C^-1 e'`` (IEEE Std 176).

    Raises
    ------
    UsageError : stiffness or eps^S is not positive definite, so no such material exists.
    """
    C, e, eps = material.tensors()
    _require_definite(C, "kick.material.stiffness")
    if material.permittivity_at == "stress":
        eps = eps - e @ np.linalg.solve(C, e.T)
    _require_definite(eps, "kick.material.permittivity")
    return PiezoMaterial(C, e, eps, material.density)


def _require_definite(matrix: np.ndarray, where: str) -> None:
    smallest = np.linalg.eigvalsh(matrix)[0]
    if smallest <= 0:
        raise UsageError(
            "no such material: not positive definite",
            where=where,
            got=f"smallest eigenvalue {smallest:g}",
            expected="greater than 0",
            hint="is the permittivity at constant stress or strain (permittivity_at)?",
        )


def assemble_kick(kick: Chip, mesh: KickMesh | None = None) -> PiezoSystem:
    """FE model of the quarter chip with ring ports ring0, ring1, ... and the anode, voltage driven.

    Boundary conditions: u_x = 0 on x = 0 and u_y = 0 on y = 0. On the bottom face z = 0, by
    ``kick.mounting``: u_z = 0 on a frictionless ``roller``, u = 0 where ``glued``, nothing where
    ``free``, or springs against all three axes, each ``mounting`` N/m per m^2. A stack poled along
    x moves antisymmetrically in x: u_y = u_z = 0 on x = 0 instead. Even electrode planes are the
    grounded cathode, odd ones the anode. Free potentials exist only where a plane of nodes lies
    inside an active layer. ``mesh`` is that of ``kick``, made here if not given.

    Raises
    ------
    UsageError : rings beyond the chip, odd sector count, impossible material, too many unknowns
        for the memory.
    """
    require_memory(kick)
    mesh = kick_mesh(kick) if mesh is None else mesh
    M, K_uu, K_uphi, K_phi = assemble_matrices(
        mesh, poled(piezo_material(kick.material), kick.poling), *cap_materials(kick)
    )
    if isinstance(kick.mounting, float):
        K_uu = _symmetric(K_uu + kick.mounting * bottom_face(mesh))
    if kick.preload_spring is not None:
        face = top_face(mesh)
        K_uu = _symmetric(K_uu + kick.preload_spring / QUARTERS / face.sum() * face)
    free = free_displacements(mesh, kick)
    anode, inner = electrodes(mesh)
    K_up, k_uV = K_uphi[free][:, inner], K_uphi[free] @ anode
    K_pp, k_pV = K_phi[inner][:, inner], K_phi[inner] @ anode
    rings = [Port(f"ring{i}", "mechanical") for i in range(len(mesh.rings))]
    return PiezoSystem(
        M=M[free][:, free],
        K_uu=K_uu[free][:, free],
        K_up=K_up,
        K_pp=K_pp,
        k_uV=k_uV,
        k_pV=k_pV,
        c_VV=float(anode @ K_phi @ anode),
        B=ring_shapes(mesh, kick.poling)[free],
        ports=(*rings, Port("anode", "electrical", pins=("anode", "cathode"))),
        alpha=kick.damping.alpha,
        beta=kick.damping.beta,
        sectors=QUARTERS,
        ring_radii=kick.mesh.ring_spacing * np.arange(len(mesh.rings)),
        mass=float(M.sum()) / _AXES,
        shift=_shift(kick) if kick.mounting == "free" else 0.0,
    )


def _shift(kick: Chip) -> float:
    """Square [rad^2/s^2] of a frequency far below the stack's own."""
    slowest = np.sqrt(min(kick.material.stiffness) / kick.material.density)
    return float((FREE_SHIFT * slowest / (kick.height + 2 * max(kick.half))) ** 2)


def poled(material: PiezoMaterial, axis: str) -> PiezoMaterial:
    """The ceramic with its poling along ``axis``."""
    if axis == "z":
        return material
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # z to x
    M = bond(turn)
    return PiezoMaterial(
        M @ material.C @ M.T, turn @ material.e @ M.T, turn @ material.eps @ turn.T,
        material.density,
    )  # fmt: skip


def cap_materials(kick: Chip) -> tuple[PiezoMaterial | None, PiezoMaterial | None]:
    """Elastic materials of the caps below and above."""
    own = piezo_material(kick.material)
    found: list[PiezoMaterial | None] = []
    for name, cap in (("bottom_cap", kick.bottom_cap), ("top_cap", kick.top_cap)):
        if cap is None:
            found.append(None)
        elif cap.material is None:
            found.append(replace(own, e=np.zeros((3, 6))))
        else:
            named = elastic_material(cap.material, f"kick.{name}.material")
            found.append(PiezoMaterial(named.C, np.zeros((3, 6)), named.eps_S, named.density))
    return found[0], found[1]


def assemble_matrices(
    mesh: KickMesh,
    material: PiezoMaterial,
    bottom: PiezoMaterial | None = None,
    top: PiezoMaterial | None = None,
) -> tuple[sparse.csc_array, sparse.csc_array, sparse.csc_array, sparse.csc_array]:
    """``M, K_uu, K_uphi, K_phi`` over all nodes, no constraint; displacement ``3 node + axis``.

    Equal levels differ only in the direction of polarisation, hence in the sign of the coupling:
    poled along -z above a cathode, so that a positive anode voltage lengthens every level.
    ``bottom`` and ``top`` are what the caps are made of.
    """
    potentials = mesh.node
    displacements = (_AXES * mesh.node[:, None] + np.arange(_AXES)).ravel()
    active, M, K_uu, K_uphi, K_phi = mesh.active, 0, 0, 0, 0
    for slab in active:
        scalar, vector = _bases(mesh, slab)
        level = (slab.first - active[0].first) // mesh.steps + np.arange(slab.count)
        poling, same = np.where(level % 2, 1.0, -1.0), np.ones(slab.count)
        coupling = _coupling(slab.span * material.e).assemble(scalar, vector)
        dielectric = _dielectric(slab.span**2 * material.eps).assemble(scalar)
        K_uphi = K_uphi + _sweep(coupling, mesh, slab, poling, displacements, potentials)
        K_phi = K_phi + _sweep(dielectric, mesh, slab, same, potentials, potentials)
    caps = ((mesh.bottom, bottom), (mesh.top, top))
    parts = [(slab, made_of) for slab, made_of in caps if slab and made_of]
    for slab, made_of in (*((slab, material) for slab in active), *parts):
        _, vector = _bases(mesh, slab)
        same = np.ones(slab.count)
        mass = _mass(made_of.density).assemble(vector)
        stiffness = _stiffness(made_of.C).assemble(vector)
        M = M + _sweep(mass, mesh, slab, same, displacements, displacements)
        K_uu = K_uu + _sweep(stiffness, mesh, slab, same, displacements, displacements)
    return _symmetric(M), _symmetric(K_uu), K_uphi, _symmetric(K_phi)


def _bases(mesh: KickMesh, slab: Slab) -> tuple[Basis, Basis]:
    scalar = Basis(slab.layer, mesh.element, intorder=2 * mesh.order + 1)
    _require_upright(scalar)
    return scalar, scalar.with_element(ElementVector(mesh.element))


def _require_upright(basis: Basis) -> None:
    """scikit-fem integrates with |det|, which would count a folded cell as volume."""
    determinant = basis.mapping.detDF(basis.X)
    if determinant.min() * determinant.max() <= 0:  # scikit-fem's boxes are left-handed
        raise UsageError(
            "mesh cells turned inside out",
            where="kick.mesh",
            got=f"Jacobian determinants {determinant.min():g} ... {determinant.max():g}",
            expected="one sign",
            hint="grade the mesh less: raise kick.mesh.outer_rings or kick.mesh.ring_spacing",
        )


def _sweep(
    layer: sparse.csr_matrix,
    mesh: KickMesh,
    slab: Slab,
    sign: np.ndarray,
    row_dofs: np.ndarray,
    col_dofs: np.ndarray,
) -> sparse.csc_array:
    """Sum of ``sign[l]`` times the matrix of one layer of the slab, moved up by ``l`` of them."""
    local = layer.tocoo()
    nodes, stride = len(mesh.plane) * len(mesh.heights), len(mesh.plane) * mesh.steps
    per_node = [dofs.size // mesh.node.size for dofs in (row_dofs, col_dofs)]
    index = [
        np.add.outer(
            n * (slab.first * len(mesh.plane) + stride * np.arange(slab.count)), dofs[entry]
        ).ravel()
        for n, dofs, entry in zip(
            per_node, (row_dofs, col_dofs), (local.row, local.col), strict=True
        )
    ]
    values = np.outer(sign, local.data).ravel()
    shape = (per_node[0] * nodes, per_node[1] * nodes)
    return sparse.csc_array(sparse.coo_array((values, tuple(index)), shape=shape))


def _symmetric(matrix: sparse.csc_array) -> sparse.csc_array:
    """Remove the last-digit asymmetry of quadrature sums."""
    return sparse.csc_array((matrix + matrix.T) * 0.5)


def _strain(gradient: np.ndarray) -> np.ndarray:
    """Engineering strain (6, ...) in the Voigt order of the material."""
    g = gradient
    return np.stack(
        [g[0, 0], g[1, 1], g[2, 2], g[1, 2] + g[2, 1], g[0, 2] + g[2, 0], g[0, 1] + g[1, 0]]
    )


def _pair(left: np.ndarray, matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """``left' matrix right`` at every quadrature point."""
    return np.sum(left * np.tensordot(matrix, right, axes=1), axis=0)


def _mass(density: float) -> BilinearForm:
    return BilinearForm(lambda u, v, _: density * np.sum(u * v, axis=0))


def _stiffness(C: np.ndarray) -> BilinearForm:
    return BilinearForm(lambda u, v, _: _pair(_strain(v.grad), C, _strain(u.grad)))


def _coupling(e: np.ndarray) -> BilinearForm:
    """``K_uphi = int S(v)' e' grad(phi)``: the stress of the field ``E = -grad(phi)``."""
    return BilinearForm(lambda phi, v, _: _pair(_strain(v.grad), e.T, phi.grad))


def _dielectric(eps: np.ndarray) -> BilinearForm:
    return BilinearForm(lambda phi, psi, _: _pair(psi.grad, eps, phi.grad))


def bottom_face(mesh: KickMesh) -> sparse.csc_array:
    """``int u . v dA`` over the bottom face, unknowns ``3 node + axis``; it sums to 3 areas."""
    return _face(mesh, mesh.bottom or mesh.active[0], np.ones(_AXES), upper=False)


def top_face(mesh: KickMesh) -> sparse.csc_array:
    """``int u_z v_z dA`` over the top face; it sums to the area."""
    return _face(mesh, mesh.top or mesh.active[-1], np.array([0.0, 0.0, 1.0]), upper=True)


def _face(mesh: KickMesh, slab: Slab, axes: np.ndarray, *, upper: bool) -> sparse.csc_array:
    """``int sum_i axes_i u_i v_i dA`` over the upper or lower face of a slab."""
    z = slab.layer.p[2]
    height = z.max() if upper else z.min()
    near = 1e-6 * np.ptp(z)
    plane = slab.first + (mesh.steps * (slab.count - 1) if upper else 0)
    facets = slab.layer.facets_satisfying(lambda x: np.abs(x[2] - height) < near)
    basis = FacetBasis(
        slab.layer, ElementVector(mesh.element), facets=facets, intorder=2 * mesh.order + 1
    )
    weight = axes[:, None, None]
    local = BilinearForm(lambda u, v, _: np.sum(weight * u * v, axis=0)).assemble(basis).tocoo()
    dofs = (_AXES * mesh.node[:, None] + np.arange(_AXES)).ravel()
    dofs = dofs + _AXES * plane * len(mesh.plane)
    size = _AXES * len(mesh.plane) * len(mesh.heights)
    entries = (local.data, (dofs[local.row], dofs[local.col]))
    return sparse.csc_array(sparse.coo_array(entries, shape=(size, size)))


def free_displacements(mesh: KickMesh, kick: Chip) -> np.ndarray:
    """Numbers ``3 node + axis`` of the unconstrained displacements, plane by plane."""
    tolerance = 1e-9 * mesh.heights[-1]
    x, y = np.abs(mesh.plane.T) < tolerance
    free = np.ones((len(mesh.heights), len(mesh.plane), _AXES), dtype=bool)
    for axis in (0,) if kick.poling == "z" else (1, 2):
        free[:, x, axis] = False
    free[:, y, 1] = False
    held = {"roller": (2,), "glued": (0, 1, 2)}.get(str(kick.mounting), ())
    for axis in held:
        free[0, :, axis] = False
    return np.flatnonzero(free)


def electrodes(mesh: KickMesh) -> tuple[np.ndarray, np.ndarray]:
    """Potentials (nodes,) that 1 V on the anode prescribes, and the numbers of the free ones: those
    within a layer. Within a level of several layers all follow from the electrodes between them."""
    steps, levels = mesh.steps, len(mesh.spans)
    plane = np.arange(len(mesh.heights)) - mesh.active[0].first
    live = (plane >= 0) & (plane <= steps * levels)
    span = mesh.spans[np.clip(plane // steps, 0, levels - 1)]
    free = live & (plane % steps != 0) & (span == 1)
    anode = np.where(live & ~free, 1 - np.abs(plane % (2 * steps) / steps - 1), 0.0)
    each = len(mesh.plane)
    return np.repeat(anode, each), np.flatnonzero(np.repeat(free, each))


def patch_shape(mesh: KickMesh, radii: np.ndarray, pressure: np.ndarray) -> np.ndarray:
    """(3 nodes,) shape of a unit axial force on the top, spread as ``pressure`` is: straight lines
    over ``radii`` [m], nothing beyond them."""
    slab = mesh.top or mesh.active[-1]
    z = slab.layer.p[2]
    facets = slab.layer.facets_satisfying(lambda x: np.abs(x[2] - z.max()) < 1e-6 * np.ptp(z))
    basis = FacetBasis(slab.layer, ElementVector(mesh.element), facets=facets, intorder=_FINE)

    def spread(v, w):  # type: ignore[no-untyped-def]
        return np.interp(np.hypot(w.x[0], w.x[1]), radii, pressure, right=0.0) * v[2]

    dofs = (_AXES * mesh.node[:, None] + np.arange(_AXES)).ravel()
    dofs = dofs + _AXES * (slab.first + mesh.steps * (slab.count - 1)) * len(mesh.plane)
    load = np.bincount(
        dofs, LinearForm(spread).assemble(basis), _AXES * len(mesh.plane) * len(mesh.heights)
    )
    return load / load.sum()


def ring_shapes(mesh: KickMesh, axis: str = "z") -> np.ndarray:
    """Columns (3 nodes, rings): shape of a unit ring force along ``axis``, equal along the circle.

    Nodes on a symmetry plane carry half (the other half acts on the mirror image). Weights sum to
    one, so the transpose averages the displacement (paper 2.2.2, eq. 8).
    """
    shapes = np.zeros((_AXES * len(mesh.plane) * len(mesh.heights), len(mesh.rings)))
    top = len(mesh.plane) * (len(mesh.heights) - 1)
    for column, ring in enumerate(mesh.rings):
        weights = np.ones(len(ring))
        if len(ring) > 1:
            weights[[0, -1]] = 0.5
        shapes[_AXES * (top + ring) + "xyz".index(axis), column] = weights / weights.sum()
    return shapes
