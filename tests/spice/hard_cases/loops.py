"""150 varied kicks of the real chip: ``python tests/spice/hard_cases/loops.py [FIRST LAST]``.

Every kick is run as the product runs it, retries and physics checks included, with the default
tolerances, and judged by the independent integrator of the same laws, which locates every touch.
"""

from __future__ import annotations

import sys
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.progress import Clock, silent
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.contact import kept_ports
from kc2spice.rom.massless import without_inertia
from kc2spice.rom.modal import resonators
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.workflow.decks import libraries, make_deck
from kc2spice.workflow.models import build_models
from kc2spice.workflow.simulate import simulate
from kc2spice.workflow.verify.circuit import solve

COUNT = 150
AFTER = 30e-6  # s from the start of a kick of 25 us: the launch, and the flight that makes it one
BOUND = 2e-4
LOW = np.log([1e-4, 10.0, 1e-9, 1e7])
HIGH = np.log([5e-2, 150.0, 5e-6, 1e10])


@dataclass(frozen=True)
class Loop:
    """One draw and its launch; ``error`` is relative to the independent integrator.

    ``velocity`` is that of the flying sphere ``AFTER`` the kick began: the instant of the last
    touch, a graze of picometres, is no better known to the oracle than to ngspice.
    """

    damping: float
    voltage: float
    edge: float
    penalty: float
    velocity: float
    error: float
    touches: int
    attempts: int
    points: int


def draws() -> np.ndarray:
    """(150, 4) damping ratio, volts, edge [s], penalty [N/m], log-uniform, always the same."""
    return np.exp(LOW + (HIGH - LOW) * np.random.default_rng(4).random((COUNT, 4)))


def loops(first: int = 0, last: int = COUNT) -> Iterator[Loop]:
    """Run the draws ``first`` to ``last``: ngspice on the emitted deck, exact modes beside it."""
    start = load_scene("kick_and_catch").parts["kick"].keys.drive.start
    for damping, voltage, edge, penalty in draws()[first:last].tolist():
        keys = [
            f"kick.damping.ratio={damping!r}", f"kick.drive.edge={edge!r}",
            f"kick.drive.voltage={voltage!r}",
            f"contact.penalty={penalty!r}", f"solver.stop={start + AFTER!r}",
            "checks.range=off",  # both have the same rings, where softer springs need more
        ]  # fmt: skip
        scene = load_scene("kick_and_catch", keys)
        models = _models(len(kept_ports(scene.parts["contact"], scene)))
        chip = resonators(models["kick"])
        # The basis does not depend on stiffness-proportional damping, which only scales with it.
        beta = scene.parts["kick"].keys.damping.beta
        damped = without_inertia(replace(chip, damp=beta * chip.omega**2))
        varied = {**models, "kick": damped.linear()}
        build = Build(scene, varied, libraries(scene))
        found, touches, attempts, points = _product(build)
        error = abs(found / _exact(build) - 1.0)
        yield Loop(damping, voltage, edge, penalty, found, error, touches, attempts, points)


@cache
def _models(rings: int) -> Mapping[str, Any]:
    scene = load_scene("kick_and_catch", [f"contact.rings={rings}", "contact.inertia=lumped"])
    return build_models(scene, Clock(silent)).models


def _product(build: Build) -> tuple[float, int, int, int]:
    """Launch, touches of one ring, attempts, time points."""
    with tempfile.TemporaryDirectory() as directory, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        outcome = simulate(build, make_deck(build), Path(directory), timeout=600.0)
    waves = outcome.waves
    (check,) = (c for c in outcome.verdict.checks if c.name == "touches")
    return waves["sphere.v"][-1], int(check.value), len(outcome.attempts), waves["time"].size


def _exact(build: Build) -> float:
    ends = Waveforms({"time": np.array([0.0, build.scene.stop])}, {})
    return solve(build, ends).results["sphere.v"][-1]


def main() -> None:
    """Print every loop, then what there is to say about all."""
    found = []
    print("damping   kick [V]  edge [s]  penalty   launch    error     touches attempts points")
    for loop in loops(*map(int, sys.argv[1:3])):
        found.append(loop)
        print(f"{loop.damping:.2e}  {loop.voltage:8.2f}  {loop.edge:.2e}  {loop.penalty:.2e}  "
              f"{loop.velocity:.5f}  {loop.error:.2e}  {loop.touches:7d} {loop.attempts:8d} "
              f"{loop.points:6d}", flush=True)  # fmt: skip
    errors = np.array([loop.error for loop in found])
    print(f"{len(found)} kicks: median error {np.median(errors):.1e}, largest {errors.max():.1e}")


if __name__ == "__main__":
    main()
