"""The part ``mass``: a point mass at a displacement pin."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

import numpy as np
from pydantic import Field

from kc2spice.core.domains import DISPLACEMENT
from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Length, Mass, Section, Velocity
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Param, make_positive_parameter
from kc2spice.parts.mechanics._contact_surfaces import ContactSurface, TouchablePart
from kc2spice.physics import Declaration, DeclaredPart, displacement
from kc2spice.physics.declaration import make_frame_branch
from kc2spice.scene.checks import Metric
from kc2spice.scene.part_records import EquilibriumConditions, FrameAcceleration
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    GROUND,
    BuiltScene,
    GovernedScene,
    Part,
    Scene,
    WiredScene,
)
from kc2spice.scene.settings import ProbeKeys
from kc2spice.scene.start_conditions import find_floating_nets, find_rigid_groups

_FRAME_PIN = "frame"  # pin for the acceleration of a frame; further pins are frame2, frame3, …


class MassKeys(Section):
    """Keys of a point mass with ``F = m x''``.

    The key ``weight`` adds the force ``-m g``. If the mass is connected to a body with an
    accelerated ``base``, the displacement x of the mass is relative to the base. The inertial force
    ``-m a`` with the acceleration a of the base then acts on the mass. If the mass has a support
    and neither ``position`` nor ``velocity`` is stated, a transient begins in equilibrium. Without
    a support, a transient begins at ``position`` with ``velocity``.
    """

    mass: Mass = Field(gt=0, description="Mass of the rigid body")
    weight: bool = Field(False, description="Whether gravity acts on the mass")
    position: Length = Field(
        0.0,
        description=(
            "Position of the mass at t = 0. If neither `position` nor `velocity` is stated, a "
            "mass with a support starts in equilibrium; in all other cases, the default is 0"
        ),
    )
    velocity: Velocity = Field(
        0.0,
        description=(
            "Velocity of the mass at t = 0. If neither `position` nor `velocity` is stated, a "
            "mass with a support starts in equilibrium; in all other cases, the default is 0"
        ),
    )


def _list_frame_pins(count: int) -> list[str]:
    """Return the names of ``count`` pins for frame accelerations.

    The names are ``frame``, ``frame2``, ….
    """
    return [_FRAME_PIN + str(k) * (k > 1) for k in range(1, 1 + count)]


@cache
def declare_point_mass(
    mass: float,
    gravity: float = 0.0,
    position: float = 0.0,
    velocity: float = 0.0,
    shaken: tuple[float, ...] = (),
) -> Declaration:
    """Return the declaration of a mass at the pin ``a``.

    The mass may be in an accelerated frame. For each frame acceleration a_k, ``shaken`` contains
    the cosine s_k of the angle between a_k and the displacement x. The force on the pin is ``F = m
    x'' + m g + m sum_k s_k a_k``.
    """
    branches = [displacement("x", "a", "base")]
    shares, inertia = [], []
    for end, value in zip(_list_frame_pins(len(shaken)), shaken, strict=True):
        share = f"along_{end}"
        branches.append(make_frame_branch(f"a_{end}", end, "base"))
        words = f"cosine of the angle between the acceleration {end} and the displacement of a"
        shares.append(Param(share, value, "-", words))
        inertia.append(f"mass*{share}*a_{end}")
    return Declaration(
        "mass",
        "point mass",
        Section,
        tuple(branches),
        kinetic="0.5*mass*x_rate^2",
        energy="mass*gravity*x",
        forces={"x": "+".join(inertia)} if inertia else {},
        starts={"x": ("position", "velocity")},
        given=(
            make_positive_parameter("mass", mass, "kg", "mass"),
            Param("gravity", gravity, "m/s2", "gravity, downwards"),
            Param("position", position, "m", "position at t = 0, used with uic"),
            Param("velocity", velocity, "m/s", "velocity at t = 0, used with uic"),
            *shares,
        ),
        rating="none: the part is rigid",
        validity="rigid, in vacuum, at any temperature",
        sign="um and N are positive in the direction of the pin's displacement; 1 A into a pin is "
        "a force of 1 N in this direction",
    )


class PointMass(TouchablePart[MassKeys], DeclaredPart[MassKeys]):
    """Part type ``mass``: point mass at a displacement pin."""

    name, title, schema = "mass", "point mass at a displacement pin", MassKeys

    def make_declaration(self, part: Part[MassKeys], scene: GovernedScene) -> Declaration:
        """Return the declaration of the part for the values of its keys."""
        keys, gravity = part.keys, scene.gravity if part.keys.weight else 0.0
        shares = tuple(
            float(shake.along or 0.0) for shake in _list_frame_accelerations(part, scene)
        )
        return declare_point_mass(keys.mass, gravity, keys.position, keys.velocity, shares)

    follows_frames = True

    def default_joins(self, part: Part[MassKeys], scene: GovernedScene) -> Mapping[str, str]:
        """Return the default connections of the acceleration pins to pins of the body.

        The acceleration pins are connected to the acceleration pins of the body.
        """
        shakes = _list_frame_accelerations(part, scene)
        pins = zip(_list_frame_pins(len(shakes)), shakes, strict=True)
        return {pin: ".".join(shake.pin) for pin, shake in pins}

    def constant_pins(self, part: Part[MassKeys], scene: WiredScene) -> Mapping[str, str]:
        """Return the pin ``base``, the origin of the displacement of the mass."""
        return {"base": f"to move the mass, connect {part.name}.a to a moving part"}

    def equilibrium_conditions(
        self, part: Part[MassKeys], scene: WiredScene
    ) -> EquilibriumConditions:
        """Return the force path to ground, and the pin on which the weight acts.

        The force path starts at the pin ``base``. The weight acts on the pin ``a``.
        """
        falls = part.keys.weight and scene.gravity
        return EquilibriumConditions(
            (("base", GROUND),), loaded_pins=("a",) if falls else (), inertial_pins=("a",)
        )

    def problems(self, part: Part[MassKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        if _has_initial_state(part) and scene.analysis.type != "transient":
            yield part.wrong(
                "",
                "position and velocity of a mass need a transient analysis",
                got=f"analysis {scene.analysis.type}",
                expected='type = "transient"',
                hint="delete the keys `position` and `velocity`",
            )

    def settable_quantities(self, part: Part[MassKeys], build: BuiltScene) -> Mapping[str, float]:
        """Return settable quantities: node voltages of initial displacement and velocity."""
        state = self.initial_motion(part, build)
        if state is None:
            return {}
        inner = f"x{part.name.lower()}"
        return {
            f"{inner}.place_x": DISPLACEMENT.pin_value_per_si_unit * state[0],
            f"{inner}.speed_x": state[1],
        }

    def contact_surface(
        self, part: Part[MassKeys], scene: GovernedScene, ports: tuple[str, ...] = ()
    ) -> ContactSurface:
        """Return the contact surface of the mass: a plane at the pin ``a``."""
        return ContactSurface(part.name, ("a",), (0.0,))

    def initial_motion(self, part: Part[MassKeys], build: BuiltScene) -> tuple[float, float] | None:
        """Return position [m] and velocity [m/s] at t = 0.

        Return None if the run starts from an equilibrium. If several masses are fixed to each
        other, the first mass determines the initial state.

        Raises
        ------
        UsageError : the keys state an initial state, but the mass is fixed to a part that
            determines this state.
        """
        scene, keys = build.scene, part.keys
        state = keys.position, keys.velocity
        if _has_initial_state(part):
            for name, pin in scene.list_joined_pins(part.name, "a"):
                other = scene.parts[name]
                moved = other.type.name == part.type.name or other.is_body
                if moved or scene.records[name].rest.ideal:
                    raise part.wrong(
                        "",
                        (
                            f"this mass states an initial motion, but {name}, to which the mass is "
                            "fixed, determines the motion of the mass"
                        ),
                        got=f"{part.name}.a connected to {name}.{pin}",
                        expected="neither the key `position` nor the key `velocity`",
                        hint=(
                            "delete the keys `position` and `velocity`, or connect the mass to "
                            f"{name} by a stiff spring"
                        ),
                    )
            return state
        if scene.analysis.type == "transient" and scene.initial_states:
            return state
        net = scene.nets[part.name, "a"]
        groups = find_floating_nets(scene, build.equilibrium_conditions)
        group = next((group for group in groups if net in group.nets), None)
        if group is None or group.bodies:
            return None
        fixed = next(nets for nets in find_rigid_groups(scene) if net in nets)
        masses = (
            m.name for m in scene.list_parts(part.type.name) if scene.nets[m.name, "a"] in fixed
        )
        return state if next(masses) == part.name else None

    def checks(self, part: Part[MassKeys], build: BuiltScene, waves: Waveforms) -> Iterator[Any]:
        """Return no checks, because the energy of a mass near rest is too small to check.

        The energy of a mass near rest is smaller than the errors of the time steps, so the energy
        balance is not checked.
        """
        return iter(())

    def main_metrics(self, part: Part[MassKeys], build: BuiltScene) -> Mapping[str, ProbeKeys]:
        """Return the main metric of the mass as a probe: the largest displacement."""
        if build.scene.analysis.type != "transient":
            return {}
        return {f"{part.name}_peak_m": ProbeKeys(of=f"{part.name}.x", take="max")}

    def metrics(
        self, part: Part[MassKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics of the part, keyed by name."""
        if "time" not in waves:
            return {}
        x, v = waves[f"{part.name}.x"], waves[f"{part.name}.v"]
        return {
            f"{part.name}_peak_m": Metric(float(x.max()), "m"),
            f"{part.name}_speed_m_s": Metric(float(np.abs(v).max()), "m/s"),
        }

    def notes(self, part: Part[MassKeys], scene: Scene) -> Iterator[str]:
        """Yield the assumptions of the model and the effects that it neglects."""
        yield f"mass {part.keys.mass:g}"


def _list_frame_accelerations(
    part: Part[MassKeys], scene: GovernedScene
) -> tuple[FrameAcceleration, ...]:
    """Return the accelerations of the frame of a mass; none for a fixed frame."""
    frame = scene.frames.get((part.name, "a"))
    return () if frame is None else frame.shakes


def _has_initial_state(part: Part[MassKeys]) -> bool:
    """Return whether the keys set an initial position or velocity of the mass."""
    return bool({"position", "velocity"} & part.keys.model_fields_set)


register_part_type(PointMass())
