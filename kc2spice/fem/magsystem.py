"""Discrete magnetostatics of the catch actuator: field equations and force at one position.

The unknown is ``a = A_phi / r``, smooth and even in r, so the axis needs no condition. With
``b(a) = 2 a + r da/dr`` the field is ``B_y = b(a)``, ``B_r = -r da/dy`` and the potential energy

    P(a) = 1/2 int nu (B_r^2 + B_y^2) dV - int nu B_rem b(a) dV - int J r a dV,   dV = 2 pi r dr dy

is least at the solution; ``a = 0`` on the air cylinder (paper 2.2.1). The force on the sphere is
``-dP/dy`` with the air around it stretched by a weight g (1 on the sphere, 0 on the mover's
outline): virtual work of the discrete energy, which equals the Maxwell stress averaged over a thick
shell (Henrotte, Deliege, Hameyer: The eggshell approach, COMPEL 23(4), 2004).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree
from skfem import Basis, BilinearForm, ElementTriP2, LinearForm, MeshTri2, condense, solve
from skfem.models.poisson import laplace

from kc2spice.errors import SimulationError
from kc2spice.fem import magmesh
from kc2spice.scene.schema import Catch, Part

MU0 = 4e-7 * pi
RING, SPHERE, LOWER, UPPER = range(4)  # columns of loads and of the fields that they make
_MAX_RESIDUAL = 1e-9
_ORDER = 6  # quadrature: the integrands on straight triangles are polynomials of degree 5


@BilinearForm
def _stiffness(u: Any, v: Any, w: Any) -> np.ndarray:
    r = w.x[0]
    bu, bv = 2 * u + r * u.grad[0], 2 * v + r * v.grad[0]
    return 2 * pi * r * (bu * bv + r**2 * u.grad[1] * v.grad[1])


@BilinearForm
def _stretch(u: Any, v: Any, w: Any) -> np.ndarray:
    """Derivative of the stiffness when points move by g in y and carry their values along."""
    r, (g_r, g_y) = w.x[0], w.g.grad
    bu, bv = 2 * u + r * u.grad[0], 2 * v + r * v.grad[0]
    shear = g_r * r * (u.grad[1] * bv + bu * v.grad[1])
    return 2 * pi * r * (g_y * (bu * bv - r**2 * u.grad[1] * v.grad[1]) - shear)


@LinearForm
def _remanence(v: Any, w: Any) -> np.ndarray:
    """``int b(v) dV``: the load of an axial ``nu B_rem`` of 1 A/m."""
    r = w.x[0]
    return 2 * pi * r * (2 * v + r * v.grad[0])


@LinearForm
def _current(v: Any, w: Any) -> np.ndarray:
    """``int A_phi 2 pi r dr dy``: the load of 1 A/m^2, and the flux that one turn/m^2 links."""
    return 2 * pi * w.x[0] ** 2 * v


@dataclass(frozen=True)
class Body:
    """Element matrices of one mesh: ``local[:, e]`` goes to ``rows[:, e]``, ``cols[:, e]``."""

    points: np.ndarray  # (2, n): places of the unknowns [m]
    centres: np.ndarray  # (2, elements)
    rows: np.ndarray
    cols: np.ndarray
    local: np.ndarray
    loads: np.ndarray  # (n, 4)


@dataclass(frozen=True)
class System:
    """Equations at one position: ``matrix a = loads`` on the ``free`` unknowns."""

    matrix: sparse.csc_array
    loads: np.ndarray  # (n, 4): ring and sphere magnet, 1 A in the lower and in the upper coil
    free: np.ndarray
    mover: np.ndarray
    stretch: sparse.csr_array

    def solve(self, loads: np.ndarray) -> np.ndarray:
        """Fields (n, k) of the loads (n, k); one symmetric factorisation, no pivoting.

        Raises
        ------
        SimulationError : the fields do not satisfy their equations.
        """
        options = {"SymmetricMode": True, "Equil": False}
        factors = splu(self.matrix, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        inner = loads[self.free]
        fields = factors.solve(inner)
        residual = np.linalg.norm(self.matrix @ fields - inner, axis=0)
        worst = np.max(residual / np.linalg.norm(inner, axis=0))
        if not worst <= _MAX_RESIDUAL:
            raise SimulationError(
                "the magnetic field does not satisfy its equations",
                where="magnetics",
                got=f"relative residual {worst:.1e}",
                expected=f"at most {_MAX_RESIDUAL:.0e}",
            )
        a = np.zeros(loads.shape)
        a[self.free] = fields
        return a

    def force(self, a: np.ndarray) -> np.ndarray:
        """Symmetric (k, k) [N]: fields ``a`` (n, k) of amplitudes q push with ``q' force q``."""
        near = a[self.mover]
        return -0.5 * near.T @ (self.stretch @ near)


@dataclass(frozen=True)
class Pieces:
    """All that does not depend on the sphere's height: stator, mover and how they join."""

    stator: Body
    mover: Body
    stretch: sparse.csr_array  # force = -1/2 a' stretch a on the mover's unknowns
    fixed: np.ndarray  # stator unknowns on the air cylinder
    rim: np.ndarray  # mover unknowns on its outline
    lookup: cKDTree  # of the stator's points
    bore: magmesh.Bore

    def system(self, y: float) -> System:
        """Equations with the sphere's centre at height ``y`` [m], a lattice point."""
        n_stator = self.stator.points.shape[1]
        mover = n_stator + np.arange(self.mover.points.shape[1])
        rim = self.mover.points[:, self.rim] + [[0], [y]]
        distance, mover[self.rim] = self.lookup.query(rim.T)
        if not np.max(distance) < 1e-6 * self.bore.pitch:
            raise SimulationError("mover and lattice do not fit", where="magnetics", got=f"y={y:g}")
        r, height = self.stator.centres
        keep = (r > self.bore.wall) | (np.abs(height - y) > self.bore.half)
        rows = np.hstack([self.stator.rows[:, keep], mover[self.mover.rows]]).ravel()
        cols = np.hstack([self.stator.cols[:, keep], mover[self.mover.cols]]).ravel()
        data = np.hstack([self.stator.local[:, keep], self.mover.local]).ravel()
        n = n_stator + mover.size
        active = np.zeros(n, dtype=bool)
        active[rows] = True
        active[self.fixed] = False
        free = np.flatnonzero(active)
        number = np.cumsum(active) - 1
        both = active[rows] & active[cols]
        entries = (data[both], (number[rows[both]], number[cols[both]]))
        loads = np.zeros((n, 4))
        loads[:n_stator] = self.stator.loads
        loads[mover] += self.mover.loads
        matrix = sparse.coo_array(entries, shape=(free.size, free.size)).tocsc()
        return System(matrix, loads, free, mover, self.stretch)


def assemble(catch: Catch, bore: magmesh.Bore) -> Pieces:
    """Mesh and assemble stator and mover for the lattice ``bore``."""
    stator_mesh = magmesh.stator_mesh(catch, bore)
    mover_mesh, sphere = magmesh.mover_mesh(bore)
    stator = _stator(catch, stator_mesh)
    mover = _mover(catch, mover_mesh, sphere)
    _, low, right, high = magmesh.air(catch)
    r, y = stator.points
    edge = 1e-9 * (high - low)
    fixed = np.flatnonzero((r > right - edge) | (y < low + edge) | (y > high - edge))
    r, y = mover.points
    edge = 1e-6 * bore.pitch
    rim = np.flatnonzero((r > bore.wall - edge) | (np.abs(y) > bore.half - edge))
    stretch = force_form(mover_mesh, sphere, shell_weight(mover_mesh, sphere, rim))
    return Pieces(stator, mover, stretch, fixed, rim, cKDTree(stator.points.T), bore)


def _basis(mesh: MeshTri2, elements: np.ndarray | None = None) -> Basis:
    return Basis(mesh, ElementTriP2(), intorder=_ORDER, elements=elements)


def _body(mesh: MeshTri2, reluctivity: np.ndarray, loads: list[np.ndarray]) -> Body:
    basis = _basis(mesh)
    coo = _stiffness.coo_data(basis)
    rows, cols = coo.indices.reshape(2, -1, mesh.nelements)
    local = coo.data.reshape(-1, mesh.nelements) * reluctivity
    centres = mesh.p[:, mesh.t].mean(axis=1)
    return Body(basis.doflocs, centres, rows, cols, local, np.column_stack(loads))


def _stator(catch: Catch, mesh: MeshTri2) -> Body:
    centres = mesh.p[:, mesh.t].mean(axis=1)
    ring, lower, upper = (_within(part, centres) for part in magmesh.parts(catch))
    reluctivity = np.where(ring, 1 / catch.mu_r, 1.0) / MU0
    coercivity = catch.remanence / (catch.mu_r * MU0)
    loads = [coercivity * _remanence.assemble(_basis(mesh, np.flatnonzero(ring)))]
    loads.append(np.zeros_like(loads[0]))
    for coil, inside in ((catch.lower, lower), (catch.upper, upper)):
        density = catch.turns / ((coil.outer - coil.inner) * coil.height)
        loads.append(density * _current.assemble(_basis(mesh, np.flatnonzero(inside))))
    return _body(mesh, reluctivity, loads)


def _mover(catch: Catch, mesh: MeshTri2, sphere: np.ndarray) -> Body:
    reluctivity = np.where(sphere, 1 / catch.mu_r, 1.0) / MU0
    coercivity = catch.remanence / (catch.mu_r * MU0)
    magnet = coercivity * _remanence.assemble(_basis(mesh, np.flatnonzero(sphere)))
    none = np.zeros_like(magnet)
    return _body(mesh, reluctivity, [none, magnet, none, none])


def shell_weight(mesh: MeshTri2, sphere: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """Weight g at the mover's unknowns: 1 in the sphere, 0 on the ``rim``, harmonic between."""
    basis = _basis(mesh)
    g = np.zeros(basis.N)
    core = np.unique(basis.element_dofs[:, sphere])
    g[core] = 1.0
    return solve(*condense(laplace.assemble(basis), x=g, D=np.union1d(core, rim)))


def force_form(mesh: MeshTri2, sphere: np.ndarray, g: np.ndarray) -> sparse.csr_array:
    """Matrix S of the force ``-1/2 a' S a`` [N], carried by the air where g varies."""
    air = _basis(mesh, np.flatnonzero(~sphere))
    return sparse.csr_array(_stretch.assemble(air, g=air.interpolate(g)) / MU0)


def _within(part: Part, points: np.ndarray) -> np.ndarray:
    left, low, right, high = magmesh.rectangle(part)
    return (points[0] > left) & (points[0] < right) & (points[1] > low) & (points[1] < high)
