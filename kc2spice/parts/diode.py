"""Junction diode: ngspice's ``.model D`` with documented parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from kc2spice.core.quantities import (
    Capacitance,
    Current,
    Ratio,
    Resistance,
    Section,
    Time,
    Voltage,
)
from kc2spice.netlist.circuit import Param, Pin, Subcircuit
from kc2spice.netlist.render import render
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, LeftOut, Modelled, PartType, Vector, register
from kc2spice.spice.header import parameter_list, part_header

_PINS = (Pin("anode", "V", "A"), Pin("cathode", "V", "A"))


class DiodeKeys(Section):
    """``i = IS (exp((v - RS i)/(N VT)) - 1)`` with junction capacitance, transit time, breakdown.

    The defaults are those in common use for a 1N4148 (small signal, 100 V).
    """

    saturation_current: Current = Field(2.52e-9, gt=0, description="IS")
    emission: Ratio = Field(1.752, gt=0, description="N, of the exponent")
    series_resistance: Resistance = Field(0.568, ge=0, description="RS")
    capacitance: Capacitance = Field(4e-12, ge=0, description="CJO, of the junction at 0 V")
    transit_time: Time = Field(20e-9, ge=0, description="TT")
    breakdown_voltage: Voltage = Field(100.0, gt=0, description="BV")


class Diode(PartType):
    name = "diode"
    title = "junction diode"
    schema = DiodeKeys

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        return tuple(Terminal(pin.name, "V", "A", required=True) for pin in _PINS)

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        name, keys = build.libraries[part.name], part.keys
        params = (
            Param("is", keys.saturation_current, "A", "saturation current"),
            Param("n", keys.emission, "-", "emission coefficient"),
            Param("rs", keys.series_resistance, "Ohm", "series resistance"),
            Param("cjo", keys.capacitance, "F", "junction capacitance at 0 V"),
            Param("tt", keys.transit_time, "s", "transit time"),
            Param("bv", keys.breakdown_voltage, "V", "breakdown voltage"),
        )
        text = render(
            "diode.j2",
            header=part_header(
                header,
                f"{name}: junction diode",
                _PINS,
                params,
                rating="it breaks through at bv; its largest current is in the diode's data sheet",
                validity="27 C, or what .options temp says; it does not heat up",
            ),
            name=name,
            pins=[pin.name for pin in _PINS],
            parameters=parameter_list(params),
        )
        return (Subcircuit(name, _PINS, params, text),)

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        return {f"{part.name}.i": Vector(f"@d.x{part.name.lower()}.djunction[id]", 1.0, "A")}

    def current(self, part: Part, pin: str, build: Build) -> Vector | None:
        sign = -1.0 if pin == "anode" else 1.0
        return Vector(f"@d.x{part.name.lower()}.djunction[id]", sign, "A")

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        keys = part.keys
        detail = f"diode, IS {keys.saturation_current:g} A, N {keys.emission:g}"
        return Modelled(part.name, "circuit", detail)

    def left_out(self, part: Part, scene: Scene) -> tuple[LeftOut, ...]:
        return (LeftOut("heating of diodes", "27 °C throughout", "not estimated"),)


register(Diode())
