"""Run of a sweep: check, shared models, points, results and table.

Points run in processes of this machine or on a Dask scheduler's workers: both are a
:class:`concurrent.futures.Executor`, and any other executor is accepted. The rows of the points are
stored in a database in any order, and then written as one sorted table.
"""

from __future__ import annotations

import csv
import hashlib
import json
import logging
import os
import signal
import sqlite3
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import timedelta
from functools import cached_property
from importlib import resources
from importlib.resources.abc import Traversable
from itertools import chain, islice, repeat
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from kc2spice.core import __version__
from kc2spice.core.errors import MissingToolError, UsageError, unknown
from kc2spice.core.extras import import_optional
from kc2spice.core.files import stage_directory
from kc2spice.core.progress import Progress, ignore_progress
from kc2spice.core.untrusted_files import MAX_TEXT_BYTES, decode_text, parse_toml, read_bounded
from kc2spice.core.waveforms import quote_csv_cell
from kc2spice.netlist.transforms import with_parameters
from kc2spice.scene.keys import list_scene_keys
from kc2spice.scene.model import Scene, scene_hash
from kc2spice.scene.overrides import format_toml
from kc2spice.workflow.sweep.grid import (
    PARAMETER_KEY,
    Plan,
    find_swept_key,
    make_plan,
    parse_range,
    parse_value,
    split_range,
)
from kc2spice.workflow.sweep.point import (
    Job,
    PointResult,
    SceneText,
    build_point,
    read_scene_files,
    read_scene_text,
    run_point,
    subcircuit_parameters,
)

# Function that opens an executor, also after the loss of an earlier executor, and yields it with
# the number of workers.
Workers = Callable[[], AbstractContextManager[tuple[Executor, int]]]
RECONNECT_TIME = 60.0  # s, time limit for a lost scheduler to reconnect
# Names of exceptions for lost workers and schedulers, so that Dask need not be imported.
_LOST_EXCEPTIONS = {
    "KilledWorker",
    "FutureCancelledError",
    "FuturesCancelledError",
    "CommClosedError",
    "FutureLostError",
}


_GROUP_SUFFIX = ".group"  # suffix of a file named after the process group of a worker


def available_cores() -> int:
    """Return the number of processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on Linux
        return os.cpu_count() or 1


def is_lost_worker(error: BaseException) -> bool:
    """Return whether a call failed because its worker or scheduler was lost."""
    kinds = {kind.__name__ for kind in type(error).__mro__}
    return isinstance(error, (BrokenExecutor, CancelledError, OSError)) or bool(
        _LOST_EXCEPTIONS & kinds
    )


def local_workers(count: int) -> Workers:
    """Return the workers: ``count`` processes of this machine."""
    from multiprocessing import get_context

    @contextmanager
    def open_executor() -> Iterator[tuple[Executor, int]]:
        with tempfile.TemporaryDirectory(
            prefix="kc2spice-sweep-", ignore_cleanup_errors=True
        ) as scratch:
            pool = ProcessPoolExecutor(count, get_context("spawn"), _initialise_worker, (scratch,))
            try:
                yield pool, count
            finally:
                pool.shutdown(wait=True, cancel_futures=True)
                _end_orphans(Path(scratch))

    return open_executor


def _end_orphans(scratch: Path) -> None:
    """Kill ngspice processes of killed workers, which would still write to ``scratch``."""
    for mark in scratch.glob("*" + _GROUP_SUFFIX):
        with suppress(ProcessLookupError, PermissionError):  # the process group has already ended
            os.killpg(int(mark.stem), signal.SIGKILL)


def _initialise_worker(scratch: str) -> None:
    """Ignore Ctrl-C; if the parent is killed, end ngspice and delete files."""
    from multiprocessing import connection, parent_process

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tempfile.tempdir = scratch
    parent, group = parent_process(), hasattr(os, "setpgrp")
    if group:
        os.setpgrp()
        Path(scratch, f"{os.getpid()}{_GROUP_SUFFIX}").touch()

    def watch_parent() -> None:
        """Wait for the end of the parent, then end this worker."""
        if parent is None:
            return
        connection.wait([parent.sentinel])
        # another process deletes the files after all processes that might write them have ended
        if group:
            clean = 'kill -9 "-$0"; sleep 0.1; rm -rf -- "$1"'
            words = ["sh", "-c", clean, str(os.getpgrp()), scratch]
            subprocess.Popen(words, start_new_session=True)
        else:
            os._exit(1)

    threading.Thread(target=watch_parent, daemon=True).start()


def dask_workers(address: str, count: int, patience: float = 10.0) -> Workers:
    """Return the workers of a Dask scheduler, or ``count`` on this machine for ``local``.

    A scheduler gets ``patience`` seconds for its first answer, and a minute to come back.
    """
    limits = chain([patience], repeat(RECONNECT_TIME))

    @contextmanager
    def open_executor() -> Iterator[tuple[Executor, int]]:
        distributed = import_optional("distributed", "--dask")
        # Dask would print tracebacks although the scheduler reconnects
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        limit, target = next(limits), address
        with ExitStack() as stack:
            try:
                if address == "local":
                    options = {"threads_per_worker": 1, "dashboard_address": None}
                    target = stack.enter_context(
                        distributed.LocalCluster(n_workers=count, **options)
                    )
                client = distributed.Client(target, timeout=limit)
                stack.callback(_disconnect, client)
                client.wait_for_workers(1, timeout=limit)
            except (OSError, TimeoutError, ValueError) as error:
                raise MissingToolError(
                    "no Dask scheduler with workers answers",
                    where="--dask",
                    got=address,
                    expected="an address such as tcp://host:8786, or local",
                    hint=f"{type(error).__name__}: {error}".splitlines()[0][:200],
                ) from None
            yield client.get_executor(pure=False, retries=0), sum(client.nthreads().values())

    return open_executor


def _disconnect(client: Any) -> None:
    with suppress(Exception):  # the scheduler may have ended already
        client.close(timeout=5)


OK_STATUS = "ok"
_OPEN_STATEMENTS = """
pragma trusted_schema = off;
pragma locking_mode = exclusive;  -- another process that writes here is refused at once
pragma journal_mode = delete;
pragma synchronous = off;         -- a row survives the end of this process, which is enough
begin exclusive;
create table if not exists sweep (digest text);
create table if not exists row (point integer primary key, outcome text);
commit;
"""
_OUTCOME_ADAPTER = TypeAdapter(PointResult)


class RowStore:
    """Results of the points in an SQLite file, in which each row is complete or missing.

    ``digest`` is that of the sweep; ``failed`` are the points that have no numbers.

    Raises
    ------
    UsageError : another process writes to it, or it contains another sweep or other data.
    """

    def __init__(self, path: Path, points: int, digest: str) -> None:
        self.path, self.outcomes, self.failed = path, dict[int, PointResult](), set[int]()
        if path.is_symlink() or (path.exists() and not path.is_file()):
            raise UsageError(
                "this file is not a results file of a sweep", where=str(path), hint="remove it"
            )
        try:
            self._rows = sqlite3.connect(path, timeout=0.0, isolation_level=None)
            self._rows.executescript(_OPEN_STATEMENTS)
            (stored,) = self._rows.execute("select digest from sweep").fetchone() or (None,)
            if stored is None:
                self._rows.execute("insert into sweep values (?)", (digest,))
            for point, text in self._rows.execute("select * from row") if stored == digest else ():
                if point not in range(points):
                    raise ValueError(f"point {str(point)[:80]!r}")
                self._write_row(point, _OUTCOME_ADAPTER.validate_json(text, strict=True))
        except (sqlite3.Error, ValueError) as error:
            hint = "remove it: what it held is run again"
            message = (
                "this file is damaged or cannot be written, because it does not contain "
                "the rows of this sweep"
            )
            if "locked" in str(error):
                message, hint = (
                    "another sweep is writing to this directory",
                    "wait for it, or choose another",
                )
            got = str(error).splitlines()[0][:200]
            raise UsageError(message, where=str(path), got=got, hint=hint) from None
        if stored not in (None, digest):
            raise UsageError(
                "this directory contains the results of another sweep",
                where=str(path.parent),
                got=f"plan {stored}"[:80],
                expected=f"plan {digest}",
                hint="choose another --out, or delete this directory",
            )

    def record(self, point: int, outcome: PointResult) -> None:
        """Write one row in place of an earlier one of the same point.

        Raises
        ------
        UsageError : the disk is full, or the file cannot be written.
        """
        row = (point, json.dumps(asdict(outcome)))
        try:
            self._rows.execute("insert or replace into row values (?, ?)", row)
        except sqlite3.Error as error:
            hint = "the rows so far are kept: make room and give the same command again"
            message = f"this file cannot be written: {error}"
            raise UsageError(message, where=str(self.path), hint=hint) from None
        self._write_row(point, outcome)

    def _write_row(self, point: int, outcome: PointResult) -> None:
        self.outcomes[point] = outcome
        (self.failed.discard if outcome.failure is None else self.failed.add)(point)

    def close(self) -> None:
        """Close the file."""
        self._rows.close()


def require_columns(outcome: PointResult, names: Sequence[str], scene: str) -> None:
    """Raise an error if a run lacks one of the metrics, or has no number for the table."""
    known = {**outcome.metrics, **outcome.facts}
    for name in names:
        if name not in known:
            raise unknown("the result has no number of this name", name, known, "--metric")
    if not names and not outcome.metrics:
        raise UsageError(
            "this scene has no metric that is a number, so the table of the sweep is empty",
            where=scene,
            expected="a scene with metrics that are numbers, or with [probes]",
            hint="use kc2spice run with --set to compute the curves of one point",
        )


def columns(
    outcomes: Mapping[int, PointResult], plan: Plan, metrics: Sequence[str] = ()
) -> dict[str, list[Any]]:
    """Return the table: swept keys, ``metrics`` (by default all of the runs), ``status``.

    A point without a number has None in this column.
    """
    rows = sorted(outcomes.items())
    names = metrics or dict.fromkeys(chain.from_iterable(item.metrics for _, item in rows))
    table: dict[str, list[Any]] = {name: [] for name in (*plan.keys, *names, "status")}
    for point, outcome in rows:
        numbers = {**outcome.facts, **outcome.metrics}
        result = {name: numbers.get(name) for name in names} | plan.values(point)
        why = outcome.failure
        result["status"] = OK_STATUS if why is None else f"failed: {' '.join(why.split())}"
        for name, value in result.items():
            table[name].append(value)
    return table


def write_csv(table: Mapping[str, Sequence[Any]], path: Path) -> None:
    """Write floats with all their digits, ``true`` and ``false``, and nothing for None.

    Text that a spreadsheet would evaluate as a formula begins with an apostrophe.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(map(quote_csv_cell, table))
        for row in zip(*table.values(), strict=True):
            writer.writerow(map(_csv_cell, row))


def _csv_cell(value: Any) -> str | None:
    if isinstance(value, str):
        return quote_csv_cell(value)
    return None if value is None else format_toml(value)


def write_parquet(table: Mapping[str, Sequence[Any]], path: Path) -> None:
    """Write the table as Parquet; its numbers keep their type."""
    arrow = import_optional("pyarrow", "--format")
    parquet = import_optional("pyarrow.parquet", "--format")

    empty = {name for name, column in table.items() if all(value is None for value in column)}
    kinds = {name: arrow.float64() if name in empty else None for name in table}
    arrays = {name: arrow.array(column, kinds[name]) for name, column in table.items()}
    parquet.write_table(arrow.table(arrays), path)


WRITERS = {"csv": write_csv, "parquet": write_parquet}


ROWS_FILE, PAGE_FILE = "rows.sqlite", "sweep.html"
LOST_POINT = PointResult(failure="its worker process died, twice", interrupted=True)


# --- planning --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sweep:
    """Checked sweep: points, settings of the workers, and columns of the table.

    ``scene`` is that of the first point, ``units`` those of the swept keys; ``metrics`` are the
    requested columns, empty for all.
    """

    scene: Scene
    job: Job
    plan: Plan
    units: Mapping[str, str]
    metrics: tuple[str, ...] = ()

    @cached_property
    def digest(self) -> str:
        """Hash of all inputs that affect the results."""
        files = {
            n: hashlib.sha256(data).hexdigest() for n, data in read_scene_files(self.scene).items()
        }
        context = [
            __version__,
            scene_hash(self.scene),
            files,
            self.job.parameters,
            self.plan.keys,
            self.scene.checks.model_dump(),
            self.scene.solver.retries,
        ]
        text = json.dumps(context, sort_keys=True) + repr(self.plan.blocks)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @property
    def runs(self) -> dict[str, int]:
        """Numbers of decks and ngspice runs."""
        keys = [key for key in self.plan.keys if not PARAMETER_KEY.fullmatch(key)]
        return {"netlists": self.plan.count_distinct(keys), "ngspice": self.plan.size}

    def describe(self) -> str:
        """Return the numbers of decks and runs in one line."""
        netlists, runs = self.runs.values()
        return f"{self.plan.size} points: {netlists} netlists, {runs} ngspice runs"


def make_sweep(
    scene: SceneText,
    sets: Sequence[str],
    *,
    zipped: bool = False,
    latin: bool = False,
    seed: int = 0,
    metrics: Sequence[str] = (),
    timeout: float | None = None,
) -> Sweep:
    """Check ``KEY=RANGE`` texts as far as possible without building a model.

    Raises
    ------
    UsageError : a range is invalid, a key is unknown, or a value is not allowed.
    """
    fixed, firsts, constants, ranges = [], [], [], dict[str, str]()
    for text in sets:
        name, _, value = (part.strip() for part in text.partition("="))
        parameter, (kind, words) = PARAMETER_KEY.fullmatch(name), split_range(value)
        if kind != "value":
            if name in ranges:
                raise UsageError("swept twice", where="--set", got=name)
            ranges[name] = value
            firsts += [] if parameter else [f"{name}={words[0]}"]
        elif parameter:
            constants.append((parameter[1], parse_value(value, "", f"--set {text!r}")))
        else:
            fixed.append(text)
    # A range may create a part that the scene lacks without this range.
    keys = list_scene_keys(scene.load((*fixed, *firsts)))
    plan = make_plan(
        {name: parse_range(name, value, keys) for name, value in ranges.items()},
        zipped=zipped,
        latin=latin,
        seed=seed,
    )
    units = {key: find_swept_key(key, keys).unit or "" for key in plan.keys}
    job = Job(scene, tuple(fixed), tuple(constants), timeout)
    return sweep_of_plan(job, plan, units, tuple(dict.fromkeys(metrics)))


def sweep_of_plan(
    job: Job, plan: Plan, units: Mapping[str, str], metrics: tuple[str, ...] = ()
) -> Sweep:
    """Return the sweep of ``plan``.

    Raises
    ------
    UsageError : the scene is wrong at the first point, or at an end of one of the ranges.
    """
    first, *_ = list(map(job.load, plan.ends()))
    return Sweep(first, job, plan, units, metrics)


class _Study(BaseModel):
    """A sweep in a file: a scene, ranges of its keys, and options of :func:`make_sweep`."""

    model_config = ConfigDict(extra="forbid", strict=True)

    title: str = ""
    scene: str
    ranges: dict[str, Any] = Field(alias="set", default_factory=dict)
    zipped: bool = Field(False, alias="zip")
    latin: bool = False
    seed: int = 0
    metrics: list[str] = Field(default_factory=list)


def studies() -> dict[str, Traversable]:
    """Return the built-in studies by name."""
    folder = resources.files("kc2spice") / "studies"
    result = {item.name: item for item in folder.iterdir() if item.name.endswith(".toml")}
    return {name.removesuffix(".toml"): result[name] for name in sorted(result)}


def load_named_sweep(name: str, sets: Sequence[str] = (), **asked: Any) -> Sweep:
    """Return the sweep of a scene, or of a study with further ``sets`` and options ``asked``.

    A range in ``sets`` replaces the study's of the same key; ``asked`` are options of
    :func:`make_sweep`.

    Raises
    ------
    UsageError : as :func:`make_sweep`; neither a scene nor a study, or a study with a mistake.
    """
    study = _find_study(name)
    if study is None:
        return make_sweep(read_scene_text(name), sets, **asked)
    ranges = {
        key: f"{key}={v if isinstance(v, str) else format_toml(v)}"
        for key, v in study.ranges.items()
    }
    ranges |= {text.partition("=")[0].strip(): text for text in sets}
    settings = study.model_dump(include={"zipped", "latin", "seed", "metrics"})
    selected = settings | {
        key: value for key, value in asked.items() if value or key not in settings
    }
    return make_sweep(read_scene_text(study.scene), tuple(ranges.values()), **selected)


def _find_study(name: str) -> _Study | None:
    """Return the study ``name``, built in or a file with a key ``scene``; None for a scene."""
    builtin = studies().get(name)
    try:
        data = builtin.read_bytes() if builtin else read_bounded(Path(name), MAX_TEXT_BYTES)
        content = parse_toml(decode_text(data))
    except (OSError, ValueError):
        return None  # the loader of scenes reports the mistake
    if not isinstance(content.get("scene"), str):
        return None
    try:
        return _Study.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = f"{name}, key {'.'.join(map(str, first['loc']))}"
        raise UsageError(
            f"this key of the study is not valid: {first['msg']}", where=where
        ) from None


# --- running it -----------------------------------------------------------------------------------


def run_points(
    definition: Sweep, points: Iterable[int], workers: Workers
) -> Iterator[tuple[int, PointResult]]:
    """Run ``points`` and yield each point with its outcome when it ends.

    The first worker that needs a model builds it into the cache; all other workers wait for this
    entry. A point that is interrupted, by the death of a worker or another fault of the machine, is
    run once more after all others. Only a point that ends its worker again fails.

    Raises
    ------
    UsageError : the deck has not a subcircuit parameter, or not with one of the swept values; the
        first good point has nothing for a column.
    MissingToolError : no workers, or no ngspice where they are.
    """
    ends = chain.from_iterable(map(subcircuit_parameters, definition.plan.ends()))
    if changed := [*definition.job.parameters, *ends]:
        _, deck = build_point(definition.job, definition.plan.values(0))
        with_parameters(deck, changed)
    again: list[int] = []
    known = False
    for index, outcome in _complete_points(definition, points, workers):
        if outcome.failure is None and not known:
            require_columns(outcome, definition.metrics, definition.scene.name)
            known = True
        if outcome.interrupted:
            again.append(index)
        else:
            yield index, outcome
    if again:
        yield from _complete_points(definition, again, workers, at_once=1)


def _complete_points(
    definition: Sweep, points: Iterable[int], workers: Workers, at_once: int | None = None
) -> Iterator[tuple[int, PointResult]]:
    """Yield outcomes of ``points`` as they end; only as many points run as there are workers.

    If a worker dies, all points that were running are ``LOST_POINT``, and the workers are started
    again.
    """
    left, pending = iter(points), dict[Future[PointResult], int]()
    with ExitStack() as opened:
        executor, count = opened.enter_context(workers())
        while True:
            for index in islice(left, max(0, (at_once or 2 * count + 1) - len(pending))):
                values = definition.plan.values(index)
                pending[_submit_point(executor.submit, definition.job, values)] = index
            if not pending:
                return
            results = {
                f: _collect_result(f) for f in wait(pending, return_when=FIRST_COMPLETED).done
            }
            if LOST_POINT in results.values():
                results |= {f: LOST_POINT for f in pending if f not in results}
                opened.close()
                executor, count = opened.enter_context(workers())
            for future, outcome in results.items():
                yield pending.pop(future), outcome


def _submit_point(submit: Any, job: Job, values: Mapping[str, Any]) -> Future[PointResult]:
    """Submit a point to the workers."""
    try:
        future: Future[PointResult] = submit(run_point, job, values)
    except Exception as error:  # an executor without workers raises an error
        future = Future()
        future.set_exception(error)
    return future


def _collect_result(future: Future[PointResult]) -> PointResult:
    """Return the outcome of a point."""
    try:
        return future.result()
    except Exception as error:
        if is_lost_worker(error):
            return LOST_POINT
        raise


def run_sweep(
    definition: Sweep,
    out: Path,
    workers: Workers,
    progress: Progress = ignore_progress,
    *,
    table_format: str = "csv",
    retry_failed: bool = False,
) -> dict[str, Any]:
    """Run all points of a sweep that are not finished, and write its table.

    Each finished row is written to ``out/rows.sqlite``. The table, its figures and ``sweep.html``
    appear after the last row. The same call continues a sweep that was interrupted. It repeats
    points that failed because of the machine.

    Parameters
    ----------
    definition : Sweep
        Points and settings of the sweep, such as :func:`load_named_sweep` returns.
    out : Path
        Directory for the files of the sweep.
    workers : callable
        Function without arguments that returns a context manager. The manager yields an executor
        and the number of points to run at a time. See :func:`local_workers` and
        :func:`dask_workers`.
    progress : callable, optional
        Called as ``progress(stage, done, text)`` after each point.
    table_format : "csv" or "parquet", default "csv"
        Format of the table.
    retry_failed : bool, default False
        Whether to repeat all points that failed.

    Returns
    -------
    dict[str, Any]
        What ``kc2spice sweep --json`` prints: number of points, failures and names of the files.

    Raises
    ------
    UsageError : ``out`` contains another sweep, another process writes to it, or it cannot be
        written.
    MissingToolError : no workers, or no ngspice where they are; no pyarrow for Parquet.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> from contextlib import nullcontext
    >>> drops = load_named_sweep("impact", ["impact.velocity=-0.1,-0.2"])
    >>> summary = run_sweep(drops, Path("drops"), lambda: nullcontext((ThreadPoolExecutor(1), 1)))
    >>> summary["points"], summary["failed"]
    (2, 0)
    >>> Path("drops/sweep.html").is_file()
    True
    """
    start = begin = time.monotonic()
    with closing(_open_rows(definition, out, table_format)) as rows:
        done = set()
        for index, outcome in rows.outcomes.items():
            if not outcome.interrupted and (outcome.failure is None or not retry_failed):
                done.add(index)
        good = (item for item in rows.outcomes.values() if item.failure is None)
        for outcome in islice(good, 1):
            require_columns(outcome, definition.metrics, definition.scene.name)
        missing = sorted(set(range(definition.plan.size)) - done)
        for count, (index, outcome) in enumerate(run_points(definition, missing, workers), 1):
            rows.record(index, outcome)
            begin = time.monotonic() if count == 1 else begin
            text = f"{count} of {len(missing)} points, {len(rows.failed)} failed"
            if count > 1:  # the first point may have built models for all others
                rate = (count - 1) / max(time.monotonic() - begin, 1e-9)
                left = timedelta(seconds=round((len(missing) - count) / rate))
                text = f"{text}, {rate:.3g}/s, {left} left"
            progress("sweep", count / len(missing), text)
        progress("report", None, "table, figures and page")
        summary = _write_tables(definition, rows, out, table_format)
    return {**summary, "resumed": len(done), "wall_s": time.monotonic() - start}


def table_file_name(table_format: str) -> str:
    """Return the file name of the table.

    Raises
    ------
    UsageError : no such format.
    MissingToolError : no pyarrow for Parquet.
    """
    if table_format not in WRITERS:
        raise unknown("this table format does not exist", table_format, WRITERS, "--format")
    if table_format == "parquet":
        import_optional("pyarrow.parquet", "--format")
    return f"sweep.{table_format}"


def _open_rows(definition: Sweep, out: Path, table_format: str) -> RowStore:
    name = table_file_name(table_format)
    if out.exists() and not out.is_dir():
        raise UsageError(
            "this path is a file, not a directory", where=str(out), hint="choose another --out"
        )
    if (out / name).exists() and not (out / ROWS_FILE).exists():
        hint = "choose another --out, or remove it"
        raise UsageError(
            "this directory already contains results", where=str(out / name), hint=hint
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"this file cannot be written: {error.strerror}", where=str(out)) from None
    return RowStore(out / ROWS_FILE, definition.plan.size, definition.digest)


def _write_tables(
    definition: Sweep, rows: RowStore, out: Path, table_format: str
) -> dict[str, Any]:
    """Write table, figures and page, and return their names for the summary."""
    from kc2spice.report.sweep_page import compute_yields, write_sweep

    table = columns(rows.outcomes, definition.plan, definition.metrics)
    name = table_file_name(table_format)
    shares = compute_yields(table, definition.plan.keys) if definition.plan.random else {}
    plan = definition.describe()
    with stage_directory(out) as work:
        WRITERS[table_format](table, work / name)
        units: dict[str, str] = {}
        for item in rows.outcomes.values():
            units |= item.units
        write_sweep(
            work / PAGE_FILE,
            definition.scene,
            table,
            definition.units,
            units,
            definition.plan.random,
            plan,
            shares,
        )
    return {
        "scene": definition.scene.name,
        "points": definition.plan.size,
        "failed": len(rows.failed),
        "table": str((out / name).absolute()),
        "directory": str(out.absolute()),
        "runs": definition.runs,
        "yield": shares,
        "files": [name, PAGE_FILE],
    }
