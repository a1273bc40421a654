"""Laws beside the penalty spring; oracles: closed forms, and the integrator on an elastic chip."""

from __future__ import annotations

import numpy as np
from device import chip
from hard_cases.cases_contact import launch_error
from hard_cases.kit import case, kick, off_weight, relative
from scipy.optimize import brentq

from kc2spice.scene.load import load_scene

ENTRY = "damped, curved and dry contact"
BOUNCES = "100 elastic bounces"


def rebound(bench, speed, reltol=1e-4, **keys):
    """Speed after a sphere has hit a rigid plane."""
    _, waves = bench.own(load_scene({
        "name": "bounce", "gravity": 0.0, "contact": {"part": "contact", "a": "gnd", **keys},
        "sphere": {"part": "sphere", "velocity": -speed, "height": 1e-7},
        "solver": {"stop": 60e-6, "max_step": 1e-6, "reltol": reltol},
    }))  # fmt: skip
    return waves["sphere.v"][-1]


def restitution(loss):
    """Of Hunt and Crossley at ``loss = damping * speed``, whatever the exponent."""
    return brentq(lambda e: np.log((1 + loss) / (1 - loss * e)) - loss * (1 + e),
                  1e-6, min(1.0, 1 / loss) * (1 - 1e-12))  # fmt: skip


@case(ENTRY, "rebound that loses 99 % of the energy, relative", 2e-3)
def strongly_damped_rebound(bench):
    return relative(rebound(bench, 1.0, penalty=1e8, damping=10.0), restitution(10.0))


@case(ENTRY, "rebound of a spring of 1e12 N/m, relative", 2e-4)
def damped_rebound_of_a_rigid_spring(bench):
    return relative(rebound(bench, 0.1, penalty=1e12, damping=1.0), 0.1 * restitution(0.1))


@case(ENTRY, "rebound from a groove, relative", 2e-4)
def rebound_from_a_groove(bench):
    return relative(rebound(bench, 1.0, 1e-5, penalty=1e8, groove=60.0), 1.0)


@case(ENTRY, "launch, relative", 2e-4, slow=True)
def damped_contact_on_an_elastic_chip(bench):
    return launch_error(bench, kick("contact.damping=0.3"), chip())


def landings(bench, count, reltol=1e-4, **keys):
    """Speeds [m/s] at which a sphere arrives with 10 mm/s, 0.1 um high, and leaves after so many
    bounces on a rigid plane."""
    speed, height, g = 0.01, 1e-7, 9.81
    first = np.sqrt(speed**2 + 2 * g * height)
    _, waves = bench.own(load_scene({
        "name": "bounces", "contact": {"part": "contact", "a": "gnd", **keys}, "gravity": g,
        "sphere": {"part": "sphere", "velocity": -speed, "height": height},
        "solver": {"stop": 1.1 * count * 2 * first / g, "max_step": 1e-5, "reltol": reltol},
    }))  # fmt: skip
    force, bottom = waves["contact.force"] > 0, waves["sphere.y"] - waves["sphere.y"][0] + height
    landed = np.flatnonzero(force[1:] & ~force[:-1]) + 1
    if landed.size <= count:
        return first, np.nan
    speeds = np.sqrt(waves["sphere.v"] ** 2 + 2 * g * np.maximum(bottom, 0.0))
    between = (landed[count - 1] + landed[count]) // 2  # in flight after that bounce
    return first, speeds[between]


@case(BOUNCES, "speed kept by Hertz, relative", 2e-3)
def hundred_bounces_by_hertz(bench):
    first, last = landings(bench, 100, law="hertz", modulus=110e9)
    return relative(last, first)


@case(BOUNCES, "speed kept in a groove, relative", 1e-3)
def hundred_bounces_in_a_groove(bench):
    first, last = landings(bench, 100, 1e-5, penalty=4e8, groove=60.0)
    return relative(last, first)


@case(BOUNCES, "speed left by a damped spring, relative", 1e-3)
def hundred_damped_bounces(bench):
    damping, count = 0.1, 100
    first, last = landings(bench, count, penalty=4e8, damping=damping)
    for _ in range(count):
        first *= restitution(damping * first)
    return relative(last, first)


def resting(bench, **keys):
    """How far the force that holds a sphere for 50 ms is from its weight, relative."""
    return off_weight(*bench.own(load_scene({
        "name": "rest", "contact": {"part": "contact", "a": "gnd", **keys}, "gravity": 9.81,
        "sphere": {"part": "sphere"}, "solver": {"stop": 50e-3, "max_step": 1e-5},
    })))  # fmt: skip


@case("resting contact", "force over weight, relative", 1e-4)
def rest_by_hertz(bench):
    return resting(bench, law="hertz", modulus=110e9)


@case("resting contact", "force over weight, relative", 1e-4)
def rest_on_a_damped_spring(bench):
    return resting(bench, penalty=4e8, damping=1.0)


@case("resting contact", "force over weight, relative", 1e-4)
def rest_in_a_groove(bench):
    return resting(bench, penalty=4e8, groove=60.0)
