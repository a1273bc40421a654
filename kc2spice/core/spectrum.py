"""Frequency limit below which a waveform has nearly all of its energy."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from kc2spice.core.waveforms import Waveform

ENERGY_SHARE = 0.999  # share of a signal's energy below the computed frequency
# Number of samples of a signal, enough for a train of 13 000 pulses with 5 samples per pulse.
SIGNAL_SAMPLES = 2**16
# For a long pulse train, the frequency is computed from the complete waveform, and again from its
# first FIRST_CORNERS corners alone.
FIRST_CORNERS = 400
# Number of time constants for which the filter output is sampled after the end of the signal.
DECAY_TIME_CONSTANTS = 20.0
MIN_SIGNAL_SAMPLES = 20  # smallest number of samples between the start and the end of the signal


def find_energy_frequency(
    time: np.ndarray, values: np.ndarray, constant: float = 0.0, share: float = ENERGY_SHARE
) -> float:
    """Find the frequency [Hz] below which a given fraction of a signal's energy is.

    The energy is the integral of the squared difference ``x(t) - x(0)``, so a constant signal has
    no energy. Between the points, the signal x is linear. If the last value of a signal differs
    from the first value, the mirror image of the signal in time is appended. A signal that is
    followed by its own mirror image ends at its first value, so no jump remains between end and
    start.

    Parameters
    ----------
    time : increasing times (n,) [s].
    values : values (n,) of the signal at the times ``time``.
    constant : time constant [s] of a first-order low-pass filter that is applied to the signal.
    share : share of the energy below the returned frequency, less than 1.
    """
    span = time[-1] - time[0]
    if not span > 0 or not np.ptp(values):
        return 0.0
    step = (
        max(span, min(DECAY_TIME_CONSTANTS * constant, SIGNAL_SAMPLES / MIN_SIGNAL_SAMPLES * span))
        / SIGNAL_SAMPLES
    )
    places = np.arange(int(np.ceil(span / step)) + 1)
    x = np.interp(time[0] + step * places, time, values - values[0])
    if x[-1]:
        x = np.concatenate([x, x[-2::-1]])
    spectrum = np.fft.rfft(x, 4 * SIGNAL_SAMPLES)
    f = np.fft.rfftfreq(4 * SIGNAL_SAMPLES, step)
    power = np.abs(spectrum) ** 2 / (1 + (2 * np.pi * f * constant) ** 2)
    power[0] /= 2  # every frequency f except 0 Hz also occurs as -f
    risen = np.cumsum(power)
    return float(f[np.searchsorted(risen, share * risen[-1])])


@lru_cache(maxsize=64)
def find_waveform_frequency(wave: Waveform, stop: float, constant: float = 0.0) -> float:
    """Return the frequency [Hz] below which a waveform has nearly all of its energy.

    For a sine, the result is the frequency of the sine. The waveform is evaluated until ``stop``
    [s]. Only one period of an endless pulse train is evaluated. For a long pulse train, one
    frequency is computed from the complete waveform, and another from its first
    :data:`FIRST_CORNERS` corners. The function returns the higher of these two frequencies.
    """
    if not wave.is_piecewise_linear:
        return wave.frequency
    times, values = map(np.array, zip(*wave.points, strict=True))
    if wave.period is not None:
        times, stop = np.append(times, times[0] + wave.period), min(stop, times[0] + wave.period)
    if wave.period is not None or times[-1] > stop or values[-1] != values[0]:
        times = np.append(times[times < stop], stop)
    times = times[times <= stop]
    values = wave(times)
    parts = {times.size, min(times.size, FIRST_CORNERS)}
    return max(find_energy_frequency(times[:n], values[:n], constant) for n in parts)
