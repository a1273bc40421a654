"""The part ``pwm_drive``: current source for coils, pulse-width modulated H-bridge."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from pydantic import Field

from kc2spice.core.quantities import Frequency, Resistance, Section, Time, Voltage
from kc2spice.netlist.circuit import Subcircuit
from kc2spice.parts import _driver_checks as driver
from kc2spice.parts._drivers import CARRIER, CoilDriver, Load, parameters
from kc2spice.parts.pid import SENSE
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import Build, Numerics, register
from kc2spice.spice.header import Header

SHUNT = 1.0  # Ohm, in the return
HEADROOM = 1.2  # rails of the controller over the triangle's peak
DUTY = 0.1  # of the rail, on average: an edge lies anywhere within a time step


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
    circuit, heading, opamp = "pwm", "H-bridge for the coils", "pole"

    def for_load(self, header: Header, keys: Any, load: Load, name: str) -> Subcircuit:
        resistance = load.resistance + 2 * keys.resistance + SHUNT
        r2 = 1e5 * 2 * math.pi * keys.bandwidth * load.inductance * CARRIER / SENSE  # Ohm V
        return self.subcircuit(
            header,
            name,
            parameters(keys, "rail", "frequency", "resistance", "edge"),
            sense=SENSE,
            inductance=load.inductance,
            resistance=resistance,
            bandwidth=keys.bandwidth,
            carrier=CARRIER,
            r2=r2,
            c1=load.inductance / resistance / r2,
        )

    def numerics(self, part: Part, scene: Scene) -> Iterable[Numerics]:
        f, edge = part.keys.frequency, part.keys.edge
        return (Numerics(f"a tenth of a period of the carrier of {part.name}", 0.1 / f, 1 / edge),)

    def limits(
        self, part: Part, build: Build, time: np.ndarray, wave: Mapping[str, np.ndarray]
    ) -> Iterable[Check]:
        """Both legs between 0 and the rail with edges as fast as the modulator's ramp, one against
        the other, and on as long as the controller asks for."""
        keys, i = part.keys, wave["i"]
        leg = wave["drive"] + keys.resistance * i
        other = wave["ret"] - (SHUNT + keys.resistance) * i
        rail, slack = keys.rail, driver.SLACK * keys.rail
        both = np.r_[leg, other]
        yield driver.within(part.name, both, 0.0, rail, slack)
        apart = float(np.abs(leg + other - rail).max()) / rail
        yield driver.check(
            part.name, "legs against each other", apart, driver.LAG, "of its rail", driver.MEANING
        )
        wanted = rail * self._duty(part, build, time, wave)
        off = float(np.trapezoid(np.abs(leg - wanted), time) / np.ptp(time)) / rail
        yield driver.check(
            part.name, "follows its command", off, DUTY, "of its rail on average", driver.MEANING
        )

    def _duty(
        self, part: Part, build: Build, time: np.ndarray, wave: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Share of the rail on the first leg: ``u = command + (command - 100 Ohm i) k (1 + 1 / (s
        L / R))``, ``k = 2 pi f L CARRIER / (100 Ohm rail)``, against a triangle of ``CARRIER``."""
        keys, load = part.keys, self.load(part, build)
        ratio = 2 * math.pi * keys.bandwidth * load.inductance * CARRIER / (SENSE * keys.rail)
        resistance = load.resistance + 2 * keys.resistance + SHUNT
        lasting = (1 + 1 / ratio) * load.inductance / resistance
        seen, command, rails = SENSE * SHUNT * wave["i"], wave["command"], HEADROOM * CARRIER
        wanted = (1 + ratio) * command - ratio * seen
        # Middles of the steps: an integral of their beginnings drifts away with the ripple.
        meant, mean = ((v + np.append(v[1:], v[-1])) / 2 for v in (wanted, seen))
        u, held = np.empty_like(time), 0.0  # V, of the integral's capacitor
        for k, step in enumerate(np.diff(time, append=time[-1])):
            u[k] = np.clip(wanted[k] - held, -rails, rails)
            held += step * (mean[k] - np.clip(meant[k] - held, -rails, rails) - held) / lasting
        triangle = 2 * CARRIER / math.pi * np.arcsin(np.sin(2 * math.pi * keys.frequency * time))
        steep = 2 * CARRIER * keys.frequency * keys.edge
        return np.asarray(0.5 + 0.5 * np.clip((u - triangle) / steep, -1.0, 1.0))


register(PwmDrive())
