"""Low-pass filter of the sound pressure in a netlist, and its compensation.

The pressure at the pin ``sound`` is proportional to the time derivative of a volume velocity. With
the trapezoidal rule, a plain derivative oscillates forever after each kink of the volume velocity:
``v[n+1] = 2 L (i[n+1] - i[n]) / h - v[n]``. A resistor ``R = w L / sqrt(2)`` and a capacitor ``C =
1 / (w^2 L)`` parallel to the inductance L prevent the oscillation. The impedance of R, C and L in
parallel is ``s L`` times a second-order low pass with the corner frequency w.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

# Corner frequency of the low pass, divided by the largest frequency of the radiation network.
# With this ratio, the amplitude is 0.6 % too small at the largest frequency, and 0.04 % at half
# this frequency.
CORNER_RATIO = 3.0


def compute_low_pass_delay(corner: float) -> float:
    """Return the low-pass delay [s] at frequencies far below ``corner`` [rad/s]."""
    return math.sqrt(2) / corner


def delay_wave(
    time: np.ndarray, wave: np.ndarray, delays: Iterable[tuple[float, float]]
) -> np.ndarray:
    """Delay copies of a waveform by different times, and return their weighted sum.

    ``delays`` contains pairs of a weight and a delay [s]. ``wave`` has the shape (points,) and is
    interpolated between its points. ``wave`` is zero before its first point, and constant after its
    last point.
    """
    from scipy.interpolate import Akima1DInterpolator  # loads slowly

    times, index = np.unique(time, return_index=True)
    total = np.zeros(time.size)
    if times.size < 2:
        return total
    curve = Akima1DInterpolator(times, wave[index])
    for weight, delay in delays:
        origin = np.minimum(time - delay, times[-1])
        inside = origin >= times[0]
        total[inside] += weight * curve(origin[inside])
    return total
