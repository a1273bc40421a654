"""Every linear element between two pins: its run, its law and its printed card, each by hand."""

import re

import numpy as np
import pytest

import kc2spice as kc
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.two_terminal_types import TABLE
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.workflow.verify.circuit import solve

# By hand, of a value in SI: through / across at the Laplace variable s. Across is the voltage [V]
# or the displacement [m], through the current [A] or the force [N].
DECLARED = {
    "resistor": lambda s, value: 1 / value,
    "capacitor": lambda s, value: s * value,
    "inductor": lambda s, value: 1 / (s * value),
    "spring": lambda s, value: value,
    "damper": lambda s, value: s * value,
}
# Of a printed card: current / voltage of its nodes.
CARDS = {
    "r": lambda s, value: 1 / value,
    "c": lambda s, value: s * value,
    "l": lambda s, value: 1 / (s * value),
}
SIZES = {"resistor": 50.0, "capacitor": 1e-7, "inductor": 1e-3, "spring": 100.0, "damper": 0.02}
EDGE, TOP, STOP = 1e-3, 2e-3, 1e-3
KEY = {row.name: row.key for row in TABLE}
rows = pytest.mark.parametrize("name", sorted(KEY))


def moving(name):
    return name in ("spring", "damper")


def tables(name, value, analysis, **drive):
    """The element between two ideal sources, of which ``far`` is still: no pin is on ground."""
    kind = {"kind": "displacement"} if moving(name) else {}
    return {
        "name": "pair",
        "near": {"part": "source", **kind, **drive},
        "far": {"part": "source", **kind, "dc": 0.0},
        "it": {"part": name, KEY[name]: value, "pins": {"a": "near.out", "b": "far.out"}},
        "analysis": analysis,
    }


def through(name):
    return "it.force" if moving(name) else "it.i"


def test_each_row_has_a_closed_form():
    assert set(DECLARED) == set(SIZES) == set(KEY)


@rows
def test_small_signals_are_those_of_the_closed_form(name):
    scene = tables(name, SIZES[name], {"type": "ac", "start": 1e2, "stop": 1e5}, ac=TOP, dc=0.0)
    waves = kc.run(scene).waves
    f = np.real(waves["frequency"])
    exact = TOP * DECLARED[name](2j * np.pi * f, SIZES[name]) * np.ones_like(f)
    np.testing.assert_allclose(waves[through(name)], exact, rtol=1e-9)
    build = Build(load_scene(scene), {})
    law = solve(build, Waveforms({"frequency": f}, {})).results
    np.testing.assert_allclose(law[through(name)], exact, rtol=1e-9)


@rows
def test_a_ramp_gives_its_value_its_slope_or_its_integral(name):
    """Across = ramp t: through is value ramp t, value ramp or ramp t^2 / (2 value)."""
    pulse = {"high": TOP, "edge": EDGE, "width": 1e-2}
    scene = tables(name, SIZES[name], {"type": "transient", "stop": STOP}, pulse=pulse)
    scene["solver"] = {"max_step": STOP / 200}
    waves = kc.run(scene).waves
    t, slope, value = waves["time"], TOP / EDGE, SIZES[name]
    exact = {
        "resistor": slope * t / value,
        "inductor": slope * t**2 / (2 * value),
        "spring": value * slope * t,
    }.get(name, value * slope * np.ones_like(t))
    inside = (t > STOP / 20) & (t < 0.99 * STOP)
    # reltol of the simulator is 1e-4; the law's integrator holds 1e-7
    limit = np.abs(exact).max()
    np.testing.assert_allclose(waves[through(name)][inside], exact[inside], atol=2e-4 * limit)
    points = Waveforms({"time": t}, {})
    law = solve(Build(load_scene(scene), {}), points).results
    np.testing.assert_allclose(law[through(name)][inside], exact[inside], atol=1e-7 * limit)


@rows
def test_the_printed_card_is_the_declared_relation(name):
    """Read back at random values and frequencies; 1 V on a displacement node is 1 um."""
    random = np.random.default_rng(7)
    for value in 10.0 ** random.uniform(-9, 6, 5):
        scene = tables(name, float(value), {"type": "op"}, dc=1.0)
        deck = kc.deck(scene)
        text = deck.files[deck.main]
        ((letter, a, size),) = re.findall(r"(?mi)^([rcl])it (\w+) far_out (\S+)$", text)
        if a != "near_out":  # an ideal meter lies in between
            assert re.search(rf"(?mi)^v\w+ near_out {a} 0$", text)
        s = complex(*random.uniform(-1e6, 1e6, 2))
        scale = 1e6 if moving(name) else 1.0
        printed = scale * CARDS[letter.lower()](s, float(size))
        assert printed == pytest.approx(DECLARED[name](s, value), rel=1e-14)
