"""Matrices that are applied and solved with, but never formed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import scipy

from kc2spice.linalg.factor import Factor, two_sided

Matrix: TypeAlias = Any  # np.ndarray, scipy.sparse.csc_array, Schur or Sum; scipy brings no types

# Two matrices whose entries differ by less than this of the largest one are the same matrix.
SAME = 1e-12


@dataclass(frozen=True, eq=False)
class Schur:
    """``uu - up pp^-1 pu``: what is left of a sparse matrix when the unknowns of ``pp`` are
    eliminated. It is dense, so it lives as its four sparse blocks.

    Raises
    ------
    SimulationError : ``pp`` is singular (on first use).
    """

    uu: scipy.sparse.csc_array
    up: scipy.sparse.csc_array
    pu: scipy.sparse.csc_array
    pp: scipy.sparse.csc_array

    @property
    def shape(self) -> tuple[int, int]:
        """Size of the matrix that is left."""
        return self.uu.shape

    @property
    def symmetric(self) -> bool:
        """Both diagonal blocks are, and the others are transposes."""
        pairs = ((self.uu, self.uu.T), (self.pp, self.pp.T), (self.up, self.pu.T))
        return all(same(a, b) for a, b in pairs)

    @cached_property
    def inner(self) -> Factor:
        """Factor of ``pp``."""
        return two_sided(self.pp, symmetric=same(self.pp, self.pp.T))[0]

    @cached_property
    def T(self) -> Schur:
        """Transpose."""
        return Schur(*(scipy.sparse.csc_array(P.T) for P in (self.uu, self.pu, self.up, self.pp)))

    def __matmul__(self, x: np.ndarray) -> np.ndarray:
        if np.iscomplexobj(x):  # of real blocks, whose factor takes real vectors
            return self @ x.real + 1j * (self @ x.imag)
        return self.uu @ x - self.up @ self.inner.solve(self.pu @ x)

    def scaled(self, t: np.ndarray) -> Schur:
        """``diag(t) S diag(t)``."""
        uu, up, pu = scaled(self.uu, t, t), scaled(self.up, t), scaled(self.pu, None, t)
        found = Schur(uu, up, pu, self.pp)
        if "inner" in self.__dict__:  # the factor of the same block
            found.__dict__["inner"] = self.inner
        return found

    def toarray(self) -> np.ndarray:
        """The dense matrix."""
        return np.asarray(self.uu.toarray() - self.up @ self.inner.solve(self.pu.toarray()))


def scaled(
    P: scipy.sparse.sparray, rows: np.ndarray | None = None, columns: np.ndarray | None = None
) -> scipy.sparse.csc_array:
    """``diag(rows) P diag(columns)``, entry by entry: products of sparse matrices take ten times
    as long."""
    found = scipy.sparse.csc_array(P, copy=True)
    if rows is not None:
        found.data *= rows[found.indices]
    if columns is not None:
        found.data *= np.repeat(columns, np.diff(found.indptr))
    return found


@dataclass(frozen=True, eq=False)
class Sum:
    """``sum_k factor_k matrix_k``, applied term by term."""

    terms: tuple[tuple[float, Matrix], ...]

    @property
    def shape(self) -> tuple[int, int]:
        """Size of every term."""
        return self.terms[0][1].shape

    @property
    def T(self) -> Sum:
        """Transpose."""
        return Sum(tuple((c, P.T) for c, P in self.terms))

    def __matmul__(self, x: np.ndarray) -> np.ndarray:
        return sum(c * (P @ x) for c, P in self.terms)

    def toarray(self) -> np.ndarray:
        """The dense matrix."""
        return np.asarray(sum(c * dense(P) for c, P in self.terms))


def dense(matrix: Matrix) -> np.ndarray:
    """Any matrix as an array."""
    return np.asarray(matrix if isinstance(matrix, np.ndarray) else matrix.toarray(), dtype=float)


def magnitudes(matrix: Matrix) -> Matrix:
    """Absolute values of the entries, of a :class:`Schur` those of its leading block."""
    if isinstance(matrix, Sum):
        return sum(abs(c) * magnitudes(P) for c, P in matrix.terms)
    return abs(matrix.uu if isinstance(matrix, Schur) else matrix)


def largest(matrix: Matrix) -> float:
    """Largest absolute entry; of a :class:`Schur` that of its leading block."""
    if isinstance(matrix, Schur):
        return largest(matrix.uu)
    if isinstance(matrix, Sum):
        return max(abs(c) * largest(P) for c, P in matrix.terms)
    return float(abs(matrix).max()) if matrix.shape[0] and matrix.shape[1] else 0.0


def same(one: Matrix, other: Matrix) -> bool:
    """Equal but for rounding of the largest entry."""
    return one.shape == other.shape and largest(one - other) <= SAME * largest(one)


def symmetric(matrix: Matrix) -> bool:
    """Equal to its transpose but for rounding."""
    if isinstance(matrix, Sum):
        return all(symmetric(P) for _, P in matrix.terms)
    return matrix.symmetric if isinstance(matrix, Schur) else same(matrix, matrix.T)


def congruence(P: Matrix, V: np.ndarray, known: bool = False) -> np.ndarray:
    """``V'PV``, its symmetric and skew parts each from that part of P alone.

    That P is symmetric may be ``known``: its parts take longer than the product.
    """
    if isinstance(P, Sum):
        return np.asarray(sum(c * congruence(term, V, known) for c, term in P.terms))
    if known or isinstance(P, Schur):
        R = V.T @ (P @ V)
        return np.asarray(0.5 * (R + R.T) if known or P.symmetric else R)
    total = np.zeros((V.shape[1],) * 2)
    for sign in (1, -1):
        part = 0.5 * (P + sign * P.T)
        if largest(part) > SAME * largest(P):
            R = V.T @ (part @ V)
            total += 0.5 * (R + sign * R.T)
    return total
