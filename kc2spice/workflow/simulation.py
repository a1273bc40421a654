"""Simulation of one deck: retries, checks, metrics, and the files of a failed run."""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import chain, count, filterfalse
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveforms, save_arrays, write_record
from kc2spice.equations.scene_laws import SceneLaws, get_scene_laws
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.power_waveforms import add_powers
from kc2spice.report.html import flatten_mapping
from kc2spice.scene.checks import Verdict
from kc2spice.scene.metrics import compute_metrics
from kc2spice.scene.scene_classes import BuiltScene
from kc2spice.sim.engines import Engine
from kc2spice.sim.ngspice import (
    ProgressCallback,
    RetriesFailedError,
    RunOutcome,
    run_with_retries,
    write_files,
)
from kc2spice.workflow.operating_point import OperatingPoint, find_operating_point
from kc2spice.workflow.part_models import collect_rom_values, list_model_values
from kc2spice.workflow.verdict import form_verdict

PARTIAL_WAVES_FILE = "waveforms.partial.npz"
FAILURE_FILE = "failure.json"


@dataclass(frozen=True)
class Run(RunOutcome):
    """Simulation of a scene: models, deck, waveforms, verdict, attempts and metrics.

    ``units`` are the SI units of metrics by dotted name, for metrics with a unit.
    ``metric_warnings`` are the warnings of metrics by dotted name, for metrics with a warning.
    ``metric_resolutions`` are the resolutions of metrics, such as a pull-in voltage, whose exact
    values lie between two points of a sweep.
    ``curves`` are the names of metrics that are arrays over the frequency.
    ``metric_scopes`` contains the name of the part for each metric that describes this part alone,
    without the circuit around it.
    ``cpu_s`` is the CPU time [s] of the simulator including all retries.
    """

    build: BuiltScene
    metrics: Mapping[str, Any]
    units: Mapping[str, str]
    metric_warnings: Mapping[str, str]
    metric_resolutions: Mapping[str, float]
    curves: Collection[str]
    metric_scopes: Mapping[str, str]
    cpu_s: float
    point: OperatingPoint

    @cached_property
    def values(self) -> dict[str, np.ndarray]:
        """Numeric metrics and arrays, keyed by dotted name; missing values are NaN."""
        result = {}
        for name, item in flatten_mapping(self.metrics):
            value = np.asarray(np.nan if item is None else item)
            if value.dtype.kind in "bif":
                result[name] = value
        return result

    @property
    def is_small_signal(self) -> bool:
        """Whether the metrics belong to a response to small signals."""
        return self.build.scene.analysis.is_small_signal

    @property
    def result_record(self) -> dict[str, Any]:
        """Content of ``result.json`` about models, simulator statistics and energies."""
        stats = self.waves.stats
        return {
            "model": list_model_values(self.build),
            **collect_rom_values(self.build),
            # a sweep or an operating point has no time points
            "steps": {name: int(stats.get(name, 0)) for name in ("accepted", "rejected")},
            "simulator_cpu_s": stats.get("cpu_s"),
            "operating_point": {
                name: {"value": value, "unit": self.point.units[name]}
                for name, value in self.point.values.items()
            },
            "energy_j": {name: balance.entries for name, balance in self.verdict.balances},
        }


def simulate_deck(
    build: BuiltScene,
    deck: Deck,
    directory: Path,
    *,
    progress: ProgressCallback = None,
    timeout: float | None = None,
    retries: int | None = None,
) -> Run:
    """Simulate a deck, with retries after failures, and check the result.

    The parts of the scene define the checks. If the wiring of an edited deck differs from the
    scene, a warning is printed.

    Parameters
    ----------
    build : BuiltScene
        Scene with the models of its parts.
    deck : Deck
        Netlist of the scene with its libraries.
    directory : Path
        Existing directory for the files of the deck and of the simulator.
    progress : callable, optional
        Called with the completed fraction of the transient, between 0 and 1.
    timeout : float, optional
        Largest wall-clock time of one attempt in s. By default there is no limit.
    retries : int, optional
        Largest number of further attempts after a failed attempt. The default number of further
        attempts is ``solver.retries`` of the scene.

    Returns
    -------
    Run
        Waves, metrics and checks, in SI units.

    Raises
    ------
    RetriesFailedError : the last attempt failed.
    SimulationError : ngspice failed, and other settings cannot prevent the failure.
    MissingToolError : ngspice is missing.

    Examples
    --------
    >>> from kc2spice.core.progress import StageTimer
    >>> from kc2spice.scene.load import load_scene
    >>> from kc2spice.workflow.decks import prepare_deck
    >>> lamp = {
    ...     "name": "lamp",
    ...     "drive": {"part": "source", "dc": "12 V"},
    ...     "lamp": {"part": "resistor", "resistance": "6 Ohm", "pins": {"a": "drive.out"}},
    ...     "analysis": {"type": "op"},
    ...     "probes": {"current_a": {"of": "lamp.i"}},
    ... }
    >>> build, deck = prepare_deck(load_scene(lamp), StageTimer())
    >>> run = simulate_deck(build, deck, Path())
    >>> print(f"{run.metrics['current_a']:.4f} {run.units['current_a']}")
    2.0000 A
    """

    def check_waves(waves: Waveforms) -> Verdict:
        """Return the verdict on waveforms: checks, energy balances and error limits."""
        result = form_verdict(waves, build)
        result = replace(result, checks=(*result.checks, *point.list_checks(build, waves)))
        if deck.text is None:
            return result
        checks = (replace(c, action="warn") if c.wiring else c for c in result.checks)
        return replace(result, checks=tuple(checks))

    laws = get_scene_laws(build)
    engine = choose_engine(laws, deck, directory, progress, timeout)
    point = find_operating_point(build, deck, laws)
    write_files(deck.files, directory)  # the netlists are written even if the simulation fails
    shared = bool(build.sampled_sources)
    begin = measure_simulator_cpu(shared=shared)
    result = run_with_retries(
        deck,
        directory,
        engine.run,
        retries=build.scene.solver.retries if retries is None else retries,
        judge=check_waves,
    )
    if build.functions and len(result.attempts) > 1:
        names = ", ".join(build.functions)
        message = f"the simulation was repeated, and called the functions {names} again from "
        message += "time 0; a function must reset its stored values at time 0"
        warn_user(message)
    used = measure_simulator_cpu(shared=shared) - begin
    waves = correct_waves(result.waves, build)
    waves = add_powers(waves, deck.powers)
    results = compute_metrics(waves, build)
    return Run(
        deck=result.deck,
        waves=waves,
        verdict=result.verdict,
        attempts=result.attempts,
        build=build,
        metrics=results.values,
        units=results.units,
        metric_warnings=results.warnings,
        metric_resolutions=results.resolutions,
        curves=results.curves,
        metric_scopes=results.scopes,
        cpu_s=used,
        point=point,
    )


def correct_waves(waves: Waveforms, build: BuiltScene) -> Waveforms:
    """Return the waveforms, with the corrections that parts make after a run."""
    result = dict(waves.data)
    for part in build.scene.parts.values():
        result |= part.type.corrected_waves(part, build, waves)
    return replace(waves, data=result)


def run_simulation(
    build: BuiltScene,
    deck: Deck,
    directory: Path,
    progress: ProgressCallback = None,
    timeout: float | None = None,
) -> Waveforms:
    """Run a deck in ngspice, and return the waveforms in SI units.

    ``directory`` contains the files of the run. Raises the errors of
    :meth:`kc2spice.sim.engines.Engine.run`.
    """
    return choose_engine(get_scene_laws(build), deck, directory, progress, timeout).run(deck)


def choose_engine(
    laws: SceneLaws,
    deck: Deck,
    directory: Path,
    progress: ProgressCallback = None,
    timeout: float | None = None,
) -> Engine:
    """Choose the engine that runs a deck of a scene.

    ``laws`` are the equations of the scene. For a small-signal scene, the engine also runs analyses
    with closely spaced frequencies near resonances. Each analysis is a separate run if the
    operating point can depend on the previous analysis. If Python functions set sources during the
    simulation, ngspice runs as a library.
    """
    if not laws.build.scene.analysis.is_small_signal:
        return Engine(directory, progress, timeout, sampled=laws.build.sampled_sources)
    # imported here, because the module loads scipy
    from kc2spice.workflow.resonances import list_refined_analyses

    refinements = list_refined_analyses(deck.command, laws)
    from_rest = deck.text is not None or not laws.is_linear
    return Engine(directory, progress, timeout, refinements=refinements, from_rest=from_rest)


def measure_simulator_cpu(*, shared: bool) -> float:
    """Return the CPU time [s] that simulators have used so far.

    By default, the result is the CPU time of all child processes that have ended. If the simulator
    is a ``shared`` library, the result is the CPU time of this process. On systems without CPU
    times of child processes, the result is the wall time.
    """
    try:
        import resource
    except ImportError:
        return time.perf_counter()
    who = resource.RUSAGE_SELF if shared else resource.RUSAGE_CHILDREN
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


@contextmanager
def keep_failed_run(work: Path, out: Path | None, scene: str) -> Iterator[None]:
    """Keep deck, logs and partial waveforms of a failed run in ``<out>.failed``.

    If a run leaves the valid range of a model, no files are kept, because the error message already
    names the key to change.
    """
    folder = None if out is None else _choose_failure_folder(Path(out).absolute())
    try:
        yield
    except SimulationError as error:
        violated = error.violated if isinstance(error, RetriesFailedError) else ()
        if folder is not None and not any(check.accepted for check in violated):
            # an error due to a full disk must not replace the error of the run
            with contextlib.suppress(OSError):
                shutil.rmtree(folder, ignore_errors=True)
                shutil.copytree(work, folder)
                _write_failure(error, folder, scene)
                error.where = error.where and error.where.replace(str(work), str(folder))
        raise
    if folder is not None and (folder / FAILURE_FILE).is_file():
        shutil.rmtree(folder, ignore_errors=True)


def _choose_failure_folder(out: Path) -> Path:
    """Return a folder ``<out>.failed`` that is free or contains an earlier failed run."""
    name = f"{out.name}.failed"
    numbers = chain([""], count(2))  # folders with other content are never replaced
    folders = (out.with_name(f"{name}{number}") for number in numbers)
    return next(filterfalse(_has_other_content, folders))


def _has_other_content(folder: Path) -> bool:
    """Return whether a path exists and is not the folder of an earlier failed run."""
    is_failed_run = (folder / FAILURE_FILE).is_file() and not folder.is_symlink()
    return os.path.lexists(folder) and not is_failed_run


def _write_failure(error: SimulationError, folder: Path, scene: str) -> None:
    """Write ``failure.json``, the record of a failed run, and its partial waveforms."""
    record: dict[str, object] = {"scene": scene, "partial": True, "error": error.message}
    record |= {"got": error.got, "next": error.hint, "waveforms": None, "attempts": []}
    if isinstance(error, RetriesFailedError):
        failure = error.failure
        record["attempts"] = list(map(asdict, error.attempts))
        if failure is not None:
            record |= {"node": failure.node, "time_s": failure.time, "part": failure.part}
        if failure is not None and failure.partial is not None:
            save_arrays(failure.partial, folder / PARTIAL_WAVES_FILE)
            record |= {
                "waveforms": PARTIAL_WAVES_FILE,
                "last_point": float(failure.partial.scale[-1]),
            }
    write_record(record, folder, FAILURE_FILE)
