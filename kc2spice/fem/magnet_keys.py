"""Scene keys of the catch actuator: ring magnet, two coils and air cylinder.

Source: tables 1 and A1 of the paper.
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


class Ring(Section):
    """Ring with a rectangular section; ``y`` is the height of the ring's centre."""

    height: Length = Field(gt=0, description="Axial height of the ring")
    outer: Length = Field(gt=0, description="Outer radius of the ring")
    inner: Length = Field(ge=0, description="Inner radius of the ring")
    y: Length = Field(description="Height of the centre of the ring")


class Catch(Section):
    """Electromagnetic catch actuator (tables 1 and A1 of the paper)."""

    polarity: Literal["parallel", "antiparallel"] = Field(
        "parallel",
        description="Whether the magnetisations of ring magnet and sphere are "
        "parallel or antiparallel",
    )
    remanence: FluxDensity = Field(0.2, ge=0, description="Remanence of ring magnet and sphere")
    mu_r: Ratio = Field(1.0611, ge=1, description="Recoil permeability of ring magnet and sphere")
    ring: Ring = Ring(height=1e-3, outer=5e-3, inner=4e-3, y=2.5e-3)
    lower: Ring = Ring(height=2e-3, outer=2.3e-3, inner=1.3e-3, y=1e-3)
    upper: Ring = Ring(height=2e-3, outer=2.3e-3, inner=1.3e-3, y=4e-3)
    turns: Count = Field(4074, ge=1, description="Number of turns of each coil")
    wire_diameter: Length = Field(25e-6, gt=0, description="Diameter of the wire of the coils")
    resistivity: Resistivity = Field(
        1.7e-8, gt=0, description="Resistivity of the wire of the coils"
    )
    air_radius: Length = Field(10e-3, gt=0, description="Radius of the modelled air cylinder")
    air_height: Length = Field(30e-3, gt=0, description="Height of the modelled air cylinder")
    y_min: Length = Field(-2.5e-3, description="Lowest sphere height in the force table")
    y_max: Length = Field(7.5e-3, description="Greatest sphere height in the force table")
    shift: Length = Field(
        0.0,
        gt=-1e-3,
        lt=1e-3,
        description=(
            "Mounting error: height of the ring, the coils and the tabulated force above the "
            "nominal position"
        ),
    )
    positions: Annotated[Count, RefinementRule(2.0, spaces=True, model=True)] = Field(
        41, ge=4, le=2001, description="Number of heights at which the magnetic field is computed"
    )
    points: Annotated[Count, RefinementRule(2.0, spaces=True)] = Field(
        201, ge=21, le=2001, description="Number of points of the force table in the netlist"
    )
    refine: Count = Field(
        1, ge=1, le=8, description="Factor that multiplies the number of cells along each edge"
    )
