"""The contact: its normal law, stated by its energy, and what it means to the integrator."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from kc2spice.core.laws import Device, Flow, Pin, Tap, inside
from kc2spice.netlist.expression import Name, Tree, walk
from kc2spice.physics.expression import ONE, derivative, expression, function, over, plus


@dataclass(frozen=True)
class Normal:
    """``F = f(x) max(0, 1 + damping x')`` along the axis, with friction beside it;
    ``f(x) = stiffness x^power (curve_0 + curve_1 s + ...)``, ``s = sqrt(x / depth)``.

    ``stiffness`` in N/m^power; ``power`` is 1, or a half more than a whole number. The law with
    more than one ``curve`` holds up to ``depth`` [m], under a sphere of ``radius`` [m]; the
    surfaces follow its force within ``pace`` [s], as ``f(x + pace x')``. ``friction`` is Coulomb's
    coefficient, ``creep`` [m/s] the speed at which it is reached.
    """

    stiffness: float
    power: float = 1.0
    damping: float = 0.0
    friction: float = 0.0
    creep: float = 1e-4
    curve: tuple[float, ...] = (1.0,)
    depth: float = math.inf
    pace: float = 0.0
    radius: float = 0.0

    @property
    def linear(self) -> bool:
        """Whether the force is in proportion to the depth."""
        return self.power == 1.0 and len(self.curve) == 1

    def energy(self, x: np.ndarray) -> np.ndarray:
        """``int f dx`` [J], 0 where nothing touches."""
        return self._of(0, np.maximum(x, 0.0))

    def force(self, x: np.ndarray) -> np.ndarray:
        """``f(x)`` [N], 0 where nothing touches."""
        return self._of(1, np.maximum(x, 0.0))

    def pressed(self, x: np.ndarray, closed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``f(x)`` [N] and its slope [N/m] where ``closed``; a linear one goes on where it pulls,
        so that its corner is seen from both sides."""
        x = x if self.linear else np.maximum(x, 0.0)
        return self._of(1, x) * closed, self._of(2, x) * closed

    def _of(self, order: int, x: np.ndarray) -> np.ndarray:
        depth = self.depth if math.isfinite(self.depth) else 1.0
        at = x if self.linear else np.sqrt(x / depth)
        made = _functions(self.power, len(self.curve))[order]
        found = made(at, self.stiffness * depth**self.power, depth, *self.curve)[0]
        return np.asarray(found * np.ones_like(x))

    def text(self, x: str, scale: str) -> str:
        """``f`` on a card, of the depth ``x`` with the names c1, … of its curve.

        A root of less than 1e-12 is that of 1e-12, so that its slope is finite.
        """
        closed, root = f"{scale}*max(0, {x})", f"sqrt(max(1e-12, {x}))"
        if self.linear:
            return closed
        terms = _stated(self.power, len(self.curve))[1]
        found = {True: list[str](), False: list[str]()}
        for k, term in enumerate(terms):  # an odd power of r is one of x times a root
            odd = sum(node == Name("r") for node in walk(term)) % 2 == 1
            found[odd].append(f"c{k}" if k else "1")
        if not found[False]:
            return f"{closed}*{root}"
        return f"{closed}*({root}*({_horner(found[True], x)})+{x}*({_horner(found[False], x)}))"


def _horner(names: list[str], x: str) -> str:
    """The polynomial of ``x`` with these coefficients."""
    first, *rest = names
    if len(rest) < 2:
        return "+".join([first, *(f"{x}*{name}" for name in rest)])
    return f"{first}+{x}*({_horner(rest, x)})"


@cache
def _stated(power: float, count: int) -> tuple[tuple[Tree, ...], ...]:
    """Terms of the energy, which is what is stated, and from them those of force and slope.

    They depend on the depth ``x`` where the law is linear, else on the root ``r`` of ``x / depth``.
    """
    metric: Tree = ONE
    if power == 1.0 and count == 1:
        found, name = [expression("0.5*scale*c0*x^2")], "x"
    else:
        first = int(2 * power) + 2
        terms = (f"2*scale*depth*c{k}*r^{first + k}/{first + k}" for k in range(count))
        found, name, metric = list(map(expression, terms)), "r", expression("2*depth*r")
    made = [tuple(found)]
    for _ in range(2):
        made.append(tuple(over(derivative(term, name), metric) for term in made[-1]))
    return tuple(made)


@cache
def _functions(power: float, count: int) -> tuple[Callable[..., tuple[np.ndarray, ...]], ...]:
    """Energy, force and slope by the coordinate, ``scale``, ``depth`` and the curve."""
    name = "x" if power == 1.0 and count == 1 else "r"
    arguments = (name, "scale", "depth", *(f"c{k}" for k in range(count)))
    return tuple(function([plus(*terms)], arguments) for terms in _stated(power, count))


@dataclass(frozen=True)
class ContactLaw(Device):
    """One-sided springs from the pins ``ports`` against the pin ``b``, and dry friction.

    ``F_i = f(pen_i) max(0, 1 + damping pen_i')``, ``pen_i = u_i - u_b - gap_i > 0`` (Hunt and
    Crossley 1975) by the law ``normal``; ``gaps`` (n,) [m]. Surfaces that part faster than
    ``1 / damping`` do not pull: the dent is left behind.

    With ``friction`` a force of at most ``friction sum F_i`` (Coulomb) acts against the sliding of
    the pin ``slide`` over ``rail``: ``sum F_i friction clip(v / creep, -1, 1)`` at the speed v;
    below the speed ``creep`` [m/s] it is viscous, which stands for sticking. Of surfaces that
    follow within ``pace`` [s] all of this is said of ``pen + pace pen'`` instead of ``pen``.

    The surface of ``b`` may carry another pin, whose displacement adds to its own and on which the
    forces act as well.
    """

    name: str
    ports: tuple[str, ...]
    normal: Normal
    gaps: np.ndarray
    carried: str = ""
    kind: str = "displacement"

    @property
    def pins(self) -> tuple[Pin, ...]:
        """The ports, what ``b`` carries, ``b``, and with friction ``slide`` and ``rail``."""
        own = tuple(Pin(p, self.kind) for p in (*self.ports, self.carried) if p)
        along = (Pin("slide", self.kind), Pin("rail", self.kind, grounded=True))
        return (*own, Pin("b", self.kind, grounded=True), *(along if self.normal.friction else ()))

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Approach of every pair, their rates where there is damping, the speed of sliding."""
        near = tuple(Tap(p, "b", less=self.carried) for p in self.ports)
        rates = tuple(Tap(p, "b", rate=True, less=self.carried) for p in self.ports if self._rated)
        return near + rates + ((Tap("slide", "rail", rate=True),) if self.normal.friction else ())

    @property
    def _rated(self) -> bool:
        return bool(self.normal.damping or self.normal.pace)

    @property
    def flows(self) -> tuple[Flow, ...]:
        """A force per pair, and the friction."""
        along = (Flow("slide", "rail"),) if self.normal.friction else ()
        return (*(Flow(p, "b", self.carried) for p in self.ports), *along)

    @property
    def affine(self) -> bool:
        """A linear spring without damping or friction."""
        return self.normal.linear and not self._rated and not self.normal.friction

    def _penetration(self, e: np.ndarray) -> np.ndarray:
        n = len(self.ports)
        return e[:n] - self.gaps + (self.normal.pace * e[n : 2 * n] if self.normal.pace else 0.0)

    def _factor(self, e: np.ndarray) -> np.ndarray:
        """``1 + damping pen'`` (n,)."""
        n = len(self.ports)
        return 1.0 + self.normal.damping * e[n : 2 * n] if self.normal.damping else np.ones(n)

    def mode(self, t: float, e: np.ndarray, before: Any = None) -> tuple[int, ...]:
        """Of each pair: 0 open, 1 pressing, 2 parting faster than the dent comes back; then the
        direction of sliding, 0 below ``creep``."""
        state = np.where(self._penetration(e) > 0.0, np.where(self._factor(e) > 0.0, 1, 2), 0)
        own = self.normal
        slides = int(np.sign(e[-1])) * int(abs(e[-1]) > own.creep) if own.friction else 0
        return (*state.tolist(), slides)

    def guards(self, t: float, e: np.ndarray, mode: Any) -> np.ndarray:
        """A closed pair can open, press or not; sliding can begin to either side, or end."""
        state = np.array(mode[:-1])
        edge = np.where(state > 0, 1.0, -1.0) * self._penetration(e)
        pull = np.where(state == 2, -1.0, 1.0) * np.where(state == 0, 1.0, self._factor(e))
        found = [edge, pull] if self.normal.damping else [edge]
        if self.normal.friction:
            creep = self.normal.creep
            found.append(np.array(inside(float(e[-1]), -creep, creep, mode[-1])))
        return np.concatenate(found)

    def switch(self, mode: Any, guard: int) -> tuple[Any, str]:
        """One pair opens, closes or lets go; sliding begins or ends."""
        n = len(self.ports)
        first = 2 * n if self.normal.damping else n
        if guard >= first:
            slides = 0 if mode[-1] else 2 * (guard - first) - 1
            return (*mode[:-1], slides), f"slide {'begins' if slides else 'ends'}"
        k, state = guard % n, mode[guard % n]
        now = (1 if state == 0 else 0) if guard < n else 3 - state
        said = "opens" if now == 0 else "closes" if state == 0 else ""
        return (*mode[:k], now, *mode[k + 1 :]), f"{self.ports[k]} {said}" if said else ""

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Forces of the pairs, and the friction."""
        press = np.array(mode[:-1]) == 1
        elastic, slope = self.normal.pressed(self._penetration(e), np.array(mode[:-1]) > 0)
        factor = self._factor(e) * press
        force, parts = elastic * factor, [np.diag(slope * factor)]
        if self._rated:
            own = self.normal
            parts.append(np.diag(elastic * own.damping * press + slope * factor * own.pace))
        by_taps = np.hstack(parts)
        if not self.normal.friction:
            return force, by_taps
        slides = mode[-1]
        drag = self.normal.friction * (float(slides) if slides else e[-1] / self.normal.creep)
        steep = 0.0 if slides else self.normal.friction * force.sum() / self.normal.creep
        along = np.append(drag * by_taps.sum(axis=0), steep)
        by_taps = np.vstack((np.column_stack((by_taps, np.zeros(force.size))), along))
        return np.append(force, drag * force.sum()), by_taps

    def energy(self, e: np.ndarray, mode: Any) -> float:
        """``int f d pen``."""
        return float(self.normal.energy(e[: len(self.ports)] - self.gaps).sum())

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """What closes damped springs, and friction times speed."""
        n = len(self.ports)
        if self.affine:
            return 0.0
        through = self.evaluate(t, e, mode)[0]
        lost = float(through[-1] * e[-1]) if self.normal.friction else 0.0
        return lost + float(through[:n] @ e[n : 2 * n]) if self._rated else lost

    def stores(self, first: np.ndarray, last: np.ndarray, mode: Any) -> float | None:
        """What the springs hold; where a dent begins or ends is no event, and no quadrature of its
        power would see the kink there."""
        return self.energy(last, mode) - self.energy(first, mode) if self._rated else None
