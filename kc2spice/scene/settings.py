"""Schemas of all tables of a scene except the tables of parts.

Each class is the schema of a table of the scene file: analysis, probes, reduction, solver, checks
or gates. Each class contains the default and the description of every key of its table.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from kc2spice.core.error_norms import NORM_WORDS
from kc2spice.core.errors import UsageError
from kc2spice.core.key_actions import DeleteKey, Hint
from kc2spice.core.quantities import (
    Charge,
    Count,
    Frequency,
    GateLength,
    GateTime,
    Gravity,
    Place,
    Ratio,
    RefinementRule,
    ResultValue,
    Section,
    Time,
    convert_quantity,
    make_invalid_value_error,
)

Action = Literal["fail", "warn", "off"]
# pattern of one printable character in a string that is written to the netlist
_PRINTABLE_CHARACTER = r"[^\x00-\x1f\x7f-\x9f\u2028\u2029]"
PartNumber = Annotated[str, Field(min_length=1, max_length=40)]
FileName = Annotated[str, Field(pattern=rf"^{_PRINTABLE_CHARACTER}+$", max_length=255)]


class RomKeys(Section):
    """Keys of a model reduction: a fixed order, or an error tolerance (default).

    The error tolerance applies within the frequency band ``band``.
    """

    unsupported_key_hints: ClassVar[Mapping[str, str]] = {
        "method": "delete the key `method`: scenes choose the method; to select a method by name, "
        "run kc2spice reduce SCENE:PART --method NAME, or call kc.reduce in Python"
    }

    order: Annotated[Count | None, RefinementRule(2.0)] = Field(
        None,
        ge=1,
        le=2000,
        description=(
            "Number of unknowns of the reduced model; cannot be combined with `rom.tolerance`"
        ),
    )
    # Limit 1e-10: rounding errors of double precision exceed a smaller tolerance.
    tolerance: Annotated[Ratio | None, RefinementRule(0.1, finest=1e-10)] = Field(
        None,
        ge=1e-10,
        lt=1,
        validate_default=True,
        description=(
            "Largest permitted relative error of the reduced model in the frequency band. "
            "Default for most bodies: 0.1 % in an ac or noise analysis if the scene has no table "
            "`rom` for the body, 0.01 % in all other cases. Some bodies have other defaults: "
            "`kc2spice explain` prints the value for each body"
        ),
    )
    band: tuple[Frequency, Frequency] = Field(
        (0.0, 500e3),
        description=(
            "Lowest and highest frequency of the band in which the error estimate of the "
            "reduced model holds. Default if `rom.order` or `rom.tolerance` is stated: 0 to "
            "500 kHz. Default in an ac or noise analysis: from 0.8 times the first to 1.2 times "
            "the last frequency. Default in all other cases: from 0 to the highest frequency that "
            "source edges and contacts excite, at least 10 kHz, but at most the 20th natural "
            "frequency of the body. Edges in a user's netlist do not change the default band. "
            "After a transient without contacts, a warning is printed if the voltage of an "
            "electrode contains frequencies above the band. `kc2spice explain` prints the band"
        ),
    )
    norm: Literal["pointwise", "peak"] | None = Field(
        None,
        description=(
            f"Norm of the reduced model's error. pointwise: relative to {NORM_WORDS['pointwise']}; "
            f"peak: relative to {NORM_WORDS['peak']}. Default: peak if "
            "every port is only a signal input or a signal output, otherwise pointwise"
        ),
    )

    parameters: dict[str, tuple[float | str, float | str]] | None = Field(
        None,
        description=(
            "Keys of the body that become parameters of the subcircuit: up to four keys, "
            "each with the range in which the error estimate holds"
        ),
    )

    @model_validator(mode="before")
    @classmethod
    def _reject_order_with_tolerance(cls, data: Any) -> Any:
        """Reject a reduction with both an order and an error tolerance."""
        if isinstance(data, dict) and "order" in data and "tolerance" in data:
            hint = DeleteKey("order")
            raise make_invalid_value_error(
                "order and tolerance are both set", "either order or tolerance", hint=hint
            )
        return data

    @field_validator("tolerance")
    @classmethod
    def _set_default_tolerance(cls, tolerance: float | None, info: ValidationInfo) -> float | None:
        """Set the default error tolerance if the scene states no fixed order."""
        order_set = info.data.get("order") is not None
        return 1e-4 if tolerance is None and not order_set else tolerance

    @field_validator("band")
    @classmethod
    def _require_nonempty_band(cls, band: tuple[float, float]) -> tuple[float, float]:
        """Reject a frequency band whose lower end is not below its upper end."""
        if not 0 <= band[0] < band[1]:
            hint = 'write the lower frequency first, such as ["0 Hz", "20 kHz"]'
            raise make_invalid_value_error(
                "the frequency band is empty", "0 <= low < high", hint=hint
            )
        return band

    @property
    def is_default(self) -> bool:
        """Whether the scene states neither order nor tolerance of the reduction."""
        return not {"order", "tolerance"} & self.model_fields_set


class SolverKeys(Section):
    """Keys of ngspice settings, which are written to the deck."""

    # The finest ``reltol`` is 1e-7: below 1e-7, rounding errors prevent convergence in ngspice.
    # The smallest ``reltol`` is 1e-12, because two retries reduce ``reltol`` by a factor of 100.
    # With a ``reltol`` below 1e-14, ngspice stops because its time steps become too small.
    reltol: Annotated[Ratio, RefinementRule(0.1, finest=1e-7)] = Field(
        1e-4, ge=1e-12, lt=1, description="Relative error tolerance of ngspice (option RELTOL)"
    )
    chgtol: Annotated[Charge, RefinementRule(0.1, finest=1e-14)] = Field(
        1e-8,
        gt=0,
        description=(
            "Charge tolerance of ngspice (option CHGTOL); in capacitors that represent "
            "vibration modes, 1 uC corresponds to a displacement of 1 um"
        ),
    )
    trtol: Ratio = Field(
        1.0,
        ge=1,
        le=10,
        description=(
            "Factor by which ngspice divides its estimate of the truncation error of a time "
            "step (option TRTOL)"
        ),
    )
    ringing: Literal["followed", "coarse"] | None = Field(
        None,
        description=(
            "Time resolution of body vibrations: `followed` or `coarse`. With `coarse`, a run "
            "needs fewer time steps than with `followed`, but is accurate only for the motion of "
            "parts other than bodies"
        ),
    )
    method: Literal["trap", "gear"] = Field(
        "trap", description="Time integration method of the simulator: trapezoidal or Gear"
    )
    max_step: Annotated[Time | None, RefinementRule(0.5)] = Field(
        None,
        gt=0,
        description=(
            "Largest time step of the simulation; by default computed from sources and "
            "resonances, and printed by kc2spice explain"
        ),
    )
    stop: Time = Field(
        5e-3,
        gt=0,
        description="End time of a transient, used if the key `analysis.stop` has no value",
    )
    retries: Count = Field(
        3,
        ge=0,
        le=4,
        description=(
            "Number of further attempts with other solver settings after a failed run of ngspice"
        ),
    )


class CheckActions(Section):
    """Actions on violated checks: fail (exit code 5), warn (exit code 0), or omit."""

    energy: Action = Field("fail", description="Action if the energy balance of a part is violated")
    touches: Action = Field(
        "fail",
        description=(
            "Action if a contact closes more than max(20, 4e-3 / solver.reltol) times "
            "during the drive pulse"
        ),
    )
    range: Action = Field(
        "fail",
        description=(
            "Action if the sphere leaves the range of the force table, or if the contact "
            "area extends beyond the modelled contact rings"
        ),
    )
    penetration: Action = Field(
        "warn",
        description=(
            "Action if the penalty stiffness of a contact is too low, or if the basis "
            "functions of the contact pressure are too far apart"
        ),
    )
    saturation: Action = Field(
        "warn",
        description=(
            "Action if a controller stays at its current limit for too long, if a driver "
            "clips, or if ac amplitudes exceed the limits of a driver"
        ),
    )
    plausible: Action = Field(
        "fail",
        description=(
            "Action if the value of a key is implausible; unusual values and results only cause "
            "warnings, unless the action is off"
        ),
    )
    reduction: Action | None = Field(
        None,
        description=(
            "Action if the estimated error of a metric exceeds its limit. The limit is "
            "`error_budget`, by default 1e-2. Default action: warn if `error_budget` is stated, "
            "otherwise off"
        ),
    )
    start: Action = Field(
        "fail", description="Action if a sphere does not rest on the body below it at t = 0"
    )


class BenchKeys(Section):
    """Keys of the command ``bench``: the metrics whose errors it compares."""

    metric: tuple[str, ...] = Field(
        (),
        max_length=64,
        description=(
            "Metrics whose errors the command kc2spice bench compares; by default all "
            "metrics that are numbers"
        ),
    )


class ErrorLimits(Section):
    """Error limits: largest accepted differences between two solutions of a scene.

    Values with a dimension need a unit.
    """

    launch_velocity: Ratio | None = Field(
        None,
        gt=0,
        description=(
            "Largest permitted relative difference of a sphere's launch velocity between "
            "ngspice and the reference solution; by default computed from reltol and chgtol"
        ),
    )
    trajectory: GateLength | None = Field(
        None,
        gt=0,
        description=(
            "Largest permitted difference of a sphere's height between ngspice and the "
            "reference solution; by default computed from reltol, chgtol and the sphere's "
            "travel"
        ),
    )
    launch_full_model: Ratio | None = Field(
        None,
        gt=0,
        description=(
            "Largest permitted relative difference of a sphere's launch velocity between "
            "the reduced and the full model; by default computed from reltol, chgtol and "
            "the error estimate of the reduced model"
        ),
    )
    position: Ratio = Field(
        1e-4,
        gt=0,
        description=(
            "Largest permitted difference of a sphere's position between any two of three "
            "solutions of an impact: ngspice, equations of the reduced model, full model. The "
            "difference is relative to the sphere's travel"
        ),
    )
    rebound_velocity: Ratio = Field(
        5e-5,
        gt=0,
        description=(
            "Largest permitted relative difference of a sphere's rebound velocity between any two "
            "of three solutions of an impact: ngspice, equations of the reduced model, full model"
        ),
    )
    separation_time: GateTime = Field(  # type: ignore[assignment]
        default="1.5 ns",
        gt=0,
        description=(
            "Largest permitted difference of the time at which an impact ends, between any two of "
            "three solutions: ngspice, equations of the reduced model, full model"
        ),
    )
    energy: Ratio = Field(
        1e-7,
        gt=0,
        description=(
            "Largest permitted error of the energy balance in the reference solution, "
            "relative to all energy that flows during the run"
        ),
    )
    imprint_rom: Ratio = Field(
        1e-12,
        gt=0,
        description=(
            "Largest permitted relative difference of the static contact force between the "
            "reduced and the full model"
        ),
    )
    imprint_ngspice: Ratio = Field(
        1e-11,
        gt=0,
        description=(
            "Largest permitted relative difference of the static contact force between "
            "ngspice and the full model"
        ),
    )
    harmonic_rom: Ratio = Field(
        1e-4,
        gt=0,
        description=(
            "Largest permitted relative difference of the frequency response between the "
            "reduced and the full model within the reduction band"
        ),
    )
    harmonic_low: Ratio = Field(
        5e-9,
        gt=0,
        description=(
            "Largest permitted relative difference of the frequency response between the "
            "reduced and the full model. The limit applies to frequencies up to one fifth of "
            "the highest frequency of the run"
        ),
    )
    harmonic_ngspice: Ratio = Field(
        5e-9,
        gt=0,
        description=(
            "Largest permitted relative difference of the frequency response between ngspice "
            "and the reduced model"
        ),
    )
    metrics: Ratio | None = Field(
        None,
        gt=0,
        description=(
            "Largest permitted relative difference of a metric between ngspice and the "
            "reference solution. Default: 10 * solver.reltol in a transient, 1e-6 in a noise "
            "analysis, otherwise 5e-9"
        ),
    )
    waves: Ratio | None = Field(
        None,
        gt=0,
        description=(
            "Largest permitted rms value of the difference between the waveforms of "
            "ngspice and the reference solution, relative to the rms value of the "
            "waveform. Default: 200 * solver.reltol (at most 0.05) in a transient, 1e-6 "
            "in a noise analysis, otherwise 3e-8"
        ),
    )
    lookup_slope: Ratio = Field(
        0.05,
        gt=0,
        description=(
            "Largest permitted change of the magnetic force's slope from one segment of "
            "the force table to the next, relative to the largest slope"
        ),
    )
    lookup: Ratio = Field(
        3e-5,
        gt=0,
        description=(
            "Largest permitted difference of the magnetic force between the table in the netlist "
            "and the spline from which the table is computed, relative to the largest force"
        ),
    )
    field: Ratio = Field(
        3e-4,
        gt=0,
        description=(
            "Largest permitted difference of the magnetic force between the force table and "
            "a denser table, relative to the largest force"
        ),
    )


# unit of the independent variable (time or frequency) of each type of analysis
ANALYSIS_UNITS = {"transient": "s", "ac": "Hz", "noise": "Hz"}
SMALL_SIGNAL_ANALYSES = ("ac", "noise")  # analyses that are linear about an operating point


def _choose_default_scale(keys: dict[str, Any]) -> Literal["log", "linear"]:
    """Return the default spacing of frequencies: linear if the range begins at 0 Hz."""
    from_zero = keys.get("type") in SMALL_SIGNAL_ANALYSES and keys.get("start") == 0
    return "linear" if from_zero else "log"


class Analysis(Section):
    """Keys of the scene table ``[analysis]``: the analysis that the simulator runs."""

    unsupported_key_hints: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("band", "range", "frequencies"),
        'write  start = "10 Hz"  and  stop = "10 kHz"  with your frequencies in place of this key',
    )

    type: Literal["transient", "ac", "dc", "op", "noise"] = Field(
        "transient", description="Type of analysis that the simulator runs"
    )
    stop: Time | Frequency | None = Field(
        None,
        gt=0,
        description=(
            "End time of a transient in s, or highest frequency of an ac or noise analysis in Hz"
        ),
    )
    start: Frequency = Field(0.0, ge=0, description="Lowest frequency of an ac or noise analysis")
    points: Annotated[Count, RefinementRule(2.0, spaces=True)] = Field(
        200,
        ge=2,
        le=200_000,
        description=(
            "Minimum number of frequencies in an ac or noise analysis, or of values in a dc sweep"
        ),
    )
    scale: Literal["log", "linear"] = Field(
        default_factory=_choose_default_scale,
        description=(
            "Spacing of the frequencies of an ac or noise analysis; only a linear range can "
            "begin at 0 Hz. Default: linear if the key `start` is missing, otherwise log"
        ),
    )
    output: str | None = Field(
        None,
        description=(
            "Output whose noise a noise analysis computes: a result such as disc.u, or a pin "
            "PART.PIN"
        ),
    )
    sweep: str | None = Field(None, description="Key that a dc analysis varies, such as PART.dc")
    from_: Any = Field(
        0.0, alias="from", description="First value of the key that a dc analysis varies"
    )
    to: Any = Field(1.0, description="Last value of the key that a dc analysis varies")
    back: bool | None = Field(
        None,
        description=(
            "Whether a dc sweep returns from its last value to its first value. Results then "
            "contain most swept values twice, once in each direction; the points of a result are "
            "numbered in the order of computation"
        ),
    )

    @field_validator("stop", mode="before")
    @classmethod
    def _read_stop(cls, stop: Any, info: ValidationInfo) -> Any:
        """Convert the key ``stop`` to the end time [s] or end frequency [Hz]."""
        unit = ANALYSIS_UNITS.get(info.data.get("type", ""))
        if stop is None or unit is None:
            return stop
        try:
            return convert_quantity(stop, unit)
        except UsageError as error:
            other = "s" if unit == "Hz" else "Hz"
            hint = error.hint
            with suppress(UsageError):
                convert_quantity(stop, other)
                kind = info.data["type"]
                example = "100 kHz" if unit == "Hz" else "10 ms"
                hint = f'write for example  stop = "{example}"  in the {kind} analysis'
            raise make_invalid_value_error(error.message, error.expected, hint=hint) from None

    @property
    def is_small_signal(self) -> bool:
        """Whether the analysis is linear about an operating point, over a frequency range."""
        return self.type in SMALL_SIGNAL_ANALYSES


class ProbeKeys(Section):
    """Keys of a probe: the result that it reads, and the value that becomes a metric.

    ``argmax`` is the frequency, time or swept value at which the result is largest. ``value`` is
    the value of the result at the frequency, time or swept value that the key ``at`` states.
    ``frequency`` is the mean frequency of the cycles in the last half of the run. ``spl`` is the
    sound pressure level in dB re 20 uPa in gases and 1 uPa in liquids. In an ac analysis, ``spl``
    is the level at the frequency ``at``. If the key ``at`` is missing in an ac analysis, ``spl`` is
    the largest level. In a transient, ``spl`` is the level of the rms pressure. A probe reads the
    magnitudes of complex values. Flows such as ``PART.force`` and ``PART.PIN.current`` are positive
    into the part: a positive force acts on the part in the direction of the displacement. The flow
    of a source is positive out of the source. The keys ``from`` and ``to``, or ``periods``,
    restrict a probe to a window, such as the steady state.
    """

    of: str = Field(
        examples=['"PART.RESULT"'],
        description=(
            "Result that the probe reads, such as disc.x, NETLIST.NODE, PART.current, "
            "PART.PIN.force or PART.power"
        ),
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
        "spl",
    ] = Field(
        "max",
        description=(
            "Value that the probe computes from the result. `value`: the result at the frequency, "
            "time or swept value that the key `at` states. `spl`: the sound pressure level in dB"
        ),
    )
    at: Place | None = Field(
        None,
        description=(
            "Frequency, time or swept value at which the probe reads the result; requires "
            "take = value or take = spl"
        ),
    )
    level: ResultValue | None = Field(
        None,
        description=(
            "Level of the result, in its SI unit or with a unit such as -1.2 um. The probe returns "
            "the time, frequency or swept value at which the result first crosses this level; "
            "requires take = crossing"
        ),
    )
    from_: Place | None = Field(
        None,
        alias="from",
        description="Lowest frequency, time or swept value of the window that the probe reads",
    )
    to: Place | None = Field(
        None,
        description="Highest frequency, time or swept value of the window that the probe reads",
    )
    periods: Count | None = Field(
        None,
        ge=1,
        description=(
            "Length of the window that the probe reads, as a number of source periods "
            "before the end of the run; cannot be combined with `from` and `to`"
        ),
    )

    @property
    def positions_by_key(self) -> dict[str, float]:
        """Values of the keys ``at``, ``from`` and ``to`` that a probe states, by key name."""
        places = {"at": self.at, "from": self.from_, "to": self.to}
        return {key: place for key, place in places.items() if place is not None}

    @model_validator(mode="before")
    @classmethod
    def _set_default_take(cls, data: Any) -> Any:
        """Set ``take = "value"`` for a probe with the key ``at``."""
        return {"take": "value", **data} if isinstance(data, dict) and "at" in data else data

    @model_validator(mode="after")
    def _require_consistent_keys(self) -> Self:
        """Reject contradictory keys of a probe."""
        for take, key in (("value", "at"), ("crossing", "level")):
            present = getattr(self, key) is not None
            if key == "at" and self.take == "spl":
                continue
            if self.take == take and not present:
                hint: Hint = f"add  {key} = VALUE  to this probe"
                raise make_invalid_value_error(
                    f'{key} is missing with take = "{take}"', f"the key `{key}`", hint=hint
                )
            if self.take != take and present:
                hint = f"delete take = {self.take!r}" if key == "at" else DeleteKey(key)
                problem = f'{key} has no effect with take = "{self.take}"'
                raise make_invalid_value_error(problem, f'{key} with take = "{take}"', hint=hint)
        window = (self.from_, self.to, self.periods)
        if self.at is not None and any(item is not None for item in window):
            expected = "`at`, or `from` and `to`, or `periods`"
            raise make_invalid_value_error(
                "`at` cannot be combined with `from`, `to` or `periods`",
                expected,
                hint=DeleteKey("at"),
            )
        if self.periods is not None and (self.from_ is not None or self.to is not None):
            expected = "`periods`, or `from` and `to`"
            raise make_invalid_value_error(
                "`periods` cannot be combined with `from` or `to`",
                expected,
                hint=DeleteKey("periods"),
            )
        if self.from_ is not None and self.to is not None and self.from_ >= self.to:
            hint = "exchange `from` and `to`" if self.from_ > self.to else "raise the key `to`"
            raise make_invalid_value_error("the window is empty", "from < to", hint=hint)
        return self


class SceneKeys(Section):
    """Keys of a scene that do not belong to its parts."""

    name: str = Field(
        pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$",
        description="Name of the scene; by default the name of its file",
    )
    title: str = Field(
        "",
        max_length=200,
        pattern=rf"^{_PRINTABLE_CHARACTER}*$",
        description="Title of the scene, in one line",
    )
    gravity: Gravity = Field(9.81, description="Gravitational acceleration, positive downwards")
    error_budget: Ratio | None = Field(
        None,
        gt=0,
        lt=1,
        description=(
            "Largest permitted relative error of every metric. A run refines all numerical "
            "settings that the scene does not state until every error is below this value"
        ),
    )
    analysis: Analysis = Analysis()
    probes: dict[str, ProbeKeys] = Field(default_factory=dict)
    rom: RomKeys = RomKeys()
    solver: SolverKeys = SolverKeys()
    checks: CheckActions = CheckActions()
    gates: ErrorLimits = ErrorLimits()
    bench: BenchKeys = BenchKeys()
    include: tuple[FileName, ...] = Field(
        (),
        max_length=16,
        description="Netlist files in the scene's folder that the main netlist includes",
    )
