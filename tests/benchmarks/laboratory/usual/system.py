"""One quarter of the chip in the form of the paper's equations, as the usual solvers take it."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from kc2spice.bodies.piezo_stack import stack_device
from kc2spice.fem.piezo.keys import SECTORS, Chip
from kc2spice.linalg.factor import factorise
from kc2spice.rom.linear import Port
from kc2spice.rom.operators import Schur


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


def quarter(kick: Chip) -> PiezoSystem:
    """Of the chip."""
    device = stack_device(kick)
    n, model = SECTORS, device.model
    b, C0, K = model.B[:, -1] / n, model.D[-1, -1] / n, model.K
    k_pV, lift = -device.lift[:, 0] / n, np.zeros(device.lift.shape[0])
    if isinstance(K, Schur):  # undo kc2spice.rom.linear.with_potentials
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
