"""Drivers: electronics between a command and the kick's electrodes or the catch's coils."""

from __future__ import annotations

import math
from dataclasses import dataclass

from kc2spice.core.quantities import Section
from kc2spice.fem.magnetics.table import EMTable, inductances
from kc2spice.parts.opamp import Level, opamp_subcircuit
from kc2spice.parts.pid import SENSE
from kc2spice.scene.drivers import (
    Amplifier,
    CatchDriver,
    ChargeDrive,
    HalfBridge,
    KickDriver,
    LinearDrive,
    PwmDrive,
)
from kc2spice.spice.cards import name as checked
from kc2spice.spice.circuit import Param, Pin, Subcircuit
from kc2spice.spice.header import Header, parameter_list, part_header
from kc2spice.spice.naming import self_contained
from kc2spice.spice.render import render

CARRIER = 10.0  # V, peak of the modulator's triangle
_VOLT, _SIGNAL = ("V", "A"), ("V", "-")


@dataclass(frozen=True)
class Driver:
    """A driver in a bench: its library parts, the subcircuit's name, the nodes of its pins."""

    parts: tuple[Subcircuit, ...]
    name: str
    nodes: tuple[str, ...]

    @property
    def known(self) -> bool:
        """Is it one of ours, whose output current can be read at ``Rout``?"""
        return bool(self.parts)


@dataclass(frozen=True)
class Load:
    """What the coils are between ``drive`` and ``ret``: both in series, the lower one reversed."""

    inductance: float  # H
    resistance: float  # Ohm


def coil_load(table: EMTable, height: float) -> Load:
    """``L11 + L22 - 2 L12`` and both resistances, with the sphere at ``height`` [m]."""
    matrix = inductances(table, height)
    return Load(
        float(matrix[0, 0] + matrix[1, 1] - 2 * matrix[0, 1]), float(table.resistance.sum())
    )


def kick_driver(header: Header, driver: KickDriver) -> Driver:
    """The driver that a scene chose for the chip, between ``command`` and ``anode``."""
    if driver.half_bridge:
        part = half_bridge_subcircuit(header, driver.half_bridge)
    elif driver.amplifier:
        part = amplifier_subcircuit(header, driver.amplifier)
    elif driver.charge:
        part = charge_drive_subcircuit(header, driver.charge)
    else:
        return _user(driver, ("command", "anode", "0"))
    nodes = {"out": "anode", "ref": "0"}
    return Driver((part,), part.name, _nodes(part, nodes))


def coil_driver(header: Header, driver: CatchDriver, load: Load, current: float) -> Driver:
    """The driver that a scene chose for the coils, from ``wanted`` to ``drive`` and ``ret``.

    ``current`` [A] is the largest that the controller asks for.
    """
    if driver.linear:
        part = linear_subcircuit(header, driver.linear, load, current)
    elif driver.pwm:
        part = pwm_subcircuit(header, driver.pwm, load)
    else:
        return _user(driver, ("wanted", "drive", "ret", "0"))
    return Driver((part,), part.name, _nodes(part, {"command": "wanted", "ref": "0"}))


def half_bridge_subcircuit(header: Header, drive: HalfBridge) -> Subcircuit:
    """Two transistors, gate resistors, reservoir; ``command`` switches at half the rail."""
    docs = {
        "rail": "supply",
        "resistance": "between bridge and chip",
        "gate_resistance": "of both gates",
        "current_limit": "at which a transistor saturates",
        "reservoir": "capacitor that the pulse's charge comes from",
        "supply_resistance": "through which it is refilled",
    }
    return _part(header, "half_bridge", "half-bridge for the chip", drive, docs)


def amplifier_subcircuit(header: Header, drive: Amplifier) -> Subcircuit:
    """``V(out) = V(command)`` within rails, bandwidth, slew rate and current."""
    return _part(header, "amplifier", "high-voltage amplifier for the chip", drive, _AMPLIFIER)


def charge_drive_subcircuit(header: Header, drive: ChargeDrive) -> Subcircuit:
    """Chip charge ``= capacitance V(command)`` on a floating chip."""
    docs = {
        "capacitance": "charge of the chip per volt of command",
        "sense": "capacitor in series with the chip",
        **_AMPLIFIER,
    }
    pins = ("anode", "cathode")
    return _part(header, "charge", "charge drive for the chip", drive, docs, pins)


def linear_subcircuit(header: Header, drive: LinearDrive, load: Load, current: float) -> Subcircuit:
    """Coil current ``V(command) / 100 Ohm`` from an amplifier between ``+-rail``."""
    resistance = load.resistance + SENSE
    ratio = 2 * math.pi * drive.bandwidth * load.inductance / SENSE
    params = (
        Param("rail", drive.rail, "V", "supplies of plus and minus this voltage"),
        Param("slew", drive.slew, "V/s", "fastest change of the output"),
        Param("current_limit", 2 * current, "A", "largest output current"),
    )
    r2 = 1e3 * ratio
    return _rendered(
        header, "linear", "current source for the coils", params, ("drive", "ret"),
        sense=SENSE, inductance=load.inductance, resistance=resistance, bandwidth=drive.bandwidth,
        r2=r2, c1=load.inductance / resistance / r2,
        gbw=5 * drive.bandwidth * (1 + ratio),
    )  # fmt: skip


def pwm_subcircuit(header: Header, drive: PwmDrive, load: Load) -> Subcircuit:
    """Coil current ``V(command) / 100 Ohm`` from an H-bridge."""
    resistance = load.resistance + 2 * drive.resistance + 1.0
    r2 = 1e5 * 2 * math.pi * drive.bandwidth * load.inductance * CARRIER / SENSE  # Ohm V
    params = (
        Param("rail", drive.rail, "V", "supply of the bridge"),
        Param("frequency", drive.frequency, "Hz", "of the carrier"),
        Param("resistance", drive.resistance, "Ohm", "of each switch when on"),
        Param("edge", drive.edge, "s", "of the switched voltage"),
    )
    return _rendered(
        header, "pwm", "H-bridge for the coils", params, ("drive", "ret"),
        sense=SENSE, inductance=load.inductance, resistance=resistance, bandwidth=drive.bandwidth,
        carrier=CARRIER, r2=r2, c1=load.inductance / resistance / r2,
    )  # fmt: skip


_AMPLIFIER = {
    "rail": "supply",
    "resistance": "between amplifier and chip",
    "bandwidth": "of the closed loop",
    "slew": "fastest change of the output",
    "current_limit": "largest output current",
}
# The operational amplifier that each driver contains.
_AMPLIFIERS: dict[str, Level] = {
    "amplifier": "slew", "charge": "slew", "linear": "slew", "pwm": "pole",
}  # fmt: skip
_UNITS = {
    "rail": "V", "resistance": "Ohm", "gate_resistance": "Ohm", "supply_resistance": "Ohm",
    "current_limit": "A", "reservoir": "F", "capacitance": "F", "sense": "F",
    "bandwidth": "Hz", "slew": "V/s",
}  # fmt: skip


def _part(
    header: Header,
    name: str,
    title: str,
    drive: Section,
    docs: dict[str, str],
    terminals: tuple[str, ...] = ("out",),
) -> Subcircuit:
    """A driver whose parameters are the keys of its scene section."""
    params = tuple(Param(key, getattr(drive, key), _UNITS[key], doc) for key, doc in docs.items())
    return _rendered(header, name, title, params, terminals)


def _rendered(
    header: Header,
    name: str,
    title: str,
    params: tuple[Param, ...],
    terminals: tuple[str, ...],
    **values: object,
) -> Subcircuit:
    pins = (
        Pin("command", *_SIGNAL),
        *(Pin(terminal, *_VOLT) for terminal in terminals),
        Pin("ref", *_VOLT),
    )
    text = render(
        f"driver_{name}.j2",
        header=part_header(header, f"{name}: {title}", pins, params),
        name=name,
        pins=[pin.name for pin in pins],
        parameters=parameter_list(params),
        **values,
    )
    helpers = [opamp_subcircuit(header, level)] if (level := _AMPLIFIERS.get(name)) else []
    return self_contained(Subcircuit(name, pins, params, text), helpers)


def _nodes(part: Subcircuit, renamed: dict[str, str]) -> tuple[str, ...]:
    return tuple(renamed.get(pin.name, pin.name) for pin in part.pins)


def _user(driver: KickDriver | CatchDriver, nodes: tuple[str, ...]) -> Driver:
    assert driver.user is not None, "a checked scene chose one driver"
    return Driver((), checked(driver.user.subckt, where="driver.user.subckt"), nodes)
