"""Natural frequencies that reduction looks for, against closed forms and dense eigenvalues."""

import numpy as np
import oracle
import pytest
from scipy import sparse
from scipy.linalg import eigvalsh
from support import (
    LinearModel,
    Response,
    SimulationError,
    UsageError,
    choose_natural_band,
    compute_elastic_eigenvalues,
)
from support import factor as factors
from support import pencil as pencils

STIFFNESS, MASS = 4e6, 1e-6


def links(n):
    K = sparse.diags_array([-np.ones(n - 1), 2 * np.ones(n), -np.ones(n - 1)], offsets=(-1, 0, 1))
    return STIFFNESS * K.tocsc()


@pytest.mark.parametrize("n", [3, 150, 400])
@pytest.mark.parametrize("order", [1, 2])
def test_a_band_ends_a_tenth_above_the_fifth_frequency(n, order):
    """Of a chain between walls ``2 sqrt(k/m) sin(j pi / (2 (n + 1)))``; its square for heat."""
    one, K, B = MASS * sparse.eye_array(n, format="csc"), links(n), np.eye(n)[:, [0]]
    if order == 1:
        model = LinearModel(E=one, A=-K, B=B, C=B.T)
    else:
        model = LinearModel(M=one, E=1e-3 * one + 1e-4 * sparse.diags_array(B.ravel()), K=K, B=B)
    rate = 2 * np.sqrt(STIFFNESS / MASS) * np.sin(min(n, 5) * np.pi / (2 * (n + 1)))
    low, high = choose_natural_band(model.pencil)
    assert low == 0.0
    assert high == pytest.approx(1.1 * (rate**2 if order == 1 else rate) / (2 * np.pi), rel=1e-3)


@pytest.mark.parametrize("free", [False, True])
def test_frequencies_of_large_models_need_no_pivots(monkeypatch, free):
    """The shifted stiffness of a supported and of a free grid of masses is definite."""
    monkeypatch.setattr(factors, "DISSECTION_UNKNOWNS", 100)
    monkeypatch.setattr(pencils, "QUASI_DEFINITE_UNKNOWNS", 0)
    monkeypatch.setattr(factors, "factorise_two_sided", pytest.fail)
    line, cross = links(20).tolil(), links(15).tolil()
    for matrix in (line, cross) if free else ():
        matrix[0, 0] = matrix[-1, -1] = STIFFNESS
    K, one = sparse.csc_array(sparse.kronsum(line, cross)), MASS * sparse.eye_array(300)
    pencil = LinearModel(M=sparse.csc_array(one), K=K, B=np.eye(300)[:, [0]]).pencil
    values = eigvalsh(K.toarray()) / MASS
    assert compute_elastic_eigenvalues(pencil, 4) == pytest.approx(
        values[free : 4 + free], rel=1e-6
    )


def test_a_model_without_stiffness_suggests_no_band():
    one = np.eye(2)
    with pytest.raises(UsageError, match="no natural frequency"):
        choose_natural_band(LinearModel(M=one, K=np.zeros((2, 2)), B=one).pencil)


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("dashpot", [0.0, 0.3])
def test_resonances_are_those_of_the_matrices(free, dashpot):
    """Of sixty models of six unknowns; rounding makes the stiffness of some free ones definite."""
    n = 6
    for seed in range(60):
        rng = np.random.default_rng(seed)
        root, spread = rng.standard_normal((n, n)), rng.standard_normal((n, n - free))
        M, K = root @ root.T + np.eye(n), 10 ** rng.uniform(-3, 6) * spread @ spread.T
        first = np.zeros((n, n))
        first[0, 0] = dashpot * np.sqrt(K[0, 0] * M[0, 0])
        model = LinearModel(M=M, E=first, K=K, B=np.eye(n)[:, [0]])
        response = Response(model.pencil)
        frequency, ratio = response.resonances
        if dashpot:
            poles = oracle.poles((K, first, M))
            top = abs(poles).max()
            exact = np.sort(poles.imag[poles.imag > 1e-7 * top])
            sharp = frequency * 2 * np.pi > 1e-7 * top
            frequency, ratio = frequency[sharp], ratio[sharp]
            assert ratio.max() > 1e-3
        else:
            exact = np.sqrt(eigvalsh(K, M)[free:])
            moving = frequency * 2 * np.pi > 1e-6 * exact[-1]
            frequency = frequency[moving]
        np.testing.assert_allclose(2 * np.pi * np.sort(frequency), exact, rtol=1e-5, err_msg=seed)


def test_a_response_at_a_pole_is_an_error_with_the_frequency():
    K = np.array([[1.0, -1.0], [-1.0, 1.0]])
    with pytest.raises(SimulationError) as caught:
        LinearModel(M=np.eye(2), K=sparse.csc_array(K), B=np.eye(2)).pencil.factorise_polynomial(
            0.0
        )
    assert "at s = 0" in caught.value.got
