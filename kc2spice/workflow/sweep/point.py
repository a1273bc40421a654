"""One point of a sweep, in whatever process it runs: scene, models, deck, ngspice, metrics."""

from __future__ import annotations

import contextlib
import errno
import re
import shutil
import tempfile
import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import Kc2spiceError, MissingToolError, UsageError
from kc2spice.core.progress import Clock
from kc2spice.core.waveforms import Waveforms
from kc2spice.report.metrics import metrics
from kc2spice.scene.keys import did_you_mean
from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene
from kc2spice.sim.ladder import Climb
from kc2spice.spice.deck import Deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.models import Models, build_models, model_facts, model_keys
from kc2spice.workflow.simulate import simulate
from kc2spice.workflow.sweep.cost import METER, NOTHING, Cost
from kc2spice.workflow.sweep.parameters import with_parameters
from kc2spice.workflow.sweep.source import SceneText

# Numbers of result.json besides its metrics, which may be columns too.
BRANCHES = ("model.", "rom.", "steps.", "checks.", "energy_j.", "simulator_cpu_s")
_SIGNAL = re.compile(r"exit code -\d+")  # somebody ended the simulator
_ROOM = 5_000_000  # bytes that a run needs on the temporary disk
_KEPT = 8  # models and decks that a worker holds at a time
Metric = float | bool | None


@dataclass(frozen=True)
class Job:
    """What all points of a sweep have in common.

    ``fixed`` are overrides of the scene, ``parameters`` those of subcircuits; ``timeout`` [s] is
    that of one ngspice run.
    """

    scene: SceneText
    fixed: tuple[str, ...]
    parameters: tuple[tuple[str, float], ...]
    metrics: tuple[str, ...]
    timeout: float | None


@dataclass(frozen=True)
class Task:
    """One point: its number, scene overrides and subcircuit parameters."""

    index: int
    overrides: tuple[str, ...]
    parameters: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Outcome:
    """Metrics in the order of the job, or in one line why there are none; what the point cost."""

    index: int
    values: tuple[Metric, ...] = ()
    failure: str | None = None
    cost: Cost = NOTHING
    interrupted: bool = False


def run_point(job: Job, task: Task) -> Outcome:
    """Run one point. What goes wrong with it is its outcome; it never ends the sweep.

    Raises
    ------
    MissingToolError : no ngspice here: no point of this machine could succeed.
    """
    return replace(_outcome(job, task), cost=METER.since_last())


def _outcome(job: Job, task: Task) -> Outcome:
    try:
        scene, deck = testbench(job, task.overrides)
        with tempfile.TemporaryDirectory(prefix="kc2spice-") as directory:
            deck = with_parameters(deck, (*job.parameters, *task.parameters))
            judged = _without_checks(scene) if job.parameters or task.parameters else scene
            models = _STORE.models(scene)
            climbed = simulate(judged, models, deck, Path(directory), timeout=job.timeout)
        found = _numbers(scene, models, climbed)
        return Outcome(task.index, tuple(_cell(found, name) for name in job.metrics))
    except MissingToolError:
        raise
    except Kc2spiceError as error:
        text = _diagnosis(error)
        return Outcome(task.index, failure=text, interrupted=_was_interrupted(text))
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        return Outcome(task.index, failure=f"{error}", interrupted=full or _disk_is_full())
    except Exception as error:
        return Outcome(task.index, failure=f"{type(error).__name__}: {error}")


def _was_interrupted(diagnosis: str) -> bool:
    """Whether a run failed for what happened to the machine and not for what the point is."""
    return bool(_SIGNAL.search(diagnosis)) or _disk_is_full()


def _disk_is_full() -> bool:
    """Whether the temporary directory has no room left for a run."""
    try:
        return shutil.disk_usage(tempfile.gettempdir()).free < _ROOM
    except OSError:
        return True


def _numbers(scene: Scene, models: Models, climbed: Climb) -> dict[str, Metric]:
    """Metrics by name, and every other number that ``result.json`` has by its dotted path."""
    facts: dict[str, Any] = {
        "model": model_facts(models),
        "steps": {name: climbed.waves.stats.get(name) for name in ("accepted", "rejected")},
        "checks": {check.name: check.value for check in climbed.truth.checks},
        "energy_j": {name: book.entries for name, book in climbed.truth.books},
        "simulator_cpu_s": climbed.waves.stats.get("cpu_s"),
    }
    if models.kick is not None:
        resonators = models.kick.resonators
        facts["rom"] = {
            "order": resonators.order, "error_estimate": resonators.certificate.error_estimate,
        }  # fmt: skip
    return {**dict(_leaves("", facts)), **metrics(climbed.waves, scene)}


def _leaves(path: str, value: Any) -> Iterator[tuple[str, Metric]]:
    if isinstance(value, Mapping):
        for name, each in value.items():
            yield from _leaves(f"{path}.{name}" if path else str(name), each)
    elif value is None or isinstance(value, (bool, int, float, np.number)):
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


def _without_checks(scene: Scene) -> Scene:
    """``scene`` without the checks that go by numbers which parameters of subcircuits change."""
    off = {"energy": "off", "penetration": "off", "saturation": "off"}
    return scene.model_copy(update={"checks": scene.checks.model_copy(update=off)})


def run_reference(job: Job, task: Task) -> Outcome:
    """The same point integrated by scipy, which shares neither netlist nor simulator."""
    from kc2spice import reference

    try:
        scene = job.scene.load((*job.fixed, *task.overrides))
        models = _STORE.models(scene)
        model = need(models.kick, "kick").resonators
        waves = reference.kick_and_catch(model, scene, models.table, rtol=1e-8).waves
        found = metrics(waves, scene)
    except Kc2spiceError as error:
        return Outcome(task.index, failure=_diagnosis(error))
    # What only a netlist's run has, its steps for one, is missing here.
    return Outcome(task.index, tuple(_plain(found.get(name)) for name in job.metrics))


def prepare(job: Job, part: str, points: Sequence[tuple[str, ...]]) -> None:
    """Build one part's models for the overrides of some points; all others find them in the cache.

    ``part`` is ``kick`` or ``catch``. Points that share the chip belong into one call.
    """
    other = {"kick": "catch", "catch": "kick"}[part]
    for overrides in points:
        with contextlib.suppress(Exception):  # the points themselves will say what is wrong
            scene = job.scene.load((*job.fixed, *overrides))
            build_models(scene.model_copy(update={other: None}), Clock())


def scalar_metrics(scene: Scene) -> dict[str, type]:
    """Metrics of the scene's experiment that fit into one column, with their types.

    The names come from the functions that measure a run, asked about a sphere that stays at rest.
    """
    rest = Waveforms(_Rest({"time": np.linspace(0.0, 1.0, 5), "frequency": np.ones(5)}), {})
    try:
        with np.errstate(all="ignore"):
            found = metrics(rest, scene)
    except KeyError:
        return {}
    kinds = {True: bool, False: float}
    return {
        name: kinds[isinstance(value, bool)]
        for name, value in found.items()
        if value is None or isinstance(value, (bool, int, float))
    }


class _Rest(dict[str, np.ndarray]):
    """Waveforms of a sphere at rest, whatever they are called."""

    def __missing__(self, name: str) -> np.ndarray:
        return np.zeros(5)


class _Store:
    """Models in memory, so that a point costs no more than its deck and its run."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._models: OrderedDict[str, Models] = OrderedDict()

    def models(self, scene: Scene) -> Models:
        placed = None if scene.catch is None else (scene.catch.remanence, scene.catch.shift)
        key = repr((model_keys(scene), placed))
        with self._lock:  # threads of one worker must not build the same model side by side
            if key not in self._models:
                self._models[key] = build_models(scene, Clock())
            self._models.move_to_end(key)
            while len(self._models) > _KEPT:
                self._models.popitem(last=False)
            return self._models[key]


_STORE = _Store()


@lru_cache(maxsize=_KEPT)
def testbench(job: Job, overrides: tuple[str, ...]) -> tuple[Scene, Deck]:
    """Scene and deck; points that differ in subcircuit parameters alone share both."""
    scene = job.scene.load((*job.fixed, *overrides))
    return scene, make_deck(scene, _STORE.models(scene))


def _diagnosis(error: Kc2spiceError) -> str:
    parts = [error.message, f"got {error.got}" if error.got is not None else ""]
    if isinstance(error, UsageError):
        parts.insert(0, str(error.where or ""))
    return ", ".join(part for part in parts if part).replace("\n", " ")


def _plain(value: Any) -> Metric:
    if value is None or isinstance(value, bool):
        return value
    return float(value)
