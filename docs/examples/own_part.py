"""Own part type: a spring that hardens, in a scene with a mass."""

from pydantic import Field

import kc2spice as kc
from kc2spice.scene.parttype import Vector


class HardSpringKeys(kc.Section):
    """``F = k x + h x^3``; x in metres."""

    k: float = Field(gt=0, description="N/m")
    h: float = Field(0.0, ge=0, description="N/m^3")


class HardSpring(kc.PartType):
    """One module says all: keys, pins, cards, results. Nothing else has to know the type."""

    name, title, schema = "hard_spring", "spring that hardens", HardSpringKeys

    def pins(self, part, scene):
        return (kc.Terminal("a", "um", "N", required=True), kc.Terminal("b", "um", "N", "gnd"))

    def cards(self, part, build):
        a, b = build.net(part, "a"), build.net(part, "b")
        x = f"(v({a}, {b})*1e-6)"
        law = f"{part.keys.k!r}*{x}+{part.keys.h!r}*{x}*{x}*{x}"
        return (f"B{part.name} {a} {b} I={law}",)

    def vectors(self, part, build):
        return {f"{part.name}.force": Vector(f"@b{part.name}[i]", 1.0, "N")}


kc.register_part(HardSpring())
result = kc.run({
    "name": "hardening",
    "plate": {"part": "hard_spring", "k": 100.0, "h": 1e10, "pins": {"a": "push.out"}},
    "guide": {"part": "spring", "stiffness": "20 N/m", "pins": {"a": "push.out"}},
    "push": {"part": "source", "kind": "displacement", "dc": "0 um"},
    "analysis": {"type": "dc", "sweep": "push.dc", "from": "0 um", "to": "200 um", "points": 41},
    "probes": {"force_n": {"of": "plate.force", "take": "final"}},
})  # fmt: skip
print(result)
result.plot("plate.force", "guide.force").savefig("own_part.png")
x = 200e-6
assert abs(result.metrics["force_n"] / (100 * x + 1e10 * x**3) - 1) < 1e-6
