"""Imprint of the sphere into the full model, statically (paper 3.2, Fig. 8)."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy import sparse

from kc2spice.bodies.pressure import ITERATIONS, contact_forces
from laboratory.usual.contact import ContactSurface, unsettled
from laboratory.usual.operator import ShiftedSolver, electrical_port
from laboratory.usual.system import PiezoSystem

Electrical = Literal["open", "short"]


@dataclass(frozen=True)
class ImprintResult:
    """Contact force of the sector against imprint; SI.

    ``depth`` (steps,), ``force`` (steps,), ``ring_force`` (steps, rings), ``iterations`` (steps,)
    those that factorised the model.
    """

    depth: np.ndarray
    force: np.ndarray
    ring_force: np.ndarray
    iterations: np.ndarray


def imprint(
    system: PiezoSystem, surface: ContactSurface, depth: np.ndarray, electrical: Electrical = "open"
) -> ImprintResult:
    """One factorisation: contact is a small problem in the compliance between the springs.

    ``G = W' K^-1 W`` (springs, springs) with W the shapes, on the open anode less the part that
    its voltage takes back: ``x x' / (C0 + b' K^-1 b)`` with ``x = W' K^-1 b``.
    """
    b, capacitance, _ = electrical_port(system)
    answers = ShiftedSolver(system, 0.0, 1.0).solve(np.column_stack([surface.shapes, b]))
    G = surface.shapes.T @ answers[:, :-1]
    if electrical == "open":
        x = surface.shapes.T @ answers[:, -1]
        G = G - np.outer(x, x) / (capacitance + b @ answers[:, -1])
    G = 0.5 * (G + G.T)
    force = np.array([contact_forces(G, d - surface.gap, surface.penalty) for d in depth])
    return _result(surface, depth, force, np.zeros(len(depth)))


def imprint_refactorised(
    system: PiezoSystem, surface: ContactSurface, depth: np.ndarray, electrical: Electrical = "open"
) -> ImprintResult:
    """The usual code: closed springs join the stiffness matrix, factorised in every iteration.

    Here the anode of an open model is a rank-one term. Equals :func:`imprint` to rounding.
    """
    b, capacitance, _ = electrical_port(system)
    closed = np.zeros(surface.gap.size, dtype=bool)
    forces, iterations = [], []
    for d in depth:
        for count in range(1, ITERATIONS + 1):
            shapes = surface.shapes[:, closed]
            springs = surface.penalty[closed]
            solver = ShiftedSolver(stiffened(system, shapes, springs), 0.0, 1.0)
            load = shapes @ (springs * (surface.gap[closed] - d))
            u, unit = solver.solve(np.column_stack([load, b])).T
            if electrical == "open":
                u = u - unit * (b @ u) / (capacitance + b @ unit)
            penetration = surface.shapes.T @ u + d - surface.gap
            now = penetration > 0
            if np.array_equal(now, closed):
                forces.append(surface.penalty * np.maximum(penetration, 0))
                iterations.append(count)
                break
            closed = now
        else:
            raise unsettled()
    return _result(surface, depth, np.array(forces), np.array(iterations))


def stiffened(system: PiezoSystem, shapes: np.ndarray, penalty: np.ndarray) -> PiezoSystem:
    """The model with ``shapes diag(penalty) shapes'`` added to K_uu."""
    springs = sparse.csc_array(shapes * np.sqrt(penalty))
    return replace(system, K_uu=sparse.csc_array(system.K_uu + springs @ springs.T))


def _result(
    surface: ContactSurface, depth: np.ndarray, force: np.ndarray, iterations: np.ndarray
) -> ImprintResult:
    return ImprintResult(depth, force.sum(axis=1), surface.per_ring(force), iterations)
