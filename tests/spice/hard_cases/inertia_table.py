"""Contact ports with and without inertia: ``python tests/spice/hard_cases/inertia_table.py``.

One kick of the usual chip at three dampings, 6 us from its start: states, contact events, time
points and processor time of ngspice with the scene's settings, the error of its launch against the
independent integrator of the same model, and the launch by that integrator. ``--full`` adds those
of the full model on rings of 50 and 25 um, by Newmark's method with two steps (half an hour).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from hard_cases.kit import simulated, write_table

from kc2spice.core.waveform import pulse
from kc2spice.core.waveforms import Waveforms
from kc2spice.rom.modal import resonators
from kc2spice.scene.load import load_scene
from kc2spice.workflow.verify.circuit import solve

STOP = 6.2e-6  # s; the sphere has left
DAMPING = (1e-2, 1e-3, 1e-4)
MESHES = {"50 um": {}, "25 um": {"ring_spacing": 25e-6, "rings": 10, "outer_rings": 16}}
STEPS = {1e-2: (20e-9, 10e-9), 1e-4: (10e-9, 5e-9)}  # of the full model, by damping


def reduced(ratio: float, inertia: str) -> tuple[str, ...]:
    """A row of the table."""
    scene = load_scene(
        {"name": "kick", "kick": {"drive": {"start": 0.0}, "damping": {"ratio": ratio}},
         "contact": {"rings": 2, "inertia": inertia}, "sphere": {}, "gravity": 9.81,
         "solver": {"stop": STOP, "max_step": 1e-6}},
    )  # fmt: skip
    build, waves = simulated(scene)
    model = resonators(build.model("kick"))
    force = np.array([waves[f"contact.force.ring{k}"] for k in range(2)]) > 0
    events = int((force[:, 1:] & ~force[:, :-1]).sum())
    ends = Waveforms({"time": np.array([0.0, STOP])}, {})
    exact = solve(build, ends).results["sphere.v"][-1]
    error = waves["sphere.v"][-1] / exact - 1
    states = 2 * model.order - model.massless
    return (
        f"{100 * ratio:g} %", inertia, f"{states}", f"{events}", f"{waves['time'].size}",
        f"{waves.stats['cpu_s']:.2f}", f"{error:+.1e}", f"{exact:.5f}",
    )  # fmt: skip


def full(ratio: float, mesh: str) -> list[float]:
    """Launches [m/s] of the full model, one per step."""
    from kc2spice.fem.piezo.assembly import assemble_kick
    from kc2spice.fem.piezo.keys import Chip
    from laboratory.usual.contact import contact_surface
    from laboratory.usual.transient import Ball, transient

    chip = Chip.model_validate({"damping": {"ratio": ratio}, "mesh": MESHES[mesh]})
    sector, surface = assemble_kick(chip), contact_surface(chip, 1e8, 1e-3)
    mass = load_scene("kick_and_catch").parts["sphere"].keys.mass / sector.sectors
    volts = pulse(0.0, 100.0, 0.0, 25e-6, 0.1e-6)
    return [
        transient(sector, surface, Ball(mass, 0.0, 0.0, 9.81), step=step, stop=STOP,
                  voltage=lambda t: float(volts(t)), resting=True).velocity[-1]
        for step in STEPS[ratio]
    ]  # fmt: skip


def main() -> None:
    """Write the table into the page, print the full model's launches."""
    forms = ((ratio, inertia) for ratio in DAMPING for inertia in ("lumped", "massless"))
    write_table("inertia", (
        "damping", "contact ports", "states", "contact events", "points", "CPU [s]",
        "error of ngspice", "launch [m/s]",
    ), (reduced(*form) for form in forms))  # fmt: skip
    if "--full" in sys.argv:
        for ratio, steps in STEPS.items():
            for mesh in MESHES:
                found = ", ".join(
                    f"{v:.5f} m/s ({1e9 * step:g} ns)"
                    for v, step in zip(full(ratio, mesh), steps, strict=True)
                )
                print(f"full model, rings of {mesh}, {100 * ratio:g} %: {found}", flush=True)


if __name__ == "__main__":
    main()
