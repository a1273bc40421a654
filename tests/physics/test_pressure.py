"""Ports of pressure against the half-space: Boussinesq, Hertz, transversely isotropic ceramic.

The oracle's half-space knows no mesh: a pressure of radial transform ``P(k) = int p J0(k r) r dr``
dents it by ``2 / E*`` times ``P(k) / k`` (Johnson, Contact Mechanics, 1985; of a transversely
isotropic body with the modulus of Delafargue and Ulm 2004, evaluated here from its two roots).
"""

from functools import cache

import numpy as np
import pytest
from closed_forms import half_space, hertz
from support import (
    BuiltScene,
    ContactPair,
    PressureBasis,
    StackKeys,
    Waveforms,
    choose_pressure_basis,
    compute_local_compliance,
    compute_stresses_under_force,
    compute_surface_compliance,
    find_material,
    fit_indentation_law,
    load_scene,
    solve_contact_forces,
)

from bench.usual.contact import sphere_gap

SPACING, COUNT, PATCH = 10e-6, 12, 250e-6
NODES = SPACING * np.arange(COUNT + 1)
EVEN = PressureBasis(np.append(NODES, [140e-6, 170e-6, 210e-6, PATCH]))
STEEL = 211.9e9 / (1 - 0.291**2)


def steel():
    return {"youngs_modulus": 211.9e9, "poisson_ratio": 0.291, **ceramic()}


def ceramic():
    return {"stress_coupling": {"e31": 0.0, "e33": 0.0, "e15": 0.0}}


def modulus(stiffness):
    """Indentation modulus along the axis: Hanson, J. Appl. Mech. 59 (1992), ``1 / (pi H)``."""
    c11, c13, c33, c44 = (stiffness[k] for k in ((0, 0), (0, 2), (2, 2), (3, 3)))
    roots = np.roots([c33 * c44, -(c11 * c33 - c13 * (c13 + 2 * c44)), c11 * c44])
    g1, g2 = (1 / np.sqrt(complex(root)) for root in roots)
    H = (g1 + g2) * c11 / (2 * np.pi * (c11 * c33 - c13**2))
    return (1 / (np.pi * H)).real


def without_mean(S):
    """Remove rigid motions and indentations far wider than the basis functions."""
    n = len(S)
    free = np.eye(n) - 1 / n
    return free @ S @ free


@cache
def body(name, cells=3):
    chip = StackKeys(material=steel() if name == "steel" else ceramic())
    return compute_surface_compliance(chip, EVEN, cells)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["steel", "ceramic"])
def test_rings_of_pressure_dent_as_on_a_half_space(name):
    E = STEEL if name == "steel" else modulus(find_material("THP51").C)
    S = body(name)[:COUNT, :COUNT]
    expected = without_mean(half_space(E, NODES))
    error = np.abs(without_mean(S) - expected).max(axis=1) / np.abs(expected).max()
    assert error[0] < 6e-3  # the cone on the axis, three cells wide
    assert error[1:].max() < 2e-3


@cache
def graded(spacing):
    """Basis, its compliance beyond a half-space of the same body, and its gaps."""
    shape = choose_pressure_basis(spacing, PATCH)
    S = compute_surface_compliance(StackKeys(material=steel()), shape)
    whole = (body("steel")[:COUNT, :COUNT] - half_space(STEEL, NODES))[5, 11]
    return shape, S - whole, sphere_gap(R, shape.mean_gap_radii)


R = 1e-3


def force(law, depth):
    s = np.sqrt(depth / law.depth)
    return sum(c * s ** (3 + k) for k, c in enumerate(law.coefficients))


@pytest.mark.slow
@pytest.mark.parametrize(("spacing", "first", "error"), [(10e-6, 2e-6, 2.5e-3), (5e-6, 5e-7, 2e-3)])
def test_the_indentation_of_a_sphere_in_steel_follows_hertz(spacing, first, error):
    """From contacts some basis functions wide on: ``F = 4/3 E* sqrt(R) d^(3/2)``. Of the error 1e-3
    is the body's, which is no half-space, and the sphere's, which is no paraboloid."""
    law = fit_indentation_law(*graded(spacing))
    depth = np.linspace(first, 14e-6, 60)
    np.testing.assert_allclose(force(law, depth), hertz(STEEL, R, depth), rtol=error)
    slope = np.polyfit(np.log(depth), np.log(force(law, depth)), 1)[0]
    assert slope == pytest.approx(1.5, abs=error)


@pytest.mark.slow
def test_stress_below_a_sphere_is_that_of_hertz_and_huber():
    """``p0 = 2 E* a / pi R``; on the axis the shear is largest half a radius down (Johnson 4.2)."""
    shape, S, gap = graded(5e-6)
    depth, nu = 6e-6, 0.291
    found = compute_stresses_under_force(
        StackKeys(material=steel()), shape, solve_contact_forces(S, gap, np.array([depth]))[0]
    )
    a = np.sqrt(R * depth)
    p0 = 2 * STEEL * a / (np.pi * R)
    z = np.linspace(0.01, 2, 20001)  # in units of a
    axial = -1 / (1 + z**2)
    radial = -(1 + nu) * (1 - z * np.arctan(1 / z)) - axial / 2
    shear = np.abs(axial - radial) / 2
    assert found["pressure_pa"] == pytest.approx(p0, rel=1e-2)
    assert found["shear_pa"] == pytest.approx(shear.max() * p0, rel=1e-2)
    assert found["shear_depth_m"] == pytest.approx(z[shear.argmax()] * a, rel=0.1)


@pytest.mark.slow  # the potentials of 33 layers
def test_a_chip_is_stiffer_than_its_ceramic_and_converges():
    """Fields stiffen a dent that is as wide as a layer is thick; meshes agree."""
    coarse, fine = (compute_surface_compliance(StackKeys(), EVEN, cells) for cells in (3, 6))
    np.testing.assert_allclose(coarse[1:, 1:], fine[1:, 1:], rtol=1e-3)
    assert 0.05 < 1 - fine[0, 0] / body("ceramic")[0, 0] < 0.15
    added = compute_local_compliance(StackKeys(), EVEN).compliance
    assert np.linalg.eigvalsh(added)[0] > 0


def test_forces_act_where_surfaces_meet_and_nowhere_else():
    rng = np.random.default_rng(3)
    for _ in range(100):
        root = rng.normal(size=(6, 6))
        S, gap, depth = (root @ root.T + np.eye(6)) * 1e-8, rng.normal(size=6) * 1e-6, 1e-6
        (force,) = solve_contact_forces(S, gap, np.array([depth]))
        apart = S @ force - (depth - gap)
        assert min(force) >= 0
        assert apart.min() > -1e-5 * np.abs(gap).max()
        np.testing.assert_allclose(force * apart, 0, atol=1e-5 * force.max() * np.abs(gap).max())


SMALL = ("kick.layers=2", "kick.mesh.sectors=4", "kick.mesh.rings=2", "kick.mesh.outer_rings=2",
         "kick.mesh.ring_spacing=100 um", "contact.shape=pressure")  # fmt: skip


def test_a_contact_deeper_than_its_law_is_reported():
    """A contact as wide as half the patch of ``a`` is ``a^2 / (4 R)`` deep, by Hertz."""
    scene = load_scene("impact", [*SMALL, "contact.spacing=20 um"])
    contact, radius = scene.parts["contact"], scene.parts["sphere"].keys.radius
    limit = ContactPair(contact, scene).lower_surface.patch ** 2 / (4 * radius)
    for depth, passed in ((0.5 * limit, True), (2.0 * limit, False)):
        none = np.zeros(3)
        data = {"time": np.array([0.0, 1.0, 2.0]), "sphere.y": radius - depth * np.ones(3),
                "kick.u.patch": none, "contact.force": none,
                "contact.force.patch": none}  # fmt: skip
        checks = contact.type.checks(contact, BuiltScene(scene, {}), Waveforms(data, {}))
        found = [c for c in checks if getattr(c, "name", "") == "depth of the contact"]
        assert [check.passed for check in found] == [passed]
        assert found[0].value == pytest.approx(depth)
