"""The part ``diode``: junction diode with the ``.model D`` of ngspice."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import Field

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.quantities import Capacitance, Current, Ratio, Resistance, Section, Time, Voltage
from kc2spice.netlist.circuit import Param
from kc2spice.parts.electronics._parts_with_netlist_template import TemplatePart
from kc2spice.physics.junction import Junction
from kc2spice.scene.part_records import NeglectedEffect, NumericalRequirements, PartResult
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    BuiltScene,
    Part,
    Scene,
    Terminal,
    WiredScene,
)


class DiodeKeys(Section):
    """Keys of a diode with the current ``i = IS (exp((v - RS i)/(N VT)) - 1)``.

    The model also includes the junction capacitance and the breakdown.

    The default values are common values of the small-signal diode 1N4148 for 100 V.
    """

    saturation_current: Current = Field(
        2.52e-9, gt=0, description="Saturation current of the diode, IS of the SPICE model"
    )
    emission: Ratio = Field(
        1.752, gt=0, description="Emission coefficient of the diode, N of the SPICE model"
    )
    series_resistance: Resistance = Field(
        0.568, ge=0, description="Series resistance of the diode, RS of the SPICE model"
    )
    capacitance: Capacitance = Field(
        4e-12, ge=0, description="Junction capacitance of the diode at 0 V, CJO of the SPICE model"
    )
    transit_time: Time = Field(
        20e-9, ge=0, description="Transit time of the diode, TT of the SPICE model"
    )
    breakdown_voltage: Voltage = Field(
        100.0, gt=0, description="Breakdown voltage of the diode, BV of the SPICE model"
    )


class Diode(TemplatePart[DiodeKeys]):
    """Part type ``diode``: junction diode."""

    name = "diode"
    title = heading = "junction diode"
    schema = DiodeKeys
    template = "diode"
    noise = "shot noise of the junction, thermal noise of the series resistance at 27 C"
    rating = "it breaks down at bv; the data sheet of the diode states its maximum current"
    validity = "27 C, or the temperature in .options temp; no self-heating"
    fixed = tuple(Terminal(pin, "V", "A", required=True) for pin in ("anode", "cathode"))

    def template_values(
        self, part: Part[DiodeKeys], build: BuiltScene
    ) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """Return the netlist parameters of the diode; the template needs no other values."""
        keys = part.keys
        params = (
            Param("is", keys.saturation_current, "A", "saturation current"),
            Param("n", keys.emission, "-", "emission coefficient"),
            Param("rs", keys.series_resistance, "Ohm", "series resistance"),
            Param("cjo", keys.capacitance, "F", "junction capacitance at 0 V"),
            Param("tt", keys.transit_time, "s", "transit time"),
            Param("bv", keys.breakdown_voltage, "V", "breakdown voltage"),
        )
        return params, {}

    def law(self, part: Part[DiodeKeys], build: BuiltScene) -> laws.Equations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice."""
        junction = Junction(part.name, *part.keys.model_dump().values())
        ends = tuple((pin.name, f"{part.name}.{pin.name}") for pin in self.fixed)
        flow = junction.flows[0].pin
        results = {f"{part.name}.i": laws.scale_wave(f"{part.name}.{flow}.through")}
        return laws.Equations((junction,), ends, results)

    def vectors(self, part: Part[DiodeKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        read, ends = f"@d.x{part.name.lower()}.djunction[id]", (("cathode",), ("anode",))
        return {f"{part.name}.i": PartResult(read, 1.0, "A", *ends)}

    def numerics(self, part: Part[DiodeKeys], scene: WiredScene) -> Iterator[NumericalRequirements]:
        """Yield a numerical requirement: a small Newton tolerance, except in transients.

        Newton's method needs a tighter tolerance, because the equation of the diode is exponential.
        """
        if scene.analysis.type != "transient":
            change = "1e-9", "convergence tolerance of Newton's method: exponential laws"
            yield NumericalRequirements(part.name, options={"reltol": change})

    def notes(self, part: Part[DiodeKeys], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys = part.keys
        yield f"diode, IS {keys.saturation_current:g} A, N {keys.emission:g}"
        yield NeglectedEffect("heating of diodes", "constant temperature of 27 °C", "not estimated")


register_part_type(Diode())
