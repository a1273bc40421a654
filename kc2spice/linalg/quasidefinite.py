"""Factors of large sparse quasi-definite matrices.

A quasi-definite matrix ``[A B; B' -C]`` has positive definite blocks A and C. In models of
piezoelectric solids, A belongs to the displacements, and C to the potentials. For any order of its
unknowns, a quasi-definite matrix has a factorisation ``L D L'`` without pivoting. The diagonal
matrix D has the entry 1 for unknowns of block A, and -1 for unknowns of block C. The signs in D are
prescribed, so a successful factorisation proves that A and C are positive definite.

The method is multifrontal. The elimination tree is divided into supernodes. The pivots of a
supernode are unknowns whose columns of L have nearly the same sparsity pattern. The front of a
supernode is a dense matrix with a row for each pivot and for each later unknown that is coupled to
the pivots. Dense Cholesky factorisations eliminate the pivots, first in A and then in C. The
remaining Schur complement is added to the front of the parent supernode.

Sources: R. J. Vanderbei, SIAM J. Optim. 5 (1995) 100; I. S. Duff, J. K. Reid, ACM Trans. Math.
Software 9 (1983) 302; J. W. H. Liu, SIAM Review 34 (1992) 82; C. Ashcraft, R. Grimes, ACM Trans.
Math. Software 15 (1989) 291 (relaxed supernodes).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from scipy.linalg.blas import dsyrk, dtrsm
from scipy.linalg.lapack import dpotrf

# Largest permitted share of zeros in a supernode, as pairs (number of pivots, share).
# A pair applies to supernodes with at most the stated number of pivots.
# The shares were chosen by timing. Zeros cost operations, and many small supernodes cost Python
# time.
ZERO_SHARES = ((48, 1.0), (160, 0.4), (500, 0.12), (np.inf, 0.05))
STRIP_WIDTH = 64  # largest number of Schur-complement columns that are added in one step


@dataclass(frozen=True, eq=False)
class Supernode:
    """Supernode of the elimination tree, with pivots, coupled rows and parent.

    In the elimination order, the pivots have the positions ``begin`` to ``end - 1``. ``rows`` (m,)
    contains the positions of the later unknowns that are coupled to the pivots. ``parent`` is the
    index of the parent supernode, or -1 without coupled rows.
    """

    begin: int
    end: int
    rows: np.ndarray
    parent: int


@dataclass(frozen=True, eq=False)
class ColumnPanel:
    """Columns of the factor L for a supernode with k pivots and m coupled rows.

    ``pivot_order`` (k,) is the order of the pivots. ``positive`` is the number of pivots whose
    entry in the diagonal matrix D is 1; these pivots come first. All other pivots have the entry -1
    in D. ``triangle`` (k, k) contains the pivot rows of these columns, and ``below`` (m, k) the
    coupled rows.
    """

    pivot_order: np.ndarray
    positive: int
    triangle: np.ndarray
    below: np.ndarray


class QuasiDefiniteFactor:
    """Factor ``L D L'`` of a quasi-definite matrix.

    Parameters
    ----------
    matrix : (n, n) sparse array
        Symmetric matrix.
    negative : (n,) mask
        Unknowns of the block -C.
    group : (n,) array
        Group number of each unknown; the columns of one group have the same pattern.
    order : (n,) array
        Elimination order for which L is sparse. The unknowns of each group are consecutive in the
        elimination order.

    Raises
    ------
    RuntimeError : the matrix is not quasi-definite.
    """

    def __init__(
        self,
        matrix: scipy.sparse.csc_array,
        negative: np.ndarray,
        group: np.ndarray,
        order: np.ndarray,
    ) -> None:
        self._order, self._supernodes = find_supernodes(matrix, group, order)
        lower = scipy.sparse.tril(matrix[self._order][:, self._order], format="csc")
        self._panels = list[ColumnPanel]()
        place = np.zeros(len(order), dtype=np.intp)
        updates: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in self._supernodes]
        for node, parts in zip(self._supernodes, updates, strict=True):
            panel, remainder = _assemble_front(lower, node, parts, place)
            parts.clear()
            minus = negative[self._order[node.begin : node.end]]
            self._panels.append(_eliminate_pivots(panel, remainder, minus))
            if node.rows.size:
                updates[node.parent].append((node.rows, remainder))

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve ``A x = rhs`` for one (n,) or several (n, k) right-hand sides."""
        x = np.asarray(rhs, dtype=float).reshape(len(rhs), -1)[self._order]
        steps = list(zip(self._supernodes, self._panels, strict=True))
        for node, panel in steps:
            pivots = x[node.begin : node.end][panel.pivot_order]
            pivots = dtrsm(1.0, panel.triangle, pivots, lower=1)
            x[node.rows] -= panel.below @ pivots
            pivots[panel.positive :] *= -1
            x[node.begin : node.end] = pivots
        for node, panel in reversed(steps):
            pivots = x[node.begin : node.end] - panel.below.T @ x[node.rows]
            pivots = dtrsm(1.0, panel.triangle, pivots, lower=1, trans_a=1)
            x[node.begin + panel.pivot_order] = pivots
        result = np.empty_like(x)
        result[self._order] = x
        return result.reshape(rhs.shape)


def _assemble_front(
    lower: scipy.sparse.csc_array,
    node: Supernode,
    updates: Sequence[tuple[np.ndarray, np.ndarray]],
    place: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Assemble a supernode's front (dense block) from the matrix and child updates.

    Return the columns of the k pivots, an array of shape (k + m, k), and the block of the m coupled
    rows, an array of shape (m, m). Only the lower triangles are assembled. ``place`` (n,) is
    working memory.
    """
    count, rows = node.end - node.begin, node.rows
    size = count + rows.size
    place[node.begin : node.end] = np.arange(count)
    place[rows] = np.arange(count, size)
    # both arrays are assembled in transposed form
    panel, remainder = np.zeros((count, size)), np.zeros((rows.size,) * 2)
    begin, end = lower.indptr[[node.begin, node.end]]
    column = np.repeat(np.arange(count), np.diff(lower.indptr[node.begin : node.end + 1]))
    panel[column, place[lower.indices[begin:end]]] = lower.data[begin:end]
    for indices, update in updates:
        at, transposed = place[indices], update.T
        pivots = int(np.searchsorted(at, count))
        for first in (*range(0, pivots, STRIP_WIDTH), *range(pivots, len(at), STRIP_WIDTH)):
            target, skip = (panel, 0) if first < pivots else (remainder, count)
            last = min(first + STRIP_WIDTH, pivots if first < pivots else len(at))
            begins = (at[first:last] - skip) * target.shape[1]
            # a flat index takes half the time of two indices for row and column
            target.reshape(-1)[begins[:, None] + (at[first:] - skip)] += transposed[
                first:last, first:
            ]
    return panel.T, remainder.T


def _eliminate_pivots(panel: np.ndarray, remainder: np.ndarray, minus: np.ndarray) -> ColumnPanel:
    """Eliminate the pivots of a front; replace its other rows by the Schur complement.

    The array ``remainder`` becomes the Schur complement. The mask ``minus`` (k,) selects the pivots
    with the entry -1 in D. The front consists of the block ``[A b'; b -C]`` of the pivot rows and
    the block ``[F G]`` of the other rows. The factor contains ``S``, ``T``, ``W = b S'^-1``, ``Y =
    F S'^-1`` and ``Z = (Y W' - G) T'^-1``, where ``A = S S'`` and ``C + W W' = T T'``.
    """
    count, positive = len(minus), int((~minus).sum())
    turn = np.argsort(minus, kind="stable")
    block = np.tril(panel[:count])
    block += np.tril(block, -1).T
    block = block[np.ix_(turn, turn)]
    below = np.asfortranarray(panel[count:, turn])
    triangle, head, tail = (
        np.zeros((count, count), order="F"),
        slice(positive),
        slice(positive, None),
    )
    triangle[head, head] = S = _compute_cholesky_factor(block[head, head])
    Y, Z = below[:, head], below[:, tail]
    if positive:
        Y[:] = dtrsm(1.0, S, Y, side=1, lower=1, trans_a=1)
        _subtract_outer_product(remainder, Y, 1.0)
    if positive < count:
        W = triangle[tail, head]
        if positive:
            W[:] = dtrsm(1.0, S, block[tail, head], side=1, lower=1, trans_a=1)
        triangle[tail, tail] = T = _compute_cholesky_factor(W @ W.T - block[tail, tail])
        Z[:] = dtrsm(1.0, T, Y @ W.T - Z, side=1, lower=1, trans_a=1)
        _subtract_outer_product(remainder, Z, -1.0)
    return ColumnPanel(turn, positive, triangle, below)


def _compute_cholesky_factor(matrix: np.ndarray) -> np.ndarray:
    """Return the lower Cholesky factor of a dense matrix."""
    if not matrix.size:
        return matrix
    factor, failure = dpotrf(matrix, lower=1, clean=1)
    if failure:
        raise RuntimeError("not quasi-definite")
    return np.asarray(factor)


def _subtract_outer_product(matrix: np.ndarray, columns: np.ndarray, sign: float) -> None:
    """Subtract ``sign * columns @ columns.T`` in place from a matrix's lower triangle."""
    if matrix.size and columns.size:
        result = dsyrk(-sign, columns, beta=1.0, c=matrix, lower=1, overwrite_c=1)
        if result.base is not matrix and result is not matrix:
            matrix[:] = result


def find_supernodes(
    matrix: scipy.sparse.csc_array, group: np.ndarray, order: np.ndarray
) -> tuple[np.ndarray, list[Supernode]]:
    """Find the supernodes of a matrix, and order the unknowns by supernode.

    Return the new elimination order (n,) and the supernodes. Except for zeros that are stored in
    supernodes, the factor has as many entries as for the original ``order``.
    """
    sequence = group[order][np.r_[True, np.diff(group[order]) != 0]]  # groups in elimination order
    rank = np.empty(len(sequence), dtype=np.intp)
    rank[sequence] = np.arange(len(sequence))
    numbers = rank[group]  # position of the group of each unknown in the elimination order
    weight = np.bincount(numbers)
    below, above = _find_neighbours(matrix, numbers, order)
    parent = _build_elimination_tree(above)
    pivots, rows = _form_relaxed_supernodes(below, parent, weight)
    return _number_supernodes(pivots, rows, parent, weight, numbers, order)


def _find_neighbours(
    matrix: scipy.sparse.csc_array, numbers: np.ndarray, order: np.ndarray
) -> tuple[list[np.ndarray], list[list[int]]]:
    """Return the later and the earlier neighbours of each group in elimination order."""
    count = int(numbers.max()) + 1
    first = np.full(count, -1)
    first[numbers[order[::-1]]] = order[::-1]
    columns = scipy.sparse.coo_array(matrix[:, first])
    i, j = numbers[columns.row], columns.col
    pairs = np.unique(j[i > j].astype(np.int64) * count + i[i > j])
    column, row = np.divmod(pairs, count)
    below = np.split(row, np.searchsorted(column, np.arange(1, count)))
    turned = np.argsort(row, kind="stable")
    above = np.split(column[turned], np.searchsorted(row[turned], np.arange(1, count)))
    return below, [part.tolist() for part in above]


def _build_elimination_tree(above: Sequence[Sequence[int]]) -> list[int]:
    """Return the parent of each group in the elimination tree, or -1 for a root.

    The function implements algorithm 4.2 of Liu (SIAM Review 34 (1992) 82).
    """
    parent, ancestor = [-1] * len(above), [-1] * len(above)
    for i, earlier in enumerate(above):
        for k in earlier:
            while (above_k := ancestor[k]) not in (-1, i):
                ancestor[k], k = i, above_k
            if above_k == -1:
                ancestor[k] = parent[k] = i
    return parent


def _form_relaxed_supernodes(
    below: Sequence[np.ndarray], parent: Sequence[int], weight: np.ndarray
) -> tuple[dict[int, list[int]], dict[int, np.ndarray]]:
    """Form relaxed supernodes; return the pivot groups and the row groups of each.

    The key of a supernode is its last pivot group.
    """
    pivots, rows = dict[int, list[int]](), dict[int, np.ndarray]()
    sizes = dict[int, tuple[int, int, int]]()  # counts of pivots, rows, zeros
    children: list[list[int]] = [[] for _ in below]
    for j, neighbours in enumerate(below):
        behind_j = np.sort(np.concatenate([neighbours, *map(rows.__getitem__, children[j])]))
        rows[j] = behind_j[np.diff(behind_j, prepend=j) > 0]
        pivots[j], count, zeros = [j], int(weight[j]), 0
        behind = int(weight[rows[j]].sum())
        for child in sorted(children[j], key=lambda k: -sizes[k][1]):
            child_count, child_behind, child_zeros = sizes[child]
            total = count + child_count
            more = zeros + child_zeros + child_count * (count + behind - child_behind)
            limit = next(share for most, share in ZERO_SHARES if total <= most)
            if more <= limit * total * (0.5 * total + behind):
                pivots[j] = pivots.pop(child) + pivots[j]
                count, zeros = total, more
                del rows[child], sizes[child]
        sizes[j] = count, behind, zeros
        if parent[j] >= 0:
            children[parent[j]].append(j)
    return pivots, rows


def _number_supernodes(
    pivots: dict[int, list[int]],
    rows: dict[int, np.ndarray],
    parent: Sequence[int],
    weight: np.ndarray,
    numbers: np.ndarray,
    order: np.ndarray,
) -> tuple[np.ndarray, list[Supernode]]:
    """Return the elimination order of the unknowns, and the supernodes in this order.

    Children precede their parents in the list of supernodes.
    """
    owner = {group: last for last, groups in pivots.items() for group in groups}
    parents = {last: owner.get(parent[last], -1) for last in pivots}
    children = dict[int, list[int]]()
    for last, above in parents.items():
        children.setdefault(above, []).append(last)
    postorder, stack = list[int](), list(children.get(-1, []))
    while stack:
        postorder.append(stack.pop())
        stack += children.get(postorder[-1], [])
    postorder.reverse()
    sequence = np.concatenate([pivots[last] for last in postorder])
    position = np.empty(len(sequence), dtype=np.intp)
    position[sequence] = np.arange(len(sequence))
    start = np.r_[0, np.cumsum(weight[sequence])]  # first unknown of each group
    index = dict(zip(postorder, range(len(postorder)), strict=True)) | {-1: -1}
    nodes, begin = list[Supernode](), 0
    for last in postorder:
        end = begin + int(weight[pivots[last]].sum())
        at = np.sort(position[rows[last]])
        counts = start[at + 1] - start[at]
        offset = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        nodes.append(
            Supernode(begin, end, np.repeat(start[at], counts) + offset, index[parents[last]])
        )
        begin = end
    return order[np.argsort(position[numbers[order]], kind="stable")], nodes
