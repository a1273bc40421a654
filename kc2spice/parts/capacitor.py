"""The part ``capacitor``."""

from __future__ import annotations

from pydantic import Field

from kc2spice.core import laws
from kc2spice.core.quantities import Capacitance, Section
from kc2spice.parts._twoterminal import TwoTerminal, meter, metered
from kc2spice.scene.model import Part
from kc2spice.scene.parttype import Build, Vector, register
from kc2spice.spice.cards import number


class CapacitorKeys(Section):
    """``i = C dv/dt``."""

    capacitance: Capacitance = Field(gt=0)


class Capacitor(TwoTerminal):
    name, title, schema = "capacitor", "ideal capacitor", CapacitorKeys
    example = """
[capacitor]
part = "capacitor"
capacitance = "100 nF"
pins = { a = "drive.out", b = "gnd" }

[drive]
part = "source"
dc = "1 V"
"""
    letter, key, unit = "C", "capacitance", "F"
    two_pole = laws.Capacitor

    def cards(self, part: Part, build: Build) -> tuple[str, ...]:
        a, b = build.net(part, "a"), build.net(part, "b")
        return metered(part, "C", number(part.keys.capacitance), a, b)

    def through(self, part: Part, build: Build) -> Vector:
        return meter(part)


register(Capacitor())
