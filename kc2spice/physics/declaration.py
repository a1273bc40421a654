"""Declarations of part types by expressions for their energies, losses and states.

======================  ===================  =========================  =====================
branch                  coordinate           flow into ``plus``         rate of coordinate
======================  ===================  =========================  =====================
:func:`displacement`    x [m]                force [N]                  ``x_rate`` [m/s]
:func:`voltage`         v [V]                current [A]
:func:`current`         i [A]                the coordinate itself
======================  ===================  =========================  =====================

The flows are derivatives of four functions: the kinetic energy ``T`` of rates, the energy ``U`` of
displacements, the coenergy ``W`` of displacements, voltages and currents, and the content ``R`` of
rates, voltages and currents::

    force  = d/dt (dT/dx_rate) + dU/dx - dW/dx + dR/dx_rate
             + any of ``forces``, such as friction, which has no content
    i      = d/dt (dW/dv) + dR/dv           charge q = dW/dv
    v      = d/dt (dW/di) + dR/di           flux   l = dW/di

A *measured* branch has a coordinate, but no flow through its pins. Each of the ``states`` x
satisfies an equation ``dx/dt = f``, where f is a function of states, coordinates and rates. The
expressions of ``forces`` and of the content ``R`` may contain the names of ``states``. For example,
the content ``R`` of a controller depends on the inputs and states of the controller. The content
``R`` is also called dissipation function.

The stored energy is ``T + U - W + sum(v * q) + sum(i * l)``. The power that becomes heat is
``sum(x_rate * dR/dx_rate) + sum(v * dR/dv) + sum(i * dR/di)``, plus the products of rates and
``forces``. For all expressions, the energy that enters through the pins equals the increase of the
stored energy plus the heat. (J. Meisel, Principles of Electromechanical Energy Conversion, 1966;
content: W. Millar, Phil. Mag. 42 (1951) 1150.)

If a part has a heat pin (:meth:`Declaration.with_heat_pin`), the power that becomes heat leaves the
part through this pin, and the resistances of ``conductors`` depend on the temperature of the pin.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np

from kc2spice.core.domains import AMBIENT, HEAT, QUANTITIES, Domain
from kc2spice.core.errors import UsageError, did_you_mean, list_candidates, unknown
from kc2spice.core.naming import list_names
from kc2spice.core.quantities import Section
from kc2spice.netlist.circuit import Param
from kc2spice.netlist.expression import (
    ExpressionWriter,
    FunctionCall,
    Name,
    Tree,
    map_operands,
    substitute_names,
    walk_tree,
)
from kc2spice.physics.symbolic_algebra import (
    ZERO,
    add_trees,
    differentiate_tree,
    divide_trees,
    evaluate_tree,
    find_kinks,
    find_names,
    is_affine,
    multiply_trees,
    parse_simplified,
    subtract_trees,
)

LOOPS = "loops"
TEMPERATURE = "temperature"  # temperature of the heat pin, relative to the pin ``ambient``
HEATING = "heating of the coil"  # effect that is neglected only without a heat pin
COEFFICIENT = "temperature_coefficient"
REFERENCE = "reference_temperature"
_ENERGIES = ("kinetic", "energy", "coenergy", "content")
RATE = "_rate"  # a displacement name with this suffix is the name of the velocity
# Quantities that can be coordinates of a branch.
# Forces and torques are excluded, because a force does not determine a displacement.
# Heat flows are excluded, because a heat flow stores no energy.
COORDINATES = tuple(
    kind
    for kind, (domain, side) in QUANTITIES.items()
    if domain.power == "across * through"
    or (side == "across" and (domain.has_position or domain.has_potential))
)


@dataclass(frozen=True)
class Branch:
    """Branch between two pins of a part: a coordinate such as a voltage, and a flow.

    ``kind`` is the physical quantity of the coordinate, and ``name`` is the name of the coordinate
    in expressions. ``through`` is the name of the flow into the pin ``plus``, and is empty for a
    measured branch. ``less`` is the name of a second negative pin, which only displacement branches
    can have. The coordinate of a branch with ``less`` is ``x_plus - x_minus - x_less``, computed
    from the displacements x of its three pins.
    """

    kind: str
    name: str
    plus: str
    minus: str
    through: str
    less: str = ""

    @property
    def domain(self) -> Domain:
        """Physical domain of the pins of the branch."""
        return QUANTITIES[self.kind][0]

    @property
    def is_flow(self) -> bool:
        """Whether the coordinate is a flow through the pins, such as a current."""
        return QUANTITIES[self.kind][1] == "through"

    @property
    def is_motion(self) -> bool:
        """Whether the coordinate is a displacement or an angle, whose rate is a velocity."""
        return self.domain.has_position and not self.is_flow

    @property
    def rate(self) -> str:
        """Name of the time derivative of a displacement coordinate."""
        return self.name + RATE

    @property
    def lossy_variable(self) -> str:
        """Name of the variable on which the losses of the branch depend.

        If the coordinate of the branch is a displacement or an angle, the dissipated power depends
        on the rate of the coordinate. Otherwise, the dissipated power depends on the coordinate
        itself, such as a voltage.
        """
        return self.rate if self.is_motion else self.name

    @property
    def pins(self) -> tuple[str, ...]:
        """Names of the pins of the branch; a closed loop has no pins."""
        return tuple(filter(None, (self.plus, self.minus, self.less)))

    @property
    def across(self) -> str:
        """Result name of the quantity across the pins, such as a voltage.

        If the coordinate is itself the quantity across the pins, the result name is the name of the
        coordinate.
        """
        if not self.is_flow:
            return self.name
        through, word = self.domain.through_variable.symbol, self.domain.across.symbol
        return word if self.name == through else f"{self.name}_{word}"


def branch(
    kind: str, name: str = "", plus: str = "a", minus: str = "b", through: str = ""
) -> Branch:
    """Make a branch of any physical domain, with the quantity ``kind`` as coordinate.

    An example of ``kind`` is ``"pressure"``. By default, the names of the coordinate and of the
    flow are the symbols of both quantities in :mod:`kc2spice.core.domains`.

    Raises
    ------
    UsageError : the quantity does not exist, or cannot be the coordinate of a branch.

    Examples
    --------
    >>> branch("temperature")
    Branch(kind='temperature', name='temperature', plus='a', minus='b', through='heat', less='')
    """
    if kind not in COORDINATES:
        raise unknown(
            "this quantity cannot be the coordinate of a branch", kind, COORDINATES, "branch"
        )
    domain, side = QUANTITIES[kind]
    name, flow = name or domain.get_quantity(side).symbol, domain.through_variable.symbol
    return Branch(kind, name, plus, minus, name if side == "through" else through or flow)


def displacement(
    name: str = "x", plus: str = "a", minus: str = "b", force: str = "force", less: str = ""
) -> Branch:
    """Make a branch whose coordinate ``name`` is the displacement [m] of pin ``plus``.

    The displacements of the pins ``minus`` and ``less`` are subtracted from the displacement of
    ``plus``.
    """
    return Branch("displacement", name, plus, minus, force, less)


def voltage(name: str = "v", plus: str = "plus", minus: str = "minus", flow: str = "i") -> Branch:
    """Make a branch with the voltage ``name`` [V] from ``plus`` to ``minus``.

    The voltage, not the current, is the variable of the branch in the part's equations.
    """
    return Branch("voltage", name, plus, minus, flow)


def current(name: str = "i", plus: str = "plus", minus: str = "minus") -> Branch:
    """Make a branch with the current ``name`` [A] from ``plus`` to ``minus``.

    The current, not the voltage, is the variable of the branch in the part's equations.
    """
    return Branch("current", name, plus, minus, name)


def make_frame_branch(name: str, pin: str, base: str) -> Branch:
    """Make a frame branch, which measures the acceleration of a reference frame.

    The name of the acceleration [m/s2] is ``name``. In the netlist, the flow through ``pin`` is the
    force that accelerates all masses that move with the frame.
    """
    return Branch("acceleration", name, pin, base, "")


def measured(branch: Branch) -> Branch:
    """Return a copy of ``branch`` that is only measured: no flow passes through it.

    The input of a sensor is an example of such a branch.
    """
    return replace(branch, through="")


def loop(name: str) -> Branch:
    """Make a branch with the current ``name`` [A] in a closed loop of a part.

    The current is the variable of the branch in the part's equations.
    """
    return Branch("current", name, "", "", name)


def _make_unknown_name_error(
    part: str, field_name: str, unknown: Sequence[str], known: Iterable[str], hint: str = ""
) -> UsageError:
    """Make the error for ``unknown`` names in the field ``field_name`` of a part."""
    first, choices = unknown[0], sorted(known)
    return UsageError(
        f"the {field_name} contains an unknown name",
        where=part,
        got=", ".join(unknown),
        expected=f"one of {list_candidates(first, choices)}" if choices else "numbers",
        hint=hint
        or did_you_mean(first, choices)
        or f"add the key `{first}` to the class of keys of this part, or use a known name",
    )


def write_resistance_ratio(temperature: str = TEMPERATURE) -> str:
    """Write a conductor's resistance ratio ``R / R0`` as a function of temperature.

    The ratio is ``R / R0 = 1 + alpha (T - T0)``. R is the resistance at the ``temperature`` T, and
    R0 is the resistance at the reference temperature T0.
    """
    return f"1 + {COEFFICIENT}*({temperature} - {REFERENCE})"


HEAT_BRANCH = branch("temperature", TEMPERATURE, HEAT, AMBIENT, HEAT)
ONE_TEMPERATURE = (
    "temperature differences within the part",
    "all losses heat a single thermal node",
    "not estimated",
)

# Hints for terms that do not belong in ``energy`` or ``coenergy``; each hint names the correct
# field of the declaration.
_FIELD_HINTS = {
    "energy": "write energy that depends on {} into `coenergy`, and losses into `content`",
    "coenergy": "write losses that depend on {} into `content`, and the energy of a mass into "
    "`kinetic`",
}


@dataclass(frozen=True)
class Declaration:
    """Declaration of a part type, from which netlist, law and checks are generated.

    The expressions may contain the names of:

    - numeric keys of the section ``keys``, in SI units
    - additional parameters in ``given``
    - ``constants``, which are expressions of numeric keys, parameters and earlier constants
    - ``tables``, functions of one argument whose values are computed outside of the declaration
    - coordinates, rates, ``states`` and ``signals``

    ``states`` maps the name of each state to the expression of its time derivative. ``signals``
    maps the name of each signal to an expression of measured coordinates, states and earlier
    signals. ``kinetic`` is the kinetic energy of a mass, ``1/2 * m * x_rate^2``. ``starts``
    contains the names of the parameters for the initial displacement and velocity of the mass,
    keyed by the name of the displacement. Only forces at the pins and a constant weight may act on
    the mass. ``forces`` contains dissipative forces as functions of coordinates and rates, keyed by
    the name of the displacement. ``limits`` maps the description of a limit to an expression that
    must stay above zero. ``remedies`` contains the action for a violated limit, keyed by the
    description of the limit; ``PART`` represents the name of the part. ``stops`` maps the
    description of a stop to an expression that is above zero during contact. ``neglected`` contains
    the name, the reason and the size of each neglected effect. ``validity`` describes the range in
    which the equations hold. By default, ``validity`` states that the temperature is constant. For
    a part with heat pins, the default of ``validity`` states that keys do not depend on
    temperature.

    ``conductors`` contains the names of current or voltage branches whose resistance depends on the
    temperature of the heat pin. ``temperature_coefficient`` [1/K] is the rise of the resistance per
    kelvin, divided by the resistance at the reference temperature. If ``ideal_work`` is true, the
    power of ``forces`` is work of an ideal source, and does not become heat. If ``losses_of_model``
    is true, the losses are known only after the model is built. ``heated`` is true if
    :meth:`with_heat_pin` added a heat pin to the part. ``example`` contains the tables of a small
    scene in TOML, for the list of part types. The header of the library file states the permitted
    load from the field ``rating``, and the sign convention of the pins from the field ``sign``.

    The following fields have an effect only on the netlist:

    - ``outputs`` are pins whose displacement is an affine function of a branch displacement.
    - ``speeds`` contains velocity nodes of rigid bodies, keyed by displacement pin. Forces on a
      rigid body act on its velocity node.
    - ``lags`` contains the delay [s] of each delayed force, keyed by the name of the displacement x
      in the law of the force. The law contains ``x + lag * x_rate`` in place of x.
    - ``base`` is the reference pin of the voltages of inner nodes.
    - If ``metered`` is false, the netlist has no nodes and sources that measure forces and
      currents.
    - ``no_module`` is the reason why the part cannot be a compiled Verilog-A module.
    - ``inner`` contains nodes between branches that are not pins of the part.
    - ``velocities`` contains nodes of the subcircuit with velocities as voltages, keyed by
      displacement. Without such a node, the netlist differentiates the displacement.
    - ``mesh`` describes the error estimate of the mesh or rings from which parameter values were
      computed.
    """

    name: str
    title: str
    keys: type[Section]
    branches: tuple[Branch, ...]
    kinetic: str = "0"
    starts: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    energy: str = "0"
    coenergy: str = "0"
    content: str = "0"
    forces: Mapping[str, str] = field(default_factory=dict)
    given: tuple[Param, ...] = ()
    constants: Mapping[str, str] = field(default_factory=dict)
    states: Mapping[str, str] = field(default_factory=dict)
    signals: Mapping[str, str] = field(default_factory=dict)
    tables: tuple[str, ...] = ()
    limits: Mapping[str, str] = field(default_factory=dict)
    remedies: Mapping[str, str] = field(default_factory=dict)
    stops: Mapping[str, str] = field(default_factory=dict)
    neglected: tuple[tuple[str, str, str], ...] = ()
    conductors: tuple[str, ...] = ()
    temperature_coefficient: float = 0.0
    ideal_work: bool = False
    losses_of_model: bool = False
    heated: bool = False
    rating: str = "not known"
    validity: str = ""
    sign: str = (
        "um and N have the same positive direction at all pins; 1 A into a pin is a force of 1 N "
        "on the part in this direction"
    )
    example: str = ""
    outputs: Mapping[str, str] = field(default_factory=dict)
    speeds: Mapping[str, str] = field(default_factory=dict)
    lags: Mapping[str, str] = field(default_factory=dict)
    base: str = ""
    metered: bool = True
    no_module: str = ""
    mesh: str = ""
    inner: tuple[str, ...] = ()
    velocities: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._check_branches()
        known = {*self.parameters, *self.variables, *self.signals}
        for what, tree in self._list_all_trees():
            if unknown := sorted(find_names(tree) - known):
                raise _make_unknown_name_error(
                    self.name, what, unknown, known, self._make_coordinate_hint(unknown)
                )
        self._check_names(
            "energy", self._parse_field("energy"), set(list_names(self.displacement_branches))
        )
        self._check_names(
            "coenergy", self._parse_field("coenergy"), set(list_names(self.acting_branches))
        )
        earlier = {*self.states}
        for b in self.measured_branches:
            earlier |= {b.name, b.rate}
        for name, tree in self.signal_trees.items():
            self._check_names(f"signal {name}", tree, earlier)
            earlier.add(name)
        self._require_lossy_variable()

    def _check_branches(self) -> None:
        """Reject ``branches`` unless it is a tuple or list of branches."""
        value: object = self.branches
        if isinstance(value, tuple | list) and all(isinstance(b, Branch) for b in value):
            return
        raise UsageError(
            "the argument `branches` is not a tuple of Branch objects",
            where=self.name,
            got="one branch" if isinstance(value, Branch) else repr(value)[:80],
            expected="a tuple such as (branch('angle'),)",
            hint="write a comma after a single branch",
        )

    def _make_coordinate_hint(self, unknown: Iterable[str]) -> str:
        """Return a hint to write a coordinate, such as ``v``, in place of ``voltage``.

        An expression must contain the name of a coordinate, such as ``v``, and not the quantity,
        such as ``voltage``. Return an empty string if ``unknown`` does not contain the name of a
        branch's quantity, such as ``voltage``.
        """
        for b in self.branches:
            if b.kind in unknown and b.kind != b.name:
                return f"the coordinate of {b.kind!r} is {b.name}"
        return ""

    def _check_names(self, field_name: str, tree: Tree, allowed: set[str]) -> None:
        """Reject variables in the field ``field_name`` that are not in ``allowed``."""
        strange = sorted(find_names(tree) - allowed - set(self.parameters))
        if strange:
            variables = ", ".join(strange)
            rates = {b.rate for b in self.branches}
            energy_of_rates = field_name == "energy" and rates.issuperset(strange)
            hint = _FIELD_HINTS.get("coenergy" if energy_of_rates else field_name, "")
            raise UsageError(
                f"the {field_name} must not depend on {variables}",
                where=self.name,
                got=variables,
                expected=f"keys and {', '.join(sorted(allowed)) or 'numbers'}",
                hint=hint.format(variables) or None,
            )

    def _require_lossy_variable(self) -> None:
        """Require that ``content`` depends on a lossy variable: rate, voltage or current.

        For example, a dissipation function that depends only on a displacement is rejected.
        """
        tree = self._parse_field("content")
        variables = {b.lossy_variable for b in self.acting_branches}
        if tree != ZERO and not find_names(tree) & variables:
            raise UsageError(
                "the dissipation function `content` depends on no rate, voltage or current",
                where=self.name,
                got=self.content,
                expected=f"an expression of {' or '.join(sorted(variables))}",
                hint="use rates, such as x_rate for the velocity of the displacement x",
            )

    def _list_all_trees(self) -> Iterable[tuple[str, Tree]]:
        """Yield the name and the tree of each expression in the declaration."""
        yield from zip(_ENERGIES, map(self._parse_field, _ENERGIES), strict=True)
        yield from (
            *self._force_trees.items(),
            *self.limit_trees.items(),
            *self.trees_by_stop.items(),
        )
        yield from self.constant_trees.items()
        yield from (
            *self.output_trees.items(),
            *self.state_rates.items(),
            *self.signal_trees.items(),
        )

    # --- heat -------------------------------------------------------------------------------------

    @property
    def heat_branch(self) -> Branch | None:
        """Branch between the heat pins; None if the part has no heat pin."""
        return HEAT_BRANCH if self.heated else None

    @property
    def offers_heat_pin(self) -> bool:
        """Whether a heat pin can be added.

        The part must have losses and no thermal pins. The names in the declaration must differ from
        the names that a heat pin adds.
        """
        names_in_use = {HEAT, TEMPERATURE, COEFFICIENT, REFERENCE} & {
            *self.domains,
            *self.variables,
            *self.parameters,
        }
        thermal = any(domain.is_relaxing for domain in self.domains.values())
        lossy = self.losses_of_model or self.heat_power != ZERO
        return lossy and not names_in_use and not thermal

    def with_heat_pin(
        self, temperature_coefficient: float | None = None, reference_temperature: float = 0.0
    ) -> Declaration:
        """Return the declaration with the pins ``heat`` and ``ambient``.

        The heat flow out of the pin ``heat`` is the power of all losses.

        Parameters
        ----------
        temperature_coefficient : float, optional
            Relative rise of the conductors' resistance [1/K], by default the value in the
            declaration.
        reference_temperature : float, default 0
            Temperature at which the stated resistances are valid, as a difference [K] from the
            temperature of the pin ``ambient``.

        Returns
        -------
        Declaration
            A declaration with a branch between the heat pins.

        Examples
        --------
        >>> from kc2spice.core.quantities import Section
        >>> class WireKeys(Section):
        ...     resistance: float
        >>> content, ends = "0.5*resistance*i^2", (current("i"),)
        >>> wire = Declaration("wire", "wire", WireKeys, ends, content=content, conductors=("i",))
        >>> for equation in wire.with_heat_pin(3.93e-3).equations:
        ...     print(equation)
        v = resistance*i*(1+temperature_coefficient*(temperature-reference_temperature))
        heat = -(i*i*resistance*(1+temperature_coefficient*(temperature-reference_temperature)))
        """
        coefficient = temperature_coefficient
        if coefficient is None:
            coefficient = self.temperature_coefficient
        neglected = [row for row in self.neglected if row[0] != HEATING]
        change: dict[str, Any] = {"neglected": (*neglected, ONE_TEMPERATURE)}
        if self.conductors:
            limits = {**self.limits, "the range of resistances": write_resistance_ratio()}
            change["limits"] = limits
            change["given"] = (
                *self.given,
                Param(
                    COEFFICIENT, coefficient, "1/K", "temperature coefficient of the resistances"
                ),
                Param(
                    REFERENCE,
                    reference_temperature,
                    "K",
                    "temperature above ambient at which the resistances are given",
                ),
            )
        return replace(self, branches=(*self.branches, HEAT_BRANCH), heated=True, **change)

    # --- names ------------------------------------------------------------------------------------

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates of all branches."""
        return tuple(list_names(self.branches))

    @cached_property
    def rates(self) -> tuple[str, ...]:
        """Names of the time derivatives of all displacement coordinates."""
        return tuple(b.rate for b in self.branches if b.is_motion)

    @cached_property
    def variables(self) -> frozenset[str]:
        """Names of all coordinates, rates and states."""
        return frozenset((*self.coordinates, *self.rates, *self.states))

    @cached_property
    def acting_branches(self) -> tuple[Branch, ...]:
        """Branches that carry a flow through their pins: all except *measured* branches."""
        return tuple(branch for branch in self.branches if branch.through)

    @cached_property
    def displacement_branches(self) -> tuple[Branch, ...]:
        """Branches that exert a force and whose coordinate is a displacement."""
        return tuple(branch for branch in self.acting_branches if branch.is_motion)

    @cached_property
    def branches_without_motion(self) -> tuple[Branch, ...]:
        """Branches that carry a flow and whose coordinate is not a displacement."""
        return tuple(b for b in self.acting_branches if not b.is_motion)

    @cached_property
    def inertial_branches(self) -> tuple[Branch, ...]:
        """Displacement branches with a mass."""
        return tuple(b for b in self.displacement_branches if self.get_branch_mass(b) != ZERO)

    @cached_property
    def measured_branches(self) -> tuple[Branch, ...]:
        """Measured branches: a quantity is read between their pins, but no flow passes."""
        return tuple(branch for branch in self.branches if not branch.through)

    @cached_property
    def pin_branches(self) -> tuple[Branch, ...]:
        """Branches that carry a flow between two pins; closed loops are excluded."""
        return tuple(branch for branch in self.acting_branches if branch.plus)

    @cached_property
    def domains(self) -> dict[str, Domain]:
        """Physical domain of each pin, keyed by pin name.

        If an acting branch and a measured branch have a common pin, the acting branch determines
        the domain.
        """
        result: dict[str, Domain] = {}
        for b in (*self.acting_branches, *self.branches):
            for pin in b.pins:
                result.setdefault(pin, b.domain)
        return result

    @property
    def valid_range(self) -> str:
        """Description of the range in which the equations hold."""
        if self.validity:
            return self.validity
        if any(domain.is_relaxing for domain in self.domains.values()):
            return "parameters independent of temperature; no ageing or failure"
        return "constant temperature; no heating, ageing or failure"

    @cached_property
    def declaration_with_loop_pin(self) -> Declaration:
        """Declaration with a pin ``loops`` at which all current loops start and end."""
        if self.pin_branches == self.acting_branches:
            return self
        branches = (b if b.plus else replace(b, plus=LOOPS, minus=LOOPS) for b in self.branches)
        return replace(self, branches=tuple(branches))

    @cached_property
    def branch_laws(self) -> tuple[Tree, ...]:
        """Two laws of each branch: the flow without storage terms, the stored quantity.

        Measured branches have no laws. The order of the branches is preserved.
        """
        result: list[Tree] = []
        for branch in self.acting_branches:
            result += [self.derive_direct_flow(branch), self.derive_stored_quantity(branch)]
        return tuple(result)

    @cached_property
    def power_series(self) -> dict[Tree, str]:
        """Names of all power series in the expressions of flows and stored quantities.

        The dictionary maps the expression of each power series to the name of the power series.
        """
        result: dict[Tree, str] = {}
        for tree in chain.from_iterable(map(walk_tree, self.branch_laws)):
            if isinstance(tree, FunctionCall) and tree.function == "poly":
                result.setdefault(tree, f"poly{len(result) + 1}")
        return result

    def replace_power_series(self, tree: Tree) -> Tree:
        """Replace each power series in an expression by a name from ``power_series``.

        :attr:`power_series` contains the names of the power series.
        """
        name = self.power_series.get(tree)
        return map_operands(tree, self.replace_power_series) if name is None else Name(name)

    @cached_property
    def numeric_keys(self) -> tuple[str, ...]:
        """Names of the numeric keys of the part."""
        fields = self.keys.model_fields.items()
        return tuple(name for name, entry in fields if entry.annotation is float)

    @cached_property
    def defaults(self) -> dict[str, float]:
        """Default values of the parameters in the field ``given``, keyed by name."""
        return {param.name: param.default for param in self.given}

    @cached_property
    def numeric_names(self) -> tuple[str, ...]:
        """Names of numeric keys, and of parameters in the field ``given``."""
        return (*self.numeric_keys, *self.defaults)

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Names of numeric keys, of parameters in the field ``given``, and of constants."""
        return (*self.numeric_names, *self.constants)

    # --- expressions ------------------------------------------------------------------------------

    def _parse_field(self, what: str) -> Tree:
        """Return the expression tree of a field of the declaration, such as ``energy``."""
        return parse_simplified(getattr(self, what), f"{what} of {self.name}", self.tables)

    def _differentiate_field(self, what: str, name: str) -> Tree:
        """Return the derivative of a field, such as ``energy``, with respect to ``name``."""
        return differentiate_tree(self._parse_field(what), name)

    def _parse_texts(self, what: str, stated: Mapping[str, str]) -> dict[str, Tree]:
        """Return the expression trees of several texts, keyed by name.

        Error messages contain ``what`` and the name of the part.
        """
        where = f"{what} of {self.name}"
        return {name: parse_simplified(text, where, self.tables) for name, text in stated.items()}

    @cached_property
    def _force_trees(self) -> dict[str, Tree]:
        """Expression trees of the dissipative forces, keyed by displacement."""
        return self._parse_texts("force", self.forces)

    @cached_property
    def limit_trees(self) -> dict[str, Tree]:
        """Expression trees of the limits, keyed by description."""
        return self._parse_texts("limit", self.limits)

    @cached_property
    def trees_by_stop(self) -> dict[str, Tree]:
        """Expression trees of the mechanical stops, keyed by the stop's description."""
        return self._parse_texts("stop", self.stops)

    @cached_property
    def variables_by_limit(self) -> dict[str, frozenset[str]]:
        """Names of the variables on which each limit depends, keyed by limit description."""
        return {name: self._list_variables(tree) for name, tree in self.limit_trees.items()}

    @cached_property
    def stop_variables(self) -> dict[str, frozenset[str]]:
        """Names of the variables of each mechanical stop, keyed by the stop's description."""
        return {name: self._list_variables(tree) for name, tree in self.trees_by_stop.items()}

    def _list_variables(self, tree: Tree) -> frozenset[str]:
        """Return the names of the variables in an expression: all names except parameters."""
        return find_names(tree).difference(self.parameters)

    @cached_property
    def constant_trees(self) -> dict[str, Tree]:
        """Expression trees of the constants, keyed by name."""
        return self._parse_texts("constant", self.constants)

    @cached_property
    def state_rates(self) -> dict[str, Tree]:
        """Expression trees of the time derivatives of the states, keyed by state."""
        return self._parse_texts("state", self.states)

    @cached_property
    def signal_trees(self) -> dict[str, Tree]:
        """Expression trees of the signals, keyed by name."""
        return self._parse_texts("signal", self.signals)

    @cached_property
    def _expanded_signals(self) -> dict[str, Tree]:
        """Expressions of the signals, with the definitions of other signals inserted.

        The definition of a signal replaces its name in all later signals. The keys are the names of
        the signals.
        """
        result: dict[str, Tree] = {}
        for name, tree in self.signal_trees.items():
            result[name] = substitute_names(tree, result)
        return result

    def substitute_signals(self, tree: Tree) -> Tree:
        """Return an expression with the definitions of signals in place of their names."""
        return add_trees(substitute_names(tree, self._expanded_signals)) if self.signals else tree

    @cached_property
    def output_trees(self) -> dict[str, Tree]:
        """Expression trees of the displacements of output pins, keyed by pin."""
        return self._parse_texts("output", self.outputs)

    def derive_direct_flow(self, branch: Branch) -> Tree:
        """Return the direct flow of a branch, which excludes rates of stored quantities.

        The direct flow is the force minus the time derivative of the momentum, or the current minus
        the time derivative of the charge. For a branch whose coordinate is a current, the function
        returns the voltage minus the time derivative of the flux.
        """
        if branch == self.heat_branch:
            return subtract_trees(ZERO, self.heat_power)
        dissipative = self._derive_lossy_flow(branch)
        if not branch.is_motion:
            return dissipative
        stored = subtract_trees(
            self._differentiate_field("energy", branch.name),
            self._differentiate_field("coenergy", branch.name),
        )
        return add_trees(stored, dissipative, self._force_trees.get(branch.name, ZERO))

    def _derive_lossy_flow(self, branch: Branch) -> Tree:
        """Return the lossy flow of a branch: the part of the flow that losses cause.

        For a branch whose coordinate is a current, the function returns the voltage across the
        resistance instead of a flow.
        """
        slope = self._differentiate_field("content", branch.lossy_variable)
        if not self.heated or branch.name not in self.conductors:
            return slope
        ratio = parse_simplified(write_resistance_ratio())
        return (multiply_trees if branch.is_flow else divide_trees)(slope, ratio)

    def derive_netlist_force(self, branch: Branch) -> Tree:
        """Derive the force of a branch for the netlist, without the force of inertia.

        The netlist replaces each coordinate x in ``lags`` by ``x + lag * x_rate``, so the netlist
        already contains the effect of the rate ``x_rate``. Therefore, the returned force contains
        zero in place of the rates of all coordinates in ``lags``.
        """
        tree = self.derive_direct_flow(branch)
        return add_trees(substitute_names(tree, {f"{name}{RATE}": ZERO for name in self.lags}))

    def derive_loss_coefficient(self, branch: Branch) -> Tree:
        """Return the small-signal damping, conductance or resistance of a branch.

        The loss coefficient determines the thermal noise of the branch. For a heat flow, which has
        no thermal noise, the coefficient is zero.
        """
        if branch.domain.power == "through":
            return ZERO
        return differentiate_tree(self._derive_lossy_flow(branch), branch.lossy_variable)

    def derive_stored_quantity(self, branch: Branch) -> Tree:
        """Return the momentum, charge or flux of a branch.

        The flow of the branch is the rate of this quantity plus :meth:`derive_direct_flow`.
        """
        if branch.is_motion:
            return self._differentiate_field("kinetic", branch.rate)
        return self._differentiate_field("coenergy", branch.name)

    def split_motion(self, stored: Tree) -> tuple[Tree, Tree]:
        """Return a stored quantity's rate due to motion, and its value without motion.

        The first result is the rate of the stored quantity due to displacements. The second result
        is the stored quantity at zero displacement.

        Only displacements with a velocity node in ``velocities`` count as motion. The stored
        quantity must be an affine function of these displacements.
        """
        moving = [b for b in self.displacement_branches if b.name in self.velocities]
        if not moving:
            return ZERO, stored
        rates = [multiply_trees(differentiate_tree(stored, b.name), Name(b.rate)) for b in moving]
        still = add_trees(substitute_names(stored, {b.name: ZERO for b in moving}))
        return add_trees(ZERO, *rates), still

    def get_branch_mass(self, branch: Branch) -> Tree:
        """Return the mass of a displacement branch."""
        return differentiate_tree(self.derive_stored_quantity(branch), branch.rate)

    @cached_property
    def stored_energy(self) -> Tree:
        """Expression of the energy [J] that the part stores."""
        products = []
        for b in self.branches_without_motion:
            products.append(multiply_trees(Name(b.name), self.derive_stored_quantity(b)))
        total = add_trees(self._parse_field("kinetic"), self._parse_field("energy"), *products)
        return subtract_trees(total, self._parse_field("coenergy"))

    @cached_property
    def _powers_of_forces(self) -> tuple[Tree, ...]:
        """Expressions of the powers [W] of all forces in the field ``forces``."""
        return tuple(
            multiply_trees(Name(name + RATE), tree) for name, tree in self._force_trees.items()
        )

    @cached_property
    def dissipation(self) -> Tree:
        """Expression of the power [W] that all branches and dissipative forces dissipate.

        The power of a branch in the thermal domain is the product of temperature and heat flow.
        """
        moving = (b for b in self.branches if b.is_motion)
        rates = map(self._write_dissipated_power, moving)
        powers = map(self._write_dissipated_power, self.branches_without_motion)
        return add_trees(*rates, *self._powers_of_forces, *powers)

    @cached_property
    def heat_power(self) -> Tree:
        """Expression of the power [W] of all losses outside the thermal domain."""
        lossy = [b for b in self.acting_branches if not b.domain.is_relaxing]
        forces = () if self.ideal_work else self._powers_of_forces
        return add_trees(*map(self._write_dissipated_power, lossy), *forces)

    def _write_dissipated_power(self, branch: Branch) -> Tree:
        """Return the power [W] that a branch dissipates."""
        return multiply_trees(Name(branch.lossy_variable), self._derive_lossy_flow(branch))

    @cached_property
    def network_loss(self) -> Tree:
        """Expression of the power [W] that enters through the pins and is not stored.

        The power at a pin is the product of its across quantity and its through quantity, such as
        voltage and current. At a heat pin, the product of temperature and heat flow takes the place
        of the power; its unit is K W. In a network, the sum of the powers at all pins is zero
        (Tellegen's theorem).
        """
        branch = self.heat_branch
        if branch is None:
            return self.dissipation
        return add_trees(
            self.dissipation, multiply_trees(Name(branch.name), self.derive_direct_flow(branch))
        )

    @cached_property
    def equations(self) -> tuple[str, ...]:
        """Equations of the part as text: branch flows, signals and states."""
        result = [*filter(None, map(self._write_equation, self.acting_branches))]
        for name, tree in self.signal_trees.items():
            result.append(f"{name} = {ExpressionWriter().write_tree(tree)}")
        for name, tree in self.state_rates.items():
            result.append(f"d/dt {name} = {ExpressionWriter().write_tree(tree)}")
        return tuple(result)

    def _write_equation(self, branch: Branch) -> str:
        """Return the equation of a branch's flow as text; empty for a zero flow."""
        direct = self.replace_power_series(self.derive_direct_flow(branch))
        storage = self.replace_power_series(self.derive_stored_quantity(branch))
        terms = [f"d/dt ({ExpressionWriter().write_tree(storage)})"] if storage != ZERO else []
        terms += [ExpressionWriter().write_tree(direct)] if direct != ZERO else []
        name = branch.across if branch.is_flow else branch.through
        return f"{name} = {' + '.join(terms)}" if terms else ""

    def set_variables_to_zero(self, tree: Tree, variable: str = "") -> Tree:
        """Return an expression with zero in place of each variable except ``variable``.

        Variables are coordinates, rates and states.
        """
        still = self.variables - {variable}
        try:
            return add_trees(substitute_names(tree, dict.fromkeys(still, ZERO)))
        except UsageError:
            raise UsageError(
                "the equations of the part contain a division by zero at rest",
                where=self.name,
                got="a denominator that is zero if all coordinates and rates are zero",
                expected="equations that are finite at rest",
                hint="add a key to the denominator, such as gap in 1/(gap - x)",
            ) from None

    @cached_property
    def is_linear(self) -> bool:
        """Whether all flows are affine functions of coordinates, rates and states."""
        laws = [*map(self.substitute_signals, (*self.branch_laws, *self.state_rates.values()))]
        if any(map(find_kinks, laws)):
            return False
        return all(is_affine(law, self.variables) for law in laws)

    @cached_property
    def branches_with_rate(self) -> tuple[Branch, ...]:
        """Branches whose displacement rates occur in an expression of the declaration."""
        trees = [
            self._parse_field("kinetic"),
            self._parse_field("content"),
            *self._powers_of_forces,
        ]
        trees += (*self.state_rates.values(), *self.signal_trees.values())
        occurring = frozenset[str]().union(*map(find_names, trees))
        return tuple(b for b in self.branches if b.rate in occurring)

    def compute_stop_depths(
        self, keys: Section, known: Mapping[str, np.ndarray]
    ) -> dict[str, float]:
        """Return the largest indentation [m] of each stop; negative if the stop is never reached.

        Stops with a variable that is not in ``known`` are omitted. ``known`` contains the recorded
        waveforms of coordinates, keyed by name.
        """
        values = self.compute_parameter_values(keys) | dict(known)
        return {
            what: float(np.max(evaluate_tree(tree, values)))
            for what, tree in self.trees_by_stop.items()
            if self.stop_variables[what] <= known.keys()
        }

    def compute_parameter_values(self, keys: Section) -> dict[str, float]:
        """Return the values of all parameters in SI units, for a part with ``keys``.

        The values are keyed by parameter name.
        """
        result = {name: float(getattr(keys, name)) for name in self.numeric_keys}
        result |= self.defaults
        for name, tree in self.constant_trees.items():
            result[name] = float(evaluate_tree(tree, result))
        return result
