"""Far fields of radiating surfaces, with directivity and travel time.

The input is the far-field pressure on the axis at 1 m, which a netlist computes versus frequency or
time. The output is the far-field pressure at a listener's distance and angle. A piston of the
radius a in a baffle has the directivity D and the impulse response d

    D(omega) = 2 J1(omega w) / (omega w),          w = a sin(angle) / c
    d(t)     = 2 / (pi w) (1 - (t / w)^2)^1/2,     |t| < w

at an angle from its axis (L. E. Kinsler et al., Fundamentals of Acoustics, 4th ed., section 7.4).
d(t) is the inverse Fourier transform of D. d(t) is the fraction of the surface, per unit time,
whose sound arrives at the time t.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from kc2spice.core.constitutive_laws import compute_low_pass_response
from kc2spice.parts.acoustics._sound_filter import compute_low_pass_delay, delay_wave
from kc2spice.parts.acoustics.radiation import RadiationKeys

# Number of delays at which d(t) is sampled. The weighted sum is exact for polynomials up to the
# degree 63.
# For a sine with omega w = 30, the error of the weighted sum is below 1e-9.
DELAY_COUNT = 32
FIRST_NULL = 3.8317  # first zero of J1


def get_baffled_radius(keys: RadiationKeys) -> float:
    """Return the radius [m] of a piston in a baffle; 0 for other shapes.

    In this model, only the shape ``baffled_piston`` has a directivity, which depends on the radius.
    """
    return keys.surface_radius if keys.shape == "baffled_piston" else 0.0


def compute_edge_lead(keys: RadiationKeys, angle: float) -> float:
    """Return the lead [s] of sound from a piston's edge over sound from its centre.

    A listener at ``angle`` degrees from the axis of a piston in a baffle first receives the sound
    from the nearest point of the piston's edge. The sound from the centre of the piston arrives
    later than the sound from the edge, by the returned time. For other shapes than a piston in a
    baffle, 0 is returned.
    """
    return get_baffled_radius(keys) * math.sin(math.radians(angle)) / keys.fluid.sound_speed


def find_first_null(surfaces: Iterable[RadiationKeys], angle: float) -> float:
    """Return the lowest frequency [Hz] at which the directivity is zero, rounded."""
    delay = max(compute_edge_lead(keys, angle) for keys in surfaces)
    return float(f"{FIRST_NULL / (2 * math.pi * delay):.3g}")


def compute_travel_time(keys: RadiationKeys, distance: float) -> float:
    """Return the travel time [s] of sound from a surface to a ``distance`` [m].

    ``distance`` starts at the centre of the surface. The sound of a sphere starts at the surface of
    the sphere. The sound of any other shape starts at the centre of its surface.
    """
    start = keys.surface_radius if keys.shape == "sphere" else 0.0
    return (distance - start) / keys.fluid.sound_speed


def propagate_response(
    keys: RadiationKeys, sound: np.ndarray, frequency: np.ndarray, distance: float, angle: float
) -> np.ndarray:
    """Propagate a pressure response to a listener, without the decay with distance.

    The pressure [Pa] at the listener is multiplied by the factor (``distance`` / 1 m). The
    ``distance`` [m] is measured from the source to the listener, and the ``angle`` [degrees] from
    the axis of the source. ``sound`` is the on-axis pressure response at 1 m that the netlist
    computes, including its low pass, an array of shape (frequencies,).
    """
    s = 2j * np.pi * frequency
    travel = np.exp(-s * compute_travel_time(keys, distance)) / compute_low_pass_response(
        s, keys.sound_corner
    )
    return sound * travel * compute_directivity(keys, angle, frequency)


def propagate_wave(
    keys: RadiationKeys, sound: np.ndarray, time: np.ndarray, distance: float, angle: float
) -> np.ndarray:
    """Propagate a pressure waveform to a listener, without the decay with distance.

    The pressure [Pa] at the listener is multiplied by the factor (``distance`` / 1 m). The
    ``distance`` [m] is measured from the source to the listener, and the ``angle`` [degrees] from
    the axis of the source. ``sound`` is the waveform of the on-axis pressure at 1 m that the
    netlist computes, an array of shape (points,). The waveform is zero before its first point. The
    travel time is reduced by the delay of the low pass.
    """
    first = compute_travel_time(keys, distance) - compute_low_pass_delay(keys.sound_corner)
    weights, offsets = _sample_delays(compute_edge_lead(keys, angle))
    return delay_wave(time, sound, zip(weights, first + offsets, strict=True))


def _sample_delays(width: float) -> tuple[np.ndarray, np.ndarray]:
    """Return weights and delays [s] for a piston's approximate impulse response.

    The weights and delays come from the Gauss-Chebyshev rule of the second kind.
    """
    if width == 0.0:
        return np.ones(1), np.zeros(1)
    angles = np.pi * np.arange(1, DELAY_COUNT + 1) / (DELAY_COUNT + 1)
    return 2 / (DELAY_COUNT + 1) * np.sin(angles) ** 2, width * np.cos(angles)


def compute_directivity(keys: RadiationKeys, angle: float, frequency: np.ndarray) -> np.ndarray:
    """Return the pressure at an angle [degrees], divided by the pressure on the axis.

    For a piston in a baffle, the ratio is ``2 J1(x) / x`` with ``x = k a sin(angle)``.
    """
    delay = compute_edge_lead(keys, angle)
    if not delay:
        return np.ones(frequency.size)
    from scipy.special import j1  # loads slowly

    x = np.maximum(2 * np.pi * frequency * delay, 1e-9)
    return np.asarray(2 * j1(x) / x)
