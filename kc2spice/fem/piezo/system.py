"""One symmetry sector of a piezoelectric FE model, as the full-model solvers take it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kc2spice.rom.linear import Port

if TYPE_CHECKING:
    from scipy import sparse


@dataclass(frozen=True)
class PiezoSystem:
    """Voltage-driven piezoelectric FE model before the potentials are eliminated.

    With displacements ``u`` (n), free internal potentials ``p`` (m, may be 0) and the prescribed
    anode voltage ``V``::

        M u'' + E u' + K_uu u + K_up p + k_uV V = B f
                        K_up' u - K_pp p - k_pV V = 0
                    Q = c_VV V + k_pV' p - k_uV' u

    ``M``, ``K_uu`` and ``K_pp`` are symmetric positive (semi-)definite, ``E = alpha M + beta K``
    where ``K`` is the stiffness with the potentials eliminated (paper eq. 1 and 2).
    All values are those of the modelled symmetry sector in SI; ``sectors`` of them make the device.
    Row ``i`` of ``B'`` averages the displacement of ring ``i`` with the weights of its force shape.
    ``mass`` is that of the sector before constraints. ``shift`` [rad^2/s^2] is 0 where something
    holds the body, else what makes ``K + shift M`` regular.
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
    sectors: int
    ring_radii: np.ndarray
    mass: float
    shift: float = 0.0

    @property
    def unknowns(self) -> int:
        """Equations of the paper's form (1): displacements, internal potentials, one anode."""
        return self.M.shape[0] + self.K_pp.shape[0] + 1
