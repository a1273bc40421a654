"""Sound pressure levels in decibels, and their reference pressures."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# reference pressures of ISO 1683 [Pa]
GAS_REFERENCE = 20e-6
LIQUID_REFERENCE = 1e-6
SMALLEST_RATIO = 1e-15  # smallest ratio of pressures, because the level of silence is infinite

LEVEL_UNIT = "dB"


class SoundLevel(NamedTuple):
    """Sound pressure level [dB] with its reference pressure [Pa].

    Parameters
    ----------
    reference : float
        Rms pressure [Pa] at 0 dB.
    decibels : float or None
        Level [dB], None if the level is unknown.
    """

    reference: float
    decibels: float | None = None

    @property
    def reference_text(self) -> str:
        """Text that states the reference pressure, such as ``re 20 µPa``."""
        return f"re {1e6 * self.reference:g} µPa"

    @property
    def unit(self) -> str:
        """Unit of the level with its reference pressure, such as ``dB re 20 µPa``."""
        return f"{LEVEL_UNIT} {self.reference_text}"


def compute_level(rms: np.ndarray, reference: float = GAS_REFERENCE) -> np.ndarray:
    """Compute the sound pressure level [dB] of rms pressures [Pa].

    Parameters
    ----------
    rms : ndarray
        Rms pressures [Pa].
    reference : float, default 20 uPa
        Rms pressure [Pa] at 0 dB.

    Returns
    -------
    ndarray
        ``20 log10(rms / reference)``, at least -300 dB.

    Examples
    --------
    >>> print(f"{compute_level(np.array(1.0)):.2f}")
    93.98
    """
    return np.asarray(20 * np.log10(np.maximum(rms / reference, SMALLEST_RATIO)))
