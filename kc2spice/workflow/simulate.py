"""One deck through the simulator: retries, checks, and what is kept of a failed run."""

from __future__ import annotations

import contextlib
import os
import shutil
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path

from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.deck import Deck
from kc2spice.scene.judge import Check, Verdict
from kc2spice.scene.parttype import Build, Sampled
from kc2spice.sim.retries import Outcome, RetriesFailedError, run_with_retries
from kc2spice.workflow.judge import verdict
from kc2spice.workflow.meters import powers, result_vectors, with_powers
from kc2spice.workflow.results import save_arrays, write_record

PARTIAL = "waveforms.partial.npz"
FAILURE = "failure.json"


def simulate(
    build: Build,
    deck: Deck,
    directory: Path,
    *,
    progress: Callable[[float], None] | None = None,
    timeout: float | None = None,
    retries: int | None = None,
) -> Outcome:
    """Run ``deck`` with the scene's retries, its result judged by the scene's parts; where a deck
    edited by hand is not wired as the scene, that is a warning.

    Raises as :func:`run_with_retries` does.
    """

    def judge(waves: Waveforms) -> Verdict:
        found = verdict(waves, build)
        if deck.text is None:
            return found
        checks = (replace(c, action="warn") if c.wiring else c for c in found.checks)
        return Verdict(tuple(checks), found.balances)

    found = run_with_retries(
        deck,
        directory,
        retries=build.scene.solver.retries if retries is None else retries,
        judge=judge,
        engine=shared_engine(build, progress),
        progress=progress,
        timeout=timeout,
    )
    pairs = powers(build, result_vectors(build))
    return replace(found, waves=with_powers(found.waves, pairs))


def shared_engine(
    build: Build, progress: Callable[[float], None] | None = None
) -> Callable[[Deck], Waveforms] | None:
    """The simulator's library, where functions set sources of the scene while it runs.

    Raises
    ------
    UsageError : a function stands in a file that is not trusted.
    """
    sampled = [
        each
        for part in build.scene.parts.values()
        for each in part.type.settable(part, build).values()
        if isinstance(each, Sampled)
    ]

    def shared(deck: Deck) -> Waveforms:
        from kc2spice.sim.shared import run_shared

        return run_shared(deck, sampled, progress)

    return shared if sampled else None


def warn_of(checks: Iterable[Check]) -> None:
    """One warning for each violated check."""
    for check in checks:
        if not check.passed:
            limit = f"limit {check.limit:.3g}: {check.advice}"
            warnings.warn(
                f"check {check.name}: {check.value:.3g} {check.unit}, {limit}", stacklevel=2
            )


@contextmanager
def kept_on_failure(work: Path, out: Path, scene: str) -> Iterator[None]:
    """Keep deck, logs and partial waveforms of a failed run in ``<out>.failed``, until a later one
    succeeds. No result is looked for there; ``failure.json`` says what the files are."""
    kept = _kept(Path(out).absolute())
    try:
        yield
    except SimulationError as error:
        with contextlib.suppress(OSError):  # a full disk must not hide the first error
            shutil.rmtree(kept, ignore_errors=True)
            shutil.copytree(work, kept)
            _write_failure(error, kept, scene)
            error.where = error.where and error.where.replace(str(work), str(kept))
        raise
    if (kept / FAILURE).is_file():
        shutil.rmtree(kept, ignore_errors=True)


def _kept(out: Path) -> Path:
    """``<out>.failed``, or ``<out>.failed2`` and so on where something else has that name."""
    name = f"{out.name}.failed"
    for number in ("", *range(2, 100)):
        found = out.with_name(f"{name}{number}")
        if not os.path.lexists(found) or ((found / FAILURE).is_file() and not found.is_symlink()):
            return found
    return found


def _write_failure(error: SimulationError, kept: Path, scene: str) -> None:
    record: dict[str, object] = {"scene": scene, "partial": True, "error": error.message}
    record |= {"got": error.got, "next": error.hint, "waveforms": None, "attempts": []}
    if isinstance(error, RetriesFailedError):
        failure = error.failure
        record["attempts"] = [asdict(attempt) for attempt in error.attempts]
        if failure is not None:
            record |= {"node": failure.node, "time_s": failure.time, "part": failure.part}
        if failure is not None and failure.partial is not None:
            save_arrays(failure.partial, kept / PARTIAL)
            scale = next(iter(failure.partial.data.values()))
            record |= {"waveforms": PARTIAL, "last_point": float(scale[-1])}
    write_record(record, kept, FAILURE)
