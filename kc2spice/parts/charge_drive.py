"""The part ``charge_drive``: charge drive for a floating capacitive load."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

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
from kc2spice.parts._driver_checks import Stage
from kc2spice.parts._drivers import Driver, ends
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Part
from kc2spice.scene.parttype import Build, register


class ChargeKeys(Section):
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
    terminals, fixed = ("anode", "cathode"), ends("anode", "cathode")
    circuit, heading = "charge", "charge drive for the chip"

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


register(ChargeDrive())
