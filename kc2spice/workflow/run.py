"""``run``: build, reduce, write, simulate, measure, plot."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

from kc2spice.core import __version__
from kc2spice.core.figure import Figure, Written
from kc2spice.core.files import staged
from kc2spice.core.progress import Clock, Progress, silent
from kc2spice.netlist.lint import lint
from kc2spice.netlist.printers.ngspice import plot_script
from kc2spice.report.figures import draw_all
from kc2spice.report.run_page import probe_figures, write_run
from kc2spice.scene.judge import require
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.sim.ngspice import Outcome, RetriesFailedError, Simulator, find_ngspice, write_files
from kc2spice.workflow import meters
from kc2spice.workflow.decks import edited_deck, make_deck
from kc2spice.workflow.judge import metrics, probe_units
from kc2spice.workflow.models import build_models, mode_tables, model_facts, rom_facts
from kc2spice.workflow.refine import Converged, converge
from kc2spice.workflow.simulate import (
    kept_on_failure,
    plain,
    simulate,
    warn_of,
    write_record,
    write_waveforms,
)


@dataclass(frozen=True)
class Completed:
    """A finished simulation of a scene: models, simulator, waveforms and verdict, times."""

    build: Build
    simulator: Simulator
    outcome: Outcome
    clock: Clock
    converged: Converged | None = None

    @cached_property
    def shown(self) -> tuple[Figure | Written, ...]:
        """What its probes and parts show of it, and further files."""
        build, waves = self.build, self.outcome.waves
        units = self.outcome.deck.units
        found: list[Figure | Written] = []
        if build.noisy:
            found += meters.figures(waves, units[meters.WAVE])
        found += probe_figures(build.scene.probes, waves, units)
        for part in build.scene.parts.values():
            found += part.type.figures(part, build, waves)
        return tuple(found)

    @property
    def figures(self) -> tuple[Figure, ...]:
        """What is shown."""
        return tuple(each for each in self.shown if isinstance(each, Figure))

    @cached_property
    def record(self) -> dict[str, Any]:
        """``result.json`` without the names of files."""
        build, outcome, step = self.build, self.outcome, self.build.largest
        waves, attempts, found = outcome.waves, outcome.attempts, outcome.verdict
        record = {
            "scene": build.scene.name,
            "version": __version__,
            "netlist": outcome.deck.main,
            "simulator": {
                "name": self.simulator.name,
                "version": self.simulator.version,
                "engine": "batch",
                "setting": attempts[-1].setting,
                "attempts": [asdict(attempt) for attempt in attempts],
            },
            "model": model_facts(build),
            **rom_facts(build),
            "modes": mode_tables(build),
            # a sweep or an operating point has no time points
            "steps": {name: int(waves.stats.get(name, 0)) for name in ("accepted", "rejected")},
            "largest_step": None if step is None else {"s": step.step, "why": step.why},
            "simulator_cpu_s": waves.stats.get("cpu_s"),
            "metrics": metrics(waves, build),
            "metric_units": probe_units(build.scene.probes, waves, outcome.deck.units),
            "checks": [check.record() for check in found.checks],
            "energy_j": {name: balance.entries for name, balance in found.balances},
            "plan": asdict(build.plan),
            "wall_s": self.clock.wall_s,
        }
        if self.converged is not None:
            record["convergence"] = self.converged.record()
        return record


def run(
    scene: Scene,
    out: Path,
    progress: Progress = silent,
    *,
    trust: bool = False,
    deck: Path | None = None,
    keep: bool = False,
    png: bool = False,
) -> dict[str, Any]:
    """Run ``scene`` and write the contract's files into ``out``; return ``result.json``.

    ``trust`` lets included netlists act on the machine; ``deck`` is a netlist of this scene that
    somebody edited, to be run instead of the scene's own; ``keep`` keeps raw file and log; ``png``
    draws the report's figures as files too.

    Raises
    ------
    UsageError : ``deck`` does not save what the scene's metrics need.
    MissingToolError : no ngspice; noticed before any FE is computed.
    SimulationError : a stage failed. Nothing was written to ``out``; the deck and its log are kept
        beside it in ``<out>.failed`` until a run into ``out`` succeeds.
    """
    with staged(out) as work:
        with kept_on_failure(work, out, scene.name):
            done = complete(scene, work, progress, trust=trust, deck=deck)
        return write_run_files(done, work, keep=keep, png=png)


def complete(
    scene: Scene,
    work: Path,
    progress: Progress = silent,
    *,
    trust: bool = False,
    deck: Path | None = None,
    functions: Mapping[str, Any] | None = None,
) -> Completed:
    """Build, reduce, export and simulate ``scene`` in the directory ``work``.

    ``functions`` are those of controllers, by part.

    Where the scene leaves a key to us and what we took for it proves too little, such as the rings
    that a contact needs, it runs again with more, and says so.

    Raises as :func:`run` does; warns of checks that fail without failing the run.
    """
    simulator = find_ngspice()
    clock = Clock(progress)
    while True:
        build = build_models(scene, clock, trust=trust, functions=functions)
        with clock.stage("export", "netlists"):
            chosen = make_deck(build)
            if deck is not None:
                chosen, build = edited_deck(build, chosen, deck)
            lint(chosen)  # wrong wiring is named with file and line before a simulator sees it
            write_files(chosen.files, work)
        try:
            with clock.stage("simulate", f"{simulator.name} {simulator.version}") as share:
                outcome = simulate(build, chosen, work, progress=share)
            break
        except RetriesFailedError as error:
            if deck is not None or not error.mends:
                raise
            told = ", ".join(f"{key} = {value}" for key, value in error.mends.items())
            warnings.warn(f"{error.message}, {error.got}: run again with {told}", stacklevel=2)
            scene = load_scene(scene, error.mends)
    converged = None
    if deck is None:
        build, outcome, converged = _judged(build, outcome, clock, work)
    warn_of(outcome.verdict.checks)
    return Completed(build, simulator, outcome, clock, converged)


def _judged(
    build: Build, outcome: Outcome, clock: Clock, work: Path
) -> tuple[Build, Outcome, Converged | None]:
    """The run that holds the error budget, with the check of its estimate."""
    found = converge(build, outcome, clock)
    if found is None:
        return build, outcome, None
    taken = found.taken
    if taken.settings:
        told = ", ".join(taken.settings)
        warnings.warn(
            f"error_budget {found.check.limit:g}: finer {told}; the deck and models are those",
            stacklevel=2,
        )
        write_files(taken.run.outcome.deck.files, work)
    require((found.check,), build.scene.name)
    build, outcome = taken.run.build, taken.run.outcome
    verdict = replace(outcome.verdict, checks=(*outcome.verdict.checks, found.check))
    return build, replace(outcome, verdict=verdict), found


def write_run_files(
    done: Completed, work: Path, *, keep: bool = False, png: bool = False
) -> dict[str, Any]:
    """Write all files of a run into ``work``, where the deck is already; return ``result.json``."""
    scene, deck, waves = done.build.scene, done.outcome.deck, done.outcome.waves
    with done.clock.stage("report", "metrics and page"):
        record, shown = dict(done.record), done.figures
        script = plot_script(deck)
        write_files(script, work)
        files = [*sorted(deck.files | script), *write_waveforms(waves, deck.units, work)]
        for each in done.shown:
            if isinstance(each, Written):
                each.write(work / each.name)
                files.append(each.name)
        files += draw_all(work, shown) if png else []
    spare = [work / f"{scene.name}.raw", *work.glob(f"{scene.name}*.log")]
    files += [path.name for path in spare if keep and path.exists()]
    record["files"] = [*files, "report.html", "result.json"]
    write_run(work / "report.html", record, scene, shown)
    write_record(record, work)
    for path in spare if not keep else ():
        path.unlink(missing_ok=True)
    return cast(dict[str, Any], plain(record))
