"""Run a sweep: check it, share the models, run and record the points, write the table."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import ExitStack, closing
from dataclasses import dataclass
from datetime import timedelta
from functools import cached_property
from importlib import resources
from importlib.resources.abc import Traversable
from itertools import islice
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from kc2spice.core.errors import UsageError, needed, unknown
from kc2spice.core.files import staged
from kc2spice.core.foreign import MAX_BYTES, parse_toml, read_bounded, text_of
from kc2spice.core.progress import Progress, silent
from kc2spice.core.version import __version__
from kc2spice.netlist.transforms import with_parameters
from kc2spice.scene.keys import keys_of
from kc2spice.scene.load import toml
from kc2spice.scene.model import Scene, scene_hash
from kc2spice.workflow.sweep.plan import (
    PARAMETER,
    Plan,
    form,
    key_of,
    make_plan,
    number,
    parse,
)
from kc2spice.workflow.sweep.point import (
    Job,
    LoadedScene,
    Outcome,
    SceneText,
    parameters,
    run_point,
    scene_files,
    scene_text,
    testbench,
)
from kc2spice.workflow.sweep.table import (
    WRITERS,
    RowStore,
    columns,
    require_columns,
)
from kc2spice.workflow.sweep.workers import Workers, is_lost

ROWS, PAGE = "rows.sqlite", "sweep.html"
LOST = Outcome(failure="its worker process died, twice", interrupted=True)


# --- what is asked ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sweep:
    """A sweep that was found good: points, what its workers need, and columns of the table.

    ``scene`` is that of the first point, ``units`` those of the swept keys; ``metrics`` are the
    columns that were asked for, none for all.
    """

    scene: Scene
    job: Job
    plan: Plan
    units: Mapping[str, str]
    metrics: tuple[str, ...] = ()

    @cached_property
    def digest(self) -> str:
        """Hash of everything that decides the numbers."""
        files = {n: hashlib.sha256(data).hexdigest() for n, data in scene_files(self.scene).items()}
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
        """How many decks and ngspice runs there will be; points that differ in parameters of
        subcircuits alone share a deck."""
        keys = [key for key in self.plan.keys if not PARAMETER.fullmatch(key)]
        return {"netlists": self.plan.distinct(keys), "ngspice": self.plan.size}

    def describe(self) -> str:
        """The same in one line."""
        netlists, runs = self.runs.values()
        return f"{self.plan.size} points: {netlists} netlists, {runs} ngspice runs"


def make_sweep(
    scene: SceneText | LoadedScene,
    sets: Sequence[str],
    *,
    zipped: bool = False,
    latin: bool = False,
    seed: int = 0,
    metrics: Sequence[str] = (),
    timeout: float | None = None,
) -> Sweep:
    """Check ``KEY=RANGE`` texts as far as that goes without building a model.

    Raises
    ------
    UsageError : a bad range, an unknown key, a value that the scene does not take.
    """
    fixed, firsts, constants, ranges = [], [], [], dict[str, str]()
    for text in sets:
        name, _, value = (part.strip() for part in text.partition("="))
        parameter, (kind, words) = PARAMETER.fullmatch(name), form(value)
        if kind != "value":
            if name in ranges:
                raise UsageError("swept twice", where="--set", got=name)
            ranges[name] = value
            firsts += [] if parameter else [f"{name}={words[0]}"]
        elif parameter:
            constants.append((parameter[1], number(value, "", f"--set {text!r}")))
        else:
            fixed.append(text)
    # A range may make a part that the scene does not have without it.
    keys = keys_of(scene.load((*fixed, *firsts)))
    plan = make_plan(
        {name: parse(name, value, keys) for name, value in ranges.items()},
        zipped=zipped,
        latin=latin,
        seed=seed,
    )
    units = {key: key_of(key, keys).unit or "" for key in plan.keys}
    job = Job(scene, tuple(fixed), tuple(constants), timeout)
    return planned(job, plan, units, tuple(dict.fromkeys(metrics)))


def planned(job: Job, plan: Plan, units: Mapping[str, str], metrics: tuple[str, ...] = ()) -> Sweep:
    """The sweep of ``plan``.

    Raises
    ------
    UsageError : the scene is wrong at the first point, or at an end of one of the ranges.
    """
    first, *_ = [job.load(values) for values in plan.ends()]
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
    """Built-in studies by name."""
    folder = resources.files("kc2spice") / "studies"
    found = {item.name: item for item in folder.iterdir() if item.name.endswith(".toml")}
    return {name.removesuffix(".toml"): found[name] for name in sorted(found)}


def named_sweep(name: str, sets: Sequence[str] = (), **asked: Any) -> Sweep:
    """The sweep of a scene, or of a study with ``sets`` and what is ``asked`` on top of it.

    A range in ``sets`` replaces the study's of the same key; ``asked`` are options of
    :func:`make_sweep`.

    Raises
    ------
    UsageError : as :func:`make_sweep`; neither a scene nor a study, or a study with a mistake.
    """
    study = _study(name)
    if study is None:
        return make_sweep(scene_text(name), sets, **asked)
    ranges = {
        key: f"{key}={v if isinstance(v, str) else toml(v)}" for key, v in study.ranges.items()
    }
    ranges |= {text.partition("=")[0].strip(): text for text in sets}
    own = study.model_dump(include={"zipped", "latin", "seed", "metrics"})
    chosen = own | {key: value for key, value in asked.items() if value or key not in own}
    return make_sweep(scene_text(study.scene), tuple(ranges.values()), **chosen)


def _study(name: str) -> _Study | None:
    """The study ``name``, built in or a file with a key ``scene``; None for a scene."""
    builtin = studies().get(name)
    try:
        data = builtin.read_bytes() if builtin else read_bounded(Path(name), MAX_BYTES)
        content = parse_toml(text_of(data))
    except (OSError, ValueError):
        return None  # whoever loads it as a scene says what is wrong with it
    if not isinstance(content.get("scene"), str):
        return None
    try:
        return _Study.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = f"{name}, key {'.'.join(map(str, first['loc']))}"
        raise UsageError(f"no key of a study: {first['msg']}", where=where) from None


# --- running it ---------------------------------------------------------------------------------


def outcomes(
    found: Sweep, points: Iterable[int], workers: Workers
) -> Iterator[tuple[int, Outcome]]:
    """Run ``points`` and give each with its outcome as it comes.

    Whoever needs a model first builds it into the cache, where all others wait for it. A point that
    is interrupted, by the death of a worker or by what else happens to the machine, is run once
    more after all others, alone: only the one that ends its worker again is given up.

    Raises
    ------
    UsageError : the deck has not a subcircuit parameter, or not with one of the swept values.
    MissingToolError : no workers, or no ngspice where they are.
    """
    ends = [pair for values in found.plan.ends() for pair in parameters(values)]
    if changed := [*found.job.parameters, *ends]:
        _, deck = testbench(found.job, found.plan.values(0))
        with_parameters(deck, changed)
    again: list[int] = []
    for index, outcome in _completed(found, points, workers):
        if outcome.interrupted:
            again.append(index)
        else:
            yield index, outcome
    if again:
        yield from _completed(found, again, workers, at_once=1)


def _completed(
    found: Sweep, points: Iterable[int], workers: Workers, at_once: int | None = None
) -> Iterator[tuple[int, Outcome]]:
    """Outcomes of ``points`` as they come, no more in flight than keeps all workers busy.

    Where a worker dies, all that was in flight is ``LOST``, and the workers are opened again.
    """
    left, pending = iter(points), dict[Future[Outcome], int]()
    with ExitStack() as opened:
        executor, count = opened.enter_context(workers())
        while True:
            for index in islice(left, max(0, (at_once or 2 * count + 1) - len(pending))):
                values = found.plan.values(index)
                pending[_submitted(executor.submit, found.job, values)] = index
            if not pending:
                return
            results = {f: _result(f) for f in wait(pending, return_when=FIRST_COMPLETED).done}
            if LOST in results.values():
                results |= {f: LOST for f in pending if f not in results}
                opened.close()
                executor, count = opened.enter_context(workers())
            for future, outcome in results.items():
                yield pending.pop(future), outcome


def _submitted(submit: Any, job: Job, values: Mapping[str, Any]) -> Future[Outcome]:
    try:
        future: Future[Outcome] = submit(run_point, job, values)
    except Exception as error:  # of an executor whose workers are gone
        future = Future()
        future.set_exception(error)
    return future


def _result(future: Future[Outcome]) -> Outcome:
    try:
        return future.result()
    except Exception as error:
        if is_lost(error):
            return LOST
        raise


def sweep(
    found: Sweep,
    out: Path,
    workers: Workers,
    progress: Progress = silent,
    *,
    table_format: str = "csv",
    retry_failed: bool = False,
) -> dict[str, Any]:
    """Run all points that ``out`` does not hold yet; return the contract's summary.

    Rows go to ``out/rows.sqlite`` as they come; the table, its figures and ``sweep.html`` appear
    when all are there. A sweep that was killed goes on where it was when it is asked for again.
    Points that failed for what happened to the machine are run again then, with ``retry_failed``
    all that failed.

    Raises
    ------
    UsageError : ``out`` holds another sweep, another process writes there, or it cannot be written.
    MissingToolError : no workers, or no ngspice where they are; no pyarrow for Parquet.
    """
    start = begin = time.monotonic()
    with closing(_open_rows(found, out, table_format)) as rows:
        done = {
            index
            for index, outcome in rows.outcomes.items()
            if not outcome.interrupted and (outcome.failure is None or not retry_failed)
        }
        good = [each for each in rows.outcomes.values() if each.failure is None]
        for outcome in good[:1]:
            require_columns(outcome, found.metrics, found.scene.name)
        missing = [index for index in range(found.plan.size) if index not in done]
        for count, (index, outcome) in enumerate(outcomes(found, missing, workers), 1):
            rows.record(index, outcome)
            if outcome.failure is None and not good:
                good.append(outcome)
                require_columns(outcome, found.metrics, found.scene.name)
            begin = time.monotonic() if count == 1 else begin
            told = f"{count} of {len(missing)} points, {len(rows.failed)} failed"
            if count > 1:  # the first one may have built models for all others
                rate = (count - 1) / max(time.monotonic() - begin, 1e-9)
                left = timedelta(seconds=round((len(missing) - count) / rate))
                told = f"{told}, {rate:.3g}/s, {left} left"
            progress("sweep", count / len(missing), told)
        progress("report", None, "table, figures and page")
        summary = _publish(found, rows, out, table_format)
    return {**summary, "resumed": len(done), "wall_s": time.monotonic() - start}


def table_name(table_format: str) -> str:
    """Name of the table's file.

    Raises
    ------
    UsageError : no such format.
    MissingToolError : no pyarrow for Parquet.
    """
    if table_format not in WRITERS:
        raise unknown("no such format", table_format, WRITERS, "--format")
    if table_format == "parquet":
        needed("pyarrow.parquet", "pyarrow", "--format", "parquet")
    return f"sweep.{table_format}"


def _open_rows(found: Sweep, out: Path, table_format: str) -> RowStore:
    name = table_name(table_format)
    if out.exists() and not out.is_dir():
        raise UsageError("is a file, not a directory", where=str(out), hint="choose another --out")
    if (out / name).exists() and not (out / ROWS).exists():
        hint = "choose another --out, or remove it"
        raise UsageError("would be overwritten", where=str(out / name), hint=hint)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"cannot be written: {error.strerror}", where=str(out)) from None
    return RowStore(out / ROWS, found.plan.size, found.digest)


def _publish(found: Sweep, rows: RowStore, out: Path, table_format: str) -> dict[str, Any]:
    """Write table, figures and page; what the summary says of them."""
    from kc2spice.report.sweep_page import write_sweep, yields

    table = columns(rows.outcomes, found.plan, found.metrics)
    name = table_name(table_format)
    shares = yields(table, found.plan.keys) if found.plan.random else {}
    plan = found.describe()
    with staged(out) as work:
        WRITERS[table_format](table, work / name)
        write_sweep(work / PAGE, found.scene, table, found.units, found.plan.random, plan, shares)
    return {
        "scene": found.scene.name,
        "points": found.plan.size,
        "failed": len(rows.failed),
        "table": str((out / name).absolute()),
        "directory": str(out.absolute()),
        "runs": found.runs,
        "yield": shares,
        "files": [name, PAGE],
    }
