"""The part ``cavity``: a closed volume of fluid with losses at its walls."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from kc2spice.core.domains import AMBIENT
from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Dimension, si
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.user_warnings import warn_user
from kc2spice.parts.acoustics._acoustic_band import choose_acoustic_band
from kc2spice.parts.acoustics._acoustic_part import (
    COMPLIANCE,
    RESISTANCE,
    AcousticElement,
    AcousticNetwork,
    AcousticPart,
)
from kc2spice.parts.acoustics._boundary_layers import RelaxationSum, fit_boundary_layer
from kc2spice.parts.acoustics._fluids import (
    LARGEST_AREA,
    LARGEST_LENGTH,
    SMALLEST_AREA,
    SMALLEST_LENGTH,
    FluidKeys,
)
from kc2spice.scene.part_records import NeglectedEffect
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import GovernedScene, Part, Scene

SMALLEST_VOLUME = 1e-18  # m3, a cubic micrometre
# relaxations in each decade of frequency, for an error of the wall losses below 1 %
CORNERS_PER_DECADE = 2
# Largest ratio of a cavity's length to the wavelength for which the pressure counts as uniform.
LARGEST_WAVELENGTH_RATIO = 0.1
# Ratio of surface area to volume^(2/3) for a cube and for a sphere.
# Of all shapes, a sphere has the smallest ratio of surface area to volume^(2/3).
CUBE_SURFACE, SPHERE_SURFACE = 6.0, 4.835975862049409


class CavityKeys(FluidKeys):
    """Keys of a cavity: its volume, its walls and its leak."""

    volume: Annotated[float, si("m3")] = Field(
        ge=SMALLEST_VOLUME, le=LARGEST_LENGTH**3, description="Volume of the cavity"
    )
    surface: Annotated[float, si("m2")] | None = Field(
        None,
        ge=SMALLEST_AREA,
        le=LARGEST_AREA,
        description=(
            "Area of the walls of the cavity; by default the surface area of a cube with the "
            "cavity's volume"
        ),
    )
    length: Dimension | None = Field(
        None,
        ge=SMALLEST_LENGTH,
        le=LARGEST_LENGTH,
        description=(
            "Longest inner dimension of the cavity; by default the edge of a cube with the "
            "cavity's volume"
        ),
    )
    wall_losses: bool = Field(
        True,
        description=(
            "Whether the model includes the losses at low frequencies due to heat conduction "
            "into the cavity's walls"
        ),
    )
    leak: Annotated[float, si("Pa s/m3")] | None = Field(
        None,
        ge=1e-6,
        le=1e30,
        description=(
            "Acoustic resistance of a leak from the cavity to the pin `ambient`; by default "
            "the cavity has no leak"
        ),
    )

    @property
    def compliance(self) -> float:
        """Adiabatic compliance ``V / (rho c^2)`` [m3/Pa]."""
        return self.volume / (self.fluid.density * self.fluid.sound_speed**2)

    @property
    def characteristic_length(self) -> float:
        """Characteristic length for heat conduction [m]: volume divided by surface area."""
        return self.volume / (self.surface or CUBE_SURFACE * self.volume ** (2 / 3))

    @property
    def longest_dimension(self) -> float:
        """Longest inner dimension [m]."""
        return self.length or self.volume ** (1 / 3)


class Cavity(AcousticPart[CavityKeys]):
    """Part type ``cavity``: closed volume of fluid with heat conduction at its walls.

    The admittance of a volume V is ``Y = j omega V / (rho c^2) (1 + (gamma - 1) tanh(z) / z)`` with
    ``z^2 = j omega h^2 / alpha``. In this formula, h is the volume divided by the surface area of
    the walls, gamma is the ratio of specific heats, and alpha is the thermal diffusivity.
    """

    name, title = "cavity", "closed volume of fluid with heat loss to its walls"
    schema = CavityKeys
    varying_ambient_advice = (
        "for a leak to another volume, use an acoustic_resistor in place of the key `leak`"
    )
    example = """
[cavity]
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
stop = "2 kHz"
"""

    def steady_flow_paths(self, part: Part[CavityKeys]) -> tuple[tuple[str, str], ...]:
        """Return the paths of a steady flow: from the opening to the ambient pressure."""
        return (("a", AMBIENT),)

    def get_fluid_volume(self, part: Part[CavityKeys]) -> float:
        """Return the volume [m3] of the cavity."""
        return part.keys.volume

    def problems(self, part: Part[CavityKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from super().problems(part, scene)
        keys = part.keys
        least = SPHERE_SURFACE * keys.volume ** (2 / 3)
        if keys.surface is not None and keys.surface < least * (1 - 1e-6):
            yield part.wrong(
                "surface",
                "the surface is smaller than the surface of a sphere of this volume",
                got=f"{keys.surface:g} m2",
                expected=f"at least {least:.4g} m2",
            )
        limit = LARGEST_WAVELENGTH_RATIO * keys.fluid.sound_speed / keys.longest_dimension
        if scene.analysis.is_small_signal and choose_acoustic_band(scene).high > limit:
            size = format_quantity(float(f"{keys.longest_dimension:.4g}"), "m")
            warn_user(
                f"{part.name}: above {format_quantity(float(f'{limit:.4g}'), 'Hz')} the cavity of "
                f"{size} is longer than a tenth of a "
                "wavelength, and its pressure is not uniform: use a tube"
            )

    def _fit_relaxations(
        self, part: Part[CavityKeys], scene: GovernedScene
    ) -> RelaxationSum | None:
        """Return the relaxations of the heat exchange at the walls; None without losses."""
        keys, fluid = part.keys, part.keys.fluid
        if not keys.wall_losses or not fluid.diffusivity or fluid.heat_ratio == 1:
            return None
        scale = 2 * math.pi * keys.characteristic_length**2 / fluid.diffusivity
        low, high = (float(f"{scale * f:.4g}") for f in choose_acoustic_band(scene))
        return fit_boundary_layer("layer", low, high, CORNERS_PER_DECADE)

    def network(self, part: Part[CavityKeys], scene: GovernedScene) -> AcousticNetwork:
        """Return the acoustic network of the cavity: compliance, leak, heat exchange."""
        keys, walls = part.keys, self._fit_relaxations(part, scene)
        volume = AcousticElement(COMPLIANCE, "a", "in", AMBIENT, repr(keys.compliance), leak=True)
        elements = [volume]
        if keys.leak is not None:
            elements.append(AcousticElement(RESISTANCE, "leak", "in", AMBIENT, repr(keys.leak)))
        if walls is not None:
            elements += list_relaxations(
                walls,
                ("in", AMBIENT),
                (keys.fluid.heat_ratio - 1) * keys.compliance,
                keys.characteristic_length**2 / keys.fluid.diffusivity,
            )
        validity = (
            f"cavity of {format_quantity(keys.volume, 'm3')}, {self._describe_walls(walls)}; "
            "uniform pressure, small amplitudes, fluid at rest"
        )
        return AcousticNetwork((), {}, tuple(elements), validity)

    def _describe_walls(self, walls: RelaxationSum | None) -> str:
        """Describe the wall losses and the error of the circuit that models the losses."""
        if walls is None:
            return "without heat loss to the walls"
        return f"heat loss to the walls accurate to {100 * walls.loss_error:.2g} % in the band"

    def notes(self, part: Part[CavityKeys], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys, walls = part.keys, self._fit_relaxations(part, scene)
        limit = LARGEST_WAVELENGTH_RATIO * keys.fluid.sound_speed / keys.longest_dimension
        yield (
            f"compliance {format_quantity(keys.compliance, 'm3/Pa')} of "
            f"{format_quantity(keys.volume, 'm3')}, {keys.fluid.summary_text}; "
            f"{self._describe_walls(walls)}"
        )
        share = (2 * math.pi * LARGEST_WAVELENGTH_RATIO) ** 2 / 2
        yield NeglectedEffect(
            "waves in the cavity",
            "uniform pressure",
            f"{100 * share:.2g} % at {format_quantity(float(f'{limit:.3g}'), 'Hz')}",
            size=share,
        )
        yield NeglectedEffect("motion of the walls", "the walls are rigid", "not estimated")


def list_relaxations(
    relaxations: RelaxationSum,
    ends: tuple[str, str],
    compliance: float,
    time: float,
    suffix: str = "",
) -> Iterator[AcousticElement]:
    """Yield each thermal relaxation as a resistance and a compliance in series.

    Each series connection has the frequency-dependent compliance ``C (w / p) / (1 + s t / p)``. The
    relaxation has the weight w and the corner p; C [m3/Pa] is ``compliance``, and t [s] is
    ``time``.
    """
    start, end = ends
    for k, (corner, weight) in enumerate(relaxations.terms, 1):
        size = compliance * weight / corner
        node = f"wall{suffix}_{k}"
        yield AcousticElement(RESISTANCE, f"w{suffix}_{k}", start, node, repr(time / corner / size))
        yield AcousticElement(COMPLIANCE, f"w{suffix}_{k}", node, end, repr(size))


register_part_type(Cavity())
