"""Contact laws and options, 100 bounces each: ``python tests/spice/hard_cases/bounces.py``."""

from __future__ import annotations

import re
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from hard_cases.kit import HEADER, Bench, bench_deck

from kc2spice.core.errors import SimulationError
from kc2spice.parts.contact import Normal, contact_subcircuit
from kc2spice.parts.sphere import SphereKeys, sphere_subcircuit

MASS, STIFFNESS, SPEED, HEIGHT, LANDINGS = SphereKeys().mass, 4e8, 0.01, 1e-7, 100
OPTIONS = {
    "trap, 1e-3": "reltol=1e-3 trtol=1 chgtol=1e-08",
    "trap, 1e-4": "reltol=1e-4 trtol=1 chgtol=1e-08",
    "trap, 1e-4, chgtol 1e-12": "reltol=1e-4 trtol=1 chgtol=1e-12",
    "trap, 1e-6, chgtol 1e-12": "reltol=1e-6 trtol=1 chgtol=1e-12",
    "gear, 1e-4": "reltol=1e-4 trtol=1 chgtol=1e-08 method=gear",
    "gear, 1e-6, chgtol 1e-12": "reltol=1e-6 trtol=1 chgtol=1e-12 method=gear",
    "ngspice's own": "trtol=7",
}
LAWS = ("max(0, x)", "max(0, x), edges watched", "blend of 0.1 nm", "blend of 0.1 nm, watched")


@dataclass(frozen=True)
class Bounced:
    """Energy gained over all landings, as a share; landings too few; points; CPU time [s]."""

    energy: float
    missed: int
    points: int
    seconds: float


def bounce(bench: Bench, law: str, options: str) -> Bounced:
    """A sphere falls 5 um a hundred times onto a rigid plane."""
    ground = contact_subcircuit(HEADER, ("ring0",), np.zeros(1), Normal(STIFFNESS))
    text = ground.text
    if "watched" not in law:
        text = re.sub(r"(?m)^(Snear|Gnear|Inear|Rnear|\.model edge).*\n", "", text)
    if "blend" in law:  # a parabola from -w to w that joins both branches with their slopes
        x, w = "(V(ring0)-V(bottom))", "1e-4"
        parabola = f"({x}+{w})*({x}+{w})/(4*{w})"
        smooth = f"({x} > {w} ? {x} : ({x} < -{w} ? 0 : {parabola}))"
        text = re.sub(r"(?m)^Bring0 .*$", f"Bring0 ring0 v I={{newton_per_um*{smooth}}}", text)
    sphere = sphere_subcircuit(HEADER, MASS, 1e-3, 9.81, velocity=-SPEED, height=HEIGHT)
    stop = (LANDINGS + 0.5) * (2 * SPEED / 9.81 + np.pi * np.sqrt(MASS / STIFFNESS))
    cards = f"""Xsphere v bottom y 0 sphere
Vground ring0 0 0
Xcontact ring0 v bottom 0 contact
.options {options} acct
.tran 1e-4 {stop} 0 1e-5 uic"""
    vectors = {"v": ("v(v)", 1.0), "bottom": ("v(bottom)", 1e-6)}
    waves = bench.run(bench_deck([sphere, replace(ground, text=text)], cards, vectors, stop))
    bottom, v = waves["bottom"], waves["v"]
    # Counted where the sphere is clear of the plane, thus without the spring's law.
    clear = bottom > HEIGHT / 10
    energy = MASS * (v**2 / 2 + 9.81 * bottom)
    last = energy[np.flatnonzero(clear)[-1]] if clear.any() else 0.0
    landings = np.count_nonzero((bottom[:-1] > 0) & (bottom[1:] <= 0))
    start = MASS * (SPEED**2 / 2 + 9.81 * HEIGHT)
    stats = waves.stats
    return Bounced(last / start - 1, LANDINGS - landings, int(stats["accepted"]), stats["cpu_s"])


def main() -> None:
    """Print the table of docs/notes/contact.md."""
    for law in LAWS:
        for name, options in OPTIONS.items():
            with tempfile.TemporaryDirectory() as directory:
                try:
                    b = bounce(Bench(Path(directory)), law, options)
                    found = f"{b.energy:+.1e} | {b.missed} | {b.points} | {b.seconds:.2f}"
                except SimulationError as error:
                    found = f"{error.message} | | |"
            print(f"| {law} | {name} | {found} |", flush=True)


if __name__ == "__main__":
    main()
