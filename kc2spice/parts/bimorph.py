"""The part ``bimorph``: layered beams and plates that bend (:mod:`kc2spice.bodies.bimorph`)."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import accumulate, pairwise

from kc2spice.bodies import bimorph
from kc2spice.bodies.axisymmetric import Block
from kc2spice.bodies.device import Device
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Shape
from kc2spice.fem.materials import material
from kc2spice.parts._linear_body import depoling_voltage, layer_problems
from kc2spice.parts._meshed import FieldKeys, MeshedBody, side_view
from kc2spice.rom.linear import Port
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import register


class BimorphKeys(bimorph.Bimorph, FieldKeys):
    """Keys of the body, its own reduction if it has one, and whether a run recovers its fields."""


class Bimorph(MeshedBody):
    name = "bimorph"
    title = "layered beam that bends (3-D piezoelectric FE, reduced)"
    schema = BimorphKeys
    example = """
[bimorph]
part = "bimorph"
length = "30 mm"
width = "5 mm"
layers = [
  { material = "PZT-5A", thickness = "0.3 mm" },
  { material = "PZT-5A", thickness = "0.3 mm" },
]
wiring = "parallel"
pins = { anode = "drive.out" }

[drive]
part = "source"
dc = "50 V"
"""
    source = "FE (piezoelectric, hexahedra)"

    def by_material(self, part: Part) -> float | None:
        return depoling_voltage(part.keys.layers, part.name, series=part.keys.wiring != "parallel")

    def problems(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        yield from super().problems(part, scene)
        widths = [part.keys.width] * len(part.keys.layers)
        yield from layer_problems(part, widths, plate=False)

    def ports(self, part: Part, scene: Scene) -> tuple[Port, ...]:
        keys = part.keys
        found = []
        if any(material(x.material, part.name).piezoelectric for x in keys.layers):
            found.append(Port("anode", "electrical", pins=("anode", "cathode")))
        if keys.support != "clamped":
            found.append(Port("tip", "mechanical"))
        found += [Port(name, "mechanical") for name in keys.points]
        if keys.support != "free":
            found.append(Port("base", "acceleration"))
        return tuple(found)

    def outline(self, part: Part, scene: Scene) -> Iterator[Shape]:
        ends = pairwise(accumulate((layer.thickness for layer in part.keys.layers), initial=0.0))
        half = (0.0, part.keys.length / 2)
        yield from side_view(
            part.name,
            [
                Block(half, span, material(layer.material, part.name))
                for layer, span in zip(part.keys.layers, ends, strict=True)
            ],
        )

    def device(self, part: Part, scene: Scene) -> Device:
        return bimorph.device(part.keys, where=part.name)


register(Bimorph())
