"""Metrics and checks of a result: physics, energy balances, error limits of ``verify``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import SimulationError
from kc2spice.core.prefix import format_value_and_limit
from kc2spice.scene.settings import Action, Solver

if TYPE_CHECKING:
    import numpy as np

SOLUTION_PAIRS = ("rom_vs_fom", "ngspice_vs_rom", "ngspice_vs_fom")
Measure = Literal["relative", "absolute", "travel", "largest", "spectral"]


@dataclass(frozen=True)
class Metric:
    """Number, array or table of numbers of a result with its SI unit.

    The unit of a pure number is ``""``. The name of a metric does not determine its unit, because
    an author may choose it freely.
    """

    value: Any
    unit: str = ""


@dataclass(frozen=True)
class Check:
    """Check that ``value`` does not exceed ``limit``, with ``advice`` for a violation.

    A value that was not reached is NaN. ``action`` is the effect of a violation on the run. A
    ``coarse`` check fails if steps are too large; tighter tolerances may correct this. A ``wiring``
    check compares the netlist with the scene; an edited deck may differ intentionally.
    ``suggested`` contains dotted keys with values that avoid the violation, if they are known and
    not set. A check of the ``discretisation`` compares a model with a finer model at the
    frequencies of the run. In a transient, ``verify`` includes this check unless it solves the
    finer model.

    The value of a ``loaded`` check is the relative error of a reduced body under the recorded loads
    of a transient. ``distance`` is the distance of a motion from the limit, on either side.
    ``travel`` is the range of this motion. ``distance`` and ``travel`` have the unit of the check.
    ``found`` and ``accepted`` describe the value and its limit in the quantities of the scene. A
    run that violates such a check leaves no files, because the input is the cause.
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
    found: str = ""
    accepted: str = ""

    @property
    def passed(self) -> bool:
        """Whether the value is within the limit; False for NaN."""
        return self.value <= self.limit

    @property
    def is_fatal(self) -> bool:
        """Whether the check fails the run."""
        return self.action == "fail" and not self.passed

    def record(self) -> dict[str, object]:
        """Return the row of the check in ``result.json``."""
        names = ("name", "value", "limit", "unit", "passed", "action", "advice")
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True, eq=False)
class Balance(EqualByContent):
    """Energy balance of a run.

    ``entries`` [J] are the energies at the end, ``missing`` [J] is the largest error at any time.
    ``limit`` is the largest ratio of ``missing`` to ``scale`` [J]. ``exact`` contains, for each
    wave, the values of the run and the exact response of a linear part to its loads.
    """

    entries: dict[str, float]
    missing: float
    scale: float
    limit: float
    advice: str = "the steps are too coarse: lower solver.reltol"
    exact: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, repr=False)

    @property
    def share(self) -> float:
        """Ratio of ``missing`` to ``scale``."""
        return self.missing / self.scale if self.scale else self.missing


@dataclass(frozen=True)
class Verdict:
    """All checks of a run, with energy balances and error limits, keyed by part."""

    checks: tuple[Check, ...] = ()
    balances: tuple[tuple[str, Balance], ...] = ()
    gates: tuple[tuple[str, Gate], ...] = ()


def require_passed(checks: tuple[Check, ...], where: str) -> None:
    """Raise an error for the first violated check that fails the run.

    Raises
    ------
    SimulationError : a violated check.
    """
    for check in checks:
        if check.is_fatal:
            value, limit = format_value_and_limit(check.value, check.limit, check.unit)
            # the sentence contains names of keys in the user's spelling
            name = check.name if " " in check.name else check.name.replace("_", " ")
            cause, colon, action = check.advice.partition(": ")
            if "(" in cause:
                cause, colon, action = "", "", ""
            raise SimulationError(
                f"{cause} (check: {name})" if colon else f"a check of the result failed: {name}",
                where=where,
                got=check.found or value,
                expected=check.accepted or f"at most {limit}",
                hint=action or check.advice,
            )


def motion_error_limit(solver: Solver) -> float:
    """Return the relative error limit of motions in ngspice against the reference solver.

    At the usual tolerances, errors are 1e-5 to 3e-5. The differences fall as ``(reltol
    chgtol)^0.55``.
    """
    return float(4e-5 * (solver.reltol * solver.chgtol / 1e-12) ** 0.55)


@dataclass(frozen=True)
class Gate:
    """Largest accepted difference between two solutions in one result.

    ``of`` is the name of a metric or of waves (a prefix ends with ``*``). ``limits`` contains the
    largest difference for each pair of solutions. ``measure`` is the measure of the difference:

    * * *relative*: each value by its size (arrays: values above 1e-6 of the largest);
    * *absolute*: in ``unit``; *travel*: by the swing of the wave;
    * *largest*: by the largest value of all waves together;
    * *spectral*: each entry of a response by its size, at least 1e-6 of its peak.

    ``share`` is the part of the scale, from its start on, that is compared; ``leads`` states
    whether the difference is the one of the scene in ``errors``. In a transient, a gate of the
    ``discretisation`` compares with a finer mesh of this part only.
    """

    words: str
    of: str
    limits: Mapping[str, float]
    measure: Measure = "relative"
    unit: str = "1"
    leads: bool = False
    share: float = 1.0
    discretisation: bool = False
