"""Sections of the drivers: electronics between a command and the chip or the coils."""

from __future__ import annotations

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


class HalfBridge(Section):
    """Two transistors from a charged capacitor; the high one is on during the kick pulse."""

    rail: Voltage = Field(100.0, gt=0)
    resistance: Resistance = Field(2.0, gt=0, description="between the bridge and the chip")
    gate_resistance: Resistance = Field(10.0, gt=0)
    current_limit: Current = Field(15.0, gt=0, description="at which a transistor saturates")
    reservoir: Capacitance = Field(10e-6, gt=0, description="limits the charge of a pulse")
    supply_resistance: Resistance = Field(100.0, gt=0, description="that refills the reservoir")


class Amplifier(Section):
    """High-voltage operational amplifier with a class-AB output stage, gain 20."""

    rail: Voltage = Field(120.0, gt=0)
    resistance: Resistance = Field(2.0, gt=0, description="between the amplifier and the chip")
    bandwidth: Frequency = Field(2e6, gt=0, description="of the closed loop")
    slew: Slew = Field(1e9, gt=0)
    current_limit: Current = Field(15.0, gt=0)


class ChargeDrive(Section):
    """Amplifier that sets the chip's charge, ``capacitance`` times the kick pulse's voltage."""

    capacitance: Capacitance = Field(150e-9, gt=0)
    sense: Capacitance = Field(1e-6, gt=0, description="in series with the floating chip")
    rail: Voltage = Field(300.0, gt=0)
    resistance: Resistance = Field(20.0, gt=0, description="between the amplifier and the chip")
    bandwidth: Frequency = Field(200e3, gt=0, description="of the closed loop")
    slew: Slew = Field(1e9, gt=0)
    current_limit: Current = Field(10.0, gt=0)


class LinearDrive(Section):
    """Current source for the coils: operational amplifier between two rails, sense resistor."""

    rail: Voltage = Field(48.0, gt=0, description="supplies of plus and minus this voltage")
    bandwidth: Frequency = Field(50e3, gt=0, description="of the current loop")
    slew: Slew = Field(20e6, gt=0)


class PwmDrive(Section):
    """Current source for the coils: H-bridge, pulse-width modulator, PI controller."""

    rail: Voltage = Field(100.0, gt=0)
    frequency: Frequency = Field(100e3, gt=0, description="of the carrier")
    bandwidth: Frequency = Field(10e3, gt=0, description="of the current loop")
    resistance: Resistance = Field(0.5, gt=0, description="of each switch when on")
    edge: Time = Field(50e-9, gt=0, description="of the switched voltage")


class UserDrive(Section):
    """A subcircuit out of one of the scene's ``include`` files."""

    subckt: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$")


class KickDriver(Section):
    """Electronics between the kick pulse and the chip, one of these; without it an ideal source.

    A user's subcircuit has the pins ``command out ref``; the command is the kick pulse in volts.
    """

    half_bridge: HalfBridge | None = None
    amplifier: Amplifier | None = None
    charge: ChargeDrive | None = None
    user: UserDrive | None = None


class CatchDriver(Section):
    """Electronics between controller and real coils, one of these; without it ideal currents.

    A user's subcircuit has the pins ``command drive ret ref``; 100 V on command ask for 1 A.
    """

    linear: LinearDrive | None = None
    pwm: PwmDrive | None = None
    user: UserDrive | None = None
