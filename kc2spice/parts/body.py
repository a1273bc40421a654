"""The part ``body``: the user's own mesh or CAD file (:mod:`kc2spice.bodies.body`)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

from kc2spice.bodies import body
from kc2spice.bodies.device import Device, part_named
from kc2spice.core.cache import cached
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Curve, Figure, Panel
from kc2spice.core.foreign import beside
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.mesh_file import length_unit, require_format
from kc2spice.parts._linear_body import file_stamp
from kc2spice.parts._meshed import FieldKeys, MeshedBody
from kc2spice.parts._pictures import outline
from kc2spice.rom.linear import Port
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import Build, register


class BodyKeys(body.Body, FieldKeys):
    """Keys of the body, its own reduction if it has one, and whether a run recovers its fields."""


class Body(MeshedBody):
    name = "body"
    title = "the user's own mesh (piezoelectric FE, reduced)"
    schema = BodyKeys
    declares = True
    source = "FE (piezoelectric, the user's mesh)"

    def ports(self, part: Part, scene: Scene) -> tuple[Port, ...]:
        return body.ports(part.keys)

    def files(self, part: Part, scene: Scene) -> tuple[str, ...]:
        beside(scene.home, part.keys.mesh, f"{part.name}.mesh")
        return (part.keys.mesh,)

    def problems(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        yield from super().problems(part, scene)
        try:
            path = beside(scene.home, part.keys.mesh, f"{part.name}.mesh")
            require_format(path)
            if path.is_file():
                length_unit(path, part.keys.unit)
        except UsageError as error:
            if error.where == "unit":
                error.where = f"{part.name}.unit"
            yield error

    def detail(self, part: Part, scene: Scene) -> str:

        def size() -> str:
            with part_named(part.name):
                return body.size_in_words(part.keys, scene.home)

        key = {"file": _stamp(part, scene), "unit": part.keys.unit}
        text, _ = cached("extent", key, size, sources=self.sources())
        return f"{text}; {super().detail(part, scene)}"

    def full_key(self, part: Part, scene: Scene) -> dict[str, Any]:
        return {**super().full_key(part, scene), "file": _stamp(part, scene)}

    def figures(self, part: Part, build: Build, waves: Waveforms) -> Iterator[Figure]:
        """Its mesh, then what all bodies show."""
        x, y = cached(
            "outline",
            self.full_key(part, build.scene),
            lambda: outline(self.device(part, build.scene).solid.mesh),
            sources=self.sources(),
        )[0]
        panel = Panel("mm", "mm", (Curve("", x, y),), equal=True)
        caption = f"Edges of the mesh {part.keys.mesh}."
        yield Figure(f"{part.name}_mesh", f"Mesh of {part.name}", caption, (panel,))
        yield from super().figures(part, build, waves)

    def device(self, part: Part, scene: Scene) -> Device:
        # unset keys stay out: a group is picked by the keys that it has
        keys = part.keys.model_dump_json(exclude_unset=True, include=set(body.Body.model_fields))
        return _device(keys, scene.home, _stamp(part, scene), part.name)


def _stamp(part: Part, scene: Scene) -> str:
    return file_stamp(beside(scene.home, part.keys.mesh, f"{part.name}.mesh"))


@lru_cache(maxsize=2)
def _device(keys: str, home: Path, stamp: str, where: str) -> Device:
    parsed = body.Body.model_validate_json(keys)
    return body.device(parsed, home, where=where)


register(Body())
