"""Rigid-body modes of a model, and their exact separation from all other unknowns.

In this module, the term *rigid-body mode* includes all integrators, which are modes with a pole at
zero. The response of rigid-body modes grows without bound as the frequency approaches zero. The
stiffness of rigid-body modes is set to exactly zero. Reduction bases and response peaks exclude
rigid-body modes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np
import scipy

from kc2spice.core.user_warnings import warn_user
from kc2spice.linalg.extended_precision import ExtendedPrecisionMatrix
from kc2spice.rom.pencil import (
    Matrix,
    Pencil,
    SchurComplement,
    compute_absolute_entries,
    convert_to_first_order,
    find_largest_entry,
    is_symmetric,
)

# Bound of the rounding error of a matrix entry, relative to ``n * eps`` times the entry. Stiffness,
# damping and coupling below the bounds of their rounding errors count as zero.
ROUNDING_FACTOR = 8.0
# A pole counts as zero if its magnitude is at most this fraction of the end of the band.
# The relative rounding error of a double pole is about the square root of eps.
ZERO_POLE_RATIO = 1e-6
# A real pole below this fraction of the upper band limit belongs to a damped rigid-body mode.
SLOW_POLE_RATIO = 1e-2
# largest energy that counts as a rounding error, relative to the effect of random rounding on the
# energy
ENERGY_FACTOR = 30.0
# A mode counts as supported if its elastic energy exceeds ENERGY_MARGIN times the random rounding
# error of this energy.
ENERGY_MARGIN = 4.0
# At SUPPORT_RATIO times the resonance frequency of a support, the support changes the response by
# 1e-4.
SUPPORT_RATIO = 100.0
# A matrix counts as regular if its reciprocal condition number exceeds REGULAR_FACTOR times its
# relative rounding error.
REGULAR_FACTOR = 10.0
# In chains of integrators, a singular value of the state matrix counts as zero up to
# CHAIN_RATE_RATIO times the angular frequency at the end of the band.
CHAIN_RATE_RATIO = 1e-9
# bounds of the rounding errors of all entries, one array for each coefficient of a pencil
Rounding: TypeAlias = tuple[np.ndarray, ...]


class RigidBodySplit(NamedTuple):
    """Split of a pencil into rigid-body modes and other coordinates, with the basis.

    The first ``pencil.free`` unknowns of ``pencil`` are rigid-body modes. ``columns`` contains the
    basis vectors of all coordinates, expressed in the original unknowns. If ``static`` is true, the
    other coordinates have a static response. ``projected`` is the pencil with its rounding errors,
    before these errors are set to zero. If no congruence separates the rigid-body modes,
    ``projected`` is None.
    """

    pencil: Pencil
    columns: np.ndarray
    static: bool
    projected: Pencil | None = None


def split_rigid_body(
    pencil: Pencil, omega: float, rounding: Rounding | None = None
) -> RigidBodySplit:
    """Transform a dense pencil so that its first unknowns are the rigid-body modes.

    If there are no rigid-body modes, the result contains the unchanged pencil.

    A rigid-body mode X of a symmetric model, or of a dissipative model, satisfies ``K X = 0`` and
    ``X^T K = 0``. For symmetric models, and for dissipative models, a congruence ``V^T P V``
    preserves the symmetry and definiteness of the matrices P. The inertia matrix does not couple X
    to the other coordinates, but damping may do so. All other models are converted to first-order
    models. In a first-order model, the invariant subspaces of the poles near zero separate the
    rigid-body modes. Whether a pole is near zero is decided relative to ``omega`` [rad/s].
    ``rounding`` contains bounds of the rounding errors of matrix entries, if known.
    """
    rest, inertia = pencil.coefficients[0], pencil.coefficients[-1]
    X = _compute_null_space(rest, (rounding or _bound_rounding(pencil))[0])
    X = _select_zero_energy_motions(rest, X, None if rounding is None else rounding[0])
    rounding = rounding or _bound_rounding(pencil)
    free = X.shape[1]
    if not free:
        return RigidBodySplit(pencil, np.eye(pencil.size), True)
    if is_symmetric(inertia) and _is_force_free(rest.T, X, rounding[0].T):
        others = scipy.linalg.null_space((inertia @ X).T)
        if others.shape[1] + free == pencil.size:
            return _split_congruently(pencil, X, others, rounding)
    result, V = _project_obliquely(convert_to_first_order(pencil, omega), omega)
    return (
        RigidBodySplit(result, V, True)
        if result.free
        else RigidBodySplit(pencil, np.eye(pencil.size), False)
    )


def split_driven_modes(pencil: Pencil, free: int, rounding: Rounding) -> RigidBodySplit:
    """Separate driven rigid-body modes from other unknowns; omit undriven modes.

    The rigid-body modes are the first ``free`` unknowns of the pencil. Entries that are only
    rounding errors are set to zero. ``rounding`` contains bounds of the rounding errors of all
    matrix entries.
    """
    X = np.eye(pencil.size)[:, :free]
    others = scipy.linalg.null_space((pencil.coefficients[-1] @ X).T)
    return _split_congruently(pencil, X, others, rounding)


def _split_congruently(
    pencil: Pencil, X: np.ndarray, others: np.ndarray, rounding: Rounding
) -> RigidBodySplit:
    """Split a pencil by a congruence: driven rigid-body modes first, then ``others``."""
    X = _select_driven_modes(pencil, X, rounding)
    V = np.hstack([X, others])
    result, projected = project_with_rigid_body(pencil, V, X.shape[1], rounding)
    return RigidBodySplit(result, V, True, projected)


def select_rigid_body_pencil(pencil: Pencil, omega: float) -> Pencil | None:
    """Select the pencil of the rigid-body modes, or return None if there are none."""
    if pencil.free and not pencil.has_uncoupled_rigid_modes:
        pencil = _project_obliquely(convert_to_first_order(pencil, omega), omega)[0]
    return pencil.truncate_to_order(pencil.free) if pencil.free else None


def _bound_rounding(pencil: Pencil) -> Rounding:
    """Return bounds of the rounding errors of all matrix entries of a pencil."""
    limit = ROUNDING_FACTOR * np.finfo(float).eps * pencil.size
    return tuple(limit * np.abs(P) for P in pencil.coefficients)


def _compute_null_space(K: np.ndarray, rounding: np.ndarray) -> np.ndarray:
    """Compute orthonormal columns X with ``K X = 0`` within ``rounding``.

    ``rounding`` contains one bound for each entry of K. Rounding errors of large entries therefore
    do not hide small entries.
    """
    rows = rounding.max(axis=1)
    rows = 1 / np.where(rows > 0, rows, 1.0)[:, None]
    columns = (rows * rounding).max(axis=0)
    columns = 1 / np.where(columns > 0, columns, 1.0)
    noise = rows * rounding * columns
    lu, _, singular = scipy.linalg.lapack.dgetrf(rows * K * columns)
    inverse = 0.0 if singular else scipy.linalg.lapack.dgecon(lu, 1.0)[0]
    # the condition number is estimated in another norm, which requires a safety factor
    if inverse > REGULAR_FACTOR * np.sqrt(len(K)) * np.linalg.norm(noise):
        return np.empty((len(K), 0))
    _, size, Vt = np.linalg.svd(rows * K * columns)
    limit = np.linalg.norm(noise, 2)
    return np.linalg.qr(columns[:, None] * Vt[size <= limit].T)[0]


def _select_zero_energy_motions(
    K: np.ndarray, X: np.ndarray, rounding: np.ndarray | None
) -> np.ndarray:
    """Select the motions in X whose elastic energy is only a rounding error.

    X has the shape (n, motions). By default, the rounding error of the energy is estimated for
    random rounding of the entries of K. If ``rounding`` contains bounds of the rounding errors of
    the entries of K, the bounds determine the rounding error of the energy.
    """
    if not X.size or not is_symmetric(K):
        return X
    energy = np.asarray(
        ExtendedPrecisionMatrix(X.T) @ (ExtendedPrecisionMatrix(K) @ X), dtype=float
    )
    rotation, size, _ = np.linalg.svd(energy)
    X = X @ rotation
    noise = (
        ENERGY_FACTOR * estimate_energy_rounding(K, X)
        if rounding is None
        else abs(X).T @ rounding @ abs(X)
    )
    return np.asarray(X[:, size <= np.diag(noise)])


def estimate_energy_rounding(P: Matrix, V: np.ndarray) -> np.ndarray:
    """Estimate the errors (k, k) of ``V'PV`` due to random rounding of the matrix P.

    The rounding errors of the entries of P are independent, so the squares of the effects of all
    entries add up: ``eps * sqrt(sum_ij v_ik^2 P_ij^2 v_jl^2)``.
    """
    squares = V**2
    return np.asarray(
        np.finfo(float).eps * np.sqrt(squares.T @ (compute_absolute_entries(P) ** 2 @ squares))
    )


def estimate_hidden_frequency(pencil: Pencil, X: np.ndarray, low: float) -> float:
    """Estimate the frequency [Hz] below which rounding hides a support's resonance.

    A support of the rigid-body modes X (n, modes) is hidden if the stiffness of the support is
    within the random rounding errors of K. Without rigid-body modes, the result is zero.

    The reduced model omits the stiffness of the modes X. If the stiffness of a rigid-body mode
    slightly exceeds the rounding errors of K, the body has a soft support that the reduced model
    neglects. The function then warns, unless ``low`` [Hz], the lower end of the band, is far above
    the resonance of the support.
    """
    K, M = pencil.coefficients[0], pencil.coefficients[-1]
    if (
        pencil.degree != 2
        or isinstance(K, SchurComplement)
        or not X.size
        or not pencil.is_symmetric
    ):
        return 0.0
    i, j, value = scipy.sparse.find(K)
    # energies of soft modes are small differences of large numbers, and need extended precision
    exact = np.asarray(X, dtype=np.longdouble)
    force = np.zeros(exact.shape, dtype=np.longdouble)
    np.add.at(force, i, value.astype(np.longdouble)[:, None] * exact[j])
    rotation, size, _ = np.linalg.svd(np.asarray(exact.T @ force, dtype=float))
    X = X @ rotation
    random = np.diag(estimate_energy_rounding(K, X))
    mass = np.einsum("ij,ij->j", X, M @ X)
    if not (mass > 0).all():
        return 0.0
    support = size > ENERGY_MARGIN * random
    frequency = float(np.sqrt((size / mass)[support].max(initial=0.0)) / (2 * np.pi))
    if support.any() and low < SUPPORT_RATIO * frequency:
        warn_user(
            "the stiffness of a support is below the rounding errors of the stiffness matrix: "
            f"the model neglects the support and its resonance at about {frequency:.2g} Hz; "
            "model the support as a part of the circuit"
        )
    return float(np.sqrt((ENERGY_FACTOR * random / mass).max()) / (2 * np.pi))


def _is_force_free(P: np.ndarray, X: np.ndarray, rounding: np.ndarray) -> bool:
    """Return whether motions X cause no forces ``P X``, within rounding errors."""
    return bool((np.abs(P @ X) <= rounding.sum(axis=1)[:, None] * np.abs(X).max(axis=0)).all())


def _select_driven_modes(pencil: Pencil, X: np.ndarray, rounding: Rounding) -> np.ndarray:
    """Select the rigid-body modes in X that an input drives.

    If inputs and outputs are not collocated, or if damping acts on the modes, all modes are
    returned.
    """
    *between, inertia = pencil.coefficients
    damped = not all(_is_force_free(P, X, R) for P, R in zip(between, rounding, strict=False))
    if damped or not pencil.is_collocated:
        return X
    X = X @ np.linalg.inv(np.linalg.cholesky(X.T @ inertia @ X)).T
    U, size, _ = np.linalg.svd(X.T @ pencil.B)
    K, momenta = pencil.coefficients[0], inertia @ X
    momenta *= np.sqrt(find_largest_entry(K)) / find_largest_entry(momenta)
    # Rounding errors of K mix the driven modes with modes that no input drives.
    # Therefore, the limit for driven modes is computed from the response to the inputs.
    response = np.linalg.solve(K + momenta @ momenta.T, pencil.B)
    input_rounding = ROUNDING_FACTOR * np.finfo(float).eps * pencil.size * np.abs(pencil.B)
    noise = np.abs(X.T) @ (input_rounding + rounding[0] @ np.abs(response))
    moved = int((size > find_largest_entry(noise)).sum())
    return np.asarray(X @ U[:, :moved])


def project_with_rigid_body(
    pencil: Pencil, V: np.ndarray, free: int, rounding: Rounding | None = None
) -> tuple[Pencil, Pencil]:
    """Project a dense pencil on V, whose first ``free`` columns are rigid-body modes.

    In the first result, entries of ``V'PV`` that are only rounding errors are set to zero. The
    second result is ``V'PV`` with all entries as computed, including rounding errors.
    """
    result, parts = pencil.project_in_extended_precision(V), []
    for P, noise in zip(result.coefficients, rounding or _bound_rounding(pencil), strict=True):
        zero = np.abs(P) <= np.abs(V).T @ (noise @ np.abs(V))
        zero[free:, free:] = False
        parts.append(np.where(zero, 0.0, P))
    parts[0][:free] = parts[0][:, :free] = 0.0
    parts[-1][:free, free:] = parts[-1][free:, :free] = 0.0
    return replace(result, coefficients=tuple(parts), free=free), result


def _project_obliquely(pencil: Pencil, omega: float) -> tuple[Pencil, np.ndarray]:
    """Separate the poles near zero by right and left invariant subspaces.

    Return a pencil whose first unknowns belong to the poles near zero, and the basis of the pencil.
    Poles that belong to integrators are exactly zero in the returned pencil. If the separation is
    not possible, the pencil is returned unchanged.
    """
    rest, inertia = pencil.coefficients
    try:
        X, Y = (
            _find_slow_subspace(rest, inertia, omega),
            _find_slow_subspace(rest.T, inertia.T, omega),
        )
        inner = Y.T @ inertia @ X
        if X.shape != Y.shape or not X.size:
            return pencil, np.eye(pencil.size)
        Y = np.linalg.solve(inner, Y.T).T
    except np.linalg.LinAlgError:
        return pencil, np.eye(pencil.size)
    A, Q = _order_chains(-(Y.T @ rest @ X) / omega)
    X, Y = X @ Q, Y @ Q
    V, W = (
        np.hstack([X, scipy.linalg.null_space(Y.T @ inertia)]),
        np.hstack([Y, scipy.linalg.null_space((inertia @ X).T)]),
    )
    free = len(A)
    parts = [
        scipy.linalg.block_diag(first, (W.T @ P @ V)[free:, free:])
        for first, P in ((-omega * A, rest), (np.eye(free), inertia))
    ]
    return Pencil(tuple(parts), W.T @ pencil.B, pencil.C @ V, pencil.D, free=free), V


def _find_slow_subspace(rest: np.ndarray, inertia: np.ndarray, omega: float) -> np.ndarray:
    """Compute an orthonormal basis of the invariant subspace of poles near zero.

    The poles near zero are poles that are zero within rounding errors, and slow real poles.
    """
    shifted = np.linalg.solve(rest + omega * inertia, omega * inertia)

    def is_near_zero(x: float, y: float) -> bool:
        """Return whether the eigenvalue ``x + j y`` belongs to a pole near zero."""
        pole = 1 - 1 / (complex(x, y) or np.finfo(float).tiny)
        return abs(pole) < ZERO_POLE_RATIO or (
            abs(pole) < SLOW_POLE_RATIO and abs(pole.imag) < ZERO_POLE_RATIO
        )

    _, Z, count = scipy.linalg.schur(shifted, output="real", sort=is_near_zero)
    return np.asarray(Z[:, :count])


def _order_chains(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return ``Q'AQ`` and Q; the rotation Q orders the chains of integrators in A.

    ``Q'AQ`` is block triangular. The coordinates form chains of integrators. The first coordinates
    span the null space of A, and a state in the null space of A is constant in time. The rate of
    each coordinate of a chain depends only on coordinates with a higher index.
    """
    A, Q, start = A.copy(), np.eye(len(A)), 0
    while start < len(A):
        _, size, Vt = np.linalg.svd(A[start:, start:])
        constant = int((size <= CHAIN_RATE_RATIO * max(1.0, size[0])).sum())
        if not constant:
            break
        rotation = scipy.linalg.block_diag(np.eye(start), np.roll(Vt, constant, axis=0).T)
        A, Q = rotation.T @ A @ rotation, Q @ rotation
        A[start:, start : start + constant] = 0.0
        start += constant
    return A, Q
