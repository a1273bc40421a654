"""A declaration as a law of the independent integrator: residual, exact Jacobian, modes, energy."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, product
from typing import Any

import numpy as np

from kc2spice.core.domains import TRANSLATION
from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import Device, Flow, LawPin, Tap
from kc2spice.netlist.expression import Name, Number, Tree, substitute
from kc2spice.physics.declaration import LOOPS, RATE, Branch, Declaration
from kc2spice.physics.symbolic import (
    ZERO,
    derivative,
    flagged,
    function,
    kinks,
    minus,
    names,
    plus,
    times,
)

_Compiled = Callable[..., tuple[Any, ...]]
_Table = Callable[[float], float]


def _number(value: float) -> Number:
    return Number(f"{value:g}")


@dataclass(frozen=True)
class DeclaredLaw(Device):
    """The law of a part with these ``values`` of its parameters, and with the functions that its
    ``tables`` and their derivatives are."""

    name: str
    declaration: Declaration
    values: tuple[float, ...]
    start: tuple[float, float] | None = None  # initial state of its mass
    tables: Mapping[str, _Table] = field(default_factory=dict, compare=False)

    @property
    def _flowing(self) -> tuple[Branch, ...]:
        return tuple(b for b in self.declaration.branches if b.flows)

    @property
    def pins(self) -> tuple[LawPin, ...]:
        result: dict[str, LawPin] = {}
        kinds = self._kinds
        for b in self.declaration.branches:
            loop = b.plus == LOOPS  # no current flows to it
            result.setdefault(b.plus, LawPin(b.plus, kinds[b.plus], grounded=loop))
            result.setdefault(b.minus, LawPin(b.minus, kinds[b.minus], grounded=True))
            if b.less:
                result.setdefault(b.less, LawPin(b.less, kinds[b.less]))
        outputs = (LawPin(name, "signal") for name in self.prescribes)
        return (*result.values(), *outputs)

    @property
    def prescribes(self) -> tuple[str, ...]:
        return tuple(self.declaration.outputs)

    @property
    def taps(self) -> tuple[Tap, ...]:
        across = [Tap(b.plus, self._minus(b), less=b.less) for b in self.declaration.branches]
        rates = (Tap(b.plus, self._minus(b), True, b.less) for b in self.declaration.damped)
        return (*across, *rates)

    @cached_property
    def _kinds(self) -> dict[str, str]:
        """Kinds of all pins; outputs are signals, as are inputs whose rate is not used."""
        d = self.declaration
        used = {pin for b in (*d.acting, *d.damped) for pin in (b.plus, b.minus, b.less)}
        result = {pin: domain.kind_of_law for pin, domain in d.domains.items()}
        only = (pin for pin in d.domains if pin not in used)
        return result | dict.fromkeys((*only, *d.outputs), "signal")

    def _minus(self, b: Branch) -> str:
        """Lower pin of a branch; empty if it is the reference of another kind of branches."""
        return b.minus if self._kinds[b.minus] == self._kinds[b.plus] else ""

    @property
    def flows(self) -> tuple[Flow, ...]:
        return tuple(Flow(b.plus, b.minus, b.less) for b in self.declaration.acting)

    @property
    def charged(self) -> tuple[int, ...]:
        d = self.declaration
        charges = (not b.flows and d.storage(b) != ZERO for b in d.acting)
        return tuple(k for k, stored in enumerate(charges) if stored)

    @property
    def states(self) -> tuple[str, ...]:
        return (*(b.name for b in self._flowing), *self.declaration.states)

    @property
    def storing(self) -> bool:
        return bool(self._flowing or self.charged)

    @cached_property
    def _inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        d = self.declaration
        across = [f"{b.name}_drop" if b.flows else b.name for b in d.branches]
        return (*across, *(b.name + RATE for b in d.damped), *self.states)

    @cached_property
    def affine(self) -> bool:
        d = self.declaration
        stated = (*map(d.direct, d.acting), *d.changes.values(), *d.read.values())
        trees = [*map(self._plain, stated)]
        pairs = product(trees, self._inputs)
        slopes = (flagged(derivative(tree, name), self._corners) for tree, name in pairs)
        constant = not any(names(slope) & set(self._inputs) for slope in slopes)
        return constant and not self.storing

    @property
    def linear(self) -> bool:
        return self.declaration.linear

    @cached_property
    def _corners(self) -> tuple[Tree, ...]:
        """Arguments of all one-sided expressions, whose signs make modes."""
        d = self.declaration
        trees = (d.stored, *d.branch_trees, *d.changes.values(), *d.read.values())
        corners = chain.from_iterable(kinks(self._plain(tree)) for tree in trees)
        return tuple(dict.fromkeys(corners))

    def _plain(self, tree: Tree) -> Tree:
        """``tree`` by the inputs alone: a signal has the unit of its pin, such as um."""
        kinds, measured = self._kinds, (b for b in self.declaration.branches if not b.through)
        signals = (b for b in measured if kinds[b.plus] == "signal")
        units = {b.name: times(_number(b.domain.across.factor), Name(b.name)) for b in signals}
        return plus(substitute(self.declaration.spelled(tree), units))

    def _stated(self, trees: Iterable[Tree], slopes: bool = False) -> _Compiled:
        """:meth:`_compiled` of what the declaration says."""
        return self._compiled(map(self._plain, trees), slopes)

    def _compiled(self, trees: Iterable[Tree], slopes: bool = False) -> _Compiled:
        """Values of ``trees``, then the derivatives of each by all inputs."""
        flags = [f"flag{k}" for k in range(len(self._corners))]
        trees = list(trees)
        pairs = product(trees, self._inputs if slopes else ())
        rows = [derivative(tree, name) for tree, name in pairs]
        smooth = [flagged(tree, self._corners) for tree in (*trees, *rows)]
        arguments = (*self._inputs, *flags, *self.declaration.parameters)
        return function(smooth, arguments, self.tables)

    @cached_property
    def _out(self) -> _Compiled:
        d = self.declaration
        flows = [Name(b.name) if b.flows else d.direct(b) for b in d.acting]
        rates = [minus(Name(f"{b.name}_drop"), d.direct(b)) for b in self._flowing]
        outputs = (times(_number(TRANSLATION.across.per_unit), tree) for tree in d.read.values())
        return self._stated([*flows, *rates, *d.changes.values(), *outputs], slopes=True)

    @cached_property
    def _storage(self) -> _Compiled:
        d = self.declaration
        fluxes, charges = (
            map(d.storage, self._flowing),
            (d.storage(d.acting[k]) for k in self.charged),
        )
        return self._stated([*fluxes, *map(Name, d.states), *charges], slopes=True)

    @cached_property
    def _energies(self) -> _Compiled:
        return self._stated([self.declaration.stored, self.declaration.dissipation])

    @cached_property
    def _guards(self) -> _Compiled:
        return self._compiled(self._corners)

    @cached_property
    def _bounds(self) -> _Compiled:
        return self._stated(self.declaration.bounds.values())

    def _called(self, compiled: _Compiled, e: np.ndarray, mode: Any) -> np.ndarray:
        return np.array(compiled(*e.tolist(), *mode, *self.values), dtype=float)

    def _split(
        self, compiled: _Compiled, e: np.ndarray, mode: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        result = self._called(compiled, e, mode)
        count = result.size // (1 + e.size)
        return result[:count], result[count:].reshape(count, e.size)

    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        return self._split(self._out, e, mode)

    def store(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Fluxes of the currents, the states, then charges of the voltages and momenta."""
        return self._split(self._storage, e, mode)

    def mode(self, e: np.ndarray) -> tuple[int, ...]:
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
    def _loss(self) -> _Compiled:
        return self._stated(map(self.declaration.loss, self.declaration.acting))

    def noise(self, s: complex, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray] | None:
        """A force, a current, or a voltage in series with every loss."""
        branches, currents = self.declaration.acting, self._flowing
        root = np.sqrt(self._called(self._loss, e, mode))
        rows = len(branches) + len(self.states) + len(self.prescribes)
        out = np.zeros((rows, len(branches)))
        for k, b in enumerate(branches):
            out[len(branches) + currents.index(b) if b in currents else k, k] = root[k]
        return out, np.zeros((len(self.states) + len(self.charged), len(branches)))

    def check(self, t: float, e: np.ndarray) -> None:
        result = self._called(self._bounds, e, self.mode(e))
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
        if self.declaration.dissipation == ZERO:
            return 0.0
        return float(self._called(self._energies, e, mode)[1])
