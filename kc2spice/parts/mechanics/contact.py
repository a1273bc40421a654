"""The part ``contact``: unilateral contact of bodies, or of a body and a sphere.

Source of the contact law: eq. 10 of Schütz, Maeter and Bechtold, Actuators 10 (2021) 279.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from kc2spice.bodies.stack_keys import MAX_RINGS, StackKeys
from kc2spice.core import constitutive_laws as laws
from kc2spice.core.domains import AMBIENT, HEAT
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Curve, Figure, Panel, choose_time_unit
from kc2spice.core.key_actions import DeleteKey
from kc2spice.core.progress import StageTimer
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveforms, integrate_cumulatively
from kc2spice.parts.mechanics._contact_keys import ContactKeys
from kc2spice.parts.mechanics._contact_surfaces import (
    SPHERE_PATCH,
    ContactPair,
    find_last_source_change,
    find_separation,
    make_pair,
)
from kc2spice.physics import Declaration, DeclaredPart
from kc2spice.physics.contact import SPACING_NOTE, ContactForce, declare_contact
from kc2spice.physics.declaration_cards import get_meter_name, name_force_node
from kc2spice.physics.loss_heat import list_heat_vectors
from kc2spice.physics.part import make_pins
from kc2spice.rom.linear_model import LinearModel
from kc2spice.scene.checks import (
    SOLUTION_PAIRS,
    Check,
    Gate,
    Metric,
    RunEnergyBalance,
    compute_motion_error_limit,
)
from kc2spice.scene.part_records import (
    EquilibriumConditions,
    NeglectedEffect,
    NumericalRequirements,
    PartResult,
)
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    GROUND,
    BuiltScene,
    GovernedScene,
    JoinedScene,
    Part,
    Scene,
    Terminal,
    WiredScene,
)

# Error limits of the launch velocity of the reduced model, relative to the full model.
# The limit is ESTIMATE_FACTOR times the error estimate of the reduced model, but at most
# MAX_LAUNCH_LIMIT. For a model without an error estimate, the limit is DEFAULT_LAUNCH_LIMIT.
# MAX_LAUNCH_LIMIT is necessary, because the error estimate at a sharp resonance may be huge.
# Runs print a warning if the error estimate under load exceeds 1 %.
ESTIMATE_FACTOR = 0.4
DEFAULT_LAUNCH_LIMIT = 1e-3
MAX_LAUNCH_LIMIT = 1e-2
# Largest permitted energy error of the contact springs.
# The error is relative to the energy that flowed through the springs.
MAX_ENERGY_ERROR = 1e-3
# Smallest number of basis functions across the radius of a contact, for a relative force error of
# 5e-3. With half as many basis functions, the relative force error is 3e-2.
FUNCTIONS_PER_RADIUS = 3.0
MAX_BASIS_ERROR = 3e-2  # largest permitted relative force error of a pressure basis
BEYOND_RINGS = "the contact area extends beyond the modelled rings"
# Largest contact radius that advice proposes, divided by the radius of the sphere.
# Hertz's law assumes a contact radius far below the radius of the sphere.
MAX_CONTACT_SHARE = 0.5
RING_GROWTH = 1.5  # smallest proposed growth of the radius that the contact rings cover
EDGE_TOLERANCE = 1e-5  # smallest distance from the outermost ring to the edge, relative
MAX_RING_MOTION = 0.95  # largest permitted motion of an omitted ring, divided by its gap
# Largest permitted product of reltol and the number of contact events during one launch.
# Each contact event adds the error of one time step, so more contact events need a smaller reltol.
# In tests with 37 launches, products of reltol and number of contact events above MAX_EVENT_RELTOL
# caused launch velocity errors of up to 9e-4.
# In the tests with 37 launches, the piezoelectric chips had damping ratios of 0.01 to 0.05 %.
MAX_EVENT_RELTOL = 4e-3
MAX_START_HEIGHT = 1e-8  # largest height [m] above a body at which a sphere counts as resting
CONTACT_FREQUENCY = 500e3  # highest frequency [Hz] that a contact excites in bodies
# Factors on ``solver.reltol`` for Hertzian or pressure contacts, and for damped contacts.
CURVED_RELTOL_FACTOR = 0.1
DAMPED_RELTOL_FACTOR = 0.01
MIN_EVENTS = 20  # number of contacts up to which every reltol is accurate enough
INDENTATION_PIN = "dent"  # pin that is connected to the port of an elastic sphere


class Contact(DeclaredPart[ContactKeys]):
    """Part type ``contact``: unilateral contact with a force law.

    The force law depends on the keys of the contact, and on the two parts that touch.
    """

    name = "contact"
    origin_of_pins = "The pins of a part follow from the two surfaces that its keys name."
    title = "unilateral penalty contact"
    discretisations = ("spacing",)
    schema = ContactKeys

    def shared_data(self, part: Part[ContactKeys], scene: GovernedScene) -> ContactPair:
        """Return the pair of contact surfaces, which other parts read."""
        return ContactPair(part, scene)

    def make_declaration(self, part: Part[ContactKeys], scene: GovernedScene) -> Declaration:
        """Return the declaration of the part for the values of its keys."""
        pair = make_pair(part, scene)
        radius, distance = pair.upper_surface.radius, pair.lower_surface.distance
        under = None if radius is None else (radius, tuple(map(float, distance)))
        return _declare_pair(pair, pair.contact_force, under, part.keys.groove)

    def pins(self, part: Part[ContactKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        law = ContactForce(1.0, damping=part.keys.damping, friction=part.keys.friction)
        d = self._with_heat_pin(_declare_pair(make_pair(part, scene), law), part, scene)
        ends = {"rail": "gnd", "base": "gnd", AMBIENT: "gnd"}
        return tuple(
            Terminal(p.name, p.unit, p.flow, ends.get(p.name), required=p.name in ("slide", HEAT))
            for p in make_pins(d)
        )

    def default_joins(self, part: Part[ContactKeys], scene: GovernedScene) -> Mapping[str, str]:
        """Return the default connections of the pins to the surfaces of both parts."""
        pair = make_pair(part, scene)
        joins = pair.lower_surface.map_pins_to_surface(
            ("va", "a") if pair.lower_surface.is_rigid else pair.ports, scene
        )
        joins |= pair.upper_surface.map_pins_to_surface(
            ("v", "bottom") if pair.upper_surface.is_rigid else ("b",), scene
        )
        return joins | (
            {INDENTATION_PIN: f"{pair.upper_surface.elastic}.{SPHERE_PATCH}"}
            if pair.upper_surface.elastic
            else {}
        )

    def equilibrium_conditions(
        self, part: Part[ContactKeys], scene: WiredScene
    ) -> EquilibriumConditions:
        """Return the equilibrium conditions: pin pairs with a possible constant force.

        The pin ``base`` and the pins of rigid surfaces form pairs with ground. If two elastic
        surfaces touch without a gap, each port of the lower surface forms a pair with the pin ``b``
        of the upper surface.
        """
        pair = make_pair(part, scene)
        pins = ("base", *["va"] * pair.lower_surface.is_rigid, *["v"] * pair.upper_surface.is_rigid)
        clamps = [*product(pins, (GROUND,))]
        if (
            part.keys.gap <= 0.0
            and not pair.lower_surface.is_rigid
            and not pair.upper_surface.is_rigid
        ):
            clamps += product(pair.ports, ("b",))
        return EquilibriumConditions(tuple(clamps))

    def numerics(
        self, part: Part[ContactKeys], scene: WiredScene
    ) -> Iterator[NumericalRequirements]:
        """Yield numerical requirements: tolerances, tighter for damped or nonlinear laws.

        With the trapezoidal rule, the errors at closing and at opening cancel only for a linear
        spring. In tests with the tighter tolerances, rebound speeds had relative errors of 1.5e-4.
        The tests of the tighter tolerances covered rebounds that lost 0 to 70 % of the energy of
        the impact.
        """
        curved = part.keys.law == "hertz" or part.keys.shape == "pressure"
        reltol = (
            DAMPED_RELTOL_FACTOR if part.keys.damping else CURVED_RELTOL_FACTOR if curved else 1.0
        )
        what = "vibrations of the bodies that the contact excites"
        yield NumericalRequirements(what, highest_frequency=CONTACT_FREQUENCY, reltol=reltol)

    def problems(self, part: Part[ContactKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        pair = make_pair(part, scene)
        a, b = pair.lower_surface, pair.upper_surface
        if a.part == b.part != GROUND and set(a.force_pins) & set(b.force_pins):
            others = [name for name in scene.parts if name not in (a.part, part.name)]
            yield part.wrong(
                "b",
                "both sides of the contact are the same part",
                got=f"{a.part} on both sides",
                expected="two parts, or two ports of a body",
                hint=f'write the name of another part, such as  b = "{(*others, "gnd")[0]}"',
            )
        if b.radius is not None and max(a.distance) >= b.radius:
            yield UsageError(
                "the outermost contact ring is larger than the sphere, so the sphere can never "
                "touch it",
                where=f"{a.part}.mesh.ring_spacing",
                got=f"ring radius {max(a.distance):g} m",
                expected=f"less than {b.part}.radius, {b.radius:g} m",
                hint=f"lower {a.part}.mesh.ring_spacing",
            )
        if part.keys.modulus is not None and part.keys.law != "hertz":
            warn_user(
                f"{part.name}: the key `modulus` has no effect with law = "
                f'"{part.keys.law}": write  law = "hertz"  or delete the key'
            )
        if part.keys.shape == "pressure":
            yield from _check_pressure_shape(pair)
        else:
            # The property ``contact_force`` raises an error if the law does not fit both surfaces.
            assert pair.contact_force

    def vectors(self, part: Part[ContactKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        n, pair, d = (
            part.name,
            make_pair(part, build.scene),
            self.make_declaration(part, build.scene),
        )
        card, heated = f"@b.x{n}.b{{}}[i]", self.declare_part(part, build.scene).heat_branch
        item = {b.through: card.format(name_force_node(b)).lower() for b in d.branches}
        result = {}
        for port in pair.ports:
            force = item[f"force.{port}"]
            result[f"{n}.force.{port}"] = PartResult(force, 1.0, "N", enters=(port,))
        if part.keys.friction:
            row = PartResult(item["friction"], 1.0, "N", ("rail",), ("slide",))
            result[f"{n}.friction"] = row
        total = "+".join(item[f"force.{port}"] for port in pair.ports)
        ends = {"force": (("v", "b", INDENTATION_PIN), ("va",))}
        for word, by in _list_result_factors(pair).items():
            result[f"{n}.{word}"] = PartResult(total, by, "N", *ends.get(word, ()))
        if heated is not None:
            result |= list_heat_vectors(part, build, get_meter_name(heated))
        return result

    def metrics(
        self, part: Part[ContactKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics of the part, keyed by name."""
        pair = make_pair(part, build.scene)
        v = waves.data.get(f"{pair.upper_surface.part}.v")
        if "time" not in waves or v is None or pair.excludes_launch_from_rest:
            return {}
        force, busy = waves[f"{part.name}.force"], find_last_source_change(build.scene)
        launch = find_separation(waves["time"], force, v, busy, pair.contact_force.power)
        return {
            "launch_velocity_m_s": Metric(launch[1] if launch else None, "m/s"),
            "launch_time_s": Metric(launch[0] if launch else None, "s"),
        }

    def checks(
        self, part: Part[ContactKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check | RunEnergyBalance | Gate]:
        """Yield the checks of the part after a run."""
        pair, gates = make_pair(part, build.scene), build.scene.gates
        if "time" in waves and not pair.excludes_launch_from_rest:
            steps = compute_motion_error_limit(build.scene.solver)
            certificate = getattr(build.models.get(pair.lower_surface.part), "certificate", None)
            reduced = DEFAULT_LAUNCH_LIMIT
            if certificate:
                reduced = min(ESTIMATE_FACTOR * certificate.error_estimate, MAX_LAUNCH_LIMIT)
            limits = dict.fromkeys(SOLUTION_PAIRS, gates.launch_full_model or steps + reduced)
            limits["ngspice_vs_rom"] = gates.launch_velocity or steps
            yield Gate("launch velocity", "launch_velocity_m_s", limits, is_main=True)
        place = pair.compute_lowest_point(waves)
        if "time" in waves:
            yield from _check_events(pair, waves)
        if place is not None:
            if "time" in waves:
                yield from _balance_energy(pair, waves, place)
                yield from _check_start(pair, waves, place)
            yield from _check_contact_extent(pair, build, waves, place)
            yield from _check_depth(pair, waves, place)

    def figures(
        self, part: Part[ContactKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Figure]:
        """Yield the figures of the part for the report."""
        force = waves.data.get(f"{part.name}.force")
        if force is None:
            return
        pair = make_pair(part, build.scene)
        inside = _find_loaded_interval(force) if "time" in waves else slice(None)
        scale = next(iter(waves.data.values()))
        x, factor = choose_time_unit(scale[inside])
        if (depth := pair.find_prescribed_indentation(waves)) is not None:
            scale, (x, factor) = depth, ("depth in µm", 1e6)
        curves = []
        for port, wave in zip(pair.ports, pair.forces(waves), strict=True):
            if wave.max() > 0:
                curves.append(Curve(port, factor * scale[inside], wave[inside]))
        if len(pair.ports) > 1:
            curves.append(Curve("sum", factor * scale[inside], force[inside], "--"))
        sides = f"{pair.lower_surface.part} and {pair.upper_surface.part}"
        panel = Panel(x, "contact force in N", tuple(curves))
        caption = f"Contact force between {sides} at each port in contact, for the whole device."
        yield Figure(f"{part.name}_force", f"Contact of {sides}", caption, (panel,))

    def law(self, part: Part[ContactKeys], build: BuiltScene) -> laws.Equations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice."""
        n, pair, result = part.name, make_pair(part, build.scene), super().law(part, build)
        forces = [result.results[f"{n}.force.{port}"].terms[0][1] for port in pair.ports]
        sums = {}
        for word, share in _list_result_factors(pair).items():
            sums[f"{n}.{word}"] = laws.WaveCombination(tuple(product([share], forces)))
        return replace(result, results=result.results | sums)

    def compare_with_finer_mesh(
        self, part: Part[ContactKeys], build: BuiltScene, clock: StageTimer, most: float
    ) -> Iterator[Check | str]:
        """Compare the contact force with a model whose basis functions are half as wide."""
        if part.keys.shape == "pressure":
            name = f"force of {part.name} with pressure basis functions of half the width"
            yield Check(name, make_pair(part, build.scene).estimate_basis_error(), MAX_BASIS_ERROR)

    def describe_discretisation(self, part: Part[ContactKeys], build: BuiltScene) -> str:
        """Describe the discretisation error of the pressure basis, which is not estimated.

        For a contact with rings, which has no pressure basis, the note is an empty string.
        """
        return f"mesh: {SPACING_NOTE}" if part.keys.shape == "pressure" else ""

    def notes(self, part: Part[ContactKeys], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys, pair = part.keys, make_pair(part, scene)
        normal = pair.contact_force
        if keys.shape == "pressure":
            depth = format_quantity(normal.depth, "m", 3)
            spacing = format_quantity(keys.spacing, "m")
            detail = f"contact pressure under a sphere, for indentations up to {depth}; basis "
            detail += f"functions with a spacing of {spacing} near the axis"
        elif normal.power == 1.0:
            stiffness = format_quantity(normal.stiffness, "N/m")
            detail = f"{len(pair.ports)} unilateral springs, {stiffness} each"
        else:
            detail = f"Hertz's law, {normal.stiffness:g} N/m^1.5"
        if keys.groove is not None:
            detail += f" along the axis of a groove of {keys.groove:g} degrees"
        if normal.damping:
            detail += f", Hunt-Crossley damping {keys.damping:g} s/m"
        if normal.friction:
            detail += f", friction coefficient {keys.friction:g}, viscous friction at sliding "
            detail += f"speeds below {normal.creep:g} m/s"
        yield detail
        a, count = pair.lower_surface, len(pair.ports)
        if len(a.ports) > 1:
            why = f"represented by one force per port of {a.part}"
            error = "not estimated; compare with a finer mesh"
            yield NeglectedEffect("pressure between the ports", why, error)
        if part.keys.inertia == "massless":
            yield NeglectedEffect(
                f"inertia of the residual modes at the ports of {part.name}",
                "stiff modes above the band act as springs without mass",
                "included in the error estimate of the reduced model",
            )
        dry = "" if part.keys.friction else "friction, "
        what = f"{dry}adhesion and plastic flow between {a.part} and {pair.upper_surface.part}"
        kind = "damped elastic" if normal.damping else "elastic"
        forces = f"{kind} normal force" + (" and Coulomb friction" if normal.friction else "")
        yield NeglectedEffect(what, f"contact law: {forces} only", "not estimated")
        if count < len(a.ports):
            why = f"{part.name}.rings = {part.keys.rings}"
            error = "none while these ports stay open, checked after the run"
            if part.keys.rings == "needed":
                largest = pair.largest_indentation
                gap, depth = (format_quantity(x, "m", 3) for x in (pair.gaps[count], largest.depth))
                why = f"the gap of {gap} exceeds the estimated approach of {depth} ({largest.why})"
                limit = format_quantity(MAX_RING_MOTION * pair.gaps[count], "m", 3)
                error = (
                    f"none while the approach of {a.part} to {pair.upper_surface.part} at "
                    f"{a.ports[count]} is at most {limit}, checked after the run"
                )
            last = f" to {a.ports[-1]}" if count + 1 < len(a.ports) else ""
            yield NeglectedEffect(f"contact at {a.ports[count]}{last}", why, error)


def _declare_pair(
    pair: ContactPair,
    law: ContactForce,
    under: tuple[float, tuple[float, ...]] | None = None,
    groove: float | None = None,
) -> Declaration:
    """Return the declaration of a contact between both surfaces of ``pair``."""
    ports, rigid = pair.ports, (pair.lower_surface.is_rigid, pair.upper_surface.is_rigid)
    carried, gaps = (
        INDENTATION_PIN if pair.upper_surface.elastic else "",
        (pair.keys.gap,) * len(ports),
    )
    words = {"rigid": rigid, "under": under, "carried": carried, "groove": groove}
    return declare_contact(ports, gaps, law, **words)


def _list_result_factors(pair: ContactPair) -> dict[str, float]:
    """Return factors that convert the sum of port forces to results, keyed by result.

    The results are ``force``, and for a groove also ``flank``, the normal force of one flank.
    """
    return {"force": 1.0} | (
        {} if pair.half_angle_sine is None else {"flank": 1 / (2 * pair.half_angle_sine)}
    )


def _check_pressure_shape(pair: ContactPair) -> Iterator[UsageError]:
    """Check the keys of a contact with ``shape = "pressure"``, and yield each error."""
    part, a, b = pair.part, pair.lower_surface, pair.upper_surface
    hint = DeleteKey("shape")
    if a.compliance is None:
        yield part.wrong(
            "shape",
            'with shape = "pressure", the key `a` must name a piezo_stack, and no port',
            got=f"the port {a.ports[0]} of {a.part}",
            expected='a = "PART", where PART is a part of type piezo_stack',
            hint=hint,
        )
    elif not part.keys.spacing < a.patch / 4:
        yield part.wrong(
            "spacing",
            "the spacing of the pressure basis functions is too large for the contact patch",
            got=f"{part.keys.spacing:g} m",
            expected=f"less than {a.patch / 4:g} m, a quarter of the radius of the patch",
        )
    if b.radius is None or b.radius <= a.patch:
        got = "no sphere" if b.radius is None else f"a sphere with a radius of {b.radius:g} m"
        yield part.wrong(
            "shape",
            'shape = "pressure" needs a sphere that is larger than the contact patch',
            got=got,
            expected=(
                f"a sphere with a radius above {a.patch:g} m, the radius of the contact patch"
            ),
            hint=hint,
        )
    for key, default in (("law", "linear"), ("groove", None)):
        if (got := getattr(part.keys, key)) != default:
            yield part.wrong(
                key,
                f'the key `{key}` cannot be combined with shape = "pressure"',
                got=got,
                hint=f'delete the key `{key}`, or write  shape = "rings"',
            )


# --- checks of the waveforms ----------------------------------------------------------------------


def _find_loaded_interval(force: np.ndarray) -> slice:
    """Return the slice of samples in the first period of contact, with a margin."""
    loaded = np.flatnonzero(force > 1e-2 * force.max(initial=0.0))
    if loaded.size == 0:
        return slice(None)
    gaps = np.flatnonzero(np.diff(loaded) > 200)
    last = loaded[gaps[0]] if gaps.size else loaded[-1]
    return slice(max(int(loaded[0]) - 2, 0), int(last) + 3)


def _balance_energy(
    pair: ContactPair, waves: Waveforms, place: np.ndarray
) -> Iterator[RunEnergyBalance]:
    """Yield the energy balance of the contact springs, which checks a run.

    The balance contains work, stored energy and damping losses. The springs must release all of
    their stored energy. If the springs released more energy than they stored, the rebound would be
    too fast. The error is relative to the work on the springs, or to the stored energy if nothing
    moves.
    """
    normal, ports = pair.contact_force, pair.ports
    heights = [pair.lower_surface.compute_surface_position(port, waves) for port in ports]
    if any(height is None for height in heights):
        return
    closing = np.array(heights) - place  # both arrays have the shape (ports, n)
    force, p = pair.forces(waves), normal.power
    elastic, energy = force, force ** (1 + 1 / p) / ((p + 1) * normal.stiffness ** (1 / p))
    if normal.damping or normal.radius:  # the force may also depend on the velocity
        x = closing - pair.gaps[: len(ports), None]
        elastic, energy = normal.force(x), normal.energy(x)
    resting, gained = float(energy.max()), energy - energy[:, :1]
    missing = (integrate_cumulatively(elastic, closing) - gained).sum(axis=0)
    entries = {"stored in the contact": float(energy[:, -1].sum())}
    if (before := float(energy[:, 0].sum())) > 0.0:
        entries["stored in the contact at the start"] = before
    if normal.damping or normal.pace:
        damped = integrate_cumulatively(force - elastic, closing)[:, -1]
        entries["damped in the contact"] = float(damped.sum())
    v, other = (
        waves.data.get(f"{pair.upper_surface.part}.v"),
        pair.scene.parts.get(pair.upper_surface.part),
    )
    mass = getattr(other.keys, "mass", 0.0) if other else 0.0
    kinetic = 0.0 if v is None else mass * float((v**2).max()) / 2
    scale = max(float(np.abs(np.diff(gained)).sum()), resting, kinetic)
    advice = "the steps are too coarse for the contact: lower solver.reltol or max_step"
    yield RunEnergyBalance(entries, float(np.abs(missing).max()), scale, MAX_ENERGY_ERROR, advice)


def _check_start(pair: ContactPair, waves: Waveforms, place: np.ndarray) -> Iterator[Check]:
    """Yield the check that the sphere rests on the body at the operating point."""
    force, other = waves.data.get(f"{pair.part.name}.force"), pair.upper_surface.part
    if (
        pair.upper_surface.radius is None
        or force is None
        or pair.scene.movers.get(other)
        or pair.excludes_launch_from_rest
    ):
        return
    above = 0.0 if force[0] > 0 else float(place[0]) + pair.keys.gap
    advice = f"the forces on {other} balance above the body: change polarity, remanence or "
    advice += f"position of the magnets, or state {other}.height and velocity at t = 0"
    name, action = f"{other} starts at rest on {pair.lower_surface.part}", pair.scene.checks.start
    label = f"initial gap between {other} and {pair.lower_surface.part}"
    yield Check(name, above, MAX_START_HEIGHT, "m", advice, action, label=label)


def _check_events(pair: ContactPair, waves: Waveforms) -> Iterator[Check]:
    """Yield checks of the penetration, and of the contact events during a drive pulse."""
    n, scene, forces = pair.part.name, pair.scene, pair.forces(waves)
    if pair.upper_surface.radius is not None and pair.gaps.size > 1:
        depth = float(forces.max()) / pair.contact_force.stiffness
        advice = f"the penalty springs are too soft for these surfaces: raise {n}.penalty"
        limit, action = float(pair.gaps[1]), scene.checks.penetration
        label = "contact penetration"
        yield Check("penetration", depth, limit, "m", advice, action, label=label)
    body = scene.parts.get(pair.lower_surface.part)
    drive = getattr(body.keys, "drive", None) if body else None
    if drive is None:
        return
    t, end = waves["time"], drive.start + drive.width + drive.edge
    during = (t >= drive.start) & (t <= end)
    closed = forces[:, during] > 0.0
    most = int(np.count_nonzero(closed[:, 1:] & ~closed[:, :-1], axis=1).max())
    reltol = waves.stats.get("reltol", scene.solver.reltol)
    advice = "the time-step errors of many contact events add up: lower solver.reltol; a launch "
    advice += "velocity after hundreds of contact events may depend strongly on small errors"
    limit, action = max(MIN_EVENTS, MAX_EVENT_RELTOL / reltol), scene.checks.touches
    label = unit = "contact events"
    yield Check("touches", most, limit, unit, advice, action, coarse=True, label=label)


def _check_contact_extent(
    pair: ContactPair, build: BuiltScene, waves: Waveforms, place: np.ndarray
) -> Iterator[Check]:
    """Yield the check that the contact stays within the rings with contact springs.

    The name of the check is *ring_left_out*, or *outer_ring* if all rings have contact springs.

    The check *ring_left_out* requires that the first ring without a contact spring stays open. Ring
    K is the outermost ring that has a contact spring. The displacement of ring K + 1 is not a
    result of the run, but estimated as ``u_K + sum_j S_Kj F_j``. ``u_K`` is the displacement of
    ring K, and ``sum_j S_Kj F_j`` is the indentation of ring K by the recorded forces F_j. The
    estimate neglects the indentation of the omitted ring, because this indentation can only
    increase the distance between ring and sphere. ``S_Kj`` is the static displacement of ring K for
    a force of 1 N at ring j. The static compliance is sufficient, because the delay of the response
    between two rings is negligible. The estimated displacement of the innermost ring that has no
    contact spring was tested against models with contact springs at all rings. In these tests, the
    estimated displacement of ring K + 1 exceeded the computed displacement by 10 to 100 %, or was
    too small by at most 5 % of the gap. If all rings have springs, the check *outer_ring* fails if
    a force acts on the last ring.
    """
    n, a, ports, action = pair.part.name, pair.lower_surface, pair.ports, pair.scene.checks.range
    if pair.upper_surface.radius is None or len(a.ports) < 2:
        return
    force, body = pair.forces(waves), pair.scene.parts[a.part]
    model = build.model(body, LinearModel)
    if len(ports) < len(a.ports) and isinstance(model, LinearModel):
        rows = list(map(model.outputs.index, ports))
        static = model.transfer(np.zeros(1))[0][rows, rows[-1]].real
        rise = waves[f"{a.part}.u.{ports[-1]}"] + static @ force - place
        gap, highest = float(pair.gaps[len(ports)]), float(rise.max())
        advice = f"set {n}.rings to more than {len(ports)}, or to 'all'"
        suggested = {f"{n}.rings": len(ports) + 1} if pair.keys.rings == "needed" else {}
        yield Check(
            "ring_left_out",
            highest,
            MAX_RING_MOTION * gap,
            "m",
            advice,
            action,
            suggested=suggested,
            label=f"approach of {a.part} to {pair.upper_surface.part} at {a.ports[len(ports)]}",
        )
    elif pair.find_prescribed_indentation(waves) is None and any(a.distance):
        label, largest = "contact force on the outermost ring", float(force[-1].max())
        advice = f"{BEYOND_RINGS}: raise {a.part}.mesh.rings"
        check = Check("outer_ring", largest, 0.0, "N", advice, action, label=label)
        yield check if check.passed else _advise_on_outermost_ring(check, pair)


def _advise_on_outermost_ring(check: Check, pair: ContactPair) -> Check:
    """Return the failed check of the outermost ring's force, with advice to the user."""
    a, ball = pair.lower_surface, pair.upper_surface.radius
    if pair.keys.a is not None and pair.keys.a != a.part:
        return replace(check, advice=f'{BEYOND_RINGS}: write  {pair.part.name}.a = "{a.part}"')
    assert ball is not None
    last, depth = a.distance[-1], pair.largest_indentation.depth
    return _advise_rings_or_speed(check, pair, BEYOND_RINGS, last, last**2 / (2 * ball), depth, 1.0)


def _advise_rings_or_speed(
    check: Check,
    pair: ContactPair,
    problem: str,
    radius: float,
    covered_depth: float,
    depth: float,
    ratio: float,
) -> Check:
    """Return a failed check with advice: more rings, or a lower speed or load.

    The rings extend to ``radius`` [m], and cover indentations of up to ``covered_depth`` [m]. This
    depth is proportional to the square of ``radius``. ``depth`` [m] is the largest indentation that
    the rings must cover. ``ratio`` is the radius of the rings divided by the contact radius. If the
    rings cannot cover the indentation, the advice is a lower speed. If even one ring would be too
    large, the advice is a smaller distance between the rings. In Hertz's law, the indentation is
    proportional to ``v^(4/5)`` at the speed v. With the advised number of rings or speed, a run
    passes the check.
    """
    a, largest, ball = pair.lower_surface, pair.largest_indentation, pair.upper_surface.radius
    body, key = pair.scene.parts[a.part].keys, f"{a.part}.mesh.rings"
    lower_load = f"{problem}: lower the load that presses the parts together"
    if ball is None or not isinstance(body, StackKeys):
        return replace(check, advice=lower_load)
    spacing = body.mesh.ring_spacing
    edge = min(body.half_widths)  # distance from the axis to the nearest edge of the surface
    largest_radius = min(edge, ratio * MAX_CONTACT_SHARE * ball) * (1 - EDGE_TOLERANCE)
    required_radius = radius * max(math.sqrt(depth / covered_depth), RING_GROWTH)
    rings = math.ceil(required_radius / spacing)
    most_rings = min(int(largest_radius / spacing), MAX_RINGS)
    if rings <= most_rings:
        return replace(check, advice=f"{problem}: set {key} = {rings}")
    if not largest.speed_key:
        return replace(check, advice=lower_load)
    if not most_rings:
        return replace(check, advice=f"{problem}: lower {a.part}.mesh.ring_spacing")
    speed = largest.speed * (covered_depth / depth * (most_rings * spacing / radius) ** 2) ** 1.25
    digit = 10.0 ** (math.floor(math.log10(speed)) - 1)  # the proposed speed has two digits
    speed = digit * math.floor(speed / digit)
    return replace(
        check,
        advice=f"at this speed, the contact radius is too large for {a.part} or for the contact "
        f'law: write  {largest.speed_key} = "-{speed:g} m/s"  and  {key} = {most_rings}',
        found=f"a speed of {largest.speed:g} m/s, set by {largest.speed_key}",
        accepted=f"a speed of at most {speed:g} m/s",
    )


def _check_depth(pair: ContactPair, waves: Waveforms, place: np.ndarray) -> Iterator[Check]:
    """Yield checks of the indentation of a contact with a pressure basis.

    The contact law is accurate up to a contact radius of half of the patch radius. The contact law
    is inaccurate if the contact radius contains fewer than :data:`FUNCTIONS_PER_RADIUS` basis
    functions of the pressure.
    """
    height = pair.lower_surface.compute_surface_position(pair.lower_surface.ports[0], waves)
    if pair.keys.shape != "pressure" or height is None:
        return
    deepest, checks = float((height - place - pair.keys.gap).max()), pair.scene.checks
    covered = pair.contact_force.depth
    problem = "the contact law is not valid at this indentation depth"
    advice = f"{problem}: raise {pair.lower_surface.part}.mesh.rings"
    check = Check("depth of the contact", deepest, covered, "m", advice, checks.range)
    if not check.passed:
        depth, patch = max(deepest, pair.largest_indentation.depth), pair.lower_surface.patch
        check = _advise_rings_or_speed(check, pair, problem, patch, covered, depth, 2.0)
    yield check
    if deepest > 0.0 and pair.upper_surface.radius is not None:
        widest, spacing = (
            math.sqrt(deepest * pair.upper_surface.radius) / FUNCTIONS_PER_RADIUS,
            pair.keys.spacing,
        )
        advice = (
            f"the contact radius contains fewer than {FUNCTIONS_PER_RADIUS:g} basis functions of "
            "the pressure, so the relative error of the contact force exceeds 0.5 %: lower "
        )
        advice += f"{pair.part.name}.spacing"
        yield Check("basis of the pressure", spacing, widest, "m", advice, checks.penetration)


register_part_type(Contact())
