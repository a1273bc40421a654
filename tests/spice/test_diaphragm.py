"""Diaphragms between motion and sound against closed forms."""

import numpy as np
import pytest
from scipy.special import j1, struve
from support import UsageError

import kc2spice as kc

DENSITY, SPEED = 1.204, 343.2  # kg/m3 and m/s, air at 20 C
AREA, MASS, FORCE = 1e-4, 0.1e-3, 1.0
CONE = {
    "name": "cone_in_air",
    "cone": {
        "part": "diaphragm",
        "area": "1 cm2",
        "mass": "0.1 g",
        "pins": {"a": "push.out", "front": "air.face"},
    },
    "air": {"part": "radiation", "area": "1 cm2"},
    "push": {"part": "source", "kind": "force", "ac": "1 N"},
    "analysis": {"type": "ac", "start": "100 Hz", "stop": "20 kHz", "points": 41},
}


def radiation_impedance(frequency):
    """Pressure per volume velocity of a piston in a baffle: Kinsler et al., eq. 7.5.11."""
    x = 4 * np.pi * frequency / SPEED * np.sqrt(AREA / np.pi)
    return DENSITY * SPEED / AREA * (1 - 2 * j1(x) / x + 2j * struve(1, x) / x)


def test_a_driven_cone_moves_against_its_mass_and_the_air():
    result = kc.run(CONE)
    waves = result.waves
    s = 2j * np.pi * waves["frequency"].real
    velocity = FORCE / (s * MASS + AREA**2 * radiation_impedance(waves["frequency"].real))
    exact = velocity / s
    assert np.abs(waves["cone.x"] / exact - 1).max() < 1e-3  # 0.16 % of the load of the air
    pressure = AREA * velocity * radiation_impedance(waves["frequency"].real)
    assert np.abs(waves["air.pressure"] / pressure - 1).max() < 3e-3
    assert np.abs(waves["cone.flow"] / -(AREA * velocity) - 1).max() < 1e-3
    (panel,) = result.figures["cone_displacement"].panels
    assert panel.curves[0].y[0] == pytest.approx(1e3 * abs(exact[0]), rel=1e-3)  # in mm


def test_a_cone_that_moves_forwards_draws_in_fluid_at_the_rear():
    behind = {"a": "push.out", "front": "gnd", "rear": "air.face"}
    turned = kc.run(CONE | {"cone": CONE["cone"] | {"pins": behind}}).waves
    waves = kc.run(CONE).waves
    np.testing.assert_allclose(turned["cone.x"], waves["cone.x"], rtol=1e-9)
    np.testing.assert_allclose(turned["air.pressure"], -waves["air.pressure"], rtol=1e-9)


STEP = 0.1  # N
AIR_SPRING = {
    "name": "air_spring",
    "cone": {
        "part": "diaphragm",
        "area": "10 cm2",
        "mass": "1 g",
        "pins": {"a": "push.out", "front": "box.a"},
    },
    "box": {"part": "cavity", "volume": "1000 cm3"},
    "push": {
        "part": "source",
        "kind": "force",
        "pulse": {"high": "0.1 N", "start": "1 ms", "edge": "10 us", "width": "1 s"},
    },
    "solver": {"stop": "60 ms", "max_step": "20 us", "reltol": 1e-6},
}


def test_a_step_of_force_moves_a_mass_on_an_air_spring():
    """Stiffness rho c^2 S^2 / V; the losses at the walls of the box are small."""
    waves = kc.run(AIR_SPRING).waves
    t, x = waves["time"], waves["cone.x"]
    stiffness = DENSITY * SPEED**2 * 1e-3**2 / 1e-3
    rate = np.sqrt(stiffness / 1e-3)
    exact = STEP / stiffness * (1 - np.cos(rate * (t - 1.005e-3))) * (t > 1.005e-3)
    first = t < 8e-3
    assert np.abs(x - exact)[first].max() < 0.03 * np.abs(exact).max()
    middle = x - STEP / stiffness
    rising = np.flatnonzero((middle[:-1] <= 0) & (middle[1:] > 0))
    crossings = t[rising] - middle[rising] * np.diff(t)[rising] / np.diff(x)[rising]
    assert 2 * np.pi / np.diff(crossings).mean() == pytest.approx(rate, rel=0.01)


def test_an_independent_integrator_confirms_the_air_spring():
    report = kc.verify(AIR_SPRING)
    assert report["passed"], report["checks"]


@pytest.mark.parametrize(("area", "words"), [("-1 cm2", "area"), ("0 cm2", "area"), ("1 cm", "cm")])
def test_an_impossible_area_is_refused(area, words):
    with pytest.raises(UsageError, match=words):
        kc.run(CONE | {"cone": CONE["cone"] | {"area": area}})


def test_the_air_transducer_has_the_values_of_its_data_sheet():
    """Prowave 400PT120: 40.0 +- 1.0 kHz, 2400 pF +- 20 %, 2.0 kHz at -6 dB."""
    result = kc.run("air_transducer")
    frequency = result.waves["frequency"].real
    pressure = np.abs(result.waves["listener.pressure"])
    assert frequency[pressure.argmax()] == pytest.approx(40e3, abs=1e3)
    half = pressure > pressure.max() / 2
    assert np.ptp(frequency[half]) == pytest.approx(2.0e3, rel=0.1)
    assert result.metrics["capacitance_f"] == pytest.approx(2400e-12, rel=0.2)
    # far field of the volume velocity of the cone on its axis, Kinsler et al., eq. 7.4.17
    s = 2j * np.pi * frequency
    flow = s * 63.6e-6 * result.waves["bender.u.centre"]
    exact = np.abs(s * DENSITY * flow) / (2 * np.pi * 0.3)
    np.testing.assert_allclose(pressure, exact, rtol=1e-3)
