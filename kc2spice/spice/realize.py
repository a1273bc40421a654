"""Linear models to subcircuits: decoupled resonators where there are, else state blocks."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.netlist.cards import distinct
from kc2spice.netlist.cards import name as checked_name
from kc2spice.netlist.circuit import Param, Pin, Subcircuit
from kc2spice.netlist.render import render
from kc2spice.rom.linear import LinearModel, Port
from kc2spice.rom.modal import Resonators, resonators
from kc2spice.spice.header import OUTWARDS, Header, parameter_list, part_header, rom_line

if TYPE_CHECKING:
    from kc2spice.rom.blocks import BlockModel

MICRO = 1e-6  # 1 V on a displacement pin is 1 um, 1 V on a charge node 1 uC
STATE = 1e-6  # farad of a fast state: one chgtol is then one tolerance of displacement
SIEMENS = 1.0  # of a state without inertia; its capacitance is its relaxation time
SILENT = 1e-9  # of the largest share of a mode in every port; such modes move no port
LEAK = 1e-12  # S; the charge of a floating anode decays in hours
# A block whose smallest singular value is this far below the band integrates constant inputs.
FREE = 1e-11
# Cross terms of D this far below the diagonal are rounding.
CROSS = 1e-13
JUMP = 1e-9  # of C B by its summands: a rate that jumps with an input; less is rounding
_INNER = r"tick|(inner|current|charge)\w*|sum\d+|[qpz]\d+"  # nodes of the templates
_MOVING = ("mechanical", "rotational")
_DRIVES = {"mechanical": "f", "rotational": "f", "electrical": "v", "acceleration": "s"}


@dataclass(frozen=True)
class Watch:
    """What step control sees of a body: an error of charge is its error of motion, see kick.j2.

    Modes below ``full`` times the lowest frequency sit on less than a microfarad by the ``power``
    of their frequency; a ``share`` of the clamped capacitance is one, whose charge is the modes'.
    """

    full: float
    power: int
    share: float


FOLLOWED = Watch(3.0, 2, 0.01)  # the body's own ringing is a result
STRIKING = Watch(3.0, 6, 0.01)  # until it has struck: a quarter fewer points at an equal launch
COARSE = Watch(8.0, 6, 1e-6)  # only what a contact throws is: half the time points
UNRATED = "not known; keep field and stress within the limits of its materials"


@dataclass(frozen=True)
class _Card:
    """One controlled source: ``value`` amperes per volt between ``plus`` and ``minus``."""

    label: str
    plus: str
    minus: str
    value: float


@dataclass(frozen=True)
class _Terminal:
    """A port as the templates see it: ``column`` of B and ``row`` of C, ``clamped`` farad.

    ``sums`` are its output by states, ``through`` by the inputs of ports.
    """

    port: Port
    pins: tuple[str, ...]
    tag: str
    column: int | None
    row: int | None
    clamped: float
    sums: tuple[_Card, ...] = ()
    through: tuple[_Card, ...] = ()

    @property
    def kind(self) -> str:
        """That of its port."""
        return self.port.kind

    @property
    def label(self) -> str:
        """The name of its port."""
        return self.port.name

    @property
    def unit(self) -> float:
        """SI value of 1 V on the node that sums its output."""
        return MICRO if self.kind in ("mechanical", "electrical") else 1.0

    def control(self, base: str) -> tuple[str, str]:
        """The nodes between which the port's input in SI is a voltage."""
        if self.kind == "electrical":
            return self.pins[0], self.pins[1]
        return (f"f{self.pins[0]}" if self.kind in _MOVING else self.pins[0]), base

    def driven(self, label: str, row: np.ndarray, base: str) -> _Card:
        """The card of its input, whose weight stands in a ``row`` of inputs."""
        return _Card(label, *self.control(base), float(row[self.column or 0]))


@dataclass(frozen=True)
class _States:
    """``z' = A z + B u``, ``y = C z + D u``: each state a voltage on its node; y in volts of the
    ports' sum nodes."""

    nodes: Sequence[str]
    labels: Sequence[str]
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray

    def cards(self, row: np.ndarray, base: str) -> tuple[_Card, ...]:
        """The sum of states with the weights ``row``."""
        return tuple(
            _Card(label, node, base, float(value))
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
    watch: Watch = FOLLOWED,
) -> Subcircuit:
    """One ``.subckt`` with the pins of every port of ``rom``.

    Electrical ports are pairs of floating terminals and come first, then the other conservative
    ports, ``base`` (their reference) and the signal pins; a model of signals alone has ``ref``.
    A displacement or rotation pin is conservative: its value equals the sum over the states, and
    the force that holds it there drives them. An acceleration pin shakes the frame and draws the
    force that this takes. Port laws and passivity are those of the model.

    A symmetric definite model with modal damping becomes decoupled resonators, anything else
    blocks of coupled states (one block of all states if ``dense``).

    Parameters
    ----------
    name : of the subcircuit and its library file.
    header : origin; that of the model itself unless given.
    title, rating : what the device is and what it stands, for the head of the library.
    ports : names of the ports to bring out, all by default; the others see no load.
    watch : how closely step control follows the modes of the resonator form.

    Raises
    ------
    UsageError : an unknown port, a name that the subcircuit has for itself, a model without
        state-space form, capacitances between electrodes that no passive network has.
    """
    if header is None:
        digest = hashlib.sha256(rom.B.tobytes() + rom.C.tobytes() + rom.D.tobytes())
        header = Header(rom.name, digest.hexdigest()[:16])
    if ports is not None:
        rom = rom.select(list(ports))
    form = _form(rom, dense)
    terminals = _terminals(rom, form.D, name)
    pins, base = _pins(terminals)
    moved = (t.pins[0].lower() for t in terminals if t.kind in _MOVING)
    inner = "|".join([_INNER, *(f"[uf]{pin}" for pin in moved)])
    distinct([pin.name for pin in pins], inner, where=name)
    params: tuple[Param, ...] = ()
    if isinstance(form, Resonators):
        if np.any(form.damp > 0):
            params = (Param("damping", 1.0, "-", "scale of the damping of all modes"),)
        template, values = "kick.j2", _resonators(form, rom, terminals, base, watch)
    else:
        template, values = "rom.j2", _blocks(form, rom, terminals, base)
        if base == "ref":
            title = f"reduced linear model, {len(rom.inputs)} inputs, {len(rom.outputs)} outputs"
    certificate = rom.certificate
    band = f" up to {certificate.band_hz[1]:g} Hz" if certificate else ""
    text = render(
        template,
        header=part_header(
            header,
            f"{name}: {title}",
            pins,
            params,
            rom=rom_line(rom.order, certificate) if certificate else "",
            sign=OUTWARDS,
            rating=rating,
            validity=f"small signals{band} at the temperature of its data (20 to 25 C, of "
            "built-in materials); no hysteresis, depolarisation or heating",
        ),
        name=checked_name(name),
        pins=[pin.name for pin in pins],
        base=base,
        parameters=parameter_list(params),
        leak=LEAK,
        **values,
    )
    return Subcircuit(name, pins, params, text)


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
    if rom.first_order or not rom.symmetric or not all(port.conservative for port in rom.ports):
        return None
    try:
        found = resonators(rom)
    except UsageError as error:
        if error.where != "resonator form":
            raise
        return None
    rates = [
        port.kind == "acceleration" or (port.kind == "electrical" and own <= 0)
        for port, own in zip(rom.ports, np.diag(rom.D), strict=True)
    ]
    relaxing = np.abs(found.gain[found.inertia == 0.0][:, rates])
    return None if (relaxing > CROSS * np.abs(found.gain).max(initial=0.0)).any() else found


# ------------------------------------------------------------------------------- ports and pins


def _terminals(rom: LinearModel, D: np.ndarray, where: str) -> list[_Terminal]:
    several = sum(port.kind == "electrical" for port in rom.ports) > 1
    found, column, row = [], 0, 0
    for port in rom.ports:
        pins = tuple(checked_name(pin) for pin in port.terminals)
        electrical = port.kind == "electrical"
        if len(pins) != (2 if electrical else 1):
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
        clamped = float(D[out, into]) if electrical else 0.0
        if clamped < 0:
            raise UsageError("negative capacitance", where=where, got=port.name)
        tag = f"_{checked_name(port.name)}" if electrical and several else ""
        found.append(_Terminal(port, pins, tag, into, out, clamped))
    return found


def _pins(terminals: list[_Terminal]) -> tuple[tuple[Pin, ...], str]:
    """Electrical pairs, other conservative pins and the base; signals as they come, before ref."""

    def of(*kinds: str) -> list[Pin]:
        return [
            Pin(pin, t.port.across, t.port.flow if t.port.conservative else "-")
            for t in terminals
            if t.kind in kinds
            for pin in t.pins
        ]

    # electrical ports against one cathode share its pin
    electrical, signals = list(dict.fromkeys(of("electrical"))), of("input", "output")
    moving = of(*_MOVING, "acceleration")
    if not electrical and not moving:
        return (*signals, Pin("ref", "V", "A")), "ref"
    base = reference([t.port for t in terminals])
    return (*electrical, *moving, *signals, Pin(base, "um", "N")), base


def reference(ports: Sequence[Port]) -> str:
    """Name of the pin that displacements count from: ``base``, or ``ground`` if a port is that."""
    taken = {pin for port in ports for pin in port.terminals}
    return "ground" if "base" in taken else "base"


def _wired(
    terminals: list[_Terminal], states: _States, D: np.ndarray, rom: LinearModel, base: str
) -> list[_Terminal]:
    """The terminals with the cards of their outputs.

    Of y = C z + D u an electrical port without capacitance of its own needs the current
    y' = C A z + C B u, an acceleration the force m a - y'', y'' = C A^2 z + C A B u, where
    C B is zero, as of all that has inertia.

    Raises
    ------
    UsageError : an acceleration port that takes the rate of an input, an electrode without
        capacitance of its own that shares charge.
    """

    def through(row: np.ndarray) -> tuple[_Card, ...]:
        size = np.abs(row).max(initial=0.0)
        return tuple(
            t.driven(f"u{t.column + 1}", row, base)
            for t in terminals
            if t.column is not None and abs(row[t.column]) > CROSS * size
        )

    def wired(t: _Terminal) -> _Terminal:
        if t.row is None:
            return t
        row, direct = states.C[t.row], D[t.row] / t.unit
        rate = t.unit * row @ states.A
        if t.kind == "acceleration":
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
        if t.kind == "electrical":  # the clamped capacitance is a capacitor
            direct = np.where(np.abs(direct) > CROSS * np.abs(direct).max(), direct, 0.0)
            direct[t.column] = 0.0
            if direct.any() and not t.clamped:
                raise UsageError(
                    "an electrode without capacitance of its own shares charge with other ports",
                    where=t.label,
                    expected="a positive semi-definite D",
                )
            if not t.clamped:
                jumps = through(t.unit * row @ states.B)
                jumps = tuple(replace(card, label=f"t{card.label}") for card in jumps)
                return replace(t, sums=states.cards(rate, base) + jumps)
        return replace(t, sums=states.cards(row, base), through=through(direct))

    return [wired(t) for t in terminals]


# -------------------------------------------------------------------------------- resonators


def _resonators(
    model: Resonators, rom: LinearModel, terminals: list[_Terminal], base: str, watch: Watch
) -> dict[str, object]:
    """With ``z_j'' + d_j z_j' + w_j^2 z_j = sum_k g_jk u_k`` and ``s_j = max_k |g_jk|`` over the
    mechanical ports, the states are ``q_j = s_j z_j`` and ``p_j = q_j' / w_j`` in um (or, of a
    model without mechanical ports, in uC)::

        C q' = C w p,    C p' = -C w q - C d p + (C s / w) sum_k g_k u_k

    with ``C = 1 uF min(1, (w / 3 w_1)^2)`` or as ``watch`` says: step control sees an error of
    charge, ``C`` times that of the displacement, and slow modes decide nothing in a contact, but
    ring long after it.
    A state without inertia is q alone, ``C q' = -G q + (G s / w^2) sum_k g_k u_k`` with
    ``C = G d / w^2``.
    """
    kept = _observable(model)
    order = np.lexsort((kept.omega, kept.inertia == 0.0))
    omega, damp, gain = kept.omega[order], kept.damp[order], kept.gain[order]
    heavy = np.arange(kept.order) < kept.order - kept.massless
    mechanical = [t.kind == "mechanical" for t in terminals]
    scale = np.abs(gain[:, mechanical]).max(axis=1, initial=0.0)
    scale = np.where(scale > 0, scale, np.abs(gain).max(axis=1))
    scale = np.where(scale > 0, scale, 1.0)[:, None]

    numbers = range(1, kept.order + 1)
    nothing = np.zeros((kept.order,) * 2)
    turn = omega * heavy  # the others have no velocity, and no node for it
    drive = heavy[:, None] * scale * gain / (omega[:, None] * MICRO)
    states = _States(
        [f"{node}{j}" for node in "qp" for j in numbers],
        [f"{mark}{j}" for mark in ("", "d") for j in numbers],
        np.block([[nothing, np.diag(turn)], [np.diag(-turn), np.diag(-damp * heavy)]]),
        np.vstack([np.zeros_like(drive), drive]),
        np.hstack(
            [(gain / scale).T * [[MICRO / t.unit] for t in terminals], np.zeros_like(gain.T)]
        ),
    )
    slowest = omega[heavy].min(initial=np.inf)
    farad = STATE * np.minimum(1.0, (omega / (watch.full * slowest)) ** watch.power)
    siemens = np.where(heavy, farad * omega, SIEMENS)
    drive = siemens[:, None] * scale * gain / (omega[:, None] ** 2 * MICRO)
    modes = [
        {
            "index": j + 1,
            "hertz": omega[j] / (2 * np.pi),
            "ratio": damp[j] / (2 * omega[j]) if heavy[j] else damp[j] / omega[j] ** 2,
            "farad": farad[j] if heavy[j] else SIEMENS * damp[j] / omega[j] ** 2,
            "stiffness": siemens[j],
            "damping": farad[j] * damp[j],
            "massless": not heavy[j],
            "drives": _drives(j + 1, drive[j], terminals, base),
            "charges": [
                _Card(f"Gc{j + 1}{t.tag}", f"q{j + 1}", f"charge{t.tag}", gain[j, k] / scale[j, 0])
                for k, t in enumerate(terminals)
                if t.clamped  # uC per um
            ],
        }
        for j in range(kept.order)
    ]
    return {
        "ports": [
            replace(t, sums=()) if t.clamped else t
            for t in _wired(terminals, states, rom.D, rom, base)
        ],
        "modes": modes,
        "silent": model.order - kept.order,
        "full": watch.full,
        "power": watch.power,
        "share": watch.share,
    }


def _drives(index: int, row: np.ndarray, terminals: list[_Terminal], base: str) -> list[_Card]:
    """What ports drive a mode with: forces, voltages, accelerations."""

    def label(t: _Terminal) -> str:
        own = f"{index}{t.tag}" if t.kind == "electrical" else f"{t.pins[0]}_{index}"
        return f"G{_DRIVES[t.kind]}{own}"

    return [
        t.driven(label(t), row, base)
        for letter in "fvs"
        for t in terminals
        if _DRIVES[t.kind] == letter
    ]


def _observable(model: Resonators) -> Resonators:
    """``model`` without modes that no port moves or observes: rounding makes them."""
    share = np.abs(model.gain) / model.omega[:, None]
    share /= share.max(axis=0, initial=0.0, keepdims=True) + np.finfo(float).tiny
    kept = share.max(axis=1, initial=0.0) > SILENT
    if kept.all() or not kept.any():
        return model
    return replace(
        model,
        omega=model.omega[kept],
        damp=model.damp[kept],
        gain=model.gain[kept],
        massless=int(np.count_nonzero(kept & (model.inertia == 0.0))),
    )


# ------------------------------------------------------------------------------------- blocks


def _blocks(
    model: BlockModel, rom: LinearModel, terminals: list[_Terminal], base: str
) -> dict[str, object]:
    """The states of every block of :func:`kc2spice.rom.blocks.block_model` are voltages on
    ``C = 1 / (2 pi f1)``, f1 the end of the band, so that conductances in the band are about 1 S.
    A block is scaled to about 1 V for a constant input of 1 V.
    """
    from scipy.linalg import block_diag  # loads what most models do not need

    band = rom.certificate.band_hz if rom.certificate else rom.band
    farad = 1 / (2 * np.pi * (band[1] if band else 1.0))
    B, C = model.B.copy(), model.C.copy()
    scaled, held, start = [], [], 0
    for block in model.blocks:
        rows = slice(start, start + len(block))
        start += len(block)
        block, free, scale = _balanced(block, B[rows], 1 / farad)
        B[rows] /= scale[:, None]
        C[:, rows] *= scale
        scaled.append(block)
        held.append(free)
    numbers = [f"{k}" for k in range(1, start + 1)]
    units = [[t.unit] for t in terminals if t.row is not None]
    states = _States(
        [f"z{k}" for k in numbers], numbers, block_diag(*scaled), B, C / np.array(units)
    )
    blocks, at = [], 0
    for block, free in zip(scaled, held, strict=True):
        first, at = at, at + len(block)
        found = [
            {
                "index": k + 1,
                "cards": states.cards(farad * states.A[k], base),
                "drives": [
                    t.driven(f"{t.column + 1}", farad * B[k], base)
                    for t in terminals
                    if t.column is not None and B[k, t.column]
                ],
                "held": free,
            }
            for k in range(first, at)
        ]
        told = {"first": first + 1, "last": at, "what": _description(block)}
        blocks.append(told | {"states": found})
    wired = _wired(terminals, states, model.D, rom, base)
    return {
        "inputs": [t.pins[0] for t in terminals if t.kind == "input"],
        "ports": [t for t in wired if t.port.conservative],
        "outputs": [t for t in wired if t.kind == "output"],
        "blocks": blocks,
        "farad": farad,
        "share": FOLLOWED.share,
    }


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
    found = np.linalg.eigvals(block)
    texts = [
        f"{abs(pole) / (2 * np.pi):.6g} Hz, damping ratio {0.0 - pole.real / abs(pole):.6g}"
        if pole.imag > 0
        else f"pole {pole.real:.6g} 1/s"
        for pole in found[found.imag >= 0]
    ]
    more = f"; and {len(texts) - 3} more" if len(texts) > 3 else ""
    return "; ".join(texts[:3]) + more
