"""Linear models to subcircuits: decoupled resonators where there are, else state blocks."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from kc2spice.core.domains import (
    ACCELERATION,
    BASE,
    ELECTRICAL,
    PORTS,
    ROTATION,
    TRANSLATION,
    Domain,
)
from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.prefix import PREFIXES, prefix_power
from kc2spice.netlist.circuit import Circuit, Element, Param, Pin
from kc2spice.netlist.elements import Line, noted, pivots
from kc2spice.netlist.library import Header, ReductionFacts, Subcircuit
from kc2spice.netlist.prefixes import rounded
from kc2spice.netlist.spelling import LEAK_RATE, comment, distinct, number
from kc2spice.netlist.spelling import name as checked_name
from kc2spice.rom.linear_model import Certificate, LinearModel, Port
from kc2spice.rom.modal import Resonators, resonators
from kc2spice.rom.network import ParallelBranches, parallel_branches
from kc2spice.synthesis.branches import ABOUT, branch_cards, branch_pins
from kc2spice.synthesis.emitted import LOWEST, MICRO, circuit_error
from kc2spice.synthesis.header import (
    OUTWARDS,
    defaults,
    mesh_entry,
    part_header,
    rom_lines,
)
from kc2spice.synthesis.heat import heat_cards, heat_modes, is_heat

if TYPE_CHECKING:
    from kc2spice.rom.blocks import BlockModel

STATE = 1e-6  # farad of a fast state: one chgtol is then one tolerance of displacement
SIEMENS = 1.0  # conductance of a massless state; its capacitance is its relaxation time
ALIKE = 1e-6  # relative difference of the gains of ports that count as equal
# Damping over frequency of a mode, 1 / Q, below which ngspice (pivrel 1e-3) takes no pivot from the
# diagonal of an operating point in q and q'/w. It then keeps 80 times as many fill-ins for 178
# modes and is 100 times slower (tests/spice/test_realize.py counts them).
LIGHT = 1e-3
SILENT = 1e-9  # zero share of a mode in every port, relative to the largest
OPEN_INPUT = 1e-18  # S, of a signal input, so that it is zero where nothing drives it
FREE_LEAK = 1e-12  # S, of a free integrator: of the conductance of its capacitor at the band's end
LEAK_POINTS = 60  # frequencies at which the least charge of a bare electrode is looked for
# A block whose smallest singular value is this far below the band integrates constant inputs.
FREE = 1e-11
# Cross terms of D this far below the diagonal are rounding.
CROSS = 1e-13
JUMP = 1e-9  # least C B, over its summands, of a rate that jumps with an input
INNER = r"tick|(inner|current|charge)\w*|sum\d+|[qpz]\d+|noise\d+"  # nodes of our own
HEAT_NODES = r"h\d+"
LOADED = tuple(kind for kind, domain in PORTS.items() if domain.driven == "through")
FRAMES = tuple(kind for kind, domain in PORTS.items() if domain is ACCELERATION)
PAIRS = tuple(kind for kind, domain in PORTS.items() if not domain.reference)
CHARGED = tuple(kind for kind, domain in PORTS.items() if domain.charged)
# Letter of the cards by which a port drives states: forces, voltages, accelerations.
_DRIVES = {kind: "f" if kind in LOADED else "s" if kind in FRAMES else "v" for kind in PORTS}


@dataclass(frozen=True)
class StepWeights:
    """Weights of the modes of a body in time step control.

    An error of charge represents an error of motion (:func:`_resonators`).

    Modes below ``full`` times the lowest frequency sit on less than a microfarad by the ``power``
    of their frequency; a ``share`` of the clamped capacitance is one, whose charge is the modes'.
    """

    full: float
    power: int
    share: float

    def farad(self, omega: np.ndarray, slowest: float) -> np.ndarray:
        """On which modes of the frequencies ``omega`` sit."""
        return STATE * np.minimum(1.0, (omega / (self.full * slowest)) ** self.power)


RINGING = StepWeights(3.0, 2, 0.01)  # the body's own ringing is a result
THROWING = StepWeights(3.0, 6, 0.01)  # until it has struck: fewer points, an equal launch
COARSE = StepWeights(8.0, 6, 1e-6)  # only what a contact throws is: half the time points
_OUTWARDS = (
    "* Positive um are along a port's outward direction. A current into its pin is a force on the",
    "* body along that direction (rotations: right-hand rule of the port's axis).",
)
_RESONATORS = """\
* Each mode of the reduced model is two integrators, q (displacement) and p (q'/omega). Both are
* scaled so that 1 V is the mode's largest {answer}:
*
*     q' = omega p                  p' = -omega q - damp p + drive (port forces and voltages)
*
* The comment of a mode states its frequency, its Q and the branch that it is, with damping=1, at
* the port that it moves most: L, C and R in series across an electrical port, or the mass m [kg],
* damper c [N s/m] and spring k [N/m] at a pin.
* Modes are left out whose share in every port is less than {silent:g} of the largest.
* Modes above {full} times the lowest frequency have capacitors of 1 uF. Slower modes have smaller
* ones, by the power {power} of their frequency: the simulator's time steps follow them less.
* {reference}: connect it to node 0. Electrical pins float."""
_LIGHT = """\
* Modes with a Q above {quality:g} have p = q + q'/omega, which gives pivots on the diagonal."""
_STATES = """\
* Linear state-space model: signal inputs draw no current, signal outputs are ideal sources, 1 V is
* one unit of the pin. Coupled states z are the voltages of capacitors of {farad} F:
*
*     z' = A z + B u                y = C z + D u
*
* They are scaled so that a constant input of 1 V sets states of about 1 V. {base} is the reference
* of all pins that are not electrical: connect it to node 0."""
_LOOPED = "no states, but signals that close loops: the currents into each node are zero"
_FREE_STATE = "* The leak gives a free integrator an operating point."
_CLAMPED = """
* Electrical port{name}: the clamped capacitance of {farad:.6g} F in series with the voltage
* -charge/capacitance of the charge that the modes move (1 V on charge = 1 uC).
* Cclamped has {share} of the capacitance, Gmore adds the rest of its current: time steps then
* follow the motion of the body, not its current. The voltage of node current is that current.
* Gleak gives a floating electrode an operating point: its charge decays within {seconds:g} s."""
_FILLED = """
* Port {pin}: 1 V is 1 {across} over {base}, 1 A is 1 {flow} into the body. What it takes up at once
* is the charge of {farad:.6g} F, in series with the voltage -charge/capacitance of the charge that
* the modes take up (1 V on charge = 1 uC, thus 1e-6 {flow} s).
* Cclamped has {share} of the capacitance, Gmore adds the rest of its current, which is the
* voltage of node current. Gleak gives the pin an operating point: the charge decays
* within {seconds:g} s."""
_UNFILLED = """
* Port {pin}: 1 V is 1 {across} over {base}, 1 A is 1 {flow} into the body. Its current is the rate
* of what the states take up. Gleak gives the pin an operating point."""
_UNCLAMPED = """
* Electrical port {name} has no capacitance of its own: its current is the rate of the charge
* that the states move.
* Gleak gives a floating electrode an operating point."""
_MOTION = """
* Port {pin}: its displacement u is the sum of the modes (1 V = 1 um). The voltage of node f is the
* force that holds the pin at u (1 V = 1 N)."""
_ROTATION = """
* Rotation {pin}: as a displacement port, 1 V = 1 rad and 1 A = 1 N m."""
_SHAKEN = """
* Acceleration {pin} of the frame that the body is fixed to (1 V = 1 m/s2); the force that it
* takes to move the body flows into the pin (1 A = 1 N)."""
_NOISE = """\
* Every loss has the force noise of its temperature, 4 k T times the damping: the voltage noise of a
* resistor of as many ohms. No other resistor here has noise."""
DAMPING = Param("damping", 1.0, "-", "scale of the damping of all modes")
_INNER_FORCE = re.compile(r"noise\d+")
UNSEEN = 1e-3  # relative to an error estimate: below its three digits
LOST = 1e-14  # rounding error, relative to the largest loss of a model
RATED_BY_HEAT = "not known; keep temperatures within the limits of its materials"
UNRATED = "not known; keep field and stress within the limits of its materials"


Value: TypeAlias = float | str  # a number, or an expression of the subcircuit's parameters


def written(value: Value) -> str:
    """A value as a word of a card."""
    return f"{{{value}}}" if isinstance(value, str) else number(value)


def scale_value(factor: float, value: Value) -> Value:
    return f"{number(factor)}*{value}" if isinstance(value, str) else factor * value


@dataclass(frozen=True)
class Transconductance:
    """One controlled source: ``value`` amperes per volt between ``plus`` and ``minus``."""

    label: str
    plus: str
    minus: str
    value: Value

    def onto(self, a: str, b: str, prefix: str = "") -> Element:
        """The element with its current from ``a`` to ``b``."""
        value = written(self.value)
        return Element.of(f"{prefix}{self.label}", a, b, self.plus, self.minus, value)


@dataclass(frozen=True)
class PortTerminal:
    """A port as its cards need it: ``column`` of B and ``row`` of C, ``clamped`` farad, or the
    expression ``capacitance``.

    ``sums`` are its output by states, ``through`` by the inputs of ports.
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
    leak: float = OPEN_INPUT

    @property
    def kind(self) -> str:
        """Kind of its port."""
        return self.port.kind

    @property
    def label(self) -> str:
        """The name of its port."""
        return self.port.name

    @property
    def unit(self) -> float:
        """SI value of 1 V on the node that sums its output."""
        domain = self.port.domain
        if domain is None:
            return 1.0
        if self.kind in LOADED:
            return domain.across.factor
        return MICRO * domain.quantity("through").factor

    @property
    def input_unit(self) -> float:
        """SI value of 1 V between the nodes of its input."""
        domain = self.port.domain
        return 1.0 if domain is None else domain.quantity(domain.driven).factor

    def ends(self, base: str) -> tuple[str, str]:
        """The pins between which it is driven."""
        return (self.pins[0], self.pins[1]) if self.port.paired else (self.pins[0], base)

    def control(self, base: str) -> tuple[str, str]:
        """The nodes between which the port's input is a voltage."""
        return (f"f{self.pins[0]}", base) if self.kind in LOADED else self.ends(base)

    def driven(self, label: str, row: np.ndarray | Sequence[Value], base: str) -> Transconductance:
        """The card of its input, whose weight stands in a ``row`` of inputs."""
        value = row[self.column or 0]
        if self.input_unit != 1.0 and value:
            value = scale_value(self.input_unit, value)
        return Transconductance(label, *self.control(base), value)


@dataclass(frozen=True, eq=False)
class _States:
    """``z' = A z + B u``, ``y = C z + D u``: each state a voltage on its node; y in volts of the
    ports' sum nodes."""

    nodes: Sequence[str]
    labels: Sequence[str]
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray

    def cards(self, row: np.ndarray, base: str) -> tuple[Transconductance, ...]:
        """The sum of states with the weights ``row``."""
        return tuple(
            Transconductance(label, node, base, float(value))
            for label, node, value in zip(self.labels, self.nodes, row, strict=True)
            if value
        )


def subcircuit(
    rom: LinearModel,
    name: str,
    header: Header | None = None,
    *,
    title: str = "reduced linear model of the whole device",
    rating: str = UNRATED,
    ports: Sequence[str] | None = None,
    dense: bool = False,
    weights: StepWeights = RINGING,
    noise: bool = False,
) -> Subcircuit:
    """Write one ``.subckt`` with the pins of every port of a linear model.

    Electrical ports are pairs of floating terminals and come first, then the other conservative
    ports, ``base`` (their reference) and the signal pins; a model of signals alone has ``ref``.
    A displacement or rotation pin is conservative: its value equals the sum over the states, and
    the force on that pin drives the states. An acceleration pin shakes the frame and draws the
    force that this takes. Port laws and passivity are those of the model.

    A measured one-port becomes its resistors, inductors and capacitors
    (:mod:`kc2spice.rom.network`), a symmetric definite model with modal damping decoupled
    resonators, anything else blocks of coupled states (one block of all states if ``dense``).

    Parameters
    ----------
    rom : LinearModel
        Linear model in SI units, such as :func:`kc2spice.reduce` returns.
    name : str
        Name of the subcircuit and of its library file.
    header : Header, optional
        Origin of the netlist. The default names the model and a hash of its matrices.
    title : str, optional
        What the device is, for the head of the library.
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

    Returns
    -------
    Subcircuit
        Pins, parameters and text of the library file.

    Raises
    ------
    UsageError : no linear model, an unknown port, a name that the subcircuit has for itself, a
        model without state-space form or, with ``noise``, without symmetric matrices, capacitances
        between electrodes that no passive network has.

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
            "not a linear model",
            where=name,
            got=type(rom).__name__,
            expected="a kc.LinearModel, such as kc.reduce returns",
            hint="kc.read_model(PATH) reads a model from a file",
        )
    if header is None:
        digest = hashlib.sha256(rom.B.tobytes() + rom.C.tobytes() + rom.D.tobytes())
        header = Header(rom.name, digest.hexdigest()[:16])
    if ports is not None:
        rom = rom.select(list(ports))
    network = None if dense else parallel_branches(rom)
    if network is not None:
        return _network(network, rom, name, header, rating)
    if is_heat(rom):
        return _heat(rom, name, header, rating)
    form = _form(rom, dense)
    if noise and not isinstance(form, Resonators):
        rom = _with_forces(rom)
        form = _form(rom, dense)
    terminals = model_terminals(rom, form.D, name)
    outer = [t for t in terminals if not _INNER_FORCE.fullmatch(t.label)]
    pins, base = subcircuit_pins(outer, name)
    params: tuple[Param, ...] = ()
    if isinstance(form, Resonators):
        params = (DAMPING,) if np.any(form.damp > 0) else ()
        about, body = _resonators(form, rom, terminals, base, weights, noise)
    else:
        about, body = _blocks(form, rom, terminals, base)
        if base == "ref":
            title = f"reduced linear model, {len(rom.inputs)} inputs, {len(rom.outputs)} outputs"
    if noise:
        about = [*about, *_NOISE.split("\n")]
    cards = about, body
    mesh = mesh_entry(rom.facts)
    return enclosed(
        rom, name, pins, base, params, header, cards, mesh=mesh, title=title, rating=rating
    )


def _network(
    network: ParallelBranches, rom: LinearModel, name: str, header: Header, rating: str
) -> Subcircuit:
    """The subcircuit of the elements of a ``network``, whose matrices ``rom`` has."""
    pins, cards = branch_pins(rom.ports[0]), (ABOUT, branch_cards(network, rom))
    distinct([pin.name for pin in pins], INNER, where=checked_name(name))
    title = "passive network of a measured one-port"
    return enclosed(rom, name, pins, "", (), header, cards, title=title, rating=rating)


def _heat(rom: LinearModel, name: str, header: Header, rating: str) -> Subcircuit:
    """The subcircuit of a heat model."""
    common = reference_pin(rom.ports)
    pins = [Pin(port.terminals[0], port.across, port.flow) for port in rom.ports]
    inner = "|".join([INNER, HEAT_NODES, *(f"[uf]{pin.name.lower()}" for pin in pins)])
    distinct([*(pin.name for pin in pins), common.name], inner, where=checked_name(name))
    cards = heat_cards(heat_modes(rom), common.name)
    base = common.name if len(pins) > 1 else ""  # resistors and capacitors need no pivots
    rating = RATED_BY_HEAT if rating == UNRATED else rating
    title = "reduced heat model"
    return enclosed(
        rom, name, (*pins, common), base, (), header, cards, title=title, rating=rating,
        valid="conductivities and heat capacities of its data, whatever the temperature",
    )  # fmt: skip


def enclosed(
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
    **words: str,
) -> Subcircuit:
    """The subcircuit of ``cards``, comments about them and their lines, under the head of ``rom``;
    ``words`` are its title and rating. Without ``base``, no pivots: passive cards need none.

    Its error estimate is that of the certificate and of the emitted elements together, these
    compared with ``rom`` at the defaults and with ``others`` at their values of the parameters.
    """
    certificate, (about, body) = rom.certificate, cards
    band = f" up to {certificate.band_hz[1]:g} Hz" if certificate else ""
    first = ("", *pivots(base)) if base else ()
    circuit = Circuit(
        name, tuple(pin.name for pin in pins), defaults(params), noted([*first, *body])
    )
    reduction = None
    if certificate is not None:
        compared = ((rom, dict[str, float]()), *others)
        reduction = _reduction(circuit, pins, rom.order, certificate, compared)
    head = part_header(
        header,
        f"{name}: {words['title']}",
        pins,
        params,
        rom=rom_lines(reduction, certificate) if reduction and certificate else (),
        mesh=mesh,
        sign=OUTWARDS,
        rating=words["rating"],
        validity=words.get("valid")
        or f"small signals{band}{within} at the temperature of its "
        "data (20 to 25 C, of built-in materials); no hysteresis, depolarisation or heating",
    )
    circuit = replace(circuit, notes=(*head, "", *about))
    title = f"{name}: {words['title']}"
    facts: dict[str, Any] = {"reduction": reduction, "head_lines": len(head)}
    return Subcircuit(name, pins, params, Circuit(items=(circuit,)), title=comment(title), **facts)


def _reduction(
    circuit: Circuit,
    pins: Sequence[Pin],
    order: int,
    certificate: Certificate,
    compared: Iterable[tuple[LinearModel, Mapping[str, float]]],
) -> ReductionFacts:
    """The facts of the reduced model with the error estimate of its emitted circuit, by the models
    that it should equal at values of its parameters."""
    band = certificate.band_hz
    errors = (circuit_error(circuit, pins, m, band, certificate.norm, at) for m, at in compared)
    worst = max(errors, key=lambda item: item.error)
    total = certificate.error_estimate
    total += worst.error if worst.error > UNSEEN * total else 0.0
    return ReductionFacts(order, band, certificate.norm, total, worst.error, worst.frequency)


def _form(rom: LinearModel, dense: bool) -> Resonators | BlockModel:
    """The model as resonators where it is that, else as blocks, whose D has also what undamped
    states without inertia yield at once."""
    modal = None if dense else _modal(rom)
    if modal is not None:
        return modal
    from kc2spice.rom.blocks import block_model  # loads what most models do not need

    return block_model(rom, dense=dense)


def _modal(rom: LinearModel) -> Resonators | None:
    """The model as resonators, None where it is not, or where a port needs the rate of a state
    that has no inertia, thus no velocity."""
    result = resonators(rom)
    if result is None or not all(port.conservative for port in rom.ports):
        return None
    rates = [
        port.kind in FRAMES or (port.charged and capacitance <= 0)
        for port, capacitance in zip(rom.ports, np.diag(rom.D), strict=True)
    ]
    relaxing = np.abs(result.gain[result.inertia == 0.0][:, rates])
    return None if (relaxing > CROSS * np.abs(result.gain).max(initial=0.0)).any() else result


# ------------------------------------------------------------------------------- ports and pins


def model_terminals(rom: LinearModel, D: np.ndarray, where: str) -> list[PortTerminal]:
    several = sum(port.charged for port in rom.ports) > 1
    result, column, row = [], 0, 0
    for port in rom.ports:
        pins = tuple(map(checked_name, port.terminals))
        if len(pins) != (2 if port.paired else 1):
            raise UsageError(
                "wrong number of pins",
                where=where,
                got=port.name,
                expected="two of an electrical port, else one",
            )
        into = None if port.kind == "output" else column
        out = None if port.kind == "input" else row
        column += into is not None
        row += out is not None
        clamped = _capacitance(port.domain, D[out, into]) if port.charged else 0.0
        if clamped < 0:
            raise UsageError(
                "the clamped capacitance of a port is negative",
                where=where,
                got=f"{clamped:.3g} F at port {port.name}",
                expected="a positive capacitance: a positive entry of D",
            )
        tag = f"_{checked_name(port.name)}" if port.charged and several else ""
        leak = OPEN_INPUT if clamped or not port.charged else _leak(rom, port)
        result.append(PortTerminal(port, pins, tag, into, out, clamped, leak=leak))
    return result


def _capacitance(domain: Domain | None, stored: Any) -> float:
    """Farads between pins of a domain that store in SI what is ``stored`` for each unit across."""
    assert domain is not None
    return float(stored) * domain.admittance


def _leak(rom: LinearModel, port: Port) -> float:
    """Conductance [S] across an electrode without capacitance of its own: ``LEAK_RATE`` times the
    least charge per volt that the electrode has anywhere in the band."""
    low, high = span(rom)
    frequency = np.geomspace(max(low, LOWEST * high), high, LEAK_POINTS)
    try:
        charge = np.abs(rom.select([port.name]).transfer(frequency))
    except SimulationError:  # a frequency is a pole
        return OPEN_INPUT
    return LEAK_RATE * _capacitance(port.domain, charge.min()) or OPEN_INPUT


def span(rom: LinearModel) -> tuple[float, float]:
    """The band [Hz] of a model: of its certificate, else of its author, else up to 1 Hz."""
    return rom.certificate.band_hz if rom.certificate else rom.band or (0.0, 1.0)


def subcircuit_pins(terminals: Sequence[PortTerminal], name: str) -> tuple[tuple[Pin, ...], str]:
    """Return the pins in order: electrical pairs, other conservative pins, base, signals, ref.

    Raises
    ------
    UsageError : a name that the subcircuit ``name`` has for itself.
    """

    def of(*kinds: str) -> list[Pin]:
        return [
            Pin(pin, t.port.across, t.port.flow if t.port.conservative else "-")
            for t in terminals
            if t.kind in kinds
            for pin in t.pins
        ]

    # electrical ports against one cathode share its pin
    electrical, signals = list(dict.fromkeys(of(*PAIRS))), of("input", "output")
    moving = of(*(kind for kind in PORTS if kind not in PAIRS))
    common = reference_pin([t.port for t in terminals])
    pins = (*electrical, *moving, *signals, common)
    moved = (t.pins[0].lower() for t in terminals if t.kind in LOADED)
    inner = "|".join([INNER, *(f"[uf]{pin}" for pin in moved)])
    distinct([pin.name for pin in pins], inner, where=checked_name(name))
    return pins, common.name


def reference(ports: Sequence[Port]) -> str:
    """Name of the pin that displacements count from: ``base``, or ``ground`` if a port is that."""
    return "ground" if any(BASE in port.terminals for port in ports) else BASE


def reference_pin(ports: Sequence[Port]) -> Pin:
    """The last pin: what the values of pins that are no pairs count from, signals among them.

    Displacements count from the base, and all others with them.
    """
    domains = {port.domain for port in ports if port.domain is not None}
    others = {domain for domain in domains if domain.reference}
    if len(others) == 1 and (domain := others.pop()).reference != BASE:
        return Pin(domain.reference, *domain.units)
    if domains:
        return Pin(reference(ports), *TRANSLATION.units)
    return Pin("ref", *ELECTRICAL.units)


def _wired(
    terminals: list[PortTerminal], states: _States, D: np.ndarray, rom: LinearModel, base: str
) -> list[PortTerminal]:
    """The terminals with the cards of their outputs.

    Of y = C z + D u an electrical port without capacitance of its own needs the current
    y' = C A z + C B u, an acceleration the force m a - y'', y'' = C A^2 z + C A B u, where
    C B is zero, as of all that has inertia.

    Raises
    ------
    UsageError : an acceleration port that takes the rate of an input, an electrode without
        capacitance of its own that shares charge.
    """

    def through(row: np.ndarray) -> tuple[Transconductance, ...]:
        size = np.abs(row).max(initial=0.0)
        return tuple(
            t.driven(f"u{t.column + 1}", row, base)
            for t in terminals
            if t.column is not None and abs(row[t.column]) > CROSS * size
        )

    def wired(t: PortTerminal) -> PortTerminal:
        if t.row is None:
            return t
        row, direct = states.C[t.row], D[t.row] / t.unit
        rate = MICRO * row @ states.A
        if t.kind in FRAMES:
            jump = np.abs(row @ states.B) > JUMP * (np.abs(row) @ np.abs(states.B))
            at_once = np.abs(D[t.row] - rom.D[t.row]) > CROSS * np.abs(D).max()
            if jump.any() or at_once.any():
                raise UsageError(
                    "an acceleration port drives states without inertia: its force needs the rates "
                    "of what drives them, which no netlist of sources and capacitors has",
                    where=t.label,
                    got="C B not zero in its row",
                    expected="C B = 0 in the row of an acceleration port",
                    hint="inertia drives with M, so give those states zero rows of B and C there",
                )
            force = -(rate @ states.B)
            mass = rom.facts.get("mass_kg")
            force[t.column] = 0.0 if mass is None else mass + force[t.column]
            return replace(t, sums=states.cards(-(rate @ states.A), base), through=through(force))
        if t.port.charged:  # the clamped capacitance is a capacitor
            direct = np.where(np.abs(direct) > CROSS * np.abs(direct).max(), direct, 0.0)
            direct[t.column] = 0.0
            if direct.any() and not t.clamped:
                raise UsageError(
                    "an electrode without capacitance of its own shares charge with other ports",
                    where=t.label,
                    expected="a positive semi-definite D",
                )
            if not t.clamped:
                jumps = through(MICRO * row @ states.B)
                jumps = tuple(replace(card, label=f"t{card.label}") for card in jumps)
                return replace(t, sums=states.cards(rate, base) + jumps)
        return replace(t, sums=states.cards(row, base), through=through(direct))

    return list(map(wired, terminals))


def conservative(terminals: Sequence[PortTerminal], base: str, share: float) -> list[Line]:
    """Cards of the ports: electrical ones, motions, accelerations of the frame."""
    order = (CHARGED, LOADED, FRAMES)
    ports = [t for kinds in order for t in terminals if t.kind in kinds]
    return [line for t in ports for line in _port(t, base, share)]


def _port(t: PortTerminal, base: str, share: float) -> Iterator[Line]:
    pin, tag = t.pins[0], t.tag
    if t.kind in FRAMES:
        yield _SHAKEN.format(pin=pin)
        yield from (card.onto(pin, base, f"Ga{pin}_") for card in t.sums + t.through)
    elif t.kind in LOADED:
        yield (_MOTION if t.port.domain is TRANSLATION else _ROTATION).format(pin=pin)
        yield Element.of(f"Ru{pin}", f"u{pin}", base, "1")
        yield Element.of(f"Gf{pin}", base, f"f{pin}", pin, f"u{pin}", "1")
        yield Element.of(f"Gp{pin}", pin, base, f"f{pin}", base, "1")
        yield from (card.onto(base, f"u{pin}", f"Gu{pin}_") for card in t.sums)
        yield from (card.onto(base, f"u{pin}", f"Gt{pin}_") for card in t.through)
    elif t.clamped:
        words = {"name": f" {t.label}" if tag else "", "farad": t.clamped, "share": share}
        words["seconds"] = 1 / LEAK_RATE
        yield (_CLAMPED if t.port.paired else _FILLED).format(**words, **_units(t, base))
        (a, b), c = t.ends(base), t.capacitance or t.clamped
        inverse = f"{number(MICRO)}/{c}" if isinstance(c, str) else MICRO / c
        yield Element.of(f"Cclamped{tag}", a, f"inner{tag}", written(scale_value(share, c)))
        yield Element.of(f"Gmore{tag}", a, b, f"current{tag}", base, 1 - share)
        yield Element.of(f"Gleak{tag}", a, b, a, f"inner{tag}", written(scale_value(LEAK_RATE, c)))
        yield Element.of(f"Ginner{tag}", base, f"current{tag}", f"inner{tag}", b, "1")
        ends = f"current{tag}", f"charge{tag}"
        yield Element.of(f"Gcharge{tag}", base, *ends, base, written(inverse))
        yield Element.of(f"Gcurrent{tag}", f"inner{tag}", b, f"current{tag}", base, share)
        yield Element.of(f"Rcharge{tag}", f"charge{tag}", base, "1")
        yield from (card.onto(base, f"charge{tag}", f"Gc{tag}_") for card in t.sums + t.through)
    else:
        a, b = t.ends(base)
        yield (_UNCLAMPED if t.port.paired else _UNFILLED).format(name=t.label, **_units(t, base))
        yield Element.of(f"Gleak{tag}", a, b, a, b, t.leak)
        for card in t.sums:
            yield replace(card, label=f"{card.label}{tag}").onto(a, b, "Gc")


def _units(t: PortTerminal, base: str) -> dict[str, str]:
    """Words about a port's pin for a comment."""
    return {"pin": t.pins[0], "base": base, "across": t.port.across, "flow": t.port.flow}


# -------------------------------------------------------------------------------- resonators


def _resonators(
    model: Resonators,
    rom: LinearModel,
    terminals: list[PortTerminal],
    base: str,
    weights: StepWeights,
    noise: bool,
) -> tuple[list[str], list[Line]]:
    """Cards of the resonators in modal coordinates.

    With ``z_j'' + d_j z_j' + w_j^2 z_j = sum_k g_jk u_k`` and ``s_j = max_k |g_jk|`` over the
    mechanical ports, the states are ``q_j = s_j z_j`` and ``p_j = q_j' / w_j`` in um (or, of a
    model without mechanical ports, in uC)::

        C q' = C w p,    C p' = -C w q - C d p + (C s / w) sum_k g_k u_k

    with ``C = 1 uF min(1, (w / 3 w_1)^2)`` or as ``weights`` says: step control sees an error of
    charge, ``C`` times that of the displacement, and slow modes decide nothing in a contact, but
    ring long after it.
    With a damping below :data:`LIGHT`, ``p_j = q_j + q_j' / w_j``, see :func:`_mode`.
    A state without inertia is q alone, ``C q' = -G q + (G s / w^2) sum_k g_k u_k`` with
    ``C = G d / w^2``.
    """
    order = _observable(model)
    omega, damp, gain = model.omega[order], model.damp[order], model.gain[order]
    heavy = model.inertia[order] > 0
    scale = scales(gain, terminals)[:, None]
    numbers = range(1, len(order) + 1)
    turn = omega * heavy  # the others have no velocity, and no node for it
    light, losses = (damp < LIGHT * omega) * heavy, damp * heavy
    rates = [[-turn * light, turn], [-turn - (turn - losses) * light, turn * light - losses]]
    drive = heavy[:, None] * scale * gain / (omega[:, None] * MICRO)
    states = _States(
        [f"{node}{j}" for node in "qp" for j in numbers],
        [f"{mark}{j}" for mark in ("", "d") for j in numbers],
        np.block([list(map(np.diag, row)) for row in rates]),
        np.vstack([np.zeros_like(drive), drive]),
        np.hstack(
            [(gain / scale).T * [[MICRO / t.unit] for t in terminals], np.zeros_like(gain.T)]
        ),
    )
    farad = weights.farad(omega, omega[heavy].min(initial=np.inf))
    siemens = np.where(heavy, farad * omega, SIEMENS)
    force = siemens * scale[:, 0] / (omega**2 * MICRO)
    drive = force[:, None] * gain
    about = _about_resonators(terminals, base, weights)
    if light.any():
        about += _LIGHT.format(quality=1 / LIGHT).split("\n")
    wired = _wired(terminals, states, rom.D, rom, base)
    stored = [replace(t, sums=()) if t.clamped else t for t in wired]
    body = conservative(stored, base, weights.share)
    branches = [mode_branch(damp[j], omega[j], gain[j], gain, terminals) for j in range(len(order))]
    for j in range(len(order)):
        if heavy[j]:
            body.append(f"\n* Mode {j + 1}: {mode_facts(omega[j], damp[j])}{branches[j]}")
            body += _mode(j + 1, omega[j], damp[j], farad[j], base)
        else:
            body += _relaxation(j + 1, omega[j], damp[j], base)
        node = f"p{j + 1}" if heavy[j] else f"q{j + 1}"
        body += [card.onto(base, node) for card in input_cards(j + 1, drive[j], terminals, base)]
        if noise and damp[j] > 0:
            loss = f"{{damping*{number(damp[j])}}}"
            body.append(Element.of(f"Rnoise{j + 1}", f"noise{j + 1}", base, loss))
            body.append(Element.of(f"Gn{j + 1}", base, node, f"noise{j + 1}", base, force[j]))
        body += [
            Transconductance(
                f"Gc{j + 1}{t.tag}", f"q{j + 1}", base, gain[j, k] / scale[j, 0] * MICRO / t.unit
            ).onto(base, f"charge{t.tag}")  # uC per um
            for k, t in enumerate(terminals)
            if t.clamped
        ]
    return about, body


def _about_resonators(
    terminals: Sequence[PortTerminal], base: str, weights: StepWeights
) -> list[str]:
    """Comments about the form of the circuit and its reference pin."""
    words: dict[str, Any] = {"full": weights.full, "power": weights.power, "silent": SILENT}
    words["answer"] = "displacement of a port in um"
    words["reference"] = "The base is the mechanical and signal reference"
    lines = list(_OUTWARDS)
    if _unplaced(terminals):
        units = dict.fromkeys(t.port.domain.answer_unit for t in terminals if t.port.domain)
        words["answer"] = f"answer of a port in 1e-6 {' or '.join(units)}"
        words["reference"], lines = f"Values of pins count from {base}", []
    return [*lines, *_RESONATORS.format(**words).split("\n")]


def _unplaced(terminals: Sequence[PortTerminal]) -> bool:
    """Whether values at pins count from another reference than that of displacements."""
    references = {t.port.domain.reference for t in terminals if t.port.domain} - {""}
    return bool(references) and BASE not in references


def _mode(j: int, omega: float, damp: float, farad: float, base: str) -> Iterator[Line]:
    """Two integrators of one mode.

    With a damping below :data:`LIGHT` the second one is ``p = q + q' / w``, so that the voltage
    from p to q is the velocity.
    """
    q, p, turn, loss = f"q{j}", f"p{j}", farad * omega, farad * damp
    light = damp < LIGHT * omega
    velocity = (p, q) if light else (p, base)
    yield Element.of(f"Cq{j}", q, base, farad)
    yield Element.of(f"Cp{j}", p, base, farad)
    yield Element.of(f"Gq{j}", base, q, *velocity, turn)
    yield Element.of(f"Gp{j}", p, base, q, base, turn)
    if light:
        yield Element.of(f"Gs{j}", base, p, *velocity, turn)
    if loss > 0:
        yield Element.of(f"Gd{j}", p, base, *velocity, f"{{damping*{number(loss)}}}")


def mode_facts(omega: float, damp: float) -> str:
    """Return frequency and Q factor of a mode of ``omega`` [rad/s] that loses ``damp`` [1/s].

    Examples
    --------
    >>> mode_facts(2 * np.pi * 41.2e3, 2 * np.pi * 824.0)
    '41.2 kHz, Q 50'
    """
    hertz = omega / (2 * np.pi)
    power = prefix_power(hertz)
    quality = f"Q {omega / damp:.4g}" if damp > 0 else "undamped"
    return f"{hertz / 10.0**power:.6g} {PREFIXES[power]}Hz, {quality}"


def mode_branch(
    damp: float,
    omega: float,
    gain: np.ndarray,
    gains: np.ndarray,
    terminals: Sequence[PortTerminal],
) -> str:
    """Return what a mode is at its port, as words of a comment; "" where it has none.

    A mode ``z'' + damp z' + omega^2 z = g v`` whose charge is ``g z`` is L = 1/g^2, R = damp/g^2
    and C = g^2/omega^2 in series across an electrical port; by the same law it is the mass
    m = 1/g^2, the damper c = damp/g^2 and the spring k = omega^2/g^2 at a mechanical one. ``gains``
    are those of all modes; rounding is far below the largest of them.
    """
    largest = np.abs(gains).max(axis=0)
    for domains, names in (((ELECTRICAL,), "LCR"), ((TRANSLATION, ROTATION), "mck")):
        shares = [
            abs(g) if t.port.domain in domains and abs(g) > SILENT * most else 0.0
            for t, g, most in zip(terminals, gain, largest, strict=True)
        ]
        if not any(shares):
            continue
        port = int(np.argmax(np.array(shares) >= max(shares) * (1 - ALIKE)))
        m, c, k = (float(value / shares[port] ** 2) for value in (1.0, damp, omega**2))
        values = (m, 1 / k, c) if names == "LCR" else (m, c, k)
        words = (f"{n}={rounded(v)}" for n, v in zip(names, values, strict=True))
        return f", {' '.join(words)} at {terminals[port].pins[0]}"
    return ""


def _relaxation(j: int, omega: float, damp: float, base: str) -> Iterator[Line]:
    """One state without inertia."""
    hertz, time = omega / (2 * np.pi), damp / omega**2
    yield f"\n* Without inertia, from {hertz:.6g} Hz on: relaxes within {time:.6g} s"
    if time > 0:
        yield Element.of(f"Cq{j}", f"q{j}", base, f"{{damping*{number(SIEMENS * time)}}}")
    yield Element.of(f"Gq{j}", f"q{j}", base, f"q{j}", base, SIEMENS)


def scales(gain: np.ndarray, terminals: Sequence[PortTerminal]) -> np.ndarray:
    """Largest share (q,) of each mode in a displacement, or in any port."""
    mechanical = [t.port.domain is TRANSLATION for t in terminals]
    scale = np.abs(gain[:, mechanical]).max(axis=1, initial=0.0)
    scale = np.where(scale > 0, scale, np.abs(gain).max(axis=1))
    return np.where(scale > 0, scale, 1.0)


def input_cards(
    index: int,
    row: np.ndarray | Sequence[Value],
    terminals: Sequence[PortTerminal],
    base: str,
) -> list[Transconductance]:
    """Cards by which ports drive a mode: forces, voltages, accelerations."""

    def label(t: PortTerminal) -> str:
        suffix = f"{index}{t.tag}" if t.port.paired else f"{t.pins[0]}_{index}"
        return f"G{_DRIVES[t.kind]}{suffix}"

    ordered = sorted(terminals, key=lambda t: "fvs".index(_DRIVES[t.kind]))
    return [t.driven(label(t), row, base) for t in ordered]


def _observable(model: Resonators) -> np.ndarray:
    """Modes by their frequency, those without inertia last, without those that no port moves or
    observes: rounding makes them."""
    share = np.abs(model.gain) / model.omega[:, None]
    share /= share.max(axis=0, initial=0.0, keepdims=True) + np.finfo(float).tiny
    observable = share.max(axis=1, initial=0.0) > SILENT
    order = np.lexsort((model.omega, model.inertia == 0.0))
    return order[observable[order]] if observable.any() else order


# ------------------------------------------------------------------------------------- blocks


def _blocks(
    model: BlockModel, rom: LinearModel, terminals: list[PortTerminal], base: str
) -> tuple[list[str], list[Line]]:
    """The states of every block of :func:`kc2spice.rom.blocks.block_model` are voltages on
    ``C = 1 / (2 pi f1)``, f1 the end of the band, so that conductances in the band are about 1 S.
    A block is scaled to about 1 V for a constant input of 1 V.
    """
    from scipy.linalg import block_diag  # loads what most models do not need

    farad = 1 / (2 * np.pi * span(rom)[1])
    B, C = model.B.copy(), model.C.copy()
    none = np.zeros((len(B), 0)), np.zeros((0, len(B))), B[:0], C[:, :0], B[:0, :0]
    F, P, Q, R, S = (item.copy() for item in model.loops or none)
    scaled_blocks, integrating, start = [], [], 0
    for block in model.blocks:
        rows = slice(start, start + len(block))
        start += len(block)
        block, free, scale = _balanced(block, np.hstack([B[rows], F[rows]]), 1 / farad)
        B[rows] /= scale[:, None]
        F[rows] /= scale[:, None]
        C[:, rows] *= scale
        P[:, rows] *= scale
        scaled_blocks.append(block)
        integrating.append(free)
    numbers = [f"{k}" for k in range(1, start + len(S) + 1)]
    units = [[t.unit] for t in terminals if t.row is not None]
    states = _States(
        [f"z{k}" for k in numbers],
        numbers,
        np.block([[block_diag(*scaled_blocks), F], [P / farad, S / farad]]),
        np.vstack([B, Q / farad]),
        np.hstack([C, R]) / np.array(units),
    )
    wired = _wired(terminals, states, model.D, rom, base)
    ports = [t for t in wired if t.port.conservative]
    inputs = [t.pins[0] for t in terminals if t.kind == "input"]
    noise_inputs = list(filter(_INNER_FORCE.fullmatch, inputs))  # forces that are noise
    inputs = [pin for pin in inputs if pin not in noise_inputs]
    body: list[Line] = [Element.of(f"R{pin}", pin, base, "1") for pin in noise_inputs]
    body += ["* An input that is left open is zero."] * bool(inputs)
    body += [Element.of(f"Gleak{k}", p, base, p, base, OPEN_INPUT) for k, p in enumerate(inputs, 1)]
    body += conservative(ports, base, RINGING.share)
    for index, t in enumerate((t for t in wired if t.kind == "output"), 1):
        body += [
            f"\n* Output {t.pins[0]}",
            Element.of(f"E{index}", t.pins[0], base, f"sum{index}", base, "1"),
            Element.of(f"Rsum{index}", f"sum{index}", base, "1"),
            *(card.onto(base, f"sum{index}", f"Gc{index}_") for card in t.sums),
            *(card.onto(base, f"sum{index}", f"Gt{index}_") for card in t.through),
        ]
    at = 0
    signals: list[tuple[np.ndarray, bool | None]] = [(S, None)] if len(S) else []
    for block, drifts in [*zip(scaled_blocks, integrating, strict=True), *signals]:
        first, at = at, at + len(block)
        accuracy = _LOOPED if drifts is None else comment(_description(block))
        body.append(f"\n* States {first + 1} to {at}: {accuracy}")
        for k in range(first, at):
            index, node = k + 1, f"z{k + 1}"
            if drifts is not None:
                body.append(Element.of(f"C{node}", node, base, farad))
            if drifts:
                body += [_FREE_STATE, Element.of(f"G{node}", node, base, node, base, FREE_LEAK)]
            cards = states.cards(farad * states.A[k], base)
            body += [card.onto(base, node, f"Ga{index}_") for card in cards]
            body += [
                t.driven(f"{t.column + 1}", farad * states.B[k], base).onto(
                    base, node, f"Gb{index}_"
                )
                for t in terminals
                if t.column is not None and states.B[k, t.column]
            ]
    about = _STATES.format(farad=number(farad), base=base).split("\n")
    return ([*_OUTWARDS, *about] if ports and not _unplaced(terminals) else about), body


def _with_forces(rom: LinearModel) -> LinearModel:
    """``rom`` with an input for the force of every loss: ``E`` is the sum of squares of the columns
    of B of these forces, so that each force has the noise of a loss of one.

    Raises
    ------
    UsageError : losses outside the matrix ``E``.
    """
    if rom.first_order or not rom.symmetric or not all(port.conservative for port in rom.ports):
        raise UsageError(
            "the noise of this model is not known",
            where=rom.name,
            got="a first-order model, one that is not symmetric, or ports that are signals",
            expected="symmetric M, E, K and conservative ports",
            hint="a transient or ac does without",
        )
    K, E, M = rom.pencil.dense().coefficients
    losses, shapes = np.linalg.eigh(E)
    lossy = losses > LOST * losses.max(initial=0.0)
    forces = shapes[:, lossy] * np.sqrt(losses[lossy])
    ports = tuple(Port(f"noise{k}", "input") for k in range(1, forces.shape[1] + 1))
    D = np.hstack([rom.D, np.zeros((len(rom.D), len(ports)))])
    B, every = np.hstack([rom.B, forces]), (*rom.ports, *ports)
    return replace(rom, M=M, E=E, K=K, rayleigh=None, B=B, C=rom.C, D=D, ports=every)


def _balanced(
    block: np.ndarray, drive: np.ndarray, omega: float
) -> tuple[np.ndarray, bool, np.ndarray]:
    """A block, a complex pair as ``[[a, w], [-w, a]]``; whether it integrates constant inputs; the
    scale of its states, about 1 for a constant input of 1."""
    scale = np.ones(len(block))
    if len(block) == 2 and block[0, 1] * block[1, 0] < 0:
        scale[1] = np.sqrt(-block[1, 0] / block[0, 1])
    block, drive = block * scale / scale[:, None], drive / scale[:, None]
    free = bool(np.linalg.svd(block, compute_uv=False)[-1] < FREE * omega)
    answer = drive / omega if free else np.linalg.solve(block, drive)
    return block, free, scale * (np.abs(answer).max(initial=0.0) or 1.0)


def _description(block: np.ndarray) -> str:
    """Poles of a block in a word for the reader."""
    result = np.linalg.eigvals(block)
    texts = [
        f"{abs(pole) / (2 * np.pi):.6g} Hz, damping ratio {0.0 - pole.real / abs(pole):.6g}"
        if pole.imag > 0
        else f"pole {pole.real:.6g} 1/s"
        for pole in result[result.imag >= 0]
    ]
    more = f"; and {len(texts) - 3} more" if len(texts) > 3 else ""
    return "; ".join(texts[:3]) + more


def loaded(
    model: LinearModel, library: Subcircuit, load: Port, tag: str = ""
) -> tuple[list[Element], dict[str, tuple[str, float]]]:
    """Elements of one copy of the subcircuit of ``model`` under a unit load, and by each port that
    answers the vector that does and its factor to SI.

    The other electrodes are shorted, mechanical ports are free, frames stand still, other inputs
    are zero, as in :meth:`LinearModel.transfer`; an electrode answers with its current, another
    driven pin with its flow, a frame with its force. ``tag`` is what the copy's names have behind
    them.
    """
    ends = {port.terminals[0].lower() for port in model.ports}
    names = [pin.name if pin.name.lower() in ends else "" for pin in library.pins]
    nodes = {name.lower(): f"{name}{tag}" for name in names if name}
    joined = [f"{name}{tag}" if name else "0" for name in names]
    cards, result = [Element.of(f"X{library.name}{tag}", *joined, library.name)], {}
    one = 1.0 if load.domain is None else load.domain.quantity(load.domain.driven).factor
    for port in model.ports:
        node, size = nodes[port.terminals[0].lower()], ("AC", "1") if port == load else ()
        if port.domain is not None and port.kind in LOADED:
            drive = Element.of(f"I{node}", "0", node, "DC", "0", *size)
            cards += [drive.valued(port.domain.value_unit("I"))] if size else []
            result[port.name] = (f"v({node})", port.domain.across.factor / one)
        elif port.kind == "output":
            result[port.name] = (f"v({node})", 1.0 / one)
        else:
            drive = Element.of(f"V{node}", node, "0", "DC", "0", *size)
            cards.append(drive.valued(port.domain.value_unit("V") if port.domain else ""))
            if port.domain is not None:
                flow = port.domain.quantity("through").factor
                result[port.name] = (f"i(v{node.lower()})", -flow / one)
    return cards, result
