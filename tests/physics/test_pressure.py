"""Ports of pressure against the half-space: Boussinesq, Hertz, transversely isotropic ceramic.

The oracle's half-space knows no mesh: a pressure of radial transform ``P(k) = int p J0(k r) r dr``
dents it by ``2 / E*`` times ``P(k) / k`` (Johnson, Contact Mechanics, 1985; of a transversely
isotropic body with the modulus of Delafargue and Ulm 2004, evaluated here from its two roots).
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.special import j0

from kc2spice.bodies.pressure import dents, hats, pressed, with_hats
from kc2spice.fem.piezo.keys import Chip, Material
from kc2spice.rom.linear import LinearModel, Port
from kc2spice.rom.modal import resonators

SPACING, COUNT, PATCH = 10e-6, 12, 250e-6
STEEL = 211.9e9 / (1 - 0.291**2)


def steel():
    lame = 211.9e9 * 0.291 / ((1 + 0.291) * (1 - 2 * 0.291))
    shear = 211.9e9 / 2 / (1 + 0.291)
    c11 = lame + 2 * shear
    return Material(stiffness=(c11, lame, lame, c11, shear, shear), coupling=(0.0, 0.0, 0.0))


def ceramic():
    return Material(coupling=(0.0, 0.0, 0.0))


def modulus(stiffness):
    """Indentation modulus along the axis: Hanson, J. Appl. Mech. 59 (1992), ``1 / (pi H)``."""
    c11, _, c13, c33, c44, _ = stiffness
    roots = np.roots([c33 * c44, -(c11 * c33 - c13 * (c13 + 2 * c44)), c11 * c44])
    g1, g2 = (1 / np.sqrt(complex(root)) for root in roots)
    H = (g1 + g2) * c11 / (2 * np.pi * (c11 * c33 - c13**2))
    return (1 / (np.pi * H)).real


@cache
def half_space(E):
    """(COUNT, COUNT) mean dent of each hat per force on each."""
    x, w = np.polynomial.legendre.leggauss(24)
    k = np.linspace(0, 25 / SPACING, 8001)
    k = (k[:-1] + k[1:]) / 2
    P = []
    for j in range(COUNT):
        total, force = np.zeros(k.size), 0.0
        for a, b in ((j - 1, j), (j, j + 1)):
            if a < 0:
                continue
            r = SPACING * ((a + b) / 2 + (b - a) / 2 * x)
            p = (1 - np.abs(r / SPACING - j)) * r * w * SPACING / 2
            total += j0(k[:, None] * r) @ p
            force += 2 * np.pi * p.sum()
        P.append(total / force)
    return 2 * np.pi * 2 / E * (k[1] - k[0]) * np.array(P) @ np.array(P).T


def without_mean(S):
    """What no rigid motion, nor a dent far wider than the hats, changes."""
    n = len(S)
    free = np.eye(n) - 1 / n
    return free @ S @ free


@cache
def body(material, cells=3):
    chip = Chip(material=steel() if material == "steel" else ceramic())
    return dents(chip, hats(SPACING, COUNT, PATCH), cells)


@pytest.mark.parametrize("material", ["steel", "ceramic"])
def test_rings_of_pressure_dent_as_on_a_half_space(material):
    E = STEEL if material == "steel" else modulus(Material().stiffness)
    S = body(material)[:COUNT, :COUNT]
    expected = without_mean(half_space(E))
    error = np.abs(without_mean(S) - expected).max(axis=1) / np.abs(expected).max()
    assert error[0] < 6e-3  # the cone on the axis, three cells wide
    assert error[1:].max() < 2e-3


def test_the_oracle_is_that_of_the_textbooks():
    """The modulus of both roots is ``E / (1 - nu^2)`` of an isotropic body, and a mean dent under
    an even pressure ``16 F / (3 pi^2 a E*)`` (Johnson 1985, 3.29)."""
    nu, E = 0.291, 211.9e9
    lame, shear = E * nu / ((1 + nu) * (1 - 2 * nu)), E / 2 / (1 + nu)
    almost = (lame + 2 * shear, lame, lame, (lame + 2 * shear) * (1 + 1e-6), shear, shear)
    assert modulus(almost) == pytest.approx(STEEL, rel=1e-5)
    # the first hats at one height are a disc with a narrow edge
    even = hats(SPACING, COUNT, PATCH).areas[:COUNT]
    found = even @ half_space(STEEL) @ even / even.sum() ** 2
    assert found == pytest.approx(16 / (3 * np.pi**2 * (COUNT - 0.5) * SPACING * STEEL), rel=4e-3)


def signorini(S, gap, depth):
    """Forces (n,) of a contact without springs: pressure where, and only where, it is shut."""
    shut = gap < depth
    while True:
        force = np.zeros(gap.size)
        force[shut] = np.linalg.solve(S[np.ix_(shut, shut)], (depth - gap)[shut])
        now = shut & (force > 0)
        if (now == shut).all():
            return force
        shut = now


def test_a_sphere_dents_steel_as_hertz_says():
    """``F = 4/3 E* sqrt(R) d^(3/2)`` and the radius ``sqrt(R d)``, beyond what the whole gives."""
    R, shape = 1e-3, hats(SPACING, COUNT, PATCH)
    S = body("steel")[:COUNT, :COUNT]
    whole = (S - half_space(STEEL))[5, 11]  # what the body's size adds, the same for all hats
    own, gap = S - whole, shape.distances[:COUNT] ** 2 / (2 * R)
    depths = np.array([2e-6, 4e-6, 8e-6])
    forces = np.array([signorini(own, gap, d) for d in depths])
    hertz = 4 / 3 * STEEL * np.sqrt(R) * depths**1.5
    np.testing.assert_allclose(forces.sum(axis=1), hertz, rtol=8e-3)
    slope = np.polyfit(np.log(depths), np.log(forces.sum(axis=1)), 1)[0]
    assert slope == pytest.approx(1.5, abs=8e-3)
    for d, force in zip(depths, forces, strict=True):
        assert np.flatnonzero(force)[-1] * SPACING == pytest.approx(np.sqrt(R * d), abs=SPACING)


def test_hats_stand_where_they_should():
    shape = hats(SPACING, COUNT, PATCH)
    assert (shape.nodes[0], shape.nodes[-1]) == (0.0, PATCH)
    assert np.pi * SPACING**2 / 3 == pytest.approx(shape.areas[0])  # a cone
    assert shape.areas[5] == pytest.approx(2 * np.pi * 5 * SPACING**2)  # Pappus
    whole = (shape.areas * shape.distances**2).sum()  # of a plateau with one falling edge
    whole += np.pi * SPACING**4 / 10  # the cone's own, whose gap is that of its tip
    assert shape.distances[0] == 0.0
    a, b = shape.nodes[-2:]
    r = np.linspace(0, b, 200001)
    height = np.interp(r, [a, b], [1.0, 0.0])
    assert whole == pytest.approx(np.trapezoid(2 * np.pi * height * r**3, r), rel=1e-6)


@pytest.mark.slow  # the potentials of 33 layers
def test_a_chip_is_stiffer_than_its_ceramic_and_converges():
    """Fields stiffen a dent that is as wide as a layer is thick; meshes agree."""
    shape = hats(SPACING, COUNT, PATCH)
    coarse, fine = (dents(Chip(), shape, cells) for cells in (3, 6))
    np.testing.assert_allclose(coarse[1:, 1:], fine[1:, 1:], rtol=1e-3)
    assert 0.05 < 1 - fine[0, 0] / body("ceramic")[0, 0] < 0.15
    added = pressed(Chip(), shape).compliance
    assert np.linalg.eigvalsh(added)[0] > 0


def test_the_hats_add_their_compliance_and_nothing_else():
    model = LinearModel(
        M=np.eye(2), E=np.diag([1e2, 2e2]), K=np.diag([1e10, 4e10]),
        B=np.array([[1.0, 0.3], [0.5, 0.1]]), C=np.array([[1.0, 0.5], [0.3, 0.1]]),
        D=np.diag([0.0, 1e-9]),
        ports=(Port("patch", "mechanical"), Port("anode", "electrical", pins=("anode", "ret"))),
    )  # fmt: skip
    added = np.array([[3e-8, 1e-8], [1e-8, 2e-8]])
    found = with_hats(model, added, ("ring0", "ring1"), 1e-9)
    assert [port.name for port in found.ports] == ["ring0", "ring1", "anode"]
    f = np.array([0.0, 1e4])
    before, after = model.transfer(f), found.transfer(f)
    np.testing.assert_allclose(after[0, :2, :2], before[0, 0, 0] + added, rtol=1e-12)
    relaxed = added / (1 + 2j * np.pi * f[1] * 1e-9)
    np.testing.assert_allclose(after[1, :2, :2], before[1, 0, 0] + relaxed, rtol=1e-12)
    np.testing.assert_allclose(after[:, :2, 2], np.repeat(before[:, 0, 1][:, None], 2, 1))
    assert resonators(found).massless == 2
