"""Cavities, vents and tubes in ngspice against closed forms of the sound field."""

import re
import subprocess
import warnings

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import jv
from support import UsageError, load_scene, verify_scenes

import kc2spice as kc

DENSITY, SPEED = 1.204, 343.2  # kg/m3 and m/s, air at 20 C
VISCOSITY, CONDUCTIVITY, HEAT, RATIO = 18.2e-6, 25.9e-3, 1006.0, 1.4
DIFFUSIVITY = CONDUCTIVITY / (DENSITY * HEAT)
FLOW = 1e-9  # m3/s
PLAIN = {"density": DENSITY, "sound_speed": SPEED}  # air without losses


def layers(omega, radius):
    """Zwikker and Kosten: series impedance [Pa s/m4] and shunt admittance [m2/(Pa s)]."""
    area = np.pi * radius**2

    def mean(diffusivity):
        x = radius * np.sqrt(-1j * omega / diffusivity)
        return 1 - 2 * jv(1, x) / (x * jv(0, x))

    series = 1j * omega * DENSITY / (area * mean(VISCOSITY / DENSITY))
    shunt = 1j * omega * area / (DENSITY * SPEED**2) * (RATIO - (RATIO - 1) * mean(DIFFUSIVITY))
    return series, shunt


def line(omega, radius, length, load):
    """Input impedance of a lossy duct with a load at its end (Kinsler et al., section 10.2)."""
    series, shunt = layers(omega, radius)
    gamma, z = np.sqrt(series * shunt), np.sqrt(series / shunt)
    t = np.tanh(gamma * length)
    return z / t if load is None else z * (load + z * t) / (z + load * t)


def driven(start, stop, points=41, **parts):
    """Parts, of which a source of volume velocity drives the pin ``a`` of the first one."""
    first = next(iter(parts))
    parts[first] = {"pins": {}} | parts[first]
    parts[first]["pins"] = {"a": "push.out"} | parts[first]["pins"]
    return {
        "name": "duct", **parts,
        "push": {"part": "source", "kind": "volume_velocity", "ac": FLOW},
        "analysis": {"type": "ac", "start": start, "stop": stop, "points": points},
    }  # fmt: skip


def impedance(scene):
    """Angular frequencies and the impedance at the source."""
    result = kc.run(scene)
    omega = 2 * np.pi * result.waves["frequency"].real
    return omega, result.waves["push.pressure"] / FLOW


@pytest.mark.parametrize("radius", [5e-5, 1e-3, pytest.param(1e-2, marks=pytest.mark.slow)])
@pytest.mark.parametrize("closed", [True, False])
def test_a_tube_is_a_lossy_line(radius, closed):
    """Narrow tubes are those of Crandall, wide ones have thin boundary layers."""
    sections = 24 if radius < 5e-3 else 60  # resonances of wide tubes are narrow
    tube = {"part": "tube", "length": 0.1, "radius": radius, "closed": closed}
    tube["sections"] = sections
    omega, z = impedance(driven(30.0, 2e3, tube=tube))
    exact = line(omega, radius, 0.1, None if closed else 0.0)
    # phase errors are (k l / sections)^2 / 24
    assert np.abs(z / exact - 1).max() < 0.08
    assert np.median(np.abs(z / exact - 1)) < 0.02
    # what dissipates, where no resonance amplifies the error of the phase
    low = omega * 0.1 / SPEED < 0.5
    assert np.abs(z.real / exact.real - 1)[low].max() < 0.05


def test_a_tube_of_the_most_sections_runs_within_seconds():
    """Its thousands of states are too many for the search of resonances, which takes a minute."""
    tube = {"part": "tube", "length": 2.0, "radius": 1e-3, "closed": True, "sections": 400}
    omega, z = impedance(driven(100.0, 2e3, points=5, tube=tube))
    np.testing.assert_allclose(z, line(omega, 1e-3, 2.0, None), rtol=0.05)


def test_a_narrow_tube_has_the_resistance_of_poiseuille():
    tube = {"part": "tube", "length": 0.01, "radius": 1e-4, "sections": 30, "pins": {"b": "gnd"}}
    omega, z = impedance(driven(1.0, 10.0, points=3, tube=tube))
    np.testing.assert_allclose(z.real, 8 * VISCOSITY * 0.01 / (np.pi * 1e-16), rtol=1e-4)
    # the reactance: 4/3 of the mass of a uniform profile, less the effect of the compliance
    np.testing.assert_allclose(z.imag, line(omega, 1e-4, 0.01, 0.0).imag, rtol=1e-3)


def test_an_organ_pipe_sounds_at_its_length_with_both_end_corrections():
    pipe = {"part": "tube", "length": 0.5, "radius": 0.01, "fluid": PLAIN, "end_a": "unflanged",
            "end_b": "flanged", "sections": 100, "pins": {"b": "gnd"}}  # fmt: skip
    scene = driven(100.0, 1200.0, points=2001, pipe=pipe)
    omega, z = impedance(scene)
    effective = 0.5 + (0.6127 + 0.8216) * 0.01
    size = np.abs(z)
    low = np.flatnonzero((size[1:-1] < size[:-2]) & (size[1:-1] < size[2:])) + 1
    exact = SPEED / (2 * effective) * np.arange(1, low.size + 1)
    # an open end is short of its correction: tan(k e) instead of k e, 1e-4 here
    np.testing.assert_allclose(omega[low] / (2 * np.pi), exact, rtol=1e-3)
    assert low.size == 3


def test_a_housing_resonates_as_that_of_helmholtz():
    """Kinsler et al., eq. 10.8.8: omega = c sqrt(S / (L' V)), both ends with a flange."""
    vent = {"part": "vent", "length": 2e-3, "radius": 1e-3, "fluid": PLAIN,
            "pins": {"a": "housing.a"}}  # fmt: skip
    housing = {"part": "cavity", "volume": 1e-6, "fluid": PLAIN}
    omega, z = impedance(driven(1500.0, 1700.0, points=2001, housing=housing, vent=vent))
    area = np.pi * 1e-6
    outside = 1j * omega * DENSITY * 0.8216e-3 / area
    wave, angle = DENSITY * SPEED / area, 1j * np.tan(omega * 2e-3 / SPEED)
    through = outside + wave * (outside + wave * angle) / (wave + outside * angle)
    exact = 1 / (1j * omega * 1e-6 / (DENSITY * SPEED**2) + 1 / through)
    found = omega[np.abs(z).argmax()]
    assert found == pytest.approx(omega[np.abs(exact).argmax()], rel=3e-4)
    # the formula of the lumped resonator, which neglects the compliance of the vent
    lumped = SPEED * np.sqrt(area / ((2e-3 + 2 * 0.8216e-3) * 1e-6))
    assert found == pytest.approx(lumped, rel=3e-3)


def test_the_loss_of_a_vent_is_that_of_its_boundary_layers():
    """Q of a Helmholtz resonator with thin layers, by a closed form of both losses."""
    vent = {"part": "vent", "length": 0.02, "radius": 5e-3, "end_a": "none", "end_b": "none",
            "pins": {"a": "housing.a"}}  # fmt: skip
    housing = {"part": "cavity", "volume": 1e-3}
    omega, z = impedance(driven(60.0, 200.0, points=3001, housing=housing, vent=vent))
    series, shunt = layers(omega, 5e-3)
    depth = 1e-3 / (6 * 1e-2)  # ratio of volume to surface of a cube
    zeta = depth * np.sqrt(1j * omega / DIFFUSIVITY)
    walls = 1e-3 / (DENSITY * SPEED**2) * (1 + (RATIO - 1) * np.tanh(zeta) / zeta)
    exact = 1 / (1j * omega * walls + shunt * 0.01 + 1 / (series * 0.02))
    np.testing.assert_allclose(z, exact, rtol=0.02)
    assert np.abs(z).max() == pytest.approx(np.abs(exact).max(), rel=5e-3)


def test_a_closed_cavity_is_adiabatic_fast_and_isothermal_slow():
    cavity = {"part": "cavity", "volume": 1e-6}
    for start, stop, ratio in ((1e-4, 1e-3, 1.4), (2e3, 3e3, 1.0)):
        omega, z = impedance(driven(start, stop, points=3, cavity=cavity))
        compliance = -1 / (omega * z.imag)
        exact = ratio * 1e-6 / (DENSITY * SPEED**2)
        np.testing.assert_allclose(compliance, exact, rtol=0.01)


def piston(omega):
    """VM282: a piston on a spring drives a closed column of fluid, its equation of frequencies."""
    area, length, density, speed = np.pi * 0.125**2, 24.0, 1000.0, 1000.0
    stiffness = density * speed**2 * area / length
    mass = density * area * length / 2
    column = density * speed * area * omega / np.tan(omega * length / speed)
    return stiffness - mass * omega**2 + column


def test_the_published_piston_on_a_column_of_fluid_has_the_published_frequencies():
    published = [9.916, 24.583, 43.729, 63.895, 84.395]
    for frequency in published:
        near = 2 * np.pi * frequency
        assert brentq(piston, 0.99 * near, 1.01 * near) == pytest.approx(near, rel=1.3e-3)


@pytest.mark.parametrize("analysis", ["ac", "transient"])
def test_laws_and_netlists_agree(analysis, tmp_path):
    scene = driven(100.0, 3e3, housing={"part": "cavity", "volume": 1e-6, "leak": 1e9},
                   vent={"part": "vent", "length": 2e-3, "radius": 1e-3, "end_b": "none",
                         "pins": {"a": "housing.a", "b": "tube.a"}},
                   tube={"part": "tube", "length": 0.02, "radius": 2e-3, "sections": 3,
                         "pins": {"b": "mouth.face"}},
                   mouth={"part": "radiation", "radius": 2e-3, "shape": "free_piston"},
                   ear={"part": "listener"})  # fmt: skip
    if analysis == "transient":
        wave = {"amplitude": FLOW, "frequency": "1 kHz"}
        scene["push"] = {"part": "source", "kind": "volume_velocity", "sine": wave}
        scene["analysis"] = {"type": "transient"}
        scene["solver"] = {"stop": "1 ms", "reltol": 1e-5}
    scene["probes"] = {"level_db": {"of": "ear.pressure", "take": "spl"},
                       "out_m3_s": {"of": "tube.flow_b"}}  # fmt: skip
    report = verify_scenes([load_scene(scene)], tmp_path)["scenes"]["duct"]
    assert report["passed"], [check for check in report["checks"] if not check["passed"]]
    start = "energy balance of the ref"
    balance = [c["value"] for c in report["checks"] if c["name"].startswith(start)]
    assert len(balance) == (analysis == "transient")
    assert all(value < 1e-8 for value in balance)  # what enters is stored, radiated or lost


def test_a_sealed_box_has_an_operating_point(tmp_path):
    scene = driven(100.0, 1e3, box={"part": "cavity", "volume": 1e-5})
    assert verify_scenes([load_scene(scene)], tmp_path)["scenes"]["duct"]["passed"]


FAULTS = [
    ({"part": "cavity", "volume": -1.0}, "out of range"),
    ({"part": "cavity", "volume": 1e-6, "surface": 4.8e-4}, "smaller than the surface of a sphere"),
    ({"part": "vent", "length": 0.01, "radius": 1e-3, "area": 1e-6}, "two sizes"),
    ({"part": "vent", "length": 0.01}, "no size"),
    ({"part": "tube", "length": 0.0, "radius": 1e-3}, "out of range"),
    ({"part": "tube", "length": 1.0, "radius": 0.01, "closed": True, "end_b": "flanged"},
     "a closed end cannot have an end correction"),
]  # fmt: skip


@pytest.mark.parametrize(("part", "words"), FAULTS)
def test_impossible_ducts_are_refused(part, words):
    with pytest.raises(UsageError, match=words):
        load_scene(driven(100.0, 1e3, duct=part))


@pytest.mark.parametrize("kind", ["cavity", "vent", "tube", "radiation"])
def test_an_open_acoustic_pin_is_refused(kind):
    sizes = {"cavity": {"volume": 1e-6}, "radiation": {"radius": 1e-3}}
    keys = sizes.get(kind, {"length": 1e-2, "radius": 1e-3})
    with pytest.raises(UsageError, match="not connected"):
        load_scene({"name": "open", "duct": {"part": kind} | keys, "push": {"part": "source"}})


WARNINGS = [
    ({"duct": {"part": "cavity", "volume": 1e-3}}, r"above 343\.2 Hz the cavity of 100 mm"),
    ({"duct": {"part": "tube", "length": 0.1, "radius": 0.05}}, "higher-order modes propagate"),
    ({"duct": {"part": "vent", "length": 0.01, "radius": 1e-3, "pins": {"b": "mouth.face"}},
      "mouth": {"part": "radiation", "radius": 1e-3}}, 'outside of end b is counted twice'),
    ({"duct": {"part": "tube", "length": 20.0, "radius": 1e-3}}, "needs 4371 sections"),
]  # fmt: skip


@pytest.mark.parametrize(("parts", "words"), WARNINGS)
def test_ducts_beyond_their_models_warn_before_the_simulation(parts, words):
    with pytest.warns(UserWarning, match=words):
        load_scene(driven(100.0, 2.5e3, **parts))


def test_ducts_within_their_models_do_not_warn():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_scene(driven(100.0, 2.5e3, duct={"part": "cavity", "volume": 1e-6}))


def whole():
    """A scene with every acoustic part."""
    return driven(
        100.0, 3e3, points=5,
        housing={"part": "cavity", "volume": 1e-6},
        vent={"part": "vent", "length": 2e-3, "radius": 1e-3, "end_b": "none",
              "pins": {"a": "housing.a", "b": "tube.a"}},
        tube={"part": "tube", "length": 0.02, "radius": 2e-3, "sections": 2,
              "pins": {"b": "mouth.face"}},
        mouth={"part": "radiation", "radius": 2e-3},
        ear={"part": "listener"},
    )  # fmt: skip


@pytest.mark.parametrize("dialect", ["ngspice", "ltspice", "xyce", "verilog-a"])
def test_every_dialect_has_the_acoustic_parts(dialect, tmp_path):
    names = {path.name for path in kc.export(whole(), tmp_path, dialect=dialect)}
    suffix = "va" if dialect == "verilog-a" else "lib"
    parts = ("cavity", "vent", "tube", "radiation", "listener")
    assert {f"{part}.{suffix}" for part in parts} <= names


def test_a_library_alone_has_the_pressure_of_the_scene(tmp_path):
    """The pin ``out`` of a listener in a deck without kc2spice, in Pa."""
    scene = whole()
    kc.export(scene, tmp_path)
    deck = tmp_path / "alone.cir"
    libraries = "\n".join(f".include {name}.lib" for name in ("radiation", "listener"))
    deck.write_text(f"""alone
{libraries}
I1 0 face DC 0 AC 1
X1 face 0 sound radiation
X2 sound out 0 listener distance=0.5
.ac lin 3 1k 2k
.print ac vm(out)
.end
""")
    log = subprocess.run(["ngspice", "-b", deck.name], cwd=tmp_path, capture_output=True, text=True)
    values = re.findall(r"(?m)^\d+\s+(\S+e\S+)\s+(\S+e\S+)\s*$", log.stdout)
    for frequency, pressure in values:
        exact = float(frequency) * DENSITY * 1e-6 / 0.5
        assert float(pressure) == pytest.approx(exact, rel=1e-4)
    assert len(values) == 3


def test_a_sweep_of_the_hole_moves_the_resonance():
    scene = driven(500.0, 3.3e3, points=201, housing={"part": "cavity", "volume": 1e-6},
                   hole={"part": "vent", "length": 2e-3, "radius": 1e-3,
                         "pins": {"a": "housing.a"}})  # fmt: skip
    scene["probes"] = {"tone_hz": {"of": "housing.pressure", "take": "argmax"}}
    table = kc.sweep(scene, {"hole.radius": ["0.5 mm", "1 mm"]}, workers=1)
    tones = table["tone_hz"]
    ratio = np.sqrt((4 / (2e-3 + 1.6432e-3)) / (1 / (2e-3 + 0.8216e-3)))
    assert tones[1] / tones[0] == pytest.approx(
        ratio, rel=0.05
    )  # more viscous mass in the small hole


BOUNDARY = [
    {"part": "vent", "length": 1e-9, "radius": 1e-9},
    {"part": "vent", "length": 1e4, "radius": 1e4},
    {"part": "tube", "length": 1e4, "radius": 1e-9, "sections": 2},
    {"part": "cavity", "volume": 1e-18},
    {"part": "cavity", "volume": 1e11, "leak": 1e-6},
]


@pytest.mark.parametrize("part", BOUNDARY)
@pytest.mark.parametrize("stop", [1e-2, 1e9])
def test_the_smallest_and_the_largest_ducts_run(part, stop):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _, z = impedance(driven(stop / 1e4, stop, points=3, duct=part))
    assert np.isfinite(z).all()
    assert (z.real >= -1e-9 * np.abs(z)).all()


BEYOND = [
    {"part": "vent", "length": 1e300, "radius": 1.0},
    {"part": "cavity", "volume": 1e-300},
    {"part": "radiation", "radius": 1e-300},
    {"part": "vent", "length": 1.0, "radius": 1.0, "fluid": PLAIN | {"viscosity": 1e-300}},
]


@pytest.mark.parametrize("part", BEYOND)
def test_impossible_sizes_and_constants_are_refused(part):
    scene = driven(100.0, 1e3, duct=part)
    if part["part"] == "radiation":
        scene["duct"]["pins"] = {"face": "push.out"}
    with pytest.raises(UsageError, match=r"out of range|at least 1e-09"):
        load_scene(scene)
