"""Piecewise polynomials and the cubic spline through the nodes of a table.

In numpy alone: scipy's would be most of what a run with cached models spends on loading modules.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Piecewise:
    """``p(x) = sum_k c[k, j] (x - knots[j])^k`` in the cell j that holds ``x``.

    ``knots`` (n,) ascend; ``c`` (degree + 1, n - 1, m) are m functions. The polynomials of the
    outer cells go on beyond the knots.
    """

    knots: np.ndarray
    c: np.ndarray

    def __call__(self, x: np.ndarray | float) -> np.ndarray:
        """Values (..., m) at ``x`` (...)."""
        x = np.asarray(x, dtype=float)
        cell = np.searchsorted(self.knots[1:-1], x, side="right")
        step = (x - self.knots[cell])[..., None]
        value = self.c[-1, cell]
        for power in self.c[-2::-1]:
            value = value * step + power[cell]
        return value

    def integral(self) -> Piecewise:
        """Antiderivative, continuous and 0 at the first knot."""
        power = np.arange(1, self.c.shape[0] + 1)[:, None, None]
        rising = self.c / power
        cells = np.sum(rising * np.diff(self.knots)[:, None] ** power, axis=0)
        start = np.cumsum(cells, axis=0) - cells
        return Piecewise(self.knots, np.concatenate([start[None], rising]))

    def derivative(self) -> Piecewise:
        """Slopes; what jumps at the knots is that of the cell above."""
        return Piecewise(self.knots, self.c[1:] * np.arange(1, self.c.shape[0])[:, None, None])

    def raised(self, by: np.ndarray) -> Piecewise:
        """The same functions plus the constants ``by`` (m,)."""
        return Piecewise(self.knots, np.concatenate([self.c[:1] + by, self.c[1:]]))


def cubic_spline(x: np.ndarray, values: np.ndarray) -> Piecewise:
    """Not-a-knot cubic spline through ``values`` (n, m) at ascending ``x`` (n,), n at least 2; of
    two or three the line or the parabola.

    Unknown are the second derivatives s at the nodes; equal slopes from both sides, with
    ``h = diff(x)`` and ``d = diff(values) / h``, ask for ::

        h[j-1] s[j-1] + 2 (h[j-1] + h[j]) s[j] + h[j] s[j+1] = 6 (d[j] - d[j-1])

    and the first two and the last two cells share one cubic: ``diff(s) / h`` is equal there
    (de Boor, A Practical Guide to Splines, ch. IV).
    """
    n, h = x.size, np.diff(x)
    d = np.diff(values, axis=0) / h[:, None]
    matrix, right = np.eye(n), np.zeros_like(values)
    inner = np.arange(1, n - 1)
    matrix[inner, inner - 1] = h[:-1]
    matrix[inner, inner] = 2 * (h[:-1] + h[1:])
    matrix[inner, inner + 1] = h[1:]
    right[1:-1] = 6 * np.diff(d, axis=0)
    if n == 3:
        matrix[[0, 2], 1] = -1.0
    for row, first in ((0, 0), (n - 1, n - 3)) if n > 3 else ():
        a, b = h[first : first + 2]
        matrix[row, first : first + 3] = b, -(a + b), a
    s = np.linalg.solve(matrix, right)
    h = h[:, None]
    slope = d - h * (2 * s[:-1] + s[1:]) / 6
    return Piecewise(x, np.stack([values[:-1], slope, s[:-1] / 2, np.diff(s, axis=0) / (6 * h)]))
