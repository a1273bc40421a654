"""Diode, switch and amplifier."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kc2spice.core.laws.device import Device, Flow, Tap, inside
from kc2spice.core.laws.pin import Pin


@dataclass(frozen=True)
class Diode(Device):
    """``i = saturation (exp(v / slope) - 1)``, straight on above ``i = 100 A``; [A], [V]."""

    name: str
    saturation: float = 1e-12
    slope: float = 0.02585

    @property
    def pins(self) -> tuple[Pin, ...]:
        """Anode ``a``, cathode ``b``."""
        return (Pin("a", "electrical"), Pin("b", "electrical", grounded=True))

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Forward voltage."""
        return (Tap("a", "b"),)

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Forward current."""
        return (Flow("a", "b"),)

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Current and conductance."""
        knee = self.slope * np.log(100.0 / self.saturation)
        v = min(float(e[0]), knee)
        grown = self.saturation * np.exp(v / self.slope)
        conductance = grown / self.slope
        current = grown - self.saturation + conductance * (e[0] - v)
        return np.array([current]), np.array([[conductance]])

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """``v i``."""
        return float(e[0] * self.evaluate(t, e, mode)[0][0])


@dataclass(frozen=True)
class Switch(Device):
    """A resistance ``on`` or ``off`` [Ohm] between ``a`` and ``b``.

    Toggled at ``times`` [s], starting from ``closed``; or, with a ``threshold``, closed while the
    signal ``control`` is above it, opening ``hysteresis`` below.
    """

    name: str
    on: float
    off: float
    times: tuple[float, ...] = ()
    closed: bool = False
    threshold: float | None = None
    hysteresis: float = 0.0

    @property
    def pins(self) -> tuple[Pin, ...]:
        """``a``, ``b`` and, with a threshold, ``control``."""
        poles = (Pin("a", "electrical"), Pin("b", "electrical", grounded=True))
        return poles if self.threshold is None else (*poles, Pin("control", "signal"))

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Voltage, and the control."""
        return (Tap("a", "b"),) if self.threshold is None else (Tap("a", "b"), Tap("control"))

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Current."""
        return (Flow("a", "b"),)

    @property
    def affine(self) -> bool:
        """Within a mode."""
        return True

    def corners(self, stop: float) -> np.ndarray:
        """The times."""
        return np.array([t for t in self.times if 0.0 < t < stop])

    def mode(self, t: float, e: np.ndarray, before: Any = None) -> bool:
        """Closed or not."""
        if self.threshold is not None:
            return bool(e[1] > self.threshold) if before is None else bool(before)
        return self.closed ^ (sum(s <= t for s in self.times) % 2 == 1)

    def guards(self, t: float, e: np.ndarray, mode: Any) -> np.ndarray:
        """Distance of the control from where it toggles."""
        if self.threshold is None:
            return np.empty(0)
        edge = self.threshold - (self.hysteresis if mode else 0.0)
        return np.array([e[1] - edge if mode else edge - e[1]])

    def switch(self, mode: Any, guard: int) -> tuple[Any, str]:
        """Toggle."""
        return not mode, "opens" if mode else "closes"

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Ohm's law."""
        slope = np.zeros((1, e.size))
        slope[0, 0] = 1.0 / (self.on if mode else self.off)
        return slope @ e, slope

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """``v^2 / R``."""
        return float(e[0] ** 2) / (self.on if mode else self.off)


@dataclass(frozen=True)
class Amplifier(Device):
    """A limited amplifier: ``x' = clip(w (clip(gain (v_p - v_n), low, high) - x), -slew, slew)``.

    ``w = 2 pi bandwidth`` [Hz] of its pole; the output pin ``out`` is ``x`` behind ``resistance``
    [Ohm] > 0. Both clips are modes with located corners.
    """

    name: str
    gain: float
    low: float
    high: float
    bandwidth: float
    resistance: float
    slew: float = np.inf
    input_kind: str = "electrical"

    @property
    def pins(self) -> tuple[Pin, ...]:
        """Inputs ``p`` and ``n``, output ``out``, its return ``ret``."""
        ends = (Pin("out", "electrical"), Pin("ret", "electrical", grounded=True))
        return (Pin("p", self.input_kind), Pin("n", self.input_kind, grounded=True), *ends)

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Input and output voltage."""
        return (Tap("p", "n"), Tap("out", "ret"))

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Current into the output."""
        return (Flow("out", "ret"),)

    @property
    def states(self) -> tuple[str, ...]:
        """Output before its resistance."""
        return ("x",)

    @property
    def affine(self) -> bool:
        """Within a mode."""
        return True

    def _demands(self, e: np.ndarray, rail: int) -> tuple[float, float]:
        aim = self.gain * e[0]
        limited = aim if rail == 0 else (self.high if rail > 0 else self.low)
        return aim, 2 * np.pi * self.bandwidth * (limited - e[2])

    def mode(self, t: float, e: np.ndarray, before: Any = None) -> tuple[int, int]:
        """At which rail the aim lies, and the sign of the slew limit: -1, 0 or 1."""
        aim = self.gain * e[0]
        rail = int(aim > self.high) - int(aim < self.low)
        rate = self._demands(e, rail)[1]
        return rail, int(rate > self.slew) - int(rate < -self.slew)

    def guards(self, t: float, e: np.ndarray, mode: Any) -> np.ndarray:
        """Distances of aim and rate from their limits."""
        aim, rate = self._demands(e, mode[0])
        slews = inside(rate, -self.slew, self.slew, mode[1])
        return np.array([*inside(aim, self.low, self.high, mode[0]), *slews])

    def switch(self, mode: Any, guard: int) -> tuple[Any, str]:
        """Meet or leave a limit."""
        which, side = divmod(guard, 2)
        now = list(mode)
        now[which] = 0 if mode[which] else (1 if side else -1)
        words = ("rail", "slew limit")[which]
        return tuple(now), f"{'meets' if now[which] else 'leaves'} its {words}"

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Output current and rate of ``x``."""
        rail, slewing = mode
        w = 2 * np.pi * self.bandwidth
        rate, slope = self._demands(e, rail)[1], np.zeros((2, 3))
        slope[0, 1:] = 1.0 / self.resistance, -1.0 / self.resistance
        if slewing:
            rate = slewing * self.slew
        else:
            slope[1] = 0.0 if rail else w * self.gain, 0.0, -w
        return np.array([slope[0] @ e, rate]), slope

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """Power taken in at the output; negative while it delivers."""
        return float(e[1] * (e[1] - e[2]) / self.resistance)
