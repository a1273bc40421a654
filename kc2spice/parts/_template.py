"""Parts whose netlist is a template of ``templates/``, and the operational amplifier in them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

from pydantic import Field

from kc2spice.core.quantities import Current, Section, Voltage
from kc2spice.core.units import BOLTZMANN, TEMPERATURE
from kc2spice.netlist.circuit import Param, Subcircuit, positive
from kc2spice.netlist.transforms import self_contained
from kc2spice.scene.keys import model_keys
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, PartType
from kc2spice.spice.header import ROOM, SIGN, Header, library

BANDWIDTH = 1e9  # Hz, gain-bandwidth product of a fast decompensated amplifier

Level = Literal["pole", "slew"]
_NOTHING: Mapping[str, Any] = {}


class InputNoise(Section):
    """White noise of an operational amplifier's inputs, in a noise analysis alone."""

    noise_voltage: Voltage | None = Field(
        None, gt=0, description="between its amplifier's inputs, rms in 1 Hz; none unless told"
    )
    noise_current: Current | None = Field(
        None, gt=0, description="out of each of them, rms in 1 Hz; none unless told"
    )


class TemplatePart(PartType):
    """A part whose cards are ``templates/TEMPLATE.j2``, with an amplifier of the level ``opamp``.

    ``heading`` says in its library's first line what it is; ``fixed`` are its pins, ``constants``
    numbers of the template that no key sets.
    """

    template: ClassVar[str]
    heading: ClassVar[str]
    fixed: ClassVar[tuple[Terminal, ...]]
    rating: ClassVar[str]
    validity: ClassVar[str] = ROOM
    sign: ClassVar[str] = SIGN
    opamp: ClassVar[Level | None] = None
    constants: ClassVar[Mapping[str, float]] = {}

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        return self.fixed

    def design(self, part: Part, build: Build) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """Parameters of its netlist, and further values that the template asks for."""
        return parameters(part.keys), _NOTHING

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        name, pins = build.libraries[part.name], self.pins(part, build.scene)
        params, values = self.design(part, build)
        if build.noisy and isinstance(part.keys, InputNoise):
            values = {**values, "input_noise": part.keys}
        return (self.netlist(header, name, params, values, pins),)

    def netlist(
        self,
        header: Header,
        name: str,
        params: tuple[Param, ...],
        values: Mapping[str, Any] = _NOTHING,
        pins: Sequence[Terminal] = (),
    ) -> Subcircuit:
        """Its library under this name."""
        told = {"rating": self.rating, "validity": self.validity, "sign": self.sign}
        words: dict[str, Any] = {**told, **self.constants, **values}
        made = library(
            self.template, header, name, self.heading, pins or self.fixed, params, **words
        )
        if not self.opamp:
            return made
        return self_contained(
            made, [opamp_subcircuit(header, self.opamp, values.get("input_noise"))]
        )


def parameters(keys: Section, *names: str) -> tuple[Param, ...]:
    """Keys, or those with these ``names``, as parameters of a netlist, all above zero."""
    return tuple(
        positive(key.name, getattr(keys, key.name), key.unit or "-", key.doc)
        for key in model_keys(type(keys))
        if (not names or key.name in names) and key.name not in InputNoise.model_fields
    )


def opamp_subcircuit(
    header: Header, level: Level = "pole", noise: InputNoise | None = None
) -> Subcircuit:
    """``V(out) = A(s) (V(inp) - V(inn))``, ``A = a0 / (1 + s a0 / (2 pi gbw))``, between the rails
    ``vee`` and ``vcc``, behind an output resistance and with an input offset.

    ``slew``: the same with limited slew rate and output current, as ``opamp_slew``, and with the
    ``noise`` of its inputs: voltages of resistors of 1 Ohm, ``sqrt(4 k T 1 Ohm)``, times a gain.
    """
    pins = [Terminal(pin, "V", "A") for pin in ("inp", "inn", "out", "vcc", "vee", "ref")]
    params = (
        positive("a0", 1e7, "-", "gain at rest"),
        positive("gbw", BANDWIDTH, "Hz", "gain-bandwidth product"),
        positive("rout", 0.1, "Ohm", "output resistance"),
        Param("offset", 0.0, "V", "input offset"),
    )
    title, rating = "operational amplifier", "its output stays between vee and vcc"
    if level == "pole":
        stiff = positive("clip", 1e3, "S", "stiffness of the rails")
        return library("opamp", header, "opamp", title, pins, (*params, stiff), rating=rating)
    limits = (
        positive("slew", 1e9, "V/s", "fastest change of the output"),
        positive("current_limit", 1.0, "A", "largest output current"),
    )
    title += " with slew rate and current limit"
    ohm = math.sqrt(4 * BOLTZMANN * TEMPERATURE)
    found = (noise.noise_voltage, noise.noise_current) if noise else (None, None)
    volts, amperes = (each / ohm if each else None for each in found)
    told: dict[str, Any] = {"rating": rating, "volts": volts, "amperes": amperes}
    return library("opamp_slew", header, "opamp_slew", title, pins, params + limits, **told)
