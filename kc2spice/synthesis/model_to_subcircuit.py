"""Conversion of linear models to subcircuits.

A subcircuit consists of decoupled resonators, of blocks of states, or of a network of R, L and C.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from kc2spice.core.argument_and_option_names import check_arguments
from kc2spice.core.domains import HEAT, HEAT_PINS
from kc2spice.core.errors import UsageError
from kc2spice.core.naming import list_names
from kc2spice.netlist.circuit import Circuit, Element, Param, Pin
from kc2spice.netlist.number_and_name_spelling import format_comment
from kc2spice.netlist.shared_cards import Line, attach_comments, write_pivot_cards
from kc2spice.netlist.subcircuit_library import Header, ReductionSummary, Subcircuit
from kc2spice.rom.linear_model import Certificate, LinearModel, Port
from kc2spice.rom.modal_models import Resonators, compute_resonators
from kc2spice.rom.one_port_network import ParallelBranches, recognise_parallel_branches
from kc2spice.synthesis.branches import NETWORK_COMMENT, write_branch_cards
from kc2spice.synthesis.circuit_error import accelerates_frame, estimate_circuit_error
from kc2spice.synthesis.heat_netlist import estimate_leak_share, is_heat_model, write_heat_model
from kc2spice.synthesis.heat_sources import HEAT_PIN_ROWS, LOSS_NODE
from kc2spice.synthesis.library_headers import (
    MODAL_EXCITATION,
    OUTWARDS_TEXT,
    format_parameter_defaults,
    list_netlist_pins,
    write_mesh_error_text,
    write_part_header,
    write_rom_comments,
)
from kc2spice.synthesis.mode_cards import (
    RINGING_WEIGHTS,
    StepWeights,
    write_losses,
    write_resonators,
)
from kc2spice.synthesis.state_blocks import write_blocks
from kc2spice.synthesis.terminals import (
    CROSS_ROUNDING,
    INNER_NODE_PATTERN,
    find_reference_pin,
    get_flow_node_pattern,
    list_subcircuit_pins,
    make_terminals,
    mask_charge_ports,
    require_distinct_pins,
)

if TYPE_CHECKING:
    from kc2spice.rom.decoupled_blocks import BlockModel
HEAT_NODE_PATTERN = r"h\d+"
_NOISE_COMMENT = """\
* Every loss has thermal force noise, 4 k T times its damping. A resistor of the same number of ohms
* provides this noise. No other resistor in this subcircuit has noise."""
DAMPING_PARAMETER = Param("damping", 1.0, "-", "scale of the damping of all modes")
# Fraction of an error estimate below which an additional error is negligible.
# An additional error below 0.1 % of an error estimate does not change the three printed digits.
NEGLIGIBLE_ERROR = 1e-3
# An eigenvalue of the damping matrix counts as zero up to this fraction of the largest eigenvalue.
NEGLIGIBLE_LOSS = 1e-14
RATED_BY_HEAT = "not known; keep temperatures within the limits of its materials"
UNRATED = "not known; keep field and stress within the limits of its materials"
UNRATED_SIGNALS = "not known; the model is linear at any signal amplitude"


@check_arguments
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
    temperature: str = "",
) -> Subcircuit:
    """Return the netlist subcircuit of a linear model, with pins for all ports.

    The order of the pins is: pairs of floating terminals for the electrical ports, pins of other
    conservative ports, signal pins, and the reference pin ``base``. A model with only signals has
    the reference pin ``ref``. A displacement or rotation pin is conservative: its value is a sum of
    the states, and the force on the pin drives the states. An acceleration pin accelerates the
    frame of the body, and the current into the pin is the necessary force. The subcircuit has the
    same equations at its ports as the model, and is passive if the model is passive.

    A network that was fitted to the measured impedance of one port is written as resistors,
    inductors and capacitors (:mod:`kc2spice.rom.one_port_network`). A symmetric definite model with
    modal damping is written as decoupled resonators. Any other model is written as blocks of
    coupled states, or as one block if ``dense`` is true.

    Parameters
    ----------
    rom : LinearModel
        Linear model in SI units, for example the result of :func:`kc2spice.reduce`.
    name : str
        Name of the subcircuit and of its library file.
    header : Header, optional
        Origin of the netlist, by default the name of the model and a hash of its matrices.
    title : str, optional
        Description of the device, for the header of the library.
    rating : str, optional
        Largest permitted load of the device, for the header of the library.
    ports : sequence of str, optional
        Names of the ports that get pins, by default all ports. All other ports have no load.
    dense : bool, default False
        Whether to write all states as one coupled block.
    weights : StepWeights, optional
        How closely the step control of the simulator follows the modes of the resonator form.
    noise : bool, default False
        Whether the subcircuit includes the thermal noise of the losses.
    heat : bool, default False
        Whether the losses leave the subcircuit as a heat flow between the additional pins ``heat``
        and ``ambient``.
    temperature : str, optional
        Temperature of the material data, for the header of the library, such as ``"25 C"``.

    Returns
    -------
    Subcircuit
        Pins, parameters and text of the library file.

    Raises
    ------
    UsageError : ``rom`` is not a linear model, a port is unknown, a pin has a name that the
        subcircuit uses internally, the model has no state-space form, or no passive network has
        the capacitances between the electrodes. With ``noise``, an error is also raised if the
        matrices are not symmetric. With ``heat``, an error is also raised if the damping couples
        the modes.

    Examples
    --------
    A mass of 10 g on a spring of 100 N/m and a damper of 0.1 N s/m has one mechanical port, which
    gives the subcircuit the pin ``tip``. The pin ``base`` is the reference of displacements.

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
            where="rom",
            got=f"{type(rom).__name__} {rom!r}"[:120],
            expected="a kc.LinearModel, such as kc.reduce returns",
            hint="read a model from a file by kc.read_model(PATH)",
        )
    if header is None:
        digest = hashlib.sha256(rom.B.tobytes() + rom.C.tobytes() + rom.D.tobytes())
        header = Header(rom.name, digest.hexdigest()[:16])
    if ports is not None:
        rom = rom.select(list(ports))
    network = None if dense else recognise_parallel_branches(rom)
    if heat and (network is not None or is_heat_model(rom)):
        raise _make_unknown_losses_error(
            name, "a heat model, or the network of a measured response"
        )
    if network is not None:
        return _make_network_subcircuit(network, rom, name, header, rating)
    if is_heat_model(rom):
        return _make_heat_subcircuit(rom, name, header, rating)
    form = _decouple_states(rom, dense)
    if noise and not isinstance(form, Resonators):
        rom = _add_noise_forces(rom)
        form = _decouple_states(rom, dense)
    terminals = make_terminals(rom, form.D, name)
    pins, base = list_subcircuit_pins([t for t in terminals if not t.is_noise], name)
    if heat:
        require_distinct_pins((*pins, *HEAT_PIN_ROWS), (LOSS_NODE,), name)
    losses: list[Line] = []
    params: tuple[Param, ...] = ()
    if isinstance(form, Resonators):
        params = (DAMPING_PARAMETER,) if np.any(form.damp > 0) else ()
        about, body = write_resonators(form, rom, terminals, base, weights, noise)
        losses = list(write_losses(form, terminals, base)) if heat else []
    elif heat:
        raise _make_unknown_losses_error(
            name,
            "a model with coupled states, or with signal ports",
            "in place of damping per material, write for example  damping = { quality = 50, "
            f"loss_tangent = 0.02 }}, or leave the pin {HEAT} out",
        )
    else:
        about, body = write_blocks(form, rom, terminals, base)
        if base == "ref":
            title = f"reduced linear model, {len(rom.inputs)} inputs, {len(rom.outputs)} outputs"
    if noise:
        about = [*about, *_NOISE_COMMENT.split("\n")]
    cards = about, body
    mesh = write_mesh_error_text(rom.facts)
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
        temperature=temperature,
    )


def _make_unknown_losses_error(name: str, got: str, hint: str = "") -> UsageError:
    """Make the error for a requested heat pin of a model whose losses are unknown."""
    return UsageError(
        "the losses of this model are unknown, so this model cannot have a heat pin",
        where=name,
        got=got,
        expected="a body with electrodes or mechanical ports, whose damping does not couple modes",
        hint=hint or f"leave the pin {HEAT} out",
    )


def _make_network_subcircuit(
    network: ParallelBranches, rom: LinearModel, name: str, header: Header, rating: str
) -> Subcircuit:
    """Return the subcircuit of a network of resistors, inductors and capacitors.

    ``rom`` contains the matrices of the network.
    """
    pins, cards = (
        list_netlist_pins(rom.ports[0]),
        (NETWORK_COMMENT, write_branch_cards(network, rom)),
    )
    require_distinct_pins(pins, (INNER_NODE_PATTERN,), name)
    title = "passive network of a measured one-port"
    return make_subcircuit(rom, name, pins, "", (), header, cards, title=title, rating=rating)


def _make_heat_subcircuit(rom: LinearModel, name: str, header: Header, rating: str) -> Subcircuit:
    """Return the subcircuit of a heat model."""
    pins, common = list_heat_pins(rom, name)
    cards = write_heat_model(rom, common)
    # A heat model with only two pins consists of resistors and capacitors.
    # Circuits of resistors and capacitors need no cards for a short first time step.
    base = common if len(pins) > 2 else ""
    return make_subcircuit(
        rom, name, pins, base, (), header, cards, **make_heat_header_texts(rating)
    )


def list_heat_pins(rom: LinearModel, name: str) -> tuple[tuple[Pin, ...], str]:
    """Return the pins of a heat model, and the name of its reference pin (the last).

    Raises
    ------
    UsageError : a pin has a name that the subcircuit ``name`` uses internally.
    """
    common = find_reference_pin(rom.ports)
    ends = tuple(chain.from_iterable(map(list_netlist_pins, rom.ports)))
    pins = (*ends, common)
    require_distinct_pins(
        pins, (INNER_NODE_PATTERN, HEAT_NODE_PATTERN, *map(get_flow_node_pattern, ends)), name
    )
    return pins, common.name


def make_heat_header_texts(rating: str) -> dict[str, Any]:
    """Return title, rating and validity of a heat model for the library header."""
    return {
        "title": "reduced heat model",
        "rating": RATED_BY_HEAT if rating == UNRATED else rating,
        "valid": "constant conductivities and heat capacities; no temperature dependence",
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
    """Return the subcircuit of a reduced model, with a header.

    ``cards`` contains comments about the circuit, and the cards of its elements. ``base`` is the
    name of the reference pin, to which the cards for a short first time step are connected. In the
    short first time step, ngspice chooses the pivots of its equations. Circuits of passive elements
    need no short first time step; for such circuits, ``base`` is empty. ``losses`` are the cards of
    heat flows from losses; they follow the cards of the elements. With ``losses``, the subcircuit
    has heat pins. ``words`` contains texts for the header: ``title``, ``rating``, ``temperature``
    of the material data, and ``valid``, the range of validity.

    The error estimate in the header is the circuit error plus the error estimate of the
    certificate. The circuit is compared with ``rom`` at the default values of the parameters, and
    with each model in ``others`` at the parameter values of that model.
    """
    certificate, (about, body) = rom.certificate, cards
    band = f" up to {certificate.band_hz[1]:g} Hz" if certificate else ""
    first = ("", *write_pivot_cards(base)) if base else ()
    names, items = tuple(list_names(pins)), attach_comments([*first, *body])
    circuit = Circuit(name, names, format_parameter_defaults(params), items)
    reduction = None
    if certificate is not None:
        compared = ((rom, dict[str, float]()), *others)
        reduction = _summarise_reduction(circuit, pins, rom.order, certificate, compared)
    absent = "no hysteresis, depolarisation or heating"
    if losses:
        absent = "no hysteresis or depolarisation; no temperature dependence"
        pins = (*pins, *HEAT_PIN_ROWS)
        ends, items = (
            tuple(map(attrgetter("name"), pins)),
            attach_comments([*first, *body, *losses]),
        )
        circuit = replace(circuit, pins=ends, items=items)
    data = "data of the model"
    if words.get("temperature"):
        data = f"material data ({words['temperature']})"
    valid = f"small signals{band}{within} at the temperature of the {data}; {absent}"
    rating, excitation = words["rating"], MODAL_EXCITATION
    if not any(port.conservative for port in rom.ports):
        valid, excitation = f"linear{band}{within}", ""
        rating = UNRATED_SIGNALS if rating == UNRATED else rating
    elif is_heat_model(rom):
        excitation = ""
    comments: tuple[str, ...] = ()
    if reduction and certificate:
        comments = write_rom_comments(reduction, certificate, excitation)
    head = write_part_header(
        header,
        f"{name}: {words['title']}",
        pins,
        params,
        rom=comments,
        mesh=mesh,
        heat=HEAT_PINS if losses else "",
        sign=OUTWARDS_TEXT,
        rating=rating,
        validity=words.get("valid", valid),
    )
    circuit = replace(circuit, notes=(*head, "", *about))
    title = f"{name}: {words['title']}"
    facts: dict[str, Any] = {"reduction": reduction, "header_lines": len(head)}
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
    """Summarise the reduction: order, band and total error of model and circuit.

    The circuit is compared with each model in ``compared`` at the parameter values of that model.
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
    """Return the model in modal coordinates if possible, otherwise as a BlockModel.

    Modal coordinates give resonators that are not coupled. A :class:`BlockModel` consists of blocks
    of first-order states; only states in one block are coupled.

    States without damping and inertia follow the inputs without delay. The feedthrough matrix D of
    a :class:`BlockModel` contains the response of states without damping and inertia.
    """
    modal = None if dense else _decouple_modes(rom)
    if modal is not None:
        return modal
    # imported here, because most models need no blocks
    from kc2spice.rom.decoupled_blocks import make_block_model

    return make_block_model(rom, dense=dense)


def _decouple_modes(rom: LinearModel) -> Resonators | None:
    """Return the model as resonators; None if the model has no resonator form.

    Resonators require modes that are not coupled, and ports that are not signals. No port's output
    may require the velocity of a state without inertia.
    """
    result = compute_resonators(rom)
    if result is None or not is_conservative(rom):
        return None
    frames = list(map(accelerates_frame, rom.ports))
    unclamped = np.logical_and(mask_charge_ports(rom), np.diag(rom.D) <= 0)
    relaxing = np.abs(result.gain[result.inertia == 0.0][:, np.logical_or(frames, unclamped)])
    return (
        None if (relaxing > CROSS_ROUNDING * np.abs(result.gain).max(initial=0.0)).any() else result
    )


def is_conservative(rom: LinearModel) -> bool:
    """Return whether all ports of the model are conservative: they exchange energy."""
    return all(map(attrgetter("conservative"), rom.ports))


def _add_noise_forces(rom: LinearModel) -> LinearModel:
    """Return a model with additional inputs for the thermal noise of its losses.

    The columns b of the input matrix for the noise forces satisfy ``E = sum b b'``, where E is the
    damping matrix. Each noise force therefore has the spectral density of the noise of a unit
    damping coefficient.

    Raises
    ------
    UsageError : the noise is not known, because the model is of first order or not symmetric, or
        has ports that are signals.
    """
    if rom.first_order or not rom.symmetric or not is_conservative(rom):
        raise UsageError(
            "the noise of this model cannot be computed",
            where=rom.name,
            got="a first-order model"
            if rom.first_order
            else "signal ports"
            if rom.symmetric
            else "matrices that are not symmetric",
            expected="symmetric matrices M, E and K, and conservative ports",
            hint="use a transient or ac analysis in place of the noise analysis",
        )
    K, E, M = rom.pencil.make_dense().coefficients
    losses, shapes = np.linalg.eigh(E)
    lossy = losses > NEGLIGIBLE_LOSS * losses.max(initial=0.0)
    forces = shapes[:, lossy] * np.sqrt(losses[lossy])
    ports = tuple(Port(f"noise{k}", "input") for k in range(1, forces.shape[1] + 1))
    D = np.hstack([rom.D, np.zeros((len(rom.D), len(ports)))])
    B, every = np.hstack([rom.B, forces]), (*rom.ports, *ports)
    return replace(rom, M=M, E=E, K=K, rayleigh=None, B=B, C=rom.C, D=D, ports=every)


def make_unit_load_cards(
    model: LinearModel, library: Subcircuit, load: Port, tag: str = ""
) -> tuple[list[Element], dict[str, tuple[str, float]]]:
    """Return cards that apply a unit load to one port, and the response vectors.

    The response vectors are keyed by port. Each response vector consists of the name of an ngspice
    vector and of the factor that converts the vector to SI units. As in
    :meth:`LinearModel.transfer`, all electrodes except the loaded one are shorted, mechanical ports
    are free, frames are at rest and all other inputs are zero. The response of an electrode is the
    current into its pin, and the response of a body's frame is the force on the frame. If a voltage
    drives a pin that belongs to neither an electrode nor a frame, the response is the flow through
    this pin. All names of the instance end with ``tag``.
    """
    ends = {port.terminals[0].lower() for port in model.ports}
    nodes = {}
    for pin in library.pins:
        key = pin.name.lower()
        nodes[key] = f"{pin.name}{tag}" if key in ends else "0"
    cards, result = [Element.from_words(f"X{library.name}{tag}", *nodes.values(), library.name)], {}
    one = 1.0 if load.domain is None else load.domain.get_quantity(load.domain.input_side).factor
    for port in model.ports:
        node, size = nodes[port.terminals[0].lower()], ("AC", "1") if port == load else ()
        if port.domain is not None and port.is_flow_driven:
            drive = Element.from_words(f"I{node}", "0", node, "DC", "0", *size)
            cards += [drive.with_unit(port.domain.find_value_unit("I"))] if size else []
            result[port.name] = (f"v({node})", port.domain.across.factor / one)
        elif port.kind == "output":
            result[port.name] = (f"v({node})", 1.0 / one)
        else:
            drive = Element.from_words(f"V{node}", node, "0", "DC", "0", *size)
            cards.append(drive.with_unit(port.domain.find_value_unit("V") if port.domain else ""))
            if port.domain is not None:
                flow = port.domain.through_variable.factor
                result[port.name] = (f"i(v{node.lower()})", -flow / one)
    return cards, result
