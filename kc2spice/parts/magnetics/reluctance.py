"""The part ``reluctance``: magnet or coil that pulls iron across air gaps.

A part of type ``reluctance`` represents the magnetic circuit of a relay, valve or holding magnet.
"""

from typing import Annotated

from pydantic import Field

from kc2spice.core.quantities import MU_0, Current, Dimension, Ratio, Resistance, Stiffness, si
from kc2spice.fem.thermal_materials import find_resistance_coefficient
from kc2spice.parts.mechanics import _mechanical_stop
from kc2spice.physics import Declaration, DeclaredPart, current, displacement
from kc2spice.physics.conductors import ConductorKeys
from kc2spice.scene.parttype import register_part_type


class ReluctanceKeys(ConductorKeys, _mechanical_stop.StopKeys):
    """Keys of a magnetic circuit that attracts an iron armature.

    The flux is ``(turns * i + magnet) / (core + gaps * (gap - x) / (MU_0 * area))`` with the
    current i and the displacement x. With ``gaps`` air gaps, the flux causes the force ``gaps *
    flux^2 / (2 * MU_0 * area)`` in the direction of the displacement x. The result ``PART.force``
    has the opposite sign, because it is the force of the other parts on the armature. A permanent
    magnet of length l and area A has the magnetomotive force ``magnet = remanence * l / (MU_0 *
    mu_r)``. The key ``core`` must include the reluctance ``l / (MU_0 * mu_r * A)`` of the magnet.
    """

    area: Annotated[float, si("m2")] = Field(
        gt=0, description="Cross-sectional area of each air gap in the magnetic circuit"
    )
    gap: Dimension = Field(
        gt=0, description="Length of each air gap at the displacement x = 0 of the armature"
    )
    gaps: Ratio = Field(
        1.0, gt=0, description="Number of air gaps in series in the magnetic circuit"
    )
    core: Annotated[float, si("1/H")] = Field(
        0.0, ge=0, description="Reluctance of the magnetic circuit without the air gaps"
    )
    magnet: Current = Field(
        0.0,
        description=(
            "Magnetomotive force of the permanent magnets in the magnetic circuit, in ampere turns"
        ),
    )
    turns: Ratio = Field(1.0, gt=0, description="Number of turns of the coil")
    resistance: Resistance = Field(gt=0, description="Electrical resistance of the coil")
    travel: Dimension = Field(
        gt=0,
        description=(
            "Displacement x at which the armature hits its stop; must be less than the key `gap`"
        ),
    )
    stop: Stiffness = Field(1e7, gt=0, description="Stiffness of the stop of the armature")


register_part_type(
    DeclaredPart(
        Declaration(
            "reluctance",
            "magnet or coil that pulls iron across air gaps, with a stop",
            ReluctanceKeys,
            (current("i", "plus", "minus"), displacement("x", "a", "b")),
            constants={"mu0": repr(MU_0)} | _mechanical_stop.STOP_CONSTANTS,
            energy=_mechanical_stop.write_stop_energy("x - travel"),
            stops={"the stop": "x - travel"},
            forces={"x": _mechanical_stop.write_stop_loss("x - travel", "x_rate")},
            coenergy="0.5*(turns*i + magnet)^2/(core + gaps*(gap - x)/(mu0*area))",
            content="0.5*resistance*i^2",
            limits={"the gap": "gap - x"},
            remedies={
                "the gap": "the armature moves beyond its stop and closes the gap: raise the key "
                "PART.stop, the stiffness of the stop",
            },
            neglected=(
                ("saturation and hysteresis", "the core is linear", "compare flux / area with 1 T"),
                ("leakage, fringing", "all flux crosses the gaps", "of the order of gap / width"),
                (
                    "eddy currents in the core",
                    "the flux follows the magnetomotive force without delay",
                    "not estimated",
                ),
                _mechanical_stop.STOP_NEGLECTED,
            ),
            conductors=("i",),
            temperature_coefficient=find_resistance_coefficient("copper"),
            rating="not known; the coil is heated by the power i^2 * resistance",
            example="""
[reluctance]
part = "reluctance"
area = "20 mm2"
gap = "1 mm"
core = 1e6
turns = 1000
resistance = "100 Ohm"
travel = "0.8 mm"
pins = { plus = "drive.out", a = "spring.a" }

[spring]
part = "spring"
stiffness = "500 N/m"

[drive]
part = "source"
dc = "3 V"
""",
        )
    )
)
