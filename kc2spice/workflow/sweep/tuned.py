"""A tuning from request to result: search, proof by the scipy reference, table and figure."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.progress import Progress, silent
from kc2spice.scene.keys import scene_keys
from kc2spice.workflow.sweep.engines import Call, Engine, completed
from kc2spice.workflow.sweep.point import Outcome, Task, run_reference
from kc2spice.workflow.sweep.run import acquire
from kc2spice.workflow.sweep.stages import task
from kc2spice.workflow.sweep.study import Study
from kc2spice.workflow.sweep.tune import Bound, Limit, Tuned, tune

TABLE = "tuned.csv"


def run_tuning(
    study: Study, bounds: Sequence[Bound], metric: str, generations: int, out: Path,
    engine: Engine, progress: Progress = silent, *, limits: Sequence[Limit] = (),
) -> dict[str, Any]:  # fmt: skip
    """Tune ``bounds`` for the least ``metric`` over the points of ``study``; write into ``out``.

    ``tuned.csv`` has a row for each condition: the metric of the scene as it is and of the tuned
    one, by ngspice and by the independent integration in scipy.

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
    proof = _proof(study, tuned, metric, engine, progress)
    _write(study, tuned, proof, metric, out / TABLE)
    files = [TABLE, *_figure(study, tuned, proof, metric, out)]
    ratio, proven = tuned.after / tuned.before, proof[1] / proof[0]
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
        "reference_mean_ratio": float(proven.mean()),
        "reference_worst_ratio": float(proven.max()),
        "files": files,
    }


def _proof(
    study: Study, tuned: Tuned, metric: str, engine: Engine, progress: Progress
) -> np.ndarray:
    """The metric by the reference (2, conditions): as the scene is, and tuned."""
    changes = ((), tuple(f"{key}={value!r}" for key, value in tuned.best.items()))

    def calls() -> Iterator[Call]:
        for row, changed in enumerate(changes):
            for index in range(study.plan.size):
                condition = task(study.plan, index)
                point = Task(index, (*condition.overrides, *changed), condition.parameters)
                yield Call((row, index), run_reference, (study.job, point))

    found = np.full((2, study.plan.size), np.nan)
    column = study.job.metrics.index(metric)
    for done, (call, result) in enumerate(completed(engine, calls()), start=1):
        if isinstance(result, Outcome) and result.values and result.values[column] is not None:
            found[call.name] = result.values[column]
        progress("reference", done / found.size, f"{done} of {found.size} runs in scipy")
    return found


def _write(study: Study, tuned: Tuned, proof: np.ndarray, metric: str, path: Path) -> None:
    head = [*study.plan.keys, metric, f"{metric} tuned", f"{metric} scipy",
            f"{metric} tuned scipy"]  # fmt: skip
    rows = zip(tuned.before, tuned.after, *proof, strict=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(head)
        for index, row in enumerate(rows):
            writer.writerow([*study.plan.values(index), *(repr(float(value)) for value in row)])


def _figure(study: Study, tuned: Tuned, proof: np.ndarray, metric: str, out: Path) -> list[str]:
    from kc2spice.report.sweep_figures import tuning_figure

    first = [study.plan.values(index)[0] for index in range(study.plan.size)]
    if any(isinstance(value, str) for value in first):
        return []
    picture = tuning_figure(
        out / "tuned.png", study.plan.keys[0], np.array(first, dtype=float), metric,
        np.vstack([tuned.before, tuned.after, proof]), tuned.best,
        {key.name: key.unit or "" for key in scene_keys()},
    )  # fmt: skip
    return [picture.path.name]
