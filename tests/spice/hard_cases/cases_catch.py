"""Flight and catch: table limits, saturation, long runs; oracles: scipy and closed forms."""

from __future__ import annotations

from dataclasses import replace

from device import chip, magnets
from hard_cases.kit import HEADER, bench_deck, case, scene

from kc2spice.parts._template import opamp_subcircuit
from kc2spice.parts.pid import Control, pid_subcircuit
from kc2spice.scene.load import load_scene

FEW = 12


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
