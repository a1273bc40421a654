"""Stability that a certificate states is that of the full model, whatever the reduced one kept."""

import json
import warnings

import numpy as np
import pytest
from typer.testing import CliRunner

from kc2spice.cli.main import app
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


def test_a_large_model_without_form_is_not_known(tmp_path):
    """In the certificate, in the words of the command and in its JSON."""
    n = 1300
    A = np.diag(-np.linspace(1, 50, n)) + np.diag(np.tile([100.0, 0.0], n // 2)[:-1], 1)
    A[-1, 0] = 1e-3  # no triangle, which would be half of a matrix
    B, C = np.ones((n, 1)), np.r_[np.ones(n // 2), np.zeros(n - n // 2)][None]
    np.savez(tmp_path / "flow.npz", A=A, B=B, C=C)
    words = ["reduce", str(tmp_path / "flow.npz"), "--band", "0", "1", "--tolerance", "1e-2"]
    done = CliRunner().invoke(app, [*words, "-o", str(tmp_path / "out"), "--json"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert found["stable"] is None
    assert "1300 states are too many" in found["method"]
    done = CliRunner().invoke(app, [*words, "-o", str(tmp_path / "out")])
    assert "not known" in done.stdout
    again = CliRunner().invoke(app, ["export", "--rom", found["rom"], "-o", str(tmp_path / "lib")])
    assert again.exit_code == 0, again.output
