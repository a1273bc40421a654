"""The part ``body``: the user's own mesh or CAD file (:mod:`kc2spice.bodies.body`)."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

from kc2spice.bodies import body
from kc2spice.bodies.device import Device
from kc2spice.parts._linear_body import file_stamp
from kc2spice.parts._meshed import FieldKeys, MeshedBody
from kc2spice.rom.linear import Port
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import register


class BodyKeys(body.Body, FieldKeys):
    """Keys of the body, its own reduction if it has one, and whether a run recovers its fields."""


class Body(MeshedBody):
    name = "body"
    title = "the user's own mesh (piezoelectric FE, reduced)"
    schema = BodyKeys
    source = "FE (piezoelectric, the user's mesh)"
    mesh_growth = 50.0  # solids

    def ports(self, part: Part, scene: Scene) -> tuple[Port, ...]:
        keys = self.body_keys(part)
        return body.ports(keys)

    def files(self, part: Part, scene: Scene) -> tuple[str, ...]:
        return (part.keys.mesh,)

    def full_key(self, part: Part, scene: Scene) -> dict[str, Any]:
        return {**super().full_key(part, scene), "file": file_stamp(scene.home / part.keys.mesh)}

    def device(self, part: Part, scene: Scene, refine: int = 1) -> Device:
        # unset keys stay out: a group is picked by the keys that it has
        keys = self.body_keys(part).model_dump_json(exclude_unset=True)
        return _device(keys, scene.home, refine, file_stamp(scene.home / part.keys.mesh), part.name)


@lru_cache(maxsize=2)
def _device(keys: str, home: Path, refine: int, stamp: str, where: str) -> Device:
    parsed = body.Body.model_validate_json(keys)
    return body.device(parsed, home, refine=refine, where=where)


register(Body())
