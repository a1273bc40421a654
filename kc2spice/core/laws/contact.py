"""One-sided springs with damping and dry friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kc2spice.core.laws.device import Device, Flow, Tap, inside
from kc2spice.core.laws.pin import Pin


@dataclass(frozen=True)
class Contact(Device):
    """One-sided springs from the pins ``ports`` against the pin ``b``, and dry friction.

    ``F_i = stiffness_i pen_i^power max(0, 1 + damping pen_i')``, ``pen_i = u_i - u_b - gap_i > 0``
    (Hunt and Crossley 1975; ``damping`` in s/m). ``stiffness`` (n,) [N/m^power], ``gaps`` (n,) [m].
    Surfaces that part faster than ``1 / damping`` do not pull: the dent is left behind.

    With ``friction`` a force of at most ``friction sum F_i`` (Coulomb) acts against the sliding of
    the pin ``slide`` over ``rail``: ``sum F_i friction clip(v / creep, -1, 1)`` at the speed v;
    below the speed ``creep`` [m/s] it is viscous, which stands for sticking.

    ``curve`` multiplies the force by ``sum_k curve_k sqrt(pen / depth)^k``. Of surfaces that follow
    within ``pace`` [s] all of this is said of ``pen + pace pen'`` instead of ``pen``.

    The surface of ``b`` may carry another pin, whose displacement adds to its own and on which the
    forces act as well.
    """

    name: str
    ports: tuple[str, ...]
    stiffness: np.ndarray
    gaps: np.ndarray
    damping: float = 0.0
    power: float = 1.0
    friction: float = 0.0
    creep: float = 1e-4
    curve: tuple[float, ...] = (1.0,)
    depth: float = 1.0
    pace: float = 0.0
    carried: str = ""
    kind: str = "displacement"

    @property
    def pins(self) -> tuple[Pin, ...]:
        """The ports, what ``b`` carries, ``b``, and with friction ``slide`` and ``rail``."""
        own = tuple(Pin(p, self.kind) for p in (*self.ports, self.carried) if p)
        along = (Pin("slide", self.kind), Pin("rail", self.kind, grounded=True))
        return (*own, Pin("b", self.kind, grounded=True), *(along if self.friction else ()))

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Approach of every pair, their rates where there is damping, the speed of sliding."""
        near = tuple(Tap(p, "b", less=self.carried) for p in self.ports)
        rates = tuple(Tap(p, "b", rate=True, less=self.carried) for p in self.ports if self._rated)
        return near + rates + ((Tap("slide", "rail", rate=True),) if self.friction else ())

    @property
    def _rated(self) -> bool:
        return bool(self.damping or self.pace)

    @property
    def flows(self) -> tuple[Flow, ...]:
        """A force per pair, and the friction."""
        along = (Flow("slide", "rail"),) if self.friction else ()
        return (*(Flow(p, "b", self.carried) for p in self.ports), *along)

    @property
    def affine(self) -> bool:
        """A linear spring without damping or friction."""
        plain = self.power == 1.0 and len(self.curve) == 1
        return plain and not self._rated and not self.friction

    def _penetration(self, e: np.ndarray) -> np.ndarray:
        n = len(self.ports)
        return e[:n] - self.gaps + (self.pace * e[n : 2 * n] if self.pace else 0.0)

    def _factor(self, e: np.ndarray) -> np.ndarray:
        """``1 + damping pen'`` (n,)."""
        n = len(self.ports)
        return 1.0 + self.damping * e[n : 2 * n] if self.damping else np.ones(n)

    def mode(self, t: float, e: np.ndarray, before: Any = None) -> tuple[int, ...]:
        """Of each pair: 0 open, 1 pressing, 2 parting faster than the dent comes back; then the
        direction of sliding, 0 below ``creep``."""
        state = np.where(self._penetration(e) > 0.0, np.where(self._factor(e) > 0.0, 1, 2), 0)
        slides = int(np.sign(e[-1])) * int(abs(e[-1]) > self.creep) if self.friction else 0
        return (*state.tolist(), slides)

    def guards(self, t: float, e: np.ndarray, mode: Any) -> np.ndarray:
        """A closed pair can open, press or not; sliding can begin to either side, or end."""
        state = np.array(mode[:-1])
        edge = np.where(state > 0, 1.0, -1.0) * self._penetration(e)
        pull = np.where(state == 2, -1.0, 1.0) * np.where(state == 0, 1.0, self._factor(e))
        found = [edge, pull] if self.damping else [edge]
        if self.friction:
            slides = mode[-1]
            found.append(np.array(inside(float(e[-1]), -self.creep, self.creep, slides)))
        return np.concatenate(found)

    def switch(self, mode: Any, guard: int) -> tuple[Any, str]:
        """One pair opens, closes or lets go; sliding begins or ends."""
        n = len(self.ports)
        first = 2 * n if self.damping else n
        if guard >= first:
            slides = 0 if mode[-1] else 2 * (guard - first) - 1
            return (*mode[:-1], slides), f"slide {'begins' if slides else 'ends'}"
        k, state = guard % n, mode[guard % n]
        now = (1 if state == 0 else 0) if guard < n else 3 - state
        said = "opens" if now == 0 else "closes" if state == 0 else ""
        return (*mode[:k], now, *mode[k + 1 :]), f"{self.ports[k]} {said}" if said else ""

    def _elastic(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Undamped forces (n,) of the closed pairs, and their slopes."""
        closed, pen = np.array(mode[:-1]) > 0, self._penetration(e)
        if self.power == 1.0 and len(self.curve) == 1:
            return self.stiffness * pen * closed, self.stiffness * closed
        return self._static(np.maximum(pen, 0.0) * closed)

    def _static(self, deep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces (n,) at rest, this ``deep`` (n,) [m], and their slopes."""
        s, power = np.sqrt(deep / self.depth), self.power + np.arange(len(self.curve)) / 2
        value, slope = (np.polynomial.polynomial.polyval(s, c) for c in (
            self.curve, power * self.curve,
        ))  # fmt: skip
        return (
            self.stiffness * deep**self.power * value,
            self.stiffness * deep ** (self.power - 1.0) * slope,
        )

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Forces of the pairs, and the friction."""
        press = np.array(mode[:-1]) == 1
        elastic, slope = self._elastic(e, mode)
        factor = self._factor(e) * press
        force, parts = elastic * factor, [np.diag(slope * factor)]
        if self._rated:
            parts.append(np.diag(elastic * self.damping * press + slope * factor * self.pace))
        by_taps = np.hstack(parts)
        if not self.friction:
            return force, by_taps
        slides = mode[-1]
        drag = self.friction * (float(slides) if slides else e[-1] / self.creep)
        steep = 0.0 if slides else self.friction * force.sum() / self.creep
        along = np.append(drag * by_taps.sum(axis=0), steep)
        by_taps = np.vstack((np.column_stack((by_taps, np.zeros(force.size))), along))
        return np.append(force, drag * force.sum()), by_taps

    def energy(self, e: np.ndarray, mode: Any) -> float:
        """``int f d pen``, of every term ``stiffness pen^(power + 1) / (power + 1)``."""
        deep = self._depth(e)
        power = self.power + 1 + np.arange(len(self.curve)) / 2
        series = np.polynomial.polynomial.polyval(
            np.sqrt(deep / self.depth), np.array(self.curve) / power
        )
        return float((self.stiffness * deep ** (self.power + 1) * series).sum())

    def _depth(self, e: np.ndarray) -> np.ndarray:
        return np.maximum(e[: len(self.ports)] - self.gaps, 0.0)

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """What closes damped springs, and friction times speed."""
        n = len(self.ports)
        if self.affine:
            return 0.0
        through = self.evaluate(t, e, mode)[0]
        lost = float(through[-1] * e[-1]) if self.friction else 0.0
        return lost + float(through[:n] @ e[n : 2 * n]) if self._rated else lost

    def stores(self, first: np.ndarray, last: np.ndarray, mode: Any) -> float | None:
        """What the springs hold; where a dent begins or ends is no event, and no quadrature of its
        power would see the kink there."""
        return self.energy(last, mode) - self.energy(first, mode) if self._rated else None
