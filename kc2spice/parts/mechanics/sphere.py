"""The part ``sphere``: sphere that moves vertically.

The equation of motion is ``m y'' = sum of forces - m g``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic import Field, field_validator

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Curve, Figure, Panel, Shape
from kc2spice.core.quantities import (
    AIR_DENSITY,
    Length,
    Section,
    SolidDensity,
    Velocity,
    make_invalid_value_error,
)
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.waveforms import Waveforms, integrate_cumulatively
from kc2spice.fem.materials import Material, find_material, find_stated_losses
from kc2spice.netlist.circuit import make_positive_parameter
from kc2spice.parts.control._pid_keys import PidKeys
from kc2spice.parts.mechanics._contact_keys import ContactKeys
from kc2spice.parts.mechanics._contact_surfaces import ContactSurface, TouchablePart, make_pair
from kc2spice.parts.mechanics.mass import declare_point_mass
from kc2spice.physics import Declaration, DeclaredPart, displacement
from kc2spice.physics.part import make_pins
from kc2spice.scene.checks import Gate, Metric, RunEnergyBalance, compute_motion_error_limit
from kc2spice.scene.part_records import (
    EquilibriumConditions,
    InitialState,
    NeglectedEffect,
    PartResult,
)
from kc2spice.scene.parttype import compute_pin_forces, register_part_type
from kc2spice.scene.plausibility import UnusualValueError, check_range
from kc2spice.scene.scene_classes import (
    GROUND,
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    JoinedScene,
    Part,
    Scene,
    Terminal,
    WiredScene,
)
from kc2spice.scene.settings import ProbeKeys
from kc2spice.synthesis.library_headers import SIGN_TEXT

AIR_VISCOSITY = 1.825e-5  # viscosity of air [Pa s]
STEEL_DENSITY = 7850.0  # density of steel [kg/m^3]
REST_STATE = InitialState(0.0, 0.0)
SETTLING_BAND = 0.05  # half-width of the settling band, divided by the step to the set point
# largest settling time of a caught sphere, divided by the duration of the run
MAX_SETTLING_SHARE = 0.9
# Largest permitted relative error of the work on a sphere.
# With this error of the work, the relative error of a launch velocity is about 1e-3.
MAX_WORK_ERROR = 1e-4


def _find_default_density(keys: dict[str, Any]) -> float:
    """Return the density [kg/m^3] of the material in ``keys``; by default steel."""
    material = keys.get("material")
    return STEEL_DENSITY if material is None else _load_material(material).density


def _load_material(name_or_table: str | dict[str, Any]) -> Material:
    """Return the material of a sphere from the name or the table of the material."""
    try:
        return find_material(name_or_table, "sphere.material")
    except UsageError as error:
        raise make_invalid_value_error(
            error.message, error.expected, hint=error.next_action
        ) from None


class SphereKeys(Section):
    """Keys of a sphere that moves vertically; it is rigid without the key ``elastic``."""

    radius: Length = Field(1e-3, gt=0, description="Radius of the sphere")
    material: str | dict[str, Any] | None = Field(
        None,
        description=(
            "Material of the sphere, which determines the effective modulus of contacts; by "
            "default steel for an elastic sphere"
        ),
    )
    density: SolidDensity = Field(
        default_factory=_find_default_density,
        gt=0,
        description=(
            "Density of the sphere; by default the density of the material, or of steel if "
            "no material is stated"
        ),
    )
    elastic: bool | dict[str, Any] | None = Field(
        None,
        description=(
            "True for an elastic sphere, or a table with the keys `damping`, `mesh` and `rom` "
            "of an elastic sphere; requires contact.shape = pressure. By default the "
            "sphere is rigid"
        ),
    )
    velocity: Velocity = Field(
        0.0,
        description=(
            "Velocity of the sphere at t = 0; with any other value than 0, the transient "
            "starts without an operating point"
        ),
    )
    height: Length = Field(
        0.0,
        description=(
            "Height of the sphere's lowest point at t = 0, above the undeformed surface below the "
            "sphere; requires the key `velocity`"
        ),
    )

    @field_validator("material")
    @classmethod
    def _require_known_material(
        cls, material: str | dict[str, Any] | None
    ) -> str | dict[str, Any] | None:
        """Return the material; raise an error if the material does not exist."""
        if material is not None:
            _load_material(material)
        return material

    @field_validator("elastic")
    @classmethod
    def _normalise_elastic(
        cls, elastic: bool | dict[str, Any] | None
    ) -> bool | dict[str, Any] | None:
        """Return the value of the key ``elastic``, with None in place of false."""
        return None if elastic is False else elastic

    @property
    def mass(self) -> float:
        """Mass [kg] of the sphere."""
        return 4 / 3 * math.pi * self.radius**3 * self.density


def declare_sphere(
    mass: float, radius: float, gravity: float, velocity: float = 0.0, height: float = 0.0
) -> Declaration:
    """Return the declaration of a sphere.

    x is the height of the sphere's lowest point, and is zero at the first touch. With the height of
    the centre in place of x, an indentation of a picometre would be lost in rounding errors.
    Without the option ``uic``, ngspice starts from the operating point.
    """
    declaration = declare_point_mass(mass, gravity, height, velocity)
    weight, pull, place, fast = declaration.given
    size = make_positive_parameter("radius", radius, "m", "radius of the sphere")
    place = replace(place, name="height", doc="height of the lowest point at t = 0, used with uic")
    return replace(
        declaration,
        title=Sphere.title,
        branches=(displacement("x", "bottom", "base"),),
        starts={"x": ("height", "velocity")},
        outputs={"y": "x + radius"},
        speeds={"bottom": "v"},
        given=(weight, size, pull, fast, place),
        base="base",
        validity=f"{declaration.valid_range}; moves along its axis only",
        sign=SIGN_TEXT,
    )


class Sphere(TouchablePart[SphereKeys], DeclaredPart[SphereKeys]):
    """Part type ``sphere``: rigid sphere that moves vertically."""

    name = "sphere"
    title = "rigid sphere, vertical motion"
    schema = SphereKeys

    def make_declaration(self, part: Part[SphereKeys], scene: GovernedScene) -> Declaration:
        """Return the declaration of the part for the values of its keys."""
        keys, begin = part.keys, scene.initial_states.get(part.name, REST_STATE)
        return declare_sphere(keys.mass, keys.radius, scene.gravity, begin.velocity, begin.height)

    def has_weight(self, part: Part[SphereKeys]) -> bool:
        """Return true, because gravity always acts on a sphere."""
        return True

    def generate_tables(
        self, part: Part[SphereKeys], data: Mapping[str, object]
    ) -> Mapping[str, Mapping[str, object]]:
        """Generate the scene table of the part that models the sphere's elasticity.

        Return no table for a rigid sphere.
        """
        if (elastic := part.keys.elastic) is None:
            return {}
        table = {"part": "elastic_sphere", "of": part.name, "at": (part.name, "elastic")}
        keys = elastic if isinstance(elastic, dict) else {}
        return {_name_elastic_part(part): {**keys, **table}}

    def pins(self, part: Part[SphereKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        declared = (
            ()
            if _has_prescribed_motion(part, scene)
            else make_pins(self.make_declaration(part, scene))
        )
        return tuple(
            Terminal(p.name, p.unit, p.flow, {"base": "gnd"}.get(p.name), signal_out=p.flow == "-")
            for p in declared
        )

    def constant_pins(self, part: Part[SphereKeys], scene: WiredScene) -> Mapping[str, str]:
        """Return the pin ``base``, the origin of the height of the sphere."""
        return {} if _has_prescribed_motion(part, scene) else {"base": ""}

    def problems(self, part: Part[SphereKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        bodies = [body.name for body in scene.bodies]
        if bodies and not scene.list_parts("contact") and scene.analysis.type == "transient":
            yield UsageError(
                "nothing touches the sphere",
                where="contact",
                got="no part of type contact",
                expected=f"a contact between {part.name} and {', '.join(bodies)}",
                hint=f"add [contact], otherwise {part.name} moves through {bodies[0]}",
            )
        keys, name = part.keys, part.name
        small = "smaller grains stick by adhesion, and no transducer moves larger balls"
        yield from check_range(f"{name}.radius", keys.radius, "m", 1e-6, 0.1, small)
        for key, value in find_stated_losses(keys.material).items():
            yield UnusualValueError(
                "not used, because only elastic.damping states losses of a sphere",
                where=f"{name}.material.{key}",
                got=str(value),
                hint=f"delete {name}.material.{key}",
            )

    def contact_surface(
        self, part: Part[SphereKeys], scene: GovernedScene, ports: tuple[str, ...] = ()
    ) -> ContactSurface:
        """Return the contact surface of the sphere: the lower pole."""
        keys, carried = part.keys, _name_elastic_part(part)
        known = keys.material is not None or carried
        modulus = make_sphere_material(part).indentation_modulus if known else None
        place = part.name, ("bottom",), (0.0,), "v"
        return ContactSurface(*place, radius=keys.radius, elastic=carried, modulus=modulus)

    def outline(self, part: Part[SphereKeys], scene: Scene) -> Iterator[Shape]:
        """Yield the side view of the sphere."""
        r, label = part.keys.radius, f"{part.name}: radius {1e3 * part.keys.radius:g} mm"
        yield Shape(0.0, r, 2 * r, 2 * r, "metal", label, round=True)

    def governed_parts(
        self, part: Part[SphereKeys], scene: DeclaredScene
    ) -> Mapping[str, InitialState]:
        """Return the velocity and height of the sphere at t = 0, keyed by its part name.

        The mapping is empty if velocity and height are zero.
        """
        keys = part.keys
        moving = keys.velocity or keys.height
        return {part.name: InitialState(keys.velocity, keys.height)} if moving else {}

    def equilibrium_conditions(
        self, part: Part[SphereKeys], scene: WiredScene
    ) -> EquilibriumConditions:
        """Return the force path to ground, and the pin on which the weight acts.

        The force path starts at the pin ``base``. The weight acts on the pin ``v``. If another part
        prescribes the motion of the sphere, the result contains neither a force path nor a weight.
        """
        if _has_prescribed_motion(part, scene):
            return EquilibriumConditions()
        return EquilibriumConditions(
            (("base", GROUND),), loaded_pins=("v",) if scene.gravity else (), inertial_pins=("v",)
        )

    def settable_quantities(self, part: Part[SphereKeys], build: BuiltScene) -> Mapping[str, float]:
        """Return settable quantities: node voltages of initial displacement and velocity.

        Both voltages are zero. They are set only if no part is joined to the pins ``v`` and
        ``bottom``, and if the scene does not prescribe the initial state of the sphere.
        """
        joined = build.scene.list_joined_pins(part.name, "v")
        if (
            joined
            or build.scene.list_joined_pins(part.name, "bottom")
            or part.name in build.scene.initial_states
        ):
            return {}
        # A sphere without support starts at rest, and just touches the body below.
        return {build.get_net(part, "v"): 0.0, build.get_net(part, "bottom"): 0.0}

    def vectors(self, part: Part[SphereKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        return {f"{part.name}.{pin}": build.get_pin_vector(part, pin) for pin in ("y", "v")}

    def main_metrics(self, part: Part[SphereKeys], build: BuiltScene) -> Mapping[str, ProbeKeys]:
        """Return the main metrics of the sphere as probes: largest and final height."""
        if build.scene.analysis.type != "transient" or part.name in build.scene.initial_states:
            return {}
        of = f"{part.name}.y"
        return {
            "peak_height_m": ProbeKeys(of=of, take="max"),
            "final_position_m": ProbeKeys(of=of, take="final"),
        }

    def metrics(
        self, part: Part[SphereKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics of the part, keyed by name.

        If the sphere is still rising at the end of the run, the metrics include a warning. The
        warning is omitted if a controller has caught the sphere, because the height of a caught
        sphere hardly changes. The warning is also omitted without gravity, because a sphere without
        weight has no final height.
        """
        y = waves.data.get(f"{part.name}.y")
        if y is None or "time" not in waves or part.name in build.scene.initial_states:
            return {}
        result = {
            "peak_height_m": Metric(float(y.max()), "m"),
            "final_position_m": Metric(float(y[-1]), "m"),
        }
        v = waves.data.get(f"{part.name}.v")
        rising = v is not None and y[-1] == y.max() and v[-1] > 0
        if not rising:
            return result
        caught = any(is_caught(pid, part, waves) for pid in _list_controllers(part, build.scene))
        n, warning = part.name, ""
        if build.scene.gravity and not caught:
            warning = f"{n} is still rising at the end of the run, so its heights are not final"
        return result | {"still_rising": Metric(True, warning=warning)}

    def checks(
        self, part: Part[SphereKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[RunEnergyBalance | Gate]:
        """Yield the check that the work of all forces equals the gain of kinetic energy.

        The error is relative to the sum of the absolute work of all forces.
        """
        if "time" not in waves or f"{part.name}.v" not in waves:
            return
        scene, words, of = build.scene, f"height of {part.name}", f"{part.name}.y"
        if part.name not in scene.initial_states:
            limit, default = (
                scene.gates.trajectory,
                {"ngspice_vs_rom": compute_motion_error_limit(scene.solver)},
            )
            if limit is None:
                yield Gate(f"{words} relative to its travel", of, default, "travel")
            else:
                yield Gate(words, of, {"ngspice_vs_rom": limit}, "absolute", "m")
        t, v, mass = waves["time"], waves[f"{part.name}.v"], part.keys.mass
        forces = {"weight": np.full_like(t, -mass * build.scene.gravity)}
        acting = compute_pin_forces(build, waves)
        for name, pin in scene.list_joined_pins(part.name, "v"):
            if (name, pin) not in acting:
                return
            forces[name] = acting[name, pin]
        total, turnover, entries = np.zeros_like(t), 0.0, dict[str, float]()
        for name, force in forces.items():
            work = integrate_cumulatively(force * v, t)
            total += work
            turnover += float(np.trapezoid(np.abs(force * v), t))
            entries[f"work of the {name}"] = float(work[-1])
        gap = mass * (v**2 - v[0] ** 2) / 2 - total
        entries["kinetic"] = mass * float(v[-1] ** 2) / 2
        if v[0] != 0.0:
            entries["kinetic at the start"] = mass * float(v[0] ** 2) / 2
        advice = "the steps are too coarse for the contact: lower solver.reltol or max_step"
        yield RunEnergyBalance(entries, abs(float(gap[-1])), turnover, MAX_WORK_ERROR, advice)

    def figures(
        self, part: Part[SphereKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Figure]:
        """Yield the figures of the part for the report."""
        y = waves.data.get(f"{part.name}.y")
        if y is None or "time" not in waves:
            return
        levels, bands = [], []
        for pid in _list_controllers(part, build.scene):
            goal, band = 1e3 * pid.keys.setpoint, 1e3 * compute_settling_band(pid, part)
            levels.append((goal, "set point, ±5 % of the step"))
            bands.append((goal - band, goal + band, ""))
        path = Curve(part.name, 1e3 * waves["time"], 1e3 * y)
        panel = Panel(
            "time in ms", "height of the centre in mm", (path,), tuple(levels), tuple(bands)
        )
        caption = f"Vertical position of {part.name}."
        title = f"Path of {part.name}"
        yield Figure(f"{part.name}_trajectory", title, caption, (panel,), main=True)

    def initial_motion(
        self, part: Part[SphereKeys], build: BuiltScene
    ) -> tuple[float, float] | None:
        """Return position [m] and velocity [m/s] at t = 0.

        Return None if the run starts from an equilibrium.
        """
        n, scene, states = part.name, build.scene, build.scene.initial_states
        if not states and (scene.list_joined_pins(n, "v") or scene.list_joined_pins(n, "bottom")):
            return None
        begin = states.get(n, REST_STATE)
        return begin.height, begin.velocity

    def law(self, part: Part[SphereKeys], build: BuiltScene) -> laws.Equations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice."""
        n, result = part.name, super().law(part, build)
        height = laws.scale_wave(f"{n}.bottom", constant=part.keys.radius)
        bottom = f"{n}.bottom"
        pins = (("v", bottom), ("bottom", bottom), ("y", bottom))
        results = {f"{n}.y": height, f"{n}.v": result.results[f"{n}.v"]}
        return replace(result, pins=pins, results=results)

    def notes(self, part: Part[SphereKeys], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys = part.keys
        mass = format_quantity(keys.mass, "kg")
        yield f"{mass}, vertical motion, gravity {format_quantity(scene.gravity, 'm/s2')}"
        linear = any(
            c.keys.law == "linear" for c in scene.list_parts_with_schema("contact", ContactKeys)
        )
        if linear and part.keys.elastic is None:
            why = f"the sphere is rigid, because {part.name}.elastic is not set"
            yield _estimate_elasticity_effect(part, scene, why)
        if scene.analysis.type == "transient":
            yield _estimate_air_drag(part.keys)
            why = "the part moves along one axis"
            yield NeglectedEffect(
                "rotation and sideways motion of the sphere", why, "not estimated"
            )


def find_sphere(part: Part, scene: DeclaredScene) -> Part[SphereKeys]:
    """Return the sphere that a part throws, pushes or pulls."""
    return scene.find_partner(part, "sphere", "of").with_schema(SphereKeys)


def make_sphere_material(part: Part[SphereKeys]) -> Material:
    """Return a sphere's material, by default steel, with the sphere's ``density``."""
    return replace(_load_material(part.keys.material or "steel"), density=part.keys.density)


def _name_elastic_part(part: Part[SphereKeys]) -> str:
    """Return the name of the part that models the sphere's elasticity.

    The name is empty for a rigid sphere.
    """
    return "" if part.keys.elastic is None else f"{part.name}_elastic"


def find_controlled_sphere(pid: Part[PidKeys], scene: DeclaredScene) -> Part[SphereKeys] | None:
    """Return the sphere whose height a controller controls; None without a sphere."""
    ball = scene.parts.get(pid.keys.of) if pid.keys.of else scene.find_only_part("sphere")
    return None if ball is None else ball.with_schema(SphereKeys)


def compute_settling_band(pid: Part[PidKeys], ball: Part[SphereKeys]) -> float:
    """Return the half-width [m] of the settling band around the set point.

    A sphere within the settling band counts as settled.
    """
    return SETTLING_BAND * abs(float(pid.keys.setpoint - ball.keys.radius))


def find_settling_time(
    pid: Part[PidKeys], ball: Part[SphereKeys], waves: Waveforms
) -> float | None:
    """Return the time [s] from which a sphere stays in the settling band.

    Return None if the sphere is outside of the settling band at the end of the run.
    """
    band = compute_settling_band(pid, ball)
    return compute_settling_time(waves["time"], waves[f"{ball.name}.y"], pid.keys.setpoint, band)


def compute_settling_time(t: np.ndarray, y: np.ndarray, target: float, band: float) -> float | None:
    """Return the time [s] from which a signal stays in a band around its target.

    The band is ``target`` ± ``band``. The result is None if the last value of ``y`` is outside the
    band.
    """
    outside = np.abs(y - target) > band
    if outside[-1]:
        return None
    if not outside.any():
        return float(t[0])
    k = int(np.flatnonzero(outside)[-1])
    edge = target + np.copysign(band, y[k] - target)
    return float(t[k] + (edge - y[k]) / (y[k + 1] - y[k]) * (t[k + 1] - t[k]))


def is_caught(pid: Part[PidKeys], ball: Part[SphereKeys], waves: Waveforms) -> bool:
    """Return whether a sphere stays in the settling band in the last tenth of the run."""
    t, settled = waves["time"], find_settling_time(pid, ball, waves)
    return settled is not None and bool(settled <= t[0] + MAX_SETTLING_SHARE * (t[-1] - t[0]))


def _list_controllers(ball: Part[SphereKeys], scene: DeclaredScene) -> list[Part[PidKeys]]:
    """Return the controllers that control the height of a sphere."""
    controllers = scene.list_parts_with_schema("pid", PidKeys)
    return [pid for pid in controllers if find_controlled_sphere(pid, scene) is ball]


def _has_prescribed_motion(part: Part[SphereKeys], scene: GovernedScene) -> bool:
    """Return whether another part prescribes the motion of the sphere."""
    return scene.movers.get(part.name) is not None


def find_height_offset(part: Part, pin: str, scene: WiredScene) -> float:
    """Return the height [m] of a sphere's centre above its lowest point: the radius.

    The unknown of the equations is the height of the sphere's lowest point. The sphere is connected
    to ``pin``. If no sphere is connected to ``pin``, the result is 0.
    """
    ball = _find_sphere_at(part, pin, scene)
    return 0.0 if ball is None else float(ball.keys.radius)


def find_initial_height(part: Part, pin: str, scene: WiredScene) -> float | None:
    """Return the height [m] of a sphere's centre above the surface below it at t = 0.

    The surface below the sphere is not deformed. The sphere is connected to ``pin``. Return None if
    no sphere is connected to the pin, or if an operating point determines the height.
    """
    ball, states = _find_sphere_at(part, pin, scene), scene.initial_states
    if ball is None or not states:
        return None
    return float(ball.keys.radius + states.get(ball.name, REST_STATE).height)


def _find_sphere_at(part: Part, pin: str, scene: WiredScene) -> Part[SphereKeys] | None:
    """Return the sphere whose height ``pin`` measures; None without such a sphere."""
    for name, other in scene.list_joined_pins(part.name, pin):
        if other == "y" and scene.parts[name].type.name == Sphere.name:
            return scene.parts[name].with_schema(SphereKeys)
    return None


def _estimate_elasticity_effect(
    part: Part[SphereKeys], scene: GovernedScene, why: str
) -> NeglectedEffect:
    """Estimate the effect of the neglected elasticity of the sphere on a contact.

    ``why`` states the assumption of the model.
    """
    sphere_modulus = make_sphere_material(part).indentation_modulus
    moduli = [
        make_pair(contact, scene).lower_surface.modulus for contact in scene.list_parts("contact")
    ]
    stiffest = max(filter(None, moduli), default=0.0)
    effect, share = "elasticity of the sphere", stiffest / sphere_modulus
    if not stiffest:
        return NeglectedEffect(effect, why, "not estimated")
    return NeglectedEffect(
        effect, why, f"contact compliance {100 * share:.0f} % higher if elastic", size=share
    )


def _estimate_air_drag(keys: SphereKeys) -> NeglectedEffect:
    """Return the neglected air drag at 1 m/s, divided by the weight of the sphere.

    The drag coefficient is computed by the formula of Schiller and Naumann.
    """
    speed = 1.0
    reynolds = AIR_DENSITY * speed * 2 * keys.radius / AIR_VISCOSITY
    coefficient = 24 / reynolds * (1 + 0.15 * reynolds**0.687)
    area = math.pi * keys.radius**2
    drag = 0.5 * AIR_DENSITY * speed**2 * area * coefficient
    share = drag / (keys.mass * 9.81)
    error = f"{100 * share:.2g} % of the weight at 1 m/s"
    return NeglectedEffect("drag of the air", "no drag", error, size=share)


register_part_type(Sphere())
