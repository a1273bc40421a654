"""Frictionless penalty contact of a rigid sphere with the chip's top face (paper 2.2.2, eq. 3-5).

The contact law is piecewise linear, so a semi-smooth Newton method on the few contact forces ends
after finitely many active sets, at the exact solution.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from kc2spice.bodies.piezo_stack import free_displacements, ring_shapes
from kc2spice.bodies.pressure import ITERATIONS
from kc2spice.core.errors import SimulationError
from kc2spice.fem.piezo.keys import Chip
from kc2spice.fem.piezo.mesh import kick_mesh
from kc2spice.rom.linear import LinearModel
from laboratory.usual.system import PiezoSystem


@dataclass(frozen=True)
class ContactSurface:
    """Contact springs of the modelled sector.

    Spring ``j`` feels the displacement ``shapes[:, j]' u`` and acts along ``-shapes[:, j]`` with
    ``penalty[j] * max(0, shapes' u - y - gap[j])``, ``y`` the height of the sphere's lowest point
    over the undeformed top. ``ring[j]`` is the ring that the spring belongs to.
    """

    shapes: np.ndarray
    gap: np.ndarray
    penalty: np.ndarray
    ring: np.ndarray

    def per_ring(self, force: np.ndarray) -> np.ndarray:
        """Sum spring forces (..., springs) over each ring, (..., rings)."""
        return force @ (self.ring[:, None] == np.arange(self.ring.max() + 1))


def sphere_gap(radius: float, distance: np.ndarray) -> np.ndarray:
    """Height of a sphere's surface over its lowest point at a distance from the axis (exact)."""
    return distance**2 / (radius + np.sqrt(radius**2 - distance**2))


def contact_surface(
    kick: Chip, stiffness: float, radius: float, *, per_node: bool = False
) -> ContactSurface:
    """One spring per ring (paper 2.3, grouped forces), or one per node with the ring's share.

    ``stiffness`` [N/m] is that of a ring of the sector in both cases, ``radius`` [m] the sphere's;
    nodes on a symmetry
    plane get half of their neighbours' share.
    """
    mesh = kick_mesh(kick)
    free = free_displacements(mesh, kick)
    rings = np.column_stack([each.weights[free] for each in ring_shapes(mesh, kick.poling)])
    radii = kick.mesh.ring_spacing * np.arange(rings.shape[1])
    if not per_node:
        penalty = np.full(rings.shape[1], stiffness)
        return ContactSurface(rings, sphere_gap(radius, radii), penalty, np.arange(len(radii)))
    dof, ring = np.nonzero(rings)
    shapes = np.zeros((rings.shape[0], dof.size))
    shapes[dof, np.arange(dof.size)] = 1.0
    return ContactSurface(
        shapes, sphere_gap(radius, radii[ring]), stiffness * rings[dof, ring], ring
    )


def resting_forces(
    compliance: np.ndarray, gap: np.ndarray, penalty: np.ndarray, weight: float
) -> tuple[np.ndarray, float]:
    """Spring forces under a sphere of given weight at rest, and the height of its lowest point.

    On the closed springs ``(compliance + 1/penalty) f + y = -gap`` and ``sum(f) = weight``.

    Raises
    ------
    SimulationError : no set of closed springs repeats within the limit.
    """
    closed = gap <= gap.min()
    for _ in range(ITERATIONS):
        index = np.flatnonzero(closed)
        matrix = np.ones((len(index) + 1,) * 2)
        matrix[:-1, :-1] = compliance[np.ix_(index, index)] + np.diag(1 / penalty[index])
        matrix[-1, -1] = 0.0
        *closed_force, height = np.linalg.solve(matrix, np.append(-gap[index], weight))
        force = np.zeros_like(gap)
        force[index] = closed_force
        now = -compliance @ force - height - gap > 0
        if np.array_equal(now, closed):
            return force, float(height)
        closed = now
    raise unsettled()


def unsettled() -> SimulationError:
    """The error of a semi-smooth Newton iteration that visits ever new sets."""
    return SimulationError(
        "contact does not settle",
        where="semi-smooth Newton",
        got=f"{ITERATIONS} different sets of closed springs",
        expected="a set that repeats",
        hint="the sphere may move too far in one step: make the step smaller",
    )


def as_system(rom: LinearModel, full: PiezoSystem) -> PiezoSystem:
    """The reduced device as one sector in the form that the full-model solvers take: states for
    displacements. Like :func:`laboratory.usual.system.quarter_of`."""
    n = full.sectors
    return replace(
        full,
        M=sparse.csc_array(rom.M / n),
        K_uu=sparse.csc_array(rom.K / n),
        K_up=sparse.csc_array((rom.order, 0)),
        K_pp=sparse.csc_array((0, 0)),
        k_uV=-rom.B[:, -1] / n,
        k_pV=np.zeros(0),
        c_VV=float(rom.D[-1, -1]) / n,
        B=rom.B[:, :-1],
    )


def on_reduced(surface: ContactSurface, rom: LinearModel) -> ContactSurface:
    """A surface with one spring per ring, as the reduced model's ring ports see it."""
    return replace(surface, shapes=rom.B[:, :-1])
