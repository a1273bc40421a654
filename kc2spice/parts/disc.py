"""The part ``disc``: buzzers, diaphragms, piezoelectric discs (:mod:`kc2spice.bodies.disc`)."""

from __future__ import annotations

from collections.abc import Iterator

from kc2spice.bodies import disc
from kc2spice.bodies.device import Device
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Shape
from kc2spice.parts._linear_body import depoling_voltage, layer_problems
from kc2spice.parts._meshed import FieldKeys, MeshedBody, side_view
from kc2spice.rom.linear import Port
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import register


class DiscKeys(disc.Disc, FieldKeys):
    """Keys of the body, its own reduction if it has one, and whether a run recovers its fields."""


class Disc(MeshedBody):
    name = "disc"
    title = "circular layers with electrodes (axisymmetric piezoelectric FE, reduced)"
    schema = DiscKeys
    source = "FE (piezoelectric, axisymmetric)"

    def ports(self, part: Part, scene: Scene) -> tuple[Port, ...]:
        names = ["anode"]
        if any(layer.feedback for layer in part.keys.layers):
            names.append("feedback")
        electrical = (Port(n, "electrical", pins=(n, "cathode")) for n in names)
        return (*electrical, Port("centre", "mechanical"))

    def by_material(self, part: Part) -> float | None:
        return depoling_voltage(part.keys.layers, part.name, series=part.keys.wiring == "series")

    def problems(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        yield from super().problems(part, scene)
        yield from layer_problems(part, [layer.diameter for layer in part.keys.layers], plate=True)

    def outline(self, part: Part, scene: Scene) -> Iterator[Shape]:
        yield from side_view(part.name, disc.blocks(part.keys, part.name))

    def device(self, part: Part, scene: Scene) -> Device:
        return disc.device(part.keys, where=part.name)


register(Disc())
