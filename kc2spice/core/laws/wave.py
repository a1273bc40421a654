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

    def rate(self, t: Any, within: float, order: int = 1) -> Any:
        """Time derivative at ``t``, of the smooth piece that holds the time ``within``."""
        ...

    def corners(self, stop: float) -> np.ndarray:
        """Times up to ``stop`` where the derivative jumps."""
        ...


@dataclass(frozen=True)
class Line:
    """Straight lines through ``points`` ((t, value), ...), constant before and after.

    Raises UsageError unless times increase strictly (edges take time).
    """

    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        times = np.array([t for t, _ in self.points])
        if times.size == 0 or np.any(np.diff(times) <= 0.0):
            raise UsageError("times of a waveform must increase strictly", got=times.tolist())

    @classmethod
    def constant(cls, value: float) -> Line:
        """The same value at all times."""
        return cls(((0.0, value),))

    @cached_property
    def knots(self) -> tuple[np.ndarray, np.ndarray]:
        """Times and values of the points."""
        times, values = np.array(self.points, dtype=float).T
        return times, values

    def value(self, t: Any) -> Any:
        """Value at the times ``t``."""
        return np.interp(t, *self.knots)

    def rate(self, t: Any, within: float, order: int = 1) -> Any:
        """Slope of the straight piece that holds ``within``, whatever ``t``."""
        times, values = self.knots
        k = int(np.searchsorted(times, within)) - 1
        inside = 0 <= k < times.size - 1 and order == 1
        slope = (values[k + 1] - values[k]) / (times[k + 1] - times[k]) if inside else 0.0
        return slope + 0.0 * np.asarray(t)

    def corners(self, stop: float) -> np.ndarray:
        """All points up to ``stop``."""
        times = self.knots[0]
        return times[(times > 0.0) & (times < stop)] if times.size > 1 else np.empty(0)


@dataclass(frozen=True)
class Recorded:
    """A smooth curve through ``values`` at ``times`` (n,) of cubics (Akima, J. ACM 17, 589, 1970).

    Every 16th sample is a corner: no step of an integrator is longer than what was sampled
    there, so that an event after a long rest is not stepped over.
    """

    times: np.ndarray
    values: np.ndarray

    @cached_property
    def _curve(self) -> Any:
        from scipy.interpolate import Akima1DInterpolator

        return Akima1DInterpolator(self.times, self.values)

    def value(self, t: Any) -> Any:
        """Value at the times ``t``, constant before and after the samples."""
        return self._curve(np.clip(t, self.times[0], self.times[-1]))

    def rate(self, t: Any, within: float, order: int = 1) -> Any:
        """Derivative at the times ``t``."""
        return self._curve(np.clip(t, self.times[0], self.times[-1]), order)

    def corners(self, stop: float) -> np.ndarray:
        """Every 16th sample up to ``stop``."""
        times = self.times[::16]
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

    def rate(self, t: Any, within: float, order: int = 1) -> Any:
        """Derivative at ``t``; zero before ``start``."""
        w = 2 * np.pi * self.frequency
        turned = np.sin(w * (np.asarray(t) - self.start) + 0.5 * np.pi * order)
        return float(within > self.start) * self.amplitude * w**order * turned

    def corners(self, stop: float) -> np.ndarray:
        """The start."""
        return np.array([self.start]) if 0.0 < self.start < stop else np.empty(0)
