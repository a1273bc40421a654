"""Axisymmetric piezoelectric elements against closed forms that share nothing with them."""

from functools import partial

import numpy as np
import oracle
import pytest
from closed_forms import rod_resonance
from scipy.linalg import eigh
from scipy.optimize import brentq
from scipy.special import i0, i1, j0, j1
from support import (
    Block,
    BondedBlocks,
    DampingKeys,
    UsageError,
    compute_node_shares,
    disc,
    find_material,
    langevin,
)

approx = partial(pytest.approx, abs=0.0)  # its default of 1e-12 is a picofarad
PZT = find_material("PZT-5A")
STEEL = find_material("steel")
UNDAMPED = DampingKeys(ratio=0)


def static(K, load, rigid=0):
    """Displacement under a load; a free body is held at one unknown."""
    K = K.toarray()
    return np.concatenate([np.zeros(rigid), np.linalg.solve(K[rigid:, rigid:], load[rigid:])])


def ceramic(radius, thickness, refine=1, size=None, electrode=None):
    faces = [((0, electrode or radius), (z, z)) for z in (0, thickness)]
    electrodes = {"cathode": faces[:1], "anode": faces[1:]}
    block = Block(((0, radius), (0, thickness)), PZT)
    size = size or radius / 10
    return BondedBlocks(
        [block], electrodes, size=size, refine=refine, damping=UNDAMPED
    ).build_fe_model()


# -- patch tests ----------------------------------------------------------------------------------


def test_a_mean_is_that_of_the_full_turn():
    """Of ``r^2`` over a disc or a cylinder of radius a it is ``a^2 / 2``."""
    radius, thickness = 3e-3, 1e-3
    solid = ceramic(radius, thickness).solid
    top = solid.mesh.facets_satisfying(lambda x: x[1] > thickness * (1 - 1e-9))
    for where in ({"facets": top}, {"elements": np.arange(solid.mesh.nelements)}):
        assert compute_node_shares(solid, **where) @ solid.node_positions[0] ** 2 == approx(
            radius**2 / 2, rel=1e-9
        )


def test_a_free_ceramic_has_its_free_permittivity_and_strain():
    radius, thickness = 3e-3, 1.3e-3
    device = ceramic(radius, thickness, size=0.7e-3)
    model = device.model
    held = static(model.K, model.B[:, 0], rigid=1)
    area = np.pi * radius**2
    capacitance = model.D[0, 0] + model.B[:, 0] @ held
    assert capacitance == approx(PZT.eps_T[2, 2] * area / thickness, rel=1e-9)
    # S = d' E with E = -V/t along z
    u = (device.displacement @ held).reshape(-1, 2)
    r, z = device.solid.basis(1).doflocs
    slope = np.polyfit(z, u[:, 1], 1)[0]
    assert slope == approx(-PZT.d[2, 2] / thickness, rel=1e-6)
    rim = r > 0.999 * radius
    np.testing.assert_allclose(u[rim, 0], -PZT.d[2, 0] / thickness * radius, rtol=1e-6)
    assert model.D[0, 0] == approx(PZT.eps_S[2, 2] * area / thickness, rel=1e-9)


# -- plates ---------------------------------------------------------------------------------------


def bending(root, radius, thickness, m=STEEL):
    E, nu = 211.9e9, 0.291
    D = E * thickness**3 / (12 * (1 - nu**2))
    return root**2 / (2 * np.pi * radius**2) * np.sqrt(D / (m.density * thickness))


def plate_root(condition):
    nu = 0.291
    conditions = {
        "clamped": lambda x: j0(x) * i1(x) + j1(x) * i0(x),
        "simply_supported": lambda x: j1(x) / j0(x) + i1(x) / i0(x) - 2 * x / (1 - nu),
        "free": lambda x: j0(x) / j1(x) + i0(x) / i1(x) - 2 * (1 - nu) / x,
    }
    brackets = {"clamped": (2.5, 4), "simply_supported": (1.8, 2.39), "free": (2.4, 3.8)}
    return brentq(conditions[condition], *brackets[condition])


@pytest.mark.parametrize("support", ["clamped", "simply_supported", "free"])
def test_a_thin_disc_bends_at_the_frequency_of_plate_theory(support):
    """Of steel with a speck of ceramic; shear and rotation are (t / a)^2 = 4e-4."""
    layers = [
        {"material": "steel", "diameter": "40 mm", "thickness": "0.4 mm"},
        {"material": "PZT-5A", "diameter": "1 mm", "thickness": "1 um"},
    ]
    model = (
        disc.make_disc_blocks({"layers": layers, "support": support, "mesh": {"refine": 2}})
        .build_fe_model()
        .model
    )
    values = eigh(model.K.toarray(), model.M.toarray(), eigvals_only=True)
    theory = bending(plate_root(support), 20e-3, 0.4e-3)
    assert np.sqrt(values[int(support == "free")]) / (2 * np.pi) == approx(theory, rel=2e-3)


# -- ceramics in closed form ----------------------------------------------------------------------


def radial_admittance(frequency, radius, thickness, m=PZT):
    """Thin disc in radial motion: Bessel functions (Meitzler, O'Bryan, Tiersten 1973)."""
    s = np.linalg.inv(m.C)
    nu = -s[0, 1] / s[0, 0]
    c = 1 / (s[0, 0] * (1 - nu**2))
    e = m.d[2, 0] / (s[0, 0] * (1 - nu))
    eps = m.eps_T[2, 2] - 2 * m.d[2, 0] ** 2 / (s[0, 0] + s[0, 1])
    x = 2 * np.pi * frequency * radius * np.sqrt(m.density / c)
    factor = eps + 2 * e**2 / c * j1(x) / (x * j0(x) - (1 - nu) * j1(x))
    return 2j * np.pi * frequency * np.pi * radius**2 / thickness * factor


def test_a_thin_ceramic_disc_has_the_admittance_of_the_radial_theory():
    radius, thickness = 10e-3, 0.4e-3
    layer = {"material": "PZT-5A", "diameter": "20 mm", "thickness": "0.4 mm"}
    model = (
        disc.make_disc_blocks({"layers": [layer], "damping": {"ratio": 0}, "mesh": {"refine": 2}})
        .build_fe_model()
        .model
    )
    f = np.linspace(5e3, 200e3, 20)
    theory = radial_admittance(f, radius, thickness).imag
    pole = brentq(lambda x: 1 / radial_admittance(x, radius, thickness).imag, 90e3, 110e3)
    zero = brentq(lambda x: radial_admittance(x, radius, thickness).imag, 1.05 * pole, 1.3 * pole)
    assert model.facts["resonance_short_hz"] == approx(pole, rel=5e-4)
    assert model.facts["resonance_open_hz"] == approx(zero, rel=5e-4)
    away = (np.abs(f - pole) > 5e3) & (np.abs(f - zero) > 5e3)
    charge = oracle.direct(oracle.system_of(model.select(["anode"])), f[away])[:, 0, 0]
    np.testing.assert_allclose(2 * np.pi * f[away] * charge.real, theory[away], rtol=5e-3)


def test_smooth_modes_converge_with_the_fourth_power_of_the_cell():
    first = []
    for refine in (1, 2, 4):
        model = ceramic(2e-3, 2e-3, refine, size=1e-3).model
        K, M = model.K.toarray(), model.M.toarray()
        values = eigh(K, M, eigvals_only=True, subset_by_index=[1, 3])
        first.append(np.sqrt(values))
    steps = np.abs(np.diff(first, axis=0))
    rate = np.log2(steps[0] / steps[1])
    assert rate.min() > 3.3


# -- Langevin -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_slender_langevin_resonates_as_a_transmission_line():
    keys = {
        "front": [{"material": "aluminium", "diameter": "10 mm", "length": "80 mm"}],
        "back": [{"material": "steel", "diameter": "10 mm", "length": "60 mm"}],
        "rings": {
            "material": "PZT-4", "outer": "10 mm", "inner": "4 mm", "thickness": "5 mm", "count": 4,
        },
        "bolt": {"material": "steel", "diameter": "3 mm", "depth": "10 mm"},
    }  # fmt: skip
    model = langevin.make_langevin_blocks(keys).build_fe_model().model
    pzt = find_material("PZT-4")
    circle = np.pi / 4 * 1e-6
    ring, bolt, full = circle * (100 - 16), circle * 9, circle * 100
    stack = ring / np.linalg.inv(pzt.C)[2, 2] + bolt * 211.9e9
    mass = ring * 7500 + bolt * 7860
    thread = (full - bolt) * 70.3e9 + bolt * 211.9e9
    weight = (full - bolt) * 2700 + bolt * 7860
    sections = [
        (full, 211.9e9, 7860, 60e-3),
        (full, stack / full, mass / full, 20e-3),
        (full, thread / full, weight / full, 10e-3),
        (full, 70.3e9, 2700, 70e-3),
    ]
    assert model.facts["resonance_short_hz"] == approx(rod_resonance(sections, 30e3), rel=0.01)
    mass = full * 60e-3 * 7860 + mass * 20e-3 + weight * 10e-3 + full * 70e-3 * 2700
    assert model.facts["mass_kg"] == approx(mass, rel=1e-9)
    capacitance = 4 * pzt.eps_T[2, 2] * ring / 5e-3
    assert model.facts["capacitance_free_f"] == approx(capacitance, rel=0.15)  # bolt clamps
    assert {p.name for p in model.ports} == {"anode", "front", "back", "front_face", "back_face"}
    fixed = langevin.make_langevin_blocks(keys | {"support": "back"}).build_fe_model().model
    assert {p.name for p in fixed.ports} == {"anode", "front", "front_face"}
    assert fixed.facts["resonance_short_hz"] < model.facts["resonance_short_hz"]


# -- errors ---------------------------------------------------------------------------------------

BRASS = {"material": "brass", "diameter": "20 mm", "thickness": "0.2 mm"}
CERAMIC = {"material": "PZT-5A", "diameter": "14 mm", "thickness": "0.2 mm"}
RING = {"inner": "2 mm", "outer": "4 mm"}


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"layers": []}, "at least 1"),
        ({"layers": [BRASS]}, "has no piezoelectric layer"),
        ({"layers": [BRASS | {"electrodes": "5 mm"}, CERAMIC]}, "not piezoelectric"),
        ({"layers": [BRASS, CERAMIC | {"electrodes": "15 mm"}]}, "larger than their layer"),
        ({"layers": [BRASS, CERAMIC | {"diameter": "14 s"}]}, "wrong unit"),
        ({"layers": [BRASS, CERAMIC | {"thickness": 0}]}, "> 0"),
        ({"layers": [BRASS, CERAMIC | {"glue": 1}]}, "unknown key"),
        ({"layers": [BRASS, CERAMIC | {"material": "PZT"}]}, "this material does not exist"),
        ({"layers": [BRASS, CERAMIC | {"material": "quartz"}]}, "isotropic about its axis"),
        ({"layers": [BRASS, CERAMIC], "support": {"node": "21 mm"}}, "outside of the body"),
        ({"layers": [BRASS, CERAMIC], "support": "glued"}, "support"),
        ({"layers": [BRASS, CERAMIC], "centre": "15 mm"}, "wider than the top"),
        ({"layers": [BRASS, CERAMIC], "damping": {"ratio": 1, "quality": 2}}, "one of ratio"),
        ({"layers": [BRASS, CERAMIC], "damping": {"per_material": True}}, "layers[0] (brass)"),
        (
            {"layers": [BRASS, CERAMIC | {"feedback": RING | {"outer": "14.5 mm"}}]},
            "electrode does not fit",
        ),
        (
            {"layers": [CERAMIC | {"electrodes": "9 mm"}, CERAMIC | {"electrodes": "8 mm"}]},
            "different diameters",
        ),
    ],
)
def test_impossible_discs_are_refused_with_a_reason(keys, says):
    with pytest.raises(UsageError) as caught:
        disc.make_disc_blocks(keys, "buzzer").build_fe_model()
    assert says in str(caught.value)
    assert "buzzer" in str(caught.value) or "axis" in says
