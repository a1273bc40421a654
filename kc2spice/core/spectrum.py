"""Frequency that bounds nearly all of the energy of a waveform or record."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from kc2spice.core.waveforms import Waveform

ENERGY = 0.999  # share of its energy that a signal has up to its highest frequency
SAMPLES = 2**16  # samples of a signal; a pulse of a train of 13 000 has 5 of them
BEGINNING = 400  # number of first corners of a long train that are also sampled separately
# number of time constants for which the output of a low-pass filter continues after the signal
AFTER = 20.0
FEWEST = 20  # least number of samples of the signal itself


def energy_frequency(
    time: np.ndarray, values: np.ndarray, constant: float = 0.0, share: float = ENERGY
) -> float:
    """Frequency [Hz] that bounds the ``share`` of the energy of a signal.

    The energy refers to ``x(t) - x(0)`` with straight lines between the points, so a constant
    signal has no energy. A signal that has not returned at its end returns as it came, without a
    jump.

    Parameters
    ----------
    time : (n,) rising times [s].
    values : (n,) values there.
    constant : time constant [s] of a first-order low-pass filter through which the signal passes.
    share : of the energy, below 1.
    """
    span = time[-1] - time[0]
    if not span > 0 or not np.ptp(values):
        return 0.0
    step = max(span, min(AFTER * constant, SAMPLES / FEWEST * span)) / SAMPLES
    places = np.arange(int(np.ceil(span / step)) + 1)
    x = np.interp(time[0] + step * places, time, values - values[0])
    if x[-1]:
        x = np.concatenate([x, x[-2::-1]])
    spectrum = np.fft.rfft(x, 4 * SAMPLES)
    f = np.fft.rfftfreq(4 * SAMPLES, step)
    power = np.abs(spectrum) ** 2 / (1 + (2 * np.pi * f * constant) ** 2)
    power[0] /= 2  # counted once; all other frequencies also occur at -f
    risen = np.cumsum(power)
    return float(f[np.searchsorted(risen, share * risen[-1])])


@lru_cache(maxsize=64)
def waveform_frequency(wave: Waveform, stop: float, constant: float = 0.0) -> float:
    """Frequency that bounds nearly all of the energy of a waveform up to ``stop`` [s].

    For a sine, the result is its frequency. An endless train is evaluated for one period, and a
    train of many pulses at its beginning.
    """
    if not wave.straight:
        return wave.frequency
    times, values = map(np.array, zip(*wave.points, strict=True))
    if wave.period is not None:
        times, stop = np.append(times, times[0] + wave.period), min(stop, times[0] + wave.period)
    if wave.period is not None or times[-1] > stop or values[-1] != values[0]:
        times = np.append(times[times < stop], stop)
    times = times[times <= stop]
    values = wave(times)
    parts = {times.size, min(times.size, BEGINNING)}
    return max(energy_frequency(times[:n], values[:n], constant) for n in parts)
