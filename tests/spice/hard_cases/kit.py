"""What the hard cases share: how one is declared and run, and their scenes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from device import bench as bench_deck  # noqa: F401
from device import built, chip, magnets

from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.magnetics.table import EMTable
from kc2spice.netlist.deck import Deck
from kc2spice.parts._touching import separation
from kc2spice.rom.modal import Resonators
from kc2spice.scene.judge import require
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Scene
from kc2spice.scene.parttype import Build
from kc2spice.sim.ngspice import run_deck
from kc2spice.spice.header import Header
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.judge import verdict
from kc2spice.workflow.verify.circuit import solve

HEADER = Header("hard case", "0")
TIMEOUT = 300.0  # s; a case that needs more has failed


@dataclass
class Bench:
    """Runs decks for a case."""

    directory: Path
    decks: int = 0

    def run(self, deck: Deck) -> Waveforms:
        """The deck's waveforms."""
        self.decks += 1
        return run_deck(deck, self.directory / str(self.decks), timeout=TIMEOUT)

    def scene(
        self,
        scene: Scene,
        model: Resonators | None = None,
        table: EMTable | None = None,
    ) -> Waveforms:
        """What ``kc2spice run`` does with a scene: the deck, ngspice, then the physics checks."""
        return self.judged(built(scene, model or chip(), table or magnets()))

    def judged(self, build: Build) -> Waveforms:
        """The deck's waveforms, which keep the physics checks."""
        waves = self.run(make_deck(build))
        require(verdict(waves, build).checks, build.scene.name)
        return waves


CASES: list[Any] = []


def case(
    entry: str, what: str, limit: float = 0.0, *, refused: str | None = None, slow: bool = False
) -> Callable[[Callable[[Bench], float]], Callable[[Bench], float]]:
    """Register a case: ``measure`` returns the error of ``what``, which must not exceed ``limit``;
    one that is ``refused`` ends in an error that matches this pattern."""

    def register(measure: Callable[[Bench], float]) -> Callable[[Bench], float]:
        marks = [pytest.mark.slow] if slow else []
        name = measure.__name__.replace("_", " ")
        CASES.append(pytest.param(measure, limit, refused, id=name, marks=marks))
        return measure

    return register


def scene(name: str, *overrides: str) -> Scene:
    """A scene of the gallery; the made-up device needs 80 V for a launch at 1 m/s."""
    first = ["kick.drive.voltage=80 V"] if name == "kick_and_catch" else []
    rings = ["contact.rings=all"] if "contact" in load_scene(name).parts else []
    return load_scene(name, [*rings, *first, *overrides])


def kick(*overrides: str) -> Scene:
    """The kick alone: no catch, no controller, 30 us after the pulse has begun."""
    tables = {
        "name": "kick_and_catch", "kick": {"drive": {"voltage": 80.0, "start": 10e-6}},
        "contact": {"rings": "all"}, "sphere": {}, "solver": {"stop": 40e-6},
    }  # fmt: skip
    return load_scene(tables, overrides)


def exact(
    study: Scene, waves: Waveforms, model: Resonators | None = None, table: EMTable | None = None
) -> Waveforms:
    """The scene by the independent integrator in Python, at the points of ``waves``."""
    return solve(built(study, model or chip(), table), waves).results


def rewritten(
    deck: Deck, text: str, vectors: Mapping[str, tuple[str, float]] | None = None
) -> Deck:
    """The deck with the text of its main file replaced, its libraries kept."""
    return replace(
        deck, text=text, options=(), vectors=deck.vectors if vectors is None else vectors
    )


def leaves(waves: Waveforms) -> tuple[float, float]:
    """Time and velocity of the launch or rebound; not numbers where there is none."""
    found = separation(waves["time"], waves["contact.force"], waves["sphere.v"])
    return found if found is not None else (np.nan, np.nan)


def relative(found: float | None, expected: float | None) -> float:
    """Relative difference; a number that is missing is infinitely wrong."""
    if found is None or expected is None:
        return np.inf
    return abs(found / expected - 1.0)
