"""The part ``ring_magnet_coils``: actuator that catches a magnetic sphere.

The actuator consists of a ring magnet and two coils on a common axis. The sphere moves along the
axis. Source: sections 2.2.1 and 2.4 of Schütz, Maeter and Bechtold, Actuators 10 (2021) 279. The
force on the sphere is a polynomial of both coil currents. The six coefficients of the force
polynomial are tabulated functions of the height of the sphere. With an ideal current drive, the
coils are modelled as resistors. With any other drive, the coils also have inductance and back-EMF.
:mod:`kc2spice.physics.coils` contains the declarations.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.cache import load_or_build
from kc2spice.core.domains import AMBIENT, BASE, DISPLACEMENT, HEAT, TRANSLATION
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Curve, Figure, FileWriter, Panel, Shape
from kc2spice.core.key_actions import ChangeKey
from kc2spice.core.magnets import (
    CURRENT_EXPONENTS,
    FORCE_COEFFICIENTS,
    MagnetostaticTable,
    interpolate_by_splines,
)
from kc2spice.core.mesh_error_descriptions import (
    PLANE_UNKNOWN_RATIO,
    describe_mesh_errors,
    list_mesh_errors,
)
from kc2spice.core.progress import StageTimer
from kc2spice.core.quantities import MU_0, si
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.magnet_keys import CatchKeys, RingKeys
from kc2spice.netlist.circuit import Pin, make_positive_parameter
from kc2spice.netlist.number_and_name_spelling import format_voltage
from kc2spice.netlist.subcircuit_library import Header, Subcircuit
from kc2spice.parts.bodies._body_figures import plot_impedances
from kc2spice.parts.control._pid_keys import PidKeys
from kc2spice.parts.electronics.netlist import make_driver_table
from kc2spice.parts.magnetics import _coil_heat
from kc2spice.parts.mechanics._contact_surfaces import (
    LargestIndentation,
    TouchablePart,
    estimate_impact_indentation,
)
from kc2spice.parts.mechanics.sphere import find_height_offset, find_sphere
from kc2spice.physics import coils
from kc2spice.physics.conductors import (
    HEAT_TERMINALS,
    OPTIONAL_HEAT_PINS,
    ConductorKeys,
    is_heated,
    list_useless_key_errors,
)
from kc2spice.physics.declaration import HEAT_BRANCH, ONE_TEMPERATURE, TEMPERATURE
from kc2spice.physics.part import get_across_vector, get_flow_vector, make_declared_subcircuit
from kc2spice.scene.checks import Check, Gate, Metric, RunEnergyBalance
from kc2spice.scene.part_records import EquilibriumConditions, NeglectedEffect, PartResult
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.plausibility import check_range
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
from kc2spice.synthesis.library_headers import SIGN_TEXT

# conductivity [S/m] of the magnetic sphere, from table A1 of Schütz et al. (2021)
MAGNET_CONDUCTIVITY = 150e3

COLD_TEXT = "coils at the temperature for which their resistances are given, without self-heating"
HOT_TEXT = "resistances linear in the temperature, which is the same for both coils"
UNRATED = "not known; compare the coil currents with the current rating of the wire"
# Current [A] in plots and checks of the force if no current limit is stated.
DEFAULT_CURRENT = 0.1
# number of mesh cells along each edge in the model of ``verify``, divided by their number in the
# netlist's model
REFINEMENT_RATIO = 2
# Number of height intervals in the force table of ``verify``, divided by their number in the force
# table of the netlist.
DENSITY_RATIO = 4
LOOKUP_POINTS = 201  # number of points of a lookup, for an error of 6e-6 of the largest force
# Largest permitted error of the force spline between the heights of the force table, divided by the
# largest force.
MAX_SPLINE_ERROR = 1e-2
# Suggested launch velocity, divided by the velocity at which the sphere just reaches the lowest or
# highest height of the force table.
KICK_MARGIN = 0.85
COPPER_HEAT_CAPACITY = 3.45e6  # J/(m3 K), 385 J/(kg K) times 8960 kg/m3
COIL_NAMES = ("lower", "upper")
TABLE_SOURCES = ("kc2spice.linalg", "kc2spice.fem", "kc2spice.core.gmsh_session", __name__)


class RingMagnetCoilsKeys(ConductorKeys, CatchKeys):
    """Keys of a ring magnet with two coils that catch a sphere, and of their driver."""

    driver: dict[str, dict[str, Any]] | None = Field(
        None,
        description=(
            "Driver circuit between the controller and the coils: a table { TYPE = { keys } "
            "}, where TYPE is the part type of a driver"
        ),
    )
    of: str | None = Field(
        None,
        description=(
            "Name of the sphere that the coils pull; by default the only sphere of the scene"
        ),
    )
    rated_rise: Annotated[float, si("K")] = Field(
        100.0,
        gt=0,
        description=(
            "Largest permitted temperature rise of the coil wire; the default is the rise "
            "from 30 to 130 degrees Celsius for wire of thermal class 130"
        ),
    )


# In the control loop, a single current i flows through both coils in opposite senses: i2 = i and
# i1 = -i.
# The force is then a polynomial of the current i.
# The weights convert the coefficients of the force table to the coefficients of this polynomial.
SERIES_COEFFICIENTS = {
    name: tuple((-1) ** a * (a + b == power) for a, b in CURRENT_EXPONENTS.values())
    for power, name in enumerate(("c0", "d1", "d2"))
}

POSITION_PINS = (
    Terminal.signal("y", DISPLACEMENT),
    Terminal.make_rate_pin("v", TRANSLATION),
    Terminal.from_domain(BASE, TRANSLATION, GROUND),
)
COIL_PINS = ("lp", "ln", "up", "un")  # pins of the lower and the upper coil
ALL_PINS = (*(Terminal(end, "V", "A") for end in COIL_PINS), *POSITION_PINS)
SERIES_PINS = (Terminal("drive", "V", "A"), Terminal("ret", "V", "A"), *POSITION_PINS)


def compute_i2t_rating(keys: RingMagnetCoilsKeys) -> float:
    """Compute the I^2 t rating of a coil: permitted time integral of i^2 [A^2 s].

    A current pulse with the permitted integral of i^2 heats the wire by the rated temperature rise.
    Without cooling, the integral is ``rise c A^2 / resistivity`` for any number of turns. c is the
    volumetric heat capacity, and A is the cross-section of the wire.
    """
    section = np.pi / 4 * keys.wire_diameter**2
    return float(keys.rated_rise * COPPER_HEAT_CAPACITY * section**2 / keys.resistivity)


def _compute_force_contributions(values: np.ndarray, current: float) -> np.ndarray:
    """Return the force contributions [N] of the powers 0, 1 and 2 of the current.

    The returned array has the shape (3, heights), with a row for each of
    :data:`SERIES_COEFFICIENTS`. ``current`` [A] flows through both coils in
    series. ``values`` contains the coefficients of the force table, an array of shape (heights, 6).
    """
    weights = np.array(list(SERIES_COEFFICIENTS.values()), dtype=float)
    return current ** np.arange(3)[:, None] * (weights @ values.T)


def make_coils_subcircuit(
    header: Header,
    table: MagnetostaticTable,
    name: str = "coil",
    *,
    apart: bool = True,
    points: int = LOOKUP_POINTS,
    rating: str = UNRATED,
    wire: tuple[float, float] | None = None,
) -> Subcircuit:
    """Return the subcircuit of the coils.

    The magnetic force acts on the node ``v`` of the sphere. If ``apart`` is true, each coil has its
    own pins, a resistance, an inductance and a back-EMF. The lower coil is between ``lp`` and
    ``ln``, and the upper coil is between ``up`` and ``un``. If ``apart`` is false, the coils are
    resistors in series between ``drive`` and ``ret``, and the current in the lower coil is
    reversed. The force of coils in series needs only three functions of the height instead of six.
    :func:`kc2spice.physics.coils.declare_coils` defines the pins and equations.

    ``points`` is the number of equally spaced heights in the lookups. ``wire`` contains the
    temperature coefficient [1/K] and the reference temperature [K] of the wire. Without ``wire``,
    there are no heat pins.
    """
    declared = coils.declare_coils("y") if apart else coils.declare_resistive_coils("y")
    low, high = DISPLACEMENT.pin_value_per_si_unit * table.y[[0, -1]]
    errors = describe_mesh_errors(table.mesh_errors)
    stated = replace(
        declared,
        given=tuple(
            make_positive_parameter(
                f"resistance_{coil}", float(ohm), "Ohm", f"resistance of the {coil} coil"
            )
            for coil, ohm in zip(COIL_NAMES, table.resistance, strict=True)
        ),
        validity=f"sphere's centre from {low:g} to {high:g} {DISPLACEMENT.pin_unit}, "
        f"constant forces beyond; linear magnetics; {COLD_TEXT if wire is None else HOT_TEXT}",
        rating=rating,
        sign=SIGN_TEXT,
        mesh=f"error estimate of the field: {errors}" if errors else "",
    )
    ends = ALL_PINS if apart else SERIES_PINS
    if wire is not None:
        stated, ends = coils.add_heat_pin(stated, *wire), (*ends, *HEAT_TERMINALS)
    pins = tuple(Pin(end.name, end.unit, end.flow) for end in ends)
    tables = coils.tabulate_coenergy(table, points)
    return make_declared_subcircuit(header, name, stated, {}, tables=tables, pins=pins)


class RingMagnetCoils(TouchablePart[RingMagnetCoilsKeys]):
    """Part type ``ring_magnet_coils``: ring magnet and two coils around a sphere.

    The coils and the ring magnet pull the magnetic sphere.
    """

    name = "ring_magnet_coils"
    title = "ring magnet and two coils that pull a magnetic sphere (axisymmetric FE, force table)"
    schema = RingMagnetCoilsKeys
    source = "FE (magnetostatic, axisymmetric)"
    discretisations = ("positions", "refine")
    optional_pins: ClassVar[Mapping[str, str]] = OPTIONAL_HEAT_PINS

    def generate_tables(
        self, part: Part[RingMagnetCoilsKeys], data: Mapping[str, object]
    ) -> Mapping[str, Mapping[str, object]]:
        """Generate the scene table of the driver that the key ``driver`` describes.

        If the part has no key ``driver``, the returned mapping is empty.
        """
        if part.keys.driver is None:
            return {}
        known = {"linear": "linear_drive", "pwm": "pwm_drive", "user": "netlist"}
        pins = {"drive": f"{part.name}.up", "ret": f"{part.name}.lp"}
        table = make_driver_table(part, part.keys.driver or {}, known, data)
        return {f"{part.name}_driver": {**table, "pins": pins}}

    def pins(self, part: Part[RingMagnetCoilsKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        thermal = HEAT_TERMINALS if is_heated(part, scene) else ()
        if not has_drive_circuit(part, scene):
            rest = None if _is_connected(part, scene) else "gnd"
            return (
                *(replace(end, default=rest) for end in SERIES_PINS[:2]),
                *POSITION_PINS,
                *thermal,
            )
        ends = (
            replace(pin, default=f"{part.name}.un") if pin.name == "ln" else pin for pin in ALL_PINS
        )
        return (*ends, *thermal)

    def equilibrium_conditions(
        self, part: Part[RingMagnetCoilsKeys], scene: WiredScene
    ) -> EquilibriumConditions:
        """Return the equilibrium conditions: pin pairs with a possible constant force.

        Pairs with the pin ``heat`` are removed, because the part does not connect ``heat`` to
        ground. The result contains no pairs with electrical pins. An operating point exists only if
        displacement, temperature and pressure pins have a path to ground; electrical pins need no
        path to ground.
        """
        clamps = super().equilibrium_conditions(part, scene).paths
        return EquilibriumConditions(tuple(path for path in clamps if HEAT not in path))

    def default_joins(
        self, part: Part[RingMagnetCoilsKeys], scene: GovernedScene
    ) -> Mapping[str, str]:
        """Return the default connections of the pins ``y`` and ``v`` to the sphere.

        If another part prescribes the motion of the sphere, ``y`` and ``v`` are connected to that
        other part.
        """
        ball = find_sphere(part, scene).name
        ball = scene.movers.get(ball) or ball
        return {"y": f"{ball}.y", "v": f"{ball}.v"}

    def problems(
        self, part: Part[RingMagnetCoilsKeys], scene: GovernedScene
    ) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from list_useless_key_errors(part, scene)
        keys, name, ball = part.keys, part.name, find_sphere(part, scene)
        radius = ball.keys.radius
        if keys.y_min >= keys.y_max:
            yield part.wrong(
                "y_min",
                "the range of positions is empty",
                got=f"{keys.y_min:g} … {keys.y_max:g} m",
                expected="y_min < y_max",
                hint="exchange y_min and y_max",
            )
        bodies: dict[str, RingKeys] = {item: getattr(keys, item) for item in ("ring", *COIL_NAMES)}
        for body_name, body in bodies.items():
            # Each rule: problem, key, whether the value is valid, limit as text, limit in metres.
            rules = (
                ("inner is not smaller than outer", "inner", body.inner < body.outer,
                 "less than outer", body.outer),
                ("the sphere does not fit through the body", "inner", body.inner > radius,
                 f"more than {ball.name}.radius", radius),
                ("the body reaches beyond the modelled air", "height",
                 body.height < keys.air_height,
                 f"less than {part.name}.air_height", keys.air_height),
                ("the body reaches beyond the modelled air", "outer", body.outer < keys.air_radius,
                 f"less than {part.name}.air_radius", keys.air_radius),
            )  # fmt: skip
            for problem, key, right, limit_text, limit in rules:
                if not right:
                    yield part.wrong(
                        f"{body_name}.{key}",
                        problem,
                        got=f"{getattr(body, key):g} m",
                        expected=f"{limit_text}, {limit:g} m",
                    )
        for (body_name, body), (other_name, other) in combinations(bodies.items(), 2):
            radial = body.inner < other.outer and other.inner < body.outer
            if radial and 2 * abs(body.y - other.y) < body.height + other.height:
                yield part.wrong(
                    other_name,
                    f"this body overlaps {name}.{body_name}",
                    hint=f"move {other_name}.y by at least {_compute_overlap(body, other):g} m",
                )
        resting = scene.analysis.type == "transient" and bool(scene.list_parts("contact"))
        if resting and not keys.y_min < radius < keys.y_max:
            yield ball.wrong(
                "radius",
                "the centre of the resting sphere is outside of the height range of the force "
                "table",
                got=f"a radius of {radius:g} m, which is the height of the centre",
                expected=f"a radius between {keys.y_min:g} and {keys.y_max:g} m",
                hint=(
                    ChangeKey("lower", f"{part.name}.y_min", "below", f"{radius:g} m")
                    if radius <= keys.y_min
                    else ChangeKey("raise", f"{part.name}.y_max", "above", f"{radius:g} m")
                ),
            )
        copper = keys.turns * np.pi / 4 * keys.wire_diameter**2
        for coil in COIL_NAMES:
            body = getattr(keys, coil)
            fill = float(copper / (body.height * (body.outer - body.inner)))
            why = f"{keys.turns} turns of {keys.wire_diameter:g} m wire do not fit into "
            why += f"{name}.{coil}"
            yield from check_range(f"{name}.turns", fill, "of its section", 0.0, 1.01, why)
        magnet = "no permanent magnet has a larger remanence"
        yield from check_range(f"{name}.remanence", keys.remanence, "T", 0.0, 1.6, magnet)
        long = "the field decreases with the cube of the distance, and the force even faster"
        yield from check_range(f"{name}.air_radius", keys.air_radius, "m", 1e-4, 1.0, long)

    def largest_indentations(
        self, part: Part[RingMagnetCoilsKeys], scene: GovernedScene
    ) -> Iterator[LargestIndentation]:
        """Yield the largest indentation by a sphere that falls from the height ``y_max``."""
        sphere = find_sphere(part, scene)
        drop = 2 * scene.gravity * (part.keys.y_max - sphere.keys.radius)
        speed = math.sqrt(max(0.0, drop))
        why, mass = f"fall from {part.name}.y_max", sphere.keys.mass
        yield from estimate_impact_indentation(sphere, mass, scene, speed, why)

    def outline(self, part: Part[RingMagnetCoilsKeys], scene: Scene) -> Iterator[Shape]:
        """Yield the side view of the magnet and the coils."""
        keys = part.keys
        coils, magnet = f"coil, {keys.turns} turns", f"ring magnet, {keys.remanence:g} T"
        rows: tuple[tuple[Literal["magnet", "coil"], RingKeys, str], ...] = (
            ("magnet", keys.ring, magnet),
            ("coil", keys.lower, coils),
            ("coil", keys.upper, coils),
        )
        for kind, ring, text in rows:
            for side in (-1, 1):
                label = f"{part.name}: {text}" if side > 0 else ""
                x, wide = side * (ring.inner + ring.outer) / 2, ring.outer - ring.inner
                yield Shape(x, ring.y + keys.shift, wide, ring.height, kind, label)

    def _make_unit_remanence_keys(self, part: Part[RingMagnetCoilsKeys], count: int) -> CatchKeys:
        """Return the keys of a force table with ``count`` heights and a remanence of 1 T."""
        alone = {"remanence": 1.0, "shift": 0.0, "points": LOOKUP_POINTS, "positions": count}
        return CatchKeys(
            **{name: getattr(part.keys, name) for name in CatchKeys.model_fields} | alone
        )

    def model_key(self, part: Part[RingMagnetCoilsKeys], scene: Scene) -> Mapping[str, Any]:
        """Return the cache key of the force table: actuator keys and radius of the sphere."""
        catch = self._make_unit_remanence_keys(part, part.keys.positions).model_dump(mode="json")
        return {"catch": catch, "radius": find_sphere(part, scene).keys.radius}

    def build(
        self, part: Part[RingMagnetCoilsKeys], scene: Scene, clock: StageTimer, full: bool = False
    ) -> MagnetostaticTable:
        """Build or load the table of the magnetic force on the sphere.

        The table is computed for unit remanence. Scaling by the remanence and shifting by the key
        ``shift`` are exact. A ``full`` table has more heights, so that the interpolation error of
        its splines is ``DENSITY_RATIO**4`` times smaller. The air box of the mesh moves with the
        ring magnet.
        """
        keys, count = part.keys, (DENSITY_RATIO if full else 1) * (part.keys.positions - 1) + 1
        unit = self._make_unit_remanence_keys(part, count)
        key = {**self.model_key(part, scene), "positions": count}

        def build() -> MagnetostaticTable:
            """Compute the force table for a remanence of 1 T."""
            from kc2spice.fem.magnet_field import compute_magnetostatic_table

            with clock.time_stage("magnetics", "field of the catch actuator") as share:
                return compute_magnetostatic_table(unit, key["radius"], share)

        table = load_or_build(
            "catch", key, build, classes=(MagnetostaticTable,), sources=TABLE_SOURCES
        )
        return table.scale_magnets(keys.remanence, keys.shift)

    def subcircuit_name(self, part: Part[RingMagnetCoilsKeys], scene: Scene) -> str:
        """Return the name of the subcircuit, such as ``coil`` or ``heated_coil``.

        The subcircuit of a part ``catch`` with separate coil terminals is ``coil``. All other
        subcircuits have the name of the part. If the pin ``heat`` is connected, the name begins
        with ``heated_``.
        """
        coil = _has_coil_terminals(part, scene) and part.name == "catch"
        name = "coil" if coil else part.name
        return f"heated_{name}" if is_heated(part, scene) else name

    def subcircuits(
        self, part: Part[RingMagnetCoilsKeys], build: BuiltScene, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return the subcircuit of the part, as a tuple of length 1."""
        keys, name, apart = (
            part.keys,
            build.libraries[part.name],
            _has_coil_terminals(part, build.scene),
        )
        rating = f"{compute_i2t_rating(keys):.3g} A^2 s in each coil, the integral of i^2 that "
        rating += f"heats the copper by {keys.rated_rise:g} K without cooling; permitted steady "
        rating += "current not known, because it depends on the cooling"
        words: dict[str, Any] = {"apart": apart, "points": keys.points, "rating": rating}
        if is_heated(part, build.scene):
            words["wire"] = _coil_heat.get_wire_coefficients(keys)
        return (
            make_coils_subcircuit(header, build.model(part, MagnetostaticTable), name, **words),
        )

    def vectors(
        self, part: Part[RingMagnetCoilsKeys], build: BuiltScene
    ) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        if not _is_connected(part, build.scene):
            return {}
        prefix, inst = get_result_prefix(part), f"x{part.name.lower()}"
        result = {
            f"{prefix}.lower.current": PartResult(f"v({inst}.i)", -1.0, "A"),
            f"{prefix}.upper.current": PartResult(f"v({inst}.i)", 1.0, "A"),
        }
        if has_drive_circuit(part, build.scene):
            for k, name in enumerate(result, 1):
                result[name] = PartResult(f"v({inst}.i{k})", 1.0, "A")
            up, lp = build.get_net(part, "up"), build.get_net(part, "lp")
            across = format_voltage(up, lp) or "v(0)"
            result[f"{prefix}.voltage"] = PartResult(across, 1.0, "V")
        if is_heated(part, build.scene):
            result[f"{prefix}.{TEMPERATURE}"] = get_across_vector(build, part, HEAT_BRANCH)
            result[f"{prefix}.{HEAT}"] = get_flow_vector(build, part, HEAT_BRANCH)
        return result

    def forces(
        self, part: Part[RingMagnetCoilsKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, np.ndarray]:
        """Return the magnetic force on the sphere at the recorded heights and currents."""
        y = waves.data.get(f"{find_sphere(part, build.scene).name}.y")
        if y is None or compute_distance_outside(build.model(part, MagnetostaticTable), y) > 0:
            return {}
        zero = np.zeros_like(y)
        lower = waves.data.get(f"{get_result_prefix(part)}.lower.current", zero)
        upper = waves.data.get(f"{get_result_prefix(part)}.upper.current", zero)
        return {
            "v": np.asarray(build.model(part, MagnetostaticTable).coenergy.force(y, lower, upper))
        }

    def law(self, part: Part[RingMagnetCoilsKeys], build: BuiltScene) -> laws.Equations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice."""
        n, scene, table = part.name, build.scene, build.model(part, MagnetostaticTable)
        prefix, apart = get_result_prefix(part), has_drive_circuit(part, scene)
        stated, ends = (
            coils.declare_resistive_coils(),
            (("drive.through", -1.0), ("drive.through", 1.0)),
        )
        if apart:
            stated, ends = coils.declare_coils(), (("i1", 1.0), ("i2", 1.0))
        heated = is_heated(part, scene)
        if heated:
            stated = coils.add_heat_pin(stated, *_coil_heat.get_wire_coefficients(part.keys))
        law = coils.make_law(n, stated, table, find_height_offset(part, "y", scene))
        results = {}
        for coil, (wave, sign) in zip(COIL_NAMES, ends, strict=True):
            results[f"{prefix}.{coil}.current"] = laws.scale_wave(f"{n}.{wave}", sign)
        if apart:
            results[f"{prefix}.voltage"] = laws.subtract_waves(f"{n}.up", f"{n}.lp")
        if heated:
            pins = f"{n}.{HEAT}", f"{n}.{AMBIENT}"
            results[f"{prefix}.{TEMPERATURE}"] = laws.subtract_waves(*pins)
            results[f"{prefix}.{HEAT}"] = laws.scale_wave(f"{n}.{HEAT}.through")
        return laws.Equations((law,), law.pin_pairs, results)

    def metrics(
        self, part: Part[RingMagnetCoilsKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics of the part, keyed by name."""
        result = _coil_heat.compute_heat_metrics(part.keys, get_result_prefix(part), waves)
        if f"{get_result_prefix(part)}.voltage" not in waves:
            return result
        current = waves[f"{get_result_prefix(part)}.upper.current"]
        voltage = float(np.abs(waves[f"{get_result_prefix(part)}.voltage"]).max())
        return result | {
            "coil_voltage_peak_v": Metric(voltage, "V"),
            "coil_current_peak_a": Metric(float(np.abs(current).max()), "A"),
        }

    def compare_with_finer_mesh(
        self, part: Part[RingMagnetCoilsKeys], build: BuiltScene, clock: StageTimer, most: float
    ) -> Iterator[Check | str]:
        """Yield the errors of force and inductance, relative to a finer mesh.

        The mesh cells of the finer mesh have half the size.
        """
        from kc2spice.fem.magnet_field import (
            choose_compared_height_count,
            compute_magnetostatic_table,
        )

        table, keys = build.model(part, MagnetostaticTable), part.keys
        unknowns = REFINEMENT_RATIO**2 * table.facts["unknowns"]
        if unknowns > PLANE_UNKNOWN_RATIO * most:
            cause = f"{unknowns:.0f} unknowns, more than {PLANE_UNKNOWN_RATIO * most:.0f}"
            mesh = self.describe_discretisation(part, build)
            yield f"{part.name}: no mesh with half the element size ({cause}); {mesh}"
            return
        settings = {
            "positions": choose_compared_height_count(keys.positions),
            "refine": REFINEMENT_RATIO * keys.refine,
        }
        unit = self._make_unit_remanence_keys(part, settings["positions"]).model_copy(
            update=settings
        )
        key = {**self.model_key(part, build.scene), "finer": settings}

        def compute_finer_table() -> MagnetostaticTable:
            """Compute the force table on a mesh with cells of half the size."""
            words = f"{part.name}: mesh with half the element size"
            with clock.time_stage("full model", words) as share:
                return compute_magnetostatic_table(unit, key["radius"], share)

        fine = load_or_build(
            "catch", key, compute_finer_table, classes=(MagnetostaticTable,), sources=TABLE_SOURCES
        )
        fine = fine.scale_magnets(keys.remanence, keys.shift)
        step = (table.y.size - 1) // (fine.y.size - 1)
        current = find_largest_current(part, build.scene) or DEFAULT_CURRENT
        pull = _compute_force_contributions(fine.coefficients, current)
        change = _compute_force_contributions(table.coefficients[::step], current) - pull
        errors = {
            "force": np.abs(change).sum(axis=0).max() / np.abs(pull).sum(axis=0).max(),
            "inductance": np.abs(table.inductance[::step] - fine.inductance).max()
            / np.abs(fine.inductance).max(),
        }
        for quantity, error in errors.items():
            yield Check(
                f"mesh of {part.name} with half the element size, {quantity}",
                float(error),
                MAX_SPLINE_ERROR,
                "relative",
                label=f"mesh of {part.name}: relative error of the {quantity}, versus half the "
                "element size",
            )

    def checks(
        self, part: Part[RingMagnetCoilsKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check | RunEnergyBalance | Gate]:
        """Yield the checks of the part after a run."""
        y = waves.data.get(f"{find_sphere(part, build.scene).name}.y")
        if y is None or "time" not in waves:
            return
        currents = _list_coil_currents(part, waves)
        if is_heated(part, build.scene):
            table, prefix = build.model(part, MagnetostaticTable), get_result_prefix(part)
            resistance = dict(zip(COIL_NAMES, table.resistance.tolist(), strict=True))
            yield from _coil_heat.check_heat_balance(part.keys, prefix, resistance, currents, waves)
            rise = part.keys.rated_rise
            yield from _coil_heat.check_temperature(part.name, prefix, rise, waves)
        elif currents:
            squares = np.square(list(currents.values()))
            heating = float(np.trapezoid(squares, waves["time"]).max())
            advice = "the coils overheat: use less current, or a thicker or shorter wire"
            limit = compute_i2t_rating(part.keys)
            name, label = f"rating of {part.name}", f"coil heating of {part.name}, I²t"
            yield Check(name, heating, limit, "A2 s", advice, "warn", label=label)
        coarse = compute_spline_error(
            build.model(part, MagnetostaticTable), find_largest_current(part, build.scene)
        )
        name = f"interpolation error of the force table of {part.name}"
        action = build.scene.checks.range
        advice = f"too few positions in the force table: raise {part.name}.positions"
        yield Check(
            name,
            coarse,
            MAX_SPLINE_ERROR,
            "of the largest force",
            advice,
            action,
            discretisation=True,
            label=f"interpolation error, force of {part.name}",
        )
        ball, limits = find_sphere(part, build.scene).name, {"rom_vs_fom": MAX_SPLINE_ERROR}
        words = f"height of {ball} relative to its travel, with {DENSITY_RATIO} times as many "
        words += f"{part.name}.positions"
        yield Gate(words, f"{ball}.y", limits, "travel", discretisation=True)
        for words, error in list_mesh_errors(build.get_model_values(part)).items():
            if error > MAX_SPLINE_ERROR:
                yield Check(
                    f"mesh of {part.name}, {words}",
                    error,
                    MAX_SPLINE_ERROR,
                    "relative, estimated",
                    f"raise {part.name}.refine",
                    "warn",
                    label=f"mesh error of {part.name}, {words}",
                )
        table, travel = build.model(part, MagnetostaticTable), float(np.ptp(y))
        remedy = f"lower {part.name}.y_min to {_suggest_table_end(y.min())}"
        if y.max() - table.y[-1] >= table.y[0] - y.min():
            remedy = f"raise {part.name}.y_max to {_suggest_table_end(y.max())}"
        from kc2spice.fem.magnet_field import get_air_section

        _, floor, _, ceiling = get_air_section(part.keys)
        if y.max() > ceiling or y.min() < floor:
            remedy = _advise_less_energy(build.scene, y, table)
        advice = f"the sphere moved outside the height range of the force table: {remedy}"
        distance = float(min(abs(y.min() - table.y[0]), abs(table.y[-1] - y.max())))
        check = Check("table_left", compute_distance_outside(table, y), 0.0, "m", advice, action)
        yield replace(
            check,
            distance=distance,
            travel=travel,
            found=f"heights from {_format_height(y.min())} to {_format_height(y.max())}",
            accepted=f"heights from {_format_height(table.y[0])} to {_format_height(table.y[-1])}, "
            "the range of the table",
            label="height outside the force table",
            undecided_label="height error near an end of the table",
        )

    def figures(
        self, part: Part[RingMagnetCoilsKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Figure | FileWriter]:
        """Yield the figures of the part, and the writers of its additional output files."""
        prefix = get_result_prefix(part)
        currents = _list_coil_currents(part, waves)
        if "time" in waves and len(currents) == len(COIL_NAMES):
            t = 1e3 * waves["time"]
            curves = [Curve(f"{coil} coil", t, 1e3 * i) for coil, i in currents.items()]
            if f"{prefix}.wanted" in waves:
                curves.append(Curve("wanted", t, 1e3 * waves[f"{prefix}.wanted"], ":"))
            panels = [Panel("", "coil current in mA", tuple(curves))]
            if f"{prefix}.voltage" in waves:
                volts = Curve("", t, waves[f"{prefix}.voltage"])
                panels.append(Panel("", "both coils in V", (volts,)))
            panels[-1] = replace(panels[-1], x="time in ms")
            caption = f"Currents in the coils of {part.name}."
            yield Figure(f"{part.name}_currents", "Coil currents", caption, tuple(panels))
        if has_drive_circuit(part, build.scene):
            yield plot_impedance(part, build)
        yield plot_force(part, build)
        table, alone = (
            build.model(part, MagnetostaticTable),
            len(build.scene.list_parts(self.name)) == 1,
        )
        arrays = {"y": table.y} | dict(zip(FORCE_COEFFICIENTS, table.coefficients.T, strict=True))
        file = "em_table.npz" if alone else f"{part.name}_table.npz"
        yield FileWriter(file, lambda path: np.savez_compressed(path, **arrays))

    def notes(
        self, part: Part[RingMagnetCoilsKeys], scene: Scene
    ) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        count = part.keys.positions
        yield f"force table with {count} heights, force quadratic in both coil currents (exact)"
        if has_drive_circuit(part, scene):
            yield "coils with R, L(y), M(y) and back-EMF"
        keys, radius = part.keys, find_sphere(part, scene).keys.radius
        diffusion = MU_0 * keys.mu_r * MAGNET_CONDUCTIVITY * (radius / np.pi) ** 2
        yield NeglectedEffect(
            "eddy currents in the sphere",
            f"the sphere is a poor conductor, {format_quantity(MAGNET_CONDUCTIVITY, 'S/m')}",
            f"force lags by about {format_quantity(diffusion, 's', 2)}",
        )
        yield NeglectedEffect(
            "the field beyond the air box",
            f"no magnetic field beyond the radius {format_quantity(keys.air_radius, 'm')}",
            f"not estimated; repeat the run with twice the values of {part.name}.air_radius and "
            f"{part.name}.air_height, and compare",
        )
        heated = is_heated(part, scene)
        if heated:
            _, why, size = ONE_TEMPERATURE
            yield NeglectedEffect("different temperatures of the two coils", why, size)
        if _is_connected(part, scene) and not has_drive_circuit(part, scene):
            yield NeglectedEffect(
                "coil voltage and inductance"
                if heated
                else "coil voltage, inductance and self-heating",
                "an ideal current source feeds the coils",
                "not estimated; a current step of "
                f"{format_quantity(find_largest_current(part, scene), 'A')} needs the voltage "
                f"L di/dt; for L and R see model.{part.name} in result.json",
            )


def plot_force(part: Part[RingMagnetCoilsKeys], build: BuiltScene) -> Figure:
    """Plot the force on the sphere versus its height.

    The curves are for no current, equal currents and opposite currents in the coils.
    """
    table = build.model(part, MagnetostaticTable)
    limit = find_largest_current(part, build.scene) or DEFAULT_CURRENT
    fine = np.linspace(table.y[0], table.y[-1], 401)
    curves = []
    for lower, upper in ((0.0, 0.0), (limit, limit), (limit, -limit), (-limit, limit)):
        force = table.coenergy.force(fine, lower, upper)
        label = f"{1e3 * lower:+.3g} / {1e3 * upper:+.3g}"
        curves.append(Curve(label, 1e3 * fine, 1e3 * force))
    panel = Panel("height of the sphere's centre in mm", "force on the sphere in mN", tuple(curves))
    caption = "Vertical force on the sphere, for the currents in mA in the lower / upper coil."
    return Figure(f"{part.name}_force", "Force map", caption, (panel,))


def plot_impedance(part: Part[RingMagnetCoilsKeys], build: BuiltScene) -> Figure:
    """Plot the impedance ``R + j w L`` of each coil, and of both coils in series.

    In the series connection, the current flows around the two coils in opposite directions.
    """
    table = build.model(part, MagnetostaticTable)
    matrix = table.coenergy.compute_inductances(0.5 * (table.y[0] + table.y[-1]))
    currents = {"lower": (1.0, 0.0), "upper": (0.0, 1.0), "both": (1.0, -1.0)}
    f, z = np.geomspace(10.0, 1e5, 201), dict[str, np.ndarray]()
    for name, pair in currents.items():
        i = np.array(pair)
        z[name] = i**2 @ table.resistance + 2j * np.pi * f * (i @ matrix @ i)
    how = f"of the impedance of the coils of {part.name}, with the sphere clamped in the middle of "
    how += "the height range of the force table. The capacitance of the windings is neglected."
    return plot_impedances(part.name, f, z, how)


def get_result_prefix(part: Part[RingMagnetCoilsKeys]) -> str:
    """Return the prefix of the part's result names.

    The prefix is ``coil`` for a part with the name ``catch``, otherwise the name of the part.
    """
    return "coil" if part.name == "catch" else part.name


def has_drive_circuit(part: Part[RingMagnetCoilsKeys], scene: DeclaredScene) -> bool:
    """Return whether a drive circuit is connected to the coils.

    Coils with a drive circuit have inductance and back-EMF in the model.
    """
    joined = any(scene.is_target(part.name, pin) or pin in part.pins for pin in COIL_PINS)
    return bool(part.keys.driver) or joined


def _has_coil_terminals(part: Part[RingMagnetCoilsKeys], scene: DeclaredScene) -> bool:
    """Return whether the netlist of the part has separate terminals for both coils."""
    return has_drive_circuit(part, scene) or bool(scene.list_parts("current_cases"))


def _suggest_table_end(height: float) -> str:
    """Suggest a force-table end such as ``12 mm``, at least 5 % beyond ``height`` [m]."""
    return f"{math.ceil(abs(1.05e3 * height)) * (1 if height > 0 else -1)} mm"


def _compute_overlap(a: RingKeys, b: RingKeys) -> float:
    """Return the axial length [m] along which two rings overlap."""
    return (a.height + b.height) / 2 - abs(a.y - b.y)


def _format_height(height: float) -> str:
    """Return a height [m] as a string in mm with four significant digits."""
    return f"{1e3 * height:.4g} mm"


def _advise_less_energy(scene: Scene, y: np.ndarray, table: MagnetostaticTable) -> str:
    """Advise a lower launch energy if a sphere leaves the force table's height range.

    ``y`` contains the heights [m] of the sphere.

    The height of a flight is proportional to the square of the launch velocity. The launch velocity
    is proportional to the voltage of the kick. The advised voltage is within the limit of the
    ceramic.
    """
    travel, room = float(y.max() - y[0]), float(table.y[-1] - y[0])
    if y.max() <= table.y[-1]:
        travel, room = float(y[0] - y.min()), float(y[0] - table.y[0])
    share = KICK_MARGIN * math.sqrt(room / travel) if room > 0 else 0.0
    for part in scene.list_parts("piezo_stack") if share else ():
        drive = getattr(part.keys, "drive", None)
        if drive is not None:
            rated = [pin.rated for (name, _), pin in scene.terminals.items() if name == part.name]
            size = _round_down(min(filter(None, (share * abs(drive.voltage), *rated))))
            voltage = math.copysign(size, drive.voltage)
            return f'lower the drive voltage, such as {part.name}.drive.voltage = "{voltage:g} V"'
    for part in scene.list_parts("throw") if share else ():
        velocity = float(f"{share * getattr(part.keys, 'velocity', 0.0):.2g}")
        return f'lower the velocity, such as {part.name}.velocity = "{velocity:g} m/s"'
    names = ", ".join(part.name for part in scene.list_parts("source"))
    return f"lower the amplitude of the source that accelerates the sphere: {names}"


def _round_down(value: float) -> float:
    """Return the largest number with two significant digits up to a positive value.

    >>> _round_down(125.9)
    120.0
    """
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / step) * step:.2g}")


def _list_coil_currents(part: Part[RingMagnetCoilsKeys], waves: Waveforms) -> dict[str, np.ndarray]:
    """Return the recorded waveforms of the coil currents [A], keyed by coil name.

    The upper coil is first.
    """
    result = {}
    for coil in reversed(COIL_NAMES):
        name = f"{get_result_prefix(part)}.{coil}.current"
        if name in waves:
            result[coil] = waves[name]
    return result


def _is_connected(part: Part[RingMagnetCoilsKeys], scene: JoinedScene) -> bool:
    """Return whether the scene connects at least one pin of the coils."""
    targets = {f"{part.name}.{pin}" for pin in ("drive", "ret", *COIL_PINS)}
    for other in scene.parts.values():
        joined = (*other.pins.values(), *scene.joins[other.name].values())
        if other is not part and not targets.isdisjoint(joined):
            return True
    return bool(part.pins)


def find_largest_current(part: Part[RingMagnetCoilsKeys], scene: JoinedScene) -> float:
    """Return the largest coil current [A] that a controller of the scene can set.

    If a part other than a controller drives the coils, their largest current is not known, and the
    result is 1 A. If no part drives the coils, return 0.
    """
    limits = [pid.keys.current_limit for pid in scene.list_parts_with_schema("pid", PidKeys)]
    return float(max(limits, default=1.0 if _is_connected(part, scene) else 0.0))


def compute_spline_error(table: MagnetostaticTable, current: float) -> float:
    """Return the error estimate of the force spline, relative to the largest force.

    The reference of the error is the largest force for currents up to ``current`` [A] in both
    coils. If the distance between heights is doubled, the error of an accurate spline becomes 16
    times larger. In tests, doubling the distance between the heights of the force table made the
    spline error at least 11 times larger. The factor was 11 for a table of 9 heights and the
    magnets of Schütz and co-authors (2021). To be on the safe side, the error estimate assumes that
    a doubled distance between heights increases the spline error by a factor of at most 8. The
    error estimate is ``e2 / min(8, max(1, e4 / e2))``, where e2 and e4 are the errors of splines
    through every second and every fourth height. If the table has fewer than 13 heights, the error
    estimate is e2, the error of a spline through every second height.
    """
    values = table.coefficients
    largest = float(np.abs(_compute_force_contributions(values, current)).sum(axis=0).max())

    def compute_spline_error(step: int) -> float:
        """Return the relative error of a spline through every ``step``-th height."""
        result = interpolate_by_splines(table.y[::step], values[::step])(table.y)
        off = _compute_force_contributions(result - values, current)
        return float(np.abs(off).sum(axis=0).max()) / largest

    half = compute_spline_error(2)
    known = half > 0.0 and table.y[::4].size >= 4
    return half / (min(8.0, max(1.0, compute_spline_error(4) / half)) if known else 1.0)


def compute_distance_outside(table: MagnetostaticTable, y: np.ndarray) -> float:
    """Return the distance [m] by which heights exceed the range of the force table.

    Return 0 if the table contains all heights.
    """
    return max(0.0, float(table.y[0] - y.min()), float(y.max() - table.y[-1]))


register_part_type(RingMagnetCoils())
