"""Certificates of bodies that are free to move, against direct solutions.

The motion of the whole body grows without bound towards zero frequency. It is exact in every
reduced model; what is certified is the rest, relative to the response and, in its notches, to a
millionth of the largest response without that motion.
"""

import numpy as np
import oracle
import pytest
import skfem
from scipy.linalg import eigh
from scipy.sparse.linalg import splu
from skfem.helpers import dot
from skfem.models.elasticity import lame_parameters, linear_elasticity
from support import LinearModel, reduce_model


def chain(rng, damping, n=40):
    """Masses on springs, forces on both ends."""
    links = np.eye(n - 1, n, 1) - np.eye(n - 1, n)
    K = links.T @ np.diag(rng.uniform(0.5, 2, n - 1)) @ links
    return np.diag(rng.uniform(0.5, 2, n)), damping * K, K, np.eye(n)[:, [0, -1]], np.ones((n, 1))


def plate(rng, damping):
    """Masses on a triangular mesh of bars in a plane: three motions without force."""
    x, y = (a.ravel() + rng.uniform(-0.1, 0.1, 36) for a in np.mgrid[:6.0, :6.0])
    n = x.size
    rows = []
    for i in range(n):
        for j in range(i):
            length = np.hypot(x[i] - x[j], y[i] - y[j])
            if length < 1.7:
                row = np.zeros(2 * n)
                row[[2 * i, 2 * i + 1, 2 * j, 2 * j + 1]] = (
                    np.array([x[i] - x[j], y[i] - y[j], x[j] - x[i], y[j] - y[i]]) / length
                )
                rows.append(row)
    links = np.array(rows)
    K = links.T @ links
    free = np.zeros((2 * n, 3))
    free[::2, 0], free[1::2, 1], free[::2, 2], free[1::2, 2] = 1.0, 1.0, -y, x
    return np.eye(2 * n), damping * K, K, np.eye(2 * n)[:, [0, 31]], free


def slowed(rng, damping):
    """A chain that slides on a viscous film: its free motion is slowed down within the band."""
    M, E, K, B, free = chain(rng, damping)
    return M, E + 0.2 * damping * M, K, B, free


CAMPAIGN = [
    pytest.param(body, top, damping, tolerance, marks=[pytest.mark.slow, pytest.mark.campaign])
    for body, top in ((chain, 0.15), (plate, 0.25), (slowed, 0.15))
    for damping, tolerance in ((1e-2, 1e-2), (1e-4, 1e-4), (1e-2, 1e-6))
]


@pytest.mark.parametrize(
    ("body", "top", "damping", "tolerance"),
    [(chain, 0.15, 1e-2, 1e-4), (plate, 0.15, 1e-2, 1e-2), (slowed, 0.15, 1e-2, 1e-4), *CAMPAIGN],
)
def test_the_error_of_a_free_body_is_within_its_certificate(body, top, damping, tolerance):
    M, E, K, B, free = body(np.random.default_rng(3), damping)
    band = 1e-4 * top, top
    rom = reduce_model(LinearModel(M=M, E=E, K=K, B=B), tolerance=tolerance, band=(0.0, top))
    full = oracle.system({"M": M, "E": E, "K": K, "B": B})
    error = oracle.largest_error(full, oracle.system_of(rom), band, free)
    stated = rom.certificate.error_estimate
    assert error <= stated <= tolerance, (error, stated)
    assert rom.order < len(M)
    assert stated <= 3 * error + oracle.ROUNDING


def steel_rod(length=0.1, width=0.01):
    """Mass and stiffness of 30 x 3 x 3 bricks, forces along it on its ends."""
    sides = np.linspace(-width / 2, width / 2, 4)
    mesh = skfem.MeshHex.init_tensor(np.linspace(0, length, 31), sides, sides)
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex1()))
    K = linear_elasticity(*lame_parameters(210e9, 0.3)).assemble(basis)
    M = skfem.BilinearForm(lambda u, v, _: 7850 * dot(u, v)).assemble(basis)
    ends = [basis.get_dofs(lambda x, at=at: np.isclose(x[0], at)).all("u^1") for at in (0, length)]
    B = np.zeros((K.shape[0], 2))
    for column, nodes in zip(B.T, ends, strict=True):
        column[nodes] = 1 / len(nodes)
    return M.tocsc(), K.tocsc(), B


@pytest.mark.parametrize("ratio", [pytest.param(1e-3, marks=pytest.mark.slow), 1e-6])
def test_a_free_rod_of_bricks_keeps_the_form_that_proves_it_stable(ratio):
    """Rounding errors in the rigid-body modes of large matrices would hide the form."""
    M, K, B = steel_rod()
    beta = ratio / (np.pi * 25e3)
    full = LinearModel(M=M, K=K, B=B, rayleigh=(0.0, beta))
    rom = reduce_model(full, tolerance=1e-4, band=(0.0, 60e3))
    assert rom.certificate.stable
    assert rom.certificate.passive
    length = np.sqrt(210e9 / 7850) / 0.2  # its first mode along, sound there and back
    assert np.abs(rom.poles().imag / (2 * np.pi) - length).min() < 0.01 * length
    for s in 2j * np.pi * np.array([6e3, 0.99 * length, 55e3]):
        exact = B.T @ splu((K + s * beta * K + s**2 * M).tocsc()).solve(B.astype(complex))
        found = rom.transfer([s.imag / (2 * np.pi)])[0]
        assert (np.abs(found - exact) / np.abs(exact)).max() <= rom.certificate.error_estimate
    assert rom.certificate.error_estimate <= 1e-4


def closed_form(M, K, damping, B, frequency):
    """Answers of a free chain with ``E = damping K`` as a sum over its modes, the first of which
    moves all masses alike, and those of that motion alone."""
    squares, T = eigh(K, M)
    squares[0], T[:, 0] = 0.0, 1 / np.sqrt(np.trace(M))
    s = 2j * np.pi * frequency[:, None]
    gain, inverse = T.T @ B, 1 / (s**2 + damping * squares * s + squares)
    terms = np.einsum("jo,fj,ji->fjoi", gain, inverse, gain)
    return terms.sum(axis=1), terms[:, 0]


def as_first_order(M, E, K, B):
    """``x' = A x + B u``, whose pole at zero is defective."""
    one, none = np.eye(len(M)), np.zeros((len(M), len(M)))
    A = np.block([[none, one], [-np.linalg.solve(M, K), -np.linalg.solve(M, E)]])
    drive = np.vstack([0 * B, np.linalg.solve(M, B)])
    return LinearModel(A=A, B=drive, C=np.hstack([B.T, 0 * B.T]))


@pytest.mark.parametrize("norm", ["pointwise", "peak"])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(
    "seed", [1, *(pytest.param(s, marks=pytest.mark.slow) for s in range(2, 20))]
)
def test_free_chains_of_any_length_are_as_good_as_certified_down_to_zero(seed, order, norm):
    """The motion of the whole chain, a mass line, is exact and hides nothing at the band's end."""
    rng = np.random.default_rng(seed)
    n, damping = int(rng.integers(8, 61)), 10 ** rng.uniform(-4, -1)
    M, E, K, B, _ = chain(rng, damping, n)
    top = 1.05 * np.sqrt(eigh(K, M, eigvals_only=True)[n // 3]) / (2 * np.pi)
    full = as_first_order(M, E, K, B) if order == 1 else LinearModel(M=M, E=E, K=K, B=B)
    rom = reduce_model(full, tolerance=10 ** rng.uniform(-5, -2), band=(0.0, top), norm=norm)
    parts = (K, E, M), B, B.T, np.zeros((2, 2))
    frequency = oracle.fine(parts, (1e-4 * top, top), oracle.poles(parts[0]))
    frequency = np.r_[np.geomspace(1e-8, 1e-4, 30) * top, frequency]
    exact, rigid = closed_form(M, K, damping, B, frequency)
    share = 1.0 if norm == "peak" else oracle.FLOOR
    base = np.maximum(np.abs(exact), share * np.abs(exact - rigid).max(axis=0))
    error = np.abs(oracle.direct(oracle.system_of(rom), frequency) - exact) / base
    stated = rom.certificate.error_estimate
    assert error.max() <= stated <= 3 * error.max() + oracle.ROUNDING
    assert error[:30].max() < 1e-6  # the whole body at a hundredth of the first resonance
    assert rom.certificate.stable
    assert rom.order <= full.order
