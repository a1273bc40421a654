"""Linear models ``P(s) x = B u``, ``y = C x + D u`` with a polynomial ``P(s)``.

The matrix polynomial ``P(s)`` and the matrices B, C, D are called a pencil. A coefficient of
``P(s)`` may be a Schur complement. The dense matrix of a Schur complement is not needed, because
solvers only compute its products with vectors and solve linear systems.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError
from kc2spice.linalg.extended_precision import ExtendedPrecisionMatrix
from kc2spice.linalg.factor import (
    QUASI_DEFINITE_UNKNOWNS,
    Factor,
    factorise,
    factorise_quasi_definite,
    factorise_two_sided,
)

Matrix: TypeAlias = (
    Any  # np.ndarray, scipy.sparse.csc_array or SchurComplement; scipy has no type hints
)

# Two matrices count as equal if (largest difference / largest entry) is at most this ratio.
EQUALITY_TOLERANCE = 1e-12


T = TypeVar("T")


class SharedValue(Generic[T]):
    """Value that is computed at the first use and shared by several objects."""

    def __init__(self) -> None:
        self._values: list[T] = []

    @property
    def value_or_none(self) -> T | None:
        """Value that several objects share, or None before the value is computed."""
        return self._values[0] if self._values else None

    def get(self, compute: Callable[[], T]) -> T:
        """Return the value; at the first call, compute it by the function ``compute``."""
        if not self._values:
            self._values.append(compute())
        return self._values[0]

    def share_with(self, other: SharedValue[T]) -> None:
        """Share the cached value with another object, so that only one computes it."""
        self._values = other._values


@dataclass(frozen=True, eq=False)
class SchurComplement:
    """Schur complement ``uu - up pp^-1 pu`` of a sparse matrix [[uu, up], [pu, pp]].

    The Schur complement itself is dense, so only the four sparse blocks of the matrix are
    stored. The unknowns of the block ``pp`` are eliminated.

    Raises
    ------
    SimulationError : ``pp`` is singular. The error is raised when the factor of ``pp`` is first
    used.
    """

    uu: scipy.sparse.csc_array
    up: scipy.sparse.csc_array
    pu: scipy.sparse.csc_array
    pp: scipy.sparse.csc_array
    factor: SharedValue[Factor] = field(default_factory=SharedValue, repr=False)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the Schur complement."""
        rows, columns = self.uu.shape
        return int(rows), int(columns)

    @property
    def is_symmetric(self) -> bool:
        """Whether the four blocks of a Schur complement form a symmetric matrix.

        The diagonal blocks must be symmetric, and ``up`` must be the transpose of ``pu``.

        """
        pairs = ((self.uu, self.uu.T), (self.pp, self.pp.T), (self.up, self.pu.T))
        return all(is_equal(a, b) for a, b in pairs)

    @property
    def inner_factor(self) -> Factor:
        """Factor of the inner matrix block, the block of the eliminated unknowns.

        The factorisation is computed at the first use.
        """
        return self.factor.get(self._factorise_inner)

    def _factorise_inner(self) -> Factor:
        """Factorise the block of the matrix that belongs to the eliminated unknowns."""
        is_symmetric = is_equal(self.pp, self.pp.T)
        if is_symmetric and self.is_large:
            return factorise_quasi_definite(self.pp)
        return factorise_two_sided(self.pp, symmetric=is_symmetric)[0]

    @property
    def is_large(self) -> bool:
        """Whether the matrices are so large that factors without pivoting are faster."""
        return bool(self.uu.shape[0] + self.pp.shape[0] >= QUASI_DEFINITE_UNKNOWNS)

    def is_proven_definite(self, factor: Factor | None) -> bool:
        """Return whether a factorisation of all blocks proves positive definiteness.

        The matrix of all blocks has as many negative eigenvalues as ``pp`` and the Schur complement
        have together (Haynsworth 1968). The Schur complement is positive definite if all negative
        eigenvalues of the matrix belong to ``pp``.
        """
        count = self.pp.shape[0]
        return factor is not None and factor.negative == count == self.inner_factor.negative

    @cached_property
    def T(self) -> SchurComplement:
        """Transpose of the Schur complement."""
        return SchurComplement(
            *(scipy.sparse.csc_array(P.T) for P in (self.uu, self.pu, self.up, self.pp))
        )

    def __matmul__(self, x: np.ndarray) -> np.ndarray:
        if np.iscomplexobj(x):  # real factors accept only real vectors
            return self @ x.real + 1j * (self @ x.imag)
        return np.asarray(self.uu @ x - self.up @ self.inner_factor.solve(self.pu @ x))

    def scale_symmetrically(self, t: np.ndarray) -> SchurComplement:
        """Return ``diag(t) S diag(t)``, where S is this Schur complement."""
        return self._replace_blocks(
            scale_matrix(self.uu, t, t), scale_matrix(self.up, t), scale_matrix(self.pu, None, t)
        )

    def make_damping_matrix(
        self, alpha: float, beta: float, M: scipy.sparse.csc_array
    ) -> SchurComplement:
        """Return the Rayleigh damping matrix ``alpha M + beta S`` of a stiffness S.

        The stiffness S is this Schur complement.
        """
        return self._replace_blocks(alpha * M + beta * self.uu, beta * self.up, self.pu)

    def _replace_blocks(self, uu: Matrix, up: Matrix, pu: Matrix) -> SchurComplement:
        """Replace the blocks ``uu``, ``up`` and ``pu`` in a copy of the Schur complement.

        Return a new Schur complement of ``uu``, ``up``, ``pu`` and the old block ``pp`` of the
        eliminated unknowns.
        """
        return SchurComplement(uu, up, pu, self.pp, self.factor)

    def toarray(self) -> np.ndarray:
        """Return the Schur complement as a dense array."""
        return np.asarray(self.uu.toarray() - self.up @ self.inner_factor.solve(self.pu.toarray()))


def scale_matrix(
    P: scipy.sparse.sparray, rows: np.ndarray | None = None, columns: np.ndarray | None = None
) -> scipy.sparse.csc_array:
    """Compute ``diag(rows) P diag(columns)`` entry by entry.

    Sparse matrix products with diagonal matrices would take ten times as long.
    """
    result = scipy.sparse.csc_array(P, copy=True)
    if rows is not None:
        result.data *= rows[result.indices]
    if columns is not None:
        result.data *= np.repeat(columns, np.diff(result.indptr))
    return result


def to_dense(matrix: Matrix) -> np.ndarray:
    """Convert a dense array, a sparse matrix or a Schur complement to a dense array."""
    return np.asarray(matrix if isinstance(matrix, np.ndarray) else matrix.toarray(), dtype=float)


def compute_absolute_entries(matrix: Matrix) -> Matrix:
    """Return the absolute values of the entries of a matrix.

    For a :class:`SchurComplement`, the result contains the absolute entries of the block ``uu``.
    """
    return abs(matrix.uu if isinstance(matrix, SchurComplement) else matrix)


def find_largest_entry(matrix: Matrix) -> float:
    """Return the largest absolute value of the entries of a matrix.

    For a :class:`SchurComplement`, only the entries of the block ``uu`` count.
    """
    if isinstance(matrix, SchurComplement):
        return find_largest_entry(matrix.uu)
    return float(abs(matrix).max()) if matrix.shape[0] and matrix.shape[1] else 0.0


def mask_unknowns_with_entries(matrices: Sequence[Matrix]) -> np.ndarray:
    """Return a mask (n,) of the unknowns with a nonzero entry in any matrix."""
    total = np.zeros(matrices[0].shape[0])
    for size in map(abs, matrices):
        total += np.ravel(size.sum(axis=0)) + np.ravel(size.sum(axis=1))
    return total > 0


def is_equal(one: Matrix, other: Matrix) -> bool:
    """Return whether two matrices are equal within a tolerance for rounding errors."""
    return one.shape == other.shape and find_largest_entry(
        one - other
    ) <= EQUALITY_TOLERANCE * find_largest_entry(one)


def is_symmetric(matrix: Matrix) -> bool:
    """Return whether a matrix equals its transpose within rounding errors."""
    return (
        matrix.is_symmetric if isinstance(matrix, SchurComplement) else is_equal(matrix, matrix.T)
    )


def apply_congruence(P: Matrix, V: np.ndarray, known: bool = False) -> np.ndarray:
    """Compute the congruence ``V'PV`` of a matrix P with the basis V.

    If P is symmetric or skew-symmetric within rounding errors, the result is exactly symmetric or
    skew-symmetric. If ``known`` is true, the caller guarantees that P is symmetric. The symmetry is
    then not tested, because the test takes longer than the product.
    """
    if known or isinstance(P, SchurComplement):
        R = V.T @ (P @ V)
        return np.asarray(0.5 * (R + R.T) if known or P.is_symmetric else R)
    total = np.zeros((V.shape[1],) * 2)
    for sign in (1, -1):
        part = 0.5 * (P + sign * P.T)
        if find_largest_entry(part) > EQUALITY_TOLERANCE * find_largest_entry(P):
            R = V.T @ (part @ V)
            total += 0.5 * (R + sign * R.T)
    return total


# Smallest magnitude of a pole that counts as infinite, relative to the reference frequency.
# Massless unknowns and algebraic equations cause infinite poles.
INFINITE_POLE_RATIO = 1e10
# Largest condition number of a mass matrix that is inverted.
# With the inverse of M, eigenvalues are computed ten times as fast as in the generalised problem.
MAX_INVERTED_CONDITION = 1e6
BATCH_BYTES = 8e6  # memory [bytes] of the dense matrices that are assembled and solved together


@dataclass(frozen=True, eq=False)
class Pencil:
    """Matrix polynomial ``P(s) = sum_k s^k coefficients[k]`` of a linear model.

    The coefficients of a second-order model are ``(K, E, M)``. The coefficients of a first-order
    model ``E x' = A x + B u`` are ``(-A, E)``. The first coefficient may be a
    :class:`SchurComplement`. If ``rayleigh`` is ``(alpha, beta)``, the damping matrix E
    is ``alpha M + beta K``. ``B`` (n, m), ``C`` (p, n) and ``D`` (p, m) are arrays. The first
    ``free`` unknowns are rigid-body modes; see :mod:`kc2spice.rom.rigid_body`.
    """

    coefficients: tuple[Matrix, ...]
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    rayleigh: tuple[float, float] | None = None
    free: int = 0
    factors: SharedValue[Factor] = field(default_factory=SharedValue, init=False, repr=False)
    symmetry: SharedValue[bool] = field(default_factory=SharedValue, init=False, repr=False)

    def __post_init__(self) -> None:
        if self.rayleigh is not None:
            K, _, M = self.coefficients
            alpha, beta = self.rayleigh
            plain = not isinstance(K, SchurComplement)
            E = alpha * M + beta * K if plain else K.make_damping_matrix(alpha, beta, M)
            object.__setattr__(self, "coefficients", (K, E, M))

    @property
    def size(self) -> int:
        """Number n of unknowns."""
        return int(self.B.shape[0])

    @property
    def degree(self) -> int:
        """Degree of the polynomial: 1 for a first-order model, 2 for a second-order model."""
        return len(self.coefficients) - 1

    @property
    def is_symmetric(self) -> bool:
        """Whether every coefficient equals its transpose within rounding errors."""
        stated = self.coefficients[:: 1 if self.rayleigh is None else 2]
        return self.symmetry.get(lambda: all(map(is_symmetric, stated)))

    @cached_property
    def is_collocated(self) -> bool:
        """Whether outputs are measured where inputs act, so that ``C = B'``."""
        return self.B.shape == self.C.T.shape and np.array_equal(self.B, self.C.T)

    @cached_property
    def is_undamped(self) -> bool:
        """Whether the model is of second order and undamped, so that ``P(j w)`` is real."""
        return self.degree == 2 and find_largest_entry(self.coefficients[1]) == 0

    @property
    def is_dense(self) -> bool:
        """Whether all coefficients are dense arrays."""
        return all(isinstance(P, np.ndarray) for P in self.coefficients)

    def make_dense(self) -> Pencil:
        """Return the same model with dense matrices only."""
        parts = tuple(map(to_dense, self.coefficients))
        return replace(self, coefficients=parts, rayleigh=None)

    def assemble_bordered_matrix(self, k: complex, e: complex, m: complex) -> Matrix:
        """Compute ``k K + e E + m M``, bordered by the equations of eliminated unknowns.

        For a first-order model, the result is ``k (-A) + e E``. If K is a Schur complement, the
        eliminated unknowns are scaled so that both diagonal blocks of K have equally large entries.
        """
        if self.rayleigh is not None:
            alpha, beta = self.rayleigh
            k, e, m = k + e * beta, 0.0, m + e * alpha
        K = self.coefficients[0]
        leading = K.uu if isinstance(K, SchurComplement) else K
        total = k * leading
        for factor_, P in zip((e, m), self.coefficients[1:], strict=False):
            if factor_ != 0:
                total = total + factor_ * P
        if not isinstance(K, SchurComplement):
            return total
        volt = np.sqrt(find_largest_entry(K.uu) / find_largest_entry(K.pp))
        blocks = [[total, k * volt * K.up], [k * volt * K.pu, k * volt**2 * K.pp]]
        return scipy.sparse.csc_array(scipy.sparse.block_array(blocks))

    def evaluate_polynomial(self, s: complex) -> Matrix:
        """Evaluate ``P(s)``, bordered by the equations of eliminated unknowns.

        The matrix is real if s is real, or if the model is undamped and ``s^2`` is real.
        """
        powers = [s**k for k in range(3)]
        if self.is_undamped and complex(powers[2]).imag == 0:
            return self.assemble_bordered_matrix(1.0, 0.0, complex(powers[2]).real)
        if complex(s).imag == 0:
            powers = [complex(p).real for p in powers]
        return self.assemble_bordered_matrix(*powers)

    def apply_derivative(self, s: complex, x: np.ndarray) -> np.ndarray:
        """Compute ``P'(s) x`` with the derivative of ``P(s)`` with respect to s.

        The result is real if ``P(s)`` and x are real. For an undamped model, the derivative is with
        respect to ``s^2`` instead of ``s``.
        """
        if self.is_undamped:
            return np.asarray(self.coefficients[2] @ x)
        s = complex(s).real if complex(s).imag == 0 else s
        return np.asarray(
            sum(k * s ** (k - 1) * (P @ x) for k, P in enumerate(self.coefficients) if k)
        )

    def factorise_polynomial(self, s: complex) -> tuple[Factor, Factor]:
        """Return factorisations of ``P(s)`` and of the transpose of ``P(s)``.

        Raises
        ------
        SimulationError : ``s`` is a pole.
        """
        try:
            return factorise_two_sided(self.evaluate_polynomial(s), symmetric=self.is_symmetric)
        except SimulationError as error:
            raise SimulationError(
                error.message, where=error.where, got=f"{error.got} at s = {s:.6g} 1/s"
            ) from None

    @property
    def is_large(self) -> bool:
        """Whether the matrices are so large that factors without pivoting are faster."""
        K = self.coefficients[0]
        return (
            K.is_large if isinstance(K, SchurComplement) else self.size >= QUASI_DEFINITE_UNKNOWNS
        )

    def factorise_shifted_stiffness(self, square: float) -> Factor:
        """Return a real factorisation of ``K - square * M`` for a scalar ``square``.

        Raises
        ------
        SimulationError : the matrix is singular, or ``square`` is zero and K is not positive
        definite.
        """
        if square:
            matrix = scipy.sparse.csc_array(self.assemble_bordered_matrix(1.0, 0.0, -square))
            if square < 0 and self.is_large:
                return factorise_quasi_definite(matrix)
            return factorise(matrix, definite=False)
        return self.factors.get(self._factorise_stiffness)

    @cached_property
    def static_response(self) -> np.ndarray:
        """Static response (n, inputs) ``K^-1 B`` of a model whose K is definite.

        Raises
        ------
        SimulationError : K is singular, or not positive definite.
        """
        return np.asarray(self.factorise_shifted_stiffness(0.0).solve(self.B))

    def _factorise_stiffness(self) -> Factor:
        """Factorise K; for a Schur complement, factorise the matrix of all four blocks."""
        matrix, K = (
            scipy.sparse.csc_array(self.assemble_bordered_matrix(1.0, 0.0, 0.0)),
            self.coefficients[0],
        )
        if isinstance(K, SchurComplement) and self.is_large and self.is_symmetric:
            return factorise_quasi_definite(matrix)
        return factorise(matrix, definite=not isinstance(K, SchurComplement))

    @property
    def elimination_order(self) -> np.ndarray | None:
        """Elimination order in the factorisation of K, or None if K is not factorised.

        The elimination order of K is also suitable for other matrices of the same unknowns.
        """
        factor = self.factors.value_or_none
        order = None if factor is None else factor.order
        return None if order is None else order[order < self.size]

    @property
    def is_factorised(self) -> bool:
        """Whether K is already factorised."""
        return self.factors.value_or_none is not None

    def share_factors(self, other: Pencil) -> None:
        """Let the pencil ``other``, which has the same K, use this pencil's factors of K."""
        other.factors.share_with(self.factors)

    def project(self, V: np.ndarray) -> Pencil:
        """Return the projection of the model on the basis V: ``V'PV``, ``V'B`` and ``CV``.

        Symmetric matrices remain exactly symmetric, and skew-symmetric matrices exactly
        skew-symmetric.
        """
        if self.rayleigh is None:
            reduced = tuple(apply_congruence(P, V, self.is_symmetric) for P in self.coefficients)
        else:
            alpha, beta = self.rayleigh
            K, M = (apply_congruence(P, V, self.is_symmetric) for P in self.coefficients[::2])
            reduced = (K, alpha * M + beta * K, M)
        B = V.T @ self.B
        return Pencil(reduced, B, B.T.copy() if self.is_collocated else self.C @ V, self.D)

    def project_in_extended_precision(self, V: np.ndarray) -> Pencil:
        """Project a dense pencil on the basis V in extended precision, with 19 digits.

        The stiffness of soft motions is a small difference of large entries of K. A precision of 16
        digits does not resolve the difference.
        """
        left, reduced = ExtendedPrecisionMatrix(V.T), []
        for P in self.coefficients:
            R = np.asarray(left @ (ExtendedPrecisionMatrix(P) @ V), dtype=float)
            if self.is_symmetric:
                R = 0.5 * (R + R.T)
            elif np.array_equal(P, -P.T):
                R = 0.5 * (R - R.T)
            reduced.append(R)
        B = np.asarray(left @ self.B, dtype=float)
        C = (
            B.T.copy()
            if self.is_collocated
            else np.asarray(ExtendedPrecisionMatrix(self.C) @ V, dtype=float)
        )
        return Pencil(tuple(reduced), B, C, self.D)

    def truncate_to_order(self, order: int) -> Pencil:
        """Return the pencil that contains only the first ``order`` unknowns."""
        return self._select_unknowns(slice(order), min(self.free, order))

    @property
    def without_rigid_body_modes(self) -> Pencil:
        """Pencil of this model without rigid-body modes."""
        return self._select_unknowns(slice(self.free, None), 0)

    def _select_unknowns(self, q: slice, free: int) -> Pencil:
        """Select the rows and columns of the unknowns ``q`` from all matrices of a pencil.

        The first ``free`` selected unknowns are rigid-body modes.
        """
        parts = tuple(P[q, q] for P in self.coefficients)
        return Pencil(parts, self.B[q], self.C[:, q], self.D, free=free)

    @property
    def has_uncoupled_rigid_modes(self) -> bool:
        """Whether rigid-body modes exist and are not coupled to the other unknowns."""
        r = self.free
        return bool(r) and not any(P[:r, r:].any() or P[r:, :r].any() for P in self.coefficients)

    def prepend_rigid_body_modes(self, free: Pencil) -> Pencil:
        """Return this pencil with the rigid-body modes ``free`` as first unknowns.

        The rigid-body modes are not coupled to the unknowns of this pencil.
        """
        parts = tuple(map(scipy.linalg.block_diag, free.coefficients, self.coefficients))
        B, C = np.vstack([free.B, self.B]), np.hstack([free.C, self.C])
        return Pencil(parts, B, C, self.D, free=free.size)

    def make_dual(self) -> Pencil:
        """Return the dual model, in which inputs and outputs are exchanged."""
        flipped = tuple(P.T for P in self.coefficients)
        return Pencil(flipped, self.C.T, self.B.T, self.D.T, free=self.free)

    def scale_unknowns(self, omega: float) -> Pencil:
        """Return the model with unknowns scaled to similar energies at ``omega`` [rad/s]."""
        return self.rescale_unknowns(self.choose_units(omega))

    def choose_units(self, omega: float) -> np.ndarray:
        """Choose units (n,) in which all unknowns have similar energies at ``omega``.

        One unit of each unknown has about the same energy at the frequency ``omega`` [rad/s].
        """
        size = np.zeros(self.size)
        for k, P in enumerate(self.coefficients):
            rows = compute_absolute_entries(P).max(axis=1)
            rows = rows.toarray() if scipy.sparse.issparse(rows) else rows
            size += omega**k * np.asarray(rows, dtype=float).ravel()
        t = 1 / np.sqrt(np.where(size > 0, size, 1.0))
        return np.asarray(np.exp2(np.round(np.log2(t))))  # powers of two cause no rounding errors

    def rescale_unknowns(self, t: np.ndarray) -> Pencil:
        """Return the model whose unknowns are divided by the units ``t`` (n,)."""

        def scale_both_sides(P: Matrix) -> Matrix:
            """Return ``diag(t) P diag(t)`` with scaled rows and columns."""
            if isinstance(P, SchurComplement):
                return P.scale_symmetrically(t)
            return t[:, None] * P * t if isinstance(P, np.ndarray) else scale_matrix(P, t, t)

        parts = tuple(map(scale_both_sides, self.coefficients))
        B = t[:, None] * self.B
        C = B.T.copy() if self.is_collocated else self.C * t
        result = Pencil(parts, B, C, self.D, self.rayleigh)
        # scaling preserves symmetry, so the costly test of symmetry is not repeated
        if self.is_symmetric:
            result.symmetry.get(lambda: True)
        return result

    def states(self, s: np.ndarray) -> np.ndarray:
        """Compute the unknowns ``P(s)^-1 B`` for unit inputs at all values ``s``.

        The result has the shape (len(s), n, m): values, unknowns and inputs.

        Raises
        ------
        SimulationError : a value in ``s`` is a pole of the model.
        """
        s = np.asarray(s, dtype=complex)
        result = np.empty((len(s), *self.B.shape), dtype=complex)
        if not self.is_dense:
            for k, item in enumerate(s):
                result[k] = self.factorise_polynomial(item)[0].solve(self.B)
            return result
        step = max(1, int(BATCH_BYTES / (16 * max(self.size, 1) ** 2)))
        for begin in range(0, len(s), step):
            part = s[begin : begin + step, None, None]
            P = sum(part**k * P for k, P in enumerate(self.coefficients))
            try:
                result[begin : begin + step] = np.linalg.solve(P, self.B.astype(complex)[None])
            except np.linalg.LinAlgError:
                raise SimulationError(
                    "at one of the frequencies, the model has a pole and an infinite response",
                    where="transfer function",
                ) from None
        return result

    def transfer(self, s: np.ndarray) -> np.ndarray:
        """Compute the transfer matrix ``C P(s)^-1 B + D`` at all values ``s``.

        The result is a complex array of shape (len(s), outputs, inputs).
        """
        if self.is_dense:
            return np.asarray(self.C @ self.states(s) + self.D)
        return np.stack([self.C @ self.states(item[None])[0] + self.D for item in np.asarray(s)])

    def poles(self, omega: float | None = None) -> np.ndarray:
        """Compute the finite poles [1/s] of the model with dense matrices.

        ``omega`` is a typical angular frequency [rad/s] by which rates are scaled.
        """
        full = self.coefficients if self.is_dense else self.make_dense().coefficients
        sizes = list(map(find_largest_entry, full))
        if omega is None:
            ratio = sizes[0] / sizes[-1] if sizes[0] and sizes[-1] else 1.0
            omega = float(ratio ** (1 / self.degree))
        scale = 1 / max([omega**k * size for k, size in enumerate(sizes)] + [np.finfo(float).tiny])
        parts = tuple(scale * omega**k * P for k, P in enumerate(full))
        rest, inertia = convert_to_first_order(
            Pencil(parts, self.B, self.C, self.D), 1.0
        ).coefficients
        if sizes[-1] and np.linalg.cond(parts[-1]) < MAX_INVERTED_CONDITION:
            return np.asarray(-omega * np.linalg.eigvals(np.linalg.solve(inertia, rest)))
        values = scipy.linalg.eigvals(-rest, inertia)
        return np.asarray(
            omega * values[np.isfinite(values) & (np.abs(values) < INFINITE_POLE_RATIO)]
        )


class GrowingProjection:
    """Projection of a definite pencil on a growing basis V.

    Each new block of basis vectors adds rows and columns to ``V'KV`` and ``V'MV``.
    """

    def __init__(self, pencil: Pencil) -> None:
        self._full = pencil
        self._K, self._M = np.empty((0, 0)), np.empty((0, 0))
        self._B = np.empty((0, pencil.B.shape[1]))

    def extend(self, V: np.ndarray, stiff: np.ndarray, heavy: np.ndarray) -> None:
        """Extend the projection by the last m columns of the basis V (n, k).

        ``stiff`` and ``heavy`` (n, m) are the products of K and M with the new columns.
        """
        self._K, self._M = (
            _border_matrix(self._K, V.T @ stiff),
            _border_matrix(self._M, V.T @ heavy),
        )
        self._B = np.vstack([self._B, V[:, len(self._B) :].T @ self._full.B])

    @property
    def pencil(self) -> Pencil:
        """Projection of the pencil on the present basis."""
        alpha, beta = self._full.rayleigh or (0.0, 0.0)
        reduced = self._K, alpha * self._M + beta * self._K, self._M
        return Pencil(reduced, self._B, self._B.T.copy(), self._full.D)


def _border_matrix(square: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Extend a symmetric matrix by ``columns`` (k, m) and the corresponding rows."""
    old = len(square)
    corner = 0.5 * (columns[old:] + columns[old:].T)
    return np.block([[square, columns[:old]], [columns[:old].T, corner]])


def make_explicit_pencil(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> Pencil:
    """Return the pencil of a state-space model ``x' = A x + B u``, ``y = C x + D u``."""
    return Pencil((-A, np.eye(len(A))), B, C, D)


def convert_to_first_order(pencil: Pencil, omega: float) -> Pencil:
    """Convert a model to the first-order form ``E x' = A x + B u``.

    No matrix is inverted. Velocities are divided by ``omega`` [rad/s].
    """
    if pencil.degree == 1:
        return pencil
    K, E, M = pencil.coefficients
    n, zero, one = pencil.size, np.zeros_like(M), omega * np.eye(pencil.size)
    rest = np.block([[zero, -omega * one], [K, omega * E]])
    inertia = np.block([[one, zero], [zero, omega * M]])
    B = np.vstack([np.zeros_like(pencil.B), pencil.B])
    return Pencil((rest, inertia), B, np.hstack([pencil.C, np.zeros((len(pencil.C), n))]), pencil.D)


def detect_rayleigh_damping(pencil: Pencil) -> Pencil:
    """Detect Rayleigh damping, where E is ``alpha M + beta K`` within rounding errors.

    Return the pencil with the attribute ``rayleigh`` set to ``(alpha, beta)``, so that a definite
    model can be reduced with real factorisations. A pencil without Rayleigh damping is returned
    unchanged.
    """
    if pencil.degree != 2 or pencil.rayleigh is not None or pencil.is_undamped:
        return pencil
    K, E, M = pencil.coefficients
    if any(isinstance(P, SchurComplement) for P in pencil.coefficients) or not find_largest_entry(
        M
    ):
        return pencil
    basis = [P / find_largest_entry(P) for P in (M, K)]
    gram = [[float((P * Q).sum()) for Q in basis] for P in basis]
    result = np.linalg.lstsq(gram, [float((P * E).sum()) for P in basis], rcond=None)[0]
    result = np.where(np.abs(result) > EQUALITY_TOLERANCE * find_largest_entry(E), result, 0.0)
    remainder = E - result[0] * basis[0] - result[1] * basis[1]
    if (result < 0).any() or find_largest_entry(
        remainder
    ) > EQUALITY_TOLERANCE * find_largest_entry(E):
        return pencil
    rayleigh = float(result[0] / find_largest_entry(M)), float(result[1] / find_largest_entry(K))
    return replace(pencil, rayleigh=rayleigh)


def eliminate_massless(pencil: Pencil) -> Pencil:
    """Eliminate unknowns without inertia and damping exactly by a Schur complement.

    Massless unknowns are the electric potentials of a piezoelectric model and the algebraic
    unknowns of a first-order model. The pencil is returned unchanged if the block of the massless
    unknowns is singular (index two), or if K or -A is already a Schur complement.
    """
    rest, *others = pencil.coefficients
    if isinstance(rest, SchurComplement) or pencil.rayleigh is not None or pencil.size < 2:
        return pencil
    massless = ~mask_unknowns_with_entries(others)
    if not massless.any() or massless.all():
        return pencil
    keep, p = np.flatnonzero(~massless), np.flatnonzero(massless)
    rest = scipy.sparse.csc_array(rest)
    blocks = [
        scipy.sparse.csc_array(rest[i][:, j])
        for i, j in ((keep, keep), (keep, p), (p, keep), (p, p))
    ]
    schur = SchurComplement(*blocks)
    if not blocks[3].nnz:
        return pencil
    try:
        lift = schur.inner_factor.solve(pencil.B[p])
        transposed_factor = factorise_two_sided(
            blocks[3], symmetric=is_equal(blocks[3], blocks[3].T)
        )[1]
        back = transposed_factor.solve(pencil.C[:, p].T)
    except SimulationError:
        return pencil
    B = pencil.B[keep] - schur.up @ lift
    C = pencil.C[:, keep] - (schur.pu.T @ back).T
    C = B.T.copy() if pencil.is_collocated and pencil.is_symmetric else C
    D = pencil.D + pencil.C[:, p] @ lift
    parts = tuple(scipy.sparse.csc_array(P)[keep][:, keep] for P in others)
    return Pencil((schur, *map(scipy.sparse.csc_array, parts)), B, C, D)
