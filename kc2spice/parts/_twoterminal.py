"""What resistor, capacitor and inductor share: one card between two electrical pins."""

from __future__ import annotations

from collections.abc import Mapping

from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Modelled, PartType, Vector
from kc2spice.spice.cards import number


class TwoTerminal(PartType):
    """One card ``LETTERname a b value``."""

    letter: str
    key: str
    unit: str

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        return (Terminal("a", "V", "A", required=True), Terminal("b", "V", "A", "gnd"))

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
