"""Responses of large full models with checked residuals, by CHOLMOD, SuperLU and ARPACK alone.

ARPACK finds the lowest modes of the undamped model, which answer exactly. The other motions y are
the sum of a series, with the load c without those modes and ``f = 1 + j w beta``:

    f y = T_0 + mu T_1 + mu^2 T_2 + ...,  mu = sigma + w^2 / f
    (K + sigma M) T_0 = c,  (K + sigma M) T_(k+1) = M T_k

Each term is smaller than the one before by about ``w^2 / w_k^2``, w_k being the lowest angular
frequency that is not among the modes. One real factor of ``K + sigma M`` and one series serve all
frequencies. The residual of every answer is compared with its forces.

kc2spice contributes the matrices and the order of elimination, which changes time but no solution.
"""

from dataclasses import dataclass
from functools import cached_property

import cvxopt
import cvxopt.cholmod
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from kc2spice.linalg.factor import find_elimination_order

MODES = 40
TERMS = 60  # most terms of the series; 20 are usual
NEGLIGIBLE = 1e-12  # size of the term that ends the series, relative to the first
RIGID = 1e-3  # squared frequencies below this times the shift are those of rigid-body modes


@dataclass(frozen=True)
class FullModel:
    """``K x + beta K x' + M x'' = B u``, ``y = B' x + D u``; massless unknowns come last.

    ``K`` (n + p, n + p) contains p massless unknowns, of which M (n, n) and B (n, ports) know
    nothing. ``shift`` sigma [rad^2/s^2] is positive for a body that is free to move.
    """

    K: sparse.csc_array
    M: sparse.csc_array
    B: np.ndarray
    D: np.ndarray
    beta: float
    shift: float = 0.0

    @classmethod
    def of(cls, model, shift=0.0):
        """Full model of a ``LinearModel`` with proportional damping."""
        K, (alpha, beta) = model.K, model.rayleigh
        assert alpha == 0
        if hasattr(K, "uu"):  # potentials are the massless unknowns
            K = sparse.block_array([[K.uu, K.up], [K.pu, K.pp]])
        matrices = sparse.csc_array(K), sparse.csc_array(model.M), np.asarray(model.B)
        return cls(*matrices, np.asarray(model.D), beta, shift)

    @cached_property
    def _solve(self):
        """Function that solves with ``K + shift M`` for real loads (n, k) on unknowns with mass."""
        n, massless = len(self.B), self.K.shape[0] - len(self.B)
        mass = sparse.block_diag([self.M, sparse.csc_array((massless, massless))])
        matrix = sparse.csc_array(self.K + self.shift * mass)
        order = find_elimination_order(matrix)
        solve = _indefinite_solver(matrix, order) if massless else _cholesky(matrix, order)
        padding = np.zeros((massless, 1))
        return lambda rhs: solve(np.vstack([rhs, np.repeat(padding, rhs.shape[1], axis=1)]))[:n]

    @cached_property
    def _modes(self):
        """Squared angular frequencies (k,) and modes (n, k) with a mass of 1."""
        n = len(self.B)
        inverse = LinearOperator((n, n), matvec=lambda v: self._solve(v.reshape(-1, 1)).ravel())
        start = np.random.default_rng(0).standard_normal(n)
        options = {"sigma": -self.shift, "OPinv": inverse, "v0": start}
        values, modes = eigsh(inverse, MODES, self.M, **options)  # which uses OPinv alone
        values[np.abs(values) < RIGID * self.shift] = 0.0
        return values, modes

    def response(self, frequencies):
        """``y/u`` (frequencies, ports, ports), and the largest relative residual."""
        squares, modes = self._modes
        momenta = self.M @ modes
        shares = modes.T @ self.B
        w = 2 * np.pi * np.asarray(frequencies, dtype=float)
        factor = 1 + 1j * w * self.beta
        ratio = self.shift + w**2 / factor
        gains = 1 / (np.outer(factor, squares) - (w**2)[:, None])
        series = self._series(modes, momenta, float(np.abs(ratio).max()))
        answers, residuals = [], []
        for k in range(len(w)):
            powers = (ratio[k] / np.abs(ratio).max()) ** np.arange(len(series)) / factor[k]
            x = modes @ (gains[k][:, None] * shares) + np.tensordot(powers, series, axes=1)
            answers.append(self.B.T @ x + self.D)
            residuals.append(self._residual(w[k], factor[k], x))
        return np.array(answers), max(residuals)

    def _series(self, modes, momenta, ratio):
        """Terms ``ratio^k T_k`` (k, n, ports) of the motions without the modes."""
        rhs, terms = self.B - momenta @ (modes.T @ self.B), []
        while len(terms) < TERMS:
            term = self._solve(rhs)
            term -= modes @ (momenta.T @ term)
            terms.append(term)
            if (np.abs(term).max(axis=0) < NEGLIGIBLE * np.abs(terms[0]).max(axis=0)).all():
                break
            rhs = ratio * (self.M @ term)
        return np.array(terms)

    def _residual(self, w, factor, x):
        """Largest residual of displacements x, relative to inertia and load."""
        massless = self.K.shape[0] - len(self.B)
        if massless:
            n = len(self.B)
            blocks = self.K[:n, :n], self.K[:n, n:], self.K[n:, :n]
            inner = self._massless
            held = inner(blocks[2] @ x.real) + 1j * inner(blocks[2] @ x.imag)
            stiff = blocks[0] @ x - blocks[1] @ held
        else:
            stiff = self.K @ x
        inertia = w**2 * (self.M @ x)
        error = np.linalg.norm(factor * stiff - inertia - self.B, axis=0)
        return float((error / np.linalg.norm(np.abs(inertia) + np.abs(self.B), axis=0)).max())

    @cached_property
    def _massless(self):
        """Function that solves with the block of the massless unknowns."""
        n = len(self.B)
        block = sparse.csc_array(-self.K[n:, n:])
        solve = _cholesky(block, find_elimination_order(block))
        return lambda rhs: -solve(rhs)


def _indefinite_solver(matrix, order):
    """Function that solves with a symmetric matrix by SuperLU without pivoting for size.

    Unknowns get units in which the diagonal is 1 or -1.
    """
    p = np.arange(matrix.shape[0]) if order is None else order
    unit = 1 / np.sqrt(np.abs(matrix.diagonal()))
    scaled = sparse.diags_array(unit) @ matrix @ sparse.diags_array(unit)
    lu = splu(
        sparse.csc_array(scaled.tocsr()[p][:, p]),
        permc_spec="MMD_AT_PLUS_A" if order is None else "NATURAL",
        diag_pivot_thresh=0.0, options={"SymmetricMode": True},
    )  # fmt: skip

    def solve(rhs):
        x = np.empty(rhs.shape)
        x[p] = lu.solve((unit[:, None] * rhs)[p])
        return unit[:, None] * x

    return solve


def _cholesky(matrix, order):
    """Function that solves with a positive definite matrix by CHOLMOD."""
    lower = sparse.coo_array(sparse.tril(matrix))
    places = lower.row.astype(np.int64), lower.col.astype(np.int64)
    entries = cvxopt.spmatrix(lower.data, *places, matrix.shape)
    chosen = {} if order is None else {"p": cvxopt.matrix(order.astype(np.int64))}
    factor = cvxopt.cholmod.symbolic(entries, uplo="L", **chosen)
    cvxopt.cholmod.numeric(entries, factor)

    def solve(rhs):
        x = cvxopt.matrix(np.ascontiguousarray(rhs))
        cvxopt.cholmod.solve(factor, x)
        return np.array(x).reshape(rhs.shape)

    return solve
