"""The part ``diaphragm``: a rigid diaphragm that turns motion into sound.

The diaphragm has the area S and the mass m. The pin ``a`` has the velocity v relative to the pin
``b``, and the two sides have the pressures p_front and p_rear::

    U = S v                                  volume velocity out of the pin front, into the pin rear
    F = m dv/dt + S (p_front - p_rear)       force on the pin a

The area is the transformation ratio of an ideal transformer between the mechanical and the acoustic
network (L. L. Beranek, T. J. Mellow, Acoustics: Sound Fields and Transducers, 2012, section 3.5).
"""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from kc2spice.core.figure import Figure
from kc2spice.core.quantities import Mass, Section, si
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import make_positive_parameter
from kc2spice.parts.acoustics._displacement_figure import plot_displacements
from kc2spice.parts.acoustics._fluids import LARGEST_AREA, SMALLEST_AREA
from kc2spice.physics import Declaration, branch, displacement
from kc2spice.physics.part_with_mass import DeclaredPartWithMass
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import BuiltScene, Part, WiredScene


class DiaphragmKeys(Section):
    """Keys of a rigid diaphragm: its area and its mass."""

    area: Annotated[float, si("m2")] = Field(
        ge=SMALLEST_AREA,
        le=LARGEST_AREA,
        description="Area of the diaphragm, projected onto the plane normal to its motion",
    )
    mass: Mass = Field(
        gt=0, description="Mass of the diaphragm, without the mass of the moving air"
    )


DIAPHRAGM = Declaration(
    "diaphragm",
    "rigid diaphragm or cone that turns motion into sound",
    DiaphragmKeys,
    (displacement("x", "a", "b"), branch("pressure", "p", "front", "rear", "flow")),
    coenergy="-area*x*p",
    neglected=(
        ("bending of the diaphragm", "all its points have the same velocity", "not estimated"),
        ("weight of the diaphragm", "it only shifts the rest position", "no effect on sound"),
    ),
    example="""
        [cone]
        part = "diaphragm"
        area = "1 cm2"
        mass = "0.1 g"
        pins = { a = "push.out", front = "air.face" }

        [air]
        part = "radiation"
        area = "1 cm2"

        [push]
        part = "source"
        kind = "force"
        ac = "1 N"

        [analysis]
        type = "ac"
        start = "100 Hz"
        stop = "20 kHz"
    """,
    rating="not checked; the equations hold for small amplitudes only",
    sign="um is the displacement of a minus that of b; N acts in the same direction; a positive "
    "displacement pushes fluid out of front and draws it in at rear",
    velocities={"x": "speed_m"},
)


class Diaphragm(DeclaredPartWithMass[DiaphragmKeys]):
    """Part type ``diaphragm``: rigid diaphragm or cone that turns motion into sound."""

    moving_pins = ("a", "b")

    def declare_mass(self, part: Part[DiaphragmKeys], scene: WiredScene) -> Declaration:
        """Return the declaration of the diaphragm's mass."""
        return Declaration(
            "mass",
            "mass of the diaphragm",
            Section,
            (displacement("m", *self.moving_pins),),
            kinetic="0.5*mass*m_rate^2",
            starts={"m": ("0", "0")},
            given=(make_positive_parameter("mass", part.keys.mass, "kg", "mass of the diaphragm"),),
        )

    def figures(
        self, part: Part[DiaphragmKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Figure]:
        """Yield the chart of the diaphragm's displacement."""
        x = waves.data.get(f"{part.name}.x")
        if x is not None:
            caption = "Displacement of the diaphragm."
            yield from plot_displacements(part.name, waves, {"": x}, caption)


register_part_type(Diaphragm(DIAPHRAGM))
