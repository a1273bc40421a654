"""Weak forms of axisymmetric magnetostatics and their element matrices (scikit-fem).

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
from skfem import Basis, BilinearForm, ElementTriP2, LinearForm, MeshTri2, condense, solve
from skfem.models.poisson import laplace

from kc2spice.fem.magnetics import mesh as magmesh
from kc2spice.fem.magnetics.keys import Catch, Ring

MU0 = 4e-7 * pi
RING, SPHERE, LOWER, UPPER = range(4)  # columns of loads and of the fields that they make
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
    loads: np.ndarray  # (n, 4): ring and sphere magnet, 1 A in the lower and in the upper coil


def stator_body(catch: Catch, mesh: MeshTri2) -> Body:
    """Ring magnet, coils and air."""
    centres = mesh.p[:, mesh.t].mean(axis=1)
    ring, lower, upper = (_within(part, centres) for part in magmesh.parts(catch))
    magnet = _magnet_load(catch, mesh, ring)
    loads = [magnet, np.zeros_like(magnet)]
    for coil, inside in ((catch.lower, lower), (catch.upper, upper)):
        density = catch.turns / ((coil.outer - coil.inner) * coil.height)
        loads.append(density * _current.assemble(_basis(mesh, np.flatnonzero(inside))))
    return _body(catch, mesh, ring, loads)


def mover_body(catch: Catch, mesh: MeshTri2, sphere: np.ndarray) -> Body:
    """Sphere magnet and the air in its box; ``sphere`` marks the sphere's triangles."""
    magnet = _magnet_load(catch, mesh, sphere)
    none = np.zeros_like(magnet)
    return _body(catch, mesh, sphere, [none, magnet, none, none])


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


def _basis(mesh: MeshTri2, elements: np.ndarray | None = None) -> Basis:
    return Basis(mesh, ElementTriP2(), intorder=_ORDER, elements=elements)


def _magnet_load(catch: Catch, mesh: MeshTri2, inside: np.ndarray) -> np.ndarray:
    coercivity = catch.remanence / (catch.mu_r * MU0)
    return coercivity * _remanence.assemble(_basis(mesh, np.flatnonzero(inside)))


def _body(catch: Catch, mesh: MeshTri2, magnet: np.ndarray, loads: list[np.ndarray]) -> Body:
    basis = _basis(mesh)
    coo = _stiffness.coo_data(basis)
    rows, cols = coo.indices.reshape(2, -1, mesh.nelements)
    reluctivity = np.where(magnet, 1 / catch.mu_r, 1.0) / MU0
    local = coo.data.reshape(-1, mesh.nelements) * reluctivity
    centres = mesh.p[:, mesh.t].mean(axis=1)
    return Body(basis.doflocs, centres, rows, cols, local, np.column_stack(loads))


def _within(part: Ring, points: np.ndarray) -> np.ndarray:
    left, low, right, high = magmesh.rectangle(part)
    return (points[0] > left) & (points[0] < right) & (points[1] > low) & (points[1] < high)
