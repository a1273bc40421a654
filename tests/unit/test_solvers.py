"""Sparse solvers against scipy's own."""

import numpy as np
import pytest
from scipy.sparse.linalg import splu

from kc2spice.core.errors import SimulationError
from kc2spice.linalg import factor
from kc2spice.linalg.factor import factorise, inverses
from laboratory.reduction_scaling import grid_model


@pytest.fixture(scope="module")
def solid():
    """A solid with three unknowns for each node."""
    return grid_model(1500, 3)


@pytest.fixture
def supernodal(monkeypatch):
    """Sparse factors of definite matrices, however narrow."""
    monkeypatch.setattr(factor, "NARROW", 0)


@pytest.mark.parametrize("kind", ["definite", "complex"])
def test_solutions_are_those_of_another_order(solid, kind, supernodal):
    shift = {"definite": 0.0, "complex": 0.2j}[kind]
    matrix = (solid.K + shift * solid.M).tocsc()
    rhs = np.random.default_rng(0).standard_normal((matrix.shape[0], 3)).astype(matrix.dtype)
    exact = splu(matrix).solve(rhs)
    if kind == "definite":
        found = factorise(matrix, definite=True).solve(rhs)
    else:
        forward, backward = inverses(matrix, symmetric=True)
        found = forward(rhs)
        np.testing.assert_allclose(backward(rhs), found, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9 * np.abs(exact).max())


def test_an_indefinite_matrix_is_not_taken_for_a_definite_one(solid, supernodal):
    with pytest.raises(SimulationError, match="cannot be factorised"):
        factorise((solid.K - 20.0 * solid.M).tocsc(), definite=True)
