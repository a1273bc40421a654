"""Run a sweep: check it, share the models, run and record the points, write the table."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import timedelta
from functools import cached_property
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from kc2spice.core.errors import UsageError
from kc2spice.core.files import staged
from kc2spice.core.foreign import MAX_BYTES, parse_toml, read_bounded, text_of
from kc2spice.core.progress import Progress, silent
from kc2spice.core.version import __version__
from kc2spice.core.words import did_you_mean
from kc2spice.netlist.transforms import with_parameters
from kc2spice.scene.hash import scene_hash
from kc2spice.scene.keys import keys_of
from kc2spice.scene.model import Scene
from kc2spice.workflow.sweep.plan import (
    PARAMETER,
    Plan,
    find_key,
    form,
    make_plan,
    number,
    parse,
)
from kc2spice.workflow.sweep.point import (
    Job,
    Outcome,
    Source,
    overrides,
    parameters,
    run_point,
    scene_files,
    scene_text,
    testbench,
    toml,
)
from kc2spice.workflow.sweep.table import (
    BAD,
    INTERRUPTED,
    MISSING,
    WRITERS,
    RowStore,
    columns,
    need_parquet,
    require_columns,
)
from kc2spice.workflow.sweep.workers import WORKER_DIED, Workers, completed

ROWS, PAGE = "rows.sqlite", "sweep.html"
DIED = "its worker process died, twice"


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
        keys = [key for key in self.plan.keys if not key.startswith(PARAMETER)]
        return {"netlists": self.plan.distinct(keys), "ngspice": self.plan.size}

    def describe(self) -> str:
        """The same in one line."""
        netlists, runs = self.runs.values()
        return f"{self.plan.size} points: {netlists} netlists, {runs} ngspice runs"


def make_sweep(
    scene: Source,
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
    fixed, constants, ranges, firsts = [], [], [], []
    for text in sets:
        name, _, value = (part.strip() for part in text.partition("="))
        kind, words = form(value)
        if kind == "value" and name.startswith(PARAMETER):
            plain = number(f"--set {text!r}", find_key(name, {}), value)
            constants.append((name.removeprefix(PARAMETER), plain))
        elif kind == "value":
            fixed.append(text)
        else:
            ranges.append((name, value))
            firsts += [] if name.startswith(PARAMETER) else [f"{name}={words[0]}"]
    # A range may make a part that the scene does not have without it.
    first = _at_first(scene, fixed, firsts)
    keys = keys_of(first)
    plan = make_plan(
        [parse(name, value, keys) for name, value in ranges],
        zipped=zipped,
        latin=latin,
        seed=seed,
    )
    units = {key: find_key(key, keys).unit or "" for key in plan.keys}
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


def _at_first(source: Source, fixed: Sequence[str], firsts: Sequence[str]) -> Scene:
    """The scene with the first value of every swept key; an unknown one is named with its like."""
    try:
        return source.load((*fixed, *firsts))
    except UsageError:
        keys = keys_of(source.load(fixed))
        for text in firsts:
            name = text.partition("=")[0]
            if name not in keys and did_you_mean(name, keys):
                find_key(name, keys)
        raise


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
    found = {item.name.removesuffix(".toml"): item for item in folder.iterdir()}
    return {name: found[name] for name in sorted(found) if found[name].name.endswith(".toml")}


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
    builtin = studies()
    try:
        text = (
            builtin[name].read_text(encoding="utf-8")
            if name in builtin
            else text_of(read_bounded(Path(name), MAX_BYTES))
        )
        content = parse_toml(text)
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
    found: Sweep, points: Sequence[int], workers: Workers
) -> Iterator[tuple[int, Outcome]]:
    """Run ``points`` and give each with its outcome as it comes.

    Whoever needs a model first builds it into the cache, where all others wait for it. A point that
    is interrupted by what happens to the machine is run once more after all others.

    Raises
    ------
    UsageError : the deck has not a subcircuit parameter, or not with one of the swept values.
    MissingToolError : no workers, or no ngspice where they are.
    """
    ends = [pair for values in found.plan.ends() for pair in parameters(values)]
    if changed := [*found.job.parameters, *ends]:
        _, deck = testbench(found.job, overrides(found.plan.values(0)))
        with_parameters(deck, changed)
    again: list[int] = []
    for last, attempt in ((False, points), (True, again)):
        calls = ((k, run_point, (found.job, found.plan.values(k))) for k in attempt)
        for index, outcome in completed(workers, calls) if attempt else ():
            if outcome is WORKER_DIED:
                outcome = Outcome(failure=DIED, interrupted=True)
            elif outcome.interrupted and not last:
                again.append(index)
                continue
            yield index, outcome


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
        rows.forget(INTERRUPTED, *([BAD] if retry_failed else []))
        missing = np.flatnonzero(rows.state == MISSING).tolist()
        first = next((each for _, each in rows.outcomes() if each.failure is None), None)
        if first is not None:
            require_columns(first, found.metrics, found.scene.name)
        for done, (index, outcome) in enumerate(outcomes(found, missing, workers), 1):
            rows.record(index, outcome)
            if outcome.failure is None and first is None:
                first = outcome
                require_columns(outcome, found.metrics, found.scene.name)
            begin = time.monotonic() if done == 1 else begin
            told = f"{done} of {len(missing)} points, {rows.failed} failed"
            if done > 1:  # the first one may have built models for all others
                rate = (done - 1) / max(time.monotonic() - begin, 1e-9)
                left = timedelta(seconds=round((len(missing) - done) / rate))
                told = f"{told}, {rate:.3g}/s, {left} left"
            progress("sweep", done / len(missing), told)
        progress("report", None, "table, figures and page")
        summary = _publish(found, rows, out, table_format)
    resumed = found.plan.size - len(missing)
    return {**summary, "resumed": resumed, "wall_s": time.monotonic() - start}


def table_name(table_format: str) -> str:
    """Name of the table's file.

    Raises
    ------
    UsageError : no such format.
    MissingToolError : no pyarrow for Parquet.
    """
    if table_format not in WRITERS:
        expected = " or ".join(WRITERS)
        raise UsageError("no such format", where="--format", got=table_format, expected=expected)
    if table_format == "parquet":
        need_parquet()
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

    table = columns(list(rows.outcomes()), found.plan, found.metrics)
    name = table_name(table_format)
    shares = yields(table, found.plan.keys) if found.plan.random else {}
    plan = found.describe()
    with staged(out) as work:
        WRITERS[table_format](table, work / name)
        write_sweep(work / PAGE, found.scene, table, found.units, found.plan.random, plan, shares)
    return {
        "scene": found.scene.name,
        "points": found.plan.size,
        "failed": rows.failed,
        "table": str((out / name).absolute()),
        "directory": str(out.absolute()),
        "runs": found.runs,
        "yield": shares,
        "files": [name, PAGE],
    }
