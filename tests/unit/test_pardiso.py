"""PARDISO as the direct solver of a reduction, against scipy."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import splu
from support import MissingToolError, pardiso

import kc2spice as kc

N = 1500
STIFFNESS = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(N, N), format="csc")


@pytest.fixture
def library():
    try:
        pardiso._load_library()
    except MissingToolError:
        pytest.skip("the package mkl is not installed")


def saddle_point():
    """A symmetric matrix with zeros on its diagonal, whose pivots PARDISO replaces."""
    G = sparse.csc_array((np.ones(30), (np.arange(30), 7 * np.arange(30))), shape=(30, N))
    return sparse.csc_array(sparse.block_array([[STIFFNESS, G.T], [G, None]]))


# Eigenvalues of the stiffness are 2 - 2 cos(k pi / (N + 1)).
BELOW = int((2 - 2 * np.cos(np.arange(1, N + 1) * np.pi / (N + 1)) < 0.5).sum())
SKEW = sparse.diags_array([-0.3, 0.3], offsets=[-1, 1], shape=(N, N))
MATRICES = {
    "definite": (STIFFNESS, 0),
    "indefinite": (STIFFNESS - 0.5 * sparse.eye_array(N), BELOW),
    "saddle point": (saddle_point(), None),
    "complex symmetric": (STIFFNESS * (1 + 0.1j) - 0.01 * sparse.eye_array(N), None),
    "unsymmetric": (STIFFNESS + SKEW, None),
    "complex unsymmetric": (STIFFNESS + 1j * SKEW, None),
}


@pytest.mark.parametrize("kind", MATRICES)
def test_solutions_and_signs_of_eigenvalues(library, kind):
    matrix, negative = MATRICES[kind]
    matrix = sparse.csc_array(matrix)
    rhs = np.random.default_rng(1).standard_normal((matrix.shape[0], 3)).astype(matrix.dtype)
    factor = pardiso.Pardiso(matrix)
    exact = splu(matrix).solve(rhs)
    assert np.abs(factor.solve(rhs) - exact).max() <= 1e-9 * np.abs(exact).max()
    assert factor.negative_eigenvalues == negative


@pytest.mark.parametrize("damping", [{"E": 0.1 * STIFFNESS + 0.01 * STIFFNESS @ STIFFNESS},
                                     {"rayleigh": (0.0, 0.1)}])  # fmt: skip
def test_reductions_by_pardiso_are_those_of_the_built_in_solvers(library, damping):
    model = kc.LinearModel(M=sparse.eye_array(N), K=STIFFNESS, B=np.eye(N)[:, :1], **damping)
    target = {"tolerance": 1e-4, "band": (0, 0.002)}
    ours, plain = kc.reduce(model, **target, solver="pardiso"), kc.reduce(model, **target)
    frequency = np.linspace(0, 0.002, 30)
    exact = plain.transfer(frequency)
    assert ours.order == plain.order
    assert np.abs(ours.transfer(frequency) - exact).max() <= 2e-4 * np.abs(exact).max()
    assert ours.certificate.passive == plain.certificate.passive


def test_a_missing_library_is_an_error_with_the_command(monkeypatch):
    def missing(name):
        raise pardiso.importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(pardiso.importlib.metadata, "files", missing)
    monkeypatch.setattr(pardiso.ctypes.util, "find_library", lambda name: None)
    pardiso._load_library.cache_clear()
    model = kc.LinearModel(
        M=sparse.eye_array(N), K=STIFFNESS, E=STIFFNESS @ STIFFNESS, B=np.eye(N)[:, :1]
    )
    with pytest.raises(MissingToolError) as caught:
        kc.reduce(model, tolerance=1e-3, band=(0, 0.002), solver="pardiso")
    assert caught.value.hint == "pip install 'kc2spice[fast]'"
    pardiso._load_library.cache_clear()
