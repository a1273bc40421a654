"""One point of a sweep, in whatever process it runs: scene, models, deck, ngspice, metrics."""

from __future__ import annotations

import contextlib
import errno
import math
import os
import re
import shutil
import tempfile
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import Kc2spiceError, MissingToolError, UsageError
from kc2spice.core.foreign import name_threat, read_bounded, text_of
from kc2spice.core.progress import Clock
from kc2spice.core.toml import MAX_BYTES
from kc2spice.core.waveforms import Waveforms
from kc2spice.core.words import did_you_mean
from kc2spice.scene.load import gallery, load_scene
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.sim.retries import Outcome as Simulated
from kc2spice.spice.cards import number
from kc2spice.spice.circuit import LEAST, Param, Subcircuit
from kc2spice.spice.deck import Deck
from kc2spice.spice.included import included_sources
from kc2spice.workflow.decks import libraries, make_deck, result_vectors
from kc2spice.workflow.judge import metrics
from kc2spice.workflow.models import build_models, model_facts, rom_facts
from kc2spice.workflow.simulate import simulate
from kc2spice.workflow.sweep.plan import Plan, overrides, parameters

# Numbers of result.json besides its metrics, which may be columns too.
BRANCHES = ("model.", "rom.", "roms.", "steps.", "checks.", "energy_j.", "simulator_cpu_s")
_SIGNAL = re.compile(r"exit code -\d+")  # somebody ended the simulator
_ROOM = 5_000_000  # bytes that a run needs on the temporary disk
_KEPT = 8  # decks and scenes that a worker holds at a time
MAX_FILES = 64_000_000  # bytes
Metric = float | bool | None
Parameters = tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class SceneText:
    """A gallery name, or a name, its TOML and the content of the files beside it, by name.

    It may come from anybody: its names are those of files below one directory, or it is not made.

    Raises
    ------
    UsageError : a name that could lead elsewhere.
    """

    name: str
    text: str | None
    files: tuple[tuple[str, bytes], ...] = ()

    def __post_init__(self) -> None:
        for name in (self.name, *(name for name, _ in self.files)):
            if reason := name_threat(name):
                hint = "copy it beside the scene"
                raise UsageError(f"is {reason}", where="name of a scene's file",
                                 got=repr(name[:120]), hint=hint)  # fmt: skip
        if "/" in self.name:
            raise UsageError("is no plain name", where="scene", got=repr(self.name[:120]))

    def load(self, overrides: Sequence[str]) -> Scene:
        """The scene with ``overrides`` on top of it; raises as :func:`load_scene` does."""
        if self.text is None:
            return load_scene(self.name, overrides)
        home = Path(_unpacked(self).name)
        try:
            return load_scene(home / f"{self.name}.toml", overrides)
        except UsageError as error:  # rows say the same wherever they are run
            error.where = error.where and str(error.where).replace(f"{home}{os.sep}", "")
            raise


@dataclass(frozen=True, eq=False)
class LoadedScene:
    """A scene that this process has loaded."""

    scene: Scene

    def load(self, overrides: Sequence[str]) -> Scene:
        """The scene with ``overrides`` on top of it; raises as :func:`load_scene` does."""
        return load_scene(self.scene, overrides)


Source = SceneText | LoadedScene


@lru_cache(maxsize=_KEPT)
def _unpacked(scene: SceneText) -> tempfile.TemporaryDirectory[str]:
    """A directory that holds the files of ``scene`` until this process ends."""
    directory = tempfile.TemporaryDirectory(prefix="kc2spice-scene-")
    for name, content in ((f"{scene.name}.toml", (scene.text or "").encode()), *scene.files):
        path = Path(directory.name) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return directory


def scene_text(name_or_path: str) -> SceneText:
    """The scene as it stands now.

    Raises
    ------
    UsageError : no such scene, or one of its files is not there or not allowed.
    """
    if name_or_path in gallery():
        return SceneText(name_or_path, None)
    path = Path(name_or_path)
    scene = load_scene(path)
    text = text_of(read_bounded(path, MAX_BYTES))
    return SceneText(scene.name, text, tuple(scene_files(scene).items()))


def scene_files(scene: Scene) -> dict[str, bytes]:
    """What a scene reads beside itself, by name; netlists as one text with all that they include.

    Raises
    ------
    UsageError : a file that is missing, not allowed or too long.
    """
    parts = scene.parts.values()
    netlists = {f for p in parts if p.type.uses_netlists(p) for f in p.type.files(p, scene)}
    texts = included_sources(sorted({*scene.include, *netlists}), scene.home)
    found = {name: text.encode() for name, text in texts.items()}
    for name in sorted({f for p in parts for f in p.type.files(p, scene)} - set(found)):
        try:
            found[name] = read_bounded(scene.home / name, MAX_FILES)
        except OSError as error:
            raise UsageError(f"cannot be read: {error.strerror}", where=name) from None
    if sum(map(len, found.values())) > MAX_FILES:
        raise UsageError("the files of this scene are too long to travel with a sweep",
                         where=scene.name, expected=f"at most {MAX_FILES} bytes")  # fmt: skip
    return found


@dataclass(frozen=True)
class Job:
    """What all points of a sweep have in common.

    ``fixed`` are overrides of the scene, ``parameters`` those of subcircuits; ``timeout`` [s] is
    that of one ngspice run.
    """

    scene: Source
    fixed: tuple[str, ...]
    parameters: Parameters
    metrics: tuple[str, ...]
    timeout: float | None

    def load(self, changed: Sequence[str]) -> Scene:
        """The scene of a point with the overrides ``changed``."""
        return self.scene.load((*self.fixed, *changed))


@dataclass(frozen=True)
class Task:
    """One point: its number, scene overrides and subcircuit parameters."""

    index: int
    overrides: tuple[str, ...]
    parameters: Parameters


@dataclass(frozen=True)
class Cost:
    """CPU seconds: ``own`` of Python, ``simulator`` of the ngspice runs."""

    own: float = 0.0
    simulator: float = 0.0

    def __add__(self, other: Cost) -> Cost:
        return Cost(self.own + other.own, self.simulator + other.simulator)


@dataclass(frozen=True)
class Outcome:
    """Metrics in the order of the job, or in one line why there are none; what the point cost."""

    index: int
    values: tuple[Metric, ...] = ()
    failure: str | None = None
    cost: Cost = Cost()
    interrupted: bool = False


def task(plan: Plan, index: int) -> Task:
    """Point ``index`` as it goes to a worker."""
    values = plan.values(index)
    return Task(index, overrides(plan.keys, values), parameters(plan.keys, values))


def run_point(job: Job, task: Task) -> Outcome:
    """Run one point. What goes wrong with it is its outcome; it never ends the sweep.

    Raises
    ------
    MissingToolError : no ngspice here: no point of this machine could succeed.
    """
    return replace(_outcome(job, task), cost=cpu_since_last())


def _outcome(job: Job, task: Task) -> Outcome:
    try:
        build, deck = testbench(job, task.overrides)
        changed = (*job.parameters, *task.parameters)
        build, deck = judged(build, deck, changed), with_parameters(deck, changed)
        with tempfile.TemporaryDirectory(prefix="kc2spice-") as directory:
            simulated = simulate(build, deck, Path(directory), timeout=job.timeout)
        found = _numbers(build, simulated)
        return Outcome(task.index, tuple(_cell(found, name) for name in job.metrics))
    except MissingToolError:
        raise
    except Kc2spiceError as error:
        text = _diagnosis(error)
        interrupted = bool(_SIGNAL.search(text)) or _disk_is_full()
        return Outcome(task.index, failure=text, interrupted=interrupted)
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        return Outcome(task.index, failure=f"{error}", interrupted=full or _disk_is_full())
    except Exception as error:
        return Outcome(task.index, failure=f"{type(error).__name__}: {error}")


def _disk_is_full() -> bool:
    """Whether the temporary directory has no room left for a run."""
    try:
        return shutil.disk_usage(tempfile.gettempdir()).free < _ROOM
    except OSError:
        return True


def _diagnosis(error: Kc2spiceError) -> str:
    parts = [error.message, f"got {error.got}" if error.got is not None else ""]
    if isinstance(error, UsageError):
        parts.insert(0, str(error.where or ""))
    return ", ".join(part for part in parts if part).replace("\n", " ")


_last = [Cost()]  # so that the first reading holds the start of the process


def cpu_since_last() -> Cost:
    """CPU of this process and of the children it has waited for, since the last call."""
    times, before = os.times(), _last[0]
    now = Cost(times.user + times.system, times.children_user + times.children_system)
    _last[0] = now
    return Cost(now.own - before.own, now.simulator - before.simulator)


_lock = threading.Lock()  # threads of one worker must not build the same model side by side


def testbench(job: Job, changed: tuple[str, ...]) -> tuple[Build, Deck]:
    """Models and deck; points that differ in subcircuit parameters alone share both."""
    with _lock:
        return _testbench(job, changed)


@lru_cache(maxsize=_KEPT)
def _testbench(job: Job, changed: tuple[str, ...]) -> tuple[Build, Deck]:
    build = build_models(job.load(changed), Clock())
    return build, make_deck(build)


# --- numbers ------------------------------------------------------------------------------------


def _numbers(build: Build, simulated: Simulated) -> dict[str, Metric]:
    """Metrics by name, and every other number that ``result.json`` has by its dotted path."""
    stats = simulated.waves.stats
    facts: dict[str, Any] = {
        "model": model_facts(build),
        **rom_facts(build),
        "steps": {name: stats.get(name) for name in ("accepted", "rejected")},
        "checks": {check.name: check.value for check in simulated.verdict.checks},
        "energy_j": {name: balance.entries for name, balance in simulated.verdict.balances},
        "simulator_cpu_s": stats.get("cpu_s"),
    }
    return dict(_leaves("", facts)) | dict(_leaves("", metrics(simulated.waves, build)))


def _leaves(path: str, value: Any) -> Iterator[tuple[str, Metric]]:
    if isinstance(value, Mapping):
        for name, each in value.items():
            yield from _leaves(f"{path}.{name}" if path else str(name), each)
    elif value is None or isinstance(value, (bool, np.bool_, int, float, np.number)):
        yield path, _plain(value)


def _cell(found: Mapping[str, Any], name: str) -> Metric:
    """Value of one column.

    Raises
    ------
    UsageError : the result has no number of that name.
    """
    if name not in found:
        raise UsageError(
            "the result has no such number", where="--metric", got=name,
            hint=did_you_mean(name, found),
        )  # fmt: skip
    return _plain(found[name])


def _plain(value: Any) -> Metric:
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    return None if value is None else float(value)


def scalar_metrics(scene: Scene) -> dict[str, type]:
    """Metrics and probes of the scene that fit into one column, with their types.

    The parts are asked about a run with all vectors that the scene records: at rest, or for ``ac``
    with one resonance in the middle of the band.

    Raises
    ------
    UsageError : a probe of a vector that the scene does not record.
    """
    build = Build(scene, {}, libraries(scene))
    with np.errstate(all="ignore"):
        found = metrics(_made_up_run(build), build)
    numbers = dict(_leaves("", found))
    return {name: bool if isinstance(value, bool) else float for name, value in numbers.items()}


def _made_up_run(build: Build) -> Waveforms:
    """Zeros; for ``ac`` 1 V everywhere, and currents of a series resonance beside a capacitance."""
    vectors, analysis = result_vectors(build), build.scene.analysis
    if analysis.type != "ac":
        scale = {"transient": "time"}.get(analysis.type, "sweep")
        data = {scale: np.linspace(0.0, 1.0, 5)} | {name: np.zeros(5) for name in vectors}
        return Waveforms(data, {})
    low, high = max(analysis.start, 1e-3 * float(analysis.stop or 1.0)), float(analysis.stop or 1.0)
    f = np.linspace(low, high, 2001)
    x = f / f.mean()
    zero, one = np.zeros(f.size, complex), np.ones(f.size, complex)
    values = {"V": one, "A": 1e-3j * x * (1 + 0.05 / (1 - x**2 + 0.02j * x))}
    data = {name: values.get(vector.unit, zero) for name, vector in vectors.items()}
    return Waveforms({"frequency": f} | data, {})


# --- parameters of subcircuits ------------------------------------------------------------------

_CARD = re.compile(r"^\.subckt\s+(\S+)(.*)$", re.MULTILINE | re.IGNORECASE)
_DEFAULT = re.compile(r"(\w+)=(\S+)")


def _library(part: Subcircuit) -> str:
    return part.filename.rpartition(".")[0] or part.filename


def _cards(part: Subcircuit) -> Iterator[tuple[str, str]]:
    """Name in ``param.NAME.…`` and text of every ``.subckt`` card of a library.

    The part itself goes by its file, whatever helper it brings along by the helper's own name:
    ``opamp`` is the amplifier in all libraries that have one.
    """
    for card in _CARD.finditer(part.text):
        own = card[1].lower() == part.name.lower()
        yield (_library(part) if own else card[1].removeprefix(f"{part.name}_")), card[2]


def declared(deck: Deck) -> dict[str, float]:
    """``PART.NAME`` and default of every numeric parameter of the deck's subcircuits."""
    found = {}
    for part in deck.parts:
        for library, card in _cards(part):
            for name, text in _DEFAULT.findall(card):
                with contextlib.suppress(ValueError):  # an expression: nothing to replace
                    found[f"{library}.{name}"] = float(text)
    return found


def with_parameters(deck: Deck, values: Iterable[tuple[str, float]]) -> Deck:
    """``deck`` with other defaults for ``("PART.NAME", value)``, in the card and in the header.

    Raises
    ------
    UsageError : no part of the deck has that parameter, or not with that value.
    """
    known, parts = declared(deck), list(deck.parts)
    for key, value in values:
        if key not in known:
            raise UsageError(
                "no part of this scene has such a parameter", where=f"param.{key}",
                expected=", ".join(known), hint=did_you_mean(key, known),
            )  # fmt: skip
        library, _, name = key.partition(".")
        parts = [_changed(part, library, name, value) for part in parts]
    return replace(deck, parts=tuple(parts))


def _changed(part: Subcircuit, library: str, name: str, value: float) -> Subcircuit:
    own = library == _library(part)
    for param in part.params if own else ():
        if param.name.lower() == name.lower():
            _require_within(param, library, value)
    names = dict(zip((card[1] for card in _CARD.finditer(part.text)), _cards(part), strict=True))
    default = re.compile(rf"(?<=\s){name}=\S+")

    def card(match: re.Match[str]) -> str:
        mine = names[match[1]][0] == library
        return default.sub(f"{name}={number(value)}", match[0]) if mine else match[0]

    text = _CARD.sub(card, part.text)
    if own:
        text = re.sub(rf"(?m)^(\* @param {name})=\S+", rf"\g<1>={number(value)}", text, count=1)
    return replace(part, text=text)


def _require_within(param: Param, library: str, value: float) -> None:
    """A mass of zero or a negative stiffness has no solution, or a wrong one."""
    least, most = param.low, param.high
    if least <= value <= most and math.isfinite(value):
        return
    expected = f"{least:g} … {most:g}" if math.isfinite(least) else "a finite number"
    if most == math.inf and least > -math.inf:
        expected = "above zero" if least == LEAST else f"at least {least:g}"
    raise UsageError(
        "outside the range of this parameter", where=f"param.{library}.{param.name}",
        got=f"{value:g} {param.unit}", expected=expected,
    )  # fmt: skip


def judged(build: Build, deck: Deck, values: Iterable[tuple[str, float]]) -> Build:
    """``build`` for metrics and checks of a ``deck`` whose parameters are changed.

    A part with a key of that name and value has the changed one; of a part without, whose keys no
    longer tell what the deck has, neither checks nor energy balance are asked for.
    """
    known, parts, unjudged = declared(deck), dict(build.scene.parts), set(build.unjudged)
    for key, value in values:
        library, _, name = key.partition(".")
        users = {_library(p) for p in deck.parts if library in dict(_cards(p))}
        for owner in (p for p, used in build.libraries.items() if used in users):
            keys = parts[owner].keys
            old = getattr(keys, name) if name in type(keys).model_fields else None
            if isinstance(old, float) and math.isclose(old, known.get(key, math.nan)):
                parts[owner] = replace(parts[owner], keys=keys.model_copy(update={name: value}))
            elif value != known.get(key):
                unjudged.add(owner)
    scene = replace(build.scene, parts=parts)
    return replace(build, scene=scene, unjudged=frozenset(unjudged))
