"""Functions of time that sources prescribe."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from kc2spice.core.errors import UsageError


class Waveform(Protocol):
    """A function of time that is smooth between its corners."""

    def value(self, t: Any) -> Any:
        """Value at one time or an array of them."""
        ...

    def rate(self, t: Any, within: float) -> Any:
        """Time derivative at ``t``, of the smooth piece that holds the time ``within``."""
        ...

    def corners(self, stop: float) -> np.ndarray:
        """Times up to ``stop`` where the derivative jumps."""
        ...


@dataclass(frozen=True)
class Line:
    """Straight lines through ``points`` ((t, value), ...), constant before and after.

    ``period`` > 0 repeats what lies between the first point and ``period`` later, ``count`` times.
    Raises UsageError unless times increase strictly (edges take time).
    """

    points: tuple[tuple[float, float], ...]
    period: float = 0.0
    count: int = 1

    def __post_init__(self) -> None:
        times = np.array([t for t, _ in self.points])
        if times.size == 0 or np.any(np.diff(times) <= 0.0):
            raise UsageError("times of a waveform must increase strictly", got=times.tolist())
        if self.count > 1 and times[-1] - times[0] >= self.period:
            raise UsageError("a pulse is longer than its period", got=self.period)

    @classmethod
    def constant(cls, value: float) -> Line:
        """The same value at all times."""
        return cls(((0.0, value),))

    @classmethod
    def pulse(
        cls,
        high: float,
        width: float,
        edge: float,
        start: float = 0.0,
        low: float = 0.0,
        period: float = 0.0,
        count: int = 1,
    ) -> Line:
        """A trapezium: rises within ``edge``, falls ``width`` after its start within ``edge``."""
        points = ((0.0, low), (edge, high), (width, high), (width + edge, low))
        if width <= edge:
            raise UsageError("the pulse is shorter than its edge", got=width, expected=f"> {edge}")
        return cls(tuple((start + t, v) for t, v in points), period, count)

    @cached_property
    def _knots(self) -> tuple[np.ndarray, np.ndarray]:
        base = np.array(self.points, dtype=float)
        shifts = self.period * np.arange(max(1, self.count))
        times = (base[:, 0] + shifts[:, None]).ravel()
        return times, np.tile(base[:, 1], shifts.size)

    def value(self, t: Any) -> Any:
        """Value at the times ``t``."""
        return np.interp(t, *self._knots)

    def rate(self, t: Any, within: float) -> Any:
        """Slope of the straight piece that holds ``within``, whatever ``t``."""
        times, values = self._knots
        k = int(np.searchsorted(times, within)) - 1
        inside = 0 <= k < times.size - 1
        slope = (values[k + 1] - values[k]) / (times[k + 1] - times[k]) if inside else 0.0
        return slope + 0.0 * np.asarray(t)

    def corners(self, stop: float) -> np.ndarray:
        """All points up to ``stop``."""
        times = self._knots[0]
        return times[(times > 0.0) & (times < stop)] if times.size > 1 else np.empty(0)


@dataclass(frozen=True)
class Recorded:
    """A smooth curve through ``values`` at ``times`` (n,) of cubics (Akima, J. ACM 17, 589, 1970).

    Every ``stride``-th sample is a corner: no step of an integrator is longer than what was sampled
    there, so that an event after a long rest is not stepped over.
    """

    times: np.ndarray
    values: np.ndarray
    stride: int = 16

    @cached_property
    def _curve(self) -> tuple[Any, Any]:
        from scipy.interpolate import Akima1DInterpolator

        curve = Akima1DInterpolator(self.times, self.values)
        return curve, curve.derivative()

    def value(self, t: Any) -> Any:
        """Value at the times ``t``, constant before and after the samples."""
        return self._curve[0](np.clip(t, self.times[0], self.times[-1]))

    def rate(self, t: Any, within: float) -> Any:
        """Slope at the times ``t``."""
        return self._curve[1](np.clip(t, self.times[0], self.times[-1]))

    def corners(self, stop: float) -> np.ndarray:
        """Every ``stride``-th sample up to ``stop``."""
        times = self.times[:: self.stride]
        return times[(times > 0.0) & (times < stop)]


@dataclass(frozen=True)
class Sine:
    """``offset + amplitude sin(2 pi frequency (t - start))`` from ``start`` on."""

    amplitude: float
    frequency: float
    start: float = 0.0
    offset: float = 0.0

    @property
    def pace(self) -> float:
        """Largest step that cannot miss what the wave makes a guard do [s]."""
        return 0.05 / self.frequency

    def value(self, t: Any) -> Any:
        """Value at the times ``t``."""
        s = np.maximum(np.asarray(t) - self.start, 0.0)
        return self.offset + self.amplitude * np.sin(2 * np.pi * self.frequency * s)

    def rate(self, t: Any, within: float) -> Any:
        """Derivative at ``t``; zero before ``start``."""
        w = 2 * np.pi * self.frequency
        on = float(within > self.start)
        return on * self.amplitude * w * np.cos(w * (np.asarray(t) - self.start))

    def corners(self, stop: float) -> np.ndarray:
        """The start."""
        return np.array([self.start]) if 0.0 < self.start < stop else np.empty(0)
