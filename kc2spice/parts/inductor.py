"""The part ``inductor``."""

from __future__ import annotations

from pydantic import Field

from kc2spice.core import laws
from kc2spice.core.quantities import Inductance, Section
from kc2spice.parts._twoterminal import TwoTerminal
from kc2spice.scene.model import Part
from kc2spice.scene.parttype import Build, Vector, register


class InductorKeys(Section):
    """``v = L di/dt``."""

    inductance: Inductance = Field(gt=0)


class Inductor(TwoTerminal):
    name, title, schema = "inductor", "ideal inductor", InductorKeys
    example = """
[inductor]
part = "inductor"
inductance = "10 uH"
pins = { a = "drive.out", b = "gnd" }

[drive]
part = "source"
kind = "current"
dc = "1 A"
"""
    letter, key, unit = "L", "inductance", "H"
    two_pole = laws.Inductor

    def through(self, part: Part, build: Build) -> Vector:
        return Vector(f"i(l{part.name.lower()})", 1.0, "A")


register(Inductor())
