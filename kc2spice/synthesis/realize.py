"""Linear models as subcircuits of decoupled resonators or of blocks of states."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, filterfalse
from operator import attrgetter
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from kc2spice.core.domains import (
    BASE,
    ELECTRICAL,
    HEAT,
    HEAT_PINS,
    ROTATION,
    TRANSLATION,
    Domain,
)
from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.naming import names_of
from kc2spice.core.prefix import PREFIXES, prefix_power
from kc2spice.netlist.circuit import Circuit, Element, Param, Pin
from kc2spice.netlist.elements import Line, attach_comments, pivot_cards
from kc2spice.netlist.library import Header, ReductionSummary, Subcircuit
from kc2spice.netlist.prefixes import abbreviate
from kc2spice.netlist.spelling import LEAK_RATE, format_comment, format_number, require_distinct
from kc2spice.netlist.spelling import require_name as checked_name
from kc2spice.rom.linear_model import Certificate, LinearModel, Port
from kc2spice.rom.modal import Resonators, resonators
from kc2spice.rom.network import ParallelBranches, parallel_branches
from kc2spice.synthesis.branches import NETWORK_COMMENT, branch_cards
from kc2spice.synthesis.emitted import (
    LOWEST_FREQUENCY_RATIO,
    MICRO,
    accelerates_frame,
    estimate_circuit_error,
)
from kc2spice.synthesis.header import (
    OUTWARDS_TEXT,
    mesh_comment,
    netlist_pins,
    parameter_defaults_of,
    part_header,
    rom_comments,
)
from kc2spice.synthesis.heat import estimate_leak_share, heat_cards, is_heat_model
from kc2spice.synthesis.heat_sources import (
    HEAT_PIN_ROWS,
    LOSS_NODE,
    meter_cards,
    moving_loss_card,
    relaxing_loss_card,
)

if TYPE_CHECKING:
    from kc2spice.rom.blocks import BlockModel

# F, of a state of a fast mode; one chgtol then corresponds to one tolerance of displacement
STATE_CAPACITANCE = 1e-6
STATE_CONDUCTANCE = 1.0  # S, of a massless mode; its capacitance is its relaxation time
EQUAL_GAIN = 1e-6  # relative difference of the gains of ports that count as equal
# Damping over frequency of a mode, 1 / Q, below which ngspice (pivrel 1e-3) does not choose
# diagonal pivots at an operating point in q and q'/w. It then has 80 times as many fill-ins for 178
# modes and is 100 times slower (tests/spice/test_realize.py counts them).
LIGHT_DAMPING = 1e-3
NEGLIGIBLE_GAIN = 1e-9  # share of a mode at every port, relative to the largest, that is negligible
INPUT_LEAK = 1e-18  # S, of a signal input, which is zero if nothing drives it
FREE_LEAK = 1e-12  # S, of a free integrator
LEAK_POINTS = 60  # frequencies at which the smallest charge of an electrode is searched
# Smallest singular value of a block, relative to the band, below which it integrates constant
# inputs.
INTEGRATOR_RATIO = 1e-11
# Cross terms of D below this share of the diagonal are rounding errors.
CROSS_ROUNDING = 1e-13
# smallest value of C B, relative to its terms, at which a rate jumps with an input
NEGLIGIBLE_JUMP = 1e-9
INNER_NODE_PATTERN = r"tick|(inner|current|charge)\w*|sum\d+|[qpz]\d+|noise\d+"
HEAT_NODE_PATTERN = r"h\d+"


@dataclass(frozen=True)
class StepWeights:
    """Weights of the modes of a body in time step control.

    Step control limits the error of charge, which represents an error of motion. A mode at
    ``full`` times the lowest frequency has a capacitor of 1 uF. The capacitors of slower modes are
    smaller by the ``power`` of their frequency. A ``share`` of the clamped capacitance is a
    capacitor, whose charge includes the charge of the modes.
    """

    full: float
    power: int
    share: float

    def capacitances(self, omega: np.ndarray, slowest: float) -> np.ndarray:
        """Return the capacitances [F] of modes at the frequencies ``omega`` [rad/s]."""
        return STATE_CAPACITANCE * np.minimum(1.0, (omega / (self.full * slowest)) ** self.power)


# for scenes in which the ringing of the body is a result
RINGING_WEIGHTS = StepWeights(3.0, 2, 0.01)
# for scenes with a throw: fewer time points with the same launch velocity
THROWING_WEIGHTS = StepWeights(3.0, 6, 0.01)
# for scenes in which only the motion of thrown parts matters: half the time points
COARSE_WEIGHTS = StepWeights(8.0, 6, 1e-6)
_OUTWARDS_COMMENT = (
    "* Positive um are along a port's outward direction. A current into its pin is a force on the",
    "* body along that direction (rotations: right-hand rule of the port's axis).",
)
_RESONATORS_COMMENT = """\
* Each mode of the reduced model has two integrators, q (displacement) and p (q'/omega). Both are
* scaled so that 1 V is the mode's largest {answer}:
*
*     q' = omega p                  p' = -omega q - damp p + drive (port forces and voltages)
*
* The comment of a mode states frequency, Q and equivalent branch at the port with the largest
* coupling, for damping=1: L, C and R in series across an electrical port, or the mass m [kg],
* damper c [N s/m] and spring k [N/m] at a pin.
* Modes whose coupling to every port is less than {silent:g} of the largest are left out.
* Modes above {full} times the lowest frequency have capacitors of 1 uF. The capacitors of slower
* modes decrease with the power {power} of the frequency: these modes limit the time steps less.
* {reference}: connect it to node 0. Electrical pins float."""
_LIGHT_DAMPING_COMMENT = """\
* Modes with a Q above {quality:g} have p = q + q'/omega, which gives pivots on the diagonal."""
_STATES_COMMENT = """\
* Linear state-space model: signal inputs draw no current, signal outputs are ideal sources, 1 V is
* one unit of the pin. Coupled states z are the voltages of capacitors of {farad} F:
*
*     z' = A z + B u                y = C z + D u
*
* The states are scaled to about 1 V for a constant input of 1 V. {base} is the reference of all
* pins that are not electrical: connect it to node 0."""
_LOOP_NOTE = "no states, but loops of signals: the sum of the currents into each node is zero"
_INTEGRATOR_COMMENT = "* The leak gives a free integrator an operating point."
_CLAMPED_COMMENT = """
* Electrical port{name}: the clamped capacitance of {farad:.6g} F in series with the voltage
* -charge/capacitance of the charge that the modes move (1 V on charge = 1 uC).
* Cclamped has {share} of the capacitance, and Gmore adds the other part of the current, so that the
* time steps follow the motion of the body and not the current. The voltage of node current is the
* total current. Gleak gives a floating electrode an operating point: its charge decays within
* {seconds:g} s."""
_FILLED_COMMENT = """
* Port {pin}: 1 V is 1 {across} over {base}, 1 A is 1 {flow} into the body. The capacitance of
* {farad:.6g} F stores the part that follows at once, in series with the voltage
* -charge/capacitance of the part that the modes store (1 V on charge = 1 uC, thus 1e-6 {flow} s).
* Cclamped has {share} of the capacitance, and Gmore adds the other part of the current. The voltage
* of node current is the total current. Gleak gives the pin an operating point: the charge decays
* within {seconds:g} s."""
_UNFILLED_COMMENT = """
* Port {pin}: 1 V is 1 {across} over {base}, 1 A is 1 {flow} into the body. Its current is the rate
* of the quantity that the states store. Gleak gives the pin an operating point."""
_UNCLAMPED_COMMENT = """
* Electrical port {name} has no clamped capacitance: its current is the rate of the charge
* that the states move.
* Gleak gives a floating electrode an operating point."""
_MOTION_COMMENT = """
* Port {pin}: its displacement u is the sum of the modes (1 V = 1 um). The voltage of node f is the
* force that keeps the pin at u (1 V = 1 N)."""
_ROTATION_COMMENT = """
* Rotation {pin}: like a displacement port, with 1 V = 1 rad and 1 A = 1 N m."""
_SHAKEN_COMMENT = """
* Acceleration {pin} of the frame to which the body is fixed (1 V = 1 m/s2). The current into the
* pin is the force that accelerates the body (1 A = 1 N)."""
_NOISE_COMMENT = """\
* Every loss has thermal force noise, 4 k T times its damping. A resistor of the same number of ohms
* provides this noise. No other resistor in this subcircuit has noise."""
DAMPING_PARAMETER = Param("damping", 1.0, "-", "scale of the damping of all modes")
_NOISE_INPUT_NAME = re.compile(r"noise\d+")
NEGLIGIBLE_ERROR = 1e-3  # negligible relative to an error estimate with three digits
NEGLIGIBLE_LOSS = 1e-14  # rounding error, relative to the largest loss of a model
RATED_BY_HEAT = "not known; keep temperatures within the limits of its materials"
UNRATED = "not known; keep field and stress within the limits of its materials"


Value: TypeAlias = float | str  # number, or expression of the subcircuit's parameters


def write_value(value: Value) -> str:
    """Return a value as a word of a card."""
    return f"{{{value}}}" if isinstance(value, str) else format_number(value)


def scale_value(factor: float, value: Value) -> Value:
    """Multiply a value by a number."""
    return f"{format_number(factor)}*{value}" if isinstance(value, str) else factor * value


@dataclass(frozen=True)
class Transconductance:
    """Controlled source of ``value`` amperes per volt of the voltage from ``plus`` to ``minus``."""

    label: str
    plus: str
    minus: str
    value: Value

    def between(self, a: str, b: str, prefix: str = "") -> Element:
        """Return the element with its current from ``a`` to ``b``."""
        value = write_value(self.value)
        return Element.of(f"{prefix}{self.label}", a, b, self.plus, self.minus, value)


def connect_sources(
    sources: Iterable[Transconductance], a: str, b: str, prefix: str = ""
) -> Iterator[Element]:
    """Yield the elements of controlled sources from ``a`` to ``b``."""
    for source in sources:
        yield source.between(a, b, prefix)


@dataclass(frozen=True)
class PortTerminal:
    """Port with its pins, its ``column`` of B and its ``row`` of C.

    ``clamped`` is its clamped capacitance [F], ``capacitance`` an expression that replaces it.
    The sources ``sums`` add the states to the output of the port, the sources ``through`` add
    inputs of ports. ``tag`` ends the names of its nodes. ``leak`` is a conductance [S].
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
        """Kind of the port."""
        return self.port.kind

    @property
    def label(self) -> str:
        """Name of the port."""
        return self.port.name

    @property
    def is_frame(self) -> bool:
        """Whether the port accelerates the frame of the body."""
        return accelerates_frame(self.port)

    @property
    def is_noise(self) -> bool:
        """Whether the input is the force of thermal noise."""
        return _NOISE_INPUT_NAME.fullmatch(self.label) is not None

    @property
    def source_letter(self) -> str:
        """SPICE letter (G or F) of the controlled sources that couple the port to the states."""
        if self.port.loaded:
            return "f"
        return "s" if self.is_frame else "v"

    @property
    def unit(self) -> float:
        """SI value of 1 V on the node that sums the output of the port."""
        domain = self.port.domain
        if domain is None:
            return 1.0
        if self.port.loaded:
            return domain.across.factor
        return MICRO * domain.through_variable.factor

    @property
    def input_unit(self) -> float:
        """SI value of 1 V between the nodes of the input."""
        domain = self.port.domain
        return 1.0 if domain is None else domain.quantity(domain.driven).factor

    def driven_pins(self, base: str) -> tuple[str, str]:
        """Return the pins between which an input drives the port."""
        return (self.pins[0], self.pins[1]) if self.port.paired else (self.pins[0], base)

    def input_nodes(self, base: str) -> tuple[str, str]:
        """Return the nodes between which the port's input is a voltage."""
        return (f"f{self.pins[0]}", base) if self.port.loaded else self.driven_pins(base)

    def weigh_input(
        self, label: str, row: np.ndarray | Sequence[Value], base: str
    ) -> Transconductance:
        """Return the source that adds the input of a port with its weight in ``row``."""
        value = row[self.column or 0]
        if self.input_unit != 1.0 and value:
            value = scale_value(self.input_unit, value)
        return Transconductance(label, *self.input_nodes(base), value)


@dataclass(frozen=True, eq=False)
class _States:
    """States ``z' = A z + B u`` with outputs ``y = C z + D u``, each the voltage of a node.

    y is in volts on the nodes that sum the outputs of the ports.
    """

    nodes: Sequence[str]
    labels: Sequence[str]
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray

    def sum_states(self, row: np.ndarray, base: str) -> tuple[Transconductance, ...]:
        """Return the sources that sum the states with the weights ``row``."""
        result = []
        for k in np.flatnonzero(row).tolist():
            value = float(row[k])
            result.append(Transconductance(self.labels[k], self.nodes[k], base, value))
        return tuple(result)


def _weigh_inputs(
    terminals: Iterable[PortTerminal], row: np.ndarray, base: str, *, mark: str = ""
) -> tuple[Transconductance, ...]:
    """Return the sources that sum the inputs of ports with the weights ``row``.

    The name of a source is the letter ``mark`` with the number of its input.
    """
    result = []
    for t in terminals:
        if t.column is not None and row[t.column]:
            result.append(t.weigh_input(f"{mark}{t.column + 1}", row, base))
    return tuple(result)


def subcircuit(
    rom: LinearModel,
    name: str,
    header: Header | None = None,
    *,
    title: str = "reduced linear model of the whole device",
    rating: str = UNRATED,
    ports: Sequence[str] | None = None,
    dense: bool = False,
    weights: StepWeights = RINGING_WEIGHTS,
    noise: bool = False,
    heat: bool = False,
) -> Subcircuit:
    """Write one ``.subckt`` with the pins of every port of a linear model.

    Electrical ports are pairs of floating terminals and come first, then the other conservative
    ports, ``base`` (their reference) and the signal pins; a model with only signals has ``ref``.
    A displacement or rotation pin is conservative: its value equals the sum over the states, and
    the force on that pin drives the states. An acceleration pin shakes the frame and draws the
    force that this takes. The subcircuit has the port laws and the passivity of the model.

    A measured one-port becomes its resistors, inductors and capacitors
    (:mod:`kc2spice.rom.network`). A symmetric definite model with modal damping becomes decoupled
    resonators. Any other model becomes blocks of coupled states, one block if ``dense``.

    Parameters
    ----------
    rom : LinearModel
        Linear model in SI units, such as :func:`kc2spice.reduce` returns.
    name : str
        Name of the subcircuit and of its library file.
    header : Header, optional
        Origin of the netlist. The default names the model and a hash of its matrices.
    title : str, optional
        Description of the device for the head of the library.
    rating : str, optional
        Largest permitted load of the device, for the head of the library.
    ports : sequence of str, optional
        Names of the ports to bring out. The default is all ports; the others have no load.
    dense : bool, default False
        Whether to write all states as one coupled block.
    weights : StepWeights, optional
        How closely the step control of the simulator follows the modes of the resonator form.
    noise : bool, default False
        Whether the losses have thermal noise.
    heat : bool, default False
        Whether the losses leave by a pin ``heat``, relative to a pin ``ambient``.

    Returns
    -------
    Subcircuit
        Pins, parameters and text of the library file.

    Raises
    ------
    UsageError : no linear model, an unknown port, a name that the subcircuit uses internally, a
        model without state-space form or, with ``noise``, without symmetric matrices, capacitances
        between electrodes that no passive network has, or, with ``heat``, coupled losses.

    Examples
    --------
    A mass of 10 g on a spring of 100 N/m and a damper of 0.1 N s/m has one mechanical pin.

    >>> import numpy as np
    >>> import kc2spice as kc
    >>> one, tip = np.ones((1, 1)), kc.Port("tip", "mechanical")
    >>> model = kc.LinearModel(M=0.01 * one, E=0.1 * one, K=100 * one, B=one, ports=(tip,))
    >>> part = kc.subcircuit(model, "oscillator")
    >>> part
    <Subcircuit oscillator: pins tip[um/N] base[um/N]; damping=1>
    >>> part.write("oscillator.lib").name
    'oscillator.lib'
    """
    if not isinstance(rom, LinearModel):
        raise UsageError(
            "this object is not a linear model",
            where=name,
            got=type(rom).__name__,
            expected="a kc.LinearModel, such as kc.reduce returns",
            hint="read a model from a file by kc.read_model(PATH)",
        )
    if header is None:
        digest = hashlib.sha256(rom.B.tobytes() + rom.C.tobytes() + rom.D.tobytes())
        header = Header(rom.name, digest.hexdigest()[:16])
    if ports is not None:
        rom = rom.select(list(ports))
    network = None if dense else parallel_branches(rom)
    if heat and (network is not None or is_heat_model(rom)):
        raise _unknown_losses(name, "a heat model, or the network of a measured response")
    if network is not None:
        return _network_subcircuit(network, rom, name, header, rating)
    if is_heat_model(rom):
        return _heat_subcircuit(rom, name, header, rating)
    form = _decouple_states(rom, dense)
    if noise and not isinstance(form, Resonators):
        rom = _add_noise_forces(rom)
        form = _decouple_states(rom, dense)
    terminals = model_terminals(rom, form.D, name)
    pins, base = subcircuit_pins([t for t in terminals if not t.is_noise], name)
    if heat:
        _require_distinct_pins((*pins, *HEAT_PIN_ROWS), (LOSS_NODE,), name)
    losses: list[Line] = []
    params: tuple[Param, ...] = ()
    if isinstance(form, Resonators):
        params = (DAMPING_PARAMETER,) if np.any(form.damp > 0) else ()
        about, body = _resonator_cards(form, rom, terminals, base, weights, noise)
        losses = list(_loss_cards(form, terminals, base)) if heat else []
    elif heat:
        raise _unknown_losses(name, "a model of coupled states, or ports that are signals")
    else:
        about, body = _block_cards(form, rom, terminals, base)
        if base == "ref":
            title = f"reduced linear model, {len(rom.inputs)} inputs, {len(rom.outputs)} outputs"
    if noise:
        about = [*about, *_NOISE_COMMENT.split("\n")]
    cards = about, body
    mesh = mesh_comment(rom.facts)
    return make_subcircuit(
        rom,
        name,
        pins,
        base,
        params,
        header,
        cards,
        losses=losses,
        mesh=mesh,
        title=title,
        rating=rating,
    )


def _unknown_losses(name: str, got: str) -> UsageError:
    """Return the error of a model whose netlist has no pin of heat."""
    return UsageError(
        "the losses of this model are not known, so that it has no pin of heat",
        where=name,
        got=got,
        expected="a body with electrodes or mechanical ports, whose damping does not couple modes",
        hint=f"leave the pin {HEAT} out",
    )


def _network_subcircuit(
    network: ParallelBranches, rom: LinearModel, name: str, header: Header, rating: str
) -> Subcircuit:
    """Return the subcircuit of a network, whose matrices are in ``rom``."""
    pins, cards = netlist_pins(rom.ports[0]), (NETWORK_COMMENT, branch_cards(network, rom))
    _require_distinct_pins(pins, (INNER_NODE_PATTERN,), name)
    title = "passive network of a measured one-port"
    return make_subcircuit(rom, name, pins, "", (), header, cards, title=title, rating=rating)


def _heat_subcircuit(rom: LinearModel, name: str, header: Header, rating: str) -> Subcircuit:
    """Return the subcircuit of a heat model."""
    pins, common = heat_pins(rom, name)
    cards = heat_cards(rom, common)
    base = common if len(pins) > 2 else ""  # resistors and capacitors need no pivots
    return make_subcircuit(rom, name, pins, base, (), header, cards, **heat_words(rating))


def heat_pins(rom: LinearModel, name: str) -> tuple[tuple[Pin, ...], str]:
    """Return the pins of a heat model, and the name of the last pin, which is the reference.

    Raises
    ------
    UsageError : a name that the subcircuit ``name`` uses internally.
    """
    common = reference_pin(rom.ports)
    ends = tuple(chain.from_iterable(map(netlist_pins, rom.ports)))
    pins = (*ends, common)
    _require_distinct_pins(
        pins, (INNER_NODE_PATTERN, HEAT_NODE_PATTERN, *map(_loaded_nodes, ends)), name
    )
    return pins, common.name


def heat_words(rating: str) -> dict[str, Any]:
    """Return title, rating and validity of a heat model, for the head of its library."""
    return {
        "title": "reduced heat model",
        "rating": RATED_BY_HEAT if rating == UNRATED else rating,
        "valid": "conductivities and heat capacities of its data, whatever the temperature",
    }


def make_subcircuit(
    rom: LinearModel,
    name: str,
    pins: tuple[Pin, ...],
    base: str,
    params: tuple[Param, ...],
    header: Header,
    cards: tuple[Iterable[str], Iterable[Line]],
    within: str = "",
    mesh: str = "",
    others: Sequence[tuple[LinearModel, Mapping[str, float]]] = (),
    losses: Sequence[Line] = (),
    **words: str,
) -> Subcircuit:
    """Return the subcircuit of a reduced model with its header.

    The cards ``losses`` follow the cards of the model. They add the pins of heat.

    ``cards`` are the comments about it and its elements. Passive elements have no ``base`` and no
    pivots. ``words`` are the title, the rating and the validity of the head.

    The error estimate is the sum of the errors of the elements and of the certificate. The
    elements are compared with ``rom`` at the defaults and with ``others`` at their parameters'
    values.
    """
    certificate, (about, body) = rom.certificate, cards
    band = f" up to {certificate.band_hz[1]:g} Hz" if certificate else ""
    first = ("", *pivot_cards(base)) if base else ()
    names, items = tuple(names_of(pins)), attach_comments([*first, *body])
    circuit = Circuit(name, names, parameter_defaults_of(params), items)
    reduction = None
    if certificate is not None:
        compared = ((rom, dict[str, float]()), *others)
        reduction = _summarise_reduction(circuit, pins, rom.order, certificate, compared)
    absent = "no hysteresis, depolarisation or heating"
    if losses:
        absent = "no hysteresis or depolarisation; nothing follows the temperature"
        pins = (*pins, *HEAT_PIN_ROWS)
        ends, items = (
            tuple(map(attrgetter("name"), pins)),
            attach_comments([*first, *body, *losses]),
        )
        circuit = replace(circuit, pins=ends, items=items)
    head = part_header(
        header,
        f"{name}: {words['title']}",
        pins,
        params,
        rom=rom_comments(reduction, certificate) if reduction and certificate else (),
        mesh=mesh,
        heat=HEAT_PINS if losses else "",
        sign=OUTWARDS_TEXT,
        rating=words["rating"],
        validity=words.get("valid")
        or f"small signals{band}{within} at the temperature of its "
        f"data (20 to 25 C, of built-in materials); {absent}",
    )
    circuit = replace(circuit, notes=(*head, "", *about))
    title = f"{name}: {words['title']}"
    facts: dict[str, Any] = {"reduction": reduction, "head_lines": len(head)}
    return Subcircuit(
        name, pins, params, Circuit(items=(circuit,)), title=format_comment(title), **facts
    )


def _summarise_reduction(
    circuit: Circuit,
    pins: Sequence[Pin],
    order: int,
    certificate: Certificate,
    compared: Iterable[tuple[LinearModel, Mapping[str, float]]],
) -> ReductionSummary:
    """Return order, band and error estimate of a reduced model with its emitted circuit.

    The circuit is compared with models at values of its parameters.
    """
    band = certificate.band_hz
    errors, leak = [], 0.0
    for model, at in compared:
        errors.append(estimate_circuit_error(circuit, pins, model, band, certificate.norm, at))
        if is_heat_model(model):
            leak = max(leak, estimate_leak_share(model))
    worst = max(errors, key=attrgetter("error"))
    total = certificate.error_estimate
    total += leak if leak > NEGLIGIBLE_ERROR * total else 0.0
    total += worst.error if worst.error > NEGLIGIBLE_ERROR * total else 0.0
    return ReductionSummary(order, band, certificate.norm, total, worst.error, worst.frequency)


def _decouple_states(rom: LinearModel, dense: bool) -> Resonators | BlockModel:
    """Return the model as resonators if possible, otherwise as blocks of states.

    D of the blocks contains the immediate response of undamped states without inertia.
    """
    modal = None if dense else _decouple_modes(rom)
    if modal is not None:
        return modal
    from kc2spice.rom.blocks import block_model  # imported here, because most models do not need it

    return block_model(rom, dense=dense)


def _decouple_modes(rom: LinearModel) -> Resonators | None:
    """Return the model as resonators, or None if it has no such form.

    The result is also None if a port needs the velocity of a state without inertia.
    """
    result = resonators(rom)
    if result is None or not _is_conservative(rom):
        return None
    frames = list(map(accelerates_frame, rom.ports))
    unclamped = np.logical_and(_charge_ports(rom), np.diag(rom.D) <= 0)
    relaxing = np.abs(result.gain[result.inertia == 0.0][:, np.logical_or(frames, unclamped)])
    return (
        None if (relaxing > CROSS_ROUNDING * np.abs(result.gain).max(initial=0.0)).any() else result
    )


def _is_conservative(rom: LinearModel) -> bool:
    """Whether every port of the model exchanges energy."""
    return all(map(attrgetter("conservative"), rom.ports))


def _charge_ports(rom: LinearModel) -> list[bool]:
    """Return for each port whether its output is a charge."""
    return list(map(attrgetter("charged"), rom.ports))


# ------------------------------------------------------------------------------- ports and pins


def model_terminals(rom: LinearModel, D: np.ndarray, where: str) -> list[PortTerminal]:
    """Return the ports of a model with pins, and with capacitances of the matrix D.

    Raises
    ------
    UsageError : a wrong number of pins, or a negative capacitance.
    """
    several = sum(_charge_ports(rom)) > 1
    result, column, row = [], 0, 0
    for port in rom.ports:
        pins = tuple(map(checked_name, port.terminals))
        if len(pins) != (2 if port.paired else 1):
            raise UsageError(
                "the port has a wrong number of pins",
                where=where,
                got=port.name,
                expected="two pins of an electrical port, otherwise one pin",
            )
        into = None if port.kind == "output" else column
        out = None if port.kind == "input" else row
        column += into is not None
        row += out is not None
        clamped = _pin_capacitance(port.domain, D[out, into]) if port.charged else 0.0
        if clamped < 0:
            raise UsageError(
                "the clamped capacitance of a port is negative",
                where=where,
                got=f"{clamped:.3g} F at port {port.name}",
                expected="a positive entry of D, the clamped capacitance",
            )
        tag = f"_{checked_name(port.name)}" if port.charged and several else ""
        leak = INPUT_LEAK if clamped or not port.charged else _leak_conductance(rom, port)
        result.append(PortTerminal(port, pins, tag, into, out, clamped, leak=leak))
    return result


def _pin_capacitance(domain: Domain | None, stored: Any) -> float:
    """Return the capacitance [F] of pins that store SI units per unit across them."""
    assert domain is not None
    return float(stored) * domain.admittance


def _leak_conductance(rom: LinearModel, port: Port) -> float:
    """Return the conductance [S] across an electrode without a clamped capacitance.

    The conductance is ``LEAK_RATE`` times the least charge per volt of the electrode in the band.
    """
    low, high = model_band(rom)
    frequency = np.geomspace(max(low, LOWEST_FREQUENCY_RATIO * high), high, LEAK_POINTS)
    try:
        charge = np.abs(rom.select([port.name]).transfer(frequency))
    except SimulationError:  # a frequency is a pole
        return INPUT_LEAK
    return LEAK_RATE * _pin_capacitance(port.domain, charge.min()) or INPUT_LEAK


def model_band(rom: LinearModel) -> tuple[float, float]:
    """Return the band [Hz] of a model, by default from 0 to 1 Hz."""
    return rom.certificate.band_hz if rom.certificate else rom.band or (0.0, 1.0)


def subcircuit_pins(terminals: Sequence[PortTerminal], name: str) -> tuple[tuple[Pin, ...], str]:
    """Return the pins in order: pairs, other conservative pins, signals, reference.

    Raises
    ------
    UsageError : a name that the subcircuit ``name`` uses internally.
    """
    paired, moving, signals = list[Pin](), list[Pin](), list[Pin]()
    inner = [INNER_NODE_PATTERN]
    for t in terminals:
        pins = netlist_pins(t.port)
        if t.port.loaded:
            inner.append(_loaded_nodes(pins[0]))
        if t.port.conservative:
            (paired if t.port.paired else moving).extend(pins)
        else:
            signals += pins
    common = reference_pin(list(map(attrgetter("port"), terminals)))
    # electrical ports against one cathode share its pin
    result = (*dict.fromkeys(paired), *moving, *signals, common)
    _require_distinct_pins(result, inner, name)
    return result, common.name


def _loaded_nodes(pin: Pin) -> str:
    """Return the pattern of the internal nodes of a port that a flow drives."""
    return f"[uf]{pin.name.lower()}"


def _require_distinct_pins(pins: Iterable[Pin], inner: Iterable[str], name: str) -> None:
    """Raise an error if pin names are equal or match an internal node."""
    require_distinct(list(map(attrgetter("name"), pins)), "|".join(inner), where=checked_name(name))


def reference_pin(ports: Sequence[Port]) -> Pin:
    """Return the last pin, which is the reference of all single pins.

    Displacements and all other quantities of a model with mechanical ports are relative to the
    base. The base is called ``ground`` if a port is called ``base``.
    """
    domains = _port_domains(ports)
    others = list(filter(attrgetter("reference"), domains))
    if len(others) == 1 and others[0].reference != BASE:
        return Pin(others[0].reference, *others[0].units)
    if domains:
        terminals = chain.from_iterable(map(attrgetter("terminals"), ports))
        return Pin("ground" if BASE in terminals else BASE, *TRANSLATION.units)
    return Pin("ref", *ELECTRICAL.units)


def _port_domains(ports: Iterable[Port]) -> list[Domain]:
    """Return the domains of ports, each once, in the order of the ports."""
    return list(filter(None, dict.fromkeys(map(attrgetter("domain"), ports))))


@dataclass(frozen=True, eq=False)
class _OutputLaws:
    """Sources by which states and inputs determine the outputs ``y = C z + D u``.

    An electrical port without a clamped capacitance needs the current ``y' = C A z + C B u``. An
    acceleration port needs the force ``m a - y''`` with ``y'' = C A^2 z + C A B u``. There C B is
    zero because everything that moves has inertia.
    """

    terminals: Sequence[PortTerminal]
    states: _States
    D: np.ndarray
    rom: LinearModel
    base: str

    def connect_output(self, t: PortTerminal) -> PortTerminal:
        """Return the terminal with the sources of its output.

        Raises
        ------
        UsageError : an acceleration port depends on the rate of an input, or an electrode without
        clamped capacitance shares charge.
        """
        if t.row is None:
            return t
        if t.is_frame:
            return self._connect_frame(t)
        row, direct = self.states.C[t.row], self.D[t.row] / t.unit
        if t.port.charged:  # the clamped capacitance is a capacitor
            direct = np.where(np.abs(direct) > CROSS_ROUNDING * np.abs(direct).max(), direct, 0.0)
            direct[t.column] = 0.0
            if not t.clamped:
                return self._connect_unclamped(t, direct)
        return replace(t, sums=self._weigh_states(row), through=self._weigh_inputs_only(direct))

    def _connect_frame(self, t: PortTerminal) -> PortTerminal:
        """Return an acceleration port with the sources of its force."""
        row, states = self.states.C[t.row], self.states
        jump = np.abs(row @ states.B) > NEGLIGIBLE_JUMP * (np.abs(row) @ np.abs(states.B))
        at_once = np.abs(self.D[t.row] - self.rom.D[t.row]) > CROSS_ROUNDING * np.abs(self.D).max()
        if jump.any() or at_once.any():
            raise UsageError(
                "an acceleration port acts on states without inertia, so its force depends on "
                "derivatives of inputs, which netlists do not support",
                where=t.label,
                got="C B not zero in the row of the port",
                expected="C B = 0 in the row of an acceleration port",
                hint="set the rows of B and C of the states without inertia to zero",
            )
        rate = MICRO * row @ states.A
        force = -(rate @ states.B)
        mass = self.rom.facts.get("mass_kg")
        force[t.column] = 0.0 if mass is None else mass + force[t.column]
        sums = self._weigh_states(-(rate @ states.A))
        return replace(t, sums=sums, through=self._weigh_inputs_only(force))

    def _connect_unclamped(self, t: PortTerminal, direct: np.ndarray) -> PortTerminal:
        """Return an unclamped electrode with the sources of its current."""
        if direct.any():
            raise UsageError(
                "an electrode without clamped capacitance is coupled to other ports through D",
                where=t.label,
                expected="a positive semi-definite D",
            )
        row = self.states.C[t.row]
        jumps = self._weigh_inputs_only(MICRO * row @ self.states.B, mark="tu")
        return replace(t, sums=self._weigh_states(MICRO * row @ self.states.A) + jumps)

    def _weigh_states(self, row: np.ndarray) -> tuple[Transconductance, ...]:
        return self.states.sum_states(row, self.base)

    def _weigh_inputs_only(self, row: np.ndarray, mark: str = "u") -> tuple[Transconductance, ...]:
        """Return the sources by inputs, without weights that are rounding errors."""
        size = np.abs(row).max(initial=0.0)
        row = np.where(np.abs(row) > CROSS_ROUNDING * size, row, 0.0)
        return _weigh_inputs(self.terminals, row, self.base, mark=mark)


def port_lines(terminals: Sequence[PortTerminal], base: str, share: float) -> Iterator[Line]:
    """Yield the cards of electrical ports, of moving ports, of accelerated frames."""
    for role in ("port.charged", "port.loaded", "is_frame"):
        for t in filter(attrgetter(role), terminals):
            yield from _lines_of_port(t, base, share)


def _lines_of_port(t: PortTerminal, base: str, share: float) -> Iterator[Line]:
    """Yield the cards of one port."""
    pin, tag = t.pins[0], t.tag
    if t.is_frame:
        yield _SHAKEN_COMMENT.format(pin=pin)
        yield from connect_sources(t.sums + t.through, pin, base, f"Ga{pin}_")
    elif t.port.loaded:
        yield (_MOTION_COMMENT if t.port.domain is TRANSLATION else _ROTATION_COMMENT).format(
            pin=pin
        )
        yield Element.of(f"Ru{pin}", f"u{pin}", base, "1")
        yield Element.of(f"Gf{pin}", base, f"f{pin}", pin, f"u{pin}", "1")
        yield Element.of(f"Gp{pin}", pin, base, f"f{pin}", base, "1")
        yield from connect_sources(t.sums, base, f"u{pin}", f"Gu{pin}_")
        yield from connect_sources(t.through, base, f"u{pin}", f"Gt{pin}_")
    elif t.clamped:
        yield from _clamped_lines(t, base, share)
    else:
        a, b = t.driven_pins(base)
        yield (_UNCLAMPED_COMMENT if t.port.paired else _UNFILLED_COMMENT).format(
            name=t.label, **_pin_comment(t, base)
        )
        yield Element.of(f"Gleak{tag}", a, b, a, b, t.leak)
        for source in t.sums:
            yield replace(source, label=f"{source.label}{tag}").between(a, b, "Gc")


def _clamped_lines(t: PortTerminal, base: str, share: float) -> Iterator[Line]:
    """Yield the cards of an electrical port with a clamped capacitance."""
    tag = t.tag
    words = {"name": f" {t.label}" if tag else "", "farad": t.clamped, "share": share}
    words["seconds"] = 1 / LEAK_RATE
    yield (_CLAMPED_COMMENT if t.port.paired else _FILLED_COMMENT).format(
        **words, **_pin_comment(t, base)
    )
    (a, b), c = t.driven_pins(base), t.capacitance or t.clamped
    inverse = f"{format_number(MICRO)}/{c}" if isinstance(c, str) else MICRO / c
    leak = write_value(scale_value(LEAK_RATE, c))
    yield Element.of(f"Cclamped{tag}", a, f"inner{tag}", write_value(scale_value(share, c)))
    yield Element.of(f"Gmore{tag}", a, b, f"current{tag}", base, 1 - share)
    yield Element.of(f"Gleak{tag}", a, b, a, f"inner{tag}", leak)
    yield Element.of(f"Ginner{tag}", base, f"current{tag}", f"inner{tag}", b, "1")
    ends = f"current{tag}", f"charge{tag}"
    yield Element.of(f"Gcharge{tag}", base, *ends, base, write_value(inverse))
    yield Element.of(f"Gcurrent{tag}", f"inner{tag}", b, f"current{tag}", base, share)
    yield Element.of(f"Rcharge{tag}", f"charge{tag}", base, "1")
    yield from connect_sources(t.sums + t.through, base, f"charge{tag}", f"Gc{tag}_")


def _pin_comment(t: PortTerminal, base: str) -> dict[str, str]:
    """Return the description of a port's pin for a comment."""
    return {"pin": t.pins[0], "base": base, "across": t.port.across, "flow": t.port.flow}


# -------------------------------------------------------------------------------- resonators


def _resonator_cards(
    model: Resonators,
    rom: LinearModel,
    terminals: list[PortTerminal],
    base: str,
    weights: StepWeights,
    noise: bool,
) -> tuple[list[str], list[Line]]:
    """Return comments and cards of the resonators in modal coordinates.

    With ``z_j'' + d_j z_j' + w_j^2 z_j = sum_k g_jk u_k`` and ``s_j = max_k |g_jk|`` over the
    mechanical ports, the states are ``q_j = s_j z_j`` and ``p_j = q_j' / w_j`` in um (or, of a
    model without mechanical ports, in uC)::

        C q' = C w p,    C p' = -C w q - C d p + (C s / w) sum_k g_k u_k

    with ``C = 1 uF min(1, (w / 3 w_1)^2)`` or by other ``weights``. Step control limits the error
    of charge, which is ``C`` times the error of displacement. Slow modes have little influence on
    a contact, but ring long after it.
    With a damping below :data:`LIGHT_DAMPING`, ``p_j = q_j + q_j' / w_j``, see :func:`_mode_cards`.
    A state without inertia is q alone, ``C q' = -G q + (G s / w^2) sum_k g_k u_k`` with
    ``C = G d / w^2``.
    """
    order = _order_observable_modes(model)
    omega, damp, gain = model.omega[order], model.damp[order], model.gain[order]
    heavy = model.inertia[order] > 0
    scale = scale_modes(gain, terminals)[:, None]
    numbers = range(1, len(order) + 1)
    turn = omega * heavy  # modes with inertia; the other states need no velocity node
    light, losses = (damp < LIGHT_DAMPING * omega) * heavy, damp * heavy
    rates = (-turn * light, turn, -turn - (turn - losses) * light, turn * light - losses)
    qq, qp, pq, pp = map(np.diag, rates)
    drive = heavy[:, None] * scale * gain / (omega[:, None] * MICRO)
    micro_per_unit = MICRO / np.array(list(map(attrgetter("unit"), terminals)))
    states = _States(
        [*map("q{}".format, numbers), *map("p{}".format, numbers)],
        [*map(str, numbers), *map("d{}".format, numbers)],
        np.block([[qq, qp], [pq, pp]]),
        np.vstack([np.zeros_like(drive), drive]),
        np.hstack([(gain / scale).T * micro_per_unit[:, None], np.zeros_like(gain.T)]),
    )
    farad = weights.capacitances(omega, omega[heavy].min(initial=np.inf))
    siemens = np.where(heavy, farad * omega, STATE_CONDUCTANCE)
    force = siemens * scale[:, 0] / (omega**2 * MICRO)
    drive = force[:, None] * gain
    about = _describe_resonators(terminals, base, weights)
    if light.any():
        about += _LIGHT_DAMPING_COMMENT.format(quality=1 / LIGHT_DAMPING).split("\n")
    laws = _OutputLaws(terminals, states, rom.D, rom, base)
    body: list[Line] = []
    stored = []
    for t in map(laws.connect_output, terminals):
        stored.append(replace(t, sums=()) if t.clamped else t)  # the modes add their charge below
    body += port_lines(stored, base, weights.share)
    for j in range(len(order)):
        node = f"p{j + 1}" if heavy[j] else f"q{j + 1}"
        if heavy[j]:
            branch = describe_branch(damp[j], omega[j], gain[j], gain, terminals)
            body.append(f"\n* Mode {j + 1}: {describe_mode(omega[j], damp[j])}{branch}")
            body += _mode_cards(j + 1, omega[j], damp[j], farad[j], base)
        else:
            body += _massless_mode_lines(j + 1, omega[j], damp[j], base)
        body += connect_sources(drive_mode(j + 1, drive[j], terminals, base), base, node)
        if noise and damp[j] > 0:
            loss = f"{{damping*{format_number(damp[j])}}}"
            body.append(Element.of(f"Rnoise{j + 1}", f"noise{j + 1}", base, loss))
            body.append(Element.of(f"Gn{j + 1}", base, node, f"noise{j + 1}", base, force[j]))
        for k, t in enumerate(terminals):
            if t.clamped:
                charge = gain[j, k] / scale[j, 0] * MICRO / t.unit  # uC per um
                source = Transconductance(f"Gc{j + 1}{t.tag}", f"q{j + 1}", base, charge)
                body.append(source.between(base, f"charge{t.tag}"))
    return about, body


def _loss_cards(model: Resonators, terminals: Sequence[PortTerminal], base: str) -> Iterator[Line]:
    """Yield the meter and the heat flows of all modes with losses.

    In the symbols of :func:`_resonator_cards` a mode with inertia has the velocity ``z' = w p / s``
    and loses ``d z'^2``. A state without inertia loses ``(w^2 / s)^2 (f - q)^2 / d`` with the drive
    ``f = (s / w^2) sum_k g_k u_k``.
    """
    order = _order_observable_modes(model)
    omega, damp, gain = model.omega[order], model.damp[order], model.gain[order]
    size = MICRO / scale_modes(gain, terminals)
    yield from meter_cards()
    for j in np.flatnonzero(damp > 0).tolist():
        index, q, p = j + 1, f"q{j + 1}", f"p{j + 1}"
        w, d, unit = map(float, (omega[j], damp[j], size[j]))
        if model.inertia[order[j]] > 0:
            velocity = (p, q) if d < LIGHT_DAMPING * w else (p, base)
            yield moving_loss_card(index, velocity, d * (w * unit) ** 2)
            continue
        row = STATE_CONDUCTANCE * gain[j] / (unit * w**2)
        sources = drive_mode(index, row, terminals, base)
        drives = [(float(g.value), g.plus, g.minus) for g in sources if g.value]
        yield relaxing_loss_card(index, drives, (q, base), (w**2 * unit) ** 2 / d)


def _describe_resonators(
    terminals: Sequence[PortTerminal], base: str, weights: StepWeights
) -> list[str]:
    """Return comments about the circuit equations and the reference pin."""
    words: dict[str, Any] = {
        "full": weights.full,
        "power": weights.power,
        "silent": NEGLIGIBLE_GAIN,
    }
    words["answer"] = "displacement of a port in um"
    words["reference"] = "The base is the mechanical and signal reference"
    lines = list(_OUTWARDS_COMMENT)
    domains = _port_domains(map(attrgetter("port"), terminals))
    if _has_other_reference(domains):
        units = dict.fromkeys(map(attrgetter("answer_unit"), domains))
        words["answer"] = f"answer of a port in 1e-6 {' or '.join(units)}"
        words["reference"], lines = f"Values of pins count from {base}", []
    return [*lines, *_RESONATORS_COMMENT.format(**words).split("\n")]


def _has_other_reference(domains: Iterable[Domain]) -> bool:
    """Return whether values at pins have another reference than displacements."""
    references = set(map(attrgetter("reference"), domains)) - {""}
    return bool(references) and BASE not in references


def _mode_cards(j: int, omega: float, damp: float, farad: float, base: str) -> Iterator[Line]:
    """Yield the two integrators of one mode.

    With a damping below :data:`LIGHT_DAMPING` the second state is ``p = q + q' / w``. The voltage
    from p to q is then the velocity.
    """
    q, p, turn, loss = f"q{j}", f"p{j}", farad * omega, farad * damp
    light = damp < LIGHT_DAMPING * omega
    velocity = (p, q) if light else (p, base)
    yield Element.of(f"Cq{j}", q, base, farad)
    yield Element.of(f"Cp{j}", p, base, farad)
    yield Element.of(f"Gq{j}", base, q, *velocity, turn)
    yield Element.of(f"Gp{j}", p, base, q, base, turn)
    if light:
        yield Element.of(f"Gs{j}", base, p, *velocity, turn)
    if loss > 0:
        yield Element.of(f"Gd{j}", p, base, *velocity, f"{{damping*{format_number(loss)}}}")


def describe_mode(omega: float, damp: float) -> str:
    """Describe the frequency and the Q factor of a mode for a comment.

    ``omega`` is its angular frequency [rad/s], ``damp`` its damping [1/s].

    Examples
    --------
    >>> describe_mode(2 * np.pi * 41.2e3, 2 * np.pi * 824.0)
    '41.2 kHz, Q 50'
    """
    hertz = omega / (2 * np.pi)
    power = prefix_power(hertz)
    quality = f"Q {omega / damp:.4g}" if damp > 0 else "undamped"
    return f"{hertz / 10.0**power:.6g} {PREFIXES[power]}Hz, {quality}"


def describe_branch(
    damp: float,
    omega: float,
    gain: np.ndarray,
    gains: np.ndarray,
    terminals: Sequence[PortTerminal],
) -> str:
    """Describe the circuit elements equal to a mode at a port; empty if there are none.

    The mode is ``z'' + damp z' + omega^2 z = g v`` with the charge ``g z``. At an electrical port
    it is L = 1/g^2, R = damp/g^2 and C = g^2/omega^2 in series. At a mechanical port it is the mass
    m = 1/g^2, the damper c = damp/g^2 and the spring k = omega^2/g^2. ``gains`` are the gains of
    all modes: a gain far below the largest is a rounding error.
    """
    size = np.abs(gain)
    size = np.where(size > NEGLIGIBLE_GAIN * np.abs(gains).max(axis=0), size, 0.0)
    for domains in ((ELECTRICAL,), (TRANSLATION, ROTATION)):
        shares = size * [t.port.domain in domains for t in terminals]
        if not shares.any():
            continue
        port = int(np.argmax(shares >= shares.max() * (1 - EQUAL_GAIN)))
        m, c, k = map(float, np.array([1.0, damp, omega**2]) / shares[port] ** 2)
        if ELECTRICAL in domains:
            elements = f"L={abbreviate(m)} C={abbreviate(1 / k)} R={abbreviate(c)}"
        else:
            elements = f"m={abbreviate(m)} c={abbreviate(c)} k={abbreviate(k)}"
        return f", {elements} at {terminals[port].pins[0]}"
    return ""


def _massless_mode_lines(j: int, omega: float, damp: float, base: str) -> Iterator[Line]:
    """Yield the cards of a massless mode."""
    hertz, time = omega / (2 * np.pi), damp / omega**2
    yield f"\n* Without inertia, from {hertz:.6g} Hz on: relaxes within {time:.6g} s"
    if time > 0:
        yield Element.of(
            f"Cq{j}", f"q{j}", base, f"{{damping*{format_number(STATE_CONDUCTANCE * time)}}}"
        )
    yield Element.of(f"Gq{j}", f"q{j}", base, f"q{j}", base, STATE_CONDUCTANCE)


def scale_modes(gain: np.ndarray, terminals: Sequence[PortTerminal]) -> np.ndarray:
    """Return the largest share (q,) of each mode in a displacement, or in any port."""
    mechanical = [t.port.domain is TRANSLATION for t in terminals]
    scale = np.abs(gain[:, mechanical]).max(axis=1, initial=0.0)
    scale = np.where(scale > 0, scale, np.abs(gain).max(axis=1))
    return np.where(scale > 0, scale, 1.0)


def drive_mode(
    index: int,
    row: np.ndarray | Sequence[Value],
    terminals: Sequence[PortTerminal],
    base: str,
) -> list[Transconductance]:
    """Return the sources by which ports drive a mode: forces, voltages, accelerations."""
    result = []
    for t in sorted(terminals, key=lambda t: "fvs".index(t.source_letter)):
        suffix = f"{index}{t.tag}" if t.port.paired else f"{t.pins[0]}_{index}"
        result.append(t.weigh_input(f"G{t.source_letter}{suffix}", row, base))
    return result


def _order_observable_modes(model: Resonators) -> np.ndarray:
    """Return the indices of observable modes by frequency, without inertia last.

    A mode that no port moves or observes is a rounding error.
    """
    share = np.abs(model.gain) / model.omega[:, None]
    share /= share.max(axis=0, initial=0.0, keepdims=True) + np.finfo(float).tiny
    observable = share.max(axis=1, initial=0.0) > NEGLIGIBLE_GAIN
    order = np.lexsort((model.omega, model.inertia == 0.0))
    return order[observable[order]] if observable.any() else order


# ------------------------------------------------------------------------------------- blocks


def _block_cards(
    model: BlockModel, rom: LinearModel, terminals: list[PortTerminal], base: str
) -> tuple[list[str], list[Line]]:
    """Return comments and cards of blocks of states.

    The states of the blocks of :func:`kc2spice.rom.blocks.block_model` are voltages on capacitors
    ``C = 1 / (2 pi f1)``. With the end f1 of the band, conductances are about 1 S. A block is
    scaled to about 1 V for a constant input of 1 V.
    """
    from scipy.linalg import block_diag  # imported here, because most models do not need it

    farad = 1 / (2 * np.pi * model_band(rom)[1])
    B, C = model.B.copy(), model.C.copy()
    none = np.zeros((len(B), 0)), np.zeros((0, len(B))), B[:0], C[:, :0], B[:0, :0]
    F, P, Q, R, S = map(np.ndarray.copy, model.loops or none)
    scaled_blocks, integrating, start = [], [], 0
    for block in model.blocks:
        rows = slice(start, start + len(block))
        start += len(block)
        block, free, scale = _balance_block(block, np.hstack([B[rows], F[rows]]), 1 / farad)
        B[rows] /= scale[:, None]
        F[rows] /= scale[:, None]
        C[:, rows] *= scale
        P[:, rows] *= scale
        scaled_blocks.append(block)
        integrating.append(free)
    numbers = list(map(str, range(1, start + len(S) + 1)))
    units = [t.unit for t in terminals if t.row is not None]
    states = _States(
        list(map("z{}".format, numbers)),
        numbers,
        np.block([[block_diag(*scaled_blocks), F], [P / farad, S / farad]]),
        np.vstack([B, Q / farad]),
        np.hstack([C, R]) / np.array(units)[:, None],
    )
    laws = _OutputLaws(terminals, states, model.D, rom, base)
    wired = list(map(laws.connect_output, terminals))
    body = list(_input_lines(terminals, base))
    body += port_lines(wired, base, RINGING_WEIGHTS.share)
    outputs = (t for t in wired if t.kind == "output")
    for index, t in enumerate(outputs, 1):
        body += _output_lines(t, index, base)
    at = 0
    signals: list[tuple[np.ndarray, bool | None]] = [(S, None)] if len(S) else []
    for block, drifts in [*zip(scaled_blocks, integrating, strict=True), *signals]:
        first, at = at, at + len(block)
        accuracy = _LOOP_NOTE if drifts is None else format_comment(_describe_poles(block))
        body.append(f"\n* States {first + 1} to {at}: {accuracy}")
        for k in range(first, at):
            index, node = k + 1, f"z{k + 1}"
            if drifts is not None:
                body.append(Element.of(f"C{node}", node, base, farad))
            if drifts:
                body += [
                    _INTEGRATOR_COMMENT,
                    Element.of(f"G{node}", node, base, node, base, FREE_LEAK),
                ]
            sums = states.sum_states(farad * states.A[k], base)
            inputs = _weigh_inputs(terminals, farad * states.B[k], base)
            body += connect_sources(sums, base, node, f"Ga{index}_")
            body += connect_sources(inputs, base, node, f"Gb{index}_")
    about = _STATES_COMMENT.format(farad=format_number(farad), base=base).split("\n")
    domains = _port_domains(rom.ports)
    placed = domains and not _has_other_reference(domains)
    return [*_OUTWARDS_COMMENT, *about] if placed else about, body


def _input_lines(terminals: Iterable[PortTerminal], base: str) -> Iterator[Line]:
    """Yield the resistors of noise inputs, then the leaks of signal inputs."""
    inputs = [t for t in terminals if t.kind == "input"]
    for t in filter(attrgetter("is_noise"), inputs):
        yield Element.of(f"R{t.pins[0]}", t.pins[0], base, "1")
    signals = filterfalse(attrgetter("is_noise"), inputs)
    for index, t in enumerate(signals, 1):
        if index == 1:
            yield "* An input that is left open is zero."
        yield Element.of(f"Gleak{index}", t.pins[0], base, t.pins[0], base, INPUT_LEAK)


def _output_lines(t: PortTerminal, index: int, base: str) -> Iterator[Line]:
    """Yield the cards of a signal output."""
    node = f"sum{index}"
    yield f"\n* Output {t.pins[0]}"
    yield Element.of(f"E{index}", t.pins[0], base, node, base, "1")
    yield Element.of(f"Rsum{index}", node, base, "1")
    yield from connect_sources(t.sums, base, node, f"Gc{index}_")
    yield from connect_sources(t.through, base, node, f"Gt{index}_")


def _add_noise_forces(rom: LinearModel) -> LinearModel:
    """Return ``rom`` with an input for the force of every loss.

    ``E`` is the sum of squares of the columns of B of these forces. Each force therefore has the
    noise of a loss of one.

    Raises
    ------
    UsageError : losses outside the matrix ``E``.
    """
    if rom.first_order or not rom.symmetric or not _is_conservative(rom):
        raise UsageError(
            "the noise of this model is not known",
            where=rom.name,
            got="a first-order model, one that is not symmetric, or ports that are signals",
            expected="symmetric M, E, K and conservative ports",
            hint="use a transient or ac analysis, which needs no noise",
        )
    K, E, M = rom.pencil.dense().coefficients
    losses, shapes = np.linalg.eigh(E)
    lossy = losses > NEGLIGIBLE_LOSS * losses.max(initial=0.0)
    forces = shapes[:, lossy] * np.sqrt(losses[lossy])
    ports = tuple(Port(f"noise{k}", "input") for k in range(1, forces.shape[1] + 1))
    D = np.hstack([rom.D, np.zeros((len(rom.D), len(ports)))])
    B, every = np.hstack([rom.B, forces]), (*rom.ports, *ports)
    return replace(rom, M=M, E=E, K=K, rayleigh=None, B=B, C=rom.C, D=D, ports=every)


def _balance_block(
    block: np.ndarray, drive: np.ndarray, omega: float
) -> tuple[np.ndarray, bool, np.ndarray]:
    """Return a block, whether it integrates, and the scale of its states.

    A complex pair becomes ``[[a, w], [-w, a]]``. States are about 1 for a constant input of 1.
    """
    scale = np.ones(len(block))
    if len(block) == 2 and block[0, 1] * block[1, 0] < 0:
        scale[1] = np.sqrt(-block[1, 0] / block[0, 1])
    block, drive = block * scale / scale[:, None], drive / scale[:, None]
    free = bool(np.linalg.svd(block, compute_uv=False)[-1] < INTEGRATOR_RATIO * omega)
    answer = drive / omega if free else np.linalg.solve(block, drive)
    return block, free, scale * (np.abs(answer).max(initial=0.0) or 1.0)


def _describe_poles(block: np.ndarray) -> str:
    """Describe the first poles of a block for a comment."""
    poles = np.linalg.eigvals(block)
    texts = list(map(_describe_pole, poles[poles.imag >= 0]))
    more = f"; and {len(texts) - 3} more" if len(texts) > 3 else ""
    return "; ".join(texts[:3]) + more


def _describe_pole(pole: complex) -> str:
    if pole.imag > 0:
        size = abs(pole)
        return f"{size / (2 * np.pi):.6g} Hz, damping ratio {0.0 - pole.real / size:.6g}"
    return f"pole {pole.real:.6g} 1/s"


def apply_unit_load(
    model: LinearModel, library: Subcircuit, load: Port, tag: str = ""
) -> tuple[list[Element], dict[str, tuple[str, float]]]:
    """Return a copy of a subcircuit under a unit load, and its responses.

    A response maps a port to its vector and the factor of the vector to SI. As in
    :meth:`LinearModel.transfer`, the other electrodes are shorted, mechanical ports are free,
    frames are at rest and other inputs are zero. The response of an electrode is its current, of
    another driven pin its flow, and of a frame its force. ``tag`` ends all names of the copy.
    """
    ends = {port.terminals[0].lower() for port in model.ports}
    nodes = {}
    for pin in library.pins:
        key = pin.name.lower()
        nodes[key] = f"{pin.name}{tag}" if key in ends else "0"
    cards, result = [Element.of(f"X{library.name}{tag}", *nodes.values(), library.name)], {}
    one = 1.0 if load.domain is None else load.domain.quantity(load.domain.driven).factor
    for port in model.ports:
        node, size = nodes[port.terminals[0].lower()], ("AC", "1") if port == load else ()
        if port.domain is not None and port.loaded:
            drive = Element.of(f"I{node}", "0", node, "DC", "0", *size)
            cards += [drive.with_unit(port.domain.value_unit("I"))] if size else []
            result[port.name] = (f"v({node})", port.domain.across.factor / one)
        elif port.kind == "output":
            result[port.name] = (f"v({node})", 1.0 / one)
        else:
            drive = Element.of(f"V{node}", node, "0", "DC", "0", *size)
            cards.append(drive.with_unit(port.domain.value_unit("V") if port.domain else ""))
            if port.domain is not None:
                flow = port.domain.through_variable.factor
                result[port.name] = (f"i(v{node.lower()})", -flow / one)
    return cards, result
