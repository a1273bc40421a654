"""``verify``: every scene by its parts, one record and one page for all."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

from kc2spice.core.errors import UsageError
from kc2spice.core.files import staged
from kc2spice.core.progress import Clock, Progress, silent
from kc2spice.report.figures import draw_all
from kc2spice.report.verdict import Findings
from kc2spice.report.verify_figures import comparison, responses
from kc2spice.report.verify_page import table_section, write_verify
from kc2spice.scene.gates import Cost, FullSolution, Gate, Limit, Table
from kc2spice.scene.hash import scene_hash
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.sim.ngspice import find_ngspice, run_deck, write_deck
from kc2spice.spice.circuit import Subcircuit
from kc2spice.spice.deck import Deck
from kc2spice.spice.read import subcircuits
from kc2spice.spice.scan import third_party
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

METRICS, WAVES = 10.0, 200.0  # times solver.reltol: gates of a transient unless the scene says
STEADY_METRICS, STEADY_WAVES = 5e-9, 3e-8  # the same for analyses without time steps
# What was recorded on a net is as good as its samples: its slope, thus the current into a
# capacitance, is right to some 1e-3 (2.5e-3 at the edges of a half-bridge), its work to 5e-6.
RECORDED, RECORDED_BALANCE = 5.0, 1e-5


def verify(
    scenes: Sequence[Scene],
    out: Path,
    *,
    full: bool = False,
    meshes: bool = False,
    deck: Deck | None = None,
    trust: bool = False,
    progress: Progress = silent,
) -> dict[str, dict[str, Any]]:
    """Verify ``scenes``, write ``verify.json``, ``verify.html`` and plots into ``out``.

    Parameters
    ----------
    full : take every baseline in full instead of a timed sample of it.
    meshes : add the mesh study of the first part that has one.
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
    tables: dict[str, Table] = {}
    with staged(out) as work:
        for scene in scenes:
            progress("verify", None, scene.name)
            folder = work / scene.name
            folder.mkdir()
            clock = Clock(progress)
            build = build_models(scene, clock, trust=trust)
            with TemporaryDirectory() as scratch:
                result = _Verification(build, clock, Path(scratch), full, deck).findings()
            if meshes and not tables:
                tables |= _mesh_study(build, clock, full)
            with clock.stage("report", "plots"):
                pictures = draw_all(folder, result.figures)
            found[scene.name] = replace(result, pictures=tuple(pictures))
        sections = [table_section(table) for table in tables.values()]
        write_verify(work / "verify.html", found, sections)
        records = {name: _record(each) for name, each in found.items()}
        for name, table in tables.items():
            records[name]["meshes"] = [dict(row) for row in table.records]
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


def _mesh_study(build: Build, clock: Clock, full: bool) -> dict[str, Table]:
    for part in build.scene.parts.values():
        table = part.type.mesh_study(part, build, clock, full)
        if table is not None:
            return {build.scene.name: table}
    return {}


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
    costs: list[Cost] = field(default_factory=list)
    outputs: list[OutputError] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    figures: list[Any] = field(default_factory=list)
    speedup: dict[str, float] = field(default_factory=dict)
    metrics: dict[str, Any] = field(default_factory=dict)
    taken: Mapping[str, str] = field(default_factory=dict)

    def findings(self) -> Findings:
        """Bodies, then the scene, then what the full model says of it."""
        deck = self._deck(self.build, self.shipped)
        libraries = _libraries(deck)
        bodies = self._bodies(libraries)
        missing = without_law(self.build)
        timed = self.build.scene.analysis.type == "transient"
        self.taken = (taken_nets(self.build) if missing and timed else None) or {}
        if self.taken:
            self.notes.append(
                "left out, for they have no law: " + ", ".join(missing) + "; the others are given "
                "what ngspice has on the nets where they meet them: " + ", ".join(self.taken)
            )
            ours, spent = self._compared(deck.saving(taken_vectors(self.taken)))
        elif missing:
            self.notes.append(
                "left out, for they have no law: " + ", ".join(missing)
                + "; the scene as a whole is not compared, its bodies are"
            )  # fmt: skip
            waves, spent = self._ngspice(self.build, deck, "scene")
            self._own_checks(self.build, waves)
            ours = solution(waves, self.build)
            self.metrics |= ours.metrics
        else:
            ours, spent = self._compared(deck)
        self._full(ours, spent)
        self._summary(bodies, spent)
        return Findings(
            checks=tuple(self.checks),
            errors=self.errors,
            speedup=self.speedup,
            costs=tuple(self.costs),
            metrics=self.metrics,
            outputs=tuple(self.outputs),
            notes=tuple(self.notes),
            left_out=missing,
            shipped=_shipped(self.build.scene),
            figures=tuple(self.figures),
        )

    # --- solution paths -----------------------------------------------------------------------

    def _deck(self, build: Build, shipped: Deck | None) -> Deck:
        """The emitted deck, or the shipped one with the names that the scene gives its results."""
        own = make_deck(build)
        if shipped is None:
            return own
        return replace(
            own, name=shipped.name, text=shipped.text, more=shipped.more, parts=(), blocks=(),
            options=(),
        )  # fmt: skip

    def _ngspice(self, build: Build, deck: Deck, folder: str) -> tuple[Any, float]:
        started = time.perf_counter()
        with self.clock.stage("simulate", f"ngspice, {build.scene.name}") as share:
            waves = run_deck(deck, self.work / folder, progress=share)
        return waves, time.perf_counter() - started

    def _reference(self, build: Build, waves: Any) -> tuple[Reference, float]:
        started = time.perf_counter()
        with self.clock.stage("reference", "laws of the reduced models, events located"):
            found = solve(build, waves, self.taken if build is self.build else {})
        return found, time.perf_counter() - started

    # --- comparisons --------------------------------------------------------------------------

    def _bodies(self, libraries: Sequence[Subcircuit]) -> list[BodyFindings]:
        found = []
        gate = self.build.scene.gates.harmonic_ngspice
        for part in self.build.scene.parts.values():
            if part.type.reduced:
                body = verify_body(
                    part, self.build, libraries, self.clock, self.work / part.name, self.whole,
                    gate,
                )  # fmt: skip
                self.checks += body.checks
                self.costs += body.costs
                self.notes += body.notes
                self.figures += responses(body.name, body.curves)
                found.append(body)
        return found

    def _compared(self, deck: Deck) -> tuple[Solution, float]:
        """The scene in ngspice against its laws."""
        build = self.build
        waves, spent = self._ngspice(build, deck, "scene")
        reference, took = self._reference(build, waves)
        ours, exact = solution(waves, build), solution(reference.results, build)
        self._pair("ngspice_vs_rom", build, ours, exact)
        self._own_checks(build, waves)
        if reference.imbalance is not None:
            limit = RECORDED_BALANCE if self.taken else build.scene.gates.energy
            self.checks.append(Limit("energy of the reference integration",
                                     reference.imbalance, limit))  # fmt: skip
        self.costs += [Cost("laws, reference integrator", took),
                       Cost("netlist, ngspice", spent, "laws")]  # fmt: skip
        curves = {"laws": reference.results, "netlist, ngspice": waves}
        self.figures += comparison("scene", build.scene.name, curves, deck.units)
        self.metrics |= ours.metrics
        return ours, spent

    def _pair(
        self, pair: str, build: Build, ours: Solution, exact: Solution, piece: str = "",
        everything: bool = True,
    ) -> None:  # fmt: skip
        """Gates of the parts; for ngspice against the laws every metric and every wave too."""
        limits, leading = gate_limits(_gates(build), pair, ours, exact, piece)
        self.checks += limits
        outputs = output_errors(pair, ours.waves, exact.waves)
        self.outputs += outputs
        if everything and pair == "ngspice_vs_rom":
            self.checks += self._generic(build, ours, exact, outputs)
        if leading is None and outputs:
            leading = max(output.rms for output in outputs)
        if leading is not None:
            self.errors[pair] = leading

    def _generic(
        self, build: Build, ours: Solution, exact: Solution, outputs: Sequence[OutputError]
    ) -> Iterable[Limit]:
        gates, solver = build.scene.gates, build.scene.solver
        timed = build.scene.analysis.type == "transient"
        metric = gates.metrics or (METRICS * solver.reltol if timed else STEADY_METRICS)
        metric *= RECORDED if self.taken else 1.0
        wave = gates.waves or (WAVES * solver.reltol if timed else STEADY_WAVES)
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

    def _own_checks(self, build: Build, waves: Any) -> None:
        """Physics of the netlist's run that nobody told the simulator."""
        for check in verdict(waves, build).checks:
            if check.action == "fail" or check.name.startswith("jump"):
                self.checks.append(
                    Limit(f"{check.name}, ngspice", check.value, check.limit, check.unit)
                )

    def _full(self, ours: Solution, spent: float) -> None:
        """The first part that can solve the scene with its full model."""
        for part in self.build.scene.parts.values():
            found = part.type.full_solution(part, self.build, self.clock, self.whole)
            if found is None:
                continue
            build, piece = found.build, found.piece
            exact = solution(found.waves, build)
            if build is not self.build:
                deck = self._deck(build, None)
                waves, spent = self._ngspice(build, deck, "piece")
                ours = solution(waves, build)
            reference, _ = self._reference(build, ours.waves)
            laws = solution(reference.results, build)
            self._pair("rom_vs_fom", build, laws, exact, piece)
            if build is not self.build:
                self._pair("ngspice_vs_rom", build, ours, laws, piece, everything=False)
            self._pair("ngspice_vs_fom", build, ours, exact, piece)
            self._told(found, spent)
            curves = {"full model": found.waves, "laws": laws.waves,
                      "netlist, ngspice": ours.waves}  # fmt: skip
            units = make_deck(build).units
            self.figures += comparison("full", f"{build.scene.name}{piece}", curves, units)
            return

    def _told(self, found: FullSolution, spent: float) -> None:
        self.checks += found.checks
        self.notes += found.notes
        self.metrics |= found.metrics
        self.costs.append(Cost(f"full model{found.piece}", found.wall_s))
        for name, seconds in found.baselines.items():
            self.speedup[name] = seconds / spent
            self.costs.append(Cost(f"full model, {name.replace('_', ' ')}", seconds))

    def _summary(self, bodies: Sequence[BodyFindings], spent: float) -> None:
        for pair in ("rom_vs_fom", "ngspice_vs_rom"):
            values = [body.errors[pair] for body in bodies if pair in body.errors]
            if values and pair not in self.errors:
                self.errors[pair] = max(values)
        scene = self.build.scene
        self.metrics["simulate_wall_s"] = self.metrics["rom_wall_s"] = spent
        if scene.analysis.type == "dc":
            self.metrics["rom_step_wall_s"] = spent / scene.analysis.points
        if "rom_vs_fom" in self.errors:
            self.metrics["rom_error"] = self.errors["rom_vs_fom"]
        if len(bodies) == 1:
            model = self.build.model(bodies[0].name)
            self.metrics["rom_order"] = model.order
            if "unknowns" in model.facts:
                self.metrics["unknowns"] = model.facts["unknowns"]


def _shipped(scene: Scene) -> bool:
    """Whether a scene is the gallery's of its name, with no key changed."""
    try:
        return scene_hash(load_scene(scene.name)) == scene_hash(scene)
    except UsageError:
        return False


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
        "speedup": found.speedup,
        "metrics": found.metrics,
        "left_out": list(found.left_out),
        "outputs": [asdict(output) for output in found.outputs],
        "costs": [asdict(cost) for cost in found.costs],
        "notes": list(found.notes),
    }
