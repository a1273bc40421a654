"""The planes of impact and loop: launch or rebound error against CPU time, all methods."""

from dataclasses import replace
from functools import partial

from bench.distance import compare
from bench.law import law
from bench.located import integrate, located
from bench.lower_bound import LowerBound
from bench.points import Plane, Point, rounds, timed, timing
from bench.variants import SHORT, fixed_steps, launches, variants
from kc2spice.core.errors import MissingToolError, SimulationError
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.verify.law_solution import solve_laws

# As fine as the steps of ngspice's own tolerances, so that both are tuned alike.
RTOL = (1e-3, 1e-4, 5e-4, 3e-4, 2e-4, 5e-5, 3e-5, 2e-5, 1e-5, 1e-6)
METHODS = ("Radau", "LSODA", "BDF", "DOP853")
SPECIALISED = "scipy, specialised"
FACTS = ("accepted", "rejected", "iterations")


class Transient:
    """One scene with its exact solution; points are measured against that."""

    def __init__(self, scene, setup):
        self.scene, self.setup = scene, setup
        self.thrown = scene.find_only_part("throw") is not None
        self.build = setup.build(scene)
        self.decks = {}  # what ngspice gave, by label
        self.law = law(self.build)
        self.massless = None  # exact solution of the form without inertia
        with setup.clock.time_stage(scene.name, "exact solution"):
            self.exact = located(self.law, scene)

    def plane(self):
        """All methods on the scene's reduced model."""
        points, notes = self._rounds([*self._ngspice(), *self._scipy(), *self._lower_bound()])
        what = "rebound" if self.thrown else "launch"
        reference = "The reference solution is an integration of the reduced model"
        notes.append(f"{reference} with a relative tolerance of 1e-9")
        notes.append(
            "Methods that neglect the inertia at the contact are compared with a solution of the "
            "reference integrator of kc2spice that also neglects this inertia"
        )
        notes.append(
            "The time of ngspice is the CPU time of the whole process, including start-up and the "
            "reading and writing of files"
        )
        notes.append(
            "The table does not contain pyMOR, because the time steppers of pyMOR cannot simulate "
            "the nonlinear contact"
        )
        return Plane(
            "impact" if self.thrown else "loop",
            f"{self.scene.title}: {self.scene.stop_time * 1e3:g} ms",
            f"relative error of the {what} velocity", "CPU time [s]", tuple(points), tuple(notes),
        )  # fmt: skip

    def _rounds(self, work):
        """All points, each measured once a round: a slow minute of the machine meets them alike.

        Long ones are measured in the first rounds only; what fails there is a note.
        """
        points, seconds, notes, repeats = {}, {}, [], self.setup.repeats
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

    def point(self, family, label, waves, time, note="", against=None):
        """A point from its waveforms; ``against`` another exact solution than the plane's."""
        found = compare(waves, against or self.exact)
        errors = {name: found[name] for name in ("launch", "position_m")}
        if errors["launch"] is None:
            raise SimulationError("the sphere does not leave", where=label)
        facts = {name: waves.stats[name] for name in FACTS if name in waves.stats}
        return Point(family, label, errors["launch"], time, errors, facts, note)

    def _ngspice(self):
        found = [*variants(self.build, self.setup)]
        if not self.thrown:
            found.append(fixed_steps(self.build))
        work = [(v.label, partial(self._deck, v)) for v in found]
        if not self.thrown:
            build = self.setup.build(self.setup.scene(self.scene.name, lumped=False))
            work += [
                (v.label, partial(self._massless, v, build)) for v in launches(build, self.setup)
            ]
        return work

    def _massless(self, variant, build):
        """A deck without inertia behind the contact, against the reference of ``build``.

        That is the product's own integration, located events included; no netlist in it.
        """
        if self.massless is None:
            fine = run_deck(make_deck(build), self.setup.work / "reference")
            self.massless = solve_laws(build, fine).results
        return self._deck(variant, self.massless)

    def _deck(self, variant, against=None):
        folder = self.setup.work / self.scene.name
        waves, time = timed(lambda: run_deck(variant.deck, folder), 1, "children")
        point = self.point(variant.family, variant.label, waves, time, variant.note, against)
        self.decks[variant.label] = waves
        return point

    def _scipy(self):
        work = []
        for method in self.setup.some(METHODS, 1):
            if method in ("BDF", "DOP853") and self.scene.stop_time > SHORT:
                continue
            for rtol in self.setup.some(RTOL):
                label = f"{method}, rtol {rtol:g}"
                work.append((label, partial(self._solve_ivp, method, rtol, label)))
        for rtol in self.setup.some(RTOL[1:]):
            label = f"Radau, events located, modes exact in flight, rtol {rtol:g}"
            work.append((label, partial(self._located, rtol, label)))
        return work

    def _solve_ivp(self, method, rtol, label):
        waves, time = timed(lambda: integrate(self.law, self.scene, method, rtol), 1)
        return self.point(
            f"scipy, {method}", label, waves, time, "restarted at the edges of the drive pulse"
        )

    def _located(self, rtol, label):
        waves, time = timed(lambda: located(law(self.build), self.scene, rtol), 1)
        note = "not a general integrator: the code assumes that only the contact couples the modes"
        return self.point(SPECIALISED, label, waves, time, note)

    def _lower_bound(self):
        bound = LowerBound(self.law)

        def kept():
            bound.run(self.scene)
            run = timed(lambda: bound.run(self.scene), 1)
            note = (
                "exact steps with stored eigenvectors for each set of closed contacts; "
                "compiled flight"
            )
            return self.point("lower bound", "lower bound", *run, note)

        return [("lower bound", kept)]
