"""Direct solution of sparse linear equations, with a check of the residual.

If the factors of a model would exceed the memory, an error is raised before the factorisation.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import scipy

from kc2spice.core.errors import MissingToolError, SimulationError, UsageError
from kc2spice.core.gmsh_session import gmsh_session
from kc2spice.core.memory import find_available_bytes
from kc2spice.core.user_warnings import warn_user
from kc2spice.linalg.openblas_kernels import use_fast_kernels
from kc2spice.linalg.solver import (
    DirectSolver,
    factorise_with_solver,
    get_selected_solver,
    solve_with_factor,
)

USABLE_MEMORY_SHARE = 0.9
# Number of entries of the LU factors of n equations, divided by n sqrt(bandwidth), for solids.
# The LU factors of a chain of elements have 4 n sqrt(bandwidth) entries for n equations.
# The LU factors of a plate have 9 n sqrt(bandwidth) entries for n equations.
FILL_FACTOR = 34.0
REAL_BYTES = 12.0  # memory [B] of a real entry of a factor: 8 for its value, 4 for shared indices
ENTRY_BYTES = 24.0  # memory [B] of a complex entry of a factor: its value, index and work space


def require_memory(need: float, purpose: str, *, where: str, hint: str) -> None:
    """Raise an error if a computation needs more memory than is free.

    ``need`` is the required memory in bytes, and ``purpose`` describes the computation.

    Raises
    ------
    UsageError : the free memory is less than ``need``.
    """
    free = USABLE_MEMORY_SHARE * find_available_bytes()
    if need > free:
        raise UsageError(
            "the model needs more memory than this machine has free",
            where=where,
            got=f"about {need / 1e9:.1f} GB for {purpose}",
            expected=f"at most {free / 1e9:.1f} GB",
            hint=hint,
        )


def require_memory_for_factors(
    matrix: scipy.sparse.sparray | np.ndarray, *, definite: bool = False, where: str = "reduction"
) -> None:
    """Raise an error if the factorisations of a model reduction need too much memory.

    A reduction needs one real and one complex LU factorisation. For plates, the memory estimate is
    up to five times too large. If ``definite`` is true, the matrix is definite or quasi-definite. A
    definite or quasi-definite matrix needs only one factor without pivoting, which has half as many
    entries as LU factors. If the user supplies a solver, this function does nothing, because the
    memory of this solver is unknown. ``where`` is the location that the error message states.

    Raises
    ------
    UsageError : the model is too large for this machine.
    """
    rows = matrix.shape[0]
    size = 0.5 * REAL_BYTES if definite else ENTRY_BYTES + REAL_BYTES
    # The first check uses the number of rows as an upper limit of the bandwidth.
    # Computing the bandwidth would take as long as assembling the matrix.
    if (
        get_selected_solver() is not None
        or size * FILL_FACTOR * rows**1.5 <= USABLE_MEMORY_SHARE * find_available_bytes()
    ):
        return
    pattern = scipy.sparse.csr_array(abs(matrix))
    order = scipy.sparse.csgraph.reverse_cuthill_mckee(pattern + pattern.T, symmetric_mode=True)
    place = np.empty(rows, dtype=np.int64)
    place[order] = np.arange(rows)
    entries = pattern.tocoo()
    band = int(np.abs(place[entries.row] - place[entries.col]).max(initial=0)) + 1
    require_memory(
        size * max(FILL_FACTOR * rows * np.sqrt(band), pattern.nnz),
        f"{rows} factorised equations",
        where=where,
        hint="use a coarser mesh, or a machine with more memory",
    )


Inverse: TypeAlias = Callable[[np.ndarray], np.ndarray]

# largest permitted backward error of a solution: 10^4 times the backward error of a stable solver
RESIDUAL_LIMIT = 1e-11
# Largest number of refinement steps of a solution. Factors without pivoting are less accurate.
# If k digits of a factor are correct, each step makes k more digits of the solution correct.
MAX_REFINEMENTS = 3
# Half-bandwidth up to which a banded factor takes less time than the search for an elimination
# order.
MAX_HALF_BANDWIDTH = 600
# Smallest number of unknowns for which a multifrontal factor in Python is faster than SuperLU.
QUASI_DEFINITE_UNKNOWNS = 20_000
# Smallest number of unknowns for which nested dissection saves more time than it takes.
DISSECTION_UNKNOWNS = 5000
_LINE_ELEMENT = 1  # gmsh's number of the element type with two nodes
# Number of stored elimination orders of sparse matrices.
# Two stored elimination orders suffice, because a reduction uses one or two sparsity patterns.
_STORED_ORDERS = 2
_orders: dict[bytes, np.ndarray | None] = {}


@dataclass(frozen=True, eq=False)
class Factor:
    """Factorised matrix that raises an error instead of an inaccurate solution.

    ``order`` (n,) is the elimination order, or None if the solver chose the order. ``negative`` is
    the number of negative eigenvalues of the matrix, or None if this number is unknown.

    While the backward error of a solution ``x`` exceeds ``RESIDUAL_LIMIT``, the solution is refined
    to ``x + A^-1 (rhs - A x)`` (Skeel 1980). After ``MAX_REFINEMENTS`` steps, :meth:`solve` raises
    an error.
    """

    matrix: scipy.sparse.csc_array
    apply_inverse: Inverse
    order: np.ndarray | None = None
    negative: int | None = None

    @cached_property
    def norm(self) -> float:
        """1-norm of the matrix."""
        return float(abs(self.matrix).sum(axis=0).max(initial=0.0))

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve ``A x = rhs`` for one (n,) or several (n, k) right-hand sides.

        If ``rhs`` has fewer rows than ``A``, the right-hand side is extended by zeros, and only the
        first ``len(rhs)`` unknowns are returned.

        Raises
        ------
        SimulationError : the backward error exceeds ``RESIDUAL_LIMIT``.
        """
        size = len(rhs)
        if more := self.matrix.shape[0] - size:
            rhs = np.concatenate([rhs, np.zeros((more, *rhs.shape[1:]))])
        solution = self.apply_inverse(rhs)
        for _ in range(MAX_REFINEMENTS):
            residual = rhs - self.matrix @ solution
            if self._compute_backward_error(solution, residual, rhs) <= RESIDUAL_LIMIT:
                return solution[:size]
            solution = solution + self.apply_inverse(residual)
        error = self._compute_backward_error(solution, rhs - self.matrix @ solution, rhs)
        if not error <= RESIDUAL_LIMIT:
            raise SimulationError(
                "the solution of the linear equations is inaccurate",
                where="direct solver",
                got=f"backward error {error:.1e}",
                expected=f"at most {RESIDUAL_LIMIT:g}",
                hint="check the supports and units of the model",
            )
        return solution[:size]

    def _compute_backward_error(
        self, x: np.ndarray, residual: np.ndarray, rhs: np.ndarray
    ) -> float:
        """Return the normwise backward error ``|r| / (|A| |x| + |rhs|)``."""
        scale = self.norm * np.abs(x).max(initial=0.0) + np.abs(rhs).max(initial=0.0)
        return float(np.abs(residual).max(initial=0.0) / scale) if scale else 0.0


Pair: TypeAlias = tuple[Factor, Factor]  # factors of a matrix and of its transpose


def factorise_supernodal(
    matrix: scipy.sparse.csc_array, order: np.ndarray | None = None
) -> Inverse:
    """Factorise a real matrix A as ``A[p][:, p] = L L'`` with CHOLMOD from cvxopt.

    ``order`` is the elimination order p. If ``order`` is None, CHOLMOD uses a minimum degree order.

    Raises
    ------
    RuntimeError : the matrix is not positive definite.
    """
    with use_fast_kernels():
        import cvxopt.cholmod  # imported here, because the other solvers do not need it

    lower = scipy.sparse.coo_array(scipy.sparse.tril(matrix))
    places = lower.row.astype(np.int64), lower.col.astype(np.int64)
    entries = cvxopt.spmatrix(lower.data, *places, matrix.shape)
    selected = {} if order is None else {"p": cvxopt.matrix(order.astype(np.int64))}
    factor = cvxopt.cholmod.symbolic(entries, uplo="L", **selected)
    try:
        cvxopt.cholmod.numeric(entries, factor)
    except ArithmeticError:
        raise RuntimeError("not positive definite") from None

    def solve(rhs: np.ndarray) -> np.ndarray:
        """Solve ``A x = rhs`` for one (n,) or several (n, k) right-hand sides."""
        x = cvxopt.matrix(np.asarray(rhs, dtype=float).reshape(len(rhs), -1))
        cvxopt.cholmod.solve(factor, x)
        return np.array(x).reshape(rhs.shape)

    return solve


def factorise(
    matrix: scipy.sparse.csc_array, *, definite: bool, order: np.ndarray | None = None
) -> Factor:
    """Factorise a real or complex symmetric matrix.

    For a positive definite matrix with a small half-bandwidth b, a banded Cholesky factor is
    computed, which costs n b^2 operations for n unknowns. For a positive definite matrix with a
    larger bandwidth, a supernodal Cholesky factor is computed. All other matrices are factorised by
    :func:`factorise_two_sided`.

    ``order`` is an elimination order, for example of a matrix with a similar sparsity pattern. If
    ``order`` is None, the function computes an elimination order of the unknowns. A solver that the
    user supplies is used for a definite matrix only if the solver counts negative eigenvalues.

    Raises
    ------
    SimulationError : the matrix is singular, or ``definite`` is true for an indefinite matrix.
    """
    if not definite:
        return factorise_two_sided(matrix, symmetric=True)[0]
    solver = get_selected_solver()
    if (
        solver is not None
        and (factor := _factorise_definite_with_solver(solver, matrix)) is not None
    ):
        return factor
    coo = scipy.sparse.coo_array(matrix)
    bandwidth = int(np.abs(coo.row - coo.col).max(initial=0))
    try:
        narrow = bandwidth <= MAX_HALF_BANDWIDTH
        if narrow:
            order, apply = None, _factorise_banded(coo, bandwidth)
        else:
            order = find_elimination_order(matrix) if order is None else order
            apply = factorise_supernodal(matrix, order)
    except (np.linalg.LinAlgError, RuntimeError) as error:
        raise make_indefinite_error(str(error)) from error
    return Factor(matrix, apply, order, negative=0)


SUPPORTS_HINT = "check that the supports of the model prevent all rigid-body modes"


def make_indefinite_error(got: str, hint: str = SUPPORTS_HINT) -> SimulationError:
    """Return the error for a matrix that has no Cholesky factor."""
    return SimulationError(
        "the matrix of the equations cannot be factorised",
        where="direct solver",
        got=got,
        expected="positive definite",
        hint=hint,
    )


def _factorise_definite_with_solver(
    solver: DirectSolver, matrix: scipy.sparse.csc_array
) -> Factor | None:
    """Factorise a positive definite matrix with the user's solver.

    The result is None if the solver does not count the negative eigenvalues of the matrix.
    """
    supplied = factorise_with_solver(solver, matrix)
    negative = getattr(supplied, "negative_eigenvalues", None)
    if negative is None:
        return None
    if negative:
        raise make_indefinite_error(f"{negative} negative eigenvalues")
    return Factor(matrix, lambda rhs: solve_with_factor(supplied, matrix, rhs), negative=0)


def _factorise_pair_with_solver(
    solver: DirectSolver, matrix: scipy.sparse.csc_array, symmetric: bool
) -> Pair:
    """Factorise a matrix and its transpose with the user's solver."""
    supplied = factorise_with_solver(solver, matrix)
    forward = Factor(matrix, lambda rhs: solve_with_factor(supplied, matrix, rhs))
    if symmetric:
        return forward, forward
    transpose = scipy.sparse.csc_array(matrix.T)
    dual = factorise_with_solver(solver, transpose)
    return forward, Factor(transpose, lambda rhs: solve_with_factor(dual, transpose, rhs))


def factorise_quasi_definite(matrix: scipy.sparse.csc_array) -> Factor:
    """Factorise a real symmetric matrix, without pivoting if it is quasi-definite.

    A matrix is quasi-definite if the rows with a positive diagonal entry form a positive definite
    block, and the other rows form a negative definite block. For a large quasi-definite matrix, a
    multifrontal factor is computed without pivoting. Other matrices are factorised by
    :func:`factorise_two_sided`.

    Raises
    ------
    SimulationError : the matrix is singular.
    """
    order = find_elimination_order(matrix) if get_selected_solver() is None else None
    if order is not None:
        minus = matrix.diagonal() < 0
        trial = np.random.default_rng(0).standard_normal(matrix.shape[0])
        try:
            # imported here, because the module loads scipy.linalg
            from kc2spice.linalg.quasidefinite import QuasiDefiniteFactor

            apply = QuasiDefiniteFactor(matrix, minus, _group_unknowns(matrix)[0], order).solve
            factor = Factor(matrix, apply, order, negative=int(minus.sum()))
            factor.solve(trial)
            return factor
        # some pivots have the wrong sign, so pivoting is necessary
        except (RuntimeError, SimulationError):
            require_memory_for_factors(matrix)
    return factorise_two_sided(matrix, symmetric=True)[0]


def factorise_two_sided(matrix: scipy.sparse.csc_array, *, symmetric: bool) -> Pair:
    """Factorise a sparse matrix and its transpose.

    A symmetric matrix is first factorised without pivoting. If a trial solution with this factor is
    inaccurate, for example for an indefinite matrix, the matrix is factorised again with partial
    pivoting.

    Raises
    ------
    SimulationError : the matrix is singular.
    """
    matrix = scipy.sparse.csc_array(matrix)
    solver = get_selected_solver()
    if solver is not None:
        return _factorise_pair_with_solver(solver, matrix, symmetric)
    trial = np.random.default_rng(0).standard_normal((matrix.shape[0], 1))
    reason: Exception | None = None
    for without_pivoting in (True, False) if symmetric else (False,):
        try:
            apply, transposed = _factorise_lu(matrix, without_pivoting)
            forward = Factor(matrix, apply)
            forward.solve(trial)
            return forward, Factor(scipy.sparse.csc_array(matrix.T), transposed)
        except (RuntimeError, MemoryError, SimulationError) as error:
            reason = error
    cause = reason.message if isinstance(reason, SimulationError) else str(reason)
    raise SimulationError(
        "the matrix of the equations cannot be factorised", where="direct solver", got=cause
    )


def _factorise_banded(coo: scipy.sparse.coo_array, bandwidth: int) -> Inverse:
    """Factorise a positive definite matrix by the banded Cholesky method."""
    band = np.zeros((bandwidth + 1, coo.shape[0]))
    lower = coo.row >= coo.col
    band[(coo.row - coo.col)[lower], coo.col[lower]] = coo.data[lower]
    factor = scipy.linalg.cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
    return lambda rhs: scipy.linalg.cho_solve_banded((factor, True), rhs, check_finite=False)


def _factorise_lu(matrix: scipy.sparse.csc_array, symmetric: bool) -> tuple[Inverse, Inverse]:
    """Factorise a matrix by LU; return solvers for it and for its transpose.

    If ``symmetric`` is true, all pivots are diagonal entries, even if these entries are small.
    """
    from scipy.sparse.linalg import splu

    order = find_elimination_order(matrix) if symmetric else None
    lu = splu(
        matrix if order is None else scipy.sparse.csc_array(matrix[order][:, order]),
        permc_spec="MMD_AT_PLUS_A" if order is None else "NATURAL",
        diag_pivot_thresh=0.0 if symmetric else 0.01,
        options={"SymmetricMode": symmetric},
    )

    def solve(rhs: np.ndarray, trans: str) -> np.ndarray:
        """Solve ``A x = rhs``, or with ``trans = "T"`` the transposed equations."""
        rhs = np.asarray(rhs).astype(matrix.dtype, casting="safe")
        if order is None:
            return np.asarray(lu.solve(rhs, trans))
        x = np.empty_like(rhs)
        x[order] = lu.solve(rhs[order], trans)
        return x

    return lambda rhs: solve(rhs, "N"), lambda rhs: solve(rhs, "T")


def find_elimination_order(matrix: scipy.sparse.csc_array) -> np.ndarray | None:
    """Find an elimination order for which the factors of a matrix are sparse.

    The order ``p`` (n,) is computed by nested dissection (METIS in gmsh) and applied as
    ``matrix[p][:, p]``. For small matrices, the function returns None, and the solver determines
    the order. If gmsh is not installed, the function issues a warning and returns None. In the
    graph for METIS, one vertex represents all unknowns whose columns have the same sparsity
    pattern, such as the unknowns of one node. Thus the graph for METIS equals the graph of the
    mesh. The elimination order affects the time and memory of a factorisation, but not the accuracy
    of solutions. The elimination orders of the most recent sparsity patterns are stored for later
    calls.

    Source: G. Karypis, V. Kumar, SIAM J. Sci. Comput. 20 (1998) 359.
    """
    if matrix.shape[0] < DISSECTION_UNKNOWNS:
        return None
    matrix = matrix if matrix.has_sorted_indices else matrix.sorted_indices()
    pattern = hashlib.blake2b(matrix.indptr.tobytes())
    pattern.update(matrix.indices.tobytes())
    key = pattern.digest()
    if key not in _orders:
        _orders[key] = _order_by_dissection(matrix)
        for old in list(_orders)[:-_STORED_ORDERS]:
            del _orders[old]
    return _orders[key]


def _order_by_dissection(matrix: scipy.sparse.csc_array) -> np.ndarray | None:
    """Compute an elimination order by nested dissection."""
    group, first = _group_unknowns(matrix)
    columns = scipy.sparse.coo_array(matrix[:, first])
    pairs = np.sort(np.column_stack([group[columns.row], columns.col]), axis=1).astype(np.int64)
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    key = np.sort(pairs[:, 0] * first.size + pairs[:, 1])
    key = key[np.diff(key, prepend=-1) > 0]  # numpy.unique would take as long as METIS
    place = np.full(first.size, first.size)
    if key.size:
        try:
            old, new = _order_graph(np.column_stack([key // first.size, key % first.size]))
        except MissingToolError as error:
            warn_user(
                f"the fast ordering of large matrices is not available, so "
                f"factorisations take longer: {error}"
            )
            return None
        place[old] = new
    return np.argsort(place[group], kind="stable")


def _group_unknowns(matrix: scipy.sparse.csc_array) -> tuple[np.ndarray, np.ndarray]:
    """Group unknowns whose matrix columns have the same sparsity pattern.

    The sparsity patterns are compared by a hash. Return the group number of each unknown, and the
    first unknown of each group.
    """
    words = np.random.default_rng(0).integers(0, 2**63, matrix.shape[0], dtype=np.uint64)
    total = np.r_[np.uint64(0), np.cumsum(words[matrix.indices], dtype=np.uint64)]
    mark = total[matrix.indptr[1:]] - total[matrix.indptr[:-1]]
    _, first, group = np.unique(mark, return_index=True, return_inverse=True)
    return group, first


def _order_graph(edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Order the nodes of a graph for elimination; return nodes and their positions.

    ``edges`` (m, 2) contains the edges of the graph. METIS in gmsh orders only the nodes of meshes,
    so each edge of the graph becomes a line element.
    """
    nodes = int(edges.max()) + 1
    with gmsh_session() as gmsh:
        gmsh.model.addDiscreteEntity(1, 1)
        gmsh.model.mesh.addNodes(1, 1, np.arange(1, nodes + 1), np.zeros(3 * nodes))
        numbers = np.arange(1, len(edges) + 1)
        gmsh.model.mesh.addElementsByType(1, _LINE_ELEMENT, numbers, (edges + 1).ravel())
        old, new = gmsh.model.mesh.computeRenumbering("Metis")
    return np.asarray(old, dtype=np.int64) - 1, np.asarray(new, dtype=np.int64) - 1
