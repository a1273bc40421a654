"""Contact ports side by side: ``python tests/spice/hard_cases/shape_table.py`` (ten minutes).

Static force at a depth of 5 um, lowest point and rebound of an impact at 1 m/s, launch of a kick by
100 V: circles of the mesh with lumps of mass or without, and pressure, each on its default and on
finer ones. States, time points and processor time of ngspice are those of the kick with the
default settings; the numbers themselves are computed with a hundredth of the tolerance. Errors are
relative to the finest hats. Writes the table into docs/notes/contact.md.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from hard_cases.kit import measured, simulated, write_table

from kc2spice.core.waveforms import Waveforms
from kc2spice.rom.modal import resonators
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build

FINE = ("kick.mesh.ring_spacing=25 um", "kick.mesh.rings=10", "kick.mesh.outer_rings=16")
PRESSURE = "contact.shape=pressure"
FORMS = {
    "rings, 50 um, lumped": ("contact.inertia=lumped",),
    "rings, 50 um, massless": (),
    "rings, 25 um, massless": FINE,
    "pressure, 20 um": (PRESSURE, "contact.spacing=20 um"),
    "pressure, 10 um": (PRESSURE,),
    "pressure, 5 um": (PRESSURE, "contact.spacing=5 um"),
    "pressure, 5 um, order 20": (PRESSURE, "contact.spacing=5 um", "rom.order=20"),
    "pressure, 5 um, on rings of 25 um": (PRESSURE, "contact.spacing=5 um", *FINE),
    "pressure, 2.5 um": (PRESSURE, "contact.spacing=2.5 um"),
}
CLOSE = "solver.reltol=1e-6"


def kick(*keys: str) -> tuple[Build, Waveforms]:
    return simulated(load_scene(
        {"name": "kick", "kick": {"drive": {"start": 0.0}}, "contact": {}, "sphere": {},
         "gravity": 9.81, "solver": {"stop": 12e-6, "max_step": 1e-6}}, keys,
    ))  # fmt: skip


def numbers(keys: tuple[str, ...]) -> np.ndarray:
    """Static force [N], depth [m], rebound and launch [m/s]."""
    _, _, static = measured(load_scene("imprint", ["imprint.depth=5 um", *keys]))
    _, _, impact = measured(load_scene("impact", [CLOSE, *keys]))
    _, fine = kick(CLOSE, *keys)
    return np.array([static["force_n"][-1], impact["min_position_m"],
                     impact["rebound_velocity_m_s"], fine["sphere.v"][-1]])  # fmt: skip


def cost(keys: tuple[str, ...]) -> tuple[int, int, float]:
    """States, time points and processor time [s] of the kick."""
    build, results = kick(*keys)
    model = resonators(build.model("kick"))
    return 2 * model.order - model.massless, results["time"].size, results.stats["cpu_s"]


def rows() -> Iterator[tuple[str, ...]]:
    """Of the table."""
    found = {name: (numbers(keys), cost(keys)) for name, keys in FORMS.items()}
    best = list(found.values())[-1][0]
    for name, (values, (states, points, seconds)) in found.items():
        error = np.abs(values / best - 1)
        each = zip(values * [1, 1e6, 1, 1], error, strict=True)
        yield (name, *(f"{value:.5g} ({off:.1e})" for value, off in each), f"{error.max():.1e}",
               f"{states}", f"{points}", f"{seconds:.2f}")  # fmt: skip


def main() -> None:
    """Write the table into the page."""
    write_table("shapes", (
        "contact ports", "static force [N]", "impact depth [um]", "rebound [m/s]", "launch [m/s]",
        "largest error", "states", "points", "CPU [s]",
    ), rows())  # fmt: skip


if __name__ == "__main__":
    main()
