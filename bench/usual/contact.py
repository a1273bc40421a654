"""Frictionless penalty contact of a rigid sphere with the chip's top face (paper 2.2.2, eq. 3-5).

The contact law is piecewise linear, so a semi-smooth Newton method on the few contact forces ends
after finitely many active sets, at the exact solution.
"""

from dataclasses import dataclass

import numpy as np

from kc2spice.bodies.stack import make_stack_setup
from kc2spice.core.errors import SimulationError

ITERATIONS = 60  # of the closed springs


@dataclass(frozen=True)
class ContactSurface:
    """Contact springs of the modelled sector, one for each ring.

    Spring ``j`` feels the displacement ``shapes[:, j]' u`` and acts along ``-shapes[:, j]`` with
    ``penalty[j] * max(0, shapes' u - y - gap[j])``, ``y`` the height of the sphere's lowest point
    over the undeformed top.
    """

    shapes: np.ndarray
    gap: np.ndarray
    penalty: np.ndarray


def sphere_gap(radius, distance):
    """Height of a sphere's surface over its lowest point at a distance from the axis (exact)."""
    return distance**2 / (radius + np.sqrt(radius**2 - distance**2))


def contact_surface(kick, stiffness, radius):
    """One spring per ring (paper 2.3, grouped forces).

    ``stiffness`` [N/m] is that of a ring of the sector, ``radius`` [m] the sphere's.
    """
    _, setup = make_stack_setup(kick)
    rings = np.column_stack([each.weights[~setup.fixed] for each in setup.shapes])
    radii = kick.mesh.ring_spacing * np.arange(rings.shape[1])
    gap, penalty = sphere_gap(radius, radii), np.full(radii.size, stiffness)
    return ContactSurface(rings, gap, penalty)


def settled(closed, solve):
    """What ``solve(closed)`` gives, and the springs' penetration, which it gives too, where the set
    of closed springs repeats; how often it was asked.

    Raises
    ------
    SimulationError : it visits ever new sets.
    """
    for count in range(1, ITERATIONS + 1):
        answer, penetration = solve(closed)
        now = penetration > 0
        if np.array_equal(now, closed):
            return answer, penetration, count
        closed = now
    raise SimulationError(
        "contact does not settle", where="semi-smooth Newton",
        got=f"{ITERATIONS} different sets of closed springs", expected="a set that repeats",
        hint="the sphere may move too far in one step: make the step smaller",
    )  # fmt: skip
