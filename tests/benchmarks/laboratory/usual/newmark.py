"""One time step of chip and sphere: accelerations under contact, on two roads."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from scipy import sparse

from kc2spice.bodies.pressure import ITERATIONS, contact_forces
from laboratory.usual.contact import ContactSurface, unsettled
from laboratory.usual.operator import ShiftedSolver, electrical_port, stiffness
from laboratory.usual.statics import stiffened
from laboratory.usual.system import PiezoSystem


class Advance(Protocol):
    """``(load, fall, penetration) -> (a, c, force)``: accelerations at the end of the step.

    ``load`` (n,) is the chip's force without contact, ``fall`` the sphere's acceleration without
    it, ``penetration`` the springs' compression that the predictors alone would give.
    """

    def __call__(
        self, load: np.ndarray, fall: float, penetration: np.ndarray
    ) -> tuple[np.ndarray, float, np.ndarray]: ...


@dataclass
class Chip:
    """The chip in one time step of length ``step``; ``open`` leaves the anode without charge."""

    system: PiezoSystem
    surface: ContactSurface
    mass: float
    step: float
    open: bool
    factorisations: int = 0
    b: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.b, self.capacitance, self.potentials = electrical_port(self.system)
        self.quarter = self.step**2 / 4
        self.a = 1 + self.system.alpha * self.step / 2
        self.c = self.system.beta * self.step / 2 + self.quarter

    def stiff(self, u: np.ndarray) -> np.ndarray:
        """Elastic force, with the field that an open anode builds up."""
        force = stiffness(self.system, self.potentials, u)
        return force + self.b * (self.b @ u / self.capacitance) if self.open else force

    def damping(self, v: np.ndarray) -> np.ndarray:
        """``E v`` with ``E = alpha M + beta K`` (short-circuit K)."""
        force = self.system.beta * stiffness(self.system, self.potentials, v)
        return force + self.system.alpha * (self.system.M @ v) if self.system.alpha else force

    def solver(self, system: PiezoSystem) -> Callable[[np.ndarray], np.ndarray]:
        """Inverse of ``M + h/2 E + h^2/4 K`` for this or a bordered system."""
        self.factorisations += 1
        solve = ShiftedSolver(system, self.a, self.c).solve
        if not self.open:
            return solve
        b = np.pad(self.b, (0, system.M.shape[0] - self.b.size))
        unit = solve(b)
        weight = 1 / (self.capacitance / self.quarter + b @ unit)

        def solve_open(rhs: np.ndarray) -> np.ndarray:
            x = solve(rhs)
            return x - np.multiply.outer(unit, weight * (b @ x))

        return solve_open


class LowRank:
    """Accelerations by one factorisation: contact lives in the compliance between the springs."""

    def __init__(self, chip: Chip) -> None:
        self.chip, self.solve = chip, chip.solver(chip.system)
        self.answers = self.solve(chip.surface.shapes)
        G = chip.surface.shapes.T @ self.answers
        self.compliance = chip.quarter * (0.5 * (G + G.T) + 1 / chip.mass)

    def __call__(
        self, load: np.ndarray, fall: float, penetration: np.ndarray
    ) -> tuple[np.ndarray, float, np.ndarray]:
        chip = self.chip
        a = self.solve(load)
        free = penetration + chip.quarter * (chip.surface.shapes.T @ a - fall)
        force = contact_forces(self.compliance, free, chip.surface.penalty)
        return a - self.answers @ force, fall + force.sum() / chip.mass, force


class Refactorise:
    """Accelerations the usual way: closed springs join the matrix, the sphere is its last row."""

    def __init__(self, chip: Chip) -> None:
        self.chip = chip
        self.bordered = _with_sphere(chip.system, chip.mass / chip.a)
        count = len(chip.surface.gap)
        self.shapes = np.vstack([chip.surface.shapes, -np.ones(count)])
        self.closed = np.zeros(count, dtype=bool)

    def __call__(
        self, load: np.ndarray, fall: float, penetration: np.ndarray
    ) -> tuple[np.ndarray, float, np.ndarray]:
        chip, penalty = self.chip, self.chip.surface.penalty
        for _ in range(ITERATIONS):
            shapes, springs = self.shapes[:, self.closed], penalty[self.closed]
            system = stiffened(self.bordered, shapes, springs * (chip.quarter / chip.c))
            rhs = np.append(load, chip.mass * fall)
            rhs -= shapes @ (springs * penetration[self.closed])
            x = chip.solver(system)(rhs)
            reached = penetration + chip.quarter * (self.shapes.T @ x)
            if np.array_equal(reached > 0, self.closed):
                return x[:-1], x[-1], penalty * np.maximum(reached, 0)
            self.closed = reached > 0
        raise unsettled()


def _with_sphere(system: PiezoSystem, mass: float) -> PiezoSystem:
    """One more degree of freedom, the sphere's, numbered last: next to the top plane."""
    last = sparse.csc_array((1, system.K_up.shape[1]))
    return replace(
        system,
        M=sparse.csc_array(sparse.block_diag([system.M, [[mass]]])),
        K_uu=sparse.csc_array(sparse.block_diag([system.K_uu, [[0.0]]])),
        K_up=sparse.csc_array(sparse.vstack([system.K_up, last])),
    )
