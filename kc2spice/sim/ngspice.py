"""Runs ngspice in batch mode and judges what it did; its exit code alone is not believed."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from kc2spice.core.errors import MissingToolError, SimulationError, UsageError
from kc2spice.core.foreign import name_threat
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.expression import literal
from kc2spice.netlist.vectors import terms
from kc2spice.sim.failure import FailedRunError, diagnose
from kc2spice.sim.log import classify, statistics
from kc2spice.sim.rawfile import last_scale_value, read_partial, read_raw
from kc2spice.sim.settings import own_reltol

ANSWERS = 20.0  # s that ngspice may take to tell its version
STALLED = 60.0  # s without processor time after which a run hangs
LARGEST_RAW = 8_000_000_000  # bytes of one raw file
SPARE = 1_000_000  # bytes; a disk with less is full
_PDEATHSIG = 1  # of prctl: the signal that a child gets when its parent dies
POLL = 0.05  # s between two looks at the growing raw file


@dataclass(frozen=True)
class Simulator:
    """The program that runs the decks."""

    name: str
    version: str
    path: str


@cache
def find_ngspice() -> Simulator:
    """The ngspice on the search path.

    Raises
    ------
    MissingToolError : there is none, or it does not tell its version.
    """
    path = shutil.which("ngspice")
    if path is None:
        raise MissingToolError(
            "ngspice is not on this machine",
            where="PATH",
            expected="the program ngspice, version 39 or later",
            hint="Debian or Ubuntu: apt-get install ngspice; else https://ngspice.sourceforge.io",
        )
    said = _version(path)
    version = re.search(r"ngspice-(\S+)", said)
    if version is None:
        raise MissingToolError(
            "this ngspice does not tell its version", where=path, got=said.strip()[:80]
        )
    return Simulator("ngspice", version.group(1), path)


def _version(path: str) -> str:
    """What the program says of itself.

    Raises
    ------
    MissingToolError : it does not run, or says nothing for so long that it hangs.
    """
    try:
        done = subprocess.run(
            [path, "--version"],
            capture_output=True,
            check=False,
            timeout=ANSWERS,
            stdin=subprocess.DEVNULL,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        hangs = isinstance(error, subprocess.TimeoutExpired)
        reason = f"no answer within {ANSWERS:g} s" if hangs else str(error)
        raise MissingToolError(
            "this ngspice does not run",
            where=path,
            got=reason,
            hint="install it again; kc2spice doctor checks it",
        ) from None
    return done.stdout.decode(errors="replace")


@cache
def _mortal() -> tuple[tuple[str, ...], Callable[[], None] | None]:
    """What makes a program die with this process, which a kill must not leave running: words
    before its command, or else a function for the child. The latter makes Python copy the page
    tables of this process, which costs each run 20 ms.
    """
    if sys.platform != "linux":
        return (), None
    words = ("setpriv", "--pdeathsig", "KILL", "--")
    if shutil.which(words[0]) is not None:
        tried = subprocess.run([*words, "true"], capture_output=True, check=False)
        if tried.returncode == 0:
            return words, None
    libc = ctypes.CDLL(None)
    return (), lambda: libc.prctl(_PDEATHSIG, signal.SIGKILL)


def write_deck(deck: Deck, directory: Path) -> Path:
    """Write all files of ``deck`` into ``directory`` and return the path of its main file."""
    write_files(deck.files, directory)
    return directory / deck.main


def write_files(files: Mapping[str, str], directory: Path) -> None:
    """Write texts under their names, which may have folders in them, into ``directory``.

    Raises
    ------
    UsageError : a name that leads out of ``directory``; nothing was written.
    """
    for filename in files:
        if reason := name_threat(filename):
            raise UsageError(f"is {reason}", where="file name", got=repr(filename[:120]))
    directory.mkdir(parents=True, exist_ok=True)
    for filename, text in files.items():
        path = directory / filename
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def run_deck(
    deck: Deck,
    directory: Path,
    progress: Callable[[float], None] | None = None,
    timeout: float | None = None,
) -> Waveforms:
    """Write ``deck`` into ``directory``, run it, return the vectors it names in SI.

    Parameters
    ----------
    progress : called with the share of the transient that is done, 0 to 1.
    timeout : seconds of wall clock after which the run is given up.

    Raises
    ------
    MissingToolError : no ngspice.
    FailedRunError : ngspice failed or stopped early. The message holds cause, node, time and part,
        and the directory with ``NAME.log``; the error has the waveforms up to there.
    UsageError : its largest step alone asks for more than ``LARGEST_RAW`` bytes.
    SimulationError : no time left, or the raw file is not complete or too large. No failed run
        leaves a raw file.
    """
    _fits(deck)
    simulator = find_ngspice()
    main = write_deck(deck, directory)
    raw, log = main.with_suffix(".raw"), main.with_suffix(".log")
    unfinished = main.with_suffix(".raw.part")
    for stale in (raw, log, unfinished):
        stale.unlink(missing_ok=True)
    try:
        code = _execute(simulator, main, unfinished, log, deck.stop, progress, timeout)
        text = log.read_text(encoding="utf-8", errors="replace")
        _judge_log(deck, directory, code, text, unfinished)
        vectors = read_raw(unfinished)
        _judge_end(deck, directory, vectors, text)
        facts = {**statistics(text), "reltol": own_reltol(deck)}
        waveforms = Waveforms(_named(deck, vectors), facts)
        unfinished.rename(raw)
    except SimulationError as error:
        free = shutil.disk_usage(directory).free
        if free < SPARE:
            raise SimulationError(
                "the disk is full",
                where=str(directory),
                got=f"{free} bytes left",
                hint="make room, or set TMPDIR or --out to another disk",
            ) from error
        raise
    finally:
        unfinished.unlink(missing_ok=True)
    return waveforms


def _fits(deck: Deck) -> None:
    """Refuse before the run what its largest step already makes too long for the disk."""
    words = deck.command.words
    step = literal(words[3], where=deck.main) if len(words) > 3 else None
    if deck.command.kind != "tran" or not step or deck.stop is None:
        return
    size = 8.0 * (1 + len(deck.saved)) * deck.stop / step
    if size > LARGEST_RAW:
        raise UsageError(
            "the run would write more than its limit",
            where=deck.main,
            got=f"about {size:.2g} bytes: {1 + len(deck.saved)} vectors at {deck.stop / step:.2g} "
            "points",
            expected=f"at most {LARGEST_RAW:.2g}",
            hint="raise solver.max_step, end earlier, or save fewer vectors",
        )


def _execute(
    simulator: Simulator,
    main: Path,
    raw: Path,
    log: Path,
    stop: float | None,
    progress: Callable[[float], None] | None,
    timeout: float | None,
) -> int:
    """Run ngspice with the user's start-up files kept out; return its exit code."""
    command = [simulator.path, "-b", "-n", "-r", raw.name, main.name]
    environment = {k: v for k, v in os.environ.items() if not k.startswith("SPICE_")}
    environment["HOME"] = str(main.parent)  # ngspice crashes where a user has none
    begin = time.monotonic()
    with log.open("wb") as sink:
        words, within = _mortal()
        # No context of the process: at an exit it would wait for a simulator that nobody has ended.
        process = subprocess.Popen(
            [*words, *command],
            cwd=main.parent,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=sink,
            stderr=subprocess.STDOUT,
            preexec_fn=within,
        )
        try:
            # A thread waits: Popen.wait with a time limit would notice the end up to 50 ms late.
            ended = threading.Event()

            def wait() -> None:
                process.wait()
                ended.set()

            threading.Thread(target=wait, daemon=True).start()
            alive = begin, _processor_time(process.pid)
            while not ended.wait(POLL):
                alive = _still_alive(process.pid, alive, main)
                if timeout is not None and time.monotonic() - begin > timeout:
                    raise SimulationError(
                        f"ngspice did not finish within {timeout:g} s",
                        where=str(main.parent),
                        got=f"time point {last_scale_value(raw)} s of {stop} s",
                        hint="give it more time, a looser solver.reltol or a shorter stop",
                    )
                size = raw.stat().st_size if raw.exists() else 0
                if size > LARGEST_RAW:
                    raise SimulationError(
                        "the raw file grows beyond its limit",
                        where=str(main.parent),
                        got=f"{size} bytes at {last_scale_value(raw)} s of {stop} s",
                        expected=f"at most {LARGEST_RAW} bytes",
                        hint="raise solver.max_step or reltol, end earlier, save fewer vectors",
                    )
                if progress is not None and stop:
                    progress(min(1.0, (last_scale_value(raw) or 0.0) / stop))
        finally:
            process.kill()  # nothing to one that has ended
            process.wait()
        return process.returncode


def _still_alive(pid: int, alive: tuple[float, int | None], main: Path) -> tuple[float, int | None]:
    """When the process was last seen at work, and its processor time then.

    Raises
    ------
    SimulationError : it has not worked for ``STALLED`` seconds.
    """
    now, spent = time.monotonic(), _processor_time(pid)
    if spent is None or spent != alive[1]:
        return now, spent
    if now - alive[0] > STALLED:
        raise SimulationError(
            "ngspice hangs",
            where=str(main.parent),
            got=f"no processor time for {STALLED:g} s",
            hint="does it run by itself? kc2spice doctor checks it",
        )
    return alive


def _processor_time(pid: int) -> int | None:
    """Clock ticks that a process and its children have used; None where the system does not say."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        return sum(map(int, fields[11:15]))
    except (OSError, ValueError):
        return None


def _judge_log(deck: Deck, directory: Path, code: int, text: str, raw: Path) -> None:
    """Refuse a run whose log holds a failure, or whose process was killed."""
    report = classify(text)
    if not report.errors and code == 0:
        return
    failure = diagnose(deck, report, f"exit code {code}", _partial(deck, raw, text))
    blame = [f"node {failure.node}"] if failure.node else []
    blame += [failure.part] if failure.part else []
    blame += [f"t = {failure.time:g} s"] if failure.time is not None else []
    tail = " | ".join(text.strip().splitlines()[-3:])
    error = FailedRunError(
        f"ngspice failed: {failure.cause}",
        where=str(directory / deck.main),
        got=", ".join(blame) or (None if report.cause else tail),
        hint=f"the whole log is {Path(deck.main).with_suffix('.log')} in the same directory",
    )
    error.failure = failure
    raise error


def _partial(deck: Deck, raw: Path, text: str) -> Waveforms | None:
    """What a failed run had saved; None where nothing, or not all that the deck asks for."""
    vectors = read_partial(raw)
    if vectors is None:
        return None
    try:
        return Waveforms(_named(deck, vectors), statistics(text))
    except SimulationError:
        return None


def _judge_end(deck: Deck, directory: Path, vectors: dict[str, np.ndarray], text: str) -> None:
    """Refuse a transient that did not reach its end; ngspice can stop early and return 0."""
    if deck.stop is None:
        return
    last = float(vectors["time"][-1]) if "time" in vectors else float("nan")
    if not abs(last - deck.stop) <= 1e-9 * deck.stop:
        report = classify(text)
        error = FailedRunError(
            "ngspice stopped before the end of the transient",
            where=str(directory / deck.main),
            got=f"last time point {last:g} s" + (f", node {report.node}" if report.node else ""),
            expected=f"{deck.stop:g} s",
        )
        partial = Waveforms(_named(deck, vectors), statistics(text))
        error.failure = diagnose(deck, report, error.message, partial)
        raise error


def _named(deck: Deck, vectors: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Result names to SI arrays over the scale ``time``, ``frequency`` or ``sweep``."""
    names = list(vectors)
    scale = names[0] if names[0] in ("time", "frequency") else "sweep"
    data = {scale: vectors[names[0]].real.copy()}
    for key, (expression, factor) in deck.vectors.items():
        parts = [sign * _vector(deck, vectors, v) for sign, v in terms(expression)]
        data[key] = factor * np.sum(parts, axis=0)
    return data


def _vector(deck: Deck, vectors: dict[str, np.ndarray], name: str) -> np.ndarray:
    """One raw vector; ngspice wraps device currents as ``i(@device[i])``."""
    for spelling in (name, f"i({name})"):
        if spelling in vectors:
            return vectors[spelling]
    raise SimulationError("ngspice did not save a vector", where=deck.main, got=name)
