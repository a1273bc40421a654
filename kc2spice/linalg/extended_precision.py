"""Matrix products in extended precision, and solutions refined with such products.

In an ill-conditioned matrix, low-frequency modes depend on small differences between large numbers.
Residuals in extended precision preserve these small differences. BLAS computes all products of the
dense matrices.

Sources: matrix products without error, Ozaki, Ogita, Oishi and Rump, Numer. Algorithms 59 (2012)
95; iterative refinement, Skeel, Math. Comput. 35 (1980) 817.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError

SLICE_COUNT = 4  # number of parts of about 21 bits into which each matrix entry is split
MAX_REFINEMENTS = 5
# relative correction below which the next correction of a solution is a rounding error
CONVERGED_CORRECTION = 1e-8
# relative correction above which the refinement of a solution has failed
DIVERGED_CORRECTION = 1e-3


class ExtendedPrecisionMatrix:
    """Real matrix whose products have extended precision, an error of about 1e-18.

    The error is relative to the largest term in the sum of a matrix product. The error does not
    increase if the terms of this sum cancel.
    """

    def __init__(self, matrix: np.ndarray) -> None:
        self.shape = matrix.shape
        self._bits = int((53 - np.log2(max(matrix.shape[1], 2))) // 2)
        self._slices = tuple(part.T for part in _slice_matrix(matrix.T, self._bits))

    def __matmul__(self, X: np.ndarray) -> np.ndarray:
        """Return ``A X`` in extended precision for real or complex X (m, k)."""
        if np.iscomplexobj(X):
            both = self @ np.hstack([X.real, X.imag])
            k = X.shape[1]
            return np.asarray(both[:, :k] + 1j * both[:, k:])
        right = tuple(_slice_matrix(X, self._bits))
        total = np.zeros((self.shape[0], X.shape[1]), dtype=np.longdouble)
        for i in reversed(range(len(self._slices))):  # small terms are added first
            for j in reversed(range(min(len(right), SLICE_COUNT - i))):
                total += self._slices[i] @ right[j]
        return total


def _slice_matrix(P: np.ndarray, bits: int) -> Iterator[np.ndarray]:
    """Split a matrix into slices of few bits, whose products are exact.

    In the first slice, each entry is rounded to ``bits`` bits, counted from the leading bit of the
    largest entry in its column. Each further slice contains the next ``bits`` bits. The product of
    two slices is exact in double precision.
    """
    for _ in range(SLICE_COUNT):
        top = np.abs(P).max(axis=0, initial=0.0).astype(float)
        if not top.any():
            return
        grain = np.ldexp(1.0, np.maximum(np.frexp(top)[1] - bits, -1000))
        part = (np.rint(P / grain) * grain).astype(float)
        P = P - part
        yield part


class RefinedSolver:
    """Solver of ``(A + s E) x = b`` for complex s, with iterative refinement of x."""

    def __init__(self, A: np.ndarray, E: np.ndarray) -> None:
        self._plain = A, E
        self._sides = (
            (ExtendedPrecisionMatrix(A), ExtendedPrecisionMatrix(E)),
            (ExtendedPrecisionMatrix(A.T), ExtendedPrecisionMatrix(E.T)),
        )

    def solve_two_sided(
        self, s: complex, B: np.ndarray, C: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Solve ``(A + s E) X = B`` and the transposed equations ``(A + s E)' Y = C'``.

        Raises
        ------
        SimulationError : s is so close to a pole that the refinement fails.
        """
        A, E = self._plain
        lu, pivots, info = scipy.linalg.lapack.zgetrf(
            np.asarray(A + s * E, dtype=complex), overwrite_a=True
        )
        if info:
            raise _make_singular_error(s)
        result = []
        for trans, (rhs, (first, second)) in enumerate(zip((B, C.T), self._sides, strict=True)):
            x = np.zeros(rhs.shape, dtype=complex)
            rest = rhs.astype(complex)
            for _ in range(MAX_REFINEMENTS):
                step = scipy.linalg.lapack.zgetrs(lu, pivots, rest, trans=trans)[0]
                x = x + step
                change = np.abs(step).max() / max(np.abs(x).max(), np.finfo(float).tiny)
                if change <= CONVERGED_CORRECTION:
                    break
                rest = np.asarray(rhs - (first @ x + np.clongdouble(s) * (second @ x)), complex)
            if not change < DIVERGED_CORRECTION:
                raise _make_singular_error(s)
            result.append(x)
        return result[0], result[1]


def _make_singular_error(s: complex) -> SimulationError:
    """Return the error for a singular matrix ``A + s E``."""
    return SimulationError(
        "the matrix of the equations cannot be factorised",
        where="direct solver",
        got=f"singular at s = {s:.6g} 1/s",
    )
