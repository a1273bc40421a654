"""The part ``charge_drive``: charge drive for a floating capacitive load."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from pydantic import Field

from kc2spice.core.quantities import (
    Capacitance,
    Current,
    Frequency,
    Resistance,
    Section,
    Slew,
    Voltage,
)
from kc2spice.netlist.circuit import Subcircuit
from kc2spice.parts._driver_checks import Stage
from kc2spice.parts._drivers import (
    AMPLIFIER,
    Driver,
    driver_part,
)
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import Build, register
from kc2spice.spice.header import Header


class ChargeKeys(Section):
    """Amplifier that sets the chip's charge, ``capacitance`` times the kick pulse's voltage."""

    capacitance: Capacitance = Field(150e-9, gt=0)
    sense: Capacitance = Field(1e-6, gt=0, description="in series with the floating chip")
    rail: Voltage = Field(300.0, gt=0)
    resistance: Resistance = Field(20.0, gt=0, description="between the amplifier and the chip")
    bandwidth: Frequency = Field(200e3, gt=0, description="of the closed loop")
    slew: Slew = Field(1e9, gt=0)
    current_limit: Current = Field(10.0, gt=0)


class ChargeDrive(Driver):
    name, title = "charge_drive", "charge drive for a floating capacitive load"
    schema = ChargeKeys
    terminals = ("anode", "cathode")

    def library(self, part: Part, scene: Scene) -> str:
        return "charge" if len(scene.of(self.name)) == 1 else part.name

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        name = build.libraries[part.name]
        return (charge_drive_subcircuit(header, part.keys, name),)

    def limits(
        self, part: Part, build: Build, time: np.ndarray, wave: Mapping[str, np.ndarray]
    ) -> Iterable[Check]:
        keys = part.keys
        share = keys.capacitance / (keys.sense + keys.capacitance)
        error = wave["command"] * keys.capacitance / keys.sense - wave["cathode"]
        return Stage(
            time,
            error,
            wave["anode"] + keys.resistance * wave["i"],
            wave["i"],
            -keys.rail,
            keys.rail,
            keys.slew,
            keys.current_limit,
            keys.bandwidth / share,
            share,
        ).checks(part.name)


def charge_drive_subcircuit(header: Header, drive: ChargeKeys, name: str = "charge") -> Subcircuit:
    """Chip charge ``= capacitance V(command)`` on a floating chip."""
    docs = {
        "capacitance": "charge of the chip per volt of command",
        "sense": "capacitor in series with the chip",
        **AMPLIFIER,
    }
    pins = ("anode", "cathode")
    return driver_part(header, "charge", name, "charge drive for the chip", drive, docs, pins)


register(ChargeDrive())
