"""The drivers: what each is made of, what its keys are, and what its output obeys by them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

import numpy as np
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
from kc2spice.core.waveforms import running
from kc2spice.netlist.circuit import Param, positive
from kc2spice.parts import _drivers as driver
from kc2spice.parts._drivers import LAG, SLACK, CoilDriver, Driver, Load, relaxed, stage
from kc2spice.parts._template import InputNoise, parameters
from kc2spice.parts.pid import SENSE
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import Build, Numerics, register

Waves = Mapping[str, np.ndarray]


class AmplifierKeys(InputNoise):
    """High-voltage operational amplifier with a class-AB output stage, gain 20."""

    rail: Voltage = Field(120.0, gt=0, description="supply")
    resistance: Resistance = Field(2.0, gt=0, description="between amplifier and chip")
    bandwidth: Frequency = Field(2e6, gt=0, description="of the closed loop")
    slew: Slew = Field(1e9, gt=0, description="fastest change of the output")
    current_limit: Current = Field(15.0, gt=0, description="largest output current")


class Amplifier(Driver):
    name, title = "amplifier", "high-voltage amplifier with slew rate and current limit"
    schema = AmplifierKeys
    template, heading = "driver_amplifier", "high-voltage amplifier for the chip"
    resistive = ("R", "Rout")
    constants: ClassVar = {"sink": -10}  # V, the lower rail

    def limits(self, part: Part, build: Build, time: np.ndarray, wave: Waves) -> Iterable[Check]:
        keys = part.keys
        volts = wave["out"] + keys.resistance * wave["i"]
        return stage(
            part.name,
            time,
            wave["command"] - volts,
            volts,
            wave["i"] + volts / 20e3,  # what returns the output
            (self.constants["sink"], keys.rail),
            keys.slew,
            keys.current_limit,
            keys.bandwidth,
        )


class ChargeKeys(InputNoise):
    """Amplifier that sets the chip's charge, ``capacitance`` times the kick pulse's voltage."""

    capacitance: Capacitance = Field(
        150e-9, gt=0, description="charge of the chip per volt of command"
    )
    sense: Capacitance = Field(1e-6, gt=0, description="capacitor in series with the chip")
    rail: Voltage = Field(300.0, gt=0, description="supply")
    resistance: Resistance = Field(20.0, gt=0, description="between amplifier and chip")
    bandwidth: Frequency = Field(200e3, gt=0, description="of the closed loop")
    slew: Slew = Field(1e9, gt=0, description="fastest change of the output")
    current_limit: Current = Field(10.0, gt=0, description="largest output current")


class ChargeDrive(Driver):
    name, title = "charge_drive", "charge drive for a floating capacitive load"
    schema = ChargeKeys
    template, heading = "driver_charge", "charge drive for the chip"
    resistive = ("Rout", "Rsense", "Rchip")
    terminals, fixed = ("anode", "cathode"), driver.ends("anode", "cathode")

    def limits(self, part: Part, build: Build, time: np.ndarray, wave: Waves) -> Iterable[Check]:
        keys = part.keys
        share = keys.capacitance / (keys.sense + keys.capacitance)
        return stage(
            part.name,
            time,
            wave["command"] * keys.capacitance / keys.sense - wave["cathode"],
            wave["anode"] + keys.resistance * wave["i"],
            wave["i"],
            (-keys.rail, keys.rail),
            keys.slew,
            keys.current_limit,
            keys.bandwidth / share,
            share,
        )


class HalfBridgeKeys(Section):
    """Two transistors from a charged capacitor; the high one is on during the kick pulse."""

    rail: Voltage = Field(100.0, gt=0, description="supply")
    resistance: Resistance = Field(2.0, gt=0, description="between bridge and chip")
    gate_resistance: Resistance = Field(10.0, gt=0, description="of both gates")
    current_limit: Current = Field(15.0, gt=0, description="at which a transistor saturates")
    reservoir: Capacitance = Field(
        10e-6, gt=0, description="capacitor that the pulse's charge comes from"
    )
    supply_resistance: Resistance = Field(100.0, gt=0, description="through which it is refilled")


class HalfBridge(Driver):
    name, title = "half_bridge", "half-bridge with gate resistors and reservoir"
    schema = HalfBridgeKeys
    template, heading = "driver_half_bridge", "half-bridge for the chip"
    resistive = ("Rout", "Rsupply", "Rhigh", "Rlow")
    opamp = None
    # V, V, F to the source and F to the drain, A of the diode in each transistor
    constants: ClassVar = {
        "gate": 12,
        "threshold": 3,
        "source": 5e-10,
        "miller": 2e-11,
        "diode": 1e-14,
    }

    def limits(self, part: Part, build: Build, time: np.ndarray, wave: Waves) -> Iterable[Check]:
        """Between the rails but for the diodes and for charge that returns to the reservoir; the
        gates' currents come on top of a transistor's. Long after its command reached a rail, and
        far from saturation, the bridge is as far from the reservoir or from ``ref`` as ``i = limit
        (1 - (1 - v / (gate - threshold))^2)`` of a transistor says."""
        keys, i, command, own = part.keys, wave["i"], wave["command"], self.constants
        bridge, rail = wave["out"] + keys.resistance * i, keys.rail
        drop = 0.03 * np.log1p(np.abs(i).max() / own["diode"])  # V for a factor e, at 75 C
        charge = running(i, time)
        back = float((np.maximum.accumulate(charge) - charge).max()) / keys.reservoir
        yield driver.within(part.name, bridge, -drop, rail + drop + back, SLACK * rail)
        inside = (bridge > 0) & (bridge < rail)
        most = keys.current_limit + own["gate"] / keys.gate_resistance
        yield driver.bounded(part.name, i[inside], most)
        supply = keys.supply_resistance
        tank = rail - supply * i * (command > rail / 2)
        tank = relaxed(time, tank, supply * keys.reservoir)
        off = np.zeros_like(time)
        share = i / keys.current_limit
        opened = own["gate"] - own["threshold"]
        across = opened * (1 - np.sqrt(1 - np.minimum(np.abs(share), 1)))
        settled = 10 * keys.gate_resistance * (own["source"] + own["miller"])
        for on, end, beyond in (
            (command >= rail, tank, bridge >= tank),
            (command <= 0, 0.0, bridge <= 0),
        ):  # beyond it a diode conducts as well
            lasted = time - np.maximum.accumulate(np.where(on, time[0], time))
            judged = (lasted > settled) & (np.abs(share) < 0.9)
            judged &= ~beyond | (across < LAG * rail)
            found = np.abs(bridge - end + np.sign(i) * across)
            off = np.maximum(off, np.where(judged, found, 0.0))
        value = float(off.max()) / rail
        yield driver.check(part.name, "follows its command", value, LAG, "of its rail")


class LinearKeys(InputNoise):
    """Current source for the coils: operational amplifier between two rails, sense resistor."""

    rail: Voltage = Field(48.0, gt=0, description="supplies of plus and minus this voltage")
    bandwidth: Frequency = Field(50e3, gt=0, description="of the current loop")
    slew: Slew = Field(20e6, gt=0, description="fastest change of the output")


class LinearDrive(CoilDriver):
    name, title = "linear_drive", "current source for coils, linear amplifier between two rails"
    schema = LinearKeys
    template, heading = "driver_linear", "current source for the coils"
    resistive = ("R", "Rout", "Rsense")
    constants: ClassVar = {"sense": SENSE}

    def for_load(self, keys: Any, load: Load) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """``drive = command + (command - V(ret)) ratio (1 + 1 / (s L / R))``, ``ratio = 2 pi f L /
        100 Ohm``, through an amplifier of five times the bandwidth ``f``."""
        ratio = 2 * math.pi * keys.bandwidth * load.inductance / SENSE
        resistance = load.resistance + SENSE
        limit = positive("current_limit", 2 * load.current, "A", "largest output current")
        return (*parameters(keys, "rail", "slew"), limit), {
            "inductance": load.inductance,
            "resistance": resistance,
            "bandwidth": keys.bandwidth,
            "ratio": ratio,
            "constant": load.inductance / resistance,
            "gbw": 5 * keys.bandwidth * (1 + ratio),
        }

    def limits(self, part: Part, build: Build, time: np.ndarray, wave: Waves) -> Iterable[Check]:
        keys, load = part.keys, self.load(part, build)
        _, made = self.for_load(keys, load)
        ratio, volts, sensed = made["ratio"], wave["drive"], SENSE * wave["i"]
        lasting = (1 + 1 / ratio) * made["constant"]
        held = relaxed(time, sensed - volts, lasting)  # by the integral's capacitor
        back = (ratio * sensed + volts + held) / (1 + ratio)
        return stage(
            part.name,
            time,
            wave["command"] - back,
            volts + wave["i"],
            wave["i"],
            (-keys.rail, keys.rail),
            keys.slew,
            2 * load.current,
            made["gbw"],
            1 / (1 + ratio),
        )


class PwmKeys(Section):
    """Current source for the coils: H-bridge, pulse-width modulator, PI controller."""

    rail: Voltage = Field(100.0, gt=0, description="supply of the bridge")
    frequency: Frequency = Field(100e3, gt=0, description="of the carrier")
    bandwidth: Frequency = Field(10e3, gt=0, description="of the current loop")
    resistance: Resistance = Field(0.5, gt=0, description="of each switch when on")
    edge: Time = Field(50e-9, gt=0, description="of the switched voltage")


class PwmDrive(CoilDriver):
    name, title = "pwm_drive", "current source for coils, pulse-width modulated H-bridge"
    schema = PwmKeys
    template, heading = "driver_pwm", "H-bridge for the coils"
    opamp = "pole"
    noise = "no noise: it switches, which an operating point knows nothing of"
    # V, peak of the triangle, and the controller's rails over it; Ohm, in the return, and V for
    # each ampere in it
    constants: ClassVar = {"carrier": 10.0, "headroom": 1.2, "shunt": 1, "sense": SENSE}

    def for_load(self, keys: Any, load: Load) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """``u = command + (command - 100 Ohm i) ratio (1 + 1 / (s L / R))``, ``ratio = 2 pi f L
        carrier / (100 Ohm rail)``, against a triangle of ``carrier``."""
        resistance = load.resistance + 2 * keys.resistance + self.constants["shunt"]
        r2 = (
            1e5 * 2 * math.pi * keys.bandwidth * load.inductance * self.constants["carrier"] / SENSE
        )
        return parameters(keys, "rail", "frequency", "resistance", "edge"), {
            "inductance": load.inductance,
            "resistance": resistance,
            "bandwidth": keys.bandwidth,
            "r2": r2,  # Ohm V, 1e5 times ratio and rail
            "constant": load.inductance / resistance,
        }

    def numerics(self, part: Part, scene: Scene) -> Iterable[Numerics]:
        f, edge = part.keys.frequency, part.keys.edge
        return (Numerics(f"a tenth of a period of the carrier of {part.name}", 0.1 / f, 1 / edge),)

    def limits(self, part: Part, build: Build, time: np.ndarray, wave: Waves) -> Iterable[Check]:
        """Both legs between 0 and the rail, one against the other, and on as long as the controller
        asks for; an edge lies anywhere within a time step."""
        keys, i, rail, own = part.keys, wave["i"], part.keys.rail, self.constants
        leg = wave["drive"] + keys.resistance * i
        other = wave["ret"] - (own["shunt"] + keys.resistance) * i
        yield driver.within(part.name, np.r_[leg, other], 0.0, rail, SLACK * rail)
        apart = float(np.abs(leg + other - rail).max()) / rail
        yield driver.check(part.name, "legs against each other", apart, LAG, "of its rail")
        wanted = rail * self._duty(part, build, time, wave)
        off = float(np.trapezoid(np.abs(leg - wanted), time) / np.ptp(time)) / rail
        yield driver.check(part.name, "follows its command", off, 0.1, "of its rail on average")

    def _duty(self, part: Part, build: Build, time: np.ndarray, wave: Waves) -> np.ndarray:
        """Share of the rail on the first leg, of the controller that :meth:`for_load` states and
        whose output ends at the amplifier's rails."""
        keys, own = part.keys, self.constants
        _, made = self.for_load(keys, self.load(part, build))
        carrier, ratio = own["carrier"], made["r2"] / 1e5 / keys.rail
        lasting, most = (1 + 1 / ratio) * made["constant"], own["headroom"] * carrier
        seen = SENSE * wave["i"]
        wanted = (1 + ratio) * wave["command"] - ratio * seen
        # Middles of the steps: an integral of their beginnings drifts away with the ripple.
        asked, mean = ((v + np.append(v[1:], v[-1])) / 2 for v in (wanted, seen))
        u, held = np.empty_like(time), 0.0  # V, of the integral's capacitor
        for k, step in enumerate(np.diff(time, append=time[-1])):
            u[k] = np.clip(wanted[k] - held, -most, most)
            held += step * (mean[k] - np.clip(asked[k] - held, -most, most) - held) / lasting
        triangle = 2 * carrier / math.pi * np.arcsin(np.sin(2 * math.pi * keys.frequency * time))
        steep = 2 * carrier * keys.frequency * keys.edge
        return np.asarray(0.5 + 0.5 * np.clip((u - triangle) / steep, -1.0, 1.0))


for _driver in (Amplifier, ChargeDrive, HalfBridge, LinearDrive, PwmDrive):
    register(_driver())
