"""The piezoelectric model with its potentials eliminated: symmetric, positive definite, implicit.

Projecting ``[u; potentials]`` as it stands is an indefinite problem whose reduced models can be
unstable. Eliminating the potentials of the *full* model first (exactly) leaves

    M u'' + E u' + K u = B u_in,   y = B' u + D u_in,   K = K_uu + K_up K_pp^-1 K_up',

a passive mechanical problem, whatever the projection. Source: Schur complement before reduction,
cf. paper 2.3 and its references 47 to 49, which apply it afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from kc2spice.fem.piezo.operator import ShiftedSolver, electrical_port, stiffness
from kc2spice.fem.piezo.system import PiezoSystem
from kc2spice.linalg.factor import Factor


@dataclass(frozen=True)
class CondensedSystem:
    """Mechanical model of a :class:`PiezoSystem`; the anode voltage is one more input.

    Attributes
    ----------
    system : the model before elimination.
    B : (n, ports) input and output vectors: ring shapes, then the electrical one.
    D : (ports, ports) feed-through: the clamped capacitance at the anode, zero elsewhere.
    potentials : factor of K_pp, None where no potential is free.
    static : solver with K.
    """

    system: PiezoSystem
    B: np.ndarray
    D: np.ndarray
    potentials: Factor | None
    static: ShiftedSolver

    @property
    def M(self) -> sparse.csc_array:
        """Mass matrix (n, n)."""
        return self.system.M

    def mass(self, u: np.ndarray) -> np.ndarray:
        """``M u``."""
        return self.system.M @ u

    def stiffness(self, u: np.ndarray) -> np.ndarray:
        """``K u`` for one or several displacement fields."""
        return stiffness(self.system, self.potentials, u)

    def solve(self, force: np.ndarray) -> np.ndarray:
        """``K^-1 force``: static displacement with the anode shorted to ground."""
        return self.static.solve(force)


def condense(system: PiezoSystem) -> CondensedSystem:
    """Eliminate the free potentials and the anode's charge equation.

    Raises
    ------
    SimulationError : the model is not positive definite (unsupported, or an impossible material).
    """
    b, capacitance, potentials = electrical_port(system)
    D = np.zeros((len(system.ports),) * 2)
    D[-1, -1] = capacitance
    B = np.column_stack([system.B, b])
    return CondensedSystem(system, B, D, potentials, ShiftedSolver(system, 0.0, 1.0))


def with_rings(model: CondensedSystem, count: int) -> CondensedSystem:
    """``model`` with the first ``count`` of its ring ports, the centre's first, and the anode.

    Elimination and factor do not depend on the ports, so they are shared.
    """
    keep = [*range(count), len(model.system.ports) - 1]
    system = replace(
        model.system,
        B=model.system.B[:, :count],
        ports=tuple(model.system.ports[k] for k in keep),
        ring_radii=model.system.ring_radii[:count],
    )
    return replace(model, system=system, B=model.B[:, keep], D=model.D[np.ix_(keep, keep)])
