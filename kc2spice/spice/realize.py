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
_INNER = r"tick|(inner|current|charge)\w*|sum\d+|[qpz]\d+"  # nodes of the templates


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


@dataclass(frozen=True)
class _Card:
    """One controlled source: ``value`` amperes per volt between ``plus`` and ``minus``."""

    label: str
    plus: str
    minus: str
    value: float


@dataclass(frozen=True)
class _Terminal:
    """A port as the templates see it; ``sums`` come from states, ``through`` from other ports."""

    kind: str
    label: str
    pins: tuple[str, ...]
    tag: str
    column: int | None
    row: int | None
    clamped: float
    sums: tuple[_Card, ...] = ()
    through: tuple[_Card, ...] = ()

    def control(self, base: str) -> tuple[str, str]:
        """The nodes between which the port's input in SI is a voltage."""
        if self.kind == "electrical":
            return self.pins[0], self.pins[1]
        moved = self.kind in ("mechanical", "rotational")
        return (f"f{self.pins[0]}" if moved else self.pins[0]), base


UNRATED = "not known; keep field and stress within the limits of its materials"


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
    conservative = all(port.conservative for port in rom.ports)
    if conservative and not dense and rom.symmetric and not rom.first_order:
        try:
            modal = resonators(rom)
            mass = rom.facts.get("mass_kg")
            return _resonators(modal, name, header, (title, rating), mass, watch)
        except UsageError as error:
            if error.where != "resonator form":
                raise
    return _blocks(rom, name, header, (title, rating), dense)


# ------------------------------------------------------------------------------- ports and pins


def _terminals(ports: Sequence[Port], D: np.ndarray, where: str) -> list[_Terminal]:
    several = sum(port.kind == "electrical" for port in ports) > 1
    found, column, row = [], 0, 0
    for port in ports:
        pins = tuple(checked_name(pin) for pin in port.terminals)
        if len(pins) != (2 if port.kind == "electrical" else 1):
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
        electrical = port.kind == "electrical"
        clamped = float(D[out, into]) if electrical else 0.0
        if clamped < 0:
            raise UsageError("negative capacitance", where=where, got=port.name)
        tag = f"_{checked_name(port.name)}" if electrical and several else ""
        found.append(_Terminal(port.kind, checked_name(port.name), pins, tag, into, out, clamped))
    return found


def _pins(terminals: list[_Terminal], ports: Sequence[Port]) -> tuple[tuple[Pin, ...], str]:
    """Electrical pairs, other conservative pins and the base; signals as they come, before ref."""

    def of(kinds: tuple[str, ...]) -> list[Pin]:
        return [
            Pin(pin, port.across, "-" if kinds[0] == "input" else port.flow)
            for port, terminal in zip(ports, terminals, strict=True)
            if port.kind in kinds
            for pin in terminal.pins
        ]

    # electrical ports against one cathode share its pin
    electrical, signals = list(dict.fromkeys(of(("electrical",)))), of(("input", "output"))
    moving = of(("mechanical", "rotational", "acceleration"))
    if not electrical and not moving:
        return (*signals, Pin("ref", "V", "A")), "ref"
    base = reference(ports)
    return (*electrical, *moving, *signals, Pin(base, "um", "N")), base


def reference(ports: Sequence[Port]) -> str:
    """Name of the pin that displacements count from: ``base``, or ``ground`` if a port is that."""
    taken = {pin for port in ports for pin in port.terminals}
    return "ground" if "base" in taken else "base"


def _check_names(pins: tuple[Pin, ...], terminals: list[_Terminal], where: str) -> None:
    moved = [t.pins[0].lower() for t in terminals if t.kind in ("mechanical", "rotational")]
    inner = "|".join([_INNER, *(f"[uf]{pin}" for pin in moved)])
    distinct([pin.name for pin in pins], inner, where=where)


def _unit(kind: str) -> float:
    """SI value of 1 V on the node that sums a port's output."""
    return MICRO if kind in ("mechanical", "electrical") else 1.0


def _through(
    terminal: _Terminal, all_terminals: list[_Terminal], row: np.ndarray, base: str
) -> tuple[_Card, ...]:
    """Direct effect of every input on an output; ``row`` in units of the port's sum node."""
    size = np.abs(row).max(initial=0.0)
    return tuple(
        _Card(f"u{other.column + 1}", *other.control(base), float(row[other.column]))
        for other in all_terminals
        if other.column is not None and abs(row[other.column]) > CROSS * size
    )


def _direct(
    terminal: _Terminal, all_terminals: list[_Terminal], D: np.ndarray, base: str
) -> tuple[_Card, ...]:
    """Cards of a row of D, less the clamped capacitance, which is a capacitor."""
    row = D[terminal.row] / _unit(terminal.kind)
    if terminal.kind == "electrical":
        largest = np.abs(row).max(initial=0.0)
        row = np.where(np.arange(len(row)) == terminal.column, 0.0, row)
        row = np.where(np.abs(row) > CROSS * largest, row, 0.0)
        if row.any() and not terminal.clamped:
            raise UsageError(
                "an electrode without capacitance of its own shares charge with other ports",
                where=terminal.label,
                expected="a positive semi-definite D",
            )
    return _through(terminal, all_terminals, row, base)


# -------------------------------------------------------------------------------- resonators


@dataclass(frozen=True)
class _Mode:
    """Card values of one resonator."""

    index: int
    hertz: float
    ratio: float
    farad: float
    stiffness: float
    damping: float
    massless: bool
    drives: list[_Card]
    charges: list[_Card]


def _resonators(
    model: Resonators,
    name: str,
    header: Header,
    told: tuple[str, str],
    mass: float | None,
    watch: Watch,
) -> Subcircuit:
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
    kept = _audible(model)
    terminals = _terminals(model.ports, model.D, name)
    pins, base = _pins(terminals, model.ports)
    _check_names(pins, terminals, name)
    order = np.lexsort((kept.omega, kept.inertia == 0.0))
    omega, damp, gain = kept.omega[order], kept.damp[order], kept.gain[order]
    heavy = kept.order - kept.massless
    mechanical = [t.kind == "mechanical" for t in terminals]
    scale = np.abs(gain[:, mechanical]).max(axis=1, initial=0.0)
    scale = np.where(scale > 0, scale, np.abs(gain).max(axis=1))
    scale = np.where(scale > 0, scale, 1.0)
    farads = _farad(omega[:heavy], watch)
    modes = [
        _mode(j, omega[j], damp[j], gain[j], scale[j], float(farads[j]), terminals, base)
        for j in range(heavy)
    ]
    modes += [
        _relaxing(j, omega[j], damp[j], gain[j], scale[j], terminals, base)
        for j in range(heavy, omega.size)
    ]
    wired = [
        _wired(t, k, terminals, model.D, (omega, damp, gain, scale), mass, base)
        for k, t in enumerate(terminals)
    ]
    scale_of_damping = Param("damping", 1.0, "-", "scale of the damping of all modes")
    params = (scale_of_damping,) if np.any(model.damp > 0) else ()
    text = render(
        "kick.j2",
        header=_head(header, name, told, pins, params, model.order, model.certificate),
        name=checked_name(name),
        pins=[pin.name for pin in pins],
        base=base,
        parameters=parameter_list(params),
        ports=wired,
        modes=modes,
        silent=model.order - kept.order,
        full=watch.full,
        power=watch.power,
        share=watch.share,
        leak=LEAK,
    )
    return Subcircuit(name, pins, params, text)


def _mode(
    j: int,
    omega: float,
    damp: float,
    gain: np.ndarray,
    scale: float,
    farad: float,
    terminals: list[_Terminal],
    base: str,
) -> _Mode:
    drive = farad * scale * gain / (omega * MICRO)  # A into p per newton or volt
    return _Mode(
        j + 1,
        omega / (2 * np.pi),
        damp / (2 * omega),
        farad,
        farad * omega,
        farad * damp,
        False,
        *_coupled(j + 1, drive, gain / scale, terminals, base),
    )


def _relaxing(
    j: int,
    omega: float,
    damp: float,
    gain: np.ndarray,
    scale: float,
    terminals: list[_Terminal],
    base: str,
) -> _Mode:
    drive = SIEMENS * scale * gain / (omega**2 * MICRO)  # A into q per newton or volt
    return _Mode(
        j + 1,
        omega / (2 * np.pi),
        damp / omega**2,
        SIEMENS * damp / omega**2,
        SIEMENS,
        0.0,
        True,
        *_coupled(j + 1, drive, gain / scale, terminals, base),
    )


def _coupled(
    index: int, drive: np.ndarray, share: np.ndarray, terminals: list[_Terminal], base: str
) -> tuple[list[_Card], list[_Card]]:
    """What ports drive a state with, and the charge that it moves."""
    drives, charges = [], []
    for kind in ("motion", "electrical", "acceleration"):
        for k, t in enumerate(terminals):
            if t.kind != kind and not (kind == "motion" and t.control("")[0] != t.pins[0]):
                continue
            label = {"electrical": f"Gv{index}{t.tag}", "acceleration": f"Gs{t.pins[0]}_{index}"}
            card = label.get(kind, f"Gf{t.pins[0]}_{index}")
            drives.append(_Card(card, *t.control(base), drive[k]))
            if kind == "electrical" and t.clamped:  # uC per um
                node = f"charge{t.tag}"
                charges.append(_Card(f"Gc{index}{t.tag}", f"q{index}", node, share[k]))
    return drives, charges


def _wired(
    t: _Terminal,
    k: int,
    terminals: list[_Terminal],
    D: np.ndarray,
    modal: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    mass: float | None,
    base: str,
) -> _Terminal:
    """The terminal with its cards; z_j is ``q_j MICRO / s_j``."""
    omega, damp, gain, scale = modal
    through = _direct(t, terminals, D, base) if t.kind != "acceleration" else ()
    if t.kind == "mechanical":
        return replace(t, sums=_states("q", gain[:, k] / scale, base), through=through)
    amplitude = gain[:, k] * MICRO / scale
    if t.kind == "rotational":
        return replace(t, sums=_states("q", amplitude, base), through=through)
    if t.kind == "electrical":
        sums = () if t.clamped else _states("p", amplitude * omega, base)
        return replace(t, sums=sums, through=through)
    # Reaction force m a - y'' with y'' = sum_j g_j z_j'' from the modes' own equations.
    row = -(gain[:, k] @ gain)
    row[k] += mass if mass is not None else gain[:, k] @ gain[:, k]
    sums = _states("q", amplitude * omega**2, base)
    sums += _states("p", amplitude * omega * damp, base, "d")
    return replace(t, sums=sums, through=_through(t, terminals, row, base))


def _states(node: str, values: np.ndarray, base: str, mark: str = "") -> tuple[_Card, ...]:
    return tuple(
        _Card(f"{mark}{j}", f"{node}{j}", base, float(value))
        for j, value in enumerate(values, 1)
        if value
    )


def _audible(model: Resonators) -> Resonators:
    """``model`` without modes that no port moves or observes: rounding makes them."""
    share = np.abs(model.gain) / model.omega[:, None]
    share /= share.max(axis=0, initial=0.0, keepdims=True) + np.finfo(float).tiny
    kept = share.max(axis=1, initial=0.0) > SILENT
    if kept.all() or not kept.any():
        return model
    massless = int(np.count_nonzero(kept & (model.inertia == 0.0)))
    return replace(
        model,
        omega=model.omega[kept],
        damp=model.damp[kept],
        gain=model.gain[kept],
        massless=massless,
    )


def _farad(omega: np.ndarray, watch: Watch) -> np.ndarray:
    """Capacitance of every mode's two states."""
    return STATE * np.minimum(1.0, (omega / (watch.full * omega.min())) ** watch.power)


def _head(
    header: Header,
    name: str,
    told: tuple[str, str],
    pins: tuple[Pin, ...],
    params: tuple[Param, ...],
    order: int,
    certificate: object,
) -> str:
    title, rating = told
    band, rom = "", ""
    if certificate is not None:
        band = f" up to {certificate.band_hz[1]:g} Hz"  # type: ignore[attr-defined]
        rom = rom_line(order, certificate)  # type: ignore[arg-type]
    return part_header(
        header,
        f"{name}: {title}",
        pins,
        params,
        rom=rom,
        sign=OUTWARDS,
        rating=rating,
        validity=f"small signals{band} at the temperature of its data (20 to 25 C, of "
        "built-in materials); no hysteresis, depolarisation or heating",
    )


# ------------------------------------------------------------------------------------- blocks


@dataclass(frozen=True)
class _State:
    index: int
    cards: list[_Card]
    drives: list[_Card]
    held: bool


@dataclass(frozen=True)
class _Block:
    states: list[_State]
    what: str

    @property
    def first(self) -> int:
        return self.states[0].index

    @property
    def last(self) -> int:
        return self.states[-1].index


def _blocks(
    rom: LinearModel, name: str, header: Header, told: tuple[str, str], dense: bool
) -> Subcircuit:
    """The states of every block of :func:`kc2spice.rom.blocks.block_model` are voltages on
    ``C = 1 / (2 pi f1)``, f1 the end of the band, so that conductances in the band are about 1 S.
    A block is scaled to about 1 V for a constant input of 1 V.
    """
    terminals = _terminals(rom.ports, rom.D, name)
    pins, base = _pins(terminals, rom.ports)
    _check_names(pins, terminals, name)
    band = rom.certificate.band_hz if rom.certificate else rom.band
    farad = 1 / (2 * np.pi * (band[1] if band else 1.0))
    from kc2spice.rom.blocks import block_model  # loads what most models do not need

    model = _balanced(block_model(rom, dense=dense), 1 / farad)
    mass = rom.facts.get("mass_kg")
    wired = [_block_port(t, terminals, model, base, mass) for t in terminals]
    if base == "ref":
        told = (
            f"reduced linear model, {len(rom.inputs)} inputs, {len(rom.outputs)} outputs",
            told[1],
        )
    text = render(
        "rom.j2",
        header=_head(header, name, told, pins, (), rom.order, rom.certificate),
        name=checked_name(name),
        pins=[pin.name for pin in pins],
        base=base,
        inputs=[t.pins[0] for t in terminals if t.kind == "input"],
        ports=[t for t in wired if t.kind not in ("input", "output")],
        outputs=[t for t in wired if t.kind == "output"],
        blocks=_block_cards(model, farad, terminals, base),
        farad=farad,
        share=FOLLOWED.share,
        leak=LEAK,
    )
    return Subcircuit(name, pins, (), text)


def _block_port(
    t: _Terminal, terminals: list[_Terminal], model: BlockModel, base: str, mass: float | None
) -> _Terminal:
    if t.row is None:
        return t
    row = model.C[t.row]
    if t.kind == "acceleration" or (t.kind == "electrical" and not t.clamped):
        A = np.zeros((model.states,) * 2)
        start = 0
        for block in model.blocks:
            A[start : start + len(block), start : start + len(block)] = block
            start += len(block)
        rate, direct = row @ A, row @ model.B  # y' = C A z + C B u
        if t.kind == "electrical":
            cards = _through(t, terminals, direct, base) if np.abs(direct).max() > 0 else ()
            sums = _nonzero(rate, base) + tuple(replace(c, label=f"t{c.label}") for c in cards)
            return replace(t, sums=sums)
        through = -(rate @ model.B)  # F = m a - y'', y'' = C A^2 z + C A B u
        through[t.column] = 0.0 if mass is None else mass + through[t.column]
        return replace(
            t, sums=_nonzero(-(rate @ A), base), through=_through(t, terminals, through, base)
        )
    return replace(
        t, sums=_nonzero(row / _unit(t.kind), base), through=_direct(t, terminals, model.D, base)
    )


def _nonzero(row: np.ndarray, base: str, shift: int = 0) -> tuple[_Card, ...]:
    return tuple(
        _Card(f"{shift + k + 1}", f"z{shift + k + 1}", base, float(value))
        for k, value in enumerate(row)
        if value != 0
    )


def _balanced(model: BlockModel, omega: float) -> BlockModel:
    """Complex pairs as ``[[a, w], [-w, a]]``, each block about 1 for a constant input of 1."""
    blocks, B, C = [], model.B.copy(), model.C.copy()
    start = 0
    for block in model.blocks:
        rows = slice(start, start + len(block))
        start += len(block)
        scale = np.ones(len(block))
        if len(block) == 2 and block[0, 1] * block[1, 0] < 0:
            scale[1] = np.sqrt(-block[1, 0] / block[0, 1])
        block = block * scale / scale[:, None]
        drive = B[rows] / scale[:, None]
        answer = drive / omega if _free(block, omega) else np.linalg.solve(block, drive)
        scale = scale * (np.abs(answer).max(initial=0.0) or 1.0)
        B[rows] /= scale[:, None]
        C[:, rows] *= scale
        blocks.append(block)
    return replace(model, blocks=tuple(blocks), B=B, C=C)


def _free(block: np.ndarray, omega: float) -> bool:
    return bool(np.linalg.svd(block, compute_uv=False)[-1] < FREE * omega)


def _block_cards(
    model: BlockModel, farad: float, terminals: list[_Terminal], base: str
) -> list[_Block]:
    inputs = [(t.column, t) for t in terminals if t.column is not None]

    def drives(state: int) -> list[_Card]:
        row = farad * model.B[state]
        return [
            _Card(f"{column + 1}", *t.control(base), float(row[column]))
            for column, t in inputs
            if row[column] != 0
        ]

    blocks: list[_Block] = []
    start = 0
    for block in model.blocks:
        free = _free(block, 1 / farad)
        states = [
            _State(start + i + 1, list(_nonzero(farad * row, base, start)), drives(start + i), free)
            for i, row in enumerate(block)
        ]
        blocks.append(_Block(states, _description(block)))
        start += len(block)
    return blocks


def _description(block: np.ndarray) -> str:
    """Poles of a block in a word for the reader."""
    found = np.linalg.eigvals(block)
    found = found[found.imag >= 0]
    texts = []
    for pole in found:
        if pole.imag > 0:
            ratio = 0.0 - pole.real / abs(pole)  # never -0
            texts.append(f"{abs(pole) / (2 * np.pi):.6g} Hz, damping ratio {ratio:.6g}")
        else:
            texts.append(f"pole {pole.real:.6g} 1/s")
    shown = "; ".join(texts[:3])
    return shown if len(texts) <= 3 else f"{shown}; and {len(texts) - 3} more"
