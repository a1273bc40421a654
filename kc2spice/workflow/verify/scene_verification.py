"""Verification of scenes by independent solutions.

:func:`verify_scenes` compares the metrics and waves of several solutions of each scene. The
differences must be within the gates (pass limits) of the parts. One record and one page are written
for all scenes.
"""

from __future__ import annotations

import fnmatch
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import filterfalse
from operator import attrgetter, itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from kc2spice.core.errors import UsageError
from kc2spice.core.files import stage_directory
from kc2spice.core.memory import find_available_bytes
from kc2spice.core.progress import Progress, StageTimer, ignore_progress
from kc2spice.core.waveforms import Waveforms, write_record
from kc2spice.equations.recorded_sources import find_replayed_nets, list_recorded_vectors
from kc2spice.equations.scene_laws import get_scene_laws
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.include_scan import FlatCircuit, read_checked_circuit
from kc2spice.netlist.subcircuit_library import Subcircuit, parse_subcircuits
from kc2spice.report.verify_page import VerificationResult, plot_comparison, write_verify
from kc2spice.rom.linear_model import LinearModel
from kc2spice.scene.checks import SOLUTION_PAIRS, Check, Gate, Verdict
from kc2spice.scene.part_method_calls import resolve
from kc2spice.scene.scene_classes import BuiltScene, Scene
from kc2spice.sim.ngspice import find_ngspice
from kc2spice.workflow.decks import prepare_deck
from kc2spice.workflow.settings_refinement import (
    MAX_MESH_UNKNOWNS,
    MEMORY_SHARE,
    estimate_factor_bytes,
)
from kc2spice.workflow.simulation import run_simulation
from kc2spice.workflow.verdict import form_verdict
from kc2spice.workflow.verify.body_verification import verify_body
from kc2spice.workflow.verify.differences import (
    OutputDeviation,
    Solution,
    complete_solution,
    compute_output_errors,
    list_gate_checks,
    list_metric_errors,
)
from kc2spice.workflow.verify.full_models import (
    solve_full_models,
    with_finer_models,
    with_full_models,
)
from kc2spice.workflow.verify.law_solution import solve_laws

# Largest permitted number of unknowns of a mesh with half the element size.
# The model of a mesh with MAX_FINER_UNKNOWNS unknowns needs seconds and little memory.
MAX_FINER_UNKNOWNS = 30_000
# The solution with a finer discretisation may take at most TIME_FACTOR times the computing time of
# the solution with the normal discretisation, plus EXTRA_SECONDS [s].
TIME_FACTOR = 5.0
EXTRA_SECONDS = 30.0


SOLUTION_NAMES = {"ngspice": "netlist, ngspice", "rom": "equations", "fom": "full model"}
# default error limits of a transient, as multiples of solver.reltol
METRIC_LIMIT_FACTOR = 10.0
WAVE_LIMIT_FACTOR = 200.0
# largest permitted error of a waveform for any value of reltol, relative to its rms value
MAX_WAVE_ERROR = 0.05
# default error limits of analyses without time steps
STEADY_METRIC_LIMIT = 5e-9
STEADY_WAVE_LIMIT = 3e-8
# The default error limit of noise allows for Boltzmann's constant, which ngspice rounds to seven
# digits.
NOISE_LIMIT = 1e-6
# If a source repeats recorded samples of ngspice, its derivative has an error of about 1e-3.
# If a source of recorded samples drives a capacitance, its current has an error of about 1e-3.
# At the edges of a half-bridge, the error of a capacitive current is up to 2.5e-3.
# The work of a source that repeats recorded samples has an error of 5e-6.
REPLAY_LIMIT_FACTOR = 5.0
REPLAY_BALANCE_LIMIT = 1e-5


def verify_scenes(
    scenes: Sequence[Scene],
    out: Path,
    *,
    full: bool = False,
    deck: Path | None = None,
    trust: bool = False,
    progress: Progress = ignore_progress,
) -> dict[str, Any]:
    """Verify ``scenes`` and write ``verify.json`` and ``verify.html`` into ``out``.

    Parameters
    ----------
    full : solve full models to the end of the run and at every frequency, without a time limit.
    deck : an exported deck of the single scene, which is verified instead of a new deck.
    trust : permit the deck and included netlists to run programs and to open files.

    Returns a mapping: ``passed``, and ``scenes`` with the record of each scene by name. If an error
    exceeds its limit, the record of the scene reports the violation, and no exception is raised.

    Raises
    ------
    UsageError : a ``deck`` is combined with several scenes, the deck does not contain the
        subcircuits of the scene, or :func:`kc2spice.workflow.decks.prepare_deck` fails.
    MissingToolError : ngspice is missing, which is checked before finite elements are computed.
    SimulationError : one of the solutions ended without a result.
    """
    if deck is not None and len(scenes) != 1:
        raise UsageError(
            "--deck cannot be combined with several scenes",
            where="--deck",
            got=f"{len(scenes)} scenes",
            expected="the scene from which the deck was exported",
            hint=f"kc2spice verify SCENE --deck {deck}",
        )
    libraries: tuple[Subcircuit, ...] = ()
    if deck is not None:
        libraries = _list_included_subcircuits(read_checked_circuit(deck, trust=trust))
    find_ngspice()
    findings: dict[str, VerificationResult] = {}
    with stage_directory(out) as work:
        for scene in scenes:
            progress("verify", None, scene.name)
            clock = StageTimer(progress)
            exported = scene if deck is None else _with_exported_ports(scene, libraries)
            build, prepared_deck = prepare_deck(exported, clock, trust=trust, edited=deck)
            emitted = prepared_deck.parts if deck is None else libraries
            with TemporaryDirectory() as scratch:
                result = _Verification(build, clock, Path(scratch), full).collect_findings(
                    prepared_deck, emitted
                )
            findings[scene.name] = result
        write_verify(work / "verify.html", findings)
        records = {name: item.make_record() for name, item in findings.items()}
        passed = all(map(itemgetter("passed"), records.values()))
        return write_record({"passed": passed, "scenes": records}, work, "verify.json")


def _list_included_subcircuits(flat: FlatCircuit) -> tuple[Subcircuit, ...]:
    """Return the subcircuits of the files that a deck includes."""
    files: dict[str, list[str]] = {}
    for line in flat.lines:
        files.setdefault(line.where.rpartition(":")[0], []).append(line.text)
    _, *included = files.items()
    result: list[Subcircuit] = []
    for name, lines in included:
        result += parse_subcircuits("\n".join(lines), name)
    return tuple(result)


def _with_exported_ports(scene: Scene, libraries: Sequence[Subcircuit]) -> Scene:
    """Return a scene whose bodies have the same ports as in exported libraries.

    The library of an export has all declared ports of a body, including unconnected ports. If one
    of the ``libraries`` comes from an export, the result has all declared ports of all bodies.
    """
    exported = resolve(replace(scene, ports="declared"))
    known = set(map(_list_pin_names, map(attrgetter("pins"), libraries)))
    for body in exported.bodies:
        pins = exported.pins(body.name)
        if pins != scene.pins(body.name) and _list_pin_names(pins) in known:
            return exported
    return scene


def _list_pin_names(pins: Iterable[Any]) -> tuple[str, ...]:
    """Return the names of the pins of a part or of its subcircuit."""
    return tuple(map(attrgetter("name"), pins))


@dataclass
class _Verification:
    """Verification of one scene, with its findings in ``outcome``."""

    build: BuiltScene
    clock: StageTimer
    work: Path
    thorough: bool
    outcome: VerificationResult = field(default_factory=VerificationResult)
    units: Mapping[str, str] = field(default_factory=dict)
    replayed: Mapping[str, str] = field(default_factory=dict)
    verdict: Verdict = field(default_factory=Verdict)
    # Parts that are also solved with a finer discretisation.
    finer: set[str] = field(default_factory=set)

    @property
    def has_transient(self) -> bool:
        """Whether the scene has a transient analysis."""
        return self.build.scene.analysis.type == "transient"

    def collect_findings(self, deck: Deck, libraries: Sequence[Subcircuit]) -> VerificationResult:
        """Return the findings about the bodies, the scene and its full models.

        ``libraries`` are the subcircuits of the bodies.
        """
        result, build = self.outcome, self.build
        self.units = deck.units
        for part in build.scene.parts.values():
            if part.is_body:
                folder = self.work / part.name
                verify_body(part, build, libraries, self.clock, folder, self.thorough, result)
            most = _compute_max_mesh_unknowns() if self.thorough else MAX_FINER_UNKNOWNS
            for row in part.type.compare_with_finer_mesh(part, build, self.clock, most):
                if isinstance(row, Check):
                    result.checks.append(row)
                else:
                    result.notes.append(row)
        laws = get_scene_laws(build)
        result.left_out = laws.parts_without_law
        replayed = find_replayed_nets(laws) if result.left_out and self.has_transient else None
        if result.left_out:
            rows = map(self._explain_missing_law, result.left_out)
            note = f"parts without equations are omitted: {', '.join(rows)}"
            if replayed is None:
                note += "; the bodies are compared, the whole scene is not"
            elif replayed:
                note += (
                    "; sources replace them, with the waveforms of ngspice on these nets: "
                    + ", ".join(replayed)
                )
            result.notes.append(note)
        self.replayed = replayed or {}
        if result.left_out and replayed is None:
            waves = self._simulate(deck)
            self._add_run_checks()
            simulated = complete_solution(waves, build)
            result.metrics |= simulated.metrics
            result.units |= simulated.units
        else:
            vectors = list_recorded_vectors(self.replayed)
            self._compare_solutions(deck.with_results(vectors) if vectors else deck)
        self._record_error_metrics()
        result.wall_s = {stage: time for stage, time in self.clock.wall_s.items() if time}
        return result

    def _explain_missing_law(self, name: str) -> str:
        """Return the name of a part without equations, with the reason if it is known."""
        reason = get_scene_laws(self.build).reasons_without_law[name]
        return f"{name} ({reason})" if reason else name

    def _simulate(self, deck: Deck) -> Waveforms:
        """Simulate a deck and return its waveforms or frequency responses."""
        with self.clock.time_stage("simulate", f"ngspice, {self.build.scene.name}") as share:
            waves = run_simulation(self.build, deck, self.work / "scene", share)
        self.verdict = form_verdict(waves, self.build)
        return waves

    def _compare_solutions(self, deck: Deck) -> None:
        """Compare the solutions of ngspice, of the equations, and of the full models.

        The solution with full models may end before the end of the run.
        """
        build, waves, result = self.build, self._simulate(deck), self.outcome
        with self.clock.time_stage(
            "reference", "integration of the equations with reduced models"
        ) as share:
            begin = time.monotonic()
            reference = solve_laws(build, waves, self.replayed, share)
            spent = time.monotonic() - begin
        solutions = {
            "ngspice": complete_solution(waves, build),
            "rom": complete_solution(reference.results, build),
        }
        result.metrics |= solutions["ngspice"].metrics
        result.units |= solutions["ngspice"].units
        result.answers |= {key: item.metrics for key, item in solutions.items()}
        outputs = self._compare_with_most_accurate_solution("scene", solutions)
        result.checks += self._list_general_checks(solutions, outputs)
        result.notes += self._note_uncompared_probes(solutions)
        if self.has_transient:
            self._compare_with_finer_laws(waves, solutions, TIME_FACTOR * spent + EXTRA_SECONDS)
        self._add_run_checks()
        if reference.imbalance is not None:
            limit = REPLAY_BALANCE_LIMIT if self.replayed else build.scene.gates.energy
            result.checks.append(
                Check(
                    "energy balance of the reference integration",
                    reference.imbalance,
                    limit,
                    "relative",
                    label="relative error of the energy balance of the reference solution",
                )
            )
        full = with_full_models(build, self.clock)
        followed = full and solve_full_models(
            build, full, waves, reference, self.replayed, self.clock, self.thorough
        )
        if not followed:
            return
        early = {
            key: complete_solution(_truncate_waves(item.waves, followed.end), build)
            for key, item in solutions.items()
        }
        exact = complete_solution(followed.waves, build)
        result.answers["fom"] = exact.metrics
        self._compare_with_most_accurate_solution("full", early | {"fom": exact})
        result.notes += followed.notes
        if followed.coarse is not None:
            self._check_time_steps(followed.waves, followed.coarse)

    def _compare_with_finer_laws(
        self, waves: Waveforms, solutions: Mapping[str, Solution], seconds: float
    ) -> None:
        """Compare the solution of the equations with that of finer discretisations.

        Only parts with an error limit for their discretisation get a finer discretisation. The
        integration takes at most ``seconds`` [s], unless the verification is thorough.
        """
        scene, gates = self.build.scene, self.verdict.gates
        stated = {part for part, gate in gates if "rom_vs_fom" in gate.limits}
        parts = [name for name, part in scene.parts.items() if name in stated and not part.is_body]
        names = ", ".join(parts)
        try:
            finer = with_finer_models(self.build, parts, self.clock)
        except UsageError as error:
            cause = " ".join(filter(None, (error.where, error.message)))
            self.outcome.notes.append(f"no finer discretisation of {names}: {cause}")
            return
        if finer is None:
            return
        try:
            with self.clock.time_stage(
                "full model", f"finer discretisation of {names}"
            ) as progress:
                share = progress if self.thorough else _limit_time(progress, seconds)
                exact = complete_solution(
                    solve_laws(finer, waves, self.replayed, share).results, finer
                )
        except _IntegrationTimeoutError as error:
            self.outcome.notes.append(
                f"finer discretisation of {names}: given up after {seconds:.0f} s at "
                f"{100 * error.share:.0f} % of the run; verify --full has no limit"
            )
            return
        self.finer = set(parts)
        # Both solutions that are compared here are computed from the equations of the parts.
        # A solution of ngspice is instead compared by the rms difference of each waveform.
        # A voltage may jump one time step earlier or later in ngspice than in another solution.
        # If one solution jumps one time step later, the largest voltage difference is the jump
        # height.
        finer_gates = [item for item in gates if item[0] in self.finer]
        self.outcome.checks += list_gate_checks(finer_gates, "rom_vs_fom", solutions["rom"], exact)[
            0
        ]

    def _list_model_gates(self) -> list[tuple[str, Gate]]:
        """List the gates: limits of errors between ngspice, equations and full models.

        In a transient, error limits of discretisations are left out, because they apply only to the
        comparison with a finer discretisation.
        """
        gates = self.verdict.gates
        return [item for item in gates if not (self.has_transient and item[1].discretisation)]

    def _compare_with_most_accurate_solution(
        self, name: str, solutions: Mapping[str, Solution]
    ) -> list[OutputDeviation]:
        """Compare solutions with the most accurate one; return the waveforms' errors.

        The last of ``solutions`` is the most accurate. The checks of error limits, the errors and
        the figures are added to the findings.
        """
        last = list(solutions)[-1]
        outputs: list[OutputDeviation] = []
        for pair in fnmatch.filter(SOLUTION_PAIRS, f"*_vs_{last}"):
            ours, exact = solutions[pair.partition("_")[0]], solutions[last]
            limits, leading = list_gate_checks(self._list_model_gates(), pair, ours, exact)
            self.outcome.checks += limits
            errors = compute_output_errors(pair, ours.waves, exact.waves)
            if leading is None:
                leading = max(map(attrgetter("rms"), errors), default=None)
            if leading is not None:
                self.outcome.errors[pair] = leading
            outputs += errors
        self.outcome.outputs += outputs
        curves = {SOLUTION_NAMES[key]: solutions[key].waves for key in reversed(list(solutions))}
        self.outcome.figures += plot_comparison(name, self.build.scene.name, curves, self.units)
        return outputs

    def _get_general_error_limits(self) -> tuple[float, float]:
        """Return the largest accepted relative errors of ngspice's metrics and waveforms."""
        gates, reltol = self.build.scene.gates, self.build.scene.solver.reltol
        if self.has_transient:
            metric, wave = (
                METRIC_LIMIT_FACTOR * reltol,
                min(WAVE_LIMIT_FACTOR * reltol, MAX_WAVE_ERROR),
            )
        elif self.build.has_noise:
            metric, wave = NOISE_LIMIT, NOISE_LIMIT
        else:
            metric, wave = STEADY_METRIC_LIMIT, STEADY_WAVE_LIMIT
        slack = REPLAY_LIMIT_FACTOR if self.replayed else 1.0
        return slack * (gates.metrics or metric), gates.waves or wave

    def _list_general_checks(
        self, solutions: Mapping[str, Solution], outputs: Sequence[OutputDeviation]
    ) -> Iterator[Check]:
        """Yield checks of ngspice's largest metric error and largest waveform error."""
        metric, wave = self._get_general_error_limits()
        known: dict[str, float] = {}
        missed: list[str] = []
        for name, error in list_metric_errors(solutions["ngspice"], solutions["rom"], self.units):
            if error is None:
                missed.append(name)
            else:
                known[name] = error
        if missed:
            words = f"metric {missed[0]}, computed by only one of ngspice and equations"
            yield Check(words, math.nan, metric, "relative")
        if known:
            worst = max(known, key=known.__getitem__)
            words = f"every metric, ngspice versus equations, worst {worst}"
            label = f"largest relative difference of a metric, ngspice versus equations: {worst}"
            yield Check(words, known[worst], metric, "relative", label=label)
        followed = filterfalse(self._may_ring_at_large_steps, outputs)
        last = max(followed, key=attrgetter("rms"), default=None)
        if last is not None:
            words = f"every waveform (rms), ngspice versus equations, worst {last.output}"
            label = (
                "largest relative rms difference of a waveform, ngspice versus equations: "
                f"{last.output}"
            )
            yield Check(words, last.rms, wave, "relative", label=label)

    def _may_ring_at_large_steps(self, output: OutputDeviation) -> bool:
        """Return whether an output belongs to a body that may ring at large time steps.

        ``solver.ringing = "coarse"`` permits distorted waveforms of a body and of its drive.
        """
        scene, owner = self.build.scene, output.output.partition(".")[0]
        if scene.solver.ringing != "coarse":
            return False
        return any(owner == p.name or owner.startswith(f"{p.name}_") for p in scene.bodies)

    def _note_uncompared_probes(self, solutions: Mapping[str, Solution]) -> Iterator[str]:
        """Yield a note on probes whose results the equations do not contain."""
        simulated, exact = solutions["ngspice"].metrics, solutions["rom"].metrics
        missing = []
        for name, probe in self.build.scene.probes.items():
            if name in simulated and name not in exact:
                missing.append(f"{name} ({probe.of})")
        if missing:
            words = ", ".join(missing)
            yield f"probes not compared, because the equations do not compute them: {words}"

    def _add_run_checks(self) -> None:
        """Add checks of the ngspice run to the findings.

        The function adds two kinds of checks of the ngspice run: checks whose violation makes the
        run fail, and checks for jumps. The error of a discretisation in a transient is normally
        checked with a finer solution of the equations. If no solution with a finer discretisation
        was computed, the discretisation check of the ngspice run is added to the findings instead.
        """
        unsolved = []
        for check in self.verdict.checks:
            solved = not (self.has_transient and check.discretisation) or self.finer & set(
                check.name.split()
            )
            if not solved:
                unsolved.append(check.name)
            if not solved or check.action == "fail" or check.name.startswith("jump"):
                name, label = f"{check.name}, ngspice", f"{check.printed_label}, ngspice"
                self.outcome.checks.append(replace(check, name=name, label=label))
        if unsolved:
            self.outcome.notes.append(
                "compared with a finer discretisation only at the frequencies of the run, not in "
                f"the time domain: {'; '.join(unsolved)}"
            )

    def _check_time_steps(self, waves: Waveforms, coarse: Waveforms) -> None:
        """Check that time steps twice as long change no result by more than its limit.

        The limit of a result is its gate: the largest accepted difference between the solutions
        with reduced and with full models.
        """
        ours, exact = complete_solution(coarse, self.build), complete_solution(waves, self.build)
        for limit in list_gate_checks(self._list_model_gates(), "rom_vs_fom", ours, exact)[0]:
            compared = "full model, time steps halved"
            name = limit.name.replace("ROM versus full model", compared)
            label = limit.label.replace("reduced model versus full model", compared)
            self.outcome.checks.append(replace(limit, name=name, label=label))
        moved = compute_output_errors("steps", coarse, waves)
        if moved:
            worst = max(moved, key=attrgetter("rms"))
            self.outcome.notes.append(
                "halving the time step changes the waveforms of the full model by at most "
                f"{worst.rms:.1e} (rms; {worst.output})"
            )

    def _record_error_metrics(self) -> None:
        """Record the reduction error as a metric; for a single body, also the model sizes."""
        result, bodies = self.outcome, self.build.scene.bodies
        if "rom_vs_fom" in result.errors:
            result.metrics["rom_error"] = result.errors["rom_vs_fom"]
        if len(bodies) == 1:
            model = self.build.model(bodies[0], LinearModel)
            result.metrics["rom_order"] = model.order
            if "unknowns" in model.facts:
                result.metrics["unknowns"] = model.facts["unknowns"]


def _compute_max_mesh_unknowns() -> float:
    """Return the largest permitted number of unknowns of a three-dimensional mesh.

    Free memory and :data:`kc2spice.workflow.settings_refinement.MAX_MESH_UNKNOWNS` limit the
    number.
    """
    share = MEMORY_SHARE * find_available_bytes() / estimate_factor_bytes(1.0, 3)
    # memory is proportional to (number of unknowns)^(4/3)
    return min(MAX_MESH_UNKNOWNS, share**0.75)


class _IntegrationTimeoutError(Exception):
    """Error about an integration that exceeds its time limit.

    ``share`` is the completed fraction of the simulated time.
    """

    def __init__(self, share: float) -> None:
        super().__init__(share)
        self.share = share


def _limit_time(progress: Callable[[float], None], seconds: float) -> Callable[[float], None]:
    """Return a progress function that also enforces a time limit.

    The returned function calls ``progress``. A call after ``seconds`` [s] raises an error, which
    ends the integration.
    """
    begin = time.monotonic()

    def report_in_time(done: float) -> None:
        """Report the progress; raise an error if the time limit is exceeded."""
        progress(done)
        if time.monotonic() - begin > seconds:
            raise _IntegrationTimeoutError(done)

    return report_in_time


def _truncate_waves(waves: Waveforms, end: float | None) -> Waveforms:
    """Return the waveforms up to an end time [s]; all points if the end time is None."""
    if end is None:
        return waves
    early = waves["time"] <= end * (1 + 1e-12)
    return Waveforms({name: values[early] for name, values in waves.data.items()}, waves.stats)
