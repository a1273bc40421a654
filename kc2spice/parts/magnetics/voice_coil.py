"""The part ``voice_coil``: voice coil and suspension for large strokes.

Force factor and compliance depend on the displacement.
"""

from typing import Annotated

from pydantic import Field

from kc2spice.core.quantities import CoilInductance, MechanicalDamping, Resistance, si
from kc2spice.fem.thermal_materials import find_resistance_coefficient
from kc2spice.physics import Declaration, DeclaredPart, current, displacement
from kc2spice.physics.conductors import ConductorKeys
from kc2spice.physics.declaration import HEATING
from kc2spice.scene.parttype import register_part_type


class VoiceCoilKeys(ConductorKeys):
    """Keys of a voice coil and its suspension.

    For the displacement x, the force factor is ``Bl(x) = bl + bl1 x + bl2 x^2``, and the compliance
    is ``Cms(x) = cms + cms1 x + cms2 x^2``. The force of the coil is ``Bl(x) i``, the force of the
    suspension is ``x / Cms(x)``, and the voltage of the coil is ``resistance i + inductance i' +
    Bl(x) x'`` (W. Klippel, J. Audio Eng. Soc. 54 (2006) 907).
    """

    resistance: Resistance = Field(gt=0, description="Electrical resistance of the voice coil")
    inductance: CoilInductance = Field(gt=0, description="Inductance of the voice coil")
    bl: Annotated[float, si("N/A")] = Field(
        description="Force factor Bl of the voice coil at the displacement x = 0"
    )
    bl1: Annotated[float, si("N/(A m)")] = Field(
        0.0,
        description=(
            "Derivative of the voice coil's force factor with respect to the displacement x, "
            "at x = 0"
        ),
    )
    bl2: Annotated[float, si("N/(A m2)")] = Field(
        0.0,
        description=(
            "Coefficient of x^2 in the voice coil's force factor, where x is the displacement"
        ),
    )
    cms: Annotated[float, si("m/N")] = Field(
        gt=0, description="Compliance of the suspension at the displacement x = 0"
    )
    cms1: Annotated[float, si("1/N")] = Field(
        0.0,
        description=(
            "Derivative of the suspension's compliance with respect to the displacement x, at x = 0"
        ),
    )
    cms2: Annotated[float, si("1/(N m)")] = Field(
        0.0,
        description=(
            "Coefficient of x^2 in the suspension's compliance, where x is the displacement"
        ),
    )
    damping: MechanicalDamping = Field(
        0.0, ge=0, description="Viscous damping coefficient of the suspension"
    )


register_part_type(
    DeclaredPart(
        Declaration(
            "voice_coil",
            "voice coil with displacement-dependent force factor and compliance",
            VoiceCoilKeys,
            (current("i", "plus", "minus"), displacement("x", "a", "b")),
            energy="integral(x/(cms + cms1*x + cms2*x^2), x)",
            coenergy="0.5*inductance*i^2 + i*(bl*x + bl1*x^2/2 + bl2*x^3/3)",
            content="0.5*resistance*i^2 + 0.5*damping*x_rate^2",
            limits={"the compliance": "cms + cms1*x + cms2*x^2"},
            remedies={
                "the compliance": "the keys cms1 and cms2 of PART are not valid at this large "
                "displacement: lower the drive, or set cms1 = 0 and cms2 = 0"
            },
            neglected=(
                (
                    "dependence of the inductance on the displacement",
                    "the inductance is constant",
                    "not estimated; its gradient causes a force proportional to i^2",
                ),
                (HEATING, "the resistance is constant", "0.4 % per kelvin for copper"),
                (
                    "mass of coil and cone",
                    "represented by a separate part `mass` at the pin `a`",
                    "none if the scene contains this part",
                ),
            ),
            conductors=("i",),
            temperature_coefficient=find_resistance_coefficient("copper"),
            rating="not known; the coil is heated by the power i^2 * resistance",
        )
    )
)
