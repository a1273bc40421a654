"""A disc on a moving support, against the theory of thin plates and independent integration."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import i0, i1, j0, j1
from support import load_scene

import kc2spice as kc

MODULUS, POISSON, DENSITY, THICKNESS, RADIUS = 100e9, 0.34, 8400.0, 0.5e-3, 15e-3
METAL = {"density": DENSITY, "youngs_modulus": MODULUS, "poisson_ratio": POISSON, "conductor": True}
SHEAR = MODULUS / (2 * (1 + POISSON))
C12 = 2 * SHEAR * POISSON / (1 - 2 * POISSON)
C11 = C12 + 2 * SHEAR
# a ceramic with the elasticity of the metal, and with so weak a coupling that it changes nothing
CERAMIC = {
    "density": DENSITY,
    "symmetry": "hexagonal",
    "stiffness": {"c11": C11, "c12": C12, "c13": C12, "c33": C11, "c44": SHEAR},
    "stress_coupling": {"e31": -0.1, "e33": 0.1, "e15": 0.1},
    "permittivity": {"eps11": 900, "eps33": 900},
    "permittivity_at": "strain",
}
RIGIDITY = MODULUS * THICKNESS**3 / (12 * (1 - POISSON**2))
SUPPORTS = ("clamped", "simply_supported")


def plate(support, **tables):
    """Return a scene with a disc of uniform thickness; ``tables`` are further or other tables."""
    layers = [
        {"material": metal, "diameter": 2 * RADIUS, "thickness": THICKNESS / 2}
        for metal in (METAL, CERAMIC)
    ]
    return {
        "name": "plate",
        "gravity": 0.0,
        "checks": {"plausible": "off"},
        "disc": {
            "part": "disc",
            "layers": layers,
            "support": support,
            "centre": "0.3 mm",
            "damping": {"ratio": 1e-3},
            "pins": {"anode": "load.a", "base": "shaker.out"},
        },
        "load": {"part": "resistor", "resistance": "1 MOhm"},
        "shaker": {"part": "source", "kind": "acceleration", "ac": "1 m/s2"},
        "analysis": {"type": "ac", "start": "300 Hz", "stop": "1 kHz", "points": 3},
        "probes": {"u": {"of": "disc.u.centre", "take": "max"}},
    } | tables


def make_edge_rows(x, support):
    """Return the edge conditions of J0(k r) and I0(k r) as two rows, for x = k R."""
    if support == "clamped":
        return np.array([[j0(x), i0(x)], [-j1(x), i1(x)]])
    # bending moment: w'' + nu w' / r = 0
    share = (1 - POISSON) / x
    return np.array([[j0(x), i0(x)], [-j0(x) + share * j1(x), i0(x) - share * i1(x)]])


def deflect(frequency, support, radius=0.0):
    """Deflection per base acceleration [s2]: ``D w'''' - rho h omega^2 w = -rho h a``.

    The solution is ``1/omega^2 + A J0(k r) + B I0(k r)`` with ``k^4 = rho h omega^2 / D``.
    """
    omega = 2 * np.pi * frequency
    k = (DENSITY * THICKNESS * omega**2 / RIGIDITY) ** 0.25
    a, b = np.linalg.solve(make_edge_rows(k * RADIUS, support), [-1 / omega**2, 0.0])
    return 1 / omega**2 + a * j0(k * radius) + b * i0(k * radius)


@pytest.mark.parametrize("support", SUPPORTS)
def test_a_disc_on_a_shaker_bends_as_a_thin_plate(support):
    result = kc.run(load_scene(plate(support)))
    frequency, moved = result.waves["frequency"].real, result.waves["disc.u.centre"]
    exact = [deflect(f, support) for f in frequency]
    np.testing.assert_allclose(moved.real, exact, rtol=0.01)
    # above the first resonance, the centre moves in phase with the acceleration of the base
    first = {"clamped": 4.7e3, "simply_supported": 2.3e3}[support]
    band = {"type": "ac", "start": 1.5 * first, "stop": 2 * first, "points": 2}
    high = kc.run(load_scene(plate(support, analysis=band)))
    exact = [deflect(f, support) for f in high.waves["frequency"].real]
    assert min(exact) > 0
    np.testing.assert_allclose(high.waves["disc.u.centre"].real, exact, rtol=0.02)


@pytest.mark.parametrize("support", SUPPORTS)
def test_the_inertia_of_a_uniform_disc_acts_as_a_uniform_pressure(support):
    """Voltage and deflection are those of the pressure ``rho h a`` on the upper face."""
    shaken = kc.run(load_scene(plate(support)))
    scene = plate(support)
    scene["disc"] |= {"pins": {"anode": "load.a", "front_face": "press.out"}}
    pressure = DENSITY * THICKNESS * 1.0
    scene["press"] = {"part": "source", "kind": "pressure", "ac": pressure}
    del scene["shaker"]
    pressed = kc.run(load_scene(scene))
    # the curvatures of a clamped plate cancel over a full electrode, so its voltage is zero
    names = ["disc.u.centre", "disc.voltage"][: 1 + (support == "simply_supported")]
    for name in names:
        np.testing.assert_allclose(shaken.waves[name], pressed.waves[name], rtol=0.01)


def find_modes(count, support="simply_supported"):
    """Return natural frequency [rad/s], participation and shape at the centre of each mode."""
    r = np.linspace(0, RADIUS, 4001)

    def edge(x):
        return float(np.linalg.det(make_edge_rows(x, support)) / i0(x))

    grid = np.linspace(0.5, 3.3 * count + 2, 400)
    values = [edge(x) for x in grid]
    spans = []
    for start, end in pairwise(range(grid.size)):
        if values[start] * values[end] < 0:
            spans.append((grid[start], grid[end]))
    result = []
    for span in spans[:count]:
        x = brentq(edge, *span)
        shape = j0(x * r / RADIUS) - j0(x) / i0(x) * i0(x * r / RADIUS)
        share = np.trapezoid(shape * r, r) / np.trapezoid(shape**2 * r, r)
        omega = (x / RADIUS) ** 2 * np.sqrt(RIGIDITY / (DENSITY * THICKNESS))
        result.append((omega, share, shape[0]))
    return np.array(result).T


def test_a_drop_bends_a_disc_as_the_modes_of_a_thin_plate():
    """A half-sine shock against the modal equations, integrated by scipy."""
    duration, peak, stop, ratio = 0.5e-3, 1000.0, 2e-3, 0.05
    time = np.linspace(0, duration, 61)
    points = [[t, peak * np.sin(np.pi * t / duration)] for t in time]
    points[-1][1] = 0.0
    scene = plate("simply_supported", analysis={"type": "transient", "stop": stop})
    scene["disc"] |= {"damping": {"ratio": ratio}}
    scene["shaker"] = {"part": "source", "kind": "acceleration", "pwl": points}
    result = kc.run(load_scene(scene))
    assert all(check.value <= check.limit for check in result.checks)
    omega, share, centre = find_modes(4)
    beta = 2 * ratio / omega[0]  # damping proportional to the stiffness

    def rates(t, y):
        q, v = np.split(y, 2)
        a = peak * np.sin(np.pi * t / duration) if t < duration else 0.0
        return np.concatenate([v, -share * a - beta * omega**2 * v - omega**2 * q])

    t = np.linspace(0, stop, 400)
    solution = solve_ivp(rates, (0, stop), np.zeros(8), "Radau", t, rtol=1e-8, max_step=1e-5)
    exact = centre @ solution.y[:4]
    found = np.interp(t, result.time, result.waves["disc.u.centre"])
    assert np.abs(found - exact).max() < 0.02 * np.abs(exact).max()


def test_a_mass_on_a_shaken_disc_has_its_own_inertia():
    """``u = Hca a - m Hcc (a - w^2 u)``: the mass at the centre presses with its own inertia."""
    mass = 0.5e-3
    scene = plate(
        "simply_supported", m={"part": "mass", "mass": mass, "pins": {"a": "disc.centre"}}
    )
    scene["analysis"] |= {"start": "20 Hz", "stop": "200 Hz"}
    built = load_scene(scene)
    result = kc.run(built)
    (body,) = kc.build(built).values()
    body = body.select(["centre", "base", "anode"])
    frequency = result.waves["frequency"].real
    w2 = (2 * np.pi * frequency) ** 2
    H = body.transfer(frequency)
    exact = (H[:, 0, 1] - mass * H[:, 0, 0]) / (1 - w2 * mass * H[:, 0, 0])
    np.testing.assert_allclose(result.waves["m.x"], exact, rtol=2e-3)
    total = mass + np.pi * RADIUS**2 * THICKNESS * DENSITY
    np.testing.assert_allclose(np.abs(result.waves["shaker.force"])[0], total, rtol=1e-3)


def test_weight_and_a_constant_acceleration_bend_a_disc_equally():
    """A mass with weight on a disc at rest bends it as an acceleration of g bends it."""
    mass, gravity = 5e-3, 9.80665
    m = {"part": "mass", "mass": mass, "weight": True, "pins": {"a": "disc.centre"}}
    scene = plate("simply_supported", m=m, analysis={"type": "op"}, gravity=gravity)
    scene["probes"] = {"u": {"of": "disc.u.centre", "take": "final"}}
    resting = {**scene, "disc": {**scene["disc"], "pins": {"anode": "load.a"}}}
    del resting["shaker"]
    falling = {**scene, "shaker": {"part": "source", "kind": "acceleration", "dc": -gravity}}
    weight = kc.run(load_scene(resting)).metrics["u"]
    assert weight < 0
    # in free fall, the weight and the inertial force of the mass cancel; the disc bends upwards
    # by the inertia of its own mass
    own = {**falling, "m": {**m, "mass": 1e-9}}
    alone = kc.run(load_scene(own)).metrics["u"]
    exact = gravity * RADIUS**4 * DENSITY * THICKNESS * (5 + POISSON)
    exact /= 64 * RIGIDITY * (1 + POISSON)
    assert alone == pytest.approx(exact, rel=0.01)
    assert kc.run(load_scene(falling)).metrics["u"] == pytest.approx(alone, rel=1e-3)


def test_a_disc_whose_base_is_not_joined_has_the_same_netlist():
    """An explicit connection of the support to ground changes nothing."""
    drive = {"part": "source", "ac": "1 V"}
    scene = plate("simply_supported", drive=drive)
    del scene["shaker"], scene["load"]
    texts = []
    for pins in ({"anode": "drive.out"}, {"anode": "drive.out", "base": "gnd"}):
        (library,) = kc.deck(load_scene({**scene, "disc": {**scene["disc"], "pins": pins}})).parts
        texts.append([line for line in library.text.splitlines() if "hash=" not in line])
    assert texts[0] == texts[1]
    assert not any("unit=m/s2" in line for line in texts[0])
    alone = {name: scene[name] for name in ("name", "gravity", "checks", "disc")}
    alone["disc"] = {**alone["disc"], "pins": {}}
    (library,) = kc.deck(load_scene(alone)).parts
    assert "unit=m/s2" not in library.text


def test_a_large_deflection_of_a_disc_warns():
    """Stretching stiffens a clamped plate by ``0.471 (w/h)^2`` (Timoshenko, table 82)."""
    scene = plate("clamped", analysis={"type": "op"})
    scene["probes"] = {"u": {"of": "disc.u.centre", "take": "final"}}
    for share, stretched in ((0.2, False), (0.22, True)):
        moved = share * THICKNESS
        acceleration = moved * 64 * RIGIDITY / (RADIUS**4 * DENSITY * THICKNESS)
        scene["shaker"] = {"part": "source", "kind": "acceleration", "dc": acceleration}
        result = kc.run(load_scene(scene))
        (check,) = [c for c in result.checks if c.name == "largest deflection of disc"]
        assert check.value == pytest.approx(share, rel=0.01)
        assert (check.value > check.limit) == stretched
    assert "2.3 %" in check.advice
