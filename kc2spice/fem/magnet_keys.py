"""Scene keys of the catch actuator: ring magnet, two coils and air cylinder.

Source: tables 1 and A1 of Schütz, Maeter and Bechtold, Actuators 10 (2021) 279.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from kc2spice.core.quantities import (
    Count,
    FluxDensity,
    Length,
    Ratio,
    RefinementRule,
    Resistivity,
    Section,
)


class RingKeys(Section):
    """Scene keys of a ring magnet or coil with a rectangular section."""

    height: Length = Field(gt=0, description="Height of the ring magnet or coil along the axis")
    outer: Length = Field(gt=0, description="Outer radius of the ring magnet or coil")
    inner: Length = Field(ge=0, description="Inner radius of the ring magnet or coil")
    y: Length = Field(
        description=(
            "Height of the centre of the ring magnet or coil above the surface on which the "
            "sphere rests"
        )
    )


class CatchKeys(Section):
    """Scene keys of an electromagnetic catch: ring magnet, two coils and air cylinder."""

    polarity: Literal["parallel", "antiparallel"] = Field(
        "parallel",
        description=(
            "Whether the magnetisations of the ring magnet and the sphere are parallel or "
            "antiparallel"
        ),
    )
    remanence: FluxDensity = Field(
        0.2,
        ge=0,
        description="Remanence (remanent flux density) of the ring magnet and the sphere",
    )
    mu_r: Ratio = Field(
        1.0611, ge=1, description="Relative recoil permeability of the ring magnet and the sphere"
    )
    ring: RingKeys = RingKeys(height=1e-3, outer=5e-3, inner=4e-3, y=2.5e-3)
    lower: RingKeys = RingKeys(height=2e-3, outer=2.3e-3, inner=1.3e-3, y=1e-3)
    upper: RingKeys = RingKeys(height=2e-3, outer=2.3e-3, inner=1.3e-3, y=4e-3)
    turns: Count = Field(4074, ge=1, description="Number of turns of each of the two coils")
    wire_diameter: Length = Field(25e-6, gt=0, description="Diameter of the coil wire")
    resistivity: Resistivity = Field(
        1.7e-8, gt=0, description="Electrical resistivity of the coil wire"
    )
    air_radius: Length = Field(
        10e-3,
        gt=0,
        description="Radius of the air cylinder in which the magnetic field is computed",
    )
    air_height: Length = Field(
        30e-3,
        gt=0,
        description="Height of the air cylinder in which the magnetic field is computed",
    )
    y_min: Length = Field(
        -2.5e-3,
        description=(
            "Lowest height of the sphere's centre in the table of the magnetic force, measured "
            "from the surface on which the sphere rests"
        ),
    )
    y_max: Length = Field(
        7.5e-3,
        description=(
            "Greatest height of the sphere's centre in the table of the magnetic force, measured "
            "from the surface on which the sphere rests"
        ),
    )
    shift: Length = Field(
        0.0,
        gt=-1e-3,
        lt=1e-3,
        description=(
            "Mounting error: distance by which the ring magnet and the coils are above their "
            "nominal position; the table of the magnetic force is shifted by the same distance"
        ),
    )
    positions: Annotated[Count, RefinementRule(2.0, spaces=True, model=True)] = Field(
        41,
        ge=4,
        le=2001,
        description="Number of sphere heights at which the magnetic field is computed",
    )
    points: Annotated[Count, RefinementRule(2.0, spaces=True)] = Field(
        201,
        ge=21,
        le=2001,
        description="Number of sphere heights in the table of the magnetic force in the netlist",
    )
    refine: Count = Field(
        1,
        ge=1,
        le=8,
        description=(
            "Refinement factor for the mesh of the magnetic field, by which all element "
            "sizes are divided"
        ),
    )
