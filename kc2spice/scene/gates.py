"""What ``verify`` asks of parts: gates of results, solutions with the full model and their cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from kc2spice.core.waveforms import Waveforms

if TYPE_CHECKING:
    from kc2spice.scene.parttype import Build
    from kc2spice.scene.settings import Solver

PAIRS = ("rom_vs_fom", "ngspice_vs_rom", "ngspice_vs_fom")
Measure = Literal["relative", "absolute", "travel", "largest", "spectral"]


def stepping(solver: Solver) -> float:
    """Gate of motion in ngspice against the same laws, relative.

    At the usual tolerances 1e-5 to 3e-5 are found; errors fall as ``(reltol chgtol)^0.55``.
    """
    return float(4e-5 * (solver.reltol * solver.chgtol / 1e-12) ** 0.55)


@dataclass(frozen=True)
class Limit:
    """A number against its gate. ``value`` None (not reached) fails."""

    name: str
    value: float | None
    limit: float
    unit: str = "1"

    @property
    def passed(self) -> bool:
        """Whether the value is within the limit; False for what is no number."""
        return self.value is not None and self.value <= self.limit


@dataclass(frozen=True)
class Gate:
    """How far two solutions may differ in one result.

    ``of`` is a metric or waves by name (a prefix ends with ``*``); ``limits`` has the largest
    difference for each pair of solutions, and ``measure`` says what of it:

    * *relative*: each value by its own size (arrays: where it exceeds 1e-6 of the largest);
    * *absolute*: in ``unit``; *travel*: by the swing of the wave;
    * *largest*: by the largest value of all waves together;
    * *spectral*: each entry of a response by its size, at least 1e-6 of its peak.

    ``share`` is the part of the scale, from its start on, that is looked at; ``leads`` says whether
    it stands for the scene in ``errors``.
    """

    words: str
    of: str
    limits: Mapping[str, float]
    measure: Measure = "relative"
    unit: str = "1"
    leads: bool = False
    share: float = 1.0


@dataclass(frozen=True)
class Cost:
    """One solution path: its wall time, and its errors by gate against ``against``."""

    name: str
    wall_s: float
    against: str = ""
    errors: Mapping[str, float | None] = field(default_factory=dict)


@dataclass(frozen=True)
class FullSolution:
    """What a full model gave.

    ``build`` is the scene that was solved, which may be a piece of the asked one, ``piece`` what
    it is called then. ``baselines`` are wall times [s] that ``speedup`` compares with the netlist:
    ``refactor`` factorises in every iteration, ``low_rank`` once.
    """

    waves: Waveforms
    build: Build
    wall_s: float
    piece: str = ""
    baselines: Mapping[str, float] = field(default_factory=dict)
    checks: tuple[Limit, ...] = ()
    metrics: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Table:
    """A study as a table: ``rows`` of the columns in ``head``, as texts, and as ``records``."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str
    records: tuple[Mapping[str, Any], ...]
