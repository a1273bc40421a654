"""Methods of reduction against their theory: moments, interpolation, bounds by singular values."""

import mor_families as families
import numpy as np
import oracle
import pytest
from scipy.linalg import eigh, schur, solve_continuous_lyapunov
from support import (
    BalancedTruncation,
    BlockKrylov,
    RationalKrylov,
    ReductionTask,
    UsageError,
    _compute_gramian_root,
    build_intermediate_model,
    registry,
)

import kc2spice as kc

METHODS = (
    "response POD", "response POD of both sides", "balanced truncation",
    "frequency-limited balanced truncation", "rational Krylov", "block Krylov",
)  # fmt: skip


def chain(n=40):
    """Masses of 1 kg on springs of 1 N/m, driven at one end and in the middle."""
    return families.chain(n), 0.1


def task_of(matrices, top, norm="peak", tolerance=1e-6):
    """The task of a model over a band from zero."""
    full = kc.LinearModel(**matrices)
    band = 0.0, top
    exact = build_intermediate_model(full.pencil, band, 1e-8, np.inf)
    return ReductionTask.from_models(full, full.pencil, exact, band, norm, tolerance)


@pytest.mark.parametrize("norm", ["pointwise", "peak"])
@pytest.mark.parametrize("method", METHODS)
def test_every_method_meets_the_tolerance_that_its_certificate_states(method, norm):
    matrices, top = chain()
    if method == "block Krylov":  # proportional damping
        matrices = matrices | {"E": None, "rayleigh": (0.0, 0.02)}
    rom = kc.reduce(kc.LinearModel(**matrices), tolerance=1e-4, band=(0, top), norm=norm,
                    method=method)  # fmt: skip
    full = oracle.system(chain()[0])
    error = oracle.largest_error(full, oracle.system_of(rom), (0.0, top), share=oracle.SHARES[norm])
    estimate = rom.certificate.error_estimate
    assert error <= estimate + oracle.ROUNDING
    assert estimate <= 1e-4
    assert rom.certificate.method.startswith(f"{method}; ")
    assert rom.certificate.stable


def test_balanced_truncation_is_between_its_bounds_by_hankel_singular_values():
    """``s_(q+1) <= max |H - H_q| <= 2 (s_(q+1) + ...)``, with singular values by scipy alone."""
    rng = np.random.default_rng(5)
    A = np.diag(-np.geomspace(0.5, 20.0, 12)) + np.triu(rng.standard_normal((12, 12)), 1)
    B, C = rng.standard_normal((12, 1)), rng.standard_normal((1, 12))
    reach = solve_continuous_lyapunov(A, -B @ B.T)
    seen = solve_continuous_lyapunov(A.T, -C.T @ C)
    hankel = np.sort(np.sqrt(np.abs(np.linalg.eigvals(reach @ seen))))[::-1]
    basis = BalancedTruncation().basis(task_of({"A": A, "B": B, "C": C}, 10.0))
    s = 1j * np.r_[0.0, np.geomspace(1e-4, 1e4, 4000)]
    exact = np.array([(C @ np.linalg.solve(p * np.eye(12) - A, B))[0, 0] for p in s])
    for order in (1, 2, 3, 5):
        error = np.abs(basis.get_response_of_order(order).transfer(s)[:, 0, 0] - exact).max()
        assert hankel[order] * (1 - 1e-6) <= error <= 2 * hankel[order:].sum() * (1 + 1e-6)


def test_balancing_over_the_band_removes_states_without_effect_in_the_band():
    """Two oscillators. The one with the higher peak, 110 of 50 m/N, is far above the band."""
    omega, gains = np.array([1.0, 40.0]), np.array([1.0, 60.0])
    matrices = {"M": np.eye(2), "E": np.diag(0.02 * omega), "K": np.diag(omega**2),
                "B": gains[:, None]}  # fmt: skip
    aims = {"order": 2, "band": (0, 0.3), "norm": "peak"}
    frequency = np.linspace(0.0, 0.3, 400)
    exact = kc.LinearModel(**matrices).transfer(frequency)
    errors = {}
    for method in ("balanced truncation", "frequency-limited balanced truncation"):
        rom = kc.reduce(kc.LinearModel(**matrices), method=method, **aims)
        errors[method] = np.abs(rom.transfer(frequency) - exact).max() / np.abs(exact).max()
    assert errors["frequency-limited balanced truncation"] < 0.3 * errors["balanced truncation"]


@pytest.mark.parametrize("blocks", [1, 2, 3])
def test_block_krylov_matches_two_moments_for_each_block(blocks):
    """``C (K^-1 M)^k K^-1 B`` for k below twice the number of blocks, and not the next one."""
    matrices, top = chain()
    matrices = matrices | {"M": np.diag(np.linspace(1.0, 2.0, 40))}
    parts = matrices | {"E": None, "rayleigh": (0.0, 0.02)}
    rom = BlockKrylov().basis(task_of(parts, top)).pencil.truncate_to_order(2 * blocks)

    def moments(K, M, B, C):
        x = np.linalg.solve(K, B)
        for _ in range(2 * blocks + 1):
            yield C @ x
            x = np.linalg.solve(K, M @ x)

    full = moments(matrices["K"], matrices["M"], matrices["B"], matrices["B"].T)
    K, _, M = rom.coefficients
    errors = [np.abs(a / b - 1).max() for a, b in zip(moments(K, M, rom.B, rom.C), full,
                                                      strict=True)]  # fmt: skip
    assert max(errors[:-1]) < 1e-9
    assert errors[-1] > 100 * max(errors[:-1])


def test_rational_krylov_interpolates_value_and_slope_at_its_points():
    """At the end of the band, by direct solutions; a reduction at rest is 1e-3 off there."""
    matrices, top = chain()
    basis = RationalKrylov().basis(task_of(matrices, top))
    M, E, K, B = (matrices[name] for name in "MEKB")
    end = 2j * np.pi * top

    def response(s):
        return B.T @ np.linalg.solve(K + s * E + s * s * M, B)

    static, point = 2 * 2, 2 * 4  # real vectors at zero and at a complex point of two ports
    rom = basis.get_response_of_order(static + point)
    x = np.linalg.solve(K + end * E + end**2 * M, B)
    slope = -x.T @ (E + 2 * end * M) @ x
    step = 1e-5 * end
    ours = rom.transfer(np.array([end, end - step, end + step]))
    assert np.abs(ours[0] / response(end) - 1).max() < 1e-9
    assert np.abs((ours[2] - ours[1]) / (2 * step) / slope - 1).max() < 1e-6


def test_response_pod_needs_the_fewest_states_of_all_congruences():
    matrices, top = chain()
    parts = matrices | {"E": None, "rayleigh": (0.0, 0.02)}
    aims = {"tolerance": 1e-4, "band": (0, top), "norm": "peak"}
    states = {
        method: kc.reduce(kc.LinearModel(**parts), method=method, **aims).order
        for method in ("response POD", "rational Krylov", "block Krylov")
    }
    assert states["response POD"] < min(states["rational Krylov"], states["block Krylov"])


class ModalTruncation(kc.Reductor):
    """Modes of lowest frequency."""

    name = "modal truncation"
    reference = "Craig and Kurdila, Fundamentals of Structural Dynamics (2006), chapter 11"

    def applies_to(self, task):
        return task.model.M is not None

    def basis(self, task):
        return task.project(eigh(task.model.K, task.model.M)[1])


@pytest.fixture
def own_method(monkeypatch):
    monkeypatch.setattr(registry, "_reductors", dict(registry._reductors))
    return kc.register_reductor(ModalTruncation())


@pytest.mark.usefixtures("own_method")
def test_a_registered_method_is_certified_like_all_others():
    """The natural frequencies of a chain held at both ends are ``sin(k pi / (2 n + 2)) / pi``."""
    matrices, top = chain()
    rom = kc.reduce(kc.LinearModel(**matrices), order=5, band=(0, top), method="modal truncation")
    K, _, M = rom.pencil.coefficients
    frequency = np.sqrt(eigh(K, M)[0]) / (2 * np.pi)
    exact = np.sin(np.arange(1, 6) * np.pi / 82) / np.pi
    np.testing.assert_allclose(frequency, exact, rtol=1e-9)
    assert rom.certificate.stable
    assert rom.certificate.passive
    error = oracle.largest_error(
        oracle.system(matrices), oracle.system_of(rom), (0.0, top), share=oracle.SHARES["peak"]
    )
    assert error <= rom.certificate.error_estimate <= 1.5 * error


@pytest.mark.usefixtures("own_method")
def test_a_method_that_does_not_apply_or_exist_is_a_clear_error():
    heat = kc.LinearModel(A=-np.diag([1.0, 2.0]), B=np.ones((2, 1)), C=np.ones((1, 2)))
    with pytest.raises(UsageError, match="does not apply"):
        kc.reduce(heat, tolerance=1e-3, band=(0, 1), method="modal truncation")
    with pytest.raises(UsageError, match="this reduction method does not exist"):
        kc.reduce(heat, tolerance=1e-3, band=(0, 1), method="modal truncatoin")
    with pytest.raises(UsageError, match="not a reduction method"):
        kc.register_reductor(ModalTruncation)


@pytest.mark.parametrize("damping", [None, 0.1])
def test_a_user_basis_of_a_free_body_keeps_the_rigid_body_mode(own_method, damping):
    """Alone or slowed by a dashpot to the ground, which couples it to the elastic modes."""
    n = 12
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    K[0, 0] = K[-1, -1] = 1.0
    E = 0.02 * K
    if damping:
        E[0, 0] += damping
    matrices = {"M": np.eye(n), "E": E, "K": K, "B": np.eye(n)[:, :1]}
    rom = kc.reduce(kc.LinearModel(**matrices), tolerance=1e-3, band=(0, 0.2), method=own_method)
    frequency = np.geomspace(1e-5, 0.2, 3000)
    exact = oracle.direct(oracle.system(matrices), frequency)
    difference = np.abs(rom.transfer(frequency) - exact)
    elastic = np.abs(exact[frequency > 0.03]).max()
    assert (difference / np.maximum(np.abs(exact), elastic)).max() < 1e-3
    assert rom.certificate.error_estimate < 1e-3


def test_structural_damping_needs_a_congruence():
    matrices, top = chain()
    lossy = kc.LinearModel(M=matrices["M"], K=matrices["K"] * (1 + 0.01j), B=matrices["B"])
    with pytest.raises(UsageError, match="cannot reduce a model with structural damping"):
        kc.reduce(lossy, tolerance=0.1, band=(0, top), method="balanced truncation")


@pytest.mark.parametrize("transposed", [False, True])
def test_roots_of_gramians_solve_the_lyapunov_equation(transposed):
    """150 states with pairs of poles, more than one block of the recursion."""
    rng = np.random.default_rng(3)
    A = rng.standard_normal((150, 150)) - 30 * np.eye(150)
    T, Q = schur(A)[0], rng.standard_normal((150, 2))
    root = _compute_gramian_root(T, Q, transposed)
    exact = solve_continuous_lyapunov(T.T if transposed else T, -Q @ Q.T)
    assert np.abs(root @ root.T - exact).max() < 1e-12 * np.abs(exact).max()
