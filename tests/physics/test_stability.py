"""Stability that a certificate states is that of the full model, whatever the reduced one kept."""

import warnings

import numpy as np
import pytest

from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduce import reduce


def first_order(seed, pole):
    """Random stable poles, and one at ``pole`` that hardly shows between input and output."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(10, 50))
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + 0.5) * np.eye(n)
    A = np.block([[A, np.zeros((n, 1))], [np.zeros((1, n)), np.full((1, 1), pole)]])
    B = np.vstack([rng.standard_normal((n, 1)), [[1e-7]]])
    C = np.hstack([rng.standard_normal((1, n)), [[1e-3]]])
    T = rng.standard_normal((n + 1, n + 1)) + 3 * np.eye(n + 1)
    return np.linalg.solve(T, A @ T), np.linalg.solve(T, B), C @ T


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("pole", [1.0, -1.0])
def test_a_weak_growing_pole_is_told(seed, pole):
    A, B, C = first_order(seed, pole)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        rom = reduce(LinearModel(A=A, B=B, C=C), tolerance=1e-3, band=(0.0, 3.0))
    assert rom.order < len(A)
    assert rom.certificate.stable is (pole < 0)
    assert any("unstable" in str(each.message) for each in said) is (pole > 0)
