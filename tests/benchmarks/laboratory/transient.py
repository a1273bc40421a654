"""The planes of impact and loop: launch or rebound error against CPU time, all methods."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from kc2spice.core.errors import MissingToolError, SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.scene.settings import Rom
from kc2spice.sim.loop import run_shared
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.verify.circuit import solve
from laboratory.distance import compare
from laboratory.law import Law, law
from laboratory.located import located
from laboratory.lower_bound import LowerBound
from laboratory.peers import integrate
from laboratory.points import Plane, Point, Timing, rounds, timed, timing
from laboratory.setup import Setup
from laboratory.variants import SHORT, Variant, fixed_steps, launches, variants

REDUCTIONS = (
    Rom(tolerance=1e-4), Rom(tolerance=1e-5), Rom(tolerance=1e-6), Rom(tolerance=2e-7),
    Rom(order=21), Rom(order=42),
)  # fmt: skip
BUDGET, BUDGETED = 1e-4, "error_budget 1e-4"
FINEST = Rom(order=84)  # of the form without inertia
EXACT = Rom(tolerance=1e-8)  # stands for the full model: its own error is far below all others
Work = list[tuple[str, Callable[[], Point]]]

# As fine as the steps of ngspice's own tolerances, so that both are tuned alike.
RTOL = (1e-3, 1e-4, 5e-4, 3e-4, 2e-4, 5e-5, 3e-5, 2e-5, 1e-5, 1e-6)
METHODS = ("Radau", "LSODA", "BDF", "DOP853")
FACTS = ("accepted", "rejected", "iterations")
FIELDS = {"launch": "velocity_relative", "position_m": "trajectory_m"}


class Transient:
    """One scene with its exact solution; points are measured against that."""

    def __init__(self, scene: Scene, setup: Setup) -> None:
        self.scene, self.setup = scene, setup
        self.thrown = scene.only("throw") is not None
        self.build = setup.build(scene)
        self.decks: dict[str, Waveforms] = {}  # what ngspice gave, by label
        self.law: Law = law(self.build)
        self.best: Waveforms | None = None
        self.references: dict[str, Waveforms] = {}  # of the form without inertia, by reduction
        with setup.clock.stage(scene.name, "exact solution"):
            self.exact = located(self.law, scene)

    def plane(self) -> Plane:
        """All methods on the scene's reduced model, and other reductions of the chip."""
        points, notes = self._rounds(
            [*self._ngspice(), *self._scipy(), *self._lower_bound(), *self._reductions()]
        )
        what = "rebound" if self.thrown else "launch"
        notes.append(
            f"errors against the same reduced model, integrated to 1e-9; those of other "
            f"reductions against one of tolerance {EXACT.tolerance:g}"
        )
        notes.append(
            "those without inertia at the contact against the product's reference integration of "
            f"the same equations; {BUDGETED} against one of {FINEST.order} states"
        )
        notes.append("time of ngspice is CPU of the whole process, start-up and files included")
        notes.append("pyMOR's time steppers take linear models only: contact is beyond them")
        return Plane(
            "impact" if self.thrown else "loop",
            f"{self.scene.title}: {self.scene.stop * 1e3:g} ms",
            f"relative error of the {what} velocity", "CPU time [s]", tuple(points), tuple(notes),
        )  # fmt: skip

    def _rounds(self, work: Work) -> tuple[list[Point], list[str]]:
        """All points, each measured once a round: a slow minute of the machine meets them alike.

        Long ones are measured in the first rounds only; what fails there is a note.
        """
        points: dict[str, Point] = {}
        seconds: dict[str, list[float]] = {}
        notes = []
        repeats = self.setup.repeats
        for turn in range(repeats):
            for done, (label, measure) in enumerate(work):
                if turn and (label not in points or turn >= rounds(seconds[label], repeats)):
                    continue
                share = (turn + done / len(work)) / repeats
                self.setup.clock.progress(self.scene.name, share, label)
                try:
                    point = measure()
                except (SimulationError, MissingToolError) as error:
                    notes.append(f"{label}: {error.message}")
                    continue
                points[label] = point
                seconds.setdefault(label, []).append(point.time.median)
        return [replace(p, time=timing(seconds[label])) for label, p in points.items()], notes

    def point(
        self, family: str, label: str, waves: Waveforms, time: Timing, note: str = "",
        against: Waveforms | None = None, own: bool = False,
    ) -> Point:  # fmt: skip
        """A point from its waveforms; ``against`` another exact solution than the plane's.

        ``own`` says that it solves the very equations of the netlist, as the plane's does.
        """
        found = compare(waves, against or self.exact)
        errors = {name: found[key] for name, key in FIELDS.items()}
        if errors["launch"] is None:
            raise SimulationError("the sphere does not leave", where=label)
        facts = {name: waves.stats[name] for name in FACTS if name in waves.stats}
        return Point(
            family, label, errors["launch"], time, errors, facts, note, own or against is None
        )  # fmt: skip

    def _ngspice(self) -> Work:
        found = [*variants(self.build, self.setup)]
        if not self.thrown:
            found.append(fixed_steps(self.build))
        work: Work = [(v.label, partial(self._deck, v)) for v in found]
        if not self.thrown:
            build = self.setup.build(self.setup.scene(self.scene.name, lumped=False))
            work += [
                (v.label, partial(self._massless, v, build, "its own"))
                for v in launches(build, self.setup)
            ]
        return [*work, ("shared engine", self._shared)]

    def _massless(self, variant: Variant, build: Build, model: str) -> Point:
        """A deck without inertia behind the contact, against the reference of ``build``.

        That is the product's own integration, located events included; no netlist in it.
        """
        if model not in self.references:
            fine = run_deck(make_deck(build), self.setup.work / "reference")
            self.references[model] = solve(build, fine).results
        return self._deck(variant, self.references[model], own=model == "its own")

    def _deck(
        self, variant: Variant, against: Waveforms | None = None, *, own: bool = False
    ) -> Point:
        folder = self.setup.work / self.scene.name
        waves, time = timed(lambda: run_deck(variant.deck, folder), 1, "children")
        point = self.point(variant.family, variant.label, waves, time, variant.note, against, own)
        self.decks[variant.label] = waves
        log = (folder / variant.deck.main).with_suffix(".log").read_text(encoding="utf-8")
        return replace(point, facts={**point.facts, **profile(log)})

    def _shared(self) -> Point:
        deck = make_deck(self.build)
        waves, time = timed(lambda: run_shared(deck), 1)
        note = "libngspice within Python"
        return self.point("ngspice, shared engine", "shared engine", waves, time, note)

    def _scipy(self) -> Work:
        short = self.scene.stop <= SHORT
        work: Work = []
        for method in self.setup.some(METHODS, 1):
            slow = method in ("BDF", "DOP853")
            if slow and not (short or self.setup.full_sweep):
                continue
            for rtol in self.setup.some(RTOL):
                label = f"{method}, rtol {rtol:g}"
                work.append((label, partial(self._solve_ivp, method, rtol, label)))
        for rtol in self.setup.some(RTOL[1:]):
            label = f"Radau, events located, modes exact in flight, rtol {rtol:g}"
            work.append((label, partial(self._located, rtol, label)))
        return work

    def _solve_ivp(self, method: str, rtol: float, label: str) -> Point:
        waves, time = timed(lambda: integrate(self.law, self.scene, method, rtol), 1)
        return self.point(f"scipy, {method}", label, waves, time, "restarted at the pulse's edges")

    def _located(self, rtol: float, label: str) -> Point:
        waves, time = timed(lambda: located(law(self.build), self.scene, rtol), 1)
        note = "not a general integrator: knows that nothing but contact couples the modes"
        return self.point("scipy, specialised", label, waves, time, note)

    def _lower_bound(self) -> Work:
        def whole() -> Point:
            run = timed(lambda: LowerBound(self.law).run(self.scene), 1)
            note = "eigenvectors of every contact set, then exact steps; flight compiled"
            return self.point("lower bound", "lower bound", *run, note)

        def kept() -> Point:
            bound = LowerBound(self.law)
            bound.run(self.scene)
            run = timed(lambda: bound.run(self.scene), 1)
            return self.point("lower bound", "lower bound, eigenvectors kept", *run)

        return [("lower bound", whole), ("lower bound, eigenvectors kept", kept)]

    def _reductions(self) -> Work:
        work: Work = [
            (f"{rom.order or rom.tolerance}", partial(self._reduced, rom)) for rom in self._roms()
        ]
        return work if self.thrown else [*work, (BUDGETED, self._budgeted)]

    def _reduced(self, rom: Rom) -> Point:
        build = self.setup.build(self.scene, rom)
        order = law(build).q
        target = f"order {order}" if rom.order else f"tolerance {rom.tolerance:g}, {order} modes"
        variant = Variant("ngspice, reduction", target, make_deck(build))
        return self._deck(variant, self._best())

    def _budgeted(self) -> Point:
        """The scene at the settings that an error budget chooses."""
        shipped = self.setup.scene(self.scene.name, lumped=False)
        asked = load_scene(shipped, {"error_budget": BUDGET})
        ideal = load_scene(shipped, {"control.form": "ideal"})
        variant = Variant("ngspice, error budget", BUDGETED, make_deck(self.setup.build(asked)))
        return self._massless(variant, self.setup.build(ideal, FINEST), "84 states")

    def _best(self) -> Waveforms:
        """What stands for the full model, integrated exactly."""
        if self.best is None:
            self.best = located(law(self.setup.build(self.scene, EXACT)), self.scene)
        return self.best

    def _roms(self) -> tuple[Rom, ...]:
        return REDUCTIONS[2:3] if self.setup.quick else REDUCTIONS


def profile(log: str) -> dict[str, float]:
    """Shares of the transient's time by ngspice's own clock: loading devices, LU, step control.

    The rest are convergence tests, prediction and the writing of points. The clock is the wall's.
    """
    found = dict(re.findall(r"Transient (\w+) time = ([0-9.eE+-]+)", log))
    if not {"analysis", "load", "factor", "solve", "trunc"} <= set(found):
        return {}
    time = {name: float(value) for name, value in found.items()}
    parts = {
        "load": "load",
        "factor": "factorisation",
        "solve": "solution",
        "trunc": "step control",
    }
    return {f"share of {parts[k]}": time[k] / (time["analysis"] or 1.0) for k in parts}
