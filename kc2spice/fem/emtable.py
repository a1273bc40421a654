"""Force and flux of the catch actuator as six functions of the sphere's position."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class EMTable:
    """Result of the magnetostatic FE sweep; exact in the currents because materials are linear.

    With the currents ``i1`` (lower coil) and ``i2`` (upper coil) at position ``y``::

        F(y, i1, i2) = c0 + c1 i1 + c2 i2 + c11 i1^2 + c12 i1 i2 + c22 i2^2
        lambda_k(y, i1, i2) = flux0[:, k] + sum_l inductance[:, k, l] i_l

    ``y`` (n,) is the height of the sphere's centre above the kick actuator's top [m], forces in
    N, flux linkages in Wb, inductances in H, coil resistances in Ohm. A positive current gives
    B_y > 0 on the axis; the sphere's moment points to +y.
    """

    y: np.ndarray
    c0: np.ndarray
    c1: np.ndarray
    c2: np.ndarray
    c11: np.ndarray
    c12: np.ndarray
    c22: np.ndarray
    flux0: np.ndarray  # (n, 2)
    inductance: np.ndarray  # (n, 2, 2)
    resistance: np.ndarray  # (2,)
    unknowns: int
