"""Keys of a contact.

The keys are in a separate module, because the parts on both sides of a contact also use these keys.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from kc2spice.core.quantities import (
    Length,
    PlausibleRange,
    Pressure,
    Ratio,
    RefinementRule,
    Rings,
    Section,
    Stiffness,
    Velocity,
    si,
)
from kc2spice.fem.material_limits import MAX_STIFFNESS as HIGHEST_MODULUS
from kc2spice.fem.material_limits import MIN_STIFFNESS

_PLAUSIBLE_MODULUS = PlausibleRange(
    "Pa",
    MIN_STIFFNESS,
    HIGHEST_MODULUS,
    "moduli are between those of soft gels and twice that of diamond",
)
# Largest permitted stiffness [N/m] of a contact spring.
# A mass of 1 g on a spring of 1e15 N/m vibrates at 160 MHz, far above all frequencies of a run.
MAX_STIFFNESS = 1e15


class ContactKeys(Section):
    """Keys of a contact with penalty springs, one at each port of the lower side."""

    penalty: Stiffness = Field(
        1e8,
        gt=0,
        le=MAX_STIFFNESS,
        description=(
            "Penalty stiffness (contact stiffness) of one contact ring in one symmetry "
            "sector of the body"
        ),
    )
    rings: Rings = Field(
        "needed",
        description=(
            "Contact rings in the model: `needed` selects the rings that can touch, `all` "
            "selects all rings, and a number N selects the N rings nearest to the centre"
        ),
    )
    a: str | tuple[str, ...] | None = Field(
        None,
        description=(
            "Lower side of the contact: a body, ports of a body, or gnd; by default the "
            "only body. Upward motion of this side closes the gap"
        ),
    )
    b: str | None = Field(
        None,
        description=(
            "Upper side of the contact: a sphere, a port of a body, or gnd; by default the "
            "only sphere. Upward motion of this side opens the gap"
        ),
    )
    gap: Length = Field(
        0.0,
        description=(
            "Additional gap of the contact at rest, added to the distance between the surfaces in "
            "the geometry"
        ),
    )
    inertia: Literal["massless", "lumped"] = Field(
        "massless",
        description=(
            "Inertia at the contact ports: none (massless), or a separate mass at each port "
            "(lumped)"
        ),
    )
    shape: Literal["rings", "pressure"] = Field(
        "rings",
        description=(
            "Contact ports of the body: rings of mesh nodes (rings), or basis functions "
            "of the contact pressure under a sphere (pressure)"
        ),
    )
    spacing: Annotated[Length, RefinementRule(0.5, model=True, when=(("shape", "pressure"),))] = (
        Field(
            10e-6,
            gt=0,
            description=(
                "Radial spacing of the piecewise linear (P1) basis functions of the contact "
                "pressure"
            ),
        )
    )
    law: Literal["linear", "hertz"] = Field(
        "linear",
        description=(
            "Contact law: linear with force = penalty * indentation, or hertz (sphere at "
            "one port) with force = 4/3 E* sqrt(R) indentation^(3/2)"
        ),
    )
    modulus: Annotated[Pressure, _PLAUSIBLE_MODULUS] | None = Field(
        None,
        gt=0,
        description=(
            "Effective elastic modulus E* of both contact sides for law = hertz; by default "
            "computed from the materials of both sides"
        ),
    )
    groove: Ratio | None = Field(
        None,
        gt=0,
        le=180,
        description=(
            "Opening angle in degrees of the groove in side `a`, which guides side `b` of "
            "the contact"
        ),
    )
    damping: Annotated[float, si("s/m")] = Field(
        0.0,
        ge=0,
        description=(
            "Hunt-Crossley damping coefficient: the contact force is multiplied by 1 "
            "+ damping * (closing speed)"
        ),
    )
    friction: Ratio = Field(
        0.0,
        ge=0,
        description=(
            "Coulomb friction coefficient for sliding of the part at the pin `slide` along the "
            "part at the pin `rail`; the same coefficient applies to both flanks of a groove"
        ),
    )
    creep: Velocity = Field(
        1e-4,
        gt=0,
        description=(
            "Sliding speed below which the friction force is viscous, as an approximation of "
            "sticking"
        ),
    )
