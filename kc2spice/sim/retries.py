"""Runs a deck until its result can be believed: what failed once is tried with other settings."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.deck import Deck
from kc2spice.scene.judge import Check, Verdict, require
from kc2spice.sim.failure import FailedRunError, Failure
from kc2spice.sim.ngspice import run_deck
from kc2spice.sim.settings import (
    FIRST,
    Cause,
    RetrySetting,
    Settings,
    next_setting,
    with_settings,
)

_ADVICE = {
    "timestep": "a larger kick.damping.ratio, a smaller contact.penalty or solver.max_step",
    "singular": "look for loops of voltage sources, nodes between capacitors and parts of value 0",
    "operating point": "look for the included circuit's state at t = 0; give it a .nodeset",
    "coarse": "lower solver.reltol or solver.max_step",
}


@dataclass(frozen=True)
class Attempt:
    """One setting that was tried: ``cause`` is None for the one that succeeded."""

    setting: str
    settings: str
    cause: str | None
    node: str | None
    time: float | None
    part: str | None
    wall_s: float
    points: int | None

    def record(self) -> dict[str, Any]:
        """Its entry in ``result.json``."""
        return asdict(self)


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
    retry, settings = FIRST, Settings()
    attempts: list[Attempt] = []
    farthest: Failure | None = None
    while True:
        violated: list[Check] = []
        tried = with_settings(deck, retry, settings)
        start = time.perf_counter()
        cause: Cause | None
        try:
            if engine is None:
                waves = run_deck(tried, directory, progress, timeout)
            else:
                waves = engine(tried)
        except FailedRunError as failed:
            error: SimulationError = failed
            failure, cause = failed.failure, failed.failure.kind
            farthest = _farther(farthest, failure)
            attempts.append(_attempt(retry, settings, start, failure, None))
        else:
            verdict = judge(waves)
            violated = [check for check in verdict.checks if check.fatal]
            points = waves["time"].size if "time" in waves else None
            if not violated:
                attempts.append(_attempt(retry, settings, start, None, points))
                return Outcome(tried, waves, verdict, tuple(attempts))
            # Outside of what is modelled no tolerance makes the result right.
            cause = "coarse" if all(check.coarse for check in violated) else None
            said = f"{violated[0].name}: {violated[0].value:.3g} {violated[0].unit}"
            attempts.append(_attempt(retry, settings, start, Failure(said, None), points))
            try:
                require(verdict.checks, deck.name)
            except SimulationError as refused:
                error = refused
        following = next_setting(cause, tuple(a.setting for a in attempts))
        if following is None or len(attempts) > retries:
            left = None if following is None else following.name
            raise _exhausted(error, cause, attempts, farthest, left, violated)
        warnings.warn(
            f"{retry.name}: {attempts[-1].cause}; trying {following.name}: {following.why}",
            stacklevel=2,
        )
        _keep_log(deck, directory, len(attempts))
        retry, settings = following, settings.plus(following.settings)


def _attempt(
    retry: RetrySetting,
    settings: Settings,
    start: float,
    failure: Failure | None,
    points: int | None,
) -> Attempt:
    wall = time.perf_counter() - start
    if failure is None:
        return Attempt(retry.name, str(settings), None, None, None, None, wall, points)
    return Attempt(
        retry.name,
        str(settings),
        failure.cause,
        failure.node,
        failure.time,
        failure.part,
        wall,
        points,
    )


def _farther(a: Failure | None, b: Failure) -> Failure:
    return b if a is None or (b.time or 0.0) > (a.time or 0.0) else a


def _keep_log(deck: Deck, directory: Path, number: int) -> None:
    """Put the log of a failed attempt aside, before the next one writes its own."""
    log = (directory / deck.main).with_suffix(".log")
    if log.is_file():
        log.rename(log.with_suffix(f".{number}.log"))


def _exhausted(
    last: SimulationError,
    cause: Cause | None,
    attempts: list[Attempt],
    failure: Failure | None,
    left: str | None,
    violated: list[Check],
) -> RetriesFailedError:
    """What the last attempt said, where the farthest got, what was tried and what else to try."""
    tried_ = ", ".join(f"{a.setting} ({a.settings})" for a in attempts[1:])
    hints = [
        f"tried in vain: {tried_}" if tried_ else "",
        f"a larger solver.retries goes on with {left}" if left else "",
        f"try {_ADVICE[cause]}" if cause and cause != "coarse" else "",
        last.hint or "",
    ]
    error = RetriesFailedError(
        last.message,
        where=last.where,
        got=last.got,
        expected=last.expected,
        hint="; ".join(filter(None, hints)) or None,
    )
    error.attempts, error.failure = tuple(attempts), failure
    mends = dict(check.mend for check in violated if check.mend is not None)
    error.mends = mends if len(mends) == len(violated) else {}
    return error
