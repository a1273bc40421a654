"""Imprint of the sphere into the full model, statically (paper 3.2, Fig. 8)."""

from dataclasses import dataclass

import numpy as np

from bench.statics import contact_forces
from bench.usual.contact import settled
from bench.usual.system import electrical_port, solver, stiffened


@dataclass(frozen=True)
class ImprintResult:
    """Contact force [N] of the sector's rings (steps, rings), and how often each step factorised
    the model."""

    ring_force: np.ndarray
    iterations: np.ndarray

    @property
    def force(self):
        """Total contact force of the sector [N] (steps,)."""
        return self.ring_force.sum(axis=1)


def imprint(system, surface, depth, electrical="open"):
    """One factorisation: contact is a small problem in the compliance between the springs,
    ``W' K^-1 W`` (springs, springs) with W the shapes, less what an open anode takes.
    """
    b, capacitance, _ = electrical_port(system)
    inverse = solver(system, 0.0, 1.0, b, (electrical == "open") / capacitance)
    G = surface.shapes.T @ inverse(surface.shapes)
    G = 0.5 * (G + G.T)
    force = contact_forces(G, surface.penalty, depth[:, None] - surface.gap)
    return ImprintResult(force, np.zeros(len(depth)))


def imprint_refactorised(system, surface, depth, electrical="open"):
    """The usual code: closed springs join the stiffness matrix, factorised in every iteration.

    Here the anode of an open model is a rank-one term. Equals :func:`imprint` to rounding.
    """
    b, capacitance, _ = electrical_port(system)
    closed = np.zeros(surface.gap.size, dtype=bool)
    forces, iterations = [], []
    for d in depth:

        def solve(closed, d=d):
            shapes, springs = surface.shapes[:, closed], surface.penalty[closed]
            stiff = stiffened(system, shapes, springs)
            inverse = solver(stiff, 0.0, 1.0, b, (electrical == "open") / capacitance)
            u = inverse(shapes @ (springs * (surface.gap[closed] - d)))
            return u, surface.shapes.T @ u + d - surface.gap

        _, penetration, count = settled(closed, solve)
        closed = penetration > 0
        forces.append(surface.penalty * np.maximum(penetration, 0))
        iterations.append(count)
    return ImprintResult(np.array(forces), np.array(iterations))
