"""The part ``linear_drive``: current source for coils, linear amplifier between two rails."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from pydantic import Field

from kc2spice.core.quantities import (
    Frequency,
    Section,
    Slew,
    Voltage,
)
from kc2spice.netlist.circuit import Subcircuit, positive
from kc2spice.parts._driver_checks import Stage, relaxed
from kc2spice.parts._drivers import (
    CoilDriver,
    Load,
    neighbour,
    rendered_driver,
)
from kc2spice.parts.pid import SENSE
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import Build, register
from kc2spice.spice.header import Header


class LinearKeys(Section):
    """Current source for the coils: operational amplifier between two rails, sense resistor."""

    rail: Voltage = Field(48.0, gt=0, description="supplies of plus and minus this voltage")
    bandwidth: Frequency = Field(50e3, gt=0, description="of the current loop")
    slew: Slew = Field(20e6, gt=0)


class LinearDrive(CoilDriver):
    name, title = "linear_drive", "current source for coils, linear amplifier between two rails"
    schema = LinearKeys

    def library(self, part: Part, scene: Scene) -> str:
        return "linear" if len(scene.of(self.name)) == 1 else part.name

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        name, load = build.libraries[part.name], self.load(part, build)
        return (linear_subcircuit(header, part.keys, load, _most(part, build.scene), name),)

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
            2 * _most(part, build.scene),
            5 * keys.bandwidth * (1 + ratio),
            1 / (1 + ratio),
        ).checks(part.name)


def _most(part: Part, scene: Scene) -> float:
    """Largest current [A] that its controller asks for."""
    control = neighbour(part, "command", scene, "pid")
    return float(control.keys.current_limit) if control else 1.0


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
    return rendered_driver(
        header,
        "linear",
        name,
        "current source for the coils",
        params,
        ("drive", "ret"),
        sense=SENSE,
        inductance=load.inductance,
        resistance=resistance,
        bandwidth=drive.bandwidth,
        r2=r2,
        c1=load.inductance / resistance / r2,
        gbw=5 * drive.bandwidth * (1 + ratio),
    )


register(LinearDrive())
