"""The catch actuator's force, flux and inductance, swept over the sphere's height.

Axisymmetric magnetostatics (scikit-fem). The unknown is ``a = A_phi / r``, smooth and even in r, so
the axis needs no condition. With ``b(a) = 2 a + r da/dr`` the field is ``B_y = b(a)``, ``B_r = -r
da/dy`` and the potential energy ::

    P(a) = 1/2 int nu (B_r^2 + B_y^2) dV - int nu B_rem b(a) dV - int J r a dV,   dV = 2 pi r dr dy

is least at the solution; ``a = 0`` on the air cylinder (paper 2.2.1). The force on the sphere is
``-dP/dy`` with the air around it stretched by a weight g (1 on the sphere, 0 on the mover's
outline): virtual work of the discrete energy, which equals the Maxwell stress averaged over a thick
shell (Henrotte, Deliege, Hameyer: The eggshell approach, COMPEL 23(4), 2004).

Materials are linear, so at each height the four sources (ring magnet, sphere magnet, a current in
each coil) superpose: one factorisation and four right-hand sides give every current (paper 2.2.1
solves 369 cases instead). All elements are assembled once; at each height the lattice's cells make
way for the mover.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree
from skfem import Basis, BilinearForm, ElementTriP2, LinearForm, MeshTri2, condense, solve
from skfem.models.poisson import laplace

from kc2spice.core.errors import SimulationError
from kc2spice.core.magnets import EMTable
from kc2spice.core.quantities import MU_0
from kc2spice.fem import magnet_mesh as magmesh
from kc2spice.fem.magnet_keys import Catch, Ring
from kc2spice.linalg.factor import Cholesky, Factor

RING, SPHERE, LOWER, UPPER = range(4)  # columns of loads and of the fields that they make
Progress = Callable[[int, int], None]


def catch_table(catch: Catch, radius: float, progress: Progress | None = None) -> EMTable:
    """Sweep the sphere over ``catch.positions`` heights from ``y_min`` to ``y_max``.

    ``progress(done, total)`` is called after each height.

    Raises
    ------
    UsageError : the sphere leaves the air cylinder, or a part is higher.
    SimulationError : a field that does not satisfy its equations.
    """
    y = positions(catch)
    forces = np.empty((y.size, 4, 4))
    fluxes = np.empty((y.size, 2, 4))
    unknowns = 0
    for done, (index, system) in enumerate(systems(catch, radius), 1):
        fields = system.solve(system.loads)
        forces[index] = system.force(fields)
        fluxes[index] = (system.loads.T @ fields)[[LOWER, UPPER]]
        unknowns = max(unknowns, system.free.size)
        if progress is not None:
            progress(done, y.size)
    sign = ring_sign(catch)
    inductance = fluxes[:, :, [LOWER, UPPER]]
    length = [catch.turns * pi * (c.inner + c.outer) for c in (catch.lower, catch.upper)]
    magnets = sign * forces[:, RING] + forces[:, SPHERE]  # cross terms with both magnets
    return EMTable(
        y=y,
        c0=forces[:, RING, RING] + forces[:, SPHERE, SPHERE] + 2 * sign * forces[:, RING, SPHERE],
        c1=2 * magnets[:, LOWER],
        c2=2 * magnets[:, UPPER],
        c11=forces[:, LOWER, LOWER],
        c12=2 * forces[:, LOWER, UPPER],
        c22=forces[:, UPPER, UPPER],
        flux0=sign * fluxes[:, :, RING] + fluxes[:, :, SPHERE],
        inductance=(inductance + inductance.transpose(0, 2, 1)) / 2,
        resistance=catch.resistivity * np.array(length) / (pi * catch.wire_diameter**2 / 4),
        unknowns=unknowns,
    )


def positions(catch: Catch) -> np.ndarray:
    """Heights of the sphere's centre [m] that the table has."""
    return np.linspace(catch.y_min, catch.y_max, catch.positions)


def ring_sign(catch: Catch) -> float:
    """Direction of the ring's magnetisation relative to the sphere's, which is +y."""
    return 1.0 if catch.polarity == "parallel" else -1.0


@dataclass(frozen=True)
class System:
    """Equations at one height: ``matrix a = loads`` on the ``free`` unknowns of all n."""

    matrix: sparse.csc_array
    loads: np.ndarray  # (n, 4)
    free: np.ndarray
    mover: np.ndarray  # unknowns of the mover
    stretch: sparse.csr_array  # force = -1/2 a' stretch a on them

    def solve(self, loads: np.ndarray) -> np.ndarray:
        """Fields (n, k) of the loads (n, k).

        Raises
        ------
        SimulationError : the fields do not satisfy their equations.
        """
        a, matrix = np.zeros(loads.shape), self.matrix
        norm = float(sparse.linalg.norm(matrix, 1))
        # Minimum degree: an order by nested dissection would cost more than these factors.
        factor = Factor(matrix, norm, Cholesky(matrix, None).solve)
        a[self.free] = factor.solve(loads[self.free])
        return a

    def force(self, a: np.ndarray) -> np.ndarray:
        """Symmetric (k, k) [N]: fields ``a`` (n, k) of amplitudes q push with ``q' force q``."""
        near = a[self.mover]
        return -0.5 * near.T @ (self.stretch @ near)


def systems(catch: Catch, radius: float) -> Iterator[tuple[int, System]]:
    """Index and equations of each height; heights on one lattice share their meshes."""
    y = positions(catch)
    pitch = magmesh.lattice_pitch(catch, radius, (y[-1] - y[0]) / (y.size - 1))
    offset = np.round((y - y[0]) / pitch, 6) % 1.0
    for value in np.unique(offset):
        chosen = np.flatnonzero(offset == value)
        bore = magmesh.bore(catch, radius, pitch, y[chosen[0]], y[chosen[-1]])
        pieces = assemble(catch, bore)
        yield from ((int(index), pieces.system(y[index])) for index in chosen)


@dataclass(frozen=True)
class Body:
    """Element matrices of one mesh: ``local[:, e]`` goes to ``rows[:, e]``, ``cols[:, e]``."""

    points: np.ndarray  # (2, n): places of the unknowns [m]
    centres: np.ndarray  # (2, elements)
    rows: np.ndarray
    cols: np.ndarray
    local: np.ndarray
    loads: np.ndarray  # (n, 4): ring and sphere magnet, 1 A in the lower and in the upper coil


@dataclass(frozen=True)
class Pieces:
    """All that does not depend on the sphere's height: stator, mover and how they join."""

    stator: Body
    mover: Body
    stretch: sparse.csr_array
    movable: np.ndarray  # mask of the stator's elements that may make way
    free: np.ndarray  # mask of the stator's unknowns that are not on the air cylinder
    rim: np.ndarray  # mover unknowns on its outline
    lookup: cKDTree  # of the stator's points
    bore: magmesh.Bore

    def system(self, y: float) -> System:
        """Equations with the sphere's centre at height ``y`` [m], a lattice point."""
        inner, count = self.stator, self.stator.points.shape[1]
        mover = count + np.arange(self.mover.points.shape[1])
        rim = self.mover.points[:, self.rim] + [[0], [y]]
        distance, mover[self.rim] = self.lookup.query(rim.T)
        if not np.max(distance) < 1e-6 * self.bore.pitch:
            raise SimulationError("mover and lattice do not fit", where="magnetics", got=f"y={y:g}")
        keep = ~(self.movable & (np.abs(inner.centres[1] - y) < self.bore.half))
        row = np.concatenate([inner.rows[:, keep].ravel(), mover[self.mover.rows].ravel()])
        col = np.concatenate([inner.cols[:, keep].ravel(), mover[self.mover.cols].ravel()])
        data = np.concatenate([inner.local[:, keep].ravel(), self.mover.local.ravel()])
        n = count + self.mover.points.shape[1]
        active = np.zeros(n, dtype=bool)
        active[row] = True
        active[:count] &= self.free
        free, number = np.flatnonzero(active), np.cumsum(active) - 1
        both = active[row] & active[col]
        places = (number[row[both]], number[col[both]])
        matrix = sparse.coo_array((data[both], places), shape=(free.size, free.size))
        loads = np.zeros((n, 4))
        loads[:count] = inner.loads
        loads[mover] += self.mover.loads
        return System(matrix.tocsc(), loads, free, mover, self.stretch)


def assemble(catch: Catch, bore: magmesh.Bore) -> Pieces:
    """Mesh and assemble stator and mover for the lattice ``bore``."""
    mesh, sphere = magmesh.mover_mesh(bore)
    mover = _body(catch, mesh, sphere, {SPHERE: (_remanence, _coercivity(catch), sphere)})
    r, y = mover.points
    edge = 1e-6 * bore.pitch
    rim = np.flatnonzero((r > bore.wall - edge) | (np.abs(y) > bore.half - edge))
    stretch = _stretched(mesh, sphere, rim)

    mesh = magmesh.stator_mesh(catch, bore)
    centres = mesh.p[:, mesh.t].mean(axis=1)
    ring, *coils = (_within(part, centres) for part in magmesh.parts(catch))
    sources = {RING: (_remanence, _coercivity(catch), ring)}
    for column, coil, inside in zip((LOWER, UPPER), (catch.lower, catch.upper), coils, strict=True):
        density = catch.turns / ((coil.outer - coil.inner) * coil.height)
        sources[column] = (_current, density, inside)
    stator = _body(catch, mesh, ring, sources)
    r, y = centres
    movable = (r < bore.wall) & (y > bore.bottom) & (y < bore.bottom + bore.rows * bore.pitch)
    _, low, right, high = magmesh.air(catch)
    r, y = stator.points
    edge = 1e-9 * (high - low)
    free = (r < right - edge) & (y > low + edge) & (y < high - edge)
    return Pieces(stator, mover, stretch, movable, free, rim, cKDTree(stator.points.T), bore)


def _body(
    catch: Catch,
    mesh: MeshTri2,
    magnet: np.ndarray,
    sources: dict[int, tuple[LinearForm, float, np.ndarray]],
) -> Body:
    """A mesh with a ``magnet`` and its ``sources`` by column: form, size, elements."""
    basis = _basis(mesh)
    loads = np.zeros((basis.N, 4))
    for column, (form, size, inside) in sources.items():
        loads[:, column] = size * form.assemble(_basis(mesh, np.flatnonzero(inside)))
    coo = _stiffness.coo_data(basis)
    rows, cols = coo.indices.reshape(2, -1, mesh.nelements)
    reluctivity = np.where(magnet, 1 / catch.mu_r, 1.0) / MU_0
    local = coo.data.reshape(-1, mesh.nelements) * reluctivity
    centres = mesh.p[:, mesh.t].mean(axis=1)
    return Body(basis.doflocs, centres, rows, cols, local, loads)


def _stretched(mesh: MeshTri2, sphere: np.ndarray, rim: np.ndarray) -> sparse.csr_array:
    """Matrix S of the force ``-1/2 a' S a`` [N], carried by the air where the weight g varies: 1 in
    the sphere, 0 on the ``rim``, harmonic between."""
    basis = _basis(mesh)
    g = np.zeros(basis.N)
    core = np.unique(basis.element_dofs[:, sphere])
    g[core] = 1.0
    g = solve(*condense(laplace.assemble(basis), x=g, D=np.union1d(core, rim)))
    air = _basis(mesh, np.flatnonzero(~sphere))
    return sparse.csr_array(_stretch.assemble(air, g=air.interpolate(g)) / MU_0)


def _basis(mesh: MeshTri2, elements: np.ndarray | None = None) -> Basis:
    """The integrands on straight triangles are polynomials of degree 5."""
    return Basis(mesh, ElementTriP2(), intorder=6, elements=elements)


def _coercivity(catch: Catch) -> float:
    return catch.remanence / (catch.mu_r * MU_0)


def _within(part: Ring, points: np.ndarray) -> np.ndarray:
    left, low, right, high = magmesh.rectangle(part)
    return (points[0] > left) & (points[0] < right) & (points[1] > low) & (points[1] < high)


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
