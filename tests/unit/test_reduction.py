"""Several reductions of one model: shared work, error estimates, reconstruction, optimality."""

import json
import warnings
from pathlib import Path

import mor_families as families
import numpy as np
import oracle
import pytest
from scipy import sparse
from scipy.linalg import solve_continuous_lyapunov
from support import (
    NORM_WORDS,
    PEAK_SHARE,
    RomKeys,
    UsageError,
    app,
    compare_methods,
    factor,
    read_rom,
    reduce_file,
)
from typer.testing import CliRunner

import kc2spice as kc
from bench.beam import steel_cantilever

TOLERANCES = 1e-2, 1e-3, 1e-4, 1e-5, 1e-6


def sparse_chain(dashpot):
    """Masses on springs, 1400 unknowns: real solutions, or complex ones with a ``dashpot``."""
    matrices = families.damped_chain(1400, dashpot, 3.0)
    if not dashpot:
        matrices = matrices | {"E": None, "rayleigh": (0.0, 1e-2)}
    return {key: sparse.csc_array(P) if key in "MEK" and P is not None else P
            for key, P in matrices.items()}  # fmt: skip


@pytest.fixture
def solved(monkeypatch):
    """Number of right-hand sides that are solved with factors of sparse matrices."""
    count, solve = [0], factor.Factor.solve

    def counted(self, rhs):
        count[0] += rhs.shape[1] if rhs.ndim > 1 else 1
        return solve(self, rhs)

    monkeypatch.setattr(factor.Factor, "solve", counted)
    return count


@pytest.mark.slow
@pytest.mark.parametrize("dashpot", [0.0, 0.3])
def test_five_tolerances_cost_at_most_a_fifth_more_than_one(dashpot, solved):
    model, band = kc.LinearModel(**sparse_chain(dashpot)), (0, 0.003)
    kc.Reduction(model, band=band).reduce(tolerance=min(TOLERANCES))
    one, solved[0] = solved[0], 0
    model = kc.LinearModel(**sparse_chain(dashpot))  # without factors
    reduction = kc.Reduction(model, band=band)
    orders = [reduction.reduce(tolerance=tolerance).order for tolerance in TOLERANCES]
    assert orders == sorted(orders)
    assert len(set(orders)) >= 4
    assert 0 < solved[0] <= 1.2 * one
    assert reduction.points
    solved[0] = 0
    for tolerance in TOLERANCES:
        kc.reduce(kc.LinearModel(**sparse_chain(dashpot)), tolerance=tolerance, band=band)
    assert solved[0] > 2.5 * one


def test_a_smaller_tolerance_extends_the_basis():
    model, band = kc.LinearModel(**sparse_chain(0.3)), (0, 0.003)
    reduction = kc.Reduction(model, band=band, tolerance=1e-2)
    points = reduction.points
    rom = reduction.reduce(tolerance=1e-6)  # of which rounding of the entries takes half
    assert len(reduction.points) > len(points)
    resonances = np.abs(rom.poles().imag) / (2 * np.pi)
    frequency = np.r_[np.linspace(0.0, 0.003, 20), resonances[resonances < 0.003]]
    exact = model.transfer(frequency)
    error = (np.abs(rom.transfer(frequency) - exact).max(axis=0) / np.abs(exact).max(axis=0)).max()
    assert error <= rom.certificate.error_estimate <= 1e-6


@pytest.mark.filterwarnings("ignore:IRKA of order")  # light damping
@pytest.mark.parametrize("method", [None, "balanced truncation", "IRKA"])
def test_error_is_the_estimate_of_the_model_of_that_order(method):
    model = kc.LinearModel(**families.chain(40))
    reduction = kc.Reduction(model, band=(0, 0.1), norm="peak", method=method)
    resonances = np.abs(model.poles().imag) / (2 * np.pi)
    frequency = np.r_[np.linspace(0.0, 0.1, 2000), resonances[resonances < 0.1]]
    exact = model.transfer(frequency)
    for order in (7, 8):
        rom = reduction.reduce(order=order)
        difference = np.abs(rom.transfer(frequency) - exact).max(axis=0)
        error = (difference / np.abs(exact).max(axis=0)).max()
        assert reduction.error(order) == pytest.approx(rom.certificate.error_estimate, rel=1e-9)
        assert error <= reduction.error(order) <= 1.5 * error


def bodies():
    """Models of each kind of intermediate model and of each form of a basis."""
    n = 60
    free = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    free[0, 0] = free[-1, -1] = 1.0
    body = {"M": np.eye(n), "K": free, "B": np.eye(n)[:, :2]}
    slowed = 0.01 * free + np.diag(np.r_[0.1, np.zeros(n - 1)])
    return {
        "small": (families.chain(40), 0.1),
        "definite": (sparse_chain(0.0), 0.003),
        "damped": (sparse_chain(0.3), 0.003),
        "free": (body | {"E": 0.01 * free}, 0.1),
        "slowed": (body | {"E": slowed}, 0.1),
    }


@pytest.mark.parametrize(
    ("name", "method"),
    [("small", None), ("small", "rational Krylov"), ("definite", None), ("damped", None),
     ("definite", "block Krylov"), ("free", None), ("slowed", None)],
)  # fmt: skip
def test_the_basis_of_a_congruence_gives_matrices_and_displacements(name, method):
    """``V'KV``, ``V'MV`` and ``V'B`` of the full-order model, and its states within 1 %."""
    matrices, top = bodies()[name]
    model = kc.LinearModel(**matrices)
    rom = kc.Reduction(model, band=(0, top), tolerance=1e-9).reduce(tolerance=1e-8, method=method)
    V, scale = rom.basis, np.abs(rom.K).max()
    assert V.shape == (model.order, rom.order)
    np.testing.assert_allclose(V.T @ (model.K @ V), rom.K, atol=1e-8 * scale)
    np.testing.assert_allclose(V.T @ (model.M @ V), rom.M, atol=1e-8 * np.abs(rom.M).max())
    np.testing.assert_allclose(V.T @ model.B, rom.B, atol=1e-8 * np.abs(rom.B).max())
    s = np.array([2j * np.pi * 0.4 * top])
    exact = model.pencil.states(s)[0]
    states = rom.reconstruct(rom.pencil.states(s)[0])
    assert np.abs(states - exact).max() < 1e-2 * np.abs(exact).max()


@pytest.mark.parametrize("name", ["small", "free"])
@pytest.mark.parametrize("method", ["balanced truncation", "frequency-limited balanced truncation"])
def test_displacements_of_a_balanced_model_are_those_of_the_full_model(name, method):
    matrices, top = bodies()[name]
    model = kc.LinearModel(**matrices)
    rom = kc.Reduction(model, band=(0, top), tolerance=1e-9, method=method, norm="peak").reduce(
        tolerance=1e-8
    )
    np.testing.assert_allclose(model.B.T @ rom.basis, rom.C, atol=1e-9 * np.abs(rom.C).max())
    s = np.array([2j * np.pi * 0.4 * top])
    exact = model.pencil.states(s)[0]
    states = rom.reconstruct(rom.pencil.states(s)[0])
    assert np.abs(states - exact).max() < 1e-2 * np.abs(exact).max()


def test_states_that_do_not_fit_and_models_without_a_basis_are_errors():
    model = kc.LinearModel(**families.chain(40))
    rom = kc.reduce(model, tolerance=1e-3, band=(0, 0.1))
    with pytest.raises(UsageError, match="states does not match"):
        rom.reconstruct(np.zeros(rom.order + 1))
    with pytest.raises(UsageError, match="no basis"):
        model.reconstruct(np.zeros(40))


def test_hankel_singular_values_are_those_of_the_gramians():
    rng = np.random.default_rng(5)
    A = np.diag(-np.geomspace(0.5, 20.0, 12)) + np.triu(rng.standard_normal((12, 12)), 1)
    B, C = rng.standard_normal((12, 2)), rng.standard_normal((3, 12))
    reach = solve_continuous_lyapunov(A, -B @ B.T)
    seen = solve_continuous_lyapunov(A.T, -C.T @ C)
    exact = np.sort(np.sqrt(np.abs(np.linalg.eigvals(reach @ seen))))[::-1]
    reduction = kc.Reduction(kc.LinearModel(A=A, B=B, C=C), band=(0, 2))
    np.testing.assert_allclose(reduction.hankel, exact, atol=1e-9 * exact[0])
    undamped = kc.LinearModel(M=np.eye(2), K=np.diag([1.0, 4.0]), B=np.ones((2, 1)))
    with pytest.raises(UsageError, match="no Hankel singular values"):
        kc.Reduction(undamped, band=(0, 0.1)).hankel  # noqa: B018


def test_points_are_interpolated_with_their_slopes():
    """The projection has the response and its slope at each point, as direct solutions do."""
    matrices = families.chain(40)
    model, points = kc.LinearModel(**matrices), [0.0, 0.03, 0.08]
    reduction = kc.Reduction(model, band=(0, 0.1), points=points)
    rom = reduction.reduce(order=18)  # of two ports: the static responses, and 8 at each pair
    step = 1e-5
    for point in points:
        near = np.array([point, point + step])
        exact, ours = model.transfer(near), rom.transfer(near)
        assert np.abs(ours[0] - exact[0]).max() < 1e-9 * np.abs(exact[0]).max()
        slope = np.abs(exact[1] - exact[0]).max()
        assert np.abs((ours[1] - ours[0]) - (exact[1] - exact[0])).max() < 1e-2 * slope
    for wrong in ([], [-1.0], [np.nan], "near", [[1], [2, 3]]):
        with pytest.raises(UsageError, match="not a list of expansion points"):
            kc.RationalKrylov(wrong)
    with pytest.raises(UsageError, match="method and points cannot be combined"):
        kc.Reduction(model, points=points, method="IRKA")


@pytest.mark.parametrize("order", [1, 4, 7])
def test_irka_meets_the_conditions_of_h2_optimality(order):
    """Response and slope in the directions of the residues, at the mirror images of the poles."""
    rng = np.random.default_rng(2)
    n, inputs, outputs = 20, 2, 3
    A = np.diag(-np.geomspace(0.3, 20.0, n)) + np.triu(rng.standard_normal((n, n)), 1)
    A[:2, :2] = [[-0.1, 2.0], [-2.0, -0.1]]
    B, C = rng.standard_normal((n, inputs)), rng.standard_normal((outputs, n))
    model = kc.LinearModel(A=A, B=B, C=C)
    rom = kc.reduce(model, order=order, band=(0, 1), norm="peak", method="IRKA")
    F = np.linalg.solve(rom.E, rom.A)
    poles, X = np.linalg.eig(F)
    left, right = (rom.C @ X).T, np.linalg.solve(X, np.linalg.solve(rom.E, rom.B))

    def response(s, A, B, C):
        """``H(s)`` and ``H'(s)``."""
        inverse = np.linalg.inv(s * np.eye(len(A)) - A)
        return C @ inverse @ B, -C @ inverse @ inverse @ B

    for pole, c, b in zip(poles, left, right, strict=True):
        H, slope = response(-pole, A, B, C)
        ours, our_slope = response(-pole, F, np.linalg.solve(rom.E, rom.B), rom.C)
        np.testing.assert_allclose(ours @ b, H @ b, atol=1e-6 * np.abs(H @ b).max())
        np.testing.assert_allclose(c @ ours, c @ H, atol=1e-6 * np.abs(c @ H).max())
        np.testing.assert_allclose(c @ our_slope @ b, c @ slope @ b, rtol=1e-5)


def test_structural_damping_is_left_to_kc_reduce():
    matrices = families.chain(40)
    lossy = kc.LinearModel(M=matrices["M"], K=matrices["K"] * (1 + 0.01j), B=matrices["B"])
    with pytest.raises(UsageError, match="structural damping"):
        kc.Reduction(lossy)


@pytest.mark.slow
def test_all_methods_are_compared_in_one_table(tmp_path):
    """States and estimates are those of each method alone; no files are written."""
    matrices = families.damped_chain(40, 0.3)
    np.savez(tmp_path / "chain.npz", **matrices)
    words = ["reduce", str(tmp_path / "chain.npz"), "--band", "0", "0.1", "--tolerance", "1e-3"]
    ran = CliRunner().invoke(app, [*words, "--method", "compare", "--json"])
    rows = {row["method"]: row for row in json.loads(ran.stdout)["methods"]}
    assert {"IRKA", "rational Krylov", "response POD", "block Krylov"} <= set(rows)
    assert rows["block Krylov"]["states"] is None
    assert "not proportional" in rows["block Krylov"]["reason"]
    alone = kc.reduce(
        kc.LinearModel(**matrices), tolerance=1e-3, band=(0, 0.1), norm="peak",
        method="balanced truncation",
    )  # fmt: skip
    assert rows["balanced truncation"]["states"] == alone.order
    assert rows["balanced truncation"]["error_estimate"] == pytest.approx(
        alone.certificate.error_estimate, rel=1e-6
    )
    assert [path.name for path in tmp_path.iterdir()] == ["chain.npz"]
    table = CliRunner().invoke(app, [*words, "--method", "compare"]).stdout
    assert "rational Krylov" in table
    wrong = CliRunner().invoke(app, [*words, "--method", "compare", "-o", str(tmp_path / "out")])
    assert wrong.exit_code == 2
    one = CliRunner().invoke(app, [*words, "--method", "IRKA", "--json", "-o", str(tmp_path / "o")])
    assert json.loads(one.stdout)["method"].startswith("IRKA; ")


def test_a_comparison_states_the_error_relative_to_peaks():
    """The error relative to peaks is that of dense solutions, and less than the pointwise one."""
    matrices, band = families.damped_chain(40, 0.3), (0.0, 0.1)
    model, full = kc.LinearModel(**matrices), oracle.system(matrices)
    reduction = kc.Reduction(model, band=band, norm="pointwise")
    rows = compare_methods(model, band=band, order=16, norm="pointwise")["methods"]
    stated = {row["method"]: row["peak_error"] for row in rows}
    for method in ("IRKA", "response POD", "balanced truncation"):
        rom = reduction.reduce(order=16, method=method)
        small = oracle.system_of(rom)
        error = oracle.largest_error(full, small, band, share=oracle.SHARES["peak"])
        assert error <= reduction.peak_error(rom) <= 1.5 * error
        assert reduction.peak_error(rom) < 0.5 * rom.certificate.error_estimate
        assert stated[method] == pytest.approx(reduction.peak_error(rom), rel=1e-3)
    assert stated["block Krylov"] is None


def cube(n):
    """An elastic cube of n^3 unknowns on a flexible support: trilinear elements."""
    stiff, mass = (
        sparse.diags_array([a, b, a], offsets=[-1, 0, 1], shape=(n, n))
        for a, b in ((-1.0, 2.0), (1 / 6, 2 / 3))
    )
    K = sum(
        sparse.kron(sparse.kron(*pair), last)
        for *pair, last in ((stiff, mass, mass), (mass, stiff, mass), (mass, mass, stiff))
    )
    M = sparse.kron(sparse.kron(mass, mass), sparse.eye_array(n))  # fewer entries than K
    B = np.zeros((n**3, 2))
    B[0, 0] = B[-1, 1] = 1.0
    order = np.random.default_rng(0).permutation(n**3)  # no narrow band
    K, M = (sparse.csc_array(P)[order][:, order] for P in (K, M))
    return kc.LinearModel(M=M, K=K, B=B[order], rayleigh=(0.0, 0.05))


def test_a_large_definite_model_has_one_order_and_one_expansion_point(monkeypatch):
    """The order of elimination of K serves the proof that M is semidefinite."""
    count, search = [0], factor._order_by_dissection

    def counted(matrix):
        count[0] += 1
        return search(matrix)

    monkeypatch.setattr(factor, "_order_by_dissection", counted)
    model = cube(18)
    assert model.order > factor.DISSECTION_UNKNOWNS
    reduction = kc.Reduction(model, band=(0, 0.08), tolerance=1e-3, norm="pointwise")
    rom = reduction.reduce(tolerance=1e-3)
    assert rom.certificate.stable
    assert rom.certificate.passive
    assert count[0] == 1
    assert reduction.points == (0.0,)
    frequency = np.array([0.0, 0.031, 0.0783])
    exact = model.transfer(frequency)
    assert (np.abs(rom.transfer(frequency) - exact) <= 1e-3 * np.abs(exact)).all()


@pytest.mark.parametrize("degree", [1, 2])
def test_a_second_order_model_prints_unknowns_and_first_order_states(tmp_path, degree):
    """Three unknowns of second order are six states of first order; both tables say which."""
    K = 2 * np.eye(20) - np.eye(20, k=1) - np.eye(20, k=-1)
    file, B = tmp_path / "chain.npz", np.eye(20)[:, :1]
    second = {"M": np.eye(20), "E": 0.05 * K, "K": K, "B": B}
    np.savez(file, **(second if degree == 2 else {"A": -K, "B": B, "C": B.T}))
    words = ["reduce", str(file), "--band", "0", "0.05", "--order", "3"]
    text = CliRunner().invoke(app, [*words, "-o", str(tmp_path / "out")]).stdout
    name = "unknowns" if degree == 2 else "states"
    row = next(line.split(maxsplit=1) for line in text.splitlines() if line.startswith(name))
    assert row[1].strip() == ("3 (6 first-order states)" if degree == 2 else "3")
    table = CliRunner().invoke(app, [*words, "--method", "compare"]).stdout.splitlines()
    heading = " ".join(word for line in table[1:3] for word in line.split())
    assert "first-order" in heading
    pod = next(line for line in table if line.startswith("response POD "))
    assert pod.removeprefix("response POD").split()[0] == str(3 * degree)


def make_gyroscopic_chain(n=12, spin=40.0):
    """Matrices of two planes of a supported chain whose disc couples the planes by its spin."""
    stiffness = 1e4 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    zero, disc = np.zeros((n, n)), np.zeros((n, n))
    disc[n // 3, n // 3] = spin
    K = np.block([[stiffness, zero], [zero, stiffness]])
    gyroscopic = np.block([[zero, disc], [-disc, zero]])
    B = np.eye(2 * n)[:, [n // 3, n + n // 3]]
    return {"M": np.eye(2 * n), "E": 1e-4 * K + gyroscopic, "K": K, "B": B}


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-5])
def test_signal_ports_give_the_fewest_states_of_all_default_methods(tolerance):
    """A gyroscopic model is passive, but signals have no power: the smallest model is returned."""
    model, band = kc.LinearModel(**make_gyroscopic_chain()), (0.0, 8.0)
    aims = {"tolerance": tolerance, "band": band}
    methods = ("response POD", "balanced truncation", "frequency-limited balanced truncation")
    states = []
    for method in methods:
        rom = kc.reduce(model, **aims, method=method)
        assert rom.certificate.reduction_method == method
        states.append(rom.order * (1 if rom.first_order else 2))
    rom = kc.reduce(model, **aims)
    assert min(states) < 0.9 * states[0]
    assert rom.order * (1 if rom.first_order else 2) <= min(states)
    assert rom.certificate.reduction_method in methods
    assert rom.certificate.stable
    resonances = np.abs(model.poles().imag) / (2 * np.pi)
    frequency = np.union1d(np.linspace(*band, 400), resonances[resonances < band[1]])
    exact, ours = (item.transfer(frequency) for item in (model, rom))
    assert (np.abs(ours - exact).max(axis=0) <= tolerance * np.abs(exact).max(axis=0)).all()


def test_the_certificate_contains_the_largest_error_at_a_notch(tmp_path):
    """The reference is a fine grid; the screen names the frequency and the option."""
    K = 2 * np.eye(40) - np.eye(40, k=1) - np.eye(40, k=-1)
    matrices = {"M": np.eye(40), "E": 0.02 * K, "K": K, "B": np.eye(40)[:, :1]}
    model = kc.LinearModel(**matrices)
    rom = kc.reduce(model, tolerance=1e-1, band=(0, 0.1))
    at, error = rom.certificate.pointwise
    frequency = np.union1d(np.linspace(0, 0.1, 20001), [at])
    exact, ours = (item.transfer(frequency)[:, 0, 0] for item in (model, rom))
    pointwise = np.abs(ours / exact - 1)
    assert error == pytest.approx(pointwise.max(), rel=0.02)
    assert pointwise[frequency == at][0] == pytest.approx(error, rel=1e-6)
    assert error > 3 * rom.certificate.error_estimate
    file = tmp_path / "chain.npz"
    np.savez(file, **matrices)
    words = ["reduce", str(file), "--band", "0", "0.1", "--tolerance", "0.1"]
    shown = CliRunner().invoke(app, [*words, "-o", str(tmp_path / "out")]).stdout
    text = " ".join(shown.split())
    assert "--norm pointwise limits this error" in text
    assert "method response POD error check difference from" in text
    back = read_rom(tmp_path / "out" / "chain_rom.npz").certificate
    assert back.pointwise == pytest.approx((at, error), rel=1e-6)
    assert back.reduction_method == "response POD"
    pointwise_rom = kc.reduce(model, tolerance=1e-1, band=(0, 0.1), norm="pointwise")
    assert pointwise_rom.certificate.pointwise is None
    assert pointwise_rom.certificate.error_estimate <= 0.1


def test_a_useless_order_warns_and_the_advice_works():
    """Two unknowns cannot represent dozens of resonances."""
    K = 2 * np.eye(40) - np.eye(40, k=1) - np.eye(40, k=-1)
    model = kc.LinearModel(M=np.eye(40), E=0.001 * K, K=K, B=np.eye(40)[:, :1])
    with pytest.warns(UserWarning, match="does not represent the full model.*tolerance, such as"):
        kc.reduce(model, order=2, band=(0, 0.25), norm="pointwise")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        kc.reduce(model, tolerance=1e-4, band=(0, 0.25), norm="pointwise")


def test_a_comparison_fits_into_80_columns_and_names_the_default(tmp_path):
    """Each reduced model has one line; the reasons of the other methods follow."""
    file = tmp_path / "rotor.npz"
    np.savez(file, **make_gyroscopic_chain())
    words = ["reduce", str(file), "--band", "0", "8", "--tolerance", "1e-3", "--method", "compare"]
    lines = CliRunner().invoke(app, words).stdout.splitlines()
    assert max(map(len, lines)) <= 80
    rows = [line for line in lines if line.startswith("frequency-limited balanced truncation ")]
    assert len(rows) == 1
    assert rows[0].split()[4] == "1st"
    assert "2nd*" in next(line for line in lines if line.startswith("response POD "))
    assert any(line.startswith("default: ") for line in lines)
    assert (
        "block Krylov" in lines[[*map(str.strip, lines)].index("Methods without a result") + 1 :][1]
    )


def test_a_comparison_of_an_unstable_model_warns_and_has_its_exit_code(tmp_path):
    """Masses with negative damping: the table stands on stdout, as of any other model."""
    K = 2 * np.eye(20) - np.eye(20, k=1) - np.eye(20, k=-1)
    file = tmp_path / "growing.npz"
    np.savez(file, M=np.eye(20), E=-0.05 * K, K=K, B=np.eye(20)[:, :1])
    words = ["reduce", str(file), "--band", "0", "0.05", "--tolerance", "1e-2"]
    with pytest.warns(UserWarning, match="the full model is unstable"):
        reduction = kc.Reduction(kc.read_model(file), band=(0, 0.05))
    assert reduction.stable is False
    ran = CliRunner().invoke(app, [*words, "--method", "compare"])
    assert ran.exit_code == 4
    assert "rational Krylov" in ran.stdout
    assert "the model is unstable" in ran.stderr
    assert "was written" not in ran.stderr


def test_a_warning_names_the_line_of_the_users_program():
    """The mass on a spring of negative stiffness is unstable."""
    unstable = kc.LinearModel(M=np.eye(2), K=np.diag([1.0, -1.0]), B=np.ones((2, 1)))
    with pytest.warns(UserWarning, match="unstable") as caught:
        kc.reduce(unstable, order=2, band=(0, 1))
    assert {item.filename for item in caught} == {__file__}
    line = Path(__file__).read_text(encoding="utf-8").splitlines()[caught[0].lineno - 1]
    assert line.strip() == "kc.reduce(unstable, order=2, band=(0, 1))"


def test_all_warnings_of_the_package_name_the_users_line():
    package = Path(kc.__file__).parent
    modules = [path for path in package.rglob("*.py") if "warnings.warn(" in path.read_text()]
    assert [path.name for path in modules] == ["user_warnings.py"]


@pytest.mark.parametrize("kind", ["mechanical", "signal", "method", "order"])
def test_reduce_prints_that_other_methods_may_need_fewer_states(tmp_path, kind):
    """For ports that exchange energy, balanced truncation is tried only in the comparison."""
    M, K, B = steel_cantilever(30)
    E = 1e-6 * K
    E[28, 28] += 0.5  # a dashpot in the middle
    np.savez(tmp_path / "chain.npz", M=M, E=E, K=K, B=B)
    if kind != "signal":
        text = '[[ports]]\nname = "tip"\nkind = "mechanical"\ncolumn = 1\n'
        (tmp_path / "chain.toml").write_text(text)
    words = ["reduce", str(tmp_path / "chain.npz"), "--band", "0", "500", "--norm", "peak"]
    words += ["--tolerance", "1e-3"] if kind != "order" else ["--order", "6"]
    extra = ["--method", "response POD"] if kind == "method" else []
    done = CliRunner().invoke(app, [*words, *extra, "-o", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    note = "note: other methods may need fewer states"
    assert (note in done.output) == (kind == "mechanical")
    if kind == "mechanical":
        assert "repeat the command with --method compare" in done.output
        compared = CliRunner().invoke(app, [*words, "--method", "compare", "--json"]).stdout
        states = {row["method"]: row["states"] for row in json.loads(compared)["methods"]}
        assert states["balanced truncation"] < states["default"]


def test_the_floor_of_the_norm_pointwise_is_stated_wherever_the_norm_is_described():
    """Errors at deeper notches are relative to a millionth of the peak."""
    assert PEAK_SHARE == 1e-6
    words = NORM_WORDS["pointwise"]
    assert words == "the response at each frequency or 1e-6 of its peak, whichever is larger"
    help_text = " ".join(CliRunner().invoke(app, ["reduce", "--help"]).stdout.split())
    assert words in help_text
    assert words in RomKeys.model_fields["norm"].description
    for function in (kc.reduce, reduce_file, kc.Certificate):
        assert "a millionth of" in function.__doc__
