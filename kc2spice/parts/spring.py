"""The part ``spring`` between two displacement pins."""

from __future__ import annotations

from pydantic import Field

from kc2spice.core import laws
from kc2spice.core.quantities import Section, Stiffness
from kc2spice.parts._mechanical import Link
from kc2spice.parts._twoterminal import across
from kc2spice.scene.model import Part
from kc2spice.scene.parttype import Build, Vector, register
from kc2spice.spice.cards import number


class SpringKeys(Section):
    """``F = k (x_a - x_b)``."""

    stiffness: Stiffness = Field(gt=0)


class Spring(Link):
    name, title, schema = "spring", "linear spring between two displacement pins", SpringKeys
    example = """
[spring]
part = "spring"
stiffness = "100 N/m"
pins = { a = "push.out", b = "gnd" }

[push]
part = "source"
kind = "force"
dc = "10 mN"
"""

    def cards(self, part: Part, build: Build) -> tuple[str, ...]:
        a, b = build.net(part, "a"), build.net(part, "b")
        return (f"R{part.name} {a} {b} {number(1e6 / part.keys.stiffness)}",)

    def through(self, part: Part, build: Build) -> Vector:
        return Vector(across(part, build), 1e-6 * part.keys.stiffness, "N")

    def link(self, part: Part) -> laws.Law:
        return laws.Spring(part.name, part.keys.stiffness)


register(Spring())
