"""Pressure, elastic spheres and rigid springs on the paper's own chip; oracles: the integrator of
the laws, the weight, energy."""

from __future__ import annotations

import numpy as np
from hard_cases.kit import case, off_weight, relative

from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.load import load_scene
from kc2spice.workflow.verify.circuit import solve
from laboratory.distance import trajectory_difference

PRESSURE = "contact.shape=pressure"
ELASTIC = (PRESSURE, "sphere.elastic=true")


def thrown(bench, *keys, stop=40e-6):
    """Speed of a sphere that a kick has thrown against that of the laws, relative."""
    build, waves = bench.own(load_scene({
        "name": "kick_and_catch", "kick": {"drive": {"start": 10e-6}}, "contact": {}, "sphere": {},
        "gravity": 9.81, "solver": {"stop": stop},
    }, keys))  # fmt: skip
    ends = Waveforms({"time": np.array([0.0, stop])}, {})
    return relative(waves["sphere.v"][-1], solve(build, ends).results["sphere.v"][-1])


def _thrown(entry, name, *keys, **more):
    def measure(bench):
        return thrown(bench, *keys, **more)

    measure.__name__ = name.replace(" ", "_")
    case(entry, "launch, relative", 2e-4, slow=True)(measure)


KICKED = "kick under pressure"
_thrown(KICKED, "kick by 100 V under pressure", PRESSURE)
_thrown(KICKED, "kick by 10 V under pressure", PRESSURE, "kick.drive.voltage=10 V")
_thrown(KICKED, "pressure that draws back first", PRESSURE, "kick.drive.voltage=-100 V", stop=60e-6)
_thrown(KICKED, "pressure with edges of 1 ns", PRESSURE, "kick.drive.edge=1 ns")
# thirty states of a space for twenty hats are refused where a resonance is this sharp
SHARP = "rom.tolerance=1e-3"
_thrown(KICKED, "pressure damped by a ten thousandth", PRESSURE, "kick.damping.ratio=1e-4", SHARP)
_thrown(KICKED, "hats of 2.5 um", PRESSURE, "contact.spacing=2.5 um")
_thrown(KICKED, "kick of an elastic sphere", *ELASTIC)
_thrown(KICKED, "elastic sphere damped by a ten thousandth", PRESSURE,
        "sphere.elastic.damping.ratio=1e-4")  # fmt: skip
_thrown("penalty 1e6 to 1e12 N/m", "penalty 1e12 on ports without inertia",
        "contact.penalty=1e12 N/m")  # fmt: skip


def met(bench, *keys):
    """Largest distance from the trajectory of the laws over its travel."""
    build, waves = bench.own(load_scene("impact", keys))
    exact = solve(build, waves).results
    return np.abs(trajectory_difference(waves, exact)[1]).max() / np.ptp(exact["sphere.y"])


def _met(entry, name, *keys):
    def measure(bench):
        return met(bench, *keys)

    measure.__name__ = name.replace(" ", "_")
    case(entry, "trajectory over travel", 1e-4, slow=True)(measure)


_met("impact under pressure", "impact under pressure", PRESSURE)
_met("impact under pressure", "impact of an elastic sphere", *ELASTIC)
GRAZING = ("impact.velocity=-1 mm/s", "impact.gap=1 nm", "solver.stop=60 us")
_met("grazing contact", "grazing under pressure", PRESSURE, *GRAZING)
_met("grazing contact", "grazing of an elastic sphere", *ELASTIC, *GRAZING)


def _rests(name, *keys):
    def measure(bench):
        return off_weight(*bench.own(load_scene({
            "name": "rest", "kick": {"drive": {"voltage": 0.0}}, "contact": {}, "sphere": {},
            "gravity": 9.81, "solver": {"stop": 50e-3},
        }, keys)))  # fmt: skip

    measure.__name__ = name.replace(" ", "_")
    case("resting contact", "force over weight, relative", 1e-4, slow=True)(measure)


_rests("rest under pressure", PRESSURE)
_rests("rest of an elastic sphere", *ELASTIC)


@case("100 elastic bounces", "energy of sphere and chip, relative", 1e-3, slow=True)
def bounces_under_pressure_on_an_undamped_chip(bench):
    """As on rings: a strong pull, and what the sphere loses the chip must hold."""
    pull = 1e4
    build, waves = bench.own(load_scene("impact", [
        PRESSURE, f"gravity={pull} m/s2", "impact.velocity=-10 mm/s", "impact.gap=100 nm",
        "kick.electrical=short", "kick.damping.ratio=0", "solver.stop=200 us", SHARP,
    ]))  # fmt: skip
    mass = build.scene.parts["sphere"].keys.mass
    force, y, v = waves["contact.force"], waves["sphere.y"], waves["sphere.v"]
    free = np.flatnonzero(force == 0.0)  # nothing is stored in the contact then
    energy = mass * (v**2 / 2 + pull * (y - y[0]))
    work = (force[1:] + force[:-1]) / 2 * np.diff(waves["kick.u.patch"])
    given = np.append(0.0, np.cumsum(work))
    return np.abs((energy - energy[0] - given)[free]).max() / energy.max()


@case("kick downwards", "time points over those of the scene as shipped", 10.0, slow=True)
def points_of_a_kick_downwards(bench):
    """What strikes is the chip's ringing: steps follow its phase, yet not all the way after."""
    down = "kick.drive.voltage=-100 V"
    found = [bench.own(load_scene("kick_and_catch", keys))[1]["time"].size
             for keys in ((), (down,), (PRESSURE, down))]  # fmt: skip
    return max(found[1:]) / found[0]
