"""Pressure, elastic spheres and rigid springs on the paper's own chip; oracles: the integrator of
the laws, the weight, energy."""

from __future__ import annotations

import numpy as np
from hard_cases.kit import case, relative

from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.load import load_scene
from kc2spice.workflow.verify.circuit import solve

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
_thrown(KICKED, "kick of an elastic sphere", *ELASTIC)
