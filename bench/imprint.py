"""Plane ``imprint``: the sphere pushed into the chip in 250 static steps."""

import numpy as np

from bench.fullmodel import factorisations, full_surface, full_system
from bench.law import law
from bench.points import Outcome, Plane, Point, quick_timed, scaled, speed_up, timed
from bench.setup import keys_of
from bench.statics import pushed
from bench.usual.statics import imprint as full_imprint
from bench.usual.statics import imprint_refactorised
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.decks import make_deck

REFACTOR, LOW_RANK = 374.0, 100.0  # the paper's speed-up, and the one against the same trick
SAMPLED = 4  # depths of the refactorising code that are timed


def imprint(setup):
    """Static force over depth: both codes of the full model, the ROM, ngspice on its netlist."""
    scene = setup.scene("imprint")
    build, push = setup.build(scene), keys_of(scene, "push")
    electrical = keys_of(scene, "piezo_stack").electrical
    depth = np.linspace(0.0, push.depth, push.steps + 1)
    equations = law(build)
    rom, rom_time = quick_timed(lambda: pushed(equations, depth), setup.repeats)
    waves, deck_time = timed(
        lambda: run_deck(make_deck(build), setup.work / "imprint"), setup.repeats,
        "children",
    )  # fmt: skip
    system, surface = full_system(scene), full_surface(scene)
    with setup.clock.time_stage("imprint", "full model, low rank"):
        full, low_rank = timed(lambda: full_imprint(system, surface, depth, electrical), 1)
    taken = depth[-SAMPLED:]
    with setup.clock.time_stage("imprint", f"full model, {taken.size} refactorising depths"):
        usual, sample = timed(lambda: imprint_refactorised(system, surface, taken, electrical), 1)
    # It starts each depth from the springs that the last one closed.
    count, whole = int(usual.iterations.sum()), factorisations(full.ring_force)
    refactor = scaled(sample, whole / count)
    exact = system.sectors * full.force

    def error(force):
        loaded = exact > 1e-6 * exact.max()
        return float((np.abs(force - exact)[loaded] / exact[loaded]).max())

    rom_error, deck_error = error(rom), error(waves["contact.force"])
    reduced = Point("ROM", "ROM, numpy", rom_error, rom_time, {"force": rom_error})
    plane = Plane(
        "imprint", f"{scene.title}: {depth.size - 1} depths", "relative error of the force",
        "CPU time [s]",
        (
            Point("full model", "full model, refactorising", 0.0, refactor, {"force": 0.0}),
            Point("full model", "full model, low rank", 0.0, low_rank, {"force": 0.0}),
            reduced,
            Point("ngspice", "netlist, ngspice", deck_error, deck_time, {"force": deck_error}),
        ),
        (
            "The time of `full model, refactorising` is extrapolated from "
            f"{count} of {whole} factorisations",
        ),
    )  # fmt: skip
    ratios = tuple(
        speed_up(
            f"imprint_{name}", time, reduced, target,
            f"time of the {what} divided by time of the reduced model in numpy, both without the "
            f"assembly of matrices; ngspice takes {deck_time.median:.3g} s with an error of "
            f"{deck_error:.1e}",
        )
        for name, time, target, what in (
            ("low_rank", low_rank, LOW_RANK,
             "full model with one factorisation and low-rank updates for the contact"),
            ("refactor", refactor, REFACTOR, "full model with a factorisation at every depth"),
        )
    )  # fmt: skip
    return Outcome((plane,), ratios)
