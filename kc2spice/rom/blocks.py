"""State space as decoupled real blocks: one per real pole, one 2 x 2 per complex pair.

Poles that repeat, or lie so close that separating them would cost digits, stay together in one
larger block; a defective pole does so by itself. Source: Bavely and Stewart, SIAM J. Numer. Anal.
16 (1979) 359: real Schur form, clusters decoupled by Sylvester equations of bounded solution.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh, lapack, schur

from kc2spice.rom.linear import LinearModel
from kc2spice.rom.operators import largest

# A decoupling transformation beyond this would cost more than three digits.
GROWTH = 1e3
SAME = 1e-13


@dataclass(frozen=True)
class BlockModel:
    """``z' = diag(blocks) z + B u``, ``y = C z + D u`` with real square blocks of any size."""

    blocks: tuple[np.ndarray, ...]
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray


def block_model(model: LinearModel, *, dense: bool = False) -> BlockModel:
    """The reduced model in decoupled blocks, or as one block if ``dense``.

    Raises
    ------
    UsageError : the model has no state-space form.
    """
    A, B, C, D = model.state_space()
    if dense:
        return BlockModel((A,), B, C, D)
    blocks, X, inverse = decoupled(A)
    return BlockModel(blocks, inverse @ B, C @ X, D)


def decoupled(A: np.ndarray) -> tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray]:
    """``A = X diag(blocks) X^-1``; the forms of energy coordinates are kept exactly."""
    one = np.eye(len(A))
    if _in_pairs(A):
        return tuple(A[i : i + 2, i : i + 2] for i in range(0, len(A), 2)), one, one
    if largest(A - A.T) <= SAME * largest(A):
        values, X = eigh(0.5 * (A + A.T))
        return tuple(np.array([[value]]) for value in values), X, X.T
    T, Z = schur(A, output="real")
    if largest(A + A.T) <= SAME * largest(A):  # lossless: the poles stay on the axis
        T = 0.5 * (T - T.T)
        T[np.abs(T) <= SAME * largest(T)] = 0.0
        return tuple(T[i : i + k, i : i + k] for i, k in _blocks(T)), Z, Z.T
    return _clustered(T, Z)


def _in_pairs(A: np.ndarray) -> bool:
    n = len(A)
    if n % 2:
        return False
    pair = np.kron(np.eye(n // 2), np.ones((2, 2))) > 0
    return not A[~pair].any()


def _clustered(
    T: np.ndarray, Z: np.ndarray
) -> tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray]:
    """Split the real Schur form from the top, taking in the nearest pole where splitting costs."""
    X, inverse, blocks, n = Z.copy(), Z.T.copy(), [], len(T)
    start = 0
    while start < n:
        end = start + _first(T, start)
        while end < n:
            S, scale, info = lapack.dtrsyl(
                T[start:end, start:end], T[end:, end:], -T[start:end, end:], isgn=-1
            )
            if info == 0 and np.linalg.norm(S) <= GROWTH * scale:
                X[:, end:] += X[:, start:end] @ (S / scale)
                inverse[start:end] -= (S / scale) @ inverse[end:]
                break
            Q, T22 = _nearest_first(T[end:, end:], _poles(T[start:end, start:end]))
            T[:, end:] = T[:, end:] @ Q
            T[end:, end:] = T22
            X[:, end:] = X[:, end:] @ Q
            inverse[end:] = Q.T @ inverse[end:]
            end += _first(T, end)
        blocks.append(T[start:end, start:end])
        start = end
    return tuple(blocks), X, inverse


def _blocks(T: np.ndarray, start: int = 0) -> Iterator[tuple[int, int]]:
    """Where each diagonal block of a real Schur form begins from ``start`` on, and its size."""
    while start < len(T):
        size = 2 if start + 1 < len(T) and T[start + 1, start] != 0 else 1
        yield start, size
        start += size


def _first(T: np.ndarray, start: int) -> int:
    return next(_blocks(T, start))[1]


def _poles(T: np.ndarray) -> np.ndarray:
    """Eigenvalues in the upper half plane of a real Schur form, in the order of its blocks."""
    found = []
    for i, size in _blocks(T):
        product = T[i, i + 1] * T[i + 1, i] if size == 2 else 0.0
        found.append(T[i, i] + 1j * np.sqrt(max(-product, 0.0)))
    return np.array(found)


def _nearest_first(T: np.ndarray, cluster: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orthogonal Q that moves the pole nearest to the cluster's to the top of T."""
    candidates = _poles(T)
    nearest = int(np.argmin(np.abs(candidates[:, None] - cluster).min(axis=1)))
    T22, Q, _ = lapack.dtrexc(T, np.eye(len(T)), list(_blocks(T))[nearest][0] + 1, 1)
    return Q, T22
