"""Own part type: a spring that hardens, stated by its energy, in a scene with another one."""

from pydantic import Field

import kc2spice as kc
from kc2spice.physics import Declaration, DeclaredPart, displacement


class HardSpringKeys(kc.Section):
    """``F = k x + h x^3``; x in metres."""

    k: float = Field(gt=0, description="N/m")
    h: float = Field(0.0, ge=0, description="N/m^3")


# One statement says all: pins, netlist, law, energy and results follow from it.
kc.register_part(DeclaredPart(Declaration(
    "hard_spring", "spring that hardens", HardSpringKeys, (displacement("x", "a", "b"),),
    energy="k*x^2/2 + h*x^4/4",
)))  # fmt: skip
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
