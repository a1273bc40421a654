"""What the form of a reduced model proves: stability and passivity without a single frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.rom.operators import largest
from kc2spice.rom.pencil import Pencil

# Rounding of a congruence: a semi-definite matrix may show eigenvalues this far below zero.
ROUNDING = 1e-12
# Growth by e in a hundred million radians is rounding of an eigenvalue on the imaginary axis.
GROWTH = 1e-8


@dataclass(frozen=True)
class Structure:
    """``stable``: no pole right of the imaginary axis, so no growing motion (a free rigid body
    drifts, it does not grow exponentially). ``passive``: the ports cannot deliver net energy.
    ``proof`` says what either rests on.
    """

    stable: bool
    passive: bool
    proof: str


def structure(pencil: Pencil, band: tuple[float, float]) -> Structure:
    """Stability and passivity of a dense pencil, from its form where the form shows it.

    Second order with M, K symmetric positive semi-definite and ``E + E' >= 0`` (gyroscopic terms
    are skew) loses energy at most; with ``C = B'`` and D >= 0 it is passive between force and
    velocity, voltage and current. First order with E symmetric positive semi-definite and
    ``A + A' <= 0`` likewise, passive between input and output. Without such form the poles decide
    on stability, and passivity is not claimed.
    """
    rest = pencil.coefficients[0]
    inertia = pencil.coefficients[-1]
    damping = pencil.coefficients[1] if pencil.degree == 2 else rest
    dissipative = semidefinite(inertia) and semidefinite(damping + damping.T)
    if pencil.degree == 2:
        dissipative = dissipative and semidefinite(rest)
    if dissipative:
        passive = pencil.collocated and semidefinite(pencil.D + pencil.D.T)
        return Structure(True, passive, "definite matrices")
    omega = 2 * np.pi * band[1]
    values = pencil.poles(omega)
    limit = GROWTH * np.maximum(np.abs(values), omega)
    return Structure(bool((values.real <= limit).all()), False, "poles")


def semidefinite(matrix: np.ndarray) -> bool:
    """Symmetric without an eigenvalue below zero, but for rounding."""
    if matrix.size == 0:
        return True
    if largest(matrix - matrix.T) > ROUNDING * largest(matrix):
        return False
    values = np.linalg.eigvalsh(matrix)
    return bool(values[0] >= -ROUNDING * abs(values[-1]))
