"""Linear models: what they take and say, and how they answer, against dense algebra."""

import numpy as np
import oracle
import pytest
from scipy import sparse
from support import (
    LinearModel,
    Port,
    SchurComplement,
    SimulationError,
    UsageError,
    apply_congruence,
    eliminate_massless,
    make_piezoelectric_model,
)


@pytest.mark.parametrize("form", ["piezoelectric", "not symmetric", "first order"])
def test_elimination_does_not_change_the_response(form):
    """Two of six unknowns have neither inertia nor damping; loads and readings act on them too."""
    rng = np.random.default_rng(4)
    K = rng.standard_normal((6, 6)) + 8 * np.eye(6)
    K = K + K.T if form == "piezoelectric" else K
    held = np.diag([1.0, 2.0, 3.0, 4.0, 0.0, 0.0])
    B, D = rng.standard_normal((6, 2)), rng.standard_normal((2, 2))
    C = B.T if form == "piezoelectric" else rng.standard_normal((2, 6))
    parts = {"M": held, "E": 0.1 * held @ held, "K": K}
    if form == "first order":
        parts = {"E": held, "A": -K}
    less = eliminate_massless(LinearModel(**parts, B=B, C=C, D=D).pencil)
    assert less.size == 4
    s = np.array([0.2j, 1.0 + 3.0j])
    exact = oracle.direct((oracle.polynomial(parts), B, C, D), s / (2j * np.pi))
    np.testing.assert_allclose(less.transfer(s), exact, rtol=1e-10)


def rng(seed=3):
    return np.random.default_rng(seed)


def spread(n, seed=3):
    return rng(seed).standard_normal((n, n)) + 3 * n * np.eye(n)


def symmetric_matrix(n, seed=3):
    return spread(n, seed) + spread(n, seed).T


# --------------------------------------------------------------------------------------- models


I2, B2 = np.eye(2), np.ones((2, 1))


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        ({"M": I2}, "the model lacks matrices"),
        ({"K": I2}, "the model lacks matrices"),
        ({"M": I2, "A": I2}, "the model lacks matrices"),
        ({"K": I2, "A": I2}, "the model lacks"),
        ({"M": I2, "K": I2, "E": I2, "rayleigh": (0, 1)}, "damping is defined twice"),
        ({"A": I2, "rayleigh": (0, 1)}, "damping is defined twice"),
        ({"M": np.eye(3), "K": I2}, "matrix M has a wrong size"),
        ({"M": I2, "K": np.ones((2, 3))}, "matrix K has a wrong size"),
        ({"A": np.ones((2, 3))}, "matrix A has a wrong size"),
        ({"M": I2, "K": I2, "E": np.eye(3)}, "matrix E has a wrong size"),
        ({"M": I2, "K": I2, "B": np.ones((3, 1))}, "matrix B has a wrong size"),
        ({"M": I2, "K": I2, "B": np.ones((2, 0))}, "has a wrong size"),
        ({"M": I2, "K": I2, "C": np.ones((1, 3))}, "matrix C has a wrong size"),
        ({"M": I2, "K": I2, "D": np.ones((2, 1))}, "matrix D has a wrong size"),
        ({"M": I2, "K": I2, "B": np.ones(2)}, "matrix B has 1 dimensions"),
        ({"M": I2, "K": I2 * 1j}, "matrix K is not a valid structural damping"),
        ({"M": I2 * np.nan, "K": I2}, "matrix M contains entries"),
        ({"M": I2, "K": sparse.csc_array(np.diag([1.0, np.inf]))}, "matrix K contains entries"),
        ({"M": I2, "K": I2, "ports": (Port("a", "input"),)}, "ports do not match the matrices"),
        ({"M": I2, "K": I2, "ports": (Port("a", "input"), Port("A", "output"))}, "the same name"),
    ],
)
def test_incomplete_models_are_refused(parts, says):
    with pytest.raises(UsageError, match=says):
        LinearModel(**{"B": B2} | parts)


@pytest.mark.parametrize("potentials", [0, 2])
@pytest.mark.parametrize("damping", ["E", "rayleigh"])
def test_free_potentials_are_eliminated_exactly(potentials, damping):
    """Against the dense solution of all three equations; two electrodes between two forces."""
    n, m, e = 4, potentials, 2
    K, M, E = symmetric_matrix(n), symmetric_matrix(n, 4), 0.1 * symmetric_matrix(n, 6)
    up, pp = rng(1).standard_normal((n, m)), symmetric_matrix(m, 7) if m else np.zeros((0, 0))
    uV, pV, VV = (
        rng(2).standard_normal((n, e)),
        rng(3).standard_normal((m, e)),
        symmetric_matrix(e, 8),
    )
    B = rng(4).standard_normal((n, 2))
    kinds = ("mechanical", "electrical", "mechanical", "electrical")
    ports = tuple(Port(f"p{k}", kind) for k, kind in enumerate(kinds))
    given = {"E": E} if damping == "E" else {"rayleigh": (0.3, 0.02)}
    if m:
        given |= {"K_up": up, "K_pp": sparse.csc_array(pp), "k_pV": pV}
    model = make_piezoelectric_model(
        M=M, K_uu=K, k_uV=uV, c_VV=VV, B=B, ports=ports, facts={"a": 1.0}, **given
    )
    assert model.facts == {"a": 1.0}
    s = 0.3 + 1.5j
    condensed = K + up @ np.linalg.solve(pp, up.T)
    loss = E if damping == "E" else 0.3 * M + 0.02 * condensed
    whole = np.block([[s * s * M + s * loss + K, up], [up.T, -pp]])
    exact = np.empty((4, 4), dtype=complex)
    for column in range(4):
        f, V = np.zeros(2), np.zeros(e)
        (V if column % 2 else f)[column // 2] = 1.0
        u = np.linalg.solve(whole, np.r_[B @ f - uV @ V, pV @ V])
        u, p = u[:n], u[n:]
        exact[0::2, column] = B.T @ u
        exact[1::2, column] = VV @ V + pV.T @ p - uV.T @ u
    np.testing.assert_allclose(
        model.pencil.transfer(np.array([s]))[0], exact, rtol=1e-9, atol=1e-12
    )


# --------------------------------------------------------------------------------- responses


def test_a_pole_among_the_frequencies_is_an_error():
    with pytest.raises(SimulationError, match="pole"):
        LinearModel(M=np.eye(1), K=np.zeros((1, 1)), B=np.eye(1)).transfer(np.zeros(1))


@pytest.mark.parametrize("skew", [0.0, 0.3])
def test_the_congruence_of_a_schur_complement_is_that_of_its_dense_matrix(skew):
    """An unsymmetric Schur complement occurs in coupled models without reciprocity."""
    rng = np.random.default_rng(4)
    whole = np.diag(np.arange(4.0, 10.0)) + 0.1
    whole[0, 4] += skew
    blocks = (whole[:4, :4], whole[:4, 4:], whole[4:, :4], whole[4:, 4:])
    dense = blocks[0] - blocks[1] @ np.linalg.solve(blocks[3], blocks[2])
    V = rng.normal(size=(4, 2))
    found = apply_congruence(SchurComplement(*map(sparse.csc_array, blocks)), V)
    assert found == pytest.approx(V.T @ dense @ V, rel=1e-12)
    assert (found == found.T).all() == (skew == 0)
