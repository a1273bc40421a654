"""The part ``cubic_spring``: a spring whose force has a cubic term."""

from typing import Annotated

from pydantic import Field

from kc2spice.core.quantities import Section, Stiffness, si
from kc2spice.physics import Declaration, DeclaredPart, displacement
from kc2spice.scene.parttype import register_part_type


class CubicSpringKeys(Section):
    """Keys of a spring with the force ``F = stiffness x + cubic x^3``.

    A negative ``cubic`` softens the spring.
    """

    stiffness: Stiffness = Field(
        gt=0,
        description=(
            "Stiffness of the spring at small elongation, the linear coefficient of the "
            "spring force"
        ),
    )
    cubic: Annotated[float, si("N/m3")] = Field(
        0.0,
        description=(
            "Cubic coefficient in the spring force stiffness x + cubic x^3, where x is the "
            "elongation"
        ),
    )


register_part_type(
    DeclaredPart(
        Declaration(
            "cubic_spring",
            "spring with a cubic term between two displacement pins",
            CubicSpringKeys,
            (displacement("x", "a", "b"),),
            energy="0.5*stiffness*x^2 + 0.25*cubic*x^4",
            limits={"the tangent stiffness": "stiffness + 3*cubic*x^2"},
            remedies={
                "the tangent stiffness": "the spring has a negative tangent stiffness at this "
                "elongation: lower the load, or raise the key PART.cubic towards 0"
            },
            neglected=(("mass of the spring", "the spring is massless", "not estimated"),),
        )
    )
)
