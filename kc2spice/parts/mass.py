"""The part ``mass``: a point mass at a displacement pin."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from pydantic import Field

from kc2spice.core import laws
from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Length, Mass, Section, Velocity
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Param, Pin, Subcircuit, positive
from kc2spice.netlist.render import render
from kc2spice.scene.model import GROUND, Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Modelled, PartType, Surface, Vector, register
from kc2spice.scene.plausible import dimensions
from kc2spice.scene.rest import free, rigid
from kc2spice.spice.header import parameter_list, part_header

_PINS = (Pin("a", "um", "N"), Pin("base", "um", "N"))


class MassKeys(Section):
    """``F = m x''``, less ``m g`` with ``weight``. Where something holds it, a transient begins in
    equilibrium, unless ``position`` or ``velocity`` is given; where nothing does, it begins there.
    """

    mass: Mass = Field(gt=0)
    weight: bool = Field(False, description="whether gravity pulls it")
    position: Length = Field(0.0, description="at t = 0, if given or if nothing holds it")
    velocity: Velocity = Field(0.0, description="at t = 0, if given or if nothing holds it")


class PointMass(PartType):
    name, title, schema = "mass", "point mass at a displacement pin", MassKeys
    heavy = True
    example = """
[mass]
part = "mass"
mass = "1 mg"
pins = { a = "push.out" }

[push]
part = "source"
kind = "force"
pulse = { high = "10 mN", width = "1 ms", edge = "1 us" }
"""

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        return (Terminal("a", "um", "N", required=True), Terminal("base", "um", "N", "gnd"))

    def holds(self, part: Part, scene: Scene, model: Any | None) -> tuple[tuple[str, str], ...]:
        return (("base", GROUND),)

    def pushes(self, part: Part, scene: Scene) -> tuple[str, ...]:
        return ("a",) if part.keys.weight and scene.gravity else ()

    def problems(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        if _given(part) and scene.analysis.type != "transient":
            yield UsageError(
                "a position or velocity at t = 0 begins a transient",
                where=part.name,
                got=f"analysis {scene.analysis.type}",
                expected="neither of them",
            )

    def implausible(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        yield from dimensions(part.name, part.keys)

    def initial(self, part: Part, build: Build) -> Mapping[str, float]:
        begins = start(part, build)
        if begins is None:
            return {}
        inner = f"x{part.name.lower()}"
        return {f"{inner}.pos": 1e6 * begins[0], f"{inner}.v": begins[1]}

    def surface(self, part: Part, scene: Scene, ports: tuple[str, ...] = ()) -> Surface:
        return Surface(("a",), ("a",), ("a",), (0.0,))

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        name = build.libraries[part.name]
        gravity = build.scene.gravity if part.keys.weight else 0.0
        params = (
            positive("mass", part.keys.mass, "kg", "mass"),
            Param("gravity", gravity, "m/s2", "gravity, downwards"),
            Param("position", part.keys.position, "m", "at t = 0, used with uic"),
            Param("velocity", part.keys.velocity, "m/s", "at t = 0, used with uic"),
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
        position, velocity = start(part, build) or (None, 0.0)
        law = laws.Mass(n, part.keys.mass, gravity, position, velocity)
        return laws.Equations((law,), (("a", f"{n}.a"),), results)

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

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        return Modelled(part.name, "closed form", f"mass {part.keys.mass:g}")


def _given(part: Part) -> bool:
    return bool({"position", "velocity"} & part.keys.model_fields_set)


def start(part: Part, build: Build) -> tuple[float, float] | None:
    """Position [m] and velocity [m/s] at which it begins, None where it begins in equilibrium.

    Of masses that are fixed to each other the first one begins, the others follow.

    Raises
    ------
    UsageError : a state is given, but what it is fixed to has its own.
    """
    scene, keys = build.scene, part.keys
    begins = keys.position, keys.velocity
    if _given(part):
        for name, pin in scene.joined(part.name, "a"):
            other = scene.parts[name]
            if (
                other.type.name == part.type.name
                or other.type.reduced
                or other.type.prescribes(other)
            ):
                raise UsageError(
                    "begins where and as fast as what it is fixed to",
                    where=part.name,
                    got=f"{name}.{pin} on the same net",
                    expected="neither position nor velocity",
                    hint="a stiff spring between both lets each have its own",
                )
        return begins
    if scene.analysis.type == "transient" and any(
        p.type.without_operating_point(p, scene) for p in scene.parts.values()
    ):
        return begins
    net = scene.nets[part.name, "a"]
    group = next((group for group in free(build) if net in group.nets), None)
    if group is None or group.bodies:
        return None
    fixed = next(nets for nets in rigid(scene) if net in nets)
    masses = (m.name for m in scene.of(part.type.name) if scene.nets[m.name, "a"] in fixed)
    return begins if next(masses) == part.name else None


register(PointMass())
