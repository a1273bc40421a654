"""The part ``mass``: a point mass at a displacement pin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field

from kc2spice.core import laws
from kc2spice.core.quantities import Mass, Section
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts._mechanical import Mechanical
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Surface, Vector, register
from kc2spice.spice.circuit import Param, Pin, Subcircuit, positive
from kc2spice.spice.header import parameter_list, part_header
from kc2spice.spice.render import render

LEAK = 1e-9  # N/um at a mass; 1e-3 N/m moves nothing that a spring holds
_PINS = (Pin("a", "um", "N"), Pin("base", "um", "N"))


class MassKeys(Section):
    """``F = m x''``; ``gravity`` adds its weight, downwards."""

    mass: Mass = Field(gt=0)
    weight: bool = Field(False, description="whether gravity pulls it")


class PointMass(Mechanical):
    name, title, schema = "mass", "point mass at a displacement pin", MassKeys
    example = """
[mass]
part = "mass"
mass = "1 mg"
pins = { a = "push.out" }

[push]
part = "source"
kind = "force"
dc = "10 mN"
"""

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        return (Terminal("a", "um", "N", required=True), Terminal("base", "um", "N", "gnd"))

    def surface(self, part: Part, scene: Scene, ports: tuple[str, ...] = ()) -> Surface:
        return Surface(("a",), ("a",), ("a",), (0.0,))

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        name = build.libraries[part.name]
        gravity = build.scene.gravity if part.keys.weight else 0.0
        params = (
            positive("mass", part.keys.mass, "kg", "mass"),
            Param("gravity", gravity, "m/s2", "gravity, downwards"),
        )
        text = render(
            "mass.j2",
            header=part_header(
                header,
                f"{name}: point mass",
                _PINS,
                params,
                rating="none: rigid",
                sign="um and N count along the pin's direction; 1 A into a pin pushes it that way",
                validity="rigid, in vacuum, at any temperature",
            ),
            name=name,
            pins=[pin.name for pin in _PINS],
            parameters=parameter_list(params),
            leak=LEAK,
        )
        return (Subcircuit(name, _PINS, params, text),)

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        return {
            f"{part.name}.x": Vector(f"v({build.net(part, 'a')})", 1e-6, "m"),
            f"{part.name}.v": Vector(f"v(x{part.name.lower()}.v)", 1.0, "m/s"),
            f"{part.name}.force": Vector(f"i(v.x{part.name.lower()}.vmass)", 1.0, "N"),
        }

    def law(self, part: Part, build: Build) -> laws.Equations | None:
        if build.net(part, "base") != "0":
            return None
        n = part.name
        gravity = build.scene.gravity if part.keys.weight else 0.0
        results = {
            f"{n}.x": laws.reading(f"{n}.a"),
            f"{n}.v": laws.reading(f"{n}.a.rate"),
            f"{n}.force": laws.reading(f"{n}.a.through"),
        }
        return laws.Equations((laws.Mass(n, part.keys.mass, gravity),), (("a", f"{n}.a"),), results)

    def force_on(self, part: Part, pin: str, build: Build, waves: Waveforms) -> np.ndarray | None:
        inertia = waves.data.get(f"{part.name}.force")
        if inertia is None or pin != "a":
            return None
        gravity = build.scene.gravity if part.keys.weight else 0.0
        return -inertia - part.keys.mass * gravity

    def metrics(self, part: Part, build: Build, waves: Waveforms) -> Mapping[str, Any]:
        if "time" not in waves:
            return {}
        x, v = waves[f"{part.name}.x"], waves[f"{part.name}.v"]
        return {
            f"{part.name}_peak_m": float(x.max()),
            f"{part.name}_speed_m_s": float(np.abs(v).max()),
        }


register(PointMass())
