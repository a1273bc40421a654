"""Acoustic pins, semi-inductance and creep of loudspeakers against closed forms."""

import numpy as np
import pytest
from scipy.special import j1, struve
from support import list_dialect_names

import kc2spice as kc

# SEAS L16RNX with the parameters of J. Candy and C. Futtrup (speakertools, ADV_L16RNX.json).
DRIVER = {"fs": 45.0, "re": 5.7212, "bl": 7.0089, "rms": 2.11, "mms": 14.896e-3, "sd": 104e-4}
SEMI = {"leb": 0.1258e-3, "le": 1.1774e-3, "ke": 0.0386, "rss": 562.4}
RHO, SOUND_SPEED = 1.204, 343.2
OMEGA = 2 * np.pi * DRIVER["fs"]
CMS = 1 / (OMEGA**2 * DRIVER["mms"])
# mass of the air in front of a piston in a baffle
LOAD = 8 / 3 * RHO * (DRIVER["sd"] / np.pi) ** 1.5


def scene(keys=None, pins=None, parts=None, **analysis):
    joined = {"plus": "drive.out"} | (pins or {})
    part = {"part": "loudspeaker", **DRIVER, **(keys or {}), "pins": joined}
    band = {"type": "ac", "start": 10.0, "stop": 2e4, "points": 60}
    drive = {"part": "source", "ac": 1.0}
    analysis = analysis or band
    return {"name": "driver", "speaker": part, "drive": drive, "analysis": analysis} | (parts or {})


def impedance(waves):
    return 2j * np.pi * waves["frequency"].real, waves["speaker.v"] / waves["speaker.i"]


def closed_form(s, inductive, suspension, mass=DRIVER["mms"], acoustic=0.0):
    """Impedance with that of the blocked coil, of the suspension, and the acoustic load."""
    mechanical = s * mass + suspension + DRIVER["sd"] ** 2 * acoustic
    return DRIVER["re"] + inductive + DRIVER["bl"] ** 2 / mechanical


def plain_suspension(s):
    return DRIVER["rms"] + 1 / (s * CMS)


def creeping_suspension(s, creep):
    """``r0 + 1/(s c0 (1 + creep ln(1 + w/s)))`` that is ``rms + 1/(s cms)`` at s = j w."""

    def shape(s):
        return 1 / (s * (1 + creep * np.log(1 + OMEGA / s)))

    c0 = shape(1j * OMEGA).imag / (1 / (1j * OMEGA * CMS)).imag
    return DRIVER["rms"] + (shape(s) - shape(1j * OMEGA).real) / c0


def semi_inductance(s, leb=0.0, le=1e30, ke=1e30, rss=1e30):
    return s * leb + 1 / (1 / (s * le) + 1 / (ke * np.sqrt(s)) + 1 / rss)


@pytest.mark.parametrize(
    "keys", [SEMI, {"ke": 0.0386}, {"ke": 0.02, "rss": 30.0}, {"le": 1e-3, "ke": 0.1}]
)
def test_the_ladder_of_semi_inductance_has_the_stated_error(keys):
    s, z = impedance(kc.run(scene(keys)).waves)
    expected = closed_form(s, semi_inductance(s, **keys), plain_suspension(s))
    np.testing.assert_allclose(z, expected, rtol=1.7e-3)


def test_shorted_turns_without_a_ladder_are_exact():
    keys = {"le": 1e-3, "rss": 100.0, "leb": 0.2e-3}
    s, z = impedance(kc.run(scene(keys)).waves)
    expected = closed_form(s, semi_inductance(s, **keys), plain_suspension(s))
    np.testing.assert_allclose(z, expected, rtol=1e-9)


def test_creep_keeps_the_stated_values_at_resonance():
    keys = {"creep": 0.1034, "le": 1e-9}
    s, z = impedance(kc.run(scene(keys, type="ac", start=1.0, stop=500.0, points=80)).waves)
    expected = closed_form(s, 1e-9 * s, creeping_suspension(s, 0.1034))
    np.testing.assert_allclose(z, expected, rtol=5e-4)
    # a constant compliance differs by far more than the ladder
    constant = closed_form(s, 1e-9 * s, plain_suspension(s))
    assert np.abs(constant / expected - 1).max() > 0.02


def test_a_constant_force_meets_the_grown_compliance():
    push = {"part": "source", "kind": "force", "dc": 1.0, "pins": {"out": "speaker.cone"}}
    tables = scene({"creep": 0.1}, parts={"push": push}, type="op")
    grown = 1 + 0.1 * np.log(1 - 1j)
    c0 = CMS * grown.real / abs(grown) ** 2
    # from 30 fs to 0.001 fs the logarithm grows by ln 1e3, and slightly more at rest
    stretch = kc.run(tables).waves["speaker.x"][0] / c0
    assert 1 + 0.1 * np.log(1e3) < stretch < 1 + 0.1 * np.log(1e4)


def test_acoustic_pins_are_an_ideal_transformer():
    load = {"part": "acoustic_resistor", "resistance": 2e4}
    air = {"part": "acoustic_mass", "mass": 30.0}
    tables = scene({"le": 1e-3}, {"front": "load.a", "rear": "air.a"}, {"load": load, "air": air})
    waves = kc.run(tables).waves
    s, z = impedance(waves)
    suspension = plain_suspension(s)
    expected = closed_form(s, 1e-3 * s, suspension, acoustic=2e4 + 30.0 * s)
    np.testing.assert_allclose(z, expected, rtol=1e-9)
    mechanical = s * DRIVER["mms"] + suspension + DRIVER["sd"] ** 2 * (2e4 + 30.0 * s)
    flow = DRIVER["sd"] * DRIVER["bl"] / (mechanical * z)
    np.testing.assert_allclose(waves["load.flow"], flow, rtol=1e-9)
    np.testing.assert_allclose(waves["air.flow"], -flow, rtol=1e-9)


def piston_impedance(s):
    """Acoustic impedance of a piston in a baffle (Kinsler et al., section 7.5)."""
    radius, rate = np.sqrt(DRIVER["sd"] / np.pi), np.abs(s)
    x = 2 * rate / SOUND_SPEED * radius
    relative = 1 - 2 * j1(x) / x + 2j * struve(1, x) / x
    return RHO * SOUND_SPEED / DRIVER["sd"] * relative


@pytest.mark.parametrize("sides", [("front",), ("front", "rear")])
def test_radiation_does_not_count_the_mass_of_the_air_twice(sides):
    parts = {side + "_air": {"part": "radiation", "area": DRIVER["sd"]} for side in sides}
    pins = {side: f"{side}_air.face" for side in sides}
    span = {"type": "ac", "start": 10.0, "stop": 5e3, "points": 100}
    s, z = impedance(kc.run(scene({"le": 1e-3}, pins, parts, **span)).waves)
    mass, acoustic = DRIVER["mms"] - len(sides) * LOAD, len(sides) * piston_impedance(s)
    expected = closed_form(s, 1e-3 * s, plain_suspension(s), mass, acoustic)
    np.testing.assert_allclose(z, expected, rtol=1e-4)
    assert (
        np.abs(z / closed_form(s, 1e-3 * s, plain_suspension(s), acoustic=acoustic) - 1).max()
        > 0.03
    )


def test_efficiency_is_radiated_over_electrical_power():
    """Below 100 Hz in a baffle: ``rho/(2 pi c) |sd dv/dt|^2`` over ``Re Z |i|^2``."""
    parts = {
        "air": {"part": "radiation", "area": DRIVER["sd"]},
        "ear": {"part": "listener", "distance": 2.0},
    }
    tables = scene({"le": 1e-3}, {"front": "air.face"}, parts)
    tables["analysis"] |= {"start": 20.0, "stop": 100.0}
    result = kc.run(tables)
    s, z = impedance(result.waves)
    speed = s * result.waves["speaker.x"]
    radiated = RHO / (2 * np.pi * SOUND_SPEED) * np.abs(DRIVER["sd"] * s * speed) ** 2
    expected = radiated / (z.real * np.abs(result.waves["speaker.i"]) ** 2)
    np.testing.assert_allclose(result.metrics["efficiency"], expected, rtol=3e-3)


def test_the_electrical_power_is_that_of_all_losses_and_of_the_sound():
    """``Re(u i*) = re |i|^2 + rms |v|^2 + Re(p q*)`` in a vented box."""
    fluid = {"density": RHO, "sound_speed": SOUND_SPEED}
    parts = {
        "ahead": {"part": "radiation", "area": DRIVER["sd"], "fluid": fluid},
        "box": {"part": "cavity", "volume": 20e-3, "fluid": fluid},
        "port": {"part": "vent", "area": 2e-3, "length": 0.1, "losses": False, "fluid": fluid,
                 "end_b": "none", "pins": {"a": "box.a", "b": "mouth.face"}},
        "mouth": {"part": "radiation", "area": 2e-3, "fluid": fluid},
    }  # fmt: skip
    tables = scene({"le": 1e-3}, {"front": "ahead.face", "rear": "box.a"}, parts)
    tables["analysis"] |= {"stop": 90.0}
    w = kc.run(tables).waves
    speed = 2j * np.pi * w["frequency"].real * w["speaker.x"]
    lost = DRIVER["re"] * np.abs(w["speaker.i"]) ** 2 + DRIVER["rms"] * np.abs(speed) ** 2
    for part in ("ahead", "mouth"):
        lost += (w[f"{part}.pressure"] * w[f"{part}.flow"].conj()).real
    np.testing.assert_allclose((w["speaker.v"] * w["speaker.i"].conj()).real, lost, rtol=1e-6)


def test_the_volume_of_the_box_sets_the_resonance():
    """``fc = fs sqrt(1 + vas/vb)`` of a closed box, at which the impedance is largest (Small)."""
    box = {"part": "cavity", "volume": 0.02, "wall_losses": False}
    tables = scene({"le": 1e-9}, {"rear": "box.a"}, {"box": box})
    tables["analysis"] |= {"start": 40.0, "stop": 100.0}
    tables["probes"] = {"least_a": {"of": "speaker.current", "take": "min"}}
    vas = RHO * SOUND_SPEED**2 * DRIVER["sd"] ** 2 * CMS
    volumes = [0.01, 0.02, 0.04]
    table = kc.sweep(tables, {"box.volume": volumes})
    least = 1 / (DRIVER["re"] + DRIVER["bl"] ** 2 / DRIVER["rms"])
    np.testing.assert_allclose(table["least_a"], least, rtol=1e-4)  # between two points
    for volume in volumes:
        tables["box"]["volume"] = volume
        fc = DRIVER["fs"] * np.sqrt(1 + vas / volume)
        tables["analysis"] |= {"start": fc, "stop": 1.01 * fc, "points": 2, "scale": "linear"}
        current = np.abs(kc.run(tables).waves["speaker.i"][0])
        assert current == pytest.approx(least, rel=1e-6)


def test_the_mass_without_air_is_one_of_the_stated_values():
    keys = {name: value for name, value in DRIVER.items() if name != "mms"}
    tables = scene()
    keys |= {"part": "loudspeaker", "mmd": DRIVER["mms"] - 2 * LOAD}
    tables["speaker"] = keys | {"pins": {"plus": "drive.out"}}
    detail = kc.load_scene(tables).records["speaker"].shared_data
    assert detail.mms == pytest.approx(DRIVER["mms"], rel=1e-9)


@pytest.mark.slow
def test_verify_passes_with_all_effects():
    load = {"part": "acoustic_resistor", "resistance": 2e4}
    keys = SEMI | {"creep": 0.1}
    tables = scene(keys, {"front": "load.a"}, {"load": load}, type="transient", stop=0.05)
    tables["drive"] = {"part": "source", "sine": {"amplitude": 2.0, "frequency": 80.0}}
    assert kc.verify(tables)["passed"]


def test_the_coil_heats_the_pin_with_all_losses():
    """Heat of a constant current at rest is ``re i^2``; eddy currents add none."""
    sink = {"part": "thermal_resistor", "resistance": 2.0}
    tables = scene(SEMI | {"temperature_coefficient": 0.0}, {"heat": "sink.a"}, {"sink": sink},
                   type="op")  # fmt: skip
    tables["drive"] = {"part": "source", "kind": "current", "dc": 0.5}
    heat = kc.run(tables).waves["sink.heat"][0]
    assert heat == pytest.approx(DRIVER["re"] * 0.25, rel=1e-6)


def test_noise_is_that_of_the_real_part_of_the_impedance():
    """``4 k T Re Z`` of an open voice coil (H. Nyquist), at 300.15 K."""
    tables = scene(SEMI | {"creep": 0.1})
    tables["analysis"] |= {"type": "noise", "output": "speaker.v"}
    tables["drive"] = {"part": "source", "kind": "current", "ac": 1.0}
    waves = kc.run(tables).waves
    s = 2j * np.pi * waves["frequency"].real
    z = closed_form(s, semi_inductance(s, **SEMI), creeping_suspension(s, 0.1))
    expected = np.sqrt(4 * 1.380649e-23 * 300.15 * z.real)
    np.testing.assert_allclose(np.abs(waves["noise"]), expected, rtol=2e-3)


@pytest.mark.parametrize("dialect", list_dialect_names())
def test_every_dialect_has_all_effects(dialect, tmp_path):
    load = {"part": "acoustic_resistor", "resistance": 2e4}
    tables = scene(SEMI | {"creep": 0.1}, {"front": "load.a"}, {"load": load})
    assert kc.export(tables, tmp_path, dialect=dialect)


@pytest.mark.parametrize(
    ("keys", "pins", "message"),
    [
        ({"leb": 1e-4}, {}, "semi-inductance"),
        ({"rss": 100.0}, {}, "no inductance in parallel"),
        ({"creep": 0.9, "rms": 0.2}, {}, "higher losses at fs"),
        ({"sd": None}, {"front": "load.a"}, "needs the area of its cone"),
        ({"sd": 0.5}, {"front": "load.a"}, "smaller than the mass of the air"),
    ],
)
def test_impossible_combinations_of_keys_are_errors(keys, pins, message):
    parts = {"load": {"part": "acoustic_resistor", "resistance": 1e4}} if pins else {}
    tables = scene({}, pins, parts)
    for name, value in keys.items():
        tables["speaker"].pop(name, None)
        if value is not None:
            tables["speaker"][name] = value
    with pytest.raises(kc.errors.UsageError, match=message):
        kc.load_scene(tables)
