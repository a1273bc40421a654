"""A magnet that moves along coils: its field as that of charges on its faces, not of currents."""

from pathlib import Path

import numpy as np
import pytest
from closed_forms import MU_0, circles
from scipy.integrate import quad, solve_ivp
from scipy.special import j1
from support import UsageError, Winding, compute_demagnetising_factor, make_current_loop

import kc2spice as kc

COIL = Winding(1.75e-3, 0.46e-3, 1.5e-3, 2.72e-3, 280.0)
RADIUS, TALL, BR = 1.5e-3, 1.6e-3, 1.02
SCENE = str(Path(__file__).parents[2] / "docs" / "published" / "magnet_over_coil.toml")
FIXED = {"outer": 1e-3, "inner": 0.0, "height": 1e-3, "y": 0.0, "remanence": 1.0}
SHEET = Winding(RADIUS, 0.0, TALL, TALL / 2, BR * TALL / MU_0)


def through_disc(radius: float, loop: float, apart: float) -> float:
    """Flux through a disc per ampere of a coaxial circle: Hankel's integral, no elliptic one."""

    def share(x):
        return j1(x) * j1(x * loop / radius) * np.exp(-x * abs(apart) / radius)

    return MU_0 * np.pi * loop * quad(share, 0, 60 * radius / abs(apart), limit=500)[0]


def pull(y: float) -> float:
    """Force [N] per ampere: charges ``BR / MU_0`` on both faces in the coil's field."""
    (x, p), (s, q) = np.polynomial.legendre.leggauss(4), np.polynomial.legendre.leggauss(12)
    at, heights = COIL.radius + COIL.width / 2 * x, COIL.y + COIL.height / 2 * s
    total = 0.0
    for face, sign in ((y + TALL, 1.0), (y, -1.0)):
        flux = [[through_disc(RADIUS, r, z - face) for z in heights] for r in at]
        total += sign * COIL.turns * (p / 2) @ np.array(flux) @ (q / 2)
    return BR / MU_0 * total


def forces(low: float, high: float, *heights: float) -> np.ndarray:
    """Force [N] per ampere from the slopes of the power series."""
    found = make_current_loop([SHEET], [COIL], [], low, high, 1e-7)
    series = np.polynomial.Polynomial(found.couplings[0, 0]).deriv()
    place = (2 * np.array(heights) - low - high) / (high - low)
    return 2 / (high - low) * series(place)


def test_a_coil_pulls_at_the_charges_of_both_faces():
    y = (-1.2e-3, -0.5e-3, 0.0, 0.15e-3)
    np.testing.assert_allclose(forces(-1.5e-3, 0.2e-3, *y), [pull(v) for v in y], rtol=1e-6)


def test_far_away_it_is_a_dipole_on_the_axis():
    """``F = m dB/dz``; both sizes squared over the distance squared are left."""
    y, moment = -50e-3, BR / MU_0 * np.pi * RADIUS**2 * TALL
    z = COIL.y - y - TALL / 2
    square = COIL.radius**2 + COIL.width**2 / 12
    slope = 1.5 * MU_0 * COIL.turns * square * z / (square + z**2) ** 2.5
    assert forces(-60e-3, -40e-3, y)[0] == pytest.approx(moment * slope, rel=1e-3)


def test_a_magnet_has_the_demagnetising_factor_of_its_shape():
    """Mean field of charged discs; 0.3116 of a cylinder as tall as wide (D.-X. Chen, J. A. Brug, R.
    B. Goldfarb, IEEE Trans. Magn. 27 (1991) 3601)."""

    def of_charges(tall: float) -> float:
        def share(x):
            return (1 - np.exp(-x * tall)) * (j1(x) / x) ** 2

        return 2 / tall * sum(quad(share, a, a + 10, limit=200)[0] for a in range(0, 400, 10))

    assert compute_demagnetising_factor(0.0, 1.0, 2.0) == pytest.approx(0.3116, abs=1e-4)
    for tall in (0.5, 1.07, 8.0):
        assert compute_demagnetising_factor(0.0, 1.0, tall) == pytest.approx(
            of_charges(tall), abs=1e-5
        )
    whole, inner = (
        compute_demagnetising_factor(0.0, 1.0, 1.0),
        compute_demagnetising_factor(0.5, 1.0, 1.0),
    )
    assert 0.0 < inner < whole  # its hole brings its faces' ends closer to its middle


def test_a_magnet_over_a_loaded_coil_is_braked_as_by_its_law():
    """On a spring over a coil of one wire that a resistor closes, and a fixed magnet below: scipy
    on its law with circles integrated along both magnets."""
    ohm, mass, k, start, fixed = 2.0, 0.2e-3, 300.0, 0.5e-3, (-10e-3, 3e-3, 1.2)
    wire = {"radius": 2.5e-3, "width": 1e-4, "height": 1e-4, "y": -2.5e-3, "turns": 200,
            "resistance": ohm / 2}  # fmt: skip
    scene = {
        "name": "braked",
        "magnet": {"part": "moving_magnet", "radius": RADIUS, "thickness": TALL, "remanence": BR,
                   "y_min": -2e-3, "y_max": 2e-3, "coils": {"c": wire},
                   "magnets": {"m": {"outer": 2e-3, "inner": 0.0, "height": fixed[1],
                                     "y": fixed[0], "remanence": fixed[2]}},
                   "pins": {"a": "body.a", "c_p": "load.a"}},
        "load": {"part": "resistor", "resistance": ohm / 2},
        "body": {"part": "mass", "mass": mass, "position": start},
        "spring": {"part": "spring", "stiffness": k, "pins": {"a": "body.a"}},
        "solver": {"reltol": 1e-6, "max_step": 1e-5, "stop": 20e-3},
    }  # fmt: skip
    waves = kc.run(scene).waves

    x, p = np.polynomial.legendre.leggauss(24)
    s = TALL / 2 * x

    def flux(y):
        return 200 * BR * TALL / MU_0 * (p / 2) @ circles(2.5e-3, RADIUS, y + s + 2.5e-3)

    def apart(y):
        z = y + s[:, None] - fixed[0] - fixed[1] / 2 * x
        both = (p / 2) @ circles(RADIUS, 2e-3, z) @ (p / 2)
        return BR * TALL * fixed[2] * fixed[1] / MU_0**2 * both

    def slope(f, y):
        return (f(y + 1e-6) - f(y - 1e-6)) / 2e-6

    own = 200**2 * MU_0 * 2.5e-3 * (np.log(8 * 2.5e-3 / (0.2235 * 2e-4)) - 2)

    def rates(t, u):
        y, v, total = u
        i = (total - flux(y)) / own
        force = i * slope(flux, y) + slope(apart, y)
        return [v, (force - k * y) / mass, -ohm * i]

    exact = solve_ivp(rates, (0, 20e-3), [start, 0, flux(start)], rtol=1e-8, atol=1e-12,
                      t_eval=waves["time"], max_step=1e-4).y[0]  # fmt: skip
    assert np.ptp(exact[-50:]) < np.ptp(exact[:200])  # it is braked
    assert np.abs(waves["magnet.y"] - exact).max() < 2e-3 * np.ptp(exact)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"magnet.y_max": "1 mm"}, "no polynomial represents the magnetic coupling"),
        (
            {"magnet.y_max": "1 mm", "magnet.radius": "1.6 mm"},
            "coils.coil: the body touches the win",
        ),
        ({"magnet.magnets.m": FIXED}, "the body touches the magnet"),
    ],
)
def test_a_range_that_meets_a_coil_or_a_magnet_is_refused_by_key(given, words, tmp_path):
    with pytest.raises(UsageError, match=words):
        kc.run(SCENE, tmp_path, overrides=given)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["moving_magnet", "moving_conductor"])
def test_the_height_of_a_body_is_that_of_its_centre_of_mass(kind):
    """Two equal coils as far above as below its middle do not push a conductor there, and push a
    magnet as much above it as below."""
    coil = {"radius": 8e-3, "width": 1e-3, "height": 1e-3, "turns": 100, "resistance": 1.0}
    own = {"remanence": 1.0} if kind == "moving_magnet" else {"conductivity": 3e7, "rings": 40}
    scene = {
        "name": "between",
        "body": {"part": kind, "radius": 4e-3, "thickness": 5e-3, "y_min": -1e-3, "y_max": 1e-3,
                 "coils": {"low": coil | {"y": -6e-3}, "high": coil | {"y": 6e-3}}, **own,
                 "pins": {"low_p": "drive.out", "low_n": "body.high_p", "a": "holder.out"}},
        "holder": {"part": "source", "kind": "displacement", "dc": 0.0},
        "drive": {"part": "source", "kind": "current", "sine": {"frequency": 1e3}},
        "solver": {"stop": 2e-3, "max_step": 1e-5},
    }  # fmt: skip

    def force(y):
        holder = scene["holder"] | {"dc": y}
        return np.abs(kc.run(scene | {"holder": holder}).waves["body.force"]).max()

    above, below = force(0.8e-3), force(-0.8e-3)
    assert above == pytest.approx(below, rel=1e-5)
    assert force(0.0) < 1e-6 * above
