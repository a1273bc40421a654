"""Generation of the netlist cards of a declared part.

The cards contain a current or voltage source for each branch of the declaration. At the pins, 1 V
represents the pin unit of the domain, such as 1 um. At inner nodes, 1 V represents the SI unit. To
differentiate a quantity, a source applies a voltage equal to the quantity to a capacitor. The
capacitor's current is proportional to the time derivative of the capacitor's voltage.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import chain, combinations_with_replacement
from textwrap import wrap
from types import MappingProxyType

import numpy as np

from kc2spice.core.domains import QUANTITIES, Quantity
from kc2spice.core.errors import UsageError
from kc2spice.core.naming import list_names
from kc2spice.netlist.circuit import Element, Item, ModelCard, Parameters
from kc2spice.netlist.expression import (
    BinaryOperation,
    CircuitVariable,
    FunctionCall,
    Name,
    Number,
    Tree,
    substitute_names,
    walk_tree,
)
from kc2spice.netlist.number_and_name_spelling import LEAK_RATE, format_number
from kc2spice.netlist.shared_cards import Line, attach_comments, write_pivot_cards
from kc2spice.physics.declaration import TEMPERATURE, Branch, Declaration
from kc2spice.physics.flux_linkages import FluxLinkages, find_flux_linkages
from kc2spice.physics.lookup_tables import (
    CELL_NODE,
    WEIGHT_NODE,
    Lookups,
    TableFunction,
    has_tables,
)
from kc2spice.physics.symbolic_algebra import (
    ONE,
    ZERO,
    add_trees,
    differentiate_tree,
    divide_trees,
    find_kinks,
    find_names,
    format_tree,
    is_affine,
    make_weighted_sum,
    multiply_trees,
    subtract_trees,
)

_UNIT_CAPACITANCE = "1e-06"
NO_TABLES: Mapping[str, TableFunction] = MappingProxyType({})
_KINK_SWITCH = ModelCard("edge", "SW", {"VT": "0", "VH": "0", "RON": "1e6", "ROFF": "2e6"})
_TIME_INTEGRALS = {
    "current": ("charge", "coulombs"),
    "voltage": ("flux", "webers"),
    "heat_flow": ("stored heat", "joules"),
    "volume_velocity": ("volume", "m3"),
    "pressure": ("pressure impulse", "Pa s"),
}
_COMMENT_TEXTS = {
    "force": "{flow} into {plus}, out of {minus}, 1 V = 1 {unit} on {node}; {word} = "
    "{factor}V({plus},{minus})",
    "direct": "{flow} into {plus}, out of {minus}; {word} = {factor}V({plus},{minus})",
    "place": "displacement in um on {node}: {plus} minus {minus}{words}",
    "rate": "velocity of {plus} relative to {minus} in m/s: the current of 1 uF at the voltage "
    "V({plus},{minus})",
    "charge": "{integral} between {plus} and {minus} on the node {node}, 1 V = {scale} {unit}; "
    "its time derivative flows from {plus} to {minus}",
    "flux": "{integral} of the {flow} from {plus} to {minus} on the node {node}, 1 V = {scale} "
    "{unit}; its time derivative is one term of the {across}",
    "mass": "mass of {plus}: velocity on {speed} (1 V = 1 m/s), position on {place} (1 V = 1 um)",
    "shake": "{plus} accelerates the frame of {speed} (1 V = 1 m/s2) and draws the required "
    "force",
    "held": "the constraint force on {node} (1 V = 1 N) accelerates the mass so that {plus} = "
    "{place}; at an operating point, another part determines {plus}",
    "output": "{plus} in um: {words}",
    "heat": "the losses flow out of {plus}, relative to {minus}: 1 A is 1 W",
    "state": "a state: its time derivative times 1 uF flows into {node}; 1 POhm defines its DC "
    "value if no other part does",
    "noise": "thermal noise of a loss, 4 k T times {loss}, which this resistor provides",
    "leak": "this current defines the operating point of a floating net; the {integral} of the "
    "net decays with the time constant {seconds} s",
    "cell": "{cell} is the argument of the lookup tables in units of table_step; {weight} is the "
    "weight t*(1-t), where t rises from 0 to 1 between two adjacent points",
    "lookup": "A lookup table has the value f(s) - w b(s), with its argument s in units of "
    "table_step and the weight w. f is the linear interpolation of the values at {points} "
    "points. b is the linear interpolation of half of the second differences of these values; "
    "points of b on the straight line between their neighbours are omitted. The value and its "
    "first derivative are continuous. Outside the table range, the value is constant. NAME_slope "
    "is the derivative of the table NAME with respect to its argument.",
    "linkage": "flux linkage of the coil {plus}-{minus} due to all currents on {node}, 1 V = "
    "{scale} Wb; its time derivative is the coil voltage minus resistive and motional voltage",
    "current": "current from {plus} to {minus}, 1 V = 1 A on {node}: the inverse inductance "
    "matrix times the flux linkages; each matrix element is its mean plus a lookup table",
    "edge": "a switch that only makes ngspice place a time point where {argument} is zero",
}  # fmt: skip


def write_subcircuit_items(
    declaration: Declaration, noise: bool = False, tables: Mapping[str, TableFunction] = NO_TABLES
) -> tuple[Item, ...]:
    """Return the cards between ``.subckt`` and ``.ends``, with their comments.

    With ``noise``, the cards include noise sources for the losses. ``tables`` contains the tables
    of the declaration and the derivatives of these tables, keyed by name.
    """
    return attach_comments(_write_items(declaration, noise, tables))


def has_losses(declaration: Declaration) -> bool:
    """Return whether any branch has a resistance, a conductance or damping."""
    return any(declaration.derive_loss_coefficient(b) != ZERO for b in declaration.acting_branches)


def _write_items(
    declaration: Declaration, noise: bool, tables: Mapping[str, TableFunction]
) -> Iterator[Line]:
    """Yield the cards of a declaration, with comment lines before the cards."""
    for name, tree in declaration.constant_trees.items():
        yield Parameters({name: f"{{{format_tree(tree)}}}"})
    nodes, rest = _list_variable_trees(declaration), get_reference_pin_name(declaration)
    linkages = find_flux_linkages(declaration)
    lookups = Lookups(tables, _list_laws_with_tables(declaration, linkages), rest)
    if lookups.argument:
        nodes = {
            **nodes,
            **lookups.list_lookup_trees(),
            **_list_inner_voltages(declaration, linkages),
        }
        yield from _write_lookups(lookups, nodes)
    for tree, name in declaration.power_series.items():
        yield f"* power series {name}"
        yield Element.behavioural_source(
            f"B{name}", name, rest, "V", format_tree(substitute_names(tree, nodes))
        )
    rated = set(declaration.branches_with_rate).difference(declaration.inertial_branches)
    rated.update(declaration.displacement_branches if linkages else ())
    rated -= {b for b in declaration.branches if b.name in declaration.velocities}
    for branch in declaration.branches:
        if branch.less or branch.name in declaration.lags:
            yield from _write_coordinate(declaration, branch)
        elif branch in rated:
            yield from _write_velocity(declaration, branch)
    yield from _write_states(declaration, nodes)
    added: dict[str, Tree] = dict.fromkeys(declaration.coordinates, ZERO)
    branches = [
        b if b.plus else replace(b, plus=rest, minus=rest) for b in declaration.acting_branches
    ]
    for branch in branches if noise else ():
        if (loss := declaration.derive_loss_coefficient(branch)) != ZERO:
            source = CircuitVariable("v", (f"noise_{branch.name}", branch.minus))
            added[branch.name] = multiply_trees(source, FunctionCall("sqrt", (loss,)))
            yield _format_comment("noise", branch, loss=format_tree(loss))
            yield Element.from_words(
                f"Rnoise_{branch.name}", f"noise_{branch.name}", branch.minus, "1"
            )
    if linkages:
        yield from _write_linkages(linkages, lookups, nodes)
        branches = [b for b in branches if not b.is_flow]
    for branch in branches:
        if branch.is_motion:
            yield from _write_force(declaration, branch, nodes, added[branch.name], lookups)
        else:
            make = _write_current_branch if branch.is_flow else _write_voltage_branch
            yield from make(declaration, branch, nodes, added[branch.name])
    yield from _write_kink_switches(declaration, nodes)
    for name, tree in declaration.output_trees.items():
        yield f"* {_COMMENT_TEXTS['output'].format(plus=name, words=format_tree(tree))}"
        yield from _write_node(name, multiply_trees(Number("1e6"), tree), nodes, rest)


def _list_inner_voltages(
    declaration: Declaration, linkages: FluxLinkages | None
) -> dict[str, Tree]:
    """Return expressions of the voltages from inner nodes to ground, keyed by name.

    The voltages are relative to ground, because the reference pin of a part with lookups is at 0 V.
    ngspice evaluates the voltage of one node faster than the voltage between two nodes.
    """
    inner = list_inner_nodes(declaration)
    for name in linkages.current_names if linkages else ():
        inner[name] = name
    return {name: CircuitVariable("v", (node,)) for name, node in inner.items()}


def _list_laws_with_tables(
    declaration: Declaration, linkages: FluxLinkages | None
) -> tuple[Tree, ...]:
    """List the laws that may contain tables: forces, and voltages induced by motion.

    Raises
    ------
    UsageError : an expression contains a table, but is neither a force nor an inductance.
    """
    others = [*declaration.signal_trees.values(), *declaration.state_rates.values()]
    for b in declaration.branches_without_motion:
        others.append(declaration.derive_direct_flow(b))
        if not linkages:
            others.append(declaration.derive_stored_quantity(b))
    for tree in others:
        if has_tables(tree, declaration.tables):
            raise UsageError(
                "tables are supported only in forces and inductances",
                where=declaration.name,
                got=format_tree(tree),
            )
    forces = map(declaration.derive_netlist_force, declaration.displacement_branches)
    return (*forces, *(linkages.motion_voltages if linkages else ()))


def _write_lookups(lookups: Lookups, nodes: Mapping[str, Tree]) -> Iterator[Line]:
    """Yield the cards of lookups, which are tables that the simulator interpolates.

    A shared lookup occurs in several laws, and therefore has a node.
    """
    base = lookups.base
    yield from map("* {}".format, wrap(_COMMENT_TEXTS["lookup"].format(points=lookups.points), 96))
    yield Parameters(
        {"table_low": format_number(lookups.low), "table_step": format_number(lookups.step)}
    )
    yield f"* {_COMMENT_TEXTS['cell'].format(cell=CELL_NODE, weight=WEIGHT_NODE)}"
    cell = divide_trees(
        subtract_trees(lookups.argument or ZERO, Name("table_low")), Name("table_step")
    )
    yield from _write_node(CELL_NODE, cell, nodes, base)
    at, within = f"V({CELL_NODE})", "V(lookup_t)"
    yield Element.behavioural_source("Blookup_t", base, "lookup_t", "I", f"{at}-floor({at})")
    yield Element.from_words("Rlookup_t", "lookup_t", base, "1")
    yield Element.behavioural_source(
        f"B{WEIGHT_NODE}", base, WEIGHT_NODE, "I", f"{within}-{within}*{within}"
    )
    yield Element.from_words(f"R{WEIGHT_NODE}", WEIGHT_NODE, base, "1")
    for calls in lookups.repeated:
        yield f"* {lookups.describe_lookup(calls)}"
        values = lookups.evaluate_at_table_points(make_weighted_sum(calls))
        yield from _write_lookup(lookups.labels[calls], lookups, values)


def _write_lookup(name: str, lookups: Lookups, values: np.ndarray) -> Iterator[Line]:
    """Yield the cards of a node whose voltage is the value of a lookup."""
    law = format_tree(lookups.write_interpolation(values))
    yield Element.behavioural_source(f"B{name}", lookups.base, name, "I", law)
    yield Element.from_words(f"R{name}", name, lookups.base, "1")


def _write_linkages(
    linkages: FluxLinkages, lookups: Lookups, nodes: Mapping[str, Tree]
) -> Iterator[Line]:
    """Write cards of flux linkages, and of the branch currents that they determine.

    The flux linkages are states of the netlist. Each inverse inductance is the sum of its mean,
    which has a separate card, and a lookup. The iteration of ngspice starts with 0 V at the lookup
    nodes, so lookups alone would give inverse inductances of zero.
    """
    henry, inverse = linkages.invert_inductances(lookups)
    mean, count = inverse.mean(axis=0), len(linkages.branches)
    for k, l in combinations_with_replacement(range(count), 2):
        name = _name_inverse_node(k, l)
        element = f"element ({k + 1}, {l + 1}) of the inverse inductance matrix"
        yield f"* {name}: {henry:.6g} H times {element}, minus its mean"
        yield from _write_lookup(name, lookups, (inverse - mean)[:, k, l])
    for k, branch in enumerate(linkages.branches):
        motion = substitute_names(add_trees(*lookups.split_law(linkages.motion_voltages[k])), nodes)
        yield from _write_linkage(linkages.declaration, branch, henry, format_tree(motion), nodes)
        n, base, terms = branch.name, lookups.base, []
        yield _format_comment("current", branch, node=n)
        for l, other in enumerate(linkages.branches):
            linkage = f"l_{other.name}"
            yield Element.from_words(
                f"G{n}_{other.name}", base, n, linkage, base, float(mean[k, l])
            )
            terms.append(f"V({_name_inverse_node(k, l)})*V({linkage})")
        yield Element.behavioural_source(f"B{n}", base, n, "I", "+".join(terms))
        yield Element.from_words(f"R{n}", n, base, "1")


def _name_inverse_node(k: int, l: int) -> str:
    """Return the name of the node for entry (k, l) of the inverse inductance matrix."""
    return f"lookup_g{min(k, l) + 1}{max(k, l) + 1}"


def _write_linkage(
    declaration: Declaration, b: Branch, henry: float, motion: str, nodes: Mapping[str, Tree]
) -> Iterator[Line]:
    """Yield the cards for the resistance and the flux linkage of a current branch.

    The text ``motion`` is the expression of the voltage that motion induces. The flux linkage is
    divided by the inductance ``henry`` [H].
    """
    n, base, inner = b.name, get_reference_pin_name(declaration), f"rest_{b.name}"
    drop = declaration.derive_direct_flow(b)
    resistance = differentiate_tree(drop, n)
    varying = find_names(resistance) & declaration.variables
    if varying - {TEMPERATURE}:
        raise UsageError(
            "the resistance in series with a tabulated inductance is not constant",
            where=declaration.name,
            got=format_tree(drop),
            expected="a constant resistance, or a resistance that depends on temperature alone",
        )
    yield _format_comment("linkage", b, node=f"l_{n}", scale=f"{henry:.6g}")
    if varying:
        law = divide_trees(CircuitVariable("v", (b.plus, inner)), resistance)
        yield Element.behavioural_source(
            f"B{inner}", b.plus, inner, "I", format_tree(substitute_names(law, nodes))
        )
    else:
        yield Element.from_words(f"R{inner}", b.plus, inner, f"{{{format_tree(resistance)}}}")
    yield Element.from_words(f"G{inner}", inner, b.minus, n, base, "1")
    yield Element.from_words(f"Cl_{n}", f"l_{n}", base, henry)
    yield Element.from_words(f"Gl_{n}", base, f"l_{n}", inner, b.minus, "1")
    yield Element.behavioural_source(f"Bl_{n}", f"l_{n}", base, "I", motion)


def _write_node(name: str, tree: Tree, nodes: Mapping[str, Tree], base: str) -> Iterator[Line]:
    """Yield the cards of a node whose voltage is the value of an expression."""
    yield from _write_current(name, (base, name), tree, nodes)
    yield Element.from_words(f"R{name}", name, base, "1")


def _write_current(
    name: str, ends: tuple[str, str], tree: Tree, nodes: Mapping[str, Tree]
) -> Iterator[Line]:
    """Yield the cards of a current between two nodes, given as an expression.

    The current flows from the first node to the second node. An affine expression becomes linear
    sources, which ngspice need not differentiate.
    """
    start, end = ends
    dependencies = sorted(find_names(tree) & set(nodes))
    voltages = [_find_single_voltage(nodes[item]) for item in dependencies]
    smooth = not find_kinks(tree) and not _list_circuit_variables(tree)
    if not all(voltages) or not smooth or not is_affine(tree, set(dependencies)):
        yield Element.behavioural_source(
            f"B{name}", start, end, "I", format_tree(substitute_names(tree, nodes))
        )
        return
    for item, voltage in zip(dependencies, voltages, strict=True):
        card = f"G{name}" if len(dependencies) == 1 else f"G{name}_{item}"
        at = nodes[item]
        unit = at.left if isinstance(at, BinaryOperation) else ONE
        gain = f"{{{format_tree(multiply_trees(unit, differentiate_tree(tree, item)))}}}"
        yield Element.from_words(card, start, end, *voltage, gain)
    rest = add_trees(substitute_names(tree, dict.fromkeys(dependencies, ZERO)))
    if rest != ZERO:
        yield Element.from_words(
            f"I{name}", end, start, f"{{{format_tree(subtract_trees(ZERO, rest))}}}"
        )


def _list_circuit_variables(tree: Tree) -> list[CircuitVariable]:
    """Return the node voltages and source currents in an expression."""
    return [node for node in walk_tree(tree) if isinstance(node, CircuitVariable)]


def _find_single_voltage(tree: Tree) -> tuple[str, ...]:
    """Find the single voltage on which an expression depends; return its two nodes.

    Otherwise, return an empty tuple.
    """
    variables = _list_circuit_variables(tree)
    if len(variables) == 1 and variables[0].kind == "v":
        return (*variables[0].names, "0")[:2]
    return ()


def _write_mass(declaration: Declaration, b: Branch) -> Iterator[Line]:
    """Yield the cards of a mass, whose velocity is the voltage of a capacitor.

    The capacitance represents the mass. The position is the integral of the velocity. If no pin
    voltage represents the velocity, the force at the pins is both a node voltage and the current of
    a 0 V source. The 0 V source is needed, because the tolerance of ngspice is tighter for currents
    than for voltages.
    """
    n, base, speed = b.name, declaration.base or b.minus, declaration.speeds.get(b.plus)
    v, place = (speed, b.plus) if speed else (f"speed_{n}", f"place_{n}")
    start, fast = declaration.starts[n]
    yield _format_comment("mass", b, speed=v, place=place)
    end = base if speed else f"pushed_{n}"
    yield Element.from_words(f"Cplace_{n}", place, base, _UNIT_CAPACITANCE, IC=f"{{{start}*1e6}}")
    yield Element.from_words(f"Gplace_{n}", base, place, v, base, "1")
    yield Element.from_words(
        f"Cmass_{n}", v, end, f"{{{format_tree(declaration.get_branch_mass(b))}}}", IC=f"{{{fast}}}"
    )
    frame_branches = [
        other for other in declaration.branches if other.domain.name == b.domain.frame
    ]
    weight = declaration.derive_direct_flow(b)
    constant_weight = add_trees(
        substitute_names(weight, dict.fromkeys(list_names(frame_branches), ZERO))
    )
    if constant_weight != ZERO:
        yield Element.from_words(f"Iweight_{n}", v, base, f"{{{format_tree(constant_weight)}}}")
    for other in frame_branches:
        share = format_tree(differentiate_tree(weight, other.name))
        yield _format_comment("shake", other, speed=v)
        yield Element.from_words(
            f"Gshake_{other.name}", v, base, other.plus, other.minus, f"{{{share}}}"
        )
    if not speed:
        yield Element.from_words(f"Vmass_{n}", end, base, "0")
        yield _format_comment("held", b, node=name_force_node(b), place=place)
        yield Element.from_words(f"Gheld_{n}", base, name_force_node(b), b.plus, place, "1")
        yield Element.from_words(
            f"G{name_force_node(b)}", b.plus, base, name_force_node(b), base, "1"
        )
        yield Element.from_words(f"Gpush_{n}", base, v, name_force_node(b), base, "1")
        for other in frame_branches:
            share = format_tree(
                divide_trees(differentiate_tree(weight, other.name), declaration.get_branch_mass(b))
            )
            yield Element.from_words(
                f"Gdraw_{other.name}", other.plus, base, name_force_node(b), base, f"{{{share}}}"
            )


def _list_variable_trees(declaration: Declaration) -> Mapping[str, Tree]:
    """List expression trees in circuit variables for all variables of a declaration.

    The keys are the names of coordinates, rates, states, signals and power series. The circuit
    variables are node voltages and source currents.
    """
    rest = get_reference_pin_name(declaration)
    series = declaration.power_series.values()
    inner = {**dict(zip(series, series, strict=True)), **list_inner_nodes(declaration)}
    result: dict[str, Tree] = {n: CircuitVariable("v", (node, rest)) for n, node in inner.items()}
    for b in declaration.branches:
        factor = find_coordinate_quantity(b).factor
        variable = (
            CircuitVariable("i", (get_meter_name(b),))
            if b.is_flow
            else CircuitVariable("v", _find_coordinate_nodes(declaration, b))
        )
        result[b.name] = _scale_to_si(variable, factor)
        high, low = (
            _find_pin_velocity(declaration, b.plus),
            _find_pin_velocity(declaration, b.minus),
        )
        sensed = _scale_to_si(CircuitVariable("i", (f"Vrate_{b.name}",)), factor * 1e6)
        plus_pin, minus_pin = _find_sensed_pins(declaration, b)
        sensed = sensed if plus_pin != minus_pin else ZERO
        result[b.rate] = add_trees(sensed, subtract_trees(high, low))
        if node := declaration.velocities.get(b.name):
            result[b.rate] = CircuitVariable("v", (node, declaration.base or b.minus))
    return result


def _find_pin_velocity(declaration: Declaration, pin: str) -> Tree:
    """Return the voltage of the velocity node of a pin; zero without such a node."""
    speed = declaration.speeds.get(pin)
    return CircuitVariable("v", (speed,)) if speed else ZERO


def list_inner_nodes(declaration: Declaration) -> dict[str, str]:
    """Return the netlist nodes of signals and states, keyed by signal or state."""
    result = dict(zip(declaration.signals, declaration.signals, strict=True))
    for name in declaration.states:
        result[name] = get_state_node(name)
    return result


def find_coordinate_quantity(b: Branch) -> Quantity:
    """Return the physical quantity of a branch's coordinate."""
    domain, side = QUANTITIES[b.kind]
    return domain.get_quantity(side)


def _scale_to_si(tree: Tree, factor: float) -> Tree:
    """Return a voltage or current in SI units: ``tree`` multiplied by ``factor``."""
    return tree if factor == 1 else BinaryOperation("*", _format_power_of_ten(factor), tree)


def _format_power_of_ten(value: float) -> Number:
    """Return a power of ten in the spelling of netlists: 1e-6, not 1e-06."""
    return ONE if value == 1 else Number(re.sub(r"e([-+])0", r"e\1", f"{value:g}").replace("+", ""))


def _find_coordinate_nodes(declaration: Declaration, b: Branch) -> tuple[str, str]:
    """Return the two nodes whose voltage represents the coordinate of a branch."""
    separate = b.less or b.name in declaration.lags
    return (f"x_{b.name}", get_reference_pin_name(declaration)) if separate else (b.plus, b.minus)


def get_reference_pin_name(declaration: Declaration) -> str:
    """Return the name of the reference pin, to which voltages of inner nodes refer."""
    pins = (b.minus for b in declaration.branches if b.is_motion)
    return declaration.base or next(pins, "") or declaration.pin_branches[0].minus


def get_meter_name(branch: Branch) -> str:
    """Return the name of the 0 V source that measures the current of a branch."""
    return f"Vmeter_{branch.name}"


def get_state_node(name: str) -> str:
    """Return the node whose voltage equals the value of a state in SI units."""
    return f"state_{name}"


def name_force_node(branch: Branch) -> str:
    """Return the name of the node whose voltage is the force of a displacement branch."""
    return f"f_{branch.name}"


def _format_comment(kind: str, branch: Branch, **words: str) -> str:
    """Return the netlist comment of type ``kind`` for a branch."""
    return f"* {_COMMENT_TEXTS[kind].format(plus=branch.plus, minus=branch.minus, **words)}"


def _describe_time_integral(quantity: Quantity) -> tuple[str, str]:
    """Return the name and the SI unit of the time integral of a quantity."""
    plain = quantity.name.replace("_", " ")
    return _TIME_INTEGRALS.get(quantity.name, (f"integral of the {plain}", f"{quantity.unit} s"))


def _write_states(declaration: Declaration, nodes: Mapping[str, Tree]) -> Iterator[Line]:
    """Yield the cards of all signals, followed by the cards of all states."""
    base = get_reference_pin_name(declaration)
    for name, tree in declaration.signal_trees.items():
        yield f"*   {name} = {format_tree(tree)}"
        yield from _write_node(name, tree, nodes, base)
    for name, tree in declaration.state_rates.items():
        node, rate = get_state_node(name), multiply_trees(Number(_UNIT_CAPACITANCE), tree)
        yield f"* {_COMMENT_TEXTS['state'].format(node=node)}"
        yield f"*   d/dt {name} = {format_tree(tree)}"
        yield Element.from_words(f"C{node}", node, base, _UNIT_CAPACITANCE)
        yield Element.from_words(f"R{node}", node, base, "1e15")
        yield from _write_current(node, (base, node), rate, nodes)


def _write_law(declaration: Declaration, tree: Tree, nodes: Mapping[str, Tree]) -> str:
    """Write a law as card text, with node voltages in place of the law's variables."""
    return format_tree(substitute_names(declaration.replace_power_series(tree), nodes))


def _write_differentiator(name: str, node: str, minus: str) -> Iterator[Line]:
    """Yield the cards that differentiate a voltage.

    The cards are a capacitor and the source ``Vrate_NAME`` in series. The current of the source is
    1e-6 times the time derivative of the voltage between ``node`` and ``minus``.
    """
    yield Element.from_words(f"Crate_{name}", node, f"sense_{name}", _UNIT_CAPACITANCE)
    yield Element.from_words(f"Vrate_{name}", f"sense_{name}", minus, "0")


def _find_sensed_pins(declaration: Declaration, b: Branch) -> tuple[str, str]:
    """Find the pins whose displacement the netlist senses to compute a velocity.

    A pin with a velocity node is replaced by the reference pin.
    """
    base = declaration.base or b.minus
    plus, minus = (base if pin in declaration.speeds else pin for pin in (b.plus, b.minus))
    return plus, minus


def _write_velocity(declaration: Declaration, b: Branch) -> Iterator[Line]:
    """Yield the cards that differentiate the displacement of a branch.

    A pin with a velocity node is left out, because the voltage of this node already is the velocity
    of the pin.
    """
    base = declaration.base or b.minus
    plus, minus = _find_sensed_pins(declaration, b)
    if plus != minus:
        yield _format_comment("rate", replace(b, plus=plus, minus=minus))
        yield Element.from_words(f"Ecopy_{b.name}", f"copy_{b.name}", base, plus, minus, "1")
        yield from _write_differentiator(b.name, f"copy_{b.name}", base)


def _write_coordinate(declaration: Declaration, b: Branch) -> Iterator[Line]:
    """Yield the cards of a coordinate that is not a voltage between two pins.

    A coordinate with a lag or with three pins is not a voltage between two pins. For a coordinate x
    with a lag, the voltage of the node is ``x + lag x'``, up to terms of second order in the lag.
    Two RC low-pass filters in series, each with the time constant ``lag / 4``, give an estimate of
    the derivative x'. With the filter outputs ``first`` and ``second``, the voltage is ``x + 4 (2 x
    - first + second - first)``.
    """
    n, base, lag = b.name, get_reference_pin_name(declaration), declaration.lags.get(b.name)
    node = f"in_{n}" if lag else f"x_{n}"
    words = f" minus {b.less}" * bool(b.less) + f" + {lag} times its time derivative" * bool(lag)
    yield _format_comment("place", b, node=f"x_{n}", words=words)
    yield Element.from_words(f"G{node}", base, node, b.plus, b.minus, "1")
    if b.less:
        yield Element.from_words(f"Gless_{n}", node, base, b.less, base, "1")
    yield Element.from_words(f"R{node}", node, base, "1")
    if lag:
        for before, name in ((node, f"first_{n}"), (f"first_{n}", f"second_{n}")):
            yield Element.from_words(f"G{name}", base, name, before, base, "1")
            yield Element.from_words(f"R{name}", name, base, "1")
            yield Element.from_words(f"C{name}", name, base, f"{{{lag}/4}}")
        yield Element.from_words(f"Gnow_{n}", base, f"x_{n}", node, base, "9")
        yield Element.from_words(f"Gthen_{n}", f"x_{n}", base, f"first_{n}", base, "12")
        yield Element.from_words(f"Gbefore_{n}", base, f"x_{n}", f"second_{n}", base, "4")
        yield Element.from_words(f"Rx_{n}", f"x_{n}", base, "1")


def _write_force(
    declaration: Declaration, b: Branch, nodes: Mapping[str, Tree], noise: Tree, lookups: Lookups
) -> Iterator[Line]:
    """Yield the cards of the force of a displacement branch."""
    if b in declaration.inertial_branches:
        yield from _write_mass(declaration, b)
        return
    node, base = name_force_node(b), declaration.base or b.minus
    speeds = declaration.speeds
    high, low = speeds.get(b.plus, b.plus), speeds.get(b.minus, b.minus)
    force = declaration.derive_netlist_force(b)
    metered = declaration.metered or b.less
    ends = (base, node) if metered else (high, low)
    across, through = b.domain.across, b.domain.through_variable
    factor = "" if across.factor == 1 else f"{format_tree(_format_power_of_ten(across.factor))} "
    words = {"flow": through.name, "unit": through.pin_unit, "word": across.symbol}
    yield _format_comment("force" if metered else "direct", b, node=node, factor=factor, **words)
    yield f"*   {b.through} = {format_tree(declaration.replace_power_series(force))}"
    terms = lookups.split_law(add_trees(force, noise))
    for k, term in enumerate(terms):
        for label in sorted(find_names(term) & set(lookups.single_use_formulas)):
            yield f"*   the lookup of {lookups.single_use_formulas[label]}"
        name = f"B{node}{k + 1 if len(terms) > 1 else ''}"
        yield Element.behavioural_source(name, *ends, "I", _write_law(declaration, term, nodes))
    if metered:
        yield Element.from_words(f"R{node}", node, base, "1")
        yield Element.from_words(f"G{node}", high, low, node, base, "1")
    if b.less:
        yield Element.from_words(f"Gless_{node}", base, b.less, node, base, "1")


def _write_stored_quantity(
    declaration: Declaration, b: Branch, stored: Tree, node: str, nodes: Mapping[str, Tree]
) -> Iterator[Line]:
    """Yield the cards of the stored quantity of a branch, and of its time derivative.

    The card contains the stored quantity, such as a charge or flux, divided by a scale. The scale
    is usually the derivative of the stored quantity with respect to the coordinate of the branch.
    If the stored quantity is proportional to the branch's coordinate, the voltage of the node
    ``node`` equals this coordinate in its netlist unit.
    """
    scale = declaration.set_variables_to_zero(differentiate_tree(stored, b.name))
    scale = multiply_trees(_format_power_of_ten(find_coordinate_quantity(b).factor), scale)
    moved = _compute_change_by_motion(declaration, stored) if scale == ZERO else scale
    unit = moved if moved != ZERO else Number("1e-12")
    yield Parameters({f"scale_{b.name}": f"{{{format_tree(unit)}}}"})
    amount = substitute_names(declaration.replace_power_series(stored), nodes)
    # When ngspice differentiates a quotient, it adds 1e-32 to the square of the divisor.
    # Derivatives of quotients with a small divisor are therefore inaccurate.
    # To avoid a division, the card of a charge multiplies the charge by a parameter with the value
    # 1/scale.
    if not b.is_flow:
        yield Parameters({f"per_{b.name}": f"{{1/scale_{b.name}}}"})
        amount = BinaryOperation("*", Name(f"per_{b.name}"), amount)
    else:
        amount = BinaryOperation("/", amount, Name(f"scale_{b.name}"))
    yield Element.behavioural_source(f"B{node}", node, b.minus, "V", format_tree(amount))
    yield from _write_differentiator(b.name, node, b.minus)


def _compute_change_by_motion(declaration: Declaration, stored: Tree) -> Tree:
    """Return the change of a stored quantity for a displacement of 1 um.

    If the stored quantity depends on several displacements, only the first of these displacements
    changes. All coordinates are zero.
    """
    for b in declaration.displacement_branches:
        slope = declaration.set_variables_to_zero(differentiate_tree(stored, b.name))
        if slope != ZERO:
            return multiply_trees(_format_power_of_ten(find_coordinate_quantity(b).factor), slope)
    return ZERO


def _write_voltage_branch(
    declaration: Declaration, b: Branch, nodes: Mapping[str, Tree], noise: Tree
) -> Iterator[Line]:
    """Yield the cards of the current through a voltage branch."""
    motion, charge = declaration.split_motion(declaration.derive_stored_quantity(b))
    direct, inner = declaration.derive_direct_flow(b), b.plus
    if motion != ZERO:
        direct = add_trees(direct, motion)
    unit = _format_power_of_ten(b.domain.through_variable.pin_value_per_si_unit)
    times_unit = "" if unit == ONE else f"*{format_tree(unit)}"
    heating = b == declaration.heat_branch
    if declaration.metered or charge != ZERO or heating:
        inner = f"in_{b.name}"
        yield Element.from_words(get_meter_name(b), b.plus, inner, "0")
    if charge != ZERO:
        integral, si_unit = _describe_time_integral(b.domain.through_variable)
        words = {"integral": integral, "unit": si_unit, "scale": f"scale_{b.name}"}
        yield _format_comment("charge", b, node=f"q_{b.name}", **words)
        yield f"*   {integral} = {format_tree(declaration.replace_power_series(charge))}"
        yield from _write_stored_quantity(declaration, b, charge, f"q_{b.name}", nodes)
        rate = f"{{scale_{b.name}*1e6{times_unit}}}"
        yield Element.from_words(f"Fq_{b.name}", inner, b.minus, f"Vrate_{b.name}", rate)
        yield f"* {_COMMENT_TEXTS['leak'].format(integral=integral, seconds=f'{1 / LEAK_RATE:g}')}"
        leak = f"{{{LEAK_RATE:g}*scale_{b.name}{times_unit}}}"
        yield Element.from_words(f"Gleak_{b.name}", b.plus, b.minus, f"q_{b.name}", b.minus, leak)
    if heating:
        yield _format_comment("heat", b)
    if direct != ZERO or charge == ZERO:
        yield f"*   {b.through} = {format_tree(declaration.replace_power_series(direct))}"
        current_law = multiply_trees(
            unit, declaration.replace_power_series(add_trees(direct, noise))
        )
        yield from _write_current(f"i_{b.name}", (inner, b.minus), current_law, nodes)


def _write_current_branch(
    declaration: Declaration, b: Branch, nodes: Mapping[str, Tree], noise: Tree
) -> Iterator[Line]:
    """Yield the cards of the voltage across a current branch."""
    motion, flux = declaration.split_motion(declaration.derive_stored_quantity(b))
    drop, inner = declaration.derive_direct_flow(b), f"in_{b.name}"
    if motion != ZERO:
        drop = add_trees(drop, motion)
    unit = _format_power_of_ten(b.domain.across.pin_value_per_si_unit)
    across = b.domain.across.name.replace("_", " ")
    integral, si_unit = _describe_time_integral(b.domain.across)
    yield Element.from_words(get_meter_name(b), b.plus, inner, "0")
    if flux != ZERO:
        words = {"integral": integral, "unit": si_unit, "scale": f"scale_{b.name}"}
        words |= {"flow": b.kind.replace("_", " "), "across": across}
        yield _format_comment("flux", b, node=f"l_{b.name}", **words)
        yield f"*   {integral} = {format_tree(declaration.replace_power_series(flux))}"
        yield from _write_stored_quantity(declaration, b, flux, f"l_{b.name}", nodes)
        yield Element.from_words(
            f"Hl_{b.name}", inner, f"rest_{b.name}", f"Vrate_{b.name}", f"{{scale_{b.name}*1e6}}"
        )
        inner = f"rest_{b.name}"
    yield f"*   {across} minus the time derivative of the {integral} = {format_tree(drop)}"
    law = _write_law(declaration, multiply_trees(unit, add_trees(drop, noise)), nodes)
    yield Element.behavioural_source(f"Bv_{b.name}", inner, b.minus, "V", law)


def _write_kink_switches(declaration: Declaration, nodes: Mapping[str, Tree]) -> Iterator[Line]:
    """Yield the cards of a switch for each kink of a law.

    The switch makes ngspice place a time point at the kink. A time step across a kink would change
    the energy of a spring. ngspice shortens its time steps until the control voltage of a switch is
    within 0.05 V of the threshold. If the kink depends on a displacement only, the control voltage
    rises by 10 kV per um. If the kink depends on states, the control voltage is 100 V times the
    expression that is zero at the kink. With larger gains, the time steps before a fast crossing of
    a kink would become too small.
    """
    moved = {b.name: b for b in declaration.displacement_branches}
    inner = {*declaration.states, *declaration.signals}
    flows = map(declaration.derive_direct_flow, declaration.branches_without_motion)
    forces = map(declaration.derive_netlist_force, declaration.displacement_branches)
    laws = (*forces, *flows, *declaration.state_rates.values())
    result = []
    for argument in dict.fromkeys(chain.from_iterable(map(find_kinks, laws))):
        inputs = find_names(argument) & {*declaration.coordinates, *inner}
        if inputs & inner or (len(inputs) == 1 and inputs <= set(moved)):
            result.append((argument, moved.get(next(iter(inputs)))))
    if declaration.stops:
        yield from write_pivot_cards(get_reference_pin_name(declaration))
    for k, (argument, b) in enumerate(result):
        base = declaration.base or (b.minus if b else get_reference_pin_name(declaration))
        yield f"* {_COMMENT_TEXTS['edge'].format(argument=format_tree(argument))}"
        yield f"* edge {k + 1}" if k else _KINK_SWITCH
        watched: Tree = BinaryOperation("*", Number("1e10"), substitute_names(argument, nodes))
        if declaration.metered and b is not None:
            yield Element.behavioural_source(
                f"Bedge{k}", f"edge{k}", base, "V", format_tree(watched)
            )
        else:
            watched = multiply_trees(Number("100" if b is None else "1e10"), argument)
            yield from _write_node(f"edge{k}", watched, nodes, base)
        yield Element.from_words(f"Sedge{k}", f"edge{k}", base, f"edge{k}", base, "edge")
