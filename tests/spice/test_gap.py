"""A gap with a stop and a squeezed film: closed forms of pull-in, release and Blech's series."""

import numpy as np
import pytest

import kc2spice as kc
from kc2spice.core.errors import UsageError
from kc2spice.scene.load import load_scene

EPS, AREA, GAP, TRAVEL, K = 8.8541878188e-12, 1e-8, 3e-6, 2e-6, 1.2152
LENGTH, WIDTH, FILM, VISCOSITY, PRESSURE = 2e-3, 1e-3, 5e-6, 18.3e-6, 1e5


def loop(**keys):
    return {
        "name": "loop",
        "plate": {"part": "gap", "a": "spring.a", "area": AREA, "gap": GAP, "travel": TRAVEL,
                  "stop": 1e4, "side": "above", "pins": {"plus": "drive.out"}, **keys},
        "spring": {"part": "spring", "stiffness": K},
        "drive": {"part": "source", "dc": 0.0},
        "analysis": {"type": "dc", "sweep": "drive.dc", "from": 0.0, "to": 12.0, "points": 241,
                     "back": True},
    }  # fmt: skip


@pytest.mark.parametrize("count", [1, 3])
def test_a_loop_snaps_in_at_a_third_of_the_gap_and_lets_go_where_the_spring_is_stronger(count):
    """Several patches on one face are one plate. Both voltages lie between two points."""
    metrics = kc.run(loop(a=["spring.a"] * count)).metrics
    step = 12.0 / 240
    pull_in = np.sqrt(8 * K * GAP**3 / (27 * EPS * AREA))
    release = (GAP - TRAVEL) * np.sqrt(2 * K * TRAVEL / (EPS * AREA))
    assert abs(metrics["pull_in_v"] - pull_in) <= step / 2
    assert abs(metrics["release_v"] - release) <= step / 2


def blech(hertz, terms=201):
    """Stiffness and damping of a film: J. J. Blech (1983), equations of a rectangular plate."""
    omega, beta = 2 * np.pi * hertz, WIDTH / LENGTH
    squeeze = 12 * VISCOSITY * omega * WIDTH**2 / (PRESSURE * FILM**2)
    n, m = np.meshgrid(np.arange(1, terms, 2), np.arange(1, terms, 2))
    below = (m * n) ** 2 * ((m**2 + (beta * n) ** 2) ** 2 + (squeeze / np.pi**2) ** 2)
    face = PRESSURE * LENGTH * WIDTH / FILM
    stiffness = 64 * squeeze**2 * face / np.pi**8 * np.sum(1 / below)
    damping = 64 * squeeze * face / (np.pi**6 * omega) * np.sum((m**2 + (beta * n) ** 2) / below)
    return stiffness, damping


def film(branches, count=1, ends=("1 kHz", "100 kHz")):
    return {
        "name": "film",
        "plate": {"part": "gap", "a": ["shake.out"] * count, "area": LENGTH * WIDTH, "gap": FILM,
                  "travel": FILM / 2, "side": "above", "pins": {"plus": "drive.out"},
                  "film": {"length": LENGTH, "width": WIDTH, "viscosity": VISCOSITY,
                           "pressure": PRESSURE, "branches": branches}},
        "drive": {"part": "source"},
        "shake": {"part": "source", "kind": "displacement", "ac": 1e-9},
        "analysis": {"type": "ac", "start": ends[0], "stop": ends[1], "points": 11},
    }  # fmt: skip


@pytest.mark.parametrize(("branches", "count", "within"), [(12, 1, 2e-3), (6, 3, 0.03)])
def test_a_film_is_blechs(branches, count, within):
    """20 branches of the series leave 2e-3 of the stiffness at 100 kHz, 6 leave 3 %."""
    waves = kc.run(film(branches, count)).waves
    force = sum(waves[f"plate.force{k}"] for k in range(1, count + 1)) / 1e-9
    for hertz, found in zip(waves["frequency"].real, force, strict=True):
        stiffness, damping = blech(hertz)
        exact = stiffness + 2j * np.pi * hertz * damping
        assert abs(found / exact - 1) < within


def test_bad_keys_say_what_they_are():
    with pytest.raises(UsageError, match="stop lies beyond"):
        load_scene(loop(travel=GAP))
    with pytest.raises(UsageError, match="shares of the area differ"):
        load_scene(loop(shares=[0.5, 0.5]))
    with pytest.raises(UsageError, match="has no patches"):
        load_scene(loop(a="spring"))
    with pytest.raises(UsageError, match="only the dc value of a source returns"):
        load_scene(loop() | {"analysis": {"type": "op", "back": True}})
