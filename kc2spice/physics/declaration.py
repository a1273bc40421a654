"""A part's physics as data: energies, losses and states as expressions of what is across its pins.

======================  ===================  =========================  =====================
branch                  coordinate           through, into ``plus``     its rate
======================  ===================  =========================  =====================
:func:`displacement`    x [m]                force [N]                  ``x_rate`` [m/s]
:func:`voltage`         v [V]                current [A]
:func:`current`         i [A]                the coordinate itself
======================  ===================  =========================  =====================

With the kinetic energy ``T`` (of rates), the energy ``U`` (of displacements), the coenergy ``W``
(of displacements, voltages, currents) and the content ``R`` (of rates, voltages, currents)::

    force  = d/dt (dT/dx_rate) + dU/dx - dW/dx + dR/dx_rate
             + any of ``forces``, which friction has no content for
    i      = d/dt (dW/dv) + dR/dv           charge q = dW/dv
    v      = d/dt (dW/di) + dR/di           flux   l = dW/di

A branch that is only *seen* has a coordinate and nothing through it; what it brings in is a signal.
``states`` follow ``dx/dt = f``, of states, coordinates and rates, and may stand wherever a rate
may: a controller is a content of what it sees and of its states.

The energy that is stored is ``T + U - W + sum v q + sum i l``, the power that becomes heat
``sum x_rate dR/dx_rate + sum v dR/dv + sum i dR/di``: what pins bring in is what is stored and what
is lost, whatever the expressions say; so are rates times ``forces``. (J. Meisel, Principles of
Electromechanical Energy Conversion, 1966; content: W. Millar, Phil. Mag. 42 (1951) 1150.)
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, product

from kc2spice.core.domains import QUANTITIES, Domain
from kc2spice.core.errors import UsageError, candidates, did_you_mean, unknown
from kc2spice.core.quantities import Section
from kc2spice.netlist.circuit import Param
from kc2spice.netlist.expression import Call, Name, Tree, Writer, rebuilt, substitute, walk
from kc2spice.physics.symbolic import (
    ZERO,
    derivative,
    evaluated,
    expression,
    kinks,
    minus,
    names,
    plus,
    times,
)

LOOPS = "loops"
_STATED = ("kinetic", "energy", "coenergy", "content")
RATE = "_rate"  # ends the name of a displacement's velocity
# A force or a torque determines no displacement, and no part stores energy by a flow of heat.
COORDINATES = tuple(
    kind
    for kind, (domain, side) in QUANTITIES.items()
    if domain.power == "across * through"
    or (side == "across" and (domain.position or domain.potential))
)


@dataclass(frozen=True)
class Branch:
    """A coordinate between two pins; ``through`` names the result that flows into ``plus``, nothing
    where it is only seen. The displacement of a pin ``less`` that ``minus`` carries is taken off
    as well. ``kind`` is the quantity of a domain that the coordinate is."""

    kind: str
    name: str
    plus: str
    minus: str
    through: str
    less: str = ""

    @property
    def domain(self) -> Domain:
        """Domain of its pins."""
        return QUANTITIES[self.kind][0]

    @property
    def flows(self) -> bool:
        """Whether its coordinate flows through the pins, such as a current."""
        return QUANTITIES[self.kind][1] == "through"

    @property
    def moves(self) -> bool:
        """Whether its coordinate is a position, such as a displacement."""
        return self.domain.position and not self.flows

    @property
    def across(self) -> str:
        """Word of the result across it: a coordinate's, or a current's voltage."""
        if not self.flows:
            return self.name
        through, word = self.domain.quantity("through").symbol, self.domain.across.symbol
        return word if self.name == through else f"{self.name}_{word}"


def branch(
    kind: str, name: str = "", plus: str = "a", minus: str = "b", through: str = ""
) -> Branch:
    """Branch in any domain, whose coordinate is the quantity ``kind``, such as ``"pressure"``.

    The names of the coordinate and of what flows through are by default the symbols of the
    quantities in :mod:`kc2spice.core.domains`.

    Raises
    ------
    UsageError : no domain has this quantity, or its stored energy is not a function of it.

    Examples
    --------
    >>> branch("temperature")
    Branch(kind='temperature', name='temperature', plus='a', minus='b', through='heat', less='')
    """
    if kind not in COORDINATES:
        raise unknown("no such coordinate of a branch", kind, COORDINATES, "branch")
    domain, side = QUANTITIES[kind]
    name, flow = name or domain.quantity(side).symbol, domain.quantity("through").symbol
    return Branch(kind, name, plus, minus, name if side == "through" else through or flow)


def displacement(
    name: str = "x", plus: str = "a", minus: str = "b", force: str = "force", less: str = ""
) -> Branch:
    """``name`` [m] is the displacement of ``plus`` less that of ``minus``, and of ``less``."""
    return Branch("displacement", name, plus, minus, force, less)


def voltage(name: str = "v", plus: str = "plus", minus: str = "minus", flow: str = "i") -> Branch:
    """``name`` [V] is the voltage from ``plus`` to ``minus``; a charge follows it."""
    return Branch("voltage", name, plus, minus, flow)


def current(name: str = "i", plus: str = "plus", minus: str = "minus") -> Branch:
    """``name`` [A] flows from ``plus`` to ``minus``; a flux follows it."""
    return Branch("current", name, plus, minus, name)


def shake(name: str, pin: str, base: str) -> Branch:
    """``name`` [m/s2] is the acceleration of the frame that displacements are relative to. It is
    only seen; the netlist draws from ``pin`` the force that moves the masses there."""
    return Branch("acceleration", name, pin, base, "")


def seen(branch: Branch) -> Branch:
    """The coordinate of a displacement or voltage, without anything through it."""
    return replace(branch, through="")


def loop(name: str) -> Branch:
    """``name`` [A] flows in a closed loop of the part; a flux follows it."""
    return Branch("current", name, "", "", name)


def _unknown_name(
    part: str, what: str, strange: Iterable[str], known: Iterable[str], hint: str = ""
) -> UsageError:
    """The error of names in the equation ``what`` of a part that are none of the ``known`` ones."""
    unknown = list(strange)
    first = unknown[0]
    choices = sorted(known)
    return UsageError(
        f"unknown name in the {what}",
        where=part,
        got=", ".join(unknown),
        expected=f"one of {candidates(first, choices)}" if choices else "numbers",
        hint=hint
        or did_you_mean(first, choices)
        or f"add the key {first} to the section of keys, or use one of these names",
    )


# Where a term belongs that an equation must not contain.
_OTHER_PLACES = {
    "energy": "state energy that depends on {} in coenergy, and losses in content",
    "coenergy": "state losses that depend on {} in content, and the energy of a mass in kinetic",
}


@dataclass(frozen=True)
class Declaration:
    """The physics of a part type: everything else is generated.

    ``keys`` are the type's keys, whose numbers (in SI) the expressions know by name, as those of
    the parameters ``given``; ``constants`` are further names with their expressions of these and of
    constants before them; ``tables`` are functions of one argument that the expressions may call,
    whose values come from elsewhere. ``states`` maps names to what their rates are, ``signals`` to
    expressions of what is seen, of states and of signals before them. ``kinetic`` is that of a
    mass, ``1/2 m x_rate^2``, on which nothing but a constant weight acts besides its pins, and
    ``starts`` names the parameters that are its displacement and velocity at t = 0. ``forces`` are
    lost ones by displacement, of coordinates and rates. ``limits`` maps words for a limit to an
    expression that must stay above zero.
    ``stops`` maps words for a stop to an expression that is above zero where it is met.
    ``neglected`` are rows of an effect, why it has no model, and what its absence changes.
    ``validity`` is the range in which the equations hold; by default at constant temperature, or
    with the keys at any temperature where the part has pins of heat.

    Of netlists alone: ``outputs`` are pins of displacements that are affine in one of a branch;
    ``speeds`` are the nodes of velocities of rigid bodies, which take the force,
    by the pins of their displacements; ``lags`` the time by which the force on a displacement x
    follows, whose law has ``x + lag x_rate`` in all places of x; ``base`` is the pin on which inner
    nodes rest. Where no part reads forces and currents that are not ``metered``, they have no nodes
    and sources of their own, a third of the devices, and watches of overlaps are linear in x.
    ``no_module`` says why no compiled module can be it. ``mesh`` is the error estimate of the mesh
    or rings that its numbers come from, in words.
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
    stops: Mapping[str, str] = field(default_factory=dict)
    neglected: tuple[tuple[str, str, str], ...] = ()
    rating: str = "not known"
    validity: str = ""
    sign: str = (
        "um and N count along plus less minus; 1 A into a pin pushes the part that way with 1 N"
    )
    example: str = ""
    outputs: Mapping[str, str] = field(default_factory=dict)
    speeds: Mapping[str, str] = field(default_factory=dict)
    lags: Mapping[str, str] = field(default_factory=dict)
    base: str = ""
    metered: bool = True
    no_module: str = ""
    mesh: str = ""

    def __post_init__(self) -> None:
        known = {*self.parameters, *self.coordinates, *self.rates, *self.states, *self.signals}
        for what, tree in self._stated():
            if unknown := sorted(names(tree) - known):
                raise _unknown_name(self.name, what, unknown, known, self._coordinate_of(unknown))
        self._only("energy", self._tree("energy"), {b.name for b in self.acting if b.moves})
        self._only("coenergy", self._tree("coenergy"), {b.name for b in self.acting})
        passive = {name for b in self.branches if not b.through for name in (b.name, b.name + RATE)}
        earlier = passive | {*self.states}
        for name, tree in self.signal_trees.items():
            self._only(f"signal {name}", tree, earlier)
            earlier.add(name)
        self._require_loss()

    def _coordinate_of(self, strange: Iterable[str]) -> str:
        """Hint on a quantity whose coordinate has another name, empty if none is among them."""
        named = {b.kind: b.name for b in self.branches if b.kind != b.name}
        kinds = (kind for kind in strange if kind in named)
        return next((f"the coordinate of {kind!r} is {named[kind]}" for kind in kinds), "")

    def _only(self, what: str, tree: Tree, allowed: set[str]) -> None:
        strange = sorted(names(tree) - allowed - set(self.parameters))
        if strange:
            words = ", ".join(strange)
            raise UsageError(
                f"the {what} must not depend on {words}",
                where=self.name,
                got=words,
                expected=f"keys and {', '.join(sorted(allowed)) or 'numbers'}",
                hint=_OTHER_PLACES.get(what, "").format(words) or None,
            )

    def _require_loss(self) -> None:
        """Refuse a content without effect, such as one of a displacement in place of its rate."""
        tree = self._tree("content")
        loss = {b.name + RATE * b.moves for b in self.acting}
        if tree != ZERO and not names(tree) & loss:
            raise UsageError(
                "the content has no effect",
                where=self.name,
                got=self.content,
                expected=f"an expression of {' or '.join(sorted(loss))}",
                hint="losses follow from rates: x_rate is the velocity of a displacement x",
            )

    def _stated(self) -> Iterable[tuple[str, Tree]]:
        yield from ((what, self._tree(what)) for what in _STATED)
        yield from (*self._forces.items(), *self.bounds.items(), *self.stopped.items())
        yield from self.fixed.items()
        yield from (*self.read.items(), *self.changes.items(), *self.signal_trees.items())

    # --- names ------------------------------------------------------------------------------

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the branches' coordinates."""
        return tuple(branch.name for branch in self.branches)

    @cached_property
    def rates(self) -> tuple[str, ...]:
        """Names of the velocities."""
        return tuple(b.name + RATE for b in self.branches if b.moves)

    @cached_property
    def acting(self) -> tuple[Branch, ...]:
        """Branches with something through them: all but those only seen."""
        return tuple(branch for branch in self.branches if branch.through)

    @cached_property
    def open(self) -> tuple[Branch, ...]:
        """Acting branches between pins, without loops."""
        return tuple(branch for branch in self.acting if branch.plus)

    @cached_property
    def domains(self) -> dict[str, Domain]:
        """Domain of each pin; a branch with a flow has priority."""
        result: dict[str, Domain] = {}
        for b in (*self.acting, *self.branches):
            for pin in filter(None, (b.plus, b.minus, b.less)):
                result.setdefault(pin, b.domain)
        return result

    @property
    def valid_range(self) -> str:
        """Range in which the equations hold, in words."""
        if self.validity:
            return self.validity
        if any(domain.relaxes for domain in self.domains.values()):
            return "keys independent of temperature; nothing here ages or breaks"
        return "constant temperature; nothing here heats up, ages or breaks"

    @cached_property
    def closed(self) -> Declaration:
        """The same with loops that begin and end at one inner pin, ``loops``."""
        if self.open == self.acting:
            return self
        branches = (b if b.plus else replace(b, plus=LOOPS, minus=LOOPS) for b in self.branches)
        return replace(self, branches=tuple(branches))

    @cached_property
    def branch_trees(self) -> tuple[Tree, ...]:
        """Instantaneous flow and stored quantity of every branch, in the order of the branches."""
        result: list[Tree] = []
        for branch in self.acting:
            result += [self.direct(branch), self.storage(branch)]
        return tuple(result)

    @cached_property
    def polynomials(self) -> dict[Tree, str]:
        """Names of all power series in what is through the branches and kept."""
        calls = chain.from_iterable(map(walk, self.branch_trees))
        result = dict.fromkeys(c for c in calls if isinstance(c, Call) and c.function == "poly")
        return {call: f"poly{k}" for k, call in enumerate(result, 1)}

    def with_series_named(self, tree: Tree) -> Tree:
        """``tree`` with the names of its power series in their places."""
        name = self.polynomials.get(tree)
        return rebuilt(tree, self.with_series_named) if name is None else Name(name)

    @cached_property
    def numbers(self) -> tuple[str, ...]:
        """Keys that are numbers, and what is given."""
        fields = self.keys.model_fields
        keys = (name for name, result in fields.items() if result.annotation is float)
        return (*keys, *(param.name for param in self.given))

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Keys that are numbers, and constants."""
        return (*self.numbers, *self.constants)

    # --- what follows -----------------------------------------------------------------------

    def _tree(self, what: str) -> Tree:
        """Expression tree of one of the energies, or of the content."""
        return expression(getattr(self, what), f"{what} of {self.name}", self.tables)

    def _slope(self, what: str, name: str) -> Tree:
        return derivative(self._tree(what), name)

    def _read(self, what: str, stated: Mapping[str, str]) -> dict[str, Tree]:
        where = f"{what} of {self.name}"
        return {name: expression(text, where, self.tables) for name, text in stated.items()}

    @cached_property
    def _forces(self) -> dict[str, Tree]:
        return self._read("force", self.forces)

    @cached_property
    def bounds(self) -> dict[str, Tree]:
        """The limits' expressions."""
        return self._read("limit", self.limits)

    @cached_property
    def stopped(self) -> dict[str, Tree]:
        """The stops' expressions."""
        return self._read("stop", self.stops)

    @cached_property
    def fixed(self) -> dict[str, Tree]:
        """The constants' expressions."""
        return self._read("constant", self.constants)

    @cached_property
    def changes(self) -> dict[str, Tree]:
        """The rates of the states."""
        return self._read("state", self.states)

    @cached_property
    def signal_trees(self) -> dict[str, Tree]:
        """The signals' expressions."""
        return self._read("signal", self.signals)

    @cached_property
    def _spelled(self) -> dict[str, Tree]:
        result: dict[str, Tree] = {}
        for name, tree in self.signal_trees.items():
            result[name] = substitute(tree, result)
        return result

    def spelled(self, tree: Tree) -> Tree:
        """``tree`` with the signals' expressions in their places."""
        return plus(substitute(tree, self._spelled)) if self.signals else tree

    @cached_property
    def read(self) -> dict[str, Tree]:
        """The outputs' expressions."""
        return self._read("output", self.outputs)

    def direct(self, branch: Branch) -> Tree:
        """Instantaneous flow through a branch.

        It is the force without that of inertia, or the current without that of the charge. For a
        branch of kind current it is the voltage without that of the flux.
        """
        if not branch.moves:
            return self._slope("content", branch.name)
        stored = minus(self._slope("energy", branch.name), self._slope("coenergy", branch.name))
        dissipative = self._slope("content", branch.name + RATE)
        return plus(stored, dissipative, self._forces.get(branch.name, ZERO))

    def followed(self, branch: Branch) -> Tree:
        """The same of a displacement that has followed its lag."""
        tree = self.direct(branch)
        return plus(substitute(tree, {f"{name}{RATE}": ZERO for name in self.lags}))

    def loss(self, branch: Branch) -> Tree:
        """Damping, conductance or resistance of a branch, for small signals; zero where heat
        flows, which has no noise of this kind."""
        if branch.domain.power == "through":
            return ZERO
        rate = branch.name + RATE * branch.moves
        return derivative(self._slope("content", rate), rate)

    def storage(self, branch: Branch) -> Tree:
        """Momentum, charge or flux of a branch, whose rate adds to :meth:`direct`."""
        if branch.moves:
            return self._slope("kinetic", branch.name + RATE)
        return self._slope("coenergy", branch.name)

    def mass(self, branch: Branch) -> Tree:
        """Mass of a displacement branch."""
        return derivative(self.storage(branch), branch.name + RATE)

    @cached_property
    def stored(self) -> Tree:
        """The stored energy [J]."""
        others = (b for b in self.acting if not b.moves)
        both = [times(Name(b.name), self.storage(b)) for b in others]
        total = plus(self._tree("kinetic"), self._tree("energy"), *both)
        return minus(total, self._tree("coenergy"))

    @cached_property
    def dissipation(self) -> Tree:
        """The power [W] that becomes heat."""
        forced = (times(Name(name + RATE), tree) for name, tree in self._forces.items())
        others = (b.name for b in self.acting if not b.moves)
        return plus(*map(self._heat, self.rates), *forced, *map(self._heat, others))

    def _heat(self, rate: str) -> Tree:
        return times(Name(rate), self._slope("content", rate))

    @cached_property
    def equations(self) -> tuple[str, ...]:
        """Equations of the flow through every branch as text; for a current, of its voltage."""
        rows = [(name, tree) for name, tree in self.signal_trees.items()]
        rows += [(f"d/dt {name}", tree) for name, tree in self.changes.items()]
        definitions = (f"{name} = {Writer().write(tree)}" for name, tree in rows)
        return (*filter(None, map(self._equation, self.acting)), *definitions)

    def _equation(self, branch: Branch) -> str:
        direct = self.with_series_named(self.direct(branch))
        storage = self.with_series_named(self.storage(branch))
        terms = [f"d/dt ({Writer().write(storage)})"] if storage != ZERO else []
        terms += [Writer().write(direct)] if direct != ZERO else []
        name = branch.across if branch.flows else branch.through
        return f"{name} = {' + '.join(terms)}" if terms else ""

    def at_rest(self, tree: Tree, but: str = "") -> Tree:
        """``tree`` where all coordinates and rates are zero, but for one of that name."""
        still = {*self.coordinates, *self.rates, *self.states} - {but}
        return plus(substitute(tree, dict.fromkeys(still, ZERO)))

    @cached_property
    def linear(self) -> bool:
        """Whether what is through the branches is in proportion to coordinates and rates."""
        variables = {*self.coordinates, *self.rates, *self.states}
        laws = [*map(self.spelled, (*self.branch_trees, *self.changes.values()))]
        slopes = (derivative(law, name) for law, name in product(laws, variables))
        return not any(map(kinks, laws)) and not any(names(slope) & variables for slope in slopes)

    @cached_property
    def damped(self) -> tuple[Branch, ...]:
        """Displacements whose velocities matter."""
        stated = [self._tree("kinetic"), self._tree("content")]
        stated += (*self.changes.values(), *self.signal_trees.values())
        stated += (times(Name(name + RATE), tree) for name, tree in self._forces.items())
        result = frozenset[str]().union(*map(names, stated))
        return tuple(b for b in self.branches if b.name + RATE in result)

    def values(self, keys: Section) -> dict[str, float]:
        """Parameters of a part by name, in SI."""
        constants = {param.name: param.default for param in self.given}
        result = {
            n: constants[n] if n in constants else float(getattr(keys, n)) for n in self.numbers
        }
        for name, tree in self.fixed.items():
            result[name] = float(evaluated(tree, result))
        return result
