"""Tune keys of a scene: scipy's optimiser around the deck, every evaluation a recorded run."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution, minimize

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.progress import Progress, silent
from kc2spice.scene.keys import Key
from kc2spice.workflow.sweep.plan import find_key, number
from kc2spice.workflow.sweep.point import Outcome, Task, run_point, task
from kc2spice.workflow.sweep.pool import Call, Engine, WorkerDied, WorkerPool
from kc2spice.workflow.sweep.run import ROWS, acquire
from kc2spice.workflow.sweep.study import Study
from kc2spice.workflow.sweep.table import MISSING, RowStore

MISSED = 3.0  # ratio of a run that has no such metric: it was not caught, or it failed
MEAN = 0.1  # weight of the mean ratio beside the worst one
CANDIDATES = 16  # of one generation
_LIMIT = r"([^<>=]+)(<=|>=)([^<>=]+)"
SIMPLEX = 0.05  # first edge of the final search, a share of each value
REFINEMENTS = 60  # candidates of the final search
TABLE = "tuned.csv"


@dataclass(frozen=True)
class Bound:
    """A key to tune between two positive values; the search is logarithmic."""

    key: str
    low: float
    high: float


@dataclass(frozen=True)
class Limit:
    """A metric that must be at most (``<=``) or at least (``>=``) ``value``, in SI."""

    metric: str
    sign: str
    value: float

    def holds(self, value: float | bool | None) -> bool:
        """Whether a run keeps it; one without the metric does not."""
        if value is None:
            return False
        return value <= self.value if self.sign == "<=" else value >= self.value

    def __str__(self) -> str:
        return f"{self.metric}{self.sign}{self.value:g}"


@dataclass(frozen=True)
class Tuned:
    """The best values found, with the metric (conditions,) before and after, and the runs made."""

    best: dict[str, float]
    before: np.ndarray
    after: np.ndarray
    runs: int


def bound(text: str, keys: Mapping[str, Key]) -> Bound:
    """``KEY=a:b`` of ``--tune``, KEY one of the scene's ``keys``.

    Raises
    ------
    UsageError : anything else, or bounds that are not positive and in order.
    """
    name, _, span = (part.strip() for part in text.partition("="))
    ends = span.split(":")
    if len(ends) != 2:
        raise UsageError("not bounds", where=f"--tune {text!r}", got=span, expected="KEY=a:b")
    key = find_key(name, keys)
    low, high = (number(f"--tune {text!r}", key, end.strip()) for end in ends)
    if not 0 < low < high:
        raise UsageError("no range to search", where=f"--tune {text!r}", got=f"{low:g} … {high:g}",
                         expected="0 < a < b")  # fmt: skip
    return Bound(name, low, high)


def limit(text: str) -> Limit:
    """``METRIC<=X`` or ``METRIC>=X`` of ``--require``.

    Raises
    ------
    UsageError : anything else.
    """
    found = re.fullmatch(_LIMIT, text, re.DOTALL)
    name, sign, value = (part.strip() for part in found.groups()) if found else ("", "", "")
    try:
        return Limit(name, sign, float(value))
    except ValueError:
        raise UsageError("not a constraint", where="--require", got=text,
                         expected="METRIC<=X or METRIC>=X, in SI") from None  # fmt: skip


def run_tuning(
    study: Study, bounds: Sequence[Bound], metric: str, generations: int, out: Path,
    engine: Engine, progress: Progress = silent, *, limits: Sequence[Limit] = (),
) -> dict[str, Any]:  # fmt: skip
    """Tune ``bounds`` for the least ``metric`` over the points of ``study``; write into ``out``.

    ``tuned.csv`` has a row for each condition: the metric of the scene as it is and of the tuned
    one.

    Raises
    ------
    UsageError : nothing to tune, an unknown metric, ``out`` holds something else.
    """
    for name, option in ((metric, "--minimise"), *((each.metric, "--require") for each in limits)):
        if name not in study.job.metrics:
            raise UsageError("this scene has no such metric", where=option, got=name,
                             expected=", ".join(study.job.metrics))  # fmt: skip
    swept = [b.key for b in bounds if b.key in study.plan.keys]
    if swept or not bounds:
        raise UsageError("cannot be tuned", where="--tune", got=", ".join(swept) or None,
                         expected="keys that --set does not sweep")  # fmt: skip
    acquire(study, out, [*map(asdict, bounds), metric, generations, *map(str, limits)])
    tuned = tune(study, bounds, metric, generations, out, engine, progress, limits=limits)
    with (out / TABLE).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*study.plan.keys, metric, f"{metric} tuned"])
        for index, row in enumerate(zip(tuned.before, tuned.after, strict=True)):
            writer.writerow([*study.plan.values(index), *(repr(float(value)) for value in row)])
    ratio = tuned.after / tuned.before
    return {
        "scene": study.base.name,
        "points": tuned.runs,
        "failed": int(np.isnan(tuned.after).sum()),
        "resumed": 0,
        "table": str((out / TABLE).absolute()),
        "directory": str(out.absolute()),
        "best": tuned.best,
        "mean_ratio": float(ratio.mean()),
        "worst_ratio": float(ratio.max()),
        "files": [TABLE, *_figure(study, tuned, metric, out)],
    }


def _figure(study: Study, tuned: Tuned, metric: str, out: Path) -> list[str]:
    from kc2spice.report.sweep_figures import tuning_figure

    first = [study.plan.values(index)[0] for index in range(study.plan.size)]
    if any(isinstance(value, str) for value in first):
        return []
    key = study.plan.keys[0]
    picture = tuning_figure(
        out / "tuned.png", key, study.units[key], np.array(first, dtype=float), metric,
        np.vstack([tuned.before, tuned.after]), tuned.best,
    )  # fmt: skip
    return [picture.path.name]


def tune(
    study: Study, bounds: Sequence[Bound], metric: str, generations: int, directory: Path,
    engine: Engine, progress: Progress = silent, *, limits: Sequence[Limit] = (),
) -> Tuned:  # fmt: skip
    """Minimise ``metric`` over all points of ``study``, its conditions, the worst of them first.

    A candidate that breaks one of the ``limits`` under a condition counts as one without the metric
    there. With the metric's ratio r_k to that of the scene as it is, the cost of a candidate is::

        max_k r_k + MEAN mean_k r_k

    Differential evolution (Storn and Price 1997) with the study's seed, then the simplex of Nelder
    and Mead (1965): a search that was killed takes its recorded runs from ``directory`` and goes
    on.

    Raises
    ------
    SimulationError : the scene as it is has no such metric under one of the conditions.
    """
    conditions = [task(study.plan, index) for index in range(study.plan.size)]
    directory.mkdir(parents=True, exist_ok=True)
    runs = _Runs(study, bounds, metric, conditions, directory / ROWS, engine, limits)
    try:
        before = runs.evaluate([{}])[0]
        if not np.isfinite(before).all():
            got = f"at {np.isnan(before).sum()} of {before.size} conditions"
            raise SimulationError("the scene as it is has no such metric", where=metric, got=got)

        def cost(logs: np.ndarray) -> np.ndarray:
            found = np.array(runs.evaluate([_values(bounds, x) for x in logs.T]))
            ratio = np.where(np.isfinite(found), found / before, MISSED)
            return ratio.max(axis=1) + MEAN * ratio.mean(axis=1)

        def tell(best: np.ndarray, convergence: float) -> None:
            text = ", ".join(f"{key} = {value:g}" for key, value in _values(bounds, best).items())
            progress("tune", min(convergence, 1.0), f"{runs.count} runs, best {text}")

        found = differential_evolution(
            cost, [(np.log(b.low), np.log(b.high)) for b in bounds], vectorized=True,
            updating="deferred", popsize=max(2, CANDIDATES // len(bounds)), maxiter=generations,
            seed=study.request.seed, polish=False, tol=1e-3, callback=tell,
        )  # fmt: skip
        # The best region is a narrow valley between the gains: a simplex follows it to its end.
        spread = [tuple(found.x), *(tuple(found.x + SIMPLEX * e) for e in np.eye(len(bounds)))]
        refined = minimize(
            lambda x: float(cost(x[:, None])[0]), found.x, method="Nelder-Mead",
            options={"maxfev": REFINEMENTS, "initial_simplex": spread},
        )  # fmt: skip
        best = _values(bounds, refined.x)
        return Tuned(best, before, runs.evaluate([best])[0], runs.count)
    finally:
        runs.close()


def _values(bounds: Sequence[Bound], logs: np.ndarray) -> dict[str, float]:
    return {b.key: float(f"{np.exp(x):.5g}") for b, x in zip(bounds, logs, strict=True)}


class _Runs:
    """Evaluations by number: recorded ones are read, the others run and are recorded."""

    def __init__(
        self, study: Study, bounds: Sequence[Bound], metric: str, conditions: Sequence[Task],
        path: Path, engine: Engine, limits: Sequence[Limit] = (),
    ) -> None:  # fmt: skip
        self.count = 0
        self._study, self._conditions, self._engine = study, conditions, engine
        self._keys = [b.key for b in bounds]
        self._column = study.job.metrics.index(metric)
        self._limits = {study.job.metrics.index(each.metric): each for each in limits}
        self._known: dict[tuple[str, ...], float] = {}
        self._store = RowStore(path, 10_000_000)
        self._pool: WorkerPool | None = None
        self._rows = int((self._store.state != MISSING).sum())
        for *name, value, _ in self._store.rows():
            self._known[tuple(name)] = float(value or "nan")

    def evaluate(self, candidates: Sequence[Mapping[str, float]]) -> list[np.ndarray]:
        """The metric (conditions,) of each candidate, nan where it has none."""
        wanted = {
            (c, k): self._name(candidate, condition)
            for c, candidate in enumerate(candidates)
            for k, condition in enumerate(self._conditions)
        }
        missing = {name: place for place, name in wanted.items() if name not in self._known}
        if missing:
            self._pool = self._pool or WorkerPool(self._engine)
            for call, result in self._pool.run(self._calls(candidates, missing)):
                self._record(call.name, result)
        self.count += len(wanted)
        found = np.array([self._known[name] for name in wanted.values()])
        return list(found.reshape(len(candidates), -1))

    def close(self) -> None:
        """End the workers and let go of the rows."""
        self._engine.close()
        self._store.close()

    def _name(self, candidate: Mapping[str, float], condition: Task) -> tuple[str, ...]:
        values = [repr(candidate[key]) if candidate else "" for key in self._keys]
        return (*values, *(repr(value) for value in self._study.plan.values(condition.index)))

    def _calls(
        self, candidates: Sequence[Mapping[str, float]], missing: Mapping[tuple[str, ...], Any]
    ) -> Iterator[Call]:
        for name, (c, k) in missing.items():
            condition = self._conditions[k]
            changed = tuple(f"{key}={value!r}" for key, value in candidates[c].items())
            overrides = (*condition.overrides, *changed)
            point = Task(condition.index, overrides, condition.parameters)
            yield Call(name, run_point, (self._study.job, point))

    def _record(self, name: tuple[str, ...], result: Outcome | WorkerDied) -> None:
        if isinstance(result, WorkerDied) or result.interrupted:
            self._known[name] = float("nan")  # not recorded: a later search runs it again
            return
        broken = [
            str(each) for column, each in self._limits.items()
            if any(name[: len(self._keys)])  # the scene as it is is what it is
            and not result.failure and not each.holds(result.values[column])
        ]  # fmt: skip
        failure = f"not {', '.join(broken)}" if broken else result.failure
        value = None if failure else result.values[self._column]
        self._known[name] = float("nan") if value is None else float(value)
        self._store.record(self._rows, (*name, value), failure)
        self._rows += 1
