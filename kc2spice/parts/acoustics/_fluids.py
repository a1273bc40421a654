"""Fluids of acoustic parts, built in or given by a table of constants.

A key of the type :data:`Fluid` accepts the name of a fluid in :data:`LIBRARY`, or a table of
constants. The value of a :data:`Fluid` key is a :class:`FluidTable`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from kc2spice.core.errors import did_you_mean
from kc2spice.core.quantities import (
    AIR_DENSITY,
    SOUND_SPEED,
    Density,
    Pressure,
    Ratio,
    Section,
    UsualRange,
    Velocity,
    make_invalid_value_error,
    si,
)
from kc2spice.core.sound_level import GAS_REFERENCE, LIQUID_REFERENCE

LARGEST_GAS_DENSITY = 100.0  # kg/m3; a denser fluid counts as a liquid
# At ambient pressure, only gases lighter than LARGEST_FAST_GAS_DENSITY [kg/m3], such as helium with
# 0.17 kg/m3 and 1007 m/s, have a speed of sound above LARGEST_HEAVY_GAS_SPEED [m/s].
LARGEST_FAST_GAS_DENSITY, LARGEST_HEAVY_GAS_SPEED = 0.3, 900.0
# The lower limit exceeds the density of every liquid in g/cm3.
USUAL_LIQUID_DENSITY = UsualRange(
    "kg/m3", 25.0, math.inf, "only liquids have such a speed of sound, and liquids are denser"
)
LARGEST_HEAT_RATIO = 5 / 3  # heat capacity ratio of a monatomic gas
# Limits of the density [kg/m3]: the density of a thin gas, and a value above the densest liquid.
SMALLEST_DENSITY, LARGEST_DENSITY = 1e-6, 3e4
SMALLEST_SPEED, LARGEST_SPEED = 1.0, 1e4  # limits [m/s] of the speed of sound in any fluid
# Lower limits of viscosity and conductivity: a thousandth of the smallest values of gases.
SMALLEST_VISCOSITY, LARGEST_VISCOSITY = 1e-9, 1e6  # viscosities [Pa s]
SMALLEST_CONDUCTIVITY, LARGEST_CONDUCTIVITY = 1e-6, 1e4  # conductivities [W/(m K)]


class FluidTable(Section):
    """Table of one fluid's constants at rest, such as density and speed of sound.

    Without the key ``viscosity``, there are no viscous losses. Without the key ``conductivity``,
    there are no thermal losses.
    """

    density: Density = Field(
        ge=SMALLEST_DENSITY, le=LARGEST_DENSITY, description="Mass density of the fluid"
    )
    sound_speed: Velocity = Field(
        ge=SMALLEST_SPEED, le=LARGEST_SPEED, description="Speed of sound in the fluid"
    )
    viscosity: Annotated[float, si("Pa s")] = Field(
        0.0, ge=0, le=LARGEST_VISCOSITY, description="Dynamic viscosity of the fluid"
    )
    conductivity: Annotated[float, si("W/(m K)")] = Field(
        0.0, ge=0, le=LARGEST_CONDUCTIVITY, description="Thermal conductivity of the fluid"
    )
    specific_heat: Annotated[float, si("J/(kg K)")] | None = Field(
        None, ge=1, le=1e6, description="Specific heat capacity of the fluid at constant pressure"
    )
    heat_ratio: Ratio = Field(
        1.0,
        ge=1,
        le=LARGEST_HEAT_RATIO,
        description="Ratio of the specific heats at constant pressure and at constant volume",
    )
    reference_pressure: Pressure | None = Field(
        None,
        gt=0,
        description=(
            "Reference sound pressure (rms) of the level 0 dB; by default 20 uPa in gases "
            "and 1 uPa in liquids"
        ),
    )
    source: str = Field(
        "", max_length=200, description="Literature reference for the values of this fluid table"
    )

    @model_validator(mode="after")
    def _require_thermal_constants(self) -> FluidTable:
        """Reject constants that are too small, and a conductivity without specific heat."""
        if self.conductivity and self.specific_heat is None:
            raise make_invalid_value_error(
                "conductivity needs the key `specific_heat`",
                None,
                hint="add for example  specific_heat = 1007",
            )
        for key, least in (
            ("viscosity", SMALLEST_VISCOSITY),
            ("conductivity", SMALLEST_CONDUCTIVITY),
        ):
            if 0 < getattr(self, key) < least:
                raise make_invalid_value_error(
                    f"{key} must be 0 or at least {least:g}",
                    None,
                    hint=f"raise {key} to {least:g}, or write {key} = 0",
                )
        return self

    @property
    def diffusivity(self) -> float:
        """Thermal diffusivity ``k / (rho cp)`` [m2/s]; 0 without a conductivity."""
        if self.specific_heat is None:
            return 0.0
        return self.conductivity / (self.density * self.specific_heat)

    @property
    def is_gas(self) -> bool:
        """Whether the fluid has the density of a gas."""
        return self.density < LARGEST_GAS_DENSITY

    @property
    def sounds_like_liquid(self) -> bool:
        """Whether no gas at ambient pressure has this density and speed of sound."""
        heavy = self.density > LARGEST_FAST_GAS_DENSITY
        return heavy and self.sound_speed > LARGEST_HEAVY_GAS_SPEED

    @property
    def level_reference_pressure(self) -> float:
        """Rms sound pressure [Pa] that corresponds to a level of 0 dB."""
        if self.reference_pressure is not None:
            return self.reference_pressure
        return GAS_REFERENCE if self.is_gas else LIQUID_REFERENCE

    @property
    def summary_text(self) -> str:
        """Text with the density and the speed of sound of the fluid."""
        return f"{self.density:.4g} kg/m³, {self.sound_speed:.5g} m/s"


# Constants at 20 C and 1013 hPa.
LIBRARY: Mapping[str, FluidTable] = {
    "air": FluidTable(
        density=AIR_DENSITY,
        sound_speed=SOUND_SPEED,
        viscosity=18.2e-6,
        conductivity=25.9e-3,
        specific_heat=1006.0,
        heat_ratio=1.40,
        source="E. W. Lemmon and R. T Jacobsen, Int. J. Thermophys. 25 (2004) 21; density and "
        "speed of an ideal gas",
    ),
    "water": FluidTable(
        density=998.2,
        sound_speed=1482.3,
        viscosity=1.0016e-3,
        conductivity=0.598,
        specific_heat=4184.0,
        heat_ratio=1.007,
        source="V. A. Del Grosso and C. W. Mader, J. Acoust. Soc. Am. 52 (1972) 1442; IAPWS 2008 "
        "and 2011",
    ),
}


def _read_fluid(value: Any) -> Any:
    """Replace a fluid name by the built-in fluid; return other values unchanged."""
    if not isinstance(value, str):
        return value
    fluid = LIBRARY.get(value.lower())
    if fluid is None:
        expected = f"one of {', '.join(LIBRARY)}, or a table"
        hint = did_you_mean(value, LIBRARY) or "write a table: { density = …, sound_speed = … }"
        raise make_invalid_value_error("this fluid does not exist", expected, hint=hint)
    return fluid


Fluid = Annotated[FluidTable, BeforeValidator(_read_fluid)]


# Limits of lengths and areas of acoustic parts, from nanometres to kilometres.
SMALLEST_LENGTH, LARGEST_LENGTH = 1e-9, 1e4  # lengths [m]
SMALLEST_AREA, LARGEST_AREA = 1e-18, 1e8  # areas [m2]


class FluidKeys(Section):
    """Keys of the fluid and the assumed face motion, common to all acoustic parts."""

    fluid: Fluid = Field(
        "air",
        validate_default=True,
        description=(
            "Fluid of the acoustic part: air or water at 20 degrees Celsius, or a table of "
            "constants; by default air"
        ),
    )
    motion: Literal["piston"] | None = Field(
        None,
        description=(
            'Assumed motion of the body\'s face: "piston" if all points have the same velocity. '
            "With this key, a run lists the effect of the assumption on the sound level, and does "
            "not warn if the face moves in another way"
        ),
    )
