"""``run`` and ``export``: build, reduce, write, simulate, measure, plot."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

import kc2spice
from kc2spice.core.errors import UsageError
from kc2spice.core.files import staged
from kc2spice.core.progress import Clock, Progress, silent
from kc2spice.fem.magnetics import table as emtable
from kc2spice.report.easel import Easel
from kc2spice.report.figures import model_figures, run_figures
from kc2spice.report.metrics import metrics
from kc2spice.report.run_page import write_run
from kc2spice.rom.model import ResonatorModel
from kc2spice.scene.plan import plan
from kc2spice.scene.schema import Scene
from kc2spice.sim.ladder import Climb
from kc2spice.sim.ngspice import Simulator, find_ngspice, write_deck, write_files
from kc2spice.spice.circuit import Deck
from kc2spice.spice.dialect import DIALECTS, dialect_files
from kc2spice.spice.lint import lint
from kc2spice.spice.symbol import symbol_files
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.models import Models, build_models, model_facts
from kc2spice.workflow.results import plain, write_record, write_waveforms
from kc2spice.workflow.simulate import kept_on_failure, simulate, warn_of


def run(
    scene: Scene, out: Path, progress: Progress = silent, *, trust: bool = False
) -> dict[str, Any]:
    """Run ``scene`` and write the contract's files into ``out``; return ``result.json``.

    ``trust`` lets included netlists act on the machine.

    Raises
    ------
    MissingToolError : no ngspice; noticed before any FE is computed.
    SimulationError : a stage failed. Nothing was written to ``out``; the deck and its log are kept
        beside it in ``<out>.failed``.
    """
    simulator = find_ngspice()
    clock = Clock(progress)
    # Drawing, and loading what draws, need not wait for the simulator, nor it for them.
    with Easel() as easel, staged(out) as work:
        models = build_models(scene, clock)
        known = easel.draw(model_figures, work, scene, models.table)
        with clock.stage("export", "netlists"):
            deck = _linted(scene, models, trust)
            write_deck(deck, work)
        simulating = clock.stage("simulate", f"{simulator.name} {simulator.version}")
        kept = kept_on_failure(work, out, scene.name)
        with simulating as share, kept:
            climbed = simulate(scene, models, deck, work, progress=share)
        deck, waves = climbed.deck, climbed.waves
        warn_of(climbed.truth.checks)
        with clock.stage("report", "metrics, plots and page"):
            drawn = easel.draw(run_figures, work, scene, waves)
            record = _record(scene, models, simulator, climbed, clock)
            files = [*sorted(deck.files), *write_waveforms(waves, work)]
            if models.table is not None:
                emtable.save(models.table, work / "em_table.npz")
                files.append("em_table.npz")
            pictures = [*drawn.result(), *known.result()]
            files += [picture.path.name for picture in pictures]
        record["files"] = [*files, "report.html", "result.json"]
        write_run(work / "report.html", record, scene, pictures)
        write_record(record, work)
        for spare in (work / f"{scene.name}.raw", *work.glob(f"{scene.name}*.log")):
            spare.unlink(missing_ok=True)
    return cast(dict[str, Any], plain(record))


def export(
    scene: Scene,
    out: Path,
    dialect: str = "ngspice",
    progress: Progress = silent,
    *,
    trust: bool = False,
) -> list[Path]:
    """Write netlists and symbols of ``scene`` into ``out`` without simulating.

    Returns the paths of the files. ``trust`` lets included netlists act on the machine.

    Raises
    ------
    UsageError : an unknown dialect, or one that cannot say what the scene needs.
    """
    if dialect not in DIALECTS:
        raise UsageError(
            "unknown dialect", where="--dialect", got=dialect, expected=", ".join(DIALECTS)
        )
    clock = Clock(progress)
    with staged(out) as work:
        models = build_models(scene, clock)
        with clock.stage("export", "netlists and symbols"):
            deck = _linted(scene, models, trust)
            files = dialect_files(deck, deck.parts, dialect) | symbol_files(deck, dialect)
            write_files(files, work)
    return [Path(out) / name for name in sorted(files)]


def _linted(scene: Scene, models: Models, trust: bool) -> Deck:
    """The scene's deck; wrong wiring is named with file and line before a simulator sees it."""
    deck = make_deck(scene, models, trust=trust)
    lint(deck)
    return deck


def _record(
    scene: Scene,
    models: Models,
    simulator: Simulator,
    climbed: Climb,
    clock: Clock,
) -> dict[str, Any]:
    waves, attempts, truth = climbed.waves, climbed.attempts, climbed.truth
    record: dict[str, Any] = {
        "scene": scene.name,
        "version": kc2spice.__version__,
        "netlist": climbed.deck.main,
        "simulator": {
            "name": simulator.name,
            "version": simulator.version,
            "engine": "batch",
            "rung": attempts[-1].rung,
            "attempts": [attempt.record() for attempt in attempts],
        },
        "model": model_facts(models),
    }
    if models.kick is not None:
        record["rom"] = _rom(models.kick.resonators)
    record |= {
        # a sweep or an operating point has no time points
        "steps": {name: int(waves.stats.get(name, 0)) for name in ("accepted", "rejected")},
        "simulator_cpu_s": waves.stats.get("cpu_s"),
        "metrics": metrics(waves, scene),
        "checks": [check.record() for check in truth.checks],
        "energy_j": {name: book.entries for name, book in truth.books},
        "plan": asdict(plan(scene)),
        "wall_s": clock.wall_s,
    }
    return record


def _rom(model: ResonatorModel) -> dict[str, Any]:
    certificate = model.certificate
    return {
        "order": model.order,
        "ports": [port.name for port in model.ports],
        "band_hz": list(certificate.band_hz),
        "error_estimate": certificate.error_estimate,
        "method": certificate.method,
        "stable": certificate.stable,
        "passive": certificate.passive,
    }
