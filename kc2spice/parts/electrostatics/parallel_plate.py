"""The part ``parallel_plate``: electrostatic actuator of two plates with a stop."""

from typing import Annotated

from pydantic import Field

from kc2spice.core.quantities import EPSILON_0, Length, Ratio, Stiffness, si
from kc2spice.parts.mechanics import _mechanical_stop
from kc2spice.physics import Declaration, DeclaredPart, displacement, voltage
from kc2spice.scene.parttype import register_part_type


class ParallelPlateKeys(_mechanical_stop.StopKeys):
    """Keys of two parallel plates with the coenergy ``C v^2 / 2``.

    The capacitance is ``C = permittivity * eps0 * area / (gap - x)``. A voltage therefore increases
    the displacement x. If a spring of stiffness ``k`` supports the plate, the pull-in voltage is
    ``sqrt(8 * k * gap^3 / (27 * eps * area))`` with ``eps = permittivity * eps0``.
    """

    area: Annotated[float, si("m2")] = Field(gt=0, description="Area of each of the two plates")
    gap: Length = Field(gt=0, description="Distance between the plates at the displacement x = 0")
    permittivity: Ratio = Field(
        1.0, gt=0, description="Relative permittivity of the medium between the plates"
    )
    travel: Length = Field(
        gt=0,
        description=(
            "Displacement x at which the moving plate hits its stop; must be less than the "
            "key `gap`"
        ),
    )
    stop: Stiffness = Field(1e5, gt=0, description="Stiffness of the stop of the moving plate")


register_part_type(
    DeclaredPart(
        Declaration(
            "parallel_plate",
            "electrostatic actuator of two parallel plates, with a stop",
            ParallelPlateKeys,
            (voltage("v", "plus", "minus"), displacement("x", "a", "b")),
            constants={"eps0": repr(EPSILON_0)} | _mechanical_stop.STOP_CONSTANTS,
            energy=_mechanical_stop.write_stop_energy("x - travel"),
            stops={"the stop": "x - travel"},
            forces={"x": _mechanical_stop.write_stop_loss("x - travel", "x_rate")},
            coenergy="0.5*eps0*permittivity*area*v^2/(gap - x)",
            limits={"the gap": "gap - x"},
            neglected=(
                (
                    "fringing field",
                    "the plates are treated as infinite",
                    "of the order of gap / width",
                ),
                (
                    "squeeze-film damping",
                    "no gas film; a damper between a and b can represent it",
                    "not estimated",
                ),
                _mechanical_stop.STOP_NEGLECTED,
            ),
            rating=(
                "not known; compare the field v / (gap - x) with the breakdown field of the medium "
                "in the gap"
            ),
        )
    )
)
