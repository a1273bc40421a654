"""Factors of quasi-definite matrices against solutions and eigenvalues by numpy and scipy."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve
from support import QuasiDefiniteFactor, factorise_quasi_definite, find_supernodes
from support import factor as factors


def grid(sides):
    """Laplacian of a grid with a support at every node, and its number of nodes."""
    parts = [
        sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(side, side))
        for side in sides
    ]
    total = sparse.csc_array(parts[0])
    for part in parts[1:]:
        total = sparse.kronsum(total, part)
    return sparse.csc_array(total + 0.01 * sparse.eye_array(total.shape[0]))


def piezo(sides, seed=0):
    """Quasi-definite matrix of two displacements and one potential at each node of a grid."""
    rng = np.random.default_rng(seed)
    stiffness = sparse.kron(grid(sides), [[2.0, 0.5], [0.5, 1.0]])
    permittivity = 1e-2 * grid(sides)
    pattern = sparse.kron(grid(sides), np.ones((2, 1)))
    coupling = sparse.csc_array(pattern)
    coupling.data = rng.standard_normal(coupling.nnz)
    blocks = [[stiffness, coupling], [coupling.T, -permittivity]]
    return sparse.csc_array(sparse.block_array(blocks))


def random_factor(matrix, seed=0):
    """Factor in a random order, each unknown being a group."""
    n = matrix.shape[0]
    order = np.random.default_rng(seed).permutation(n)
    return QuasiDefiniteFactor(matrix, matrix.diagonal() < 0, np.arange(n), order)


@pytest.mark.parametrize("columns", [(), (1,), (5,)])
@pytest.mark.parametrize("sides", [(1,), (7,), (9, 8), (6, 5, 4)])
def test_solutions_agree_with_those_of_scipy(sides, columns):
    matrix = piezo(sides)
    rhs = np.random.default_rng(1).standard_normal((matrix.shape[0], *columns))
    exact = spsolve(matrix, rhs).reshape(rhs.shape)
    assert random_factor(matrix).solve(rhs) == pytest.approx(exact, rel=1e-9, abs=1e-9)


def test_matrices_of_separate_parts_are_solved():
    matrix = sparse.csc_array(sparse.block_diag([piezo((5, 4)), piezo((3,)), [[2.0]], [[-3.0]]]))
    rhs = np.random.default_rng(1).standard_normal(matrix.shape[0])
    assert random_factor(matrix).solve(rhs) == pytest.approx(spsolve(matrix, rhs), rel=1e-9)


def test_groups_of_unknowns_are_eliminated_together():
    matrix = piezo((8, 7))
    nodes = 56
    group = np.r_[np.repeat(np.arange(nodes), 2), np.arange(nodes)]
    order = np.argsort(np.random.default_rng(2).permutation(nodes)[group], kind="stable")
    factor = QuasiDefiniteFactor(matrix, matrix.diagonal() < 0, group, order)
    rhs = np.random.default_rng(1).standard_normal((matrix.shape[0], 2))
    assert factor.solve(rhs) == pytest.approx(spsolve(matrix, rhs), rel=1e-9, abs=1e-9)


def test_supernodes_contain_the_pattern_of_the_factor():
    matrix = grid((9, 9))
    n = matrix.shape[0]
    order, nodes = find_supernodes(matrix, np.arange(n), np.random.default_rng(3).permutation(n))
    assert sorted(order) == list(range(n))
    L = np.linalg.cholesky(matrix.toarray()[np.ix_(order, order)])
    stored = np.zeros((n, n), bool)
    for node in nodes:
        stored[node.begin : node.end, node.begin : node.end] = True
        stored[node.rows, node.begin : node.end] = True
        assert node.rows.size == 0 or node.parent > nodes.index(node)
    assert not (np.abs(L) > 1e-14)[~stored].any()


def test_a_block_of_the_wrong_sign_is_refused():
    matrix = piezo((6, 6)).tolil()
    matrix[3, 9] = matrix[9, 3] = 50.0  # its diagonal remains positive
    with pytest.raises(RuntimeError, match="quasi-definite"):
        random_factor(sparse.csc_array(matrix))


def test_factors_of_large_matrices_have_the_correct_inertia(monkeypatch):
    monkeypatch.setattr(factors, "DISSECTION_UNKNOWNS", 100)
    matrix = piezo((9, 8))
    factor = factorise_quasi_definite(matrix)
    assert factor.negative == (np.linalg.eigvalsh(matrix.toarray()) < 0).sum() == 72
    rhs = np.random.default_rng(1).standard_normal(matrix.shape[0])
    assert factor.solve(rhs) == pytest.approx(spsolve(matrix, rhs), rel=1e-9)


def test_other_symmetric_matrices_are_factorised_with_pivots(monkeypatch):
    monkeypatch.setattr(factors, "DISSECTION_UNKNOWNS", 100)
    matrix = sparse.csc_array(grid((12, 12)) - 0.7 * sparse.eye_array(144))
    factor = factorise_quasi_definite(matrix)
    assert factor.negative is None
    rhs = np.random.default_rng(1).standard_normal(144)
    assert factor.solve(rhs) == pytest.approx(spsolve(matrix, rhs), rel=1e-8)
