"""One quarter of the chip in the form of the paper's equations, as the usual solvers take it."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from kc2spice.bodies.stack import make_stack
from kc2spice.bodies.stack_keys import SECTORS
from kc2spice.linalg.factor import factorise
from kc2spice.rom.linear_model import Port
from kc2spice.rom.pencil import SchurComplement


@dataclass(frozen=True)
class PiezoSystem:
    """Voltage-driven piezoelectric FE model before the potentials are eliminated.

    With displacements ``u`` (n), free internal potentials ``p`` (m, may be 0) and the prescribed
    anode voltage ``V``::

        M u'' + E u' + K_uu u + K_up p + k_uV V = B f
                        K_up' u - K_pp p - k_pV V = 0
                    Q = c_VV V + k_pV' p - k_uV' u

    ``E = alpha M + beta K`` where ``K`` is the stiffness with the potentials eliminated (paper eq.
    1 and 2). All values are those of one of ``sectors``.
    """

    M: sparse.csc_array
    K_uu: sparse.csc_array
    K_up: sparse.csc_array
    K_pp: sparse.csc_array
    k_uV: np.ndarray
    k_pV: np.ndarray
    c_VV: float
    B: np.ndarray
    ports: tuple[Port, ...]
    alpha: float
    beta: float
    sectors: int = SECTORS


def quarter(kick):
    """Quarter model of the chip."""
    device = make_stack(kick)
    n, model = SECTORS, device.model
    b, C0, K = model.B[:, -1] / n, model.D[-1, -1] / n, model.K
    k_pV, lift = -device.lift[:, 0] / n, np.zeros(device.lift.shape[0])
    if isinstance(K, SchurComplement):  # undo kc2spice.rom.linear_model.make_piezoelectric_model
        K_uu, K_up, K_pp = K.uu / n, K.up / n, -K.pp / n
        lift = factorise(sparse.csc_array(K_pp), definite=True).solve(k_pV)
    else:
        K_uu, K_up, K_pp = K / n, sparse.csc_array((len(b), 0)), sparse.csc_array((0, 0))
    assert model.rayleigh is not None
    alpha, beta = model.rayleigh
    return PiezoSystem(
        M=model.M / n, K_uu=K_uu, K_up=K_up, K_pp=K_pp, k_uV=K_up @ lift - b, k_pV=k_pV,
        c_VV=float(C0 + k_pV @ lift), B=model.B[:, :-1], ports=model.ports, alpha=alpha, beta=beta,
    )  # fmt: skip


def electrical_port(system):
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


def stiffness(system, potentials, u):
    """``K u`` for one or several displacement fields (short-circuited anode)."""
    force = system.K_uu @ u
    if potentials is not None:
        force = force + system.K_up @ potentials.solve(system.K_up.T @ u)
    return force


def solver(system, a, c, b, open_by):
    """Inverse of ``a M + c K + open_by b b'`` on forces (n,) or (n, k).

    K = K_uu + K_up K_pp^-1 K_up' is dense where potentials are free, so it lives as the pair
    (displacement, potential); the last term is that of an open anode.
    """
    matrix, count = c * system.K_uu + a * system.M if a else c * system.K_uu, system.K_pp.shape[0]
    if count:
        # A unit of potential that makes both diagonal blocks equally large.
        volt = np.sqrt(system.K_uu.diagonal().max() / system.K_pp.diagonal().max())
        K_up, K_pp = c * volt * system.K_up, c * volt**2 * system.K_pp
        matrix = sparse.block_array([[matrix, K_up], [K_up.T, -K_pp]])
    factor = factorise(sparse.csc_array(matrix), definite=not count)

    def solve(force):
        free = np.zeros((count, *force.shape[1:]))
        return factor.solve(np.concatenate([force, free]))[: force.shape[0]]

    if not open_by:
        return solve
    b = np.pad(b, (0, system.M.shape[0] - b.size))
    unit = solve(b)
    weight = open_by / (1 + open_by * (b @ unit))

    def solve_open(force):
        x = solve(force)
        return x - np.multiply.outer(unit, weight * (b @ x))

    return solve_open


def stiffened(system, shapes, penalty):
    """The model with ``shapes diag(penalty) shapes'`` added to K_uu."""
    springs = sparse.csc_array(shapes * np.sqrt(penalty))
    return replace(system, K_uu=sparse.csc_array(system.K_uu + springs @ springs.T))
