"""The parts ``vent`` and ``tube``: circular ducts with losses at their walls.

The model divides a duct into sections. Each section has a series impedance, and a shunt admittance
at both of its ends. The impedance Z' and the admittance Y' per unit length are:

    1 / Z' = A / (j omega rho) F(omega rho a^2 / mu)
    Y'     = j omega A / (rho c^2) (gamma - (gamma - 1) F(omega a^2 / alpha))

The duct has the cross-sectional area A and the radius a. The function F describes the viscous and
thermal boundary layers (:mod:`._boundary_layers`); without losses, F = 1. At an open end, the fluid
in the duct moves a column of outer fluid, whose length is 0.8216 a with a flange and 0.6127 a
without a flange (S. W. Rienstra and A. Hirschberg, An Introduction to Acoustics, section 5.1.3).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Literal

from pydantic import Field, model_validator

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.domains import ACOUSTIC, AMBIENT
from kc2spice.core.errors import UsageError
from kc2spice.core.key_actions import DeleteKey, Hint
from kc2spice.core.quantities import Count, Dimension, DuctLength, make_invalid_value_error, si
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.user_warnings import warn_user
from kc2spice.netlist.circuit import Element, Item
from kc2spice.parts.acoustics._acoustic_band import choose_acoustic_band
from kc2spice.parts.acoustics._acoustic_part import (
    COMPLIANCE,
    MASS,
    RESISTANCE,
    AcousticElement,
    AcousticNetwork,
    AcousticPart,
)
from kc2spice.parts.acoustics._boundary_layers import RelaxationSum, fit_boundary_layer
from kc2spice.parts.acoustics._duct_law import DuctLaw
from kc2spice.parts.acoustics._fluids import (
    LARGEST_AREA,
    LARGEST_LENGTH,
    SMALLEST_AREA,
    SMALLEST_LENGTH,
    FluidKeys,
)
from kc2spice.parts.acoustics.cavity import CORNERS_PER_DECADE, list_relaxations
from kc2spice.scene.part_records import NeglectedEffect, PartResult
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    GROUND,
    BuiltScene,
    GovernedScene,
    JoinedScene,
    Part,
    Scene,
    Terminal,
)

EndType = Literal["none", "unflanged", "flanged"]
END_CORRECTIONS: Mapping[EndType, float] = {"none": 0.0, "unflanged": 0.6127, "flanged": 0.8216}
# Product k a of wave number and radius above which the first transverse mode propagates.
WIDEST_DUCT = 1.84
SECTIONS_PER_WAVELENGTH = 30  # error of the phase velocity: (2 pi / 30)^2 / 24 = 0.18 %
MOST_SECTIONS = 400  # largest number of sections of a tube
FEW_SECTIONS = 10  # ducts with more sections have fewer relaxations in each section
# a duct with more sections has fewer relaxations in each section
# With one corner in each decade, the losses of a duct with many sections have an error below 5 %.
CORNERS_OF_LONG_DUCTS = 1
FAR_END = "b"  # pin of the far end
FAR_METER = "Vflow_b"  # name of the ammeter for the volume velocity out of the far end


class DuctKeys(FluidKeys):
    """Keys of a circular duct: its length, its radius and its losses."""

    length: DuctLength = Field(
        ge=SMALLEST_LENGTH,
        le=LARGEST_LENGTH,
        description="Length of the duct, without end corrections",
    )
    radius: Dimension | None = Field(
        None, ge=SMALLEST_LENGTH, le=LARGEST_LENGTH, description="Inner radius of the duct"
    )
    area: Annotated[float, si("m2")] | None = Field(
        None,
        ge=SMALLEST_AREA,
        le=LARGEST_AREA,
        description="Cross-sectional area of the duct; can be stated instead of the key `radius`",
    )
    losses: bool = Field(
        True,
        description=(
            "Whether the model includes the viscous and thermal losses in the boundary "
            "layers at the duct's wall"
        ),
    )

    @model_validator(mode="after")
    def _require_one_size(self) -> DuctKeys:
        """Require exactly one of the keys ``radius`` and ``area``."""
        if (self.radius is None) == (self.area is None):
            number = "no size" if self.radius is None else "two sizes"
            hint: Hint = DeleteKey("area")
            if self.radius is None:
                hint = 'add for example  radius = "1 mm"'
            raise make_invalid_value_error(f"the duct has {number}", "radius or area", hint=hint)
        return self

    @property
    def inner_radius(self) -> float:
        """Inner radius [m] of the duct."""
        return self.radius or math.sqrt((self.area or 0.0) / math.pi)


class VentKeys(DuctKeys):
    """Keys of a short duct, such as a hole or the port of a loudspeaker box."""

    end_a: EndType = Field(
        "flanged",
        description=(
            "End correction at the end `a` of the duct: with a flange, without a flange, or none"
        ),
    )
    end_b: EndType = Field(
        "flanged",
        description=(
            "End correction at the end `b` of the duct; must be none if a part of type "
            "`radiation` is connected to this end"
        ),
    )


class TubeKeys(DuctKeys):
    """Keys of a long duct, such as a measurement tube."""

    end_a: EndType = Field(
        "none",
        description=(
            "End correction at the end `a` of the duct: with a flange, without a flange, or none"
        ),
    )
    end_b: EndType = Field(
        "none",
        description=(
            "End correction at the end `b` of the duct: with a flange, without a flange, or none"
        ),
    )
    closed: bool = Field(
        False,
        description=(
            "Whether a rigid wall closes the end `b` of the tube; a closed end has no pin"
        ),
    )
    sections: Count | None = Field(
        None,
        ge=1,
        le=MOST_SECTIONS,
        description=(
            "Number of sections into which the model divides the tube; by default 30 per "
            "wavelength at the highest frequency"
        ),
    )


@dataclass(frozen=True)
class DuctModel:
    """Model of a duct: number of sections, losses in boundary layers, phase error.

    ``viscous`` and ``thermal`` are sums of relaxation terms that approximate the losses in the
    viscous and in the thermal boundary layer. Without losses, ``viscous`` and ``thermal`` are None.
    ``phase_error`` is the relative error of the phase velocity at the end of the band.
    """

    sections: int
    viscous: RelaxationSum | None
    thermal: RelaxationSum | None
    phase_error: float

    @property
    def loss_error(self) -> float:
        """Largest relative error of the duct's losses in the frequency band."""
        layers = (self.viscous, self.thermal)
        return max((layer.loss_error for layer in layers if layer is not None), default=0.0)


class DuctPart(AcousticPart[DuctKeys]):
    """Base class of the part types ``vent`` and ``tube``, which are circular ducts."""

    def is_closed(self, part: Part[DuctKeys]) -> bool:
        """Return whether a rigid wall closes the far end of the duct."""
        return bool(getattr(part.keys, "closed", False))

    def list_pressure_pins(self, part: Part[DuctKeys]) -> tuple[str, ...]:
        """Return the pressure pins at the open ends of the duct."""
        return ("a",) if self.is_closed(part) else ("a", FAR_END)

    def steady_flow_paths(self, part: Part[DuctKeys]) -> tuple[tuple[str, str], ...]:
        """Return the paths of a steady flow: from the end ``a`` to far end or ambient.

        The fluid in a duct with a closed end acts as a spring between the pins ``a`` and
        ``ambient``.
        """
        return (("a", AMBIENT),) if self.is_closed(part) else (("a", FAR_END),)

    def pins(self, part: Part[DuctKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        result = []
        for pin in super().pins(part, scene):
            if pin.name == FAR_END and not scene.is_target(part.name, FAR_END):
                pin = replace(pin, default=GROUND, required=False)
            result.append(pin)
        return tuple(result)

    def problems(self, part: Part[DuctKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from super().problems(part, scene)
        keys, fluid = part.keys, part.keys.fluid
        high = choose_acoustic_band(scene).high
        limit = WIDEST_DUCT * fluid.sound_speed / (2 * math.pi * keys.inner_radius)
        if scene.analysis.is_small_signal and high > limit:
            warn_user(
                f"{part.name}: above {format_quantity(float(f'{limit:.4g}'), 'Hz')}, higher-order "
                "modes propagate in a duct of this radius, and the model neglects these modes: "
                "lower analysis.stop"
            )
        self._warn_of_double_ends(part, scene)

    def _warn_of_double_ends(self, part: Part[DuctKeys], scene: GovernedScene) -> None:
        """Warn about an end correction at an end where a ``radiation`` part is connected.

        A part of type ``radiation`` already includes the end correction.
        """
        for end in self.list_pressure_pins(part):
            correction = getattr(part.keys, f"end_{end}")
            joined = part.pins.get(end, "").partition(".")[0]
            for other in scene.list_parts("radiation"):
                meets = other.name == joined or other.pins.get("face") == f"{part.name}.{end}"
                if meets and correction != "none":
                    warn_user(
                        f"{part.name}: the fluid mass outside of end {end} is counted twice, in "
                        f'end_{end} = "{correction}" and in {other.name}: set end_{end} = "none"'
                    )

    def count_sections(self, part: Part[DuctKeys], scene: GovernedScene) -> int:
        """Return the number of sections of the duct, 1 by default."""
        return 1

    def make_duct_model(self, part: Part[DuctKeys], scene: GovernedScene) -> DuctModel:
        """Return a duct model that is accurate in the frequency band of the scene."""
        keys, fluid, band = part.keys, part.keys.fluid, choose_acoustic_band(scene)
        count = self.count_sections(part, scene)
        corners = CORNERS_PER_DECADE if count <= FEW_SECTIONS else CORNERS_OF_LONG_DUCTS
        scale = 2 * math.pi * keys.inner_radius**2
        viscous = thermal = None
        if keys.losses and fluid.viscosity:
            ends = (float(f"{scale * f * fluid.density / fluid.viscosity:.4g}") for f in band)
            viscous = fit_boundary_layer("flow", *ends, corners)
        if keys.losses and fluid.diffusivity and fluid.heat_ratio > 1:
            ends = (float(f"{scale * f / fluid.diffusivity:.4g}") for f in band)
            thermal = fit_boundary_layer("heat", *ends, corners)
        phase = 2 * math.pi * band.high * keys.length / (count * fluid.sound_speed)
        return DuctModel(count, viscous, thermal, phase**2 / 24)

    def network(self, part: Part[DuctKeys], scene: GovernedScene) -> AcousticNetwork:
        """Return the acoustic elements of all sections of the duct."""
        duct = self.make_duct_model(part, scene)
        elements = tuple(self._list_elements(part, duct))
        words = (
            f"duct of length {format_quantity(part.keys.length, 'm')} and radius "
            f"{format_quantity(part.keys.inner_radius, 'm')}, {self._describe_duct(duct)}; small "
            "amplitudes, fluid at rest"
        )
        return AcousticNetwork((), {}, elements, words, exits=self._map_far_pin_to_node(part))

    def _map_far_pin_to_node(self, part: Part[DuctKeys]) -> dict[str, str]:
        """Map the far-end pin to the inner node that an ammeter connects to the pin."""
        return {} if self.is_closed(part) else {FAR_END: "out"}

    def _describe_duct(self, duct: DuctModel) -> str:
        """Describe the sections and losses of a duct, with their errors, as text."""
        losses = "no losses"
        if duct.viscous:
            losses = f"losses accurate to {100 * duct.loss_error:.2g} %"
        count = f"{duct.sections} section{'s' if duct.sections > 1 else ''}"
        return f"{count}, phase accurate to {100 * duct.phase_error:.2g} % and {losses} in the band"

    def _list_elements(self, part: Part[DuctKeys], duct: DuctModel) -> Iterator[AcousticElement]:
        """Yield the end corrections, series elements and shunt elements of a duct."""
        keys, fluid, count = part.keys, part.keys.fluid, duct.sections
        area = math.pi * keys.inner_radius**2
        inertia, step = fluid.density / area, keys.length / count
        start, last = "in", "end" if self.is_closed(part) else "out"
        for end, outer, inner in (("a", "in", "mouth_a"), (FAR_END, "mouth_b", "out")):
            share = END_CORRECTIONS[getattr(keys, f"end_{end}")]
            if share and end in self.list_pressure_pins(part):
                mass = repr(inertia * share * keys.inner_radius)
                yield AcousticElement(MASS, f"end_{end}", outer, inner, mass)
                start = inner if end == "a" else start
                last = outer if end == FAR_END else last
        nodes = [start, *map("n{}".format, range(1, count)), last]
        for k in range(count):
            yield from _list_series_elements(duct, (nodes[k], nodes[k + 1]), k + 1, part, step)
        for k, node in enumerate(nodes):
            width = step / 2 if k in (0, count) else step
            yield from _list_shunt_elements(duct, node, k + 1, part, width)

    # --- the far end ------------------------------------------------------------------------------

    def write_further_cards(self, part: Part[DuctKeys]) -> Iterator[Item | str]:
        """Yield the card of the ammeter at the far end."""
        if not self.is_closed(part):
            yield "* volume velocity out of the far end"
            yield Element.from_words(FAR_METER, "out", FAR_END, "0")

    def vectors(self, part: Part[DuctKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        n, flow = part.name, ACOUSTIC.through_variable
        near = f"{n}.{flow.symbol}"
        result = dict(super().vectors(part, build))
        result[near] = replace(result[near], leaves=())
        if not self.is_closed(part):
            through = f"i(v.x{n}.{FAR_METER})".lower()
            result[f"{near}_b"] = PartResult(through, flow.factor, flow.unit, (FAR_END,))
        return result

    def law(self, part: Part[DuctKeys], build: BuiltScene) -> laws.Equations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice.

        One device represents the complete duct, because separate devices for all elements would be
        hundreds of devices.
        """
        n, network = part.name, self.network(part, build.scene)
        pins = {network.entry: "a"} | {node: pin for pin, node in network.exits.items()}
        law = make_duct_law(n, network, pins)
        names = {"a": ACOUSTIC.through_variable.symbol}
        names[FAR_END] = f"{names['a']}_{FAR_END}"
        results = {f"{n}.{ACOUSTIC.across.symbol}": laws.subtract_waves(f"{n}.a", f"{n}.{AMBIENT}")}
        for end, sign in zip(self.list_pressure_pins(part), (1.0, -1.0), strict=False):
            results[f"{n}.{names[end]}"] = laws.scale_wave(f"{n}.{end}.through", sign)
        joins = tuple((pin.name, f"{n}.{pin.name}") for pin in law.pins)
        return laws.Equations((law,), joins, results)

    def notes(self, part: Part[DuctKeys], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys, fluid = part.keys, part.keys.fluid
        area = math.pi * keys.inner_radius**2
        mass = fluid.density * keys.length / area
        words = self._describe_duct(self.make_duct_model(part, scene))
        yield f"acoustic mass {mass:.4g} kg/m⁴, {fluid.summary_text}: {words}"
        yield NeglectedEffect("vortices at the ends", "small amplitudes", "losses at high flow")
        yield NeglectedEffect(
            "radiation of open ends",
            "end corrections are masses",
            "not estimated; connect a part of type radiation",
        )
        yield NeglectedEffect("motion of the walls", "the walls are rigid", "not estimated")


def make_duct_law(name: str, network: AcousticNetwork, pins: Mapping[str, str]) -> DuctLaw:
    """Derive the model equations of a duct from its acoustic network.

    ``pins`` maps nodes of the network to pins.
    """
    nodes = {pins.get(item.plus, item.plus): 0.0 for item in network.elements}
    middles: dict[str, AcousticElement] = {}
    channels, walls = list[tuple[str, str, float, float]](), list[tuple[str, float, float]]()
    for item in network.elements:
        start, end = (pins.get(node, node) for node in (item.plus, item.minus))
        value, first = network.evaluate_element(item), middles.get(item.plus)
        origin = "" if first is None else pins.get(first.plus, first.plus)
        if item.kind == RESISTANCE:
            middles[item.minus] = item
        elif item.kind == MASS:
            friction = 0.0 if first is None else network.evaluate_element(first)
            channels.append((origin or start, end, friction, value))
        elif first is None:
            nodes[start] += value
        else:
            walls.append((origin, network.evaluate_element(first), value))
    for node in middles:
        nodes.pop(node, None)
    ends = tuple(end for end in ("a", FAR_END) if end in pins.values())
    nodes |= {end: nodes.get(end, 0.0) for end in ends}
    return DuctLaw(name, nodes, ends, tuple(channels), tuple(walls))


def _list_series_elements(
    duct: DuctModel, ends: tuple[str, str], index: int, part: Part[DuctKeys], step: float
) -> Iterator[AcousticElement]:
    """Yield the series elements of a duct section.

    Without losses, a section has a single acoustic mass. With losses, a section has parallel
    branches, each with a resistance and a mass in series.
    """
    keys, (start, end) = part.keys, ends
    radius = keys.inner_radius
    inertia = keys.fluid.density * step / (math.pi * radius**2)
    if duct.viscous is None:
        yield AcousticElement(MASS, f"s{index}", start, end, repr(inertia))
        return
    friction = keys.fluid.viscosity * step / (math.pi * radius**4)
    for k, (corner, weight) in enumerate(duct.viscous.terms, 1):
        name, node = f"s{index}_{k}", f"layer{index}_{k}"
        yield AcousticElement(RESISTANCE, name, start, node, repr(friction * corner / weight))
        yield AcousticElement(MASS, name, node, end, repr(inertia / weight))


def _list_shunt_elements(
    duct: DuctModel, node: str, index: int, part: Part[DuctKeys], width: float
) -> Iterator[AcousticElement]:
    """Yield the elements of a duct node: its compliance and its thermal relaxations."""
    keys, fluid = part.keys, part.keys.fluid
    radius = keys.inner_radius
    size = math.pi * radius**2 * width / (fluid.density * fluid.sound_speed**2)
    yield AcousticElement(COMPLIANCE, f"p{index}", node, AMBIENT, repr(size), leak=True)
    if duct.thermal is not None:
        share = (fluid.heat_ratio - 1) * size
        time = radius**2 / fluid.diffusivity
        yield from list_relaxations(duct.thermal, (node, AMBIENT), share, time, str(index))


class Vent(DuctPart):
    """Part type ``vent``: short duct with end corrections and losses."""

    name, title = "vent", "short duct with end corrections and losses"
    schema = VentKeys
    example = """
[vent]
part = "vent"
length = "2 mm"
radius = "1 mm"
pins = { a = "housing.a" }

[housing]
part = "cavity"
volume = "1 cm3"
pins = { a = "push.out" }

[push]
part = "source"
kind = "volume_velocity"
ac = "1e-9 m3/s"

[analysis]
type = "ac"
start = "100 Hz"
stop = "3 kHz"
"""


class Tube(DuctPart):
    """Part type ``tube``: long duct of many sections with losses."""

    name, title = "tube", "long duct of many sections with losses"
    schema = TubeKeys
    example = """
[tube]
part = "tube"
length = "17 cm"
radius = "1 cm"
end_b = "unflanged"
pins = { a = "push.out", b = "gnd" }

[push]
part = "source"
kind = "volume_velocity"
ac = "1e-6 m3/s"

[analysis]
type = "ac"
start = "100 Hz"
stop = "3 kHz"
"""

    def problems(self, part: Part[DuctKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from super().problems(part, scene)
        keys = part.with_schema(TubeKeys).keys
        if keys.closed and FAR_END in part.pins:
            yield part.wrong(
                "closed",
                "a closed tube has no pin at its end b",
                got=f"closed = true and pins.{FAR_END}",
                expected=f"either closed = true or pins.{FAR_END}",
                hint=DeleteKey("closed"),
            )
        if keys.closed and keys.end_b != "none":
            yield part.wrong(
                "end_b",
                "a closed end cannot have an end correction",
                got=f'closed = true and end_b = "{keys.end_b}"',
                expected='end_b = "none", or closed = false',
                hint=DeleteKey("end_b"),
            )
        if keys.sections is None and self._count_required_sections(part, scene) > MOST_SECTIONS:
            warn_user(
                f"{part.name}: the band needs {self._count_required_sections(part, scene)} "
                f"sections, but the tube has {MOST_SECTIONS}: the upper frequencies of the band "
                f"are less accurate"
            )

    def _count_required_sections(self, part: Part[DuctKeys], scene: GovernedScene) -> int:
        """Return the number of sections that the frequency band of the scene requires."""
        waves = part.keys.length * choose_acoustic_band(scene).high / part.keys.fluid.sound_speed
        return max(2, math.ceil(SECTIONS_PER_WAVELENGTH * waves))

    def count_sections(self, part: Part[DuctKeys], scene: GovernedScene) -> int:
        """Return the number of duct sections that the scene or the band requires."""
        stated = part.with_schema(TubeKeys).keys.sections
        return stated or min(self._count_required_sections(part, scene), MOST_SECTIONS)


register_part_type(Vent())
register_part_type(Tube())
