"""What the elasticity of the sphere moves: ``python tests/spice/hard_cases/sphere_table.py``.

Impact at 1 m/s, kick by 100 V and a push of 5 um under pressure, for spheres of four materials,
rigid and with their finite elements. Writes the table into docs/contact.md.
"""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import numpy as np

from kc2spice.core.progress import Clock, silent
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.materials import material
from kc2spice.parts.contact import separation
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.models import build_models

PAGE = Path(__file__).parents[3] / "docs" / "contact.md"
TABLE = re.compile(r"(?s)<!-- spheres -->\n.*<!-- end of spheres -->")
MATERIALS = ("steel", "ruby", "tungsten carbide", "NdFeB")
KICK = {"name": "kick", "kick": {"drive": {"start": 0.0}}, "contact": {}, "sphere": {},
        "gravity": 9.81, "solver": {"stop": 12e-6, "max_step": 1e-6}}  # fmt: skip
PUSH = ("imprint.depth=5 um", "imprint.steps=50")


def run(scene: object, *keys: str) -> tuple[Build, Waveforms]:
    """What ngspice says of the scene under pressure."""
    loaded = load_scene(scene, ["contact.shape=pressure", *keys])
    build = build_models(loaded, Clock(silent))
    with tempfile.TemporaryDirectory() as directory:
        return build, run_deck(make_deck(build), Path(directory))


def numbers(*keys: str) -> tuple[np.ndarray, float | None]:
    """Depth [m], rebound and launch [m/s], force [N], time of the contact [s]; frequency [Hz] of
    the lowest mode of an elastic sphere."""
    fine = "solver.reltol=1e-5"
    build, hit = run("impact", fine, *keys)
    radius, time = build.scene.parts["sphere"].keys.radius, hit["time"]
    leave = separation(time, hit["contact.force"], hit["sphere.v"])
    assert leave is not None
    closed = leave[0] - time[np.flatnonzero(hit["contact.force"] > 0)[0]]
    depth = float((hit["sphere.y"] - radius).min())
    _, thrown = run(KICK, fine, *keys)
    _, pushed = run("imprint", *PUSH, *keys)
    rows = [depth, leave[1], float(thrown["sphere.v"][-1]), pushed["contact.force"].max(), closed]
    model = build.model("sphere_elastic")
    return np.array(rows), None if model is None else model.facts["resonance_hz"]


def main() -> None:
    """Write the table into the page."""
    lines = ["| sphere | E* [GPa] | mass [mg] | impact depth [um] | rebound [m/s] | launch [m/s] | "
             "force at 5 um [N] | contact [us] | lowest mode [MHz] |",
             "|---|---|---|---|---|---|---|---|---|"]  # fmt: skip
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
        cells = [
            f"{f * a:.4f} -> {f * b:.4f} ({b / a - 1:+.1e})"
            for f, a, b in zip((1e6, 1, 1, 1, 1e6), rigid, soft, strict=True)
        ]
        mass = 4 / 3 * np.pi * 1e-9 * made_of.density
        lines.append(
            f"| {name} | {1e-9 * made_of.indentation_modulus:.0f} | {1e6 * mass:.1f} | "
            f"{' | '.join(cells)} | {1e-6 * mode:.2f} |"
        )
        print(lines[-1], flush=True)
    table = "\n".join(["<!-- spheres -->", *lines, "<!-- end of spheres -->"])
    PAGE.write_text(TABLE.sub(lambda _: table, PAGE.read_text()))


if __name__ == "__main__":
    main()
