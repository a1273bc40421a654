"""Catch actuator against closed forms: mu_r = 1, and an air cylinder too large to matter.

The ring is then two current sheets, the sphere a point dipole and the coils are thick solenoids.
None of these formulas shares code with the finite elements.
"""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0, j1, struve
from support import CatchKeys, MagnetostaticTable, RingKeys, compute_magnetostatic_table

MU0 = 4e-7 * np.pi
# Ten times the default air cylinder: truncation falls with its cube, to 3e-5 of max|F0|.
RADIUS = 1e-3
FREE = CatchKeys(mu_r=1.0, air_radius=0.1, air_height=0.3, positions=13)


def dipole_moment(catch: CatchKeys, radius: float = RADIUS) -> float:
    """Moment [A m^2] of a sphere of remanence B_r: V M with M = 3 B_r / (mu0 (mu_r + 2))."""
    volume = 4 / 3 * np.pi * radius**3
    return volume * 3 * catch.remanence / (MU0 * (catch.mu_r + 2))


def coil_field(coil: RingKeys, turns: int, y: np.ndarray) -> np.ndarray:
    """Axial field [T] of 1 A in a thick solenoid."""
    density = turns / ((coil.outer - coil.inner) * coil.height)

    def half(x: np.ndarray) -> np.ndarray:
        outer, inner = coil.outer + np.hypot(coil.outer, x), coil.inner + np.hypot(coil.inner, x)
        return x * np.log(outer / inner)

    z = y - coil.y
    return MU0 * density / 2 * (half(z + coil.height / 2) - half(z - coil.height / 2))


def coil_inductance(one: RingKeys, other: RingKeys, turns: int) -> float:
    """Self or mutual inductance [H] of two equal coils, from the Hankel form of A_phi.

    ``M = mu0 pi n^2 int P(k)^2 Z(k) dk`` with ``P = int a J1(k a) da`` over the thickness and ``Z``
    the double integral of ``exp(-k |z - z'|)`` over both heights.
    """
    density = turns / ((one.outer - one.inner) * one.height)
    h, distance = one.height, abs(one.y - other.y)

    def first_moment(x: float) -> float:  # int_0^x t J1(t) dt
        return np.pi * x / 2 * (j1(x) * struve(0, x) - j0(x) * struve(1, x))

    def integrand(k: float) -> float:
        thickness = (first_moment(k * one.outer) - first_moment(k * one.inner)) / k**2
        if distance == 0:
            heights = 2 * (k * h - 1 + np.exp(-k * h)) / k**2
        else:
            heights = np.exp(-k * distance) * (2 * np.sinh(k * h / 2) / k) ** 2
        return thickness**2 * heights

    edges = np.concatenate([[1e-3], np.linspace(200, 40e3, 200)])
    total = sum(quad(integrand, a, b)[0] for a, b in pairwise(edges))
    return MU0 * np.pi * density**2 * total


@pytest.fixture(scope="module")
def table() -> MagnetostaticTable:
    return compute_magnetostatic_table(FREE, RADIUS)


def test_flux_of_the_sphere_is_its_moment_times_the_coil_field(table: MagnetostaticTable) -> None:
    for k, coil in enumerate((FREE.lower, FREE.upper)):
        dipole = dipole_moment(FREE) * coil_field(coil, FREE.turns, table.y)
        of_ring = table.flux0[:, k] - dipole
        assert np.ptp(of_ring) < 1e-5 * np.ptp(dipole)  # the ring's flux knows no position
        assert np.mean(of_ring) < 0  # its field in the bore opposes its magnetisation


def test_inductances_agree_with_the_hankel_integral(table: MagnetostaticTable) -> None:
    own = coil_inductance(FREE.lower, FREE.lower, FREE.turns)
    mutual = coil_inductance(FREE.lower, FREE.upper, FREE.turns)
    assert own == pytest.approx(43.8e-3, rel=1e-3)
    assert mutual == pytest.approx(7.33e-3, rel=1e-3)
    expected = np.array([[own, mutual], [mutual, own]])
    # Measured 3e-7 H, most of it the air cylinder's end.
    assert np.max(np.abs(table.inductance - expected)) < 2e-5 * own


@pytest.mark.parametrize(
    ("mu_r", "radius", "error"),
    [(1.5, RADIUS, 1e-4), pytest.param(3.0, 0.4e-3, 5e-4, marks=pytest.mark.slow)],
)
def test_moment_of_a_permeable_sphere(mu_r: float, radius: float, error: float) -> None:
    # Ring reduced to a far sliver: only the sphere is permeable, and outside it is a dipole.
    sliver = RingKeys(height=0.2e-3, outer=8.2e-3, inner=8e-3, y=2.5e-3)
    catch = FREE.model_copy(update={"mu_r": mu_r, "ring": sliver, "positions": 5})
    table = compute_magnetostatic_table(catch, radius)
    step = 1e-6  # central difference at a scale of 1 mm: 1e-7 of the slope
    above, below = (coil_field(catch.lower, catch.turns, table.y + s) for s in (step, -step))
    force = dipole_moment(catch, radius) * (above - below) / (2 * step)
    assert np.abs(table.coefficients[:, 1] - force).max() < error * np.abs(force).max()
