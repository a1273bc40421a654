"""Drive waveforms: one definition for the netlist, the reference and the check of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kc2spice.core.quantities import Count, Frequency, Section, Time

TOP = 1e-6  # flat top of a repeated triangle, of its edge
NEVER = 1e4  # s; a period that no run reaches (newer ngspice repeats a pulse that has none)


class PulseKeys(Section):
    """From ``low`` to ``high`` from ``start`` on within ``edge``; ``width`` at half height."""

    high: float | str = 1.0
    low: float | str = 0.0
    width: Time
    edge: Time = 1e-9
    start: Time = 0.0
    period: Time | None = None
    count: Count | None = None


class SineKeys(Section):
    """``amplitude sin(2 pi frequency (t - start))`` from ``start`` on, zero before."""

    amplitude: float | str = 1.0
    frequency: Frequency
    start: Time = 0.0


@dataclass(frozen=True)
class Waveform:
    """A function of time in SI: constant, piecewise linear or a sine from ``start`` on.

    ``points`` (n, 2) are times [s] and values, held before the first and behind the last. With a
    ``period`` [s] the part from the first point on repeats, which a ``PULSE`` writes shortly.
    """

    kind: Literal["constant", "linear", "sine"]
    points: tuple[tuple[float, float], ...]
    period: float | None = None
    amplitude: float = 0.0
    frequency: float = 0.0
    start: float = 0.0

    def __call__(self, t: np.ndarray | float) -> np.ndarray:
        """Values at times [s]."""
        t = np.asarray(t, dtype=float)
        if self.kind == "sine":
            phase = 2 * np.pi * self.frequency * (t - self.start)
            return np.where(t < self.start, 0.0, self.amplitude * np.sin(phase))
        times, values = np.array(self.points).T
        if self.period is not None:
            t = np.where(t > times[0], times[0] + np.mod(t - times[0], self.period), t)
        return np.interp(t, times, values)

    def corners(self, stop: float) -> np.ndarray:
        """Times [s] up to ``stop`` at which the slope jumps."""
        if self.kind == "sine":
            found = np.array([self.start])
        elif self.kind == "constant":
            return np.empty(0)
        else:
            found = np.array(self.points)[:, 0]
            if self.period is not None:
                turns = np.arange(int((stop - found[0]) / self.period) + 1)
                found = (found[None, :] + self.period * turns[:, None]).ravel()
        return found[(found > 0) & (found < stop)]

    def spice(self, scale: float = 1.0) -> str:
        """What stands behind the nodes of an independent source, values times ``scale``.

        A flat top of zero length is written as corners: ngspice reads a ``PULSE`` width of zero as
        "until the end".
        """
        if self.kind == "constant":
            return f"DC {_number(scale * self.points[0][1])}"
        if self.kind == "sine":
            numbers = (0.0, scale * self.amplitude, self.frequency, self.start)
            return f"SIN({' '.join(map(_number, numbers))})"
        pulse = self._pulse(scale)
        if pulse is not None:
            return pulse
        corners = [number for t, v in self.points for number in (t, scale * v)]
        return f"PWL({' '.join(map(_number, corners))})"

    def _pulse(self, scale: float) -> str | None:
        """The short form of a trapezoid with a flat top, or of triangles without end."""
        if len(self.points) == 3 and self.period is not None:
            (t0, v0), (t1, v1), (t2, _) = self.points
            rise = _span(t0, t1)
            top = TOP * rise  # a width of zero means "until the end"
            numbers = (scale * v0, scale * v1, t0, rise, _span(t1, t2) - top, top, self.period)
            return f"PULSE({' '.join(map(_number, numbers))})"
        if len(self.points) != 4:
            return None
        (t0, v0), (t1, v1), (t2, v2), (t3, v3) = self.points
        if v0 != v3 or v1 != v2 or not t1 < t2:
            return None
        period = NEVER if self.period is None else self.period
        edges = (_span(t0, t1), _span(t2, t3), _span(t1, t2))
        numbers = (scale * v0, scale * v1, t0, *edges, period)
        return f"PULSE({' '.join(map(_number, numbers))})"


def constant(value: float) -> Waveform:
    """The same at all times."""
    return Waveform("constant", ((0.0, value),))


def sine(amplitude: float, frequency: float, start: float = 0.0) -> Waveform:
    """A sine from ``start`` on."""
    return Waveform("sine", ((start, 0.0),), None, amplitude, frequency, start)


def linear(points: np.ndarray) -> Waveform:
    """Straight lines through ``points`` (n, 2)."""
    return Waveform("linear", tuple((float(t), float(v)) for t, v in points))


def pulse(
    low: float,
    high: float,
    start: float,
    width: float,
    edge: float,
    period: float | None = None,
    count: int | None = None,
) -> Waveform:
    """Trapezoids of ``width`` at half height, one, ``count`` of them, or without end."""
    edges = ((0.0, low), (edge, high), (width, high), (width + edge, low))
    one = tuple((start + t, v) for t, v in edges)
    if period is None:
        return Waveform("linear", one if width > edge else (one[0], one[1], one[3]))
    if count is None:
        shape = one if width > edge else (one[0], one[1], one[3])
        return Waveform("linear", shape, period)
    many = [(start + k * period + t, v) for k in range(count) for t, v in edges]
    unique = [p for k, p in enumerate(many) if k + 1 == len(many) or p[0] < many[k + 1][0]]
    return Waveform("linear", tuple(unique))


def _span(first: float, last: float) -> float:
    """``last - first`` with the fewest digits that rounding of both leaves open."""
    exact = last - first
    slack = 2 * np.spacing(max(abs(first), abs(last)))
    rounded = (float(f"{exact:.{digits}g}") for digits in range(1, 17))
    return next((value for value in rounded if abs(value - exact) <= slack), exact)


def _number(value: float) -> str:
    """As a person would write it: 15 digits where the value is that but for rounding of a sum."""
    short = float(f"{value:.15g}")
    return repr(short if abs(short - value) <= 4 * np.spacing(abs(value)) else float(value))
