"""Sphere against the full model in time: impact with true penalty contact (Fig. 9).

Newmark's average acceleration (beta = 1/4, gamma = 1/2) for chip and sphere together: second
order and free of numerical damping.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from laboratory.usual.contact import ContactSurface
from laboratory.usual.newmark import Advance, Chip, LowRank, Refactorise
from laboratory.usual.system import PiezoSystem

Road = Literal["low_rank", "refactorise"]


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

    @property
    def force(self) -> np.ndarray:
        """Total contact force of the sector [N]."""
        return self.ring_force.sum(axis=1)


class _State(NamedTuple):
    """Chip displacement, velocity, acceleration; the same of the sphere; spring forces."""

    u: np.ndarray
    v: np.ndarray
    a: np.ndarray
    ball: np.ndarray
    force: np.ndarray


def transient(
    system: PiezoSystem,
    surface: ContactSurface,
    ball: Ball,
    *,
    step: float,
    stop: float,
    is_open: bool,
    road: Road = "low_rank",
) -> TransientResult:
    """Integrate chip and sphere from rest to ``stop`` in equal steps, the chip undeformed at first.

    ``is_open`` leaves the anode without charge, else it is at 0 V. Every step solves

        (M + h/2 E + h^2/4 K) a = -E v* - K u* - W f,     m c = sum(f) - m g,
        f = penalty max(0, W'u - y - gap),     u = u* + h^2/4 a,     y = y* + h^2/4 c

    to the exact set of closed springs. Both roads give the same result.

    Raises
    ------
    SimulationError : the set of closed springs does not settle.
    """
    chip = Chip(system, surface, ball.mass, step, is_open)
    advance = LowRank(chip) if road == "low_rank" else Refactorise(chip)
    state = _at_start(chip, ball)
    heights, forces, springs = [], [], []
    for k in range(round(stop / step) + 1):
        if k:
            state = _step(chip, advance, state, ball.gravity)
        heights.append(state.ball)
        forces.append(state.force)
        springs.append(surface.shapes.T @ state.u)
    height, velocity, _ = np.array(heights).T
    return TransientResult(
        time=step * np.arange(len(heights)),
        height=height,
        velocity=velocity,
        ring_force=surface.per_ring(np.array(forces)),
        spring_displacement=np.array(springs),
        factorisations=chip.factorisations,
    )


def _step(chip: Chip, advance: Advance, state: _State, gravity: float) -> _State:
    h, quarter, shapes = chip.step, chip.quarter, chip.surface.shapes
    u = state.u + h * state.v + quarter * state.a
    v = state.v + h / 2 * state.a
    y, w, c = state.ball
    y, w = y + h * w + quarter * c, w + h / 2 * c
    load = -chip.damping(v) - chip.stiff(u)
    a, c, force = advance(load, -gravity, shapes.T @ u - y - chip.surface.gap)
    ball = np.array([y + quarter * c, w + h / 2 * c, c])
    return _State(u + quarter * a, v + h / 2 * a, a, ball, force)


def _at_start(chip: Chip, ball: Ball) -> _State:
    zero = np.zeros(chip.b.size)
    sphere = np.array([ball.height, ball.velocity, -ball.gravity])
    return _State(zero, zero, zero, sphere, np.zeros(len(chip.surface.gap)))
