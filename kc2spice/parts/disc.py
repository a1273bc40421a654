"""The part ``disc``: buzzers, diaphragms, piezoelectric discs (:mod:`kc2spice.bodies.disc`)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from kc2spice.bodies import disc
from kc2spice.core.figure import Shape
from kc2spice.parts._linear_body import BodyKeys, LinearBody, depoling_voltage, layered
from kc2spice.rom.linear import LinearModel, Port
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import register


class DiscKeys(disc.Disc, BodyKeys):
    """Keys of the body, and its own reduction if it has one."""


class Disc(LinearBody):
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

    def rated(self, part: Part) -> float | None:
        return depoling_voltage(part, series=part.keys.wiring == "series")

    def outline(self, part: Part, scene: Scene) -> Iterator[Shape]:
        yield from layered(part, [layer.diameter for layer in part.keys.layers])

    def full(self, part: Part, scene: Scene, clock: Any, refine: int = 1) -> LinearModel:
        with clock.stage("assemble", f"matrices of {part.name}"):
            return disc.build(self.body_keys(part), refine=refine, where=part.name)


register(Disc())
