"""Part types that declarations define.

The declaration determines pins, netlist, results, equations and checks of a part.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain, pairwise, starmap
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.domains import HEAT, HEAT_PINS, SIGNALS, TRANSLATION, VELOCITY
from kc2spice.core.errors import UsageError
from kc2spice.core.naming import list_names
from kc2spice.core.waveforms import Waveforms, integrate_cumulatively
from kc2spice.netlist.circuit import Circuit, Item, Param, Pin
from kc2spice.netlist.expression import Tree
from kc2spice.netlist.number_and_name_spelling import (
    format_comment,
    format_voltage,
    require_distinct,
)
from kc2spice.netlist.number_and_name_spelling import require_name as checked
from kc2spice.netlist.shared_cards import (
    STOP_COMMENT,
    attach_comments,
    list_range_conditions,
    write_condition_stops,
)
from kc2spice.netlist.subcircuit_library import Subcircuit
from kc2spice.physics.conductors import (
    get_temperature_coefficient,
    is_heated,
    list_useless_key_errors,
)
from kc2spice.physics.declaration import Branch, Declaration
from kc2spice.physics.declaration_cards import (
    NO_TABLES,
    get_meter_name,
    get_reference_pin_name,
    has_losses,
    list_inner_nodes,
    name_force_node,
    write_subcircuit_items,
)
from kc2spice.physics.flux_linkages import find_flux_linkages
from kc2spice.physics.law import DeclaredLaw
from kc2spice.physics.lookup_tables import TableFunction
from kc2spice.physics.symbolic_algebra import (
    differentiate_tree,
    evaluate_tree,
    find_kinks,
    find_names,
)
from kc2spice.scene.checks import Check, RunEnergyBalance
from kc2spice.scene.keys import list_schema_keys
from kc2spice.scene.part_records import (
    EquilibriumConditions,
    NeglectedEffect,
    NumericalRequirements,
    PartResult,
)
from kc2spice.scene.scene_classes import (
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    JoinedScene,
    KeysT,
    Part,
    PartType,
    Scene,
    Terminal,
    WiredScene,
)

if TYPE_CHECKING:
    from kc2spice.netlist.subcircuit_library import Header

# If the number of impacts on a stop exceeds MAX_IMPACTS, the run prints a warning.
# In tests, two to nine impacts on a stop caused errors of up to 20 % in the results of a run.
MAX_IMPACTS = 1.0
REBOUND_ADVICE = (
    "impacts make the results sensitive to each time step: set error_budget to estimate the error "
    "of each metric"
)
_INNER_PREFIXES = "f|x|in|q|l|rest|copy|sense|first|second|noise|speed|place|pushed|state|lookup"
_INNER_NODE_PATTERN = rf"(?:{_INNER_PREFIXES})_.+|(?:edge|poly)\d+|tick"  # names of inner nodes
_MAX_UNEXPLAINED_SHARE = 1e-3  # largest accepted relative error of the energy balance


def list_newton_numerics(part: Part, scene: DeclaredScene) -> Iterator[NumericalRequirements]:
    """List the numerical requirement of ``dc`` and ``op``: a smaller Newton tolerance."""
    if scene.analysis.type in ("dc", "op"):
        change = "1e-6", "convergence tolerance of Newton's method: nonlinear parts"
        yield NumericalRequirements(part.name, options={"reltol": change})


class DeclaredPart(PartType[KeysT]):
    """Part type that a declaration defines."""

    source = "closed form"

    def __init__(self, declaration: Declaration | None = None) -> None:
        """Make the part type that a ``declaration`` defines.

        Without a declaration, the subclass must override :meth:`make_declaration`.
        """
        if declaration is None:
            return
        self.declaration = declaration
        self.name, self.title = declaration.name, declaration.title
        self.schema = cast("type[KeysT]", declaration.keys)
        self.example = declaration.example
        self.noise = ("Rnoise",) if has_losses(declaration) else ()

    # --- pins and netlist -------------------------------------------------------------------------

    def make_declaration(self, part: Part[KeysT], scene: GovernedScene) -> Declaration:
        """Make the declaration of a part: its branches, energies and losses.

        By default, all parts of a part type have the same declaration.
        """
        return self.declaration

    def declare_after_build(self, part: Part[KeysT], build: BuiltScene) -> Declaration:
        """Return the declaration of a part after its model is built.

        The declaration may depend on the built model.
        """
        return self.make_declaration(part, build.scene)

    def declare_part(self, part: Part[KeysT], scene: GovernedScene) -> Declaration:
        """Return the declaration of a part before its model is built.

        The declaration has a heat pin if the scene connects the pin ``heat``.
        """
        return self._with_heat_pin(self.make_declaration(part, scene), part, scene)

    def declare_built_part(self, part: Part[KeysT], build: BuiltScene) -> Declaration:
        """Return the declaration of a part after its model is built.

        The declaration has a heat pin if the scene connects the pin ``heat``.
        """
        declaration = self.declare_after_build(part, build)
        heated = (part.name, HEAT) in build.scene.terminals
        return _attach_heat_pin(declaration, part) if heated else declaration

    def _with_heat_pin(
        self, declaration: Declaration, part: Part[KeysT], scene: DeclaredScene
    ) -> Declaration:
        """Add a heat pin to the declaration if the scene connects the pin ``heat``."""
        return _attach_heat_pin(declaration, part) if is_heated(part, scene) else declaration

    def problems(self, part: Part[KeysT], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield errors for keys of the part that have no effect."""
        yield from list_useless_key_errors(part, scene)

    def pins(self, part: Part[KeysT], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        d, result = self.declare_part(part, scene), []
        plus = {b.plus for b in d.branches}
        for p in make_pins(d):
            required = p.name in plus or scene.is_target(part.name, p.name)
            default = None if required else "gnd"
            result.append(Terminal(p.name, p.unit, p.flow, default, required=required))
        return tuple(result)

    def pins_with_mass(self, part: Part[KeysT], scene: JoinedScene) -> tuple[str, ...]:
        """Return the names of the pins at which a branch has inertia."""
        d = self.declare_part(part, scene)
        return tuple(d.speeds.get(b.plus, b.plus) for b in d.inertial_branches)

    def equilibrium_conditions(self, part: Part[KeysT], scene: WiredScene) -> EquilibriumConditions:
        """Return the equilibrium conditions: pin pairs that can transmit a steady flow.

        A branch transmits a steady flow, such as a constant force or current, if the branch has a
        stiffness at rest, or if its coordinate is a flow.
        """
        d = self.declare_part(part, scene)
        values = d.compute_parameter_values(part.keys)
        stiff, flowing = [], []
        for b in d.branches:
            if b.domain.path_to_reference and b.is_flow:
                flowing.append((b.plus, b.minus))
            elif b.domain.path_to_reference:
                # all other variables are set to zero, which makes the slope a short expression
                slope = differentiate_tree(
                    d.set_variables_to_zero(d.derive_direct_flow(b), b.name), b.name
                )
                if evaluate_tree(d.set_variables_to_zero(slope), values):
                    stiff.append((b.plus, b.minus))
        paths = (*stiff, *flowing)
        return EquilibriumConditions(_merge_inner_paths(paths, d.inner) if d.inner else paths)

    def subcircuits(
        self, part: Part[KeysT], build: BuiltScene, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return the subcircuit of the part, as a tuple of length 1."""
        d, name = self.declare_built_part(part, build), build.libraries[part.name]
        return (
            make_declared_subcircuit(
                header, name, d, d.compute_parameter_values(part.keys), build.has_noise
            ),
        )

    def numerics(self, part: Part[KeysT], scene: WiredScene) -> Iterator[NumericalRequirements]:
        """Yield a requirement on the Newton tolerance if the declaration is nonlinear."""
        if not self.declare_part(part, scene).is_linear:
            yield from list_newton_numerics(part, scene)

    # --- results ----------------------------------------------------------------------------------

    def vectors(self, part: Part[KeysT], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        result, d = {}, self.declare_built_part(part, build)
        for b in d.branches:
            if b.plus and {_get_node_name(build, part, pin) for pin in (b.plus, b.minus)} != {"0"}:
                result[f"{part.name}.{b.across}"] = get_across_vector(build, part, b)
            if not b.through or (b.plus in d.inner and not b.is_flow):
                continue
            result[f"{part.name}.{b.through}"] = get_flow_vector(build, part, b)
            if b in d.inertial_branches:
                speed = f"v(x{part.name}.speed_{b.name})".lower()
                result[f"{part.name}.v"] = PartResult(speed, VELOCITY.factor, VELOCITY.unit)
        for name, node in list_inner_nodes(d).items():
            value = _write_inner_voltage(build, part, node, get_reference_pin_name(d)).lower()
            result[f"{part.name}.{name}"] = PartResult(value, 1.0, "SI")
        return result

    def initial_motion(self, part: Part[KeysT], build: BuiltScene) -> tuple[float, float] | None:
        """Return the displacement [m] and velocity [m/s] of the part's mass at t = 0.

        None means that the run starts at an equilibrium.
        """
        return None

    def law(self, part: Part[KeysT], build: BuiltScene) -> laws.Equations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice."""
        n, d = part.name, self.declare_built_part(part, build)
        results = {}
        # The results omit the currents in closed loops, because the full model of a part has
        # different loops.
        for b in d.pin_branches:
            if b.plus not in d.inner:
                results[f"{n}.{b.through}"] = laws.scale_wave(f"{n}.{b.plus}.through")
            elif b.is_flow:
                results[f"{n}.{b.through}"] = laws.scale_wave(f"{n}.{b.name}")
            if d.metered:
                results[f"{n}.{b.across}"] = laws.subtract_waves(f"{n}.{b.plus}", f"{n}.{b.minus}")
            if b in d.inertial_branches:
                results[f"{n}.v"] = laws.scale_wave(f"{n}.{b.plus}.rate")
        for state in d.states:
            results[f"{n}.{state}"] = laws.scale_wave(f"{n}.{state}")
        values = tuple(d.compute_parameter_values(part.keys).values())
        law = DeclaredLaw(n, d.declaration_with_loop_pin, values, self.initial_motion(part, build))
        return laws.Equations((law,), law.pin_pairs, results)

    # --- checks of a run --------------------------------------------------------------------------

    def checks(self, part: Part[KeysT], build: BuiltScene, waves: Waveforms) -> Iterator[Any]:
        """Yield the energy balance, and checks of limits and of the number of impacts."""
        d = self.declare_built_part(part, build)
        known = {} if "frequency" in waves else self._list_recorded_waves(part, build, waves)
        yield from _check_limits(d, part, known)
        if build.scene.analysis.type == "op":
            yield from self.check_operating_point(part, build, waves)
        if "time" in waves:
            yield from balance_energy(d, part, known, waves)
            positions = known.keys() & set(list_names(d.displacement_branches))
            forces = map(d.derive_direct_flow, d.acting_branches)
            for tree in dict.fromkeys(chain.from_iterable(map(find_kinks, forces))):
                # A kink of a force law is an impact only if a displacement determines where the
                # kink occurs.
                if positions.isdisjoint(find_names(tree)):
                    continue
                met = evaluate_tree(tree, d.compute_parameter_values(part.keys) | known) > 0
                strikes = float(np.count_nonzero(met[1:] & ~met[:-1]))
                yield Check(
                    f"strikes of {part.name}",
                    strikes,
                    MAX_IMPACTS,
                    "",
                    REBOUND_ADVICE,
                    "warn",
                    label=f"impacts in {part.name}",
                )

    def check_operating_point(
        self, part: Part[KeysT], build: BuiltScene, point: Waveforms
    ) -> Iterator[Check]:
        """Yield checks that the operating point is within the limits and not on a stop."""
        d, known = (
            self.declare_built_part(part, build),
            self._list_recorded_waves(part, build, point),
        )
        small = build.scene.analysis.is_small_signal
        if small:
            yield from _check_limits(d, part, known, " at its operating point")
        for what, depth in d.compute_stop_depths(part.keys, known).items():
            name = f"{part.name} beyond {what} at its operating point"
            advice = "the part has pulled in: lower the bias, or use stiffer springs"
            yield Check(name, max(depth, 0.0), 0.0, "m", advice, "fail" if small else "warn")

    def _list_recorded_waves(
        self, part: Part[KeysT], build: BuiltScene, waves: Waveforms
    ) -> dict[str, np.ndarray]:
        """Return the recorded waveforms of coordinates, states and signals, keyed by name."""
        d = self.declare_built_part(part, build)
        result = {}
        for name in (*d.coordinates, *d.states, *d.signals):
            if (wave := waves.data.get(f"{part.name}.{name}")) is not None:
                result[name] = wave
        return result

    # --- notes that the command ``explain`` prints ------------------------------------------------

    def notes(self, part: Part[KeysT], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the equations of the model and the effects that it neglects."""
        yield "; ".join(self.declare_part(part, scene).equations)
        yield from self.list_neglected_effects(part, scene)

    def list_neglected_effects(self, part: Part[KeysT], scene: Scene) -> Iterator[NeglectedEffect]:
        """Yield the effects that the model of a part neglects."""
        yield from starmap(NeglectedEffect, self.declare_part(part, scene).neglected)


def _attach_heat_pin(declaration: Declaration, part: Part) -> Declaration:
    """Return a declaration with a heat pin.

    If the declaration cannot have a heat pin, the same declaration is returned.
    """
    if not declaration.offers_heat_pin:
        return declaration
    coefficient, reference = get_temperature_coefficient(part.keys)
    return declaration.with_heat_pin(coefficient, reference)


def _check_limits(
    d: Declaration, part: Part, known: dict[str, np.ndarray], where: str = ""
) -> Iterator[Check]:
    """Yield a check of each limit whose variables are all in ``known``."""
    for what, tree in d.limit_trees.items():
        if d.variables_by_limit[what] <= known.keys():
            value = float(
                np.min(evaluate_tree(tree, d.compute_parameter_values(part.keys) | known))
            )
            remedy = d.remedies.get(what) or f"change a key so that {d.limits[what]} > 0"
            advice = remedy.replace("PART", part.name)
            beyond = max(-value, 0.0)
            name = f"{what} of {part.name}{where}"
            label = f"{name.removeprefix('the ')}, amount below zero"
            yield Check(name, beyond, 0.0, "beyond the limit", advice, label=label)


def _get_node_name(build: BuiltScene, part: Part, pin: str) -> str:
    """Return the ngspice name of the node of a pin.

    The name of an inner node includes the name of the instance.
    """
    inner = f"x{part.name}.{pin}".lower()
    return build.scene.nets.get((part.name, pin), inner)


def _write_inner_voltage(build: BuiltScene, part: Part, node: str, pin: str) -> str:
    """Return the ngspice expression of the voltage from an inner node to a pin."""
    low = _get_node_name(build, part, pin)
    return f"v(x{part.name}.{node})" + f"-v({low})" * (low != "0")


def _merge_inner_paths(
    paths: Iterable[tuple[str, str]], inner: Collection[str]
) -> tuple[tuple[str, str], ...]:
    """Return paths between pins that replace the paths via ``inner`` nodes."""
    groups: list[set[str]] = []
    for path in paths:
        joined = [group for group in groups if not group.isdisjoint(path)]
        groups = [group for group in groups if group.isdisjoint(path)]
        groups.append(set(path).union(*joined))
    ends = [sorted(group.difference(inner)) for group in groups]
    return tuple(chain.from_iterable(map(pairwise, ends)))


def make_pins(declaration: Declaration) -> tuple[Pin, ...]:
    """Return the pins of a declared part in the order of its branches.

    If the declaration has a ``base``, the upper pins of all branches precede the lower pins. The
    velocity pin of a rigid body precedes the displacement pin of this body.
    """
    d, result = declaration, dict[str, Pin]()
    ends = [(b.plus, b.minus, b.less) for b in d.branches]
    rows = zip(*ends, strict=True) if d.base else ends
    loaded = set(chain.from_iterable(b.pins for b in d.acting_branches))
    for pin in filter(None, chain.from_iterable(rows)):
        unit, flow = d.domains[pin].units
        if speed := d.speeds.get(pin):
            result.setdefault(checked(speed), Pin(speed, VELOCITY.pin_unit, flow))
        quiet = speed or (pin not in loaded and d.domains[pin].pin_kind != SIGNALS.name)
        result.setdefault(checked(pin), Pin(pin, unit, "-" if quiet else flow))
    for node in d.inner:
        result.pop(checked(node), None)
    for pin in d.outputs:
        result[checked(pin)] = Pin(pin, TRANSLATION.across.pin_unit, "-")
    if d.base:
        result.pop(d.base, None)
        result[d.base] = Pin(d.base, *d.domains.get(d.base, TRANSLATION).units)
    return tuple(result.values())


def make_declared_subcircuit(
    header: Header,
    name: str,
    declaration: Declaration,
    values: Mapping[str, float],
    noise: bool = False,
    more: Sequence[Item] = (),
    tables: Mapping[str, TableFunction] = NO_TABLES,
    pins: Sequence[Pin] = (),
) -> Subcircuit:
    """Return the subcircuit of a declared part.

    Parameters
    ----------
    header : Header
        Origin of the netlist.
    name : str
        Name of the subcircuit.
    declaration : Declaration
        Physics of the part.
    values : mapping of str to float
        Values of the keys in SI units, which become the default values of the parameters.
    noise : bool, default False
        Whether the netlist includes the thermal noise of the losses.
    more : sequence of Item, optional
        Further cards of the subcircuit.
    tables : mapping of str to TableFunction, optional
        Tables of the declaration and of the derivatives of these tables.
    pins : sequence of Pin, optional
        Pins in the order of the netlist. By default, the pins are in the order of the branches.

    Returns
    -------
    Subcircuit
        Pins, parameters and text of the library file.

    Raises
    ------
    UsageError : a pin or a parameter has the name of an inner node or of another pin of the part.

    Examples
    --------
    The pin unit ``um/N`` means that 1 V represents 1 um, and 1 A represents 1 N.

    >>> from kc2spice.parts.electronics.two_terminal_types import TABLE
    >>> from kc2spice.parts.electronics.two_terminal_types import declare_element as declared
    >>> from kc2spice.netlist.subcircuit_library import Header
    >>> spring = declared(next(row for row in TABLE if row.name == "spring"))
    >>> make_declared_subcircuit(Header("demo", "0"), "leaf", spring, {"stiffness": 100.0})
    <Subcircuit leaf: pins a[um/N] b[um/N]; stiffness=100>
    """
    from kc2spice.synthesis.library_headers import (
        format_parameter_defaults,
        write_part_header,
    )  # loads scipy

    d, pins = declaration, tuple(pins) or make_pins(declaration)
    ends = tuple(list_names(pins))
    linkages = find_flux_linkages(d)
    inner = [
        *map(checked, d.signals),
        *d.inner,
        *tables,
        *(linkages.current_names if linkages else ()),
    ]
    require_distinct([*ends, *inner], _INNER_NODE_PATTERN, where=name)
    keys = []
    for key in list_schema_keys(d.keys):
        if key.name in d.numeric_keys:
            unit = (key.unit or "-").replace(" ", "*")
            keys.append(Param(key.name, values[key.name], unit, key.doc))
    params = (*keys, *d.given)
    words: dict[str, Any] = {"rating": d.rating, "validity": d.valid_range, "mesh": d.mesh}
    words |= {"heat": HEAT_PINS} if d.heated else {}
    head = write_part_header(header, f"{name}: {d.title}", pins, params, sign=d.sign, **words)
    items = (*write_subcircuit_items(d, noise, tables), *more)
    if conditions := list_range_conditions(d.given):
        stops = attach_comments((STOP_COMMENT, *write_condition_stops(conditions, ends[0])))
        items = (*items, *stops)
    circuit = Circuit(name, ends, format_parameter_defaults(params), items, notes=head)
    title = format_comment(f"{name}: {d.title}")
    tree = Circuit(items=(circuit,))
    facts: dict[str, Any] = {"no_module": d.no_module, "header_lines": len(head)}
    return Subcircuit(name, pins, params, tree, title=title, **facts)


def get_across_vector(build: BuiltScene, part: Part, branch: Branch) -> PartResult:
    """Return the ngspice vector of the quantity across a branch."""
    quantity = branch.domain.across
    return PartResult(format_branch_voltage(build, part, branch), quantity.factor, quantity.unit)


def get_flow_vector(build: BuiltScene, part: Part, branch: Branch) -> PartResult:
    """Return the ngspice vector of the flow into the pin ``plus`` of a branch."""
    flow, quantity = f"i(v.x{part.name}.{get_meter_name(branch)})", branch.domain.through_variable
    if branch.is_motion:
        flow = _write_inner_voltage(build, part, name_force_node(branch), branch.minus)
    known, ends = build.scene.nets, []
    for pin in (branch.minus, branch.plus):
        ends.append((pin,) if (part.name, pin) in known else ())
    return PartResult(flow.lower(), quantity.factor, quantity.unit, *ends)


def format_branch_voltage(build: BuiltScene, part: Part, branch: Branch) -> str:
    """Return the ngspice expression of the voltage across a branch.

    The voltage is measured from ``plus`` to ``minus``.
    """
    plus, minus = (_get_node_name(build, part, pin) for pin in (branch.plus, branch.minus))
    return format_voltage(plus, minus) or "v(0)"


def balance_energy(
    declaration: Declaration, part: Part, recorded: Mapping[str, np.ndarray], waves: Waveforms
) -> Iterator[RunEnergyBalance]:
    """Yield the energy balance of a part in a transient.

    Without the recorded waveforms of all variables, no energy balance is yielded. Parts with
    neither displacement branches nor a heat pin have no energy balance.

    The work at the pins is computed from the waveforms at the pins: ``int F dx`` for forces, ``int
    v dq`` for voltages with the charge ``q = int i dt``, and ``int i dl`` for currents with the
    flux ``l = int v dt``. If the charges, fluxes or losses of the netlist differ from the
    declaration, the energy balance is violated. All losses of a part with a heat pin leave the part
    through this pin. The energy of all losses is then the integral of the heat flow.
    """
    d, time = declaration, waves["time"]
    if not (d.displacement_branches or d.heated) or set(recorded) != {
        *d.coordinates,
        *d.states,
        *d.signals,
    }:
        return
    speeds, slopes, means = {}, {}, {}
    for b in d.branches_with_rate:
        if b in d.inertial_branches:
            # With the simulated velocity of a mass, the trapezoidal rule conserves energy exactly.
            speeds[b.rate] = waves[f"{part.name}.v"]
        else:
            slopes[b.rate] = np.gradient(recorded[b.name], time)
            means[b.rate] = np.diff(recorded[b.name]) / np.diff(time)
    known = d.compute_parameter_values(part.keys) | dict(recorded) | speeds | slopes

    def evaluate_over_time(tree: Tree) -> np.ndarray:
        """Return the values of an expression at all times as an array of shape (nt,)."""
        return np.asarray(evaluate_tree(tree, known) * np.ones_like(time))

    stored = evaluate_over_time(d.stored_energy)
    dissipated, rise = _compute_step_heat(d, known, means, time), np.diff(stored)
    heat, brought, forces = dissipated, np.zeros_like(dissipated), []
    converted = 0.0  # sum of the absolute work at all pins except displacement pins
    given_off = None
    for b in d.pin_branches:
        known_as = f"{part.name}.{b.across if b.is_flow else b.through}"
        pins = waves.data.get(known_as, np.zeros_like(time))
        if b == d.heat_branch:
            heat = given_off = _integrate_steps(-pins, time, dissipated)
            continue
        if b.is_motion:
            forces.append((pins, np.diff(recorded[b.name])))
            continue
        increase = np.diff(evaluate_over_time(d.derive_stored_quantity(b))) + np.diff(
            integrate_cumulatively(evaluate_over_time(d.derive_direct_flow(b)), time)
        )
        middle = (recorded[b.name][1:] + recorded[b.name][:-1]) / 2
        work = middle * _integrate_steps(pins, time, increase)
        brought, converted = brought + work, converted + float(np.abs(work).sum())
    brought = brought + _compute_step_work(forces, rise + heat - brought, jumps=bool(slopes))
    missing = np.cumsum(brought - heat - rise)
    entries = {
        "supplied through the pins": float(brought.sum()),
        "heat" if given_off is None else f"delivered as heat at the pin {HEAT}": float(heat.sum()),
        "stored": float(stored[-1]),
    }
    if stored[0] != 0.0:
        entries["stored at the start"] = float(stored[0])
    turned = float(np.abs(brought).sum() + np.abs(heat.sum()))
    if not stored.any() and not heat.any():  # an ideal transformer stores no energy
        turned = converted
    yield RunEnergyBalance(
        entries, float(np.abs(missing).max(initial=0.0)), turned, _MAX_UNEXPLAINED_SHARE
    )


def _compute_step_heat(
    declaration: Declaration,
    known: Mapping[str, Any],
    means: Mapping[str, np.ndarray],
    time: np.ndarray,
) -> np.ndarray:
    """Compute an array (nt - 1,) with the heat [J] in each time step.

    ``known`` contains the variables as arrays of shape (nt,). The heat is the mean of the power at
    the start and at the end of a step, times the duration of the step. The velocity of a coordinate
    without mass jumps at corners of the driving waveform. Therefore, the power is computed with the
    mean velocities ``means`` (nt - 1,) of the steps, not with velocities at single times.
    """
    first, last = dict(known), dict(known)
    for name, values in known.items():
        if np.size(values) > 1:
            first[name], last[name] = values[:-1], values[1:]
    dissipated = declaration.dissipation
    power = evaluate_tree(dissipated, {**first, **means}) + evaluate_tree(
        dissipated, {**last, **means}
    )
    return np.asarray(power / 2 * np.diff(time))


def _compute_step_work(
    forces: Iterable[tuple[np.ndarray, np.ndarray]], near: np.ndarray, *, jumps: bool
) -> np.ndarray:
    """Compute an array (nt - 1,) with the work [J] of forces in each time step.

    ``forces`` contains pairs of a force (nt,) and the changes (nt - 1,) of its displacement. The
    work is the mean force in a step times the change of the displacement. If ``jumps`` is true, a
    second value of the work is computed with the force at the end of the step. In this case, the
    function returns, for each step, the value of the work that is closer to the reference value in
    ``near``, an array of shape (nt - 1,).
    """
    means, ends = np.zeros_like(near), np.zeros_like(near)
    for force, displacement in forces:
        means += (force[1:] + force[:-1]) / 2 * displacement
        ends += force[1:] * displacement
    return _select_nearer(near, means, ends) if jumps else means


def _select_nearer(near: np.ndarray, *tried: np.ndarray) -> np.ndarray:
    """Return, for each element, the nearer of two values to a reference value."""
    first, second = tried
    return np.where(np.abs(second - near) < np.abs(first - near), second, first)


def _integrate_steps(rate: np.ndarray, time: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return an array (nt - 1,) with the integral of a rate over each time step.

    The rate is an array of shape (nt,). Simulators use the trapezoidal rule or, after a jump, the
    backward Euler rule with the rate at the end of the step. The function integrates each step by
    the trapezoidal and by the backward Euler rule, and returns the result nearer to ``near`` (nt -
    1,).
    """
    step = np.diff(time)
    return _select_nearer(near, step * (rate[1:] + rate[:-1]) / 2, step * rate[1:])
