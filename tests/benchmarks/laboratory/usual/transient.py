"""Sphere against the full model in time: impact and kick with true penalty contact (Fig. 9).

Newmark's average acceleration (beta = 1/4, gamma = 1/2) for chip and sphere together: second
order and free of numerical damping, so the energy balance shows what the contact does.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from laboratory.usual.contact import ContactSurface, resting_forces
from laboratory.usual.newmark import Advance, Chip, LowRank, Refactorise
from laboratory.usual.operator import ShiftedSolver
from laboratory.usual.system import PiezoSystem

Voltage = Callable[[float], float]
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

    ``height`` is that of the sphere's lowest point. ``energy`` maps ``sphere``, ``chip``
    (kinetic and strain, with the open anode's field), ``contact`` (springs), ``damped`` and
    ``supplied`` (by the voltage) to their histories [J]; the first four sum up to the start's
    energy plus ``supplied``, but for the steps in which a spring opens or closes.
    """

    time: np.ndarray
    height: np.ndarray
    velocity: np.ndarray
    ring_force: np.ndarray
    spring_displacement: np.ndarray
    energy: dict[str, np.ndarray]
    factorisations: int
    wall_s: float

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
    voltage: Voltage | None,
    resting: bool = False,
    road: Road = "low_rank",
    progress: Callable[[float], None] | None = None,
) -> TransientResult:
    """Integrate chip and sphere from rest to ``stop`` in equal steps.

    ``voltage`` None leaves the anode open (Q = 0), else it is V(t), zero at the start.
    ``resting`` starts from the static equilibrium of the sphere lying on the chip, else the chip
    is undeformed. Every step solves

        (M + h/2 E + h^2/4 K) a = b V - E v* - K u* - W f,     m c = sum(f) - m g,
        f = penalty max(0, W'u - y - gap),     u = u* + h^2/4 a,     y = y* + h^2/4 c

    to the exact set of closed springs. Both roads give the same result.

    Raises
    ------
    SimulationError : the set of closed springs does not settle.
    """
    start = time.perf_counter()
    chip = Chip(system, surface, ball.mass, step, voltage is None)
    advance = LowRank(chip) if road == "low_rank" else Refactorise(chip)
    state = _rest(chip, ball) if resting else _at_start(chip, ball)
    count = round(stop / step)
    volts = np.array([voltage(k * step) if voltage else 0.0 for k in range(count + 1)])
    record = _Record(chip, ball.gravity, count)
    record.add(0, state, state, volts)
    for k in range(1, count + 1):
        new = _step(chip, advance, state, ball.gravity, volts[k])
        record.add(k, state, new, volts)
        state = new
        if progress:
            progress(k / count)
    return record.result(time.perf_counter() - start)


def _step(chip: Chip, advance: Advance, state: _State, gravity: float, volts: float) -> _State:
    h, quarter, shapes = chip.step, chip.quarter, chip.surface.shapes
    u = state.u + h * state.v + quarter * state.a
    v = state.v + h / 2 * state.a
    y, w, c = state.ball
    y, w = y + h * w + quarter * c, w + h / 2 * c
    load = chip.b * volts - chip.damping(v) - chip.stiff(u)
    a, c, force = advance(load, -gravity, shapes.T @ u - y - chip.surface.gap)
    ball = np.array([y + quarter * c, w + h / 2 * c, c])
    return _State(u + quarter * a, v + h / 2 * a, a, ball, force)


def _at_start(chip: Chip, ball: Ball) -> _State:
    zero = np.zeros(chip.b.size)
    sphere = np.array([ball.height, ball.velocity, -ball.gravity])
    return _State(zero, zero, zero, sphere, np.zeros(len(chip.surface.gap)))


def _rest(chip: Chip, ball: Ball) -> _State:
    """The sphere's weight on the closed springs, everything at rest."""
    shapes, count = chip.surface.shapes, len(chip.surface.gap)
    answers = ShiftedSolver(chip.system, 0.0, 1.0).solve(np.column_stack([shapes, chip.b]))
    W, unit = answers[:, :count], answers[:, count]
    if chip.open:
        W = W - np.outer(unit, chip.b @ W) / (chip.capacitance + chip.b @ unit)
    weight = ball.mass * ball.gravity
    force, y = resting_forces(shapes.T @ W, chip.surface.gap, chip.surface.penalty, weight)
    zero = np.zeros(len(W))
    return _State(-W @ force, zero, zero, np.array([y, 0.0, 0.0]), force)


class _Record:
    """Histories, and the energies that belong to average acceleration."""

    def __init__(self, chip: Chip, gravity: float, count: int) -> None:
        self.chip, self.gravity = chip, gravity
        self.ball = np.zeros((count + 1, 3))
        self.force = np.zeros((count + 1, len(chip.surface.gap)))
        self.spring = np.zeros_like(self.force)
        names = ("sphere", "chip", "contact", "damped", "supplied")
        self.energy = {name: np.zeros(count + 1) for name in names}

    def add(self, k: int, old: _State, new: _State, volts: np.ndarray) -> None:
        chip, energy = self.chip, self.energy
        self.ball[k], self.force[k] = new.ball, new.force
        self.spring[k] = chip.surface.shapes.T @ new.u
        y, w, _ = new.ball
        energy["sphere"][k] = chip.mass * (w**2 / 2 + self.gravity * y)
        energy["chip"][k] = (new.v @ (chip.system.M @ new.v) + new.u @ chip.stiff(new.u)) / 2
        energy["contact"][k] = np.sum(new.force**2 / chip.surface.penalty) / 2
        if k:
            mean = (old.v + new.v) / 2
            loss = chip.step * (mean @ chip.damping(mean))
            work = (volts[k - 1] + volts[k]) / 2 * (chip.b @ (new.u - old.u))
            energy["damped"][k] = energy["damped"][k - 1] + loss
            energy["supplied"][k] = energy["supplied"][k - 1] + work

    def result(self, wall: float) -> TransientResult:
        return TransientResult(
            time=self.chip.step * np.arange(len(self.ball)),
            height=self.ball[:, 0],
            velocity=self.ball[:, 1],
            ring_force=self.chip.surface.per_ring(self.force),
            spring_displacement=self.spring,
            energy=self.energy,
            factorisations=self.chip.factorisations,
            wall_s=wall,
        )
