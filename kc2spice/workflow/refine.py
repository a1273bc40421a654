"""One run of a scene under some numerical settings, and what finer ones change of its metrics."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.progress import Clock
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.sim.ngspice import run_deck
from kc2spice.sim.retries import Outcome
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.judge import metrics
from kc2spice.workflow.models import build_models
from kc2spice.workflow.results import leaves
from kc2spice.workflow.simulate import simulate


@dataclass(frozen=True)
class Run:
    """``values`` of the metrics by dotted name, over the points of ``scale`` where they are curves
    of the analysis; ``cpu_s`` of the simulator's process, with all its retries."""

    values: Mapping[str, np.ndarray]
    scale: np.ndarray
    cpu_s: float
    build: Build
    outcome: Outcome


def measured(build: Build, outcome: Outcome, cpu_s: float = 0.0) -> Run:
    """The run that gave ``outcome``."""
    scale = next(iter(outcome.waves.data.values())).real
    return Run(dict(_arrays(metrics(outcome.waves, build))), scale, cpu_s, build, outcome)


def evaluate(
    scene: Scene,
    clock: Clock,
    text: str,
    *,
    trust: bool = False,
    functions: Mapping[str, Any] | None = None,
    retries: int | None = None,
) -> Run:
    """Build, write, simulate and measure ``scene``; raises as :func:`simulate` does."""
    build = build_models(scene, clock, trust=trust, functions=functions)
    with clock.stage("refined run", text), tempfile.TemporaryDirectory() as folder:
        begin = _children_cpu()
        outcome = simulate(build, make_deck(build), Path(folder), retries=retries)
        return measured(build, outcome, _children_cpu() - begin)


def time_again(run: Run) -> float:
    """CPU seconds [s] of the simulator for the deck of ``run``, once more."""
    with tempfile.TemporaryDirectory() as folder:
        begin = _children_cpu()
        run_deck(run.outcome.deck, Path(folder))
        return _children_cpu() - begin


def _children_cpu() -> float:
    """CPU seconds so far of all child processes that have ended; wall time where nobody tells."""
    try:
        import resource
    except ImportError:
        return time.perf_counter()
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _arrays(found: Mapping[str, Any]) -> Iterator[tuple[str, np.ndarray]]:
    """Numbers and arrays of numbers by dotted name; what is missing is nan."""
    for name, value in leaves(found):
        array = np.asarray(np.nan if value is None else value)
        if array.dtype.kind in "bif":
            yield name, array


def changes(run: Run, finer: Run, near_zero: float = 0.0) -> dict[str, float]:
    """Relative change of every metric that ``finer`` has, infinite where ``run`` has none like it.

    That of a curve is relative to its largest value, that of a small number to ``near_zero`` of the
    largest one in its unit. A curve over other points is interpolated to those of ``run``.
    """
    exact = {name: v.astype(float) for name, v in finer.values.items() if v.size}
    exact = {name: v for name, v in exact.items() if np.isfinite(v).all()}
    least: dict[str, float] = {}
    for name, value in exact.items():
        unit = name.rpartition("_")[2]
        least[unit] = max(least.get(unit, 0.0), near_zero * float(np.abs(value).max()))
    found = {}
    for name, value in exact.items():
        mine = run.values.get(name)
        scale = max(float(np.abs(value).max()), least[name.rpartition("_")[2]])
        if mine is not None and value.shape == finer.scale.shape and mine.shape == run.scale.shape:
            value = np.interp(run.scale, finer.scale, value)
        if mine is None or mine.shape != value.shape or not np.isfinite(mine).all():
            found[name] = np.inf
        else:
            apart = float(np.abs(mine.astype(float) - value).max())
            found[name] = apart / scale if scale else 0.0
    return found
