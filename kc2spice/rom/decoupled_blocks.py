"""Transformation of state-space models to decoupled real blocks.

A real pole becomes one block, and a complex pair of poles becomes one 2 x 2 block. Repeated,
defective or nearly equal poles remain together in one larger block. The solution of a Sylvester
equation decouples a cluster of poles in the real Schur form. A cluster is decoupled only if the
norm of the solution is below a limit (Bavely and Stewart, SIAM J. Numer. Anal. 16 (1979) 359). The
size of a netlist is proportional to the square of the block size. To obtain smaller blocks, larger
limits of the norm are tried as long as the response of the model remains accurate.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, eigh, lapack, schur

from kc2spice.core.equality import EqualByContent
from kc2spice.rom.error_estimate import compute_relative_error
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.pencil import find_largest_entry, make_explicit_pencil

# Largest norm of the solution of a Sylvester equation; a norm of 1000 loses three digits.
CONDITION_LIMIT = 1e3
# Limits of the Sylvester solution's norm that are tried if CONDITION_LIMIT gives large blocks.
# One of LARGER_LIMITS replaces CONDITION_LIMIT only if the response of the blocks stays accurate.
LARGER_LIMITS = 1e5, 1e7, 1e9
# The next larger of LARGER_LIMITS is tried only if a block has more than MAX_BLOCK_STATES states.
MAX_BLOCK_STATES = 4
# permitted relative change of the response if one of LARGER_LIMITS replaces CONDITION_LIMIT
MAX_RESPONSE_CHANGE = 1e-9
# Largest accepted ratio: relative change of the response by the transformation to blocks, divided
# by the error estimate of the reduced model.
MAX_ERROR_SHARE = 1e-2
COMPARED_FREQUENCIES = 40  # number of frequencies at which the response is compared
EQUALITY_TOLERANCE = 1e-13  # smaller relative numbers count as zero


@dataclass(frozen=True, eq=False)
class BlockModel(EqualByContent):
    """State-space model whose state matrix consists of decoupled diagonal blocks.

    The equations are ``z' = diag(blocks) z + B u + F w`` and ``y = C z + D u + R w``.
    Each block is a real square matrix. The signals w are determined by algebraic equations:
    ``0 = P z + Q u + S w``. For example, the signals w are the waves at the ports of a measured
    multiport. Without the signals w, the blocks would have more entries. ``loops`` contains the
    matrices ``(F, P, Q, R, S)``, or is None without signals w.
    """

    blocks: tuple[np.ndarray, ...]
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    loops: tuple[np.ndarray, ...] | None = None


def make_block_model(model: LinearModel, *, dense: bool = False) -> BlockModel:
    """Transform a reduced model to decoupled blocks.

    If ``dense`` is true, the result is a single block.

    Raises
    ------
    UsageError : the model has no state-space form.
    """
    if not dense and (result := _find_existing_blocks(model)):
        return result
    A, B, C, D = model.state_space()
    if dense:
        return BlockModel((A,), B, C, D)
    certificate, best = model.certificate, None
    limit = (
        max(MAX_RESPONSE_CHANGE, MAX_ERROR_SHARE * certificate.error_estimate)
        if certificate
        else MAX_RESPONSE_CHANGE
    )
    s, exact = _sample_pole_range(A), np.empty(0)
    for growth in (CONDITION_LIMIT, *LARGER_LIMITS):
        blocks, X, inverse = decouple_states(A, growth)
        result = BlockModel(blocks, inverse @ B, C @ X, D)
        if best is not None and s.size:
            exact = exact if exact.size else make_explicit_pencil(A, B, C, D).transfer(s)
            block_diagonal = make_explicit_pencil(
                block_diag(*result.blocks), result.B, result.C, result.D
            )
            if compute_relative_error(block_diagonal.transfer(s), exact) > limit:
                break
        best = result
        if max(map(len, blocks), default=0) <= MAX_BLOCK_STATES:
            break
    assert best is not None
    return best


def _sample_pole_range(A: np.ndarray) -> np.ndarray:
    """Return points ``j w`` (n,) from below the slowest to above the fastest pole.

    If all poles are zero, the array is empty.
    """
    size = np.abs(np.linalg.eigvals(A))
    size = size[size > EQUALITY_TOLERANCE * size.max(initial=0.0)]
    if not size.size:
        return np.empty(0, complex)
    return np.asarray(1j * np.geomspace(0.1 * size.min(), 3 * size.max(), COMPARED_FREQUENCIES))


def _find_existing_blocks(model: LinearModel) -> BlockModel | None:
    """Return a first-order model as a block model if its states form decoupled blocks.

    The states must form small blocks, and E must be diagonal with ones before zeros. Rows in which
    E is zero are algebraic equations, which become the ``loops`` of the block model. Return None
    for other models.
    """
    if not model.first_order or model.E is None:
        return None
    rest, E = model.pencil.make_dense().coefficients
    n = int(np.count_nonzero(np.diag(E)))
    if n == len(E) or not np.array_equal(E, np.diag(np.arange(len(E)) < n)):
        return None
    A, B, C = -rest, model.B, model.C
    coupled = np.abs(np.diag(A[:n, :n], 1)) + np.abs(np.diag(A[:n, :n], -1)) > 0
    starts = [0, *(k + 1 for k in range(n - 1) if not coupled[k]), n]
    blocks = tuple(A[i:j, i:j] for i, j in itertools.pairwise(starts))
    if max(map(len, blocks)) > MAX_BLOCK_STATES or not np.array_equal(
        block_diag(*blocks), A[:n, :n]
    ):
        return None
    loops = A[:n, n:], A[n:, :n], B[n:], C[:, n:], A[n:, n:]
    return BlockModel(blocks, B[:n], C[:, :n], model.D, loops)


def decouple_states(
    A: np.ndarray, growth: float = CONDITION_LIMIT
) -> tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray]:
    """Decompose ``A = X diag(blocks) X^-1``; return the blocks, X and X^-1.

    If A is symmetric or skew-symmetric, X is orthogonal. ``growth`` is the largest permitted norm
    of the solution of a Sylvester equation.
    """
    one = np.eye(len(A))
    if len(A) % 2 == 0 and not A[np.kron(np.eye(len(A) // 2), np.ones((2, 2))) == 0].any():
        return tuple(A[i : i + 2, i : i + 2] for i in range(0, len(A), 2)), one, one
    if find_largest_entry(A - A.T) <= EQUALITY_TOLERANCE * find_largest_entry(A):
        values, X = eigh(0.5 * (A + A.T))
        return tuple(np.array([[value]]) for value in values), X, X.T
    T, Z = schur(A, output="real")
    # if the model has no losses, a skew-symmetric T keeps all poles on the imaginary axis
    if find_largest_entry(A + A.T) <= EQUALITY_TOLERANCE * find_largest_entry(A):
        T = 0.5 * (T - T.T)
        T[np.abs(T) <= EQUALITY_TOLERANCE * find_largest_entry(T)] = 0.0
        return tuple(T[i : i + k, i : i + k] for i, k in _list_blocks(T)), Z, Z.T
    return _split_schur_form(T, Z, growth)


def _split_schur_form(
    T: np.ndarray, Z: np.ndarray, growth: float
) -> tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray]:
    """Split the real Schur form T of ``A = Z T Z'`` into decoupled blocks.

    The blocks are separated in the order of the rows of T. If the separation of a block would be
    inaccurate, the nearest pole is added to the block.
    """
    X, inverse, blocks, n = Z.copy(), Z.T.copy(), [], len(T)
    start = 0
    while start < n:
        end = start + _get_block_size(T, start)
        while end < n:
            S, scale, info = lapack.dtrsyl(
                T[start:end, start:end], T[end:, end:], -T[start:end, end:], isgn=-1
            )
            if info == 0 and np.linalg.norm(S) <= growth * scale:
                X[:, end:] += X[:, start:end] @ (S / scale)
                inverse[start:end] -= (S / scale) @ inverse[end:]
                break
            rest = T[end:, end:]
            apart = np.abs(_list_poles(rest)[:, None] - _list_poles(T[start:end, start:end])).min(
                axis=1
            )
            nearest = list(_list_blocks(rest))[int(np.argmin(apart))][0]
            # reorder the Schur form so that the nearest pole or pair follows the block
            T22, Q, _ = lapack.dtrexc(rest, np.eye(len(rest)), nearest + 1, 1)
            T[:, end:] = T[:, end:] @ Q
            T[end:, end:] = T22
            X[:, end:] = X[:, end:] @ Q
            inverse[end:] = Q.T @ inverse[end:]
            end += _get_block_size(T, end)
        blocks.append(T[start:end, start:end])
        start = end
    return tuple(blocks), X, inverse


def _list_blocks(T: np.ndarray, start: int = 0) -> Iterator[tuple[int, int]]:
    """Yield the first index and the size of each diagonal block of a real Schur form."""
    while start < len(T):
        size = 2 if start + 1 < len(T) and T[start + 1, start] != 0 else 1
        yield start, size
        start += size


def _get_block_size(T: np.ndarray, start: int) -> int:
    """Return the size (1 or 2) of the diagonal block that begins at ``start``."""
    return next(_list_blocks(T, start))[1]


def _list_poles(T: np.ndarray) -> np.ndarray:
    """Return one pole (eigenvalue) for each diagonal block of a real Schur form.

    Of a complex pair, the eigenvalue in the upper half-plane is returned.
    """
    result = []
    for i, size in _list_blocks(T):
        product = T[i, i + 1] * T[i + 1, i] if size == 2 else 0.0
        result.append(T[i, i] + 1j * np.sqrt(max(-product, 0.0)))
    return np.array(result)
