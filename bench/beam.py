"""Made-up models for tests: a beam of Hermite elements, a rod that conducts heat, random modes."""

import numpy as np

from kc2spice.rom.linear_model import LinearModel


def hermite_beam(elements, bending=1.0, line=1.0, *, scaled=False):
    """Mass and stiffness of a free beam of unit length; deflection and slope of each node in turn.

    ``bending`` is E I, ``line`` the mass per length; ``scaled`` slopes are times the length of an
    element, which keeps the digits that slopes lose. Przemieniecki, Theory of Matrix Structural
    Analysis (1968).
    """
    h = 1 / elements
    unit = np.array([1.0, 1.0 if scaled else h] * 2)
    k = [[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]
    m = [[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]]
    stiff = bending / h**3 * np.outer(unit, unit) * k
    heavy = line * h / 420 * np.outer(unit, unit) * m
    K, M = np.zeros((2, 2 * elements + 2, 2 * elements + 2))
    for i in range(elements):
        rows = slice(2 * i, 2 * i + 4)
        K[rows, rows] += stiff
        M[rows, rows] += heavy
    return M, K


def steel_cantilever(elements):
    """Mass, stiffness and force at the free end of a beam of steel, 1 m by 10 mm by 5 mm."""
    M, K = hermite_beam(elements, 210e9 * 1e-2 * 5e-3**3 / 12, 7850 * 1e-2 * 5e-3)
    return M[2:, 2:], K[2:, 2:], np.eye(2 * elements)[:, [-2]]


def heat(cells=200):
    """A rod, heated at a third, measured at two thirds; a tolerance, a band [Hz]."""
    n = cells
    A = 1e-2 * (n + 1) ** 2 * (np.eye(n, k=1) + np.eye(n, k=-1) - 2 * np.eye(n))
    model = LinearModel(A=A, B=(n + 1) * np.eye(n)[:, [n // 3]], C=np.eye(n)[[2 * n // 3]])
    return model, 1e-4, (0.0, 1e3 / (2 * np.pi))


def structure(states, ports):
    """Random lightly damped modes over two decades in first order, none left out by symmetry."""
    rng = np.random.default_rng(states)
    n = states // 2
    w, ratio = np.exp(np.linspace(0, 5, n)), rng.uniform(1e-3, 5e-3, n)
    A = np.zeros((states, states))
    A[::2, 1::2], A[1::2, ::2], A[1::2, 1::2] = np.diag(w), -np.diag(w), -2 * np.diag(ratio * w)
    B, C = np.zeros((states, ports)), np.zeros((ports, states))
    B[1::2] = rng.standard_normal((n, ports)) / w[:, None]
    C[:, ::2] = rng.standard_normal((ports, n)) / w
    return LinearModel(A=A, B=B, C=C), 1e-4, (0.0, w[-1] / (2 * np.pi))
