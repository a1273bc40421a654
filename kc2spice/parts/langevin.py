"""The part ``langevin``: a bolted sandwich transducer (:mod:`kc2spice.bodies.langevin`)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from kc2spice.bodies import langevin
from kc2spice.bodies.device import Device
from kc2spice.core.figure import Shape
from kc2spice.fem.materials import material
from kc2spice.parts._meshed import FieldKeys, MeshedBody
from kc2spice.rom.linear import Port
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import register


class LangevinKeys(langevin.Langevin, FieldKeys):
    """Keys of the body, its own reduction if it has one, and whether a run recovers its fields."""


class Langevin(MeshedBody):
    name = "langevin"
    title = "bolted sandwich transducer (axisymmetric piezoelectric FE, reduced)"
    schema = LangevinKeys
    example = """
[langevin]
part = "langevin"
front = [{ material = "aluminium", diameter = "20 mm", length = "30 mm" }]
back = [{ material = "steel", diameter = "20 mm", length = "20 mm" }]
rings = { material = "PZT-8", outer = "20 mm", inner = "8 mm", thickness = "3 mm" }
bolt = { material = "steel", diameter = "6 mm" }
pins = { anode = "drive.out" }

[drive]
part = "source"
ac = "1 V"

[analysis]
type = "ac"
start = "10 kHz"
stop = "100 kHz"
"""
    source = "FE (piezoelectric, axisymmetric)"

    def by_material(self, part: Part) -> float | None:
        """Rings lie between anode and cathode one by one."""
        rings = part.keys.rings
        limit = material(rings.material, f"{part.name}.rings").depoling_field
        return None if limit is None else float(limit * rings.thickness)

    def ports(self, part: Part, scene: Scene) -> tuple[Port, ...]:
        faces = ("front",) if part.keys.support == "back" else ("front", "back")
        anode = Port("anode", "electrical", pins=("anode", "cathode"))
        return (anode, *(Port(name, "mechanical") for name in faces))

    def outline(self, part: Part, scene: Scene) -> Iterator[Shape]:
        keys, y = part.keys, 0.0
        rings = keys.rings
        stack = [(c, c.diameter, 0.0, c.length, "front") for c in reversed(keys.front)]
        stack += [(rings, rings.outer, rings.inner, rings.thickness, "ring")] * rings.count
        stack += [(c, c.diameter, 0.0, c.length, "back") for c in keys.back]
        for k, (one, width, hole, high, what) in enumerate(stack):
            label = f"{part.name}: {what}, {material(one.material, part.name).name}, "
            label += f"{1e3 * width:g} mm by {1e3 * high:g} mm"
            named = label if k == 0 or stack[k - 1][0] is not one else ""
            kind: Literal["ceramic", "metal"] = "ceramic" if one is rings else "metal"
            if hole:
                for side in (-1, 1):
                    yield Shape(
                        side * (width + hole) / 4,
                        y - high / 2,
                        (width - hole) / 2,
                        high,
                        kind,
                        named if side > 0 else "",
                    )
            else:
                yield Shape(0.0, y - high / 2, width, high, kind, named)
            y -= high
        bolt = keys.bolt
        first = sum(c.length for c in keys.front)
        deep = bolt.depth if bolt.depth is not None else keys.front[0].length
        top, end = deep - first, y
        label = f"{part.name}: bolt, {material(bolt.material, part.name).name}, "
        label += f"{1e3 * bolt.diameter:g} mm"
        yield Shape(0.0, (top + end) / 2, bolt.diameter, top - end, "metal", label)
        if bolt.head_length is not None:
            yield Shape(0.0, end - bolt.head_length / 2, bolt.head_diameter, bolt.head_length)

    def device(self, part: Part, scene: Scene) -> Device:
        return langevin.device(self.body_keys(part), where=part.name)


register(Langevin())
