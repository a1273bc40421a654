"""The part ``radiation``: sound radiation of a piston or a pulsating sphere."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.domains import ACOUSTIC, AMBIENT, SIGNAL
from kc2spice.core.errors import UsageError
from kc2spice.core.key_actions import DeleteKey
from kc2spice.core.quantities import Dimension, make_invalid_value_error, si
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Element, Item, make_positive_parameter
from kc2spice.netlist.number_and_name_spelling import format_number, format_voltage
from kc2spice.parts.acoustics._acoustic_part import (
    MASS,
    METER,
    SCALES,
    AcousticNetwork,
    AcousticPart,
)
from kc2spice.parts.acoustics._fluids import (
    LARGEST_AREA,
    LARGEST_LENGTH,
    SMALLEST_AREA,
    SMALLEST_LENGTH,
    FluidKeys,
)
from kc2spice.parts.acoustics._radiation_impedance import (
    RADIATORS,
    Radiator,
    Shape,
    list_elements,
)
from kc2spice.parts.acoustics._sound_filter import CORNER_RATIO, compute_low_pass_delay, delay_wave
from kc2spice.scene.highest_frequency import find_highest_frequency
from kc2spice.scene.part_records import NeglectedEffect, PartResult
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    BuiltScene,
    GovernedScene,
    JoinedScene,
    Part,
    Scene,
    Terminal,
)

FACE, SOUND = "face", "sound"  # pins of the radiating surface and of the far-field sound pressure
# m, distance at which the pin ``sound`` states the far-field sound pressure
REFERENCE_DISTANCE = 1.0


class RadiationKeys(FluidKeys):
    """Keys of a radiating surface: its shape, and its radius or area."""

    shape: Shape = Field(
        "baffled_piston",
        description="Shape of the radiating surface: piston in an infinite baffle, piston in the "
        "open end of a tube, or pulsating sphere",
    )
    radius: Dimension | None = Field(
        None, ge=SMALLEST_LENGTH, le=LARGEST_LENGTH, description="Radius of the radiating surface"
    )
    area: Annotated[float, si("m2")] | None = Field(
        None,
        ge=SMALLEST_AREA,
        le=LARGEST_AREA,
        description="Area of the radiating surface; can be stated instead of the key `radius`",
    )

    @model_validator(mode="after")
    def _require_one_size(self) -> RadiationKeys:
        """Require exactly one size, and no ``motion`` for a pulsating sphere."""
        if (self.radius is None) == (self.area is None):
            number = "no size" if self.radius is None else "two sizes"
            hint = 'add for example  radius = "10 mm"' if self.radius is None else "delete area"
            raise make_invalid_value_error(f"the surface has {number}", "radius or area", hint=hint)
        if self.motion is not None and self.shape == "sphere":
            raise make_invalid_value_error(
                "a pulsating sphere cannot have the key `motion`",
                "no key `motion`",
                hint=DeleteKey("motion"),
            )
        return self

    @property
    def radiator(self) -> Radiator:
        """Radiator with the part's shape: its radiation network, area and solid angle."""
        return RADIATORS[self.shape]

    @property
    def surface_radius(self) -> float:
        """Radius [m] of the radiating surface."""
        if self.radius is not None:
            return self.radius
        return math.sqrt((self.area or 0.0) / self.radiator.area)

    @property
    def sound_corner(self) -> float:
        """Corner frequency [rad/s] of the low pass that smooths the voltage ``sound``.

        The corner frequency is infinite for a sphere.
        """
        return 2 * math.pi * CORNER_RATIO * self.largest_frequency

    @property
    def largest_frequency(self) -> float:
        """Frequency [Hz] up to which the stated errors of the radiation network apply."""
        return self.radiator.largest_frequency(self.surface_radius, self.fluid.sound_speed)


class Radiation(AcousticPart[RadiationKeys]):
    """Part type ``radiation``: radiation impedance of a piston or a pulsating sphere."""

    name, title = "radiation", "radiation impedance of a piston or a pulsating sphere"
    schema = RadiationKeys
    encloses_fluid = False
    example = """
[radiation]
part = "radiation"
radius = "10 mm"
pins = { face = "push.out" }

[push]
part = "source"
kind = "volume_velocity"
ac = "1e-6 m3/s"

[analysis]
type = "ac"
start = "100 Hz"
stop = "20 kHz"
"""

    def list_pressure_pins(self, part: Part[RadiationKeys]) -> tuple[str, ...]:
        """Return the pressure pins except ``ambient``: the pin of the radiating surface."""
        return (FACE,)

    def steady_flow_paths(self, part: Part[RadiationKeys]) -> tuple[tuple[str, str], ...]:
        """Return the paths of a steady flow: from the surface to the ambient pressure."""
        return ((FACE, AMBIENT),)

    def pins(self, part: Part[RadiationKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        unit = ACOUSTIC.across.pin_unit
        return (*super().pins(part, scene), Terminal(SOUND, unit, SIGNAL, signal_out=True))

    def problems(self, part: Part[RadiationKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from super().problems(part, scene)
        if not scene.analysis.is_small_signal:
            return
        highest, limit = find_highest_frequency(scene), part.keys.largest_frequency
        if highest > limit:
            ka = 2 * math.pi * highest * part.keys.surface_radius / part.keys.fluid.sound_speed
            warn_user(
                f"{part.name}: the network of the radiation impedance is valid up to "
                f"{format_quantity(limit, 'Hz')}, but the analysis ends at "
                f"{format_quantity(highest, 'Hz')} (k a = {ka:.3g}): lower analysis.stop"
            )

    def network(self, part: Part[RadiationKeys], scene: GovernedScene) -> AcousticNetwork:
        """Return the network of the radiation impedance."""
        keys = part.keys
        params = (
            make_positive_parameter("radius", keys.surface_radius, "m", "radius of the surface"),
            make_positive_parameter("density", keys.fluid.density, "kg/m3", "density of the fluid"),
            make_positive_parameter("sound_speed", keys.fluid.sound_speed, "m/s", "speed of sound"),
        )
        area = f"{keys.radiator.area!r}*radius*radius"
        return AcousticNetwork(
            params,
            {"impedance": f"density*sound_speed/({area})", "rate": "sound_speed/radius"},
            tuple(list_elements(keys.radiator.network, "in", AMBIENT)),
            f"{keys.radiator.words}, {keys.radiator.error_text}; small amplitudes, fluid at rest",
        )

    def write_further_cards(self, part: Part[RadiationKeys]) -> Iterator[Item | str]:
        """Yield the cards of the sound pressure at the reference distance."""
        yield (
            f"* sound pressure at {REFERENCE_DISTANCE:g} m on the axis, in the far field, without "
            "propagation delay"
        )
        if part.keys.shape == "sphere":
            yield "* pressure on the surface times radius / 1 m"
            gain = f"{{radius*{format_number(1 / REFERENCE_DISTANCE)}}}"
            yield Element.from_words("Esound", SOUND, AMBIENT, FACE, AMBIENT, gain)
            return
        angle = part.keys.radiator.solid_angle * REFERENCE_DISTANCE
        yield f"* density / {angle:.4g} m times the time derivative of the volume velocity"
        yield Element.from_words("Fsound", AMBIENT, SOUND, METER, "1")
        if part.keys.shape == "free_piston":
            yield (
                "* plus the same factor times the time derivative of pressure / impedance: twice\n"
                "* the incident wave at the opening"
            )
            gain = f"{{{ACOUSTIC.admittance:g}/impedance}}"
            yield Element.from_words("Gsound", AMBIENT, SOUND, FACE, AMBIENT, gain)
        mass = format_number(SCALES[MASS] / angle)
        yield Element.from_words("Lsound", SOUND, AMBIENT, f"{{{mass}*density}}")
        largest = CORNER_RATIO * part.keys.radiator.network.largest_ka
        corner = f"{largest:g}*rate"
        yield f"* low pass above the range of the network, at k a = {largest:g}"
        yield Element.from_words("Rsound", SOUND, AMBIENT, f"{{{mass}*density*{corner}/sqrt(2)}}")
        yield Element.from_words(
            "Csound", SOUND, AMBIENT, f"{{1/({mass}*density*{corner}*{corner})}}"
        )

    def vectors(self, part: Part[RadiationKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        level = part.keys.fluid.level_reference_pressure
        ends = format_voltage(build.get_net(part, SOUND), build.get_net(part, AMBIENT))
        sound = replace(
            build.get_pin_vector(part, SOUND),
            expression=ends,
            level_reference=level,
            corrected=build.scene.analysis.type in ("ac", "transient"),
        )
        return {**super().vectors(part, build), f"{part.name}.{SOUND}": sound}

    def corrected_waves(
        self, part: Part[RadiationKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, np.ndarray]:
        """Return the sound pressure, corrected for the low-pass filter of the netlist.

        A sound pressure versus frequency is divided by the response of the low pass. A sound
        pressure versus time is advanced by the delay of the low pass.
        """
        name, corner = f"{part.name}.{SOUND}", part.keys.sound_corner
        scale = next(iter(waves))
        if name not in waves or math.isinf(corner):
            return {}
        x = waves.scale.real
        if scale == "frequency":
            return {name: waves[name] / laws.compute_low_pass_response(2j * np.pi * x, corner)}
        if scale != "time":
            return {}
        return {name: delay_wave(x, waves[name], [(1.0, -compute_low_pass_delay(corner))])}

    def law(self, part: Part[RadiationKeys], build: BuiltScene) -> laws.Equations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice."""
        equations = super().law(part, build)
        sound = {f"{part.name}.{SOUND}": _express_sound(part, equations)}
        return replace(equations, results={**equations.results, **sound})

    def notes(self, part: Part[RadiationKeys], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys, radiator = part.keys, part.keys.radiator
        limit = keys.largest_frequency
        upper = "" if math.isinf(limit) else f" ({format_quantity(limit, 'Hz')})"
        yield (
            f"{radiator.words}, radius {format_quantity(keys.surface_radius, 'm')}, "
            f"{keys.fluid.summary_text}: {radiator.error_text}{upper}"
        )
        yield NeglectedEffect(
            "reflections", "the sound radiates into a free field", "not estimated"
        )
        if keys.shape != "sphere":
            words = "an infinite baffle" if keys.shape == "baffled_piston" else "an endless tube"
            size = "up to 6 dB at low frequencies, more if the back is open"
            yield NeglectedEffect("size of the baffle", words, size)
            yield NeglectedEffect(
                "shape of the motion", "all points have the same velocity", "not estimated"
            )


@dataclass(frozen=True)
class FarField:
    """Far-field pressure on the axis at the reference distance, without propagation delay.

    At the reference distance, the far-field pressure is ``pressure * p + flow * U``, where p [Pa]
    is the pressure on the surface and U [m3/s] its volume velocity. With ``rate``, the far-field
    pressure is the time derivative ``d/dt (pressure * p + flow * U)``.
    """

    pressure: float
    flow: float
    rate: bool

    def evaluate(self, s: np.ndarray, p: np.ndarray, U: np.ndarray) -> np.ndarray:
        """Return the far-field pressures at ``s = j omega``."""
        return np.asarray((s if self.rate else 1.0) * (self.pressure * p + self.flow * U))


def find_far_field(keys: RadiationKeys) -> FarField:
    """Return the coefficients of the far-field pressure of a surface.

    A piston in a baffle has the far-field pressure ``rho / (2 pi r) dU/dt``. The far-field pressure
    of a sphere with the radius a and the pressure p on its surface is ``p a / r``. The far-field
    pressure of an open end is ``rho / (4 pi r) d/dt (U + p S / (rho c))``. The intensity on the
    axis of an open end is ``(k a)^2 / (1 - |R|^2)`` times the intensity of a point source with the
    same power.
    """
    if keys.shape == "sphere":
        return FarField(keys.surface_radius / REFERENCE_DISTANCE, 0.0, rate=False)
    mass = keys.fluid.density / (keys.radiator.solid_angle * REFERENCE_DISTANCE)
    if keys.shape == "baffled_piston":
        return FarField(0.0, mass, rate=True)
    area = keys.radiator.area * keys.surface_radius**2
    return FarField(mass * area / (keys.fluid.density * keys.fluid.sound_speed), mass, rate=True)


def _express_sound(part: Part[RadiationKeys], equations: laws.Equations) -> laws.WaveCombination:
    """Express the sound pressure of a part as a linear combination of its waveforms."""
    field, terms = find_far_field(part.keys), list[tuple[float, str]]()
    symbols = {
        ACOUSTIC.through_variable.symbol: field.flow, ACOUSTIC.across.symbol: field.pressure,
    }  # fmt: skip
    for symbol, share in symbols.items():
        if share:
            for factor, wave in equations.results[f"{part.name}.{symbol}"].terms:
                terms.append((share * factor, wave))
    corner = part.keys.sound_corner if field.rate else math.inf
    return laws.WaveCombination(tuple(terms), rate=field.rate, corner=corner)


register_part_type(Radiation())
