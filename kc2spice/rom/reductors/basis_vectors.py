"""Checks and scaling of the basis vectors that a reduction method returns."""

from __future__ import annotations

from typing import Any

import numpy as np

from kc2spice.core.errors import UsageError, join_first

# Largest distance of a dependent unit vector from the span of earlier vectors, about 450 eps. The
# rounding errors in a QR factorisation of a few hundred vectors are about 1e-14.
DEPENDENT_BY_ROUNDING = 1e-13
# Several adjacent dependent columns form one group. If the number of groups is at most
# MAX_LISTED_GROUPS, an error proposes to delete the dependent columns.
MAX_LISTED_GROUPS = 10
# A basis V whose condition number exceeds MAX_CONDITION is orthonormalised.
# V'KV is the reduced stiffness matrix. The relative rounding error of the smallest eigenvalue of
# V'KV is eps = 2.2e-16 times the squared condition number of V. If the condition number of V is at
# most 1e3, the relative rounding error of the smallest eigenvalue is below 3e-10.
MAX_CONDITION = 1e3


def require_vectors(value: Any, where: str, shape: tuple[int, int | None]) -> np.ndarray:
    """Require vectors that form a basis, and return them as a real matrix.

    Parameters
    ----------
    value : array_like
        Vectors, one in each column.
    where : str
        Name of the argument, for error messages.
    shape : tuple
        Required numbers of rows and columns. If the number of columns is None, any number is
        accepted.

    Raises
    ------
    UsageError : the value is not a matrix of the required ``shape``, contains numbers that are
        complex or not finite, or has linearly dependent columns.
    """
    V, (rows, columns) = _require_real_matrix(value, where, shape[0]), shape
    if len(V) != rows or columns not in (None, V.shape[1]):
        expected = f"{rows} rows, one for each coordinate of task.model"
        if columns is not None:
            expected += f", and {columns} columns as V"
        raise UsageError(
            "the vectors have a wrong shape", where=where, got=_describe_size(V), expected=expected,
            hint="build the vectors from the matrices of task.model, not of task.fom",
        )  # fmt: skip
    if rows and not V.shape[1]:
        raise UsageError(
            "the array contains no vectors",
            where=where,
            got=_describe_size(V),
            expected="at least one column",
        )
    if not np.isfinite(V).all():
        count = int((~np.isfinite(V)).sum())
        raise UsageError(
            "the vectors contain numbers that are not finite",
            where=where,
            got=f"{count} entries that are NaN or infinite",
            expected="finite numbers",
        )
    if _has_dependent_columns(V):
        groups = _list_dependent_columns(V)
        listed = [str(low) if low == high else f"{low} to {high}" for low, high in groups]
        one = len(groups) == 1 and groups[0][0] == groups[0][1]
        slices = [str(low) if low == high else f"{low}:{high + 1}" for low, high in groups]
        raise UsageError(
            "the vectors are linearly dependent",
            where=where,
            got=f"column{'' if one else 's'} {join_first(listed)} of {V.shape[1]} "
            f"{'is zero or a combination' if one else 'are zero or combinations'} of the columns "
            "before (the first column is column 0)",
            expected=f"linearly independent columns, at most {rows}",
            hint=f"write V = np.delete(V, np.r_[{', '.join(slices)}], axis=1)"
            if len(groups) <= MAX_LISTED_GROUPS
            else "write V = scipy.linalg.orth(V)",
        )
    return V


def scale_to_unit_norm(V: np.ndarray) -> np.ndarray:
    """Scale vectors by powers of two, so that their norms are close to one.

    Scaling by powers of two gives norms between 0.7 and 1.5, and causes no rounding errors.
    Orthonormal vectors do not change. The scale of a basis vector has no effect on the response of
    the reduced model. Without scaling, however, a reduced model could contain a mass of 1e-22 and
    another mass of 1. The small mass would then count as zero.

    >>> scale_to_unit_norm(np.array([[0.6, 3e-11], [0.8, 4e-11]])).round(2)
    array([[0.6 , 0.52],
           [0.8 , 0.69]])
    """
    norms = np.linalg.norm(V, axis=0)
    exponents = np.round(np.log2(np.where(norms > 0, norms, 1.0))).astype(int)
    return np.asarray(np.ldexp(V, -exponents))


def improve_conditioning(V: np.ndarray) -> np.ndarray:
    """Return V if it is well-conditioned, otherwise the factor Q of ``V = Q R``.

    The columns of V may be almost linearly dependent. For example, a static response is nearly a
    sum of many modes. If the condition number of V exceeds a thousand, the result is the matrix Q
    of the factorisation ``V = Q R``. For each q, the first q columns of Q and of V span the same
    space. If V is well-conditioned, the result is V.

    >>> abs(improve_conditioning(np.array([[1.0, 1.0], [0.0, 1e-6]]))).round(9)
    array([[1., 0.],
           [0., 1.]])
    """
    spectrum = np.linalg.eigvalsh(V.T @ V)  # squared singular values of V
    if spectrum[0] * MAX_CONDITION**2 >= spectrum[-1]:
        return V
    return np.linalg.qr(V)[0]


def _require_real_matrix(value: Any, where: str, rows: int) -> np.ndarray:
    """Return the vectors as a two-dimensional array of real numbers."""
    expected = f"a real array of {rows} rows, one for each coordinate of task.model"
    try:
        V = np.asarray(value)
    except ValueError:  # NumPy rejects rows of different lengths
        V = np.empty(0, dtype=object)
    if V.dtype.kind == "c":
        raise UsageError(
            "vectors are complex",
            where=where,
            got=f"an array of {V.dtype}",
            expected=expected,
            hint="use real and imaginary parts: np.linalg.qr(np.hstack([V.real, V.imag]))[0]",
        )
    if V.dtype.kind not in "fiu":
        name, dtype = type(value).__name__, getattr(value, "dtype", None)
        raise UsageError(
            "the vectors are not an array of numbers",
            where=where,
            got=f"an object of type {name} that contains no rectangular table of numbers"
            if dtype is None
            else f"an object of type {name} with elements of type {dtype}",
            expected=expected,
        )
    if V.ndim != 2:
        hint = "write one vector as V[:, None]" if V.ndim == 1 else None
        raise UsageError(
            "the vectors are not a matrix",
            where=where,
            got=f"an array of shape {V.shape}",
            expected=expected,
            hint=hint,
        )
    return V.astype(float)


def _has_dependent_columns(V: np.ndarray) -> bool:
    """Return whether a column of a matrix is a combination of the columns before it."""
    norms = np.linalg.norm(V, axis=0)
    distance = np.zeros(V.shape[1])
    diagonal = np.abs(np.diag(np.linalg.qr(V / np.where(norms > 0, norms, 1.0), mode="r")))
    distance[: diagonal.size] = diagonal
    return bool((distance <= DEPENDENT_BY_ROUNDING).any())


def _list_dependent_columns(V: np.ndarray) -> list[tuple[int, int]]:
    """Return the first and last index of each group of linearly dependent columns.

    The independent columns of V have the same span as V.

    >>> _list_dependent_columns(np.array([[1.0, 2.0, 3.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0, 1.0]]))
    [(1, 2), (4, 4)]
    """
    basis, groups = np.empty((len(V), 0)), list[tuple[int, int]]()
    for k, column in enumerate(V.T):
        rest = column / (np.linalg.norm(column) or 1.0)
        for _ in range(2):  # the second pass removes rounding errors of the first
            rest = rest - basis @ (basis.T @ rest)
        if (distance := np.linalg.norm(rest)) > DEPENDENT_BY_ROUNDING:
            basis = np.column_stack([basis, rest / distance])
        elif groups and groups[-1][1] == k - 1:
            groups[-1] = groups[-1][0], k
        else:
            groups.append((k, k))
    return groups


def _describe_size(V: np.ndarray) -> str:
    """Describe the numbers of rows and columns of a matrix, for error messages."""
    return f"{V.shape[0]} rows and {V.shape[1]} columns"
