"""What is judged of a finished run: checks against physics and energy balances."""

from __future__ import annotations

from dataclasses import dataclass

from kc2spice.core.errors import SimulationError
from kc2spice.scene.settings import Action


@dataclass(frozen=True)
class Check:
    """One check: ``value`` must not exceed ``limit``; ``advice`` is for the case that it does.

    ``action`` says what a violation does to the run. A ``coarse`` check fails for too large steps,
    which tighter tolerances may cure. A ``wiring`` check holds the netlist against the scene, from
    which a deck that somebody edited may differ on purpose. ``mend`` is a dotted key and its value
    by which the scene would not violate it, where that is known and nobody chose otherwise.
    """

    name: str
    value: float
    limit: float
    unit: str
    advice: str
    action: Action = "fail"
    coarse: bool = False
    wiring: bool = False
    mend: tuple[str, int] | None = None

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


@dataclass(frozen=True)
class Balance:
    """An energy balance: ``entries`` [J] at the end of the run, ``missing`` [J] the largest gap at
    any time, ``scale`` [J] what it is measured against, ``limit`` the share that may be missing.
    """

    entries: dict[str, float]
    missing: float
    scale: float
    limit: float
    advice: str = "the steps are too coarse: lower solver.reltol"

    @property
    def share(self) -> float:
        """``missing`` as a share of ``scale``."""
        return self.missing / self.scale if self.scale else self.missing


@dataclass(frozen=True)
class Verdict:
    """All checks of a run, and the energy balances behind some of them."""

    checks: tuple[Check, ...] = ()
    balances: tuple[tuple[str, Balance], ...] = ()


def require(checks: tuple[Check, ...], where: str) -> None:
    """Raise for the first violated check that fails the run.

    Raises
    ------
    SimulationError : a violated check.
    """
    for check in checks:
        if check.fatal:
            raise SimulationError(
                f"the result contradicts physics: {check.name}",
                where=where,
                got=f"{check.value:g} {check.unit}",
                expected=f"at most {check.limit:g} {check.unit}",
                hint=check.advice,
            )
