"""Flight and catch: table limits, saturation, long runs; oracles: scipy and closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from device import chip, deck_of, magnets
from hard_cases.kit import HEADER, bench_deck, case, exact, scene

from kc2spice.parts._opamp import opamp_subcircuit
from kc2spice.parts.pid import Control, pid_subcircuit
from kc2spice.scene.load import load_scene
from laboratory.distance import compare

FEW = 12


def loop_error(bench, *overrides):
    """Largest distance [m] from scipy's trajectory."""
    study, model = scene("kick_and_catch", *overrides), chip(FEW)
    waves = bench.scene(study, model)
    return compare(waves, exact(study, waves, model, magnets()))["trajectory_m"]


@case("saturated controller with integrator", "distance from scipy [m]", 1e-6, slow=True)
def saturation_without_windup(bench):
    return loop_error(bench, "control.ki=1e3 A/(m s)", "control.current_limit=30 mA",
                      "solver.stop=4 ms")  # fmt: skip


@case("saturated controller with integrator", "distance from scipy [m]", 1e-6, slow=True)
def bang_bang(bench):
    """Ten times the gains: the current jumps from limit to limit."""
    return loop_error(bench, "control.kp=5e5 A/m", "control.kd=200 A s/m", "solver.stop=2 ms")


@case("saturated controller with integrator", "current after 2 ms at the limit", 1e-3)
def integrator_held_in_saturation(bench):
    """Just past the set point after 2 ms far below it: only P acts, nothing has wound up."""
    control = Control(ki=1e3)
    cards = """Vy y 0 PWL(0 1000 2e-03 1000 2.01e-03 2501 3e-03 2501)
Venable enable 0 PULSE(0 1 1e-06 1e-08 1e-08 1)
Xpid y enable drive ret 0 pid
Rcoils drive ret 3192
.options reltol=1e-5 trtol=1
.tran 1e-07 0.003 0 1e-06"""
    parts = [opamp_subcircuit(HEADER), pid_subcircuit(HEADER, control)]
    waves = bench.run(bench_deck(parts, cards, {"i": ("@rcoils[i]", 1.0)}, 3e-3))
    law = -control.kp * 1e-6 - control.ki * 1e-6 * 0.99e-3
    return abs(waves["i"][-1] - law) / control.current_limit


@case("sphere leaves the field table", "above", refused="table_left")
def out_at_the_top(bench):
    tables = {
        "name": "kick_and_catch", "kick": {"drive": {"voltage": 150.0}},
        "contact": {"rings": "all"}, "sphere": {}, "catch": {}, "solver": {"stop": 5e-3},
    }  # fmt: skip
    bench.scene(load_scene(tables), chip(FEW))
    return 0.0


@case("sphere leaves the field table", "below", refused="table_left")
def out_at_the_bottom(bench):
    """Rings and springs so soft that the resting sphere sinks below a table cut off just there."""
    study = scene("kick_and_catch", "contact.penalty=1e6 N/m", "catch.y_min=0.99999 mm",
                  "kick.drive.voltage=150 V", "solver.stop=1 ms")  # fmt: skip
    table = magnets()
    keep = table.y > 0.9999e-3
    short = replace(table, **{
        name: getattr(table, name)[keep]
        for name in ("y", "c0", "c1", "c2", "c11", "c12", "c22", "flux0", "inductance")
    })  # fmt: skip
    bench.scene(study, chip(FEW), short)
    return 0.0


@case("50 ms of flight", "rest position after 50 ms [m]", 1e-6)
def caught_for_50_ms(bench):
    """The integrator has all the time to bring the sphere to the set point."""
    study = scene("kick_and_catch", "solver.stop=50 ms")
    waves = bench.scene(study, chip(FEW))
    return abs(waves["sphere.y"][-1] - 2.5e-3)


@case("all at once", "distance from scipy [m]", 1e-6, slow=True)
def fast_edges_stiff_springs_light_damping(bench):
    study = scene("kick_and_catch", "kick.drive.edge=1 ns", "contact.penalty=1e10 N/m",
                  "solver.stop=1.5 ms", "checks.touches=warn")  # fmt: skip
    model = chip(FEW, damping=1e-3)  # whose many touches would have the run refined: not here
    waves = bench.scene(study, model)
    return compare(waves, exact(study, waves, model, magnets()))["trajectory_m"]


@case("all at once", "difference of two runs [m]", 0.0)
def two_runs_of_one_deck(bench):
    """The same scene twice gives the same points, to the last bit: no state is left behind."""
    study, model = scene("kick_and_catch", "solver.stop=1 ms"), chip(FEW)
    deck = deck_of(study, model, magnets())
    first, second = bench.run(deck), bench.run(deck)
    if first["time"].size != second["time"].size:
        return np.inf
    return float(np.abs(first["sphere.y"] - second["sphere.y"]).max())
