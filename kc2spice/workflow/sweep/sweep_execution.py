"""Execution of a sweep: checks, shared models, points, results and table.

Points run in processes of this machine or on the workers of a Dask scheduler. Any other
:class:`concurrent.futures.Executor` is also accepted. The row of each point is stored in a database
when the point ends. All rows are finally written as one sorted table.
"""

from __future__ import annotations

import hashlib
import json
import re
import shlex
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import timedelta
from functools import cached_property, partial
from importlib import resources
from importlib.resources.abc import Traversable
from itertools import chain, islice
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from kc2spice.core import __version__
from kc2spice.core.errors import UsageError, unknown
from kc2spice.core.files import make_write_error, stage_directory
from kc2spice.core.key_errors import OUT_OF_RANGE, UNKNOWN_KEY
from kc2spice.core.optional_libraries import import_optional
from kc2spice.core.progress import Progress, ignore_progress
from kc2spice.core.toml_text import format_toml
from kc2spice.core.units import NUMBER_WITH_UNIT
from kc2spice.core.untrusted_files import MAX_TEXT_BYTES, decode_text, parse_toml, read_bounded
from kc2spice.core.user_warnings import collect_warnings, warn_user
from kc2spice.netlist.scale_factors import read_user_number
from kc2spice.netlist.transforms import with_parameters
from kc2spice.parts.bodies._varied_keys import read_number_key
from kc2spice.scene.keys import KeyDescription, list_scene_keys
from kc2spice.scene.overrides import expand_overrides
from kc2spice.scene.scene_classes import Scene, compute_scene_hash
from kc2spice.scene.scene_file import open_scene
from kc2spice.workflow.sweep.grid import (
    PARAMETER_KEY,
    RANGE_GRAMMAR,
    ProposedRangeError,
    SweepPoints,
    find_swept_key,
    join_range,
    make_plan,
    parse_range,
    scale_quantity,
    split_range,
)
from kc2spice.workflow.sweep.point import (
    PointResult,
    SceneInput,
    SweepSettings,
    build_sweep_point,
    list_subcircuit_parameters,
    read_scene_files,
    read_scene_text,
    resolve_parameters,
    run_point,
)
from kc2spice.workflow.sweep.row_store import (
    RowStore,
    collect_columns,
    require_columns,
    write_csv,
    write_parquet,
)
from kc2spice.workflow.sweep.workers import Workers, is_lost_worker

WRITERS = {"csv": write_csv, "parquet": write_parquet}


ROWS_FILE = "rows.sqlite"
PAGE_FILE = "sweep.html"
_NUMBER = re.compile(r"\d[\d.]*(?:e[-+]?\d+)?")
# largest number of faults of one range that a proposed range corrects
_MAX_CORRECTIONS = 4
LOST_POINT = PointResult(
    failure="its worker process was killed or crashed twice, probably because the memory was full: "
    "free memory, then repeat the sweep with fewer workers",
    interrupted=True,
)


# --- planning --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sweep:
    """Checked sweep: points, settings for the workers, and columns of the table.

    ``scene`` is the scene of the first point, and ``units`` are the units of the swept keys.
    ``metrics`` are the requested metrics. If no metric is requested, the table contains all
    metrics. ``warnings`` are the texts of the warnings that :func:`make_sweep` issued.
    """

    scene: Scene
    job: SweepSettings
    plan: SweepPoints
    units: Mapping[str, str]
    metrics: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @cached_property
    def digest(self) -> str:
        """Return a hash of all inputs that affect the results of the sweep."""
        files = {
            n: hashlib.sha256(data).hexdigest() for n, data in read_scene_files(self.scene).items()
        }
        context = [
            __version__,
            compute_scene_hash(self.scene),
            files,
            self.job.parameters,
            self.plan.keys,
            self.scene.checks.model_dump(),
            self.scene.solver.retries,
        ]
        text = json.dumps(context, sort_keys=True) + repr(self.plan.blocks)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @property
    def run_counts(self) -> dict[str, int]:
        """Number of different decks, and number of ngspice runs."""
        keys = [key for key in self.plan.keys if not PARAMETER_KEY.fullmatch(key)]
        return {"netlists": self.plan.count_distinct(keys), "ngspice": self.plan.size}

    def describe(self) -> str:
        """Return the numbers of points, decks and runs as a one-line text."""
        netlists, runs = self.run_counts.values()
        return f"{self.plan.size} points: {netlists} netlists, {runs} ngspice runs"


def make_sweep(
    scene: SceneInput,
    sets: Sequence[str],
    *,
    zipped: bool = False,
    latin: bool = False,
    seed: int = 0,
    metrics: Sequence[str] = (),
    timeout: float | None = None,
) -> Sweep:
    """Make a sweep from strings ``KEY=RANGE``.

    The sweep is checked as far as possible without building a model.

    Raises
    ------
    UsageError : a range is invalid, a key is unknown, or a value is not allowed.
    """
    make = partial(
        _make_sweep,
        scene,
        zipped=zipped,
        latin=latin,
        seed=seed,
        metrics=metrics,
        timeout=timeout,
    )
    try:
        with collect_warnings() as texts:
            sweep = make(sets)
        for text in texts:
            warn_user(text)
        return replace(sweep, warnings=tuple(texts))
    except ProposedRangeError as error:
        _correct_proposal(error, sets, make)
        raise


def _correct_proposal(
    error: ProposedRangeError, sets: Sequence[str], make: Callable[[Sequence[str]], Sweep]
) -> None:
    """Correct the hint of an error whose proposed range has further faults.

    The further faults are corrected one by one. ``make`` makes the sweep from strings ``KEY=RANGE``
    such as ``sets``.
    """
    ranges = [tuple(part.strip() for part in text.partition("=")) for text in sets]
    matches = [(k, name) for k, (name, _, value) in enumerate(ranges) if value == error.text]
    # several keys may have the same range; an error about its spelling does not name a key
    k, name = next((match for match in matches if _concerns_key(error, match[1])), matches[0])
    texts, proposal = list(sets), error.proposal
    for _ in range(_MAX_CORRECTIONS):
        texts[k] = f"{name}={proposal}"
        try:
            with collect_warnings():
                make(texts)
            return
        except ProposedRangeError as next_error:
            if next_error.text != proposal:
                return  # an error about another range
            error.hint, proposal = next_error.hint, next_error.proposal
        except UsageError as next_error:
            if _concerns_key(next_error, name):
                hint = str(next_error.hint)
                error.hint = hint if proposal in hint else f"{error.hint}; {hint}"
            return


def _make_sweep(
    scene: SceneInput,
    sets: Sequence[str],
    *,
    zipped: bool,
    latin: bool,
    seed: int,
    metrics: Sequence[str],
    timeout: float | None,
) -> Sweep:
    """Make a sweep from strings ``KEY=RANGE``.

    If an error proposes a range, the function does not check whether the proposed range is valid.

    Raises
    ------
    UsageError : a range is invalid, a key is unknown, or a value is not allowed.
    """
    fixed, constants = [], []
    firsts, ranges = dict[str, str](), dict[str, str]()
    for text in sets:
        name, _, value = (part.strip() for part in text.partition("="))
        parameter, (kind, words) = PARAMETER_KEY.fullmatch(name), split_range(value)
        if kind != "value":
            if name in ranges:
                raise UsageError(
                    "this key is swept twice",
                    where="--set",
                    got=name,
                    expected="one --set for each key",
                    hint=f"delete one of the options --set {name}=…",
                )
            ranges[name] = value
            firsts |= {} if parameter else {name: words[0]}
        elif parameter:
            constants.append((parameter[1], read_user_number(value, f"--set {text!r}")))
        else:
            fixed.append(text)
    if sets and not ranges:
        name = sets[0].partition("=")[0].strip()
        raise UsageError(
            "no option --set contains a range, so no key is swept",
            where="sweep",
            got=" ".join(f"--set {shlex.quote(text)}" for text in sets),
            expected=f"--set KEY=RANGE, where RANGE is {RANGE_GRAMMAR}",
            hint=f"write --set {name}=FIRST:LAST:POINTS in place of --set {shlex.quote(sets[0])}",
        )
    # a swept key may also occur in a TOML file of fixed keys
    fixed = [text for text in fixed if text.partition("=")[0].strip() not in ranges]

    def load_first_values(changed: Mapping[str, str]) -> Scene:
        """Load the scene with the first value of each range, except for ``changed`` values."""
        # A swept key can create a part that the unchanged scene does not contain.
        return scene.load((*fixed, *(f"{k}={word}" for k, word in {**firsts, **changed}.items())))

    with (
        _propose_accepted_range(ranges, load_first_values),
        _name_range_in_errors(ranges, at_first_value=True),
    ):
        first = load_first_values({})
        keys = list_scene_keys(first)
        keys |= _describe_entries_of_tables(first, keys, ranges)
    parsed = {name: parse_range(name, value, keys) for name, value in ranges.items()}
    plan = make_plan(parsed, zipped=zipped, latin=latin, seed=seed)
    units = {key: find_swept_key(key, keys).unit or "" for key in plan.keys}
    job = SweepSettings(scene, tuple(fixed), tuple(constants), timeout)
    with (
        _propose_accepted_range(ranges, load_first_values),
        _name_range_in_errors(ranges),
    ):
        return make_sweep_of_points(job, plan, units, tuple(dict.fromkeys(metrics)))


def _describe_entries_of_tables(
    scene: Scene, keys: Mapping[str, KeyDescription], names: Iterable[str]
) -> dict[str, KeyDescription]:
    """Describe the swept entries of tables whose keys the user chooses.

    Examples are the constants of a material, and the parameters of a user's netlist. ``names`` are
    the names of all swept keys, and ``keys`` are the keys with a description. The result is keyed
    by names without indices.
    """
    result = {}
    for name in names:
        plain = re.sub(r"\[-?\d+\]", "", name)
        if plain in keys:
            continue
        for part in scene.parts.values():
            if not name.startswith(f"{part.key_prefix}."):
                continue
            with suppress(UsageError):  # the part has no numeric key of this name
                key = name.removeprefix(f"{part.key_prefix}.")
                unit = read_number_key(part, key, name)[1]
                of_netlist = part.is_user_netlist and key.startswith("parameters.")
                result[plain] = KeyDescription(plain, unit, None, (), "", of_netlist=of_netlist)
    return result


@contextmanager
def _name_range_in_errors(
    ranges: Mapping[str, str], at_first_value: bool = False
) -> Iterator[None]:
    """In errors about values outside of a key's limits, state the user's range.

    ``ranges`` are the ranges by key. With ``at_first_value``, each swept key has the first value of
    its range. The first value of a normal distribution is its mean.
    """
    try:
        yield
    except UsageError as error:
        for name, text in ranges.items():
            kind, words = split_range(text)
            if at_first_value:
                error.hint = _write_full_range(error.hint, name, words[0], text)
            if not _concerns_key(error, name):
                continue
            too_wide = kind == "normal" and not at_first_value
            if too_wide:
                error.hint = _advise_normal_range(words)
            elif error.message == OUT_OF_RANGE and at_first_value:
                error.hint = f"write a value {error.expected} in place of {words[0]}"
            elif error.message == OUT_OF_RANGE:
                error.hint = f"write a range of values {error.expected}"
            if too_wide or error.message in (OUT_OF_RANGE, UNKNOWN_KEY):
                error.where = f"--set '{name}={text}'"
        raise


def _write_full_range(hint: str | None, name: str, first: str, text: str) -> str | None:
    """Write the full range of a swept key in a hint, in place of its first value.

    >>> _write_full_range("change --set 'gap=1 mm'", "gap", "1 mm", "1 mm:2 mm:5")
    "change --set 'gap=1 mm:2 mm:5'"
    """
    option = rf"--set '?([\w.\[\]]*{re.escape(f'{name}={first}')})(?:'|(?=\s|,|$))"
    for item in re.finditer(option, hint or ""):
        quoted = shlex.quote(item[1].replace(f"{name}={first}", f"{name}={text}"))
        hint = str(hint).replace(item[0], f"--set {quoted}", 1)
    return hint


@contextmanager
def _propose_accepted_range(
    ranges: Mapping[str, str], load: Callable[[Mapping[str, str]], object]
) -> Iterator[None]:
    """Propose a range of accepted values if a key rejects the sign of values in its range.

    ``ranges`` are the ranges by key. ``load`` loads the scene with changed values of keys.
    """
    try:
        yield
    except UsageError as error:
        for name, text in ranges.items():
            if not _concerns_key(error, name):
                continue

            def is_accepted(word: str, name: str = name) -> bool:
                """Return whether the scene loads without an error about this value of the key."""
                try:
                    with collect_warnings():
                        load({name: word})
                except UsageError as error:
                    return not _concerns_key(error, name)
                return True

            proposal = _find_accepted_range(text, is_accepted)
            if proposal is not None:
                raise ProposedRangeError(
                    error.message,
                    text=text,
                    proposal=proposal,
                    expected=error.expected,
                    where=f"--set '{name}={text}'",
                    got=error.got,
                    hint=f"write --set {shlex.quote(f'{name}={proposal}')}",
                ) from None
        raise


def _concerns_key(error: UsageError, name: str) -> bool:
    """Return whether an error is about a value of the swept key ``name``."""
    return (error.where or "").startswith(f"--set '{name}=")


def _find_accepted_range(text: str, is_accepted: Callable[[str], bool]) -> str | None:
    """Return a range like ``text`` whose values have the sign that a key accepts.

    ``is_accepted`` returns whether the key accepts a value. The result is None if the signs of the
    values are not the reason why the key rejects the range.
    """
    kind, words = split_range(text)
    count = {"list": len(words), "normal": 1}.get(kind, 2)
    ends = words[:count]
    numbers = list(map(NUMBER_WITH_UNIT.fullmatch, ends))
    values = [float(number[1]) for number in numbers if number]
    if len(values) < len(ends):
        return None
    negated = list(map(_negate_number, ends))
    if kind == "uniform":
        negated.reverse()  # the first value must be the lower value
    accepted: list[str] | None = None
    if min(values) > 0 or max(values) < 0:
        accepted = negated if all(map(is_accepted, negated)) else None
    elif kind in ("linear", "uniform"):
        accepted = _propose_range_of_accepted_sign(
            ends, is_accepted
        ) or _propose_range_of_accepted_sign(negated, is_accepted)
    return None if accepted is None else join_range(kind, [*accepted, *words[count:]])


def _negate_number(word: str) -> str:
    """Return a number with the other sign, with its unit.

    >>> _negate_number("1 m/s"), _negate_number("-1 m/s")
    ('-1 m/s', '1 m/s')
    """
    return word.removeprefix("-") if word.startswith("-") else f"-{word.removeprefix('+')}"


def _propose_range_of_accepted_sign(
    ends: Sequence[str], is_accepted: Callable[[str], bool]
) -> list[str] | None:
    """Propose a range of the accepted sign.

    The range is between the accepted end value and half of this end value.
    The result is None if both ends are rejected, or if the key accepts values of both signs.

    >>> _propose_range_of_accepted_sign(["-1", "2 m"], lambda word: not word.startswith("-"))
    ['1 m', '2 m']
    """
    first, last = ends
    halves = ((first, scale_quantity(first, 0.5)), (scale_quantity(last, 0.5), last))
    # a value near 0 is rejected only because of its sign
    near_zero = [scale_quantity(word, 1e-3) for word in (last, first)]
    for half, word in zip(halves, near_zero, strict=True):
        if half[0] != half[1] and all(map(is_accepted, half)) and not is_accepted(word):
            return list(half)
    return None


def _advise_normal_range(words: Sequence[str]) -> str:
    """Advise a smaller standard deviation for the range ``normal(...)`` of a key.

    The advised value is 1/10 of the typed standard deviation, but at most 1/10 of the mean.
    """
    mean, deviation = (NUMBER_WITH_UNIT.fullmatch(word) for word in words[:2])
    # the range is parsed before this error
    assert mean is not None
    assert deviation is not None
    smaller = float(deviation[1]) / 10
    if mean[2] == deviation[2] and float(mean[1]):
        smaller = min(smaller, abs(float(mean[1])) / 10)
    text = f"{smaller:g} {deviation[2]}".strip()
    return f"lower the standard deviation: write normal({words[0]},{text},{words[2]})"


def make_sweep_of_points(
    job: SweepSettings, plan: SweepPoints, units: Mapping[str, str], metrics: tuple[str, ...] = ()
) -> Sweep:
    """Make a sweep from its points and its settings.

    ``plan`` contains the points.

    Raises
    ------
    UsageError : the scene is invalid at the first point, or at an end of one of the ranges.
    """
    first, *_ = list(map(job.load, plan.list_end_points()))
    return Sweep(first, job, plan, units, metrics)


class _SweepFile(BaseModel):
    """Sweep in a file: a scene, ranges of its keys, and options of the sweep."""

    model_config = ConfigDict(extra="forbid", strict=True)

    title: str = ""
    scene: str
    ranges: dict[str, Any] = Field(alias="set", default_factory=dict)
    zipped: bool = Field(False, alias="zip")
    latin: bool = False
    seed: int = 0
    metrics: list[str] = Field(default_factory=list)


def list_studies() -> dict[str, Traversable]:
    """Return the files of the built-in studies, keyed by name."""
    folder = resources.files("kc2spice") / "studies"
    result = {item.name: item for item in folder.iterdir() if item.name.endswith(".toml")}
    return {name.removesuffix(".toml"): result[name] for name in sorted(result)}


def load_named_sweep(name: str, sets: Sequence[str] = (), **asked: Any) -> Sweep:
    """Load the sweep of a named scene or study, and add the ranges in ``sets``.

    ``sets`` are strings ``KEY=RANGE`` with ranges that are added to the sweep, or names of TOML
    files with values of keys. A range in ``sets`` replaces the study's range of the same key.
    ``asked`` are options of :func:`make_sweep`, which replace options of the study.

    Raises
    ------
    UsageError : ``name`` is neither a scene nor a study, the study contains a mistake, an option
        has no effect, or :func:`make_sweep` rejects a range or key.
    """
    _require_distinct_keys(sets)
    study = _find_study(name)
    scene, selected = name if study is None else study.scene, asked
    source = read_scene_text(scene)
    texts = expand_overrides(sets, open_scene(scene).parse_tables())
    if study is not None:
        ranges = {
            key: [f"{key}={v if isinstance(v, str) else format_toml(v)}"]
            for key, v in study.ranges.items()
        }
        typed = dict[str, list[str]]()
        for text in texts:
            typed.setdefault(text.partition("=")[0].strip(), []).append(text)
        texts = list(chain.from_iterable((ranges | typed).values()))
        settings = study.model_dump(include={"zipped", "latin", "seed", "metrics"})
        selected = settings | {
            key: value for key, value in asked.items() if value or key not in settings
        }
    result = make_sweep(source, texts, **selected)
    _require_effective_options(result.plan, asked)
    return result


def _require_distinct_keys(sets: Sequence[str]) -> None:
    """Raise an error if two options ``--set`` state the same key."""
    texts = dict[str, str]()
    for text in sets:
        name, equals, _ = text.partition("=")
        name = name.strip()
        if equals and name in texts:
            raise UsageError(
                "two options --set state the same key",
                where="sweep",
                got=f"--set {shlex.quote(texts[name])} and --set {shlex.quote(text)}",
                expected="one --set for each key",
                hint=f"delete one of the options --set {name}=…",
            )
        texts[name] = text


def _require_effective_options(plan: SweepPoints, asked: Mapping[str, Any]) -> None:
    """Raise an error if an option has no effect on the points of the sweep."""
    keys = ", ".join(plan.keys)
    for name in ("latin", "seed"):
        if asked.get(name) and not plan.random:
            raise UsageError(
                "the option has no effect, because no key has random values",
                where=f"--{name}",
                got=f"ranges without a random distribution: {keys}",
                expected="a range normal(MEAN,DEVIATION,POINTS) or uniform(LOW,HIGH,POINTS)",
                hint=f"leave out --{name}",
            )
    if asked.get("zipped") and len(plan.keys) == 1:
        raise UsageError(
            "the option has no effect, because only one key is swept",
            where="--zip",
            got=f"only one key: {keys}",
            expected="ranges of two or more keys",
            hint="leave out --zip",
        )
    if asked.get("zipped") and len(plan.random) == len(plan.keys):
        warn_user(f"--zip has no effect: the random values of {keys} always vary together")


def _find_study(name: str) -> _SweepFile | None:
    """Find a built-in study, or a study file, which is a file with a key ``scene``.

    The result is None if ``name`` is a scene.
    """
    builtin = list_studies().get(name)
    try:
        data = builtin.read_bytes() if builtin else read_bounded(Path(name), MAX_TEXT_BYTES)
        content = parse_toml(decode_text(data))
    except (OSError, ValueError):
        return None  # the scene loader reports the error in this file
    if not isinstance(content.get("scene"), str):
        return None
    try:
        return _SweepFile.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        raise UsageError(
            f"this key of the study is not valid: {first['msg']}",
            where=f"{name}, key {'.'.join(map(str, first['loc']))}",
        ) from None


# --- running a sweep ------------------------------------------------------------------------------


def run_points(
    definition: Sweep, points: Iterable[int], workers: Workers
) -> Iterator[tuple[int, PointResult]]:
    """Run points of a sweep, and yield each point with its result when the point ends.

    The first worker that needs a model builds the model and stores it in the cache; all other
    workers wait for the model. A point that was interrupted, by a lost worker or another fault of
    the machine, runs once more after all other points. If the worker of a repeated point is lost
    again, the point fails.

    Raises
    ------
    UsageError : the deck lacks a swept subcircuit parameter, the range of the parameter excludes a
        swept value, or the first successful point has no value for a column.
    MissingToolError : there are no workers, or the workers have no ngspice.
    """
    ends = chain.from_iterable(map(list_subcircuit_parameters, definition.plan.list_end_points()))
    if changed := [*definition.job.parameters, *ends]:
        with collect_warnings():  # the points collect the same warnings
            build, deck = build_sweep_point(definition.job, definition.plan.values(0))
        with_parameters(deck, resolve_parameters(build, deck, tuple(changed)))
    again: list[int] = []
    known = False

    def require_known_columns(outcome: PointResult) -> None:
        """Raise an error if the first successful point has no value for a column."""
        nonlocal known
        if outcome.failure is None and not known:
            require_columns(outcome, definition.metrics, definition.scene.name)
            known = True

    for index, outcome in _complete_points(definition, points, workers, require_known_columns):
        if outcome.interrupted:
            again.append(index)
        else:
            yield index, outcome
    if again:
        yield from _complete_points(definition, again, workers, require_known_columns, at_once=1)


def _complete_points(
    definition: Sweep,
    points: Iterable[int],
    workers: Workers,
    require: Callable[[PointResult], None],
    at_once: int | None = None,
) -> Iterator[tuple[int, PointResult]]:
    """Complete all sweep points; yield each point and result as soon as its run ends.

    Each worker runs one point at a time. The function ``require`` raises an error if a result shows
    that the sweep cannot succeed. After an error or Ctrl-C, no further point begins. The points
    that are already running are completed and yielded, and then the error is raised. A second
    Ctrl-C ends the sweep at once.

    If a worker process crashes or is killed, the result of all running points is ``LOST_POINT``,
    and the workers are started again.
    """
    left, pending = iter(points), dict[Future[PointResult], int]()
    fault: BaseException | None = None
    with ExitStack() as opened:
        executor, count = opened.enter_context(workers())
        while True:
            if fault is None:
                for index in islice(left, max(0, (at_once or 2 * count + 1) - len(pending))):
                    values = definition.plan.values(index)
                    pending[_submit_point(executor.submit, definition.job, values)] = index
            else:
                pending = {future: k for future, k in pending.items() if not future.cancel()}
            if not pending:
                break
            try:
                ended = wait(pending, return_when=FIRST_COMPLETED).done
            except (KeyboardInterrupt, SystemExit) as signal_error:
                if fault is not None:
                    raise
                fault = signal_error
                continue
            results = dict[Future[PointResult], PointResult]()
            for future in ended:
                try:
                    results[future] = _collect_result(future)
                except Exception as error:
                    fault = fault or error
                    del pending[future]
            if LOST_POINT in results.values():
                results |= {f: LOST_POINT for f in pending if f not in results}
                opened.close()
                if fault is None:
                    executor, count = opened.enter_context(workers())
            for future, outcome in results.items():
                yield pending.pop(future), outcome  # stored even if a column does not exist
                try:
                    require(outcome)
                except UsageError as error:
                    fault = fault or error
    if fault is not None:
        raise fault


def _submit_point(
    submit: Any, job: SweepSettings, values: Mapping[str, Any]
) -> Future[PointResult]:
    """Submit a point to the workers, and return the future of its result."""
    try:
        future: Future[PointResult] = submit(run_point, job, values)
    except Exception as error:  # an executor without workers raises an error
        future = Future()
        future.set_exception(error)
    return future


def _collect_result(future: Future[PointResult]) -> PointResult:
    """Return the result of a point; ``LOST_POINT`` if the point's worker was lost."""
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
    """Run all unfinished points of a sweep, and write the table of the sweep.

    Each finished row is written to ``out/rows.sqlite``. The table, its figures and ``sweep.html``
    are written after the last row. A repeated call continues an interrupted sweep, and repeats
    points that failed because of the machine.

    Parameters
    ----------
    definition : Sweep
        Points and settings of the sweep, for example the result of :func:`load_named_sweep`.
    out : Path
        Directory for the files of the sweep.
    workers : callable
        Function without arguments that returns a context manager. The context manager yields an
        executor and the number of points to run at a time. See
        :func:`kc2spice.workflow.sweep.workers.make_local_pool_opener` and
        :func:`kc2spice.workflow.sweep.workers.make_dask_connector`.
    progress : callable, optional
        Called as ``progress(stage, done, text)`` after each point.
    table_format : "csv" or "parquet", default "csv"
        Format of the table.
    retry_failed : bool, default False
        Whether to repeat all points that failed.

    Returns
    -------
    dict[str, Any]
        The output of ``kc2spice sweep --json``: number of points, failures and names of the files.

    Raises
    ------
    UsageError : ``out`` contains another sweep, another process writes to it, or ``out`` cannot be
        written.
    MissingToolError : there are no workers, the workers have no ngspice, or pyarrow is missing for
        Parquet.

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
    with (
        closing(_open_row_store(definition, out, table_format)) as rows,
        rows.remove_empty_file_on_error(),
    ):
        done = set()
        for index, outcome in rows.outcomes.items():
            if not outcome.interrupted and (outcome.failure is None or not retry_failed):
                done.add(index)
        good = (item for item in rows.outcomes.values() if item.failure is None)
        for outcome in islice(good, 1):
            require_columns(outcome, definition.metrics, definition.scene.name)
        missing = sorted(set(range(definition.plan.size)) - done)
        for count, (index, outcome) in enumerate(run_points(definition, missing, workers), 1):
            rows.write_row(index, outcome)
            begin = time.monotonic() if count == 1 else begin
            text = f"{count} of {len(missing)} points, {len(rows.failed)} failed"
            if count > 1:  # the first point may have built models that all other points use
                rate = (count - 1) / max(time.monotonic() - begin, 1e-9)
                left = timedelta(seconds=round((len(missing) - count) / rate))
                text = f"{text}, {rate:.3g}/s, {left} left"
            progress("sweep", count / len(missing), text)
        _warn_of_points(definition, [rows.outcomes[index] for index in sorted(rows.outcomes)])
        progress("report", None, "table, figures and page")
        summary = _write_sweep_files(definition, rows, out, table_format)
    return {**summary, "resumed": len(done), "wall_s": time.monotonic() - start}


def _warn_of_points(definition: Sweep, outcomes: Iterable[PointResult]) -> None:
    """Issue each warning of the points once, with the number of points.

    Of warnings that differ only in numbers, the first one is issued. Warnings about the scene of
    the first point are omitted, because :func:`make_sweep` has issued these warnings.
    """
    known = {_NUMBER.sub("", text) for text in definition.warnings}
    texts = dict[str, list[str]]()
    for outcome in outcomes:
        for text in outcome.warnings:
            texts.setdefault(_NUMBER.sub("", text), []).append(text)
    for pattern, group in texts.items():
        if pattern not in known:
            example = ", with different numbers, for example" if len(set(group)) > 1 else ""
            count = f"{len(group)} of {definition.plan.size} points"
            warn_user(f"{count}{example}: {group[0]}")


def get_table_file_name(table_format: str) -> str:
    """Return the file name of a sweep table in the format ``table_format``.

    Raises
    ------
    UsageError : the format does not exist.
    MissingToolError : pyarrow, which Parquet tables require, is missing.
    """
    if table_format not in WRITERS:
        raise unknown("this table format does not exist", table_format, WRITERS, "--format")
    if table_format == "parquet":
        import_optional("pyarrow.parquet", "--format")
    return f"sweep.{table_format}"


def _open_row_store(definition: Sweep, out: Path, table_format: str) -> RowStore:
    """Open the store of rows in ``out``; reject a directory with other results."""
    name = get_table_file_name(table_format)
    if out.exists() and not out.is_dir():
        raise UsageError(
            "this path is a file, not a directory", where=str(out), hint="choose another --out"
        )
    if (out / name).exists() and not (out / ROWS_FILE).exists():
        raise UsageError(
            "this directory already contains results",
            where=str(out / name),
            hint="choose another --out",
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise make_write_error(str(out), out, error.strerror or str(error)) from None
    return RowStore(out / ROWS_FILE, definition.plan.size, definition.digest)


def _write_sweep_files(
    definition: Sweep, rows: RowStore, out: Path, table_format: str
) -> dict[str, Any]:
    """Write the files of a sweep (table, page with figures); return its summary."""
    from kc2spice.report.sweep_page import compute_yields, write_sweep

    table = collect_columns(rows.outcomes, definition.plan, definition.metrics)
    name = get_table_file_name(table_format)
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
        "runs": definition.run_counts,
        "yield": shares,
        "files": [name, PAGE_FILE],
    }
