"""Computation of probe values: extremes, means, crossings and sound levels.

:func:`compute_probe_value` computes one number from two arrays: the values of a wave, and its
times, frequencies or swept values. Complex frequency responses are replaced by their magnitude.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.sound_level import GAS_REFERENCE, compute_level
from kc2spice.core.waveforms import interpolate

# Largest fraction by which an interpolated maximum may exceed the largest point.
# If the distance between the points is a quarter of the 3 dB width of a resonance, this fraction is
# at most 3 %.
MAX_CORRECTION = 0.05
SCALE_ROUNDING = 1e-9  # rounding error of the first and last point, relative to the range


def compute_probe_value(
    take: str,
    scale: np.ndarray,
    values: np.ndarray,
    where: str,
    *,
    at: float | None = None,
    level: float = 0.0,
    window: tuple[float, float] | None = None,
    reference: float = GAS_REFERENCE,
) -> float | None:
    """Compute the value of a probe, such as a maximum or rms value, from a waveform.

    Parameters
    ----------
    take : str
        Name of the value, as in the scene key ``take`` of a probe.
    scale : ndarray
        Times, frequencies or swept values (n,) of the points, in SI units.
    values : ndarray
        Waveform (n,) in SI units; complex for a frequency response.
    where : str
        Scene key of the probe, for error messages.
    at : float, optional
        Time, frequency or swept value at which the waveform is evaluated. By default, all points
        are used.
    level : float, default 0
        Value that the waveform crosses, in its SI unit, for the probe value ``crossing``.
    window : tuple of float, optional
        First and last time, frequency or swept value of the points that are used.
    reference : float, default 20 uPa
        Rms pressure [Pa] that corresponds to a sound pressure level of 0 dB.

    Returns
    -------
    float or None
        Value in SI units, or in dB; None if the waveform has no crossing or no complete cycle.

    Raises
    ------
    UsageError : ``at`` or an end of ``window`` is outside the analysed range of times, frequencies
        or swept values.

    Examples
    --------
    >>> time = np.array([0.0, 1.0, 2.0])
    >>> compute_probe_value("peak_to_peak", time, np.array([1.0, 4.0, 2.0]), "probes.swing")
    3.0
    """
    if take == "spl":
        rms = _compute_rms(scale, values, where, at, window)
        return float(compute_level(np.asarray(rms), reference))
    if at is not None:
        return _interpolate_value(scale, values, at, where)
    if window is not None:
        scale, values = _clip_to_window(scale, values, window, where)
    return _evaluate_range(take, scale, values, level)


def _compute_rms(
    scale: np.ndarray,
    values: np.ndarray,
    where: str,
    at: float | None,
    window: tuple[float, float] | None,
) -> float:
    """Compute the rms value of a waveform, or of an ac response at one frequency.

    For an ac response, the result is the rms value of the sine at one frequency, by default at the
    frequency of the largest magnitude.
    """
    response = np.iscomplexobj(values)
    take = "max" if response else "rms"
    size = compute_probe_value(take, scale, values, where, at=at, window=window) or 0.0
    # the amplitude of a sine is its rms value times the square root of two
    return math.sqrt(0.5) * size if response else size


def _clip_to_window(
    scale: np.ndarray, values: np.ndarray, window: tuple[float, float], where: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return the points of a waveform in a window, with interpolated end points.

    Raises
    ------
    UsageError : an end of ``window`` is outside the analysed range of times, frequencies or swept
        values, or the window has no extent.
    """
    direction = -1 if scale[0] > scale[-1] else 1
    scale, values = scale[::direction], values[::direction]
    for key, end in zip(("from", "to"), window, strict=True):
        if math.isfinite(end) and not _is_in_analysed_range(scale, end):
            raise make_outside_error(f"{where}.{key}", end, scale.min(), scale.max())
    low, high = max(window[0], scale[0]), min(window[1], scale[-1])
    if low >= high and scale.size > 1:
        raise UsageError(
            "the window of this probe ends where it begins",
            where=f"{where}.from",
            got=f"{low:g} to {high:g}",
            expected="an end of the window that is larger than its beginning",
            hint=f"write for example  from = {(scale[0] + scale[-1]) / 2:g}",
        )
    inside = (scale > low) & (scale < high)
    at = np.concatenate([[low], scale[inside], [high]])
    ends = np.interp([low, high], scale, values)
    clipped = np.concatenate([ends[:1], values[inside], ends[1:]])
    return at[::direction], clipped[::direction]


def _evaluate_range(take: str, scale: np.ndarray, values: np.ndarray, level: float) -> float | None:
    """Compute the probe value, such as ``max``, of the given range of a waveform."""
    if np.iscomplexobj(values) and take in ("max", "argmax"):
        place, largest = find_response_maximum(scale.real, np.abs(values))
        return largest if take == "max" else place
    if np.iscomplexobj(values) and take == "min":
        return find_response_minimum(scale.real, np.abs(values))
    sizes = np.abs(values) if np.iscomplexobj(values) else values
    result = _PROBE_FUNCTIONS[take](scale, sizes, level)
    return None if result is None else float(result)


def find_response_maximum(frequency: np.ndarray, size: np.ndarray) -> tuple[float, float]:
    """Return frequency and magnitude of the maximum of a frequency response.

    The maximum may lie between two points. Near a pole ``a + j w0``, the response is approximately
    ``y = R / (j w - a - j w0)``. Then ``1 / |y|^2`` is a parabola in ``w``, which three points
    determine:

        1 / |y|^2 = ((w - w0)^2 + a^2) / |R|^2

    If the largest point is the first or the last point, this point is returned without
    interpolation. If the interpolated maximum exceeds the largest point by more than
    :data:`MAX_CORRECTION`, the largest point is returned instead, because the points are too far
    apart.

    >>> w = np.array([9.0, 10.1, 11.2])
    >>> place, value = find_response_maximum(w, np.abs(1 / (1j * (w - 10) + 1)))
    >>> print(f"{place:.6f} {value:.6f}")
    10.000000 1.000000
    """
    k = int(size.argmax())
    position, largest = float(frequency[k]), float(size[k])
    if not 0 < k < size.size - 1 or not size[k - 1 : k + 2].all():
        return position, largest
    # 1/|y|^2 = (1 + linear * x + square * x^2) / largest^2 at the distance x from the largest point
    x = frequency[[k - 1, k + 1]] - position
    slopes = ((largest / size[[k - 1, k + 1]]) ** 2 - 1) / x
    square = (slopes[1] - slopes[0]) / (x[1] - x[0])
    linear = slopes[1] - square * x[1]
    least = 1 - linear**2 / (4 * square) if square > 0 else 0.0
    if least < 1 / (1 + MAX_CORRECTION) ** 2:
        return position, largest
    return float(position - linear / (2 * square)), float(largest / math.sqrt(least))


def find_response_minimum(frequency: np.ndarray, size: np.ndarray) -> float:
    """Return the smallest magnitude of a frequency response.

    The minimum may lie between two points. The function computes the maximum of the reciprocal
    response.
    """
    return 1 / find_response_maximum(frequency, 1 / size)[1] if size.all() else 0.0


def compute_mean_frequency(scale: np.ndarray, values: np.ndarray) -> float | None:
    """Return the mean frequency of an oscillation in the second half of its duration.

    A cycle is the interval between two points at which the wave rises through its mean. The result
    is None if the wave has no complete cycle.
    """
    late = np.abs(scale - scale[0]) >= np.ptp(scale) / 2
    x, y = scale[late], values[late]
    y = y - _compute_time_average(x, y)
    k = np.flatnonzero((y[:-1] < 0) & (y[1:] >= 0))
    if k.size < 2:
        return None
    places = x[k] - y[k] * (x[k + 1] - x[k]) / (y[k + 1] - y[k])
    return float((k.size - 1) / abs(places[-1] - places[0]))


def find_first_crossing(scale: np.ndarray, values: np.ndarray, level: float) -> float | None:
    """Return the first time, frequency or swept value where ``values`` cross a level."""
    above = values >= level
    changes = np.flatnonzero(above[1:] != above[:-1])
    if changes.size == 0:
        return None
    k = int(changes[0])
    share = (level - values[k]) / (values[k + 1] - values[k])
    return float(scale[k] + share * (scale[k + 1] - scale[k]))


def _compute_time_average(scale: np.ndarray, values: np.ndarray) -> float:
    """Average a waveform over time or a swept key by the trapezoidal rule."""
    # If the independent variable, such as a voltage, decreases, span and integral are negative.
    span = scale[-1] - scale[0]
    return float(
        np.trapezoid(values, scale) / span if span else values[0]
    )  # the mean of a single point is the value at this point


# Functions that compute a probe value of a wave, keyed by the name of the value, such as ``max``.
# Their arguments are the times or frequencies, the samples of the wave, and a level for crossings.
_PROBE_FUNCTIONS: dict[str, Callable[[np.ndarray, np.ndarray, float], float | None]] = {
    "argmax": lambda scale, values, _: scale[values.argmax()],
    "max": lambda scale, values, _: values.max(),
    "min": lambda scale, values, _: values.min(),
    "final": lambda scale, values, _: values[-1],
    "peak_to_peak": lambda scale, values, _: np.ptp(values),
    "mean": lambda scale, values, _: _compute_time_average(scale, values),
    "rms": lambda scale, values, _: math.sqrt(_compute_time_average(scale, values**2)),
    "frequency": lambda scale, values, _: compute_mean_frequency(scale, values),
    "crossing": find_first_crossing,
}


def _is_in_analysed_range(scale: np.ndarray, place: float) -> bool:
    """Return whether a time, frequency or swept value is within the analysed range.

    ``scale`` contains the analysed times, frequencies or swept values. A tolerance allows for
    rounding errors.
    """
    slack = SCALE_ROUNDING * float(np.ptp(scale))
    return bool(scale.min() - slack <= place <= scale.max() + slack)


def make_outside_error(
    where: str, place: float, first: float, last: float, unit: str = ""
) -> UsageError:
    """Make the error for a position outside the analysed time, frequency or key range.

    The range is ``first`` to ``last`` in ``unit``. The error suggests the position ``last``. For
    the key ``from``, the start of a window, the error suggests the middle of the range.
    """
    key = where.rpartition(".")[2]
    return UsageError(
        "this time, frequency or swept value is outside of the range of the analysis",
        where=where,
        got=f"{place:g}",
        expected=f"{first:g} … {last:g} {unit}".rstrip(),
        hint=f"write for example  {key} = {(first + last) / 2 if key == 'from' else last:g}",
    )


def _interpolate_value(scale: np.ndarray, values: np.ndarray, place: float, where: str) -> float:
    """Interpolate a waveform at a position; return the magnitude of a complex value."""
    if not _is_in_analysed_range(scale, place):
        raise make_outside_error(f"{where}.at", place, scale.min(), scale.max())
    result = interpolate(place, scale, values)
    return float(np.abs(result)) if np.iscomplexobj(result) else float(result)
