"""Controllers: PID, and functions in Python that are asked at intervals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kc2spice.core.laws.device import Device, Tap, inside
from kc2spice.core.laws.pin import Pin


@dataclass(frozen=True)
class Pid(Device):
    """``out = clip(kp e + I + kd d, -limit, limit)``, ``e = setpoint - (across(y) + offset)``.

    ``d = (e - f) / rolloff``, ``f' = d`` is the rolled-off rate; ``I' = ki e`` while switched on
    and not at the limit. Switched on and off at the times ``enable`` and ``disable``; 0 while off.
    """

    name: str
    kp: float
    ki: float
    kd: float
    rolloff: float
    limit: float
    setpoint: float
    offset: float = 0.0
    enable: tuple[float, ...] = (0.0,)
    disable: tuple[float, ...] = ()
    kind: str = "displacement"

    taps = (Tap("y"),)
    states = ("followed", "integral")
    drives = ("out",)
    affine = True
    extra = ("error",)

    @property
    def pins(self) -> tuple[Pin, ...]:
        """Measured quantity ``y``, signal ``out``."""
        return (Pin("y", self.kind), Pin("out", "signal"))

    @property
    def scales(self) -> tuple[float, ...]:
        """A micrometre, and a hundredth of the limit."""
        return (1e-6, 0.01 * self.limit)

    def initial(self, taps: np.ndarray) -> np.ndarray:
        """At rest."""
        return np.array([self._error(taps), 0.0])

    def _error(self, e: np.ndarray) -> float:
        return self.setpoint - self.offset - float(e[0])

    def demand(self, e: np.ndarray) -> float:
        """What it asks for before the limit."""
        error = self._error(e)
        return self.kp * error + e[2] + self.kd * (error - e[1]) / self.rolloff

    def corners(self, stop: float) -> np.ndarray:
        """Times of switching on and off."""
        return np.array([t for t in (*self.enable, *self.disable) if 0.0 < t < stop])

    def mode(self, t: float, e: np.ndarray, before: Any = None) -> tuple[bool, int]:
        """On or off, and the sign of the limit that holds: -1, 0 or 1."""
        last_on = max((s for s in self.enable if s <= t), default=-np.inf)
        last_off = max((s for s in self.disable if s <= t), default=-np.inf)
        on = last_on > last_off
        demand = self.demand(e)
        return on, (int(demand > self.limit) - int(demand < -self.limit) if on else 0)

    def guards(self, t: float, e: np.ndarray, mode: Any) -> np.ndarray:
        """Distances from the limits."""
        on, side = mode
        return np.array(inside(self.demand(e), -self.limit, self.limit, side)) if on else np.ones(2)

    def switch(self, mode: Any, guard: int) -> tuple[Any, str]:
        """Meet or leave the limit."""
        on, side = mode
        now = 0 if side else (1 if guard else -1)
        return (on, now), f"out {'meets' if now else 'leaves'} its limit"

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Rates of both states, then the output."""
        on, side = mode
        error = self._error(e)
        out, jac = np.zeros(3), np.zeros((3, 3))
        out[0] = (error - e[1]) / self.rolloff
        jac[0, :2] = -1.0 / self.rolloff
        if on and side == 0:
            out[1], jac[1, 0] = self.ki * error, -self.ki
            out[2] = self.demand(e)
            jac[2] = -self.kp - self.kd / self.rolloff, -self.kd / self.rolloff, 1.0
        elif on:
            out[2] = side * self.limit
        return out, jac

    def waves(self, t: float, e: np.ndarray, mode: Any) -> dict[str, float]:
        """The error."""
        return {"error": self._error(e)}
