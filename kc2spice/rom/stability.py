"""Proofs of stability and passivity from the matrices or poles of a model.

The proofs apply to full-order and reduced-order models, and do not depend on the method of
reduction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError
from kc2spice.core.user_warnings import warn_user
from kc2spice.linalg.factor import factorise
from kc2spice.rom.pencil import Matrix, Pencil, SchurComplement, find_largest_entry, is_symmetric
from kc2spice.rom.rigid_body import split_rigid_body

# largest relative magnitude of a negative eigenvalue that counts as a rounding error
NEGATIVE_ROUNDING = 1e-12
# largest relative growth rate that counts as a rounding error of a pole on the imaginary axis
GROWTH_ROUNDING = 1e-8
DEFINITE_EVIDENCE = "definite matrices"
# number of unknowns up to which a factorisation takes less than 0.1 s
MAX_FACTORED_UNKNOWNS = 5_000
MISS_PROBABILITY = 1e-12  # accepted probability that Lanczos steps miss a negative eigenvalue
MAX_LANCZOS_STEPS = 200  # largest number of Lanczos steps
LANCZOS_INTERVAL = 20  # number of Lanczos steps between computations of the smallest Ritz value
MAX_POLE_STATES = 1200  # largest number of first-order states of a model whose poles are computed


@dataclass(frozen=True)
class StabilityProof:
    """Stability and passivity of a model, and the evidence for both.

    If ``stable`` is true, no pole is in the right half-plane, so that no motion grows
    exponentially. Even if ``stable`` is true, the displacement of a free rigid body may increase
    linearly. ``stable`` is None if the stability is unknown. If ``passive`` is true, the ports are
    proven to deliver no net energy. ``proof`` describes the evidence for both properties, or the
    reason why the stability is unknown.
    """

    stable: bool | None
    passive: bool
    proof: str

    @property
    def evidence(self) -> str:
        """Evidence of the stability, as text that follows the word "stability"."""
        return f"unknown: {self.proof}" if self.stable is None else f"from {self.proof}"


def prove_stability(
    pencil: Pencil, band: tuple[float, float], poles: np.ndarray | None = None
) -> StabilityProof:
    """Prove the stability and passivity of a full or reduced model, if possible.

    The proof first uses the symmetry and definiteness of the matrices. A second-order model cannot
    gain energy if M and K are symmetric positive semi-definite and the damping matrix E satisfies
    ``E + E^T >= 0``. Gyroscopic terms are allowed in E, because they are skew-symmetric. If ``C =
    B^T`` and ``D + D^T >= 0`` are also true, the second-order model is passive. The powers of the
    ports are force times velocity, and voltage times current. A first-order model cannot gain
    energy if E is symmetric positive semi-definite and ``A + A^T <= 0``. If ``C = B^T`` and ``D +
    D^T >= 0`` are also true, the first-order model is passive. The power of a port of a first-order
    model is input times output.

    If the symmetry and definiteness of the matrices do not prove stability, the poles show whether
    the model is stable. Poles do not prove passivity. The poles of models with more than
    ``MAX_POLE_STATES`` states are not computed. The caller passes ``poles`` [1/s] if the poles are
    known.
    """
    try:
        dissipates = is_dissipative(pencil)
    except MemoryError:
        warn_user(
            "there is not enough free memory to prove stability and passivity, so both properties "
            "are unknown; the error estimate is valid"
        )
        return StabilityProof(None, False, "not enough memory for another factorisation")
    if dissipates:
        passive = pencil.is_collocated and is_semidefinite(pencil.D + pencil.D.T)
        return StabilityProof(True, passive, DEFINITE_EVIDENCE)
    states = pencil.degree * pencil.size
    if states > MAX_POLE_STATES and poles is None:
        return StabilityProof(None, False, f"{states} states are too many to compute all poles")
    omega = 2 * np.pi * band[1]
    values = _compute_poles(pencil, omega) if poles is None else poles
    limit = GROWTH_ROUNDING * np.maximum(np.abs(values), omega)
    grows = values.real > limit
    rounded = states * np.finfo(float).eps * np.abs(values).max(initial=0.0)
    if grows.any() and (values.real[grows] <= rounded).all():
        return StabilityProof(
            None, False, "the positive real parts of some poles are below their rounding errors"
        )
    return StabilityProof(not grows.any(), False, "poles")


def _compute_poles(pencil: Pencil, omega: float) -> np.ndarray:
    """Compute all poles [1/s]; compute the poles of rigid-body modes separately.

    A computation of all poles together would halve the number of correct digits of the double poles
    of rigid-body modes.
    """
    result = (
        pencil
        if pencil.free
        else split_rigid_body(pencil.scale_unknowns(omega).make_dense(), omega).pencil
    )
    if not result.has_uncoupled_rigid_modes:
        return pencil.poles(omega)
    return np.asarray(
        np.r_[
            result.truncate_to_order(result.free).poles(omega),
            result.without_rigid_body_modes.poles(omega),
        ]
    )


def is_dissipative(pencil: Pencil) -> bool:
    """Return whether the matrices prove that a model cannot create energy."""
    rest, *others = pencil.coefficients
    order = pencil.elimination_order
    if not is_semidefinite(others[-1], order):
        return False
    # Rayleigh damping with non-negative factors is semidefinite if M and K are semidefinite
    if pencil.rayleigh is None or min(pencil.rayleigh) < 0:
        loss = others[0] if others[1:] else rest
        if not is_semidefinite(loss if isinstance(loss, SchurComplement) else loss + loss.T, order):
            return False
    # an existing factorisation of K may prove that K is definite
    if isinstance(rest, SchurComplement):
        definite = rest.is_proven_definite(pencil.factors.value_or_none) and pencil.is_symmetric
    else:
        definite = pencil.is_factorised and pencil.is_symmetric
    return pencil.degree == 1 or definite or is_semidefinite(rest)


def is_semidefinite(matrix: Matrix, order: np.ndarray | None = None) -> bool:
    """Return whether a matrix is symmetric and positive semidefinite.

    ``order`` is the elimination order for a sparse matrix, if it is known.
    """
    if isinstance(matrix, SchurComplement):
        if not matrix.is_symmetric:
            return False
        # the elimination of electric potentials increases the stiffness
        if is_semidefinite(-matrix.pp):
            return is_semidefinite(matrix.uu)
        blocks = [[matrix.uu, matrix.up], [matrix.pu, matrix.pp]]
        return is_semidefinite(scipy.sparse.csc_array(scipy.sparse.block_array(blocks)))
    if not isinstance(matrix, np.ndarray):
        return _is_sparse_semidefinite(scipy.sparse.csc_array(matrix), order)
    if matrix.size == 0:
        return True
    if find_largest_entry(matrix - matrix.T) > NEGATIVE_ROUNDING * find_largest_entry(matrix):
        return False
    values = np.linalg.eigvalsh(matrix)
    return bool(values[0] >= -NEGATIVE_ROUNDING * abs(values[-1]))


def _is_positive_by_lanczos(matrix: Matrix, empty: np.ndarray, spread: float) -> bool:
    """Return whether Lanczos steps prove that all eigenvalues are positive.

    Rows in the mask ``empty`` are ignored. Let x be the smallest Ritz value after k steps from a
    random vector of n numbers. ``spread`` is an upper bound of the eigenvalues. The probability
    that x exceeds the smallest eigenvalue by more than ``e * spread`` is below
    ``1.648 sqrt(n) exp(-sqrt(e) (2 k - 1))``. For ``e = x / spread``, this expression is a bound of
    the probability that an eigenvalue is negative. For a mass matrix with a unit diagonal, the
    smallest Ritz value x is about 0.1. The proof for such a mass matrix needs about 80
    matrix-vector products, which take a tenth of the time of a factorisation. The result is False
    if x is so small that more than :data:`MAX_LANCZOS_STEPS` steps would be necessary.

    Source: J. Kuczynski, H. Wozniakowski, SIAM J. Matrix Anal. Appl. 13 (1992) 1094.
    """
    n = matrix.shape[0]
    v = np.where(empty, 0.0, np.random.default_rng(0).standard_normal(n))
    v, before = v / np.linalg.norm(v), np.zeros(n)
    diagonal, beside = list[float](), list[float]()
    needed = math.log(1.648 * math.sqrt(n) / MISS_PROBABILITY)
    for k in range(1, MAX_LANCZOS_STEPS + 1):
        w = matrix @ v - (beside[-1] if beside else 0.0) * before
        diagonal.append(float(v @ w))
        w -= diagonal[-1] * v
        beside.append(float(np.linalg.norm(w)))
        if not beside[-1] > 0:
            return False
        before, v = v, w / beside[-1]
        if k % LANCZOS_INTERVAL:
            continue
        (least,) = scipy.linalg.eigvalsh_tridiagonal(
            diagonal, beside[:-1], select="i", select_range=(0, 0)
        )
        if least <= 0 or math.sqrt(least / spread) * (2 * MAX_LANCZOS_STEPS - 1) < needed:
            return False
        if math.sqrt(least / spread) * (2 * k - 1) >= needed:
            return True
    return False


def _is_sparse_semidefinite(matrix: Matrix, order: np.ndarray | None = None) -> bool:
    """Return whether a sparse matrix is positive semidefinite within rounding errors.

    The diagonal of the matrix is first scaled to one. If the Lanczos method proves that all
    eigenvalues of a large matrix are positive, the result is True. If the Lanczos method gives no
    proof, a small multiple of the machine precision is added to the diagonal of the matrix. If the
    matrix with the increased diagonal has a Cholesky factor, the matrix without the increase counts
    as semidefinite.
    """
    if not find_largest_entry(matrix):
        return True
    diagonal = matrix.diagonal()
    empty = np.asarray(abs(matrix).max(axis=0).toarray()).ravel() == 0
    if not is_symmetric(matrix) or (diagonal[~empty] <= 0).any():
        return False
    T = scipy.sparse.diags_array(1 / np.sqrt(np.where(empty, 1.0, diagonal)))
    scaled = T @ (0.5 * (matrix + matrix.T)) @ T
    spread = float(abs(scaled).sum(axis=0).max())  # upper bound of the eigenvalues
    if matrix.shape[0] > MAX_FACTORED_UNKNOWNS and _is_positive_by_lanczos(scaled, empty, spread):
        return True
    shift = NEGATIVE_ROUNDING * spread
    added_diagonal = scipy.sparse.diags_array(np.where(empty, 1.0, shift))
    try:
        factorise(scipy.sparse.csc_array(scaled + added_diagonal), definite=True, order=order)
    except SimulationError:
        return False
    return True
