"""A position sensor with bandwidth, offset and noise, between a height and a controller."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import Field

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Frequency, Length, Section
from kc2spice.netlist.circuit import Param, Pin, Subcircuit
from kc2spice.netlist.render import render
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Modelled, PartType, Vector, register
from kc2spice.spice.header import Header, parameter_list, part_header

_PINS = (Pin("of", "um", "-"), Pin("out", "um", "-"), Pin("ref", "V", "A"))


class SensorKeys(Section):
    """Reads a position: one pole, an offset, white noise."""

    bandwidth: Frequency = Field(1e6, gt=0)
    offset: Length = 0.0
    noise: Length = Field(
        0.0,
        ge=0,
        description="rms of each sample, of which there are two a period of the bandwidth",
    )


class Sensor(PartType):
    name = "sensor"
    title = "position sensor with bandwidth, offset and noise"
    schema = SensorKeys
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

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        return (
            Terminal("of", "um", "-", required=True),
            Terminal("out", "um", "-", signal_out=True),
            Terminal("ref", "V", "A", "gnd"),
        )

    def problems(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        if part.keys.noise and scene.analysis.type != "transient":
            yield UsageError(
                "noise is drawn in time",
                where=f"{part.name}.noise",
                got=scene.analysis.type,
                expected="a transient, or no noise",
            )

    def subcircuits(self, part: Part, build: Build, header: Header) -> tuple[Any, ...]:
        keys, name = part.keys, build.libraries[part.name]
        params = (
            Param("bandwidth", keys.bandwidth, "Hz", "of the reading", 0.0),
            Param("offset", keys.offset, "m", "added to the reading"),
        )
        text = render(
            "sensor.j2",
            header=part_header(
                header,
                f"{name}: position sensor",
                _PINS,
                params,
                rating="no range: compare the reading with that of your sensor",
                validity="linear, one pole, constant temperature",
            ),
            name=name,
            pins=[pin.name for pin in _PINS],
            parameters=parameter_list(params),
            noise=keys.noise,
            step=0.5 / keys.bandwidth,
        )
        return (Subcircuit(name, _PINS, params, text),)

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        return {f"{part.name}.y": Vector(f"v({build.net(part, 'out')})", 1e-6, "m")}

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        keys = part.keys
        detail = f"{keys.bandwidth:g} Hz, offset {keys.offset:g} m, noise {keys.noise:g} m rms"
        return Modelled(part.name, "closed form", detail)


register(Sensor())
