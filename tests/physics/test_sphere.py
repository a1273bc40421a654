"""The free elastic sphere against closed forms: statics by Legendre series, Lamb's modes, Hertz.

Statics: inside, ``u = sum_n A_n grad(phi_n) + B_n (r^2 grad(phi_n) + alpha_n x phi_n)`` of solid
harmonics phi_n (Love, A Treatise on the Mathematical Theory of Elasticity, 1944, article 172), the
traction of each pressure expanded on the surface, and a uniform body force against its resultant.
"""

from functools import cache

import numpy as np
import pytest
from closed_forms import half_space, hertz
from scipy.optimize import brentq
from scipy.special import spherical_jn

from kc2spice.bodies.pressure import (
    PressureBasis,
    Sphere,
    compliance,
    indentation_law,
    pressure_basis,
    sphere,
)
from kc2spice.fem.keys import Damping
from kc2spice.fem.materials import material
from kc2spice.rom.modal import resonators
from kc2spice.rom.reduce import reduce

R, SPACING, COUNT = 1e-3, 20e-6, 6
E, NU, DENSITY = 211.9e9, 0.291, 7860.0
MU, LAME = E / 2 / (1 + NU), E * NU / (1 + NU) / (1 - 2 * NU)

BODY = Sphere(R, material("steel"), Damping(ratio=1e-3))


def legendre(x, count):
    """P_n(x) and its derivative by x, n < count: (count, points) each."""
    P, D = np.zeros((2, count, x.size))
    P[0], P[1], D[1] = 1.0, x, 1.0
    for n in range(2, count):
        P[n] = ((2 * n - 1) * x * P[n - 1] - (n - 1) * P[n - 2]) / n
        D[n] = n * P[n - 1] + x * D[n - 1]
    return P, D


def tractions(n, U, dU, V, dV, div, r):
    """sigma_rr over P_n and sigma_rt over dP_n/dtheta."""
    return LAME * div + 2 * MU * dU, MU * (dV - V / r + U / r)


@cache
def series(count=2500):
    """(COUNT, COUNT) displacement along the axis, relative to the centre of mass, per force."""
    x, w = np.polynomial.legendre.leggauss(40)
    theta, weight, q = [], [], []  # pressures near theta = 0, forces along -z: pushed in
    for j in range(COUNT):
        a, b = (np.arcsin(SPACING * k / R) for k in (j, j + 1))
        theta.append((a + b) / 2 + (b - a) / 2 * x)
        weight.append(2 * np.pi * R**2 * (b - a) / 2 * w * np.sin(theta[-1]))
    theta, weight = np.concatenate(theta), np.concatenate(weight)
    c, s = np.cos(theta), np.sin(theta)
    heights = np.array([np.interp(R * s, SPACING * np.arange(COUNT + 1), np.eye(COUNT + 1)[k])
                        for k in range(COUNT)])  # fmt: skip
    q = heights * c
    q /= (q * weight).sum(axis=1)[:, None]
    P, D = legendre(c, count)
    D = -s * D  # by theta
    volume, total = 4 / 3 * np.pi * R**3, np.zeros((COUNT, COUNT))
    for n in range(count):
        size = (2 * n + 1) / (4 * np.pi * R**2)
        radial, along = -q * weight @ (c * P[n]), q * weight @ (s * D[n])  # of q (-z)
        if n == 0:
            A = size * radial / (3 * LAME + 2 * MU)
            total += np.outer(radial, A * R)
            continue
        load = size * np.array([radial, along / (n * (n + 1))])  # (2, COUNT)
        alpha = -2 * (n * LAME + (3 * n + 1) * MU) / ((n + 3) * LAME + (n + 5) * MU)
        div = (2 * n + alpha * (n + 3)) / R
        UB, VB = (n + alpha), 1.0  # both times r^(n+1) / R^(n+1)
        tB = tractions(n, UB, (n + 1) * UB / R, VB, (n + 1) * VB / R, div, R)
        if n == 1:
            A = -(1 / volume) / (2 * LAME + 8 * MU)  # of the body force +z / volume
            p = A * R**2
            tp = tractions(n, p, 2 * p / R, p, 2 * p / R, 2 * A * R, R)
            B = np.linalg.lstsq(np.array(tB)[:, None], load - np.array(tp)[:, None], rcond=None)[0]
            left = np.array(tB)[:, None] @ B - load + np.array(tp)[:, None]
            assert np.abs(left).max() < 1e-6 * np.abs(load).max()  # in equilibrium
            mean = 3 / 5 * (p + B[0] * (1 + alpha / 3))
            U, V = p + B[0] * UB - mean, p + B[0] * VB - mean
        else:
            tA = tractions(n, n, n * (n - 1) / R, 1.0, (n - 1) / R, 0.0, R)
            A, B = np.linalg.solve(np.array([tA, tB]).T, load)
            U, V = A * n + B * UB, A + B * VB
        total += np.outer(radial, U) + np.outer(along, V)
    return total


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


def test_the_sphere_swings_as_lamb_says():
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
    model = sphere(BODY, np.array([0.4, 0.6]), wide)
    assert model.facts["mass_kg"] == pytest.approx(4 / 3 * np.pi * R**3 * DENSITY, rel=2e-5)
    small = reduce(model, tolerance=1e-3, band=(0.0, 3e6))
    swings = np.sort(resonators(small).omega)[: len(expected)] / 2 / np.pi
    np.testing.assert_allclose(swings, expected, rtol=2e-4)


@cache
def dents():
    shape = pressure_basis(5e-6, 120e-6)
    return compliance(BODY, shape), shape


@pytest.mark.parametrize("plane", [np.inf, 100e9])
def test_two_elastic_sides_dent_as_hertz_says(plane):
    """``F = 4/3 E* sqrt(R) d^(3/2)`` with ``1/E* = 1/E1* + 1/E2*``, beyond what a sphere adds
    because it is no half-space: far from the contact that is the same for all of the basis."""
    S, shape, own = *dents(), E / (1 - NU**2)
    whole = (S - half_space(own, shape.nodes))[-1, 0]
    local = S - whole + half_space(plane, shape.nodes)
    law = indentation_law(shape, local, shape.distances**2 / (2 * R))
    modulus = 1 / (1 / own + 1 / plane)
    for d in (1e-6, 2e-6, 3e-6):
        s = np.sqrt(d / law.depth)
        force = sum(c * s ** (3 + k) for k, c in enumerate(law.coefficients))
        assert force == pytest.approx(hertz(modulus, R, d), rel=5e-3)
