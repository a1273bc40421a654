"""The part ``moving_conductor``: conductor that moves along the axis of coils and magnets.

A few current loops represent the eddy currents in the body of revolution. The base class
``MovingBody`` is also the base class of the part ``moving_magnet``.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import cache
from itertools import combinations_with_replacement
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from typing_extensions import TypeVar

from kc2spice.core.cache import load_or_build
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Curve, Figure, Panel, Shape
from kc2spice.core.key_actions import ChangeKey
from kc2spice.core.mesh_error_descriptions import describe_mesh_errors
from kc2spice.core.progress import StageTimer
from kc2spice.core.quantities import (
    MU_0,
    Count,
    Dimension,
    FluxDensity,
    Frequency,
    Ratio,
    RefinementRule,
    Resistance,
    Section,
    si,
)
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.spectrum import find_energy_frequency
from kc2spice.core.untrusted_files import make_identifier
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.magnet_keys import RingKeys
from kc2spice.fem.magnet_rings import (
    LoopModel,
    RingCells,
    Winding,
    compare_loops_with_rings,
    divide_section,
    reduce_to_loops,
)
from kc2spice.fem.thermal_materials import find_resistance_coefficient
from kc2spice.physics import Declaration, DeclaredPart, current, displacement, loop
from kc2spice.physics.conductors import ConductorKeys
from kc2spice.physics.declaration import Branch
from kc2spice.physics.part import list_newton_numerics
from kc2spice.scene.checks import Check, Gate, Metric, RunEnergyBalance
from kc2spice.scene.highest_frequency import find_highest_frequency
from kc2spice.scene.part_records import NeglectedEffect, NumericalRequirements
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    BuiltScene,
    GovernedScene,
    Part,
    Scene,
    WiredScene,
)

Conductivity = Annotated[float, si("1/(Ohm m)")]
LOOP_SOURCES = ("kc2spice.fem.magnet_rings", __name__)
# tolerance of the full model, divided by the tolerance of the reduced model
TOLERANCE_RATIO = 0.1
MIN_TURN_SHARE = 0.05  # smallest height change between two turning points, as fraction of the range
MAX_TURNS = 5  # largest number of turning points that are reported as metrics
# The full model has twice as many rings as the reduced model.
# The full model resolves twice the highest frequency of the reduced model.
REFINEMENT_RATIO = 2
# description of the method that computes the couplings of a conductor without a division into rings
CIRCLE_METHOD = "closed-form inductances of coaxial current loops"
MIN_FREQUENCY = 1e3  # Hz, frequency up to which eddy currents are always resolved
# Assumed inductance of a coil above a conductor, divided by the inductance of the coil alone.
SCREENED_RATIO = 0.5
# Largest permitted frequency of a run's currents, divided by the resolved frequency.
MAX_FREQUENCY_RATIO = 2.0
# Fraction of a coil current's energy at frequencies below the highest frequency of a run.
# The fraction is less than 1, because a short sine also has energy above its frequency.
CURRENT_ENERGY_SHARE = 0.99
# Largest permitted relative error of flux, force and loss due to the division of the conductor into
# rings.
MAX_RING_ERROR = 0.02
# Largest permitted change of a magnet's path in ``verify``, relative to the path.
# The full model of ``verify`` has a ten times smaller tolerance for the magnet's field.
MAX_PATH_CHANGE = 1e-3
# A finer division of the conductor into rings is assumed to reduce the error of the division by at
# least this fraction.
MIN_CHANGE_RATIO = 0.1


class CoilKeys(Section):
    """Keys of a coaxial coil whose winding has a rectangular cross-section."""

    radius: Dimension = Field(gt=0, description="Mean radius of the coil's winding")
    width: Dimension = Field(
        gt=0, description="Radial width of the cross-section of the coil's winding"
    )
    height: Dimension = Field(
        gt=0, description="Axial height of the cross-section of the coil's winding"
    )
    y: Dimension = Field(
        description=(
            "Height of the centre of the coil's winding, with the same zero as the moving body's "
            "height"
        )
    )
    turns: Ratio = Field(examples=["100"], gt=0, description="Number of turns of the coil")
    resistance: Resistance = Field(gt=0, description="Electrical resistance of the coil's wire")


class MagnetKeys(RingKeys):
    """Keys of a fixed ring or cylinder magnet.

    The magnet is magnetised along the axis, and has the permeability of air.
    """

    remanence: FluxDensity = Field(
        description="Remanence of the fixed magnet, positive for an upward magnetisation"
    )


class ConductionKeys(Section):
    """Keys of a conducting body that are also parameters of its netlist."""

    conductivity: Conductivity = Field(
        gt=0, description="Electrical conductivity of the moving body, such as 3.4e7 1/(Ohm m)"
    )


class MovingBodyKeys(ConductorKeys):
    """Keys of a body that moves along the common axis of coils and magnets.

    The coordinate y is the height of the body's centre of mass, with the same zero as the heights
    of the coils and magnets. A part ``mass`` at the pin ``a`` represents the mass of the body.
    """

    radius: Dimension = Field(gt=0, description="Outer radius of the moving body")
    inner: Dimension = Field(
        0.0,
        ge=0,
        description="Radius of the central hole of the moving body; 0 for a body without a hole",
    )
    thickness: Dimension | None = Field(
        None, gt=0, description="Thickness of the moving disc along the axis"
    )
    coils: dict[str, CoilKeys] = Field(
        {},
        description=(
            "Coils that act on the moving body, each a table [PART.coils.NAME] with the pins "
            "NAME_p and NAME_n"
        ),
    )
    magnets: dict[str, MagnetKeys] = Field(
        {},
        description="Fixed magnets that act on the moving body, each a table [PART.magnets.NAME]",
    )
    y_min: Dimension = Field(
        description=(
            "Lowest height of the moving body's centre of mass for which the model is valid, "
            "with the same freely chosen zero as the heights of coils and magnets"
        )
    )
    y_max: Dimension = Field(
        description=(
            "Greatest height of the moving body's centre of mass for which the model is valid, "
            "with the same freely chosen zero as the heights of coils and magnets"
        )
    )
    tolerance: Annotated[Ratio, RefinementRule(0.1, model=True)] = Field(
        1e-3,
        gt=1e-8,
        lt=0.1,
        description=(
            "Largest permitted relative error of flux and force; determines the number of current "
            "loops that represent the eddy currents in the moving body"
        ),
    )


class MovingConductorKeys(ConductionKeys, MovingBodyKeys):
    """Keys of a moving conducting disc, ring or sphere."""

    shape: Literal["disc", "sphere"] = Field(
        "disc",
        description=(
            "Shape of the moving body: sphere, or disc; a ring is a disc with the key `inner`"
        ),
    )
    frequency: Frequency | None = Field(
        None,
        gt=0,
        description=(
            "Highest frequency at which the model resolves eddy currents; by default the "
            "highest frequency of analysis and sources, but at least 1 kHz"
        ),
    )
    rings: Annotated[Count, RefinementRule(2.0, model=True, mesh=True)] = Field(
        400,
        ge=20,
        le=3000,
        description=(
            "Number of current rings that represent eddy currents in the body; thinner rings "
            "are added below the surface if the skin depth is small"
        ),
    )


def _name_coil_current(coil: str) -> str:
    """Return the name of the current of a coil."""
    return f"i_{coil}"


def _list_loop_currents(count: int) -> list[str]:
    """Return the names of the currents in ``count`` loops of the body."""
    return list(map("eddy{}".format, range(1, count + 1)))


def _list_branches(keys: MovingBodyKeys, loops: int) -> tuple[Branch, ...]:
    """Return the branches for the coils, the motion, and the current loops of a body."""
    coils = (current(_name_coil_current(n), f"{n}_p", f"{n}_n") for n in keys.coils)
    return (*coils, displacement("y", "a", "b"), *map(loop, _list_loop_currents(loops)))


@cache
def _declare_body(
    kind: MovingBody,
    branches: tuple[Branch, ...],
    low: str = "",
    high: str = "",
    reach: str = "",
    **physics: Any,
) -> Declaration:
    """Return the declaration of a moving body from its branches and expressions.

    ``low`` and ``high`` are expressions that are positive within the range of heights. The text
    ``reach`` states up to which frequency the currents of the current loops are valid.
    """
    limits = {"y above y_min": low, "y below y_max": high} if low else {}
    return Declaration(
        kind.name,
        kind.title,
        kind.parameters,
        branches,
        limits=limits,
        remedies={
            "y above y_min": "lower the key PART.y_min",
            "y below y_max": "raise the key PART.y_max",
        },
        rating=kind.rating,
        sign=(
            "the displacement of a relative to b, in um, is the height of the centre of mass; 1 A "
            "into the pin a is an upward force of 1 N"
        ),
        validity=f"heights y_min to y_max{reach}; rigid, not magnetic, at constant temperature",
        conductors=tuple(b.name for b in branches if b.is_flow and b.plus),
        temperature_coefficient=find_resistance_coefficient("copper"),
        losses_of_model=True,
        **physics,
    )


def declare_moving_body(part: Part[MovingBodyKeys], model: LoopModel) -> Declaration:
    """Return the declaration of a moving body, with its computed current loops.

    The coenergy is ``i' L i / 2`` with the currents i of coils and loops. The couplings in the
    inductance matrix L are power series of the height. A magnet has no current loops. The couplings
    of a magnet are stated per tesla of remanence.
    """
    keys, coils = part.keys, list(map(_name_coil_current, part.keys.coils))
    eddies = _list_loop_currents(model.rates.size)
    loops = eddies or ["remanence"]
    place = f"(y - {(model.low + model.high) / 2:.11g})/{(model.high - model.low) / 2:.11g}"
    energy = list(map("0.5*{}^2".format, eddies))
    for (j, a), (k, b) in combinations_with_replacement(enumerate(coils), 2):
        energy.append(f"{0.5 if j == k else 1.0}*{model.inductance[j, k]:.11g}*{a}*{b}")
    for coil, row in zip((*coils, "1"), model.couplings, strict=False):
        for current_, series in zip(loops, row, strict=True):
            numbers = ", ".join(map("{:.11g}".format, series))
            energy.append(f"{coil}*{current_}*poly({place}, {numbers})")
    heat = []
    for eddy, rate in zip(eddies, model.rates, strict=True):
        heat.append(f"0.5*{rate:.11g}/conductivity*{eddy}^2")
    for coil, winding in zip(coils, keys.coils.values(), strict=True):
        heat.append(f"0.5*{winding.resistance:.11g}*{coil}^2")
    return _declare_body(
        part.type,
        _list_branches(keys, len(eddies)),
        coenergy=" + ".join(energy),
        content=" + ".join(heat) or "0",
        low=f"y - {model.low:.11g}",
        high=f"{model.high:.11g} - y",
        reach=f", currents up to {model.frequency:g} Hz" if eddies else "",
        mesh=_describe_ring_error(model) or f"none: {CIRCLE_METHOD}",
    )


MovingT = TypeVar("MovingT", bound=MovingBodyKeys, default=MovingBodyKeys)


class MovingBody(DeclaredPart[MovingT]):
    """Base class of bodies that move in the field of coils and magnets."""

    # Each current loop of the built model has a result, so the result names depend on the model.
    results_of_model = True
    parameters: ClassVar[type[Section]]
    rating: ClassVar[str]

    def numerics(self, part: Part[MovingT], scene: WiredScene) -> Iterator[NumericalRequirements]:
        """Yield the Newton tolerance for ``dc`` and ``op``, smaller than the default."""
        return list_newton_numerics(part, scene)

    def make_declaration(self, part: Part[MovingT], scene: GovernedScene) -> Declaration:
        """Return the declaration of the part for the values of its keys."""
        return _declare_body(self, _list_branches(part.keys, 0))

    def declare_after_build(self, part: Part[MovingT], build: BuiltScene) -> Declaration:
        """Return the declaration, which contains the current loops of the built model."""
        return declare_moving_body(part, build.model(part, LoopModel))

    def problems(self, part: Part[MovingT], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from super().problems(part, scene)
        keys = part.keys
        if keys.y_min >= keys.y_max:
            hint = f"write  y_min = {keys.y_max:g}  and  y_max = {keys.y_min:g}"
            hint = hint if keys.y_min > keys.y_max else "raise y_max above y_min"
            yield part.wrong(
                "y_min",
                "the range of heights is empty",
                got=f"{keys.y_min:g} … {keys.y_max:g} m",
                expected="y_min < y_max",
                hint=hint,
            )
        if not keys.coils and not keys.magnets:
            yield part.wrong(
                "coils",
                "the part has neither coils nor magnets",
                got="{}",
                expected="at least one coil or magnet",
                hint=f"add the table [{part.name}.coils.NAME] with radius, width, height and turns",
            )
        yield from self.shape_problems(part)
        if keys.inner >= keys.radius:
            yield part.wrong(
                "inner",
                "the inner radius leaves no material",
                got=f"{keys.inner:g} m",
                expected=f"less than radius, {keys.radius:g} m",
            )
        for name, coil in keys.coils.items():
            if not name.isidentifier():
                yield part.wrong(
                    f"coils.{name}",
                    "this name of a coil is not valid",
                    got=name,
                    expected="letters, digits and _",
                    hint=f"write {make_identifier(name, 'coil')} in place of {name}",
                )
            if coil.width >= 2 * coil.radius:
                yield part.wrong(
                    f"coils.{name}.width",
                    "the winding crosses the axis",
                    got=f"{coil.width:g} m",
                    expected=f"less than {2 * coil.radius:g} m, twice the mean radius",
                )
        obstacles = []
        for name, winding in zip(keys.coils, make_windings(keys), strict=True):
            obstacles.append((f"coils.{name}", "winding", winding))
        for name, magnet in keys.magnets.items():
            obstacles.append((f"magnets.{name}", "magnet", _make_cross_section(magnet)))
        for where, obstacle, w in obstacles:
            apart = w.radius - w.width / 2 >= keys.radius or w.radius + w.width / 2 <= keys.inner
            over = w.y + w.height / 2 + _compute_body_height(keys) / 2
            under = w.y - w.height / 2 - _compute_body_height(keys) / 2
            if not (apart or keys.y_min >= over or keys.y_max <= under):
                yield part.wrong(
                    where,
                    f"the body touches the {obstacle}",
                    got=(
                        f"a centre of mass from y_min = {keys.y_min:g} m to y_max = "
                        f"{keys.y_max:g} m"
                    ),
                    expected=f"y_min of at least {over:g} m, or y_max of at most {under:g} m",
                    hint=ChangeKey("raise", f"{part.name}.y_min", "to", f"{over:g} m"),
                )

    def outline(self, part: Part[MovingT], scene: Scene) -> Iterator[Shape]:
        """Yield the side view of coils, magnets and the moving body."""
        for name, coil in part.keys.coils.items():
            for side in (-1, 1):
                label = f"{part.name}: coil {name}, {coil.turns:g} turns" if side > 0 else ""
                yield Shape(side * coil.radius, coil.y, coil.width, coil.height, "coil", label)
        for name, ring in part.keys.magnets.items():
            for side in (-1, 1):
                label = f"{part.name}: magnet {name}" if side > 0 else ""
                x, width = side * (ring.inner + ring.outer) / 2, ring.outer - ring.inner
                yield Shape(x, ring.y, width, ring.height, "magnet", label)
        yield from _outline_body(part, scene)

    # --- model ------------------------------------------------------------------------------------

    def build(
        self, part: Part[MovingT], scene: Scene, clock: StageTimer, full: bool = False
    ) -> LoopModel:
        """Build or load the current loops of the body and their couplings to the coils.

        The ``full`` model has more loops and rings than the reduced model, and resolves twice the
        highest frequency. The full model also has a smaller tolerance, so that its couplings are
        more accurate than the couplings of the reduced model.
        """
        keys, frequency = part.keys, self.find_resolved_frequency(part, scene)
        tolerance = (TOLERANCE_RATIO if full else 1.0) * keys.tolerance
        rings = (REFINEMENT_RATIO if full else 1) * getattr(keys, "rings", 1)
        if full and frequency:
            frequency = REFINEMENT_RATIO * max(
                frequency, find_highest_frequency(scene, _find_shortest_time_constant(part, scene))
            )

        def build() -> LoopModel:
            """Compute the current loops of the body and their couplings to the coils."""
            fixed = []
            for magnet in keys.magnets.values():
                fixed += compute_surface_currents(magnet, magnet.remanence)
            with clock.time_stage("magnetics", f"field of {part.name}"):
                ladder = self.make_current_loops(keys, fixed, tolerance, rings, frequency)
                if full or not frequency:
                    return ladder
                return self.add_ring_error(ladder, keys, fixed, rings)

        shape, settings = {"tolerance", "rings", "frequency"}, (tolerance, rings, frequency)
        key = {"keys": keys.model_dump(exclude=shape, mode="json"), "of": settings}
        sources = (*LOOP_SOURCES, type(self).__module__)
        try:
            return load_or_build(self.name, key, build, classes=(LoopModel,), sources=sources)
        except UsageError as error:  # the fit over the range of heights failed
            details = str(error.message), error.got, error.expected, error.next_action
            raise part.wrong("y_max", *details) from None

    def metrics(
        self, part: Part[MovingT], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the heights and times of the first turning points of the body."""
        if "time" not in waves or f"{part.name}.y" not in waves:
            return {}
        result = find_turning_points(waves["time"], waves[f"{part.name}.y"])
        metrics = {}
        for k, (time, height) in enumerate(result[:MAX_TURNS], 1):
            metrics[f"{part.name}_turn{k}_s"] = Metric(time, "s")
            metrics[f"{part.name}_turn{k}_m"] = Metric(height, "m")
        return metrics

    def checks(
        self, part: Part[MovingT], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check | RunEnergyBalance | Gate]:
        """Yield the checks of the part after a run."""
        result = build.model(part, LoopModel)
        loops, limit = result.rates.size, part.keys.tolerance
        what = f"truncation error of {part.name} with {loops} current loops"
        advice = "use more rings, or a lower frequency"
        if loops:
            yield Check(what, result.error, limit, "of flux and force", advice, "warn")
            finer = f"discretisation error of {part.name} with {result.rings} rings"
            more = f"raise {part.name}.rings"
            unit = "of flux, force and loss"
            yield Check(
                finer, result.ring_error, MAX_RING_ERROR, unit, more, "warn", discretisation=True
            )
            highest = _find_highest_run_frequency(part, build, waves)
            what = f"highest frequency of the currents of {part.name}"
            advice = f"raise {part.name}.frequency to the highest frequency"
            limit = MAX_FREQUENCY_RATIO * result.frequency
            yield Check(what, highest, limit, "Hz", advice, "warn", discretisation=True)
            limits = {"rom_vs_fom": MAX_RING_ERROR, "ngspice_vs_fom": MAX_RING_ERROR}
            of = f"{part.name}.{_name_coil_current('*')}_v"
            yield Gate(f"coil voltages of {part.name}", of, limits, "largest")
        elif "time" in waves:
            of, limits = f"{part.name}.y", {"rom_vs_fom": MAX_PATH_CHANGE}
            words = (
                f"height of {part.name}, relative to its travel, with a ten times smaller tolerance"
            )
            yield Gate(words, of, limits, "travel", discretisation=True)
        yield from super().checks(part, build, waves)

    def figures(self, part: Part[MovingT], build: BuiltScene, waves: Waveforms) -> Iterator[Figure]:
        """Yield the figures of the part for the report."""
        y = waves.data.get(f"{part.name}.y")
        if y is not None and "time" in waves:
            path = Curve(part.name, 1e3 * waves["time"], 1e3 * y)
            panel = Panel("time in ms", "height in mm", (path,))
            caption = f"Height of the centre of mass of {part.name}."
            title = f"Path of {part.name}"
            yield Figure(f"{part.name}_height", title, caption, (panel,), main=True)

    def describe_discretisation(self, part: Part[MovingT], build: BuiltScene) -> str:
        """Return the error estimate of the division into rings, in words."""
        return _describe_ring_error(build.model(part, LoopModel)) or f"no mesh: {CIRCLE_METHOD}"

    @abstractmethod
    def make_current_loops(
        self, keys: MovingT, fixed: list[Winding], tolerance: float, rings: int, frequency: float
    ) -> LoopModel:
        """Return the current loops of the body with their couplings.

        The loops are coupled to the coils and to the ``fixed`` currents.
        """

    def shape_problems(self, part: Part[MovingT]) -> Iterator[UsageError]:
        """Yield an error for each key that does not apply to the body's shape.

        The method of the base class yields no errors; subclasses override the method to check their
        keys.
        """
        return iter(())

    def find_resolved_frequency(self, part: Part[MovingT], scene: Scene) -> float:
        """Return the highest frequency [Hz] at which eddy currents are resolved.

        Return 0 for a body without eddy currents.
        """
        return 0.0

    def add_ring_error(
        self, ladder: LoopModel, keys: MovingT, fixed: list[Winding], rings: int
    ) -> LoopModel:
        """Add an error estimate to the model: the error of dividing a body into rings.

        A model without rings is returned unchanged.
        """
        return ladder


class MovingConductor(MovingBody[MovingConductorKeys]):
    """Part type ``moving_conductor``: conductor that moves along the axis of coils."""

    name = "moving_conductor"
    title = "conducting body that moves along the axis of coils and magnets (eddy currents)"
    schema = MovingConductorKeys
    discretisations: ClassVar[tuple[str, ...]] = ("rings", "frequency", "tolerance")
    parameters: ClassVar[type[Section]] = ConductionKeys
    rating = (
        "not known; the power i^2 * resistance heats each coil, and eddy currents heat the body"
    )
    source = "rings (integral equation, axisymmetric), reduced"

    def shape_problems(self, part: Part[MovingConductorKeys]) -> Iterator[UsageError]:
        """Yield an error for each key that does not apply to the body's shape."""
        keys = part.keys
        if keys.shape == "disc" and not keys.thickness:
            yield part.wrong(
                "thickness",
                "the thickness of the disc is missing",
                got="none",
                expected="a length above zero",
                hint='add  thickness = "1 mm"',
            )
        if keys.shape == "sphere" and (keys.inner or keys.thickness):
            yield part.wrong(
                "shape",
                "inner and thickness do not apply to a sphere",
                got=f"inner {keys.inner:g} m, thickness {keys.thickness}",
                expected="a sphere without these keys",
                hint='write  shape = "disc"  or delete the keys `inner` and `thickness`',
            )

    def find_resolved_frequency(self, part: Part[MovingConductorKeys], scene: Scene) -> float:
        """Return the highest frequency [Hz] at which eddy currents are resolved."""
        return float(
            part.keys.frequency
            or max(
                MIN_FREQUENCY,
                find_highest_frequency(scene, _find_shortest_time_constant(part, scene)),
            )
        )

    def make_current_loops(
        self,
        keys: MovingConductorKeys,
        fixed: list[Winding],
        tolerance: float,
        rings: int,
        frequency: float,
    ) -> LoopModel:
        """Return the current loops of the body with their couplings.

        The loops are coupled to the coils and to the ``fixed`` currents.
        """
        body, coils = _divide_body(keys, rings, frequency), make_windings(keys)
        settings = keys.y_min, keys.y_max, keys.conductivity, frequency, tolerance
        return reduce_to_loops(body, coils, fixed, *settings)

    def add_ring_error(
        self, ladder: LoopModel, keys: MovingConductorKeys, fixed: list[Winding], rings: int
    ) -> LoopModel:
        """Add an error estimate to the model: the error of dividing a body into rings.

        The error is proportional to the square of the ring size, and therefore to the reciprocal of
        the number of rings. The estimate is computed from the change of the results with finer
        rings.
        """
        finer = _divide_body(keys, REFINEMENT_RATIO * rings, ladder.frequency)
        changed = compare_loops_with_rings(
            finer, ladder, make_windings(keys), fixed, keys.conductivity
        )
        return replace(
            ladder, ring_error=changed / max(1 - ladder.rings / finer.r.size, MIN_CHANGE_RATIO)
        )

    def notes(
        self, part: Part[MovingConductorKeys], scene: Scene
    ) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys, frequency = part.keys, self.find_resolved_frequency(part, scene)
        highest = format_quantity(frequency, "Hz")
        yield (
            f"{len(keys.coils)} coils; eddy currents modelled as current loops, with a relative "
            f"error of flux and force of at most {keys.tolerance:g} at frequencies up to "
            f"{highest}; flux and force exact in the currents, power series in the height"
        )
        yield from self.list_neglected_effects(part, scene)
        depth = 1e3 * _compute_skin_depth(keys, frequency)
        yield NeglectedEffect(
            f"eddy currents above {frequency:.4g} Hz",
            f"current loops up to {highest}, where the skin depth is {depth:.2g} mm",
            "each run checks the frequencies of its currents and the discretisation error of the "
            "rings",
        )
        yield NeglectedEffect("eddy currents in the coils' wires", "thin wires", "not estimated")
        yield NeglectedEffect(
            "tilting and sideways motion", "one degree of freedom", "not estimated"
        )


def _describe_ring_error(model: LoopModel) -> str:
    """Return the error estimate of the rings in words; empty without rings."""
    errors = describe_mesh_errors(model.facts)
    return f"error estimate of its {model.rings} rings: {errors}" if errors else ""


def find_turning_points(time: np.ndarray, y: np.ndarray) -> list[tuple[float, float]]:
    """Return times [s] and heights [m] of alternating maxima and minima of ``y``.

    Between two turning points, ``y`` changes by more than ``MIN_TURN_SHARE`` times the range of
    ``y``. Smaller ripple is ignored.
    """
    result, best, sign = [], 0, 0
    least = MIN_TURN_SHARE * np.ptp(y)
    for k in range(1, y.size):
        gone = y[k] - y[best]
        if not sign and abs(gone) > least:
            sign = int(np.sign(gone))
        if sign * gone > 0:
            best = k
        elif sign and abs(gone) > least:
            result.append((float(time[best]), float(y[best])))
            best, sign = k, -sign
    return result


def _compute_skin_depth(keys: MovingConductorKeys, frequency: float) -> float:
    """Return the skin depth [m] at ``frequency`` [Hz].

    The skin depth is ``1 / sqrt(pi f MU_0 conductivity)``.
    """
    return 1 / math.sqrt(math.pi * frequency * MU_0 * keys.conductivity)


def _divide_body(keys: MovingConductorKeys, rings: int, frequency: float) -> RingCells:
    """Return the division of the body into rings.

    The rings resolve the skin depth at ``frequency`` [Hz].
    """
    box = (
        keys.inner,
        keys.radius,
        -_compute_body_height(keys) / 2,
        _compute_body_height(keys) / 2,
        rings,
    )

    def is_inside_sphere(r: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return whether each point lies in the sphere."""
        return np.asarray(r**2 + z**2 < keys.radius**2)

    ball = keys.shape == "sphere"
    return divide_section(
        *box, is_inside_sphere if ball else None, _compute_skin_depth(keys, frequency)
    )


def _find_shortest_time_constant(part: Part[MovingBodyKeys], scene: WiredScene) -> float:
    """Return the shortest time constant [s] of the coils with their series resistors."""
    result = []
    for name, coil, winding in zip(
        part.keys.coils, part.keys.coils.values(), make_windings(part.keys), strict=True
    ):
        ohms = coil.resistance + _sum_series_resistance(part, scene, {f"{name}_p", f"{name}_n"})
        result.append(SCREENED_RATIO * winding.compute_coupling_inductance(winding) / ohms)
    return min(result, default=0.0)


def _sum_series_resistance(part: Part[MovingBodyKeys], scene: WiredScene, pins: set[str]) -> float:
    """Return the sum [Ohm] of the series resistors at a coil's ``pins``."""
    coil_nets = {scene.get_net(part.name, pin) for pin in pins} - {"0"}
    result = 0.0
    for resistor in scene.list_parts("resistor"):
        if len({scene.get_net(resistor.name, pin) for pin in "ab"} & coil_nets) == 1:
            result += resistor.keys.model_dump()["resistance"]
    return result


def _find_highest_run_frequency(
    part: Part[MovingBodyKeys], build: BuiltScene, waves: Waveforms
) -> float:
    """Return the highest frequency [Hz] of a frequency response or of coil currents.

    The highest frequency of a frequency response is the last frequency. The highest frequency of a
    transient is the highest frequency of the coil currents.
    """
    if "frequency" in waves:
        return float(waves["frequency"].real[-1])
    result = 0.0
    for name in part.keys.coils:
        current = waves.data.get(f"{part.name}.{_name_coil_current(name)}")
        if "time" in waves and current is not None:
            share = CURRENT_ENERGY_SHARE
            result = max(result, find_energy_frequency(waves["time"], current, share=share))
    return result


def make_windings(keys: MovingBodyKeys) -> list[Winding]:
    """Return the windings of the coils, in the order of the keys."""
    return [Winding(c.radius, c.width, c.height, c.y, c.turns) for c in keys.coils.values()]


def compute_surface_currents(ring: RingKeys, remanence: float) -> list[Winding]:
    """Return the surface currents [A] that represent a magnet of ``remanence`` [T]."""
    current = remanence * ring.height / MU_0
    result = [Winding(ring.outer, 0.0, ring.height, ring.y, current)]
    if ring.inner:
        result.append(Winding(ring.inner, 0.0, ring.height, ring.y, -current))
    return result


def _make_cross_section(ring: RingKeys) -> Winding:
    """Return the cross-section of a magnet as a ``Winding``, which has zero turns."""
    middle, width = (ring.inner + ring.outer) / 2, ring.outer - ring.inner
    return Winding(middle, width, ring.height, ring.y, 0.0)


def _outline_body(part: Part[MovingT], scene: Scene) -> Iterator[Shape]:
    """Yield the cross-section of the body at its initial height, for the drawing.

    The initial height is the key ``position`` of a part ``mass`` at the pin ``a``, limited to the
    range of heights.
    """
    keys = part.keys
    y = keys.y_min
    for name, _ in scene.list_joined_pins(part.name, "a"):
        y = getattr(scene.parts[name].keys, "position", y)
    y = min(max(y, keys.y_min), keys.y_max)
    sphere = getattr(keys, "shape", "disc") == "sphere"
    kind: Literal["metal", "magnet"] = "metal" if hasattr(keys, "conductivity") else "magnet"
    shape = "sphere" if sphere else "disc"
    label = f"{part.name}: {shape} of {format_quantity(2 * keys.radius, 'm')}"
    height = _compute_body_height(keys)
    if not keys.inner:
        yield Shape(0.0, y, 2 * keys.radius, height, kind, label, round=sphere)
        return
    for side in (-1, 1):
        x, width = side * (keys.inner + keys.radius) / 2, keys.radius - keys.inner
        yield Shape(x, y, width, height, kind, label if side > 0 else "")


def _compute_body_height(keys: MovingBodyKeys) -> float:
    """Return the axial dimension [m] of the body."""
    return 2 * keys.radius if keys.thickness is None else keys.thickness


register_part_type(MovingConductor())
