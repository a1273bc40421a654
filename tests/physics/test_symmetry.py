"""Structures with mirror planes: entries that are zero by symmetry, against direct solutions."""

import numpy as np
import oracle
import pytest
from scipy import sparse
from scipy.linalg import block_diag, hadamard
from support import LinearModel, Port, reduce_model


def chain(n, stiffness):
    """Springs in a row, the last end free."""
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    K[-1, -1] = 1.0
    return stiffness * K


def mirrored(rng):
    """Matrices with one or two mirror planes, and which entries these make zero.

    Motions of each symmetry have matrices of their own, sometimes equal ones (a square section).
    """
    kinds, n = int(rng.choice([2, 4])), int(rng.integers(5, 25))
    equal = rng.random() < 0.3
    stiffness = np.exp(rng.uniform(-1, 1, kinds)) if not equal else np.ones(kinds)
    K = block_diag(*(chain(n, 1e6 * k) for k in stiffness))
    M = block_diag(*([np.diag(np.exp(rng.uniform(-0.5, 0.5, n)))] * kinds)) * 1e-3
    E = 10 ** rng.uniform(-4, -1.5) / 3e4 * K
    if rng.random() < 0.3:  # a dashpot beside each end, which couples modes of one symmetry
        E[::n, ::n] += np.diag(np.diag(E)[::n])
    kind = np.sort(rng.integers(0, kinds, int(rng.integers(2, 6))))
    kind[0], kind[-1] = 0, kinds - 1
    B = np.zeros((kinds * n, len(kind)))
    for column, k in zip(B.T, kind, strict=True):
        column[k * n : (k + 1) * n] = rng.standard_normal(n) * 10 ** rng.uniform(-3, 3)
    T = np.kron(hadamard(kinds) / np.sqrt(kinds), np.eye(n))
    if rng.random() < 0.7:
        T = np.linalg.qr(rng.standard_normal(T.shape))[0] @ T
    K, E, M = (0.5 * (P + P.T) for P in (T @ P @ T.T for P in (K, E, M)))
    return {"M": M, "E": E, "K": K, "B": T @ B}, kind[:, None] != kind


DRAWS = [
    pytest.param(seed, marks=[pytest.mark.slow, pytest.mark.campaign]) for seed in range(4, 100)
]


@pytest.mark.parametrize("seed", [0, 1, 2, 3, *DRAWS])
def test_entries_that_are_zero_by_symmetry_refuse_no_model(seed):
    rng = np.random.default_rng([46, seed])
    matrices, zero = mirrored(rng)
    norm = ("pointwise", "peak")[seed % 2]
    kind = ("mechanical", "input")[int(rng.integers(0, 2))]
    names = [f"p{k}" for k in range(len(zero))]
    ports = [Port(name, kind) for name in names]
    more = {}
    if kind == "input":  # outputs elsewhere, which see one symmetry each
        ports += [Port(f"y{k}", "output") for k in range(len(zero))]
        more["C"] = matrices["B"].T * 10 ** rng.uniform(-3, 3, (len(zero), 1))
    model = oracle.system(matrices | more)
    omega = np.sort(np.sqrt(np.linalg.eigvals(np.linalg.solve(matrices["M"], matrices["K"])).real))
    band, tolerance = (0.0, float(omega[len(omega) // 3]) / 2 / np.pi), 10 ** rng.uniform(-6, -2)
    full = LinearModel(**matrices, **more, ports=ports)
    rom = reduce_model(full, tolerance=tolerance, band=band, norm=norm)
    estimate = rom.certificate.error_estimate
    assert estimate <= tolerance
    assert "zero by symmetry" in rom.certificate.method
    near = omega[omega < 2 * np.pi * band[1]] / (2 * np.pi)
    frequency = np.r_[rng.uniform(*band, 300), near, 0.999 * near]
    exact, found = oracle.direct(model, frequency), rom.transfer(frequency)
    size = np.abs(exact)
    base = np.maximum(size, oracle.SHARES[norm] * size.max(axis=0))
    error = np.where(zero, 0.0, np.abs(found - exact) / base).max()
    assert error <= estimate + oracle.ROUNDING
    own = np.sqrt(np.einsum("ii->i", size.max(axis=0)))
    assert (np.abs(found) * zero <= (estimate + oracle.ROUNDING) * np.outer(own, own)).all()


def test_a_small_entry_that_is_not_zero_by_symmetry_has_its_own_reference():
    """A coupling of 1e-6 between two chains in other units is no rounding error."""
    n = 20
    K = block_diag(chain(n, 4e6), chain(n, 5e6))
    K[n - 1, -1] = K[-1, n - 1] = -4.0
    B = np.zeros((2 * n, 2))
    B[n - 1, 0], B[-1, 1] = 1e-4, 1e4
    full = LinearModel(M=1e-3 * np.eye(2 * n), K=K, B=B, rayleigh=(0.0, 1e-7))
    rom = reduce_model(full, tolerance=1e-4, band=(0.0, 4e3), norm="pointwise")
    assert "zero by symmetry" not in rom.certificate.method
    frequency = np.linspace(13.0, 3987.0, 400)
    exact = oracle.direct(oracle.system_of(full), frequency)
    base = np.maximum(np.abs(exact), oracle.FLOOR * np.abs(exact).max(axis=0))
    error = (np.abs(rom.transfer(frequency) - exact) / base).max()
    assert error <= rom.certificate.error_estimate <= 1e-4


def test_a_large_sparse_brick_with_a_mirror_plane_is_reduced():
    """Krylov vectors of the subspace keep motions in y and z apart too."""
    n = 700
    K = block_diag(chain(n, 4e6), chain(n, 5e6))
    rotation = np.kron([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]], np.eye(n))
    T = sparse.csc_array(rotation)
    B = np.zeros((2 * n, 2))
    B[n - 1, 0] = B[-1, 1] = 1.0
    full = LinearModel(
        M=1e-3 * sparse.eye_array(2 * n, format="csc"), K=T @ sparse.csc_array(K) @ T.T, B=T @ B,
        rayleigh=(0.0, 1e-5), ports=[Port("y", "mechanical"), Port("z", "mechanical")],
    )  # fmt: skip
    rom = reduce_model(full, tolerance=1e-4, band=(0.0, 100.0))
    assert "zero by symmetry: y/z, z/y" in rom.certificate.method
    frequency = np.array([7.0, 31.0, 83.0])
    exact, found = full.transfer(frequency), rom.transfer(frequency)
    own = np.arange(2)
    assert np.abs(found[:, own, own] / exact[:, own, own] - 1).max() <= 1e-4
