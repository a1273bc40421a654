"""Runs of ngspice in batch mode, with checks of the output and with retries.

The exit code of ngspice does not prove that a run succeeded. The log and the raw file of each run
are therefore also checked. A failed run is repeated with other settings.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import MissingToolError, SimulationError, UsageError, join_first
from kc2spice.core.install_commands import make_install_command
from kc2spice.core.untrusted_files import explain_unsafe_name
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.expression import split_terms
from kc2spice.netlist.number_and_name_spelling import format_number
from kc2spice.scene.checks import Check, Verdict, require_passed
from kc2spice.sim.output import (
    FailedRunError,
    Failure,
    FailureKind,
    find_alteration_error,
    find_run_failure,
    read_last_scale_value,
    read_partial_vectors,
    read_raw,
    read_statistics,
)

VERSION_TIMEOUT = 20.0  # time limit [s] of ``ngspice --version``
STALL_TIME = 60.0  # time [s] without use of the processor after which a run counts as hanging
MAX_RAW_BYTES = 8_000_000_000  # largest size [bytes] of a raw file
MIN_FREE_BYTES = 1_000_000  # free disk space [bytes] below which a failure counts as "disk full"
POLL_INTERVAL = 0.05  # time [s] between two checks of the raw file
# Callback whose argument is the completed fraction of a transient.
ProgressCallback = Callable[[float], None] | None


@dataclass(frozen=True)
class Simulator:
    """Installed simulator program, with its name, version and path."""

    name: str
    version: str
    path: str


@cache
def find_ngspice() -> Simulator:
    """Find the ngspice program on the search path, and read its version.

    Raises
    ------
    MissingToolError : ngspice is not installed, or does not print its version.
    """
    path = shutil.which("ngspice")
    if path is None:
        raise MissingToolError(
            "ngspice is not on this machine",
            where="PATH",
            expected="the program ngspice, version 39 or later",
            hint=f"{make_install_command('ngspice')}; see also https://ngspice.sourceforge.io",
        )
    options: Any = {"capture_output": True, "timeout": VERSION_TIMEOUT, "stdin": subprocess.DEVNULL}
    try:
        answer = subprocess.run([path, "--version"], check=False, **options).stdout
    except (OSError, subprocess.TimeoutExpired) as error:
        hangs = isinstance(error, subprocess.TimeoutExpired)
        raise MissingToolError(
            "the installed ngspice does not start",
            where=path,
            got=f"no answer within {VERSION_TIMEOUT:g} s" if hangs else str(error),
            hint="install ngspice again, then run kc2spice doctor",
        ) from None
    text = answer.decode(errors="replace")
    version = re.search(r"ngspice-(\S+)", text)
    if version is None:
        raise MissingToolError(
            "this ngspice does not print its version", where=path, got=text.strip()[:80]
        )
    return Simulator("ngspice", version.group(1), path)


@cache
def _make_parent_death_prefix() -> tuple[str, ...]:
    """Return a command prefix that ends the command when this process ends.

    The prefix is an empty tuple on systems without the program ``setpriv``.
    """
    words = ("setpriv", "--pdeathsig", "KILL", "--")
    tried: Any = {"capture_output": True, "check": False}
    works = shutil.which(words[0]) and not subprocess.run([*words, "true"], **tried).returncode
    return words if works else ()


def write_files(files: Mapping[str, str], directory: Path) -> None:
    """Write text files to ``directory``.

    ``files`` contains the texts, keyed by file name; a file name may contain folders.

    Raises
    ------
    UsageError : the path of a file is outside of ``directory``, or its name is not allowed; no file
        was written.
    """
    for filename in files:
        if reason := explain_unsafe_name(filename):
            raise UsageError(
                f"this file name is not allowed: {reason}",
                where="file name",
                got=repr(filename[:120]),
            )
    directory.mkdir(parents=True, exist_ok=True)
    for filename, text in files.items():
        path = directory / filename
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def run_deck(
    deck: Deck, directory: Path, progress: ProgressCallback = None, timeout: float | None = None
) -> Waveforms:
    """Run ``deck`` in ngspice in ``directory``, and return the waveforms in SI units.

    Parameters
    ----------
    deck : deck to run.
    directory : folder in which ngspice runs, and which then contains deck, log and raw file.
    progress : callback whose argument is the completed fraction of the transient, 0 to 1.
    timeout : wall-clock time [s] after which the run is ended.

    Raises
    ------
    MissingToolError : ngspice is not installed.
    FailedRunError : ngspice failed or stopped early. The error is also raised if ngspice ignored or
        replaced a card of a deck that is not trusted. The error message states the cause, the node
        and the time of the failure, the part that failed, and the directory that contains
        ``NAME.log``. The error contains the waveforms up to the failure.
    UsageError : even with the largest time step, the run would write more than ``MAX_RAW_BYTES``
        bytes.
    SimulationError : the run exceeds ``timeout``, or the raw file is incomplete or too large. The
        raw file of a failed run is deleted.
    """
    _reject_large_deck(deck)
    find_ngspice()
    write_files(deck.files, directory)
    main = directory / deck.main_file_name
    raw, log = main.with_suffix(".raw"), main.with_suffix(".log")
    unfinished = main.with_suffix(".raw.part")
    for stale in (raw, log, unfinished):
        stale.unlink(missing_ok=True)
    try:
        code = _run_ngspice(deck, main, unfinished, log, progress, timeout)
        text = log.read_text(encoding="utf-8", errors="replace")
        failed = find_run_failure(deck, str(main), text, code)
        if failed is None:
            vectors = read_raw(unfinished)
            facts = {**read_statistics(text), "reltol": deck.reltol}
            waves = Waveforms(convert_to_waves(deck, vectors), facts)
            last = float(vectors["time"][-1]) if "time" in vectors else math.nan
            failed = find_run_failure(deck, str(main), text, last=last)
            failed = failed or find_alteration_error(deck, str(main), text)
        if failed is not None:
            place = f"the whole log is {log.name} in the same directory"
            failed.hint = "; ".join(filter(None, (failed.hint, place)))
            partial = read_partial_waves(deck, read_partial_vectors(unfinished), text)
            failed.failure = replace(failed.failure, partial=partial)
            raise failed
        unfinished.rename(raw)
    except SimulationError as error:
        free = shutil.disk_usage(directory).free
        if free < MIN_FREE_BYTES:
            raise SimulationError(
                "the disk is full",
                where=str(directory),
                got=f"{free} bytes left",
                hint="delete files, or set TMPDIR or --out to another disk",
            ) from error
        raise
    finally:
        unfinished.unlink(missing_ok=True)
    return waves


def _reject_large_deck(deck: Deck) -> None:
    """Reject a deck whose raw file would be too large even with the largest time step."""
    step, size = deck.max_step, _estimate_raw_bytes(deck)
    if step and deck.stop is not None and size > MAX_RAW_BYTES:
        action = "raise solver.max_step, choose an earlier end time, or save fewer vectors"
        if deck.step_reason:
            action = (
                f"choose an earlier end time; reason for the short time steps: {deck.step_reason}"
            )
        raise UsageError(
            "the waveforms of this run exceed the size limit",
            where=deck.main_file_name,
            got=f"about {size:.2g} bytes: {1 + len(deck.saved_vectors)} vectors at "
            f"{deck.stop / step:.2g} points",
            expected=f"at most {MAX_RAW_BYTES:.2g}",
            hint=action,
        )


def _estimate_raw_bytes(deck: Deck) -> float:
    """Return the smallest possible size [byte] of the raw file of a transient.

    The result is 0 for a deck without a largest time step or without an end time.
    """
    if not deck.max_step or deck.stop is None:
        return 0.0
    return 8.0 * (1 + len(deck.saved_vectors)) * deck.stop / deck.max_step


def _run_ngspice(
    deck: Deck, main: Path, raw: Path, log: Path, progress: ProgressCallback, timeout: float | None
) -> int:
    """Run ngspice without the user's start-up files, and return the exit code.

    Raises
    ------
    SimulationError : the run takes longer than ``timeout``, hangs, or fills the disk.
    """
    command = [
        *_make_parent_death_prefix(),
        find_ngspice().path,
        "-b",
        "-n",
        "-r",
        raw.name,
        main.name,
    ]
    environment = {k: v for k, v in os.environ.items() if not k.startswith("SPICE_")}
    environment["HOME"] = str(main.parent)  # without a home directory, ngspice crashes
    begin = worked = time.monotonic()
    spent = None
    with log.open("wb") as sink:
        streams: Any = {"stdin": subprocess.DEVNULL, "stdout": sink, "stderr": subprocess.STDOUT}
        # Popen is not used as a context manager, because leaving the context would wait for
        # ngspice.
        process = subprocess.Popen(command, cwd=main.parent, env=environment, **streams)
        try:
            # A thread waits for the end of the process.
            # Popen.wait with a time limit would detect the end of the process up to 50 ms late.
            waiting = threading.Thread(target=process.wait, daemon=True)
            waiting.start()
            waiting.join(POLL_INTERVAL)
            while waiting.is_alive():
                now, ticks = time.monotonic(), _read_processor_time(process.pid)
                if ticks is None or ticks != spent:
                    worked, spent = now, ticks
                size, at = raw.stat().st_size if raw.exists() else 0, read_last_scale_value(raw)
                problem = hint = ""
                if timeout is not None and now - begin > timeout:
                    problem = f"ngspice did not finish within {timeout} s"
                    hint = "raise the time limit, raise solver.reltol, or lower solver.stop"
                elif now - worked > STALL_TIME:
                    problem = f"ngspice hangs: no processor time for {STALL_TIME:g} s"
                    hint = "kc2spice doctor checks whether ngspice runs"
                elif size > MAX_RAW_BYTES:
                    problem = f"the raw file grows beyond its limit of {MAX_RAW_BYTES:.3g} bytes"
                    hint = "raise solver.max_step, lower solver.stop, or save fewer vectors"
                if problem:
                    raise SimulationError(
                        problem,
                        where=str(main.parent),
                        got=f"{size} bytes at time point {at} s of {deck.stop} s",
                        hint=hint,
                    )
                if progress is not None and deck.stop:
                    progress(min(1.0, (at or 0.0) / deck.stop))
                waiting.join(POLL_INTERVAL)
        finally:
            process.kill()  # has no effect if the process has ended
            process.wait()
        return process.returncode


def _read_processor_time(pid: int) -> int | None:
    """Return the CPU time [clock ticks] of a process and its children, or None."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        return sum(map(int, fields[11:15]))
    except (OSError, ValueError):
        return None


def read_partial_waves(
    deck: Deck, vectors: Mapping[str, np.ndarray] | None, text: str
) -> Waveforms | None:
    """Return the waveforms that a failed run has written; None if a vector is missing.

    ``text`` is the log of the run.
    """
    try:
        return (
            Waveforms(convert_to_waves(deck, vectors), read_statistics(text)) if vectors else None
        )
    except SimulationError:
        return None


def convert_to_waves(deck: Deck, vectors: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Convert ngspice vectors to the results of a deck in SI units, keyed by name.

    The results are computed from the ngspice ``vectors``. The first result is the independent
    variable, which is called ``time``, ``frequency`` or ``sweep``. The swept values are also in SI
    units: a swept displacement is in metres, although its source is in um.

    Raises
    ------
    SimulationError : a vector of the deck is missing.
    """
    first = next(iter(vectors))
    scale = first if first in ("time", "frequency") else "sweep"
    data = {scale: vectors[first].real / (deck.sweep_scale if scale == "sweep" else 1.0)}
    for key, (expression, factor) in deck.vectors.items():
        parts = []
        for sign, name in split_terms(expression):
            # in raw files, the name of a device current is enclosed in "i(…)"
            result = vectors.get(name, vectors.get(f"i({name})"))
            if result is None:
                raise SimulationError(
                    f"the output of ngspice lacks the vector {name}", where=deck.main_file_name
                )
            parts.append(sign * result)
        data[key] = factor * np.sum(parts, axis=0)
    return data


@dataclass(frozen=True)
class RetrySetting:
    """Solver settings of an attempt to run a deck.

    The settings consist of ngspice ``options``, and of a ``factor`` for tolerances and time steps.
    ``cures`` are the kinds of failures that the settings may prevent, and ``why`` is the presumed
    reason for such failures.
    """

    name: str
    cures: tuple[FailureKind, ...]
    why: str
    options: Mapping[str, str] = field(default_factory=dict)
    factor: float = 1.0

    def combine(self, other: RetrySetting) -> RetrySetting:
        """Return these solver settings combined with other settings.

        The factors are multiplied.
        """
        options, factor = {**other.options, **self.options}, self.factor * other.factor
        return replace(self, options=options, factor=factor)

    @property
    def changed_settings_text(self) -> str:
        """Text that lists the solver settings that an attempt to run a deck changes."""
        words = [f"{key}={value}" for key, value in self.options.items()]
        if self.factor != 1.0:
            words.append(f"reltol, chgtol and largest step times {self.factor:g}")
        return ", ".join(words) or "unchanged"

    def apply(self, deck: Deck) -> Deck:
        """Return a copy of a deck with these solver settings."""
        options = dict(self.options)
        if self.factor != 1.0:
            options["reltol"] = format_number(self.factor * deck.reltol)
            options["chgtol"] = format_number(self.factor * deck.chgtol)
        if not options:
            return deck
        changed = deck.with_options(options, f"retry with {self.name}: {self.why}")
        return changed.scale_max_step(self.factor)


# If an attempt takes longer than LONG_ATTEMPT [s], the warning before the next attempt states how
# many attempts may follow.
LONG_ATTEMPT = 10.0
FIRST_SETTING = RetrySetting("the scene's own settings", (), "")
# The retry settings were tested with the scene ``kick_and_catch`` and contact penalties of 1e11 and
# 1e12 N/m. Without a retry setting, the scene ``kick_and_catch`` fails with "timestep too small" if
# its contact penalty is 1e11 or 1e12 N/m.
# Runs with larger pivot thresholds succeed, and take 1.2 to 2 times the CPU time per time point.
# With the default pivot thresholds, Gear integration, tighter tolerances or more iterations do not
# prevent the failure of the scene ``kick_and_catch``.
# Even with larger pivot thresholds, rounding noise slows the trapezoidal rule down.
# Gear integration with larger pivot thresholds damps the rounding noise.
# The error of Gear integration per step is about twice the error of the trapezoidal rule.
RETRY_SETTINGS = (
    RetrySetting(
        "firmer pivots",
        ("timestep", "singular"),
        "the pivot order of the first time step causes rounding errors at short time steps",
        {"pivrel": "0.1"},
    ),
    RetrySetting(
        "gear",
        ("timestep",),
        "the trapezoidal rule rings after abrupt changes by a switch or a mechanical stop",
        {"pivrel": "0.1", "method": "gear"},
    ),
    RetrySetting(
        "tighter tolerances",
        ("coarse", "timestep"),
        "the time steps are too long for the fastest change",
        factor=0.1,
    ),
    RetrySetting(
        "much tighter tolerances",
        ("coarse",),
        "the time steps are still too long for the fastest change",
        factor=0.1,
    ),
)


@dataclass(frozen=True)
class Attempt:
    """Record of one attempt to run the simulator, which is written to ``result.json``.

    ``cause`` is the reason why the attempt failed; None if the attempt succeeded. ``wall_s`` is the
    wall-clock time [s], and ``points`` the number of time points.
    """

    setting: str
    settings: str
    cause: str | None
    node: str | None
    time: float | None
    part: str | None
    wall_s: float
    points: int | None


@dataclass(frozen=True)
class RunOutcome:
    """Deck, waveforms and verdict of a successful attempt, and all attempts."""

    deck: Deck
    waves: Waveforms
    verdict: Verdict
    attempts: tuple[Attempt, ...]


class RetriesFailedError(SimulationError):
    """Error that is raised if the last attempt to run the simulator failed.

    ``violated`` are the checks that the last attempt violated. ``suggested`` contains values of
    scene keys that would prevent all violations except those due to large time steps.
    """

    attempts: tuple[Attempt, ...]
    failure: Failure | None
    violated: tuple[Check, ...]
    suggested: Mapping[str, Any]


def _describe_long_retries(wall: float, most: int) -> str:
    """Describe how long retries may take after an attempt of ``wall`` seconds; "" if short.

    ``most`` is the largest number of further attempts.
    """
    if wall < LONG_ATTEMPT:
        return ""
    attempts = "1 attempt" if most == 1 else f"up to {most} attempts"
    return (
        f"; the failed attempt took {wall:.0f} s, and {attempts} of similar or longer duration may "
        "follow (with solver.retries = 0, a run stops at the first failure)"
    )


def _join_suggestions(violated: Iterable[Check]) -> dict[str, Any]:
    """Return scene keys and values with which a run would pass the violated checks.

    The dictionary contains no suggestions for checks that are violated because of large time steps.
    The returned dictionary is empty if a check without suggested keys is violated for a reason
    other than large time steps.
    """
    result: dict[str, Any] = {}
    for check in violated:
        if check.coarse:
            continue
        if not check.suggested:
            return {}
        result |= check.suggested
    return result


# If the value of a violated check remains above UNCHANGED_SHARE of its largest value in all
# attempts, the time steps are not the cause. Each retry divides the tolerances by 10.
UNCHANGED_SHARE = 0.9


def _correct_time_step_error(
    error: SimulationError, check: Check, values: Sequence[tuple[str, float]], deck: Deck
) -> None:
    """Correct the message and hint of an error that names time steps as the cause.

    ``values`` contains the name and the value of the first violated check of each attempt. If
    shorter time steps did not change the value, the time steps are not the cause.
    """
    edits = f"compare these edits with a new export: {join_first(deck.edits, '; ')}"
    sizes = [value for name, value in values if name == check.name]
    if 1 < len(sizes) == len(values) and min(sizes) > UNCHANGED_SHARE * max(sizes):
        error.message = (
            "shorter time steps do not change the value of a violated check "
            f"(check: {check.printed_label})"
        )
        compare = "run  kc2spice verify  on this scene to compare with an independent solution"
        error.hint = edits if deck.edits else compare
    elif deck.text is not None and error.hint:
        lower = error.hint.replace("solver.reltol", "reltol in the .options line of the deck")
        error.hint = f"{edits}; or {lower}" if deck.edits else lower


def run_with_retries(
    deck: Deck,
    directory: Path,
    engine: Callable[[Deck], Waveforms],
    *,
    retries: int,
    judge: Callable[[Waveforms], Verdict],
) -> RunOutcome:
    """Run a deck, and repeat a failed run with settings that may prevent the failure.

    The kind of a failure determines the next setting, which is combined with the earlier settings.
    Before each retry, a warning is printed. ``engine`` runs the deck, and writes its logs to
    ``directory``. ``judge`` returns the verdict of a finished run. A violated energy balance counts
    as a failure due to large time steps.

    Raises
    ------
    RetriesFailedError : the last attempt failed. The error states the node, the time and the part
        at which the run failed. The error also lists the settings of all attempts, and possible
        remedies.
    SimulationError, MissingToolError : a failure that no setting can prevent, as in
        :func:`run_deck`.
    """
    setting, left = FIRST_SETTING, list(RETRY_SETTINGS)
    attempts: list[Attempt] = []
    farthest: Failure | None = None
    coarse: list[tuple[str, float]] = []  # first violated check of each attempt
    while True:
        tried = setting.apply(deck)
        violated: list[Check] = []
        failure, points = Failure(None), None
        start = time.perf_counter()
        try:
            waves = engine(tried)
            verdict = judge(waves)
            points = waves["time"].size if "time" in waves else None
            violated = [check for check in verdict.checks if check.is_fatal]
            require_passed(verdict.checks, deck.name)
        except SimulationError as raised:
            error: SimulationError = raised
            if isinstance(raised, FailedRunError):
                failure = raised.failure
                if farthest is None or (failure.time or 0.0) > (farthest.time or 0.0):
                    farthest = failure
            elif violated:
                first = violated[0]
                # A run is repeated only if all its violations are due to large time steps.
                # Outside of a model's valid range, results are wrong with every tolerance.
                kind: FailureKind | None = (
                    "coarse" if all(check.coarse for check in violated) else None
                )
                failure = Failure(f"{first.name}: {first.value:.3g} {first.unit}", kind=kind)
                coarse.append((first.name, first.value))
            else:
                raise
        blame = failure.cause, failure.node, failure.time, failure.part
        wall = time.perf_counter() - start
        attempts.append(Attempt(setting.name, setting.changed_settings_text, *blame, wall, points))
        if failure.cause is None:
            return RunOutcome(tried, waves, verdict, tuple(attempts))
        following = next((item for item in left if failure.kind in item.cures), None)
        # shorter time steps could make the raw file too large
        if (
            following
            and _estimate_raw_bytes(following.combine(setting).apply(deck)) > MAX_RAW_BYTES
        ):
            following = None
        if following is None or len(attempts) > retries:
            if failure.kind == "coarse":
                _correct_time_step_error(error, violated[0], coarse, deck)
            vain = [f"{a.setting} ({a.settings})" for a in attempts[1:]]
            hints = [
                vain and f"retries without success: {', '.join(vain)}",
                following and f"increase solver.retries to also try {following.name}",
                error.hint,
            ]
            last = RetriesFailedError(error.message)
            last.where, last.got, last.expected = error.where, error.got, error.expected
            last.hint = "; ".join(map(str, filter(None, hints))) or None
            last.attempts, last.failure = tuple(attempts), farthest
            last.violated = tuple(violated)
            last.suggested = _join_suggestions(violated)
            raise last
        warn_user(
            f"with {setting.name}, the run failed: {failure.cause}; now trying {following.name}, "
            f"because {following.why}{_describe_long_retries(wall, retries - len(attempts) + 1)}"
        )
        log = (directory / deck.main_file_name).with_suffix(".log")
        if log.is_file():  # the next attempt writes a log with this name
            log.rename(log.with_suffix(f".{len(attempts)}.log"))
        left.remove(following)
        setting = following.combine(setting)
