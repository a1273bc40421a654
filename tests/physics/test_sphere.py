"""The free elastic sphere against closed forms: Lamb's modes, Hertz's contact."""

from functools import cache

import numpy as np
import pytest
from closed_forms import half_space, hertz
from scipy.optimize import brentq
from scipy.special import spherical_jn
from support import (
    DampingKeys,
    PressureBasis,
    TransverselyIsotropicSphere,
    choose_pressure_basis,
    compute_resonators,
    compute_sphere_compliance,
    find_material,
    fit_indentation_law,
    make_sphere_model,
    reduce_model,
)

R = 1e-3
E, NU, DENSITY = 211.9e9, 0.291, 7860.0
MU, LAME = E / 2 / (1 + NU), E * NU / (1 + NU) / (1 - 2 * NU)

BODY = TransverselyIsotropicSphere(R, find_material("steel"), DampingKeys(ratio=1e-3))


def tractions(n, U, dU, V, dV, div, r):
    """sigma_rr over P_n and sigma_rt over dP_n/dtheta."""
    return LAME * div + 2 * MU * dU, MU * (dV - V / r + U / r)


def lamb(n, f):
    """Determinant of the tractions of a spheroidal oscillation (Lamb 1882)."""
    h, k = (2 * np.pi * f / np.sqrt(c / DENSITY) for c in (LAME + 2 * MU, MU))

    def j(z):
        value, slope = spherical_jn(n, z), spherical_jn(n, z, True)
        return value, slope, -2 / z * slope - (1 - n * (n + 1) / z**2) * value

    a, b, c = j(h * R)
    one = tractions(n, h * b, h**2 * c, a / R, h * b / R - a / R**2, -(h**2) * a, R)
    a, b, c = j(k * R)
    m = n * (n + 1)
    two = tractions(
        n, m * a / R, m * (k * b / R - a / R**2), k * b + a / R,
        k**2 * c + k * b / R - a / R**2, 0.0, R,
    )  # fmt: skip
    return one[0] * two[1] - one[1] * two[0]


def roots(g, low, high):
    f = np.linspace(low, high, 4000)
    v = g(f)
    return [brentq(g, f[i], f[i + 1]) for i in np.flatnonzero(v[1:] * v[:-1] < 0)]


def test_the_sphere_oscillates_at_the_frequency_of_lamb():
    """All axisymmetric modes up to 2.65 MHz, breathing and oblate among them."""
    speed = np.sqrt((LAME + 2 * MU) / DENSITY)
    ratio = (LAME + 2 * MU) / MU / 4

    def breathing(f):
        z = 2 * np.pi * f * R / speed
        return np.sin(z) * (1 - ratio * z**2) - z * np.cos(z)

    breathes = roots(breathing, 1e6, 3e6)
    assert len(breathes) == 1
    expected = sorted(breathes + [f for n in range(1, 7) for f in roots(
        lambda f, n=n: lamb(n, f), 0.5e6, 2.65e6)])  # fmt: skip
    # the oblate mode of nu = 0.291: 0.842 c / 2R (Love 1944, article 196: 0.840 of nu = 1/4)
    assert expected[0] * 2 * R / np.sqrt(MU / DENSITY) == pytest.approx(0.842, abs=2e-3)
    wide = PressureBasis(np.array([0.0, 60e-6, 120e-6]))
    model = make_sphere_model(BODY, np.array([0.4, 0.6]), wide)
    assert model.facts["mass_kg"] == pytest.approx(4 / 3 * np.pi * R**3 * DENSITY, rel=2e-5)
    small = reduce_model(model, tolerance=1e-3, band=(0.0, 3e6))
    swings = np.sort(compute_resonators(small).omega)[: len(expected)] / 2 / np.pi
    np.testing.assert_allclose(swings, expected, rtol=2e-4)


@cache
def dents():
    shape = choose_pressure_basis(5e-6, 120e-6)
    return compute_sphere_compliance(BODY, shape).compliance, shape


@pytest.mark.parametrize("plane", [np.inf, 100e9])
def test_the_indentation_of_two_elastic_sides_follows_hertz(plane):
    """``F = 4/3 E* sqrt(R) d^(3/2)`` with ``1/E* = 1/E1* + 1/E2*``, beyond what a sphere adds
    because it is no half-space: far from the contact that is the same for all of the basis."""
    S, shape, own = *dents(), E / (1 - NU**2)
    whole = (S - half_space(own, shape.nodes))[-1, 0]
    local = S - whole + half_space(plane, shape.nodes)
    law = fit_indentation_law(shape, local, shape.mean_gap_radii**2 / (2 * R))
    modulus = 1 / (1 / own + 1 / plane)
    for d in (1e-6, 2e-6, 3e-6):
        s = np.sqrt(d / law.depth)
        force = sum(c * s ** (3 + k) for k, c in enumerate(law.coefficients))
        assert force == pytest.approx(hertz(modulus, R, d), rel=5e-3)
