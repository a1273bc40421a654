"""Models as other tools may hand them over, of unfriendly kinds: each is certified rightly,
refused with a reason, or ends in bounded time.
"""

import warnings

import numpy as np
import oracle
import pytest
from support import LinearModel, SimulationError, UsageError, reduce_model, subcircuit

REASONS = "too inaccurate", "no state-space form", "out of reach", "does not converge"


def rotation(rng, n):
    return np.linalg.qr(rng.standard_normal((n, n)))[0]


def spd(rng, n, low, high):
    """Symmetric, eigenvalues spread evenly on a logarithmic scale."""
    Q = rotation(rng, n)
    P = Q @ np.diag(np.exp(rng.uniform(np.log(low), np.log(high), n))) @ Q.T
    return 0.5 * (P + P.T)


def ports(rng, n, collocated):
    B = rng.standard_normal((n, int(rng.integers(1, 4))))
    return {"B": B} if collocated else {"B": B, "C": rng.standard_normal((2, n))}


def chain(n):
    return 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)


def non_normal(rng):
    """Eigenvalues far left, a large part above the diagonal: the response grows before it falls."""
    n = int(rng.integers(5, 60))
    A = np.triu(rng.standard_normal((n, n)), 1) * 10 ** rng.uniform(0, 1.5)
    A -= np.diag(np.exp(rng.uniform(0, 3, n)))
    Q = rotation(rng, n)
    return {"A": Q @ A @ Q.T, **ports(rng, n, False)}


def undamped(rng):
    n = int(rng.integers(5, 80))
    return {"M": spd(rng, n, 0.3, 3), "K": spd(rng, n, 1, 1e3), **ports(rng, n, rng.random() < 0.5)}


def high_loss(rng):
    """Loss that is larger than stiffness and couples all modes."""
    n = int(rng.integers(5, 80))
    loss = 10 ** rng.uniform(0, 3)
    return {
        "M": spd(rng, n, 0.3, 3), "K": spd(rng, n, 1, 1e3), "E": loss * spd(rng, n, 1e-3, 1),
        **ports(rng, n, rng.random() < 0.5),
    }  # fmt: skip


def heat(rng):
    """Conduction along a rod of random conductivity and capacity, as E x' + K x = B u."""
    n = int(rng.integers(20, 400))
    k = np.exp(rng.uniform(-2, 2, n + 1))
    K = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    return {
        "E": np.diag(np.exp(rng.uniform(-1, 1, n))) / n, "K": K * n,
        "B": np.eye(n)[:, [n // 3]], "C": np.eye(n)[[2 * n // 3, n // 2]],
    }  # fmt: skip


def index_two(rng):
    """Masses held together by a constraint with its multiplier: E is singular, of index 2."""
    n = int(rng.integers(5, 40))
    G = rng.standard_normal((1, n))
    A = np.block([[-spd(rng, n, 1, 50), -G.T], [G, np.zeros((1, 1))]])
    E = np.diag(np.r_[np.ones(n), 0.0])
    B, C = np.zeros((n + 1, 1)), np.zeros((1, n + 1))
    B[:n, 0], C[0, :n] = rng.standard_normal(n), rng.standard_normal(n)
    if rng.random() < 0.5:  # driven constraint: the multiplier answers to the derivative of u
        B[n, 0] = C[0, n] = 1.0
    return {"A": A, "E": E, "B": B, "C": C}


def integrator(rng):
    """One or two poles at zero, of which two may be a double one (a Jordan block)."""
    n = int(rng.integers(4, 50))
    A = -spd(rng, n, 1, 100)
    A[0, :] = A[:, 0] = 0.0
    if rng.random() < 0.5:
        A[1, :] = A[:, 1] = 0.0
        A[0, 1] = float(rng.random() < 0.5)
    return {"A": A, **ports(rng, n, False)}


def rigid(rng):
    """Free along and across: two motions that cost no energy."""
    n = int(rng.integers(4, 40))
    K = chain(n)
    K[0, 0] = K[-1, -1] = 1.0
    zero = np.zeros_like(K)
    K = np.block([[100 * K, zero], [zero, 30 * K]])
    M = np.diag(np.exp(rng.uniform(-1, 1, 2 * n)))
    E = K * 10 ** rng.uniform(-5, -2) if rng.random() < 0.7 else 0 * K
    Q = rotation(rng, 2 * n) if rng.random() < 0.5 else np.eye(2 * n)
    M, K, E = (0.5 * (P + P.T) for P in (Q @ M @ Q.T, Q @ K @ Q.T, Q @ E @ Q.T))
    return {"M": M, "K": K, "E": E, **ports(rng, 2 * n, True)}


def unstable(rng):
    n = int(rng.integers(5, 60))
    if rng.random() < 0.5:
        A = rng.standard_normal((n, n))
        return {"A": A * 10 ** rng.uniform(0, 2), **ports(rng, n, False)}
    K = spd(rng, n, 1, 1e3) - rng.uniform(2, 200) * np.eye(n)
    E = 1e-3 * spd(rng, n, 1, 1e3)
    return {"M": spd(rng, n, 0.3, 3), "K": K, "E": E, **ports(rng, n, True)}


def unsymmetric(rng):
    """Follower forces: K has a skew part, which may or may not make it flutter."""
    n = int(rng.integers(5, 60))
    S = rng.standard_normal((n, n)) * 10 ** rng.uniform(-1, 1.5)
    K = spd(rng, n, 1, 1e3) + 0.5 * (S - S.T)
    return {
        "M": spd(rng, n, 0.3, 3), "K": K, "E": 10 ** rng.uniform(-4, -1) * spd(rng, n, 1, 1e2),
        **ports(rng, n, rng.random() < 0.5),
    }  # fmt: skip


def gyroscopic(rng):
    n = int(rng.integers(5, 60))
    S = rng.standard_normal((n, n)) * 10 ** rng.uniform(-1, 1)
    E = 0.5 * (S - S.T) + 10 ** rng.uniform(-5, -1) * spd(rng, n, 1, 1e2)
    return {"M": spd(rng, n, 0.3, 3), "K": spd(rng, n, 1, 1e3), "E": E, **ports(rng, n, True)}


def massless(rng):
    """Half of the unknowns without inertia, some of them without damping either."""
    n = int(rng.integers(6, 60))
    M = np.diag(np.where(rng.random(n) < 0.5, 0.0, rng.uniform(0.3, 3, n)))
    E = 10 ** rng.uniform(-4, -1) * np.diag(np.where(rng.random(n) < 0.5, 0.0, 1.0))
    return {"M": M, "K": spd(rng, n, 1, 1e3), "E": E, **ports(rng, n, True)}


def sparse_large(rng):
    """Too large to be taken whole: a grid with a dashpot at a corner."""
    n = int(rng.integers(310, 420))
    K = chain(n) * 10 ** rng.uniform(0, 4)
    E = 1e-4 * K
    E[0, 0] += 10 ** rng.uniform(-2, 2)
    B = np.eye(n)[:, [n // 5, n - 1]]
    return {"M": np.diag(np.exp(rng.uniform(-1, 1, n))), "K": K, "E": E, "B": B}


def faint(rng):
    """Stable but for one pole, which may grow and hardly shows between input and output."""
    n = int(rng.integers(10, 50))
    A = np.zeros((n + 1, n + 1))
    A[:n, :n] = rng.standard_normal((n, n))
    A[:n, :n] -= (np.linalg.eigvals(A[:n, :n]).real.max() + 0.5) * np.eye(n)
    A[n, n] = rng.choice([-1.0, 1.0])
    B, C = rng.standard_normal((n + 1, 1)), rng.standard_normal((1, n + 1))
    B[n], C[0, n] = 1e-7, 1e-3
    T = rng.standard_normal((n + 1, n + 1)) + 3 * np.eye(n + 1)
    return {"A": np.linalg.solve(T, A @ T), "B": np.linalg.solve(T, B), "C": C @ T}


KINDS = (
    non_normal, undamped, high_loss, heat, index_two, integrator, rigid, unstable, unsymmetric,
    gyroscopic, massless, sparse_large, faint,
)  # fmt: skip


def band_of(P, rng):
    """Zero to somewhere among the poles, a few dozen of them at most."""
    size = np.sort(np.abs(oracle.poles(P)))
    top = size[min(int(len(size) * rng.uniform(0.2, 0.8)), 60)]
    return 0.0, float(top or 1.0) * 1.03 / (2 * np.pi)


QUICK = {
    non_normal: (2, 8), undamped: (0, 9), high_loss: (2,), heat: (4, 5), index_two: (1, 2),
    integrator: (0, 2), rigid: (0,), unstable: (4, 5), unsymmetric: (8,), gyroscopic: (0,),
    massless: (4, 7), faint: (0, 1, 2, 3),
}  # fmt: skip
CAMPAIGN = [
    pytest.param(kind, seed, norm, marks=[pytest.mark.slow, pytest.mark.campaign])
    for kind in KINDS for seed in range(12) for norm in oracle.SHARES
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seed", "norm"),
    [*((kind, seed, "pointwise") for kind in QUICK for seed in QUICK[kind]), *CAMPAIGN],
)
def test_foreign_models_are_certified_rightly_or_refused(kind, seed, norm):
    rng = np.random.default_rng([KINDS.index(kind), seed])
    matrices = kind(rng)
    model = oracle.system(matrices)
    band, tolerance = band_of(model[0], rng), 10 ** rng.uniform(-6, -2)
    try:
        with oracle.bounded(), warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            full = LinearModel(**matrices, name="foreign")
            rom = reduce_model(full, tolerance=tolerance, band=band, norm=norm)
            subcircuit(rom, "foreign")
    except (UsageError, SimulationError) as refused:
        assert any(reason in str(refused) for reason in REASONS), refused
        return
    small = oracle.system_of(rom)
    error = oracle.largest_error(model, small, band, share=oracle.SHARES[norm])
    estimate = rom.certificate.error_estimate
    said = f"error {error:.1e}, estimate {estimate:.1e}, tolerance {tolerance:.1e}"
    assert error <= estimate + oracle.ROUNDING, said
    assert estimate <= tolerance, said
    grows = bool(oracle.poles(model[0]).real.max() > 1e-6 * 2 * np.pi * band[1])
    assert rom.certificate.stable is not grows, f"stable {rom.certificate.stable}: {said}"
    assert any("unstable" in str(each.message) for each in told) is grows
    assert kind is not faint or rom.order < full.order
    if rom.certificate.stable:
        assert oracle.poles(small[0]).real.max() <= 1e-7 * 2 * np.pi * band[1], said
