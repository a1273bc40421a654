"""Where a response is looked at, and how errors are measured, against closed forms."""

import numpy as np
import pytest

from kc2spice.core.errors import SimulationError
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.response import (
    FLOOR,
    Judge,
    Response,
    telling,
)  # fmt: skip

TWO_PI = 2 * np.pi


def resonators(hertz, ratio, B, C=None, D=None):
    """Pencil of unit masses on springs, resonant at ``hertz``."""
    w = TWO_PI * np.asarray(hertz, dtype=float)
    B = np.asarray(B, dtype=float)
    C = B.T if C is None else np.asarray(C, dtype=float)
    D = np.zeros((len(C), B.shape[1])) if D is None else np.asarray(D, dtype=float)
    parts = np.diag(w**2), np.diag(2 * np.broadcast_to(ratio, w.shape) * w), np.eye(len(w))
    return Pencil(parts, B, C, D)


def direct(pencil, s):
    """``C P(s)^-1 B + D`` by numpy's solver."""
    P = sum(s[:, None, None] ** k * each for k, each in enumerate(pencil.coefficients))
    return pencil.C @ np.linalg.solve(P, pencil.B.astype(complex)[None]) + pencil.D


# ------------------------------------------------------------------------------- frequencies


def test_each_of_many_notches_is_found():
    """Between two resonances of a driving point lies a zero: 149 of them in the band."""
    hertz = np.arange(1.0, 151.0)
    response = Response(resonators(hertz, 0.0, np.ones((150, 1))))
    frequency = telling(response, (0.5, 150.5), False)
    size = np.abs(response.transfer(2j * np.pi * frequency))[:, 0, 0]
    between = (np.floor(frequency) == each for each in hertz[:-1])
    assert max(size[inside].min() for inside in between) < FLOOR * size.max()
    assert (np.diff(frequency) > 1e-12 * frequency[1:]).all()  # or a maximum hides beside its twin


# --------------------------------------------------------------------------------- responses


def full(n, rng):
    return rng.standard_normal((n, n)) + 3 * n * np.eye(n)


@pytest.mark.parametrize("n", [3, 13, 30])
@pytest.mark.parametrize("form", ["decoupled", "coupled", "first order", "heat", "free"])
def test_a_response_is_that_of_the_matrices(form, n):
    rng = np.random.default_rng(n)
    root, other = rng.standard_normal((2, n, n))
    K, M = root @ root.T + np.eye(n), other @ other.T + np.eye(n)
    parts = {
        "decoupled": (K, 0.01 * K + 0.1 * M, M),
        "coupled": (K, 0.1 * full(n, rng), M),
        "first order": (full(n, rng), full(n, rng)),
        "heat": (K, M),
        "free": (root[:, 1:] @ root[:, 1:].T, 0 * K, M),
    }[form]
    pencil = Pencil(parts, *(rng.standard_normal(s) for s in ((n, 2), (3, n), (3, 2))))
    response = Response(pencil)
    assert response.decoupled is (form in ("decoupled", "heat", "free"))
    assert (response.modes is None) is (n == 3 and not response.decoupled)
    s = np.array([0.3j, 1.0 + 2j, 20j])
    exact = direct(pencil, s)
    np.testing.assert_allclose(response.transfer(s), exact, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(
        pencil.C @ response.states(s) + pencil.D, exact, rtol=1e-8, atol=1e-10
    )


def test_a_defective_model_is_not_taken_apart():
    """A chain of equal first-order lags has one eigenvector; that of a free mass has two poles."""
    n = 14
    lags = Pencil((np.eye(n) - np.eye(n, k=1), np.eye(n)), np.eye(n)[:, [-1]], np.eye(n)[[0]],
                  np.zeros((1, 1)))  # fmt: skip
    response = Response(lags)
    assert response.modes is None
    np.testing.assert_allclose(response.transfer(np.array([1j]))[0, 0, 0], (1 + 1j) ** -n)


# ------------------------------------------------------------------------------------ errors


def bent(pencil, size, hertz, width):
    """``pencil`` whose response is off by up to about ``size`` around ``hertz``."""

    class Bent(Response):
        def transfer(self, s):
            off = size * np.exp(-(((s.imag / TWO_PI - hertz) / width) ** 2))
            return super().transfer(s) * (1 + off[:, None, None])

    return Bent(pencil)


def test_the_largest_error_is_found_between_the_frequencies():
    pencil = resonators([1000.0], 0.1, [[1.0]])
    judge = Judge(Response(pencil), np.linspace(0.0, 100.0, 11), (0.0, 100.0))
    between = judge.error(bent(pencil, 1e-3, 54.4, 3.0))  # the nearest see 1.1e-4 and 2.9e-5
    assert between == pytest.approx(1e-3, rel=1e-3)
    fine = Judge(Response(pencil), np.linspace(0.0, 100.0, 201), (0.0, 100.0))
    for hertz in (0.2, 99.8):  # beside the first or the last one
        assert fine.error(bent(pencil, 1e-3, hertz, 0.15)) == pytest.approx(1e-3, rel=1e-2)
    for hertz in (-1.0, 101.0):  # at an end it is largest there
        at_the_end = judge.error(bent(pencil, 1e-3, hertz, 3.0))
        assert at_the_end == pytest.approx(1e-3 * np.exp(-1 / 9), rel=1e-6)
    assert judge.error(Response(pencil)) == 0.0


# kinds as files spell them: equal words, not the same objects


def test_a_pole_among_the_frequencies_is_an_error():
    with pytest.raises(SimulationError, match="pole"):
        LinearModel(M=np.eye(1), K=np.zeros((1, 1)), B=np.eye(1)).transfer(np.zeros(1))
