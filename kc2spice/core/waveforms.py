"""Waveforms of sources and of results.

Netlists, the reference solver and the checks of a run all use the waveform of a source from this
module.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import UsageError
from kc2spice.core.key_actions import DeleteKey
from kc2spice.core.quantities import Count, Frequency, Section, Time

# Largest number of pulses in a finite pulse train.
# A train of 25 000 pulses has 100 000 corners, as many as a waveform file may have rows.
MAX_PULSES = 25_000


@dataclass(frozen=True, eq=False)
class Waveforms(EqualByContent):
    """Results in SI units as functions of one variable, named as in waveforms.npz.

    The independent variable of all arrays is ``time``, ``frequency`` or the swept value.

    ``stats`` contains statistics of the simulator: the numbers of ``accepted`` and ``rejected``
    time points and of ``iterations``, and the CPU time ``cpu_s`` [s].
    """

    data: dict[str, np.ndarray]
    stats: dict[str, float]

    @property
    def scale(self) -> np.ndarray:
        """Values of the scale, the independent variable of all waveforms."""
        return next(iter(self.data.values()))

    def __getitem__(self, name: str) -> np.ndarray:
        """Return the array with this name."""
        return self.data[name]

    def __contains__(self, name: str) -> bool:
        """Return whether there is an array with this name."""
        return name in self.data

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the arrays."""
        return iter(self.data)


SCALES = {"time": "s", "frequency": "Hz"}  # SI units of independent variables


def quote_csv_cell(text: str) -> str:
    """Return a text as a CSV cell that no spreadsheet evaluates as a formula.

    Spreadsheets evaluate cells that begin with ``=``, ``+``, ``-``, ``@``, a tab or a carriage
    return (OWASP, CSV injection). An apostrophe at the beginning of a cell prevents the evaluation.

    >>> quote_csv_cell("=1+1")
    "'=1+1"
    """
    return f"'{text}" if text[:1] in tuple("=+-@\t\r") else text


def write_waveforms(waves: Waveforms, units: Mapping[str, str], directory: Path) -> list[str]:
    """Write the arrays to ``waveforms.npz`` and, with units, to ``waveforms.csv``."""
    save_arrays(waves, directory / "waveforms.npz")
    columns = dict[str, np.ndarray]()
    for name, values in waves.data.items():
        columns.update(_split_columns(name, values, units.get(name) or SCALES.get(name, "")))
    head, table = ",".join(map(quote_csv_cell, columns)), np.column_stack(list(columns.values()))
    np.savetxt(directory / "waveforms.csv", table, "%.10g", ",", header=head, comments="")
    return ["waveforms.npz", "waveforms.csv"]


def save_arrays(waves: Waveforms, path: Path) -> None:
    """Write all arrays of the waveforms to one npz file."""
    np.savez_compressed(path, **waves.data)  # type: ignore[arg-type]


def _split_columns(name: str, values: np.ndarray, unit: str) -> Iterator[tuple[str, np.ndarray]]:
    """Split an array into real CSV columns; yield each column's title and values.

    A complex array has two columns: the real part and the imaginary part.
    """
    if np.iscomplexobj(values):
        yield f"{name} real", values.real
        yield f"{name} imag", values.imag
    else:
        yield (f"{name} [{unit}]" if unit else name), values


def integrate_cumulatively(values: np.ndarray, over: np.ndarray) -> np.ndarray:
    """Compute the cumulative integral of samples by the trapezoidal rule.

    ``values`` has the shape (..., n). The variable of integration is ``over`` with the shape (n,).
    The integral is zero at the first point.
    """
    steps = (values[..., 1:] + values[..., :-1]) / 2 * np.diff(over)
    start = np.zeros((*np.shape(steps)[:-1], 1))
    return np.concatenate([start, np.cumsum(steps, axis=-1)], axis=-1)


def average_over_window(values: np.ndarray, time: np.ndarray, window: float) -> np.ndarray:
    """Compute the mean of a waveform in a time window around each time point.

    ``values`` and ``time`` [s] have the shape (n,). ``window`` is the length of the window [s]. At
    the ends of the waveform, the window is shorter. Between two time points, the waveform counts as
    constant, and its value is the mean of the values at both points.

    >>> average_over_window(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0]), 1.0)
    array([0.5, 1. , 1.5])
    """
    integral = integrate_cumulatively(values, time)
    first = np.maximum(time - window / 2, time[0])
    last = np.minimum(time + window / 2, time[-1])
    rise = np.interp(last, time, integral) - np.interp(first, time, integral)
    return np.asarray(rise / (last - first))


def differentiate(values: np.ndarray, over: np.ndarray) -> np.ndarray:
    """Compute the derivative of sampled values with respect to their abscissae.

    ``over`` contains the abscissae. Both arguments and the result are arrays of shape (n,). The
    result is the derivative of the parabola through three neighbouring points. The error of the
    derivative is proportional to the square of the distance between the points. Consecutive values
    of ``over`` may be equal.
    """
    first = np.r_[True, np.diff(over) > 0]
    if first.sum() < 3:
        return np.zeros_like(values)
    inner = np.gradient(values[first], over[first], edge_order=2)
    return np.asarray(np.interp(over, over[first], inner))


def interpolate(at: Any, scale: np.ndarray, values: np.ndarray) -> Any:
    """Interpolate linearly between samples over a monotonic independent variable.

    ``scale`` contains the values of the independent variable at the samples. ``at`` contains the
    values of the independent variable at which the samples are interpolated. ``values`` and
    ``scale`` are arrays of shape (n,).
    """
    direction = -1 if scale[0] > scale[-1] else 1
    return np.interp(at, scale[::direction], values[::direction])


# Periodic triangles are written as trapezoids, because ngspice does not end a pulse of zero width.
# FLAT_TOP_RATIO is the duration of the trapezoid's flat top, divided by the rise time.
FLAT_TOP_RATIO = 1e-6
# Period [s] that is written for a single pulse; every run is shorter.
# Newer versions of ngspice repeat a ``PULSE`` without a period.
ENDLESS_PERIOD = 1e4


class PulseKeys(Section):
    """Scene keys of trapezoidal pulses: two levels, edge time, width and period.

    The pulse rises from ``low`` to ``high`` and begins at ``start``. ``edge`` is both the rise time
    and the fall time. ``width`` is the width of the pulse at half height.
    """

    high: float | str = Field(
        1.0, description="Value of the source during a pulse, in the unit of the source"
    )
    low: float | str = Field(
        0.0, description="Value of the source between pulses, in the unit of the source"
    )
    width: Time = Field(description="Width of the pulse at half of its height")
    edge: Time = Field(1e-9, description="Rise time of the pulse, equal to the fall time")
    start: Time = Field(0.0, description="Time at which the first pulse begins to rise")
    period: Time | None = Field(
        None, description="Period of the pulse train; by default the source has only one pulse"
    )
    count: Count | None = Field(
        None, description="Number of pulses of a pulse train; by default unlimited"
    )


class SineKeys(Section):
    """Scene keys of a sine ``amplitude * sin(2 pi * frequency * (t - start))``.

    Before the time ``start``, the waveform is zero.
    """

    unsupported_key_hints: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("offset", "dc_offset", "dc", "bias"),
        'for a constant offset, add  [bias]  with  part = "source", the same kind and the key `dc`,'
        ' and write  pins = { ret = "bias.out" }  in the source with the sine',
    )

    amplitude: float | str = Field(
        1.0, description="Amplitude of the sine, in the unit of the source"
    )
    frequency: Frequency = Field(gt=0, description="Frequency of the sine")
    start: Time = Field(
        0.0, description="Time at which the sine begins; before this time, the source is zero"
    )


@dataclass(frozen=True)
class Waveform:
    """Piecewise linear or sinusoidal function of time, in SI units.

    A waveform with a ``frequency`` is a sine that begins at ``start``. Any other waveform is linear
    between ``points``, an array of shape (n, 2) with times [s] and values. The value is constant
    before the first point and after the last point. If ``period`` [s] is given, the waveform
    repeats with this period from the first point on. In a netlist, the waveform is written as a
    ``PULSE`` if possible.

    Raises UsageError unless the times increase strictly, because an edge must have a duration.
    """

    points: tuple[tuple[float, float], ...]
    period: float | None = None
    amplitude: float = 0.0
    frequency: float = 0.0
    start: float = 0.0

    def __post_init__(self) -> None:
        """Raise an error if the times do not increase."""
        times = list(map(itemgetter(0), self.points))
        if not times or np.any(np.diff(times) <= 0.0):
            raise UsageError(
                "the times of the waveform do not increase strictly",
                got=times,
                expected="a later time in each row",
                hint="sort the rows by time, and delete rows with a repeated time",
            )

    @property
    def is_piecewise_linear(self) -> bool:
        """Whether the waveform is linear between its corners."""
        return not self.frequency

    @property
    def step_limit(self) -> float:
        """Largest time step [s] that an integrator may use for the waveform.

        With longer steps, an integrator could step over two neighbouring zeros of an event function
        and miss both events.
        """
        return np.inf if self.is_piecewise_linear else 0.05 / self.frequency

    @cached_property
    def _corner_points(self) -> tuple[np.ndarray, np.ndarray]:
        """Times and values of the corners, as two arrays."""
        times, values = np.array(self.points, dtype=float).T
        return times, values

    @cached_property
    def _slopes_between_corners(self) -> np.ndarray:
        """Slopes between neighbouring corners; the first and the last entry are zero."""
        times, values = self._corner_points
        return np.concatenate(([0.0], np.diff(values) / np.diff(times), [0.0]))

    def _fold_time(self, t: Any) -> np.ndarray:
        """Shift times by whole periods into the first period of the waveform."""
        t, first = np.asarray(t, dtype=float), self.points[0][0]
        if self.period is None:
            return t
        return np.where(t > first, first + np.mod(t - first, self.period), t)

    def __call__(self, t: Any) -> Any:
        """Return the values of the waveform at the times ``t`` [s]."""
        if self.is_piecewise_linear:
            return np.interp(self._fold_time(t), *self._corner_points)
        return self._evaluate_sine(t, t, 0)

    def _evaluate_sine(self, t: Any, within: Any, order: int) -> Any:
        """Compute a time derivative of the sine; ``order`` 0 is the sine itself."""
        w = 2 * np.pi * self.frequency
        turned = np.sin(w * (np.asarray(t) - self.start) + 0.5 * np.pi * order)
        return (np.asarray(within) > self.start) * self.amplitude * w**order * turned

    def compute_derivative(self, t: Any, within: Any, order: int = 1) -> Any:
        """Compute a time derivative of the waveform at several times.

        ``order`` is the order of the derivative, and ``t`` contains the times. ``within`` is one
        time, or one time for each entry of ``t``. At a corner of the waveform, the result is the
        right derivative if ``within`` is later than the corner, and otherwise the left derivative.
        """
        if not self.is_piecewise_linear:
            return self._evaluate_sine(t, within, order)
        piece = np.searchsorted(self._corner_points[0], self._fold_time(within))
        return self._slopes_between_corners[piece] * (order == 1) + 0.0 * np.asarray(t)

    def list_points(self, stop: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the times [s] and the values of the corners in all periods.

        The result contains all periods that begin before ``stop``.
        """
        times, values = self._corner_points
        if self.period is not None:
            turns = self.period * np.arange(max(1, int((stop - times[0]) / self.period) + 1))
            times, first = np.unique((times + turns[:, None]).ravel(), return_index=True)
            values = np.tile(values, turns.size)[first]
        return times, values

    def find_first_change(self) -> float | None:
        """Return the time [s] at which the waveform first changes; None if it is constant."""
        if not self.is_piecewise_linear:
            return self.start if self.amplitude else None
        times, values = self._corner_points
        changes = np.flatnonzero(np.diff(values))
        return float(times[changes[0]]) if changes.size else None

    def find_corner_times(self, stop: float) -> np.ndarray:
        """Return the times [s] at which the time derivative of the waveform jumps.

        The times are before ``stop`` [s].
        """
        result = self.list_points(stop)[0] if self.is_piecewise_linear else np.array([self.start])
        return result[(result > 0) & (result < stop)]

    def format_spice(self, scale: float = 1.0) -> str:
        """Format the waveform, with a scale factor, as a source value in SPICE syntax.

        A pulse without a flat top is written as ``PWL``, because ngspice never ends a ``PULSE`` of
        zero width.
        """
        if not self.is_piecewise_linear:
            numbers = (0.0, scale * self.amplitude, self.frequency, self.start)
            return f"SIN({' '.join(map(_format_number, numbers))})"
        if len(self.points) == 1:
            return f"DC {_format_number(scale * self.points[0][1])}"
        pulse = self._format_pulse(scale)
        if pulse is not None:
            return pulse
        times, values = self._corner_points
        corners = np.column_stack([times, scale * values]).ravel().tolist()
        return f"PWL({' '.join(map(_format_number, corners))})"

    def _format_pulse(self, scale: float) -> str | None:
        """Format a trapezoid or periodic triangle as ``PULSE``; None for other waveforms."""
        if len(self.points) not in (3, 4):
            return None
        (t0, v0), (t1, v1), *_, (t2, v2), (last, end) = self.points[:2] + self.points[-2:]
        if len(self.points) == 3 and self.period is not None:
            rise = _round_difference(t0, t1)
            top = FLAT_TOP_RATIO * rise  # ngspice does not end a pulse of zero width
            fall = _round_difference(t1, last) - top
        elif len(self.points) == 4 and v0 == end and v1 == v2:
            rise, fall, top = (
                _round_difference(t0, t1),
                _round_difference(t2, last),
                _round_difference(t1, t2),
            )
        else:
            return None
        period = ENDLESS_PERIOD if self.period is None else self.period
        numbers = (scale * v0, scale * v1, t0, rise, fall, top, period)
        return f"PULSE({' '.join(map(_format_number, numbers))})"


def make_constant_waveform(value: float) -> Waveform:
    """Make a waveform with a constant value."""
    return Waveform(((0.0, value),))


def make_sine_waveform(amplitude: float, frequency: float, start: float = 0.0) -> Waveform:
    """Make a sine waveform that begins at a start time."""
    return Waveform(((start, 0.0),), None, amplitude, frequency, start)


def make_linear_waveform(points: Iterable[tuple[float, float]] | np.ndarray) -> Waveform:
    """Make a piecewise linear waveform through ``points``, an array of shape (n, 2)."""
    return Waveform(tuple((float(t), float(v)) for t, v in points))


def make_pulse_waveform(
    low: float,
    high: float,
    start: float,
    width: float,
    edge: float,
    period: float | None = None,
    count: int | None = None,
) -> Waveform:
    """Make one trapezoidal pulse, a train of several pulses, or an endless train.

    ``width`` is the width of a pulse at half height.

    Raises
    ------
    UsageError : ``count`` is given without ``period``, or exceeds ``MAX_PULSES``.
    """
    if count is not None and period is None:
        raise UsageError(
            "the pulse has a count, but no period",
            expected="period and count",
            hint="add the key `period`, or delete the key `count`",
        )
    if count is not None and not 1 <= count <= MAX_PULSES:
        raise UsageError(
            "count is not a number of pulses",
            got=count,
            expected=f"1 to {MAX_PULSES}; without a count the train has no end",
            hint=DeleteKey("count"),
        )
    edges = ((0.0, low), (edge, high), (width, high), (width + edge, low))
    corners = tuple((start + t, v) for t, v in edges)
    if period is None or count is None:
        shape = corners if width > edge else (corners[0], corners[1], corners[3])
        return Waveform(shape, period)
    points = list[tuple[float, float]]()
    for k in range(count):
        points += [(start + k * period + t, v) for t, v in edges]
    unique = [point for point, following in pairwise(points) if point[0] < following[0]]
    return Waveform((*unique, points[-1]))


@dataclass(frozen=True, eq=False)
class RecordedWave(EqualByContent):
    """Smooth curve through the recorded samples of a quantity over time.

    The samples are the ``values`` at the ``times`` [s]. Both arrays have the shape (n,). The curve
    is constant before the first sample and after the last sample. Between two samples, the curve is
    the cubic polynomial of Akima's method (J. ACM 17, 589, 1970).

    Every 16th sample is a corner, at which an integrator must end a step. Without these corners, an
    integrator could miss an event after a long interval without changes.
    """

    times: np.ndarray
    values: np.ndarray
    is_piecewise_linear = False
    step_limit = np.inf

    @cached_property
    def _spline(self) -> Any:
        """Interpolating spline through the recorded samples."""
        # imported here, because importing scipy is slow
        from scipy.interpolate import Akima1DInterpolator

        return Akima1DInterpolator(self.times, self.values)

    def __call__(self, t: Any) -> Any:
        """Return the values of the waveform at the times ``t`` [s]."""
        return self.compute_derivative(t, t, 0)

    def compute_derivative(self, t: Any, within: Any, order: int = 1) -> Any:
        """Compute the ``order``-th time derivative of the recorded curve at several times.

        ``order`` is the order of the derivative, and ``t`` contains the times.
        """
        return self._spline(np.clip(t, self.times[0], self.times[-1]), order)

    def find_corner_times(self, stop: float) -> np.ndarray:
        """Return the times [s] of the corners, at which an integrator must end a step.

        The times are before ``stop`` [s].
        """
        times = self.times[::16]
        return times[(times > 0.0) & (times < stop)]


Function = Waveform | RecordedWave


def _round_difference(first: float, last: float) -> float:
    """Return the shortest decimal equal to ``last - first`` within rounding errors."""
    exact = last - first
    slack = 2 * np.spacing(max(abs(first), abs(last)))
    rounded = (float(f"{exact:.{digits}g}") for digits in range(1, 17))
    return next((value for value in rounded if abs(value - exact) <= slack), exact)


def _format_number(value: float) -> str:
    """Format a number with 15 digits, or with all digits if 15 are too inaccurate."""
    short = float(f"{value:.15g}")
    return repr(short if abs(short - value) <= 4 * np.spacing(abs(value)) else float(value))


def write_record(
    record: Mapping[str, Any], directory: Path, name: str = "result.json"
) -> dict[str, Any]:
    """Write a record to a JSON file, with null for non-finite numbers.

    Return the written content.
    """
    result: dict[str, Any] = _convert_to_json_types(record)
    (directory / name).write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return result


def _convert_to_json_types(value: Any) -> Any:
    """Convert numpy numbers, tuples and non-finite numbers of a value to JSON types."""
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _convert_to_json_types(item) for key, item in value.items()}
    return list(map(_convert_to_json_types, value)) if isinstance(value, (list, tuple)) else value
