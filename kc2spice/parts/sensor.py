"""A position sensor with bandwidth, offset and noise, between a height and a controller."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import Field

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import BOLTZMANN, TEMPERATURE, Frequency, Length, Section
from kc2spice.netlist.circuit import Param
from kc2spice.parts._template import TemplatePart
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Vector, register


class SensorKeys(Section):
    """Reads a position: one pole, an offset, white noise."""

    bandwidth: Frequency = Field(1e6, gt=0)
    offset: Length = 0.0
    noise: Length = Field(
        0.0,
        ge=0,
        description="rms of each sample, of which there are two a period of the bandwidth",
    )


class Sensor(TemplatePart):
    name = "sensor"
    title = "position sensor with bandwidth, offset and noise"
    schema = SensorKeys
    source = "closed form"
    template, heading = "sensor", "position sensor"
    noise = ("Rnoise",)
    rating = "no range: compare the reading with that of your sensor"
    validity = "linear, one pole, constant temperature"
    fixed = (
        Terminal("of", "um", "-", required=True),
        Terminal("out", "um", "-", signal_out=True),
        Terminal("ref", "V", "A", "gnd"),
    )
    example = """
[sensor]
part = "sensor"
bandwidth = "100 kHz"
pins = { of = "push.out" }

[push]
part = "source"
kind = "displacement"
dc = "1 um"
"""

    def problems(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        kinds = ("transient", "noise")
        if part.keys.noise and scene.analysis.type not in kinds:
            words = "noise is drawn in time, or analysed"
            yield part.wrong("noise", words, scene.analysis.type, f"{' or '.join(kinds)}, or none")

    def design(self, part: Part, build: Build) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        keys = part.keys
        params = (
            Param("bandwidth", keys.bandwidth, "Hz", "of the reading", 0.0),
            Param("offset", keys.offset, "m", "added to the reading"),
        )
        # white up to the bandwidth, over the noise voltage of an ohm
        root = math.sqrt(4 * BOLTZMANN * TEMPERATURE * keys.bandwidth)
        gain = 1e6 * keys.noise / root if build.noisy else 0.0
        return params, {"noise": keys.noise, "step": 0.5 / keys.bandwidth, "gain": gain}

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        return {f"{part.name}.y": build.across(part, "out")}

    def notes(self, part: Part, scene: Scene) -> Iterator[str]:
        keys = part.keys
        yield f"{keys.bandwidth:g} Hz, offset {keys.offset:g} m, noise {keys.noise:g} m rms"


register(Sensor())
