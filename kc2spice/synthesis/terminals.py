"""Pins of a subcircuit's ports, and the cards between pins and states."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from operator import attrgetter
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from kc2spice.core.domains import BASE, ELECTRICAL, TRANSLATION, Domain
from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.netlist.circuit import Element, Pin
from kc2spice.netlist.number_and_name_spelling import LEAK_RATE, format_number, require_distinct
from kc2spice.netlist.number_and_name_spelling import require_name as checked_name
from kc2spice.netlist.shared_cards import Line
from kc2spice.rom.linear_model import LinearModel, Port
from kc2spice.synthesis.circuit_error import LOWEST_FREQUENCY_RATIO, MICRO, accelerates_frame
from kc2spice.synthesis.library_headers import list_netlist_pins

if TYPE_CHECKING:
    pass
# leakage conductance [S] at a signal input, so that an input without a source is zero
INPUT_LEAK = 1e-18
LEAK_POINTS = 60  # number of frequencies in the search for the smallest charge per volt
# An entry of D counts as a rounding error if its ratio to the largest entry in its row is below
# CROSS_ROUNDING.
CROSS_ROUNDING = 1e-13
# The product C B counts as zero if its value, relative to its terms, is below NEGLIGIBLE_JUMP.
# If C B is not zero, the rate of an output jumps when an input jumps.
NEGLIGIBLE_JUMP = 1e-9
INNER_NODE_PATTERN = r"tick|(inner|current|charge)\w*|sum\d+|[qpz]\d+|noise\d+"
# Description of the names that INNER_NODE_PATTERN does not match, for error messages.
PERMITTED_PIN_NAMES = (
    "a name that is not reserved; reserved names are `tick`, names that begin with `inner`, "
    "`current` or `charge`, and `p`, `q`, `z`, `sum` or `noise` followed by a number"
)
OUTWARDS_COMMENT = (
    "* Displacements (um) are positive along a port's outward direction. A current into its pin is",
    "* a force on the body in this direction (rotations: right-hand rule of the port's axis).",
)
_CLAMPED_COMMENT = """
* Electrical port{name}: the clamped capacitance of {farad:.6g} F is in series with the voltage
* -charge/capacitance. The node charge has the electrode charge due to the modes (1 V = 1 uC).
* Cclamped carries the fraction {share} of the current, and Gmore carries the rest. Therefore the
* motion of the body, not the electrical current, determines the time steps. The voltage of the node
* current is the total current. Gleak is the DC path of a floating electrode: its charge decays with
* a time constant of {seconds:g} s."""
_CLAMPED_PIN_COMMENT = """
* Port {pin}: 1 V is 1 {across} relative to {base}, 1 A is 1 {flow} into the body.
* Charge is the time integral of the current. The capacitance of {farad:.6g} F is in series with
* the voltage -charge/capacitance. The node charge has the charge due to the modes (1 V = 1 uC, that
* is 1e-6 {flow} s). Cclamped carries the fraction {share} of the current, and Gmore carries the
* rest. The voltage of the node current is the total current. Gleak is the DC path of the pin: the
* charge decays with a time constant of {seconds:g} s."""
_UNCLAMPED_PIN_COMMENT = """
* Port {pin}: 1 V is 1 {across} relative to {base}, 1 A is 1 {flow} into the body.
* The current is the time derivative of the quantity that the states store. Gleak is the DC path of
* the pin."""
_UNCLAMPED_COMMENT = """
* Electrical port {name} has no clamped capacitance: its current is the time derivative of the
* charge due to the states.
* Gleak is the DC path of a floating electrode."""
_MOTION_COMMENT = """
* Port {pin}: its displacement u is the sum of the modes (1 V = 1 um). The voltage of node f is the
* force that keeps the pin at u (1 V = 1 N)."""
_ROTATION_COMMENT = """
* Rotation {pin}: like a displacement port, with 1 V = 1 rad and 1 A = 1 N m."""
_FRAME_COMMENT = """
* Acceleration {pin} of the frame to which the body is fixed (1 V = 1 m/s2). The current into the
* pin is the force that accelerates the body (1 A = 1 N)."""
_NOISE_INPUT_NAME = re.compile(r"noise\d+")


Value: TypeAlias = float | str  # number, or expression of subcircuit parameters


def write_value(value: Value) -> str:
    """Return a number or an expression in the syntax of netlist cards."""
    return f"{{{value}}}" if isinstance(value, str) else format_number(value)


def scale_value(factor: float, value: Value) -> Value:
    """Return the product of a number and a value, which is a number or an expression."""
    return f"{format_number(factor)}*{value}" if isinstance(value, str) else factor * value


@dataclass(frozen=True)
class Transconductance:
    """Current source that the voltage between two nodes controls.

    The voltage from node ``plus`` to node ``minus`` controls the current. ``value`` is the
    transconductance [A/V].
    """

    label: str
    plus: str
    minus: str
    value: Value

    def write_element(self, a: str, b: str, prefix: str = "") -> Element:
        """Return the source as a netlist element, with its current from ``a`` to ``b``."""
        value = write_value(self.value)
        return Element.from_words(f"{prefix}{self.label}", a, b, self.plus, self.minus, value)


def connect_sources(
    sources: Iterable[Transconductance], a: str, b: str, prefix: str = ""
) -> Iterator[Element]:
    """Yield the elements of controlled sources in parallel, from node a to node b."""
    for source in sources:
        yield source.write_element(a, b, prefix)


@dataclass(frozen=True)
class PortTerminal:
    """Port of a subcircuit with its pins, capacitances and output sources.

    ``column`` is the number of the port's column in the matrix B, and ``row`` the number of its row
    in the matrix C. ``clamped`` is the clamped capacitance [F] of the port. If ``capacitance`` is
    not empty, this expression replaces the value of ``clamped``. The sources in ``sums`` add a
    weighted sum of the states to the output of the port. The sources in ``through`` add a weighted
    sum of the port inputs to the output of the port. The names of the port's nodes end with
    ``tag``. ``leak`` is the leakage conductance [S] between the pins.
    """

    port: Port
    pins: tuple[str, ...]
    tag: str
    column: int | None
    row: int | None
    clamped: float
    capacitance: str = ""
    sums: tuple[Transconductance, ...] = ()
    through: tuple[Transconductance, ...] = ()
    leak: float = INPUT_LEAK

    @property
    def kind(self) -> str:
        """Kind of the port, such as "output" for a signal output."""
        return self.port.kind

    @property
    def port_name(self) -> str:
        """Name of the port."""
        return self.port.name

    @property
    def is_frame_acceleration(self) -> bool:
        """Whether the input of the port is the acceleration of the body's frame."""
        return accelerates_frame(self.port)

    @property
    def is_noise(self) -> bool:
        """Whether the input of the port is a thermal noise force."""
        return _NOISE_INPUT_NAME.fullmatch(self.port_name) is not None

    @property
    def source_letter(self) -> str:
        """Letter after ``G`` in the names of a port's sources: ``f``, ``s`` or ``v``.

        The letter is ``f`` for a flow, ``s`` for the acceleration of a frame, and ``v`` otherwise.
        """
        if self.port.is_flow_driven:
            return "f"
        return "s" if self.is_frame_acceleration else "v"

    @property
    def output_value_per_volt(self) -> float:
        """SI value of the port's output that 1 V on the output node represents."""
        domain = self.port.domain
        if domain is None:
            return 1.0
        if self.port.is_flow_driven:
            return domain.across.factor
        return MICRO * domain.through_variable.factor

    @property
    def input_value_per_volt(self) -> float:
        """SI value of the port's input that 1 V between the input nodes represents."""
        domain = self.port.domain
        return 1.0 if domain is None else domain.get_quantity(domain.input_side).factor

    def get_driven_pins(self, base: str) -> tuple[str, str]:
        """Return the pins between which a source drives the port."""
        return (self.pins[0], self.pins[1]) if self.port.is_paired else (self.pins[0], base)

    def get_input_nodes(self, base: str) -> tuple[str, str]:
        """Return the nodes between which the voltage is the input of the port."""
        return (
            (f"f{self.pins[0]}", base) if self.port.is_flow_driven else self.get_driven_pins(base)
        )

    def make_weighted_source(
        self, label: str, row: np.ndarray | Sequence[Value], base: str
    ) -> Transconductance:
        """Make a current source whose current is the weighted input of the port.

        ``row`` contains the weights of all inputs.
        """
        value = row[self.column or 0]
        if self.input_value_per_volt != 1.0 and value:
            value = scale_value(self.input_value_per_volt, value)
        return Transconductance(label, *self.get_input_nodes(base), value)


@dataclass(frozen=True, eq=False)
class StateNodes:
    """Netlist nodes of the states of a state-space model.

    The model is ``z' = A z + B u``, ``y = C z + D u`` with the states z. Each state is the voltage
    of one of the ``nodes``. The outputs y are the voltages of the output nodes of the ports.
    ``labels`` contains one name suffix for each state. The name of each controlled source that
    depends on a state ends with the suffix of this state.
    """

    nodes: Sequence[str]
    labels: Sequence[str]
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray

    def write_state_sum(self, row: np.ndarray, base: str) -> tuple[Transconductance, ...]:
        """Return sources whose total current is a weighted sum of the states.

        ``row`` contains the weights.
        """
        result = []
        for k in np.flatnonzero(row).tolist():
            value = float(row[k])
            result.append(Transconductance(self.labels[k], self.nodes[k], base, value))
        return tuple(result)


def write_weighted_sources(
    terminals: Iterable[PortTerminal], row: np.ndarray, base: str, *, mark: str = ""
) -> tuple[Transconductance, ...]:
    """Return sources whose total current is the weighted sum of the port inputs.

    ``row`` contains the weights. The label of a source consists of the argument ``mark`` and the
    number of the input.
    """
    result = []
    for t in terminals:
        if t.column is not None and row[t.column]:
            result.append(t.make_weighted_source(f"{mark}{t.column + 1}", row, base))
    return tuple(result)


def mask_charge_ports(rom: LinearModel) -> list[bool]:
    """Return, for each port of a model, whether its output is a charge."""
    return list(map(attrgetter("has_charge_output"), rom.ports))


def make_terminals(rom: LinearModel, D: np.ndarray, where: str) -> list[PortTerminal]:
    """Return the terminals of a model's ports, with capacitances from the matrix D.

    Raises
    ------
    UsageError : a port has a wrong number of pins, or a clamped capacitance is negative.
    """
    several = sum(mask_charge_ports(rom)) > 1
    result, column, row = [], 0, 0
    for port in rom.ports:
        pins = tuple(map(checked_name, port.terminals))
        if len(pins) != (2 if port.is_paired else 1):
            raise UsageError(
                "the port has a wrong number of pins",
                where=where,
                got=f"{len(pins)} pins of the port {port.name}",
                expected="two pins for an electrical port, one pin for every other port",
            )
        into = None if port.kind == "output" else column
        out = None if port.kind == "input" else row
        column += into is not None
        row += out is not None
        clamped = (
            _compute_pin_capacitance(port.domain, D[out, into]) if port.has_charge_output else 0.0
        )
        if clamped < 0:
            raise UsageError(
                "the clamped capacitance of a port is negative",
                where=where,
                got=f"{clamped:.3g} F at port {port.name}",
                expected="a positive entry of D, the clamped capacitance",
            )
        tag = f"_{checked_name(port.name)}" if port.has_charge_output and several else ""
        leak = (
            INPUT_LEAK
            if clamped or not port.has_charge_output
            else _find_leak_conductance(rom, port)
        )
        result.append(PortTerminal(port, pins, tag, into, out, clamped, leak=leak))
    return result


def _compute_pin_capacitance(domain: Domain | None, stored: Any) -> float:
    """Compute the pin capacitance [F] for the charge or volume that a port stores.

    ``stored`` is the stored quantity, such as a charge, per unit of the across quantity in SI
    units.
    """
    assert domain is not None
    return float(stored) * domain.admittance


def _find_leak_conductance(rom: LinearModel, port: Port) -> float:
    """Return the leakage conductance [S] of an electrode without clamped capacitance.

    The conductance is ``LEAK_RATE`` times the smallest charge per volt of the electrode within the
    band.
    """
    low, high = get_model_band(rom)
    frequency = np.geomspace(max(low, LOWEST_FREQUENCY_RATIO * high), high, LEAK_POINTS)
    try:
        charge = np.abs(rom.select([port.name]).transfer(frequency))
    except SimulationError:  # a frequency coincides with a pole
        return INPUT_LEAK
    return LEAK_RATE * _compute_pin_capacitance(port.domain, charge.min()) or INPUT_LEAK


def get_model_band(rom: LinearModel) -> tuple[float, float]:
    """Return the lower and upper end of a model's band [Hz], by default 0 and 1 Hz."""
    return rom.certificate.band_hz if rom.certificate else rom.band or (0.0, 1.0)


def list_subcircuit_pins(
    terminals: Sequence[PortTerminal], name: str
) -> tuple[tuple[Pin, ...], str]:
    """Return the pins of a subcircuit, and the name of its reference pin.

    The order of the pins is: pairs of pins, other conservative pins, signals, reference pin.

    Raises
    ------
    UsageError : a pin has a name that the subcircuit ``name`` uses internally.
    """
    paired, moving, signals = list[Pin](), list[Pin](), list[Pin]()
    inner = [INNER_NODE_PATTERN]
    for t in terminals:
        pins = list_netlist_pins(t.port)
        if t.port.is_flow_driven:
            inner.append(get_flow_node_pattern(pins[0]))
        if t.port.conservative:
            (paired if t.port.is_paired else moving).extend(pins)
        else:
            signals += pins
    common = find_reference_pin(list(map(attrgetter("port"), terminals)))
    # several electrical ports may share one cathode pin
    result = (*dict.fromkeys(paired), *moving, *signals, common)
    require_distinct_pins(result, inner, name)
    return result, common.name


def get_flow_node_pattern(pin: Pin) -> str:
    """Return the pattern of internal node names of a port whose input is a flow.

    The pattern is a regular expression.
    """
    return f"[uf]{pin.name.lower()}"


def require_distinct_pins(pins: Iterable[Pin], inner: Iterable[str], name: str) -> None:
    """Raise an error if a pin has the name of another pin or of an internal node."""
    require_distinct(
        list(map(attrgetter("name"), pins)),
        "|".join(inner),
        where=checked_name(name),
        expected=PERMITTED_PIN_NAMES,
    )


def find_reference_pin(ports: Sequence[Port]) -> Pin:
    """Return the common reference pin of all pins that do not belong to pairs.

    In a model with mechanical ports, the reference pin is called ``base``. If a pin of a port is
    already called ``base``, the reference pin is called ``ground``.
    """
    domains = list_port_domains(ports)
    others = list(filter(attrgetter("reference"), domains))
    if len(others) == 1 and others[0].reference != BASE:
        return Pin(others[0].reference, *others[0].units)
    if domains:
        terminals = chain.from_iterable(map(attrgetter("terminals"), ports))
        return Pin("ground" if BASE in terminals else BASE, *TRANSLATION.units)
    return Pin("ref", *ELECTRICAL.units)


def list_port_domains(ports: Iterable[Port]) -> list[Domain]:
    """Return the different physical domains of ports, in the order of the ports."""
    return list(filter(None, dict.fromkeys(map(attrgetter("domain"), ports))))


@dataclass(frozen=True, eq=False)
class OutputSourceWriter:
    """Writer of the controlled sources that produce a state-space model's outputs.

    The outputs are ``y = C z + D u``. At an electrical port without a clamped capacitance, the
    sources provide the current ``y' = C A z + C B u``. At an acceleration port, the sources provide
    the force ``m a - y''`` [N] with the body's mass m, the frame's acceleration a and ``y'' = C A^2
    z + C A B u``. At an acceleration port, C B must be zero, as in all models whose moving parts
    have inertia.
    """

    terminals: Sequence[PortTerminal]
    states: StateNodes
    D: np.ndarray
    rom: LinearModel
    base: str

    def connect_output(self, t: PortTerminal) -> PortTerminal:
        """Connect a port to the sources of its output, and return the changed terminal.

        Raises
        ------
        UsageError : an acceleration port depends on the rate of an input, or the charge of an
            electrode without clamped capacitance depends directly on another input.
        """
        if t.row is None:
            return t
        if t.is_frame_acceleration:
            return self._make_acceleration_terminal(t)
        row, direct = self.states.C[t.row], self.D[t.row] / t.output_value_per_volt
        if (
            t.port.has_charge_output
        ):  # a capacitor, not a source, represents the clamped capacitance
            direct = np.where(np.abs(direct) > CROSS_ROUNDING * np.abs(direct).max(), direct, 0.0)
            direct[t.column] = 0.0
            if not t.clamped:
                return self._connect_unclamped_electrode(t, direct)
        return replace(t, sums=self._write_state_sum(row), through=self._write_input_sum(direct))

    def _make_acceleration_terminal(self, t: PortTerminal) -> PortTerminal:
        """Return the terminal of an acceleration port with the sources of its force."""
        row, states = self.states.C[t.row], self.states
        jump = np.abs(row @ states.B) > NEGLIGIBLE_JUMP * (np.abs(row) @ np.abs(states.B))
        at_once = np.abs(self.D[t.row] - self.rom.D[t.row]) > CROSS_ROUNDING * np.abs(self.D).max()
        if jump.any() or at_once.any():
            raise UsageError(
                "netlists do not support an acceleration port that acts on states without inertia, "
                "because the output of the port, or the rate of the output, then jumps",
                where=t.port_name,
                got="an acceleration port with an output whose rate jumps when an input jumps"
                if jump.any()
                else "an acceleration port with an output that jumps when an input jumps",
                expected="an acceleration port that acts only on states with inertia",
                hint="set the rows of B and the columns of C of all states without inertia to zero",
            )
        rate = MICRO * row @ states.A
        force = -(rate @ states.B)
        mass = self.rom.facts.get("mass_kg")
        force[t.column] = 0.0 if mass is None else mass + force[t.column]
        sums = self._write_state_sum(-(rate @ states.A))
        return replace(t, sums=sums, through=self._write_input_sum(force))

    def _connect_unclamped_electrode(self, t: PortTerminal, direct: np.ndarray) -> PortTerminal:
        """Connect an electrode without clamped capacitance to the sources of its current.

        ``direct`` contains the direct effect of each port input on the charge of the electrode.
        """
        if direct.any():
            raise UsageError(
                "the electrode has a zero on the diagonal of D, but D couples the electrode to "
                "other ports",
                where=t.port_name,
                expected="a positive semi-definite matrix D",
            )
        row = self.states.C[t.row]
        jumps = self._write_input_sum(MICRO * row @ self.states.B, mark="tu")
        return replace(t, sums=self._write_state_sum(MICRO * row @ self.states.A) + jumps)

    def _write_state_sum(self, row: np.ndarray) -> tuple[Transconductance, ...]:
        """Return sources whose total current is a weighted sum of the states.

        ``row`` contains the weights.
        """
        return self.states.write_state_sum(row, self.base)

    def _write_input_sum(self, row: np.ndarray, mark: str = "u") -> tuple[Transconductance, ...]:
        """Return sources whose total current is a weighted sum of the port inputs.

        ``row`` contains the weights. Inputs whose weight is a rounding error are omitted.
        """
        size = np.abs(row).max(initial=0.0)
        row = np.where(np.abs(row) > CROSS_ROUNDING * size, row, 0.0)
        return write_weighted_sources(self.terminals, row, self.base, mark=mark)


def write_port_cards(terminals: Sequence[PortTerminal], base: str, share: float) -> Iterator[Line]:
    """Yield the cards of all ports.

    Ports with charge outputs come first, followed by flow-driven ports and acceleration ports. The
    input of a flow-driven port is a flow, such as a force.
    """
    for role in ("port.has_charge_output", "port.is_flow_driven", "is_frame_acceleration"):
        for t in filter(attrgetter(role), terminals):
            yield from _write_port(t, base, share)


def _write_port(t: PortTerminal, base: str, share: float) -> Iterator[Line]:
    """Yield the cards of one port."""
    pin, tag = t.pins[0], t.tag
    if t.is_frame_acceleration:
        yield _FRAME_COMMENT.format(pin=pin)
        yield from connect_sources(t.sums + t.through, pin, base, f"Ga{pin}_")
    elif t.port.is_flow_driven:
        yield (_MOTION_COMMENT if t.port.domain is TRANSLATION else _ROTATION_COMMENT).format(
            pin=pin
        )
        yield Element.from_words(f"Ru{pin}", f"u{pin}", base, "1")
        yield Element.from_words(f"Gf{pin}", base, f"f{pin}", pin, f"u{pin}", "1")
        yield Element.from_words(f"Gp{pin}", pin, base, f"f{pin}", base, "1")
        yield from connect_sources(t.sums, base, f"u{pin}", f"Gu{pin}_")
        yield from connect_sources(t.through, base, f"u{pin}", f"Gt{pin}_")
    elif t.clamped:
        yield from _write_clamped_port(t, base, share)
    else:
        a, b = t.get_driven_pins(base)
        yield (_UNCLAMPED_COMMENT if t.port.is_paired else _UNCLAMPED_PIN_COMMENT).format(
            name=t.port_name, **_list_pin_comment_values(t, base)
        )
        yield Element.from_words(f"Gleak{tag}", a, b, a, b, t.leak)
        for source in t.sums:
            yield replace(source, label=f"{source.label}{tag}").write_element(a, b, "Gc")


def _write_clamped_port(t: PortTerminal, base: str, share: float) -> Iterator[Line]:
    """Yield the cards of an electrical port with a clamped capacitance."""
    tag = t.tag
    words = {"name": f" {t.port_name}" if tag else "", "farad": t.clamped, "share": share}
    words["seconds"] = 1 / LEAK_RATE
    yield (_CLAMPED_COMMENT if t.port.is_paired else _CLAMPED_PIN_COMMENT).format(
        **words, **_list_pin_comment_values(t, base)
    )
    (a, b), c = t.get_driven_pins(base), t.capacitance or t.clamped
    inverse = f"{format_number(MICRO)}/{c}" if isinstance(c, str) else MICRO / c
    leak = write_value(scale_value(LEAK_RATE, c))
    yield Element.from_words(f"Cclamped{tag}", a, f"inner{tag}", write_value(scale_value(share, c)))
    yield Element.from_words(f"Gmore{tag}", a, b, f"current{tag}", base, 1 - share)
    yield Element.from_words(f"Gleak{tag}", a, b, a, f"inner{tag}", leak)
    yield Element.from_words(f"Ginner{tag}", base, f"current{tag}", f"inner{tag}", b, "1")
    ends = f"current{tag}", f"charge{tag}"
    yield Element.from_words(f"Gcharge{tag}", base, *ends, base, write_value(inverse))
    yield Element.from_words(f"Gcurrent{tag}", f"inner{tag}", b, f"current{tag}", base, share)
    yield Element.from_words(f"Rcharge{tag}", f"charge{tag}", base, "1")
    yield from connect_sources(t.sums + t.through, base, f"charge{tag}", f"Gc{tag}_")


def _list_pin_comment_values(t: PortTerminal, base: str) -> dict[str, str]:
    """Return the pin names and units that a netlist comment about a port contains."""
    return {"pin": t.pins[0], "base": base, "across": t.port.across, "flow": t.port.flow}


def has_other_reference(domains: Iterable[Domain]) -> bool:
    """Return whether domains have reference pins, all of them other than ``base``.

    The result is false if no domain has a reference pin.
    """
    references = set(map(attrgetter("reference"), domains)) - {""}
    return bool(references) and BASE not in references
