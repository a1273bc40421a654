"""Drivers: electronics between a command and electrodes or coils."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import Field

from kc2spice.core.quantities import (
    Capacitance,
    Current,
    Frequency,
    Resistance,
    Section,
    Slew,
    Time,
    Voltage,
)
from kc2spice.fem.magnetics.table import EMTable, inductances
from kc2spice.parts.opamp import Level, opamp_subcircuit
from kc2spice.parts.pid import SENSE
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Modelled, PartType, Vector, register
from kc2spice.spice.circuit import Param, Pin, Subcircuit, positive
from kc2spice.spice.header import Header, parameter_list, part_header
from kc2spice.spice.naming import self_contained
from kc2spice.spice.render import render

CARRIER = 10.0  # V, peak of the modulator's triangle
_VOLT, _SIGNAL = ("V", "A"), ("V", "-")


class HalfBridgeKeys(Section):
    """Two transistors from a charged capacitor; the high one is on during the kick pulse."""

    rail: Voltage = Field(100.0, gt=0)
    resistance: Resistance = Field(2.0, gt=0, description="between the bridge and the chip")
    gate_resistance: Resistance = Field(10.0, gt=0)
    current_limit: Current = Field(15.0, gt=0, description="at which a transistor saturates")
    reservoir: Capacitance = Field(10e-6, gt=0, description="limits the charge of a pulse")
    supply_resistance: Resistance = Field(100.0, gt=0, description="that refills the reservoir")


class AmplifierKeys(Section):
    """High-voltage operational amplifier with a class-AB output stage, gain 20."""

    rail: Voltage = Field(120.0, gt=0)
    resistance: Resistance = Field(2.0, gt=0, description="between the amplifier and the chip")
    bandwidth: Frequency = Field(2e6, gt=0, description="of the closed loop")
    slew: Slew = Field(1e9, gt=0)
    current_limit: Current = Field(15.0, gt=0)


class ChargeKeys(Section):
    """Amplifier that sets the chip's charge, ``capacitance`` times the kick pulse's voltage."""

    capacitance: Capacitance = Field(150e-9, gt=0)
    sense: Capacitance = Field(1e-6, gt=0, description="in series with the floating chip")
    rail: Voltage = Field(300.0, gt=0)
    resistance: Resistance = Field(20.0, gt=0, description="between the amplifier and the chip")
    bandwidth: Frequency = Field(200e3, gt=0, description="of the closed loop")
    slew: Slew = Field(1e9, gt=0)
    current_limit: Current = Field(10.0, gt=0)


class LinearKeys(Section):
    """Current source for the coils: operational amplifier between two rails, sense resistor."""

    rail: Voltage = Field(48.0, gt=0, description="supplies of plus and minus this voltage")
    bandwidth: Frequency = Field(50e3, gt=0, description="of the current loop")
    slew: Slew = Field(20e6, gt=0)


class PwmKeys(Section):
    """Current source for the coils: H-bridge, pulse-width modulator, PI controller."""

    rail: Voltage = Field(100.0, gt=0)
    frequency: Frequency = Field(100e3, gt=0, description="of the carrier")
    bandwidth: Frequency = Field(10e3, gt=0, description="of the current loop")
    resistance: Resistance = Field(0.5, gt=0, description="of each switch when on")
    edge: Time = Field(50e-9, gt=0, description="of the switched voltage")


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


def half_bridge_subcircuit(
    header: Header, drive: HalfBridgeKeys, name: str = "half_bridge"
) -> Subcircuit:
    """Two transistors, gate resistors, reservoir; ``command`` switches at half the rail."""
    docs = {
        "rail": "supply",
        "resistance": "between bridge and chip",
        "gate_resistance": "of both gates",
        "current_limit": "at which a transistor saturates",
        "reservoir": "capacitor that the pulse's charge comes from",
        "supply_resistance": "through which it is refilled",
    }
    return _part(header, "half_bridge", name, "half-bridge for the chip", drive, docs)


def amplifier_subcircuit(
    header: Header, drive: AmplifierKeys, name: str = "amplifier"
) -> Subcircuit:
    """``V(out) = V(command)`` within rails, bandwidth, slew rate and current."""
    return _part(
        header, "amplifier", name, "high-voltage amplifier for the chip", drive, _AMPLIFIER
    )


def charge_drive_subcircuit(header: Header, drive: ChargeKeys, name: str = "charge") -> Subcircuit:
    """Chip charge ``= capacitance V(command)`` on a floating chip."""
    docs = {
        "capacitance": "charge of the chip per volt of command",
        "sense": "capacitor in series with the chip",
        **_AMPLIFIER,
    }
    pins = ("anode", "cathode")
    return _part(header, "charge", name, "charge drive for the chip", drive, docs, pins)


def linear_subcircuit(
    header: Header, drive: LinearKeys, load: Load, current: float, name: str = "linear"
) -> Subcircuit:
    """Coil current ``V(command) / 100 Ohm`` from an amplifier between ``+-rail``."""
    resistance = load.resistance + SENSE
    ratio = 2 * math.pi * drive.bandwidth * load.inductance / SENSE
    params = (
        positive("rail", drive.rail, "V", "supplies of plus and minus this voltage"),
        positive("slew", drive.slew, "V/s", "fastest change of the output"),
        positive("current_limit", 2 * current, "A", "largest output current"),
    )
    r2 = 1e3 * ratio
    return _rendered(
        header, "linear", name, "current source for the coils", params, ("drive", "ret"),
        sense=SENSE, inductance=load.inductance, resistance=resistance, bandwidth=drive.bandwidth,
        r2=r2, c1=load.inductance / resistance / r2,
        gbw=5 * drive.bandwidth * (1 + ratio),
    )  # fmt: skip


def pwm_subcircuit(header: Header, drive: PwmKeys, load: Load, name: str = "pwm") -> Subcircuit:
    """Coil current ``V(command) / 100 Ohm`` from an H-bridge."""
    resistance = load.resistance + 2 * drive.resistance + 1.0
    r2 = 1e5 * 2 * math.pi * drive.bandwidth * load.inductance * CARRIER / SENSE  # Ohm V
    params = (
        positive("rail", drive.rail, "V", "supply of the bridge"),
        positive("frequency", drive.frequency, "Hz", "of the carrier"),
        positive("resistance", drive.resistance, "Ohm", "of each switch when on"),
        positive("edge", drive.edge, "s", "of the switched voltage"),
    )
    return _rendered(
        header, "pwm", name, "H-bridge for the coils", params, ("drive", "ret"),
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
    template: str,
    name: str,
    title: str,
    drive: Section,
    docs: dict[str, str],
    terminals: tuple[str, ...] = ("out",),
) -> Subcircuit:
    """A driver whose parameters are the keys of its scene section."""
    params = tuple(
        positive(key, getattr(drive, key), _UNITS[key], doc) for key, doc in docs.items()
    )
    return _rendered(header, template, name, title, params, terminals)


def _rendered(
    header: Header,
    template: str,
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
        f"driver_{template}.j2",
        header=part_header(header, f"{name}: {title}", pins, params),
        name=name,
        pins=[pin.name for pin in pins],
        parameters=parameter_list(params),
        **values,
    )
    helpers = [opamp_subcircuit(header, level)] if (level := _AMPLIFIERS.get(template)) else []
    return self_contained(Subcircuit(name, pins, params, text), helpers)


class _Driver(PartType):
    """From ``command`` to its terminals; the subcircuit's last resistor is ``Rout``."""

    terminals: tuple[str, ...] = ("out",)

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        ends = (Terminal(name, *_VOLT, required=True) for name in self.terminals)
        return (Terminal("command", *_SIGNAL), *ends, Terminal("ref", *_VOLT, "gnd"))

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        values = ", ".join(f"{key} {value:g}" for key, value in part.keys)
        return Modelled(f"{part.name} ({self.name})", "circuit", values)

    def current(self, part: Part, pin: str, build: Build) -> Vector | None:
        if pin == self.terminals[0] and self.terminals[0] != "drive":
            return Vector(f"@r.x{part.name.lower()}.rout[i]", 1.0, "A")
        return None


class HalfBridge(_Driver):
    name, title = "half_bridge", "half-bridge with gate resistors and reservoir"
    schema = HalfBridgeKeys

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        return (half_bridge_subcircuit(header, part.keys, build.libraries[part.name]),)


class Amplifier(_Driver):
    name, title = "amplifier", "high-voltage amplifier with slew rate and current limit"
    schema = AmplifierKeys

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        name = build.libraries[part.name]
        return (amplifier_subcircuit(header, part.keys, name),)


class ChargeDrive(_Driver):
    name, title = "charge_drive", "charge drive for a floating capacitive load"
    schema = ChargeKeys
    terminals = ("anode", "cathode")

    def library(self, part: Part, scene: Scene) -> str:
        return "charge" if len(scene.of(self.name)) == 1 else part.name

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        name = build.libraries[part.name]
        return (charge_drive_subcircuit(header, part.keys, name),)


class _CoilDriver(_Driver):
    terminals = ("drive", "ret")

    def links(self, part: Part, scene: Scene) -> Mapping[str, str]:
        control = scene.only("pid")
        return {} if control is None else {"command": f"{control.name}.command"}

    def load(self, part: Part, build: Build) -> Load:
        """What the coils at its terminals are, with the sphere at the set point."""
        coils = _neighbour(part, "drive", build.scene, "ring_magnet_coils")
        control = _neighbour(part, "command", build.scene, "pid")
        height = control.keys.setpoint if control else 0.0
        return coil_load(build.model(coils), height)


class LinearDrive(_CoilDriver):
    name, title = "linear_drive", "current source for coils, linear amplifier between two rails"
    schema = LinearKeys

    def library(self, part: Part, scene: Scene) -> str:
        return "linear" if len(scene.of(self.name)) == 1 else part.name

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        control = _neighbour(part, "command", build.scene, "pid")
        limit = control.keys.current_limit if control else 1.0
        name = build.libraries[part.name]
        load = self.load(part, build)
        return (linear_subcircuit(header, part.keys, load, limit, name),)


class PwmDrive(_CoilDriver):
    name, title = "pwm_drive", "current source for coils, pulse-width modulated H-bridge"
    schema = PwmKeys

    def library(self, part: Part, scene: Scene) -> str:
        return "pwm" if len(scene.of(self.name)) == 1 else part.name

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        name, load = build.libraries[part.name], self.load(part, build)
        return (pwm_subcircuit(header, part.keys, load, name),)


def _neighbour(part: Part, pin: str, scene: Scene, kind: str) -> Part | None:
    """The part of this kind that a pin is joined to."""
    for name, _ in scene.joined(part.name, pin):
        if scene.parts[name].type.name == kind:
            return scene.parts[name]
    return None


for _type in (HalfBridge, Amplifier, ChargeDrive, LinearDrive, PwmDrive):
    register(_type())
