"""Netlist cards of blocks of states, for models that have no resonator form."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import filterfalse
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from kc2spice.netlist.circuit import Element
from kc2spice.netlist.number_and_name_spelling import format_comment, format_number
from kc2spice.netlist.shared_cards import Line
from kc2spice.rom.linear_model import LinearModel
from kc2spice.synthesis.mode_cards import RINGING_WEIGHTS
from kc2spice.synthesis.terminals import (
    INPUT_LEAK,
    OUTWARDS_COMMENT,
    OutputSourceWriter,
    PortTerminal,
    StateNodes,
    connect_sources,
    get_model_band,
    has_other_reference,
    list_port_domains,
    write_port_cards,
    write_weighted_sources,
)

if TYPE_CHECKING:
    from kc2spice.rom.decoupled_blocks import BlockModel
FREE_LEAK = 1e-12  # leakage conductance [S] at each state of an integrating block
# A block counts as integrating if its smallest singular value is below INTEGRATOR_RATIO.
# INTEGRATOR_RATIO is relative to the upper end of the band [rad/s].
# A constant input makes the states of an integrating block grow without limit.
INTEGRATOR_RATIO = 1e-11
_STATES_COMMENT = """\
* Linear state-space model: signal inputs draw no current, signal outputs are ideal sources, 1 V is
* one unit of the pin. Coupled states z are the voltages of capacitors of {farad} F:
*
*     z' = A z + B u                y = C z + D u
*
* The states are scaled to about 1 V for a constant input of 1 V. {base} is the reference of all
* pins that are not electrical: connect it to node 0."""
_LOOP_NOTE = "algebraic loops without capacitors; the currents into each node sum to zero"
_INTEGRATOR_COMMENT = "* The leak conductance is the DC path of an integrator."


def write_blocks(
    model: BlockModel, rom: LinearModel, terminals: list[PortTerminal], base: str
) -> tuple[list[str], list[Line]]:
    """Return comments and the cards of blocks of states.

    :func:`kc2spice.rom.decoupled_blocks.make_block_model` makes the blocks. The states of the
    blocks are the voltages of capacitors ``C = 1 / (2 pi f1)``, where f1 is the upper end of the
    band. The conductances between states are therefore about 1 S. The states of a block are scaled
    to about 1 V for a constant input of 1 V.
    """
    from scipy.linalg import block_diag  # imported here, because most models need no blocks

    farad = 1 / (2 * np.pi * get_model_band(rom)[1])
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
    units = [t.output_value_per_volt for t in terminals if t.row is not None]
    states = StateNodes(
        list(map("z{}".format, numbers)),
        numbers,
        np.block([[block_diag(*scaled_blocks), F], [P / farad, S / farad]]),
        np.vstack([B, Q / farad]),
        np.hstack([C, R]) / np.array(units)[:, None],
    )
    laws = OutputSourceWriter(terminals, states, model.D, rom, base)
    wired = list(map(laws.connect_output, terminals))
    body = list(_write_input_cards(terminals, base))
    body += write_port_cards(wired, base, RINGING_WEIGHTS.share)
    outputs = (t for t in wired if t.kind == "output")
    for index, t in enumerate(outputs, 1):
        body += _write_output_cards(t, index, base)
    at = 0
    signals: list[tuple[np.ndarray, bool | None]] = [(S, None)] if len(S) else []
    for block, drifts in [*zip(scaled_blocks, integrating, strict=True), *signals]:
        first, at = at, at + len(block)
        accuracy = _LOOP_NOTE if drifts is None else format_comment(_describe_poles(block))
        body.append(f"\n* States {first + 1} to {at}: {accuracy}")
        for k in range(first, at):
            index, node = k + 1, f"z{k + 1}"
            if drifts is not None:
                body.append(Element.from_words(f"C{node}", node, base, farad))
            if drifts:
                body += [
                    _INTEGRATOR_COMMENT,
                    Element.from_words(f"G{node}", node, base, node, base, FREE_LEAK),
                ]
            sums = states.write_state_sum(farad * states.A[k], base)
            inputs = write_weighted_sources(terminals, farad * states.B[k], base)
            body += connect_sources(sums, base, node, f"Ga{index}_")
            body += connect_sources(inputs, base, node, f"Gb{index}_")
    about = _STATES_COMMENT.format(farad=format_number(farad), base=base).split("\n")
    domains = list_port_domains(rom.ports)
    placed = domains and not has_other_reference(domains)
    return [*OUTWARDS_COMMENT, *about] if placed else about, body


def _write_input_cards(terminals: Iterable[PortTerminal], base: str) -> Iterator[Line]:
    """Yield input cards: resistors at noise inputs, conductances at signal inputs."""
    inputs = [t for t in terminals if t.kind == "input"]
    for t in filter(attrgetter("is_noise"), inputs):
        yield Element.from_words(f"R{t.pins[0]}", t.pins[0], base, "1")
    signals = filterfalse(attrgetter("is_noise"), inputs)
    for index, t in enumerate(signals, 1):
        if index == 1:
            yield "* An input that is left open is zero."
        yield Element.from_words(f"Gleak{index}", t.pins[0], base, t.pins[0], base, INPUT_LEAK)


def _write_output_cards(t: PortTerminal, index: int, base: str) -> Iterator[Line]:
    """Yield the cards of one signal output.

    ``index`` is the number of the output.
    """
    node = f"sum{index}"
    yield f"\n* Output {t.pins[0]}"
    yield Element.from_words(f"E{index}", t.pins[0], base, node, base, "1")
    yield Element.from_words(f"Rsum{index}", node, base, "1")
    yield from connect_sources(t.sums, base, node, f"Gc{index}_")
    yield from connect_sources(t.through, base, node, f"Gt{index}_")


def _balance_block(
    block: np.ndarray, drive: np.ndarray, omega: float
) -> tuple[np.ndarray, bool, np.ndarray]:
    """Scale the states of a block, and find out whether one of its poles is zero.

    Return three values: the scaled block, whether one of its poles is zero, and the scale factors
    of its states.

    The block of a complex pair of poles becomes ``[[a, w], [-w, a]]``. The scaled states are about
    1 for a constant input of 1. ``drive`` contains the rows of B for the states of the block, and
    ``omega`` is the upper end of the band [rad/s].
    """
    scale = np.ones(len(block))
    if len(block) == 2 and block[0, 1] * block[1, 0] < 0:
        scale[1] = np.sqrt(-block[1, 0] / block[0, 1])
    block, drive = block * scale / scale[:, None], drive / scale[:, None]
    free = bool(np.linalg.svd(block, compute_uv=False)[-1] < INTEGRATOR_RATIO * omega)
    answer = drive / omega if free else np.linalg.solve(block, drive)
    return block, free, scale * (np.abs(answer).max(initial=0.0) or 1.0)


def _describe_poles(block: np.ndarray) -> str:
    """Return a description of the first three poles of a block, for a netlist comment."""
    poles = np.linalg.eigvals(block)
    texts = list(map(_describe_pole, poles[poles.imag >= 0]))
    more = f"; and {len(texts) - 3} more" if len(texts) > 3 else ""
    return "; ".join(texts[:3]) + more


def _describe_pole(pole: complex) -> str:
    """Return a description of a real pole or of a pair of complex poles."""
    if pole.imag > 0:
        size = abs(pole)
        return f"{size / (2 * np.pi):.6g} Hz, damping ratio {0.0 - pole.real / size:.6g}"
    return f"pole {pole.real:.6g} 1/s"
