"""Negative control: projecting displacements and voltages as one vector loses stability.

The charge-driven model in ``x = [u; p; V]`` has the indefinite stiffness

    [[K_uu, K_up, k_uV], [K_up', -K_pp, -k_pV], [k_uV', -k_pV', -c_VV]]

and a mass that ends at u. A one-sided Krylov projection mixes the three in every state, and the
reduced pencil no longer is a passive network (paper 2.3, its references 47 to 49). Nothing uses
this method; it shows why :func:`kc2spice.rom.linear.with_potentials` eliminates them first.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.linalg import eigvals

from kc2spice.fem.piezo.system import PiezoSystem
from kc2spice.linalg.factor import factorise
from kc2spice.rom.krylov import block_arnoldi


def naive_poles(system: PiezoSystem, order: int) -> np.ndarray:
    """Finite poles [1/s] of the one-sided projection of the full indefinite system."""
    n, m = system.M.shape[0], system.K_pp.shape[0]
    k_uV, k_pV = (sparse.csc_array(k[:, None]) for k in (system.k_uV, system.k_pV))
    stiffness = sparse.block_array(
        [
            [system.K_uu, system.K_up, k_uV],
            [system.K_up.T, -system.K_pp, -k_pV],
            [k_uV.T, -k_pV.T, [[-system.c_VV]]],
        ]
    )
    volt = np.sqrt(system.K_uu.diagonal().max() / system.c_VV)
    units = sparse.diags_array(np.r_[np.ones(n), np.full(m + 1, volt)])
    stiffness = sparse.csc_array(units @ stiffness @ units)
    empty = sparse.csc_array((m + 1, m + 1))
    mass = sparse.csc_array(sparse.block_diag([system.M, empty]))
    damping = sparse.csc_array(sparse.block_diag([system.beta * system.K_uu, empty]))
    inputs = np.zeros((n + m + 1, len(system.ports)))
    inputs[:n, :-1], inputs[-1, -1] = system.B, -volt
    solve = factorise(stiffness, definite=False).solve
    V = block_arnoldi(lambda x: x, solve, lambda x: mass @ x, inputs, order)
    return _poles(*(V.T @ (matrix @ V) for matrix in (mass, damping, stiffness)))


def _poles(M: np.ndarray, E: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Finite roots of det(s^2 M + s E + K), time scaled to microseconds for conditioning."""
    q, tau = len(M), 1e-6
    zero, one = np.zeros((q, q)), np.eye(q)
    scale = 1 / np.abs(K).max()
    left = np.block([[zero, one], [-K * scale, -E * scale / tau]])
    right = np.block([[one, zero], [zero, M * scale / tau**2]])
    values = eigvals(left, right)
    return values[np.isfinite(values) & (np.abs(values) < 1e12 * tau)] / tau
