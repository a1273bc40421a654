"""What resistor, capacitor and inductor share: one card between two electrical pins."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

from kc2spice.core import laws
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Modelled, PartType, Vector
from kc2spice.spice.cards import number


class TwoTerminal(PartType):
    """One card ``LETTERname a b value``.

    Currents are not read from the device (``@r[i]``), which ngspice gives at the operating point
    alone in an ac analysis.
    """

    two_pole: type
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
        through = self.through(part, build)
        return {f"{part.name}.v": Vector(across(part, build), 1.0, "V"), f"{part.name}.i": through}

    @abstractmethod
    def through(self, part: Part, build: Build) -> Vector:
        """The current from ``a`` to ``b``."""

    def current(self, part: Part, pin: str, build: Build) -> Vector | None:
        found = self.through(part, build)
        return Vector(found.expression, -found.factor if pin == "a" else found.factor, "A")

    def law(self, part: Part, build: Build) -> laws.Equations:
        n = part.name
        results = {
            f"{n}.v": laws.difference(f"{n}.a", f"{n}.b"),
            f"{n}.i": laws.reading(f"{n}.a.through"),
        }
        pins = (("a", f"{n}.a"), ("b", f"{n}.b"))
        return laws.Equations((self.two_pole(n, getattr(part.keys, self.key)),), pins, results)

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        value = getattr(part.keys, self.key)
        return Modelled(part.name, "circuit", f"{self.name} of {value:g} {self.unit}")


def across(part: Part, build: Build) -> str:
    """The voltage from pin ``a`` to pin ``b``."""
    a, b = build.net(part, "a"), build.net(part, "b")
    return f"v({a})" if b == "0" else f"-v({b})" if a == "0" else f"v({a})-v({b})"


def metered(part: Part, letter: str, value: str, a: str, b: str) -> tuple[str, ...]:
    """A card with an ideal meter in series at ``a``; see :func:`meter`."""
    inner = f"{part.name.lower()}_metered"
    return (f"V{part.name}_meter {a} {inner} 0", f"{letter}{part.name} {inner} {b} {value}")


def meter(part: Part) -> Vector:
    """What the meter of :func:`metered` reads, from ``a`` to ``b``."""
    return Vector(f"i(v{part.name.lower()}_meter)", 1.0, "A")
