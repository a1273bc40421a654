"""Keys of the layered chip: material, mesh, damping, geometry (paper 2.1, 2.2.2, A.2)."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from kc2spice.core.quantities import (
    Count,
    Density,
    Frequency,
    Length,
    Mounting,
    Polarisation,
    Pressure,
    Rate,
    Ratio,
    Section,
)


class Material(Section):
    """Piezoelectric ceramic in Voigt order xx yy zz yz xz xy, poled along +z (paper A.2)."""

    density: Density = Field(7700.0, gt=0)
    stiffness: tuple[Pressure, Pressure, Pressure, Pressure, Pressure, Pressure] = Field(
        (158.9e9, 113.0e9, 117.1e9, 144.2e9, 14.08e9, 22.94e9),
        description="C11 C12 C13 C33 C44 C66",
    )
    coupling: tuple[Polarisation, Polarisation, Polarisation] = Field(
        (-3.914, 27.50, 13.38), description="e31 e33 e15"
    )
    permittivity: tuple[Ratio, Ratio] = Field(
        (3370.0, 3300.0), description="relative, 11 and 33, at constant permittivity_at"
    )
    permittivity_at: Literal["stress", "strain"] = "stress"


class ChipMesh(Section):
    """In-plane polar mesh; ``refine`` splits every cell edge, layers included, into that many."""

    refine: Count = Field(1, ge=1, le=6)
    order: Literal[1, 2] = 1
    sectors: Count = Field(10, ge=2, le=180, description="of the quarter circle")
    rings: Count = Field(5, ge=1, le=100, description="contact rings around the centre node")
    ring_spacing: Length = Field(50e-6, gt=0)
    outer_rings: Count = Field(11, ge=1, le=200, description="graded, out to the edge")


class Damping(Section):
    """Rayleigh damping: ``alpha`` on the mass, and a ratio met at one frequency by stiffness."""

    ratio: Ratio = Field(0.01, ge=0)
    at: Frequency = Field(250e3, gt=0)
    alpha: Rate = Field(0.0, ge=0)

    @property
    def beta(self) -> float:
        """Stiffness coefficient [s]: ``ratio = beta omega / 2`` at ``omega = 2 pi at``."""
        return self.ratio / (math.pi * self.at)


class Chip(Section):
    """Layered piezoelectric chip with square cross-section, one quarter of it modelled."""

    side: Length = Field(3e-3, gt=0)
    height: Length = Field(2e-3, gt=0)
    layers: Count = Field(33, ge=1, le=400)
    material: Material = Material()
    mesh: ChipMesh = ChipMesh()
    damping: Damping = Damping()
    mounting: Mounting = Field(
        "roller", description="of the bottom face: roller, glued, free, or stiffness per area N/m3"
    )
