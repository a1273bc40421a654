"""A pencil as state-space matrices: what circuits are built from, and what other libraries read."""

from __future__ import annotations

import numpy as np
import scipy

from kc2spice.core.errors import UsageError
from kc2spice.rom.operators import largest
from kc2spice.rom.pencil import Pencil, first_order
from kc2spice.rom.structure import semidefinite

ABCD = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
# Masses and algebraic parts this far below the largest are zero.
MASSLESS = 1e-13
# Off-diagonal modal damping below this is rounding of proportional damping.
COUPLING = 1e-10


def state_space(pencil: Pencil, top_hz: float | None = None) -> ABCD:
    """A, B, C, D of ``x' = A x + B u``, ``y = C x + D u``.

    States are energy coordinates where there is an energy, so ``A + A' <= 0`` for a dissipative
    model, ``A = -A'`` for a lossless one and ``A = A'`` for symmetric first order. A decoupled
    second-order model has one 2 x 2 block per mode. Positions are scaled by ``top_hz``, the end of
    the band; without one by the ratio of stiffness to mass.

    Raises
    ------
    UsageError : the model answers to derivatives of its input, or its massless part is singular.
    """
    pencil = pencil.dense()
    if pencil.degree == 1:
        return _energy_states(pencil)
    K, _, M = pencil.coefficients
    top = largest(K) / largest(M) if largest(K) and largest(M) else 1.0
    omega = 2 * np.pi * top_hz if top_hz is not None else float(np.sqrt(top))
    if semidefinite(M):
        for each in (pencil, pencil.scaled(omega)):  # a free motion's units may hide an inertia
            mass = np.linalg.eigvalsh(each.coefficients[2])
            if mass[0] > MASSLESS * mass[-1]:
                return _modal(each, omega)
        pencil = _without_static(pencil)
    elif _singular(M, M):
        raise UsageError(
            "the mass matrix is singular and not symmetric",
            where="state space",
            expected="a regular or a symmetric positive semi-definite M",
        )
    A, B, C, D = _energy_states(first_order(pencil, omega))
    return A, omega * B, C / omega, D


def _modal(pencil: Pencil, omega: float) -> ABCD:
    """States ``w z`` and ``z'`` of mass-normalised coordinates; modes of a symmetric K."""
    K, E, M = pencil.coefficients
    T, stiffness = _mass_normal(M, K)
    K, E, B, C = T.T @ K @ T, T.T @ E @ T, T.T @ pencil.B, pencil.C @ T
    w = np.full(len(M), omega)
    if stiffness is not None:
        moving = np.abs(stiffness) > MASSLESS * omega**2
        w[moving] = np.sqrt(np.abs(stiffness[moving]))
        K = np.diag(np.where(moving, stiffness, 0.0))
    damp = np.abs(np.diag(E))
    scale = np.sqrt(np.outer(damp, damp)) + np.finfo(float).tiny
    if (np.abs(E - np.diag(np.diag(E))) <= COUPLING * scale).all():
        E = np.diag(np.diag(E))
    A = np.block([[np.zeros_like(K), np.diag(w)], [-K / w, -E]])
    pairs = np.arange(2 * len(M)).reshape(2, len(M)).T.ravel()  # z1, z1', z2, z2', ...
    drive, read = np.vstack([np.zeros_like(B), B]), np.hstack([C / w, np.zeros_like(C)])
    return A[np.ix_(pairs, pairs)], drive[pairs], read[:, pairs], pencil.D


def _mass_normal(M: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """``T'MT = 1``; for a symmetric K also its eigenvalues, which T then diagonalises.

    A definite K takes the part of the better conditioned matrix, so that low modes are exact.
    """
    if largest(K - K.T) > COUPLING * largest(K):
        return scipy.linalg.solve_triangular(scipy.linalg.cholesky(M), np.eye(len(M))), None
    values = np.linalg.eigvalsh(K)
    if values[0] > MASSLESS * values[-1]:
        inverse, T = scipy.linalg.eigh(M, K)
        return T / np.sqrt(inverse), 1 / inverse
    stiffness, T = scipy.linalg.eigh(K, M)
    return T, stiffness


def _without_static(pencil: Pencil) -> Pencil:
    """Without the coordinates that have neither mass nor damping; the others without mass last."""
    K, E, M = pencil.coefficients
    B, C, D = pencil.B, pencil.C, pencil.D
    mass, V = scipy.linalg.eigh(M)
    none = mass <= MASSLESS * mass[-1]
    damping = V[:, none].T @ E @ V[:, none]
    size, U = scipy.linalg.eigh(0.5 * (damping + damping.T))
    still = np.abs(size) <= MASSLESS * max(largest(E), np.finfo(float).tiny)
    light, static = V[:, none] @ U[:, ~still], V[:, none] @ U[:, still]
    if static.size:
        if max(largest(E @ static), largest(E.T @ static)) > COUPLING * largest(E):
            raise _improper("massless coordinates are coupled by damping alone")
        inner = static.T @ K @ static
        if _singular(inner, K):
            raise _improper("massless, undamped coordinates without stiffness")
        held = scipy.linalg.solve(inner, np.hstack([static.T @ K, static.T @ B]))
        n = len(M)
        B, D = B - (K @ static) @ held[:, n:], D + (C @ static) @ held[:, n:]
        C, K = C - (C @ static) @ held[:, :n], K - (K @ static) @ held[:, :n]
    T = np.hstack([V[:, ~none], light])
    M = np.diag(np.r_[mass[~none], np.zeros(light.shape[1])])
    return Pencil((T.T @ K @ T, T.T @ E @ T, M), T.T @ B, C @ T, D)


def _energy_states(pencil: Pencil) -> ABCD:
    """Energy coordinates of a symmetric positive definite E, algebraic equations eliminated."""
    rest, E = pencil.coefficients
    A, B, C, D = -rest, pencil.B, pencil.C, pencil.D
    if semidefinite(E) and np.linalg.eigvalsh(E)[0] > MASSLESS * largest(E):
        T = scipy.linalg.solve_triangular(scipy.linalg.cholesky(E), np.eye(len(E)))
        inner = T.T @ A @ T
        if largest(A - A.T) <= COUPLING * largest(A):
            inner = 0.5 * (inner + inner.T)
        return inner, T.T @ B, C @ T, D
    U, size, Vt = scipy.linalg.svd(E)
    r = int((size > MASSLESS * max(size[0], np.finfo(float).tiny)).sum())
    A, B, C, E = U.T @ A @ Vt.T, U.T @ B, C @ Vt.T, size[:r, None]
    if r < len(A):
        inner = A[r:, r:]
        if _singular(inner, A):
            raise _improper("algebraic equations that do not determine their unknowns")
        held = scipy.linalg.solve(inner, np.hstack([A[r:, :r], B[r:]]))
        B, D = B[:r] - A[:r, r:] @ held[:, r:], D - C[:, r:] @ held[:, r:]
        C, A = C[:, :r] - C[:, r:] @ held[:, :r], A[:r, :r] - A[:r, r:] @ held[:, :r]
    return A / E, B / E, C, D


def _singular(matrix: np.ndarray, whole: np.ndarray) -> bool:
    """A singular value that is rounding of ``whole``."""
    return bool(np.linalg.svd(matrix, compute_uv=False)[-1] <= MASSLESS * largest(whole))


def _improper(why: str) -> UsageError:
    return UsageError(
        f"has no state-space form: {why}",
        where="state space",
        expected="a model whose outputs follow from inputs, not from their derivatives",
        hint="give the coordinates in question a little mass, or fix them",
    )
