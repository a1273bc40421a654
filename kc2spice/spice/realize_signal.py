"""Any reduced linear model to a subcircuit with signal pins: states on capacitors, G cards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.rom.blocks import BlockModel, block_model
from kc2spice.rom.model import FirstOrderModel, ReducedModel
from kc2spice.spice.cards import distinct
from kc2spice.spice.cards import name as checked_name
from kc2spice.spice.circuit import Pin, Subcircuit
from kc2spice.spice.header import Header, part_header, rom_line
from kc2spice.spice.render import render

_INNER = r"ref|tick|sum\d+|z\d+"  # nodes of the template
LEAK = 1e-12  # S; an order above the conductances that ngspice takes for zero
# A block whose smallest singular value is this far below the band integrates constant inputs.
FREE = 1e-11


@dataclass(frozen=True)
class _Card:
    column: int
    value: float


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


@dataclass(frozen=True)
class _Output:
    index: int
    pin: str
    cards: list[_Card]
    through: list[_Card]


def realize_signal(
    model: ReducedModel | FirstOrderModel, header: Header, *, name: str = "rom", dense: bool = False
) -> Subcircuit:
    """One ``.subckt`` with the inputs, the outputs and ``ref`` as pins; 1 V is one unit.

    The states of every block of :func:`kc2spice.rom.blocks.block_model` are voltages on
    ``C = 1 / (2 pi f1)``, f1 the end of the band, so that conductances in the band are about 1 S.
    A block is scaled to about 1 V for a constant input of 1 V. ``dense`` couples all states.

    Raises
    ------
    UsageError : a port name that no netlist can hold, conservative ports, or a model without
        state-space form.
    """
    inputs, outputs = _split(model)
    blocks = block_model(model, dense=dense)
    farad = 1 / (2 * np.pi * model.certificate.band_hz[1])
    blocks = _balanced(blocks, 1 / farad)
    pins = (
        *(Pin(checked_name(p.name), p.across, "-") for p in model.ports),
        Pin("ref", "V", "A"),
    )
    text = render(
        "rom.j2",
        header=part_header(
            header,
            f"{name}: reduced linear model, {len(inputs)} inputs, {len(outputs)} outputs",
            pins,
            rom=rom_line(model.order, model.certificate),
        ),
        name=checked_name(name),
        pins=[pin.name for pin in pins],
        inputs=inputs,
        outputs=_outputs(blocks, outputs),
        blocks=_blocks(blocks, farad),
        farad=farad,
        leak=LEAK,
    )
    return Subcircuit(name, pins, (), text)


def _split(model: ReducedModel | FirstOrderModel) -> tuple[list[str], list[str]]:
    """Names of input and output pins."""
    m, names = model.B.shape[1], [port.name for port in model.ports]
    if any(port.kind != "signal" for port in model.ports) or len(names) != m + model.C.shape[0]:
        raise UsageError("its ports are not signals", where="signal subcircuit", got=names)
    distinct(names, _INNER, where="ports")
    return names[:m], names[m:]


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
    return BlockModel(tuple(blocks), B, C, model.D)


def _free(block: np.ndarray, omega: float) -> bool:
    return bool(np.linalg.svd(block, compute_uv=False)[-1] < FREE * omega)


def _outputs(model: BlockModel, names: list[str]) -> list[_Output]:
    rows = enumerate(zip(names, model.C, model.D, strict=True), 1)
    return [_Output(i, name, _cards(c, 1.0), _cards(d, 1.0)) for i, (name, c, d) in rows]


def _blocks(model: BlockModel, farad: float) -> list[_Block]:
    found, start = [], 0
    for block in model.blocks:
        free = _free(block, 1 / farad)
        states = [
            _State(
                start + i + 1, _cards(row, farad, start), _cards(model.B[start + i], farad), free
            )
            for i, row in enumerate(block)
        ]
        found.append(_Block(states, _description(block)))
        start += len(block)
    return found


def _cards(row: np.ndarray, factor: float, shift: int = 0) -> list[_Card]:
    return [_Card(shift + k + 1, factor * value) for k, value in enumerate(row) if value != 0]


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
