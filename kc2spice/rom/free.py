"""Motions that nothing holds at rest: rigid bodies and integrators, with what slows them down.

Their part of a response grows without bound towards zero frequency. It is found once, made exact,
and kept apart from all other unknowns: a basis and a peak are those of the rest.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from kc2spice.rom.operators import largest, symmetric
from kc2spice.rom.pencil import Pencil, first_order

ROUNDING = 8.0  # times n eps of the largest: a stiffness, a damping or a coupling that is zero
# Poles of a first-order model below these shares of the band's end: zero but for rounding, which
# leaves half of the digits of a pair, and a free motion that something slows down.
ZERO, SLOW = 1e-6, 1e-2
DEPENDENT = 1e-9  # rates per band's end: a chain of integrators in first order


def apart(
    pencil: Pencil, omega: float, rounding: float | None = None
) -> tuple[Pencil, np.ndarray, bool]:
    """A dense pencil in coordinates of which the first ``free`` ones are its free motion, these as
    columns, and whether all others have a static answer; the pencil itself where none is free.

    Where ``K X = 0`` and ``X'K = 0``, as in symmetric and dissipative models, the form is kept:
    ``V'PV`` with the others orthogonal to X in the inertia. Damping may couple both. All other
    models are turned to first order
    and split at their poles near zero (of ``omega``), by both invariant subspaces. ``rounding`` is
    that of the entries of K, known of projections.
    """
    rest, inertia = pencil.coefficients[0], pencil.coefficients[-1]
    X = _null_space(rest, rounding)
    free = X.shape[1]
    if not free:
        return pencil, np.eye(pencil.size), True
    still = (np.abs(X.T @ rest) <= np.maximum(_noise(X.T, rest), rounding or 0.0)).all()
    if symmetric(inertia) and still:
        others = scipy.linalg.null_space((inertia @ X).T)
        if others.shape[1] + free == pencil.size:
            X = _driven(pencil, X)
            V = np.hstack([X, others])
            return congruent(pencil, V, X.shape[1]), V, True
    found, V = _oblique(first_order(pencil, omega), omega)
    return (found, V, True) if found.free else (pencil, np.eye(pencil.size), False)


def free_part(pencil: Pencil, omega: float) -> Pencil | None:
    """The free motion alone, whose response is the part without bound; None if there is none."""
    if pencil.free and not pencil.detached:
        pencil = _oblique(first_order(pencil, omega), omega)[0]
    return pencil.leading(pencil.free) if pencil.free else None


def _null_space(K: np.ndarray, rounding: float | None) -> np.ndarray:
    """Orthonormal columns that K takes to zero but for ``rounding``; by default for that of each of
    its entries, however stiff others are."""
    columns = np.ones(len(K))
    if rounding is None:
        rows = np.abs(K).max(axis=1)
        K = K / np.where(rows > 0, rows, 1.0)[:, None]
        largest_of = np.abs(K).max(axis=0)
        columns = 1 / np.where(largest_of > 0, largest_of, 1.0)
        K = K * columns
    _, size, Vt = np.linalg.svd(K)
    limit = rounding or ROUNDING * np.finfo(float).eps * len(K) * size.max(initial=0.0)
    return np.linalg.qr(columns[:, None] * Vt[size <= limit].T)[0]


def _driven(pencil: Pencil, X: np.ndarray) -> np.ndarray:
    """Those of the free motions X that an input moves; all where the outputs are others, or damping
    joins them."""
    *between, inertia = pencil.coefficients
    if not pencil.collocated or any((np.abs(P @ X) > _noise(P, X)).any() for P in between):
        return X
    X = X @ np.linalg.inv(np.linalg.cholesky(X.T @ inertia @ X)).T
    U, size, _ = np.linalg.svd(X.T @ pencil.B)
    moved = int((size > largest(_noise(X.T, pencil.B))).sum())
    return X @ U[:, :moved]


def _noise(P: np.ndarray, X: np.ndarray) -> np.ndarray:
    """What rounding makes of the entries of ``P X`` that are zero."""
    limit = ROUNDING * np.finfo(float).eps * len(X)
    return np.asarray(limit * (np.abs(P) @ np.abs(X)))


def congruent(pencil: Pencil, V: np.ndarray, free: int) -> Pencil:
    """``V'PV`` of a dense pencil, the first columns of V being ``free`` motions, without the
    rounding of what is zero."""
    found, parts = pencil.project_exactly(V), []
    limit = ROUNDING * np.finfo(float).eps * pencil.size
    for P, R in zip(pencil.coefficients, found.coefficients, strict=True):
        noise = limit * (np.abs(V).T @ (np.abs(P) @ np.abs(V)))
        zero = np.abs(R) <= noise
        zero[free:, free:] = False
        parts.append(np.where(zero, 0.0, R))
    parts[0][:free] = parts[0][:, :free] = 0.0
    parts[-1][:free, free:] = parts[-1][free:, :free] = 0.0
    return replace(found, coefficients=tuple(parts), free=free)


def _oblique(pencil: Pencil, omega: float) -> tuple[Pencil, np.ndarray]:
    """``W'PV`` with the right and left invariant subspaces of the poles near zero in front, there
    in coordinates that show the chains of integrators."""
    rest, inertia = pencil.coefficients
    try:
        X, Y = _slow(rest, inertia, omega), _slow(rest.T, inertia.T, omega)
        inner = Y.T @ inertia @ X
        if X.shape != Y.shape or not X.size:
            return pencil, np.eye(pencil.size)
        Y = np.linalg.solve(inner, Y.T).T
    except np.linalg.LinAlgError:
        return pencil, np.eye(pencil.size)
    A, Q = _chains(-(Y.T @ rest @ X) / omega)
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


def _slow(rest: np.ndarray, inertia: np.ndarray, omega: float) -> np.ndarray:
    """Orthonormal basis of the invariant subspace of poles that are zero, or real and slow."""
    shifted = np.linalg.solve(rest + omega * inertia, omega * inertia)

    def chosen(x: float, y: float) -> bool:
        pole = 1 - 1 / (complex(x, y) or np.finfo(float).tiny)
        return abs(pole) < ZERO or (abs(pole) < SLOW and abs(pole.imag) < ZERO)

    _, Z, count = scipy.linalg.schur(shifted, output="real", sort=chosen)
    return np.asarray(Z[:, :count])


def _chains(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``Q'AQ`` with Q orthogonal, block triangular with exact zeros: first what does not move, then
    what moves that at a constant rate, and so on."""
    A, Q, start = A.copy(), np.eye(len(A)), 0
    while start < len(A):
        _, size, Vt = np.linalg.svd(A[start:, start:])
        still = int((size <= DEPENDENT * max(1.0, size[0])).sum())
        if not still:
            break
        turn = scipy.linalg.block_diag(np.eye(start), np.roll(Vt, still, axis=0).T)
        A, Q = turn.T @ A @ turn, Q @ turn
        A[start:, start : start + still] = 0.0
        start += still
    return A, Q
