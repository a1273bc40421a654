"""What a verification found: checks against gates, errors between the roads, and their times."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from kc2spice.core.waveforms import Waveforms
from kc2spice.report.plots import Picture


@dataclass(frozen=True)
class Check:
    """One number against its gate. ``value`` None (not reached) fails."""

    name: str
    value: float | None
    limit: float
    unit: str = "1"

    @property
    def passed(self) -> bool:
        """Whether the value is within the limit."""
        return self.value is not None and self.value <= self.limit


@dataclass(frozen=True)
class Road:
    """One way to the result, its wall time and its errors against ``against``."""

    name: str
    wall_s: float
    against: str = ""
    errors: dict[str, float | None] = field(default_factory=dict)


@dataclass(frozen=True)
class OutputError:
    """Largest and rms error of one output over all points of one pair of roads, relative to the
    exact response at each point (harmonic) or to the output's largest value (all others)."""

    pair: str
    output: str
    largest: float
    rms: float


@dataclass(frozen=True)
class StepPoint:
    """One setting of ngspice: what it cost and how far it is from the exact integration."""

    reltol: float
    max_step_s: float
    accepted: int
    cpu_s: float
    position: float | None
    velocity: float | None


@dataclass(frozen=True)
class Findings:
    """Outcome of one scene's verification.

    ``errors`` holds ``rom_vs_fom``, ``ngspice_vs_rom`` and ``ngspice_vs_fom`` (largest relative),
    ``speedup`` the ratios ``refactor`` and ``low_rank`` of a full-model baseline's time to the
    netlist's, where the scene has them; ``curves`` the waveforms of each road, the
    most exact one first.
    """

    checks: tuple[Check, ...]
    errors: dict[str, float]
    speedup: dict[str, float]
    roads: tuple[Road, ...]
    metrics: dict[str, Any]
    outputs: tuple[OutputError, ...] = ()
    steps: tuple[StepPoint, ...] = ()
    notes: tuple[str, ...] = ()
    curves: dict[str, Waveforms] = field(default_factory=dict)
    pictures: tuple[Picture, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every check is."""
        return all(check.passed for check in self.checks)
