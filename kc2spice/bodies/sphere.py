"""A free elastic sphere under a patch of pressure at its lowest point, a side of a contact.

Axisymmetric, on quadrilaterals that grow away from that pole. The conformal map
``zeta = w / (1 - i w / 2R)`` of ``zeta = r + i h`` takes the quarter plane ``w = 2R (tan x/2 +
i tan y/2)`` to the half disc, h the height above the pole: a grid of the angles x, along the
surface, and y, along the axis, has right angles everywhere and, at the pole, the lines of the hats.
The other pole lies at infinity; there a pit of ``R / 30`` is left out, 1e-5 of the mass.

Displacements are relative to the centre of mass. With the motion t (n,) of the whole along the
axis and the mass ``m = t' M t``, forces F at the ports B act with the inertia that balances them,
``B - M t t' B / m``, and so do not move the whole; a spring ``(M t) (M t)' w^2 / m`` on it, as one
unknown that is eliminated, makes K definite and is neither moved nor seen. Any uniform force, such
as weight, adds nothing.

The patch is pressed as :mod:`kc2spice.bodies.pressure` has it, by hats in the shares that move all
of them alike; what they give more than it is local and answers at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from skfem.mesh import MeshQuad, MeshQuad2

from kc2spice.bodies.device import electromechanical
from kc2spice.bodies.pressure import CELLS, GROWTH, Pressed, PressureBasis, hat_loads
from kc2spice.bodies.stack_keys import PATCH
from kc2spice.fem.keys import Damping
from kc2spice.fem.materials import Material
from kc2spice.fem.solid import Solid, assemble
from kc2spice.rom.linear import LinearModel, Port, with_potentials

OBLATE = 2.65  # 2 pi f R / c of the lowest mode, c of shear waves (Lamb 1882, nu = 0.25)
WIDEST = 1 / 8  # rad, of a cell
PIT = 1 / 60  # rad around the upper pole without cells


@dataclass(frozen=True)
class Sphere:
    """``radius`` [m] and what it is made of; isotropic about the axis."""

    radius: float
    material: Material
    damping: Damping

    @property
    def oblate(self) -> float:
        """Frequency [Hz] of its lowest mode, which makes it oblong, but for 1 % by the ratio nu."""
        sound = np.sqrt(self.material.C[5, 5] / self.material.density)
        return float(OBLATE * sound / (2 * np.pi * self.radius))

    @property
    def rayleigh(self) -> tuple[float, float]:
        """``alpha`` [1/s] and ``beta`` [s] of ``E = alpha M + beta K``, by that frequency."""
        return self.damping.rayleigh(self.oblate) if self.damping.zeta else (self.damping.alpha, 0)


def sphere(body: Sphere, shares: np.ndarray, shape: PressureBasis, refine: int = 1) -> LinearModel:
    """The sphere with the port ``patch``, upwards: ``shares`` (n,) of the hats; see the module.

    ``refine`` divides every cell along each axis.
    """
    free = _free(body, shape, refine)
    model = replace(
        free,
        B=free.B @ shares[:, None],
        C=(free.B @ shares[:, None]).T,
        D=np.zeros((1, 1)),
        ports=(Port(PATCH, "mechanical"),),
    )
    facts = {**free.facts, **electromechanical(model)}
    return replace(model, E=None, rayleigh=body.rayleigh, facts=facts)


def pressed(body: Sphere, shape: PressureBasis, refine: int = 1) -> Pressed:
    """Shares of the hats in the patch, what they give more than it, and what it gives [m/N]."""
    S = compliance(body, shape, refine)
    shares = np.linalg.solve(S, np.ones(len(S)))
    patch = float(1 / shares.sum())
    return Pressed(patch * shares, S - patch, patch)


def compliance(body: Sphere, shape: PressureBasis, refine: int = 1) -> np.ndarray:
    """(n, n) static displacement [m] of each hat per force [N] on each."""
    free = _free(body, shape, refine)
    S = free.B.T @ free.pencil.pencil_solver(0.0).solve(free.B)
    return np.asarray((S + S.T) / 2)


def _free(body: Sphere, shape: PressureBasis, refine: int) -> LinearModel:
    """The undamped sphere with a port for every hat."""
    solid = _graded(body, shape, refine)
    r, _ = solid.places
    free = np.ones((r.size, 2), dtype=bool)
    free[r < 1e-6 * shape.nodes[1], 0] = False
    kept = np.flatnonzero(free.ravel())
    full = assemble(solid)
    M, K = (sparse.csc_array(P[kept][:, kept]) for P in (full.M, full.K_uu))
    loads = np.zeros((2 * r.size, len(shape.nodes) - 1))
    loads[1::2] = hat_loads(solid, shape, _under(solid, body.radius, shape.nodes[-1]))
    along = (kept % 2).astype(float)
    momentum = M @ along
    mass = float(along @ momentum)
    slow = np.linalg.eigvalsh(body.material.C)[0] / body.material.density / body.radius**2
    return with_potentials(
        M=M,
        K_uu=K,
        K_up=sparse.csc_array(momentum[:, None]),
        K_pp=sparse.csc_array([[mass / slow]]),
        k_uV=np.zeros((len(kept), 0)),
        c_VV=np.zeros((0, 0)),
        B=loads[kept] - momentum[:, None] / mass,
        ports=[Port(f"hat{k}", "mechanical") for k in range(loads.shape[1])],
        facts={"unknowns": float(len(kept)), "mass_kg": mass},
    )


def _graded(body: Sphere, shape: PressureBasis, refine: int) -> Solid:
    """See the module."""
    ends = zip(shape.nodes[:-1], shape.nodes[1:], strict=True)
    radii = [np.linspace(a, b, CELLS + 1)[:-1] for a, b in ends]
    x = _onwards(np.arcsin(np.concatenate([*radii, shape.nodes[-1:]]) / body.radius))
    y = _onwards(np.array([0.0, x[1]]))
    x, y = (_divided(each, refine) for each in (x, y))
    mesh = MeshQuad2.from_mesh(MeshQuad.init_tensor(x, y))
    w = np.tan(mesh.doflocs[0] / 2) + 1j * np.tan(mesh.doflocs[1] / 2)
    zeta = 2 * body.radius * w / (1 - 1j * w)
    mesh = MeshQuad2(np.ascontiguousarray([zeta.real, zeta.imag]), mesh.t)
    owner = np.zeros(mesh.nelements, dtype=int)
    return Solid(mesh, (body.material,), owner, axisymmetric=True)


def _onwards(angles: np.ndarray) -> np.ndarray:
    """``angles`` [rad] and further ones, whose steps grow and shrink again towards pi."""
    found = list(angles)
    while found[-1] + 2 * (step := min(GROWTH * (found[-1] - found[-2]), WIDEST)) < np.pi:
        found.append(found[-1] + step)
    while np.pi - found[-1] > 2 * PIT:
        found.append((found[-1] + np.pi) / 2)
    return np.array(found)


def _divided(points: np.ndarray, count: int) -> np.ndarray:
    """Every interval in ``count`` equal ones."""
    parts = np.arange(count * (len(points) - 1) + 1) / count
    return np.interp(parts, np.arange(len(points)), points)


def _under(solid: Solid, radius: float, edge: float) -> np.ndarray:
    """The facets on the sphere within ``edge`` [m] of the lower pole."""
    r, h = solid.mesh.p[:, solid.mesh.facets]
    on = np.abs(np.hypot(r, h - radius) - radius).max(axis=0) < 1e-9 * radius
    return np.flatnonzero(on & (r.max(axis=0) < (1 + 1e-9) * edge) & (h.max(axis=0) < radius))
