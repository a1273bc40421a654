"""What is asked of a sweep, checked and planned; it can be written down and read back."""

from __future__ import annotations

import contextlib
import json
import math
import os
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import read_bounded, text_of
from kc2spice.scene.hash import scene_hash
from kc2spice.scene.keys import did_you_mean
from kc2spice.scene.schema import Scene
from kc2spice.spice.included import included_netlists
from kc2spice.workflow.sweep.parameters import with_parameters
from kc2spice.workflow.sweep.plan import Plan, make_plan
from kc2spice.workflow.sweep.point import BRANCHES, Job, scalar_metrics, testbench
from kc2spice.workflow.sweep.ranges import PARAMETER, parameter, parse
from kc2spice.workflow.sweep.source import SceneText
from kc2spice.workflow.sweep.stages import Stages, stages
from kc2spice.workflow.sweep.table import FORMATS

PLAN = "plan.json"
SHARDS = "shards"
MAX_PLAN = 100_000_000  # bytes


@dataclass(frozen=True)
class Request:
    """A sweep as it was asked for; equal requests give equal tables."""

    scene: SceneText
    sets: tuple[str, ...]
    zipped: bool = False
    latin: bool = False
    seed: int = 0
    metrics: tuple[str, ...] = ()
    timeout: float | None = None
    format: str = "csv"


@dataclass(frozen=True)
class Study:
    """A request that was found good: job of the workers, points, and what they share.

    ``kinds`` are the types of the table's columns.
    """

    request: Request
    base: Scene
    job: Job
    plan: Plan
    kinds: dict[str, type]

    @property
    def header(self) -> list[str]:
        """Columns of the table in order."""
        return [*self.plan.keys, *self.job.metrics, "status"]

    @cached_property
    def stages(self) -> Stages:
        """Which models the points share."""
        return stages(self.plan, self.job)

    @cached_property
    def digest(self) -> str:
        """Hash of everything that decides the table."""
        context = [
            scene_hash(self.base), included_netlists(self.base), self.job.parameters,
            self.job.metrics, self.base.checks.model_dump(), self.base.solver.retries,
            self.request.format,
        ]  # fmt: skip
        return self.plan.digest(context)

    def describe(self) -> str:
        """How many runs of which kind there will be, in one line."""
        runs = self.stages.runs
        models = runs["chip_fe"] + runs["catch_fe"]
        return (
            f"{self.plan.size} points: {models} FE runs ({runs['chip_fe']} chip, "
            f"{runs['catch_fe']} catch), {runs['rom']} ROM, {runs['netlists']} netlists, "
            f"{runs['ngspice']} ngspice runs"
        )


def make_study(request: Request) -> Study:
    """Check ``request`` as far as that goes without building a model.

    Raises
    ------
    UsageError : a bad range, an unknown key or metric, a value that the scene does not take.
    """
    if request.format not in FORMATS:
        raise UsageError("no such format", where="--format", got=request.format,
                         expected=" or ".join(FORMATS))  # fmt: skip
    parsed = {text: parse(text) for text in request.sets}
    ranges = [found for found in parsed.values() if found is not None]
    plain = [text for text, found in parsed.items() if found is None]
    fixed = tuple(text for text in plain if not text.startswith(PARAMETER))
    parts = tuple(parameter(text) for text in plain if text.startswith(PARAMETER))
    plan = make_plan(ranges, zipped=request.zipped, latin=request.latin, seed=request.seed)
    base = request.scene.load(fixed)
    available = scalar_metrics(base)
    wanted = tuple(dict.fromkeys(request.metrics)) or tuple(available)
    for name in wanted:
        if name not in available and not name.startswith(BRANCHES):
            raise UsageError(
                "this scene has no such metric", where="--metric", got=name,
                expected=", ".join((*available, *(f"{branch}…" for branch in BRANCHES))),
                hint=did_you_mean(name, available),
            )  # fmt: skip
    if not wanted:
        raise UsageError(
            "nothing to tabulate: every metric is a curve", where="--metric",
            got=f"experiment {base.experiment!r}", expected="loop, impact, imprint or em_force",
            hint="'kc2spice run' writes the curve of one point; --set works there too",
        )  # fmt: skip
    job = Job(request.scene, fixed, parts, wanted, request.timeout)
    kinds = {key: type(plan.values(0)[i]) for i, key in enumerate(plan.keys)}
    kinds |= {name: available.get(name, float) for name in wanted} | {"status": str}
    study = Study(request, base, job, plan, kinds)
    _ = study.stages  # tries the ends of all ranges
    return study


def check_parameters(study: Study) -> None:
    """Raise UsageError if a swept or fixed subcircuit parameter is not in the deck.

    Builds the models of the first point.
    """
    from kc2spice.workflow.sweep.stages import task

    first = task(study.plan, 0)
    changed = (*study.job.parameters, *first.parameters)
    if changed:
        with_parameters(testbench(study.job, first.overrides)[1], changed)


def write_plan(study: Study, directory: Path, digest: str) -> None:
    """``plan.json``: the request and the hash by which a later sweep knows its own table."""
    content = {"digest": digest, "points": study.plan.size, **asdict(study.request)}
    partial = directory / f"{PLAN}.part"
    partial.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    partial.replace(directory / PLAN)


def read_plan(directory: Path) -> tuple[Request, str]:
    """Request and digest in ``directory``.

    Raises
    ------
    UsageError : there is none, or it is not one of ours.
    """
    path = directory / PLAN
    no_links(directory)
    try:
        content: dict[str, Any] = json.loads(text_of(read_bounded(path, MAX_PLAN)))
        digest, _ = content.pop("digest"), content.pop("points")
        scene = content.pop("scene")
        scene["netlists"] = tuple((name, text) for name, text in scene["netlists"])
        sets, metrics = tuple(content.pop("sets")), tuple(content.pop("metrics"))
        request = Request(SceneText(**scene), sets, metrics=metrics, **content)
        _check_types(request, digest)
        return request, digest
    except FileNotFoundError:
        raise UsageError("holds no sweep", where=str(directory), expected=f"a {PLAN}") from None
    except UsageError as error:
        raise UsageError("not the plan of a sweep", where=str(path), got=str(error)) from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise UsageError("not the plan of a sweep", where=str(path), got=str(error)[:200]) from None


def _check_types(request: Request, digest: Any) -> None:
    """ValueError for a field that holds something else than the command line could have given."""
    words = (digest, request.format, *request.sets, *request.metrics)
    flags = (request.zipped, request.latin)
    limit = request.timeout
    if (
        not all(isinstance(word, str) for word in words)
        or not all(isinstance(flag, bool) for flag in flags)
        or type(request.seed) is not int
        or request.seed < 0
        or not (limit is None or (type(limit) in (int, float) and 0 < limit < math.inf))
    ):
        raise ValueError("a field of the wrong type")


def no_links(directory: Path) -> None:
    """Refuse a sweep's directory in which what is written would land elsewhere.

    Raises
    ------
    UsageError : a link among its files or its shards.
    """
    for folder in (directory, directory / SHARDS):
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            for entry in os.scandir(folder):
                if entry.is_symlink():
                    raise UsageError("is a link, which leads out of the sweep's directory",
                                     where=entry.path, hint="remove it")  # fmt: skip
