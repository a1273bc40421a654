"""Keys of the catch actuator: ring magnet, two coils, air box (paper tables 1 and A1)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from kc2spice.core.quantities import Count, FluxDensity, Length, Notch, Ratio, Resistivity, Section


class Ring(Section):
    """A body of revolution with rectangular section; ``y`` is its centre."""

    height: Length = Field(gt=0)
    outer: Length = Field(gt=0)
    inner: Length = Field(ge=0)
    y: Length


class Catch(Section):
    """Electromagnetic catch actuator (paper tables 1 and A1)."""

    polarity: Literal["parallel", "antiparallel"] = "parallel"
    remanence: FluxDensity = Field(0.2, ge=0)
    mu_r: Ratio = Field(1.0611, ge=1)
    ring: Ring = Ring(height=1e-3, outer=5e-3, inner=4e-3, y=2.5e-3)
    lower: Ring = Ring(height=2e-3, outer=2.3e-3, inner=1.3e-3, y=1e-3)
    upper: Ring = Ring(height=2e-3, outer=2.3e-3, inner=1.3e-3, y=4e-3)
    turns: Count = Field(4074, ge=1)
    wire_diameter: Length = Field(25e-6, gt=0)
    resistivity: Resistivity = Field(1.7e-8, gt=0)
    air_radius: Length = Field(10e-3, gt=0)
    air_height: Length = Field(30e-3, gt=0)
    y_min: Length = -2.5e-3
    y_max: Length = 7.5e-3
    shift: Length = Field(
        0.0, gt=-1e-3, lt=1e-3, description="of ring, coils and table upwards: mounting error"
    )
    positions: Annotated[Count, Notch(2.0, spaces=True, model=True)] = Field(41, ge=4, le=2001)
    points: Annotated[Count, Notch(2.0, spaces=True)] = Field(
        201, ge=21, le=2001, description="of the force lookup in the netlist"
    )
    refine: Count = Field(1, ge=1, le=8)
