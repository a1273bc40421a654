"""What the elasticity of the sphere moves: ``python tests/spice/hard_cases/sphere_table.py``.

Impact at 1 m/s and kick by 100 V under hats of pressure, for spheres of four materials: rigid ones,
and such as are dented by the same pressures as the chip, by Boussinesq's half-space (Johnson,
Contact Mechanics, 1985). The sphere's own modes are left out: its lowest, which makes it oblong, is
printed beside the time of contact. Writes the table into docs/contact.md.
"""

from __future__ import annotations

import re
import tempfile
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from scipy.special import j0

from kc2spice.bodies.pressure import Hats
from kc2spice.core.progress import Clock, silent
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.materials import material
from kc2spice.parts.contact import separation
from kc2spice.parts.piezo_stack import PiezoStack
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build, Dents, Surface
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.models import build_models

PAGE = Path(__file__).parents[3] / "docs" / "contact.md"
TABLE = re.compile(r"(?s)<!-- spheres -->\n.*<!-- end of spheres -->")
MATERIALS = ("steel", "ruby", "tungsten carbide", "NdFeB")
KEYS = ("contact.shape=pressure", "solver.reltol=1e-5")
OBLONG = 2.65  # 2 pi f R / c of the lowest mode at Poisson's ratios of 0.25 (Lamb 1882)


def half_space(shape: Hats, modulus: float) -> np.ndarray:
    """(hats, hats) dent [m] of each hat per force [N] on each: ``4 pi / E* int P P' dk``."""
    x, w = np.polynomial.legendre.leggauss(24)
    nodes = shape.nodes
    k = np.linspace(0, 25 / nodes[1], 8001)
    k = (k[:-1] + k[1:]) / 2
    found = []
    for j in range(len(nodes) - 1):
        total, force = np.zeros(k.size), 0.0
        for a in (j - 1, j) if j else (j,):
            width = nodes[a + 1] - nodes[a]
            up = (1 + x) / 2
            r = nodes[a] + width * up
            p = (up if a < j else 1 - up) * r * w * width / 2
            total += j0(k[:, None] * r) @ p
            force += 2 * np.pi * p.sum()
        found.append(total / force)
    P = np.array(found)
    return 4 * np.pi / modulus * (k[1] - k[0]) * P @ P.T


def softened(modulus: float) -> Any:
    """The chip's patch, which the sphere's dents are added to."""
    surface = PiezoStack.surface

    def soft(*given: Any) -> Surface:
        own = surface(*given)
        assert own.dents is not None
        dents = own.dents

        def both(shape: Hats) -> Dents:
            found = dents(shape)
            return replace(found, compliance=found.compliance + half_space(shape, modulus))

        return replace(own, dents=both)

    return patch.object(PiezoStack, "surface", soft)


def runs(name: str, tables: object) -> list[tuple[Build, Waveforms]]:
    """The scene with a rigid sphere, then with an elastic one."""
    made_of = [f"sphere.material={name}", f"sphere.density={material(name).density!r}"]
    build = build_models(load_scene(tables, [*KEYS, *made_of]), Clock(silent))
    found = []
    for how in (nullcontext(), softened(material(name).indentation_modulus)):
        with tempfile.TemporaryDirectory() as directory, how:
            found.append((build, run_deck(make_deck(build), Path(directory))))
    return found


def numbers(name: str) -> np.ndarray:
    """Rows rigid and elastic: depth [m], rebound and launch [m/s]; time of the contact [s]."""
    kick = {"name": "kick", "kick": {"drive": {"start": 0.0}}, "contact": {}, "sphere": {},
            "gravity": 9.81, "solver": {"stop": 12e-6, "max_step": 1e-6}}  # fmt: skip
    rows = []
    hits, kicks = runs(name, "impact"), runs(name, kick)
    for (build, hit), (_, thrown) in zip(hits, kicks, strict=True):
        radius = build.scene.parts["sphere"].keys.radius
        time = hit["time"]
        leave = separation(time, hit["contact.force"], hit["sphere.v"])
        assert leave is not None
        closed = leave[0] - time[np.flatnonzero(hit["contact.force"] > 0)[0]]
        depth = float((hit["sphere.y"] - radius).min())
        rows.append([depth, leave[1], float(thrown["sphere.v"][-1]), closed])
    return np.array(rows)


def main() -> None:
    """Write the table into the page."""
    lines = ["| sphere | E* [GPa] | mass [mg] | impact depth [um] | rebound [m/s] | launch [m/s] | "
             "contact [us] | period of its lowest mode [us] |",
             "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for name in MATERIALS:
        made_of, rows = material(name), numbers(name)
        cells = [
            f"{f * rigid:.4f} -> {f * soft:.4f} ({soft / rigid - 1:+.1e})"
            for f, rigid, soft in zip((1e6, 1, 1, 1e6), *rows, strict=True)
        ]
        shear = np.sqrt(made_of.C[5, 5] / made_of.density)
        period = 2 * np.pi * 1e-3 / (OBLONG * shear)
        mass = 4 / 3 * np.pi * 1e-9 * made_of.density
        lines.append(
            f"| {name} | {1e-9 * made_of.indentation_modulus:.0f} | {1e6 * mass:.1f} | "
            f"{' | '.join(cells)} | {1e6 * period:.2f} |"
        )
        print(lines[-1], flush=True)
    table = "\n".join(["<!-- spheres -->", *lines, "<!-- end of spheres -->"])
    PAGE.write_text(TABLE.sub(lambda _: table, PAGE.read_text()))


if __name__ == "__main__":
    main()
