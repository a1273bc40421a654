"""Sparse solvers against scipy's own, and what is said where an optional one is missing."""

import builtins

import numpy as np
import pytest
from scipy import io
from scipy.sparse.linalg import splu

from kc2spice.core.errors import MissingToolError, SimulationError
from kc2spice.linalg import factor
from kc2spice.linalg.factor import factorise, inverses
from kc2spice.rom.reduce import reduce
from laboratory.reduction_scaling import grid_model


@pytest.fixture(scope="module")
def solid():
    """A solid with three unknowns for each node."""
    return grid_model(1500, 3)


@pytest.fixture
def supernodal(monkeypatch):
    """Sparse factors of definite matrices, however narrow."""
    monkeypatch.setattr(factor, "NARROW", 0)


@pytest.mark.parametrize("kind", ["definite", "complex"])
def test_solutions_are_those_of_another_order(solid, kind, supernodal):
    shift = {"definite": 0.0, "complex": 0.2j}[kind]
    matrix = (solid.K + shift * solid.M).tocsc()
    rhs = np.random.default_rng(0).standard_normal((matrix.shape[0], 3)).astype(matrix.dtype)
    exact = splu(matrix).solve(rhs)
    if kind == "definite":
        found = factorise(matrix, definite=True).solve(rhs)
    else:
        forward, backward = inverses(matrix, symmetric=True)
        found = forward(rhs)
        np.testing.assert_allclose(backward(rhs), found, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9 * np.abs(exact).max())


def test_an_indefinite_matrix_is_not_taken_for_a_definite_one(solid, supernodal):
    with pytest.raises(SimulationError, match="cannot be factorised"):
        factorise((solid.K - 20.0 * solid.M).tocsc(), definite=True)


def test_reductions_are_the_same_by_pardiso(solid):
    pytest.importorskip("pypardiso")
    band, frequency = (0.0, 0.1), np.linspace(0.0, 0.1, 40)
    ours, theirs = (
        reduce(solid, band=band, order=10, solver=name).transfer(frequency)
        for name in ("scipy", "pardiso")
    )
    assert np.abs(ours - theirs).max() <= 1e-10 * np.abs(ours).max()


def test_a_missing_library_is_named_with_its_cure(tmp_path, monkeypatch, cli):
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name.startswith("pypardiso"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    model = grid_model(300, 2)
    with pytest.raises(MissingToolError, match=r"pip install 'kc2spice\[fast\]'"):
        reduce(model, tolerance=1e-3, band=(0.0, 1.0), solver="pardiso")
    for letter in "MEKB":
        with (tmp_path / f"plate.{letter}").open("wb") as stream:
            io.mmwrite(stream, getattr(model, letter))
    for solver, code, said in (("pardiso", 3, "kc2spice[fast]"), ("umfpack", 2, "scipy, pardiso")):
        ran = cli("reduce", "plate", "-o", "out", "--solver", solver)
        assert ran.exit_code == code
        assert said in ran.stderr
        assert not (tmp_path / "out").exists()
