"""The part ``langevin``: a bolted sandwich transducer (:mod:`kc2spice.bodies.langevin`)."""

from __future__ import annotations

from collections.abc import Iterator

from kc2spice.bodies import langevin
from kc2spice.bodies.device import Device
from kc2spice.core.figure import Shape
from kc2spice.fem.materials import material
from kc2spice.parts._meshed import FieldKeys, MeshedBody, side_view
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
        yield from side_view(part.name, langevin.blocks(part.keys, part.name))

    def device(self, part: Part, scene: Scene) -> Device:
        return langevin.device(part.keys, where=part.name)


register(Langevin())
