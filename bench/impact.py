"""Plane ``impact``: a free sphere hits the chip, the full model among the solution methods."""

from dataclasses import replace

import numpy as np

from bench.distance import compare
from bench.fullmodel import as_waveforms, factorisations, full_surface, full_system, limit
from bench.points import Outcome, Point, fastest, scaled, speed_up, timed
from bench.setup import keys_of
from bench.transient import Transient
from bench.usual.transient import Ball, transient

PAPER_STEP = 50e-9  # s, of the paper's Newmark integration (2.2.2)
SAMPLED = 6  # steps of the refactorising code that are timed
LIMIT = 1e-4  # of rebound velocity and travel
REFACTOR, LOW_RANK = 1784.0, 100.0  # the paper's speed-up, and the one against the same trick


def impact(setup):
    """All methods of the impact; speed-ups of the netlist over both codes of the full model."""
    scene = setup.scene("impact")
    transient = Transient(scene, setup)
    plane, full = transient.plane(), _FullModel(scene, setup)
    limits = {"launch": LIMIT, "position_m": LIMIT * full.travel}
    own = fastest((p for p in plane.points if p.label in transient.decks), limits)
    errors = {} if own is None else full.errors(transient.decks[own.label])
    ratios = tuple(
        speed_up(
            f"impact_{name}", time, own, target,
            f"time of the {what} divided by time of ngspice, both without the "
            f"assembly of matrices; ngspice with {own and own.label}, the "
            f"fastest setting within {LIMIT:g} of the exact reduced model; errors relative to the "
            "full model with converged time step", error=errors.get("launch"), errors=errors,
        )
        for name, time, target, what in (
            ("low_rank", full.low_rank, LOW_RANK,
             "full model with one factorisation and low-rank updates for the contact"),
            ("refactor", full.refactorising, REFACTOR,
             "full model with a factorisation in every iteration"),
        )
    )  # fmt: skip
    points = (*plane.points, *full.points())
    notes = (*plane.notes, f"The time of `full model, refactorising` is extrapolated {full.how}")
    return Outcome((replace(plane, points=points, notes=notes),), ratios)


class _FullModel:
    """Both codes of the full model at the paper's step, and its limit of small steps."""

    def __init__(self, scene, setup):
        self.stop, self.system, self.surface = (
            scene.stop_time,
            full_system(scene),
            full_surface(scene),
        )
        throw, sphere = keys_of(scene, "throw"), keys_of(scene, "sphere")
        mass = sphere.mass / self.system.sectors
        self.ball = Ball(mass, throw.gap, throw.velocity, scene.gravity)

        def waves(result):
            return as_waveforms(result, sphere.radius, self.system.sectors)

        step = 2.5 * PAPER_STEP if setup.quick else PAPER_STEP
        steps = round(self.stop / step)
        with setup.clock.time_stage("impact", "full model, converged in time"):
            fine = step if setup.quick else step / 5
            self.exact = limit(waves(self._run(2 * fine)), waves(self._run(fine)))
        self.travel = float(np.ptp(self.exact["sphere.y"]))
        with setup.clock.time_stage("impact", "full model, low rank"):
            result, self.low_rank = timed(lambda: self._run(step), 1)
        self.waves = waves(result)
        touching = replace(self.ball, height=0.0)  # the timed steps are all in contact
        with setup.clock.time_stage("impact", f"full model, {SAMPLED} refactorising steps"):
            taken, sample = timed(
                lambda: self._run(step, touching, SAMPLED * step, "refactorise"), 1
            )
        whole = factorisations(result.ring_force[1:])
        self.refactorising = scaled(sample, whole / taken.factorisations)
        self.how = f"from {taken.factorisations} of the {whole} factorisations in {steps} steps"

    def _run(self, step, ball=None, stop=None, method="low_rank"):
        return transient(
            self.system, self.surface, ball or self.ball, step=step, stop=stop or self.stop,
            is_open=True, method=method,
        )  # fmt: skip

    def points(self):
        """Errors here are against the full model, which is this method's own limit."""
        errors = self.errors(self.waves)
        error = errors["launch"] or 0.0
        note = "error relative to the full model with converged time step"
        return tuple(
            Point("full model", label, error, time, errors, {}, note, False)
            for label, time in (
                ("full model, low rank", self.low_rank),
                ("full model, refactorising", self.refactorising),
            )
        )

    def errors(self, waves):
        """Errors of a method relative to the full model at its limit."""
        return compare(waves, self.exact)
