"""Balanced truncation over all frequencies, by the Gramians of a stable model.

In balanced coordinates, each state is as controllable as it is observable. The most controllable
state comes first. Inputs and outputs are scaled by the peaks of the response, so that small and
large entries have equal weights.
"""

from __future__ import annotations

import numpy as np
import scipy

from kc2spice.rom.pencil import Pencil, make_explicit_pencil
from kc2spice.rom.reduced_basis import ReducedBasis, ReductionTask
from kc2spice.rom.reductors.base import Reductor

# limits of the computing time, which grows with the cube of the number of states; found by trials
MAX_STATES = 2000  # largest number of first-order states for dense Gramians
# largest number of first-order states for which unscaled inputs and outputs are also tried
MAX_UNSCALED_STATES = 500
# Smallest decay rate of a pole, relative to the angular frequency at the end of the band.
# Gramians of models with slower poles contain only rounding errors.
MIN_DECAY = 1e-9
SYLVESTER_BLOCK = 64  # largest block of a Lyapunov equation that LAPACK solves at once
# Hankel singular values below this fraction of the largest one are rounding errors
HANKEL_ROUNDING = 1e-13
NOT_STABLE_TEXT = "the model is not strictly stable"


class BalancedTruncation(Reductor):
    """Balanced truncation by the square root method.

    The Gramians of a stable first-order model are ``P = R R'`` and ``Q = L L'``. With the singular
    value decomposition ``L'R = U S Z'``, the projection is ``V = R Z S^(-1/2)`` and ``W = L U
    S^(-1/2)``. For order q, the largest singular value of the error at any frequency is at most ``2
    (s_(q+1) + s_(q+2) + ...)``.

    Parameters
    ----------
    scaled : bool
        Whether inputs and outputs are scaled by the peaks of the response.

    Examples
    --------
    If one of two relaxations is a million times weaker, one state is enough.

    >>> import numpy as np
    >>> import kc2spice as kc
    >>> A, B = np.diag([-1.0, -3.0]), np.array([[1.0], [1e-3]])
    >>> rom = kc.reduce(
    ...     kc.LinearModel(A=A, B=B, C=B.T), tolerance=1e-4, band=(0, 1), norm="peak",
    ...     method="balanced truncation",
    ... )
    >>> print(rom.order, f"{rom.A[0, 0]:.4f}")
    1 -1.0000
    """

    reference = "Laub, Heath, Paige and Ward, IEEE Trans. Autom. Control 32 (1987) 115"
    congruence = False
    no_basis = NOT_STABLE_TEXT

    def __init__(self, scaled: bool = True) -> None:
        self.scaled = scaled
        self.name = "balanced truncation" if scaled else "unscaled balanced truncation"

    def obstacle(self, task: ReductionTask) -> str:
        """Explain why the method does not apply to the model; return "" if it applies."""
        reason = explain_no_gramians(task)
        if reason or self.scaled:
            return reason
        if task.estimator.exact_response_and_scales[1].peak.size == 1:
            return "scaling has no effect on a single transfer function: use 'balanced truncation'"
        return explain_too_large(task.first_order_response.pencil.size, MAX_UNSCALED_STATES)

    def basis(self, task: ReductionTask) -> ReducedBasis | None:
        """Return the balanced basis, or None if the model is not strictly stable."""
        return task.get_shared_value(self.name, lambda: self._balance(task))

    def _balance(self, task: ReductionTask) -> ReducedBasis | None:
        """Return the balanced basis of a task, or None if the Gramians do not exist."""
        rows, columns = compute_balancing_factors(task.estimator.exact_response_and_scales[1].peak)
        if not self.scaled:
            rows, columns = np.ones(len(rows)), np.ones(len(columns))
        roots = _compute_gramian_roots(task.first_order_response.pencil, rows, columns)
        return (
            None if roots is None else balance_model(task, task.first_order_response.pencil, *roots)
        )


def compute_hankel_singular_values(task: ReductionTask) -> np.ndarray | None:
    """Return the Hankel singular values of the intermediate model in descending order.

    The result is None if the model is too large, or is not strictly stable.
    """
    if not has_gramians(task):
        return None
    model = task.first_order_response.pencil
    roots = _compute_gramian_roots(model, np.ones(len(model.C)), np.ones(model.B.shape[1]))
    return None if roots is None else np.linalg.svd(roots[1].T @ roots[0], compute_uv=False)


def _compute_gramian_roots(
    model: Pencil, rows: np.ndarray, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Compute square roots of the controllability and observability Gramians.

    Each row of C is divided by its entry of ``rows``, and each column of B by its entry of
    ``columns``. Return None if the model is not strictly stable.
    """
    A = -model.coefficients[0]
    if np.linalg.eigvals(A).real.max() > -MIN_DECAY:
        return None
    controllable = _compute_gramian_root(A, model.B / columns)
    return controllable, _compute_gramian_root(A, (model.C / rows[:, None]).T, transposed=True)


def has_gramians(task: ReductionTask) -> bool:
    """Return whether dense Gramians exist and are small enough to be computed.

    The Gramians exist if the model has a static response, and if rigid-body modes are not coupled
    to other motions by damping.
    """
    return not explain_no_gramians(task)


def explain_no_gramians(task: ReductionTask) -> str:
    """Return the reason why dense Gramians cannot be computed, or "" if they can."""
    if task.pencil_without_rigid_modes.free:
        return "damping couples rigid-body modes to other motions, so Gramians do not exist"
    if not task.intermediate.static:
        return "the model has no static response, so Gramians do not exist"
    return explain_too_large(task.state_count, MAX_STATES)


def explain_too_large(states: int, largest: int) -> str:
    """Return the reason why a model has too many states, or "" if it is small enough."""
    if states <= largest:
        return ""
    return f"the intermediate model has {states} first-order states, more than {largest}"


def balance_model(
    task: ReductionTask, model: Pencil, controllable: np.ndarray, observable: np.ndarray
) -> ReducedBasis | None:
    """Balance a first-order model by square roots of its two Gramians.

    The result is None if the product of the two square roots of Gramians exceeds the float range.
    For example, poles at 1e21 1/s cause such an overflow.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        product = observable.T @ controllable
    if not np.isfinite(product).all():
        return None
    U, hankel, Zt = np.linalg.svd(product)
    count = int((hankel > HANKEL_ROUNDING * hankel[0]).sum())
    V = controllable @ Zt[:count].T / np.sqrt(hankel[:count])
    W = observable @ U[:, :count] / np.sqrt(hankel[:count])
    A = -model.coefficients[0]
    balanced = task.restore_units_and_rigid_modes(
        make_explicit_pencil(W.T @ A @ V, W.T @ model.B, model.C @ V, model.D)
    )
    vectors = scipy.linalg.block_diag(np.eye(balanced.free), V)
    return ReducedBasis(
        task, balanced, balanced.free, congruence=False, vectors=vectors, coordinates="first order"
    )


def compute_balancing_factors(size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return balancing factors of rows and columns: ``r_i c_j`` is near ``size_ij``.

    ``size`` contains the magnitudes of the entries of one or more matrices, in an array of shape
    (..., rows, columns). The factors minimise the sum of the squares of ``log(r_i c_j) -
    log(size_ij)`` over all entries.
    """
    log = np.log(np.where(size > 0, size, size.max(initial=0.0) or 1.0))
    half = 0.5 * log.mean(axis=(-2, -1))[..., None]
    return np.exp(log.mean(axis=-1) - half), np.exp(log.mean(axis=-2) - half)


def _compute_gramian_root(T: np.ndarray, Q: np.ndarray, transposed: bool = False) -> np.ndarray:
    """Solve ``T X + X T' = -Q Q'`` for the Gramian X; return R with ``X = R R'``.

    The matrix T is in real Schur form. If ``transposed`` is true, the equation contains T' instead
    of T. If rounding errors make X slightly indefinite, its negative eigenvalues are set to zero.
    """
    C = -Q @ Q.T
    if transposed:  # if rows and columns are reversed, T' is in Schur form
        X = _solve_sylvester(T.T[::-1, ::-1], T.T[::-1, ::-1], C[::-1, ::-1])[::-1, ::-1]
    else:
        X = _solve_sylvester(T, T, C)
    values, vectors = np.linalg.eigh(0.5 * (X + X.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _solve_sylvester(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Solve ``A X + X B' = C`` for X by recursion; A and B are in real Schur form.

    LAPACK computes one column of X after another. The recursion is faster than LAPACK, because it
    computes most of X by products of large matrix blocks. Source: I. Jonsson, B. Kagstrom, ACM
    Trans. Math. Softw. 28 (2002) 392.
    """
    rows, columns = C.shape
    if max(rows, columns) <= SYLVESTER_BLOCK:
        X, scale, _ = scipy.linalg.lapack.dtrsyl(A, B, C, tranb="T")
        return np.asarray(X / scale)
    if rows >= columns:
        k = _find_schur_middle(A)
        low = _solve_sylvester(A[k:, k:], B, C[k:])
        high = _solve_sylvester(A[:k, :k], B, C[:k] - A[:k, k:] @ low)
        return np.concatenate([high, low])
    k = _find_schur_middle(B)
    right = _solve_sylvester(A, B[k:, k:], C[:, k:])
    left = _solve_sylvester(A, B[:k, :k], C[:, :k] - right @ B[:k, k:].T)
    return np.hstack([left, right])


def _find_schur_middle(T: np.ndarray) -> int:
    """Return an index near the middle of a Schur form that splits no 2 x 2 block."""
    k = len(T) // 2
    return k + 1 if T[k, k - 1] else k
