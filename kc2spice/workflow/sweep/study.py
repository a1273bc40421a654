"""What is asked of a sweep, checked and planned; it can be written down and read back."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import read_bounded, text_of
from kc2spice.core.toml import MAX_BYTES, parse_toml
from kc2spice.core.words import did_you_mean
from kc2spice.scene.hash import scene_hash
from kc2spice.scene.keys import Key, keys_of
from kc2spice.scene.model import Scene
from kc2spice.workflow.sweep.plan import (
    PARAMETER,
    Grid,
    Plan,
    deck_keys,
    find_key,
    first_value,
    make_plan,
    number,
    overrides,
    parse,
)
from kc2spice.workflow.sweep.point import (
    BRANCHES,
    Job,
    LoadedScene,
    SceneText,
    Source,
    scalar_metrics,
    scene_files,
    scene_text,
    task,
    testbench,
    with_parameters,
)
from kc2spice.workflow.sweep.table import FORMATS

PLAN = "plan.json"
SHARDS = "shards"
MAX_PLAN = 100_000_000  # bytes
_COUNTED = 400  # combinations of keys whose models are told apart one by one
_STUDY: dict[str, type | tuple[type, ...]] = {
    "title": str, "scene": str, "set": dict, "zip": bool, "latin": bool, "seed": int,
    "metrics": list,
}  # fmt: skip


@dataclass(frozen=True)
class Request:
    """A sweep as it was asked for; equal requests give equal tables."""

    scene: Source
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

    ``keys`` are those that the scene may have, ``kinds`` the types of the table's columns.
    """

    request: Request
    base: Scene
    job: Job
    plan: Plan
    keys: Mapping[str, Key]
    kinds: dict[str, type]

    @property
    def header(self) -> list[str]:
        """Columns of the table in order."""
        return [*self.plan.keys, *self.job.metrics, "status"]

    @property
    def units(self) -> dict[str, str]:
        """SI units of the swept keys."""
        return {name: find_key(name, self.keys).unit or "" for name in self.plan.keys}

    @cached_property
    def stages(self) -> Stages:
        """Which models the points share."""
        return stages(self.plan, self.job)

    @cached_property
    def digest(self) -> str:
        """Hash of everything that decides the table."""
        files = {n: hashlib.sha256(data).hexdigest() for n, data in scene_files(self.base).items()}
        context = [
            scene_hash(self.base), files, self.job.parameters, self.job.metrics,
            self.base.checks.model_dump(), self.base.solver.retries, self.request.format,
        ]  # fmt: skip
        return self.plan.digest(context)

    def describe(self) -> str:
        """How many runs of which kind there will be, in one line."""
        runs = self.stages.runs
        parts = ", ".join(f"{count} {part}" for part, count in runs["fe"].items())
        models = f"{sum(runs['fe'].values())} models ({parts}), " if parts else ""
        return (
            f"{self.plan.size} points: {models}{sum(runs['rom'].values())} reductions, "
            f"{runs['netlists']} netlists, {runs['ngspice']} ngspice runs"
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
    firsts = {text: first_value(text) for text in request.sets}
    plain = [text for text, first in firsts.items() if first is None]
    fixed = tuple(text for text in plain if not text.startswith(PARAMETER))
    base = request.scene.load(fixed)
    # A range may make a part that the scene does not have without it.
    swept = [first for first in firsts.values() if first and not first.startswith(PARAMETER)]
    keys = keys_of(base) | keys_of(_at_first(request.scene, fixed, swept, keys_of(base)))
    ranges = [parse(text, keys) for text, first in firsts.items() if first is not None]
    fixed_parameters = tuple(
        (name.strip().removeprefix(PARAMETER), number(f"--set {text!r}", find_key(name.strip(), {}),
                                                      value.strip()))
        for text in plain if text.startswith(PARAMETER)
        for name, _, value in [text.partition("=")]
    )  # fmt: skip
    plan = make_plan(ranges, zipped=request.zipped, latin=request.latin, seed=request.seed)
    job = Job(request.scene, fixed, fixed_parameters, (), request.timeout)
    return study_of(request, base, job, plan, keys)


def study_of(request: Request, base: Scene, job: Job, plan: Plan, keys: Mapping[str, Key]) -> Study:
    """The study of ``plan``; raises as :func:`make_study` does."""
    available = scalar_metrics(job.load(overrides(plan.keys, plan.values(0))))
    wanted = tuple(dict.fromkeys(request.metrics)) or tuple(available)
    _check_metrics(wanted, available, base)
    kinds = {key: str if _worded(plan, key) else type(plan.column(key)[0]) for key in plan.keys}
    kinds |= {name: available.get(name, float) for name in wanted} | {"status": str}
    study = Study(request, base, replace(job, metrics=wanted), plan, keys, kinds)
    _ = study.stages  # tries the ends of all ranges
    return study


def study_in_memory(scene: Scene, grids: Sequence[Grid]) -> Study:
    """The study of a loaded scene over the product of ``grids``, for the Python interface.

    Raises as :func:`make_study` does.
    """
    source, plan = LoadedScene(scene), make_plan(grids)
    return study_of(Request(source, ()), scene, Job(source, (), (), (), None), plan, {})


def _at_first(
    source: Source, fixed: Sequence[str], swept: Sequence[str], keys: Mapping[str, Key]
) -> Scene:
    """The scene with the first value of every swept key that it does not have by itself.

    Raises
    ------
    UsageError : an unknown key, named with the nearest one of the scene.
    """
    more = [text for text in swept if text.partition("=")[0].strip() not in keys]
    try:
        return source.load((*fixed, *more))
    except UsageError:
        for text in more:
            name = text.partition("=")[0].strip()
            if near := did_you_mean(name, keys):
                raise UsageError("unknown key", where="--set", got=name, hint=near) from None
        raise


def _check_metrics(wanted: Sequence[str], available: Mapping[str, type], scene: Scene) -> None:
    for name in wanted:
        if name not in available and not name.startswith(BRANCHES):
            raise UsageError(
                "this scene has no such metric", where="--metric", got=name,
                expected=", ".join((*available, *(f"{branch}…" for branch in BRANCHES))),
                hint=did_you_mean(name, available),
            )  # fmt: skip
    if not wanted:
        raise UsageError(
            "nothing to tabulate: every metric is a curve", where="--metric", got=scene.name,
            expected="a scene with metrics that are numbers, or with [probes]",
            hint="'kc2spice run' writes the curve of one point; --set works there too",
        )  # fmt: skip


def check_parameters(study: Study) -> None:
    """Raise UsageError if the deck has not a subcircuit parameter, or not at all swept values.

    Builds the models of the first point.
    """
    first = task(study.plan, 0)
    values = list(study.job.parameters)
    for key in study.plan.keys:
        if key.startswith(PARAMETER):
            values += [(key.removeprefix(PARAMETER), float(v)) for v in _extremes(study.plan, key)]
    if values:
        with_parameters(testbench(study.job, first.overrides)[1], values)


# --- studies in files ---------------------------------------------------------------------------


def studies() -> dict[str, Traversable]:
    """Built-in studies by name."""
    folder = resources.files("kc2spice") / "studies"
    found = {item.name.removesuffix(".toml"): item for item in folder.iterdir()}
    return {name: found[name] for name in sorted(found) if found[name].name.endswith(".toml")}


def request_of(name: str, **asked: Any) -> Request:
    """The request for a scene, or for a study with what is ``asked`` on top of it.

    ``asked`` are fields of :class:`Request`; ``sets`` replace the study's range of the same key.

    Raises
    ------
    UsageError : neither a scene nor a study, or a study with a mistake in it.
    """
    study = _definition(name)
    if study is None:
        return Request(scene_text(name), **{"sets": (), **asked})
    ranges = {
        key: f"{key}={value if isinstance(value, str) else repr(value)}"
        for key, value in study.get("set", {}).items()
    }
    ranges |= {text.partition("=")[0].strip(): text for text in asked.pop("sets", ())}
    own = {"zipped": study.get("zip", False), "latin": study.get("latin", False),
           "seed": study.get("seed", 0), "metrics": tuple(study.get("metrics", ()))}  # fmt: skip
    chosen = own | {key: value for key, value in asked.items() if value or key not in own}
    return Request(scene_text(study["scene"]), tuple(ranges.values()), **chosen)


def _definition(name: str) -> Mapping[str, Any] | None:
    """Content of the study ``name``, built in or a file with a key ``scene``; None for a scene."""
    builtin = studies()
    try:
        if name in builtin:
            text = builtin[name].read_text(encoding="utf-8")
        else:
            text = text_of(read_bounded(Path(name), MAX_BYTES))
        content = parse_toml(text)
    except (OSError, ValueError):
        return None  # whoever loads it as a scene says what is wrong with it
    if not isinstance(content.get("scene", {}), str):
        return None
    for key, value in content.items():
        kind = _STUDY.get(key)
        if kind is None or not isinstance(value, kind):
            raise UsageError(
                "not a key of a study" if kind is None else "of the wrong type",
                where=f"{name}, key {key}", got=repr(value), expected=", ".join(_STUDY),
                hint=did_you_mean(key, _STUDY) if kind is None else None,
            )  # fmt: skip
    return content


# --- what points share --------------------------------------------------------------------------


@dataclass(frozen=True)
class Stages:
    """Swept ``keys`` that cost models, those of the finite elements first, and what there is to do.

    ``first`` are points that need a model which no point before them needs. ``runs`` counts ``fe``
    and ``rom`` by part, ``netlists`` and ``ngspice``; a model that several parts share counts for
    the first of them.
    """

    keys: tuple[str, ...]
    first: tuple[int, ...]
    runs: dict[str, Any]


def stages(plan: Plan, job: Job) -> Stages:
    """Try every key at its extremes and see which models then differ.

    Where that leaves few combinations, their models are counted exactly.

    Raises
    ------
    UsageError : the scene is wrong at the first point, or at an end of one of the ranges.
    """
    start = list(plan.values(0))
    tried = [("", job.load(overrides(plan.keys, start)))]
    for key in deck_keys(plan.keys):
        for other in _extremes(plan, key):
            values = list(start)
            values[plan.keys.index(key)] = other
            tried.append((key, job.load(overrides(plan.keys, values))))
    reached: list[dict[str, None]] = [{}, {}]  # by the full models, by the final ones
    known: tuple[set[str], set[str]] = (set(), set())
    first: list[int] = []
    fe, rom = {}, {}
    for name, part in tried[0][1].parts.items():
        (_, base), *others = ((key, _texts(name, scene)) for key, scene in tried)
        if base is None:
            continue
        differ = [
            tuple(dict.fromkeys(k for k, text in others if text is None or text[i] != base[i]))
            for i in (0, 1)
        ]
        for keys, level in zip(differ, reached, strict=True):
            level.update(dict.fromkeys(keys))
        every = tuple(dict.fromkeys((*differ[0], *differ[1])))
        if plan.distinct(every) > _COUNTED:
            fe[name], models = plan.distinct(differ[0]), plan.distinct(every)
        else:
            before = tuple(map(len, known))
            first += _new_models(plan, job, name, every, known)
            fe[name], models = (len(now) - then for now, then in zip(known, before, strict=True))
        if part.type.reduced:
            rom[name] = models
    fe, rom = ({name: n for name, n in counts.items() if n} for counts in (fe, rom))
    runs = {"fe": fe, "rom": rom, "netlists": plan.distinct(deck_keys(plan.keys)),
            "ngspice": plan.size}  # fmt: skip
    return Stages(tuple(reached[0] | reached[1]), tuple(dict.fromkeys(first)), runs)


def _new_models(
    plan: Plan, job: Job, name: str, keys: Sequence[str], known: tuple[set[str], set[str]]
) -> Iterator[int]:
    """Points at which the part needs a full or final model that is not among the ``known`` yet."""
    for index in plan.representatives(keys):
        with contextlib.suppress(UsageError):  # its row will say what is wrong
            texts = _texts(name, job.load(task(plan, index).overrides))
            if texts is not None and texts[1] not in known[1]:
                for text, level in zip(texts, known, strict=True):
                    level.add(text)
                yield index


def _texts(name: str, scene: Scene) -> tuple[str, str] | None:
    """What the full and the final model of a part depend on, None where it has none."""
    part = scene.parts.get(name)
    key = None if part is None else part.type.model_key(part, scene)
    if part is None or key is None:
        return None
    keys = (part.type.full_key(part, scene), key)
    first, last = (json.dumps(k, sort_keys=True, default=str) for k in keys)
    return f"{part.type.name} {first}", f"{part.type.name} {last}"


def _extremes(plan: Plan, key: str) -> Sequence[Any]:
    """Smallest and largest value of a number, all of words."""
    column = plan.column(key)
    return list(dict.fromkeys(column if _worded(plan, key) else (min(column), max(column))))


def _worded(plan: Plan, key: str) -> bool:
    return any(isinstance(value, str) for value in plan.column(key))


# --- on disk ------------------------------------------------------------------------------------


class _Plan(BaseModel):
    """What ``plan.json`` holds: the request, and the hash by which a sweep knows its own table."""

    model_config = ConfigDict(
        extra="forbid", strict=True, ser_json_bytes="base64", val_json_bytes="base64"
    )

    digest: str
    points: int
    scene: SceneText
    sets: tuple[str, ...]
    zipped: bool
    latin: bool
    seed: Annotated[int, Field(ge=0)]
    metrics: tuple[str, ...]
    timeout: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None
    format: str


def write_plan(study: Study, directory: Path, digest: str) -> None:
    """Write ``plan.json`` of ``study``, which then goes by ``digest``."""
    asked = {field.name: getattr(study.request, field.name) for field in fields(study.request)}
    content = _Plan(digest=digest, points=study.plan.size, **asked)
    partial = directory / f"{PLAN}.part"
    partial.write_text(content.model_dump_json(indent=2) + "\n", encoding="utf-8")
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
        found = _Plan.model_validate_json(read_bounded(path, MAX_PLAN))
    except FileNotFoundError:
        raise UsageError("holds no sweep", where=str(directory), expected=f"a {PLAN}") from None
    except (UsageError, OSError, ValueError) as error:
        raise UsageError("not the plan of a sweep", where=str(path), got=str(error)[:200]) from None
    asked = {field.name: getattr(found, field.name) for field in fields(Request)}
    return Request(**asked), found.digest


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
