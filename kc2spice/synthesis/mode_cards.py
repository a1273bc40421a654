"""Netlist cards of decoupled resonators, and of the heat flows from their losses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from kc2spice.core.domains import ELECTRICAL, ROTATION, TRANSLATION
from kc2spice.core.si_prefix_format import PREFIXES, get_prefix_exponent
from kc2spice.netlist.circuit import Element
from kc2spice.netlist.number_and_name_spelling import format_number
from kc2spice.netlist.scale_factors import abbreviate_number
from kc2spice.netlist.shared_cards import Line
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.modal_models import Resonators
from kc2spice.synthesis.circuit_error import MICRO
from kc2spice.synthesis.heat_sources import (
    write_heat_meter,
    write_inertial_mode_loss_card,
    write_massless_mode_loss_card,
)
from kc2spice.synthesis.terminals import (
    OUTWARDS_COMMENT,
    OutputSourceWriter,
    PortTerminal,
    StateNodes,
    Transconductance,
    Value,
    connect_sources,
    has_other_reference,
    list_port_domains,
    write_port_cards,
)

if TYPE_CHECKING:
    pass


# Capacitance [F] for each state of a fast mode.
# The capacitance converts the simulator's charge tolerance chgtol to a displacement tolerance.
STATE_CAPACITANCE = 1e-6
STATE_CONDUCTANCE = 1.0  # conductance [S] from the node of a massless mode to the reference node
EQUAL_GAIN_TOLERANCE = 1e-6  # largest relative difference of gains that count as equal
# Value of 1 / Q of a mode below which the states are q and q + q'/w instead of q and q'/w.
# With the states q and q'/w, ngspice (pivrel 1e-3) chooses no diagonal pivots at an operating
# point.
# Without diagonal pivots, the factorised matrix of 178 modes would have 80 times as many fill-ins.
# Without diagonal pivots, the solution for 178 modes would take 100 times as long.
# The test tests/spice/test_realize.py counts the fill-ins.
LIGHT_DAMPING = 1e-3
# Contributions of a mode to the response of a port are negligible below NEGLIGIBLE_GAIN.
# NEGLIGIBLE_GAIN is relative to the largest contribution of all modes.
NEGLIGIBLE_GAIN = 1e-9


@dataclass(frozen=True)
class StepWeights:
    """Weights of the modes of a body in the simulator's time step control.

    The charge error of each capacitor represents an error of the motion, and time step control
    limits this charge error. Modes at or above ``full`` times the lowest mode frequency have
    capacitors of 1 uF. For slower modes, the capacitance is proportional to the frequency raised to
    ``power``. In the netlist, a capacitor represents the fraction ``share`` of the clamped
    capacitance of an electrical port. The charge that the modes generate changes the voltage of the
    capacitor. Therefore, time step control also limits the error of the generated charge.
    """

    full: float
    power: int
    share: float

    def compute_capacitances(self, omega: np.ndarray, slowest: float) -> np.ndarray:
        """Return the netlist capacitance [F] of each mode from its frequency [rad/s].

        ``slowest`` is the lowest mode frequency [rad/s] of the body.
        """
        return STATE_CAPACITANCE * np.minimum(1.0, (omega / (self.full * slowest)) ** self.power)


# Weights of a body's modes in time step control, if the results include the body's ringing.
RINGING_WEIGHTS = StepWeights(3.0, 2, 0.01)
# Weights of a body's modes in time step control, if the body throws another part.
# THROWING_WEIGHTS give the same launch velocity as RINGING_WEIGHTS, with fewer time points.
THROWING_WEIGHTS = StepWeights(3.0, 6, 0.01)
# Weights of a body's modes in time step control, if only the motion of thrown parts is a result.
# COARSE_WEIGHTS halve the number of time points.
COARSE_WEIGHTS = StepWeights(8.0, 6, 1e-6)
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
* Modes with a Q above {quality:g} use the state p = q + q'/omega: no diagonal pivot is zero."""


def write_resonators(
    model: Resonators,
    rom: LinearModel,
    terminals: list[PortTerminal],
    base: str,
    weights: StepWeights,
    noise: bool,
) -> tuple[list[str], list[Line]]:
    """Return comments and the cards of the resonators in modal coordinates.

    Mode j has the equation ``z_j'' + d_j z_j' + w_j^2 z_j = sum_k g_jk u_k``. With the largest gain
    ``s_j = max_k |g_jk|`` at the mechanical ports, the states are ``q_j = s_j z_j`` and ``p_j =
    q_j' / w_j`` in um. In a model without mechanical ports, the states are in uC. The cards
    represent the equations::

        C q' = C w p,    C p' = -C w q - C d p + (C s / w) sum_k g_k u_k

    The default ``weights`` give ``C = 1 uF min(1, (w / (3 w_1))^2)`` with the lowest angular
    frequency w_1 of all modes with inertia. Time step control limits the charge error, which is
    ``C`` times the displacement error. A mode with a small capacitance hardly limits the time
    steps. Slow modes hardly affect a contact, but continue to ring after the contact has ended.
    Therefore, slow modes have small capacitances, so that their ringing hardly limits the time
    steps. If 1 / Q is below :data:`LIGHT_DAMPING`, ``p_j = q_j + q_j' / w_j``, see
    :func:`_write_mode`. A mode without inertia has only the state q with ``C q' = -G q + (G s /
    w^2) sum_k g_k u_k`` and ``C = G d / w^2``.
    """
    order = order_observable_modes(model)
    omega, damp, gain = model.omega[order], model.damp[order], model.gain[order]
    heavy = model.inertia[order] > 0
    scale = find_largest_gains(gain, terminals)[:, None]
    numbers = range(1, len(order) + 1)
    turn = omega * heavy  # zero for modes without inertia, which have no velocity node
    light, losses = (damp < LIGHT_DAMPING * omega) * heavy, damp * heavy
    rates = (-turn * light, turn, -turn - (turn - losses) * light, turn * light - losses)
    qq, qp, pq, pp = map(np.diag, rates)
    drive = heavy[:, None] * scale * gain / (omega[:, None] * MICRO)
    micro_per_unit = MICRO / np.array(list(map(attrgetter("output_value_per_volt"), terminals)))
    states = StateNodes(
        [*map("q{}".format, numbers), *map("p{}".format, numbers)],
        [*map(str, numbers), *map("d{}".format, numbers)],
        np.block([[qq, qp], [pq, pp]]),
        np.vstack([np.zeros_like(drive), drive]),
        np.hstack([(gain / scale).T * micro_per_unit[:, None], np.zeros_like(gain.T)]),
    )
    farad = weights.compute_capacitances(omega, omega[heavy].min(initial=np.inf))
    siemens = np.where(heavy, farad * omega, STATE_CONDUCTANCE)
    force = siemens * scale[:, 0] / (omega**2 * MICRO)
    drive = force[:, None] * gain
    about = _describe_resonators(terminals, base, weights)
    if light.any():
        about += _LIGHT_DAMPING_COMMENT.format(quality=1 / LIGHT_DAMPING).split("\n")
    laws = OutputSourceWriter(terminals, states, rom.D, rom, base)
    body: list[Line] = []
    stored = []
    for t in map(laws.connect_output, terminals):
        # the sources of the charge of a clamped port are added below
        stored.append(replace(t, sums=()) if t.clamped else t)
    body += write_port_cards(stored, base, weights.share)
    for j in range(len(order)):
        node = f"p{j + 1}" if heavy[j] else f"q{j + 1}"
        if heavy[j]:
            branch = describe_branch(damp[j], omega[j], gain[j], gain, terminals)
            body.append(f"\n* Mode {j + 1}: {describe_mode(omega[j], damp[j])}{branch}")
            body += _write_mode(j + 1, omega[j], damp[j], farad[j], base)
        else:
            body += _write_massless_mode(j + 1, omega[j], damp[j], base)
        body += connect_sources(make_mode_sources(j + 1, drive[j], terminals, base), base, node)
        if noise and damp[j] > 0:
            loss = f"{{damping*{format_number(damp[j])}}}"
            body.append(Element.from_words(f"Rnoise{j + 1}", f"noise{j + 1}", base, loss))
            body.append(
                Element.from_words(f"Gn{j + 1}", base, node, f"noise{j + 1}", base, force[j])
            )
        for k, t in enumerate(terminals):
            if t.clamped:
                charge = gain[j, k] / scale[j, 0] * MICRO / t.output_value_per_volt  # uC per um
                source = Transconductance(f"Gc{j + 1}{t.tag}", f"q{j + 1}", base, charge)
                body.append(source.write_element(base, f"charge{t.tag}"))
    return about, body


def write_losses(model: Resonators, terminals: Sequence[PortTerminal], base: str) -> Iterator[Line]:
    """Yield the ammeter at the heat pin, and the heat sources of lossy modes.

    :func:`write_resonators` defines the symbols. A mode with inertia has the velocity ``z' = w p /
    s`` and dissipates the power ``d z'^2``. A mode without inertia dissipates the power ``(w^2 /
    s)^2 (f - q)^2 / d`` with the drive ``f = (s / w^2) sum_k g_k u_k``.
    """
    order = order_observable_modes(model)
    omega, damp, gain = model.omega[order], model.damp[order], model.gain[order]
    size = MICRO / find_largest_gains(gain, terminals)
    yield from write_heat_meter()
    for j in np.flatnonzero(damp > 0).tolist():
        index, q, p = j + 1, f"q{j + 1}", f"p{j + 1}"
        w, d, unit = map(float, (omega[j], damp[j], size[j]))
        if model.inertia[order[j]] > 0:
            velocity = (p, q) if d < LIGHT_DAMPING * w else (p, base)
            yield write_inertial_mode_loss_card(index, velocity, d * (w * unit) ** 2)
            continue
        row = STATE_CONDUCTANCE * gain[j] / (unit * w**2)
        sources = make_mode_sources(index, row, terminals, base)
        drives = [(float(g.value), g.plus, g.minus) for g in sources if g.value]
        yield write_massless_mode_loss_card(index, drives, (q, base), (w**2 * unit) ** 2 / d)


def _describe_resonators(
    terminals: Sequence[PortTerminal], base: str, weights: StepWeights
) -> list[str]:
    """Return netlist comments that describe the resonators and the reference pin."""
    words: dict[str, Any] = {
        "full": weights.full,
        "power": weights.power,
        "silent": NEGLIGIBLE_GAIN,
    }
    words["answer"] = "displacement of a port in um"
    words["reference"] = "The base is the mechanical and signal reference"
    lines = list(OUTWARDS_COMMENT)
    domains = list_port_domains(map(attrgetter("port"), terminals))
    if has_other_reference(domains):
        units = dict.fromkeys(map(attrgetter("output_unit"), domains))
        words["answer"] = f"response of a port in 1e-6 {' or '.join(units)}"
        words["reference"] = f"{base} is the reference of all non-electrical pins"
        lines = []
    return [*lines, *_RESONATORS_COMMENT.format(**words).split("\n")]


def _write_mode(j: int, omega: float, damp: float, farad: float, base: str) -> Iterator[Line]:
    """Yield the cards of the two integrators of one mode.

    If 1 / Q is below :data:`LIGHT_DAMPING`, the second state is ``p = q + q' / w``. With this
    second state, the voltage from node p to node q is the velocity.
    """
    q, p, turn, loss = f"q{j}", f"p{j}", farad * omega, farad * damp
    light = damp < LIGHT_DAMPING * omega
    velocity = (p, q) if light else (p, base)
    yield Element.from_words(f"Cq{j}", q, base, farad)
    yield Element.from_words(f"Cp{j}", p, base, farad)
    yield Element.from_words(f"Gq{j}", base, q, *velocity, turn)
    yield Element.from_words(f"Gp{j}", p, base, q, base, turn)
    if light:
        yield Element.from_words(f"Gs{j}", base, p, *velocity, turn)
    if loss > 0:
        yield Element.from_words(f"Gd{j}", p, base, *velocity, f"{{damping*{format_number(loss)}}}")


def describe_mode(omega: float, damp: float) -> str:
    """Return a mode's frequency and Q factor as text for a netlist comment.

    ``omega`` is the angular frequency [rad/s] of the mode, ``damp`` its damping [1/s].

    Examples
    --------
    >>> describe_mode(2 * np.pi * 41.2e3, 2 * np.pi * 824.0)
    '41.2 kHz, Q 50'
    """
    hertz = omega / (2 * np.pi)
    power = get_prefix_exponent(hertz)
    quality = f"Q {omega / damp:.4g}" if damp > 0 else "undamped"
    return f"{hertz / 10.0**power:.6g} {PREFIXES[power]}Hz, {quality}"


def describe_branch(
    damp: float,
    omega: float,
    gain: np.ndarray,
    gains: np.ndarray,
    terminals: Sequence[PortTerminal],
) -> str:
    """Describe a mode's equivalent circuit at a port, for a netlist comment.

    The mode has the equation ``z'' + damp z' + omega^2 z = g v``, and contributes ``g z`` to the
    charge or displacement of the port. At an electrical port, the mode is equivalent to L = 1/g^2,
    R = damp/g^2 and C = g^2/omega^2 in series. At a mechanical port, the mode is equivalent to the
    mass m = 1/g^2, the damper c = damp/g^2 and the spring k = omega^2/g^2. The text is empty if
    every gain of the mode is a rounding error, compared with the largest of the ``gains`` of all
    modes.
    """
    size = np.abs(gain)
    size = np.where(size > NEGLIGIBLE_GAIN * np.abs(gains).max(axis=0), size, 0.0)
    for domains in ((ELECTRICAL,), (TRANSLATION, ROTATION)):
        shares = size * [t.port.domain in domains for t in terminals]
        if not shares.any():
            continue
        port = int(np.argmax(shares >= shares.max() * (1 - EQUAL_GAIN_TOLERANCE)))
        m, c, k = map(float, np.array([1.0, damp, omega**2]) / shares[port] ** 2)
        if ELECTRICAL in domains:
            elements = (
                f"L={abbreviate_number(m)} C={abbreviate_number(1 / k)} R={abbreviate_number(c)}"
            )
        else:
            elements = f"m={abbreviate_number(m)} c={abbreviate_number(c)} k={abbreviate_number(k)}"
        return f", {elements} at {terminals[port].pins[0]}"
    return ""


def _write_massless_mode(j: int, omega: float, damp: float, base: str) -> Iterator[Line]:
    """Yield the cards of a mode that has no mass."""
    hertz, time = omega / (2 * np.pi), damp / omega**2
    yield f"\n* Massless mode {j}, {hertz:.6g} Hz: relaxes with a time constant of {time:.6g} s"
    if time > 0:
        yield Element.from_words(
            f"Cq{j}", f"q{j}", base, f"{{damping*{format_number(STATE_CONDUCTANCE * time)}}}"
        )
    yield Element.from_words(f"Gq{j}", f"q{j}", base, f"q{j}", base, STATE_CONDUCTANCE)


def find_largest_gains(gain: np.ndarray, terminals: Sequence[PortTerminal]) -> np.ndarray:
    """Return the largest gain of each mode at the displacement ports.

    For a mode without gain at the displacement ports, the largest gain at all ports is returned.
    """
    mechanical = [t.port.domain is TRANSLATION for t in terminals]
    scale = np.abs(gain[:, mechanical]).max(axis=1, initial=0.0)
    scale = np.where(scale > 0, scale, np.abs(gain).max(axis=1))
    return np.where(scale > 0, scale, 1.0)


def make_mode_sources(
    index: int,
    row: np.ndarray | Sequence[Value],
    terminals: Sequence[PortTerminal],
    base: str,
) -> list[Transconductance]:
    """Return the sources by which forces, voltages and accelerations drive a mode.

    ``row`` contains the weights of the port inputs, and ``index`` the number of the mode.
    """
    result = []
    for t in sorted(terminals, key=lambda t: "fvs".index(t.source_letter)):
        suffix = f"{index}{t.tag}" if t.port.is_paired else f"{t.pins[0]}_{index}"
        result.append(t.make_weighted_source(f"G{t.source_letter}{suffix}", row, base))
    return result


def order_observable_modes(model: Resonators) -> np.ndarray:
    """Return the indices of the observable modes, sorted by frequency.

    Modes without inertia are last. Modes that no port drives or observes are omitted, because the
    gains of such modes are rounding errors.
    """
    share = np.abs(model.gain) / model.omega[:, None]
    share /= share.max(axis=0, initial=0.0, keepdims=True) + np.finfo(float).tiny
    observable = share.max(axis=1, initial=0.0) > NEGLIGIBLE_GAIN
    order = np.lexsort((model.omega, model.inertia == 0.0))
    return order[observable[order]] if observable.any() else order
