"""Factors of sparse matrices from PARDISO in the Intel Math Kernel Library.

The package ``mkl`` contains the library, whose functions are called through ``ctypes``. For
symmetric indefinite and complex symmetric matrices, PARDISO needs half the memory and much less
time than an LU factorisation.

Source: O. Schenk, K. Gaertner, Future Generation Computer Systems 20 (2004) 475.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.metadata
import weakref
from functools import cache
from typing import Any

import numpy as np
import scipy

from kc2spice.core.errors import MissingToolError
from kc2spice.core.optional_libraries import OPTIONAL_LIBRARIES

# Codes of PARDISO for symmetric matrices, keyed by whether the matrix is complex.
# PARDISO reads only the upper triangle of a symmetric matrix.
SYMMETRIC_TYPES = {False: -2, True: 6}
UNSYMMETRIC_TYPES = {False: 11, True: 13}
# codes of PARDISO's phases
FACTORISE = 12
SOLVE = 33
RELEASE = -1
# largest relative difference from the transpose for which a matrix counts as symmetric
SYMMETRY_TOLERANCE = 1e-12
# PARDISO replaces pivots that are smaller than 10^-k times the norm of the matrix.
# The exponent k is 8 for symmetric matrices, and 13 for unsymmetric matrices.
PIVOT_DIGITS = {True: 8, False: 13}
# indices in the parameter array ``iparm``, counted from 0
OWN_VALUES = 0
ORDER = 1
PIVOTS = 9
SCALING = 10
MATCHING = 12
REPLACED_PIVOTS = 13
BUNCH_KAUFMAN = 20
NEGATIVE = 22
NESTED_DISSECTION = 2  # value of ``iparm[ORDER]``: nested dissection by METIS


class Pardiso:
    """PARDISO factorisation of a real or complex sparse matrix.

    The matrix may be symmetric or unsymmetric.

    Parameters
    ----------
    matrix : (n, n) sparse array
        Matrix A.

    Attributes
    ----------
    negative_eigenvalues : int or None
        Number of negative eigenvalues, or None if the matrix is complex, unsymmetric or nearly
        singular.

    Raises
    ------
    MissingToolError : the package ``mkl`` is not installed.
    RuntimeError : PARDISO reports an error, such as a singular matrix.
    """

    def __init__(self, matrix: Any) -> None:
        # without the package ``mkl``, this call raises MissingToolError before memory is allocated
        _load_library()
        difference = abs(matrix - matrix.T).max()
        symmetric = bool(difference <= SYMMETRY_TOLERANCE * abs(matrix).max())
        complex_numbers = bool(np.iscomplexobj(matrix))
        rows = _complete_diagonal(matrix, symmetric)
        self._kind = (SYMMETRIC_TYPES if symmetric else UNSYMMETRIC_TYPES)[complex_numbers]
        self._entries = rows.data.astype(complex if complex_numbers else float)
        self._begin, self._columns = (a.astype(np.int32) + 1 for a in (rows.indptr, rows.indices))
        self._memory = np.zeros(64, dtype=np.int64)
        self._settings = np.zeros(64, dtype=np.int32)
        self._settings[[OWN_VALUES, ORDER]] = 1, NESTED_DISSECTION
        self._settings[PIVOTS] = PIVOT_DIGITS[symmetric]
        self._settings[[SCALING, MATCHING]] = not symmetric
        self._settings[BUNCH_KAUFMAN] = symmetric
        memory = self._memory, self._settings
        release = weakref.finalize(
            self, _call_pardiso, RELEASE, self._kind, rows.shape[0], (), *memory
        )
        release.atexit = False
        self._run_phase(FACTORISE, np.zeros((rows.shape[0], 1), self._entries.dtype))
        signs_known = self._kind == SYMMETRIC_TYPES[False] and not self._settings[REPLACED_PIVOTS]
        self.negative_eigenvalues = int(self._settings[NEGATIVE]) if signs_known else None

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve ``A x = rhs`` for right-hand sides (n, k)."""
        return self._run_phase(SOLVE, rhs)

    def _run_phase(self, phase: int, rhs: np.ndarray) -> np.ndarray:
        """Run one phase of PARDISO on the stored matrix, and return the solution."""
        rhs = np.asfortranarray(rhs, dtype=self._entries.dtype)
        x = np.zeros_like(rhs, order="F")
        matrix = self._entries, self._begin, self._columns
        _call_pardiso(phase, self._kind, len(rhs), matrix, self._memory, self._settings, rhs, x)
        return x


def require_library() -> None:
    """Load the library that contains PARDISO, or raise an error.

    Raises
    ------
    MissingToolError : the package ``mkl`` is not installed.
    """
    _load_library()


def _complete_diagonal(matrix: Any, symmetric: bool) -> scipy.sparse.csr_array:
    """Return a matrix in CSR format that stores all diagonal entries, including zeros.

    If ``symmetric`` is true, the returned matrix contains only the upper triangle.
    """
    entries = scipy.sparse.coo_array(scipy.sparse.triu(matrix) if symmetric else matrix)
    n = entries.shape[0]
    diagonal = np.arange(n)
    places = np.r_[entries.row, diagonal], np.r_[entries.col, diagonal]
    rows = scipy.sparse.csr_array((np.r_[entries.data, np.zeros(n)], places), shape=(n, n))
    rows.sort_indices()
    return rows


def _call_pardiso(
    phase: int,
    kind: int,
    size: int,
    matrix: tuple[np.ndarray, ...],
    memory: np.ndarray,
    settings: np.ndarray,
    rhs: np.ndarray | None = None,
    x: np.ndarray | None = None,
) -> None:
    """Call the PARDISO library for one of its phases.

    Raises
    ------
    RuntimeError : PARDISO returns an error number.
    """
    nothing = np.zeros(1)
    entries, begin, columns = matrix or (nothing,) * 3
    count = 1 if rhs is None else rhs.shape[1]
    one, error = ctypes.c_int32(1), ctypes.c_int32(0)
    numbers = [one, one, *map(ctypes.c_int32, (kind, phase, size))]
    silent = ctypes.c_int32(0)
    _load_library().pardiso(
        _get_address(memory),
        *map(ctypes.byref, numbers),
        *map(_get_address, (entries, begin, columns, nothing)),
        ctypes.byref(ctypes.c_int32(count)),
        _get_address(settings),
        ctypes.byref(silent),
        *(_get_address(nothing if array is None else array) for array in (rhs, x)),
        ctypes.byref(error),
    )
    if error.value:
        raise RuntimeError(f"PARDISO returned the error code {error.value}")


def _get_address(array: np.ndarray) -> ctypes.c_void_p:
    """Return the memory address of the first number of an array."""
    return array.ctypes.data_as(ctypes.c_void_p)


@cache
def _load_library() -> ctypes.CDLL:
    """Load the PARDISO library, from the package ``mkl`` or from the system."""
    try:
        files = importlib.metadata.files("mkl") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    names = (
        str(file.locate()) for file in files if file.name.startswith(("libmkl_rt.", "mkl_rt."))
    )
    path = next(names, None) or ctypes.util.find_library("mkl_rt")
    problem, got = "PARDISO is not installed", None
    if path is not None:
        try:
            return ctypes.CDLL(path)
        except OSError as error:
            problem, got = "PARDISO cannot be loaded", str(error)
    raise MissingToolError(
        problem, where="solver", got=got, hint=OPTIONAL_LIBRARIES["mkl"].installation_command
    )
