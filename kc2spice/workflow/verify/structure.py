"""Stability, passivity and reciprocity of a reduced model, by its form and over frequency."""

from __future__ import annotations

import numpy as np

from kc2spice.report.verdict import Check
from kc2spice.rom.modal import Resonators

# Rounding of a response that sums some thirty modes; a violation by structure is of order one.
ROUNDING = 1e-12


def structure_checks(model: Resonators, frequency: np.ndarray) -> list[Check]:
    """Poles in the left half plane, ``Re (s H)`` positive semi-definite, ``H`` symmetric.

    ``s H`` maps forces and voltages to velocities and currents; a network is passive if its
    Hermitian part has no negative eigenvalue at any frequency. Values are relative to the largest
    entry, so that a sound model shows rounding only.
    """
    frequency = frequency[frequency > 0]
    H = model.transfer(frequency)
    balance = np.sqrt(np.abs(np.diagonal(H, axis1=1, axis2=2)).max(axis=0))
    H = H / np.outer(balance, balance)
    Y = 2j * np.pi * frequency[:, None, None] * H
    hermitian = (Y + Y.conj().transpose(0, 2, 1)) / 2
    lowest = np.linalg.eigvalsh(hermitian)[:, 0] / np.abs(Y).max(axis=(1, 2))
    asymmetry = np.abs(H - H.transpose(0, 2, 1)).max() / np.abs(H).max()
    rightmost = float((-model.damp / (2 * model.omega)).max())
    return [
        Check("rightmost pole over its frequency", rightmost, 0.0),
        Check("active power over all frequencies", float(max(0.0, -lowest.min())), ROUNDING),
        Check("reciprocity", float(asymmetry), ROUNDING),
    ]
