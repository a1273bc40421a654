"""Linear elements between two pins: a table, one row each, from which their part types are made.

A row says how what goes *through* the element (current, force) follows from what lies *across* it,
and under which key its value stands. Keys, pins, card, results, the law of the independent
integrator, documentation and example follow from the row.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field, create_model

from kc2spice.core import laws
from kc2spice.core.quantities import Section, si
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.cards import number
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Modelled, PartType, Vector, register


@dataclass(frozen=True)
class Domain:
    """What the elements between pins of one kind share.

    1 V on a node is ``scale`` of the pin's quantity in SI, ``per_si`` its inverse; 1 A is 1 in SI.
    ``shifts``: the pin's quantity is the integral of the one whose product with ``through`` is the
    power. ``flows`` spells integral, value and derivative of the latter, ``through`` value and
    derivative.
    """

    kind: str
    node: tuple[str, str]
    results: tuple[str, ...]
    scale: float
    per_si: float
    shifts: bool
    source: str
    flows: tuple[str, str, str]
    through: tuple[str, str]
    drive: str


ELECTRICAL = Domain(
    "electrical", ("V", "A"), ("v", "i"), 1.0, 1.0, False, "circuit",
    ("integral of v dt", "v", "dv/dt"), ("i", "di/dt"), 'dc = "1 V"',
)  # fmt: skip
MECHANICAL = Domain(
    "displacement", ("um", "N"), ("force",), 1e-6, 1e6, True, "closed form",
    ("(x_a - x_b)", "(x_a' - x_b')", "(x_a'' - x_b'')"), ("F", "F'"),
    'kind = "force"\ndc = "10 mN"',
)  # fmt: skip


@dataclass(frozen=True)
class Element:
    """A row: ``through = y d^order/dt^order`` of voltage or velocity from pin ``a`` to ``b``.

    ``order`` is -1 (stores by the integral: inductor, spring), 0 (dissipates) or 1 (stores by the
    value: capacitor). ``y`` is the value of ``key`` in SI, or one over it where it is ``inverse``.
    ``symbol`` stands for the key in the documentation, ``value`` in the example, which ``drive``
    drives where a constant voltage or force would not do. A mechanical element of order 1 has no
    card of its own: SPICE has no second derivative.
    """

    name: str
    title: str
    domain: Domain
    order: int
    key: str
    symbol: str
    unit: str
    value: str
    inverse: bool = False
    drive: str = ""

    @property
    def letter(self) -> str:
        """Of its card; a displacement is the integral of the velocity."""
        return {-1: "L", 0: "R", 1: "C"}[self.order + self.domain.shifts]

    @property
    def equation(self) -> str:
        """The relation in words of the documentation."""
        flows, through = self.domain.flows, self.domain.through
        if self.inverse:
            return f"{flows[1 + max(self.order, 0)]} = {self.symbol} {through[-min(self.order, 0)]}"
        return f"{through[0]} = {self.symbol} {flows[1 + self.order]}"

    @property
    def example(self) -> str:
        """Tables of a small scene."""
        return f"""
[{self.name}]
part = "{self.name}"
{self.key} = "{self.value}"
pins = {{ a = "drive.out", b = "gnd" }}

[drive]
part = "source"
{self.drive or self.domain.drive}
"""


TABLE = (
    Element("resistor", "ideal resistor", ELECTRICAL, 0,
            "resistance", "R", "Ohm", "50 Ohm", inverse=True),
    Element("capacitor", "ideal capacitor", ELECTRICAL, 1, "capacitance", "C", "F", "100 nF"),
    Element("inductor", "ideal inductor", ELECTRICAL, -1,
            "inductance", "L", "H", "10 uH", inverse=True, drive='kind = "current"\ndc = "1 A"'),
    Element("spring", "linear spring between two displacement pins", MECHANICAL, -1,
            "stiffness", "k", "N/m", "100 N/m"),
    Element("damper", "viscous damper between two displacement pins", MECHANICAL, 0,
            "damping", "c", "N s/m", "0.02 N s/m"),
)  # fmt: skip


class TwoTerminal(PartType):
    """The part type of a row.

    Currents are not read from the device (``@r[i]``), which ngspice gives at the operating point
    alone in an ac analysis: a resistance has its law, an inductance its branch, and a capacitance
    an ideal meter in series at pin ``a``.
    """

    def __init__(self, row: Element) -> None:
        self.row = row
        # Names of a type are constants of its class elsewhere; here of its one instance.
        vars(self).update(name=row.name, title=row.title, example=row.example)
        fields: dict[str, Any] = {row.key: (Annotated[float, si(row.unit)], Field(gt=0))}
        vars(self)["schema"] = create_model(
            f"{row.name.title()}Keys", __base__=Section, __module__=__name__,
            __doc__=f"``{row.equation}``.", **fields,
        )  # fmt: skip

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        ground = None if scene.named(part.name, "b") else "gnd"
        node = self.row.domain.node
        return (Terminal("a", *node, required=True), Terminal("b", *node, ground))

    def holds(self, part: Part, scene: Scene, model: Any | None) -> tuple[tuple[str, str], ...]:
        return (("a", "b"),) if self.row.domain.shifts and self.row.order < 0 else ()

    def own_names(self, part: Part, scene: Scene) -> tuple[tuple[str, ...], ...]:
        return (_meter(part), _inner(part)) if self.row.letter == "C" else ()

    def cards(self, part: Part, build: Build) -> tuple[str, ...]:
        row, a, b = self.row, build.net(part, "a"), build.net(part, "b")
        key, impedance = self._key(part), row.letter != "C"
        scale = row.domain.per_si if impedance else row.domain.scale
        value = number(scale * key if impedance == row.inverse else scale / key)
        if row.letter != "C":
            return (f"{row.letter}{part.name} {a} {b} {value}",)
        inner = build.own(part, *_inner(part))
        return (
            f"{build.own(part, *_meter(part))} {a} {inner} 0",
            f"{row.letter}{part.name} {inner} {b} {value}",
        )

    def through(self, part: Part, build: Build) -> Vector:
        """The current or force from ``a`` to ``b``."""
        row, unit = self.row, self.row.domain.node[1]
        if row.letter == "R":
            return Vector(_across(part, build), row.domain.scale * self._admittance(part), unit)
        own = build.own(part, *_meter(part)) if row.letter == "C" else f"l{part.name}"
        return Vector(f"i({own.lower()})", 1.0, unit)

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        *across, through = (f"{part.name}.{name}" for name in self.row.domain.results)
        domain = self.row.domain
        seen = {name: Vector(_across(part, build), domain.scale, domain.node[0]) for name in across}
        return seen | {through: self.through(part, build)}

    def current(self, part: Part, pin: str, build: Build) -> Vector | None:
        if self.row.domain is not ELECTRICAL:
            return None
        found = self.through(part, build)
        return Vector(found.expression, -found.factor if pin == "a" else found.factor, "A")

    def force_on(self, part: Part, pin: str, build: Build, waves: Waveforms) -> np.ndarray | None:
        found = waves.data.get(f"{part.name}.force")
        return None if found is None else (-found if pin == "a" else found)

    def law(self, part: Part, build: Build) -> laws.Equations:
        n, row = part.name, self.row
        *across, through = (f"{n}.{name}" for name in row.domain.results)
        results = {name: laws.difference(f"{n}.a", f"{n}.b") for name in across}
        results[through] = laws.reading(f"{n}.a.through")
        law = laws.TwoTerminal(n, row.order, self._admittance(part), row.domain.kind)
        return laws.Equations((law,), (("a", f"{n}.a"), ("b", f"{n}.b")), results)

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        row = self.row
        detail = f"{row.name} of {self._key(part):g} {row.unit}"
        return Modelled(part.name, row.domain.source, detail)

    def _key(self, part: Part) -> float:
        return float(getattr(part.keys, self.row.key))

    def _admittance(self, part: Part) -> float:
        return 1.0 / self._key(part) if self.row.inverse else self._key(part)


def _across(part: Part, build: Build) -> str:
    """From pin ``a`` to pin ``b``."""
    a, b = build.net(part, "a"), build.net(part, "b")
    return f"v({a})" if b == "0" else f"-v({b})" if a == "0" else f"v({a})-v({b})"


def _meter(part: Part) -> tuple[str, ...]:
    return (f"V{part.name}", "meter")


def _inner(part: Part) -> tuple[str, ...]:
    return (part.name.lower(), "metered")


for _row in TABLE:
    register(TwoTerminal(_row))
