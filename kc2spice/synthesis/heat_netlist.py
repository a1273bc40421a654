"""Netlist cards of heat models: resistors, capacitors and ideal transformers.

The model is ``E x' + K x = B q``, ``T = B' x + D q``. E and K are symmetric without negative
eigenvalues. In modal coordinates h, the model is

    C_j h_j' + h_j / R_j = sum_k a_kj q_k,    T_k = sum_j a_kj h_j + sum_l D_kl q_l

with the heat flows ``q`` [W] into the ports and the temperature rises ``T`` [K] of the ports over
the pin ``ambient``. Every mode j is a thermal resistance R_j in parallel with a heat capacity C_j.
The modes are scaled so that the largest ``|a_kj|`` of each mode is one. For a model with one port,
the modes are connected in series (Foster's form). For several ports, the factors a_kj multiply heat
flows and temperatures as ideal transformers do. The circuit is passive for all positive R_j and
C_j. A model with the matrices of :class:`kc2spice.rom.heat_network.HeatLadder` becomes a ladder
(Cauer's form). (E. Kuh and R. Rohrer, Theory of Linear Active Networks, 1967, chapter 6.)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np
import scipy

from kc2spice.core.domains import THERMAL
from kc2spice.core.errors import UsageError
from kc2spice.netlist.circuit import Element
from kc2spice.netlist.number_and_name_spelling import LEAK_RATE
from kc2spice.netlist.shared_cards import Line
from kc2spice.rom.heat_network import HeatLadder, find_heat_ladder
from kc2spice.rom.linear_model import LinearModel, Port

# An eigenvalue of K counts as zero up to this fraction of the largest eigenvalue.
# The heat of a mode with a zero eigenvalue is not conducted away.
# In the netlist, only a leak resistance removes the heat of a mode with a zero eigenvalue.
ZERO_EIGENVALUE = 1e-13
# A time constant counts as zero up to this fraction of the largest time constant of all modes.
# A mode with a zero time constant has no heat capacity.
ZERO_TIME = 1e-14
# A mode's factor at a port counts as zero up to this fraction of the largest of all factors.
# A mode whose factors at all ports are zero is omitted.
ZERO_SHARE = 1e-9
_NETWORK_COMMENT = """\
* Thermal network: 1 V from a pin to {base} is a temperature rise of 1 K, 1 A into the pin is 1 W.
* Connect {base} to node 0, or to a source whose voltage is the ambient temperature.
* Resistances [K/W] and heat capacities [J/K] are positive: the network is passive."""
_MODES_COMMENT = "* Every mode is a thermal resistance in parallel with a heat capacity."
_SERIES_COMMENT = "* The modes of the port are in series (Foster's form)."
_COUPLED_COMMENT = """\
* Ideal transformers connect ports and modes: V(h1) times a factor adds to the temperature of the
* port, and the heat flow times this factor flows into the node h1. The voltage of the node fPIN is
* the heat flow into the pin PIN: 1 V on this node is 1 W."""
_LADDER_COMMENT = """\
* Cauer ladder: each heat capacity connects a node to {base}. Resistances and heat capacities, each
* summed from the port inwards, form the structure function."""
_STORED_COMMENT = "no heat path to ambient; its resistor is a leak that sets the DC operating point"


@dataclass(frozen=True, eq=False)
class HeatModes:
    """Modes of a heat model, with their thermal resistances and heat capacities.

    ``resistance`` and ``capacity`` contain the thermal resistance [K/W] and the heat capacity [J/K]
    of each mode. ``share[j, k]`` is the contribution of mode j to the temperature of port k,
    relative to the temperature of the mode. ``direct`` is the matrix D of the model. A heat flow
    into port k raises the temperature of port j without delay by ``direct[j, k]`` [K/W] times the
    heat flow.
    """

    resistance: np.ndarray
    capacity: np.ndarray
    share: np.ndarray
    direct: np.ndarray
    ports: tuple[Port, ...]


def estimate_leak_share(model: LinearModel) -> float:
    """Return the largest share of heat flow through the leak of an insulated body.

    The share is the relative temperature error that the leak causes. If a body has no heat path to
    a reference temperature, its netlist contains a leakage conductance ``C * LEAK_RATE`` in
    parallel with each heat capacity C. If one of two ports has a prescribed temperature, the leak
    takes the share ``R C LEAK_RATE`` of the heat flow between the ports. R is the thermal
    resistance between the ports, and C the heat capacity of the body. The function computes the
    share of the leak for each pair of ports, and returns the largest value.
    """
    K, E = model.pencil.make_dense().coefficients
    values, vectors = np.linalg.eigh(0.5 * (K + K.T))
    rises = model.B.T @ vectors[:, 0]
    if values[0] > ZERO_EIGENVALUE * values[-1] or not np.abs(rises).min() > 0:
        return 0.0
    even = vectors[:, 0] / rises.mean()
    apart = model.B[:, :, None] - model.B[:, None, :]
    parts = np.einsum("ij,ikl->jkl", vectors[:, 1:], apart)
    resistance = np.einsum("jkl,j->kl", parts**2, 1 / values[1:]).max(initial=0.0)
    return float(LEAK_RATE * (even @ E @ even) * resistance)


def is_heat_model(model: LinearModel) -> bool:
    """Return whether a model has thermal ports."""
    return THERMAL in map(attrgetter("domain"), model.ports)


def compute_heat_modes(model: LinearModel) -> HeatModes:
    """Return the modes of a heat model that its ports excite, slowest mode first.

    The mode shapes x satisfy ``E x = t K x`` with the time constants t. If K is singular, no path
    conducts the heat of some modes away. For a mode without a heat path, the thermal resistance is
    not infinite, but the resistance of a leak that the netlist contains.

    Raises
    ------
    UsageError : E, K or D is not symmetric and positive semi-definite, or E and K have a common
        null space.
    """
    times, shapes = decouple_heat(model)
    gain = shapes.T @ model.B
    size = np.abs(gain).max(axis=1)
    felt = (np.abs(gain) / (np.abs(gain).max(axis=0) + np.finfo(float).tiny)).max(
        axis=1
    ) > ZERO_SHARE
    gain, times, size = gain[felt], times[felt], size[felt]
    sign = np.sign(gain[np.arange(len(gain)), np.abs(gain).argmax(axis=1)])
    return HeatModes(
        resistance=size**2,
        capacity=times / size**2,
        share=gain * (sign / size)[:, None],
        direct=model.D,
        ports=model.ports,
    )


def decouple_heat(model: LinearModel) -> tuple[np.ndarray, np.ndarray]:
    """Compute the time constants [s] and mode shapes of a heat model, slowest first.

    The array of shapes has one row for each state and one column for each mode. The mode shapes are
    scaled so that the thermal resistance of each mode is 1 K/W. See :func:`compute_heat_modes`.

    Raises
    ------
    UsageError : as in :func:`compute_heat_modes`.
    """
    K, E = model.pencil.make_dense().coefficients
    if not model.symmetric:
        raise _make_not_passive_error(
            model,
            "matrices that are not symmetric, such as those of heat transport by a flow",
            'for each heat input, write a port of kind = "input" with its column of the matrix B, '
            'and for each temperature, a port of kind = "output" with its row of the matrix C',
        )
    if np.linalg.eigvalsh(model.D).min(initial=0.0) < 0:
        raise _make_not_passive_error(model, "a matrix D with a negative eigenvalue")
    K, E = 0.5 * (K + K.T), 0.5 * (E + E.T)
    for size in map(np.linalg.eigvalsh, (K, E)):
        if size[0] < -ZERO_EIGENVALUE * np.abs(size).max():
            raise _make_not_passive_error(model, "a matrix E or K with a negative eigenvalue")
    stored, conducted = _separate_stored_heat(E, K)
    capacity = np.linalg.eigvalsh(stored.T @ E @ stored)
    if capacity.size and capacity[0] <= ZERO_EIGENVALUE * np.abs(E).max():
        raise _make_not_passive_error(model, "a matrix E and a matrix K that are both singular")
    shapes = conducted
    # the loop runs twice, so that the shapes are orthonormal even if K is almost singular
    for _ in range(2):
        times, turned = scipy.linalg.eigh(shapes.T @ E @ shapes, shapes.T @ K @ shapes)
        shapes = shapes @ turned
    times = np.where(times > ZERO_TIME * times.max(initial=0.0), times, 0.0)
    if stored.size:
        capacity, axes = np.linalg.eigh(stored.T @ E @ stored)
        leaking = stored @ axes / np.sqrt(capacity * LEAK_RATE)
        times = np.concatenate([times, np.full(capacity.size, 1 / LEAK_RATE)])
        shapes = np.hstack([shapes, leaking])
    return times[::-1], shapes[:, ::-1]


def diagonalise_heat_model(model: LinearModel) -> LinearModel:
    """Return a heat model in the modal coordinates of its netlist.

    The matrices E and K of the returned model are diagonal. With diagonal matrices, modes whose
    rates differ by many orders of magnitude cause no rounding errors in each other.
    """
    modes = compute_heat_modes(model)
    return replace(
        LinearModel(
            E=np.diag(modes.capacity),
            K=np.diag(1 / modes.resistance),
            B=modes.share,
            D=modes.direct,
            ports=modes.ports,
        ),
        certificate=model.certificate,
        facts=model.facts,
        name=model.name,
        band=model.band,
    )


def _separate_stored_heat(E: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split temperature patterns into those that only store heat and the others.

    The first returned basis spans the null space of K. The second returned basis spans the
    E-orthogonal complement of the null space of K. The modes in one subspace are therefore
    independent of the modes in the other subspace.
    """
    scale = np.sqrt(np.maximum(np.diag(K), 0.0))
    scale = 1 / np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(scale[:, None] * K * scale)
    vectors = scale[:, None] * vectors
    null = values <= ZERO_EIGENVALUE * max(values[-1], 0.0)
    stored, conducted = vectors[:, null], vectors[:, ~null]
    if stored.size:
        heat = stored.T @ E
        conducted = (
            conducted - stored @ np.linalg.lstsq(heat @ stored, heat @ conducted, rcond=None)[0]
        )
    return stored, conducted


def _make_not_passive_error(model: LinearModel, got: str, hint: str = "") -> UsageError:
    """Make the error about a heat model that is not a passive network."""
    return UsageError(
        "this model is not a passive heat model",
        where=model.name,
        got=got,
        expected="E dx/dt + K x = B q, y = B^T x + D q, with symmetric E, K and D without "
        "negative eigenvalues",
        hint=hint or "E contains heat capacities, K thermal conductances; check their signs",
    )


def write_heat_model(model: LinearModel, base: str) -> tuple[list[str], list[Line]]:
    """Return the netlist comments and the cards of a heat model.

    The cards form a network between the ports of the model and the node ``base``. If the model has
    the matrices of a ladder (Cauer's form), the network is this ladder; otherwise, the network
    consists of modes.
    """
    about = _NETWORK_COMMENT.format(base=base).split("\n")
    ladder = find_heat_ladder(model)
    if ladder is not None:
        cards = list(_write_ladder_cards(ladder, model.ports[0].terminals[0], base))
        return [*about, *_LADDER_COMMENT.format(base=base).split("\n")], cards
    modes, one = compute_heat_modes(model), len(model.ports) == 1
    about += [_MODES_COMMENT, *(_SERIES_COMMENT if one else _COUPLED_COMMENT).split("\n")]
    return about, list(
        _write_series_cards(modes, base) if one else _write_coupled_cards(modes, base)
    )


def _write_ladder_cards(ladder: HeatLadder, pin: str, base: str) -> Iterator[Line]:
    """Yield the cards of a ladder (Cauer's form) from a pin to ``base``."""
    node, count = pin, len(ladder.capacity)
    if ladder.direct > 0:
        yield f"\n* Thermal resistance before the first heat capacity: {ladder.direct:.4g} K/W"
        yield Element.from_words("Rdirect", pin, "h1", ladder.direct)
        node = "h1"
    depth = ladder.direct + np.cumsum(ladder.resistance)
    content = np.cumsum(ladder.capacity)
    for j, (R, C) in enumerate(zip(ladder.resistance, ladder.capacity, strict=True)):
        following = base if j == count - 1 else f"h{j + 2}"
        yield f"\n* Cumulative from the port: {depth[j]:.4g} K/W, {content[j]:.4g} J/K"
        yield Element.from_words(f"C{j + 1}", node, base, float(C))
        yield Element.from_words(f"R{j + 1}", node, following, float(R))
        node = following


def describe_heat_mode(modes: HeatModes, j: int) -> str:
    """Return the netlist comment that precedes the elements of one mode."""
    R, C = modes.resistance[j], modes.capacity[j]
    text = f"time constant {R * C:.4g} s, {R:.4g} K/W, {C:.4g} J/K"
    if R * C * LEAK_RATE >= 1 - ZERO_EIGENVALUE:
        text = f"{C:.4g} J/K: {_STORED_COMMENT}"
    return f"\n* Mode {j + 1}: {text}"


def _write_mode_elements(modes: HeatModes, j: int, node: str, other: str) -> Iterator[Line]:
    """Yield the resistor and the capacitor of one mode between two nodes."""
    yield Element.from_words(f"R{j + 1}", node, other, float(modes.resistance[j]))
    if modes.capacity[j] > 0:
        yield Element.from_words(f"C{j + 1}", node, other, float(modes.capacity[j]))


def _write_series_cards(modes: HeatModes, base: str) -> Iterator[Line]:
    """Yield the cards of a model with one port: modes in series (Foster's form)."""
    node, count = modes.ports[0].terminals[0], len(modes.resistance)
    if (direct := float(modes.direct[0, 0])) > 0:
        yield f"\n* Thermal resistance without a heat capacity: {direct:.4g} K/W"
        yield Element.from_words("Rdirect", node, "h1", direct)
        node = "h1"
    for j in range(count):
        following = base if j == count - 1 else f"h{j + 2}"
        yield describe_heat_mode(modes, j)
        yield from _write_mode_elements(modes, j, node, following)
        node = following


def _write_coupled_cards(modes: HeatModes, base: str) -> Iterator[Line]:
    """Yield the cards of a model with several ports: modes with ideal transformers."""
    yield from write_heat_port_cards(modes, base)
    for j in range(len(modes.share)):
        yield describe_heat_mode(modes, j)
        yield from _write_mode_elements(modes, j, f"h{j + 1}", base)
        yield from write_heat_flows(modes, j, base)


def write_heat_port_cards(modes: HeatModes, base: str) -> Iterator[Line]:
    """Yield the cards that sum the temperatures of the modes at each port."""
    names = [port.terminals[0] for port in modes.ports]
    for k, pin in enumerate(names):
        yield f"\n* Port {pin}: its temperature rise u is the sum of the modes (1 V = 1 K)."
        yield Element.from_words(f"Ru{pin}", f"u{pin}", base, "1")
        yield Element.from_words(f"Gf{pin}", base, f"f{pin}", pin, f"u{pin}", "1")
        yield Element.from_words(f"Gp{pin}", pin, base, f"f{pin}", base, "1")
        for j, share in enumerate(modes.share[:, k], 1):
            yield Element.from_words(f"Gu{pin}_{j}", base, f"u{pin}", f"h{j}", base, float(share))
        for other, direct in zip(names, modes.direct[k], strict=True):
            if direct:
                name = f"Gd{pin}_{other}"
                yield Element.from_words(name, base, f"u{pin}", f"f{other}", base, float(direct))


def write_heat_flows(modes: HeatModes, j: int, base: str) -> Iterator[Line]:
    """Yield the sources of the heat flows from all ports into one mode."""
    for port, share in zip(modes.ports, modes.share[j], strict=True):
        pin = port.terminals[0]
        yield Element.from_words(
            f"Gq{pin}_{j + 1}", base, f"h{j + 1}", f"f{pin}", base, float(share)
        )
