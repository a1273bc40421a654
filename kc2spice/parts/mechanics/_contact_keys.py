"""Keys of a contact, in a separate module because the parts on both sides also use them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from kc2spice.core.quantities import (
    Length,
    Pressure,
    Ratio,
    RefinementRule,
    Rings,
    Section,
    Stiffness,
    Velocity,
    si,
)

# Largest permitted stiffness [N/m] of a contact spring.
# A mass of one gram on such a spring vibrates at 160 MHz, far above all frequencies of a run.
MAX_STIFFNESS = 1e15


class ContactKeys(Section):
    """Keys of a penalty contact with a spring at each port of its side ``a`` (paper, eq. 10)."""

    penalty: Stiffness = Field(
        1e8,
        gt=0,
        le=MAX_STIFFNESS,
        description="Penalty stiffness of one ring in one symmetry sector",
    )
    rings: Rings = Field(
        "needed",
        description=(
            "Contact rings in the model: needed (rings that can touch), all, or the number "
            "of rings from the centre"
        ),
    )
    a: str | tuple[str, ...] | None = Field(
        None,
        description=(
            "Lower side of the contact, whose upward motion closes the gap: a body, its ports, "
            "or gnd; by default the only body"
        ),
    )
    b: str | None = Field(
        None,
        description=(
            "Upper side of the contact, whose upward motion opens the gap: a sphere, a port of "
            "a body, or gnd; by default the only sphere"
        ),
    )
    gap: Length = Field(0.0, description="Gap at rest, in addition to the gap of the geometry")
    inertia: Literal["massless", "lumped"] = Field(
        "massless",
        description=(
            "Inertia at the contact ports: none (massless), or one mass for each port (lumped)"
        ),
    )
    shape: Literal["rings", "pressure"] = Field(
        "rings",
        description=(
            "Contact ports of the chip: rings of mesh nodes, or pressure basis functions under "
            "a sphere"
        ),
    )
    spacing: Annotated[Length, RefinementRule(0.5, model=True, when=(("shape", "pressure"),))] = (
        Field(10e-6, gt=0, description="Radial spacing of the pressure basis functions (P1)")
    )
    law: Literal["linear", "hertz"] = Field(
        "linear",
        description=(
            "Contact law: penalty * indentation, or for a sphere at one port the law of Hertz, "
            "4/3 E* sqrt(R) x^(3/2)"
        ),
    )
    modulus: Pressure | None = Field(
        None,
        gt=0,
        description=(
            "Effective modulus E* of both sides for law = hertz; by default computed from their "
            "materials"
        ),
    )
    groove: Ratio | None = Field(
        None,
        gt=0,
        le=180,
        description="Opening angle in degrees of a groove in side a, in which side b lies",
    )
    damping: Annotated[float, si("s/m")] = Field(
        0.0,
        ge=0,
        description=(
            "Damping coefficient of Hunt and Crossley: the force is multiplied by 1 + damping * "
            "(closing speed)"
        ),
    )
    friction: Ratio = Field(
        0.0,
        ge=0,
        description=(
            "Coulomb friction coefficient between the pins `slide` and `rail`, equal on "
            "both flanks of a groove"
        ),
    )
    creep: Velocity = Field(
        1e-4,
        gt=0,
        description=("Sliding speed below which friction is viscous, which approximates sticking"),
    )
