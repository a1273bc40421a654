"""Nested dissection and supernodal factors against scipy's own solver and order."""

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from kc2spice.core.errors import MissingToolError, SimulationError
from kc2spice.linalg import factor, ordering
from kc2spice.linalg.factor import factorise, inverses
from kc2spice.rom import subspace
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduce import reduce
from laboratory.reduction_scaling import grid_model

PLAIN = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}


@pytest.fixture(scope="module")
def solid():
    """Stiffness of a solid of 6 591 unknowns, three for each node."""
    return grid_model(6591, 3).K.tocsc()


def test_solids_fill_less_than_in_the_order_of_minimum_degree(solid):
    order = ordering.nested_dissection(solid)
    np.testing.assert_array_equal(np.sort(order), np.arange(solid.shape[0]))
    ours = splu(solid[order][:, order].tocsc(), "NATURAL", **PLAIN)
    assert ours.L.nnz < 0.75 * splu(solid, "MMD_AT_PLUS_A", **PLAIN).L.nnz  # 0.57 measured


def test_unknowns_without_a_link_have_a_place_too():
    lonely = grid_model(300, 3).K.tolil()
    lonely[7, :] = lonely[:, 7] = 0.0
    lonely[7, 7] = 1.0
    order = ordering.nested_dissection(lonely.tocsc())
    np.testing.assert_array_equal(np.sort(order), np.arange(lonely.shape[0]))


@pytest.fixture
def supernodal(monkeypatch):
    """Sparse factors of definite matrices, however narrow."""
    monkeypatch.setattr(factor, "NARROW", 0)


@pytest.mark.parametrize("kind", ["definite", "shifted", "complex"])
def test_solutions_are_those_of_another_order(solid, kind, supernodal):
    rng = np.random.default_rng(0)
    rhs = rng.standard_normal((solid.shape[0], 3))
    mass = grid_model(6591, 3).M.tocsc()
    shift = {"definite": 0.0, "shifted": -0.9, "complex": 0.2j}[kind]
    matrix = (solid + shift * mass).tocsc()
    exact = splu(matrix).solve(rhs.astype(matrix.dtype))
    if kind == "definite":
        found = factorise(matrix, definite=True).solve(rhs)
    else:
        forward, backward = inverses(matrix, symmetric=True)
        found = forward(rhs.astype(matrix.dtype))
        np.testing.assert_allclose(backward(rhs.astype(matrix.dtype)), found, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9 * np.abs(exact).max())


def test_an_indefinite_matrix_is_not_taken_for_a_definite_one(solid, supernodal):
    with pytest.raises(SimulationError, match="cannot be factorised"):
        factorise((solid - 20.0 * grid_model(6591, 3).M).tocsc(), definite=True)


def test_without_gmsh_it_takes_longer_and_says_so(solid, supernodal, monkeypatch):
    def missing(name):
        raise MissingToolError("gmsh cannot be loaded")

    monkeypatch.setattr(ordering, "gmsh_session", missing)
    monkeypatch.setattr(ordering, "_orders", {})
    rhs = np.ones(solid.shape[0])
    with pytest.warns(UserWarning, match="slower order"):
        found = factorise(solid, definite=True).solve(rhs)
    assert np.abs(solid @ found - rhs).max() < 1e-11


def test_damping_in_proportion_is_seen_in_matrices_of_others(monkeypatch):
    """E = alpha M + beta K as one matrix: real solutions at a few shifts, and the same model."""
    model = grid_model(3000, 3)
    alpha, beta = 3e-3, 0.01
    plain = LinearModel(M=model.M, K=model.K, E=alpha * model.M + beta * model.K, B=model.B)
    named = LinearModel(M=model.M, K=model.K, rayleigh=(alpha, beta), B=model.B)
    band = (0.0, 0.2)
    monkeypatch.setattr(subspace, "_rational", None)  # complex solutions would fail
    found, wanted = (reduce(m, tolerance=1e-5, band=band) for m in (plain, named))
    frequency = np.linspace(*band, 21)
    np.testing.assert_allclose(found.transfer(frequency), wanted.transfer(frequency), rtol=1e-6)
    assert found.order == wanted.order


def test_many_factorisations_are_explained(monkeypatch):
    """A local dashpot asks for complex solutions at several frequencies."""
    monkeypatch.setattr(subspace, "MANY", 3)
    monkeypatch.setattr(subspace, "COSTLY", 0)
    model = grid_model(432, 2)
    E = model.E.tolil()
    E[5, 5] += 0.5 * E[5, 5]
    local = LinearModel(M=model.M, K=model.K, E=E.tocsc(), B=model.B)
    with pytest.warns(UserWarning, match="more than 3 factorisations"):
        reduce(local, tolerance=1e-4, band=(0.0, 0.1))
