"""Records of metrics, checks, energy balances and error limits of a run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import SimulationError
from kc2spice.core.si_prefix_format import format_value_and_limit, remove_unit_words
from kc2spice.scene.settings import Action, SolverKeys

if TYPE_CHECKING:
    import numpy as np

SOLUTION_PAIRS = ("rom_vs_fom", "ngspice_vs_rom", "ngspice_vs_fom")
Measure = Literal["relative", "absolute", "travel", "largest", "spectral"]


@dataclass(frozen=True)
class Metric:
    """Metric of a result: a number, an array or a table of numbers, with the SI unit.

    The unit of a pure number is ``""``. The name of a metric does not determine its unit, because
    the author of a part may choose the name freely. If ``warning`` is set, the summary of a run
    prints the text ``warning`` as a warning in place of the metric. If the value lies between two
    points of a sweep, ``resolution`` is half the distance between these points, in the unit of the
    metric. ``curve`` states that the value is an array over the frequencies of an ac analysis.
    ``scope`` is the name of the part if the value does not include the circuit around the part;
    otherwise, ``scope`` is empty.
    """

    value: Any
    unit: str = ""
    warning: str = ""
    resolution: float = 0.0
    curve: bool = False
    scope: str = ""


@dataclass(frozen=True)
class Check:
    """Check of a run: a value, its limit, and the effect of a violation.

    The value must not exceed ``limit``. The value is NaN if the run did not reach the checked
    event. ``advice`` states what to do if the check is violated. ``action`` is the effect of a
    violation on the run. ``coarse`` is true if too large time steps can cause a violation of the
    check. If only checks with ``coarse = True`` fail, the run is repeated with tighter tolerances.
    If ``wiring`` is true, the check compares the netlist with the scene. In an edited deck, netlist
    and scene may differ intentionally, so a violated ``wiring`` check of an edited deck only prints
    a warning. ``suggested`` contains dotted keys with values that avoid the violation.
    ``suggested`` is empty if no key values are known that avoid the violation, or if the scene
    itself sets the keys. If ``discretisation`` is true, the check compares a model with a finer
    model at the frequencies of the run. If the command ``verify`` solves a transient with a finer
    model, ``verify`` omits checks with ``discretisation = True``.

    If ``loaded`` is true, the value is the relative error of a reduced body under the recorded
    loads of a transient. In a check of a motion, ``distance`` is the smallest distance between an
    extreme position of the motion and an end of its permitted range. ``travel`` is the range of the
    motion. ``distance`` and ``travel`` have the unit of the check.

    ``label`` is the printed label of the check. The default label is the name of the check. If the
    errors of reduced bodies may change the outcome of the check, an additional violated check has
    the label ``undecided_label``.

    ``found`` and ``accepted`` are texts for the error message of a violated check. ``found`` states
    the result of the run, such as ``heights from 2 mm to 9 mm``. ``accepted`` states the permitted
    results, such as ``heights from 0 mm to 8 mm``. ``found`` and ``accepted`` are set only if a
    violation of the check is due to a value in the scene. If ``accepted`` is set, no files of a run
    that fails the check are kept, because the error message already names the key to change.
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
    label: str = ""
    undecided_label: str = ""

    @property
    def passed(self) -> bool:
        """Whether the value is within the limit (False for NaN)."""
        return self.value <= self.limit

    @property
    def printed_label(self) -> str:
        """Label of the check; without a label, the name of the check."""
        if self.label:
            return self.label
        # a name with blanks may contain scene keys, whose underscores must remain
        return self.name if " " in self.name else self.name.replace("_", " ")

    @property
    def is_fatal(self) -> bool:
        """Whether a violation of the check fails the run."""
        return self.action == "fail" and not self.passed

    @property
    def violation(self) -> str:
        """Text of the warning that a violation of the check causes."""
        value, limit = format_value_and_limit(self.value, self.limit, remove_unit_words(self.unit))
        return f"failed check: {self.printed_label}: {value}, limit {limit}: {self.advice}"

    def make_record(self) -> dict[str, object]:
        """Return the check as an entry of ``result.json``."""
        names = ("name", "value", "limit", "unit", "passed", "action", "advice")
        record = {name: getattr(self, name) for name in names}
        return {**record, "label": self.printed_label}


@dataclass(frozen=True, eq=False)
class RunEnergyBalance(EqualByContent):
    """Energy balance of a part or of a whole run.

    ``entries`` [J] are the energies at the end of the run. ``missing`` [J] is the largest error of
    the balance at any time. The relative error of the balance is ``missing`` divided by the energy
    ``scale`` [J]. ``limit`` is the largest accepted relative error of the balance. For a linear
    part, ``exact`` contains two arrays for each wave: the values of the run, and the exact response
    to the loads.
    """

    entries: dict[str, float]
    missing: float
    scale: float
    limit: float
    advice: str = "the steps are too coarse: lower solver.reltol"
    exact: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, repr=False)

    @property
    def relative_imbalance(self) -> float:
        """Largest error of the energy balance, divided by the energy ``scale``."""
        return self.missing / self.scale if self.scale else self.missing


@dataclass(frozen=True)
class Verdict:
    """Verdict on a run: its checks, energy balances and error limits.

    The entries of ``balances`` and ``gates`` are pairs of a part name and a record.
    """

    checks: tuple[Check, ...] = ()
    balances: tuple[tuple[str, RunEnergyBalance], ...] = ()
    gates: tuple[tuple[str, Gate], ...] = ()


def require_passed(checks: tuple[Check, ...], where: str) -> None:
    """Raise an error for the first violated check whose ``action`` is ``"fail"``.

    Raises
    ------
    SimulationError : a check with the action ``"fail"`` is violated.
    """
    for check in checks:
        if check.is_fatal:
            value, limit = format_value_and_limit(check.value, check.limit, check.unit)
            cause, colon, action = check.advice.partition(": ")
            if "(" in cause:
                cause, colon, action = "", "", ""
            raise SimulationError(
                f"{cause} (check: {check.printed_label})"
                if colon
                else f"a check of the result failed: {check.printed_label}",
                where=where,
                got=check.found or value,
                expected=check.accepted or f"at most {limit}",
                hint=action or check.advice,
            )


def compute_motion_error_limit(solver: SolverKeys) -> float:
    """Return the largest accepted relative error of motions that ngspice computes.

    The error is the difference from the motion in the reference solution. At the usual tolerances
    ``reltol`` and ``chgtol``, the errors are 1e-5 to 3e-5. The errors are proportional to ``(reltol
    * chgtol)^0.55``.
    """
    return float(4e-5 * (solver.reltol * solver.chgtol / 1e-12) ** 0.55)


@dataclass(frozen=True)
class Gate:
    """Gate of ``verify``: largest accepted difference of a result between solutions.

    ``result`` is the name of a metric or a wave, or a prefix of names with a final ``*``.
    ``limits`` contains the largest accepted difference for each pair of solutions. ``measure``
    states how the difference is measured:

    * *relative*: difference of each value divided by the value; values of a waveform below 1e-6 of
      its largest value are ignored;
    * *absolute*: difference in ``unit``; *travel*: difference divided by the range of the waveform;
    * *largest*: difference divided by the largest value of all waveforms;
    * *spectral*: difference of each entry of a response, divided by the magnitude of the entry or
      by 1e-6 of its peak, whichever is larger.

    ``share`` is the compared fraction of the time or frequency range, counted from the start of the
    range. For each pair of solutions, a verification records one error: the largest difference
    among all gates with ``is_main = True``. If ``discretisation`` is true, a transient is compared
    with a solution on a finer mesh. Only a part that has a gate with ``discretisation = True`` is
    solved on a finer mesh.
    """

    description: str
    result: str
    limits: Mapping[str, float]
    measure: Measure = "relative"
    unit: str = "1"
    is_main: bool = False
    share: float = 1.0
    discretisation: bool = False
