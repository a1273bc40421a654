"""Keys of the layered chip: material, mesh, damping, geometry (paper 2.1, 2.2.2, A.2)."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import (
    Count,
    Density,
    Frequency,
    Length,
    Mounting,
    Polarisation,
    Pressure,
    Ratio,
    Section,
    Stiffness,
    si,
)
from kc2spice.core.units import EPSILON_0
from kc2spice.fem.keys import Damping
from kc2spice.fem.materials import Material, MaterialTable, material

SECTORS = 4  # quarters of the chip that move alike, of which one is modelled
PATCH = "patch"  # its port under a pressure


_NAMES = (
    ("stiffness", ("c11", "c12", "c13", "c33", "c44", "c66")),
    ("coupling", ("e31", "e33", "e15")),
    ("permittivity", ("eps11", "eps33")),
)


class Ceramic(Section):
    """Piezoelectric ceramic in Voigt order xx yy zz yz xz xy, poled along +z (paper A.2)."""

    density: Density = Field(7700.0, gt=0, description="of the ceramic")
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
    permittivity_at: Literal["stress", "strain"] = Field("stress", description="which is constant")
    tensile_strength: Pressure | None = Field(
        None, gt=0, description="largest principal stress; that of PZT-5H is assumed if absent"
    )
    depoling_field: Annotated[float, si("V/m")] | None = Field(
        None, gt=0, description="largest field against poling; that of PZT-5H is assumed if absent"
    )

    def build(self) -> Material:
        """The ceramic, poled along z; its permittivity is that at constant strain.

        Raises
        ------
        UsageError : stiffness or permittivity is not positive definite, so no such material exists.
        """
        tables = {key: dict(zip(names, getattr(self, key), strict=True)) for key, names in _NAMES}
        table = MaterialTable(
            symmetry="hexagonal",
            stress_coupling=tables.pop("coupling"),
            **tables,
            **self.model_dump(exclude=set(tables) | {"coupling"}),
        )
        return table.build("ceramic", "kick.material")


class ChipMesh(Section):
    """In-plane polar mesh; ``refine`` splits every cell edge, layers included, into that many."""

    refine: Count = Field(1, ge=1, le=6, description="multiplies the cells along each edge")
    order: Literal[1, 2] = Field(1, description="of the elements")
    sectors: Count = Field(10, ge=2, le=180, description="of the quarter circle")
    rings: Count = Field(5, ge=1, le=100, description="contact rings around the centre node")
    ring_spacing: Length = Field(50e-6, gt=0, description="of the contact rings")
    outer_rings: Count = Field(11, ge=1, le=200, description="graded, out to the edge")
    layers_per_element: Count = Field(
        1, ge=1, le=100, description="at most, in elements that grow with their depth below the top"
    )


class ChipDamping(Damping):
    """The ratio is met at a frequency of the paper's chip unless ``at`` says another."""

    at: Frequency | tuple[Frequency, Frequency] | None = Field(
        250e3, description="where the ratio holds"
    )

    @property
    def beta(self) -> float:
        """Stiffness coefficient [s]: ``zeta = beta omega / 2`` at ``omega = 2 pi at``."""
        return self.rayleigh(0.0)[1]


def _from_library(given: object) -> object:
    """A ceramic by its name in the library of materials, as the twelve constants of class 6mm."""
    if not isinstance(given, str):
        return given
    try:
        named = material(given)
    except UsageError as error:
        raise ValueError(str(error)) from None
    C, e, eps = named.C, named.e, named.eps_S / EPSILON_0
    c = C[0, 0], C[0, 1], C[0, 2], C[2, 2], C[3, 3], C[5, 5]
    keys = {
        "density": named.density,
        "stiffness": tuple(map(float, c)),
        "coupling": (float(e[2, 0]), float(e[2, 2]), float(e[0, 4])),
        "permittivity": (float(eps[0, 0]), float(eps[2, 2])),
        "permittivity_at": "strain",
        "tensile_strength": named.tensile_strength,
        "depoling_field": named.depoling_field,
    }
    found = Ceramic(**keys).build()
    same = ((found.C, C), (found.e, e), (found.eps_S, named.eps_S))
    if not named.piezoelectric or any(not np.allclose(a, b, rtol=1e-9) for a, b in same):
        raise ValueError(f"{given} is no ceramic poled along z (class 6mm)")
    return keys


class Cap(Section):
    """A layer without field at one end: the stack's own ceramic, not poled, unless ``material``."""

    thickness: Length = Field(gt=0, description="of the inactive layer")
    material: str | dict[str, Any] | None = Field(
        None, description="name or table; that of the chip unless told"
    )


class Chip(Section):
    """Layered piezoelectric stack, one quarter of it modelled: its cross-section is a square of
    ``side``, a rectangle of ``side`` (x) and ``depth`` (y), or a circle of ``diameter``.

    ``height`` is that of the active layers: ``layers`` times ``layer_thickness`` where it is given.
    ``poling`` along z, the field's axis, makes the stack longer; along x it shears, the rings move
    along x.
    """

    side: Length = Field(3e-3, gt=0, description="width")
    depth: Length | None = Field(None, gt=0, description="the other width; side unless told")
    diameter: Length | None = Field(None, gt=0, description="of a round stack, instead of side")
    height: Length = Field(2e-3, gt=0, description="of all layers")
    layers: Count = Field(33, ge=1, le=400, description="active ones")
    layer_thickness: Length | None = Field(None, gt=0, description="instead of height")
    bottom_cap: Cap | None = None
    top_cap: Cap | None = None
    material: Annotated[Ceramic, BeforeValidator(_from_library)] = Ceramic()
    poling: Literal["z", "x"] = Field("z", description="z makes the stack longer, x shears it")
    mesh: ChipMesh = ChipMesh()
    damping: ChipDamping = ChipDamping()
    mounting: Mounting = Field(
        "roller", description="of the bottom face: roller, glued, free, or stiffness per area N/m3"
    )
    preload_spring: Stiffness | None = Field(
        None, gt=0, description="of the spring that presses evenly on the top face"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Chip:
        if self.diameter is not None and {"side", "depth"} & self.model_fields_set:
            raise ValueError("give diameter, or side and depth")
        if self.layer_thickness is not None:
            height = self.layers * self.layer_thickness
            if "height" in self.model_fields_set and not math.isclose(height, self.height):
                raise ValueError("give height or layer_thickness; height is layers times it")
            object.__setattr__(self, "height", height)
        if self.poling == "x" and self.mounting in ("roller", "free"):
            raise ValueError('a stack that shears needs a mounting that holds it: "glued"')
        return self

    @property
    def half(self) -> tuple[float, float]:
        """Half the extent [m] along x and y."""
        if self.diameter is not None:
            return self.diameter / 2, self.diameter / 2
        return self.side / 2, (self.side if self.depth is None else self.depth) / 2
