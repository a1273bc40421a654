"""State space of models of every form: the same transfer function, in coordinates of the energy."""

import numpy as np
import oracle
import pytest
from scipy.linalg import block_diag
from support import LinearModel, UsageError, decouple_states, make_block_model

N = 6
RNG = np.random.default_rng(5)


def definite(rank=N, n=N):
    root = RNG.standard_normal((n, rank))
    return root @ root.T


B, C, D = RNG.standard_normal((N, 2)), RNG.standard_normal((3, N)), RNG.standard_normal((3, 2))
K, M, E = definite() + np.eye(N), definite() + np.eye(N), 0.1 * definite()
SKEW = RNG.standard_normal((N, N))
HEAVY = np.diag([1.0, 2.0, 3.0, 0.0, 0.0, 0.0])
LIGHT = np.zeros((N, N))
LIGHT[:5, :5] = definite(5, 5)  # the last coordinate has neither mass nor damping
MODELS = {
    "definite": {"M": M, "E": E, "K": K},
    "lossless": {"M": M, "E": 0 * E, "K": K},
    "free": {"M": M, "E": E, "K": definite(N - 1)},
    "stiffness that is not symmetric": {"M": M, "E": E, "K": K + 0.1 * SKEW},
    "mass that is not symmetric": {"M": M + 0.1 * SKEW, "E": E, "K": K},
    "massless, damped": {"M": HEAVY, "E": E, "K": K},
    "massless, undamped": {"M": HEAVY, "E": np.diag([0.1] * 3 + [0.0] * 3), "K": K},
    "massless, one undamped": {"M": HEAVY, "E": LIGHT, "K": K + 0.1 * SKEW},
    "heat": {"E": M, "A": -K},
    "first order": {"E": M + 0.1 * SKEW, "A": -K + SKEW},
    "with algebraic equations": {"E": HEAVY + 0.2 * HEAVY @ SKEW @ HEAVY, "A": -K + SKEW},
}


@pytest.mark.parametrize("name", MODELS)
def test_the_transfer_function_is_that_of_the_matrices(name):
    parts = MODELS[name]
    a, b, c, d = LinearModel(**parts, B=B, C=C, D=D).state_space()
    frequency = np.array([0.3j, 1.0 + 2.0j, 40.0j]) / (2j * np.pi)
    exact = oracle.direct((oracle.polynomial(parts), B, C, D), frequency)
    found = oracle.direct((oracle.polynomial({"A": a}), b, c, d), frequency)
    np.testing.assert_allclose(found, exact, rtol=1e-8, atol=1e-9)


def test_energy_shows_in_the_form():
    def of(name, **change):
        return LinearModel(**MODELS[name] | change, B=B, C=C).state_space()[0]

    lossless, heat, lossy = of("lossless"), of("heat"), of("definite")
    np.testing.assert_allclose(lossless, -lossless.T, atol=1e-12 * abs(lossless).max())
    assert (heat == heat.T).all()
    assert np.linalg.eigvalsh(lossy + lossy.T).max() < 1e-12 * abs(lossy).max()
    modal = of("definite", E=0.1 * M + 0.02 * K)
    blocks = np.kron(np.eye(N), np.ones((2, 2)))
    assert (modal[blocks == 0] == 0).all()


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        ({"M": np.triu(HEAVY + np.eye(N, k=1)), "E": E, "K": K}, "singular and not symmetric"),
        ({"M": HEAVY, "E": 0 * E, "K": np.diag([1.0] * 5 + [0.0])}, "without stiffness"),
        ({"M": HEAVY, "E": np.eye(N, k=3) + np.eye(N, k=-3), "K": K}, "coupled by damping alone"),
        ({"E": HEAVY, "A": -np.diag([1.0] * 5 + [0.0])}, "algebraic equations are singular"),
    ],
)
def test_models_without_state_space_are_rejected(parts, says):
    with pytest.raises(UsageError, match=says):
        LinearModel(**parts, B=B, C=C).state_space()


def test_blocks_stay_small_while_the_response_keeps_its_digits():
    """Eigenvectors of condition 1e6, above which the first bound keeps states together; a true
    Jordan block stays one."""
    rng = np.random.default_rng(3)
    n = 12
    A = np.diag(-np.arange(1.0, n + 1)) + 12 * np.triu(rng.standard_normal((n, n)), 1)
    Q = np.linalg.qr(rng.standard_normal((n, n)))[0]
    model = LinearModel(A=Q @ A @ Q.T, B=rng.standard_normal((n, 2)), C=rng.standard_normal((2, n)))
    assert np.linalg.cond(np.linalg.eig(A)[1]) > 1e5
    assert len(decouple_states(model.A)[0]) == 1
    found = make_block_model(model)
    assert max(map(len, found.blocks)) == 1
    s = 1j * np.geomspace(0.1, 100, 30)[:, None, None]
    given, small = (
        C @ np.linalg.solve(s * np.eye(n) - inner, B.astype(complex)[None])
        for inner, B, C in (
            (model.A, model.B, model.C),
            (block_diag(*found.blocks), found.B, found.C),
        )
    )
    assert np.abs(small - given).max() < 1e-9 * np.abs(given).max()
    defective = np.diag(-np.ones(4)) + np.eye(4, k=1)
    kept = make_block_model(LinearModel(A=defective, B=np.ones((4, 1)), C=np.ones((1, 4))))
    assert [len(block) for block in kept.blocks] == [4]
