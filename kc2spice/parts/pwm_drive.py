"""The part ``pwm_drive``: current source for coils, pulse-width modulated H-bridge."""

from __future__ import annotations

import math
from typing import Any

from pydantic import Field

from kc2spice.core.quantities import (
    Frequency,
    Resistance,
    Section,
    Time,
    Voltage,
)
from kc2spice.parts._drivers import (
    CARRIER,
    CoilDriver,
    Load,
    rendered_driver,
)
from kc2spice.parts.pid import SENSE
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import Build, register
from kc2spice.spice.circuit import Subcircuit, positive
from kc2spice.spice.header import Header


class PwmKeys(Section):
    """Current source for the coils: H-bridge, pulse-width modulator, PI controller."""

    rail: Voltage = Field(100.0, gt=0)
    frequency: Frequency = Field(100e3, gt=0, description="of the carrier")
    bandwidth: Frequency = Field(10e3, gt=0, description="of the current loop")
    resistance: Resistance = Field(0.5, gt=0, description="of each switch when on")
    edge: Time = Field(50e-9, gt=0, description="of the switched voltage")


class PwmDrive(CoilDriver):
    name, title = "pwm_drive", "current source for coils, pulse-width modulated H-bridge"
    schema = PwmKeys

    def library(self, part: Part, scene: Scene) -> str:
        return "pwm" if len(scene.of(self.name)) == 1 else part.name

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        name, load = build.libraries[part.name], self.load(part, build)
        return (pwm_subcircuit(header, part.keys, load, name),)


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
    return rendered_driver(
        header, "pwm", name, "H-bridge for the coils", params, ("drive", "ret"),
        sense=SENSE, inductance=load.inductance, resistance=resistance, bandwidth=drive.bandwidth,
        carrier=CARRIER, r2=r2, c1=load.inductance / resistance / r2,
    )  # fmt: skip


register(PwmDrive())
