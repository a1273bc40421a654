"""The optional direct solver gives what the default gives, or says that it is missing."""

import builtins

import numpy as np
import pytest
from scipy import io, sparse
from typer.testing import CliRunner

from kc2spice.cli.main import app
from kc2spice.core.errors import MissingToolError
from kc2spice.linalg.factor import inverses
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduce import reduce

N = 60


def grid_model(side, dimension):
    """Springs between all neighbours of a square or cubic grid of unit masses."""
    one = np.ones(side)
    line = sparse.diags_array([2 * one, -one[1:], -one[1:]], offsets=[0, 1, -1])
    K = line
    for _ in range(dimension - 1):
        K = sparse.kron(K, sparse.eye_array(side)) + sparse.kron(sparse.eye_array(K.shape[0]), line)
    K = sparse.csc_array(K)
    B = np.zeros((K.shape[0], 1))
    B[0, 0] = 1.0
    return LinearModel(M=sparse.eye_array(K.shape[0], format="csc"), E=0.01 * K, K=K, B=B)


@pytest.fixture
def pardiso():
    return pytest.importorskip("pypardiso")


def banded(kind):
    """Symmetric positive definite, indefinite or complex; and one that is not symmetric."""
    one = np.ones(N)
    matrix = sparse.diags_array([4 * one, -one[1:], -one[1:]], offsets=[0, 1, -1], format="csc")
    if kind == "indefinite":
        matrix = matrix - 4.0 * sparse.eye_array(N, format="csc")  # no diagonal is left
    return matrix + 1j * sparse.eye_array(N, format="csc") if kind == "complex" else matrix


def test_reductions_are_the_same(pardiso):
    model = grid_model(11, 3)
    band, frequency = (0.0, 0.1), np.linspace(0.0, 0.1, 40)
    found = [reduce(model, band=band, order=10, solver=name) for name in ("scipy", "pardiso")]
    s = 2j * np.pi * frequency[:, None, None]
    ours, theirs = (
        rom.C @ np.linalg.solve(s * s * rom.M + s * rom.E + rom.K, rom.B[None]) for rom in found
    )
    assert np.abs(ours - theirs).max() <= 1e-10 * np.abs(ours).max()


def test_a_missing_library_is_named_with_its_cure(tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name.startswith("pypardiso"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingToolError, match=r"pip install 'kc2spice\[fast\]'"):
        inverses(sparse.csc_array(banded("definite")), symmetric=True, solver="pardiso")
    with pytest.raises(MissingToolError):  # of a model too small to need it, too
        reduce(grid_model(2, 1), tolerance=1e-3, band=(0.0, 1.0), solver="pardiso")
    model = grid_model(17, 2).pencil
    K, E, M = model.coefficients
    for letter, matrix in {"M": M, "E": E, "K": K, "B": model.B}.items():
        with (tmp_path / f"plate.{letter}").open("wb") as stream:
            io.mmwrite(stream, matrix)
    command = ["reduce", str(tmp_path / "plate"), "-o", str(tmp_path / "out"), "--solver"]
    ran = CliRunner().invoke(app, [*command, "pardiso"])
    assert ran.exit_code == 3
    assert "kc2spice[fast]" in ran.stderr
    assert not (tmp_path / "out").exists()
    ran = CliRunner().invoke(app, [*command, "umfpack"])
    assert ran.exit_code == 2
    assert "scipy, pardiso" in ran.stderr
