"""Laws of declared parts for the independent integrator.

The laws are equations with exact derivatives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import chain, filterfalse, product, starmap
from typing import Any

import numpy as np

from kc2spice.core.constitutive_laws import AcrossInput, Device, Flow, LawPin
from kc2spice.core.domains import TRANSLATION
from kc2spice.core.errors import SimulationError
from kc2spice.core.naming import list_names
from kc2spice.netlist.expression import Name, Number, Tree, substitute_names
from kc2spice.physics.declaration import LOOPS, Branch, Declaration
from kc2spice.physics.symbolic_algebra import (
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


def _make_input_name(branch: Branch) -> str:
    """Return the name of the law's input for the quantity across a branch.

    For a branch whose coordinate is a current, the quantity across the branch is the voltage.
    """
    return f"{branch.name}_drop" if branch.is_flow else branch.name


@dataclass(frozen=True)
class DeclaredLaw(Device):
    """Law that a declaration defines, with the values of the part's parameters.

    ``tables`` contains the functions of the tables and of the derivatives of the tables, keyed by
    name.
    """

    name: str
    declaration: Declaration
    values: tuple[float, ...]
    start: tuple[float, float] | None = None  # initial displacement and velocity of a mass
    tables: Mapping[str, _Table] = field(default_factory=dict, compare=False)

    @property
    def _through_branches(self) -> tuple[Branch, ...]:
        """Branches whose coordinate is a flow, such as a current."""
        return tuple(b for b in self.declaration.branches if b.is_flow)

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins of the law in the order of the branches, followed by the signal pins."""
        result: dict[str, LawPin] = {}
        kinds = self._pin_kinds
        for b in self.declaration.branches:
            # The pin ``loops`` is grounded, so that loop currents do not flow into the base pin.
            loop = b.plus == LOOPS
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
        """Pairs of pin names: name in the part, and full name in the law."""
        inner = {LOOPS, *self.declaration.inner}
        pins = filterfalse(inner.__contains__, list_names(self.pins))
        return tuple((pin, f"{self.name}.{pin}") for pin in pins)

    @property
    def prescribed_signals(self) -> tuple[str, ...]:
        """Names of the signal pins whose values the device sets."""
        return tuple(self.declaration.outputs)

    @property
    def across_inputs(self) -> tuple[AcrossInput, ...]:
        """Inputs of the device: across quantities, such as voltages, and their rates."""
        d = self.declaration
        rates = map(partial(self._make_across_input, rate=True), d.branches_with_rate)
        return (*map(self._make_across_input, d.branches), *rates)

    def _make_across_input(self, b: Branch, rate: bool = False) -> AcrossInput:
        """Return the coordinate of a branch, or its rate, as an input of the law.

        With ``rate``, return the rate of the coordinate.
        """
        return AcrossInput(b.plus, self._get_minus_pin(b), rate, b.less)

    @cached_property
    def _pin_kinds(self) -> dict[str, str]:
        """Kind of each pin, keyed by pin name.

        The kind is ``signal`` for outputs. If a pin belongs only to branches without a flow, and no
        expression contains the rates of these branches, the kind of the pin is also ``signal``.
        """
        d = self.declaration
        result = dict.fromkeys(d.domains, "signal")
        for b in (*d.acting_branches, *d.branches_with_rate):
            for pin in b.pins:
                result[pin] = d.domains[pin].pin_kind
        return result | dict.fromkeys(d.outputs, "signal")

    def _get_minus_pin(self, b: Branch) -> str:
        """Return the pin ``minus`` of a branch.

        Return an empty string if the kind of the pin ``minus`` differs from the kind of the pin
        ``plus``.
        """
        return b.minus if self._pin_kinds[b.minus] == self._pin_kinds[b.plus] else ""

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Flow of each branch, from its pin ``plus`` to its pin ``minus``.

        Branches that only measure a quantity between two pins have no flow, and are not in the
        result.
        """
        return tuple(Flow(b.plus, b.minus, b.less) for b in self.declaration.acting_branches)

    @property
    def storing_flow_indices(self) -> tuple[int, ...]:
        """Indices of the flows that include the time derivative of a stored quantity.

        The stored quantity is the charge or the momentum of the branch.
        """
        return tuple(map(self.declaration.acting_branches.index, self._storage_branches))

    @cached_property
    def _storage_branches(self) -> tuple[Branch, ...]:
        """Branches that carry a flow and store a charge or a momentum."""
        d = self.declaration
        branches = d.acting_branches
        return tuple(b for b in branches if not b.is_flow and d.derive_stored_quantity(b) != ZERO)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states: flows of branches, then states that the part declares."""
        return (*list_names(self._through_branches), *self.declaration.states)

    @property
    def has_stored_quantities(self) -> bool:
        """Whether the law stores fluxes, charges or momenta."""
        return bool(self._through_branches or self.storing_flow_indices)

    @cached_property
    def _input_names(self) -> tuple[str, ...]:
        """Names of all inputs: one for each branch, then all rates, then all states."""
        d = self.declaration
        rates = (b.rate for b in d.branches_with_rate)
        return (*map(_make_input_name, d.branches), *rates, *self.states)

    @cached_property
    def is_affine(self) -> bool:
        """Whether the law is affine and has no memory, that is, stores no quantities.

        The law must be affine in each switching state.
        """
        d = self.declaration
        laws = (*d.state_rates.values(), *d.output_trees.values())
        trees = (*map(d.derive_direct_flow, d.acting_branches), *laws)
        for tree, name in product(map(self._substitute_inputs, trees), self._input_names):
            slope = replace_kinks(differentiate_tree(tree, name), self._kink_arguments)
            if not find_names(slope).isdisjoint(self._input_names):
                return False
        return not self.has_stored_quantities

    @property
    def is_linear(self) -> bool:
        """Whether all equations of the declaration are linear."""
        return self.declaration.is_linear

    @cached_property
    def _kink_arguments(self) -> tuple[Tree, ...]:
        """Arguments of the functions with a kink in the law, such as x in ``max(0, x)``.

        The signs of these arguments define the mode of the law.
        """
        d = self.declaration
        trees = (d.stored_energy, *d.branch_laws, *d.state_rates.values(), *d.output_trees.values())
        corners = chain.from_iterable(map(find_kinks, map(self._substitute_inputs, trees)))
        return tuple(dict.fromkeys(corners))

    def _substitute_inputs(self, tree: Tree) -> Tree:
        """Return an expression with the law's inputs in place of signals and coordinates.

        Only coordinates of measured branches are replaced.
        """
        units: dict[str, Tree] = {}
        for b in self.declaration.measured_branches:
            if self._pin_kinds[b.plus] == "signal":
                units[b.name] = multiply_trees(_make_number(b.domain.across.factor), Name(b.name))
        return add_trees(substitute_names(self.declaration.substitute_signals(tree), units))

    def _compile_expressions(self, trees: Iterable[Tree], slopes: bool = False) -> _Compiled:
        """Return a compiled function that evaluates expressions of the declaration."""
        return self._compile(map(self._substitute_inputs, trees), slopes)

    def _compile(self, trees: Iterable[Tree], slopes: bool = False) -> _Compiled:
        """Return a compiled function of the law's inputs that evaluates expressions.

        With ``slopes``, the function also returns the derivatives with respect to all inputs.
        """
        rows = list(trees)
        if slopes:
            rows += starmap(differentiate_tree, product(rows, self._input_names))
        smooth = [replace_kinks(tree, self._kink_arguments) for tree in rows]
        flags = map("flag{}".format, range(len(self._kink_arguments)))
        arguments = (*self._input_names, *flags, *self.declaration.parameters)
        return compile_function(smooth, arguments, self.tables)

    @cached_property
    def _flow_trees(self) -> tuple[Tree, ...]:
        """Expressions of the outputs of the law: flows, rates of states, and signals."""
        d = self.declaration
        flows = [Name(b.name) if b.is_flow else d.derive_direct_flow(b) for b in d.acting_branches]
        rates = [
            subtract_trees(Name(_make_input_name(b)), d.derive_direct_flow(b))
            for b in self._through_branches
        ]
        per_metre = _make_number(TRANSLATION.across.pin_value_per_si_unit)
        outputs = map(partial(multiply_trees, per_metre), d.output_trees.values())
        return (*flows, *rates, *d.state_rates.values(), *outputs)

    @cached_property
    def _flow_function(self) -> _Compiled:
        """Compiled function that returns the law's outputs and their derivatives."""
        return self._compile_expressions(self._flow_trees, slopes=True)

    @cached_property
    def _outputs_function(self) -> _Compiled:
        """Compiled function that returns the law's outputs, but not their derivatives."""
        return self._compile_expressions(self._flow_trees)

    @cached_property
    def _storage_trees(self) -> tuple[Tree, ...]:
        """Expressions of the stored quantities: fluxes, states, and charges or momenta."""
        d = self.declaration
        fluxes = map(d.derive_stored_quantity, self._through_branches)
        charges = map(d.derive_stored_quantity, self._storage_branches)
        return (*fluxes, *map(Name, d.states), *charges)

    @cached_property
    def _storage_function(self) -> _Compiled:
        """Compiled function that returns the stored quantities and their derivatives."""
        return self._compile_expressions(self._storage_trees, slopes=True)

    @cached_property
    def _stored_quantities_function(self) -> _Compiled:
        """Compiled function that returns stored quantities, but not their derivatives."""
        return self._compile_expressions(self._storage_trees)

    @cached_property
    def _energy_function(self) -> _Compiled:
        """Compiled function that returns the stored energy and the power loss."""
        return self._compile_expressions(
            [self.declaration.stored_energy, self.declaration.network_loss]
        )

    @cached_property
    def _guard_function(self) -> _Compiled:
        """Compiled function that returns all guards, whose zeros are kinks of the law."""
        return self._compile(self._kink_arguments)

    @cached_property
    def _limit_function(self) -> _Compiled:
        """Compiled function that returns all limits: values that must be positive."""
        return self._compile_expressions(self.declaration.limit_trees.values())

    def _evaluate(self, compiled: _Compiled, e: np.ndarray, mode: Any) -> np.ndarray:
        """Evaluate a compiled function at inputs ``e`` in the switching state ``mode``."""
        try:
            return np.array(compiled(*e.tolist(), *mode, *self.values), dtype=float)
        except (ZeroDivisionError, OverflowError, ValueError) as error:
            inputs = zip(self._input_names, e.tolist(), strict=True)
            raise SimulationError(
                f"the equations of the part have no value: {error}",
                where=self.name,
                got=", ".join(f"{name} = {value:g}" for name, value in inputs),
                expected="nonzero denominators, and positive arguments of roots and logarithms",
                hint="state the valid range of the expressions in the limits of the declaration",
            ) from None

    def _evaluate_with_slopes(
        self, compiled: _Compiled, e: np.ndarray, mode: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the values and the derivatives that a compiled function computes."""
        result = self._evaluate(compiled, e, mode)
        count = result.size // (1 + e.size)
        return result[:count], result[count:].reshape(count, e.size)

    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the outputs of the law and their derivatives with respect to the inputs."""
        return self._evaluate_with_slopes(self._flow_function, e, mode)

    def evaluate_storage(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the stored quantities and their derivatives with respect to the inputs.

        The stored quantities are, in this order: the fluxes of current branches, the states, and
        the charges or momenta of other branches.
        """
        return self._evaluate_with_slopes(self._storage_function, e, mode)

    def evaluate_outputs(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return only the outputs of the law, not their partial derivatives."""
        return self._evaluate(self._outputs_function, e, mode)

    def evaluate_stored_quantities(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return only the stored quantities, not their partial derivatives."""
        return self._evaluate(self._stored_quantities_function, e, mode)

    def find_initial_mode(self, e: np.ndarray) -> tuple[int, ...]:
        """Find the initial mode of the law: for each kink, a flag for its active side.

        The mode is the switching state of the law. The mode contains 1 for each function with a
        kink whose argument is positive, otherwise 0.
        """
        flags: tuple[int, ...] = (0,) * len(self._kink_arguments)
        # The flags are computed in order: the argument of a function with a kink can depend on the
        # flags of earlier functions.
        for k in range(len(flags)):
            above = self._evaluate(self._guard_function, e, flags)[k] > 0.0
            flags = (*flags[:k], int(above), *flags[k + 1 :])
        return flags

    def evaluate_guards(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Evaluate the guard functions; each one is positive until the device switches.

        The guard functions are the arguments of all functions with a kink. Their signs are chosen
        so that all guard functions are positive in the switching state ``mode``.
        """
        return self._evaluate(self._guard_function, e, mode) * np.where(
            np.array(mode) > 0, 1.0, -1.0
        )

    def find_next_mode(self, mode: Any, guard: int) -> tuple[int, ...]:
        """Find the next mode of a device: the switching state into which it switches.

        Each kink of the law has one guard function, and one flag in ``mode`` that states the active
        side of the kink. ``guard`` is the index of the guard function that has fallen to zero. The
        result is a copy of ``mode`` in which only the flag with the index ``guard`` is inverted.
        """
        return (*mode[:guard], 1 - mode[guard], *mode[guard + 1 :])

    @cached_property
    def _loss_function(self) -> _Compiled:
        """Compiled function that returns the loss coefficients of all branches."""
        return self._compile_expressions(
            map(self.declaration.derive_loss_coefficient, self.declaration.acting_branches)
        )

    def compute_noise_weights(
        self, s: complex, e: np.ndarray, mode: Any
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the noise weights: thermal-noise amplitudes of all branches with losses.

        The noise of a branch is a force, a current or a series voltage.
        """
        branches, currents = self.declaration.acting_branches, self._through_branches
        root = np.sqrt(self._evaluate(self._loss_function, e, mode))
        rows = len(branches) + len(self.states) + len(self.prescribed_signals)
        out = np.zeros((rows, len(branches)))
        for k, b in enumerate(branches):
            out[len(branches) + currents.index(b) if b in currents else k, k] = root[k]
        return out, np.zeros((len(self.states) + len(self.storing_flow_indices), len(branches)))

    def require_in_range(self, t: float, e: np.ndarray) -> None:
        """Raise an error if the inputs violate a limit of the declaration at time ``t``."""
        result = self._evaluate(self._limit_function, e, self.find_initial_mode(e))
        for limit_name, value in zip(self.declaration.limit_trees, result, strict=True):
            if value <= 0.0:
                raise SimulationError(
                    f"the part leaves its valid range, limited by {limit_name}",
                    where=f"{self.name} at t = {t:.6e} s",
                    got=f"{self.declaration.limits[limit_name]} = {value:g}",
                    expected="a value above zero",
                )

    def energy(self, e: np.ndarray, mode: Any) -> float:
        """Return the energy [J] that the part stores for the input values ``e``."""
        return float(self._evaluate(self._energy_function, e, mode)[0])

    def loss(self, e: np.ndarray, mode: Any) -> float:
        """Return the power [W] that the part dissipates for the input values ``e``."""
        if self.declaration.network_loss == ZERO:
            return 0.0
        return float(self._evaluate(self._energy_function, e, mode)[1])
