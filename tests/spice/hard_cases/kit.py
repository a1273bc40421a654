"""Shared tools of the hard cases: declaration, run and scenes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from device import bench as bench_deck  # noqa: F401
from device import built, chip, magnets
from support import (
    Header,
    find_separation,
    form_verdict,
    load_scene,
    make_deck,
    require_passed,
    run_deck,
    solve_laws,
)

HEADER = Header("hard case", "0")
TIMEOUT = 300.0  # s; a case that needs more has failed
# A circuit without an operating point: V(y)^2 + 1 = 0 has no real solution.
LATCH = """.subckt mine command out ref
Rin command ref 1000
Rout command out 1
Ifeed ref x 1
Bx x ref I={exp(V(x))*(V(x) > 0 ? 1 : 0) - 10*exp(-V(x)*V(x))+exp(-V(x))}
Bbad y ref V={V(y)*V(y) + 1 + V(y)}
Rbad y ref 1
.ends mine
"""


@dataclass
class BenchKeys:
    """Runs decks for a case."""

    directory: Path
    decks: int = 0

    def run(self, deck):
        """The deck's waveforms."""
        self.decks += 1
        return run_deck(deck, self.directory / str(self.decks), timeout=TIMEOUT)

    def scene(self, scene, model=None, table=None):
        """Run a scene as ``kc2spice run``: the deck, ngspice, then the physics checks."""
        build = built(scene, model or chip(), table or magnets())
        waves = self.run(make_deck(build))
        require_passed(form_verdict(waves, build).checks, build.scene.name)
        return waves


CASES: list[Any] = []
TABLE: list[tuple[str, str, str, float, Any]] = []  # entry, name, what, limit and measure of each


def case(entry, what, limit=0.0, *, refused=None, slow=False, name=None):
    """Register a case: ``measure`` returns the error of ``what``, which must not exceed ``limit``;
    one that is ``refused`` ends in an error that matches this pattern."""

    def register(measure):
        marks = [pytest.mark.slow] if slow else []
        called = name or measure.__name__.replace("_", " ")
        CASES.append(pytest.param(measure, limit, refused, id=called, marks=marks))
        TABLE.append((entry, called, what, limit, measure))
        return measure

    return register


def scene(name, *overrides):
    """A scene of the gallery; the made-up device needs 80 V for a launch at 1 m/s."""
    first = ["kick.drive.voltage=80 V"] if name == "kick_and_catch" else []
    rings = ["contact.rings=all"] if "contact" in load_scene(name).parts else []
    return load_scene(name, [*rings, *first, *overrides])


def kick(*overrides):
    """The kick alone: no catch, no controller, 30 us after the pulse has begun."""
    tables = {
        "name": "kick_and_catch", "kick": {"drive": {"voltage": 80.0, "start": 10e-6}},
        "contact": {"rings": "all"}, "sphere": {}, "solver": {"stop": 40e-6},
    }  # fmt: skip
    return load_scene(tables, overrides)


def exact(study, waves, model=None, table=None):
    """The scene by the independent integrator in Python, at the points of ``waves``."""
    return solve_laws(built(study, model or chip(), table), waves).results


def leaves(waves):
    """Time and velocity of the launch or rebound; not numbers where there is none."""
    found = find_separation(waves["time"], waves["contact.force"], waves["sphere.v"])
    return found if found is not None else (np.nan, np.nan)


def relative(found, expected):
    """Relative difference; a number that is missing is infinitely wrong."""
    if found is None or expected is None:
        return np.inf
    return abs(found / expected - 1.0)


def launch_error(bench, study, model=None):
    """Launch velocity of a kick against scipy, relative."""
    model = model or chip()
    waves = bench.scene(study, model)
    return relative(leaves(waves)[1], leaves(exact(study, waves, model))[1])
