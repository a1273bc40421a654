"""Solves with ``a M + c K`` where K is the stiffness with the internal potentials eliminated.

Statics (a = 0, c = 1) and time steps need this one operator. K = K_uu + K_up K_pp^-1 K_up' is dense
where potentials are free, so it lives as the pair (displacement, potential).
"""

import numpy as np
from scipy import sparse

from kc2spice.linalg.factor import Factor, factorise
from laboratory.usual.system import PiezoSystem


def electrical_port(system: PiezoSystem) -> tuple[np.ndarray, float, Factor | None]:
    """``b`` (n,), clamped capacitance C0 [F] and the factor of K_pp (None without potentials).

    With ``p = K_pp^-1 (K_up' u - k_pV V)`` the model becomes ``M u'' + E u' + K u = B f + b V``
    and ``Q = b' u + C0 V``, where ``b = -(k_uV - K_up K_pp^-1 k_pV)`` and
    ``C0 = c_VV - k_pV' K_pp^-1 k_pV > 0``.
    """
    if system.K_pp.shape[0] == 0:
        return -system.k_uV, system.c_VV, None
    potentials = factorise(system.K_pp, definite=True)
    lift = potentials.solve(system.k_pV)
    capacitance = system.c_VV - float(system.k_pV @ lift)
    return system.K_up @ lift - system.k_uV, capacitance, potentials


def stiffness(system: PiezoSystem, potentials: Factor | None, u: np.ndarray) -> np.ndarray:
    """``K u`` for one or several displacement fields (short-circuited anode)."""
    force = system.K_uu @ u
    if potentials is not None:
        force = force + system.K_up @ potentials.solve(system.K_up.T @ u)
    return force


class ShiftedSolver:
    """Factorised ``a M + c K`` with ``a >= 0`` and ``c > 0``.

    Raises
    ------
    SimulationError : singular, or not definite.
    """

    def __init__(self, system: PiezoSystem, a: float, c: float) -> None:
        matrix = c * system.K_uu + a * system.M if a else c * system.K_uu
        self._potentials = system.K_pp.shape[0]
        if self._potentials:
            # A unit of potential that makes both diagonal blocks equally large.
            volt = np.sqrt(system.K_uu.diagonal().max() / system.K_pp.diagonal().max())
            K_up, K_pp = c * volt * system.K_up, c * volt**2 * system.K_pp
            matrix = sparse.block_array([[matrix, K_up], [K_up.T, -K_pp]])
        self._factor = factorise(sparse.csc_array(matrix), definite=not self._potentials)

    def solve(self, force: np.ndarray) -> np.ndarray:
        """Displacements (n,) or (n, k) under the forces."""
        if not self._potentials:
            return self._factor.solve(force)
        free = np.zeros((self._potentials, *force.shape[1:]))
        return self._factor.solve(np.concatenate([force, free]))[: force.shape[0]]
