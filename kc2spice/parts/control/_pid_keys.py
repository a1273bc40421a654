"""Keys of a PID controller, which several part types use."""

from __future__ import annotations

from itertools import product
from typing import Annotated, Literal

from pydantic import Field

from kc2spice.core.quantities import Current, Length, Section, Time, si

# Largest permitted fraction of the run during which the current is at its limit.
# While the current is at its limit, the controller has no effect.
MAX_SATURATED_SHARE = 0.9


class PidKeys(Section):
    """Keys of a PID controller with limited output.

    The controller drives opposite currents of equal magnitude through both coils.
    """

    setpoint: Length = Field(
        2.5e-3,
        description=(
            "Set point of the height of the sphere's centre above the surface on which the sphere "
            "rests"
        ),
    )
    kp: Annotated[float, si("A/m")] = Field(
        5e4,
        ge=0,
        description=(
            "Proportional gain of the PID controller: coil current divided by height error"
        ),
    )
    ki: Annotated[float, si("A/(m s)")] = Field(
        10.0,
        ge=0,
        description=(
            "Integral gain of the PID controller: coil current divided by the time "
            "integral of the height error"
        ),
    )
    kd: Annotated[float, si("A s/m")] = Field(
        20.0,
        ge=0,
        description=(
            "Derivative gain of the PID controller: coil current divided by the rate of "
            "change of the height error"
        ),
    )
    rolloff: Time = Field(
        100e-9,
        gt=0,
        description=(
            "Time constant of the low-pass filter in the derivative term of the PID controller"
        ),
    )
    current_limit: Current = Field(
        0.1, gt=0, description="Largest current that the controller drives through each coil"
    )
    form: Literal["opamps", "ideal"] | None = Field(
        None,
        description=(
            "Form of the controller's netlist: a circuit of op-amps, or ideal controlled "
            "sources, which simulate faster"
        ),
    )
    enable_at: Time | tuple[Time, ...] = Field(
        0.5e-3, description="Time or list of times at which the controller is enabled"
    )
    disable_at: tuple[Time, ...] = Field(
        (),
        description=(
            "Times at which the controller is disabled, one between each two consecutive times in "
            "`enable_at`; a further time after the last one is optional"
        ),
    )
    of: str | None = Field(
        None,
        description=(
            "Name of the sphere whose height is controlled; by default the only sphere of the scene"
        ),
    )
    coils: str | None = Field(
        None,
        description=(
            "Name of the part with the coils that the controller drives; by default the only "
            "such part of the scene"
        ),
    )

    @property
    def switching_times(self) -> tuple[tuple[float, float], ...]:
        """Switching times [s], each with the next state: 1 is enabled, 0 is disabled."""
        on = self.enable_at if isinstance(self.enable_at, tuple) else (self.enable_at,)
        return tuple(sorted((*product(on, (1.0,)), *product(self.disable_at, (0.0,)))))
