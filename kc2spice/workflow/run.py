"""``run`` and ``export``: build, reduce, write, simulate, measure, plot."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

import kc2spice
from kc2spice.core.errors import UsageError
from kc2spice.core.figure import Figure
from kc2spice.core.files import staged
from kc2spice.core.progress import Clock, Progress, silent
from kc2spice.core.waveforms import Waveforms
from kc2spice.report.figures import draw_all
from kc2spice.report.plots import Picture
from kc2spice.report.plotworker import PlotWorker, share
from kc2spice.report.run_page import write_run
from kc2spice.scene.judge import Check, require
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.scene.plan import plan
from kc2spice.sim.ngspice import Simulator, find_ngspice, write_files
from kc2spice.sim.retries import Outcome, RetriesFailedError
from kc2spice.spice.array import array_deck
from kc2spice.spice.deck import Deck
from kc2spice.spice.dialect import DECKS, DIALECTS, dialect_files
from kc2spice.spice.lint import lint
from kc2spice.spice.plotscript import plot_script
from kc2spice.spice.symbol import symbol_files
from kc2spice.workflow.decks import edited_deck, make_deck
from kc2spice.workflow.judge import metrics
from kc2spice.workflow.models import build_models, model_facts, rom_facts
from kc2spice.workflow.results import plain, write_record, write_waveforms
from kc2spice.workflow.richer import NAME, Closer, closer_run, estimated
from kc2spice.workflow.simulate import kept_on_failure, simulate, warn_of


@dataclass(frozen=True)
class Completed:
    """A finished simulation of a scene: models, simulator, waveforms and verdict, times."""

    build: Build
    simulator: Simulator
    outcome: Outcome
    clock: Clock

    @property
    def figures(self) -> tuple[Figure, ...]:
        """What the parts show of it."""
        return run_figures(self.build, self.outcome.waves)


def run(
    scene: Scene,
    out: Path,
    progress: Progress = silent,
    *,
    plots: PlotWorker | None = None,
    trust: bool = False,
    deck: Path | None = None,
    keep: bool = False,
) -> dict[str, Any]:
    """Run ``scene`` and write the contract's files into ``out``; return ``result.json``.

    ``plots`` draws if it has been started already. ``trust`` lets included netlists act on the
    machine; ``deck`` is a netlist of this scene that somebody edited, to be run instead of the
    scene's own; ``keep`` keeps raw file and log.

    Raises
    ------
    UsageError : ``deck`` does not save what the scene's metrics need.
    MissingToolError : no ngspice; noticed before any FE is computed.
    SimulationError : a stage failed. Nothing was written to ``out``; the deck and its log are kept
        beside it in ``<out>.failed``.
    """
    # Loading what draws need not wait for the simulator, nor it for that.
    worker = PlotWorker() if plots is None else nullcontext(plots)
    with worker as pens, staged(out) as work:
        with kept_on_failure(work, out, scene.name):
            done = complete(scene, work, progress, trust=trust, deck=deck, ahead=True)
        return write_run_files(
            done, work, lambda figures: pens.draw(share, draw_all, work, figures).result, keep=keep
        )


def complete(
    scene: Scene,
    work: Path,
    progress: Progress = silent,
    *,
    trust: bool = False,
    deck: Path | None = None,
    functions: Mapping[str, Any] | None = None,
    ahead: bool = False,
) -> Completed:
    """Build, reduce, export and simulate ``scene`` in the directory ``work``.

    ``functions`` are those of controllers, by part; ``ahead`` is that of :func:`build_models`.

    Where the scene leaves a key to us and what we took for it proves too little, such as the rings
    that a contact needs, it runs again with more, and says so.

    Raises as :func:`run` does; warns of checks that fail without failing the run.
    """
    simulator = find_ngspice()
    clock = Clock(progress)
    while True:
        build = build_models(scene, clock, trust=trust, functions=functions, ahead=ahead)
        with clock.stage("export", "netlists"):
            chosen = make_deck(build) if deck is None else edited_deck(build, deck)
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
    if deck is None:
        build, outcome = _judged(build, outcome, clock, work)
    warn_of(outcome.verdict.checks)
    return Completed(build, simulator, outcome, clock)


def _judged(build: Build, outcome: Outcome, clock: Clock, work: Path) -> tuple[Build, Outcome]:
    """A run with the check of a closer one, where something asks for it; and that run instead where
    the first is beyond the error budget."""
    found = closer_run(build, outcome, clock)
    if found is None:
        return build, outcome
    check = found if isinstance(found, Check) else found.check
    budget = build.scene.error_budget
    if isinstance(found, Closer) and budget is not None and not check.passed:
        warnings.warn(
            f"{check.name} {check.value:.2g} with the settings of error_budget {budget:g}: "
            "the closer run is the result, its deck and models are written",
            stacklevel=2,
        )
        build, outcome = found.build, found.outcome
        check = found.own
        write_files(outcome.deck.files, work)
    require((check,), build.scene.name)
    verdict = replace(outcome.verdict, checks=(*outcome.verdict.checks, check))
    return build, replace(outcome, verdict=verdict)


def write_run_files(
    done: Completed,
    work: Path,
    draw: Callable[[tuple[Figure, ...]], Callable[[], list[Picture]]],
    *,
    keep: bool = False,
) -> dict[str, Any]:
    """Write all files of a run into ``work``, where the deck is already; return ``result.json``.

    ``draw`` begins to draw figures and returns what waits for the pictures.
    """
    scene, deck, waves = done.build.scene, done.outcome.deck, done.outcome.waves
    with done.clock.stage("report", "metrics, plots and page"):
        shown = done.figures
        drawn = draw(shown)
        record = run_record(done)
        script = plot_script(deck)
        write_files(script, work)
        files = [*sorted(deck.files | script), *write_waveforms(waves, deck.units, work)]
        files += [*_arrays(done.build, work), *_own_files(done.build, waves, work)]
        figures = {figure.name: figure for figure in shown}
        pictures = [replace(p, figure=figures.get(p.path.stem)) for p in _pictures(drawn)]
        files += [picture.path.name for picture in pictures]
    record["wall_s"] = done.clock.wall_s
    spare = [work / f"{scene.name}.raw", *work.glob(f"{scene.name}*.log")]
    files += [path.name for path in spare if keep and path.exists()]
    record["files"] = [*files, "report.html", "result.json"]
    write_run(work / "report.html", record, scene, pictures)
    write_record(record, work)
    for path in spare if not keep else ():
        path.unlink(missing_ok=True)
    return cast(dict[str, Any], plain(record))


def run_figures(build: Build, waves: Waveforms) -> tuple[Figure, ...]:
    """What the parts of a scene show of a run."""
    parts = build.scene.parts.values()
    return tuple(figure for part in parts for figure in part.type.figures(part, build, waves))


def _pictures(drawn: Callable[[], list[Picture]]) -> list[Picture]:
    """The pictures, or none and a warning: what was computed is worth more than its plots."""
    try:
        return drawn()
    except Exception as error:
        reason = f"{type(error).__name__}: {error}".splitlines()[0]
        warnings.warn(f"no plots: {reason}", stacklevel=2)
        return []


def _arrays(build: Build, directory: Path) -> list[str]:
    """Write the parts' tables, and return the names of the files."""
    names = []
    for part in build.scene.parts.values():
        for name, arrays in part.type.arrays(part, build).items():
            np.savez_compressed(directory / name, **arrays)
            names.append(name)
    return names


def _own_files(build: Build, waves: Waveforms, directory: Path) -> list[str]:
    """What the parts write themselves, as fields of bodies."""
    parts = build.scene.parts.values()
    return [name for part in parts for name in part.type.write(part, build, waves, directory)]


def export(
    scene: Scene,
    out: Path,
    dialect: str = "ngspice",
    progress: Progress = silent,
    *,
    trust: bool = False,
    count: int | None = None,
) -> list[Path]:
    """Write netlists and symbols of ``scene`` into ``out`` without simulating.

    Returns the paths of the files. ``trust`` lets included netlists act on the machine. With
    ``count`` the deck has so many copies of the scene, and there are no symbols.

    Raises
    ------
    UsageError : an unknown dialect, or one that cannot say what the scene needs.
    """
    known = DIALECTS if count is None else DECKS
    if dialect not in known:
        raise UsageError(
            "unknown dialect" if count is None else "no array of copies in this dialect",
            where="--dialect", got=dialect, expected=", ".join(known),
        )  # fmt: skip
    clock = Clock(progress)
    with staged(out) as work:
        build = build_models(scene, clock, trust=trust, ahead=True)
        with clock.stage("export", "netlists and symbols"):
            deck = _linted(build)
            if count is not None:
                deck = array_deck(deck, count)
            files = dict(dialect_files(deck, deck.parts, dialect))
            files |= plot_script(deck) if dialect == "ngspice" else {}
            files |= symbol_files(deck, dialect) if count is None else {}
            _spare_other_decks(Path(out), files)
            write_files(files, work)
    return [Path(out) / name for name in sorted(files)]


def _spare_other_decks(out: Path, files: Mapping[str, str]) -> None:
    """Refuse to take subcircuits from another deck in ``out``: it would run no more."""
    for deck in sorted(out.glob("*.cir")) if out.is_dir() else ():
        text = deck.read_text(encoding="utf-8", errors="replace")
        for name in re.findall(r"(?im)^\.include\s+(\S+)", "" if deck.name in files else text):
            library = out / name
            if name in files and library.is_file():
                lost = _defined(library.read_text(errors="replace")) - _defined(files[name])
                if lost:
                    raise UsageError(
                        f"this deck there needs {', '.join(sorted(lost))} of {name}",
                        where=str(deck), got=f"another {name}", hint="choose another --out",
                    )  # fmt: skip


def _defined(text: str) -> set[str]:
    return set(re.findall(r"(?im)^\.subckt\s+(\S+)", text))


def _linted(build: Build) -> Deck:
    """The scene's deck; wrong wiring is named with file and line before a simulator sees it."""
    deck = make_deck(build)
    lint(deck)
    return deck


def run_record(done: Completed) -> dict[str, Any]:
    """``result.json`` without the names of files."""
    build, simulator, outcome = done.build, done.simulator, done.outcome
    waves, attempts, found = outcome.waves, outcome.attempts, outcome.verdict
    record: dict[str, Any] = {
        "scene": build.scene.name,
        "version": kc2spice.__version__,
        "netlist": outcome.deck.main,
        "simulator": {
            "name": simulator.name,
            "version": simulator.version,
            "engine": "batch",
            "setting": attempts[-1].setting,
            "attempts": [attempt.record() for attempt in attempts],
        },
        "model": model_facts(build),
    }
    record |= rom_facts(build)
    if "rom" in record and estimated(build):
        own = (c.value for c in found.checks if c.name.startswith(NAME))
        record["rom"]["contact_error"] = next(own, None)
    record |= {
        # a sweep or an operating point has no time points
        "steps": {name: int(waves.stats.get(name, 0)) for name in ("accepted", "rejected")},
        "simulator_cpu_s": waves.stats.get("cpu_s"),
        "metrics": metrics(waves, build),
        "checks": [check.record() for check in found.checks],
        "energy_j": {name: balance.entries for name, balance in found.balances},
        "plan": asdict(plan(build.scene)),
        "wall_s": done.clock.wall_s,
    }
    return record
