"""The part ``damper`` between two displacement pins."""

from __future__ import annotations

from pydantic import Field

from kc2spice.core import laws
from kc2spice.core.quantities import MechanicalDamping, Section
from kc2spice.parts._mechanical import Link
from kc2spice.parts._twoterminal import meter, metered
from kc2spice.scene.model import Part
from kc2spice.scene.parttype import Build, Vector, register
from kc2spice.spice.cards import number


class DamperKeys(Section):
    """``F = c (x_a' - x_b')``."""

    damping: MechanicalDamping = Field(gt=0)


class Damper(Link):
    name, title, schema = "damper", "viscous damper between two displacement pins", DamperKeys
    example = """
[damper]
part = "damper"
damping = "0.02 N s/m"
pins = { a = "push.out", b = "gnd" }

[push]
part = "source"
kind = "force"
dc = "10 mN"
"""

    def cards(self, part: Part, build: Build) -> tuple[str, ...]:
        a, b = build.net(part, "a"), build.net(part, "b")
        return metered(part, "C", number(1e-6 * part.keys.damping), a, b)

    def through(self, part: Part, build: Build) -> Vector:
        return Vector(meter(part).expression, 1.0, "N")

    def link(self, part: Part) -> laws.Law:
        return laws.Damper(part.name, part.keys.damping)


register(Damper())
