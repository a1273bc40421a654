"""Laws beside the penalty spring; oracles: closed forms, and the integrator on an elastic chip."""

from __future__ import annotations

import numpy as np
from device import chip
from hard_cases.cases_contact import launch_error
from hard_cases.kit import case, kick, relative
from scipy.optimize import brentq

from kc2spice.scene.judge import require
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.workflow.decks import libraries, make_deck
from kc2spice.workflow.judge import verdict

ENTRY = "damped, curved and dry contact"


def ran(bench, tables):
    """What ``kc2spice run`` does with a scene of rigid parts alone."""
    scene = load_scene(tables)
    build = Build(scene, {}, libraries(scene))
    waves = bench.run(make_deck(build))
    if not bench.plain:
        require(verdict(waves, build).checks, scene.name)
    return waves


def rebound(bench, speed, reltol=1e-4, **keys):
    """Speed after a sphere has hit a rigid plane."""
    waves = ran(bench, {
        "name": "bounce", "gravity": 0.0, "contact": {"part": "contact", "a": "gnd", **keys},
        "sphere": {"part": "sphere", "velocity": -speed, "height": 1e-7},
        "solver": {"stop": 60e-6, "max_step": 1e-6, "reltol": reltol},
    })  # fmt: skip
    return waves["sphere.v"][-1]


def restitution(loss):
    """Of Hunt and Crossley at ``loss = damping * speed``, whatever the exponent."""
    return brentq(lambda e: np.log((1 + loss) / (1 - loss * e)) - loss * (1 + e),
                  1e-6, min(1.0, 1 / loss) * (1 - 1e-12))  # fmt: skip


@case(ENTRY, "rebound of a damped spring, relative", 2e-4)
def damped_rebound(bench):
    return relative(rebound(bench, 1.0, penalty=1e7, damping=0.5), restitution(0.5))


@case(ENTRY, "rebound that loses 99 % of the energy, relative", 2e-3)
def strongly_damped_rebound(bench):
    return relative(rebound(bench, 1.0, penalty=1e8, damping=10.0), restitution(10.0))


@case(ENTRY, "rebound of a spring of 1e12 N/m, relative", 2e-4)
def damped_rebound_of_a_rigid_spring(bench):
    return relative(rebound(bench, 0.1, penalty=1e12, damping=1.0), 0.1 * restitution(0.1))


@case(ENTRY, "rebound by Hertz, relative", 2e-4)
def elastic_rebound_by_hertz(bench):
    return relative(rebound(bench, 1.0, law="hertz", modulus=110e9), 1.0)


@case(ENTRY, "rebound by Hertz with damping, relative", 2e-4)
def damped_rebound_by_hertz(bench):
    found = rebound(bench, 1.0, law="hertz", modulus=110e9, damping=0.2)
    return relative(found, restitution(0.2))


@case(ENTRY, "rebound from a groove, relative", 2e-4)
def rebound_from_a_groove(bench):
    return relative(rebound(bench, 1.0, 1e-5, penalty=1e8, groove=60.0), 1.0)


def pushed(bench, force, stop):
    """How far a block of 10 g slides that a force pushes for 5 ms over a dry floor."""
    waves = ran(bench, {
        "name": "block", "gravity": 9.81,
        "weight": {"part": "mass", "mass": 10e-3, "weight": True},
        "block": {"part": "mass", "mass": 10e-3, "pins": {"a": "push.out"}},
        "push": {"part": "source", "kind": "force",
                 "pulse": {"high": force, "width": 5e-3, "edge": 1e-6}},
        "floor": {"part": "contact", "a": "gnd", "b": "weight", "penalty": 1e5, "friction": 0.3,
                  "pins": {"slide": "block.a"}},
        "solver": {"stop": stop, "max_step": 20e-6},
    })  # fmt: skip
    return waves["block.x"][-1]


@case(ENTRY, "distance slid, relative", 2e-3)
def a_block_slides_to_rest(bench):
    drag = 0.3 * 9.81
    a = 0.1 / 10e-3 - drag
    return relative(pushed(bench, 0.1, 30e-3), a * 5e-3**2 / 2 + (a * 5e-3) ** 2 / (2 * drag))


@case(ENTRY, "creep below the limit of friction, relative", 5e-3)
def a_block_sticks(bench):
    return relative(pushed(bench, 0.01, 10e-3), 1e-4 * 0.01 / (0.3 * 10e-3 * 9.81) * 5e-3)


@case(ENTRY, "momentum and energy of five spheres, relative", 1e-4)
def newtons_cradle(bench):
    scene = load_scene("newtons_cradle")
    build = Build(scene, {}, libraries(scene))
    waves = bench.run(make_deck(build))
    if not bench.plain:
        require(verdict(waves, build).checks, scene.name)
    speed = np.array([waves[f"sphere{k}.v"][-1] for k in range(1, 6)])
    return max(abs(speed.sum() - 1), abs((speed**2).sum() - 1))


@case(ENTRY, "launch, relative", 2e-4)
def damped_contact_on_an_elastic_chip(bench):
    return launch_error(bench, kick("contact.damping=0.3"), chip())
