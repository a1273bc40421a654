"""150 varied kicks of the real chip, each run as the product runs it, retries and checks included.

Every launch is judged by the independent integrator of the same laws, which locates every touch.
"""

import tempfile
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

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
# damping ratio, volts, edge [s], penalty [N/m], log-uniform
LOW = np.log([1e-4, 10.0, 1e-9, 1e7])
HIGH = np.log([5e-2, 150.0, 5e-6, 1e10])


@cache
def models_of(rings):
    scene = load_scene("kick_and_catch", [f"contact.rings={rings}", "contact.inertia=lumped"])
    return build_models(scene, Clock(silent)).models


def drawn(damping, voltage, edge, penalty):
    start = load_scene("kick_and_catch").parts["kick"].keys.drive.start
    scene = load_scene("kick_and_catch", {
        "kick.damping.ratio": damping, "kick.drive.edge": edge, "kick.drive.voltage": voltage,
        "contact.penalty": penalty, "solver.stop": start + AFTER,
        "checks.range": "off",  # both have the same rings, where softer springs need more
    })  # fmt: skip
    models = models_of(len(kept_ports(scene.parts["contact"], scene)))
    chip = resonators(models["kick"])
    # The basis does not depend on stiffness-proportional damping, which only scales with it.
    beta = scene.parts["kick"].keys.damping.beta
    damped = without_inertia(replace(chip, damp=beta * chip.omega**2))
    return Build(scene, {**models, "kick": damped.linear()}, libraries(scene))


def judged(build):
    """Relative error of the flying sphere's speed ``AFTER`` the kick began, and touches of a ring:
    the instant of the last touch, a graze of picometres, is no better known to the oracle."""
    with tempfile.TemporaryDirectory() as directory, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        outcome = simulate(build, make_deck(build), Path(directory), timeout=600.0)
    (check,) = (c for c in outcome.verdict.checks if c.name == "touches")
    ends = Waveforms({"time": np.array([0.0, build.scene.stop])}, {})
    exact = solve(build, ends).results["sphere.v"][-1]
    return abs(outcome.waves["sphere.v"][-1] / exact - 1.0), int(check.value)


@pytest.mark.slow
@pytest.mark.campaign
def test_launch_of_150_varied_kicks():
    """All complete, none needs hundreds of contacts, and every launch is within the bound."""
    draws = np.exp(LOW + (HIGH - LOW) * np.random.default_rng(4).random((COUNT, 4)))
    errors, touches = np.array([judged(drawn(*each)) for each in draws.tolist()]).T
    assert np.median(errors) <= 5e-5
    assert errors.max() <= 2e-4
    assert touches.max() <= 20
