"""Elimination of constraints and infinite poles from linear models.

Finite-element programs enforce rigid couplings ``G x = 0`` by Lagrange multipliers l::

    M x'' + E x' + K x + G' l = B u        G x = 0

The constraints ``G x = 0`` permit the motions ``x = Z q`` with ``G Z = 0``. The model ``Z'MZ q'' +
Z'EZ q' + Z'KZ q = Z'B u`` has the same response, symmetry and definiteness. The multipliers l can
be computed from x by the first equation.

A descriptor model ``E x' = A x + B u`` with a singular E has infinite poles. In a basis that
separates E into a regular block and zeros, some equations are algebraic. Algebraic equations of
index 1 determine unknowns, which are eliminated. Algebraic equations of index 2 are constraints
with multipliers::

    E1 x' + P1 x + L l = B1 u        G x = B3 u        x = Z q + R u,  G R = B3

Source: P. Kunkel and V. Mehrmann, Differential-Algebraic Equations (2006), chapters 2 and 3.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError
from kc2spice.rom.pencil import (
    Matrix,
    Pencil,
    SchurComplement,
    convert_to_first_order,
    detect_rayleigh_damping,
    eliminate_massless,
    find_largest_entry,
    mask_unknowns_with_entries,
    to_dense,
)
from kc2spice.rom.transfer_function_error_scales import balance_matrix

# a constraint counts as linearly dependent if (pivot / largest pivot) is below this ratio
DEPENDENT_CONSTRAINT = 1e-12
# Singular values below this multiple of eps times the norm of the matrix count as zero.
# The multiple of eps is large, because the matrix E of many models is a product of matrices.
ZERO_SINGULAR_VALUE = 100.0
MAX_DESCRIPTOR_STATES = 2000  # largest number of states of a model whose infinite poles are removed
MAX_CONSTRAINT_ENTRIES = 5e7  # largest number of entries of the constraints as a dense matrix
NEGLIGIBLE_TERM = 1e-10  # terms below this fraction of the largest term count as zero


def eliminate_constraints(pencil: Pencil) -> Pencil:
    """Eliminate the constraints that Lagrange multipliers enforce.

    A pencil without multipliers is returned unchanged, as is a pencil whose response contains
    derivatives of the input.
    """
    rest, *others = pencil.coefficients
    if pencil.degree != 2 or isinstance(rest, SchurComplement) or pencil.rayleigh is not None:
        return pencil
    multipliers = _find_multipliers(rest, others)
    if not multipliers.any():
        return pencil
    keep, row = np.flatnonzero(~multipliers), np.flatnonzero(multipliers)
    K, E, M = (_select_submatrix(P, keep, keep) for P in pencil.coefficients)
    G, L = _select_submatrix(rest, row, keep), _select_submatrix(rest, keep, row)
    if pencil.B[row].any() or G.shape[0] * G.shape[1] > MAX_CONSTRAINT_ENTRIES:
        return pencil
    Z, rank = compute_null_basis(G)
    # Multipliers whose forces act on permitted motions cannot be eliminated.
    if Z.shape[1] == 0 or _exceeds_rounding(Z.T @ L, L):
        return pencil
    observed = pencil.C[:, row].any()
    if observed and rank < len(row):
        return pencil
    parts = [_symmetrise(Z.T @ P @ Z, pencil.is_symmetric) for P in (K, E, M)]
    if pencil.is_dense:
        parts = list(map(to_dense, parts))
    C = pencil.C[:, keep]
    B = Z.T @ pencil.B[keep]
    plain = Pencil(tuple(parts), B, B.T.copy() if pencil.is_collocated else C @ Z, pencil.D)
    return _insert_multipliers(plain, pencil, keep, row, (K, E, M), L, Z) if observed else plain


def _find_multipliers(rest: Matrix, others: list[Matrix]) -> np.ndarray:
    """Return a mask of the unknowns that are Lagrange multipliers.

    Multipliers have neither inertia nor damping, and no stiffness couples two multipliers.
    """
    result = ~mask_unknowns_with_entries(others) & (rest.diagonal() == 0)
    indices = np.flatnonzero(result)
    if indices.size:
        among = abs(_select_submatrix(rest, indices, indices))
        result[indices[np.asarray(among.sum(axis=0) + among.sum(axis=1)).ravel() > 0]] = False
    return np.asarray(result)


def compute_null_basis(G: Matrix) -> tuple[scipy.sparse.csc_array, int]:
    """Compute a sparse basis Z (n, n - rank) with ``G Z = 0``, and the rank of G.

    Most rows of Z are rows of the identity matrix. The other rows express dependent unknowns by
    independent unknowns.

    Examples
    --------
    >>> Z, rank = compute_null_basis(np.array([[1.0, -1.0, 0.0], [2.0, -2.0, 0.0]]))
    >>> rank, Z.toarray().round(12).tolist()
    (1, [[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    """
    G = scipy.sparse.csc_array(G)
    used = np.flatnonzero(np.asarray(abs(G).sum(axis=0)).ravel())
    block = G[:, used].toarray()
    block /= np.maximum(np.abs(block).max(axis=1, initial=0.0, keepdims=True), np.finfo(float).tiny)
    R, order = scipy.linalg.qr(block, mode="r", pivoting=True)
    size = np.abs(np.diag(R))
    rank = int((size > DEPENDENT_CONSTRAINT * size.max(initial=0.0)).sum())
    followers, leaders = used[order[:rank]], used[order[rank:]]
    follow = -scipy.linalg.solve_triangular(R[:rank, :rank], R[:rank, rank:])
    follow[np.abs(follow) < DEPENDENT_CONSTRAINT * np.abs(follow).max(initial=0.0)] = 0.0
    free = np.setdiff1d(np.arange(G.shape[1]), followers)
    column = np.empty(G.shape[1], dtype=int)
    column[free] = np.arange(free.size)
    i, j = np.nonzero(follow)
    rows, columns = np.r_[free, followers[i]], np.r_[column[free], column[leaders[j]]]
    values = np.r_[np.ones(free.size), follow[i, j]]
    return scipy.sparse.csc_array((values, (rows, columns)), (G.shape[1], free.size)), rank


def _insert_multipliers(
    plain: Pencil,
    pencil: Pencil,
    keep: np.ndarray,
    row: np.ndarray,
    parts: tuple[Matrix, ...],
    L: Matrix,
    Z: Matrix,
) -> Pencil:
    """Add the Lagrange multipliers of the constraints to the outputs of a model.

    The multipliers are ``l = S^-1 L'M^-1 (B u - E x' - K x)`` with ``S = L'M^-1 L``. If the
    multipliers depend on velocities, the result is a first-order model.
    """
    K, E, M = map(to_dense, parts)
    L, Z = to_dense(L), to_dense(Z)
    try:
        through = np.linalg.solve(M.T, L).T
        lift = pencil.C[:, row] @ np.linalg.solve(through @ L, through)
    except np.linalg.LinAlgError:
        return pencil
    small = plain.make_dense()
    C = pencil.C[:, keep] @ Z - lift @ K @ Z
    D = pencil.D + lift @ pencil.B[keep]
    speed = -lift @ E @ Z
    if (
        np.abs(speed).max(initial=0.0)
        <= NEGLIGIBLE_TERM * (np.abs(lift) @ np.abs(E) @ np.abs(Z)).max()
    ):
        return replace(small, C=C, D=D)
    omega = float(np.sqrt(find_largest_entry(K) / find_largest_entry(M)))
    result = convert_to_first_order(replace(small, C=C, D=D), omega)
    return replace(result, C=np.hstack([C, omega * speed]))


def deflate_infinite_poles(pencil: Pencil) -> Pencil:
    """Remove the infinite poles of a first-order descriptor model.

    The pencil is returned unchanged if E is regular, if the model is too large, or if the response
    contains derivatives of the input.
    """
    if pencil.degree != 1 or pencil.size > MAX_DESCRIPTOR_STATES or pencil.free:
        return pencil
    full = pencil.make_dense()
    rest, inertia = full.coefficients
    rows, columns = balance_matrix(
        np.abs(rest) / find_largest_entry(rest) + np.abs(inertia) / find_largest_entry(inertia)
    )
    if not _is_singular(inertia / np.outer(rows, columns)):
        return pencil
    symmetric = pencil.is_symmetric
    if symmetric:
        rows = columns = np.sqrt(rows * columns)
    P, E = rest / np.outer(rows, columns), inertia / np.outer(rows, columns)
    B, C = full.B / rows[:, None], full.C / columns
    U, V, rank = _split_by_rank(E, symmetric or np.array_equal(inertia, inertia.T))
    P, E, B, C = U.T @ P @ V, (U.T @ E @ V)[:rank, :rank], U.T @ B, C @ V
    # algebraic equations: first the equations that determine unknowns, then the constraints
    U2, V2, regular = _split_by_rank(P[rank:, rank:], symmetric, find_largest_entry(P))
    left, right = (scipy.linalg.block_diag(np.eye(rank), T) for T in (U2, V2))
    P, B, C = left.T @ P @ right, left.T @ B, C @ right
    known = slice(rank, rank + regular)
    inner = P[known, known]
    rest_of = np.r_[0:rank, rank + regular : len(P)]
    elimination = np.linalg.solve(inner, np.hstack([P[known][:, rest_of], B[known]]))
    keep = rest_of.size
    D = full.D + C[:, known] @ elimination[:, keep:]
    C = C[:, rest_of] - C[:, known] @ elimination[:, :keep]
    B = B[rest_of] - P[rest_of][:, known] @ elimination[:, keep:]
    P = P[np.ix_(rest_of, rest_of)] - P[rest_of][:, known] @ elimination[:, :keep]
    result = _eliminate_index_two(E, P, B, C, D, rank) if keep > rank else Pencil((P, E), B, C, D)
    return pencil if result is None else _restore_symmetry(result, symmetric, pencil.is_collocated)


def _eliminate_index_two(
    E: np.ndarray, P: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, n: int
) -> Pencil | None:
    """Eliminate the constraints (all equations after the first n) of an index-2 model.

    Return None if the index is higher than two, or if the response contains derivatives of the
    input.
    """
    L, G, B3, C3 = P[:n, n:], P[n:, :n], B[n:], C[:, n:]
    P, B, C = P[:n, :n], B[:n], C[:, :n]
    try:
        through = np.linalg.solve(E, L)  # E^-1 L
        S = G @ through
        size = np.linalg.svd(S, compute_uv=False)
        if (
            size[-1]
            <= ZERO_SINGULAR_VALUE
            * len(E)
            * np.finfo(float).eps
            * np.abs(G).max()
            * np.abs(through).max()
        ):
            return None
        R = through @ np.linalg.solve(S, B3)
        lift = np.linalg.solve(S, np.linalg.solve(E.T, G.T).T)  # S^-1 G E^-1
    except np.linalg.LinAlgError:
        return None
    Z, W = scipy.linalg.null_space(G), scipy.linalg.null_space(L.T)
    if Z.shape != W.shape:
        return None
    B3 = np.where(np.abs(B3) <= NEGLIGIBLE_TERM * np.abs(B).max(initial=0.0), 0.0, B3)
    slope = C3 @ np.linalg.solve(S, B3)
    if np.abs(slope).max(initial=0.0) > NEGLIGIBLE_TERM * (np.abs(C3).max() * np.abs(B3).max()):
        return None
    if symmetric := np.allclose(W @ (W.T @ Z), Z, atol=1e-10):
        W = Z
    drive = B - P @ R
    D = D + C @ R + C3 @ lift @ drive
    C = C @ Z - C3 @ lift @ P @ Z
    parts = W.T @ P @ Z, W.T @ E @ Z
    return (
        Pencil(parts, W.T @ drive, C, D) if symmetric or np.linalg.cond(parts[1]) < 1e12 else None
    )


def _is_singular(matrix: np.ndarray) -> bool:
    """Return whether a matrix is singular within rounding errors."""
    lu, _, singular = scipy.linalg.lapack.dgetrf(matrix)
    norm = float(np.abs(matrix).sum(axis=0).max(initial=0.0))
    inverse = 0.0 if singular else scipy.linalg.lapack.dgecon(lu, norm)[0]
    return bool(inverse <= ZERO_SINGULAR_VALUE * len(matrix) * np.finfo(float).eps)


def _split_by_rank(
    matrix: np.ndarray, symmetric: bool, scale: float = 0.0
) -> tuple[np.ndarray, np.ndarray, int]:
    """Separate the null space of a matrix P by orthogonal matrices U and V.

    The leading block of ``U'PV`` is regular, and all other entries are zero. Return U, V and the
    rank of P.
    """
    if symmetric and np.abs(matrix - matrix.T).max(initial=0.0) <= 1e-12 * find_largest_entry(
        matrix
    ):
        values, U = np.linalg.eigh(0.5 * (matrix + matrix.T))
        order = np.argsort(-np.abs(values))
        size, U = np.abs(values[order]), U[:, order]
        V = U
    else:
        U, size, Vt = np.linalg.svd(matrix)
        V = Vt.T
    limit = (
        ZERO_SINGULAR_VALUE * len(matrix) * np.finfo(float).eps * max(size.max(initial=0.0), scale)
    )
    return U, V, int((size > limit).sum())


def _restore_symmetry(pencil: Pencil, symmetric: bool, collocated: bool) -> Pencil:
    """Restore a symmetry that rounding errors of matrix products have destroyed."""
    parts = pencil.coefficients
    if symmetric:
        parts = tuple(0.5 * (P + P.T) for P in parts)
    near = pencil.B.shape == pencil.C.T.shape and not _exceeds_rounding(
        pencil.C.T - pencil.B, pencil.B
    )
    C = pencil.B.T.copy() if symmetric and collocated and near else pencil.C
    return Pencil(parts, pencil.B, C, pencil.D)


def _exceeds_rounding(difference: Matrix, reference: Matrix) -> bool:
    """Return whether a difference exceeds the rounding errors of a reference matrix."""
    return find_largest_entry(difference) > NEGLIGIBLE_TERM * find_largest_entry(reference)


def _select_submatrix(P: Matrix, rows: np.ndarray, columns: np.ndarray) -> Matrix:
    """Return the entries of a matrix in the given rows and columns."""
    return P[np.ix_(rows, columns)] if isinstance(P, np.ndarray) else P[rows][:, columns]


def _symmetrise(P: Matrix, symmetric: bool) -> Matrix:
    """Return the symmetric part of a matrix, or the matrix if ``symmetric`` is false."""
    P = scipy.sparse.csc_array(P) if scipy.sparse.issparse(P) else P
    return 0.5 * (P + P.T) if symmetric else P


def eliminate_algebraic_unknowns(pencil: Pencil) -> Pencil:
    """Eliminate the algebraic unknowns of a model, as the first step of a reduction.

    Return an equivalent model without constraints and without infinite poles. Unknowns with neither
    inertia nor damping are also eliminated.
    """
    try:
        pencil = deflate_infinite_poles(eliminate_massless(eliminate_constraints(pencil)))
    except (SimulationError, np.linalg.LinAlgError):
        pencil = eliminate_massless(pencil)
    return detect_rayleigh_damping(pencil)
