"""The part ``comb_drive``: electrostatic comb drive with a stop."""

from pydantic import Field

from kc2spice.core.quantities import EPSILON_0, Dimension, Ratio, Stiffness
from kc2spice.parts.mechanics import _mechanical_stop
from kc2spice.physics import Declaration, DeclaredPart, displacement, voltage
from kc2spice.scene.parttype import register_part_type


class CombDriveKeys(_mechanical_stop.StopKeys):
    """Keys of an electrostatic comb drive.

    The capacitance of the comb drive is ``C = 2 * fingers * eps0 * thickness * (overlap + x) /
    gap``. The force ``fingers * eps0 * thickness * v^2 / gap`` does not depend on the displacement
    x.
    """

    fingers: Ratio = Field(
        examples=["50"],
        gt=0,
        description=(
            "Number of fingers of the moving comb, each of which lies between two fixed fingers"
        ),
    )
    thickness: Dimension = Field(
        gt=0,
        description=(
            "Thickness of the fingers, perpendicular to their motion and to the gap between "
            "the fingers"
        ),
    )
    gap: Dimension = Field(
        gt=0, description="Width of the gap between neighbouring fingers of the two combs"
    )
    overlap: Dimension = Field(
        gt=0, description="Overlap length of moving and fixed fingers at the displacement x = 0"
    )
    travel: Dimension = Field(
        gt=0, description="Displacement x at which the moving comb hits its stop"
    )
    stop: Stiffness = Field(1e4, gt=0, description="Stiffness of the stop of the moving comb")


register_part_type(
    DeclaredPart(
        Declaration(
            "comb_drive",
            "electrostatic comb drive, with a stop",
            CombDriveKeys,
            (voltage("v", "plus", "minus"), displacement("x", "a", "b")),
            constants={"eps0": repr(EPSILON_0)} | _mechanical_stop.STOP_CONSTANTS,
            energy=_mechanical_stop.write_stop_energy("x - travel"),
            stops={"the stop": "x - travel"},
            forces={"x": _mechanical_stop.write_stop_loss("x - travel", "x_rate")},
            coenergy="fingers*eps0*thickness*(overlap + x)*v^2/gap",
            limits={"the overlap": "overlap + x"},
            remedies={"the overlap": "the two combs no longer overlap: raise the key PART.overlap"},
            neglected=(
                (
                    "fringing field",
                    "only the field between overlapping fingers is modelled",
                    "of the order of gap / thickness",
                ),
                (
                    "sideways pull-in",
                    "the fingers stay in the middle of their gaps",
                    "not estimated",
                ),
                _mechanical_stop.STOP_NEGLECTED,
            ),
            rating=(
                "not known; compare the field v / gap with the breakdown field of the medium in "
                "the gap"
            ),
        )
    )
)
