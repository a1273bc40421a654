"""Heat flows into pins of given temperature: emitted netlists against the full model in scipy."""

import re

import numpy as np
import pytest
from support import HeatBodyKeys, assemble_heat_model
from test_random_heat import random_body

import kc2spice as kc

TOLERANCE = 1e-4
SMALLEST = 1e-6  # share of the largest heat flow below which errors are relative to this share


def full_flows(keys, frequency):
    """Heat flow into the case [W] at 1 K there, and the temperature of the junction [K]."""
    model = assemble_heat_model(HeatBodyKeys.model_validate(keys), None).model
    K, E = (np.asarray(part) for part in model.pencil.make_dense().coefficients)
    names = [port.name for port in model.ports]
    at = int(model.B[:, names.index("case")].argmax())
    free = np.delete(np.arange(len(K)), at)
    junction = model.B[free, names.index("junction")]
    flows, warm = [], []
    for s in 2j * np.pi * frequency:
        # T = 1 + x: all heat that flows into the case is stored, Q = s sum(E T)
        inner = np.ix_(free, free)
        x = np.linalg.solve(K[inner] + s * E[inner], -s * E[free].sum(axis=1))
        T = np.ones(len(K), dtype=complex)
        T[free] += x
        flows.append(s * (E @ T).sum())
        warm.append(junction @ T[free])
    return np.array(flows), np.array(warm)


def rates(keys):
    """Slowest rate [1/s] of the body with the case at a given temperature."""
    model = assemble_heat_model(HeatBodyKeys.model_validate(keys), None).model
    K, E = (np.asarray(part) for part in model.pencil.make_dense().coefficients)
    names = [port.name for port in model.ports]
    at = int(model.B[:, names.index("case")].argmax())
    free = np.delete(np.arange(len(K)), at)
    values = np.linalg.eigvals(np.linalg.solve(K[np.ix_(free, free)], E[np.ix_(free, free)]))
    return 1 / values.real.max()


def bodies(count, start=0):
    """Random bodies whose only path of heat is a pin of given temperature."""
    result = []
    for seed in range(start, start + 10 * count):
        keys, case = random_body(np.random.default_rng(seed))
        if case is not None:
            result.append(pytest.param(keys, id=f"{seed}-{'film' if 'films' in keys else 'face'}"))
    return result[:count]


def assert_flows_are_those_of_the_full_model(keys, **more):
    """Compare an ac analysis with scipy; ``more`` are keys of the reduction alone."""
    high = 30 * rates(keys) / (2 * np.pi)
    scene = {
        "name": "flow",
        "gravity": 0.0,
        "body": {"part": "heat_body", **keys, **more, "pins": {"case": "drive.out"}},
        "leak": {
            "part": "thermal_resistor",
            "resistance": "1e15 K/W",
            "pins": {"a": "body.junction"},
        },
        "drive": {"part": "source", "kind": "temperature", "ac": 1.0},
        "analysis": {"type": "ac", "start": 1e-3 * high, "stop": high, "points": 13},
    }
    stated = re.search(r"norm=(\w+) error=(\S+)", kc.deck(scene).files["flow_body.lib"])
    waves = kc.run(scene).waves
    exact, warm = full_flows(keys, waves["frequency"].real)
    limit = max(1.2 * float(stated[2]), 2e-5)  # 1e-5 of rounding errors of the oracle
    for name, expected in (("drive.heat", exact), ("body.temperature.junction", warm)):
        scale = np.abs(expected)
        floor = SMALLEST if stated[1] == "pointwise" else 1.0
        error = np.abs(waves[name] - expected) / np.maximum(scale, floor * scale.max())
        assert error.max() < limit, (name, error.max(), limit)


@pytest.mark.parametrize("keys", bodies(6))
def test_heat_flows_into_pins_are_within_the_stated_error(keys):
    assert_flows_are_those_of_the_full_model(keys)


WALL = {
    "layers": [
        {"material": "silicon", "thickness": 3e-4, "area": 25e-6, "resistance": 1e-5},
        {"material": "copper", "thickness": 2e-3, "area": 1e-4},
        {"material": "epoxy", "thickness": 1e-3, "area": 1e-4},
    ],
    "sources": {"junction": "top", "inside": "layer2"},
}


@pytest.mark.slow
@pytest.mark.parametrize("coefficient", [20.0, 300.0, 5000.0])
def test_heat_flows_over_the_range_of_a_film_are_within_the_stated_error(coefficient):
    keys = {**WALL, "films": [{"group": "bottom", "coefficient": coefficient, "pin": "case"}]}
    ranges = {"films[0].coefficient": [20.0, 5000.0]}
    assert_flows_are_those_of_the_full_model(keys, rom={"parameters": ranges})


@pytest.mark.campaign
@pytest.mark.parametrize("keys", bodies(40, start=60))
def test_many_heat_flows_into_pins_are_within_the_stated_error(keys):
    assert_flows_are_those_of_the_full_model(keys)
