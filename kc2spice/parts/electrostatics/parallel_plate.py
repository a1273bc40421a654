"""The part ``parallel_plate``: electrostatic actuator of two plates with a stop."""

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import EPSILON_0, Dimension, Ratio, Stiffness, si
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.electrostatics import _closing_gap
from kc2spice.parts.mechanics import _mechanical_stop
from kc2spice.physics import Declaration, DeclaredPart, displacement, voltage
from kc2spice.scene.part_records import NeglectedEffect
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import BuiltScene, GovernedScene, Part, Scene


class ParallelPlateKeys(_mechanical_stop.StopKeys):
    """Keys of two parallel plates with the coenergy ``C v^2 / 2``.

    The capacitance is ``C = permittivity * eps0 * area / (gap - x)``. A voltage therefore increases
    the displacement x. If a spring of stiffness ``k`` supports the plate, the pull-in voltage is
    ``sqrt(8 * k * gap^3 / (27 * eps * area))`` with ``eps = permittivity * eps0``.
    """

    area: Annotated[float, si("m2")] = Field(gt=0, description="Area of each of the two plates")
    gap: Dimension = Field(
        gt=0, description="Distance between the plates at the displacement x = 0"
    )
    permittivity: Ratio = Field(
        1.0, gt=0, description="Relative permittivity of the medium between the plates"
    )
    travel: Dimension = Field(
        gt=0,
        description=(
            "Displacement x at which the moving plate hits its stop; must be less than the "
            "key `gap`"
        ),
    )
    stop: Stiffness = Field(1e5, gt=0, description="Stiffness of the stop of the moving plate")


class ParallelPlate(DeclaredPart[ParallelPlateKeys]):
    """Part type ``parallel_plate``: two parallel plates that attract each other."""

    def problems(self, part: Part[ParallelPlateKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from super().problems(part, scene)
        yield from _closing_gap.list_travel_errors(part)

    def checks(
        self, part: Part[ParallelPlateKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Any]:
        """Yield the checks of the part after a run."""
        if "frequency" not in waves:
            recorded = self._list_recorded_waves(part, build, waves)
            yield from _closing_gap.check_stop_indentation(
                part, self.declare_built_part(part, build), recorded
            )
        yield from super().checks(part, build, waves)

    def list_neglected_effects(
        self, part: Part[ParallelPlateKeys], scene: Scene
    ) -> Iterator[NeglectedEffect]:
        """Yield the effects that the model of a part neglects."""
        yield from super().list_neglected_effects(part, scene)
        yield from _closing_gap.list_ramp_effects(scene)


register_part_type(
    ParallelPlate(
        Declaration(
            "parallel_plate",
            "electrostatic actuator of two parallel plates, with a stop",
            ParallelPlateKeys,
            (voltage("v", "plus", "minus"), displacement("x", "a", "b")),
            constants={
                "eps0": repr(EPSILON_0),
                "least": f"{_closing_gap.LEAST_SHARE}*(gap - travel)",
                **_mechanical_stop.STOP_CONSTANTS,
            },
            energy=_mechanical_stop.write_stop_energy("x - travel"),
            stops={"the stop": "x - travel"},
            forces={"x": _mechanical_stop.write_stop_loss("x - travel", "x_rate")},
            coenergy="0.5*eps0*permittivity*area*v^2*"
            + _closing_gap.write_inverse_gap("(gap - x)", "least"),
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
