"""What a driver's waveforms must obey: rails, slew rate, current, and gain within its bandwidth.

Everything is asked of the saved waveforms alone, so that a driver's netlist is held against its
keys by arithmetic that the netlist has no part in.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kc2spice.scene.judge import Check

SLACK = 1e-3  # of the span or the current: rails give by millivolts, saved points have reltol
LAG = 2e-3  # of the swing: saved points with trapezoids between them; up to 2e-4 was found
LINEAR = 0.98  # of slew rate and current up to which a stage is linear
MEANING = "the driver's netlist is not its keys: please report it"


def check(name: str, what: str, value: float, limit: float, unit: str, advice: str) -> Check:
    """A check of a driver, which an edited deck may violate on purpose."""
    return Check(f"{name} {what}", value, limit, unit, advice, wiring=True)


def within(
    name: str,
    volts: np.ndarray,
    low: np.ndarray | float,
    high: np.ndarray | float,
    slack: float,
    advice: str = MEANING,
) -> Check:
    """``low <= volts <= high`` but for ``slack`` [V]."""
    beyond = float(np.maximum(volts - high, low - volts).max())
    return check(name, "within its rails", max(0.0, beyond), slack, "V beyond", advice)


def bounded(name: str, current: np.ndarray, limit: float) -> Check:
    """``|current| <= limit`` [A]."""
    most = float(np.abs(current).max(initial=0.0))
    return check(name, "within its current", most, (1 + SLACK) * limit, "A", MEANING)


def slewing(
    name: str, time: np.ndarray, volts: np.ndarray, slew: float, slack: float, advice: str = MEANING
) -> Check:
    """``|volts(t2) - volts(t1)| <= slew (t2 - t1)`` for every two times, but for ``slack`` [V]."""
    most = 0.0
    for sign in (1.0, -1.0):
        ahead = sign * volts - slew * time
        most = max(most, float((ahead - np.minimum.accumulate(ahead)).max(initial=0.0)))
    return check(name, "within its slew rate", most, slack, "V ahead", advice)


@dataclass(frozen=True)
class Stage:
    """A power stage: ``d volts/dt = 2 pi gbw error`` between rails, with slew rate and current.

    ``error`` [V] is what stands between its inputs, ``volts`` and ``current`` are those of its
    output, which has the resistance ``rout``; ``feedback`` is the share of the output that returns.
    """

    time: np.ndarray
    error: np.ndarray
    volts: np.ndarray
    current: np.ndarray
    low: float
    high: float
    slew: float
    limit: float
    gbw: float
    feedback: float = 1.0
    rout: float = 0.1

    def checks(self, name: str) -> Iterator[Check]:
        """Rails, current, slew rate, and gain times input within the bandwidth."""
        span = self.high - self.low
        inner = self.volts + self.rout * self.current  # before the output resistance
        free = np.abs(self.current) < LINEAR * self.limit
        yield within(
            name,
            inner,
            self.low,
            self.high,
            SLACK * span,
            "its load drives it beyond its rails, where diodes of a real output would conduct",
        )
        yield bounded(name, self.current, self.limit)
        yield slewing(name, self.time[free], inner[free], self.slew, LAG * span)
        lag = self._lag(inner, free, SLACK * span) / max(float(np.ptp(inner)), SLACK * span)
        yield check(name, "follows its command", lag, LAG, "of its swing", MEANING)

    def _lag(self, inner: np.ndarray, free: np.ndarray, margin: float) -> float:
        """Largest mean of ``error - (d inner/dt) / (2 pi gbw)`` over a time constant of the loop,
        as a voltage at the output, where the stage is linear."""
        pace = 2 * np.pi * self.gbw
        linear = free & (inner < self.high - margin) & (inner > self.low + margin)
        linear &= np.abs(self.error) * pace < LINEAR * self.slew
        step = np.diff(self.time)
        area = np.r_[0.0, np.cumsum(step * (self.error[1:] + self.error[:-1]) / 2)]
        whole = np.r_[0, np.cumsum(~(linear[1:] & linear[:-1]))]  # the same within linear pieces
        first = np.arange(self.time.size)
        last = np.searchsorted(self.time, self.time + 1 / (pace * self.feedback))
        last = np.minimum(last, self.time.size - 1)
        good = (last > first) & (whole[last] == whole[first])
        first, last = first[good], last[good]
        lasted = self.time[last] - self.time[first]
        off = (area[last] - area[first] - (inner[last] - inner[first]) / pace) / lasted
        return float(np.abs(off).max(initial=0.0)) / self.feedback


def relaxed(time: np.ndarray, towards: np.ndarray, constant: float) -> np.ndarray:
    """``x' = (towards - x) / constant`` from rest, by trapezoids."""
    found = np.empty_like(towards)
    found[0] = towards[0]
    share = np.diff(time) / (2 * constant)
    drive = share * (towards[1:] + towards[:-1])
    for k in range(share.size):
        found[k + 1] = ((1 - share[k]) * found[k] + drive[k]) / (1 + share[k])
    return found
