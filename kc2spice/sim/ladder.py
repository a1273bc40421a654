"""Runs a deck until its result can be believed: what failed once is tried with other settings."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.sim.failure import FailedRunError, Failure
from kc2spice.sim.ngspice import run_deck
from kc2spice.sim.rungs import FIRST, Cause, Rung, Settings, next_rung, with_settings
from kc2spice.sim.truth import Truth, require
from kc2spice.spice.circuit import Deck

_ADVICE = {
    "timestep": "a larger kick.damping.ratio, a smaller contact.penalty or solver.max_step",
    "singular": "look for loops of voltage sources, nodes between capacitors and parts of value 0",
    "operating point": "look for the included circuit's state at t = 0; give it a .nodeset",
    "coarse": "lower solver.reltol or solver.max_step",
}


@dataclass(frozen=True)
class Attempt:
    """One rung that was tried: ``cause`` is None for the one that succeeded."""

    rung: str
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
class Climb:
    """The result of the first rung that held, the deck that gave it, and all that was tried."""

    deck: Deck
    waves: Waveforms
    truth: Truth
    attempts: tuple[Attempt, ...]


class LadderError(SimulationError):
    """No rung held. ``attempts`` are all that were tried, ``failure`` the one that got farthest."""

    attempts: tuple[Attempt, ...]
    failure: Failure | None


def climb(
    deck: Deck,
    directory: Path,
    *,
    retries: int,
    judge: Callable[[Waveforms], Truth] = lambda waves: Truth(),
    progress: Callable[[float], None] | None = None,
    timeout: float | None = None,
) -> Climb:
    """Run ``deck`` in ``directory``; after a failure that settings may cure, with the next rung.

    The cause of each failure picks the rung; what earlier rungs changed stays changed. Every
    retry is announced by a warning. ``judge`` checks a finished run; violated energy books count
    as failures of too coarse steps. ``timeout`` [s] is that of each rung.

    Raises
    ------
    LadderError : the last rung failed; it names node, time, part, all rungs and what to try.
    SimulationError, MissingToolError : as :func:`run_deck`, for what no setting cures.
    """
    rung, settings = FIRST, Settings()
    attempts: list[Attempt] = []
    farthest: Failure | None = None
    while True:
        tried = with_settings(deck, rung, settings)
        start = time.perf_counter()
        cause: Cause | None
        try:
            waves = run_deck(tried, directory, progress, timeout)
        except FailedRunError as failed:
            error: SimulationError = failed
            failure, cause = failed.failure, failed.failure.kind
            farthest = _farther(farthest, failure)
            attempts.append(_attempt(rung, settings, start, failure, None))
        else:
            truth = judge(waves)
            violated = [check for check in truth.checks if check.fatal]
            points = waves["time"].size if "time" in waves else None
            if not violated:
                attempts.append(_attempt(rung, settings, start, None, points))
                return Climb(tried, waves, truth, tuple(attempts))
            # Outside of what is modelled no tolerance makes the result right.
            cause = "coarse" if all(check.coarse for check in violated) else None
            said = f"{violated[0].name}: {violated[0].value:.3g} {violated[0].unit}"
            attempts.append(_attempt(rung, settings, start, Failure(said, None), points))
            try:
                require(truth.checks, deck.name)
            except SimulationError as refused:
                error = refused
        following = next_rung(cause, tuple(a.rung for a in attempts))
        if following is None or len(attempts) > retries:
            left = None if following is None else following.name
            raise _exhausted(error, cause, attempts, farthest, left)
        warnings.warn(
            f"{rung.name}: {attempts[-1].cause}; trying {following.name}: {following.why}",
            stacklevel=2,
        )
        _keep_log(deck, directory, len(attempts))
        rung, settings = following, settings.plus(following.settings)


def _attempt(
    rung: Rung, settings: Settings, start: float, failure: Failure | None, points: int | None
) -> Attempt:
    wall = time.perf_counter() - start
    if failure is None:
        return Attempt(rung.name, str(settings), None, None, None, None, wall, points)
    return Attempt(
        rung.name, str(settings), failure.cause, failure.node, failure.time, failure.part, wall,
        points,
    )  # fmt: skip


def _farther(a: Failure | None, b: Failure) -> Failure:
    return b if a is None or (b.time or 0.0) > (a.time or 0.0) else a


def _keep_log(deck: Deck, directory: Path, number: int) -> None:
    """Put the log of a failed rung aside, before the next one writes its own."""
    log = (directory / deck.main).with_suffix(".log")
    if log.is_file():
        log.rename(log.with_suffix(f".{number}.log"))


def _exhausted(
    last: SimulationError,
    cause: Cause | None,
    attempts: list[Attempt],
    failure: Failure | None,
    left: str | None,
) -> LadderError:
    """What the last rung said, where the farthest one got, what was tried and what else to try."""
    rungs = ", ".join(f"{a.rung} ({a.settings})" for a in attempts[1:])
    hints = [
        f"tried in vain: {rungs}" if rungs else "",
        f"a larger solver.retries goes on with {left}" if left else "",
        f"try {_ADVICE[cause]}" if cause and cause != "coarse" else "",
        last.hint or "",
    ]
    error = LadderError(
        last.message,
        where=last.where,
        got=last.got,
        expected=last.expected,
        hint="; ".join(filter(None, hints)) or None,
    )
    error.attempts, error.failure = tuple(attempts), failure
    return error
