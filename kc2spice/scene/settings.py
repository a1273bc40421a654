"""Tables of a scene that belong to no part: reduction, solver, checks of a run, gates of verify."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from kc2spice.core.quantities import (
    Charge,
    Count,
    Frequency,
    GateLength,
    GateTime,
    Notch,
    Ratio,
    Section,
    Time,
    refused,
)

Action = Literal["fail", "warn", "off"]


class Rom(Section):
    """Reduction: a fixed order, or a tolerance over a band; the tolerance unless told."""

    order: Annotated[Count | None, Notch(2.0)] = Field(
        None, ge=1, le=2000, description="number of states"
    )
    tolerance: Annotated[Ratio | None, Notch(0.1, finest=1e-10)] = Field(
        None,
        gt=0,
        lt=1,
        description="largest relative error over the band; 1e-4 unless order is set",
    )
    band: tuple[Frequency, Frequency] = Field(
        (0.0, 500e3), description="frequencies that the reduction must hold"
    )
    norm: Literal["pointwise", "peak"] | None = Field(
        None, description="of the error; peak where all ports are signals, else pointwise"
    )

    parameters: dict[str, tuple[float | str, float | str]] | None = Field(
        None,
        description="of the netlist: keys of the body with their ranges, four at most; the error "
        "then holds over all of them",
    )

    @model_validator(mode="before")
    @classmethod
    def _one_target(cls, data: Any) -> Any:
        if isinstance(data, dict) and "order" in data and "tolerance" in data:
            raise refused("order and tolerance are both set", "one of the two")
        return data

    @model_validator(mode="after")
    def _some_target(self) -> Self:
        if self.order is None and self.tolerance is None:
            self.__dict__["tolerance"] = 1e-4  # frozen; not among the fields that are set
        return self

    @property
    def left_open(self) -> bool:
        """Whether neither order nor tolerance was asked for."""
        return not {"order", "tolerance"} & self.model_fields_set


class Solver(Section):
    """ngspice settings that are written into the deck."""

    # below 1e-7 ngspice's iterations end in rounding
    reltol: Annotated[Ratio, Notch(0.1, finest=1e-7)] = Field(1e-4, gt=0, lt=1)
    chgtol: Annotated[Charge, Notch(0.1, finest=1e-14)] = Field(
        1e-8, gt=0, description="1 uC of a fast state is 1 um of displacement"
    )
    trtol: Ratio = Field(1.0, ge=1, le=10, description="of ngspice: trust in the error estimate")
    ringing: Literal["followed", "coarse"] | None = Field(
        None, description="of bodies; coarse where only what they throw is asked for: fewer steps"
    )
    method: Literal["trap", "gear"] = "trap"
    max_step: Annotated[Time | None, Notch(0.5)] = Field(
        None, gt=0, description="largest; by what drives the scene and what resonates, see explain"
    )
    stop: Time = Field(5e-3, gt=0)
    retries: Count = Field(3, ge=0, le=4, description="with other settings, after a failure")


class Checks(Section):
    """What becomes of a run whose result violates a check: it fails (exit 5), warns, or neither."""

    energy: Action = Field("fail", description="energy balances of sphere, contact and chip")
    touches: Action = Field("fail", description="contact events before the launch, against reltol")
    range: Action = Field("fail", description="sphere in the field table, contact within the rings")
    penetration: Action = Field("warn", description="of a contact: soft springs, too few hats")
    saturation: Action = Field("warn", description="share of the time at the current limit")
    plausible: Action = Field("fail", description="keys against what exists or can be made")
    reduction: Action | None = Field(
        None,
        description="estimated error of every metric, by a refined run; off, with an error_budget "
        "warn",
    )
    start: Action = Field("fail", description="a sphere at rest on its body at t = 0")


class Bench(Section):
    """What ``bench`` judges settings by."""

    metric: tuple[str, ...] = Field(
        (), max_length=64, description="metrics that the scene is run for; empty: all numbers"
    )


class Gates(Section):
    """Largest errors that a result may have; those with a dimension must be given with a unit."""

    launch_velocity: Ratio | None = Field(
        None, gt=0, description="relative, ngspice against the laws; follows reltol and chgtol"
    )
    trajectory: GateLength | None = Field(
        None, gt=0, description="largest, ngspice against the laws; as launch_velocity, of the way"
    )
    launch_full_model: Ratio | None = Field(
        None, gt=0, description="relative, against the full model; follows the reduction's error"
    )
    position: Ratio = Field(1e-4, gt=0, description="of the travel in an impact, any two solutions")
    rebound_velocity: Ratio = Field(5e-5, gt=0, description="relative, any two solutions")
    separation_time: GateTime = Field(  # type: ignore[assignment]
        default="1.5 ns", gt=0, description="end of the impact, any two solutions"
    )
    energy: Ratio = Field(
        1e-7, gt=0, description="what the laws' integration loses of the energy turned over"
    )
    imprint_rom: Ratio = Field(1e-12, gt=0, description="static force, ROM against full model")
    imprint_ngspice: Ratio = Field(1e-11, gt=0, description="static force, ngspice against full")
    harmonic_rom: Ratio = Field(1e-4, gt=0, description="response over the band, ROM against full")
    harmonic_low: Ratio = Field(5e-9, gt=0, description="the same below a fifth of the band")
    harmonic_ngspice: Ratio = Field(5e-9, gt=0, description="response, ngspice against the ROM")
    metrics: Ratio | None = Field(
        None, gt=0, description="of any metric, ngspice against the laws; 10 solver.reltol"
    )
    waves: Ratio | None = Field(
        None, gt=0, description="rms of any wave, ngspice against the laws; 200 solver.reltol"
    )
    lookup_slope: Ratio = Field(
        0.05, gt=0, description="jump of the EM lookup's slope, of the largest"
    )
    lookup: Ratio = Field(3e-5, gt=0, description="EM force, ngspice lookup to the table's splines")
    field: Ratio = Field(3e-4, gt=0, description="EM force, table to a denser one, of the largest")
