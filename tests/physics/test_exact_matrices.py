"""What is certified is the model of the given matrices, to all their digits, though they be such
that 16 digits of a solution keep few: against elimination with 19 digits."""

import warnings

import numpy as np
import oracle
import pytest
from scipy.linalg import eigh
from support import LinearModel, reduce_model

from bench.beam import steel_cantilever


def eliminated(matrices, frequency):
    """(frequencies,) response by elimination with pivots in extended precision."""
    found = []
    for f in frequency:
        s = np.clongdouble(2j) * np.pi * np.longdouble(f)
        M, E, K, B, C = matrices
        A = s * s * M.astype(np.longdouble) + s * E.astype(np.longdouble) + K
        A, b = A.astype(np.clongdouble), B.astype(np.clongdouble)
        for k in range(len(A)):
            p = k + int(np.argmax(np.abs(A[k:, k])))
            A[[k, p]], b[[k, p]] = A[[p, k]], b[[p, k]]
            share = (A[k + 1 :, k] / A[k, k])[:, None]
            A[k + 1 :, k:] -= share * A[k, k:]
            b[k + 1 :] -= share * b[k]
        for k in range(len(A) - 1, -1, -1):
            b[k] = (b[k] - A[k, k + 1 :] @ b[k + 1 :]) / A[k, k]
        found.append(C @ b)
    return np.array(found)


@pytest.mark.parametrize(
    ("alpha", "beta"), [(0.0, 1e-5), pytest.param(2.0, 2e-6, marks=pytest.mark.slow)]
)
def test_an_ill_conditioned_beam_is_reduced_without_a_change_of_form(alpha, beta):
    """100 elements, condition 1e10: two solutions with 16 digits differ by 2e-5 of the response."""
    M, K, B = steel_cantilever(100)
    E = alpha * M + beta * K
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        rom = reduce_model(LinearModel(M=M, E=E, K=K, B=B), tolerance=1e-5, band=(1.0, 800.0))
    stated = rom.certificate.error_estimate
    assert stated <= 1e-5
    poles = np.sqrt(eigh(K, M, eigvals_only=True)[:4]) / (2 * np.pi)
    frequency = np.r_[poles, 1.02 * poles, 300.0, 800.0]
    exact = eliminated((M, E, K, B, B.T), frequency)
    found = eliminated((rom.M, rom.E, rom.K, rom.B, rom.C), frequency)
    largest = np.abs(exact).max()
    error = (np.abs(found - exact) / np.maximum(np.abs(exact), 1e-6 * largest)).max()
    assert error <= stated
    assert rom.order <= 12
    assert "rounding of the matrix entries changes the response by" in rom.certificate.method
    if alpha == 0:  # its lowest resonance is a hundred times sharper
        assert any("rounding of the matrix entries changes" in str(each.message) for each in said)


@pytest.mark.parametrize("ratio", [1e-6, pytest.param(1e-5, marks=pytest.mark.slow)])
def test_a_gyroscopic_model_is_within_its_error_at_sharp_resonances(ratio):
    """16 digits of the matrices leave some nine at a damping ratio of 2.6e-7."""
    rng = np.random.default_rng(8)
    n = 40
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    w = np.sort(np.exp(rng.uniform(0, 4, n)))
    G = 0.1 * rng.standard_normal((n, n))
    K, E = Q @ np.diag(w**2) @ Q.T, G - G.T + 2 * ratio * Q @ np.diag(w) @ Q.T
    M, K, B = np.eye(n), 0.5 * (K + K.T), rng.standard_normal((n, 2))
    band = 0.0, w[n // 3] * 1.03 / (2 * np.pi)
    rom = reduce_model(LinearModel(M=M, E=E, K=K, B=B), tolerance=1.8e-7, band=band)
    poles = oracle.poles((K, E, M)) / (2 * np.pi)
    poles = poles[(poles.imag > 0) & (poles.imag < band[1])]
    frequency = (poles.imag[:, None] + np.abs(poles.real[:, None]) * np.r_[-1, 0, 1]).ravel()
    exact = eliminated((M, E, K, B, B.T), frequency)
    found = rom.transfer(frequency)
    error = np.abs(found - exact) / np.maximum(np.abs(exact), 1e-6 * np.abs(exact).max(axis=0))
    assert error.max() <= rom.certificate.error_estimate <= 1.8e-7


def test_errors_evaluated_beside_resonances_are_reported():
    """Without damping there is no error on a resonance."""
    K = 2 * np.eye(20) - np.eye(20, k=1) - np.eye(20, k=-1)
    said = {}
    for loss in (0.0, 1e-3):
        model = LinearModel(M=np.eye(20), E=loss * K, K=K, B=np.eye(20)[:, [3]])
        method = reduce_model(model, tolerance=1e-3, band=(0.0, 0.1)).certificate.method
        said[loss] = "from the resonance" in method
    assert said == {0.0: True, 1e-3: False}


@pytest.mark.parametrize("elements", [pytest.param(40, marks=pytest.mark.slow), 60])
def test_a_beam_in_first_order_is_reduced_in_first_order(elements):
    """``inv(M) K`` spans 14 decades: neither its eigenvectors nor projections on orthonormal
    vectors keep a digit of the lowest modes."""
    M, K, B = steel_cantilever(elements)
    n = len(M)
    inner = np.linalg.solve(M, np.hstack([K, 2.0 * M + 1e-5 * K, B]))
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inner[:, :n], -inner[:, n : 2 * n]]])
    drive, read = np.vstack([0 * B, inner[:, 2 * n :]]), np.hstack([B.T, 0 * B.T])
    rom = reduce_model(LinearModel(A=A, B=drive, C=read), tolerance=1e-5, band=(1.0, 800.0))
    assert rom.order <= 24
    assert rom.certificate.stable
    frequency = np.array([1.3, 26.1, 77.0, 333.0, 790.0])
    exact = eliminated((0 * A, np.eye(2 * n), -A, drive, read), frequency)
    error = np.abs(rom.transfer(frequency) - exact).max() / 0.09  # its largest value, at 4.2 Hz
    assert error <= rom.certificate.error_estimate <= 1e-5
