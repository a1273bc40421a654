"""Laws of declared parts for the independent integrator, with exact derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import chain, filterfalse, product, starmap
from typing import Any

import numpy as np

from kc2spice.core.domains import TRANSLATION
from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import AcrossInput, Device, Flow, LawPin
from kc2spice.core.naming import names_of
from kc2spice.netlist.expression import Name, Number, Tree, substitute_names
from kc2spice.physics.declaration import LOOPS, Branch, Declaration
from kc2spice.physics.symbolic import (
    ZERO,
    add_trees,
    compile_function,
    differentiate_tree,
    find_kinks,
    find_names,
    multiply_trees,
    replace_kinks,
    subtract_trees,
)

_Compiled = Callable[..., tuple[Any, ...]]
_Table = Callable[[float], float]


def _make_number(value: float) -> Number:
    """Return a number as an expression tree."""
    return Number(f"{value:g}")


def _input_name(branch: Branch) -> str:
    """Return the name of the quantity across a branch; for a current, of its voltage."""
    return f"{branch.name}_drop" if branch.flows else branch.name


@dataclass(frozen=True)
class DeclaredLaw(Device):
    """Law of a declared part, with the ``values`` of the part's parameters.

    ``tables`` maps the names of tables and of their derivatives to functions.
    """

    name: str
    declaration: Declaration
    values: tuple[float, ...]
    start: tuple[float, float] | None = None  # initial displacement and velocity of a mass
    tables: Mapping[str, _Table] = field(default_factory=dict, compare=False)

    @property
    def _through_branches(self) -> tuple[Branch, ...]:
        """Branches whose coordinate is a flow, such as a current."""
        return tuple(b for b in self.declaration.branches if b.flows)

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins in the order of the subcircuit."""
        result: dict[str, LawPin] = {}
        kinds = self._pin_kinds
        for b in self.declaration.branches:
            loop = b.plus == LOOPS  # no current flows into the base pin
            result.setdefault(b.plus, LawPin(b.plus, kinds[b.plus], grounded=loop))
            inner = b.minus in self.declaration.inner
            result.setdefault(b.minus, LawPin(b.minus, kinds[b.minus], grounded=not inner))
            if b.less:
                result.setdefault(b.less, LawPin(b.less, kinds[b.less]))
        for name in self.prescribed_signals:
            result[name] = LawPin(name, "signal")
        return tuple(result.values())

    @property
    def pin_pairs(self) -> tuple[tuple[str, str], ...]:
        """Pairs of a pin of the part and the corresponding pin of the law."""
        inner = {LOOPS, *self.declaration.inner}
        pins = filterfalse(inner.__contains__, names_of(self.pins))
        return tuple((pin, f"{self.name}.{pin}") for pin in pins)

    @property
    def prescribed_signals(self) -> tuple[str, ...]:
        """Signal pins whose value the law prescribes."""
        return tuple(self.declaration.outputs)

    @property
    def across_inputs(self) -> tuple[AcrossInput, ...]:
        """Quantities across pins, and their rates, that are inputs of the law."""
        d = self.declaration
        rates = map(partial(self._across_input, rate=True), d.branches_with_rate)
        return (*map(self._across_input, d.branches), *rates)

    def _across_input(self, b: Branch, rate: bool = False) -> AcrossInput:
        """Return the coordinate of a branch, or its rate, as an input of the law."""
        return AcrossInput(b.plus, self._lower_pin(b), rate, b.less)

    @cached_property
    def _pin_kinds(self) -> dict[str, str]:
        """Kinds of all pins; ``signal`` for outputs, and for inputs whose rate is not used."""
        d = self.declaration
        result = dict.fromkeys(d.domains, "signal")
        for b in (*d.acting_branches, *d.branches_with_rate):
            for pin in b.pins:
                result[pin] = d.domains[pin].kind_of_law
        return result | dict.fromkeys(d.outputs, "signal")

    def _lower_pin(self, b: Branch) -> str:
        """Return the lower pin of a branch; empty for the reference of a signal input."""
        return b.minus if self._pin_kinds[b.minus] == self._pin_kinds[b.plus] else ""

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Flows of all acting branches."""
        return tuple(Flow(b.plus, b.minus, b.less) for b in self.declaration.acting_branches)

    @property
    def charged(self) -> tuple[int, ...]:
        """Indices of the flows of branches with a stored quantity."""
        return tuple(map(self.declaration.acting_branches.index, self._charged_branches))

    @cached_property
    def _charged_branches(self) -> tuple[Branch, ...]:
        """Acting branches that store a charge or a momentum."""
        d = self.declaration
        branches = d.acting_branches
        return tuple(b for b in branches if not b.flows and d.stored_quantity(b) != ZERO)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states: first the currents, then the declared states."""
        return (*names_of(self._through_branches), *self.declaration.states)

    @property
    def has_stored_quantities(self) -> bool:
        return bool(self._through_branches or self.charged)

    @cached_property
    def _inputs(self) -> tuple[str, ...]:
        """Names of the inputs."""
        d = self.declaration
        rates = (b.rate for b in d.branches_with_rate)
        return (*map(_input_name, d.branches), *rates, *self.states)

    @cached_property
    def is_affine(self) -> bool:
        d = self.declaration
        laws = (*d.state_rates.values(), *d.output_trees.values())
        trees = (*map(d.direct_flow, d.acting_branches), *laws)
        for tree, name in product(map(self._substitute_inputs, trees), self._inputs):
            slope = replace_kinks(differentiate_tree(tree, name), self._corners)
            if not find_names(slope).isdisjoint(self._inputs):
                return False
        return not self.has_stored_quantities

    @property
    def linear(self) -> bool:
        """Whether the declaration is linear."""
        return self.declaration.linear

    @cached_property
    def _corners(self) -> tuple[Tree, ...]:
        """Arguments of all one-sided functions; the signs of these arguments define the mode."""
        d = self.declaration
        trees = (d.stored_energy, *d.branch_laws, *d.state_rates.values(), *d.output_trees.values())
        corners = chain.from_iterable(map(find_kinks, map(self._substitute_inputs, trees)))
        return tuple(dict.fromkeys(corners))

    def _substitute_inputs(self, tree: Tree) -> Tree:
        """Return ``tree`` as a function of the inputs of the law alone."""
        units: dict[str, Tree] = {}
        for b in self.declaration.measured_branches:
            if self._pin_kinds[b.plus] == "signal":
                units[b.name] = multiply_trees(_make_number(b.domain.across.factor), Name(b.name))
        return add_trees(substitute_names(self.declaration.without_signals(tree), units))

    def _compile_declared(self, trees: Iterable[Tree], slopes: bool = False) -> _Compiled:
        """Compile expressions that contain the variables of the declaration."""
        return self._compile(map(self._substitute_inputs, trees), slopes)

    def _compile(self, trees: Iterable[Tree], slopes: bool = False) -> _Compiled:
        """Compile ``trees``; with ``slopes``, also their derivatives with respect to inputs."""
        rows = list(trees)
        if slopes:
            rows += starmap(differentiate_tree, product(rows, self._inputs))
        smooth = [replace_kinks(tree, self._corners) for tree in rows]
        flags = map("flag{}".format, range(len(self._corners)))
        arguments = (*self._inputs, *flags, *self.declaration.parameters)
        return compile_function(smooth, arguments, self.tables)

    @cached_property
    def _flow_trees(self) -> tuple[Tree, ...]:
        """Expressions of the flows, rates of states and signals that the law returns."""
        d = self.declaration
        flows = [Name(b.name) if b.flows else d.direct_flow(b) for b in d.acting_branches]
        rates = [
            subtract_trees(Name(_input_name(b)), d.direct_flow(b)) for b in self._through_branches
        ]
        per_metre = _make_number(TRANSLATION.across.per_unit)
        outputs = map(partial(multiply_trees, per_metre), d.output_trees.values())
        return (*flows, *rates, *d.state_rates.values(), *outputs)

    @cached_property
    def _flow_function(self) -> _Compiled:
        """Compiled function of the outputs and their derivatives."""
        return self._compile_declared(self._flow_trees, slopes=True)

    @cached_property
    def _output_function(self) -> _Compiled:
        """Compiled function of the outputs without derivatives."""
        return self._compile_declared(self._flow_trees)

    @cached_property
    def _storage_trees(self) -> tuple[Tree, ...]:
        """Expressions of the stored quantities."""
        d = self.declaration
        fluxes = map(d.stored_quantity, self._through_branches)
        charges = map(d.stored_quantity, self._charged_branches)
        return (*fluxes, *map(Name, d.states), *charges)

    @cached_property
    def _storage_function(self) -> _Compiled:
        """Compiled function of the stored quantities and their derivatives."""
        return self._compile_declared(self._storage_trees, slopes=True)

    @cached_property
    def _store_function(self) -> _Compiled:
        """Compiled function of the stored quantities without derivatives."""
        return self._compile_declared(self._storage_trees)

    @cached_property
    def _energy_function(self) -> _Compiled:
        return self._compile_declared(
            [self.declaration.stored_energy, self.declaration.network_loss]
        )

    @cached_property
    def _guard_function(self) -> _Compiled:
        return self._compile(self._corners)

    @cached_property
    def _limit_function(self) -> _Compiled:
        return self._compile_declared(self.declaration.limit_trees.values())

    def _evaluate(self, compiled: _Compiled, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return the values of a compiled function for the inputs ``e`` in a mode."""
        try:
            return np.array(compiled(*e.tolist(), *mode, *self.values), dtype=float)
        except (ZeroDivisionError, OverflowError, ValueError) as error:
            inputs = zip(self._inputs, e.tolist(), strict=True)
            raise SimulationError(
                f"the equations of the part have no value: {error}",
                where=self.name,
                got=", ".join(f"{name} = {value:g}" for name, value in inputs),
                expected="denominators, roots and logarithms of positive expressions",
                hint="state in the declaration's limits where its expressions are valid",
            ) from None

    def _values_and_slopes(
        self, compiled: _Compiled, e: np.ndarray, mode: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return values and derivatives of a compiled function."""
        result = self._evaluate(compiled, e, mode)
        count = result.size // (1 + e.size)
        return result[:count], result[count:].reshape(count, e.size)

    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the outputs of the law and their derivatives."""
        return self._values_and_slopes(self._flow_function, e, mode)

    def store(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return fluxes of currents, states, charges of voltages and momenta, in this order."""
        return self._values_and_slopes(self._storage_function, e, mode)

    def evaluate_outputs(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return the outputs of the law without derivatives."""
        return self._evaluate(self._output_function, e, mode)

    def evaluate_store(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return the stored quantities without derivatives."""
        return self._evaluate(self._store_function, e, mode)

    def mode(self, e: np.ndarray) -> tuple[int, ...]:
        """Return the mode: whether the argument of each one-sided function is positive."""
        flags: tuple[int, ...] = (0,) * len(self._corners)
        for k in range(len(flags)):  # an argument may depend on earlier ones
            above = self._evaluate(self._guard_function, e, flags)[k] > 0.0
            flags = (*flags[:k], int(above), *flags[k + 1 :])
        return flags

    def guards(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return the arguments of one-sided functions, with signs that are positive in the mode."""
        return self._evaluate(self._guard_function, e, mode) * np.where(
            np.array(mode) > 0, 1.0, -1.0
        )

    def next_mode(self, mode: Any, guard: int) -> tuple[int, ...]:
        """Return the mode after the guard with this number fell to zero."""
        return (*mode[:guard], 1 - mode[guard], *mode[guard + 1 :])

    @cached_property
    def _loss_function(self) -> _Compiled:
        return self._compile_declared(
            map(self.declaration.loss_coefficient, self.declaration.acting_branches)
        )

    def noise(self, s: complex, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray] | None:
        """Return a noise source for each loss: a force, a current or a series voltage."""
        branches, currents = self.declaration.acting_branches, self._through_branches
        root = np.sqrt(self._evaluate(self._loss_function, e, mode))
        rows = len(branches) + len(self.states) + len(self.prescribed_signals)
        out = np.zeros((rows, len(branches)))
        for k, b in enumerate(branches):
            out[len(branches) + currents.index(b) if b in currents else k, k] = root[k]
        return out, np.zeros((len(self.states) + len(self.charged), len(branches)))

    def require_in_range(self, t: float, e: np.ndarray) -> None:
        """Raise an error if the inputs violate a limit of the declaration."""
        result = self._evaluate(self._limit_function, e, self.mode(e))
        for what, value in zip(self.declaration.limit_trees, result, strict=True):
            if value <= 0.0:
                raise SimulationError(
                    f"{what} is exceeded",
                    where=f"{self.name} at t = {t:.6e} s",
                    got=f"{self.declaration.limits[what]} = {value:g}",
                    expected="a value above zero",
                )

    def energy(self, e: np.ndarray, mode: Any) -> float:
        """Return the stored energy [J]."""
        return float(self._evaluate(self._energy_function, e, mode)[0])

    def loss(self, e: np.ndarray, mode: Any) -> float:
        """Return the dissipated power [W]."""
        if self.declaration.network_loss == ZERO:
            return 0.0
        return float(self._evaluate(self._energy_function, e, mode)[1])
