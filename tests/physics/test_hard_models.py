"""Random models with constraints, infinite poles and structural zeros against direct solutions.

None is refused that a direct solution handles, and none is silently wrong. Seed 46.
"""

import numpy as np
import oracle
import pytest
from scipy import sparse
from scipy.linalg import block_diag, null_space
from support import LinearModel, reduce_model

TOP = 0.35  # of the poles: where the band ends


def chain(rng, n):
    """Masses between springs of random sizes, the first one held, with stiffness damping."""
    k = 1e6 * np.exp(rng.uniform(-1, 1, n + 1))
    K = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    M = np.diag(np.exp(rng.uniform(-1, 1, n))) * 1e-2
    return M, 10 ** rng.uniform(-3.5, -1) / np.sqrt(1e8) * K, K


def some_ports(rng, n):
    B = np.zeros((n, int(rng.integers(1, 4))))
    for column in B.T:
        column[rng.integers(0, n, 2)] = rng.standard_normal(2)
    return B


def constrained(rng):
    """Rigid couplings by Lagrange multipliers; outputs may see the multipliers' forces."""
    n, m = int(rng.integers(15, 60)), int(rng.integers(1, 5))
    M, E, K = chain(rng, n)
    if rng.random() < 0.3:
        E[0, 0] *= 30
    G = np.zeros((m, n))
    for row in G:
        places = rng.choice(n, int(rng.integers(2, 5)), replace=False)
        row[places] = rng.standard_normal(len(places))
    if rng.random() < 0.2:
        G = np.vstack([G, G[:1]])  # a constraint twice
        m += 1
    zero = np.zeros((m, m))
    scale = 10 ** rng.uniform(-3, 6)  # of the multipliers, which no tool fixes
    parts = {
        "M": block_diag(M, zero), "E": block_diag(E, zero),
        "K": np.block([[K, scale * G.T], [scale * G, zero]]),
    }  # fmt: skip
    B = some_ports(rng, n)
    parts["B"] = np.vstack([B, np.zeros((m, B.shape[1]))])
    if rng.random() < 0.4 and np.linalg.matrix_rank(G) == m:
        C = np.zeros((2, n + m))
        C[0, rng.integers(0, n)] = 1.0
        C[1, n] = 1.0  # force of the first coupling
        parts["C"] = C
    Z = null_space(G)
    return parts, "MEK", oracle.poles([Z.T @ P @ Z for P in (K, E, M)])


def without_twins(parts):
    """Without the last row of K where another is the same, which makes it singular."""
    K = parts["K"]
    size = len(K) - int(len(np.unique(K, axis=0)) < len(K))
    cut = {k: P[:size, :size] for k, P in parts.items() if k in "MEK"}
    return cut | {k: P[:size] if k == "B" else P[:, :size] for k, P in parts.items() if k in "BC"}


def algebraic(rng):
    """A chain in first order beside algebraic equations, in random coordinates (index 1)."""
    n, m = int(rng.integers(6, 25)), int(rng.integers(2, 40))
    M, E, K = chain(rng, n)
    w = 1e4
    A = np.block([[np.zeros((n, n)), w * np.eye(n)], [-K / w, -E]])
    mass = block_diag(np.eye(n), M)
    link = rng.standard_normal((2 * n, m)) * 0.1
    inner = rng.standard_normal((m, m)) + 3 * np.sqrt(m) * np.eye(m)
    weak = rng.standard_normal((m, 2 * n)) * 0.1
    condensed = A + 10 * link @ np.linalg.solve(inner, weak)
    poles = oracle.poles((-condensed, mass))
    A = np.block([[A, link * 10], [weak, -inner]])
    mass = block_diag(mass, np.zeros((m, m)))
    B, C = rng.standard_normal((2 * n + m, 2)), rng.standard_normal((2, 2 * n + m))
    left, right = (np.linalg.qr(rng.standard_normal(A.shape))[0] for _ in range(2))
    parts = {"A": left @ A @ right, "E": left @ mass @ right, "B": left @ B, "C": C @ right}
    return parts, "AE", poles


def index_two(rng):
    """A dissipative system with constraints, in random coordinates; multipliers may be outputs."""
    n, m = int(rng.integers(8, 40)), int(rng.integers(1, 4))
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    S = rng.standard_normal((n, n)) * 30
    A = -Q @ np.diag(np.exp(rng.uniform(0, 5, n))) @ Q.T + S - S.T
    G = rng.standard_normal((m, n))
    mass = np.diag(np.exp(rng.uniform(-1, 1, n)))
    Z = null_space(G)
    poles = oracle.poles((-Z.T @ A @ Z, Z.T @ mass @ Z))
    A = np.block([[A, G.T], [G, np.zeros((m, m))]])
    mass = block_diag(mass, np.zeros((m, m)))
    B = np.vstack([rng.standard_normal((n, 2)), np.zeros((m, 2))])
    C = np.hstack([rng.standard_normal((2, n)), np.zeros((2, m))])
    if rng.random() < 0.5:
        C[1] = np.r_[np.zeros(n), np.ones(m)]
    if rng.random() < 0.7:
        left, right = (np.linalg.qr(rng.standard_normal(A.shape))[0] for _ in range(2))
        A, mass, B, C = left @ A @ right, left @ mass @ right, left @ B, C @ right
    return {"A": A, "E": mass, "B": B, "C": C}, "AE", poles


KINDS = (constrained, algebraic, index_two)
QUICK = [(kind, seed) for kind in KINDS for seed in range(2)]
DRAWS = [
    pytest.param(kind, seed, marks=[pytest.mark.slow, pytest.mark.campaign])
    for kind in KINDS for seed in range(2, 75)
]  # fmt: skip


@pytest.mark.filterwarnings("ignore:the full model is unstable")
@pytest.mark.parametrize(("kind", "seed"), [*QUICK, *DRAWS])
def test_models_that_a_direct_solution_handles_are_reduced(kind, seed):
    rng = np.random.default_rng([46, KINDS.index(kind), seed])
    parts, letters, poles = kind(rng)
    model = oracle.system(parts if kind is not constrained else without_twins(parts))
    found = np.sort(np.abs(poles))
    band = 0.0, float(found[max(3, int(TOP * len(found)))]) / (2 * np.pi)
    tolerance, norm = 10 ** rng.uniform(-5, -2), ("peak", "pointwise")[seed % 2]
    sparse_too = rng.random() < 0.5
    given = {k: sparse.csc_array(P) if sparse_too and k in letters else P for k, P in parts.items()}
    with oracle.bounded():
        rom = reduce_model(LinearModel(**given), tolerance=tolerance, band=band, norm=norm)
    grows = poles.real.max() > 1e-6 * 2 * np.pi * band[1]
    assert rom.certificate.stable is not bool(grows)
    frequency = np.r_[rng.uniform(0, 1, 200), 10 ** rng.uniform(-3, 0, 60)] * band[1]
    near = np.abs(poles.imag)[np.abs(poles.imag) < 2 * np.pi * band[1]] / (2 * np.pi)
    frequency = np.r_[frequency, near, 0.9999 * near]
    exact, ours = oracle.direct(model, frequency, refined=False), rom.transfer(frequency)
    size = np.abs(exact)
    base = np.maximum(size, oracle.SHARES[norm] * size.max(axis=0))
    error = (np.abs(ours - exact) / base).max()
    estimate = rom.certificate.error_estimate
    assert error <= estimate + 10 * oracle.ROUNDING, (error, estimate)
    assert estimate <= tolerance
    rom.state_space()


def response(parts, frequency):
    """Direct solutions of matrices, complex ones too."""
    result = []
    for s in 2j * np.pi * frequency:
        P = parts["K"] + s * parts["E"] + s**2 * parts["M"]
        result.append(parts["B"].T @ np.linalg.solve(P, parts["B"]))
    return np.array(result)


STRUCTURAL = [
    pytest.param(seed, marks=[pytest.mark.slow, pytest.mark.campaign]) for seed in range(3, 75)
]


@pytest.mark.filterwarnings("ignore:no causal model")
@pytest.mark.parametrize("seed", [0, 1, 2, *STRUCTURAL])
def test_structural_damping_becomes_a_passive_model_of_known_difference(seed):
    rng = np.random.default_rng([46, 3, seed])
    n, eta = int(rng.integers(15, 60)), 10 ** rng.uniform(-4, -1)
    M, E, K = chain(rng, n)
    E = E * (rng.random() < 0.3)
    parts = {"M": M, "E": E, "K": K * (1 + 1j * eta), "B": some_ports(rng, n)}
    modes = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).real) / (2 * np.pi)
    band = 0.0, float(np.sort(modes)[max(2, int(TOP * n))])
    norm, tolerance = ("peak", "pointwise")[seed % 2], 10 ** rng.uniform(-4, -2)
    form = sparse.csc_array if seed % 3 else np.asarray
    given = {k: form(P) if k in "MEK" else P for k, P in parts.items()}
    model = LinearModel(**given)
    rom = reduce_model(model, tolerance=tolerance, band=band, norm=norm)
    known = rom.certificate
    assert known.stable
    assert known.passive
    assert rom.loss_factor == 0.0
    near = modes[modes < band[1]]
    frequency = np.r_[rng.uniform(0.001, 1, 200) * band[1], near, near * (1 + eta)]
    frequency = frequency[frequency < band[1]]
    exact = response(parts, frequency)
    np.testing.assert_allclose(model.transfer(frequency[:3]), exact[:3], rtol=1e-8)
    size = np.abs(exact)
    base = np.maximum(size, oracle.SHARES[norm] * size.max(axis=0))
    error = (np.abs(rom.transfer(frequency) - exact) / base).max()
    assert error <= known.error_estimate + oracle.ROUNDING
    if norm == "peak":
        assert known.error_estimate <= tolerance + 2 * eta


def materials(rng, n):
    """K of a chain between ground and its springs, and its loss: three loss factors of springs."""
    K, H = np.zeros((n, n)), np.zeros((n, n))
    factors = 10 ** rng.uniform(-4, -1, 3)
    for k in range(n):
        stretch = np.zeros((1, n))
        stretch[0, max(k - 1, 0)] = -1.0
        stretch[0, k] = 1.0
        spring = 1e6 * np.exp(rng.uniform(-1, 1)) * stretch.T @ stretch
        K, H = K + spring, H + factors[3 * k // n] * spring
    return K, H, factors.max()


SEVERAL = [
    pytest.param(seed, marks=[pytest.mark.slow, pytest.mark.campaign]) for seed in range(2, 50)
]


@pytest.mark.filterwarnings("ignore:no causal model")
@pytest.mark.parametrize("seed", [0, 1, *SEVERAL])
def test_losses_of_several_materials_become_a_passive_model_of_known_difference(seed):
    rng = np.random.default_rng([46, 4, seed])
    n = int(rng.integers(15, 60))
    K, H, eta = materials(rng, n)
    M = np.diag(np.exp(rng.uniform(-1, 1, n))) * 1e-2
    parts = {"M": M, "E": 0 * K, "K": K + 1j * H, "B": some_ports(rng, n)}
    modes = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).real) / (2 * np.pi)
    band = 0.0, float(np.sort(modes)[max(2, int(TOP * n))])
    norm, tolerance = ("peak", "pointwise")[seed % 2], 10 ** rng.uniform(-4, -2)
    form = sparse.csc_array if seed % 3 else np.asarray
    given = {k: form(P) if k in "MK" else P for k, P in parts.items() if k != "E"}
    rom = reduce_model(LinearModel(**given), tolerance=tolerance, band=band, norm=norm)
    known = rom.certificate
    assert known.stable
    assert known.passive
    near = modes[modes < band[1]]
    frequency = np.r_[rng.uniform(0.001, 1, 200) * band[1], near, near * (1 + eta)]
    frequency = frequency[frequency < band[1]]
    exact = response(parts, frequency)
    size = np.abs(exact)
    base = np.maximum(size, oracle.SHARES[norm] * size.max(axis=0))
    error = (np.abs(rom.transfer(frequency) - exact) / base).max()
    assert error <= known.error_estimate + oracle.ROUNDING
    if norm == "peak":
        assert known.error_estimate <= tolerance + eta


@pytest.mark.slow
def test_a_chain_of_301_masses_with_general_damping_settles():
    """602 first-order states, dozens of resonances in the band, and dashpots that couple them."""
    n = 301
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    E = 1e-3 * K
    E[0, 0] += 0.3
    E[n // 2, n // 2] += 0.1
    parts = {"M": np.diag(np.linspace(1, 3, n)), "E": E, "K": K, "B": np.eye(n)[:, [n // 5, n - 1]]}
    rom = reduce_model(LinearModel(**parts), tolerance=1e-4, band=(0.0, 0.3), norm="peak")
    assert rom.certificate.stable
    rates = np.linalg.eigvals(np.block([  # the peak of each entry is at a pole, between grid points
        [np.zeros((n, n)), np.eye(n)],
        [-np.linalg.solve(parts["M"], K), -np.linalg.solve(parts["M"], E)],
    ]))  # fmt: skip
    natural = rates.imag[rates.imag > 0] / (2 * np.pi)
    frequency = np.r_[np.linspace(0.0007, 0.2993, 200), natural[natural < 0.3]]
    exact = response(parts, frequency)
    error = np.abs(rom.transfer(frequency) - exact) / np.abs(exact).max(axis=0)
    assert error.max() <= rom.certificate.error_estimate <= 1e-4
