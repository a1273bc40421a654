"""What the elasticity of the sphere moves: ``python tests/spice/hard_cases/sphere_table.py``.

Impact at 1 m/s, kick by 100 V and a push of 5 um under pressure, for spheres of four materials,
rigid and with their finite elements. Writes the table into docs/notes/contact.md.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from hard_cases.kit import measured, write_table

from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.materials import material
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build

MATERIALS = ("steel", "ruby", "tungsten carbide", "NdFeB")
KICK = {"name": "kick", "kick": {"drive": {"start": 0.0}}, "contact": {}, "sphere": {},
        "gravity": 9.81, "solver": {"stop": 12e-6, "max_step": 1e-6}}  # fmt: skip
PUSH = ("imprint.depth=5 um", "imprint.steps=50")


def run(scene: object, *keys: str) -> tuple[Build, Waveforms, dict[str, Any]]:
    """What ngspice says of the scene under pressure."""
    return measured(load_scene(scene, ["contact.shape=pressure", *keys]))


def numbers(*keys: str) -> tuple[np.ndarray, float | None]:
    """Depth [m], rebound and launch [m/s], force [N], time of the contact [s]; frequency [Hz] of
    the lowest mode of an elastic sphere."""
    fine = "solver.reltol=1e-5"
    build, hit, found = run("impact", fine, *keys)
    met = hit["time"][np.flatnonzero(hit["contact.force"] > 0)[0]]
    _, thrown, _ = run(KICK, fine, *keys)
    _, pushed, _ = run("imprint", *PUSH, *keys)
    rows = [found["min_position_m"], found["rebound_velocity_m_s"], thrown["sphere.v"][-1],
            pushed["contact.force"].max(), found["separation_time_s"] - met]  # fmt: skip
    model = build.model("sphere_elastic")
    return np.array(rows), None if model is None else model.facts["resonance_hz"]


def rows() -> Iterator[tuple[str, ...]]:
    """Of the table."""
    for name in MATERIALS:
        made_of = material(name)
        (rigid, _), (soft, mode) = (
            numbers(
                f"sphere.material={name}",
                f"sphere.density={made_of.density!r}",
                f"sphere.elastic={elastic}",
            )
            for elastic in ("false", "true")
        )
        assert mode is not None
        moved = (
            f"{f * a:.4f} -> {f * b:.4f} ({b / a - 1:+.1e})"
            for f, a, b in zip((1e6, 1, 1, 1, 1e6), rigid, soft, strict=True)
        )
        mass = 4 / 3 * np.pi * 1e-9 * made_of.density
        yield (name, f"{1e-9 * made_of.indentation_modulus:.0f}", f"{1e6 * mass:.1f}", *moved,
               f"{1e-6 * mode:.2f}")  # fmt: skip


def main() -> None:
    """Write the table into the page."""
    write_table("spheres", (
        "sphere", "E* [GPa]", "mass [mg]", "impact depth [um]", "rebound [m/s]", "launch [m/s]",
        "force at 5 um [N]", "contact [us]", "lowest mode [MHz]",
    ), rows())  # fmt: skip


if __name__ == "__main__":
    main()
