"""Metrics of a result, and its checks: physics, energy balances, and gates of ``verify``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import SimulationError
from kc2spice.scene.settings import Action, Solver

if TYPE_CHECKING:
    import numpy as np

PAIRS = ("rom_vs_fom", "ngspice_vs_rom", "ngspice_vs_fom")
Measure = Literal["relative", "absolute", "travel", "largest", "spectral"]


@dataclass(frozen=True)
class Metric:
    """A number of a result, or an array or table of numbers, and its SI unit: ``""`` of a pure one.

    Readers get the unit from here, never from the metric's name, which an author may choose freely.
    """

    value: Any
    unit: str = ""


@dataclass(frozen=True)
class Check:
    """One check: ``value`` must not exceed ``limit``; ``advice`` is for the case that it does.

    A value that was not reached is no number.

    ``action`` says what a violation does to the run. A ``coarse`` check fails for too large steps,
    which tighter tolerances may cure. A ``wiring`` check holds the netlist against the scene, from
    which a deck that somebody edited may differ on purpose. ``suggested`` are dotted keys and their
    values by which the scene would not violate it, where these are known and not set.
    A check of the ``discretisation`` compares it with a finer one at the frequencies of the run;
    ``verify`` counts it in time, where it does not follow the finer one.

    The value of a ``loaded`` check is the relative error of a reduced body under the recorded loads
    of a transient. ``distance`` is that of a motion from the limit, on either side, and ``travel``
    the range of this motion, both in the unit of the check.
    """

    name: str
    value: float
    limit: float
    unit: str = "1"
    advice: str = ""
    action: Action = "fail"
    coarse: bool = False
    wiring: bool = False
    discretisation: bool = False
    suggested: Mapping[str, Any] = field(default_factory=dict)
    loaded: bool = False
    distance: float = math.inf
    travel: float = 0.0

    @property
    def passed(self) -> bool:
        """False also for a value that is not a number."""
        return self.value <= self.limit

    @property
    def fatal(self) -> bool:
        """Does it fail the run?"""
        return self.action == "fail" and not self.passed

    def record(self) -> dict[str, object]:
        """Its row of ``result.json``."""
        names = ("name", "value", "limit", "unit", "passed", "action", "advice")
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True, eq=False)
class Balance(EqualByContent):
    """An energy balance: ``entries`` [J] at the end of the run, ``missing`` [J] the largest gap at
    any time, ``scale`` [J] what it is measured against, ``limit`` the share that may be missing.

    ``exact`` has by wave what the run has and what a linear part answers exactly to its loads.
    """

    entries: dict[str, float]
    missing: float
    scale: float
    limit: float
    advice: str = "the steps are too coarse: lower solver.reltol"
    exact: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, repr=False)

    @property
    def share(self) -> float:
        """``missing`` as a share of ``scale``."""
        return self.missing / self.scale if self.scale else self.missing


@dataclass(frozen=True)
class Verdict:
    """All checks of a run, the energy balances behind some of them, and the gates of ``verify``, by
    the parts that have them."""

    checks: tuple[Check, ...] = ()
    balances: tuple[tuple[str, Balance], ...] = ()
    gates: tuple[tuple[str, Gate], ...] = ()


def require(checks: tuple[Check, ...], where: str) -> None:
    """Raise for the first violated check that fails the run.

    Raises
    ------
    SimulationError : a violated check.
    """
    for check in checks:
        if check.fatal:
            raise SimulationError(
                f"a check of the result failed: {check.name}",
                where=where,
                got=f"{check.value:g} {check.unit}",
                expected=f"at most {check.limit:g} {check.unit}",
                hint=check.advice,
            )


def stepping(solver: Solver) -> float:
    """Gate of motion in ngspice against the same laws, relative.

    At the usual tolerances 1e-5 to 3e-5 are found; errors fall as ``(reltol chgtol)^0.55``.
    """
    return float(4e-5 * (solver.reltol * solver.chgtol / 1e-12) ** 0.55)


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
    it stands for the scene in ``errors``. In a transient, a gate of the ``discretisation`` of a
    part compares with a finer one of this part alone.
    """

    words: str
    of: str
    limits: Mapping[str, float]
    measure: Measure = "relative"
    unit: str = "1"
    leads: bool = False
    share: float = 1.0
    discretisation: bool = False
