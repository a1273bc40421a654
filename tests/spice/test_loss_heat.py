"""Heat of bodies, resonators and contacts, against the energy that enters and is not stored."""

import json

import numpy as np
import pytest
from scipy.integrate import trapezoid
from support import StageTimer, UsageError, load_scene, prepare_deck

import kc2spice as kc

SINK = {
    "mass": {"part": "thermal_capacitor", "capacity": "1e-3 J/K", "pins": {"b": "gnd"}},
    "path": {
        "part": "thermal_resistor",
        "resistance": "50 K/W",
        "pins": {"a": "mass.a", "b": "gnd"},
    },
}
STRIP = {"material": "PZT-5A", "thickness": "0.2 mm"}
# part and frequency [Hz] of its drive; the first two settle within 30 periods
DRIVEN = {
    "disc": (
        {
            "part": "disc",
            "layers": [
                {"material": "brass", "diameter": "27 mm", "thickness": "0.2 mm"},
                {"material": "PZT-5A", "diameter": "20 mm", "thickness": "0.2 mm"},
            ],
            "support": "simply_supported",
            "damping": {"quality": 1, "loss_tangent": 0.02},
            "rom": {"band": [3e3, 30e3], "tolerance": 1e-3},
        },
        10e3,
    ),
    "bvd": (
        {
            "part": "bvd",
            "fs": ["40 kHz", "90 kHz"],
            "cm": ["1 nF", "0.2 nF"],
            "rm": ["2 kOhm", "5 kOhm"],
            "c0": "2 nF",
        },
        40e3,
    ),
    "crystal": (
        {"part": "crystal", "f": "32.768 kHz", "r1": "35 kOhm", "c1": "3 fF", "c0": "1 pF"},
        32768.0,
    ),
    "bimorph": (
        {
            "part": "bimorph",
            "length": "20 mm",
            "width": "3 mm",
            "layers": [STRIP, STRIP],
            "wiring": "series",
            "damping": {"quality": 1500},
            "rom": {"tolerance": 1e-3},
        },
        500.0,
    ),
    "langevin": (
        {
            "part": "langevin",
            "front": [{"material": "aluminium", "diameter": "20 mm", "length": "30 mm"}],
            "back": [{"material": "steel", "diameter": "20 mm", "length": "20 mm"}],
            "rings": {
                "material": "PZT-8",
                "outer": "20 mm",
                "inner": "8 mm",
                "thickness": "3 mm",
            },
            "bolt": {"material": "steel", "diameter": "6 mm"},
            "damping": {"quality": 50},
        },
        30e3,
    ),
    "piezo_stack": ({"part": "piezo_stack", "electrical": "driven"}, 100e3),
}


def driven(kind, periods=10, *, heat=True, **solver):
    """A part at a sine of 100 V behind 10 Ohm, whose heat flows into ``mass.a``."""
    part, frequency = json.loads(json.dumps(DRIVEN[kind]))
    pins = {"a" if kind == "crystal" else "anode": "lead.b"} | ({"heat": "mass.a"} if heat else {})
    settings = {"stop": periods / frequency, "reltol": 1e-4, "max_step": 1 / frequency / 400}
    return {
        "name": "warm",
        "gravity": 0.0,
        **SINK,
        "part": part | {"pins": pins},
        "lead": {"part": "resistor", "resistance": "10 Ohm", "pins": {"a": "drive.out"}},
        "drive": {"part": "source", "sine": {"amplitude": "100 V", "frequency": frequency}},
        "solver": settings | solver,
    }, frequency


def mean_powers(result, frequency):
    """Mean electrical power and mean heat flow [W] over the last of equal time steps."""
    t, waves = result.time, result.waves
    steps = round(1 / frequency / np.diff(t)[-3])
    period = slice(t.size - 3 - steps, t.size - 3)
    assert np.ptp(np.diff(t)[period]) < 1e-9 / frequency
    power = waves["part.voltage"] * waves["part.current"]
    return power[period].mean(), -waves["part.heat"][period].mean()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["disc", "bvd"])
def test_a_settled_part_gives_off_the_power_that_enters(kind):
    scene, frequency = driven(kind, 40, reltol=1e-5)
    power, heat = mean_powers(kc.run(scene), frequency)
    assert heat > 1e-3
    assert heat == pytest.approx(power, rel=1e-6)


def test_the_heat_of_a_resonator_is_the_real_part_of_its_admittance():
    scene, f = driven("bvd", 40, reltol=1e-5)
    result = kc.run(scene)
    _, heat = mean_powers(result, f)
    s, Y = 2j * np.pi * f, 2j * np.pi * f * 2e-9
    for fs, cm, rm in ((40e3, 1e-9, 2e3), (90e3, 0.2e-9, 5e3)):
        lm = 1 / ((2 * np.pi * fs) ** 2 * cm)
        Y += s * cm / (1 + s * rm * cm + s**2 * lm * cm)
    amplitude = abs(100 / (1 + 10 * Y))
    assert heat == pytest.approx(amplitude**2 * Y.real / 2, rel=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["bimorph", "langevin", "piezo_stack", "bvd", "crystal"])
def test_heat_is_the_work_less_the_stored_energy(kind):
    scene, _ = driven(kind, reltol=1e-6)
    build, _ = prepare_deck(load_scene(scene), StageTimer())
    result = kc.run(scene)
    waves, t = result.waves, result.time
    work = trapezoid(waves["part.voltage"] * waves["part.current"], t)
    heat = -trapezoid(waves["part.heat"], t)
    law = build.scene.parts["part"].type.law(build.scene.parts["part"], build).laws[0].model
    # exact states of the modes under the recorded voltage, by their decoupled equations
    wave = waves["part.voltage"]
    stored = law.D[0, 0] * wave[-1] ** 2 / 2
    mass, damping, stiffness = (np.diag(m) for m in (law.M, law.E, law.K))
    for m, d, k, gain in zip(mass, damping, stiffness, law.B[:, 0], strict=True):
        stored += stored_in_mode(t, gain * wave, m, d, k)
    scale = np.abs(work) + np.abs(stored)
    assert heat > 0
    assert work - heat == pytest.approx(stored, abs=1e-3 * scale)


def stored_in_mode(t, force, m, d, k):
    """Energy of ``m z'' + d z' + k z = force`` at the end, from rest; ``force`` is linear in t."""
    if m == 0.0 or d * d >= 4 * m * k:
        return stored_in_overdamped_mode(t, force, m, d, k)
    root = (-d + 1j * np.sqrt(4 * m * k - d * d)) / (2 * m)
    x = march(t, force, root)
    z = (x / (root - root.conjugate())).real * 2 / m
    v = (root * x / (root - root.conjugate())).real * 2 / m
    return k * z**2 / 2 + m * v**2 / 2


def stored_in_overdamped_mode(t, force, m, d, k):
    """Return the same of a mode that does not ring."""
    if d == 0.0:
        return force[-1] ** 2 / (2 * k)
    if m == 0.0:
        z = march(t, force / d, complex(-k / d)).real
        return k * z**2 / 2
    a, b = np.roots([m, d, k])
    x, y = march(t, force / m, complex(a)).real, march(t, force / m, complex(b)).real
    z, v = (x - y) / (a - b), (a * x - b * y) / (a - b)
    return k * z**2 / 2 + m * v**2 / 2


def march(t, force, root):
    """``x' = root x + force`` from zero, exact for a force that is linear between the times."""
    h = np.diff(t)
    s = root * h
    grow = np.exp(s)
    small = np.abs(s) < 1e-4
    safe = np.where(small, 1.0, s)
    p1 = np.where(small, 1 + s / 2, (grow - 1) / safe)
    p2 = np.where(small, 0.5 + s / 6, (p1 - 1) / safe)
    push = h * (p1 * force[:-1] + p2 * np.diff(force))
    x = 0.0
    for g, p in zip(grow, push, strict=True):
        x = g * x + p
    return x


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["disc", "bvd", "bimorph", "langevin", "piezo_stack"])
def test_heat_agrees_with_the_laws_of_the_part(kind):
    scene, _ = driven(kind)
    verdict = kc.verify(scene)
    assert verdict["passed"], [c for c in verdict["checks"] if not c["passed"]]


BALL = {"part": "sphere", "velocity": -1.0, "height": 1e-6}
MASS = 4 / 3 * np.pi * 1e-9 * 7850.0  # kg


@pytest.mark.parametrize(
    ("law", "keys"), [("linear", {"penalty": 1e7}), ("hertz", {"modulus": 100e9})]
)
def test_a_contact_gives_off_the_energy_lost_in_a_rebound(law, keys):
    floor = {"part": "contact", "a": "gnd", "law": law, "damping": 0.1, **keys}
    scene = {
        "name": "bounce",
        "gravity": 0.0,
        **SINK,
        "floor": floor | {"pins": {"heat": "mass.a"}},
        "ball": BALL,
        "solver": {"stop": 20e-6, "max_step": 1e-6, "reltol": 1e-4},
    }
    result = kc.run(scene)
    v = result.waves["ball.v"]
    assert v[-1] > 0.5
    heat = -trapezoid(result.waves["floor.heat"], result.time)
    assert heat == pytest.approx(MASS * (v[0] ** 2 - v[-1] ** 2) / 2, rel=1e-3)
    assert kc.verify(scene)["passed"]


def test_friction_gives_off_its_work():
    scene = {
        "name": "block",
        "gravity": 9.81,
        **SINK,
        "weight": {"part": "mass", "mass": 10e-3, "weight": True},
        "block": {"part": "mass", "mass": 10e-3, "pins": {"a": "push.out"}},
        "push": {
            "part": "source",
            "kind": "force",
            "pulse": {"high": 0.1, "width": 5e-3, "edge": 1e-6},
        },
        "floor": {
            "part": "contact",
            "a": "gnd",
            "b": "weight",
            "penalty": 1e5,
            "friction": 0.3,
            "pins": {"slide": "block.a", "heat": "mass.a"},
        },
        "solver": {"stop": 8e-3, "max_step": 20e-6},
    }
    result = kc.run(scene)
    heat = -trapezoid(result.waves["floor.heat"], result.time)
    way = result.waves["block.x"][-1] - result.waves["block.x"][0]
    assert heat == pytest.approx(0.3 * 10e-3 * 9.81 * way, rel=1e-3)


def test_without_the_pin_a_netlist_has_no_heat():
    for kind in ("disc", "bvd"):
        scene, _ = driven(kind, heat=False)
        text = "".join(kc.deck(scene).files.values())
        assert "Bheat" not in text
        assert "@pin 4 heat" not in text


def test_a_deck_neglects_differences_of_temperature_instead_of_heating():
    for heat, words in ((True, "part: temperature differences"), (False, "heating by its own")):
        scene, _ = driven("disc", heat=heat)
        text = " ".join(kc.deck(scene).files["warm.cir"].replace("\n*", "").split())
        assert words in text


def test_losses_of_coupled_states_have_no_pin_of_heat(tmp_path):
    E = np.array([[1.0, -0.5], [-0.5, 2.0]])
    port = kc.Port("tip", "mechanical")
    model = kc.LinearModel(
        M=np.eye(2), E=E, K=np.diag([1e4, 4e4]), B=np.array([[1.0], [0.5]]), ports=(port,)
    )
    assert "damping" in kc.subcircuit(model, "part").text
    with pytest.raises(UsageError, match="cannot have a heat pin"):
        kc.subcircuit(model, "part", heat=True)


def test_ranges_of_keys_have_no_pin_of_heat():
    scene, _ = driven("bimorph")
    scene["part"]["rom"] = {"parameters": {"length": ["19 mm", "21 mm"]}}
    with pytest.raises(UsageError, match="a netlist with parameters cannot have a heat pin"):
        kc.deck(scene)


@pytest.mark.parametrize(
    "keys", [{"law": "linear", "penalty": 1e7}, {"law": "hertz", "modulus": 100e9}]
)
def test_a_contact_without_losses_has_no_pin_of_heat(keys):
    floor = {"part": "contact", "a": "gnd", "pins": {"heat": "mass.a"}, **keys}
    scene = {"name": "bounce", "gravity": 0.0, **SINK, "floor": floor, "ball": BALL}
    with pytest.raises(UsageError, match="no such pin"):
        kc.deck(scene | {"solver": {"stop": 20e-6}})
