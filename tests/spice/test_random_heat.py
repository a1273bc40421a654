"""Random heat bodies: the emitted netlist in ngspice against scipy on the full model."""

import numpy as np
import pytest
import scipy
from support import HeatBodyKeys, assemble_heat_model

import kc2spice as kc

MATERIALS = ("copper", "silicon", "alumina", "FR4", "solder", "epoxy", "steel", "PZT")
TOLERANCE = 1e-4


def random_body(rng):
    """Keys of a stack with random layers, joints, films and pins."""
    layers = []
    for number in range(int(rng.integers(1, 6))):
        layer = {
            "material": str(rng.choice(MATERIALS)),
            "thickness": float(10 ** rng.uniform(-4, -2)),
            "area": float(10 ** rng.uniform(-6, -3)),
        }
        layers.append(layer)
        if number and rng.random() < 0.5:
            layers[number - 1]["resistance"] = float(10 ** rng.uniform(-6, -3))
    keys = {"layers": layers, "sources": {"junction": "top"}}
    inner = int(rng.integers(1, len(layers) + 1))
    keys["sources"]["inside"] = f"layer{inner}"
    coefficient = float(10 ** rng.uniform(0, 4))
    way = rng.choice(["fixed", "film", "isothermal", "pin"])
    if way == "fixed":
        keys["fixed"] = ["bottom"]
    elif way == "isothermal":
        keys["isothermal"] = {"case": "bottom"}
    else:
        film = {"group": "bottom", "coefficient": coefficient}
        keys["films"] = [film if way == "film" else {**film, "pin": "case"}]
    return keys, "case" if way in ("isothermal", "pin") else None


def slowest(E, K):
    values = scipy.linalg.eigh(K, E + 1e-12 * np.trace(E) * np.eye(len(E)), eigvals_only=True)
    return float(values[values > 1e-9 * values.max()].min())


def condensed(model, case):
    """E, K and B of the full model with the case at the ambient temperature."""
    K, E = (np.asarray(part) for part in model.pencil.make_dense().coefficients)
    names = [port.name for port in model.ports]
    B = model.B
    if case is not None:
        at = int(B[:, names.index(case)].argmax())
        free = np.delete(np.arange(len(K)), at)
        E, K, B = E[np.ix_(free, free)], K[np.ix_(free, free)], B[free]
    return E, K, B[:, [names.index("junction"), names.index("inside")]]


def assert_random_body_is_the_full_model(seed):
    rng = np.random.default_rng(seed)
    keys, case = random_body(rng)
    full = assemble_heat_model(HeatBodyKeys.model_validate(keys), None).model
    E, K, B = condensed(full, case)
    rate = slowest(E, K)
    body = {"part": "heat_body", **keys, "pins": {"junction": "drive.out"}}
    if case is not None:
        body["pins"][case] = "gnd"
    probes = {
        "junction": {"of": "body.temperature.junction", "take": "final"},
        "inside": {"of": "body.temperature.inside", "take": "final"},
    }
    scene = {"name": "random", "gravity": 0.0, "body": body, "probes": probes}
    drive = {"part": "source", "kind": "heat_flow"}
    exact = B.T @ np.linalg.solve(K, B[:, 0])
    # at rest
    found = kc.run({**scene, "drive": {**drive, "dc": "1 W"}, "analysis": {"type": "op"}}).metrics
    assert [found["junction"], found["inside"]] == pytest.approx(exact, rel=2 * TOLERANCE)
    # over frequency
    low, high = 0.01 * rate / (2 * np.pi), 100 * rate / (2 * np.pi)
    sweep = {"type": "ac", "start": low, "stop": high, "points": 7}
    result = kc.run({**scene, "drive": {**drive, "ac": "1 W"}, "analysis": sweep})
    rom, waves = result.record["rom"], result.waves
    for k, f in enumerate(waves["frequency"].real):
        answer = B.T @ np.linalg.solve(K + 2j * np.pi * f * E, B[:, 0])
        base = abs(answer[0] if rom["norm"] == "pointwise" else exact[0])
        error = waves["body.temperature.junction"][k] - answer[0]
        assert abs(error) < 1.5 * rom["error_estimate"] * base + 1e-5 * base, (seed, f)
    # after a step
    stop, edge = 3 / rate, 3e-4 / rate
    pulse = {"high": "1 W", "width": 1e3 * stop, "edge": edge}
    solver = {"stop": stop, "reltol": 1e-6, "max_step": stop / 1000}
    step = kc.run({**scene, "drive": {**drive, "pulse": pulse}, "solver": solver}).waves
    # E T' = B q - K T by its modes, for an edge that is short beside all times of interest
    values, vectors = scipy.linalg.eigh(E, K)
    rates = 1 / np.maximum(values, 1e-300)
    gains = vectors.T @ B
    t = np.array([0.1, 0.3, 1.0]) * stop
    settled = 1 - np.exp(-np.minimum(np.outer(t - edge / 2, rates), 700))
    expected = settled @ (gains[:, 0] * gains[:, 0])
    seen = np.interp(t, step["time"], step["body.temperature.junction"])
    assert seen == pytest.approx(expected, rel=1e-3), seed


@pytest.mark.parametrize("seed", range(4))
def test_random_heat_bodies(seed):
    assert_random_body_is_the_full_model(seed)


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(4, 54))
def test_many_random_heat_bodies(seed):
    assert_random_body_is_the_full_model(seed)
