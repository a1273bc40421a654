"""Large sparse matrices: definiteness without a factor, and kernels for the processor."""

import os

import numpy as np
import pytest
from scipy import sparse
from support import openblas_kernels, stability

SIDE = 20  # nodes of a cube in each direction: 8 000 unknowns


def mass():
    """Consistent mass matrix of a cube of trilinear hexahedra, the product of three of lines."""
    line = sparse.diags_array(
        [np.full(SIDE - 1, 1 / 6), np.r_[1 / 3, np.full(SIDE - 2, 2 / 3), 1 / 3],
         np.full(SIDE - 1, 1 / 6)], offsets=[-1, 0, 1],
    )  # fmt: skip
    return sparse.csc_array(sparse.kron(sparse.kron(line, line), line))


@pytest.fixture
def no_factors(monkeypatch):
    def refuse(*_, **__):
        pytest.fail("a matrix was factorised")

    monkeypatch.setattr(stability, "factorise", refuse)


def test_a_mass_matrix_is_shown_to_be_definite_without_a_factor(no_factors):
    """It is definite, as the product of three definite matrices of lines."""
    assert stability.is_semidefinite(mass())
    rows = sparse.block_diag([mass(), sparse.csc_array((500, 500))], format="csc")
    assert stability.is_semidefinite(rows)  # massless unknowns are left out


@pytest.mark.parametrize("depth", [1e-6, 1e-2, 1.0])
def test_a_matrix_with_one_negative_eigenvalue_is_not(depth):
    """Shifted below zero by ``depth`` of its size along one vector of many unknowns."""
    M = mass()
    x = np.zeros(M.shape[0])
    x[1234:1242] = np.array([1, -1, 1, -1, 1, -1, 1, -1]) / np.sqrt(8)
    energy = float(x @ (M @ x))
    column = sparse.csc_array(x[:, None])
    wrong = sparse.csc_array(M - (energy * (1 + depth)) * (column @ column.T) * 1.2)
    assert float(x @ (wrong @ x)) < 0
    assert not stability.is_semidefinite(wrong)


def test_a_singular_matrix_needs_its_factor():
    """The least Ritz value tends to zero, which Lanczos steps cannot tell from below zero."""
    n = 6000
    line = sparse.diags_array(
        [np.full(n - 1, -1.0), np.r_[1.0, np.full(n - 2, 2.0), 1.0], np.full(n - 1, -1.0)],
        offsets=[-1, 0, 1], format="csc",
    )  # fmt: skip
    D = sparse.diags_array(1 / np.sqrt(line.diagonal()))
    scaled = sparse.csc_array(D @ line @ D)
    assert not stability._is_positive_by_lanczos(scaled, np.zeros(n, dtype=bool), 2.0)
    assert stability.is_semidefinite(line)


def test_kernels_follow_the_processor_and_the_user(monkeypatch):
    monkeypatch.delenv(openblas_kernels.CORE_TYPE_VARIABLE, raising=False)
    skylake = openblas_kernels.KERNELS["SkylakeX"] | {"sse2"}
    assert openblas_kernels.select_kernels(skylake) == "SkylakeX"
    assert openblas_kernels.select_kernels(skylake - {"avx512vl"}) == "Haswell"
    assert openblas_kernels.select_kernels({"sse2"}) is None
    monkeypatch.setattr(openblas_kernels, "read_processor_flags", lambda: skylake)
    with openblas_kernels.use_fast_kernels():
        assert os.environ[openblas_kernels.CORE_TYPE_VARIABLE] == "SkylakeX"
    assert openblas_kernels.CORE_TYPE_VARIABLE not in os.environ
    monkeypatch.setenv(openblas_kernels.CORE_TYPE_VARIABLE, "Zen")
    with openblas_kernels.use_fast_kernels():
        assert os.environ[openblas_kernels.CORE_TYPE_VARIABLE] == "Zen"
