"""150 varied kicks of the real chip: ``python tests/spice/hard_cases/loops.py [FIRST LAST]``.

Every kick is run as the product runs it, retry ladder and truth checks included, with the default
tolerances, and judged by exact modes between located touches.

A chip damped by less than 0.05 % rattles against the sphere at hundreds of megahertz, up to three
thousand times before it throws it. Some of these launches are not determined by their data: a
voltage changed by 1e-12 to 1e-9 of itself, less than anyone can set, changes them by more than the
bound. ``Loop.doubt`` is that change; it is looked for where a launch is off by more.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kc2spice.core.progress import Clock, silent
from kc2spice.rom.modal import resonators
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.workflow.decks import libraries, make_deck
from kc2spice.workflow.models import build_models
from kc2spice.workflow.simulate import simulate

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from laboratory.law import law
from laboratory.lower_bound import LowerBound

COUNT = 150
AFTER = 60e-6  # s from the kick's start: the launch and the flight that makes it one
SAMPLING = 5e-10  # s between looks for a touch
BOUND = 2e-4
CHANGES = (1e-12, -1e-12, 3e-12, 1e-9, -1e-9)  # of the voltage
LOW = np.log([1e-4, 10.0, 1e-9, 1e7])
HIGH = np.log([5e-2, 150.0, 5e-6, 1e10])


@dataclass(frozen=True)
class Loop:
    """One draw and its launch; ``error`` is relative to exact steps between located touches.

    ``velocity`` is that of the flying sphere ``AFTER`` the kick began: the instant of the last
    touch, a graze of picometres, is no better known to the oracle than to ngspice. ``doubt`` is
    the largest relative change of the exact launch under ``CHANGES``, zero where the error is
    within ``BOUND``.
    """

    damping: float
    voltage: float
    edge: float
    penalty: float
    velocity: float
    error: float
    doubt: float
    touches: int
    rungs: int
    points: int


def draws() -> np.ndarray:
    """(150, 4) damping ratio, volts, edge [s], penalty [N/m], log-uniform, always the same."""
    return np.exp(LOW + (HIGH - LOW) * np.random.default_rng(4).random((COUNT, 4)))


def loops(first: int = 0, last: int = COUNT) -> Iterator[Loop]:
    """Run the draws ``first`` to ``last``: ngspice on the emitted deck, exact modes beside it."""
    base = load_scene("kick_and_catch")
    models = build_models(base, Clock(silent)).models
    chip, start = resonators(models["kick"]), base.parts["kick"].keys.drive.start
    for damping, voltage, edge, penalty in draws()[first:last].tolist():
        keys = [
            f"kick.damping.ratio={damping!r}", f"kick.drive.edge={edge!r}",
            f"contact.penalty={penalty!r}", f"solver.stop={start + AFTER!r}",
            "checks.range=off",  # both roads have the same rings, where softer springs need more
        ]  # fmt: skip

        scene = _kick(keys, voltage)
        # The basis does not depend on stiffness-proportional damping, which only scales with it.
        beta = scene.parts["kick"].keys.damping.beta
        damped = replace(chip, damp=beta * chip.omega**2).linear()
        varied = {**models, "kick": damped}
        found, touches, rungs, points = _product(_build(scene, varied))
        exact = _exact(_build(scene, varied))
        error, doubt = abs(found / exact - 1.0), 0.0
        if error > BOUND:
            scenes = [_kick(keys, voltage * (1 + c)) for c in CHANGES]
            others = [_exact(_build(each, varied)) for each in scenes]
            doubt = max(abs(other / exact - 1.0) for other in others)
        yield Loop(damping, voltage, edge, penalty, found, error, doubt, touches, rungs, points)


def _kick(keys: list[str], voltage: float) -> Scene:
    return load_scene("kick_and_catch", [*keys, f"kick.drive.voltage={voltage!r}"])


def _build(scene: Scene, models: dict[str, object]) -> Build:
    return Build(scene, models, libraries(scene))


def _product(build: Build) -> tuple[float, int, int, int]:
    """Launch, touches of one ring, rungs of the ladder, time points."""
    with tempfile.TemporaryDirectory() as directory, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        climbed = simulate(build, make_deck(build), Path(directory), timeout=600.0)
    waves = climbed.waves
    (check,) = (c for c in climbed.verdict.checks if c.name == "touches")
    return waves["sphere.v"][-1], int(check.value), len(climbed.attempts), waves["time"].size


def _exact(build: Build) -> float:
    return LowerBound(law(build), SAMPLING).run(build.scene)["sphere.v"][-1]


def main() -> None:
    """Print every loop, then what there is to say about all."""
    found = []
    print(
        "damping   kick [V]  edge [s]  penalty   launch    error     doubt     touches rungs points"
    )
    for loop in loops(*map(int, sys.argv[1:3])):
        found.append(loop)
        print(f"{loop.damping:.2e}  {loop.voltage:8.2f}  {loop.edge:.2e}  {loop.penalty:.2e}  "
              f"{loop.velocity:.5f}  {loop.error:.2e}  {loop.doubt:.2e}  {loop.touches:7d} "
              f"{loop.rungs:5d} {loop.points:6d}", flush=True)  # fmt: skip
    errors = np.array([loop.error for loop in found])
    known = np.array([loop.doubt <= BOUND / 2 for loop in found])
    print(f"{len(found)} kicks: median error {np.median(errors):.1e}, largest {errors.max():.1e}; "
          f"{known.sum()} are determined by their data, of these the largest is "
          f"{errors[known].max():.1e}")  # fmt: skip


if __name__ == "__main__":
    main()
