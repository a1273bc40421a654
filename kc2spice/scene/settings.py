"""Settings of a scene outside of its parts.

Each class is a table of the scene file: analysis, probes, reduction, solver, checks or gates. It
contains the default and the description of every key.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import (
    Acceleration,
    Charge,
    Count,
    Frequency,
    GateLength,
    GateTime,
    Notch,
    Place,
    Ratio,
    Section,
    Time,
    invalid_value_error,
    quantity,
)

Action = Literal["fail", "warn", "off"]
# pattern of texts that are written into the netlist
_ONE_LINE_PATTERN = r"[^\x00-\x1f\x7f-\x9f\u2028\u2029]"
PartNumber = Annotated[str, Field(min_length=1, max_length=40)]
FileName = Annotated[str, Field(pattern=rf"^{_ONE_LINE_PATTERN}+$", max_length=255)]


class Rom(Section):
    """Reduction: a fixed order, or a tolerance over a band; by default the tolerance."""

    absent: ClassVar[Mapping[str, str]] = {
        "method": "leave it out: scenes choose the method; a method by its name is selected by "
        "kc2spice reduce SCENE:PART --method NAME, or by kc.reduce in Python"
    }

    order: Annotated[Count | None, Notch(2.0)] = Field(
        None, ge=1, le=2000, description="Number of states, instead of a tolerance"
    )
    # below 1e-10, rounding errors of double precision exceed the tolerance
    tolerance: Annotated[Ratio | None, Notch(0.1, finest=1e-10)] = Field(
        None,
        ge=1e-10,
        lt=1,
        validate_default=True,
        description=("Largest relative error over the band; by default 1e-4 unless order is set"),
    )
    band: tuple[Frequency, Frequency] = Field(
        (0.0, 500e3), description="Lowest and highest frequency at which the error estimate holds"
    )
    norm: Literal["pointwise", "peak"] | None = Field(
        None,
        description=(
            "Norm of the error; by default peak if all ports are signals, otherwise pointwise"
        ),
    )

    parameters: dict[str, tuple[float | str, float | str]] | None = Field(
        None,
        description=(
            "Parameters of the netlist: up to four keys of the body with their ranges, over which "
            "the error estimate holds"
        ),
    )

    @model_validator(mode="before")
    @classmethod
    def _require_one_target(cls, data: Any) -> Any:
        if isinstance(data, dict) and "order" in data and "tolerance" in data:
            hint = "delete the key order"
            raise invalid_value_error(
                "order and tolerance are both set", "one of the two", hint=hint
            )
        return data

    @field_validator("tolerance")
    @classmethod
    def _set_default_tolerance(cls, tolerance: float | None, info: ValidationInfo) -> float | None:
        """Set the default tolerance if there is no order."""
        order_set = info.data.get("order") is not None
        return 1e-4 if tolerance is None and not order_set else tolerance

    @field_validator("band")
    @classmethod
    def _require_band(cls, band: tuple[float, float]) -> tuple[float, float]:
        if not 0 <= band[0] < band[1]:
            raise invalid_value_error("empty band", "0 <= low < high")
        return band

    @property
    def is_default(self) -> bool:
        """Whether the scene sets neither order nor tolerance."""
        return not {"order", "tolerance"} & self.model_fields_set


class Solver(Section):
    """ngspice settings that are written into the deck."""

    # below 1e-7, rounding errors prevent the convergence of ngspice
    reltol: Annotated[Ratio, Notch(0.1, finest=1e-7)] = Field(
        1e-4, gt=0, lt=1, description="Relative tolerance of the simulator"
    )
    chgtol: Annotated[Charge, Notch(0.1, finest=1e-14)] = Field(
        1e-8,
        gt=0,
        description="Charge tolerance; for fast modes, a charge of 1 uC is a displacement of 1 um",
    )
    trtol: Ratio = Field(
        1.0,
        ge=1,
        le=10,
        description="Factor by which ngspice divides its estimate of the truncation error (TRTOL)",
    )
    ringing: Literal["followed", "coarse"] | None = Field(
        None,
        description=(
            "Resolution of ringing bodies; coarse takes fewer steps where only the motion of "
            "other parts counts"
        ),
    )
    method: Literal["trap", "gear"] = Field(
        "trap", description="Integration rule of the simulator: trapezoidal or Gear"
    )
    max_step: Annotated[Time | None, Notch(0.5)] = Field(
        None,
        gt=0,
        description=(
            "Largest time step; by default it follows from drives and resonances, which explain "
            "lists"
        ),
    )
    stop: Time = Field(5e-3, gt=0, description="End of the transient")
    retries: Count = Field(
        3, ge=0, le=4, description="Number of further attempts with other settings after a failure"
    )


class Checks(Section):
    """Action on a violated check: the run fails (exit 5), warns, or neither."""

    energy: Action = Field(
        "fail", description="Action if an energy balance of sphere, contact or chip fails"
    )
    touches: Action = Field(
        "fail",
        description=(
            "Action if there are too many contact events before the launch for this reltol"
        ),
    )
    range: Action = Field(
        "fail",
        description=("Action if the sphere leaves the field table or the contact leaves its rings"),
    )
    penetration: Action = Field(
        "warn", description="Action if a contact is too soft or its basis too coarse"
    )
    saturation: Action = Field(
        "warn", description="Action if the controller spends too long at its current limit"
    )
    plausible: Action = Field("fail", description="Action if a key has a value that no device has")
    reduction: Action | None = Field(
        None,
        description=(
            "Action if the error estimate of a metric by a refined run is too large; by default "
            "off, or warn with an error_budget"
        ),
    )
    start: Action = Field(
        "fail", description="Action if a sphere does not rest on its body at t = 0"
    )


class Bench(Section):
    """Metrics and limits by which ``bench`` judges settings."""

    metric: tuple[str, ...] = Field(
        (),
        max_length=64,
        description="Metrics whose errors are compared; by default all metrics that are numbers",
    )


class ErrorLimits(Section):
    """Largest errors that a result may have; values with a dimension need a unit."""

    launch_velocity: Ratio | None = Field(
        None,
        gt=0,
        description=(
            "Relative error of the launch velocity, ngspice against the equations; follows reltol "
            "and chgtol"
        ),
    )
    trajectory: GateLength | None = Field(
        None,
        gt=0,
        description=(
            "Largest error of the trajectory, ngspice against the equations; by default "
            "launch_velocity times the distance"
        ),
    )
    launch_full_model: Ratio | None = Field(
        None,
        gt=0,
        description=(
            "Relative error of the launch velocity against the full model; follows the error of "
            "the reduction"
        ),
    )
    position: Ratio = Field(
        1e-4,
        gt=0,
        description=(
            "Error of the position in an impact relative to the travel, between any two solutions"
        ),
    )
    rebound_velocity: Ratio = Field(
        5e-5,
        gt=0,
        description="Largest relative difference of the rebound velocity between any two solutions",
    )
    separation_time: GateTime = Field(  # type: ignore[assignment]
        default="1.5 ns",
        gt=0,
        description="Largest difference of the end time of an impact between any two solutions",
    )
    energy: Ratio = Field(
        1e-7,
        gt=0,
        description=(
            "Fraction of the exchanged energy that the integration of the equations loses"
        ),
    )
    imprint_rom: Ratio = Field(
        1e-12, gt=0, description="Relative error of the static force, reduced against full model"
    )
    imprint_ngspice: Ratio = Field(
        1e-11,
        gt=0,
        description="Relative error of the static force, ngspice against the full model",
    )
    harmonic_rom: Ratio = Field(
        1e-4,
        gt=0,
        description=("Relative error of the response over the band, reduced against full model"),
    )
    harmonic_low: Ratio = Field(
        5e-9,
        gt=0,
        description=(
            "Relative error of the response below a fifth of the band, reduced against full model"
        ),
    )
    harmonic_ngspice: Ratio = Field(
        5e-9, gt=0, description="Relative error of the response, ngspice against the reduced model"
    )
    metrics: Ratio | None = Field(
        None,
        gt=0,
        description=(
            "Relative error of any metric, ngspice against the equations; by default 10 "
            "solver.reltol"
        ),
    )
    waves: Ratio | None = Field(
        None,
        gt=0,
        description=(
            "Rms error of any wave, ngspice against the equations; by default 200 solver.reltol"
        ),
    )
    lookup_slope: Ratio = Field(
        0.05,
        gt=0,
        description=("Largest jump of the slope of the force table, relative to the largest slope"),
    )
    lookup: Ratio = Field(
        3e-5,
        gt=0,
        description="Error of the magnetic force, table of the netlist against splines",
    )
    field: Ratio = Field(
        3e-4,
        gt=0,
        description=(
            "Error of the table of magnetic forces, compared with a denser table, relative to the "
            "largest force"
        ),
    )


# units of the scale of each type of analysis
ANALYSIS_UNITS = {"transient": "s", "ac": "Hz", "noise": "Hz"}
SMALL_SIGNALS = ("ac", "noise")  # types of analysis of linear signals about an operating point


def _default_scale(keys: dict[str, Any]) -> Literal["log", "linear"]:
    """Spacing of frequencies: linear if their range begins at 0 Hz."""
    from_zero = keys.get("type") in SMALL_SIGNALS and keys.get("start") == 0
    return "linear" if from_zero else "log"


class Analysis(Section):
    """Analysis that the simulator runs."""

    type: Literal["transient", "ac", "dc", "op", "noise"] = Field(
        "transient", description="Kind of analysis"
    )
    stop: Time | Frequency | None = Field(
        None, gt=0, description="End of a transient [s], or highest frequency of ac and noise [Hz]"
    )
    start: Frequency = Field(0.0, ge=0, description="Lowest frequency of ac and noise")
    points: Annotated[Count, Notch(2.0, spaces=True)] = Field(
        200, ge=2, le=200_000, description="Least number of frequencies or of swept values"
    )
    scale: Literal["log", "linear"] = Field(
        default_factory=_default_scale,
        description="Spacing of the frequencies of ac and noise; linear may begin at 0 Hz",
    )
    output: str | None = Field(
        None, description="Output of a noise analysis: a result such as disc.u, or PART.PIN"
    )
    sweep: str | None = Field(None, description="Key that a dc analysis varies, PART.KEY")
    from_: Any = Field(0.0, alias="from", description="First value of a dc analysis")
    to: Any = Field(1.0, description="Last value of a dc analysis")
    back: bool | None = Field(
        None,
        description=(
            "Whether a dc analysis returns to its first value; its scale continues to grow"
        ),
    )

    @field_validator("stop", mode="before")
    @classmethod
    def _read_stop(cls, stop: Any, info: ValidationInfo) -> Any:
        """Read the end of a transient as a time, that of ac and noise as a frequency."""
        unit = ANALYSIS_UNITS.get(info.data.get("type", ""))
        if stop is None or unit is None:
            return stop
        try:
            return quantity(stop, unit)
        except UsageError as error:
            raise invalid_value_error(error.message, error.expected) from None

    @property
    def small(self) -> bool:
        """Whether the analysis is linear about an operating point, over frequency."""
        return self.type in SMALL_SIGNALS


class Probe(Section):
    """Result that a probe reads, and the quantity that it computes as a metric.

    ``argmax`` is the place of the largest value on the scale (Hz in ``ac``, s in a transient).
    ``value`` is the value ``at`` a place of the scale. ``frequency`` is the mean rate of cycles
    over the last half of the run. Complex values count by their magnitude. With a window, ``from``
    and ``to`` or the last ``periods``, a probe reads only this window, such as a steady state.
    """

    of: str = Field(
        description=(
            "Result that the probe reads: disc.x, NETLIST.NODE, or PART.current, PART.PIN.current, "
            "PART.power and PART.PIN.power; force, heat_flow or volume_velocity instead of current"
        )
    )
    take: Literal[
        "max",
        "min",
        "argmax",
        "final",
        "mean",
        "rms",
        "peak_to_peak",
        "crossing",
        "frequency",
        "value",
    ] = Field(
        "max",
        description=(
            "Quantity that the probe computes from the result; `value` reads the result at the key "
            "`at`"
        ),
    )
    at: Place | None = Field(
        None, description="Frequency, time or swept value at which take = value reads the result"
    )
    level: Ratio | None = Field(
        None, description="Level of a crossing, in the SI unit of the result"
    )
    from_: Place | None = Field(
        None, alias="from", description="First frequency, time or swept value that the probe reads"
    )
    to: Place | None = Field(
        None, description="Last frequency, time or swept value that the probe reads"
    )
    periods: Count | None = Field(
        None,
        ge=1,
        description=(
            "Number of the last periods of the scene's sources that the probe reads, instead of "
            "from and to"
        ),
    )

    @property
    def places(self) -> dict[str, float]:
        """Places on the scale of the analysis by their keys."""
        places = {"at": self.at, "from": self.from_, "to": self.to}
        return {key: place for key, place in places.items() if place is not None}

    @model_validator(mode="before")
    @classmethod
    def _take_value_at_place(cls, data: Any) -> Any:
        return {"take": "value", **data} if isinstance(data, dict) and "at" in data else data

    @model_validator(mode="after")
    def _require_consistent_keys(self) -> Self:
        for take, key in (("value", "at"), ("crossing", "level")):
            present = getattr(self, key) is not None
            if self.take == take and not present:
                hint = f"add  {key} = VALUE  to this probe"
                raise invalid_value_error(
                    f'{key} is missing with take = "{take}"', f"a {key}", hint=hint
                )
            if self.take != take and present:
                hint = f"delete take = {self.take!r}" if key == "at" else f"delete the key {key}"
                problem = f'{key} has no effect with take = "{self.take}"'
                raise invalid_value_error(problem, f'{key} with take = "{take}"', hint=hint)
        window = (self.from_, self.to, self.periods)
        if self.at is not None and any(item is not None for item in window):
            expected = "at, or from and to, or periods"
            raise invalid_value_error("at beside a window", expected, hint="delete the key at")
        if self.periods is not None and (self.from_ is not None or self.to is not None):
            expected = "periods, or from and to"
            raise invalid_value_error(
                "periods beside from or to", expected, hint="delete the key periods"
            )
        if self.from_ is not None and self.to is not None and self.from_ >= self.to:
            raise invalid_value_error("empty window", "from < to")
        return self


class Frame(Section):
    """Keys of a scene outside of its parts."""

    name: str = Field(
        pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$",
        description="Name of the scene; by default that of its file",
    )
    title: str = Field(
        "",
        max_length=200,
        pattern=rf"^{_ONE_LINE_PATTERN}*$",
        description="Title of the scene, one line",
    )
    gravity: Acceleration = Field(9.81, description="Gravity, positive downwards")
    error_budget: Ratio | None = Field(
        None,
        gt=0,
        lt=1,
        description=(
            "Relative error of every metric that the run must reach by refining the settings that "
            "the scene leaves open"
        ),
    )
    analysis: Analysis = Analysis()
    probes: dict[str, Probe] = Field(default_factory=dict)
    rom: Rom = Rom()
    solver: Solver = Solver()
    checks: Checks = Checks()
    gates: ErrorLimits = ErrorLimits()
    bench: Bench = Bench()
    include: tuple[FileName, ...] = Field(
        (), max_length=16, description="Netlist files beside the scene that its deck includes"
    )
