"""One run of a scene under some settings: what it gives, and what the simulator took for it."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.progress import Clock
from kc2spice.core.words import did_you_mean
from kc2spice.netlist.deck import Deck
from kc2spice.scene.axes import Axis, axes
from kc2spice.scene.model import Scene
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.judge import metrics
from kc2spice.workflow.models import build_models
from kc2spice.workflow.simulate import simulate


@dataclass(frozen=True)
class Run:
    """``values`` of the metrics by dotted name, arrays of any shape; CPU seconds of the simulator
    process; the axes of the scene; the deck.
    """

    values: dict[str, np.ndarray]
    cpu_s: float
    axes: tuple[Axis, ...]
    deck: Deck


def evaluate(scene: Scene, *, trust: bool = False) -> Run:
    """Build, write, simulate and measure ``scene``; the simulator is not given a second try.

    Raises
    ------
    SimulationError : the run failed or its result violates a physical check.
    MissingToolError : no ngspice.
    """
    build = build_models(scene, Clock(), trust=trust)
    deck = make_deck(build)
    with tempfile.TemporaryDirectory(prefix="kc2spice-bench-") as folder:
        begin = _children_cpu()
        result = simulate(build, deck, Path(folder), retries=0)
        spent = _children_cpu() - begin
    values = dict(_flat("", metrics(result.waves, build)))
    return Run(values, spent, axes(scene, build), deck)


def time_again(run: Run) -> float:
    """CPU seconds [s] of the simulator for the deck of ``run``, once more.

    Raises
    ------
    SimulationError : the run failed.
    """
    with tempfile.TemporaryDirectory(prefix="kc2spice-bench-") as folder:
        begin = _children_cpu()
        run_deck(run.deck, Path(folder))
        return _children_cpu() - begin


def _children_cpu() -> float:
    """CPU seconds so far of all child processes that have ended; wall time where nobody tells."""
    try:
        import resource
    except ImportError:
        return time.perf_counter()
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _flat(prefix: str, value: Any) -> Iterable[tuple[str, np.ndarray]]:
    """Numbers and arrays of numbers below ``value`` by dotted name; what is missing is nan."""
    if isinstance(value, Mapping):
        for key, each in value.items():
            yield from _flat(f"{prefix}.{key}" if prefix else str(key), each)
    elif value is None or isinstance(value, (bool, int, float, list, np.ndarray, np.number)):
        array = np.asarray(np.nan if value is None else value)
        if array.dtype.kind in "bif":
            yield prefix, array


def chosen(run: Run, wanted: Sequence[str]) -> tuple[str, ...]:
    """Names of ``run`` that ``wanted`` means, each alone or all that begin with it and a dot.

    Without any wanted: all scalars that are numbers; of a run that has none, all curves.

    Raises
    ------
    UsageError : a metric that the scene does not have.
    """
    found: list[str] = []
    for name in wanted:
        hits = [known for known in run.values if known == name or known.startswith(f"{name}.")]
        if not hits:
            raise UsageError(
                "this scene has no such metric",
                where="--metric",
                got=name,
                expected=", ".join(run.values),
                hint=did_you_mean(name, run.values),
            )
        found += hits
    if wanted:
        return tuple(dict.fromkeys(found))
    numbers = {name: v for name, v in run.values.items() if v.dtype.kind != "b"}
    scalars = tuple(name for name, v in numbers.items() if v.ndim == 0)
    return scalars or tuple(numbers)


def errors(run: Run, reference: Run, names: Iterable[str]) -> dict[str, float]:
    """Relative error of each metric; that of a curve is relative to its largest value.

    Raises
    ------
    SimulationError : a metric is missing, or a yes became a no.
    """
    for name, exact in reference.values.items():
        value = run.values.get(name, np.asarray(np.nan))
        if exact.dtype.kind == "b" and not np.array_equal(value, exact):
            raise SimulationError(f"{name} is {value}, with the finest settings {exact}")
    return {name: _error(name, run, reference) for name in names}


def _error(name: str, run: Run, reference: Run) -> float:
    value, exact = run.values.get(name), reference.values[name]
    if value is None or value.shape != exact.shape or not np.isfinite(value).all():
        raise SimulationError(f"has no {name}")
    scale = float(np.abs(exact).max())
    difference = float(np.abs(value.astype(float) - exact.astype(float)).max())
    return difference / scale if scale else (0.0 if difference == 0.0 else np.inf)
