"""Matrices of an Euler-Bernoulli beam of Hermite elements, for tables and for tests."""

from __future__ import annotations

import numpy as np


def hermite_beam(
    elements: int, bending: float = 1.0, line: float = 1.0, *, scaled: bool = False
) -> tuple[np.ndarray, np.ndarray]:
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


def steel_cantilever(elements: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass, stiffness and force at the free end of a beam of steel, 1 m by 10 mm by 5 mm."""
    M, K = hermite_beam(elements, 210e9 * 1e-2 * 5e-3**3 / 12, 7850 * 1e-2 * 5e-3)
    return M[2:, 2:], K[2:, 2:], np.eye(2 * elements)[:, [-2]]
