"""Direct solution of the symmetric sparse systems of layered models, with a checked residual."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError
from kc2spice.linalg.cholesky import Cholesky
from kc2spice.linalg.ordering import nested_dissection

Inverse: TypeAlias = Callable[[np.ndarray], np.ndarray]

# A backward-stable solver leaves about 1e-15; four digits of slack for growth, no more.
RESIDUAL_LIMIT = 1e-11
# Factors without pivoting for size lose digits; each step of refinement gains what they kept.
REFINEMENTS = 3
# Up to this half-bandwidth a banded factor costs no more than the search for a better order.
NARROW = 600
# From so many unknowns on nested dissection repays its own time.
LARGE = 5000


@dataclass(frozen=True)
class Factor:
    """A factorised matrix and its 1-norm; ``solve`` refuses to return an inaccurate solution.

    A solution beyond ``RESIDUAL_LIMIT`` is refined first: ``x + A^-1 (rhs - A x)`` (Skeel 1980).
    """

    matrix: scipy.sparse.csc_array
    norm: float
    apply_inverse: Inverse

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve ``A x = rhs`` for one (n,) or several (n, k) right-hand sides.

        Raises
        ------
        SimulationError : the backward error exceeds ``RESIDUAL_LIMIT``.
        """
        solution = self.apply_inverse(rhs)
        for _ in range(REFINEMENTS):
            residual = rhs - self.matrix @ solution
            if self._backward_error(solution, residual, rhs) <= RESIDUAL_LIMIT:
                return solution
            solution = solution + self.apply_inverse(residual)
        error = self._backward_error(solution, rhs - self.matrix @ solution, rhs)
        if not error <= RESIDUAL_LIMIT:
            raise SimulationError(
                "linear solution is inaccurate",
                where="direct solver",
                got=f"backward error {error:.1e}",
                expected=f"at most {RESIDUAL_LIMIT:g}",
                hint="the model is singular or badly scaled: check its supports and units",
            )
        return solution

    def _backward_error(self, x: np.ndarray, residual: np.ndarray, rhs: np.ndarray) -> float:
        """Normwise: ``|r| / (|A| |x| + |rhs|)``, zero where nothing is asked."""
        scale = self.norm * np.abs(x).max(initial=0.0) + np.abs(rhs).max(initial=0.0)
        return float(np.abs(residual).max(initial=0.0) / scale) if scale else 0.0


def factorise(matrix: scipy.sparse.csc_array, *, definite: bool) -> Factor:
    """Factorise a symmetric matrix, real or complex.

    A narrow positive definite matrix (planes numbered one after another) gets a banded Cholesky
    factor, which costs n b^2 operations and no fill, any other definite one a supernodal Cholesky
    factor; everything else that of :func:`two_sided`.

    Raises
    ------
    SimulationError : ``definite`` was promised and is not true, or the matrix is singular.
    """
    if not definite:
        return two_sided(matrix, symmetric=True)[0]
    coo = scipy.sparse.coo_array(matrix)
    bandwidth = int(np.abs(coo.row - coo.col).max(initial=0))
    try:
        narrow = bandwidth <= NARROW
        apply = _banded(coo, bandwidth) if narrow else Cholesky(matrix, _order(matrix)).solve
    except (np.linalg.LinAlgError, RuntimeError) as error:
        raise SimulationError(
            "matrix cannot be factorised",
            where="direct solver",
            got=str(error),
            expected="positive definite",
            hint="the model may be free to move: check its supports",
        ) from error
    return Factor(matrix, _norm(matrix), apply)


def two_sided(matrix: scipy.sparse.csc_array, *, symmetric: bool) -> tuple[Factor, Factor]:
    """Factors of a sparse matrix and of its transpose; without pivoting first where that keeps the
    fill of a symmetric matrix.

    A trial solution shows whether that is accurate, and partial pivoting follows where it is not
    (indefinite matrices, saddle points).

    Raises
    ------
    SimulationError : singular.
    """
    matrix = scipy.sparse.csc_array(matrix)
    trial = np.random.default_rng(0).standard_normal((matrix.shape[0], 1))
    reason: Exception | None = None
    for without_pivoting in (True, False) if symmetric else (False,):
        try:
            apply, transposed = inverses(matrix, symmetric=without_pivoting)
            forward = Factor(matrix, _norm(matrix), apply)
            forward.solve(trial)
            return forward, Factor(scipy.sparse.csc_array(matrix.T), forward.norm, transposed)
        except (RuntimeError, MemoryError, SimulationError) as error:
            reason = error
    text = reason.message if isinstance(reason, SimulationError) else str(reason)
    raise SimulationError("matrix cannot be factorised", where="direct solver", got=text)


def _norm(matrix: scipy.sparse.csc_array) -> float:
    return float(abs(matrix).sum(axis=0).max()) if matrix.shape[0] else 0.0


def _banded(coo: scipy.sparse.coo_array, bandwidth: int) -> Inverse:
    band = np.zeros((bandwidth + 1, coo.shape[0]))
    lower = coo.row >= coo.col
    band[(coo.row - coo.col)[lower], coo.col[lower]] = coo.data[lower]
    factor = scipy.linalg.cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
    return lambda rhs: scipy.linalg.cho_solve_banded((factor, True), rhs, check_finite=False)


def inverses(matrix: scipy.sparse.csc_array, *, symmetric: bool) -> tuple[Inverse, Inverse]:
    """Solutions with the matrix and with its transpose, real or complex.

    ``symmetric`` skips pivoting for size: least fill, but only as accurate as a residual shows.

    Raises
    ------
    RuntimeError : singular.
    """
    from scipy.sparse.linalg import splu

    matrix = scipy.sparse.csc_array(matrix)
    order = _order(matrix) if symmetric else None
    lu = splu(
        matrix if order is None else scipy.sparse.csc_array(matrix[order][:, order]),
        permc_spec="MMD_AT_PLUS_A" if order is None else "NATURAL",
        diag_pivot_thresh=0.0 if symmetric else 0.01,
        options={"SymmetricMode": symmetric},
    )

    def solve(rhs: np.ndarray, trans: str) -> np.ndarray:
        rhs = np.asarray(rhs).astype(matrix.dtype, casting="safe")
        if order is None:
            return np.asarray(lu.solve(rhs, trans))
        x = np.empty_like(rhs)
        x[order] = lu.solve(rhs[order], trans)
        return x

    return lambda rhs: solve(rhs, "N"), lambda rhs: solve(rhs, "T")


def _order(matrix: scipy.sparse.csc_array) -> np.ndarray | None:
    """Nested dissection of large matrices; None leaves the order to the solver."""
    return nested_dissection(matrix) if matrix.shape[0] >= LARGE else None
