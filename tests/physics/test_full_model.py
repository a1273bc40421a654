"""Statics and responses of the full chip, each against an independent oracle."""

import numpy as np
import oracle
import pytest
from closed_forms import hertz
from scipy import sparse
from support import (
    LinearModel,
    SimulationError,
    StackKeys,
    make_stack,
    make_surrogate,
    reduce_model,
)

from bench.usual.contact import contact_surface
from bench.usual.statics import imprint
from bench.usual.system import quarter

SMALL = {"sectors": 4, "rings": 2, "ring_spacing": 300e-6, "outer_rings": 2}


@pytest.mark.slow
def test_surrogate_is_checked_against_direct_solutions():
    full = make_stack(StackKeys(layers=3, mesh={**SMALL, "order": 2})).model
    model, error = make_surrogate(full, (0.0, 500e3))
    assert error < 1e-10
    frequency = np.array([1.23e5, 4.56e5])
    np.testing.assert_allclose(model.transfer(frequency), full.transfer(frequency), rtol=1e-9)
    with pytest.raises(SimulationError, match="misses the tolerance"):
        make_surrogate(full, (0.0, 500e3), blocks=6)  # 4e-8


def slender_beam(elements):
    """A cantilever of Euler-Bernoulli elements with a force at its tip; EI, mass and length are 1.
    Its stiffness has a condition of 1e12."""
    h, size = 1.0 / elements, 2 * elements + 2
    bending = [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
               [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]  # fmt: skip
    inertia = [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
               [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]  # fmt: skip
    K, M = np.zeros((size, size)), np.zeros((size, size))
    for k in range(elements):
        own = slice(2 * k, 2 * k + 4)
        K[own, own] += np.array(bending) / h**3
        M[own, own] += np.array(inertia) * h / 420
    K, M = (sparse.csc_array(matrix[2:, 2:]) for matrix in (K, M))
    B = np.zeros((size - 2, 1))
    B[-2] = 1.0
    return LinearModel(M=M, E=1e-3 * M, K=K, B=B, C=B.T)


def test_surrogate_is_as_good_as_rounding_lets_direct_solutions_be():
    """Statics: ``L^3 / (3 E I)``."""
    model, error = make_surrogate(slender_beam(400), (0.0, 2.0))
    assert 1e-10 < error < 1e-3
    assert model.transfer(np.array([1e-3]))[0, 0, 0].real == pytest.approx(1 / 3, rel=1e-4)


@pytest.mark.slow
def test_imprint_of_an_isotropic_chip_follows_hertz():
    """F = 4/3 E/(1-nu^2) sqrt(R) d^1.5 on a half space; finite chip, rings 1/8 of the contact."""
    young, nu = 70e9, 0.3
    lame, shear = young * nu / (1 + nu) / (1 - 2 * nu), young / 2 / (1 + nu)
    c = {"c11": lame + 2 * shear, "c12": lame, "c13": lame, "c33": lame + 2 * shear,
         "c44": shear, "c66": shear}  # fmt: skip
    kick = StackKeys(
        side=3e-3, layers=40,
        material={"stiffness": c, "stress_coupling": {"e31": 0.0, "e33": 0.0, "e15": 0.0}},
        mesh={"rings": 10, "ring_spacing": 25e-6, "outer_rings": 11},
    )  # fmt: skip
    surface = contact_surface(kick, 1e13, 1e-3)
    depth = np.array([40e-6])
    force = 4 * imprint(quarter(kick), surface, depth, "short").force
    expected = hertz(young / (1 - nu**2), 1e-3, depth)
    np.testing.assert_allclose(force, expected, rtol=0.08)  # measured 6 %


def test_mass_damping_reaches_the_response_and_its_reduction():
    """A small chip whose damping is mostly alpha M, against its matrices."""
    kick = StackKeys(layers=3, mesh=SMALL, damping={"alpha": 3e5, "ratio": 1e-3})
    system = quarter(kick)
    assert system.K_pp.shape[0] == 0  # one element a layer: nothing to eliminate
    M, K = system.M.toarray(), system.K_uu.toarray()
    E = 3e5 * M + 1e-3 / (np.pi * 250e3) * K
    model = make_stack(kick).model
    frequency = np.array([50e3, 230e3, 270e3, 400e3])
    matrices = {"M": M, "E": E, "K": K, "B": -system.k_uV[:, None], "C": system.B[:, :1].T}
    direct = oracle.direct(oracle.system(matrices), frequency)[:, 0, 0]
    rom = reduce_model(model, tolerance=1e-6, band=(0.0, 500e3))
    for found in (model, rom):
        row, column = found.outputs.index("ring0"), found.inputs.index("anode")
        H = found.transfer(frequency)[:, row, column]
        np.testing.assert_allclose(H, direct, rtol=2e-6)
