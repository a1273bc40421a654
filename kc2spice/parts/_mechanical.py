"""What mass, spring and damper share: laws at displacement pins."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import numpy as np

from kc2spice.core import laws
from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Modelled, PartType, Vector


class Mechanical(PartType):
    def modelled(self, part: Part, scene: Scene) -> Modelled:
        (key, value), *_ = part.keys
        return Modelled(part.name, "closed form", f"{key} {value:g}")


class Link(Mechanical):
    """Two displacement pins and one law between them."""

    template: str
    key: str
    unit: str

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        ground = None if scene.named(part.name, "b") else "gnd"
        return (Terminal("a", "um", "N", required=True), Terminal("b", "um", "N", ground))

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        return {f"{part.name}.force": self.through(part, build)}

    @abstractmethod
    def through(self, part: Part, build: Build) -> Vector:
        """The force that it passes from ``a`` to ``b``."""

    @abstractmethod
    def link(self, part: Part) -> laws.Law:
        """Its law."""

    def law(self, part: Part, build: Build) -> laws.Equations:
        n = part.name
        pins = (("a", f"{n}.a"), ("b", f"{n}.b"))
        return laws.Equations(
            (self.link(part),), pins, {f"{n}.force": laws.reading(f"{n}.a.through")}
        )

    def force_on(self, part: Part, pin: str, build: Build, waves: Waveforms) -> np.ndarray | None:
        found = waves.data.get(f"{part.name}.force")
        return None if found is None else (-found if pin == "a" else found)
