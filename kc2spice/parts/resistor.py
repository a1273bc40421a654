"""The part ``resistor``."""

from __future__ import annotations

from pydantic import Field

from kc2spice.core import laws
from kc2spice.core.quantities import Resistance, Section
from kc2spice.parts._twoterminal import TwoTerminal, across
from kc2spice.scene.model import Part
from kc2spice.scene.parttype import Build, Vector, register


class ResistorKeys(Section):
    """``v = R i``."""

    resistance: Resistance = Field(gt=0)


class Resistor(TwoTerminal):
    name, title, schema = "resistor", "ideal resistor", ResistorKeys
    example = """
[resistor]
part = "resistor"
resistance = "50 Ohm"
pins = { a = "drive.out", b = "gnd" }

[drive]
part = "source"
dc = "1 V"
"""
    letter, key, unit = "R", "resistance", "Ohm"
    two_pole = laws.Resistor

    def through(self, part: Part, build: Build) -> Vector:
        return Vector(across(part, build), 1.0 / part.keys.resistance, "A")


register(Resistor())
