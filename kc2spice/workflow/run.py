"""``run``: simulate a scene, and write the files of the result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from kc2spice.core import __version__
from kc2spice.core.figure import Figure, FileWriter
from kc2spice.core.files import stage_directory
from kc2spice.core.progress import Progress, StageTimer, ignore_progress
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import write_record, write_waveforms
from kc2spice.netlist.printers.plot_script import format_plot_script
from kc2spice.report.matplotlib_figures import write_pngs
from kc2spice.report.probe_figure import plot_probes
from kc2spice.report.run_page import write_run
from kc2spice.scene import noise_analysis
from kc2spice.scene.load import load_scene
from kc2spice.scene.metrics import select_sound_levels
from kc2spice.scene.numerical_settings import describe_plan
from kc2spice.scene.results import NOISE_WAVE
from kc2spice.scene.scene_classes import Scene
from kc2spice.scene.undriven_parts import warn_of_undriven_parts
from kc2spice.sim.ngspice import RetriesFailedError, Simulator, find_ngspice, write_files
from kc2spice.synthesis.ringing_time import warn_of_long_run
from kc2spice.workflow.decks import prepare_deck, protect_other_decks
from kc2spice.workflow.larger_reduced_model_orders import rerun_with_larger_orders, suggest_keys
from kc2spice.workflow.part_models import find_value_units, list_model_values, tabulate_body_modes
from kc2spice.workflow.settings_refinement import ConvergedRun, converge_to_budget
from kc2spice.workflow.simulation import Run, keep_failed_run, simulate_deck


@dataclass(frozen=True)
class CompletedRun:
    """Completed run of a scene, with simulator version and wall time [s] per stage."""

    run: Run
    simulator: Simulator
    wall_s: Mapping[str, float]
    converged: ConvergedRun | None = None

    @cached_property
    def page_contents(self) -> tuple[Figure | FileWriter, ...]:
        """Contents of the result page: figures of probes and parts, and other files."""
        build, waves, units = self.run.build, self.run.waves, self.run.deck.units
        result: list[Figure | FileWriter] = []
        if build.has_noise:
            result += noise_analysis.plot_noise(waves, units[NOISE_WAVE])
        levels = select_sound_levels(build, self.run.metrics)
        result += plot_probes(build.scene.probes, waves, units, levels)
        for part in build.scene.parts.values():
            result += part.type.figures(part, build, waves)
        return tuple(result)

    @property
    def figures(self) -> tuple[Figure, ...]:
        """Charts on the result page of the run."""
        return tuple(item for item in self.page_contents if isinstance(item, Figure))

    @cached_property
    def record(self) -> dict[str, Any]:
        """Content of ``result.json`` without the names of files."""
        run, build, step = self.run, self.run.build, self.run.build.largest_step
        attempts = run.attempts
        record = {
            "scene": build.scene.name,
            "version": __version__,
            "netlist": run.deck.main_file_name,
            "simulator": {
                "name": self.simulator.name,
                "version": self.simulator.version,
                "engine": "shared" if build.sampled_sources else "batch",
                "setting": attempts[-1].setting,
                "attempts": list(map(asdict, attempts)),
            },
            **run.result_record,
            "modes": tabulate_body_modes(build),
            "largest_step": None if step is None else {"s": step.step, "why": step.why},
            "metrics": {k: v for k, v in run.metrics.items() if k not in run.curves},
            "curves": {k: v for k, v in run.metrics.items() if k in run.curves},
            "metric_units": run.units,
            "metric_warnings": run.metric_warnings,
            "metric_resolutions": run.metric_resolutions,
            "metric_scopes": run.metric_scopes,
            "probes": {
                name: {"of": probe.of, "take": probe.take}
                for name, probe in build.scene.probes.items()
            },
            "model_units": {
                name: find_value_units(row) for name, row in list_model_values(build).items()
            },
            "checks": [check.make_record() for check in run.verdict.checks],
            "plan": describe_plan(build),
            "wall_s": self.wall_s,
        }
        if self.converged is not None:
            record["convergence"] = self.converged.make_record()
        return record


def run_scene(
    scene: Scene,
    out: Path,
    progress: Progress = ignore_progress,
    *,
    trust: bool = False,
    deck: Path | None = None,
    keep: bool = False,
    png: bool = False,
) -> dict[str, Any]:
    """Run a scene and write the files of its result.

    Parameters
    ----------
    scene : Scene
        Scene, for example the result of :func:`kc2spice.load_scene`.
    out : Path
        Directory for the output files. Either all output files are written, or none.
    progress : callable, optional
        Called as ``progress(stage, done, text)`` during the run.
    trust : bool, default False
        Whether netlists that the scene includes may run commands and write files.
    deck : Path, optional
        Netlist of the scene that was edited by hand. The edited netlist is simulated instead of the
        deck of the scene.
    keep : bool, default False
        Whether to keep the raw file and the log of the simulator.
    png : bool, default False
        Whether to write the figures of the report also as PNG files.

    Returns
    -------
    dict[str, Any]
        Content of ``result.json``, in SI units.

    Raises
    ------
    UsageError : ``deck`` does not save the vectors of the scene's metrics.
    MissingToolError : ngspice is missing, which is checked before finite elements are computed.
    SimulationError : a stage of the run failed, and nothing was written to ``out``. The deck and
        its log are kept in ``<out>.failed`` until a run with the same ``out`` succeeds.

    Examples
    --------
    >>> lamp = {
    ...     "name": "lamp",
    ...     "drive": {"part": "source", "dc": "12 V"},
    ...     "lamp": {"part": "resistor", "resistance": "6 Ohm", "pins": {"a": "drive.out"}},
    ...     "analysis": {"type": "op"},
    ...     "probes": {"current_a": {"of": "lamp.i"}},
    ... }
    >>> record = run_scene(load_scene(lamp), Path("lamp"))
    >>> print(f"{record['metrics']['current_a']:.4f} A")
    2.0000 A
    >>> Path("lamp/result.json").is_file()
    True
    """
    clock = StageTimer(progress)
    with stage_directory(out) as work:
        done = complete_run(scene, work, clock, out=out, trust=trust, deck=deck)
        return write_run_files(done, work, clock, keep=keep, png=png)


def complete_run(
    scene: Scene,
    work: Path,
    clock: StageTimer,
    *,
    out: Path | None = None,
    trust: bool = False,
    deck: Path | None = None,
    functions: Mapping[str, Any] | None = None,
) -> CompletedRun:
    """Build, reduce, export and simulate a scene, and return the completed run.

    The directory ``work`` contains the files of the run. ``functions`` are the Python functions of
    controllers, keyed by part. ``out`` is the directory of the result. The files of a failed run
    are kept in ``<out>.failed``.

    A key without a value in the scene, such as the number of contact rings, has an automatic value.
    If an automatic value is too small, the scene runs again with a larger value, and a warning
    states the new value. The scene also runs again with more states for each reduced body whose
    error under the recorded loads is too large.

    Raises the errors of :func:`run_scene`. A warning is printed for each violated check that does
    not fail the run.
    """
    simulator, automatic = find_ngspice(), dict[str, Any]()
    with keep_failed_run(work, out, scene.name):
        while True:
            build, prepared_deck = prepare_deck(
                scene, clock, trust=trust, functions=functions, edited=deck
            )
            if out is not None:
                protect_other_decks(out, prepared_deck.files)
            warn_of_long_run(build, prepared_deck)
            try:
                with clock.time_stage("simulate", f"{simulator.name} {simulator.version}") as share:
                    result = simulate_deck(build, prepared_deck, work, progress=share)
                break
            except RetriesFailedError as error:
                suggested = suggest_keys(error, automatic) if deck is None else {}
                if not suggested:
                    raise
                keys = ", ".join(f"{key} = {value}" for key, value in suggested.items())
                warn_user(f"{error.message}, {error.got}; the run is repeated with {keys}")
                automatic |= suggested
                scene = load_scene(scene, suggested)
        # with an error budget, `converge_to_budget` instead changes the orders of reduced models
        if deck is None and scene.error_budget is None:
            result = rerun_with_larger_orders(result, work, clock)
        converged = converge_to_budget(result, clock) if deck is None else None
        if converged is not None:
            result = converged.run
    warn_of_undriven_parts(result.build, result.waves)
    for check in result.verdict.checks:
        if not check.passed:
            warn_user(check.violation)
    return CompletedRun(result, simulator, clock.wall_s, converged)


def write_run_files(
    done: CompletedRun, work: Path, clock: StageTimer, *, keep: bool = False, png: bool = False
) -> dict[str, Any]:
    """Write all files of a run, and return the content of ``result.json``.

    ``work`` is the directory of the files.
    """
    scene, deck, waves = done.run.build.scene, done.run.deck, done.run.waves
    with clock.time_stage("report", "metrics and page"):
        record = dict(done.record)
        record["wall_s"] = clock.wall_s
        texts = deck.files | format_plot_script(deck)
        write_files(texts, work)
        files, figures = [*sorted(texts), *write_waveforms(waves, deck.units, work)], done.figures
        for item in done.page_contents:
            if isinstance(item, FileWriter):
                item.write(work / item.name)
                files.append(item.name)
        files += write_pngs(work, figures) if png else []
    spare = [work / f"{scene.name}.raw", *work.glob(f"{scene.name}*.log")]
    files += [path.name for path in spare if keep and path.exists()]
    record["files"] = [*files, "report.html", "result.json"]
    write_run(work / "report.html", record, scene, figures)
    result = write_record(record, work)
    for path in spare if not keep else ():
        path.unlink(missing_ok=True)
    return result
