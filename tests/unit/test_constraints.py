"""Constraints and infinite poles: what is equivalent, in closed form."""

import numpy as np
import pytest
from support import (
    LinearModel,
    compute_null_basis,
    deflate_infinite_poles,
    eliminate_algebraic_unknowns,
    reduce_model,
)


def test_two_masses_on_a_rigid_bar_are_one():
    """``(m1 + m2) x'' + (k1 + k2) x = F``, and the bar carries ``F - m1 x'' - k1 x``."""
    m, k, E = np.array([2.0, 3.0]), np.array([10.0, 20.0]), np.diag([0.1, 0.4, 0.0])
    G = np.array([[1.0, -1.0]])
    K = np.block([[np.diag(k), G.T], [G, np.zeros((1, 1))]])
    B, C = np.array([[1.0], [0.0], [0.0]]), np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for damping, degree in ((np.zeros((3, 3)), 2), (E, 1)):
        model = LinearModel(M=np.diag([*m, 0.0]), E=damping, K=K, B=B, C=C)
        small = eliminate_algebraic_unknowns(model.pencil)
        assert (small.size * small.degree, small.degree) == (2, degree)
        s = 1j * np.array([0.3, 2.0, 7.0])
        both = m.sum() * s**2 + s * np.trace(damping) + k.sum()
        own = m[0] * s**2 + s * damping[0, 0] + k[0]
        exact = np.stack([1 / both, 1 - own / both], axis=1)
        np.testing.assert_allclose(small.transfer(s)[:, :, 0], exact, rtol=1e-12)


def test_a_basis_of_motions_within_constraints():
    rng = np.random.default_rng(46)
    G = rng.standard_normal((4, 12))
    G[3] = G[0] - 2 * G[1]  # follows from two others
    G[:, 5] = 0.0
    Z, rank = compute_null_basis(G)
    assert (rank, Z.shape) == (3, (12, 9))
    assert np.abs(G @ Z).max() < 1e-13
    assert np.linalg.matrix_rank(Z.toarray()) == 9


@pytest.mark.parametrize("rank", [61, 120])
def test_infinite_poles_make_no_model_unstable(rank):
    """480 states and a rank of 242 are what a circuit simulator hands over; here a quarter."""
    n, m = rank, 2 * 61 - 2
    rng = np.random.default_rng(7)
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    A = -Q @ np.diag(np.geomspace(1e3, 1e6, n)) @ Q.T
    inner = rng.standard_normal((m, m)) + 3 * np.sqrt(m) * np.eye(m)
    B, C = rng.standard_normal((n, 1)), rng.standard_normal((1, n))
    left, right = (rng.standard_normal((n + m, n + m)) + 5 * np.eye(n + m) for _ in range(2))
    zero = np.zeros((n, m))
    big = np.block([[A, zero], [zero.T, -1e5 * inner]])
    mass = np.block([[np.eye(n), zero], [zero.T, np.zeros((m, m))]])
    drive = np.vstack([B, rng.standard_normal((m, 1))])
    see = np.hstack([C, rng.standard_normal((1, m))])
    model = LinearModel(A=left @ big @ right, E=left @ mass @ right, B=left @ drive, C=see @ right)
    small = deflate_infinite_poles(model.pencil)
    assert small.size == n
    rom = reduce_model(model, tolerance=1e-4, band=(0.0, 1e5 / (2 * np.pi)), norm="peak")
    assert rom.certificate.stable
    frequency = np.array([0.0, 77.0, 3.1e3, 1.5e4])
    s = 2j * np.pi * frequency
    direct = see[:, n:] @ np.linalg.solve(1e5 * inner, drive[n:])
    exact = np.array([(C @ np.linalg.solve(x * np.eye(n) - A, B) + direct)[0, 0] for x in s])
    found = rom.transfer(frequency)[:, 0, 0]
    assert np.abs(found - exact).max() <= 1e-4 * np.abs(exact).max()


def test_models_that_respond_to_derivatives_are_unchanged():
    """A constraint that is driven, whose multiplier is seen."""
    A = np.array([[-1.0, -1.0], [1.0, 0.0]])
    model = LinearModel(A=A, E=np.diag([1.0, 0.0]), B=np.eye(2)[:, [1]], C=np.eye(2)[[1]])
    assert eliminate_algebraic_unknowns(model.pencil).size == 2
