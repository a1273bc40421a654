"""The piezoelectric model with its potentials eliminated: symmetric, positive definite, implicit.

Projecting ``[u; potentials]`` as it stands is an indefinite problem whose reduced models can be
unstable. Eliminating the potentials of the *full* model first (exactly) leaves

    M u'' + E u' + K u = b u_in,   y = b' u + D u_in,   K = K_uu + K_up K_pp^-1 K_up',

a passive mechanical problem, whatever the projection. ``K`` is dense where potentials are free,
so it exists only as the pair (u, p). Source: Schur complement before reduction, cf. paper 2.3 and
its references 47 to 49, which apply it afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from kc2spice.fem.factor import Factor, factorise
from kc2spice.fem.system import PiezoSystem


@dataclass(frozen=True)
class CondensedSystem:
    """Mechanical model of a :class:`PiezoSystem`; the anode voltage is one more input.

    Attributes
    ----------
    system : the model before elimination.
    B : (n, ports) input and output vectors: ring shapes, then ``-(k_uV - K_up K_pp^-1 k_pV)``.
    D : (ports, ports) feed-through: the clamped capacitance at the anode, zero elsewhere.
    potentials : factor of K_pp, None where no potential is free.
    stiffness_factor : factor of K_uu, or of ``[[K_uu, K_up], [K_up', -K_pp]]``.
    """

    system: PiezoSystem
    B: np.ndarray
    D: np.ndarray
    potentials: Factor | None
    stiffness_factor: Factor

    @property
    def M(self) -> sparse.csc_array:
        """Mass matrix (n, n)."""
        return self.system.M

    def stiffness(self, u: np.ndarray) -> np.ndarray:
        """``K u`` for one or several displacement fields."""
        force = self.system.K_uu @ u
        if self.potentials is not None:
            force = force + self.system.K_up @ self.potentials.solve(self.system.K_up.T @ u)
        return force

    def solve(self, force: np.ndarray) -> np.ndarray:
        """``K^-1 force``: static displacement with the anode shorted to ground."""
        if self.potentials is None:
            return self.stiffness_factor.solve(force)
        rhs = np.concatenate([force, np.zeros((self.system.K_pp.shape[0], *force.shape[1:]))])
        return self.stiffness_factor.solve(rhs)[: force.shape[0]]


def condense(system: PiezoSystem) -> CondensedSystem:
    """Eliminate the free potentials and the anode charge equation.

    With ``p = K_pp^-1 (K_up' u - k_pV V)`` the charge becomes ``Q = b' u + C0 V`` where
    ``C0 = c_VV - k_pV' K_pp^-1 k_pV > 0`` is the clamped capacitance.

    Raises
    ------
    SimulationError : the model is not positive definite (unsupported, or an impossible material).
    """
    b, capacitance = -system.k_uV, system.c_VV
    if system.K_pp.shape[0] == 0:
        potentials = None
        factor = factorise(system.K_uu, definite=True)
    else:
        potentials = factorise(system.K_pp, definite=True)
        lift = potentials.solve(system.k_pV)
        b = b + system.K_up @ lift
        capacitance = capacitance - float(system.k_pV @ lift)
        # A unit of potential that makes both diagonal blocks equally large.
        volt = float(np.sqrt(system.K_uu.diagonal().max() / system.K_pp.diagonal().max()))
        K_up, K_pp = system.K_up * volt, system.K_pp * volt**2
        coupled = sparse.block_array([[system.K_uu, K_up], [K_up.T, -K_pp]], format="csc")
        factor = factorise(coupled, definite=False)
    D = np.zeros((len(system.ports),) * 2)
    D[-1, -1] = capacitance
    return CondensedSystem(system, np.column_stack([system.B, b]), D, potentials, factor)
