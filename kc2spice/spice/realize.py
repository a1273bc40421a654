"""Reduced model to subcircuit: resonators as pairs of integrators (paper eq. 7, diagonalised)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.rom.model import ResonatorModel
from kc2spice.spice.cards import distinct
from kc2spice.spice.cards import name as checked_name
from kc2spice.spice.circuit import Param, Pin, Subcircuit
from kc2spice.spice.header import Header, parameter_list, part_header, rom_line
from kc2spice.spice.render import render

MICRO = 1e-6  # 1 V on a mechanical pin is 1 um
STATE = 1e-6  # farad of a fast state: one chgtol is then one tolerance of displacement
FAST = 3.0  # times the lowest frequency; slower modes need less care, see kick.j2
_INNER = r"tick|inner|current|charge|[qp]\d+"  # nodes of the template
SHARE = 0.01  # of the clamped capacitance that step control sees; its charge is the modes' own
SILENT = 1e-9  # of the largest share of a mode in every port; such modes move no port
LEAK = 1e-12  # S; the charge of a floating anode decays in hours


@dataclass(frozen=True)
class _Ring:
    pin: str
    column: int


@dataclass(frozen=True)
class _Mode:
    """Card values of one resonator."""

    index: int
    hertz: float
    ratio: float
    farad: float
    stiffness: float
    damping: float
    shape: np.ndarray
    force: np.ndarray
    voltage: float
    charge: float


def realize(
    model: ResonatorModel,
    header: Header,
    *,
    name: str = "kick",
    title: str = "piezoelectric actuator, reduced finite-element model of the whole device",
    ports: tuple[str, ...] | None = None,
) -> Subcircuit:
    """One ``.subckt`` with the electrical port ``anode cathode``, the rings asked for and ``base``.

    With ``z_j'' + d_j z_j' + w_j^2 z_j = sum_k g_jk u_k`` and ``s_j = max_k |g_jk|`` over the
    mechanical ports, the states are ``q_j = s_j z_j`` and ``p_j = q_j' / w_j`` in um (or, of a
    model without mechanical ports, in uC)::

        C q' = C w p,    C p' = -C w q - C d p + (C s / w) sum_k g_k u_k

    with ``C = 1 uF min(1, (w / 3 w_1)^2)``: step control sees an error of charge, ``C`` times that
    of the displacement, and slow modes decide nothing in a contact, but ring long after it.
    A ring pin is conservative: its displacement equals the modal sum, and the force that holds
    it there drives the modes. Both are exact, so port laws and passivity are those of the model.

    Parameters
    ----------
    model : the whole device, not a symmetry sector.
    title : what the device is, for the head of the library.
    ports : names of the model's ports to bring out, all by default; the others see no load.

    Raises
    ------
    UsageError : an unknown port, one that is neither mechanical nor electrical, or one whose name
        the subcircuit has for itself.
    """
    wanted = tuple(p.name for p in model.ports) if ports is None else ports
    known = {p.name: p for p in model.ports}
    for port in wanted:
        if port not in known:
            raise UsageError("no such port", where=name, got=port, expected=", ".join(known))
    rings = tuple(
        _Ring(checked_name(p.name), column)
        for column, p in enumerate(model.ports)
        if p.kind == "mechanical" and p.name in wanted
    )
    anode = next((i for i, p in enumerate(model.ports) if p.kind == "electrical"), None)
    electrical = anode is not None and model.ports[anode].name in wanted
    clamped = float(model.D[anode, anode]) if anode is not None else 0.0
    heard, pins = _heard(model), _pins(rings, electrical)
    inner = "|".join([_INNER, *(f"[uf]{ring.pin.lower()}" for ring in rings)])
    distinct([pin.name for pin in pins], inner, where=name)
    params, farads = _params(model), _farad(heard.omega)
    text = render(
        "kick.j2",
        header=part_header(
            header,
            f"{name}: {title}",
            pins,
            params,
            rom=rom_line(model.order, model.certificate),
            validity=(
                f"small signals up to {model.certificate.band_hz[1]:g} Hz at the temperature of "
                "the data; no hysteresis, depolarisation or heating"
            ),
            rating="keep every layer's field within its material's limits; the model never ends",
        ),
        name=checked_name(name),
        pins=[pin.name for pin in pins],
        parameters=parameter_list(params),
        rings=rings,
        modes=_modes(heard, anode, farads),
        silent=model.order - heard.order,
        weighted=farads.min() < STATE,
        full=FAST,
        electrical=electrical,
        clamped=clamped,
        share=SHARE,
        leak=LEAK,
    )
    return Subcircuit(name, pins, params, text)


def _params(model: ResonatorModel) -> tuple[Param, ...]:
    """A scale of all damping where there is any; zero gives the undamped device."""
    scale = Param("damping", 1.0, "-", "scale of the damping of all modes")
    return (scale,) if np.any(model.damp > 0) else ()


def _pins(rings: tuple[_Ring, ...], electrical: bool) -> tuple[Pin, ...]:
    terminals = (Pin("anode", "V", "A"), Pin("cathode", "V", "A")) if electrical else ()
    return (*terminals, *(Pin(ring.pin, "um", "N") for ring in rings), Pin("base", "um", "N"))


def _modes(model: ResonatorModel, anode: int | None, farads: np.ndarray) -> list[_Mode]:
    """Card values of every mode, from low to high frequency."""
    mechanical = [p.kind == "mechanical" for p in model.ports]
    modes: list[_Mode] = []
    for j in np.argsort(model.omega):
        omega, damp, gain = model.omega[j], model.damp[j], model.gain[j]
        scale = np.max(np.abs(gain[mechanical]), initial=0.0) or np.abs(gain).max() or 1.0
        farad = float(farads[j])
        drive = farad * scale * gain / (omega * MICRO)  # A into p per newton or volt
        modes.append(
            _Mode(
                index=len(modes) + 1,
                hertz=omega / (2 * np.pi),
                ratio=damp / (2 * omega),
                farad=farad,
                stiffness=farad * omega,
                damping=farad * damp,
                shape=gain / scale,
                force=drive,
                voltage=drive[anode] if anode is not None else 0.0,
                charge=gain[anode] / scale if anode is not None else 0.0,  # uC per um
            )
        )
    return modes


def _heard(model: ResonatorModel) -> ResonatorModel:
    """``model`` without modes that no port moves nor hears: rounding makes them in a reduction."""
    share = np.abs(model.gain) / model.omega[:, None]
    share /= share.max(axis=0, initial=0.0, keepdims=True) + np.finfo(float).tiny
    kept = share.max(axis=1, initial=0.0) > SILENT
    if kept.all() or not kept.any():
        return model
    return replace(model, omega=model.omega[kept], damp=model.damp[kept], gain=model.gain[kept])


def _farad(omega: np.ndarray) -> np.ndarray:
    """Capacitance of every mode's two states."""
    return STATE * np.minimum(1.0, (omega / (FAST * omega.min())) ** 2)
