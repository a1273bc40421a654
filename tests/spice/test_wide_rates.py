"""Circuits whose natural rates differ by many orders of magnitude, against exact solutions."""

import numpy as np
import pytest
from scipy.linalg import expm

import kc2spice as kc

START, EDGE, STOP = 1e-3, 10e-6, 60e-3  # s
PULSE = {"high": "1 V", "start": "1 ms", "edge": "10 us", "width": "1 s"}
# rates of 1e6, 1 and 0.05 per second: 1 kOhm with 1 nF, 1 MOhm with 1 uF, 1 MOhm with 20 uF
LADDER = [(1e3, 1e-9), (1e6, 1e-6), (1e6, 20e-6)]


def make_ladder(sections):
    """Scene of RC sections in a row, driven by a step of voltage."""
    scene = {"name": "ladder", "drive": {"part": "source", "pulse": PULSE}}
    before = "drive.out"
    for k, (r, c) in enumerate(sections):
        pins = {"a": before, "b": f"c{k}.a"}
        scene[f"r{k}"] = {"part": "resistor", "resistance": f"{r:g} Ohm", "pins": pins}
        scene[f"c{k}"] = {"part": "capacitor", "capacitance": f"{c:g} F"}
        before = f"c{k}.a"
    return scene | {"solver": {"stop": "60 ms", "reltol": 1e-6}}


def exact_voltages(sections, times):
    """Voltages (nt, sections) of the ladder: linear equations with the ramp as two more states."""
    n = len(sections)
    A = np.zeros((n + 2, n + 2))
    for k, (r, c) in enumerate(sections):
        A[k, k] -= 1 / (r * c)
        A[k, k - 1 if k else n] += 1 / (r * c)
        if k:
            before = sections[k - 1][1]
            A[k - 1, k - 1] -= 1 / (r * before)
            A[k - 1, k] += 1 / (r * before)
    A[n, n + 1] = 1.0  # source voltage, and its slope
    start = np.zeros(n + 2)
    start[n + 1] = 1 / EDGE
    top = expm(A * EDGE) @ start
    top[n + 1] = 0.0
    result = []
    for t in times - START:
        if t < EDGE:
            result.append(expm(A * max(t, 0.0)) @ start * (t > 0))
        else:
            result.append(expm(A * (t - EDGE)) @ top)
    return np.array(result)[:, :n]


def step_check(result):
    """Deviation of the waves from the exact motion, as the run states it."""
    return next(c for c in result.checks if c.name == "time steps compared with the exact solution")


def test_slow_relaxations_beside_fast_ones_are_no_rigid_motions():
    result = kc.run(make_ladder(LADDER))
    assert step_check(result).value < 2e-3
    waves = result.waves
    chosen = np.linspace(0, waves["time"].size - 1, 60).astype(int)
    exact = exact_voltages(LADDER, waves["time"][chosen])
    for k in range(len(LADDER)):
        error = np.abs(waves[f"c{k}.v"][chosen] - exact[:, k]).max()
        assert error < 1e-3 * np.abs(exact[:, k]).max()


@pytest.mark.parametrize("seed", range(4))
def test_random_ladders_raise_no_false_alarm(seed):
    rng = np.random.default_rng(seed)
    sizes = 10 ** rng.uniform(2, 7, 4), 10 ** rng.uniform(-10, -4.5, 4)
    assert step_check(kc.run(make_ladder(list(zip(*sizes, strict=True))))).value < 5e-3


def test_a_loudspeaker_in_a_closed_box_follows_the_exact_motion():
    """The heat conduction of the walls relaxes with rates down to 0.2 per second."""
    box = {
        "name": "closed_box",
        "woofer": {
            "part": "loudspeaker", "fs": "46.4 Hz", "re": "6.23 Ohm", "qms": 6.66, "qes": 0.538,
            "mms": "10.28 g", "sd": "132 cm2", "pins": {"plus": "drive.out", "front": "box.a"},
        },
        "box": {"part": "cavity", "volume": "1000 cm3"},
        "drive": {"part": "source", "pulse": PULSE},
        "solver": {"stop": "60 ms"},
    }  # fmt: skip
    assert step_check(kc.run(box)).value < 5e-3
