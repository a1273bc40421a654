"""``verify``: every scene by its parts, one record and one page for all."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

from kc2spice.core.errors import UsageError
from kc2spice.core.files import staged
from kc2spice.core.progress import Clock, Progress, silent
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Subcircuit
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.foreign import Flat, checked
from kc2spice.netlist.read import subcircuits
from kc2spice.report.verify_page import Findings, comparison, write_verify
from kc2spice.scene.compose import composed
from kc2spice.scene.judge import PAIRS, Check, Verdict
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.sim.ngspice import find_ngspice, run_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.edited import edited_deck
from kc2spice.workflow.judge import verdict
from kc2spice.workflow.models import build_models
from kc2spice.workflow.results import plain, write_record
from kc2spice.workflow.simulate import shared_engine
from kc2spice.workflow.verify.bodies import verify_body
from kc2spice.workflow.verify.circuit import (
    solve,
    taken_nets,
    taken_vectors,
    without_law,
)
from kc2spice.workflow.verify.compare import (
    OutputError,
    Solution,
    gate_limits,
    metric_errors,
    output_errors,
    solution,
)
from kc2spice.workflow.verify.full import full_build, full_solution

SOLUTIONS = {"ngspice": "netlist, ngspice", "rom": "laws", "fom": "full model"}
METRICS, WAVES = 10.0, 200.0  # times solver.reltol: gates of a transient unless the scene says
ANY_WAVE = 0.05  # of a wave's rms, whatever reltol: more is another wave
STEADY_METRICS, STEADY_WAVES = 5e-9, 3e-8  # the same for analyses without time steps
NOISE = 1e-6  # the same of noise: Boltzmann's constant has seven digits in ngspice
# What was recorded on a net is as good as its samples: its slope, thus the current into a
# capacitance, is right to some 1e-3 (2.5e-3 at the edges of a half-bridge), its work to 5e-6.
RECORDED, RECORDED_BALANCE = 5.0, 1e-5


def verify(
    scenes: Sequence[Scene],
    out: Path,
    *,
    full: bool = False,
    deck: Path | None = None,
    trust: bool = False,
    progress: Progress = silent,
) -> dict[str, dict[str, Any]]:
    """Verify ``scenes``, write ``verify.json``, ``verify.html`` into ``out``.

    Parameters
    ----------
    full : follow full models to the end of the scene and at every frequency, whatever it takes.
    deck : a shipped deck of the one scene, run and taken apart instead of the one just emitted.
    trust : let it, and included netlists, act on the machine.

    Returns the contract's record of each scene by name; a missed gate is in its ``passed``, not an
    exception.

    Raises
    ------
    UsageError : a ``deck`` for several scenes, one without the scene's subcircuits, or as
        :func:`kc2spice.workflow.edited.edited_deck`.
    MissingToolError : no ngspice; noticed before any FE is computed.
    SimulationError : a solution path ended without a result.
    """
    if deck is not None and len(scenes) != 1:
        raise UsageError("one deck is one scene's", where="--deck", got=f"{len(scenes)} scenes")
    libraries = () if deck is None else _libraries(checked(deck, trust=trust))
    find_ngspice()
    found: dict[str, Findings] = {}
    with staged(out) as work:
        for scene in scenes:
            progress("verify", None, scene.name)
            clock = Clock(progress)
            asked = scene if deck is None else _as_shipped(scene, libraries)
            build = build_models(asked, clock, trust=trust)
            made = make_deck(build)
            emitted = made.parts if deck is None else libraries
            if deck is not None:
                made, build = edited_deck(build, made, deck)
            with TemporaryDirectory() as scratch:
                result = _Verification(build, clock, Path(scratch), full).findings(made, emitted)
            found[scene.name] = result
        write_verify(work / "verify.html", found)
        records = {name: each.record() for name, each in found.items()}
        passed = all(record["passed"] for record in records.values())
        write_record({"passed": passed, "scenes": records}, work, "verify.json")
    return cast(dict[str, dict[str, Any]], plain(records))


def _libraries(flat: Flat) -> tuple[Subcircuit, ...]:
    """The subcircuits of the files that a deck includes."""
    files: dict[str, list[str]] = {}
    for line in flat.lines:
        files.setdefault(line.where.rpartition(":")[0], []).append(line.text)
    _, *included = files.items()
    return tuple(part for name, text in included for part in subcircuits("\n".join(text), name))


def _as_shipped(scene: Scene, libraries: Sequence[Subcircuit]) -> Scene:
    """``scene`` with the ports that an export keeps although nothing joins them, if the libraries
    have them."""
    exported = composed(replace(scene, ports="declared"))
    more = {
        tuple(pin.name for pin in part.type.pins(part, exported))
        for part in exported.parts.values()
        if part.reduced and part.type.pins(part, exported) != part.type.pins(part, scene)
    }
    shipped = {tuple(pin.name for pin in library.pins) for library in libraries}
    return exported if more & shipped else scene


@dataclass
class _Verification:
    """One scene's verification under way: what was ``found`` up to now."""

    build: Build
    clock: Clock
    work: Path
    whole: bool
    found: Findings = field(default_factory=Findings)
    units: Mapping[str, str] = field(default_factory=dict)
    taken: Mapping[str, str] = field(default_factory=dict)
    verdict: Verdict = field(default_factory=Verdict)

    def findings(self, deck: Deck, libraries: Sequence[Subcircuit]) -> Findings:
        """Bodies by their ``libraries``, then the scene, then what full models say of it."""
        found, build = self.found, self.build
        self.units = deck.units
        self._bodies(libraries)
        found.left_out = without_law(build)
        timed = build.scene.analysis.type == "transient"
        taken = taken_nets(build) if found.left_out and timed else None
        if found.left_out:
            told = f"left out, for they have no law: {', '.join(found.left_out)}"
            if taken is None:
                told += "; the scene as a whole is not compared, its bodies are"
            elif taken:
                told += (
                    "; the others are given what ngspice has on the nets where they meet them: "
                    + ", ".join(taken)
                )
            found.notes.append(told)
        self.taken = taken or {}
        if found.left_out and taken is None:
            waves = self._ngspice(deck)
            self._own_checks()
            found.metrics |= solution(waves, build).metrics
        else:
            vectors = taken_vectors(self.taken)
            self._compared(deck.saving(vectors) if vectors else deck)
        self._summary()
        found.wall_s = {stage: time for stage, time in self.clock.wall_s.items() if time}
        return found

    def _ngspice(self, deck: Deck) -> Waveforms:
        with self.clock.stage("simulate", f"ngspice, {self.build.scene.name}") as share:
            shared = shared_engine(self.build, share)
            folder = self.work / "scene"
            waves = shared(deck) if shared else run_deck(deck, folder, progress=share)
        self.verdict = verdict(waves, self.build)
        return waves

    def _bodies(self, libraries: Sequence[Subcircuit]) -> None:
        for part in self.build.scene.parts.values():
            if part.reduced:
                folder = self.work / part.name
                verify_body(part, self.build, libraries, self.clock, folder, self.whole, self.found)

    def _compared(self, deck: Deck) -> None:
        """The scene in ngspice, by its laws, and by those with full models as far as these are
        followed: each two of the three."""
        build, waves, found = self.build, self._ngspice(deck), self.found
        with self.clock.stage("reference", "laws of the reduced models, events located") as told:
            reference = solve(build, waves, self.taken, told)
        solutions = {"ngspice": solution(waves, build), "rom": solution(reference.results, build)}
        found.metrics |= solutions["ngspice"].metrics
        found.answers |= {key: each.metrics for key, each in solutions.items()}
        outputs = self._pairs("scene", solutions)
        found.checks += self._generic(solutions, outputs)
        self._own_checks()
        if reference.imbalance is not None:
            limit = RECORDED_BALANCE if self.taken else build.scene.gates.energy
            found.checks.append(
                Check("energy of the reference integration", reference.imbalance, limit)
            )
        full = full_build(build, self.clock)
        followed = full and full_solution(
            build, full, waves, reference, self.taken, self.clock, self.whole
        )
        if not followed:
            return
        cut = {k: solution(_until(s.waves, followed.end), build) for k, s in solutions.items()}
        exact = solution(followed.waves, build)
        found.answers["fom"] = exact.metrics
        self._pairs("full", cut | {"fom": exact})
        found.notes += followed.notes
        if followed.coarse is not None:
            self._stepped(followed.waves, followed.coarse)

    def _pairs(self, name: str, solutions: Mapping[str, Solution]) -> list[OutputError]:
        """Gates of the parts, errors of all waves and figures, of each pair with the last."""
        last = list(solutions)[-1]
        outputs: list[OutputError] = []
        for pair in (p for p in PAIRS if p.endswith(last)):
            ours, exact = solutions[pair.partition("_")[0]], solutions[last]
            limits, leading = gate_limits(self.verdict.gates, pair, ours, exact)
            self.found.checks += limits
            errors = output_errors(pair, ours.waves, exact.waves)
            leading = max((e.rms for e in errors), default=None) if leading is None else leading
            if leading is not None:
                self.found.errors[pair] = leading
            outputs += errors
        self.found.outputs += outputs
        curves = {SOLUTIONS[key]: solutions[key].waves for key in reversed(list(solutions))}
        self.found.figures += comparison(name, self.build.scene.name, curves, self.units)
        return outputs

    def _generic(
        self, solutions: Mapping[str, Solution], outputs: Sequence[OutputError]
    ) -> Iterable[Check]:
        scene = self.build.scene
        gates, solver = scene.gates, scene.solver
        timed = scene.analysis.type == "transient"
        steady = (NOISE, NOISE) if self.build.noisy else (STEADY_METRICS, STEADY_WAVES)
        metric = gates.metrics or (METRICS * solver.reltol if timed else steady[0])
        metric *= RECORDED if self.taken else 1.0
        wave = gates.waves or (min(WAVES * solver.reltol, ANY_WAVE) if timed else steady[1])
        errors = dict(metric_errors(solutions["ngspice"], solutions["rom"], self.units))
        missed = [name for name, error in errors.items() if error is None]
        if missed:
            yield Check(f"metric {missed[0]}, reached by one of both", math.nan, metric)
        known = {name: error for name, error in errors.items() if error is not None}
        if known:
            worst = max(known, key=lambda name: known[name])
            yield Check(f"every metric, worst {worst}, ngspice to laws", known[worst], metric)
        # what rings on after a launch is coarse by choice: the body's own waves and its drive's
        coarse = [n for n, p in scene.parts.items() if p.reduced]
        coarse = coarse if solver.ringing == "coarse" else []
        owners = [(output, output.output.partition(".")[0]) for output in outputs]
        outputs = [o for o, n in owners if not any(n == c or n.startswith(f"{c}_") for c in coarse)]
        if outputs:
            last = max(outputs, key=lambda output: output.rms)
            yield Check(f"every wave (rms), worst {last.output}, ngspice to laws", last.rms, wave)

    def _own_checks(self) -> None:
        """Physics of the netlist's run that nobody told the simulator."""
        self.found.checks += [
            replace(check, name=f"{check.name}, ngspice")
            for check in self.verdict.checks
            if check.action == "fail" or check.name.startswith("jump")
        ]

    def _stepped(self, waves: Waveforms, coarse: Waveforms) -> None:
        """What steps twice as long change must not decide over a gate."""
        ours, exact = solution(coarse, self.build), solution(waves, self.build)
        for limit in gate_limits(self.verdict.gates, "rom_vs_fom", ours, exact)[0]:
            words = limit.name.replace("ROM to full model", "full model, steps halved")
            self.found.checks.append(replace(limit, name=words))
        moved = output_errors("steps", coarse, waves)
        if moved:
            worst = max(moved, key=lambda output: output.rms)
            self.found.notes.append(
                f"halving its steps moves the full model's waves by at most {worst.rms:.1e} (rms; "
                f"{worst.output})"
            )

    def _summary(self) -> None:
        found, parts = self.found, self.build.scene.parts.values()
        if "rom_vs_fom" in found.errors:
            found.metrics["rom_error"] = found.errors["rom_vs_fom"]
        bodies = [part for part in parts if part.reduced]
        if len(bodies) == 1:
            model = self.build.model(bodies[0])
            found.metrics["rom_order"] = model.order
            if "unknowns" in model.facts:
                found.metrics["unknowns"] = model.facts["unknowns"]


def _until(waves: Waveforms, end: float | None) -> Waveforms:
    """The points up to ``end``, all of them where no time passes."""
    if end is None:
        return waves
    kept = waves["time"] <= end * (1 + 1e-12)
    return Waveforms({name: values[kept] for name, values in waves.data.items()}, waves.stats)
