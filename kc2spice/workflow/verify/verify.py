"""``verify``: every scene by its parts, one record and one page for all."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

from kc2spice.core.errors import UsageError
from kc2spice.core.files import staged
from kc2spice.core.progress import Clock, Progress, silent
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Subcircuit
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.read import subcircuits
from kc2spice.netlist.scan import third_party
from kc2spice.report.verdict import Findings
from kc2spice.report.verify_figures import comparison, responses
from kc2spice.report.verify_page import write_verify
from kc2spice.scene.compose import composed
from kc2spice.scene.gates import Gate, Limit
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.sim.ngspice import find_ngspice, run_deck, write_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.judge import verdict
from kc2spice.workflow.models import build_models
from kc2spice.workflow.results import plain, write_record
from kc2spice.workflow.verify.bodies import BodyFindings, verify_body
from kc2spice.workflow.verify.circuit import (
    Reference,
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

METRICS, WAVES = 10.0, 200.0  # times solver.reltol: gates of a transient unless the scene says
ANY_WAVE = 0.05  # of a wave's rms, whatever reltol: more is another wave
STEADY_METRICS, STEADY_WAVES = 5e-9, 3e-8  # the same for analyses without time steps
# What was recorded on a net is as good as its samples: its slope, thus the current into a
# capacitance, is right to some 1e-3 (2.5e-3 at the edges of a half-bridge), its work to 5e-6.
RECORDED, RECORDED_BALANCE = 5.0, 1e-5


def verify(
    scenes: Sequence[Scene],
    out: Path,
    *,
    full: bool = False,
    deck: Deck | None = None,
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
    UsageError : a ``deck`` for several scenes, one without the scene's subcircuits, or one with a
        line that could act on the machine.
    MissingToolError : no ngspice; noticed before any FE is computed.
    SimulationError : a solution path ended without a result.
    """
    if deck is not None and len(scenes) != 1:
        raise UsageError("one deck is one scene's", where="--deck", got=f"{len(scenes)} scenes")
    if deck is not None and not trust:
        _refuse_threats(deck)
    find_ngspice()
    found: dict[str, Findings] = {}
    with staged(out) as work:
        for scene in scenes:
            progress("verify", None, scene.name)
            clock = Clock(progress)
            asked = scene if deck is None else _as_shipped(scene, deck)
            build = build_models(asked, clock, trust=trust)
            with TemporaryDirectory() as scratch:
                result = _Verification(build, clock, Path(scratch), full, deck).findings()
            found[scene.name] = result
        write_verify(work / "verify.html", found)
        records = {name: _record(each) for name, each in found.items()}
        passed = all(record["passed"] for record in records.values())
        write_record({"passed": passed, "scenes": records}, work, "verify.json")
    return cast(dict[str, dict[str, Any]], plain(records))


def _refuse_threats(deck: Deck) -> None:
    """Its texts as they will be run, in a folder with nothing else to include."""
    with TemporaryDirectory() as folder:
        try:
            third_party(write_deck(deck, Path(folder)))
        except UsageError as error:
            error.where = (error.where or "").replace(f"{folder}/", "")
            raise


def _as_shipped(scene: Scene, deck: Deck) -> Scene:
    """``scene`` with the ports that an export keeps although nothing joins them, if ``deck`` is one
    that has them."""
    exported = composed(replace(scene, exported=True))
    more = {
        tuple(pin.name for pin in part.type.pins(part, exported))
        for part in exported.parts.values()
        if part.type.reduced and part.type.pins(part, exported) != part.type.pins(part, scene)
    }
    shipped = {tuple(pin.name for pin in library.pins) for library in _libraries(deck)}
    return exported if more & shipped else scene


@dataclass
class _Verification:
    """One scene's verification under way: what was found up to now."""

    build: Build
    clock: Clock
    work: Path
    whole: bool
    shipped: Deck | None
    checks: list[Limit] = field(default_factory=list)
    errors: dict[str, float] = field(default_factory=dict)
    outputs: list[OutputError] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    figures: list[Any] = field(default_factory=list)
    metrics: dict[str, Any] = field(default_factory=dict)
    taken: Mapping[str, str] = field(default_factory=dict)

    def findings(self) -> Findings:
        """Bodies, then the scene, then what full models say of it."""
        deck = self._deck(self.build, self.shipped)
        libraries = _libraries(deck)
        bodies = self._bodies(libraries)
        missing = without_law(self.build)
        timed = self.build.scene.analysis.type == "transient"
        given = taken_nets(self.build) if missing and timed else None
        self.taken = given or {}
        if missing and given is None:
            self.notes.append(
                "left out, for they have no law: "
                + ", ".join(missing)
                + "; the scene as a whole is not compared, its bodies are"
            )
            waves = self._ngspice(deck)
            self._own_checks(waves)
            self.metrics |= solution(waves, self.build).metrics
        else:
            if missing:
                self.notes.append(
                    "left out, for they have no law: "
                    + ", ".join(missing)
                    + "; the others are given what ngspice has on the nets where they meet them: "
                    * bool(self.taken)
                    + ", ".join(self.taken)
                )
            vectors = taken_vectors(self.taken)
            self._full(*self._compared(deck.saving(vectors) if vectors else deck))
        self._summary(bodies)
        return Findings(
            checks=tuple(self.checks),
            errors=self.errors,
            wall_s={stage: time for stage, time in self.clock.wall_s.items() if time},
            metrics=self.metrics,
            outputs=tuple(self.outputs),
            notes=tuple(self.notes),
            left_out=missing,
            figures=tuple(self.figures),
        )

    # --- solution paths -----------------------------------------------------------------------

    def _deck(self, build: Build, shipped: Deck | None) -> Deck:
        """The emitted deck, or the shipped one with the names that the scene gives its results."""
        own = make_deck(build)
        if shipped is None:
            return own
        return replace(
            own,
            name=shipped.name,
            text=shipped.text,
            more=shipped.more,
            parts=(),
            blocks=(),
            options=(),
        )

    def _ngspice(self, deck: Deck) -> Waveforms:
        with self.clock.stage("simulate", f"ngspice, {self.build.scene.name}") as share:
            return run_deck(deck, self.work / "scene", progress=share)

    # --- comparisons --------------------------------------------------------------------------

    def _bodies(self, libraries: Sequence[Subcircuit]) -> list[BodyFindings]:
        found = []
        gate = self.build.scene.gates.harmonic_ngspice
        for part in self.build.scene.parts.values():
            if part.type.reduced:
                body = verify_body(
                    part,
                    self.build,
                    libraries,
                    self.clock,
                    self.work / part.name,
                    self.whole,
                    gate,
                )
                self.checks += body.checks
                self.notes += body.notes
                self.figures += responses(body.name, body.curves)
                found.append(body)
        return found

    def _compared(self, deck: Deck) -> tuple[Solution, Reference]:
        """The scene in ngspice against its laws."""
        build, waves = self.build, self._ngspice(deck)
        with self.clock.stage("reference", "laws of the reduced models, events located"):
            reference = solve(build, waves, self.taken)
        ours, exact = solution(waves, build), solution(reference.results, build)
        outputs = self._pair("ngspice_vs_rom", ours, exact)
        self.checks += self._generic(build, ours, exact, outputs)
        self._own_checks(waves)
        if reference.imbalance is not None:
            limit = RECORDED_BALANCE if self.taken else build.scene.gates.energy
            self.checks.append(
                Limit("energy of the reference integration", reference.imbalance, limit)
            )
        curves = {"laws": reference.results, "netlist, ngspice": waves}
        self.figures += comparison("scene", build.scene.name, curves, deck.units)
        self.metrics |= ours.metrics
        return ours, reference

    def _pair(self, pair: str, ours: Solution, exact: Solution) -> list[OutputError]:
        """Gates of the parts, and the errors of all waves."""
        limits, leading = gate_limits(_gates(self.build), pair, ours, exact)
        self.checks += limits
        outputs = output_errors(pair, ours.waves, exact.waves)
        self.outputs += outputs
        if leading is None and outputs:
            leading = max(output.rms for output in outputs)
        if leading is not None:
            self.errors[pair] = leading
        return outputs

    def _generic(
        self, build: Build, ours: Solution, exact: Solution, outputs: Sequence[OutputError]
    ) -> Iterable[Limit]:
        gates, solver = build.scene.gates, build.scene.solver
        timed = build.scene.analysis.type == "transient"
        metric = gates.metrics or (METRICS * solver.reltol if timed else STEADY_METRICS)
        metric *= RECORDED if self.taken else 1.0
        wave = gates.waves or (min(WAVES * solver.reltol, ANY_WAVE) if timed else STEADY_WAVES)
        errors = dict(metric_errors(ours, exact, make_deck(build).units))
        missed = [name for name, error in errors.items() if error is None]
        if missed:
            yield Limit(f"metric {missed[0]}, reached by one of both", None, metric)
        known = {name: error for name, error in errors.items() if error is not None}
        if known:
            worst = max(known, key=lambda name: known[name])
            yield Limit(f"every metric, worst {worst}, ngspice to laws", known[worst], metric)
        # what rings on after a launch is coarse by choice: the body's own waves and its drive's
        coarse = [n for n, p in build.scene.parts.items() if p.type.reduced]
        coarse = coarse if solver.ringing == "coarse" else []
        owners = [(output, output.output.partition(".")[0]) for output in outputs]
        outputs = [o for o, n in owners if not any(n == c or n.startswith(f"{c}_") for c in coarse)]
        if outputs:
            last = max(outputs, key=lambda output: output.rms)
            yield Limit(f"every wave (rms), worst {last.output}, ngspice to laws", last.rms, wave)

    def _own_checks(self, waves: Waveforms) -> None:
        """Physics of the netlist's run that nobody told the simulator."""
        for check in verdict(waves, self.build).checks:
            if check.action == "fail" or check.name.startswith("jump"):
                self.checks.append(
                    Limit(f"{check.name}, ngspice", check.value, check.limit, check.unit)
                )

    def _full(self, ours: Solution, reference: Reference) -> None:
        """Full models in place of the reduced ones, as far as they are followed."""
        build = self.build
        full = full_build(build, self.clock)
        found = full and full_solution(
            build, full, ours.waves, reference, self.taken, self.clock, self.whole
        )
        if not found:
            return
        exact = solution(found.waves, build)
        laws, ours = (
            solution(_until(waves, found.end), build) for waves in (reference.results, ours.waves)
        )
        self._pair("rom_vs_fom", laws, exact)
        self._pair("ngspice_vs_fom", ours, exact)
        self.notes += found.notes
        if found.coarse is not None:
            self._stepped(exact, solution(found.coarse, build))
        curves = {"full model": exact.waves, "laws": laws.waves, "netlist, ngspice": ours.waves}
        self.figures += comparison("full", build.scene.name, curves, make_deck(build).units)

    def _stepped(self, exact: Solution, coarse: Solution) -> None:
        """What steps twice as long change must not decide over a gate."""
        for limit in gate_limits(_gates(self.build), "rom_vs_fom", coarse, exact)[0]:
            words = limit.name.replace("ROM to full model", "full model, steps halved")
            self.checks.append(replace(limit, name=words))
        moved = output_errors("steps", coarse.waves, exact.waves)
        if moved:
            worst = max(moved, key=lambda output: output.rms)
            self.notes.append(
                f"halving its steps moves the full model's waves by at most {worst.rms:.1e} (rms; "
                f"{worst.output})"
            )

    def _summary(self, bodies: Sequence[BodyFindings]) -> None:
        for pair in ("rom_vs_fom", "ngspice_vs_rom"):
            values = [body.errors[pair] for body in bodies if pair in body.errors]
            if values and pair not in self.errors:
                self.errors[pair] = max(values)
        if "rom_vs_fom" in self.errors:
            self.metrics["rom_error"] = self.errors["rom_vs_fom"]
        if len(bodies) == 1:
            model = self.build.model(bodies[0].name)
            self.metrics["rom_order"] = model.order
            if "unknowns" in model.facts:
                self.metrics["unknowns"] = model.facts["unknowns"]


def _until(waves: Waveforms, end: float | None) -> Waveforms:
    """The points up to ``end``, all of them where no time passes."""
    if end is None:
        return waves
    kept = waves["time"] <= end * (1 + 1e-12)
    return Waveforms({name: values[kept] for name, values in waves.data.items()}, waves.stats)


def _gates(build: Build) -> list[Gate]:
    parts = build.scene.parts.values()
    return [gate for part in parts for gate in part.type.gates(part, build)]


def _libraries(deck: Deck) -> tuple[Subcircuit, ...]:
    """Subcircuits of a deck, emitted or from disk."""
    if deck.text is None:
        return deck.parts
    return tuple(part for name, text in deck.more.items() for part in subcircuits(text, name))


def _record(found: Findings) -> dict[str, Any]:
    return {
        "passed": found.passed,
        "checks": [{**asdict(check), "passed": check.passed} for check in found.checks],
        "errors": found.errors,
        "metrics": found.metrics,
        "left_out": list(found.left_out),
        "outputs": [asdict(output) for output in found.outputs],
        "wall_s": found.wall_s,
        "notes": list(found.notes),
    }
