"""150 varied kicks of the real chip: ``python tests/spice/hard_cases/loops.py [COUNT]``."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kc2spice.scene.load import load_scene
from kc2spice.sim.ngspice import run_deck
from kc2spice.sim.reference.law import law
from kc2spice.study.bench.floor import Floor
from kc2spice.study.decks import make_deck
from kc2spice.study.models import build_models
from kc2spice.study.progress import Clock, silent

COUNT = 150
AFTER = 60e-6  # s from the kick's start: the launch and the flight that makes it one
# s between looks for a touch: less than this changes no launch but the chaotic ones.
SAMPLING = 5e-10
CHAOTIC = 5e-4  # damping ratio below which a sphere may touch thousands of times before it flies
LOW = np.log([1e-4, 10.0, 1e-9, 1e7])
HIGH = np.log([5e-2, 150.0, 5e-6, 1e10])


@dataclass(frozen=True)
class Loop:
    """One draw and its launch; ``error`` is relative to exact steps between located touches.

    ``velocity`` is that of the flying sphere ``AFTER`` the kick began: the instant of the last
    touch, a graze of picometres, is no better known to the oracle than to ngspice.
    """

    damping: float
    voltage: float
    edge: float
    penalty: float
    velocity: float
    error: float
    points: int


def draws() -> np.ndarray:
    """(150, 4) damping ratio, volts, edge [s], penalty [N/m], log-uniform, always the same."""
    return np.exp(LOW + (HIGH - LOW) * np.random.default_rng(4).random((COUNT, 4)))


def loops(count: int = COUNT) -> Iterator[Loop]:
    """Run the first ``count`` draws: ngspice on the emitted deck, exact modes on the same model."""
    base = load_scene("kick_and_catch")
    models = build_models(base, Clock(silent))
    for damping, voltage, edge, penalty in draws()[:count].tolist():
        keys = [f"kick.damping.ratio={damping!r}", f"kick.drive.voltage={voltage!r}",
                f"kick.drive.edge={edge!r}", f"contact.penalty={penalty!r}",
                f"solver.stop={base.kick.drive.start + AFTER!r}"]  # fmt: skip
        scene = load_scene("kick_and_catch", keys)
        chip = models.kick.resonators
        # The basis does not depend on stiffness-proportional damping, which only scales with it.
        damped = replace(chip, damp=scene.kick.damping.beta * chip.omega**2)
        varied = replace(models, kick=replace(models.kick, resonators=damped))
        with tempfile.TemporaryDirectory() as directory:
            waves = run_deck(make_deck(scene, varied), Path(directory), timeout=600.0)
        exact = Floor(law(damped, scene, models.table), SAMPLING).run(scene)["sphere.v"][-1]
        found, points = waves["sphere.v"][-1], waves["time"].size
        yield Loop(damping, voltage, edge, penalty, found, abs(found / exact - 1.0), points)


def main() -> None:
    """Print every loop, then median and largest error with and without the chaotic ones."""
    errors: dict[bool, list[float]] = {False: [], True: []}
    print("damping   kick [V]  edge [s]  penalty   launch    error     points")
    for loop in loops(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT):
        errors[loop.damping < CHAOTIC].append(loop.error)
        print(f"{loop.damping:.2e}  {loop.voltage:8.2f}  {loop.edge:.2e}  {loop.penalty:.2e}  "
              f"{loop.velocity:.5f}  {loop.error:.2e}  {loop.points:6d}", flush=True)  # fmt: skip
    for chaotic, name in ((False, "damped by"), (True, "damped by less than")):
        found = errors[chaotic] or [np.nan]
        print(f"{len(found)} kicks {name} {CHAOTIC:.2%}: median {np.median(found):.1e}, "
              f"largest {max(found):.1e}, {sum(e > 2e-4 for e in found)} beyond 2e-4")  # fmt: skip


if __name__ == "__main__":
    main()
