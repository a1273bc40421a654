"""Direct solvers that a user supplies for a reduction, and the errors of wrong ones."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import splu
from support import MissingToolError, SimulationError, UsageError, app, pardiso
from typer.testing import CliRunner

import kc2spice as kc

N = 2000
STIFFNESS = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(N, N), format="csc")
MASS = sparse.eye_array(N, format="csc")
ENDS = np.eye(N)[:, [0]]
BAND = (0, 0.002)


def chain(**others):
    """Masses between springs, with damping that needs complex factors."""
    matrices = {"M": MASS, "K": STIFFNESS, "B": ENDS} | others
    if "rayleigh" not in matrices:
        matrices["E"] = 0.1 * STIFFNESS + 0.01 * STIFFNESS @ STIFFNESS
    return kc.LinearModel(**matrices)


class Recorder:
    """SuperLU that counts its matrices and states a number of negative eigenvalues."""

    def __init__(self, negative_eigenvalues=None):
        self.matrices = []
        self.negative_eigenvalues = negative_eigenvalues

    def __call__(self, matrix):
        self.matrices.append(matrix)
        factor = Factor(splu(matrix).solve)
        if self.negative_eigenvalues is not None:
            factor.negative_eigenvalues = self.negative_eigenvalues
        return factor


class Factor:
    """An object with one method."""

    def __init__(self, solve):
        self.solve = solve


def direct(model, frequency):
    """Response by scipy alone."""
    parts = [1.0, *(2j * np.pi * frequency) ** np.arange(1, 3)]
    P = sum(s * matrix for s, matrix in zip(parts, (model.K, model.E, model.M), strict=True))
    return model.C @ splu(P.tocsc()).solve(model.B.astype(complex))


@pytest.mark.parametrize("outputs", [ENDS.T, np.eye(N)[[1]]])
def test_a_supplied_solver_makes_all_factors_of_a_damped_model(outputs):
    solver, model = Recorder(), chain(C=outputs)
    target = {"tolerance": 1e-4, "band": BAND, "norm": "pointwise"}
    rom = kc.reduce(model, **target, solver=solver)
    assert any(np.iscomplexobj(matrix) for matrix in solver.matrices)
    for frequency in (0.0004, 0.0011, 0.0019):
        exact, found = direct(model, frequency), rom.transfer([frequency])[0]
        assert (np.abs(found - exact) <= rom.certificate.error_estimate * np.abs(exact)).all()
    plain = kc.reduce(chain(C=outputs), **target)
    assert plain.order == rom.order


def test_definite_matrices_need_a_count_of_negative_eigenvalues(monkeypatch):
    """Without the count, the Cholesky factor of kc2spice proves that they are definite."""
    from support import factor

    cholesky = []
    original = factor._factorise_banded
    monkeypatch.setattr(
        factor, "_factorise_banded", lambda *args: cholesky.append(1) or original(*args)
    )
    for count, needs_cholesky in ((None, True), (0, False)):
        cholesky.clear()
        rom = kc.reduce(
            chain(rayleigh=(0.0, 0.1)), tolerance=1e-3, band=BAND, solver=Recorder(count)
        )
        assert bool(cholesky) is needs_cholesky
        assert rom.certificate.passive


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("solver", [splu, Recorder(1)])
def test_an_indefinite_stiffness_is_not_taken_for_a_definite_one(solver):
    """An LU factor exists, and proves nothing."""
    support = sparse.csc_array(([-2.5], ([N - 1], [N - 1])), shape=(N, N))
    model = chain(K=STIFFNESS + support, rayleigh=(0.0, 0.1))
    rom = kc.reduce(model, tolerance=1e-3, band=BAND, solver=solver)
    assert not rom.certificate.stable
    assert not rom.certificate.passive


def test_a_reduction_uses_its_solver_for_every_tolerance():
    solver = Recorder()
    reduction = kc.Reduction(chain(), band=BAND, tolerance=1e-2, solver=solver)
    before = len(solver.matrices)
    reduction.reduce(tolerance=1e-4)
    assert 0 < before < len(solver.matrices)


def no_solve(matrix):
    return matrix


def wrong_shape(matrix):
    return Factor(lambda rhs: rhs[:, 0])


def broken(matrix):
    return Factor(lambda rhs: rhs.no_such_attribute)


def hermitian(matrix):
    """A frequent error: the factor of another matrix."""
    return splu(matrix.conj() if np.iscomplexobj(matrix) else matrix)


@pytest.mark.parametrize(
    ("solver", "text"),
    [
        ("mumps", "not a direct solver"),
        (no_solve, "without a method solve"),
        (wrong_shape, "array of a wrong type or shape"),
        (broken, "no_such_attribute"),
    ],
)
def test_a_wrong_solver_is_refused(solver, text):
    with pytest.raises(UsageError, match=text):
        kc.reduce(chain(), tolerance=1e-3, band=BAND, solver=solver)


def test_an_inaccurate_solver_is_refused():
    with pytest.raises(SimulationError, match="inaccurate"):
        kc.reduce(chain(), tolerance=1e-3, band=BAND, solver=hermitian)


@pytest.fixture
def matrices(tmp_path):
    parts = {"K": STIFFNESS, "M": MASS, "E": 0.1 * STIFFNESS}
    arrays = {"B": ENDS}
    for letter, matrix in parts.items():
        matrix = matrix.tocoo()
        arrays |= {f"{letter}.data": matrix.data, f"{letter}.shape": np.array(matrix.shape)}
        arrays |= {f"{letter}.row": matrix.row, f"{letter}.col": matrix.col}
    np.savez(tmp_path / "chain.npz", **arrays)
    return tmp_path


def _call(folder, *words):
    command = ["reduce", str(folder / "chain.npz"), "--band", "0", "0.002", *words]
    return CliRunner().invoke(app, [*command, "--out", str(folder / "out")])


def test_the_command_line_uses_the_named_solver(matrices, monkeypatch):
    recorder = Recorder()
    monkeypatch.setattr(pardiso, "Pardiso", recorder)
    monkeypatch.setattr(pardiso, "_load_library", lambda: None)
    result = _call(matrices, "--solver", "pardiso")
    assert result.exit_code == 0, result.output
    assert recorder.matrices


def test_a_missing_solver_names_the_line_that_installs_it(matrices, monkeypatch):
    monkeypatch.setattr(pardiso.importlib.metadata, "files", lambda name: [])
    monkeypatch.setattr(pardiso.ctypes.util, "find_library", lambda name: None)
    pardiso._load_library.cache_clear()
    result = _call(matrices, "--solver", "pardiso")
    assert result.exit_code == MissingToolError.exit_code
    assert "pip install 'kc2spice[fast]'" in result.output


@pytest.mark.parametrize("command", ["reduce", "export"])
def test_an_unknown_name_of_a_solver_is_refused(matrices, command):
    words = [str(matrices / "chain.npz")] if command == "reduce" else ["impact"]
    result = CliRunner().invoke(app, [command, *words, "--solver", "paradiso"])
    assert result.exit_code == UsageError.exit_code
    assert "--solver: this direct solver does not exist" in result.output
    assert "expected: one of pardiso" in result.output
