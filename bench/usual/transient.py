"""Sphere against the full model in time: impact with true penalty contact (Fig. 9).

Newmark's average acceleration (beta = 1/4, gamma = 1/2) for chip and sphere together: second
order and free of numerical damping.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from bench.statics import contact_forces
from bench.usual.contact import settled
from bench.usual.system import electrical_port, solver, stiffened, stiffness


@dataclass(frozen=True)
class Ball:
    """The sphere as one sector sees it: its share of the ``mass`` [kg], the ``height`` [m] of its
    lowest point over the undeformed top, ``velocity`` [m/s], ``gravity`` [m/s^2] downwards."""

    mass: float
    height: float
    velocity: float
    gravity: float = 0.0


@dataclass(frozen=True)
class TransientResult:
    """Histories (steps + 1, ...) of the modelled sector in SI.

    ``height`` is that of the sphere's lowest point.
    """

    time: np.ndarray
    height: np.ndarray
    velocity: np.ndarray
    ring_force: np.ndarray
    spring_displacement: np.ndarray
    factorisations: int


class _Chip:
    """The chip in one time step; ``is_open`` leaves the anode without charge."""

    def __init__(self, system, surface, mass, step, is_open):
        self.system, self.surface, self.mass = system, surface, mass
        self.b, capacitance, self.potentials = electrical_port(system)
        self.open_by, self.quarter, self.factorisations = is_open / capacitance, step**2 / 4, 0
        self.a = 1 + system.alpha * step / 2
        self.c = system.beta * step / 2 + self.quarter

    def load(self, u, v):
        """``-E v - K u`` with ``E = alpha M + beta K``, and with the field of an open anode."""
        system = self.system
        force = stiffness(system, self.potentials, system.beta * v + u)
        return -force - system.alpha * (system.M @ v) - self.open_by * (self.b @ u) * self.b

    def inverse(self, system):
        """Inverse of ``M + h/2 E + h^2/4 K`` for this or a bordered system."""
        self.factorisations += 1
        return solver(system, self.a, self.c, self.b, self.open_by * self.quarter)


def _low_rank(chip):
    """Accelerations by one factorisation: contact lives in the compliance between the springs."""
    solve, shapes = chip.inverse(chip.system), chip.surface.shapes
    answers = solve(shapes)
    G = shapes.T @ answers
    compliance = chip.quarter * (0.5 * (G + G.T) + 1 / chip.mass)

    def advance(load, fall, penetration):
        a = solve(load)
        free = penetration + chip.quarter * (shapes.T @ a - fall)
        force = contact_forces(compliance, chip.surface.penalty, free[None])[0]
        return a - answers @ force, fall + force.sum() / chip.mass, force

    return advance


def _refactorise(chip):
    """Accelerations the usual way: closed springs join the matrix, the sphere is its last row."""
    system, mass, last = chip.system, chip.mass / chip.a, chip.system.K_up.shape[1]
    bordered = replace(  # numbered last: next to the top plane
        system,
        M=sparse.csc_array(sparse.block_diag([system.M, [[mass]]])),
        K_uu=sparse.csc_array(sparse.block_diag([system.K_uu, [[0.0]]])),
        K_up=sparse.csc_array(sparse.vstack([system.K_up, sparse.csc_array((1, last))])),
    )
    penalty, start = chip.surface.penalty, np.zeros(chip.surface.gap.size, dtype=bool)
    all_shapes = np.vstack([chip.surface.shapes, -np.ones(penalty.size)])

    def advance(load, fall, penetration):
        nonlocal start

        def solve(closed):
            shapes, springs = all_shapes[:, closed], penalty[closed]
            stiff = stiffened(bordered, shapes, springs * (chip.quarter / chip.c))
            rhs = np.append(load, chip.mass * fall) - shapes @ (springs * penetration[closed])
            x = chip.inverse(stiff)(rhs)
            return x, penetration + chip.quarter * (all_shapes.T @ x)

        x, reached, _ = settled(start, solve)
        start = reached > 0
        return x[:-1], x[-1], penalty * np.maximum(reached, 0)

    return advance


METHODS = {"low_rank": _low_rank, "refactorise": _refactorise}


def transient(system, surface, ball, *, step, stop, is_open, method="low_rank"):
    """Integrate chip and sphere from rest to ``stop`` in equal steps, the chip undeformed at first.

    ``is_open`` leaves the anode without charge, else it is at 0 V. Every step solves

        (M + h/2 E + h^2/4 K) a = -E v* - K u* - W f,     m c = sum(f) - m g,
        f = penalty max(0, W'u - y - gap),     u = u* + h^2/4 a,     y = y* + h^2/4 c

    to the exact set of closed springs. Both methods give the same result.
    """
    chip = _Chip(system, surface, ball.mass, step, is_open)
    advance, W = METHODS[method](chip), surface.shapes
    u, v, a = np.zeros((3, chip.b.size))
    y, w, c, force = ball.height, ball.velocity, -ball.gravity, np.zeros(surface.gap.size)
    rows = [(y, w, force, W.T @ u)]
    for _ in range(round(stop / step)):
        u, v = u + step * v + chip.quarter * a, v + step / 2 * a
        y, w = y + step * w + chip.quarter * c, w + step / 2 * c
        a, c, force = advance(chip.load(u, v), -ball.gravity, W.T @ u - y - surface.gap)
        u, v = u + chip.quarter * a, v + step / 2 * a
        y, w = y + chip.quarter * c, w + step / 2 * c
        rows.append((y, w, force, W.T @ u))
    histories = map(np.array, zip(*rows, strict=True))
    return TransientResult(step * np.arange(len(rows)), *histories, chip.factorisations)
