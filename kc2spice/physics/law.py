"""A declaration as a law of the independent integrator: residual, exact Jacobian, modes, energy."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import Device, Flow, Pin, Tap
from kc2spice.netlist.expression import Name, Tree
from kc2spice.physics.declaration import LOOPS, RATE, Branch, Declaration
from kc2spice.physics.expression import (
    ZERO,
    derivative,
    flagged,
    function,
    kinks,
    minus,
    names,
)

_KIND = {"displacement": "displacement", "voltage": "electrical", "current": "electrical"}
_Made = Callable[..., tuple[Any, ...]]


@dataclass(frozen=True)
class DeclaredLaw(Device):
    """The law of a part with these ``values`` of its parameters."""

    name: str
    declaration: Declaration
    values: tuple[float, ...]
    start: tuple[float, float] | None = None  # of its mass

    def _of(self, *kinds: str) -> tuple[Branch, ...]:
        return tuple(b for b in self.declaration.branches if b.kind in kinds)

    @property
    def pins(self) -> tuple[Pin, ...]:
        result: dict[str, Pin] = {}
        for b in self.declaration.branches:
            loop = b.plus == LOOPS  # no current flows to it
            result.setdefault(b.plus, Pin(b.plus, _KIND[b.kind], grounded=loop))
            result.setdefault(b.minus, Pin(b.minus, _KIND[b.kind], grounded=True))
            if b.less:
                result.setdefault(b.less, Pin(b.less, _KIND[b.kind]))
        return tuple(result.values())

    @property
    def taps(self) -> tuple[Tap, ...]:
        across = [Tap(b.plus, b.minus, less=b.less) for b in self.declaration.branches]
        rates = (Tap(b.plus, b.minus, True, b.less) for b in self.declaration.damped)
        return (*across, *rates)

    @property
    def flows(self) -> tuple[Flow, ...]:
        return tuple(Flow(b.plus, b.minus, b.less) for b in self.declaration.branches)

    @property
    def charged(self) -> tuple[int, ...]:
        d = self.declaration
        return tuple(
            k
            for k, b in enumerate(d.branches)
            if b.kind == "voltage" or (b.kind != "current" and d.kept(b) != ZERO)
        )

    @property
    def states(self) -> tuple[str, ...]:
        return tuple(b.name for b in self._of("current"))

    @cached_property
    def _seen(self) -> tuple[str, ...]:
        """Names of the inputs."""
        d = self.declaration
        across = [f"{b.name}_drop" if b.kind == "current" else b.name for b in d.branches]
        return (*across, *(b.name + RATE for b in d.damped), *self.states)

    @cached_property
    def affine(self) -> bool:
        d = self.declaration
        trees = [d.direct(b) for b in d.branches if b.kind == "displacement"]
        slopes = (flagged(derivative(t, n), self._corners) for t in trees for n in self._seen)
        constant = not any(names(slope) & set(self._seen) for slope in slopes)
        return constant and len(trees) == len(d.branches)

    @property
    def linear(self) -> bool:
        return self.declaration.linear

    @cached_property
    def _corners(self) -> tuple[Tree, ...]:
        """Arguments of all one-sided expressions, whose signs make modes."""
        d = self.declaration
        trees = [d.stored, *(x for b in d.branches for x in (d.direct(b), d.kept(b)))]
        return tuple(dict.fromkeys(e for tree in trees for e in kinks(tree)))

    def _made(self, trees: Iterable[Tree], slopes: bool = False) -> _Made:
        """Values of ``trees``, then the derivatives of each by all inputs."""
        flags = [f"flag{k}" for k in range(len(self._corners))]
        trees = list(trees)
        rows = [derivative(tree, name) for tree in trees for name in self._seen if slopes]
        smooth = [flagged(tree, self._corners) for tree in (*trees, *rows)]
        return function(smooth, (*self._seen, *flags, *self.declaration.parameters))

    @cached_property
    def _out(self) -> _Made:
        d = self.declaration
        flows = [Name(b.name) if b.kind == "current" else d.direct(b) for b in d.branches]
        rates = [minus(Name(f"{b.name}_drop"), d.direct(b)) for b in self._of("current")]
        return self._made([*flows, *rates], slopes=True)

    @cached_property
    def _kept(self) -> _Made:
        stored = (*self._of("current"), *(self.declaration.branches[k] for k in self.charged))
        return self._made([self.declaration.kept(b) for b in stored], slopes=True)

    @cached_property
    def _energies(self) -> _Made:
        return self._made([self.declaration.stored, self.declaration.lost])

    @cached_property
    def _guards(self) -> _Made:
        return self._made(self._corners)

    @cached_property
    def _bounds(self) -> _Made:
        return self._made(self.declaration.bounds.values())

    def _called(self, made: _Made, e: np.ndarray, mode: Any) -> np.ndarray:
        return np.array(made(*e.tolist(), *mode, *self.values), dtype=float)

    def _split(self, made: _Made, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        result = self._called(made, e, mode)
        count = result.size // (1 + e.size)
        return result[:count], result[count:].reshape(count, e.size)

    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        return self._split(self._out, e, mode)

    def store(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Fluxes of the currents, then charges of the voltages and momenta."""
        return self._split(self._kept, e, mode)

    def mode(self, t: float, e: np.ndarray) -> tuple[int, ...]:
        flags: tuple[int, ...] = (0,) * len(self._corners)
        for k in range(len(flags)):  # one may depend on those before
            above = self._called(self._guards, e, flags)[k] > 0.0
            flags = (*flags[:k], int(above), *flags[k + 1 :])
        return flags

    def guards(self, e: np.ndarray, mode: Any) -> np.ndarray:
        return self._called(self._guards, e, mode) * np.where(np.array(mode) > 0, 1.0, -1.0)

    def switch(self, mode: Any, guard: int) -> tuple[int, ...]:
        return (*mode[:guard], 1 - mode[guard], *mode[guard + 1 :])

    @cached_property
    def _loss(self) -> _Made:
        return self._made(map(self.declaration.loss, self.declaration.branches))

    def noise(self, s: complex, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray] | None:
        """A force, a current, or a voltage in series with every loss."""
        branches, currents = self.declaration.branches, self._of("current")
        root = np.sqrt(self._called(self._loss, e, mode))
        out = np.zeros((len(branches) + len(currents), len(branches)))
        for k, b in enumerate(branches):
            out[len(branches) + currents.index(b) if b in currents else k, k] = root[k]
        return out, np.zeros((len(currents) + len(self.charged), len(branches)))

    def check(self, t: float, e: np.ndarray) -> None:
        result = self._called(self._bounds, e, self.mode(t, e))
        for what, value in zip(self.declaration.bounds, result, strict=True):
            if value <= 0.0:
                raise SimulationError(
                    f"{what} is exceeded",
                    where=f"{self.name} at t = {t:.6e} s",
                    got=f"{self.declaration.limits[what]} = {value:g}",
                    expected="above zero",
                )

    def energy(self, e: np.ndarray, mode: Any) -> float:
        return float(self._called(self._energies, e, mode)[0])

    def loss(self, e: np.ndarray, mode: Any) -> float:
        if self.declaration.lost == ZERO:
            return 0.0
        return float(self._called(self._energies, e, mode)[1])
