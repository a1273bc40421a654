"""The part ``body``: the user's own mesh or CAD file (:mod:`kc2spice.bodies.body`)."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

from kc2spice.bodies import body
from kc2spice.core.progress import Clock
from kc2spice.parts._linear_body import LinearBody, file_stamp
from kc2spice.rom.linear import LinearModel, Port
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import register
from kc2spice.scene.settings import Rom


class BodyKeys(body.Body):
    """Keys of the body, and its own reduction if it has one."""

    rom: Rom | None = None


class Body(LinearBody):
    name = "body"
    title = "the user's own mesh (piezoelectric FE, reduced)"
    schema = BodyKeys
    source = "FE (piezoelectric, the user's mesh)"

    def ports(self, part: Part, scene: Scene) -> tuple[Port, ...]:
        keys = self.body_keys(part)
        return body.ports(keys)

    def full_key(self, part: Part, scene: Scene) -> dict[str, Any]:
        return {**super().full_key(part, scene), "file": file_stamp(scene.home / part.keys.mesh)}

    def full(self, part: Part, scene: Scene, clock: Clock, refine: int = 1) -> LinearModel:
        stamp = file_stamp(scene.home / part.keys.mesh)
        with clock.stage("mesh", f"mesh and matrices of {part.name}"):
            return _built(self.body_keys(part), scene.home, refine, stamp)


@lru_cache(maxsize=2)
def _built(keys: body.Body, home: Path, refine: int, stamp: str) -> LinearModel:
    return body.build(keys, home, refine=refine)


register(Body())
