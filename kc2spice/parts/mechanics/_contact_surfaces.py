"""Contact surfaces, indentations, and velocities of bodies that lose contact."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from operator import itemgetter
from typing import TYPE_CHECKING

import numpy as np

from kc2spice.parts.electronics.source import SourceKeys
from kc2spice.parts.mechanics._contact_keys import ContactKeys
from kc2spice.physics.contact import ContactForce
from kc2spice.scene.scene_classes import (
    GROUND,
    GovernedScene,
    KeysT,
    Part,
    PartType,
    WiredScene,
)

if TYPE_CHECKING:
    from kc2spice.bodies.contact_pressure import IndentationLaw, LocalCompliance, PressureBasis
    from kc2spice.core.waveforms import Waveforms

FLOOR_PORT = "floor"  # name of the port of a fixed rigid plane
SPHERE_PATCH = "patch"  # name of the port of an elastic sphere
# Assumed force error of the pressure basis, divided by the change of the force on refinement.
# On refinement, the basis functions of the pressure have half the width.
# A division of the width of the basis functions by 4 changes the force 1.8 times as much as a
# division of the width by 2.
# The assumed factor of 3 between force error and change of the force is therefore on the safe side.
REFINEMENT_LIMIT = 3.0
# Shortest interval without contact [s] that counts as a flight.
# The interval is several times as long as a vibration period of a chip.
# A shorter interval without contact counts as a bounce during a launch, not as the end of the
# launch.
_MIN_FLIGHT = 20e-6
# Safety factor on the estimated indentation.
# The factor is necessary, because a body is not a half-space and only a few rings carry the force.
_INDENTATION_MARGIN = 1.25


@dataclass(frozen=True)
class ContactSurface:
    """Surface of a part that can be in contact with another surface.

    ``distance`` [m] contains the distances of the ports from the axis. The voltages of the pins
    ``ports`` are positions in um, and the contact force acts on these pins. For a rigid part, the
    force acts on the pin ``velocity`` instead. ``radius`` [m] is the radius of a sphere, None for a
    plane. ``sectors`` is the number of symmetry sectors if the stiffness applies to a single
    sector. If the port is a patch with a pressure basis, ``patch`` [m] is its radius,
    ``compliance`` is its compliance, and ``pace`` [s] is its damping time. If the surface is
    rigid, ``elastic`` is the name of the part that models the elasticity; this part has the port
    ``patch``. ``modulus`` [Pa] is the indentation modulus if the surface is a half-space.
    """

    part: str
    ports: tuple[str, ...]
    distance: tuple[float, ...]
    velocity: str = ""
    radius: float | None = None
    sectors: int = 1
    patch: float = 0.0
    compliance: Callable[[PressureBasis], LocalCompliance] | None = None
    pace: float = 0.0
    elastic: str = ""
    modulus: float | None = None

    @property
    def is_rigid(self) -> bool:
        """Whether the surface is rigid; contact forces then act on the pin ``velocity``."""
        return bool(self.velocity)

    @property
    def force_pins(self) -> tuple[str, ...]:
        """Pins of the part on which the contact force acts."""
        return (self.velocity,) if self.velocity else self.ports

    def map_pins_to_surface(self, pins: Iterable[str], scene: GovernedScene) -> dict[str, str]:
        """Return the connections of the contact's ``pins`` to this surface.

        If another part prescribes the motion of the surface, the pins of that part are used.
        """
        if self.part == GROUND:
            return dict.fromkeys(pins, GROUND)
        owner = scene.movers.get(self.part) or self.part
        ends = (*self.force_pins, *self.ports) if self.is_rigid else self.ports
        return {pin: f"{owner}.{end}" for pin, end in zip(pins, ends, strict=False)}

    def compute_surface_position(self, port: str, waves: Waveforms) -> np.ndarray | None:
        """Return the position [m] of the surface at ``port``, relative to the first touch."""
        if self.part == GROUND:
            return np.zeros(next(iter(waves.data.values())).size)
        if self.radius is not None and self.is_rigid:
            y = waves.data.get(f"{self.part}.y")
            return None if y is None else y - self.radius
        return waves.data.get(f"{self.part}.u.{port}", waves.data.get(f"{self.part}.x"))


@dataclass(frozen=True)
class LargestIndentation:
    """Largest indentation [m] of two contact surfaces, and the event that causes it.

    ``speed_key`` is the key of the scene that sets the speed of the impact, and ``speed`` [m/s] is
    this speed.
    """

    depth: float
    why: str
    speed_key: str = ""
    speed: float = 0.0


class TouchablePart(PartType[KeysT]):
    """Base class of part types that have a contact surface or press surfaces together.

    A part that has no contact surface can still press the contact surfaces of two other parts
    together.
    """

    def contact_surface(
        self, part: Part[KeysT], scene: GovernedScene, ports: tuple[str, ...] = ()
    ) -> ContactSurface | None:
        """Return the contact surface of the part, or None if the part has no surface."""
        return None

    def largest_indentations(
        self, part: Part[KeysT], scene: GovernedScene
    ) -> Iterable[LargestIndentation]:
        """Return the largest indentation that the part can cause at each contact."""
        return ()


def find_surface(
    part: Part, scene: GovernedScene, ports: tuple[str, ...] = ()
) -> ContactSurface | None:
    """Return the contact surface of a part at ``ports``; None without a surface.

    Without ``ports``, the surface contains the default contact ports of the part.
    """
    return (
        part.type.contact_surface(part, scene, ports)
        if isinstance(part.type, TouchablePart)
        else None
    )


def compute_ring_gaps(distance: np.ndarray, sphere_radius: float) -> np.ndarray:
    """Return the gap [m] between a sphere and a plane at each distance from the axis.

    ``distance`` [m] is the distance from the axis. The sphere touches the plane on the axis. At the
    distance r from the axis, the gap between a plane and a sphere of radius R is ``R - sqrt(R^2 -
    r^2)``. The formula ``r^2 / (R + sqrt(R^2 - r^2))`` gives the same gap without cancellation.
    """
    r = np.asarray(distance, dtype=float)
    return r**2 / (sphere_radius + np.sqrt(sphere_radius**2 - r**2))


@dataclass(frozen=True)
class ContactPair:
    """Both sides of a contact: the surface ``a`` below and the surface ``b`` above.

    Side ``a`` has one or several ports. The contact opens when ``b`` rises.
    """

    part: Part[ContactKeys]
    scene: GovernedScene

    @property
    def keys(self) -> ContactKeys:
        """Keys of the contact part."""
        return self.part.keys

    @cached_property
    def lower_surface(self) -> ContactSurface:
        """Surface on the lower side of the contact."""
        return self._find_side("a", spherical=False)

    @cached_property
    def upper_surface(self) -> ContactSurface:
        """Surface on the upper side of the contact."""
        return self._find_side("b", spherical=True)

    def _find_side(self, key: str, *, spherical: bool) -> ContactSurface:
        """Return the surface that the key ``a`` or ``b`` selects.

        Without the key, the scene must have exactly one suitable surface.
        """
        part, scene = self.part, self.scene
        selected: str | tuple[str, ...] | None = getattr(part.keys, key)
        if selected is None:
            offers, masses = [], []
            for other in scene.parts.values():
                surface = find_surface(other, scene)
                if surface is not None and (surface.radius is not None) == spherical:
                    offers.append(surface)
                elif surface is not None and not other.is_body:
                    masses.append(surface.part)
            if not offers:
                kind = ("sphere", "sphere") if spherical else ("body with a flat surface", "kick")
                hint = f"add the table [{kind[1]}], which needs no keys, to the scene"
                if spherical and masses:
                    hint = f'write  {key} = "{masses[0]}"'
                raise part.wrong(
                    key,
                    f"the scene has no {kind[0]} that {part.name} can touch",
                    got=f"no {kind[0]}",
                    expected=f'{key} = "PART" or "PART.PORT"',
                    hint=hint,
                )
            if len(offers) > 1:
                raise part.wrong(
                    key,
                    f"{part.name} can touch several parts, so the key `{key}` must name one",
                    got=f"no key `{key}`; possible parts: "
                    f"{', '.join(item.part for item in offers)}",
                    expected=f'{key} = "PART" or "PART.PORT"',
                    hint=f'write  {key} = "{offers[0].part}"',
                )
            return offers[0]
        if selected == GROUND:
            return ContactSurface(GROUND, (FLOOR_PORT,), (0.0,))
        targets = (selected,) if isinstance(selected, str) else selected
        names = {target.partition(".")[0] for target in targets}
        if len(names) != 1:
            raise part.wrong(
                key,
                f"the key `{key}` of {part.name} lists ports of several parts",
                got=f"ports of {', '.join(sorted(names))}",
                expected="ports of one part",
                hint=(
                    f"delete the ports in {key} that do not belong to {min(names)}, and add "
                    f"another contact for {max(names)}"
                ),
            )
        other = scene.get_part(names.pop(), f"{part.name}.{key}")
        ports = tuple(target.partition(".")[2] for target in targets if "." in target)
        if (surface := find_surface(other, scene, ports)) is None:
            fitting = [p.name for p in scene.parts.values() if find_surface(p, scene) is not None]
            hint = f'write  {key} = "{fitting[0]}"' if fitting else "add  [mass]  to the scene"
            raise part.wrong(
                key,
                f"{other.type.name} has no surface for a contact",
                got=repr(other.name),
                expected="a body, a sphere or a mass",
                hint=hint,
            )
        return surface

    @cached_property
    def gaps(self) -> np.ndarray:
        """Gap [m] at each port of the lower surface, with both surfaces at rest."""
        distance = np.array(self.lower_surface.distance)
        curved = (
            0.0 * distance
            if self.upper_surface.radius is None
            else compute_ring_gaps(distance, self.upper_surface.radius)
        )
        return np.asarray(curved + self.keys.gap)

    @cached_property
    def ports(self) -> tuple[str, ...]:
        """Ports of the contact's lower surface at which a contact spring acts.

        The ports have the same order as in ``lower_surface.ports``.
        """
        rings, ports = self.keys.rings, self.lower_surface.ports
        if (
            rings == "all"
            or len(ports) == 1
            or list(self.lower_surface.distance) != sorted(self.lower_surface.distance)
        ):
            return ports
        if rings == "needed":
            return ports[
                : max(1, int(np.count_nonzero(self.gaps < self.largest_indentation.depth)))
            ]
        return ports[:rings]

    @cached_property
    def largest_indentation(self) -> LargestIndentation:
        """Largest indentation [m] that any part of the scene can cause in the contact."""
        parts, by = self.scene.parts, self.scene.movers.get(self.upper_surface.part)
        able = parts.values() if by is None else [parts[by]]
        result = [LargestIndentation(0.0, "its weight")]
        for part in able:
            if isinstance(part.type, TouchablePart):
                result += part.type.largest_indentations(part, self.scene)
        return max(result, key=lambda item: item.depth)

    @property
    def excludes_launch_from_rest(self) -> bool:
        """Whether the contact excludes a launch from rest, as with a fixed upper side.

        A launch from rest is also excluded if the lower side of the contact is rigid, or if the
        scene prescribes the initial state of the upper part. Callers evaluate a launch from rest
        only if the value is false.
        """
        return (
            self.upper_surface.part == GROUND
            or self.lower_surface.is_rigid
            or self.upper_surface.part in self.scene.initial_states
        )

    def forces(self, waves: Waveforms) -> np.ndarray:
        """Return the recorded forces [N] at the ports as an array of shape (ports, n)."""
        return np.array([waves[f"{self.part.name}.force.{port}"] for port in self.ports])

    # --- the law ----------------------------------------------------------------------------------

    @cached_property
    def contact_force(self) -> ContactForce:
        """Law of the contact force at each port.

        For a sphere of radius R, the force is ``4/3 E* sqrt(R) x^(3/2)`` at the indentation x
        (Hertz 1881). The combined modulus ``E*`` follows from the indentation moduli ``M_a`` and
        ``M_b`` of both sides: ``1/E* = 1/M_a + 1/M_b``. For two spheres of radii R_a and R_b, ``1/R
        = 1/R_a + 1/R_b``. In a groove of opening angle g, the axial indentation x indents each
        flank by ``s x`` with ``s = sin(g/2)``. The fraction ``s`` of the flank forces acts along
        the axis. With ``s = sin(g/2)``, the stiffness of a groove is ``2 s^(1 + power)`` times the
        stiffness of one flank. Each flank has the closing speed ``s x'``, which determines the
        damping. A force F that presses a body into a groove of opening angle g causes the normal
        force ``F / (2 sin(g/2))`` on each of the two flanks. The friction force along the groove is
        therefore ``1 / s`` times the friction force on a plane.
        """
        keys, along = self.keys, (self.keys.damping, self.keys.friction, self.keys.creep)
        if keys.shape == "pressure":
            assert self.upper_surface.radius is not None
            local, pace = self.basis_compliance_and_damping_time
            result = _get_indentation_law(
                self.pressure_basis, local.compliance, self.upper_surface.radius
            )
            first, *_ = result.coefficients
            curve = tuple(np.divide(result.coefficients, first).tolist())
            stiffness, of = (
                first / result.depth**1.5,
                (result.depth, pace, self.upper_surface.radius),
            )
            return ContactForce(stiffness, 1.5, *along, curve, *of)
        value, power = self.lower_surface.sectors * float(keys.penalty), 1.0
        if keys.law == "hertz":
            spherical = [
                1 / side.radius
                for side in (self.lower_surface, self.upper_surface)
                if side.radius is not None
            ]
            count = len(self.lower_surface.ports)
            if not spherical or count > 1:
                spheres = ("no sphere", "1 sphere", "2 spheres")[len(spherical)]
                raise self.part.wrong(
                    "law",
                    "the law of Hertz requires a sphere that touches a part at a single port",
                    got=f"{spheres}, and {count} port{'s' * (count > 1)} of "
                    f"{self.lower_surface.part} in the contact",
                    expected="two spheres, or a sphere and a surface, in contact at a single port",
                    hint='write  law = "linear"',
                )
            value, power = 4 / 3 * self._combined_modulus / math.sqrt(sum(spherical)), 1.5
        if (s := self.half_angle_sine) is not None:
            value *= 2 * s ** (1 + power)
            along = s * keys.damping, keys.friction / s, keys.creep
        return ContactForce(value, power, *along)

    @property
    def half_angle_sine(self) -> float | None:
        """Sine of half the opening angle of the groove; None without a groove."""
        groove = self.keys.groove
        return None if groove is None else math.sin(math.radians(groove) / 2)

    @property
    def _combined_modulus(self) -> float:
        """Combined modulus ``E*`` [Pa] of both sides of the contact."""
        if self.keys.modulus is not None:
            return float(self.keys.modulus)
        compliance = 0.0
        for side in (self.lower_surface, self.upper_surface):
            if side.modulus is None:
                raise self.part.wrong(
                    "modulus",
                    f"the modulus of {side.part} is not known",
                    expected='a pressure such as "110 GPa", or a material for each side',
                    hint='add the combined modulus of both materials, such as  modulus = "110 GPa"',
                )
            compliance += 1 / side.modulus
        return 1 / compliance

    # --- pressure (kc2spice.bodies.contact_pressure)
    # ------------------------------------------------------

    @cached_property
    def pressure_basis(self) -> PressureBasis:
        """Piecewise linear basis functions for the contact pressure on the lower surface."""
        from kc2spice.bodies.contact_pressure import choose_pressure_basis

        return choose_pressure_basis(self.keys.spacing, self.lower_surface.patch)

    @cached_property
    def basis_compliance_and_damping_time(self) -> tuple[LocalCompliance, float]:
        """Compliance of two surfaces in the pressure basis, and mean damping time [s].

        The compliances of both surfaces are added. They are matrices for the basis functions of
        :attr:`pressure_basis`.
        """
        return self._combine_compliances(self.pressure_basis)

    def _combine_compliances(self, shape: PressureBasis) -> tuple[LocalCompliance, float]:
        """Return the summed compliance of both sides, and their mean damping time [s].

        The mean of the damping times of both sides is weighted by the compliances of the sides.
        Stiffness-proportional damping with the damping time ``beta`` has the damping matrix ``beta
        K``.
        """
        assert self.lower_surface.compliance is not None
        result = self.lower_surface.compliance(shape)
        if not self.upper_surface.elastic:
            return result, self.lower_surface.pace
        surface = find_surface(
            self.scene.parts[self.upper_surface.elastic], self.scene, (SPHERE_PATCH,)
        )
        assert surface is not None
        assert surface.compliance is not None
        other = surface.compliance(shape)
        total = result.compliance + other.compliance
        share = float(np.trace(other.compliance) / np.trace(total))
        pace = (1 - share) * self.lower_surface.pace + share * surface.pace
        return replace(result, compliance=total, patch=result.patch + other.patch), pace

    def compute_basis_forces(self, force: float) -> np.ndarray:
        """Return an array (n,) with the contact force [N] on each basis function.

        The sum of these forces is ``force``.
        """
        from kc2spice.bodies.contact_pressure import solve_contact_forces

        assert self.upper_surface.radius is not None
        depths = np.linspace(0.0, self.contact_force.depth, 1000)
        depth = np.interp(force, self.contact_force.force(depths), depths)
        gap = compute_ring_gaps(self.pressure_basis.mean_gap_radii, self.upper_surface.radius)
        result = solve_contact_forces(
            self.basis_compliance_and_damping_time[0].compliance, gap, np.array([depth])
        )[0]
        return np.asarray(force / result.sum() * result)

    def estimate_basis_error(self) -> float:
        """Estimate the relative error that the pressure basis causes in the contact force.

        The estimate is 0 for a contact with rings. The estimate is proportional to the largest
        relative change of the contact force when the width of the basis functions is halved. The
        forces are compared at indentations between half of the largest indentation of the scene and
        the largest indentation. For each width of the basis functions, the force follows from the
        compliance of the complete contact patch plus the local compliance.
        """
        from kc2spice.bodies.contact_pressure import choose_pressure_basis

        if self.keys.shape != "pressure":
            return 0.0
        assert self.upper_surface.radius is not None
        forces = []
        for wider in (1.0, 0.5):
            shape = choose_pressure_basis(wider * self.keys.spacing, self.lower_surface.patch)
            result, _ = self._combine_compliances(shape)
            law = _get_indentation_law(
                shape, result.compliance + result.patch, self.upper_surface.radius
            )
            deepest = min(self.largest_indentation.depth or math.inf, law.depth)
            forces.append(law.force(np.linspace(0.5, 1.0, 50) * deepest))
        return REFINEMENT_LIMIT * float(np.abs(forces[1] / forces[0] - 1).max())

    # --- motion -----------------------------------------------------------------------------------

    def find_prescribed_indentation(self, waves: Waveforms) -> np.ndarray | None:
        """Return the prescribed indentation [m] of side ``b``; None if ``b`` moves freely."""
        return waves.data.get(f"{self.scene.movers.get(self.upper_surface.part)}.depth")

    def compute_lowest_point(self, waves: Waveforms) -> np.ndarray | None:
        """Return the position [m] of the lowest point of side ``b``.

        The position is zero at the first touch.
        """
        depth = self.find_prescribed_indentation(waves)
        result = (
            self.upper_surface.compute_surface_position(self.upper_surface.ports[0], waves)
            if depth is None
            else -depth
        )
        if not self.upper_surface.elastic or result is None:
            return result
        dent = waves.data.get(f"{self.upper_surface.elastic}.u.{SPHERE_PATCH}")
        return None if dent is None else result + dent


def make_pair(contact: Part, scene: GovernedScene) -> ContactPair:
    """Return the stored pair of surfaces of a contact, or otherwise make a new pair.

    A scene stores the pair of surfaces in the :class:`PartRecord` of the contact.
    """
    record = scene.get_record(contact)
    if record is None or not isinstance(record.shared_data, ContactPair):
        return ContactPair(contact.with_schema(ContactKeys), scene)
    return record.shared_data


def find_single_contact(scene: GovernedScene) -> ContactPair | None:
    """Return the contact pair of a scene that has exactly one contact, or None."""
    contact = scene.find_only_part("contact")
    return None if contact is None else make_pair(contact, scene)


def _get_indentation_law(
    shape: PressureBasis, compliance: np.ndarray, radius: float
) -> IndentationLaw:
    """Return the law of force versus indentation for a sphere on a compliant surface.

    Equal laws are computed only once.
    """
    return _fit_cached_law(shape.nodes.tobytes(), compliance.tobytes(), radius)


@lru_cache(maxsize=8)
def _fit_cached_law(nodes: bytes, compliance: bytes, radius: float) -> IndentationLaw:
    """Fit the indentation law of a sphere on a compliant surface, and cache the law.

    ``nodes`` contains the radii [m] at which the pressure basis functions have their nodes.
    ``compliance`` is the compliance matrix of the surface, and ``radius`` [m] is the radius of the
    sphere. The arrays are passed as bytes, because NumPy arrays are not hashable, but the keys of
    the cache must be hashable.
    """
    from kc2spice.bodies.contact_pressure import PressureBasis, fit_indentation_law

    shape = PressureBasis(np.frombuffer(nodes))
    matrix = np.frombuffer(compliance).reshape(len(shape.nodes) - 1, -1)
    return fit_indentation_law(shape, matrix, compute_ring_gaps(shape.mean_gap_radii, radius))


# --- largest indentation by a sphere --------------------------------------------------------------


def estimate_impact_indentation(
    sphere: Part, mass: float, scene: GovernedScene, speed: float, why: str, speed_key: str = ""
) -> Iterator[LargestIndentation]:
    """Yield the largest indentation by a sphere that hits a surface.

    ``speed`` is the speed [m/s] of the sphere when the contact closes. ``why`` describes in words
    the event that causes the indentation. ``speed_key`` is the key that sets the speed.

    Among all states with the indentation d, the static state has the smallest stored energy. The
    static law of Hertz (1881) therefore gives an upper bound of d: ``m v^2 / 2 = 8/15 E sqrt(R)
    d^(5/2)``. m is the mass of the sphere, v is its speed, R is its radius, and E is the combined
    modulus.
    """
    energy = 0.5 * mass * speed**2
    for contact in scene.list_parts("contact"):
        pair = make_pair(contact, scene)
        if (
            pair.upper_surface.part == sphere.name
            and pair.upper_surface.radius
            and (modulus := pair.lower_surface.modulus)
        ):
            if pair.upper_surface.elastic:
                assert pair.upper_surface.modulus is not None
                modulus = 1 / (1 / modulus + 1 / pair.upper_surface.modulus)
            depth = (15 * energy / (8 * modulus * math.sqrt(pair.upper_surface.radius))) ** 0.4
            yield LargestIndentation(_INDENTATION_MARGIN * float(depth), why, speed_key, speed)


# --- launch from a contact ------------------------------------------------------------------------


def find_separation(
    t: np.ndarray, force: np.ndarray, v: np.ndarray, busy: float = math.inf, power: float = 1.0
) -> tuple[float, float] | None:
    """Return the start time [s] and start velocity [m/s] of a flight without contact.

    A flight is an interval without contact that lasts at least 20 us, or until the end of the data.
    If the data contain no flight, the result is None. In contact, the force is proportional to
    ``overlap**power``.

    A run can contain several flights, because a body can fall back and rebound again. The drive
    ends at the time ``busy`` [s]. Only flights that begin at most 20 us after the end of the drive
    are candidates for the result. If all flights begin later than 20 us after the end of the drive,
    only the earliest flight is a candidate. The result is the first candidate flight whose start
    velocity is at least half the largest start velocity of all candidates. The default ``busy =
    inf`` describes a drive that never ends, so that all flights are candidates for the result.
    """
    loaded = force > 1e-9 * force.max(initial=0.0)
    force = np.maximum(force, 0.0) ** (1 / power)
    flights = []
    for last in np.flatnonzero(loaded[:-1] & ~loaded[1:]):
        again = np.flatnonzero(loaded[last + 1 :])
        if again.size == 0 or t[last + 1 + again[0]] - t[last] >= _MIN_FLIGHT:
            flights.append(_extrapolate_release(t, v, force, int(last)))
    if not flights:
        return None
    kicked = [item for item in flights if item[0] <= busy + _MIN_FLIGHT] or flights[:1]
    fastest = max(map(itemgetter(1), kicked))
    return next(item for item in kicked if item[1] >= min(fastest, fastest / 2))


def _extrapolate_release(
    t: np.ndarray, v: np.ndarray, force: np.ndarray, last: int
) -> tuple[float, float]:
    """Return time [s] and velocity [m/s] at which the contact force vanishes.

    The contact force is extrapolated to zero. The velocity at this time is extrapolated from the
    flight. The velocity after the last sample with a contact force is not suitable, because it
    still changes under load. In flight, the rate of change of the velocity is nearly constant, so a
    linear extrapolation is accurate.
    """
    time, free = float(t[last]), last + 1
    if last > 0 and force[last - 1] > force[last]:
        decay = (force[last - 1] - force[last]) / (t[last] - t[last - 1])
        time = min(time + force[last] / decay, float(t[free]))
    later = min(int(np.searchsorted(t, t[free] + 100e-9)), t.size - 1)
    slope = (v[later] - v[free]) / (t[later] - t[free]) if later > free else 0.0
    return float(time), float(v[free] + slope * (time - t[free]))


def find_last_source_change(scene: WiredScene) -> float:
    """Return the time [s] after which all sources of the scene are constant.

    Sources that drive only controllers are ignored. The time is infinite if all other sources are
    constant, or if a source never stops changing.
    """
    ends = []
    for source in scene.list_parts_with_schema("source", SourceKeys):
        wave = source.keys.waveform
        if scene.list_joined_types(source.name, "out") <= {"pid"}:
            continue
        corners = wave.find_corner_times(scene.stop_time)
        ends.append(float(max(corners, default=0.0)) if wave.is_piecewise_linear else math.inf)
    last = max(ends, default=0.0)
    return last if last > 0 else math.inf
