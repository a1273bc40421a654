"""Contact pressure on a stack; the indentation converges as the mesh is refined.

A force on a circle of mesh nodes is a line load. The indentation under a line load grows without
bound as the mesh is refined. In this module, contact pressures are sums of basis functions that are
piecewise linear in the radius (P1). The displacement of a basis function is the average surface
displacement, weighted with the function. The mesh of the whole stack is too coarse for the basis
functions of the pressure. The contact port of the whole stack is a patch with the pressure of a
flat punch. Let S be the static compliance matrix (n, n) between the basis functions, and 1 a vector
of n ones. The shares ``w = S^-1 1 / (1' S^-1 1)`` divide a unit force among the basis functions.
With the shares w, the displacements S w of all basis functions are equal to ``s = 1 / (1' S^-1
1)``. The displacement u_i of basis function i depends on the forces F_j of all functions j and on
the displacement u_patch of the patch::

    u_i = u_patch + sum_j (S_ij - s_patch) F_j,     F_patch = sum_j F_j.

S is computed for a round stack of the same layers on a graded axisymmetric mesh. ``s_patch`` is the
compliance of the contact patch, computed with a coarse mesh of a round stack that has the layers of
the real stack. The sum over j adds the compliance that the coarse mesh does not represent. The
displacements of the round stack and of the real stack differ by a smooth function of the position,
which is nearly equal for all basis functions. The displacement ``u_patch`` is computed with a
dynamic model of the real stack, which need not be round. The compliances S and ``s_patch`` are
computed with static models of a round stack. Therefore, ``u_patch`` contains the difference between
the displacements of the round stack and of the real stack. The matrix ``S - s * ones(n, n)`` is
positive semi-definite, because s is the minimum of the compliance ``w' S w`` over all force shares
w whose sum is 1. A coarse mesh is too stiff, so its patch compliance ``s_patch`` is smaller than
the compliance s on the graded mesh. Because ``s_patch`` is smaller than s, the matrix
``S - s_patch * ones(n, n)`` is positive semi-definite as well.

Like residual modes (:mod:`kc2spice.rom.modal_models`), the local compliance has no inertia. The
inertia of the patch is negligible, because the modes of the patch are above ten megahertz (speed of
sound divided by the size of the patch). Therefore, the contact forces depend only on x, the
indentation of a sphere relative to the patch. The sum of the contact forces is a function of x
(:func:`fit_indentation_law`), which a circuit evaluates like the force of one spring.

The other contact body may be a free elastic sphere (:class:`TransverselyIsotropicSphere`) with the
same basis functions. The quadrilaterals in the mesh of the sphere are larger at larger distances
from the lowest point of the sphere (the lower pole). Points in the half disc are ``zeta = r + i
h``, where h is the height above the lower pole. The conformal map ``zeta = w / (1 - i w / 2R)``
transforms the quarter plane ``w = 2R (tan x/2 + i tan y/2)`` to the half disc. On the surface of
the sphere, y is zero, and x is the polar angle from the lower pole. On the axis of the sphere, x is
zero, and y increases with the height h. In the half disc, lines of constant angle x cross lines of
constant angle y at right angles. On the surface of the sphere, every node of the pressure basis
functions is also a node of the mesh. The conformal map transforms infinity in the quarter plane w
to the upper pole of the sphere. The mesh ends at a small void around the upper pole, with a radius
of at most ``R / 30``. The void at the upper pole reduces the mass of the meshed sphere by the
fraction 1e-5.

Displacements of the sphere are relative to its centre of mass. The rigid translation of the sphere
along the axis is the vector t (n,), and its mass is ``m = t' M t``. Inertia forces that balance the
loads B of the ports are added to these loads: ``B - M t t' B / m``. Therefore, forces at the ports
do not move the centre of mass. The stiffness matrix K of an unsupported sphere is singular, because
a rigid translation t deforms nothing: ``K t = 0``. A spring with the stiffness matrix ``(M t) (M
t)' w^2 / m`` resists the rigid translation t and makes K definite. An additional unknown of the
sphere's model represents this spring, and elimination of the unknown adds the spring's stiffness to
K. No port force deforms this spring, and no output contains its deformation. A uniform body force
on the sphere, such as its weight, causes no deformation, because inertia forces balance this body
force at every point.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import sparse
from skfem import LinearForm
from skfem.mesh import MeshQuad, MeshQuad2

from kc2spice.bodies.fields import FieldProbe, compute_largest_principal_stress
from kc2spice.bodies.mesh_error_estimate import estimate_mesh_errors
from kc2spice.bodies.solid_models import BoundaryConditions, PortLoad, make_undamped_model
from kc2spice.bodies.stack import make_layer_materials, make_stack_setup
from kc2spice.bodies.stack_keys import PATCH_PORT, StackKeys
from kc2spice.bodies.undamped_models import FiniteElementModel, compute_undamped_responses
from kc2spice.core.domains import TRANSLATION
from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import SimulationError
from kc2spice.fem.body_keys import DampingKeys
from kc2spice.fem.materials import Material
from kc2spice.fem.solid import Solid, assemble_solid
from kc2spice.rom.linear_model import LinearModel, Port, make_piezoelectric_model

CELLS_PER_NODE = 3  # number of cells of the graded mesh between two nodes of the basis functions
CELL_GROWTH = 1.3  # ratio of successive cell sizes outside of the contact
# radius within which the nodes are equally spaced, relative to the radius of the patch
EVEN_RADIUS_RATIO = 0.2
# largest contact radius of a force law, relative to the radius of the patch
MAX_CONTACT_RATIO = 0.5
# The force law is fitted only to contact areas that cover at least this number of basis functions.
MIN_FUNCTIONS = 5
LAW_DEGREE = 5  # degree of the force law's polynomial in the contact radius
FIT_DEPTHS = 300  # number of indentations to which the force law is fitted
# This share of the largest diagonal entry is added to all diagonal entries of a compliance matrix.
# The addition makes the compliance matrix positive definite.
REGULARISATION = 1e-7
# Dimensionless frequency 2 pi f R / c of the lowest mode of a sphere of radius R.
# The speed of shear waves is c, and Poisson's ratio is 0.25 (Lamb 1882).
OBLATE_FREQUENCY = 2.65
MAX_CELL_ANGLE = 1 / 8  # rad, largest angle that a cell of the sphere's mesh spans
# rad; the mesh of the sphere ends at one to two times this angle from the upper pole
PIT_ANGLE = 1 / 60


@dataclass(frozen=True, eq=False)
class PressureBasis(EqualByContent):
    """Basis functions of contact pressures, which are piecewise linear in the radius.

    ``nodes`` [m] contains the radii of the nodes. Function j is 1 at node j and 0 at all other
    nodes. The last node is the edge of the patch and has no function, because the pressure at the
    edge is zero.
    """

    nodes: np.ndarray

    @property
    def areas(self) -> np.ndarray:
        """Integral [m^2] of each basis function over the plane of contact."""
        return self._integrate_powers(0)

    @property
    def mean_gap_radii(self) -> np.ndarray:
        """Radii [m] at which the gap equals its mean over each pressure basis function.

        The mean of ``r^2`` over the plane of contact is weighted with the basis function. The gap
        below a paraboloid is proportional to ``r^2``. Therefore, the gap at the returned radius is
        the mean gap, weighted with the basis function.
        """
        return np.asarray(np.sqrt(self._integrate_powers(2) / self._integrate_powers(0)))

    def compute_pressure(self, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return node radii, and the contact pressure at each node under a unit force.

        ``shares`` contains the fraction of the total force that each basis function carries. The
        first returned array contains the radii [m] of the nodes. The second returned array contains
        the pressure per unit contact force [1/m^2] at each node.
        """
        return self.nodes, np.append(shares / self.areas, 0.0)

    def _integrate_powers(self, power: int) -> np.ndarray:
        """Integrate each basis function times a power of the radius over the plane."""
        x, w = np.polynomial.legendre.leggauss(4)
        a, b = self.nodes[:-1], self.nodes[1:]
        r = (a + b)[:, None] / 2 + (b - a)[:, None] / 2 * x
        part = np.pi * (b - a)[:, None] * w * r ** (1 + power)
        up = (r - a[:, None]) / (b - a)[:, None]
        falling, rising = (part * (1 - up)).sum(axis=1), (part * up).sum(axis=1)
        return falling + np.r_[0.0, rising[:-1]]


def choose_pressure_basis(spacing: float, patch: float) -> PressureBasis:
    """Choose the node radii of a pressure basis on a circular contact patch.

    Near the axis, the distance between two nodes is ``spacing`` [m]. Farther than a fifth of the
    patch radius from the axis, the distance between two nodes is proportional to their distance
    from the axis. As the node spacing grows with the distance from the axis, each basis function
    carries a similar share of the contact force of a sphere.
    """
    nodes = [0.0]
    while (
        nodes[-1] + 1.5 * (step := spacing * max(1.0, nodes[-1] / (EVEN_RADIUS_RATIO * patch)))
        < patch
    ):
        nodes.append(nodes[-1] + step)
    return PressureBasis(np.array([*nodes, patch]))


@dataclass(frozen=True, eq=False)
class LocalCompliance(EqualByContent):
    """Local compliance of a contact: matrix in a pressure basis, and patch compliance.

    ``compliance`` (n, n) [m/N] is the additional compliance matrix of the basis functions.
    ``patch`` [m/N] is the compliance of the patch.
    """

    compliance: np.ndarray
    patch: float

    @property
    def rigid_force_shares(self) -> np.ndarray:
        """Share of each basis function in the force of a rigid flat punch.

        The punch displaces the surface equally under all basis functions. The returned array of n
        shares has the shape (n,).
        """
        result = np.linalg.solve(self.compliance + self.patch, np.ones(len(self.compliance)))
        return np.asarray(result / result.sum())


def compute_local_compliance(chip: StackKeys, shape: PressureBasis) -> LocalCompliance:
    """Compute the local compliance of a stack's top face in a pressure basis.

    The compliance of the whole patch is computed on the coarse mesh.

    Raises
    ------
    SimulationError : the coarse mesh is softer than the graded mesh, because the coarse mesh or the
        ``spacing`` of the basis functions is unsuitable.
    """
    S = compute_surface_compliance(chip, shape)
    # the coarse model is a round stack with the same layers and the same mesh under the patch
    alike = ("height", "layers", "bottom_cap", "top_cap", "material", "mesh", "damping")
    chip_keys = {name: getattr(chip, name) for name in alike} | {
        "diameter": 2 * min(chip.half_widths)
    }
    pressure = shape.compute_pressure(LocalCompliance(S, 0.0).rigid_force_shares)
    coarse = float(
        _compute_port_compliance(
            make_undamped_model(*make_stack_setup(StackKeys(**chip_keys), pressure=pressure)).model
        )[0, 0]
    )
    lowest = float(np.linalg.eigvalsh(S - coarse)[0])
    if lowest < 0:
        raise SimulationError(
            "the local compliance of the contact is negative: the mesh of the stack is too coarse",
            where="contact.shape",
            got=f"a local compliance of {lowest:.3g} m/N",
            expected="a local compliance above 0 m/N",
            hint="raise `mesh.sectors` of the stack, or lower `spacing` of the contact",
        )
    return LocalCompliance(S - coarse, coarse)


def compute_surface_compliance(
    chip: StackKeys, shape: PressureBasis, cells: int = CELLS_PER_NODE
) -> np.ndarray:
    """Compute the compliance matrix of the basis functions on the top of a stack.

    The diameter of the round stack is the smaller side of the chip. The round stack stands on a
    frictionless support, and the voltages of its electrodes are constant. Return a matrix of shape
    (n, n) [m/N]. ``cells`` is the number of cells between two nodes of the basis functions.
    """
    return _compute_port_compliance(_model_stack(chip, shape, cells).model)


def _compute_port_compliance(model: LinearModel) -> np.ndarray:
    """Compute the static compliance matrix of the mechanical ports of a model.

    Return a symmetric matrix of shape (n, n) [m/N].
    """
    loads = model.B[:, [port.domain is TRANSLATION for port in model.ports]]
    S = loads.T @ model.pencil.factorise_shifted_stiffness(0.0).solve(loads)
    return np.asarray((S + S.T) / 2)


# units of the values that `compute_stresses_under_force` returns
UNITS = {"pressure_pa": "Pa", "shear_pa": "Pa", "shear_depth_m": "m"}


def compute_stresses_under_force(
    chip: StackKeys, shape: PressureBasis, force: np.ndarray
) -> dict[str, float]:
    """Compute the largest stresses in a stack under contact forces.

    ``force`` [N] contains the force of each basis function, an array of shape (n,). The stresses
    are evaluated at the Gauss points of the graded mesh. Return the largest pressure
    ``pressure_pa``, the largest shear stress ``shear_pa`` (half of the difference of principal
    stresses), and the depth ``shear_depth_m`` of the largest shear stress below the top.
    """
    stack = _model_stack(chip, shape, CELLS_PER_NODE)
    probe, model = FieldProbe(stack, gauss=True), stack.model
    z = model.pencil.factorise_shifted_stiffness(0.0).solve(-model.B[:, : len(force)] @ force)
    T, _ = probe.compute_stress_and_field(*probe.compute_nodal_values(z[:, None], np.zeros((1, 1))))
    shear = (
        compute_largest_principal_stress(T[..., 0]) + compute_largest_principal_stress(-T[..., 0])
    ) / 2
    height = np.asarray(probe.basis.global_coordinates())[1].ravel()
    return {
        "pressure_pa": float((force / shape.areas).max()),
        "shear_pa": float(shear.max()),
        "shear_depth_m": float(stack.solid.mesh.p[1].max() - height[shear.argmax()]),
    }


def _model_stack(chip: StackKeys, shape: PressureBasis, cells: int) -> FiniteElementModel:
    """Model the layers as a round stack with one port for each pressure function.

    Each pressure basis function acts on one port. The support below the stack is frictionless.
    Quadrilaterals of the mesh are larger at larger distances from the loaded area, which is the
    centre of the top face. Every face of a layer is a line of the mesh.
    """
    ends = [cap.thickness if cap else 0.0 for cap in (chip.bottom_cap, chip.top_cap)]
    caps = [int(end > 0) for end in ends]
    layers = [chip.height / chip.layers] * chip.layers
    heights = np.r_[0.0, np.cumsum([*ends[:1] * caps[0], *layers, *ends[1:] * caps[1]])]
    planes, near = heights[caps[0] :][: chip.layers + 1], 1e-9 * heights[-1]
    inner = _subdivide_intervals(shape.nodes, cells)
    outer = _make_growing_grid(inner[-1], min(chip.half_widths), inner[-1] - inner[-2])
    lines, step = [heights[-1:]], shape.nodes[1] / cells
    for low, high in zip(heights[-2::-1], heights[:0:-1], strict=True):
        down = _make_growing_grid(0.0, high - low, step)
        lines.append(np.r_[high - down[1:-1], low])
        step = down[-1] - down[-2]
    mesh = MeshQuad.init_tensor(np.r_[inner, outer[1:]], np.concatenate(lines)[::-1])
    materials, owner = make_layer_materials(chip, np.pad(np.ones(chip.layers, int), caps))
    layer = np.searchsorted(heights, mesh.p[1][mesh.t].mean(axis=0)) - 1
    solid = Solid(mesh, materials, owner[layer], axisymmetric=True)
    r, z = solid.node_positions

    def find_nodes_at_heights(at: np.ndarray) -> np.ndarray:
        """Return the numbers of the nodes at any of the given heights [m]."""
        return np.flatnonzero((np.abs(z[:, None] - at) < near).any(axis=1))

    top = mesh.facets_satisfying(lambda x: np.abs(x[1] - heights[-1]) < near)
    ports = _make_basis_ports(shape)
    setup = BoundaryConditions(
        np.column_stack([r < near, z < near]).ravel(),
        {
            "anode": find_nodes_at_heights(planes[1::2]),
            "cathode": find_nodes_at_heights(planes[::2]),
        },
        "cathode",
        shapes=[*map(PortLoad, ports, _compute_basis_loads(solid, shape, top).T)],
    )
    return make_undamped_model(solid, setup)


def _make_basis_ports(shape: PressureBasis) -> list[Port]:
    """Return a force port for each pressure basis function."""
    return [Port(f"basis{k}", TRANSLATION.port) for k in range(len(shape.nodes) - 1)]


def _compute_basis_loads(solid: Solid, shape: PressureBasis, facets: np.ndarray) -> np.ndarray:
    """Return the nodal loads of a unit axial force for each basis function.

    The force per projected horizontal area of the facets is proportional to the basis function. The
    returned array has the shape (2 * nodes, n), with a radial and an axial row for each node, and a
    column for each of the n basis functions.
    """
    basis = solid.make_facet_basis(facets, 5)

    def compute_facet_load(heights: np.ndarray) -> np.ndarray:
        """Return the nodal loads of a pressure profile on the facets.

        ``heights`` contains the value of the pressure profile at each node of the basis functions.
        Between the nodes, the pressure profile is linear.
        """
        profile = partial(np.interp, xp=shape.nodes, fp=heights, right=0.0)
        form = LinearForm(lambda v, w: profile(w.x[0]) * w.x[0] * np.abs(w.n[1]) * v)
        return np.asarray(form.assemble(basis))

    axial = np.column_stack(list(map(compute_facet_load, np.eye(len(shape.nodes))[:-1])))
    return np.kron(axial / axial.sum(axis=0), [[0.0], [1.0]])


def _subdivide_intervals(points: np.ndarray, count: int) -> np.ndarray:
    """Divide every interval between points into ``count`` equal intervals."""
    parts = np.arange(count * (len(points) - 1) + 1) / count
    return np.interp(parts, np.arange(len(points)), points)


def _make_growing_grid(start: float, end: float, step: float) -> np.ndarray:
    """Return points from ``start`` to ``end`` whose spacing increases.

    The first spacing is :data:`CELL_GROWTH` times ``step``.
    """
    points = [start]
    while points[-1] + 1.5 * (step := CELL_GROWTH * step) < end:
        points.append(points[-1] + step)
    return np.array([*points, end])


@dataclass(frozen=True)
class IndentationLaw:
    """Contact force of a sphere as a function of its indentation x [m].

    The force is ``sum_k c_k s^(3 + k)`` [N] with ``s = sqrt(x / depth)``, where ``depth`` [m] is
    the largest indentation of the law. Thus s is the contact radius divided by the largest contact
    radius. The first term of the sum is Hertz's law. The other terms represent effects of the
    layers and of the size of the body.
    """

    depth: float
    coefficients: tuple[float, ...]

    def force(self, x: np.ndarray) -> np.ndarray:
        """Compute the force [N] at non-negative indentations ``x`` [m]."""
        s = np.sqrt(x / self.depth)
        return np.asarray(s**3 * np.polynomial.polynomial.polyval(s, self.coefficients))


def fit_indentation_law(
    shape: PressureBasis, compliance: np.ndarray, gap: np.ndarray
) -> IndentationLaw:
    """Fit a contact force law: force on a sphere as a function of its indentation.

    The contact pressure is a sum of basis functions that depend on the radius. ``compliance`` (n,
    n) [m/N] is the compliance matrix of the basis functions, and ``gap`` (n,) [m] is the initial
    gap between each basis function and the sphere. The basis functions come into contact one after
    another, so that the force is a piecewise linear function of the indentation with n pieces. The
    relative error of the piecewise linear force is at most a quarter of (spacing / contact
    radius)^2. The work ``J = int F dx`` is the maximum of ``p'(x - gap) - p'S p / 2`` over all
    forces ``p >= 0`` of the basis functions, with the indentation x and the compliance S. The error
    of J is therefore proportional to the squared errors of the forces p. A polynomial is fitted to
    J at contact radii within which there are at least :data:`MIN_FUNCTIONS` basis functions. The
    force law is the derivative of the fitted polynomial.
    """
    spacing, widest = shape.nodes[1], MAX_CONTACT_RATIO * shape.nodes[-1]
    # in Hertz's solution, the pressure at this radius is half of the largest pressure
    depth = 2 * float(np.interp(widest, shape.mean_gap_radii, gap))
    s = np.linspace(min(0.5, MIN_FUNCTIONS * spacing / widest), 1.0, FIT_DEPTHS)
    x = depth * s**2
    force = solve_contact_forces(compliance, gap, x)
    work = ((x[:, None] - gap) * force).sum(axis=1) / 2
    power = 3 + np.arange(LAW_DEGREE + 1)
    terms = s[:, None] ** (power + 2) * (2 * depth / (power + 2))
    result = np.linalg.lstsq(terms / work[:, None], np.ones(FIT_DEPTHS), rcond=None)[0]
    return IndentationLaw(depth, tuple(result.tolist()))


def solve_contact_forces(compliance: np.ndarray, gap: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Compute a sphere's contact forces, one per basis function, at each indentation.

    ``depth`` [m] contains the indentations x. Return the forces f [N], an array of shape (depths,
    n). The compliance matrix is S, and ``g = x - gap`` is the overlap of sphere and surface. The
    forces are positive only where the sphere touches the surface: ``f >= 0``, ``S f >= g`` and
    ``f'(S f - g) = 0``. Forces that satisfy these three conditions minimise ``f'S f / 2 - f'g``.
    With ``S = L L'``, minimisation of ``|L'f - L^-1 g|^2 / 2`` yields the same forces.
    """
    from scipy.optimize import nnls  # nnls is imported here, because ring contacts do not need it

    soft = REGULARISATION * compliance.diagonal().max()
    L = np.linalg.cholesky(compliance + soft * np.eye(gap.size))
    return np.array([nnls(L.T, np.linalg.solve(L, x - gap))[0] for x in depth])


@dataclass(frozen=True)
class TransverselyIsotropicSphere:
    """Elastic sphere of a transversely isotropic material, with radius and damping."""

    radius: float
    material: Material
    damping: DampingKeys

    @property
    def oblate_frequency(self) -> float:
        """Frequency [Hz] of the sphere's lowest mode, alternately oblate and prolate.

        Poisson's ratio changes the frequency by at most 1 %.
        """
        sound = np.sqrt(self.material.C[5, 5] / self.material.density)
        return float(OBLATE_FREQUENCY * sound / (2 * np.pi * self.radius))

    @property
    def rayleigh_factors(self) -> tuple[float, float]:
        """Rayleigh damping factors ``alpha`` [1/s] and ``beta`` [s] of the sphere.

        If ``damping`` contains a damping ratio, the lowest mode of the sphere has this ratio.
        """
        return self.damping.compute_rayleigh_factors(self.oblate_frequency)


def make_sphere_model(
    body: TransverselyIsotropicSphere, shares: np.ndarray, shape: PressureBasis, refine: int = 1
) -> LinearModel:
    """Make the model of a free sphere with one port at the contact patch.

    The port ``patch`` is directed upwards. ``shares`` (n,) are the shares of the port's force on
    the basis functions. ``refine`` is the number of parts into which every cell is divided along
    each axis. The docstring of :mod:`kc2spice.bodies.contact_pressure` describes the model of the
    sphere.
    """
    device, port = _make_free_sphere_model(body, shape, refine), Port(PATCH_PORT, TRANSLATION.port)
    facet_load = device.model.B @ shares[:, None]
    model = replace(device.model, B=facet_load, C=facet_load.T, D=np.zeros((1, 1)), ports=(port,))
    answers = compute_undamped_responses(model)
    facts = {
        **model.facts,
        **answers.facts,
        **estimate_mesh_errors(replace(device, model=model), answers),
    }
    return replace(model, E=None, rayleigh=body.rayleigh_factors, facts=facts)


def compute_sphere_compliance(
    body: TransverselyIsotropicSphere, shape: PressureBasis, refine: int = 1
) -> LocalCompliance:
    """Compute the compliance of a sphere to pressures on its circular contact patch."""
    S = _compute_port_compliance(_make_free_sphere_model(body, shape, refine).model)
    patch = float(1 / np.linalg.solve(S, np.ones(len(S))).sum())
    return LocalCompliance(S - patch, patch)


def _make_free_sphere_model(
    body: TransverselyIsotropicSphere, shape: PressureBasis, refine: int
) -> FiniteElementModel:
    """Make the undamped model of a free sphere with a port for every basis function.

    The mesh is a grid of angles that the conformal map of the module docstring transforms.
    """
    radius = body.radius
    x = _extend_angles(np.arcsin(_subdivide_intervals(shape.nodes, CELLS_PER_NODE) / radius))
    y = _extend_angles(np.array([0.0, x[1]]))
    mesh = MeshQuad2.from_mesh(
        MeshQuad.init_tensor(_subdivide_intervals(x, refine), _subdivide_intervals(y, refine))
    )
    w = np.tan(mesh.doflocs[0] / 2) + 1j * np.tan(mesh.doflocs[1] / 2)
    zeta = 2 * radius * w / (1 - 1j * w)
    mesh = MeshQuad2(np.ascontiguousarray([zeta.real, zeta.imag]), mesh.t)
    solid = Solid(mesh, (body.material,), np.zeros(mesh.nelements, int), axisymmetric=True)
    # ``under`` marks the facets of the sphere's surface within the contact patch at the lower pole.
    r, h = mesh.p[:, mesh.facets]
    under = np.abs(np.hypot(r, h - radius) - radius).max(axis=0) < 1e-9 * radius
    under &= (r.max(axis=0) < (1 + 1e-9) * shape.nodes[-1]) & (h.max(axis=0) < radius)
    free = np.ones((solid.node_positions.shape[1], 2), dtype=bool)
    free[solid.node_positions[0] < 1e-6 * shape.nodes[1], 0] = False
    unknowns = np.flatnonzero(free.ravel())
    full = assemble_solid(solid)
    M, K = (sparse.csc_array(P[unknowns][:, unknowns]) for P in (full.M, full.K_uu))
    along = (unknowns % 2).astype(float)
    momentum = M @ along
    mass = float(along @ momentum)
    slow = np.linalg.eigvalsh(body.material.C)[0] / body.material.density / radius**2
    loads = _compute_basis_loads(solid, shape, np.flatnonzero(under))[unknowns]
    model = make_piezoelectric_model(
        M=M,
        K_uu=K,
        K_up=sparse.csc_array(momentum[:, None]),
        K_pp=sparse.csc_array([[mass / slow]]),
        k_uV=np.zeros((len(unknowns), 0)),
        c_VV=np.zeros((0, 0)),
        B=loads - momentum[:, None] / mass,
        ports=_make_basis_ports(shape),
        facts={"unknowns": float(len(unknowns)), "mass_kg": mass},
    )
    moved = sparse.eye_array(free.size, format="csc")[:, unknowns]
    none = sparse.csc_array((len(free), 0))  # the sphere is not piezoelectric: no potentials
    return FiniteElementModel(model, solid, moved, none, none, np.zeros((0, 0)), 0.0, mass)


def _extend_angles(angles: np.ndarray) -> np.ndarray:
    """Extend ``angles`` [rad] to pi with steps that first increase and then decrease."""
    result = list(angles)
    while (
        result[-1] + 2 * (step := min(CELL_GROWTH * (result[-1] - result[-2]), MAX_CELL_ANGLE))
        < np.pi
    ):
        result.append(result[-1] + step)
    while np.pi - result[-1] > 2 * PIT_ANGLE:
        result.append((result[-1] + np.pi) / 2)
    return np.array(result)
