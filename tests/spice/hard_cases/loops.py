"""150 varied kicks of the real chip: ``python tests/spice/hard_cases/loops.py [COUNT]``."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kc2spice.errors import SimulationError
from kc2spice.scene.load import load_scene
from kc2spice.sim import reference
from kc2spice.sim.ngspice import run_deck
from kc2spice.study.decks import make_deck
from kc2spice.study.models import build_models
from kc2spice.study.progress import Clock, silent

COUNT = 150
AFTER = 60e-6  # s from the kick's start: the launch and the flight that makes it one
LIMIT = 2e-4
LOW = np.log([1e-4, 10.0, 1e-9, 1e7])
HIGH = np.log([5e-2, 150.0, 5e-6, 1e10])


@dataclass(frozen=True)
class Loop:
    """One draw and its launch: ``error`` is relative to scipy's.

    ``velocity`` is that of the flying sphere ``AFTER`` the kick began: the instant of the last
    touch, a graze of picometres, is no better known to scipy than to ngspice. ``determined`` is
    False where scipy itself, ten times closer, launches otherwise by more than half the limit, or
    meets contacts without end: thousands of touches on a chip that hardly damps are chaotic.
    """

    damping: float
    voltage: float
    edge: float
    penalty: float
    velocity: float
    error: float
    points: int
    determined: bool


def draws() -> np.ndarray:
    """(150, 4) damping ratio, volts, edge [s], penalty [N/m], log-uniform, always the same."""
    return np.exp(LOW + (HIGH - LOW) * np.random.default_rng(4).random((COUNT, 4)))


def loops(count: int = COUNT) -> Iterator[Loop]:
    """Run the first ``count`` draws, ngspice on the emitted deck and scipy on the same model."""
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

        def speed(rtol: float, damped=damped, scene=scene) -> float:
            run = reference.kick_and_catch(damped, scene, models.table, rtol=rtol)
            return run.waves["sphere.v"][-1]

        found, determined = waves["sphere.v"][-1], True
        try:
            exact = speed(1e-8)
            error = abs(found / exact - 1.0)
            if error > LIMIT:
                determined = abs(speed(1e-9) / exact - 1.0) < LIMIT / 2
        except SimulationError:
            exact, error, determined = np.nan, np.nan, False
        points = waves["time"].size
        yield Loop(damping, voltage, edge, penalty, found, error, points, determined)


def main() -> None:
    """Print every loop, then median and largest error of those that are determined."""
    errors = []
    print("damping   kick [V]  edge [s]  penalty   launch    error     points")
    for loop in loops(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT):
        errors += [loop.error] if loop.determined else []
        print(f"{loop.damping:.2e}  {loop.voltage:8.2f}  {loop.edge:.2e}  {loop.penalty:.2e}  "
              f"{loop.velocity:.5f}  {loop.error:.2e}  {loop.points:6d}"
              f"{'' if loop.determined else '  chaotic'}", flush=True)  # fmt: skip
    print(f"{len(errors)} loops: median {np.median(errors):.2e}, largest {max(errors):.2e}")


if __name__ == "__main__":
    main()
