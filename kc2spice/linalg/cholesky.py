"""Supernodal Cholesky factors of sparse positive definite matrices, by CHOLMOD in cvxopt."""

from __future__ import annotations

import numpy as np
import scipy


class Cholesky:
    """``A[p][:, p] = L L'`` of a real matrix, in the order ``p`` or, if None, of minimum degree.

    Raises
    ------
    RuntimeError : not positive definite.
    """

    def __init__(self, matrix: scipy.sparse.csc_array, order: np.ndarray | None) -> None:
        import cvxopt.cholmod  # one of three solvers: loaded where it is chosen

        self._library = cvxopt
        lower = scipy.sparse.coo_array(scipy.sparse.tril(matrix))
        entries = cvxopt.spmatrix(
            lower.data, lower.row.astype(np.int64), lower.col.astype(np.int64), matrix.shape
        )
        chosen = {} if order is None else {"p": cvxopt.matrix(order.astype(np.int64))}
        self._factor = cvxopt.cholmod.symbolic(entries, uplo="L", **chosen)
        try:
            cvxopt.cholmod.numeric(entries, self._factor)
        except ArithmeticError:
            raise RuntimeError("not positive definite") from None

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solution (n,) or (n, k)."""
        x = self._library.matrix(np.asarray(rhs, dtype=float).reshape(len(rhs), -1))
        self._library.cholmod.solve(self._factor, x)
        return np.array(x).reshape(rhs.shape)
