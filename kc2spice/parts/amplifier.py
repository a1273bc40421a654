"""The part ``amplifier``: high-voltage amplifier with slew rate and current limit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from pydantic import Field

from kc2spice.core.quantities import Current, Frequency, Resistance, Section, Slew, Voltage
from kc2spice.parts._driver_checks import Stage
from kc2spice.parts._drivers import Driver
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Part
from kc2spice.scene.parttype import Build, register

FEEDBACK = 20e3  # Ohm, of what returns the output
SINK = -10.0  # V, the lower rail


class AmplifierKeys(Section):
    """High-voltage operational amplifier with a class-AB output stage, gain 20."""

    rail: Voltage = Field(120.0, gt=0, description="supply")
    resistance: Resistance = Field(2.0, gt=0, description="between amplifier and chip")
    bandwidth: Frequency = Field(2e6, gt=0, description="of the closed loop")
    slew: Slew = Field(1e9, gt=0, description="fastest change of the output")
    current_limit: Current = Field(15.0, gt=0, description="largest output current")


class Amplifier(Driver):
    name, title = "amplifier", "high-voltage amplifier with slew rate and current limit"
    schema = AmplifierKeys
    circuit, heading = "amplifier", "high-voltage amplifier for the chip"

    def limits(
        self, part: Part, build: Build, time: np.ndarray, wave: Mapping[str, np.ndarray]
    ) -> Iterable[Check]:
        keys = part.keys
        volts = wave["out"] + keys.resistance * wave["i"]
        return Stage(
            time,
            wave["command"] - volts,
            volts,
            wave["i"] + volts / FEEDBACK,
            SINK,
            keys.rail,
            keys.slew,
            keys.current_limit,
            keys.bandwidth,
        ).checks(part.name)


register(Amplifier())
