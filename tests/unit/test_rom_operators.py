"""Operators at their edges, and what elimination leaves of a model, against dense algebra."""

import numpy as np
import pytest
from scipy import sparse

from kc2spice.rom.linear import LinearModel
from kc2spice.rom.operators import Schur, largest
from kc2spice.rom.pencil import eliminated


@pytest.mark.parametrize("shape", [(0, 0), (0, 3), (3, 0)])
@pytest.mark.parametrize("make", [np.zeros, sparse.csc_array])
def test_the_largest_entry_of_no_entries_is_zero(make, shape):
    assert largest(make(shape)) == 0.0


@pytest.mark.parametrize("symmetric", [False, True])
def test_a_complement_is_that_of_dense_algebra(symmetric):
    rng = np.random.default_rng(2)
    K = rng.standard_normal((7, 7)) + 8 * np.eye(7)
    K = K + K.T if symmetric else K
    uu, up, pu, pp = K[:4, :4], K[:4, 4:], K[4:, :4], K[4:, 4:]
    S = Schur(*map(sparse.csc_array, (uu, up, pu, pp)))
    exact = uu - up @ np.linalg.solve(pp, pu)
    assert S.symmetric is symmetric
    x = rng.standard_normal((4, 2)) + 1j * rng.standard_normal((4, 2))
    t = rng.uniform(1, 2, 4)
    for found, expected in (
        (S @ x, exact @ x), (S.toarray(), exact), (S.T.toarray(), exact.T),
        (S.scaled(t).toarray(), np.diag(t) @ exact @ np.diag(t)),
    ):  # fmt: skip
        np.testing.assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("form", ["piezoelectric", "not symmetric", "first order"])
def test_elimination_leaves_the_response_as_it_is(form):
    """Two of six unknowns have neither inertia nor damping; loads and readings act on them too."""
    rng = np.random.default_rng(4)
    K = rng.standard_normal((6, 6)) + 8 * np.eye(6)
    K = K + K.T if form == "piezoelectric" else K
    held = np.diag([1.0, 2.0, 3.0, 4.0, 0.0, 0.0])
    B, D = rng.standard_normal((6, 2)), rng.standard_normal((2, 2))
    C = B.T if form == "piezoelectric" else rng.standard_normal((2, 6))
    if form == "first order":
        model = LinearModel(E=held, A=-K, B=B, C=C, D=D)
    else:
        model = LinearModel(M=held, E=0.1 * held @ held, K=K, B=B, C=C, D=D)
    less = eliminated(model.pencil)
    assert less.size == 4
    for s in (0.2j, 1.0 + 3.0j):
        P = s * held + K if form == "first order" else s**2 * held + 0.1 * s * held @ held + K
        exact = C @ np.linalg.solve(P, B) + D
        np.testing.assert_allclose(less.transfer(np.array([s]))[0], exact, rtol=1e-10)
