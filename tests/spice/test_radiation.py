"""Radiation and listeners in ngspice against closed forms of the sound field."""

import warnings

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ive, j1, kve, struve, y1
from support import RADIATORS, UsageError, load_scene, verify_scenes

import kc2spice as kc

DENSITY, SPEED = 1.204, 343.2  # kg/m3 and m/s, air at 20 C
FLOW = 1e-6  # m3/s
SWEEP = {"type": "ac", "start": "100 Hz", "stop": "20 kHz", "points": 61}


def baffled_piston(ka):
    """Kinsler et al., Fundamentals of Acoustics, 4th ed., eq. 7.5.11, relative to rho c / S."""
    x = 2 * ka
    return 1 - 2 * j1(x) / x + 2j * struve(1, x) / x


def open_end(ka):
    """Levine and Schwinger, Phys. Rev. 73 (1948) 383, by direct integration over x."""
    result = []
    for k in ka:
        # x = k sin t removes the singularity of the root at x = k
        def inner(t, k=k):
            x = k * np.sin(t)
            angle = np.pi / 2 + np.arctan(y1(x) / j1(x))
            return angle / np.sin(t), np.log(np.pi * j1(x) * np.hypot(j1(x), y1(x))) / np.sin(t)

        angles = quad(lambda t: inner(t)[0], 0, np.pi / 2, epsabs=1e-11)[0]
        sizes = quad(lambda t: inner(t)[1], 0, np.pi / 2, epsabs=1e-11)[0] / k
        rest = quad(
            lambda x, k=k: -np.log(2 * ive(1, x) * kve(1, x)) / (x * np.hypot(x, k)), 0, np.inf
        )[0]
        reflection = -np.exp(-2 / np.pi * angles - 2j * k * (sizes + rest) / np.pi)
        result.append((1 + reflection) / (1 - reflection))
    return np.array(result)


def sphere(ka):
    """Kinsler et al., eq. 7.1.5, relative to rho c / S."""
    return 1j * ka / (1 + 1j * ka)


EXACT = {"baffled_piston": baffled_piston, "free_piston": open_end, "sphere": sphere}
AREAS = {"baffled_piston": np.pi, "free_piston": np.pi, "sphere": 4 * np.pi}
ANGLES = {"baffled_piston": 2 * np.pi, "free_piston": 4 * np.pi, "sphere": 4 * np.pi}


def respond(network, ka):
    """Impedance of the sections of a network relative to rho c / S."""
    s, result = 1j * ka, 0
    for r, w, b in network.sections:
        result = result + (r * b * w * s / (s * s + b * w * s + w * w) if b else r * s / (s + w))
    return result


@pytest.mark.parametrize("shape", EXACT)
def test_networks_have_the_stated_errors_and_no_larger_ones(shape):
    network = RADIATORS[shape].network
    ka = np.geomspace(1e-3, min(network.largest_ka, 1e3), 150)
    exact, ours = EXACT[shape](ka), respond(network, ka)
    impedance = np.abs(ours / exact - 1).max()
    power = np.abs(ours.real / exact.real - 1).max()
    assert impedance <= network.impedance_error + 1e-12
    assert power <= network.power_error + 1e-12
    assert impedance >= 0.9 * network.impedance_error
    assert (np.array(network.sections) >= 0).all()  # each section is positive real


def test_an_open_end_has_its_known_length_and_resistance():
    """End correction 0.61270 a (S. W. Rienstra, A. Hirschberg, An Introduction to Acoustics)."""
    z = open_end(np.array([1e-3]))[0]
    assert z.imag / 1e-3 == pytest.approx(0.61270, abs=1e-5)
    assert z.real / 1e-6 == pytest.approx(0.25, rel=1e-3)


def front(shape, **keys):
    """A radiating surface of 10 mm that a source of 1 cm3/s drives."""
    return {
        "name": "sound",
        "front": {"part": "radiation", "shape": shape, "radius": "10 mm",
                  "pins": {"face": "push.out"}} | keys,
        "push": {"part": "source", "kind": "volume_velocity", "ac": FLOW},
        "analysis": SWEEP,
    }  # fmt: skip


@pytest.mark.parametrize("shape", EXACT)
def test_the_pressure_on_a_surface_is_that_of_its_impedance(shape):
    result = kc.run(front(shape, fluid="water" if shape == "sphere" else "air"))
    frequency = result.waves["frequency"].real
    density, speed = (998.2, 1482.3) if shape == "sphere" else (DENSITY, SPEED)
    ka = 2 * np.pi * frequency * 0.01 / speed
    exact = FLOW * density * speed / (AREAS[shape] * 1e-4) * EXACT[shape](ka)
    error = RADIATORS[shape].network.impedance_error
    np.testing.assert_allclose(result.waves["front.pressure"], exact, rtol=max(error, 1e-9))
    np.testing.assert_allclose(result.waves["front.flow"], FLOW, rtol=1e-9)
    sound = 2j * np.pi * frequency * density * FLOW / ANGLES[shape]
    # the pressure of a sphere decreases as 1 / r from its surface on
    sound = sound / (1 + 1j * ka) if shape == "sphere" else sound
    sound = sound * (1 + open_end(ka)) if shape == "free_piston" else sound
    limit = error if shape == "free_piston" else 1e-9
    np.testing.assert_allclose(result.waves["front.sound"], sound, rtol=limit)


@pytest.mark.parametrize("shape", ["sphere", "free_piston"])
def test_the_intensity_on_the_axis_follows_from_the_power_at_the_face(shape):
    """|p|^2 / (2 rho c) is G / (4 pi r^2) times the power; G = 1 of a sphere.

    G = (k a)^2 / (1 - |R|^2) of an open end (Levine and Schwinger).
    """
    scene = front(shape) | {"ear": {"part": "listener", "distance": "2 m"}}
    scene["analysis"] = SWEEP | {"start": "19 kHz", "points": 3}
    scene["probes"] = {"radiated_w": {"of": "front.power", "at": "20 kHz"}}
    result = kc.run(scene)
    ka = np.array([2 * np.pi * 20e3 * 0.01 / SPEED])
    gain = 1.0
    if shape == "free_piston":
        z = open_end(ka)[0]
        gain = ka[0] ** 2 / (1 - np.abs((z - 1) / (z + 1)) ** 2)
    intensity = np.abs(result.waves["ear.pressure"][-1]) ** 2 / (2 * DENSITY * SPEED)
    exact = gain * result.metrics["radiated_w"] / (4 * np.pi * 4)
    limit = 3 * RADIATORS[shape].network.impedance_error
    assert intensity == pytest.approx(exact, rel=max(limit, 1e-6))


def test_the_field_of_the_sphere_of_nafems_at_15_m():
    """rho c v / (1 + k^2) |k^2 - j k| / 15, the closed form of test CA1 (radius 1 m)."""
    density, speed = 1.225, 340.0
    scene = front("sphere", radius="1 m", fluid={"density": density, "sound_speed": speed})
    scene["push"]["ac"] = 4 * np.pi * 0.1
    scene |= {"ear": {"part": "listener", "distance": "15 m"},
              "analysis": SWEEP | {"start": "20 Hz", "stop": "500 Hz"}}  # fmt: skip
    result = kc.run(scene)
    k = 2 * np.pi * result.waves["frequency"].real / speed
    exact = density * speed * 0.1 / (1 + k**2) * (k**2 + 1j * k) / 15 * np.exp(-14j * k)
    np.testing.assert_allclose(result.waves["ear.pressure"], exact, rtol=1e-9)


def test_a_listener_hears_two_surfaces_at_an_angle():
    scene = front("baffled_piston") | {
        "back": {"part": "radiation", "shape": "baffled_piston", "area": "78.54 mm2",
                 "pins": {"face": "pull.out"}},
        "pull": {"part": "source", "kind": "volume_velocity", "ac": -3e-7},
        "ear": {"part": "listener", "distance": "30 cm", "angle": 50},
        "one": {"part": "listener", "distance": "30 cm", "sources": ["back"]},
        "probes": {"level": {"of": "ear.pressure", "take": "spl", "at": "20 kHz"},
                   "loudest": {"of": "one.pressure", "take": "spl"}},
    }  # fmt: skip
    result = kc.run(scene)
    frequency = result.waves["frequency"].real
    k, sine, r = 2 * np.pi * frequency / SPEED, np.sin(np.radians(50)), 0.3
    total = 0
    for flow, radius in ((FLOW, 0.01), (-3e-7, np.sqrt(78.54e-6 / np.pi))):
        x = k * radius * sine
        total = total + flow * (2 * j1(x) / x)
    exact = 1j * k * SPEED * DENSITY * total / (2 * np.pi * r) * np.exp(-1j * k * r)
    np.testing.assert_allclose(result.waves["ear.pressure"], exact, rtol=1e-8)
    level = 20 * np.log10(np.abs(exact[-1]) / np.sqrt(2) / 20e-6)
    assert result.metrics["level"] == pytest.approx(level, abs=1e-6)
    assert result.record["metric_units"]["level"] == "dB"
    back = 3e-7 * 2 * np.pi * 20e3 * DENSITY / (2 * np.pi * r)
    loudest = 20 * np.log10(back / np.sqrt(2) / 20e-6)
    assert result.metrics["loudest"] == pytest.approx(loudest, abs=1e-6)
    assert result.metrics["one.peak_level_db"] == pytest.approx(loudest, abs=1e-6)
    assert result.metrics["one.peak_level_frequency_hz"] == pytest.approx(20e3)


def test_a_listener_in_water_counts_from_one_micropascal():
    scene = front("sphere", fluid="water") | {"ear": {"part": "listener", "distance": "1 m"}}
    scene["probes"] = {"level": {"of": "ear.pressure", "take": "spl"}}
    ka = 2 * np.pi * 20e3 * 0.01 / 1482.3
    pressure = 2 * np.pi * 20e3 * 998.2 * FLOW / (4 * np.pi) / np.hypot(1, ka)
    level = 20 * np.log10(pressure / np.sqrt(2) / 1e-6)
    result = kc.run(scene)
    assert result.metrics["level"] == pytest.approx(level, abs=1e-6)
    assert result.metrics["peak_level_db"] == pytest.approx(level, abs=1e-6)


def test_a_tone_in_time_has_the_level_of_its_amplitude(tmp_path):
    scene = front("sphere") | {
        "ear": {"part": "listener", "distance": "10 cm"},
        "push": {"part": "source", "kind": "volume_velocity",
                 "sine": {"amplitude": FLOW, "frequency": "4 kHz"}},
        "analysis": {"type": "transient"},
        "solver": {"stop": "2 ms", "reltol": 1e-5},
        "probes": {"level": {"of": "ear.pressure", "take": "spl", "periods": 4}},
    }  # fmt: skip
    ka = 2 * np.pi * 4e3 * 0.01 / SPEED
    pressure = 2 * np.pi * 4e3 * DENSITY * FLOW / (4 * np.pi * 0.1) / np.hypot(1, ka)
    level = 20 * np.log10(pressure / np.sqrt(2) / 20e-6)
    assert kc.run(scene).metrics["level"] == pytest.approx(level, abs=0.01)
    report = verify_scenes([load_scene(scene)], tmp_path)["scenes"]["sound"]
    assert report["passed"], report["checks"]


@pytest.mark.parametrize("shape", EXACT)
def test_laws_and_netlist_agree(shape, tmp_path):
    scene = front(shape) | {"ear": {"part": "listener"}}
    scene["probes"] = {"level": {"of": "ear.pressure", "take": "spl"}}
    report = verify_scenes([load_scene(scene)], tmp_path)["scenes"]["sound"]
    assert report["passed"], report["checks"]


FAULTS = [
    ({"area": "3 cm2"}, {}, "two sizes"),
    ({"radius": None}, {}, "no size"),
    ({"shape": "sphere", "motion": "piston"}, {}, "cannot have the key `motion`"),
    ({"fluid": "mercury"}, {}, "fluid does not exist"),
    ({"fluid": {"density": -1, "sound_speed": 343}}, {}, "out of range"),
    ({"fluid": {"density": 1.2, "sound_speed": 343, "heat_ratio": 0.9}}, {}, "out of range"),
    ({"fluid": {"density": 1.2, "sound_speed": 343, "conductivity": 0.026}}, {}, "specific_heat"),
    ({}, {"angle": 100}, "behind the baffle"),
    ({"shape": "sphere"}, {"distance": "9 mm"}, "inside of the sphere"),
    ({}, {"sources": ["side"]}, "no part of type radiation with this name"),
    ({}, {"sources": ["front", "front"]}, "twice"),
    ({"pins": {}}, {}, "not joined|not connected|face"),
]


@pytest.mark.parametrize(("keys", "ear", "words"), FAULTS)
def test_impossible_keys_are_refused(keys, ear, words):
    scene = front(**({"shape": "baffled_piston"} | keys)) | {"ear": {"part": "listener"} | ear}
    scene["front"] = {k: v for k, v in scene["front"].items() if v is not None}
    with pytest.raises(UsageError, match=words):
        load_scene(scene)


def test_a_listener_without_a_surface_is_refused():
    with pytest.raises(UsageError, match="no radiating surface"):
        load_scene({"name": "deaf", "ear": {"part": "listener"}, "push": {"part": "source"}})


def test_a_band_beyond_the_network_warns_before_the_simulation():
    with pytest.warns(
        UserWarning, match=r"valid up to 20\.\d+ kHz, but the analysis ends at 30 kHz"
    ):
        load_scene(front("free_piston") | {"analysis": SWEEP | {"stop": "30 kHz"}})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_scene(front("free_piston"))


def test_a_listener_in_the_near_field_warns():
    with pytest.warns(UserWarning, match="the pressure is inaccurate above 10.92 kHz"):
        load_scene(front("baffled_piston") | {"ear": {"part": "listener", "distance": "10 mm"}})


@pytest.mark.parametrize("probe", [{"of": "front.flow", "take": "spl"}])
def test_levels_need_a_pressure(probe):
    with pytest.raises(UsageError, match="needs a pressure"):
        kc.run(front("sphere") | {"probes": {"level": probe}})


def test_the_noise_of_a_surface_is_that_of_its_resistance():
    scene = front("sphere")
    del scene["push"]["ac"]
    scene["analysis"] = SWEEP | {"type": "noise", "output": "front.pressure"}
    result = kc.run(scene)
    ka = 2 * np.pi * result.waves["frequency"].real * 0.01 / SPEED
    resistance = DENSITY * SPEED / (4 * np.pi * 1e-4) * sphere(ka).real
    exact = np.sqrt(4 * 1.380649e-23 * 300.15 * resistance)
    np.testing.assert_allclose(np.abs(result.waves["noise"]), exact, rtol=1e-5)
