"""Certificates of bodies that are free to move, against direct solutions.

The motion of the whole body grows without bound towards zero frequency. It is exact in every
reduced model; what is certified is the rest, relative to the response and, in its notches, to a
millionth of the largest response without that motion.
"""

import numpy as np
import pytest
from scipy.linalg import eigvals, null_space

from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduce import reduce

FLOOR = 1e-6


def chain(rng, damping):
    """40 masses on springs, forces on both ends."""
    n = 40
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


def random_free(rng, damping):
    """Two motions that cost nothing, full matrices, a dashpot that couples the modes."""
    n = 50
    links = rng.standard_normal((n - 2, n)) * np.exp(rng.uniform(-2, 1, n - 2))[:, None]
    root = rng.standard_normal((n, n)) / np.sqrt(n) + np.eye(n)
    K, M = links.T @ links, root.T @ root
    E = damping * K
    E += damping * np.outer(links[0], links[0])
    return M, E, K, rng.standard_normal((n, 2)), null_space(links)


def slowed(rng, damping):
    """A chain that slides on a viscous film: its free motion is slowed down within the band."""
    M, E, K, B, free = chain(rng, damping)
    return M, E + 0.2 * damping * M, K, B, free


def direct(matrices, frequency):
    M, E, K, B, C = matrices
    s = 2j * np.pi * frequency[:, None, None]
    return C @ np.linalg.solve(s * s * M + s * E + K, B.astype(complex)[None])


def true_error(matrices, free, found, band):
    """The largest over a fine grid, at poles and close to every notch."""
    M, E, K, B, C = matrices
    n = len(M)
    low = 1e-4 * band[1]
    inner = np.linalg.solve(M, np.hstack([K, E]))
    poles = eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-inner[:, :n], -inner[:, n:]]]))
    poles = poles[poles.imag > 1e-2 * 2 * np.pi * band[1]] / (2 * np.pi)
    near = poles.imag[:, None] + np.abs(poles.real[:, None]) * np.linspace(-3, 3, 13)
    f = np.r_[np.linspace(low, band[1], 2000), np.geomspace(low, band[1], 1000), near.ravel()]
    f = np.unique(f[(f >= low) & (f <= band[1])])
    for _ in range(3):
        size = np.abs(direct(matrices, f)).reshape(len(f), -1)
        notch = ((size[1:-1] < size[:-2]) & (size[1:-1] <= size[2:])).any(axis=1)
        f = np.unique(np.r_[f, *(np.linspace(*f[[k, k + 2]], 9) for k in np.flatnonzero(notch))])
    H = direct(matrices, f)
    whole = direct([free.T @ P @ free for P in (M, E, K)] + [free.T @ B, C @ free], f)
    peak = np.abs(H - whole).max(axis=0)
    return float((np.abs(direct(found, f) - H) / np.maximum(np.abs(H), FLOOR * peak)).max())


@pytest.mark.parametrize(("damping", "tolerance"), [(1e-2, 1e-2), (1e-4, 1e-4), (1e-2, 1e-6)])
@pytest.mark.parametrize(
    ("body", "top"), [(chain, 0.15), (plate, 0.25), (random_free, 0.5), (slowed, 0.15)]
)
def test_a_free_body_is_as_good_as_its_certificate_says(body, top, damping, tolerance):
    rng = np.random.default_rng(3)
    M, E, K, B, free = body(rng, damping)
    band = 0.0, top
    rom = reduce(LinearModel(M=M, E=E, K=K, B=B), tolerance=tolerance, band=band)
    matrices = rom.M, rom.E, rom.K, rom.B, rom.C
    error = true_error((M, E, K, B, B.T), free, matrices, band)
    stated = rom.certificate.error_estimate
    assert error <= stated <= tolerance, (error, stated)
    assert rom.order < len(M)
    assert stated <= 3 * error + 1e-9  # rounding of either solution


def test_a_free_body_in_first_order_is_as_good_as_its_certificate_says():
    """The same chain as x' = A x + B u, whose pole at zero is defective."""
    M, E, K, B, free = chain(np.random.default_rng(3), 1e-2)
    n, one, none = len(M), np.eye(len(M)), np.zeros((len(M), len(M)))
    A = np.block([[none, one], [-np.linalg.solve(M, K), -np.linalg.solve(M, E)]])
    drive, read = np.vstack([0 * B, np.linalg.solve(M, B)]), np.hstack([B.T, 0 * B.T])
    band = 0.0, 0.15
    rom = reduce(LinearModel(A=A, B=drive, C=read), tolerance=1e-3, band=band)
    found = np.zeros_like(rom.A), rom.E, -rom.A, rom.B, rom.C  # 0 s^2 + E s - A
    error = true_error((M, E, K, B, B.T), free, found, band)
    assert error <= rom.certificate.error_estimate <= 1e-3
    assert rom.order < 2 * n
