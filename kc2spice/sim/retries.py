"""Runs a deck until its result can be believed: what failed once is tried with other settings."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.cards import number
from kc2spice.netlist.deck import Deck
from kc2spice.scene.judge import Check, Verdict, require
from kc2spice.sim.log import FailedRunError, Failure, Kind
from kc2spice.sim.ngspice import own_reltol, run_deck

# "coarse": ngspice finished, but the energy balances of the result do not close.
Cause = Kind | Literal["coarse"]
_CHGTOL = "1e-14"  # ngspice's own, where the deck says nothing
_ADVICE: Mapping[str, str] = {
    "timestep": "try a larger kick.damping.ratio, a smaller contact.penalty or solver.max_step",
    "singular": "look for loops of voltage sources, nodes between capacitors and parts of value 0",
    "operating point": "look for the included circuit's state at t = 0; give it a .nodeset",
}


@dataclass(frozen=True)
class RetrySetting:
    """One way to try again: entries of a deck's options, and a ``factor`` on its tolerances and
    step limit. ``cures`` are the causes that it is for, ``why`` it may help."""

    name: str
    cures: tuple[Cause, ...]
    why: str
    options: Mapping[str, str] = field(default_factory=dict)
    factor: float = 1.0

    def after(self, other: RetrySetting) -> RetrySetting:
        """This one, with what ``other`` changed kept."""
        options = {**other.options, **self.options}
        return RetrySetting(self.name, self.cures, self.why, options, self.factor * other.factor)

    @property
    def changes(self) -> str:
        """In words."""
        words = [f"{key}={value}" for key, value in self.options.items()]
        if self.factor != 1.0:
            words.append(f"reltol, chgtol and largest step times {self.factor:g}")
        return ", ".join(words) or "unchanged"

    def of(self, deck: Deck) -> Deck:
        """``deck`` with these settings instead of its own options."""
        options = dict(self.options)
        if self.factor != 1.0:
            options["reltol"] = number(self.factor * own_reltol(deck))
            options["chgtol"] = number(self.factor * float(deck.option("chgtol") or _CHGTOL))
        if not options:
            return deck
        changed = deck.with_options(options, f"retry with {self.name}: {self.why}")
        return changed.with_steps(self.factor)


FIRST = RetrySetting("the scene's own settings", (), "")
# Measured on the kick at a penalty of 1e11 and 1e12 N/m, where the scene's own settings end in
# "timestep too small": firmer pivots finish at 1.2 to 2 times the cost a point; gear alone, tighter
# tolerances alone and more iterations never do. Gear on firmer pivots ends ringing at the last
# bit that makes the trapezoidal rule crawl, at about twice the error a step.
RETRIES = (
    RetrySetting(
        "firmer pivots",
        ("timestep", "singular"),
        "the pivots chosen at the first step lose the digits that short steps need",
        {"pivrel": "0.1"},
    ),
    RetrySetting(
        "gear",
        ("timestep",),
        "the trapezoidal rule rings at switching edges and in stiff contact",
        {"pivrel": "0.1", "method": "gear"},
    ),
    RetrySetting(
        "tighter tolerances",
        ("coarse", "timestep"),
        "the steps are too coarse for the contact",
        factor=0.1,
    ),
    RetrySetting(
        "much tighter tolerances",
        ("coarse",),
        "the steps are still too coarse for the contact",
        factor=0.1,
    ),
)


@dataclass(frozen=True)
class Attempt:
    """One setting that was tried, as ``result.json`` has it: ``cause`` is None for the one that
    succeeded."""

    setting: str
    settings: str
    cause: str | None
    node: str | None
    time: float | None
    part: str | None
    wall_s: float
    points: int | None


@dataclass(frozen=True)
class Outcome:
    """The result of the first attempt that succeeded, its deck, and all that was tried."""

    deck: Deck
    waves: Waveforms
    verdict: Verdict
    attempts: tuple[Attempt, ...]


class RetriesFailedError(SimulationError):
    """No attempt of ``attempts`` succeeded; ``failure`` is the one that got farthest.

    ``mends`` are keys of the scene, and values, that would cure all checks that the last violated.
    """

    attempts: tuple[Attempt, ...]
    failure: Failure | None
    mends: Mapping[str, int]


def run_with_retries(
    deck: Deck,
    directory: Path,
    *,
    retries: int,
    judge: Callable[[Waveforms], Verdict] = lambda waves: Verdict(),
    engine: Callable[[Deck], Waveforms] | None = None,
    progress: Callable[[float], None] | None = None,
    timeout: float | None = None,
) -> Outcome:
    """Run ``deck`` in ``directory``; after a failure that settings may cure, with the next setting.

    The cause of each failure picks the setting; what earlier ones changed stays changed. Every
    retry is announced by a warning. ``judge`` checks a finished run; violated energy balances count
    as failures of too coarse steps. ``engine`` runs the deck instead of the simulator's own
    process. ``timeout`` [s] is that of each attempt.

    Raises
    ------
    RetriesFailedError : the last attempt failed; names node, time, part, all settings, what to try.
    SimulationError, MissingToolError : as :func:`run_deck`, for what no setting cures.
    """
    setting, left = FIRST, list(RETRIES)
    attempts: list[Attempt] = []
    farthest: Failure | None = None
    while True:
        tried = setting.of(deck)
        violated: list[Check] = []
        failure, points = Failure(""), None
        cause: Cause | None = None
        start = time.perf_counter()
        try:
            waves = engine(tried) if engine else run_deck(tried, directory, progress, timeout)
            verdict = judge(waves)
            points = waves["time"].size if "time" in waves else None
            violated = [check for check in verdict.checks if check.fatal]
            require(verdict.checks, deck.name)
        except SimulationError as raised:
            error: SimulationError = raised
            if isinstance(raised, FailedRunError):
                failure, cause = raised.failure, raised.failure.kind
                if farthest is None or (failure.time or 0.0) > (farthest.time or 0.0):
                    farthest = failure
            elif violated:
                first = violated[0]
                failure = Failure(f"{first.name}: {first.value:.3g} {first.unit}")
                # Outside of what is modelled no tolerance makes the result right.
                cause = "coarse" if all(check.coarse for check in violated) else None
            else:
                raise
        blame = failure.cause or None, failure.node, failure.time, failure.part
        wall = time.perf_counter() - start
        attempts.append(Attempt(setting.name, setting.changes, *blame, wall, points))
        if not failure.cause:
            return Outcome(tried, waves, verdict, tuple(attempts))
        following = next((each for each in left if cause in each.cures), None)
        if following is None or len(attempts) > retries:
            vain = [f"{a.setting} ({a.settings})" for a in attempts[1:]]
            hints = [
                vain and f"tried in vain: {', '.join(vain)}",
                following and f"a larger solver.retries goes on with {following.name}",
                _ADVICE.get(cause or ""),
                error.hint,
            ]
            last = RetriesFailedError(
                error.message,
                where=error.where,
                got=error.got,
                expected=error.expected,
                hint="; ".join(str(hint) for hint in hints if hint) or None,
            )
            last.attempts, last.failure = tuple(attempts), farthest
            mends = dict(check.mend for check in violated if check.mend is not None)
            last.mends = mends if len(mends) == len(violated) else {}
            raise last
        warnings.warn(
            f"{setting.name}: {failure.cause}; trying {following.name}: {following.why}",
            stacklevel=2,
        )
        log = (directory / deck.main).with_suffix(".log")
        if log.is_file():  # put aside, before the next attempt writes its own
            log.rename(log.with_suffix(f".{len(attempts)}.log"))
        left.remove(following)
        setting = following.after(setting)
