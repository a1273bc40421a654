"""Pressure on the top of a layered stack: a contact port that converges with the mesh.

A force on a circle of the mesh's nodes is a line load, whose dent grows without limit as the mesh
gets finer. Here pressures are hat functions of the radius, with the displacements averaged by them.
The mesh of the whole stack is too coarse for them; only a patch of them is a port of it, pressed as
by a flat punch: with the shares ``w = S^-1 1 / (1' S^-1 1)`` of the hats, S (n, n) their static
compliance, every hat moves by the same ``S w = s 1``. Then

    u_i = u_patch + sum_j (S - s_patch 1 1')_ij F_j,     F_patch = sum_j F_j,

where S is that of a round stack of the same layers on a graded axisymmetric mesh and ``s_patch``
that of the patch on the coarse mesh of the same round stack: what the coarse mesh has too little is
put back where it is missing. What differs between the round stack and the real one is smooth, thus
the same for all hats, and dynamic: the patch has it. The matrix is positive semi-definite because
``S - s 1 1'`` is (s is the least compliance of all shares) and a coarse mesh is too stiff.

The hats answer at once, as residual modes do (:mod:`kc2spice.rom.modal`): the dents' own modes
lie above the sound's frequency over the patch, ten megahertz. Nothing but the depth x by which a
sphere is pressed into them beyond the patch's motion sets them therefore, and their sum is one law
of one depth (:func:`dented`), which a circuit evaluates at the cost of one spring.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from skfem import LinearForm
from skfem.mesh import MeshQuad

from kc2spice.bodies.device import Device, Setup, Shape, constrained
from kc2spice.bodies.fields import Probe, principal
from kc2spice.bodies.piezo_stack import layer_materials, stack_setup
from kc2spice.bodies.stack_keys import Chip
from kc2spice.core.errors import SimulationError
from kc2spice.fem.solid import Solid
from kc2spice.rom.linear import Port

CELLS = 3  # of the graded mesh between two hats
GROWTH = 1.3  # from cell to cell away from the hats
EVEN = 0.2  # of the patch's radius, within which hats are equally spaced
WIDEST = 0.5  # of the patch's radius, of the contacts that a law is for
RESOLVED = 5  # hats under the narrowest contact that the law is fitted to
DEGREE = 5  # of its polynomial in the contact's radius
DEPTHS = 300  # that it is fitted to
ITERATIONS = 60  # of the closed hats
RIGID = 1e7  # stiffness of what keeps surfaces apart, of a hat's own


@dataclass(frozen=True)
class PressureBasis:
    """Hat functions of the radius: hat j is 1 at ``nodes[j]`` and 0 at its neighbours [m].

    The last node is the patch's edge, where no hat stands.
    """

    nodes: np.ndarray

    @property
    def areas(self) -> np.ndarray:
        """Their integrals over the plane [m^2]."""
        return self._moments(0)

    @property
    def distances(self) -> np.ndarray:
        """Radius [m] at which a paraboloid's gap is that of each hat: the mean over it, where
        ``r^2`` is the mean of ``r^2``."""
        return np.asarray(np.sqrt(self._moments(2) / self._moments(0)))

    def pressure(self, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Radii and pressure as shares (n,) of the hats spread a unit force."""
        return self.nodes, np.append(shares / self.areas, 0.0)

    def _moments(self, power: int) -> np.ndarray:
        x, w = np.polynomial.legendre.leggauss(4)
        a, b = self.nodes[:-1], self.nodes[1:]
        r = (a + b)[:, None] / 2 + (b - a)[:, None] / 2 * x
        part = np.pi * (b - a)[:, None] * w * r ** (1 + power)
        up = (r - a[:, None]) / (b - a)[:, None]
        falling, rising = (part * (1 - up)).sum(axis=1), (part * up).sum(axis=1)
        return falling + np.r_[0.0, rising[:-1]]


def hats(spacing: float, patch: float) -> PressureBasis:
    """One every ``spacing`` [m] near the axis, in proportion to the radius beyond a fifth of
    ``patch`` [m], up to which they go: under a sphere each has a like share of the force."""
    nodes = [0.0]
    while nodes[-1] + 1.5 * (step := spacing * max(1.0, nodes[-1] / (EVEN * patch))) < patch:
        nodes.append(nodes[-1] + step)
    return PressureBasis(np.array([*nodes, patch]))


@dataclass(frozen=True)
class Pressed:
    """``shares`` (n,) of the hats in the patch, what they give more than it (n, n) [m/N], and what
    it gives on the coarse mesh [m/N]."""

    shares: np.ndarray
    compliance: np.ndarray
    patch: float


def pressed(chip: Chip, shape: PressureBasis, cells: int = CELLS) -> Pressed:
    """Shares and additional compliance [m/N] of the hats on the stack's top.

    Raises
    ------
    SimulationError : the coarse mesh is softer than the graded one, which no good mesh is.
    """
    S = dents(chip, shape, cells)
    shares = np.linalg.solve(S, np.ones(len(S)))
    shares /= shares.sum()
    own = stack_setup(_round(chip), pressure=shape.pressure(shares))
    coarse = float(_compliance(constrained(*own))[0, 0])
    added = S - coarse
    lowest = float(np.linalg.eigvalsh(added)[0])
    if lowest < 0:
        raise SimulationError(
            "the mesh of the stack is softer than a graded one under a patch of pressure",
            where="contact.shape",
            got=f"compliance {lowest:.3g} m/N of a hat",
            expected="above 0",
            hint="raise kick.mesh.sectors, or lower contact.spacing",
        )
    return Pressed(shares, added, coarse)


def dents(chip: Chip, shape: PressureBasis, cells: int = CELLS) -> np.ndarray:
    """(n, n) mean displacement [m] of each hat per force [N] on each, of a round stack as wide as
    the chip's smaller side, on a roller, electrodes at constant voltage."""
    S = _compliance(_stack(chip, shape, cells))
    return (S + S.T) / 2


def _compliance(stack: Device) -> np.ndarray:
    """(n, n) static displacements [m] of the mechanical ports, which come first, per force [N]."""
    model = stack.model
    loads = model.B[:, [port.kind == "mechanical" for port in model.ports]]
    return np.asarray(loads.T @ model.pencil.pencil_solver(0.0).solve(loads))


def stressed(
    chip: Chip, shape: PressureBasis, force: np.ndarray, cells: int = CELLS
) -> dict[str, float]:
    """What ``force`` (n,) [N] on the hats does inside, on the graded mesh, at Gauss points: the
    largest ``pressure_pa``, and the largest ``shear_pa``, half the difference of principal
    stresses, with its ``shear_depth_m`` below the top."""
    stack = _stack(chip, shape, cells)
    probe, model = Probe(stack, gauss=True), stack.model
    z = model.pencil.pencil_solver(0.0).solve(-model.B[:, : len(force)] @ force)
    T, _ = probe.stress(*probe.nodal(z[:, None], np.zeros((1, 1))))
    shear = (principal(T[..., 0]) + principal(-T[..., 0])) / 2
    height = np.asarray(probe.basis.global_coordinates())[1].ravel()
    return {
        "pressure_pa": float((force / shape.areas).max()),
        "shear_pa": float(shear.max()),
        "shear_depth_m": float(stack.solid.mesh.p[1].max() - height[shear.argmax()]),
    }


def _stack(chip: Chip, shape: PressureBasis, cells: int) -> Device:
    """The round stack on a roller, with a port for every hat."""
    heights, planes, solid = _graded(chip, shape, cells)
    r, z = solid.places
    near = 1e-9 * heights[-1]

    def level(at: np.ndarray) -> np.ndarray:
        return np.flatnonzero((np.abs(z[:, None] - at) < near).any(axis=1))

    top = solid.mesh.facets_satisfying(lambda x: np.abs(x[1] - heights[-1]) < near)
    loads = np.zeros((2 * z.size, len(shape.nodes) - 1))
    loads[1::2] = hat_loads(solid, shape, top)
    setup = Setup(
        np.column_stack([r < near, z < near]).ravel(),
        {"anode": level(planes[1::2]), "cathode": level(planes[::2])},
        "cathode",
        shapes=[Shape(Port(f"hat{k}", "mechanical"), load) for k, load in enumerate(loads.T)],
    )
    return constrained(solid, setup)


def hat_loads(solid: Solid, shape: PressureBasis, facets: np.ndarray) -> np.ndarray:
    """(nodes, hats) unit axial forces, spread as the hats are over what the facets project."""
    basis, hats = solid.face(facets, 5), np.eye(len(shape.nodes))[:-1]

    def load(hat: np.ndarray) -> LinearForm:
        profile = partial(np.interp, xp=shape.nodes, fp=hat, right=0.0)
        return LinearForm(lambda v, w: profile(w.x[0]) * w.x[0] * np.abs(w.n[1]) * v)

    loads = np.column_stack([load(hat).assemble(basis) for hat in hats])
    return loads / loads.sum(axis=0)


def _graded(chip: Chip, shape: PressureBasis, cells: int) -> tuple[np.ndarray, np.ndarray, Solid]:
    """Heights [m] of the layers' faces, those with electrodes, and quadrilaterals that grow away
    from the hats, with a line at every height."""
    below, above = (cap.thickness if cap else 0.0 for cap in (chip.bottom_cap, chip.top_cap))
    caps = (int(below > 0), int(above > 0))
    thickness = np.r_[
        [below] * caps[0], [chip.height / chip.layers] * chip.layers, [above] * caps[1]
    ]
    heights, radius = np.r_[0.0, np.cumsum(thickness)], min(chip.half)
    planes = heights[caps[0] :][: chip.layers + 1]
    ends = zip(shape.nodes[:-1], shape.nodes[1:], strict=True)
    inner = np.concatenate(
        [*(np.linspace(a, b, cells + 1)[:-1] for a, b in ends), shape.nodes[-1:]]
    )
    r = np.concatenate([inner, _growing(inner[-1], radius, inner[-1] - inner[-2])[1:]])
    lines, step = [heights[-1:]], shape.nodes[1] / cells
    for low, high in zip(heights[-2::-1], heights[:0:-1], strict=True):
        down = _growing(0.0, high - low, step)
        lines.append(np.r_[high - down[1:-1], low])
        step = down[-1] - down[-2]
    mesh = MeshQuad.init_tensor(r, np.concatenate(lines)[::-1])
    middle = mesh.p[1][mesh.t].mean(axis=0)
    materials, owner = layer_materials(chip, np.pad(np.ones(chip.layers, int), caps))
    layer = np.searchsorted(heights, middle) - 1
    return heights, planes, Solid(mesh, materials, owner[layer], axisymmetric=True)


def _growing(start: float, end: float, step: float) -> np.ndarray:
    """Points from ``start`` to ``end`` whose distances grow from about ``step`` on."""
    points = [start]
    while points[-1] + 1.5 * (step := GROWTH * step) < end:
        points.append(points[-1] + step)
    return np.array([*points, end])


def _round(chip: Chip) -> Chip:
    """The round stack of the same layers and the same mesh under the hats."""
    given = {
        name: getattr(chip, name)
        for name in ("height", "layers", "bottom_cap", "top_cap", "material", "mesh", "damping")
    }
    return Chip(**given, diameter=2 * min(chip.half))


@dataclass(frozen=True)
class Indented:
    """Force [N] of a sphere pressed by x [m] into hats: ``sum_k c_k s^(3 + k)``.

    ``s = sqrt(x / depth)`` is the contact's radius over the widest one, so that the first term is
    Hertz's law and the others what layers and the body's size add. ``depth`` [m] is the largest
    that it holds for.
    """

    depth: float
    coefficients: tuple[float, ...]

    def force(self, x: np.ndarray) -> np.ndarray:
        """Force [N] at depths [m], none of them negative."""
        s = np.sqrt(x / self.depth)
        return np.asarray(s**3 * np.polynomial.polynomial.polyval(s, self.coefficients))


def dented(shape: PressureBasis, compliance: np.ndarray, gap: np.ndarray) -> Indented:
    """The law of a sphere over hats of the ``compliance`` (n, n), each the ``gap`` (n,) [m] below
    it.

    Hats close one by one, and the force of n of them is n straight lines: it swings about the
    converged one by a quarter of (spacing / contact's radius)^2. The work ``J = int F dx`` is a
    minimum over all pressures, of second order in their error. The law is the derivative of the
    polynomial that fits J, from contacts that are some hats wide on.

    Raises
    ------
    SimulationError : the closed hats do not settle.
    """
    spacing, widest = shape.nodes[1], WIDEST * shape.nodes[-1]
    depth = 2 * float(np.interp(widest, shape.distances, gap))  # Hertz: half of it is left there
    s = np.linspace(min(0.5, RESOLVED * spacing / widest), 1.0, DEPTHS)
    x = depth * s**2
    force = pressing(compliance, gap, x)
    work = ((x[:, None] - gap) * force).sum(axis=1) / 2
    power = 3 + np.arange(DEGREE + 1)
    terms = s[:, None] ** (power + 2) * (2 * depth / (power + 2))
    found = np.linalg.lstsq(terms / work[:, None], np.ones(DEPTHS), rcond=None)[0]
    return Indented(depth, tuple(found.tolist()))


def pressing(compliance: np.ndarray, gap: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """(depths, n) forces [N]: pressure where, and only where, the sphere meets the surface."""
    rigid = np.full(gap.size, RIGID / compliance.diagonal().max())
    return np.array([contact_forces(compliance, x - gap, rigid) for x in depth])


def contact_forces(
    compliance: np.ndarray, penetration: np.ndarray, penalty: np.ndarray
) -> np.ndarray:
    """Solve ``f = penalty * max(0, penetration - compliance f)`` for f >= 0.

    ``compliance`` (c, c) is symmetric positive semi-definite, which makes the solution unique.
    The iteration stops only when the set of closed springs repeats, that is at the solution.

    Raises
    ------
    SimulationError : no set repeats within the limit.
    """
    closed = penetration > 0
    for _ in range(ITERATIONS):
        force = np.zeros_like(penetration)
        index = np.flatnonzero(closed)
        system = compliance[np.ix_(index, index)] + np.diag(1 / penalty[index])
        force[index] = np.linalg.solve(system, penetration[index])
        now = penetration - compliance @ force > 0
        if np.array_equal(now, closed):
            return force
        closed = now
    raise SimulationError(
        "contact does not settle",
        where="semi-smooth Newton",
        got=f"{ITERATIONS} different sets of closed springs",
        expected="a set that repeats",
        hint="the sphere may move too far in one step: make the step smaller",
    )
