"""The part ``linear_drive``: current source for coils, linear amplifier between two rails."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from pydantic import Field

from kc2spice.core.quantities import Frequency, Section, Slew, Voltage
from kc2spice.netlist.circuit import Subcircuit, positive
from kc2spice.parts._driver_checks import Stage, relaxed
from kc2spice.parts._drivers import CoilDriver, Load, parameters
from kc2spice.parts.pid import SENSE
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Part
from kc2spice.scene.parttype import Build, register
from kc2spice.spice.header import Header


class LinearKeys(Section):
    """Current source for the coils: operational amplifier between two rails, sense resistor."""

    rail: Voltage = Field(48.0, gt=0, description="supplies of plus and minus this voltage")
    bandwidth: Frequency = Field(50e3, gt=0, description="of the current loop")
    slew: Slew = Field(20e6, gt=0, description="fastest change of the output")


class LinearDrive(CoilDriver):
    name, title = "linear_drive", "current source for coils, linear amplifier between two rails"
    schema = LinearKeys
    circuit, heading = "linear", "current source for the coils"

    def for_load(self, header: Header, keys: Any, load: Load, name: str) -> Subcircuit:
        resistance = load.resistance + SENSE
        ratio = 2 * math.pi * keys.bandwidth * load.inductance / SENSE
        limit = positive("current_limit", 2 * load.current, "A", "largest output current")
        return self.subcircuit(
            header,
            name,
            (*parameters(keys, "rail", "slew"), limit),
            sense=SENSE,
            inductance=load.inductance,
            resistance=resistance,
            bandwidth=keys.bandwidth,
            r2=1e3 * ratio,
            c1=load.inductance / resistance / (1e3 * ratio),
            gbw=5 * keys.bandwidth * (1 + ratio),
        )

    def limits(
        self, part: Part, build: Build, time: np.ndarray, wave: Mapping[str, np.ndarray]
    ) -> Iterable[Check]:
        """``drive = command + (command - V(ret)) k (1 + 1 / (s L / R))``, ``k = 2 pi f L / 100
        Ohm``, through an amplifier of five times the bandwidth ``f``."""
        keys, load = part.keys, self.load(part, build)
        ratio = 2 * math.pi * keys.bandwidth * load.inductance / SENSE
        lasting = (1 + 1 / ratio) * load.inductance / (load.resistance + SENSE)
        held = relaxed(time, wave["ret"] - wave["drive"], lasting)  # by the integral's capacitor
        returned = (ratio * wave["ret"] + wave["drive"] + held) / (1 + ratio)
        return Stage(
            time,
            wave["command"] - returned,
            wave["drive"] + wave["i"],
            wave["i"],
            -keys.rail,
            keys.rail,
            keys.slew,
            2 * load.current,
            5 * keys.bandwidth * (1 + ratio),
            1 / (1 + ratio),
        ).checks(part.name)


register(LinearDrive())
