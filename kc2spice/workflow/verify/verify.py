"""``verify``: every scene by its parts, one record and one page for all; how far two solutions of a
scene are apart by the gates of its parts, in metrics and waves.
"""

from __future__ import annotations

import fnmatch
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.files import staged
from kc2spice.core.memory import available_bytes
from kc2spice.core.progress import Clock, Progress, silent
from kc2spice.core.waveforms import Waveforms, write_record
from kc2spice.equations.replay import replayed_nets, replayed_vectors
from kc2spice.equations.scene_laws import scene_laws
from kc2spice.netlist.deck import Deck, PowerTerm
from kc2spice.netlist.include_scan import Flat, checked
from kc2spice.netlist.library import Subcircuit, subcircuits
from kc2spice.report.verify_page import Findings, plot_comparison, write_verify
from kc2spice.rom.linear_model import LinearModel
from kc2spice.scene.checks import PAIRS, Check, Gate, Verdict
from kc2spice.scene.model import Build, Scene
from kc2spice.scene.resolve import resolve
from kc2spice.scene.results import collect_powers
from kc2spice.sim.ngspice import find_ngspice
from kc2spice.workflow.decks import prepared
from kc2spice.workflow.metrics import metrics, verdict
from kc2spice.workflow.refine import FREE_SHARE, MOST_UNKNOWNS, factor_bytes
from kc2spice.workflow.simulate import ran, with_powers
from kc2spice.workflow.verify.bodies import verify_body
from kc2spice.workflow.verify.full_models import finer_build, full_build, full_solution
from kc2spice.workflow.verify.law_solution import solve

FEW_UNKNOWNS = 30_000  # of a mesh half as wide as that of the run: seconds, with little memory
LOADED = 1e-6  # least value with a meaningful relative error, over the largest value
LONGER, SPARE = 5.0, 30.0  # times, and s, that a finer discretisation may take beside the run's
STILL = 1e-9  # largest motion at rest, by rounding errors, relative to the size
NOTHING = 1e-150  # its square is zero: what rounding leaves of no current
SMALL = 1e-3  # least size of a metric in errors, relative to the largest wave of its unit


@dataclass(frozen=True)
class Solution:
    """Waves of one solution path with their metrics, and the units of these."""

    waves: Waveforms
    metrics: Mapping[str, Any]
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class OutputError:
    """Largest and rms error of one wave of one pair of solutions, relative to its largest and its
    rms value."""

    pair: str
    output: str
    largest: float
    rms: float


def solution(waves: Waveforms, build: Build) -> Solution:
    """A solution with those powers and metrics that follow from its waves."""
    powers = collect_powers(build, waves.data)
    known = {name: terms for name, terms in powers.items() if _has(waves, terms)}
    waves = with_powers(waves, known)
    return Solution(waves, *metrics(waves, build, partial=True))


def _has(waves: Waveforms, terms: Iterable[PowerTerm]) -> bool:
    return all(term.names <= set(waves) for term in terms)


def gate_limits(
    gates: Iterable[tuple[str, Gate]], pair: str, ours: Solution, exact: Solution
) -> tuple[list[Check], float | None]:
    """Every gate of this pair, and the largest value of those that stand for the scene.

    ``gates`` are by the part that has them: of a metric that several parts have each judges its
    own.
    """
    limits, leading = [], []
    words = pair.replace("rom", "ROM").replace("fom", "full model").replace("_vs_", " to ")
    for part, item in gates:
        wave = f"{part}.{item.of}"
        gate = replace(item, of=wave) if wave in exact.metrics else item
        value = gate_difference(gate, ours, exact)
        if value is None:
            continue
        if pair in gate.limits:
            limits.append(Check(f"{gate.words}, {words}", value, gate.limits[pair], gate.unit))
        if gate.leads and not math.isnan(value):
            leading.append(value)
    return limits, max(leading, default=None)


def gate_difference(gate: Gate, ours: Solution, exact: Solution) -> float | None:
    """The difference that a gate asks for, nan where one of both has not reached it; None where
    neither has it, such as the launch of what never leaves."""
    if gate.of in exact.metrics:
        a, b = ours.metrics.get(gate.of), exact.metrics[gate.of]
        if a is None or b is None:
            return None if a is b else math.nan
        return abs(a - b) if gate.measure == "absolute" else abs(a / b - 1.0)
    names = sorted(fnmatch.filter(set(ours.waves) & set(exact.waves), gate.of))
    if not names:
        return None
    pairs = [_aligned(ours.waves, exact.waves, name)[1:] for name in names]
    if gate.share < 1.0:
        scale = exact.waves.scale
        low = scale <= gate.share * scale[-1]
        pairs = [(a[low], b[low]) for a, b in pairs]
    if gate.measure == "spectral":
        from kc2spice.rom.error_estimate import (
            relative_error,
        )  # which loads scipy; every run is here

        return relative_error(*(np.stack(item, axis=1) for item in zip(*pairs, strict=True)))
    if gate.measure == "relative":
        return max(_each(a, b) for a, b in pairs)
    apart = max(float(np.abs(a - b).max()) for a, b in pairs)
    if gate.measure == "absolute":
        return apart
    size = max(float(np.abs(b).max()) for _, b in pairs)
    if gate.measure == "travel":
        size = max(STILL * size, *(float(np.ptp(b)) for _, b in pairs))
    # with a zero reference, any difference is infinitely large
    return apart / size if size else math.inf if apart else 0.0


def _each(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference of a value by its own size."""
    size = np.abs(b)
    loaded = size > LOADED * size.max()
    return float((np.abs(a - b)[loaded] / size[loaded]).max(initial=0.0))


def _aligned(
    waves: Waveforms, exact: Waveforms, name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points that both cover, those of the coarser one, and a wave of both there."""
    if "time" not in waves:
        return np.arange(float(waves[name].size)), waves[name], exact[name]
    t, s = (np.unique(item["time"]) for item in (waves, exact))
    at = t if t.size <= s.size else s
    at = at[(at >= max(t[0], s[0])) & (at <= min(t[-1], s[-1]))]
    return at, _at(at, waves, name), _at(at, exact, name)


def _at(at: np.ndarray, waves: Waveforms, name: str) -> np.ndarray:
    """A wave at times ``at``: a height with its velocity by cubics, others by straight lines."""
    t, unique = np.unique(waves["time"], return_index=True)
    stem, _, last = name.rpartition(".")
    if last in ("y", "x") and f"{stem}.v" in waves and t.size > 1:
        from scipy.interpolate import CubicHermiteSpline

        return np.asarray(
            CubicHermiteSpline(t, waves[name][unique], waves[f"{stem}.v"][unique])(at)
        )
    return np.interp(at, t, waves[name][unique])


def output_errors(pair: str, waves: Waveforms, exact: Waveforms) -> list[OutputError]:
    """Every wave that both have; those that never move are left out.

    The rms is one over time: points that a solver crowds into a contact weigh what they last.
    """
    result = []
    scale = next(iter(exact.data))
    for name in exact.data:
        if name == scale or name not in waves:
            continue
        at, a, b = _aligned(waves, exact, name)
        size = float(np.abs(b).max(initial=0.0))
        if size <= max(_resting(name, exact), NOTHING):
            continue
        error = np.abs(a - b)
        power = (
            np.trapezoid(np.abs(x) ** 2, at) if at.size > 1 else np.abs(x).max() ** 2
            for x in (error, b)
        )
        rms = math.sqrt(float(np.divide(*power)))
        result.append(OutputError(pair, name, float(error.max()) / size, rms))
    return result


def _resting(name: str, waves: Waveforms) -> float:
    """Speed [m/s] below which a velocity is what rounding makes of a position at rest; else 0."""
    stem, _, last = name.rpartition(".")
    place = next((waves[n] for n in (f"{stem}.y", f"{stem}.x") if n in waves), None)
    if last != "v" or place is None or "time" not in waves:
        return 0.0
    return STILL * float(np.abs(place).max()) / float(np.ptp(waves["time"]))


def metric_errors(
    ours: Solution, exact: Solution, units: Mapping[str, str]
) -> Iterator[tuple[str, float | None]]:
    """Yield the relative error of each metric that both solutions contain.

    The reference is the size of the exact metric, or ``SMALL`` of the largest wave of its unit if
    that is larger. If both are zero, the error is the absolute difference.
    """
    for name, b in exact.metrics.items():
        if name not in ours.metrics or isinstance(b, bool):
            continue
        a = ours.metrics[name]
        if a is None or b is None:
            if a is not b:
                yield name, None
            continue
        try:
            x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
        except (TypeError, ValueError):
            continue
        if x.shape != y.shape or x.size == 0:
            continue
        base = max(
            float(np.abs(y).max()), SMALL * _largest(exact.units.get(name, ""), exact.waves, units)
        )
        yield name, float(np.abs(x - y).max()) / (base or 1.0)


def _largest(unit: str, waves: Waveforms, units: Mapping[str, str]) -> float:
    """The largest wave of the ``unit`` of a metric; for times their span.

    A metric without a unit, such as a coupling, has no such wave: a frequency would excuse any.
    """
    if not unit:
        return 0.0
    if unit == "s" and "time" in waves:
        return float(np.ptp(waves["time"]))
    sizes = [float(np.abs(v).max()) for k, v in waves.data.items() if units.get(k) == unit]
    return max(sizes, default=0.0)


SOLUTIONS = {"ngspice": "netlist, ngspice", "rom": "laws", "fom": "full model"}
METRICS, WAVES = 10.0, 200.0  # times solver.reltol: gates of a transient unless the scene says
ANY_WAVE = 0.05  # largest error with any reltol, relative to a wave's rms
STEADY_METRICS, STEADY_WAVES = 5e-9, 3e-8  # the same for analyses without time steps
NOISE = 1e-6  # the same of noise: Boltzmann's constant has seven digits in ngspice
# A source that replays samples of ngspice has an error of about 1e-3 in its slope, which is the
# current into a capacitance (2.5e-3 at the edges of a half-bridge). Its work is off by 5e-6.
RECORDED, RECORDED_BALANCE = 5.0, 1e-5


def verify_scenes(
    scenes: Sequence[Scene],
    out: Path,
    *,
    full: bool = False,
    deck: Path | None = None,
    trust: bool = False,
    progress: Progress = silent,
) -> dict[str, Any]:
    """Verify ``scenes``, write ``verify.json``, ``verify.html`` into ``out``.

    Parameters
    ----------
    full : follow full models to the end of the scene and at every frequency, whatever it takes.
    deck : a shipped deck of the one scene, run and taken apart instead of the one just emitted.
    trust : let it, and included netlists, act on the machine.

    Returns ``passed`` and in ``scenes`` the contract's record of each by name; a missed gate is in
    these, not an exception.

    Raises
    ------
    UsageError : a ``deck`` for several scenes, one without the scene's subcircuits, or as
        :func:`kc2spice.workflow.decks.prepared`.
    MissingToolError : no ngspice; noticed before any FE is computed.
    SimulationError : a solution path ended without a result.
    """
    if deck is not None and len(scenes) != 1:
        raise UsageError(
            "--deck needs exactly one scene",
            where="--deck",
            got=f"{len(scenes)} scenes",
            expected="the scene from which the deck was exported",
            hint=f"kc2spice verify SCENE --deck {deck}",
        )
    libraries = () if deck is None else _libraries(checked(deck, trust=trust))
    find_ngspice()
    answer: dict[str, Findings] = {}
    with staged(out) as work:
        for scene in scenes:
            progress("verify", None, scene.name)
            clock = Clock(progress)
            exported = scene if deck is None else _as_shipped(scene, libraries)
            build, prepared_deck = prepared(exported, clock, trust=trust, edited=deck)
            emitted = prepared_deck.parts if deck is None else libraries
            with TemporaryDirectory() as scratch:
                result = _Verification(build, clock, Path(scratch), full).findings(
                    prepared_deck, emitted
                )
            answer[scene.name] = result
        write_verify(work / "verify.html", answer)
        records = {name: item.record() for name, item in answer.items()}
        passed = all(record["passed"] for record in records.values())
        return write_record({"passed": passed, "scenes": records}, work, "verify.json")


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
    exported = resolve(replace(scene, ports="declared"))
    more = {
        tuple(pin.name for pin in exported.pins(part.name))
        for part in exported.parts.values()
        if part.reduced and exported.pins(part.name) != scene.pins(part.name)
    }
    shipped = {tuple(pin.name for pin in library.pins) for library in libraries}
    return exported if more & shipped else scene


@dataclass
class _Verification:
    """One scene's verification under way: ``outcome`` has what is known up to now."""

    build: Build
    clock: Clock
    work: Path
    thorough: bool
    outcome: Findings = field(default_factory=Findings)
    units: Mapping[str, str] = field(default_factory=dict)
    replayed: Mapping[str, str] = field(default_factory=dict)
    verdict: Verdict = field(default_factory=Verdict)
    finer: set[str] = field(default_factory=set)  # parts followed with a finer discretisation

    def findings(self, deck: Deck, libraries: Sequence[Subcircuit]) -> Findings:
        """Bodies by their ``libraries``, then the scene, then what full models say of it."""
        result, build = self.outcome, self.build
        self.units = deck.units
        for part in build.scene.parts.values():
            if part.reduced:
                folder = self.work / part.name
                verify_body(part, build, libraries, self.clock, folder, self.thorough, result)
            most = _most_unknowns() if self.thorough else FEW_UNKNOWNS
            for row in part.type.finer_mesh(part, build, self.clock, most):
                if isinstance(row, Check):
                    result.checks.append(row)
                else:
                    result.notes.append(row)
        laws = scene_laws(build)
        result.left_out = laws.missing
        timed = build.scene.analysis.type == "transient"
        replayed = replayed_nets(laws) if result.left_out and timed else None
        if result.left_out:
            note = f"parts without a law are left out: {', '.join(result.left_out)}"
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
            waves = self._ngspice(deck)
            self._own_checks()
            simulated = solution(waves, build)
            result.metrics |= simulated.metrics
            result.units |= simulated.units
        else:
            vectors = replayed_vectors(self.replayed)
            self._compared(deck.saving(vectors) if vectors else deck)
        self._summary()
        result.wall_s = {stage: time for stage, time in self.clock.wall_s.items() if time}
        return result

    def _ngspice(self, deck: Deck) -> Waveforms:
        with self.clock.stage("simulate", f"ngspice, {self.build.scene.name}") as share:
            waves = ran(self.build, deck, self.work / "scene", share)
        self.verdict = verdict(waves, self.build)
        return waves

    def _compared(self, deck: Deck) -> None:
        """The scene in ngspice, by its laws, and by those with full models as far as these are
        followed: each two of the three."""
        build, waves, result = self.build, self._ngspice(deck), self.outcome
        with self.clock.stage("reference", "laws of the reduced models, events located") as share:
            begin = time.monotonic()
            reference = solve(build, waves, self.replayed, share)
            spent = time.monotonic() - begin
        solutions = {"ngspice": solution(waves, build), "rom": solution(reference.results, build)}
        result.metrics |= solutions["ngspice"].metrics
        result.units |= solutions["ngspice"].units
        result.answers |= {key: item.metrics for key, item in solutions.items()}
        outputs = self._pairs("scene", solutions)
        result.checks += self._generic(solutions, outputs)
        result.notes += self._uncompared(solutions)
        if build.scene.analysis.type == "transient":
            self._finer(waves, solutions, LONGER * spent + SPARE)
        self._own_checks()
        if reference.imbalance is not None:
            limit = RECORDED_BALANCE if self.replayed else build.scene.gates.energy
            result.checks.append(
                Check("energy of the reference integration", reference.imbalance, limit)
            )
        full = full_build(build, self.clock)
        followed = full and full_solution(
            build, full, waves, reference, self.replayed, self.clock, self.thorough
        )
        if not followed:
            return
        cut = {k: solution(_until(s.waves, followed.end), build) for k, s in solutions.items()}
        exact = solution(followed.waves, build)
        result.answers["fom"] = exact.metrics
        self._pairs("full", cut | {"fom": exact})
        result.notes += followed.notes
        if followed.coarse is not None:
            self._stepped(followed.waves, followed.coarse)

    def _finer(self, waves: Waveforms, solutions: Mapping[str, Solution], seconds: float) -> None:
        """The laws with finer discretisations of those parts that state how much these may change,
        integrated for at most so many ``seconds``; without a limit where the whole is asked for."""
        scene, gates = self.build.scene, self.verdict.gates
        stated = {part for part, gate in gates if "rom_vs_fom" in gate.limits}
        parts = [name for name, part in scene.parts.items() if name in stated and not part.reduced]
        names = ", ".join(parts)
        try:
            finer = finer_build(self.build, parts, self.clock)
        except UsageError as error:
            cause = " ".join(filter(None, (error.where, error.message)))
            self.outcome.notes.append(f"no finer discretisation of {names}: {cause}")
            return
        if finer is None:
            return
        try:
            with self.clock.stage("full model", f"finer discretisation of {names}") as progress:
                share = progress if self.thorough else _limited(progress, seconds)
                exact = solution(solve(finer, waves, self.replayed, share).results, finer)
        except _TooLongError as error:
            self.outcome.notes.append(
                f"finer discretisation of {names}: given up after {seconds:.0f} s at "
                f"{100 * error.share:.0f} % of the run; verify --full has no limit"
            )
            return
        self.finer = set(parts)
        # Laws against laws. ngspice is compared with the laws by the rms of each wave, because
        # its voltage jumps one time step earlier or later, which dominates a largest difference.
        finer_gates = [item for item in gates if item[0] in self.finer]
        self.outcome.checks += gate_limits(finer_gates, "rom_vs_fom", solutions["rom"], exact)[0]

    def _gates_of_models(self) -> list[tuple[str, Gate]]:
        """The gates without those of discretisations, which only finer ones meet in time."""
        timed = self.build.scene.analysis.type == "transient"
        gates = self.verdict.gates
        return [item for item in gates if not (timed and item[1].discretisation)]

    def _pairs(self, name: str, solutions: Mapping[str, Solution]) -> list[OutputError]:
        """Gates of the parts, errors of all waves and figures, of each pair with the last."""
        last = list(solutions)[-1]
        outputs: list[OutputError] = []
        for pair in (p for p in PAIRS if p.endswith(last)):
            ours, exact = solutions[pair.partition("_")[0]], solutions[last]
            limits, leading = gate_limits(self._gates_of_models(), pair, ours, exact)
            self.outcome.checks += limits
            errors = output_errors(pair, ours.waves, exact.waves)
            leading = max((e.rms for e in errors), default=None) if leading is None else leading
            if leading is not None:
                self.outcome.errors[pair] = leading
            outputs += errors
        self.outcome.outputs += outputs
        curves = {SOLUTIONS[key]: solutions[key].waves for key in reversed(list(solutions))}
        self.outcome.figures += plot_comparison(name, self.build.scene.name, curves, self.units)
        return outputs

    def _generic(
        self, solutions: Mapping[str, Solution], outputs: Sequence[OutputError]
    ) -> Iterable[Check]:
        scene = self.build.scene
        gates, solver = scene.gates, scene.solver
        timed = scene.analysis.type == "transient"
        steady = (NOISE, NOISE) if self.build.noisy else (STEADY_METRICS, STEADY_WAVES)
        metric = gates.metrics or (METRICS * solver.reltol if timed else steady[0])
        metric *= RECORDED if self.replayed else 1.0
        wave = gates.waves or (min(WAVES * solver.reltol, ANY_WAVE) if timed else steady[1])
        errors = dict(metric_errors(solutions["ngspice"], solutions["rom"], self.units))
        missed = [name for name, error in errors.items() if error is None]
        if missed:
            yield Check(f"metric {missed[0]}, reached by one of both", math.nan, metric)
        known = {name: error for name, error in errors.items() if error is not None}
        if known:
            worst = max(known, key=lambda name: known[name])
            yield Check(f"every metric, worst {worst}, ngspice to laws", known[worst], metric)
        # ringing after a launch is coarse by choice, in the waves of the body and of its drive
        coarse = [n for n, p in scene.parts.items() if p.reduced]
        coarse = coarse if solver.ringing == "coarse" else []
        owners = [(output, output.output.partition(".")[0]) for output in outputs]
        outputs = [o for o, n in owners if not any(n == c or n.startswith(f"{c}_") for c in coarse)]
        if outputs:
            last = max(outputs, key=lambda output: output.rms)
            yield Check(f"every wave (rms), worst {last.output}, ngspice to laws", last.rms, wave)

    def _uncompared(self, solutions: Mapping[str, Solution]) -> Iterator[str]:
        """A note on the probes whose results the laws do not contain."""
        simulated, exact = solutions["ngspice"].metrics, solutions["rom"].metrics
        probes = self.build.scene.probes
        missing = [name for name in probes if name in simulated and name not in exact]
        if missing:
            words = ", ".join(f"{name} ({probes[name].of})" for name in missing)
            yield f"probes that are not compared, as the laws have no such result: {words}"

    def _own_checks(self) -> None:
        """Add checks of the ngspice run to the findings.

        These are the checks that can fail a run, and the checks of jumps. In a transient, checks of
        a discretisation are added as well if no finer solution replaces them.
        """
        timed = self.build.scene.analysis.type == "transient"
        rows = [c for c in self.verdict.checks if timed and c.discretisation]
        unfollowed = [c for c in rows if not self.finer & set(c.name.split())]
        self.outcome.checks += [
            replace(check, name=f"{check.name}, ngspice")
            for check in self.verdict.checks
            if check.action == "fail" or check.name.startswith("jump") or check in unfollowed
        ]
        if unfollowed:
            self.outcome.notes.append(
                "not solved in time with a finer discretisation, but compared with one at the "
                f"frequencies of the run: {'; '.join(check.name for check in unfollowed)}"
            )

    def _stepped(self, waves: Waveforms, coarse: Waveforms) -> None:
        """Compare the effect of steps twice as long with each gate."""
        ours, exact = solution(coarse, self.build), solution(waves, self.build)
        for limit in gate_limits(self._gates_of_models(), "rom_vs_fom", ours, exact)[0]:
            words = limit.name.replace("ROM to full model", "full model, steps halved")
            self.outcome.checks.append(replace(limit, name=words))
        moved = output_errors("steps", coarse, waves)
        if moved:
            worst = max(moved, key=lambda output: output.rms)
            self.outcome.notes.append(
                f"halving its steps moves the full model's waves by at most {worst.rms:.1e} (rms; "
                f"{worst.output})"
            )

    def _summary(self) -> None:
        result, parts = self.outcome, self.build.scene.parts.values()
        if "rom_vs_fom" in result.errors:
            result.metrics["rom_error"] = result.errors["rom_vs_fom"]
        bodies = [part for part in parts if part.reduced]
        if len(bodies) == 1:
            model = self.build.model(bodies[0], LinearModel)
            result.metrics["rom_order"] = model.order
            if "unknowns" in model.facts:
                result.metrics["unknowns"] = model.facts["unknowns"]


def _most_unknowns() -> float:
    """Unknowns of the finest mesh in space that the free memory and :data:`MOST_UNKNOWNS` allow."""
    share = FREE_SHARE * available_bytes() / factor_bytes(1.0, 3)
    return min(MOST_UNKNOWNS, share**0.75)  # the memory grows by the power 4/3


class _TooLongError(Exception):
    """An integration that was given up at this ``share`` of its run."""

    def __init__(self, share: float) -> None:
        super().__init__(share)
        self.share = share


def _limited(progress: Callable[[float], None], seconds: float) -> Callable[[float], None]:
    """Return ``progress`` with a time limit.

    A call after ``seconds`` raises an error that ends the integration.
    """
    begin = time.monotonic()

    def share(done: float) -> None:
        progress(done)
        if time.monotonic() - begin > seconds:
            raise _TooLongError(done)

    return share


def _until(waves: Waveforms, end: float | None) -> Waveforms:
    """The points up to ``end``, all of them where no time passes."""
    if end is None:
        return waves
    early = waves["time"] <= end * (1 + 1e-12)
    return Waveforms({name: values[early] for name, values in waves.data.items()}, waves.stats)
