"""Keys of the multilayer chip: mesh, damping and geometry (Schütz et al. 2021)."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Any, Literal

from pydantic import Field, model_validator

from kc2spice.core.errors import UsageError
from kc2spice.core.key_actions import ChangeKey, DeleteKey
from kc2spice.core.quantities import (
    Count,
    Extent,
    Frequency,
    Length,
    Mounting,
    Section,
    Stiffness,
    Thickness,
    Width,
    make_invalid_value_error,
)
from kc2spice.fem.body_keys import DampingKeys
from kc2spice.fem.materials import Material, find_material

SECTORS = 4  # number of equal quarters of the chip; the mesh contains only one quarter
MAX_RINGS = 100  # largest number of contact rings
PATCH_PORT = "patch"  # name of the port that replaces the ring ports if a pressure is given
PAPER_CERAMIC = "THP51"  # ceramic of the chip in Schütz et al. (2021)


class StackMeshKeys(Section):
    """Keys of a stack's mesh, which has rings and sectors in the plane of the layers.

    The key ``refine`` is the number of equal parts into which each edge of a cell is divided, also
    along the height.
    """

    refine: Count = Field(
        1,
        ge=1,
        le=6,
        description=(
            "Refinement factor of the stack's mesh: number of equal parts into which each "
            "cell edge is divided"
        ),
    )
    order: Literal[1, 2] = Field(
        1, description="Polynomial order of the finite elements of the stack"
    )
    sectors: Count = Field(
        10,
        ge=2,
        le=180,
        description="Number of mesh sectors around the axis in the modelled quarter of the stack",
    )
    rings: Count = Field(
        5,
        ge=1,
        le=MAX_RINGS,
        description=(
            "Number of rings of mesh nodes around the centre of the top face at which a contact "
            "can act"
        ),
    )
    ring_spacing: Length = Field(
        50e-6, gt=0, description="Radial spacing of the contact rings of mesh nodes on the top face"
    )
    outer_rings: Count = Field(
        11,
        ge=1,
        le=200,
        description=(
            "Number of mesh rings between the finely meshed contact area and the edge of the "
            "stack; the spacing of these rings increases outwards"
        ),
    )
    layers_per_element: Count = Field(
        1,
        ge=1,
        le=100,
        description=(
            "Largest number of ceramic layers in one finite element; elements near the top "
            "face may contain fewer layers"
        ),
    )

    @model_validator(mode="after")
    def _require_even_sectors(self) -> StackMeshKeys:
        """Reject an odd number of mesh sectors."""
        if self.sectors % 2:
            raise make_invalid_value_error(
                "sectors must be an even number, so that a mesh line meets the corner of the chip",
                None,
                hint=f"write sectors = {self.sectors + 1}",
            )
        return self


class ChipDamping(DampingKeys):
    """Keys of the damping of a piezoelectric chip.

    The damping ratio applies at the frequency ``at``. By default, the damping ratio applies at 250
    kHz, as for the chip of Schütz et al. (2021).
    """

    at: Frequency | tuple[Frequency, Frequency] | None = Field(
        250e3,
        description=(
            "Frequency at which the damping ratio of the stack applies, or two frequencies "
            "for two damping ratios"
        ),
    )

    @property
    def beta(self) -> float:
        """Stiffness coefficient ``beta`` [s] of a piezoelectric chip's Rayleigh damping.

        At the frequency ``at``, the damping ratio is ``zeta = beta omega / 2`` with the angular
        frequency omega.
        """
        return self.compute_rayleigh_factors(0.0)[1]


class Cap(Section):
    """Inactive layer (without electric field) at the bottom or the top of a stack.

    By default, the layer consists of the unpoled ceramic of the stack.
    """

    thickness: Thickness = Field(
        gt=0,
        description=(
            "Thickness of one inactive layer, without electric field: the bottom layer of the "
            "stack in `bottom_cap`, the top layer in `top_cap`"
        ),
    )
    material: str | dict[str, Any] | None = Field(
        None,
        description=(
            "Material of the inactive layer at an end of the stack, a name or a table; by "
            "default the unpoled ceramic of the stack"
        ),
    )


DEFAULT_HEIGHT = 2e-3  # m, height of the stack in Schütz et al. (2021)


def _compute_default_height(keys: dict[str, Any]) -> float:
    """Compute the default of the total height [m] of a stack's active layers.

    If ``layers`` and ``layer_thickness`` are given, the height is the product of both.
    """
    layers, thickness = keys.get("layers"), keys.get("layer_thickness")
    return DEFAULT_HEIGHT if layers is None or thickness is None else float(layers * thickness)


class StackKeys(Section):
    """Keys of a layered piezoelectric stack, of which one quarter is modelled.

    The cross-section of the stack is a square with the side ``side``, a rectangle ``side`` (x)
    times ``depth`` (y), or a circle with the ``diameter``. ``height`` is the total height of all
    active layers. If ``layer_thickness`` is given, the height is ``layers`` times
    ``layer_thickness``. The electric field is along z. A positive voltage lengthens a stack that is
    poled along z. A voltage shears a stack that is poled along x, so its contact rings move along
    x.
    """

    side: Width = Field(3e-3, gt=0, description="Width of a rectangular stack along x")
    depth: Width | None = Field(
        None, gt=0, description="Width of a rectangular stack along y; by default equal to `side`"
    )
    diameter: Width | None = Field(
        None,
        gt=0,
        description=(
            "Diameter of a round stack; cannot be combined with the keys `side` and `depth`"
        ),
    )
    layers: Count = Field(
        33, ge=1, le=400, description="Number of active ceramic layers in the stack"
    )
    layer_thickness: Length | None = Field(
        None,
        gt=0,
        description=(
            "Thickness of one active ceramic layer; cannot be combined with the key `height`"
        ),
    )
    height: Extent = Field(
        default_factory=_compute_default_height,
        gt=0,
        description=(
            "Total height of all active layers; by default `layers` times `layer_thickness`, "
            "or 2 mm without `layer_thickness`"
        ),
    )
    bottom_cap: Cap | None = None
    top_cap: Cap | None = None
    material: str | dict[str, Any] = Field(
        PAPER_CERAMIC,
        description=(
            "Ceramic of the stack: the name of a ceramic poled along z, or a table of the "
            "properties that differ from THP51"
        ),
    )
    poling: Literal["z", "x"] = Field(
        "z",
        description=(
            "Poling direction of the ceramic: z for a stack that elongates, x for a stack "
            "that shears"
        ),
    )
    mesh: StackMeshKeys = StackMeshKeys()
    damping: ChipDamping = ChipDamping()
    mounting: Mounting = Field(
        "roller",
        description=(
            "Support of the bottom face of the stack: roller, glued, free, or a stiffness "
            "per area in N/m3"
        ),
    )
    preload_spring: Stiffness | None = Field(
        None,
        gt=0,
        description=(
            "Stiffness of the preload spring, whose force is distributed evenly over the top "
            "face of the stack"
        ),
    )

    @model_validator(mode="after")
    def _require_consistent_keys(self) -> StackKeys:
        """Reject contradictory keys of a stack."""
        if self.diameter is not None and {"side", "depth"} & self.model_fields_set:
            raise make_invalid_value_error(
                "the stack has two sizes: the key `diameter`, and the key `side` or `depth`",
                None,
                hint="delete the keys `side` and `depth`, or delete the key `diameter`",
            )
        if self.layer_thickness is not None:
            height = self.layers * self.layer_thickness
            if not math.isclose(height, self.height):
                raise make_invalid_value_error(
                    "write height or layer_thickness, not both: height = layers * layer_thickness",
                    None,
                    hint=DeleteKey("height"),
                )
        outermost, half = self.mesh.rings * self.mesh.ring_spacing, min(self.half_widths)
        if outermost > half * (1 - 1e-6):
            fitting = int(half * (1 - 1e-6) // self.mesh.ring_spacing)
            spacing = float(f"{0.9 * half / self.mesh.rings:.2g}")
            hint = ChangeKey("lower", "mesh.rings", "to", str(fitting))
            if not fitting:
                hint = ChangeKey("lower", "mesh.ring_spacing", "to", f"{spacing:g} m")
            raise make_invalid_value_error(
                (
                    f"mesh.rings: a contact ring of radius {outermost:g} m does not fit on the "
                    f"chip; half of the smaller side is {half:g} m"
                ),
                None,
                hint=hint,
            )
        if self.poling == "x" and self.mounting in ("roller", "free"):
            raise make_invalid_value_error(
                'poling = "x" needs mounting = "glued"', None, hint='write  mounting = "glued"'
            )
        try:
            _ = self.ceramic
        except UsageError as error:
            raise make_invalid_value_error(
                error.message, error.expected, "material", error.next_action
            ) from None
        return self

    @cached_property
    def ceramic(self) -> Material:
        """Ceramic material of the layers, poled along z.

        Raises
        ------
        UsageError : the material does not exist, or is not isotropic about z.
        """
        table = self.material
        if not isinstance(table, str):
            table = {"like": PAPER_CERAMIC, **table}
        result = find_material(table)
        if result.conductor or not result.is_isotropic_about_z:
            raise UsageError(
                f"{result.name} is not a ceramic with poling along z (class 6mm)",
                expected="a ceramic such as THP51 or PZT-5A",
                hint='write  material = "PZT-5A"',
            )
        return replace(result, name="ceramic")

    @property
    def half_widths(self) -> tuple[float, float]:
        """Half of the stack's widths along x and y [m]."""
        if self.diameter is not None:
            return self.diameter / 2, self.diameter / 2
        return self.side / 2, (self.side if self.depth is None else self.depth) / 2
