"""The scene as data: parts by name, joined at typed pins, with analysis, probes and settings.

Nothing here knows a part type: what a type can do is behind :class:`kc2spice.scene.parttype.
PartType`, and the types register themselves.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from kc2spice.core.errors import UsageError, unknown
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
    quantity,
    refused,
)

if TYPE_CHECKING:
    from kc2spice.scene.frames import ShakenFrame
    from kc2spice.scene.parttype import PartType
Action = Literal["fail", "warn", "off"]


class Rom(Section):
    """Reduction: a fixed order, or a tolerance over a band; the tolerance unless told."""

    order: Annotated[Count | None, Notch(2.0)] = Field(
        None, ge=1, le=2000, description="Number of states, instead of a tolerance"
    )
    tolerance: Annotated[Ratio | None, Notch(0.1, finest=1e-10)] = Field(
        None,
        gt=0,
        lt=1,
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
    def _one_target(cls, data: Any) -> Any:
        if isinstance(data, dict) and "order" in data and "tolerance" in data:
            raise refused("order and tolerance are both set", "one of the two")
        return data

    @model_validator(mode="after")
    def _some_target(self) -> Self:
        if self.order is None and self.tolerance is None:
            self.__dict__["tolerance"] = 1e-4  # frozen; not among the fields that are set
        return self

    @field_validator("band")
    @classmethod
    def _some_band(cls, band: tuple[float, float]) -> tuple[float, float]:
        if not 0 <= band[0] < band[1]:
            raise refused("empty band", "0 <= low < high")
        return band

    @property
    def left_open(self) -> bool:
        """Whether neither order nor tolerance was asked for."""
        return not {"order", "tolerance"} & self.model_fields_set


class Solver(Section):
    """ngspice settings that are written into the deck."""

    # below 1e-7 ngspice's iterations end in rounding
    reltol: Annotated[Ratio, Notch(0.1, finest=1e-7)] = Field(
        1e-4, gt=0, lt=1, description="Relative tolerance of the simulator"
    )
    chgtol: Annotated[Charge, Notch(0.1, finest=1e-14)] = Field(
        1e-8, gt=0, description="Charge tolerance; 1 uC of a fast state is 1 um of displacement"
    )
    trtol: Ratio = Field(
        1.0, ge=1, le=10, description="Factor of ngspice on its estimate of the truncation error"
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
    """What becomes of a run whose result violates a check: it fails (exit 5), warns, or neither."""

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
            "off, with an error_budget warn"
        ),
    )
    start: Action = Field(
        "fail", description="Action if a sphere does not rest on its body at t = 0"
    )


class Bench(Section):
    """What ``bench`` judges settings by."""

    metric: tuple[str, ...] = Field(
        (), max_length=64, description="Metrics that the scene is run for; by default all numbers"
    )


class Gates(Section):
    """Largest errors that a result may have; those with a dimension must be given with a unit."""

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
        5e-5, gt=0, description="Relative error of the rebound velocity, between any two solutions"
    )
    separation_time: GateTime = Field(  # type: ignore[assignment]
        default="1.5 ns",
        gt=0,
        description="Error of the end of an impact, between any two solutions",
    )
    energy: Ratio = Field(
        1e-7,
        gt=0,
        description=("Share of the turned-over energy that the integration of the equations loses"),
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
        description="Error of the magnetic force, table of the netlist against the splines",
    )
    field: Ratio = Field(
        3e-4,
        gt=0,
        description=(
            "Error of the magnetic force, table against a denser one, relative to the largest force"
        ),
    )


GROUND = "gnd"
# Tables that need no ``part`` key, and the type that each means.
SHORT = {
    "kick": "piezo_stack",
    "contact": "contact",
    "sphere": "sphere",
    "catch": "ring_magnet_coils",
    "control": "pid",
    "impact": "throw",
    "imprint": "push",
    "harmonic": "port_loads",
    "em_force": "current_cases",
}
TABLES = {kind: name for name, kind in SHORT.items()}
_ONE_LINE = r"[^\x00-\x1f\x7f-\x9f\u2028\u2029]"  # such text ends up in a netlist
FileName = Annotated[str, Field(pattern=rf"^{_ONE_LINE}+$", max_length=255)]


@dataclass(frozen=True)
class Terminal:
    """A pin of a part: what 1 V and 1 A on it mean (``flow="-"`` for a signal).

    ``default`` is where it goes when the scene says nothing (``"gnd"`` or ``"part.pin"``).
    A ``required`` pin must be joined. ``signal_out`` marks the one pin that sets a signal.
    ``rated`` [V] is the largest voltage that an electrode stands, where it is known.
    """

    name: str
    unit: str
    flow: str
    default: str | None = None
    required: bool = False
    signal_out: bool = False
    rated: float | None = None

    @property
    def kind(self) -> str:
        """What may be joined to what: the unit pair in words."""
        return f"{self.unit}/{self.flow}" if self.flow != "-" else f"signal in {self.unit}"

    @property
    def moving(self) -> bool:
        """Whether something moves along it under a force."""
        return self.flow == "N" and self.unit in ("um", "m/s")


@dataclass(frozen=True)
class Part:
    """One part of a scene: its checked keys and the pins that the scene joins by name.

    ``at`` is where the file has the keys of a part that another one brings along, which is under
    that part's keys; empty for a part with a table of its own.
    """

    name: str
    type: PartType
    keys: Any
    pins: Mapping[str, str] = field(default_factory=dict)
    at: tuple[str | int, ...] = ()

    @property
    def netlist(self) -> bool:
        """Whether it is a subcircuit out of a file of the user's, which has names of its own."""
        return hasattr(self.keys, "subckt")

    @property
    def reduced(self) -> bool:
        """Whether it is a body, whose model is a reduced one, so that ``rom`` matters."""
        return hasattr(self.keys, "rom")

    def declares(self, scene: Scene) -> bool:
        """Whether it is a body out of files, whose author declares its ports."""
        return self.reduced and bool(self.type.files(self, scene))

    def wrong(
        self,
        key: str,
        message: str,
        got: object = None,
        expected: str | None = None,
        hint: str | None = None,
    ) -> UsageError:
        """The error of one of its keys, or of itself without a key."""
        where = f"{self.name}.{key}" if key else self.name
        return UsageError(message, where=where, got=got, expected=expected, hint=hint)

    def __repr__(self) -> str:
        joined = ", ".join(f"{pin} = {target}" for pin, target in self.pins.items())
        return f"<{self.type.name} {self.name}{': ' + joined if joined else ''}>"


SCALE_OF = {"transient": "s", "ac": "Hz", "noise": "Hz"}  # units by type of analysis


class Analysis(Section):
    """What the simulator does with the circuit."""

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
        "log", description="Spacing of the frequencies of ac and noise; linear may begin at 0 Hz"
    )
    output: str | None = Field(
        None, description="Output of a noise analysis: a result such as disc.u, or PART.PIN"
    )
    sweep: str | None = Field(None, description="Key that a dc analysis varies, PART.KEY")
    from_: Any = Field(0.0, alias="from", description="First value of a dc analysis")
    to: Any = Field(1.0, description="Last value of a dc analysis")
    back: bool | None = Field(
        None,
        description=("Whether a dc analysis returns to its first value; its scale goes on growing"),
    )

    @field_validator("stop", mode="before")
    @classmethod
    def _stops(cls, stop: Any, info: ValidationInfo) -> Any:
        """The end of a transient is a time, that of ac and noise a frequency."""
        unit = SCALE_OF.get(info.data.get("type", ""))
        if stop is None or unit is None:
            return stop
        try:
            return quantity(stop, unit)
        except UsageError as error:
            raise refused(error.message, error.expected) from None

    @model_validator(mode="after")
    def _from_zero(self) -> Analysis:
        """A range from 0 Hz is linear, unless its author says otherwise."""
        if self.small and self.start == 0 and "scale" not in self.model_fields_set:
            self.__dict__["scale"] = "linear"
        return self

    @property
    def small(self) -> bool:
        """Whether it is linear in signals about an operating point, over frequency."""
        return self.type in ("ac", "noise")


class Probe(Section):
    """A vector of the result and what to take of it; becomes a metric.

    ``argmax`` is where on the scale (Hz in ``ac``, s in a transient) the largest value lies,
    ``value`` what the vector has ``at`` a place of the scale, ``frequency`` the mean rate of its
    cycles over the last half of the run. Complex values are taken by magnitude. A window, ``from``
    and ``to`` or the last ``periods``, is all that a probe reads, such as a steady state.
    """

    of: str = Field(
        description=(
            "Result that the probe reads: disc.x, NETLIST.NODE, or PART.current, PART.PIN.current "
            "and PART.power of a part with electrical pins"
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
        description=("Quantity that the probe takes of the result; value reads it where `at` says"),
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
        """Its places on the scale of the analysis by their keys."""
        given = {"at": self.at, "from": self.from_, "to": self.to}
        return {key: place for key, place in given.items() if place is not None}

    @model_validator(mode="before")
    @classmethod
    def _value_at(cls, data: Any) -> Any:
        return {"take": "value", **data} if isinstance(data, dict) and "at" in data else data

    @model_validator(mode="after")
    def _goes_together(self) -> Self:
        for take, key in (("value", "at"), ("crossing", "level")):
            if (self.take == take) != (getattr(self, key) is not None):
                raise refused(f"{key} goes with {take}", f'take = "{take}" and {key}, or neither')
        window = (self.from_, self.to, self.periods)
        if self.at is not None and any(item is not None for item in window):
            raise refused("at beside a window", "at, or from and to, or periods")
        if self.periods is not None and (self.from_ is not None or self.to is not None):
            raise refused("periods beside from or to", "periods, or from and to")
        if self.from_ is not None and self.to is not None and self.from_ >= self.to:
            raise refused("empty window", "from < to")
        return self


class Frame(Section):
    """Keys of a scene outside of its parts."""

    name: str = Field(
        pattern=r"^[A-Za-z][A-Za-z0-9_]{0,63}$",
        description="Name of the scene; by default that of its file",
    )
    title: str = Field(
        "", max_length=200, pattern=rf"^{_ONE_LINE}*$", description="Title of the scene, one line"
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
    gates: Gates = Gates()
    bench: Bench = Bench()
    include: tuple[FileName, ...] = Field(
        (), max_length=16, description="Netlist files beside the scene that its deck includes"
    )


class Names:
    """A name for each key, the wanted one unless it is ``taken``, in whatever case."""

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self.taken = {name.lower() for name in taken}
        self.given: dict[Hashable, str] = {}

    def name(self, key: Hashable, wanted: str) -> str:
        """The name of ``key``, given when it is first asked for."""
        if key not in self.given:
            free, count = wanted, 1
            while free.lower() in self.taken:
                count += 1
                free = f"{wanted}_{count}"
            self.taken.add(free.lower())
            self.given[key] = free
        return self.given[key]


@dataclass(frozen=True, eq=False)
class Scene:
    """A checked scene. ``parts`` are in the order of the file, what they expand to behind them.

    ``terminals`` has every pin by ``(part, pin)``, ``nets`` its node of the netlist (``"0"`` is
    ground); ``own`` gives ``(part, *words)`` the name of what else the part has there
    (:meth:`kc2spice.scene.parttype.Build.own`); ``shaken`` has the shaken frame that the
    displacements of a net are relative to, by node; ``home`` is the folder of the scene's file,
    ``tables`` what it says with all overrides. Bodies keep the ``ports`` that are needed, in an
    export all that their author declares, joined or not
    (:meth:`Part.declares`), for documentation all of them.
    """

    frame: Frame
    parts: Mapping[str, Part]
    terminals: Mapping[tuple[str, str], Terminal] = field(default_factory=dict)
    nets: Mapping[tuple[str, str], str] = field(default_factory=dict)
    own: Names = field(default_factory=Names)
    shaken: Mapping[str, ShakenFrame] = field(default_factory=dict)
    home: Path = Path()
    tables: Mapping[str, Any] = field(default_factory=dict)
    ports: Literal["needed", "declared", "all"] = "needed"

    def __getattr__(self, name: str) -> Any:
        """Keys of the frame: ``scene.solver``, ``scene.rom``, ``scene.gravity``, …"""
        if name.startswith("_") or name == "frame":
            raise AttributeError(name)
        return getattr(self.frame, name)

    @property
    def stop(self) -> float:
        """End of a transient [s]: ``analysis.stop``, else ``solver.stop``."""
        own = self.analysis.stop if self.analysis.type == "transient" else None
        return float(self.solver.stop if own is None else own)

    def of(self, *types: str) -> tuple[Part, ...]:
        """All parts of these types, in order."""
        return tuple(part for part in self.parts.values() if part.type.name in types)

    def only(self, *types: str) -> Part | None:
        """The part of one of these types if there is exactly one, else None."""
        result = self.of(*types)
        return result[0] if len(result) == 1 else None

    def part(self, name: str, where: str = "scene") -> Part:
        """The part of this name.

        Raises
        ------
        UsageError : there is none.
        """
        if name not in self.parts:
            raise unknown("no such part", name, self.parts, where)
        return self.parts[name]

    def partner(self, part: Part, kind: str, key: str = "") -> Part:
        """The part of type ``kind`` that ``part`` names under ``key``, else the only one.

        Raises
        ------
        UsageError : none is named and there is not exactly one.
        """
        name, table = getattr(part.keys, key, None), TABLES.get(kind, kind)
        if name is not None:
            return self.part(name, f"{part.name}.{key}")
        result = self.of(kind)
        if not result:
            raise UsageError(
                f"{part.name} needs this part",
                where=table,
                hint=f"add [{table}]; an empty table takes the defaults",
            )
        if len(result) > 1:
            raise UsageError(
                f"{part.name} needs to know which {kind} is meant",
                where=f"{part.name}.{key}",
                got=", ".join(item.name for item in result),
                expected=f"{key or 'one'} = NAME",
            )
        return result[0]

    def named(self, part: str, pin: str) -> bool:
        """Whether the ``pins`` of another part name this one, so that no default joins it."""
        target = f"{part}.{pin}"
        return any(target in other.pins.values() for other in self.parts.values())

    def net(self, part: str, pin: str) -> str:
        """Node of the netlist that a pin is joined to."""
        return self.nets[part, pin]

    def shaken_frame(self, part: str, pin: str) -> ShakenFrame | None:
        """The shaken frame that a pin's displacement is relative to, None where it is absolute."""
        return self.shaken.get(self.nets.get((part, pin), ""))

    def joined(self, part: str, pin: str) -> tuple[tuple[str, str], ...]:
        """The other pins on the net of this one; none for ground."""
        net = self.nets[part, pin]
        if net == "0":
            return ()
        return tuple(key for key, other in self.nets.items() if other == net and key != (part, pin))

    def __repr__(self) -> str:
        parts = ", ".join(f"{part.name}: {part.type.name}" for part in self.parts.values())
        return f"<Scene {self.name} ({self.analysis.type}): {parts}>"


def scene_hash(scene: Scene) -> str:
    """First 16 hex digits of the SHA-256 of all numbers and choices that a netlist depends on.

    Names and titles are free, and so are gates and what is done about a run that fails; keys that
    are not given do not count, so that a new one changes no old scene. Floats enter with all their
    digits, so equal hashes mean bit-equal netlists.
    """
    without = {"name", "title", "checks", "gates", "bench"}
    content = scene.frame.model_dump(mode="json", exclude=without, exclude_none=True)
    del content["solver"]["retries"]
    content["parts"] = {
        part.name: [
            part.type.name,
            part.keys.model_dump(mode="json", exclude_none=True),
            dict(part.pins),
        ]
        for part in scene.parts.values()
    }
    several = scene.parts.values() if len(scene.parts) > 1 else ()  # one keeps all in any case
    if scene.ports == "declared" and (whole := [p.name for p in several if p.declares(scene)]):
        content["every_port"] = whole
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]
