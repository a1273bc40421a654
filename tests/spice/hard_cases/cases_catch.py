"""Flight and catch: table limits."""

from dataclasses import replace

from device import chip, magnets
from hard_cases.kit import case, scene
from support import load_scene

FEW = 12


@case(
    "sphere leaves the field table",
    "position above the force table",
    refused="outside the force table",
)
def sphere_leaves_at_the_top(bench):
    tables = {
        "name": "kick_and_catch", "kick": {"drive": {"voltage": 150.0}},
        "contact": {"rings": "all"}, "sphere": {}, "catch": {}, "solver": {"stop": 5e-3},
    }  # fmt: skip
    bench.scene(load_scene(tables), chip(FEW))
    return 0.0


@case(
    "sphere leaves the field table",
    "position below the force table",
    refused="outside the force table",
)
def sphere_leaves_at_the_bottom(bench):
    """Rings and springs so soft that the resting sphere sinks below a table cut off just there."""
    study = scene("kick_and_catch", "contact.penalty=1e6 N/m", "catch.y_min=0.99999 mm",
                  "kick.drive.voltage=150 V", "solver.stop=1 ms")  # fmt: skip
    table = magnets()
    keep = table.y > 0.9999e-3
    short = replace(table, **{
        name: getattr(table, name)[keep]
        for name in ("y", "coefficients", "flux0", "inductance")
    })  # fmt: skip
    bench.scene(study, chip(FEW), short)
    return 0.0
