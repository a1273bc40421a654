"""Resistor, capacitor and inductor between two electrical pins."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import Field

from kc2spice.core.quantities import Capacitance, Inductance, Resistance, Section
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Modelled, PartType, Vector, register
from kc2spice.spice.cards import number


class ResistorKeys(Section):
    """``v = R i``."""

    resistance: Resistance = Field(gt=0)


class CapacitorKeys(Section):
    """``i = C dv/dt``."""

    capacitance: Capacitance = Field(gt=0)


class InductorKeys(Section):
    """``v = L di/dt``."""

    inductance: Inductance = Field(gt=0)


class _TwoTerminal(PartType):
    """One card ``LETTERname a b value``."""

    letter: str
    key: str
    unit: str

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        ground = None if scene.named(part.name, "b") else "gnd"
        return (Terminal("a", "V", "A", required=True), Terminal("b", "V", "A", ground))

    def cards(self, part: Part, build: Build) -> tuple[str, ...]:
        a, b = build.net(part, "a"), build.net(part, "b")
        return (f"{self.letter}{part.name} {a} {b} {number(getattr(part.keys, self.key))}",)

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        a, b = build.net(part, "a"), build.net(part, "b")
        device = f"{self.letter.lower()}{part.name.lower()}"
        across = f"v({a})" if b == "0" else f"-v({b})" if a == "0" else f"v({a})-v({b})"
        return {
            f"{part.name}.v": Vector(across, 1.0, "V"),
            f"{part.name}.i": Vector(f"@{device}[i]", 1.0, "A"),
        }

    def current(self, part: Part, pin: str, build: Build) -> Vector | None:
        device = f"{self.letter.lower()}{part.name.lower()}"
        return Vector(f"@{device}[i]", -1.0 if pin == "a" else 1.0, "A")

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        value = getattr(part.keys, self.key)
        return Modelled(part.name, "circuit", f"{self.name} of {value:g} {self.unit}")


class Resistor(_TwoTerminal):
    name, title, schema = "resistor", "ideal resistor", ResistorKeys
    letter, key, unit = "R", "resistance", "Ohm"


class Capacitor(_TwoTerminal):
    name, title, schema = "capacitor", "ideal capacitor", CapacitorKeys
    letter, key, unit = "C", "capacitance", "F"


class Inductor(_TwoTerminal):
    name, title, schema = "inductor", "ideal inductor", InductorKeys
    letter, key, unit = "L", "inductance", "H"


for _type in (Resistor, Capacitor, Inductor):
    register(_type())
