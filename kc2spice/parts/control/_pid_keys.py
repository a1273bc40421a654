"""Keys of a PID controller, in a separate module because other part types also use them."""

from __future__ import annotations

from itertools import product
from typing import Annotated, Literal

from pydantic import Field

from kc2spice.core.quantities import Current, Length, Section, Time, si


class Control(Section):
    """Keys of a PID controller with limited output, see section 2.4 of the paper.

    The controller drives opposite currents of equal magnitude through both coils.
    """

    setpoint: Length = Field(2.5e-3, description="Set point of the sphere's height")
    kp: Annotated[float, si("A/m")] = Field(
        5e4, ge=0, description="Proportional gain of the controller"
    )
    ki: Annotated[float, si("A/(m s)")] = Field(
        10.0, ge=0, description="Integral gain of the controller"
    )
    kd: Annotated[float, si("A s/m")] = Field(
        20.0, ge=0, description="Derivative gain of the controller"
    )
    rolloff: Time = Field(100e-9, gt=0, description="Time constant of the differentiator's pole")
    current_limit: Current = Field(0.1, gt=0, description="Largest current of each coil")
    form: Literal["opamps", "ideal"] | None = Field(
        None,
        description="Form of the netlist: a circuit of op-amps, or ideal controlled "
        "sources, which simulate faster",
    )
    enable_at: Time | tuple[Time, ...] = Field(
        0.5e-3, description="Time at which the controller is enabled, or a list of times"
    )
    disable_at: tuple[Time, ...] = Field(
        (),
        description=(
            "Times at which the controller is disabled, one after each enable_at except the last"
        ),
    )
    of: str | None = Field(
        None,
        description="Sphere whose height is controlled; by default the only sphere of the scene",
    )
    coils: str | None = Field(
        None, description="Coils that the controller drives; by default the only coils of the scene"
    )

    @property
    def switching_times(self) -> tuple[tuple[float, float], ...]:
        """Pairs of switching time [s] and following state: 1 if enabled, 0 if disabled."""
        on = self.enable_at if isinstance(self.enable_at, tuple) else (self.enable_at,)
        return tuple(sorted((*product(on, (1.0,)), *product(self.disable_at, (0.0,)))))
