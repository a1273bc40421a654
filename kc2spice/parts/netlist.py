"""A subcircuit out of the user's own netlist, read and checked before a simulator sees it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import Field

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Section
from kc2spice.core.words import did_you_mean
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Modelled, PartType, register
from kc2spice.spice.circuit import Pin, Subcircuit
from kc2spice.spice.scan import third_party

KINDS = {"V/A": ("V", "A"), "um/N": ("um", "N"), "m/s/N": ("m/s", "N"), "V": ("V", "-")}


class NetlistKeys(Section):
    """``.subckt SUBCKT`` of ``file``, which stands beside the scene."""

    file: str = Field(min_length=1, max_length=255)
    subckt: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$")
    units: dict[str, str] = Field(
        default_factory=dict, description="kind of a pin, V/A unless told: um/N, m/s/N, V"
    )


class Netlist(PartType):
    name = "netlist"
    title = "the user's own subcircuit"
    schema = NetlistKeys

    def uses_netlists(self, part: Part) -> bool:
        return True

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        found = []
        for name in _pins(part, scene):
            unit, flow = KINDS[part.keys.units.get(name, "V/A")]
            ground = name in ("ref", "gnd", "base")
            found.append(Terminal(name, unit, flow, "gnd" if ground else None, required=not ground))
        return tuple(found)

    def problems(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        pins = _pins(part, scene)
        for name, kind in part.keys.units.items():
            if name not in pins or kind not in KINDS:
                yield UsageError(
                    "not a kind of a pin", where=f"{part.name}.units.{name}", got=repr(kind),
                    expected=f"one of {', '.join(KINDS)} for one of {', '.join(pins)}",
                )  # fmt: skip

    def library(self, part: Part, scene: Scene) -> str:
        return str(part.keys.subckt)

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        path = build.scene.home / part.keys.file
        text = third_party(path, trust=build.trust)
        pins = tuple(Pin(t.name, t.unit, t.flow) for t in self.pins(part, build.scene))
        return (Subcircuit(part.keys.subckt, pins, (), text, file=path.name),)

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        detail = f".subckt {part.keys.subckt} of {part.keys.file}"
        return Modelled(part.name, "yours", detail)


def _pins(part: Part, scene: Scene) -> tuple[str, ...]:
    """Pins of the subcircuit in its own order.

    Raises
    ------
    UsageError : the file cannot be read or has no such subcircuit.
    """
    known: Mapping[str, tuple[str, ...]] = subcircuit_pins(scene.home / part.keys.file)
    pins = known.get(part.keys.subckt.lower())
    if pins is None:
        raise UsageError(
            "no such subcircuit", where=f"{part.name}.subckt", got=repr(part.keys.subckt),
            expected=", ".join(known) or f"a .subckt in {part.keys.file}",
            hint=did_you_mean(part.keys.subckt, known),
        )  # fmt: skip
    return pins


register(Netlist())
